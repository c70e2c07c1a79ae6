"""A solve about to be made, which effects change, and what solving and sampling it gives."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.blood.conventions import Conventions
from zoo.blood.directions import Derivatives, Point
from zoo.blood.network import Network
from zoo.blood.solver import (
    CHI_WALLS,
    PARAMETERS,
    PUBLISHED_CELLS_PER_CM,
    Physics,
    Solution,
    Solver,
    SolverOptions,
)
from zoo.blood.study import QUANTITIES
from zoo.core.arrays import Array, Brief
from zoo.core.effects import Location
from zoo.core.forward import SolveError
from zoo.core.words import nearest

Place = tuple[int, float, str]
"""A series: vessel id, position (0 inlet, 1 outlet), quantity."""

UNITS = {"pressure_mmHg": "mmHg", "flow_ml_s": "ml/s", "area_cm2": "cm2"}
WAVE_SAMPLES = 1024
"""Samples of a beat on which functions of the waves act."""


class OutputError(ValueError):
    """A series that no solve has: its position or quantity does not exist."""


@dataclass(frozen=True)
class Wave:
    """Waveforms over one beat, which sensors act on.

    Parameters
    ----------
    value : array (n_series, n)
        At times m period/n, each series in its own unit.
    quantity : tuple of str
        "pressure_mmHg", "flow_ml_s" or "area_cm2", for each series.
    period_s : float
        s.
    """

    value: Array
    quantity: tuple[str, ...]
    period_s: float

    @property
    def is_pressure(self) -> NDArray[np.bool_]:
        """Which series are pressures, (n_series,)."""
        return np.array([q == "pressure_mmHg" for q in self.quantity], dtype=bool)


@dataclass(frozen=True, eq=False, repr=False)
class Case(Brief):
    """A solve about to be made: what an effect may change.

    Parameters
    ----------
    network : Network
    inflow_time_s, inflow_ml_s : array (n,)
        Flow into the root over one beat; empty where the pressure is given.
    conventions : Conventions
    wall : {"linear", "tangent", "olufsen"}
    options : SolverOptions
    physics : Physics
        Terms inside the solver.
    stiffness, gamma, psi1, psi2, c : array (n_vessels,)
        chi (g cm-1 s-2), the tangent wall's gamma, and the factors of the nominal R1, R2, C.
    waves : tuple of functions
        From `Wave` to `Wave`, applied to the solution in this order.
    coarse_blend : float
        a in y + a (y(2 dx) - y), where y(2 dx) is a second solve with cells twice as long.
    inlet_pressure_mmHg : array (n,)
        Pressure at the root's inlet over one beat, instead of the flow; empty where that is given.
    """

    network: Network
    inflow_time_s: Array
    inflow_ml_s: Array
    conventions: Conventions
    wall: str
    options: SolverOptions
    physics: Physics
    stiffness: Array
    gamma: Array
    psi1: Array
    psi2: Array
    c: Array
    waves: tuple[Callable[[Wave], Wave], ...] = ()
    coarse_blend: float = 0.0
    inlet_pressure_mmHg: Array = field(default_factory=lambda: np.empty(0))

    @property
    def inlet(self) -> Array:
        """What is given at the root's inlet over the beat, (n,): its flow, ml/s, or its pressure, mmHg."""
        return self.inlet_pressure_mmHg if self.inlet_pressure_mmHg.size else self.inflow_ml_s

    @property
    def parameters(self) -> dict[str, Any]:
        """Those that `Solver.solve` takes."""
        return {name: getattr(self, name) for name in PARAMETERS}


# ---------------------------------------------------------------------------------------------------
# Solving


def solver_of(case: Case, places: Sequence[tuple[int, float]], times_s: Array) -> Solver:
    """The solver of a case, sampled at places (vessel id, position) and times."""
    return Solver(
        case.network,
        case.inflow_time_s,
        case.inflow_ml_s,
        wall=case.wall,
        conventions=case.conventions,
        series=places,
        times_s=times_s,
        options=case.options,
        physics=case.physics,
        inlet_pressure_mmHg=case.inlet_pressure_mmHg,
    )


def check_series(case: Case, series: Sequence[Place]) -> None:
    """Raise where a vessel is not in the network, or a position or a quantity does not exist.

    Raises
    ------
    zoo.blood.study.StudyError
        For the vessel.
    OutputError
        For the other two.
    """
    for vessel, position, quantity in series:
        case.network.index(vessel)
        if quantity not in QUANTITIES:
            raise OutputError(f"quantity = {quantity!r}: {nearest(quantity, QUANTITIES)}")
        if not 0 <= position <= 1:
            raise OutputError(f"position = {position!r} of vessel {vessel}: must be in [0, 1]")


def simulate(
    case: Case,
    series: Sequence[Place],
    times_s: ArrayLike,
    *,
    solver: Callable[[Case, Sequence[tuple[int, float]], Array], Solver] | None = None,
) -> Array:
    """Solve a case and sample it.

    Without functions of the waves this is ``Solver(...).solve(...)``, bit for bit. They act on
    `WAVE_SAMPLES` uniform samples of the beat, and what they add there is added to the solution
    after periodic cubic interpolation.

    Parameters
    ----------
    case : Case
    series : sequence of (vessel id, position, quantity)
        Position 0 is the vessel's inlet, 1 its outlet.
    times_s : array (n_times,)
        s, from the start of the beat.
    solver : function
        Finds a solver for series that are known to exist, instead of `solver_of`.

    Returns
    -------
    array (n_series, n_times)
        Each series in its own unit.

    Raises
    ------
    SolveError
        If the solve fails; its kind is the solver's status, such as "collapse", or "not-finite".
    zoo.blood.study.StudyError, OutputError
        If a vessel, a position or a quantity does not exist.
    """
    if solver is None:
        check_series(case, series)
    return simulate_derivatives(case, (), series, times_s, solver or solver_of)[0]


@dataclass(frozen=True)
class Stencil:
    """A direction: cases at steps from the one that is differentiated, with weights whose sum is zero."""

    steps: tuple[float, ...]
    weights: tuple[float, ...]
    cases: tuple[Case, ...]


def _equal(a: Any, b: Any) -> bool:
    """Whether two networks, physics, conventions or options hold the same."""
    if a is b:
        return True
    return type(a) is type(b) and all(
        np.array_equal(x, y) if isinstance(x, np.ndarray) or isinstance(y, np.ndarray) else x is y or x == y
        for x, y in ((getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    )


def same_run(a: Case, b: Case) -> bool:
    """Whether two cases differ at most in stiffness, shapes and factors of loads, and in what sensors see."""
    return (
        a.wall == b.wall
        and np.array_equal(a.inflow_ml_s, b.inflow_ml_s)
        and np.array_equal(a.inlet_pressure_mmHg, b.inlet_pressure_mmHg)
        and all(
            _equal(getattr(a, name), getattr(b, name))
            for name in ("network", "physics", "conventions", "options")
        )
    )


def simulate_derivatives(
    case: Case,
    stencils: Sequence[Stencil],
    series: Sequence[Place],
    times_s: ArrayLike,
    solver: Callable[[Case, Sequence[tuple[int, float]], Array], Solver],
) -> tuple[Array, Array]:
    """Solve a case, sample it, and differentiate the samples.

    Parameters
    ----------
    case : Case
    stencils : sequence of Stencil
    series : sequence of (vessel id, position, quantity)
    times_s : array (n_times,)
    solver : function
        Finds the solver of a case.

    Returns
    -------
    values : array (n_series, n_times)
        As `simulate` gives them.
    slopes : array (n_stencils, n_series, n_times)

    Raises
    ------
    SolveError
        If the solve, or its derivatives, fail.
    """
    times, period = np.asarray(times_s, dtype=np.float64), case.network.period_s
    waves = bool(case.waves)
    wanted = np.concatenate([times, np.arange(WAVE_SAMPLES) * (period / WAVE_SAMPLES)]) if waves else times
    values, slopes = _sampled(case, stencils, series, wanted, solver)
    blends = np.array(
        [sum(w * c.coarse_blend for w, c in zip(s.weights, s.cases, strict=True)) for s in stencils]
    )
    if case.coarse_blend or np.any(blends):
        coarse = [replace(s, cases=tuple(_coarser(c) for c in s.cases)) for s in stencils]
        less, sloped = _sampled(_coarser(case), coarse, series, wanted, solver)
        slopes = slopes + case.coarse_blend * (sloped - slopes) + blends[:, None, None] * (less - values)
        values = values + case.coarse_blend * (less - values)
    if not waves:
        return values, slopes
    n, quantities = len(times), tuple(quantity for _, _, quantity in series)

    def seen(acting: Case, all_values: Array) -> Array:
        plain = all_values[:, n:]
        wave = Wave(plain, quantities, period)
        for act in acting.waves:
            wave = act(wave)
        return np.asarray(all_values[:, :n] + _periodic(wave.value - plain, period, times))

    there = seen(case, values)
    made = [
        sum(
            w * (seen(c, values + step * slope) - there)
            for w, step, c in zip(s.weights, s.steps, s.cases, strict=True)
        )
        for s, slope in zip(stencils, slopes, strict=True)
    ]
    return there, np.array(made).reshape(len(stencils), len(series), n)


def _sampled(
    case: Case,
    stencils: Sequence[Stencil],
    series: Sequence[Place],
    times: Array,
    solver: Callable[..., Solver],
) -> tuple[Array, Array]:
    rows: dict[tuple[int, float], int] = {}
    at = [rows.setdefault((vessel, position), len(rows)) for vessel, position, _ in series]
    own = solver(case, tuple(rows), times)

    def point(weight: float, near: Case) -> Point:
        beside = None if same_run(case, near) else _beside(own, near, tuple(rows), times)
        return Point(weight, **near.parameters, solver=beside)

    def taken(found: Solution | Derivatives) -> Array:
        rows_of_series = [getattr(found, series[k][2])[..., i, :] for k, i in enumerate(at)]
        shape = (*found.pressure_mmHg.shape[:-2], len(series), len(times))
        return np.stack(rows_of_series, axis=-2) if rows_of_series else np.empty(shape)

    if stencils:
        directions = [[point(w, c) for w, c in zip(s.weights, s.cases, strict=True)] for s in stencils]
        found = own.jacobian(**case.parameters, directions=directions)
        values, slopes = taken(found.solution), taken(found)
    else:
        values = taken(own.solve(**case.parameters))
        slopes = np.empty((0, *values.shape))
    if not np.all(np.isfinite(values)):
        raise SolveError("the solution is not finite", "not-finite")
    return values, slopes


def _beside(own: Solver, near: Case, places: Sequence[tuple[int, float]], times: Array) -> Solver:
    """A solver of a case near that of another solver, with as many cells in each vessel."""
    made = solver_of(near, places, times)
    cells, other = own.grid()[0], made.grid()[0]
    if np.array_equal(cells, other):
        return made
    refine = near.options.refine
    options = replace(near.options, cells=tuple(int(n) // refine for n in cells))
    return solver_of(replace(near, options=options), places, times)


def _coarser(case: Case) -> Case:
    """The same with cells twice as long, and with them the time step."""
    case = with_true_lengths(case)
    fine = case.options
    coarse = replace(
        fine,
        dx_cm=2 * fine.dx_cm,
        cells=tuple(max(1, n // 2) for n in fine.cells),
        steps_per_beat=max(32, fine.steps_per_beat // 2) if fine.steps_per_beat else 0,
        least_steps=fine.least_steps // 2,
    )
    return replace(case, options=coarse)


def _periodic(values: Array, period: float, times: Array) -> Array:
    """Cubic spline through uniform samples of a period, (n_series, n) to (n_series, n_times)."""
    from scipy.interpolate import CubicSpline

    n = values.shape[1]
    closed = np.concatenate([values, values[:, :1]], axis=1)
    spline = CubicSpline(np.arange(n + 1) * (period / n), closed, axis=1, bc_type="periodic")
    return np.asarray(spline(np.mod(times, period)))


# ---------------------------------------------------------------------------------------------------
# Changed copies, and what effects ask of a case


def with_true_lengths(case: Case) -> Case:
    """The same case with the lengths that its grid has, where the conventions truncate them.

    Truncated lengths come in steps of 1/40 cm; an effect that changes a length must not.
    """
    if not case.conventions.truncate_lengths:
        return case
    cells = np.floor(PUBLISHED_CELLS_PER_CM * case.network.length_cm + 1e-9)
    return replace(
        case,
        network=replace(case.network, length_cm=cells / PUBLISHED_CELLS_PER_CM),
        conventions=case.conventions.replace(truncate_lengths=False),
        options=replace(case.options, dx_cm=1 / PUBLISHED_CELLS_PER_CM),
    )


def with_inlet(case: Case, values: Array) -> Case:
    """The case with another flow, or where that is given another pressure, at the root's inlet, (n,)."""
    if case.inlet_pressure_mmHg.size:
        return replace(case, inlet_pressure_mmHg=values)
    return replace(case, inflow_ml_s=values)


def with_network(case: Case, **arrays: Any) -> Case:
    """The case with some of its network's arrays changed."""
    return replace(case, network=replace(case.network, **arrays))


def with_physics(case: Case, **terms: Any) -> Case:
    """The case with some terms of its physics changed."""
    return replace(case, physics=replace(case.physics, **terms))


def with_more(case: Case, name: str, added: Array) -> Case:
    """The same with more of a term of `Physics` (n_vessels,), beside what is there of it."""
    old = getattr(case.physics, name)
    return with_physics(case, **{name: added if old is None else old + added})


def with_viscosity(case: Case, factor: Array) -> Case:
    """The same with the viscosity in each vessel times a factor (n_vessels,)."""
    old = case.physics.viscosity_factor
    return with_physics(case, viscosity_factor=factor if old is None else old * factor)


def with_offset(case: Case, at_inlet: ArrayLike, at_outlet: ArrayLike) -> Case:
    """The case with something added to the wall's pressure, dyn/cm2, linear along each vessel."""
    zero = np.zeros(len(case.network.ids))

    def total(old: Array | None, added: ArrayLike) -> Array:
        return np.asarray((zero if old is None else old) + np.asarray(added, dtype=np.float64))

    old = case.physics
    return with_physics(
        case,
        offset_in=total(old.offset_in, at_inlet),
        offset_out=total(old.offset_out, at_outlet),
    )


def with_wave(case: Case, act: Callable[[Wave], Wave]) -> Case:
    """The case with one more function of the waves, after those it has."""
    return replace(case, waves=(*case.waves, act))


def members(network: Network, location: Location) -> NDArray[np.bool_]:
    """Which vessels a location holds, (n_vessels,).

    Raises
    ------
    zoo.blood.study.StudyError
        If its vessel is not in the network.
    """
    if location.part is None:
        return np.ones(len(network.ids), dtype=bool)
    inside = np.zeros(len(network.ids), dtype=bool)
    part = location.part
    inside[network.index(int(part) if isinstance(part, str) else part)] = True
    if location.subtree:
        for i, parent in enumerate(network.parent):
            inside[i] |= parent >= 0 and inside[parent]
    return inside


def total_resistance(case: Case) -> Array:
    """psi1 R1 + psi2 R2 of every vessel, dyn s/cm5, NaN where there is no terminal; (n_vessels,)."""
    return np.asarray(case.psi1 * case.network.R1 + case.psi2 * case.network.R2)


def wall_slope(case: Case) -> Array:
    """dp/d(A/A0) at rest, dyn/cm2, (n_vessels,): (2/3) chi, or k chi pi/gamma of the tangent wall."""
    if case.wall in CHI_WALLS:
        return np.asarray(2 / 3 * case.stiffness)
    return np.asarray(case.conventions.wall_factor * case.stiffness * math.pi / case.gamma)


def filtered(values: Array, period_s: float, response: Callable[[Array], NDArray[Any]]) -> Array:
    """Periodic samples after a linear filter.

    Parameters
    ----------
    values : array (..., n)
        Over one period.
    period_s : float
    response : function
        Complex response at the angular frequencies (rad/s) of the harmonics from 0 up.

    Returns
    -------
    array (..., n)
    """
    n = values.shape[-1]
    harmonics = 2 * math.pi / period_s * np.arange(n // 2 + 1)
    return np.fft.irfft(np.fft.rfft(values) * response(harmonics), n)
