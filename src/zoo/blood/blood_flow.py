"""Blood flow in a study's tree as a forward model: parameters in, the observed series out."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from zoo.blood.case import UNITS, Case, Place, check_series, simulate, simulate_derivatives, solver_of
from zoo.blood.case_changes import off_zero, stencil_of
from zoo.blood.conventions import Conventions
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.outlet_tables import TREE_FACTORS
from zoo.blood.physics import NO_PHYSICS, study_physics
from zoo.blood.resolution import Resolution, coarse_at, resolve
from zoo.blood.solver import SHAPES, WALLS, Solver, SolverArgumentError, SolverOptions
from zoo.blood.study import Study, StudyError
from zoo.core.arrays import Array
from zoo.core.data import Data
from zoo.core.forward import InNumba, Outputs, SolveError, content_key, function_text
from zoo.core.parameters import Parameter, pack, start_of, unpack

Values = Mapping[str, Array]
StiffnessLaw = Callable[[Values, Network, Conventions], Array]
"""From parameters by name to chi (g cm-1 s-2) of every vessel, (n_vessels,)."""

FAMILIES = (
    "geometry",
    "wall",
    "fluid",
    "junctions",
    "outflow",
    "surroundings",
    "inflow",
    "sensor",
    "noise",
    "numerics",
)
"""In this order effects are applied: first what others read, such as lengths and radii."""
KEPT_SOLVERS = 4
STEP_UNIT = 32
"""Steps of a beat are a multiple of this."""
PINNED_MARGIN = 0.25
"""Steps to spare where their number is kept while the parameters move, as a part of them."""


# ---------------------------------------------------------------------------------------------------
# Stiffness laws


def constant_stiffness(values: Values, network: Network, conventions: Conventions) -> Array:
    """The same in every vessel: chi = f3."""
    return np.full(len(network.ids), float(values["f3"]))


def radius_dependent_stiffness(values: Values, network: Network, conventions: Conventions) -> Array:
    """By the inlet's radius at rest, `stiffness_profile`: chi = f1 exp(f2 r0/u) + f3 (eq. 3.5)."""
    f1, f2, f3 = (float(values[name]) for name in ("f1", "f2", "f3"))
    return stiffness_profile(network.radius_in_cm, f1, f2, f3, conventions.stiffness_radius_unit_cm)


def stiffness_of_each_vessel(values: Values, network: Network, conventions: Conventions) -> Array:
    """Each vessel has its own: chi, (n_vessels,)."""
    return np.array(values["chi"], dtype=np.float64)


def scaled_stiffness(values: Values, network: Network, conventions: Conventions) -> Array:
    """What the study gives, times a factor: chi = f chi_given, also along each vessel.

    Raises
    ------
    zoo.blood.study.StudyError
        If the study gives no stiffness.
    """
    if network.stiffness_in is None:
        raise StudyError(
            "network: stiffness_g_cm_s2: is missing, and there is nothing to scale; give every vessel one "
            "(or youngs_modulus_g_cm_s2 and wall_thickness_cm), or take another stiffness law"
        )
    return float(values["stiffness_factor"]) * network.stiffness_in


LAW_PARAMETERS = {
    constant_stiffness: ("f3",),
    radius_dependent_stiffness: ("f1", "f2", "f3"),
    stiffness_of_each_vessel: ("chi",),
    scaled_stiffness: ("stiffness_factor",),
}
"""Of the laws that `zoo.blood.solver_in_numba` knows."""


# ---------------------------------------------------------------------------------------------------
# The forward model


class BloodFlow:
    """Pressure, flow and area in a study's tree at the periodic state, as a `zoo.core.forward.ForwardModel`.

    It has the study's physics (`zoo.blood.physics.study_physics`). Stiffness is that of the law, the same
    all along a vessel; what the study gives is read by `scaled_stiffness` alone, and then also along the
    vessels.

    Its configuration is a `zoo.blood.case.Case`; without effects its series are those of
    ``Solver.for_study(study, wall).solve(...)``, bit for bit. Series are (vessel id, position, quantity),
    and times are those of the study's samples: the convention `sample_lag_beats` is added when it solves.

    Parameters
    ----------
    study : Study
        Vessels, blood, inflow; its observed series and times are the default outputs.
    wall : {"linear", "tangent", "olufsen"}
        Eq. (3.3), (3.4), or p = (4/3) chi (1 - sqrt(A0/A)).
    stiffness : function
        A `StiffnessLaw`.
    parameters : sequence of Parameter
        Those of the stiffness law, and of "gamma" (2 if absent), "psi1", "psi2" and "c" (1 if absent): one
        value, or one for each vessel. A wall with several shape parameters has their names instead of gamma.
        Where outlets are structured trees, those of `zoo.blood.outlet_tables.TREE_FACTORS` are factors of all
        trees' fields (1 if absent).
    name : str
    conventions : Conventions
        Instead of the study's own.
    options : SolverOptions
        Numerical settings.
    outputs : Outputs
        Instead of the study's.
    fixed : mapping of name to number
        Parameters of known value.

    Raises
    ------
    SolverArgumentError
        If the wall is unknown or the numerical settings do not fit the network.
    zoo.blood.study.StudyError, zoo.blood.case.OutputError
        If a series' vessel, position or quantity does not exist.
    """

    families = FAMILIES
    threads = True

    def __init__(
        self,
        study: Study,
        wall: str,
        stiffness: StiffnessLaw,
        parameters: Sequence[Parameter],
        *,
        name: str = "blood-flow",
        conventions: Conventions | None = None,
        options: SolverOptions | None = None,
        outputs: Outputs | None = None,
        fixed: Mapping[str, float] | None = None,
    ) -> None:
        if wall not in WALLS:
            raise SolverArgumentError(f"wall = {wall!r}: must be one of {', '.join(WALLS)}")
        self.study, self.wall, self.stiffness, self.name = study, wall, stiffness, name
        self.parameters = tuple(parameters)
        self.fixed = {name: np.asarray(value, dtype=np.float64) for name, value in (fixed or {}).items()}
        self.conventions = conventions or study.conventions
        self.options = options or SolverOptions()
        self.resolution: Resolution | None = None
        self.network = Network.from_study(study)
        self.physics = study_physics(
            study, self.network, mmhg=self.conventions.mmhg, along=stiffness is scaled_stiffness
        )
        self.outputs = outputs or Outputs(
            tuple((s.vessel, s.position, s.quantity) for s in study.series), study.time_s
        )
        self._times = self.outputs.times + self.conventions.sample_lag_beats * self.network.period_s
        self._kept: tuple[tuple[Case, Any, Array, Solver], ...] = ()
        self.key = self._digest()
        if len(self.network.ids) and self.series:
            blank = self._case(self.fixed, np.ones(len(self.network.ids)))
            check_series(blank, self.series)
            self._solver(blank, self._places(), self._times)

    @property
    def series(self) -> tuple[Place, ...]:
        """Vessel, position and quantity of each output."""
        return cast("tuple[Place, ...]", self.outputs.series)

    def _places(self) -> tuple[tuple[int, float], ...]:
        return tuple(dict.fromkeys((vessel, position) for vessel, position, _ in self.series))

    def _digest(self) -> str:
        """Of everything that a solution depends on besides theta."""
        net, law = self.network, function_text(self.stiffness)
        words = [self.wall, self.conventions, self.options, net.density, net.viscosity, net.period_s]
        words += [(p.name, p.size) for p in self.parameters]
        words += [self.physics.settings()] if self.physics is not NO_PHYSICS else []
        words += [(name, value.tolist()) for name, value in sorted(self.fixed.items())]
        tree = (net.ids, net.parent, net.length_cm, net.radius_in_cm, net.radius_out_cm)
        loads_and_inflow = (net.R1, net.R2, net.C, self.study.inflow_time_s, self.study.inflow_ml_s)
        pressure = self.study.inlet_pressure_mmHg
        given = (net.stiffness_in, net.response_cosine, net.response_sine)
        walls = tuple(array for array in (*given, pressure if pressure.size else None) if array is not None)
        return content_key(law, repr(words), *tree, *loads_and_inflow, *walls, self.outputs)

    def resolved(self, *, share: float = 1.0) -> BloodFlow:
        """The same model at the numerical settings of its study, `zoo.blood.resolution.resolve`.

        They are chosen at the medians of the parameters' priors, which models of the same mean share, or at
        the parameters' starts if those cannot be solved. What was chosen stands in `resolution`.

        Parameters
        ----------
        share : float
            Factor of the accepted distance from the periodic state.

        Returns
        -------
        BloodFlow

        Raises
        ------
        StudyError
            If the study's table [numerics] is wrong, or neither can be solved.
        """
        medians = start_of([replace(p, start=None) for p in self.parameters])
        failed: SolveError | None = None
        for values in (medians, start_of(self.parameters)):
            case = self.configure(pack(self.parameters, values))
            try:
                found = resolve(self.study, case, self.series, self._times, share=share)
            except SolveError as error:
                failed = error
                continue
            return self._with(found.options, found)
        raise StudyError(
            f"study {self.study.name!r}: cells and steps cannot be chosen at the parameters where "
            f"{self.name} starts: {failed}; or give dx_cm in [numerics]"
        )

    def warning_at(self, configuration: Case) -> str:
        """A sentence if the chosen cells and steps are too coarse for this solve; else empty."""
        if self.resolution is None:
            return ""
        return coarse_at(self.study, configuration, self.series, self._times)

    def refined(self) -> BloodFlow | None:
        """The same with cells and steps of half the size.

        Returns
        -------
        BloodFlow or None
            None where the grid was given and not chosen from an accuracy: then it is part of the model, and
            no error of it was estimated. Also where twice as many steps are more than the settings allow.
        """
        if self.resolution is None or math.isnan(self.resolution.error_percent):
            return None
        try:
            options = replace(self.options, refine=2 * self.options.refine)
        except SolverArgumentError:
            return None
        return self._with(options, self.resolution)

    def pinned(self, configuration: Case) -> BloodFlow:
        """The same with as many steps a beat, whatever the parameters, as this solve takes and some more.

        Its solutions are then smooth functions of the parameters; one whose waves outrun the steps is a
        `SolveError` of the kind "cfl".

        Parameters
        ----------
        configuration : Case
            At which steps are counted; `PINNED_MARGIN` of them are to spare.

        Raises
        ------
        SolveError
            If it cannot be solved.
        """
        solved = self._solver(configuration, self._places(), self._times).solve(**configuration.parameters)
        refine = configuration.options.refine
        taken = math.ceil((1.0 + PINNED_MARGIN) * solved.steps_per_beat / (STEP_UNIT * refine)) * STEP_UNIT
        steps = min(taken, self.options.max_steps // refine)
        return self._with(replace(self.options, steps_per_beat=steps), self.resolution)

    def _with(self, options: SolverOptions, resolution: Resolution | None) -> BloodFlow:
        """The same at other numerical settings."""
        model = copy.copy(self)
        model.options, model.resolution, model._kept = options, resolution, ()
        model.key = model._digest()
        return model

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_kept": ()}

    def _case(self, values: Values, stiffness: Array) -> Case:
        n, shapes = len(self.network.ids), SHAPES[self.wall]

        def of_each(name: str, otherwise: float = 1.0) -> Array:
            return np.full(n, np.asarray(values.get(name, otherwise), dtype=np.float64))

        factors = {name: float(values[name]) for name in TREE_FACTORS if name in values}
        return Case(
            network=self.network.with_tree_factors(factors) if factors else self.network,
            inflow_time_s=self.study.inflow_time_s,
            inflow_ml_s=self.study.inflow_ml_s,
            inlet_pressure_mmHg=self.study.inlet_pressure_mmHg,
            conventions=self.conventions,
            wall=self.wall,
            options=self.options,
            physics=self.physics,
            stiffness=stiffness,
            gamma=of_each("gamma", 2.0) if len(shapes) < 2 else np.stack([of_each(name) for name in shapes]),
            psi1=of_each("psi1"),
            psi2=of_each("psi2"),
            c=of_each("c"),
        )

    def configure(self, theta: ArrayLike) -> Case:
        """The solve about to be made, from parameters (n_values,).

        Raises
        ------
        zoo.core.parameters.ParameterError
            If theta has another length.
        """
        values = self.fixed | unpack(self.parameters, theta)
        return self._case(values, self.stiffness(values, self.network, self.conventions))

    def solve(self, configuration: Case, outputs: Outputs | None = None) -> Array:
        """Series (n_series, n_times), each in the unit of its quantity.

        Parameters
        ----------
        configuration : Case
        outputs : Outputs
            Series (vessel id, position, quantity), and times of samples in s; the observed ones if absent.

        Raises
        ------
        SolveError
            If the solve fails; its kind is the solver's status, such as "collapse", or "not-finite".
        zoo.blood.study.StudyError, zoo.blood.case.OutputError
            If a vessel, a position or a quantity does not exist.
        """
        wanted = outputs or self.outputs
        series = cast("tuple[Place, ...]", wanted.series)
        if wanted is not self.outputs:
            check_series(configuration, series)
        return simulate(configuration, series, self._clock(wanted), solver=self._solver)

    def solve_derivatives(
        self,
        configure: Callable[[Array], Case],
        theta: Array,
        scales: Array,
        outputs: Outputs | None = None,
    ) -> tuple[Array, Array]:
        """Series of ``configure(theta)`` and their derivatives, as `zoo.core.derivatives` asks for them.

        The solver differentiates the discrete solution at the time steps that the solve chooses; how the
        solve's arguments follow from theta is differenced.

        Parameters
        ----------
        configure : function
            From theta to a `Case`; of this model, or with effects.
        theta : array (n_values,)
        scales : array (n_values,)
            Over what a change of each element is small; zero for those that no solve reads.
        outputs : Outputs
            As in `solve`.

        Returns
        -------
        values : array (n_series, n_times)
        slopes : array (n_values, n_series, n_times)

        Raises
        ------
        SolveError
            If the solve or its derivatives fail.
        """
        wanted = outputs or self.outputs
        series = cast("tuple[Place, ...]", wanted.series)
        case = configure(theta)
        if wanted is not self.outputs:
            check_series(case, series)
        read = np.flatnonzero(scales)
        at = off_zero(configure, case, theta, scales)
        near = case if at is theta else configure(at)
        stencils = [stencil_of(configure, near, at, int(i), float(scales[i])) for i in read]
        values, found = simulate_derivatives(near, stencils, series, self._clock(wanted), self._solver)
        if near is not case:
            values = self.solve(case, outputs)
        slopes = np.zeros((len(theta), *values.shape))
        slopes[read] = found
        return values, slopes

    def in_numba(self) -> InNumba | None:
        """As functions that numba compiles; None for a stiffness law other than those of this module."""
        from zoo.blood.solver_in_numba import Law, blood_flow

        net, law = self.network, next((p for f, p in LAW_PARAMETERS.items() if f is self.stiffness), None)
        ones = np.ones(len(net.ids))
        scale = net.stiffness_in if self.stiffness is scaled_stiffness else ones
        if law is None or scale is None:
            return None
        solver = self._solver(self._case(self.fixed, ones), self._places(), self._times)
        radius = net.radius_in_cm / self.conventions.stiffness_radius_unit_cm
        known = Law.of(self.parameters, self.fixed, self.wall, law, scale, radius)
        return None if known is None else blood_flow(solver, self.outputs, self.parameters, known)

    def _clock(self, outputs: Outputs) -> Array:
        """When the solution is sampled: the samples' times, with the conventions' lag."""
        if outputs is not self.outputs:
            return np.asarray(outputs.times + self.conventions.sample_lag_beats * self.network.period_s)
        return self._times

    def _solver(self, case: Case, places: Sequence[tuple[int, float]], times: Array) -> Solver:
        """A solver that was made before, if only the parameters differ."""
        for old, at, when, solver in self._kept:
            same = (
                old.network is case.network
                and old.inlet is case.inlet
                and old.inflow_time_s is case.inflow_time_s
                and old.physics is case.physics
                and old.wall == case.wall
                and (old.conventions is case.conventions or old.conventions == case.conventions)
                and (old.options is case.options or old.options == case.options)
                and at == places
                and (when is times or np.array_equal(when, times))
            )
            if same:
                return solver
        made = solver_of(case, places, times)
        self._kept = ((case, places, times, made), *self._kept[: KEPT_SOLVERS - 1])
        return made


def study_data(study: Study) -> Data:
    """A study's observed series as data: a group for each quantity.

    Parameters
    ----------
    study : Study

    Returns
    -------
    Data
        Its outputs are (vessel id, position, quantity).

    Raises
    ------
    StudyError
        If the study has no observations.
    """
    if not study.series:
        raise StudyError(
            f"{study.source}: study {study.name!r} has no observations: add observations.csv, "
            "a model needs something to be compared with"
        )
    return Data(
        study.time_s,
        study.values,
        labels=[s.label for s in study.series],
        units=[UNITS[s.quantity] for s in study.series],
        groups=[s.quantity for s in study.series],
        period=study.period_s,
        outputs=[(s.vessel, s.position, s.quantity) for s in study.series],
        name=study.name,
        source=str(study.source),
    )
