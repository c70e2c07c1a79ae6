"""Baseline models of blood flow, and PyMC models made of one, an error model and effects."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from zoo.blood.blood_flow import BloodFlow, StiffnessLaw, study_data
from zoo.blood.conventions import Conventions
from zoo.blood.effects.given import Given, added_effects
from zoo.blood.network import Network
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.blood.study_priors import (
    GivenPrior,
    check_names,
    held_parameters,
    prior_table,
    study_parameters,
    with_priors,
)
from zoo.core.effects import EffectError, with_effects
from zoo.core.parameters import Parameter
from zoo.core.words import nearest

if TYPE_CHECKING:
    import pymc as pm

    from zoo.core.data import Data
    from zoo.core.errors.base import ErrorModel

HOMES = {
    "linear-constant": "B",
    "linear-radius": "E",
    "linear-vessels": "G",
    "tangent-constant": "H",
    "tangent-radius": "I",
}
"""The model that declares each baseline of the paper's models; others declare their own."""
SHARED = {"A": "B", "C": "B", "D": "E", "F": "G"}
"""Models with the same mean as another."""


@dataclass(frozen=True)
class Baseline:
    """A model to which effects are added: a wall law, a stiffness law, and parameters with their priors.

    Parameters
    ----------
    name : str
    wall : {"linear", "tangent"}
        Eq. (3.3), in whose place a study's own law stands, or (3.4).
    stiffness : function
        Stiffness of every vessel from the parameters, a `zoo.blood.blood_flow.StiffnessLaw`.
    parameters : tuple of Parameter
        Their starts are where a search may begin. One with dims "vessel" has an element for each vessel.
    wall_factor : float, optional
        Instead of that of a study's conventions, as model I has it.
    fixed : mapping of name to number
        Parameters of known value, such as {"gamma": 5.0}.
    prior_set : str
        Which named set the priors of `parameters` are, such as "paun2020": studies of another set have those
        of `zoo.blood.study_priors` instead. Empty: they hold for any study.
    """

    name: str
    wall: str
    stiffness: StiffnessLaw
    parameters: tuple[Parameter, ...]
    wall_factor: float | None = None
    fixed: Mapping[str, float] = field(default_factory=dict)
    prior_set: str = ""

    def _wall(self, study: Study) -> str:
        return study.wall if self.wall == "linear" else self.wall

    def _conventions(self, study: Study, given: Conventions | None) -> Conventions:
        if given is None and self.wall_factor is not None:
            return study.conventions.replace(wall_factor=self.wall_factor)
        return given or study.conventions

    def priors(
        self,
        study: Study,
        *,
        conventions: Conventions | None = None,
        priors: Mapping[str, Any] | None = None,
    ) -> tuple[GivenPrior, ...]:
        """The parameters with the priors that a study gives them, and where these came from.

        Parameters
        ----------
        study : Study
        conventions, priors
            As in `forward`.

        Returns
        -------
        tuple of GivenPrior
            Vectors with an element for each vessel.

        Raises
        ------
        zoo.blood.prior_tables.PriorsError
            If the study's table of priors, or `priors`, cannot be used.
        """
        given, held = self._given(with_priors(study, priors), conventions)
        return tuple(one for one in given if one.parameter.name not in held)

    def held(self, study: Study) -> dict[str, float]:
        """The parameters that a study holds, by the baseline's own names."""
        return self._given(study, None)[1]

    def _given(
        self, study: Study, conventions: Conventions | None
    ) -> tuple[tuple[GivenPrior, ...], dict[str, float]]:
        """All parameters with their priors, and the values of those that are held."""
        n = len(study.vessels)
        parameters = [replace(p, size=n) if p.dims == "vessel" else p for p in self.parameters]
        given = study_parameters(
            parameters, study, self._wall(study), self._conventions(study, conventions), self.prior_set
        )
        return given, held_parameters(study, given)

    def forward(
        self,
        study: Study,
        *,
        conventions: Conventions | None = None,
        options: SolverOptions | None = None,
        priors: Mapping[str, Any] | None = None,
        share: float = 1.0,
    ) -> BloodFlow:
        """The forward model of a study.

        Parameters
        ----------
        study : Study
        conventions : Conventions
            Instead of the study's own, also of the baseline's `wall_factor`.
        options : SolverOptions
            Numerical settings; those of the study, `zoo.blood.resolution.resolve`, if absent.
        share : float
            Factor of the study's accepted distance from the periodic state.
        priors : mapping
            Instead of some of the study's own, as its table [priors] or as `Prior` objects.

        Returns
        -------
        BloodFlow
        """
        study = with_priors(study, priors)
        parameters = [one.parameter for one in self.priors(study, conventions=conventions)]
        check_names(study, self.parameters)
        flow = BloodFlow(
            study, self._wall(study), self.stiffness, parameters, name=self.name,
            conventions=self._conventions(study, conventions), options=options,
            fixed={**self.fixed, **self.held(study)},
        )  # fmt: skip
        return flow if options is not None else flow.resolved(share=share)


class StudyModel(Protocol):
    """A function that makes a PyMC model of a study, as `study_model` gives it."""

    def __call__(
        self,
        study: Study | Sequence[Study],
        *,
        effects: Iterable[Given] = (),
        options: SolverOptions | None = None,
        conventions: Conventions | None = None,
        priors: Mapping[str, Any] | None = None,
        fixed: Mapping[str, float] | None = None,
        errors: str | ErrorModel | None = None,
        share: Iterable[str] = (),
        population: Iterable[str] | Mapping[str, str] = (),
    ) -> pm.Model:
        """The PyMC model of a study."""


def get_baseline(name: str) -> Baseline:
    """A baseline by its name, or by the letter of a model that has its mean.

    Parameters
    ----------
    name : str
        Such as "linear-constant" or "B".

    Returns
    -------
    Baseline

    Raises
    ------
    EffectError
        If there is none.

    Examples
    --------
    >>> [p.name for p in get_baseline("B").parameters]
    ['f3', 'psi1', 'psi2', 'c']
    """
    from zoo.models import MODELS, PAPER

    own = {letter: _declared(letter) for letter in MODELS if letter not in PAPER}
    for letter, baseline in own.items():
        if [*HOMES, *(other.name for other in own.values())].count(baseline.name) > 1:
            raise EffectError(
                f"model {letter}: another model has a baseline named {baseline.name!r}; "
                "give this one a new name"
            )
    homes = HOMES | {baseline.name: letter for letter, baseline in own.items()}
    letter = homes.get(name, SHARED.get(name.upper(), name.upper()))
    if letter not in MODELS:
        raise EffectError(f"baseline {name!r}: {nearest(name, [*homes, *MODELS])}")
    return _declared(letter)


def _declared(letter: str) -> Baseline:
    found: Baseline = import_module(f"zoo.models.model_{letter.lower()}").BASELINE
    return found


def study_model(
    name: str,
    baseline: Baseline,
    errors: ErrorModel | Callable[[Study], ErrorModel],
) -> StudyModel:
    """Make the function that builds a model of any study; its help begins with the docstring of its module.

    Parameters
    ----------
    name : str
        Such as "B"; the function is named "model_B".
    baseline : Baseline
    errors : ErrorModel, or function of a study
        A function, such as `zoo.blood.errors.by_prior_set` makes, gives the errors of the study at hand.

    Returns
    -------
    StudyModel
    """
    usual = errors

    def build(
        study: Study | Sequence[Study],
        *,
        effects: Iterable[Given] = (),
        options: SolverOptions | None = None,
        conventions: Conventions | None = None,
        priors: Mapping[str, Any] | None = None,
        fixed: Mapping[str, float] | None = None,
        errors: str | ErrorModel | None = None,
        share: Iterable[str] = (),
        population: Iterable[str] | Mapping[str, str] = (),
    ) -> pm.Model:
        """Parameters
        ----------
        study : Study or sequence of Study
            With at least one observed series; several are subjects, each with a solver of its own.
        effects : iterable
            Added to the baseline, their parameters sampled beside its own: names such as "viscoelastic-wall"
            or "local-stiffness@2" (vessel 2), pairs such as ("local-stiffness", 2), effects with a location.
        options : SolverOptions, optional
            Numerical settings; chosen for the study's accuracy if absent.
        conventions : Conventions, optional
            Instead of the study's own.
        priors : mapping, optional
            Instead of some of the study's own: by parameter ("stiffness" is the overall one), each a prior or
            as in study.toml, ``{"f3": LogUniform(2e4, 4e5), "c": {"log_normal": [1, 0.5]}}``; also "set" and
            "wave_speed_m_s".
        fixed : mapping, optional
            Parameters that are held at a value, ``{"psi1": 1.0}``, beside those that the study holds.
        errors : {"student-t"} or ErrorModel, optional
            Instead of the model's own: "student-t" is `zoo.GroupStudent` with the study's `noise_sd`.
        share : iterable of str
            Parameters of several studies that are one for all.
        population : iterable of str, or mapping of str to str
            Those that come from one population, with their scale, as `zoo.joint_model` takes them.

        Returns
        -------
        pm.Model
            ``model.zoo`` is its record; with effects its name there is such as "B+viscoelastic-wall".

        Raises
        ------
        EffectError
            If an effect does not exist, cannot act there or cannot be added to this baseline.
        ValueError
            If the study has no observations, or the errors cannot hold for them.
        ModelError
            If several studies cannot be joined, or there is nothing to share with one alone.

        Examples
        --------
        >>> import zoo
        >>> model = zoo.model_B(zoo.load_study("demo"), effects=["viscoelastic-wall"])  # doctest: +SKIP
        >>> both = zoo.model_B([zoo.load_study("a"), zoo.load_study("b")], share=["f3"])  # doctest: +SKIP
        """  # noqa: D205  the model's own words come before
        import zoo.core.inference.pymc_step  # noqa: F401  for pm.sample() without a step method
        from zoo.blood.errors import errors_named
        from zoo.core.joint import joint_model
        from zoo.core.model import ModelError, bayesian_model

        if not isinstance(study, Study):
            added = list(effects)
            models = [
                build(
                    one,
                    effects=added,
                    options=options,
                    conventions=conventions,
                    priors=priors,
                    fixed=fixed,
                    errors=errors,
                )
                for one in study
            ]
            return joint_model(models, share=share, population=population)
        for option, names in (("share", [*share]), ("population", [*population])):
            if names:
                raise ModelError(f"{option} = {', '.join(names)}: is of several studies; give a list of them")
        study = with_priors(study, priors, fixed)
        data = study_data(study)
        chosen = usual if errors is None else errors_named(errors)
        law = _with_own_priors(chosen(study) if callable(chosen) else chosen, study, data)
        check_names(study, baseline.parameters, law.bind(data).parameter_names)
        flow = baseline.forward(study, conventions=conventions, options=options)
        given = baseline.priors(study, conventions=conventions)
        placed = added_effects(effects, flow)
        return bayesian_model(
            "+".join([name, *(one.name + one.location.suffix for one in placed)]),
            with_effects(flow, placed),
            data,
            law,
            coords={"vessel": [int(vessel) for vessel in flow.network.ids]},
            study=study,
            constants=_constants(study, flow.network),
            places={
                "vessel": [one.vessel for one in study.series],
                "position": [one.position for one in study.series],
            },
            settings={
                "conventions": asdict(flow.conventions),
                "solver options": asdict(flow.options)
                | ({} if flow.resolution is None else flow.resolution.record()),
                **({"held": held} if (held := baseline.held(study)) else {}),
                "prior origins": {
                    **dict.fromkeys(prior_table(study).own, "given"),
                    **{one.parameter.name: one.origin for one in given},
                },
            },
        )

    home = sys._getframe(1).f_globals  # the module that defines the model, where pickle finds it too
    build.__name__ = build.__qualname__ = f"model_{name}"
    build.__module__ = str(home.get("__name__"))
    build.__doc__ = "\n\n".join(inspect.cleandoc(text or "") for text in (home.get("__doc__"), build.__doc__))
    return build


def _constants(study: Study, network: Network) -> dict[str, tuple[tuple[str, ...], Any, str]]:
    """What a study gives its models and no parameter changes: name -> dimensions, values, unit."""
    pressure = study.inlet_pressure_mmHg
    times = np.arange(len(pressure)) * (study.period_s / max(1, len(pressure)))
    inlets: dict[str, tuple[tuple[str, ...], Any, str]] = {
        "inflow": (("inflow_time",), study.inflow_ml_s, "ml/s"),
        "inflow_time": (("inflow_time",), study.inflow_time_s, "s"),
        "inlet_pressure": (("inlet_time",), pressure, "mmHg"),
        "inlet_time": (("inlet_time",), times, "s"),
    }
    return {
        **{name: given for name, given in inlets.items() if len(given[1])},
        "length": (("vessel",), network.length_cm, "cm"),
        "radius_in": (("vessel",), network.radius_in_cm, "cm"),
        "radius_out": (("vessel",), network.radius_out_cm, "cm"),
        "period": ((), study.period_s, "s"),
    }


def _with_own_priors(errors: ErrorModel, study: Study, data: Data) -> ErrorModel:
    """Errors with the priors that a study gives their parameters by name."""
    there = errors.bind(data).parameter_names
    own = {name: prior for name, prior in prior_table(study).own.items() if name in there}
    return errors.with_priors(own) if own else errors
