"""Priors that follow from a study: what is known of its vessels and loads before their waves are seen.

The models of the paper have its priors in their files, the set "paun2020", which are for one mouse. In the
set "study", the default for any other study:

- The stiffness chi of a vessel is log-normal, 95 % of it between the stiffnesses of two pulse wave speeds:
  c^2 = (2/3) chi/rho of the linear wall at rest, k chi pi/(gamma rho) of the tangent one (gamma its median).
- Where stiffness depends on the radius, chi = f1 exp(f2 r0/u) + f3, f3 is that of wide vessels; f1 adds to
  it in narrow ones, and f2 counts in u/r, r the geometric mean of the widest and the narrowest radius.
- Where each vessel has its own, log chi_i ~ N(log m_chi, v_chi): m_chi is the stiffness of above, and v_chi
  the variance of the logarithm between vessels.
- The factors psi1, psi2 and c of the outlets are log-normal around 1, the given or nominal loads.
- gamma is log-normal around 3, a wall that can grow to two and a half times its area.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from zoo.blood.conventions import Conventions
from zoo.blood.network import Network
from zoo.blood.prior_tables import (
    PAPER_SET,
    STIFFNESS,
    PriorsError,
    PriorTable,
    check_held,
    names_of,
    read_priors,
    table_of,
)
from zoo.blood.solver import CHI_WALLS
from zoo.blood.study import QUANTITIES, Study
from zoo.core.effects import nearest
from zoo.core.parameters import InverseGamma, LogNormal, LogPopulation, Normal, Parameter, Prior

NORMAL_95 = 1.959963984540054
"""Standard deviations from the middle of a normal density that hold 95 % of it."""

GAMMA = LogNormal(3.0, 0.5)
"""Of the tangent wall, whose largest area is A0 (1 + gamma/2): 95 % between 1.1 and 8."""
LOADS = {"psi1": LogNormal(1.0, 1.0), "psi2": LogNormal(1.0, 0.7), "c": LogNormal(1.0, 1.0)}
"""Factors on given or nominal loads; R1 + R2 is a mean pressure over a mean flow, hence the narrower psi2."""
POSITIVE = ("f3", "m_chi", "gamma", "psi1", "psi2", "c")
"""Parameters that a solve takes only as positive numbers."""
RADIUS_SHARE = 3.0
"""Median of f1 over that of f3: what the narrowest vessels could add, were their radius zero."""
RADIUS_SPREAD = 1.0
"""Sd of the logarithm of f1/f3 beside that of the stiffness."""
RADIUS_RATE = Normal(-2.0, 1.5, -math.inf, 0.0)
"""Of f2 in parts of u/r."""
BETWEEN_VESSELS = InverseGamma(3.0, 0.4)
"""Variance of the logarithm of the stiffness between vessels: 95 % of its root between 0.24 and 0.80."""

OF_MODELS = (
    "f1", "f2", "f3", "gamma", "m_chi", "v_chi", "psi1", "psi2", "c", STIFFNESS, "sigma2", "w", "b",
    *(f"{what}_{quantity}" for what in ("noise", "amplitude", "w", "b") for quantity in QUANTITIES),
)  # fmt: skip
"""Parameters of the models of the package, of which a study may give a prior."""


OF_STRUCTURE = (*OF_MODELS[:9], STIFFNESS)
"""Those of the forward models of the package, of which a study may hold some."""


@dataclass(frozen=True)
class GivenPrior:
    """A parameter with the prior that a study gives it.

    Parameters
    ----------
    parameter : Parameter
    origin : str
        Where the prior came from.
    """

    parameter: Parameter
    origin: str


def with_priors(
    study: Study, given: Mapping[str, Any] | None, fixed: Mapping[str, float] | None = None
) -> Study:
    """The study with some priors of its table changed, and some parameters held.

    Parameters
    ----------
    study : Study
    given : mapping
        As the table [priors] of study.toml, or with `Prior` objects: ``{"f3": LogUniform(2e4, 4e5)}``.
        A parameter that the study holds is free again.
    fixed : mapping
        Parameters that are held, ``{"psi1": 1.0}``, in the place of the study's priors of them.

    Raises
    ------
    PriorsError
        If one cannot be used.
    """
    if fixed is not None and not isinstance(fixed, Mapping):
        raise PriorsError(f"fixed = {fixed!r}: give a mapping, such as {{'psi1': 1.0}}")
    if not (given or fixed):
        return study
    given, fixed = given or {}, fixed or {}
    if not isinstance(given, Mapping):
        raise PriorsError(
            f"priors = {given!r}: give a mapping, such as {{'f3': {{'log_uniform': [2e4, 4e5]}}}}"
        )
    table = {name: table_of(value) if isinstance(value, Prior) else value for name, value in given.items()}
    check_held(fixed, table)
    replaced = {other for name in fixed for other in names_of(name)}
    merged = {name: law for name, law in study.priors.items() if name not in replaced} | table
    freed = {other for name in table for other in names_of(name)} | replaced
    held = {name: value for name, value in study.parameters.items() if name not in freed} | dict(fixed)
    if table.get("set") == PAPER_SET and "wave_speed_m_s" not in table:
        merged.pop("wave_speed_m_s", None)
    made = replace(study, priors=merged, parameters=held)
    prior_table(made)
    return made


def prior_table(study: Study) -> PriorTable:
    """The table of a study, read.

    Raises
    ------
    PriorsError
        With the study's file.
    """
    try:
        return read_priors(study.priors)
    except PriorsError as error:
        raise PriorsError(f"{study.source or study.name}: priors: {error}") from None


def stiffness_of_wave_speed(speed_m_s: float, wall: str, density: float, wall_factor: float = 1.0) -> float:
    """Stiffness chi (g cm-1 s-2) of a wall in which pulse waves travel at this speed at rest.

    rho c^2 = dp/d(A/A0) = (2/3) chi of the linear wall and of Olufsen's, k chi pi/gamma of the tangent one,
    with gamma the median of its prior.

    Parameters
    ----------
    speed_m_s : float
    wall : {"linear", "tangent", "olufsen"}
    density : float
        g/cm3.
    wall_factor : float
        k of the conventions.

    Examples
    --------
    >>> round(stiffness_of_wave_speed(1.78, "linear", 1.055))
    50140
    """
    slope = density * (100.0 * speed_m_s) ** 2
    return 1.5 * slope if wall in CHI_WALLS else slope * GAMMA.centre / (math.pi * wall_factor)


def study_parameters(
    parameters: Sequence[Parameter],
    study: Study,
    wall: str,
    conventions: Conventions,
    prior_set: str,
) -> tuple[GivenPrior, ...]:
    """The parameters of a baseline with the priors of a study, and where these came from.

    Parameters
    ----------
    parameters : sequence of Parameter
        As a model's file has them.
    study : Study
    wall : str
    conventions : Conventions
        In force.
    prior_set : str
        Which set the parameters' own priors are; empty if they hold for any study.

    Returns
    -------
    tuple of GivenPrior
        In their order. A prior that was changed has no start but its median.

    Raises
    ------
    PriorsError
        If the study's table cannot be used.
    """
    table = prior_table(study)
    derived: dict[str, tuple[Prior, str]] = {}
    if prior_set and prior_set != table.set:
        derived = _derived(study, wall, conventions, table)
    own = {_called(name, parameters): prior for name, prior in table.own.items()}
    found = []
    for p in parameters:
        changed: dict[str, Any] = {}
        origin = f"set {prior_set}" if prior_set else "the model's file"
        if p.name in derived:
            changed["prior"], origin = derived[p.name]
        if p.name in own:
            changed["prior"], origin = own[p.name], "given"
            _must_be_positive(study, p, own[p.name])
        if changed:
            changed |= {"start": None, "log": p.log or changed["prior"].support[0] >= 0.0}
        if p.name == "v_chi" and p.name in derived:
            changed |= {"label": "variance of log chi between vessels"}
        found.append(GivenPrior(replace(p, **changed), origin))
    return tuple(found)


def _must_be_positive(study: Study, parameter: Parameter, prior: Prior) -> None:
    """Refuse a given prior whose middle is not positive where a solve needs that."""
    low = prior.support[0]
    if parameter.name in POSITIVE and low < 0 and not prior.depends_on and sum(prior.support) <= 0:
        raise PriorsError(
            f"{study.source or study.name}: priors: {parameter.name} = {table_of(prior)}: it is a "
            f"stiffness or a factor and must be positive, and begins at {low:g}; give it bounds above 0"
        )


def _called(name: str, parameters: Sequence[Parameter]) -> str:
    """A parameter's own name for "stiffness"."""
    if name != STIFFNESS:
        return name
    names = [p.name for p in parameters]
    return "m_chi" if "m_chi" in names else "f3"


def check_names(study: Study, parameters: Sequence[Parameter], of_errors: Sequence[str] = ()) -> None:
    """Refuse priors of parameters that no model has.

    Parameters
    ----------
    study : Study
    parameters : sequence of Parameter
        Of the baseline.
    of_errors : sequence of str
        Names of the errors' parameters, where they are known.

    Raises
    ------
    PriorsError
        With the nearest name that the model has.
    """
    there = [*(p.name for p in parameters), *of_errors]
    for name in prior_table(study).own:
        if name not in {*there, *OF_MODELS}:
            own = [one for one in dict.fromkeys([*there, STIFFNESS]) if one != "chi"]
            words = nearest(name, [*own, "set", "wave_speed_m_s"])
            raise PriorsError(f"{study.source or study.name}: priors: {name}: {words}")


def held_parameters(study: Study, given: Sequence[GivenPrior]) -> dict[str, float]:
    """Those of a model that a study holds, by the model's own names.

    Parameters
    ----------
    study : Study
    given : sequence of GivenPrior
        All of the model, in whose priors the values must lie.

    Raises
    ------
    PriorsError
        If no model has one, its prior has no room for the value, or others depend on it.
    """
    by_name = {one.parameter.name: one.parameter for one in given}
    where, found = f"{study.source or study.name}: parameters", {}
    for called, value in study.parameters.items():
        name = _called(called, [*by_name.values()])
        p = by_name.get(name)
        if p is None:
            if called not in OF_STRUCTURE:
                raise PriorsError(f"{where}: {called}: {nearest(called, [*by_name, STIFFNESS])}")
            continue
        if p.hyper or p.dims:
            raise PriorsError(
                f"{where}: {called} = {value:g}: is of a population, which cannot be held; hold the "
                "stiffness of a model with the same one in all vessels, such as B"
            )
        low, high = p.prior.support
        if not low <= value <= high or (p.log and value <= 0):
            raise PriorsError(
                f"{where}: {called} = {value:g}: lies outside its prior {p.prior.text}; correct one of them"
            )
        found[name] = float(value)
    return found


def without_use(study: Study, names: Sequence[str]) -> list[str]:
    """Parameters of which a study gives a prior, and which are not among a model's, by their names."""
    overall = {STIFFNESS} if {"f3", "m_chi"} & set(names) else set()
    return [name for name in prior_table(study).own if name not in {*names, *overall}]


def _derived(
    study: Study, wall: str, conventions: Conventions, table: PriorTable
) -> dict[str, tuple[Prior, str]]:
    """Priors that follow from a study, by the names that the paper's models give their parameters."""
    network = Network.from_study(study)
    low, high = table.wave_speed_m_s
    chi_low, chi_high = (
        stiffness_of_wave_speed(speed, wall, network.density, conventions.wall_factor)
        for speed in (low, high)
    )
    median, spread = math.sqrt(chi_low * chi_high), math.log(chi_high / chi_low) / (2.0 * NORMAL_95)
    speeds = f"wave speeds of {low:g} to {high:g} m/s"
    widest, narrowest = float(np.max(network.radius_in_cm)), float(np.min(network.radius_in_cm))
    rate = conventions.stiffness_radius_unit_cm / math.sqrt(widest * narrowest)
    radii = f"radii of {narrowest:g} to {widest:g} cm"
    f1 = LogNormal(RADIUS_SHARE * median, math.hypot(spread, RADIUS_SPREAD))
    f2 = Normal(
        RADIUS_RATE.mean * rate, RADIUS_RATE.sd * rate, RADIUS_RATE.low * rate, RADIUS_RATE.high * rate
    )
    found: dict[str, tuple[Prior, str]] = {
        name: (LogNormal(median, spread), speeds) for name in ("f3", "m_chi")
    }
    found |= {"f1": (f1, speeds), "f2": (f2, radii)}
    found |= {"v_chi": (BETWEEN_VESSELS, "vessels alike within a factor of about 2")}
    found |= {"chi": (LogPopulation("m_chi", "v_chi"), "m_chi and v_chi")}
    found |= {"gamma": (GAMMA, "a wall of up to 2.5 times its area")}
    feeding = {v.parent for v in study.vessels}
    loads = {"given" if v.has_load else "nominal" for v in study.vessels if v.id not in feeding}
    words = f"{' and '.join(sorted(loads))} loads"
    return found | {name: (prior, words) for name, prior in LOADS.items()}
