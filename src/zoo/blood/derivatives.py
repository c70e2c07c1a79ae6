"""Derivatives of a case's series along changes of the case, and the changes that a parameter makes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import (
    WAVE_SAMPLES,
    Case,
    Place,
    Wave,
    _coarser,
    _periodic,
    solver_of,
)
from zoo.blood.directions import Point
from zoo.blood.solve_errors import NoDerivativeError
from zoo.blood.solver import Solver
from zoo.core.forward import SolveError

Array = NDArray[np.float64]
NEAR, FAR = 1e-5, 1e-3
"""Steps of differences, over the scale of a parameter: where it changes stiffness, shapes and loads alone;
and, with stencils of fourth order, where it changes more."""
OFF = 3e-5
"""How far a parameter is moved off zero, over its scale, where what it adds is absent at zero."""
PARAMETERS = ("stiffness", "gamma", "psi1", "psi2", "c")


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
        and all(
            _equal(getattr(a, name), getattr(b, name))
            for name in ("network", "physics", "conventions", "options")
        )
    )


def additions(case: Case) -> tuple[object, ...]:
    """What a case has and another may lack: waves, settings, functions, and terms in each of the vessels."""

    def there(term: Any) -> object:
        if isinstance(term, np.ndarray):
            return term.shape, term.astype(bool).tobytes()
        return getattr(term, "changes", None)

    terms = (there(getattr(case.physics, f.name)) for f in fields(case.physics))
    return bool(case.waves), case.options, case.conventions, *terms


def off_zero(configure: Callable[[Array], Case], case: Case, theta: Array, scales: Array) -> Array:
    """Theta with its zeros moved a little where what they add is absent at zero.

    A solve without a term is another run than one with little of it, that may have other state variables: the
    difference of one time step of both is no derivative.

    Parameters
    ----------
    configure : function
        From theta to a case.
    case : Case
        ``configure(theta)``.
    theta, scales : array (n_values,)
        Over what a change of each element is small; zero for those that no solve reads.

    Returns
    -------
    array (n_values,)
        `theta` itself where nothing is absent.
    """
    at, there = theta, additions(case)
    for i in np.flatnonzero((theta == 0) & (scales > 0)):
        for step in (OFF * scales[i], -OFF * scales[i]):
            moved = at.copy()
            moved[i] = step
            try:
                near = additions(configure(moved))
            except (SolveError, ValueError):
                continue
            if near != there:
                at, there = moved, near
            break
    return at


def stencil_of(configure: Callable[[Array], Case], case: Case, theta: Array, i: int, scale: float) -> Stencil:
    """The change of a case along element i of theta.

    Parameters
    ----------
    configure : function
        From theta to a case.
    case : Case
        ``configure(theta)``.
    theta : array (n_values,)
    i : int
    scale : float
        Over which its change is small.

    Returns
    -------
    Stencil
        Central differences, or one-sided ones of second order where the parameter ends.

    Raises
    ------
    NoDerivativeError
        If the numerical settings or the wall law change with it, or it can be changed to neither side.
    """

    def at(step: float) -> Case:
        moved = theta.copy()
        moved[i] += step
        found = configure(moved)
        if found.wall != case.wall or found.options != case.options or found.conventions != case.conventions:
            raise NoDerivativeError(
                f"parameter {i}: the grid, the conventions or the wall change with it: it has no derivative; "
                "sample without gradients"
            )
        return found

    def tried(steps: tuple[float, ...]) -> tuple[Case, ...] | None:
        try:
            return tuple(at(step) for step in steps)
        except NoDerivativeError:
            raise
        except (SolveError, ValueError):
            return None

    h = NEAR * scale
    two = tried((h, -h))
    if two and all(same_run(case, one) for one in two):
        return Stencil((h, -h), (0.5 / h, -0.5 / h), two)
    h = FAR * scale
    steps: tuple[float, ...] = (h, -h, 2 * h, -2 * h)
    if four := tried(steps):
        return Stencil(steps, tuple(w / (12 * h) for w in (8.0, -8.0, -1.0, 1.0)), four)
    for side in (0.1 * h, -0.1 * h):
        steps = (side, 2 * side, 3 * side)
        if three := tried(steps):
            return Stencil(steps, tuple(w / (2 * side) for w in (-5.0, 8.0, -3.0)), three)
    raise NoDerivativeError(
        f"parameter {i} = {theta[i]:.6g}: can be changed to neither side; keep it away from the ends of its "
        "range"
    )


def simulate_derivatives(
    case: Case,
    stencils: Sequence[Stencil],
    series: Sequence[Place],
    times_s: Array,
    solver: Callable[[Case, Sequence[tuple[int, float]], Array], Solver] = solver_of,
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
        As `zoo.blood.case.simulate` gives them.
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
        values = {name: getattr(near, name) for name in PARAMETERS}
        return Point(
            weight, **values, solver=None if same_run(case, near) else _beside(own, near, tuple(rows), times)
        )

    directions = [[point(w, c) for w, c in zip(s.weights, s.cases, strict=True)] for s in stencils]
    if not directions:
        solution = own.solve(*(getattr(case, name) for name in PARAMETERS))
        values = np.array([getattr(solution, series[k][2])[i] for k, i in enumerate(at)])
        return values.reshape(len(series), len(times)), np.empty((0, len(series), len(times)))
    found = own.jacobian(*(getattr(case, name) for name in PARAMETERS), directions=directions)
    values = np.array([getattr(found.solution, series[k][2])[i] for k, i in enumerate(at)])
    slopes = np.array([getattr(found, series[k][2])[:, i] for k, i in enumerate(at)])
    return (
        values.reshape(len(series), len(times)),
        slopes.reshape(len(series), len(stencils), len(times)).transpose(1, 0, 2),
    )


def _beside(own: Solver, near: Case, places: Sequence[tuple[int, float]], times: Array) -> Solver:
    """A solver of a case near that of another solver, with as many cells in each vessel."""
    made = solver_of(near, places, times)
    cells, other = own.grid()[0], made.grid()[0]
    if np.array_equal(cells, other):
        return made
    refine = near.options.refine
    options = replace(near.options, cells=tuple(int(n) // refine for n in cells))
    return solver_of(replace(near, options=options), places, times)
