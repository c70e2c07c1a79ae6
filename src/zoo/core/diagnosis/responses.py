"""What effects and free functions do to a simulator's series, around the baseline's best fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.causes.problem import Cause, Problem
from zoo.core.components import FreeFunction
from zoo.core.diagnosis.coordinates import FAILURES, SearchModel
from zoo.core.diagnosis.fitting import Fitting
from zoo.core.diagnosis.search import NO_DAMPING, Point, Search
from zoo.core.effects import AddedEffect, Effect
from zoo.core.threads import threads

Array = NDArray[np.float64]
Tick = Callable[[str, float], None]
Effects = tuple[AddedEffect, ...]

SHAPES = (0.0, -0.7, 1.5)
"""Shapes of an effect from which a fit starts: prior standard deviations away from the centre."""
NEARER = 0.3
"""Part of a start that is tried where the start cannot be solved; step of a shape, in its prior's scale."""
STEPS, GAIN = 8, 0.5
"""Steps to where an effect and the baseline's parameters fit best together, and gain that ends them."""
SMALLEST = 0.02
"""Size of an effect, in its prior's scale, from which on it is solved there."""
RESOLVED = 1e-4
"""Part of the largest variance of a function's shortest length below which a direction is left out."""
DIFFERENCE, HEARD, LOUD, SHORTEST, LONGEST = 0.05, 0.2, 5.0, 1e-3, 0.5
"""Step of a difference in prior sds, rms of its change in noise sds to be kept, least and largest step."""
STRAIGHT = 0.1
"""Difference between a response and that of the opposite step, in parts of it, that is taken for linear."""
RETREAT = (1.0, -1.0, 0.2, -0.2)
"""Parts of a step that are tried one after the other where the solve fails."""


class Projected:
    """A problem whose baseline's parameters were projected out, for errors of one variance.

    Parameters
    ----------
    problem : Problem
    V : array (n,)
    """

    def __init__(self, problem: Problem, V: Array) -> None:
        self.n, self.root = len(V), np.sqrt(V)
        values, vectors = np.linalg.eigh(problem.P)
        prior = (vectors * np.sqrt(np.maximum(values, 0.0))).T
        J = np.concatenate([problem.jacobian / self.root[:, None], prior])
        size = np.linalg.norm(J, axis=0)
        self.Q = np.linalg.qr(J / np.where(size > 0.0, size, 1.0))[0]
        self.residual = self(problem.residual)

    def __call__(self, signal: Array) -> Array:
        """Whitened, without what the baseline's parameters take up, (n + k, ...)."""
        scaled = signal / (self.root if signal.ndim == 1 else self.root[:, None])
        scaled = np.concatenate([scaled, np.zeros((len(self.Q) - self.n, *scaled.shape[1:]))])
        return np.asarray(scaled - self.Q @ (self.Q.T @ scaled))

    def left(self, change: Array) -> float:
        """Half the sum of squares that a change of the series leaves."""
        return 0.5 * float(np.sum((self.residual - self(change)) ** 2))


@dataclass(frozen=True, eq=False)
class Origin:
    """What a cause is in the simulator: a listed effect at a place, or a function of some length."""

    added: AddedEffect | None = None
    function: FreeFunction | None = None
    length: float | None = None

    @property
    def scales(self) -> Array:
        """Of the values of one weight each, in the parameters' units."""
        return np.array([p.scale for p in self.effect().effect.parameters])

    @property
    def centres(self) -> Array:
        """Prior means of the values."""
        return np.array([p.centre for p in self.effect().effect.parameters])

    @cached_property
    def key(self) -> tuple[Any, ...]:
        """By which it is known elsewhere."""
        if self.added is not None:
            return (self.added.name, self.added.location)
        assert self.function is not None
        return (self.function.name, self.length)

    def effect(self) -> AddedEffect:
        """As an effect, a function by standard normal weights."""
        if self.added is not None:
            return self.added
        assert self.function is not None
        return self.function.effect(self.function.size, self.length)


@dataclass(frozen=True, eq=False)
class Response:
    """What a cause does around a point, as a cause to be weighed.

    Parameters
    ----------
    cause : Cause
    values : array
        Of its parameters, from which its weights count.
    solved_at : array
        Of its parameters, where it was solved.
    end : Point or None
        Where a listed effect fits best beside the parameters; its Jacobian is only near.
    """

    cause: Cause
    values: Array
    solved_at: Array
    end: Point | None = None


@dataclass(frozen=True, eq=False)
class _Tried:
    """An effect as solved at some size: its response by each parameter, and what they leave."""

    values: Array
    columns: Array = field(repr=False)
    cost: float


def descend(held: Search[SearchModel], free: Search[SearchModel], point: Point, steps: int) -> Point:
    """A descent of what is held, with fresh differences where those at hand do not keep what they promise."""
    if held.promised(point) >= GAIN:
        point = held.descend(point, steps, GAIN)
    if held.promised(point) < GAIN:
        return point
    return held.descend(replace(point, jacobian=free.differences(point, point.jacobian)), steps, GAIN)


class _Listed:
    """One effect at one place, around a fit of the baseline with other effects."""

    def __init__(
        self,
        fitting: Fitting,
        base: Point,
        others: Effects,
        added: AddedEffect,
        problem: Problem,
        projected: Projected,
    ) -> None:
        self.base, self.added, self.problem, self.projected = base, added, problem, projected
        self.parameters = added.effect.parameters
        self.scales = np.array([p.scale for p in self.parameters])
        self.centres = np.array([0.0, *(p.centre for p in self.parameters[1:])])
        self.low, self.high = (np.array([getattr(p, x) for p in self.parameters]) for x in ("low", "high"))
        self.forward, self.held = (fitting.model((*others, added)) for _ in range(2))

    def solve(self, values: Array, step: Array) -> Array | None:
        """Change of the series (n,) by the effect, beside a step of the others that is linear without it."""
        found = self.forward(np.concatenate([self.base.u + step, values]))
        return None if found is None else found - self.base.computed - self.problem.jacobian @ step

    def at(self, values: Array, step: Array) -> _Tried | None:
        """The effect solved there, with secants: of the first parameter from 0, of others by a step each."""
        change = self.solve(values, step)
        if change is None:
            values = values * np.array([NEARER, *np.ones(len(values) - 1)])
            change = self.solve(values, step)
        if change is None or values[0] == 0.0:
            return None
        columns = [change / values[0]]
        for i in range(1, len(values)):
            moved = values.copy()
            more = NEARER * self.scales[i]
            moved[i] += more if values[i] + more <= self.high[i] else -more
            other = self.solve(moved, step)
            columns.append(
                np.zeros_like(change) if other is None else (other - change) / (moved[i] - values[i])
            )
        z = (values - self.centres) / self.scales
        cost = self.projected.left(change) + 0.5 * float(z @ z)
        return _Tried(values, np.stack(columns, axis=1) * self.scales, cost)

    @property
    def _search(self) -> Search[SearchModel]:
        """Of the parameters and the effect, for the errors in which a size is sought."""
        return Search(self.forward, self.base.computed + self.problem.residual, self.projected.root**2)

    def _beside(self, one: _Tried) -> tuple[Array, Array]:
        """Coordinates of the base with the effect as tried, and derivatives there."""
        jacobian = np.concatenate([self.problem.jacobian, one.columns / self.scales], axis=1)
        return np.concatenate([self.base.u, one.values]), jacobian

    def _end(self, tried: Sequence[_Tried]) -> Point:
        """Where a search ends that begins beside each start with the parameters that fit best there."""
        search, ends, k = self._search, list[Point](), len(self.base.u)
        for one in tried:
            start = search.at(*self._beside(one))
            ends.append(self._holding(search, one.values).descend(start, STEPS // 2, GAIN))
        best = min(ends, key=lambda end: end.cost)
        best = descend(self._holding(search, best.u[k:]), search, best, STEPS // 2)
        return descend(search, search, best, STEPS)

    def _holding(self, search: Search[SearchModel], values: Array) -> Search[SearchModel]:
        """The search beside some values of the effect."""
        held, k = self.held, len(self.base.u)
        held.low = np.concatenate([self.forward.low[:k], values])
        held.high = np.concatenate([self.forward.high[:k], values])
        return Search(held, search.data, search.S)

    def _starts(self) -> list[Array]:
        """Values from which a fit starts."""
        first, *others = self.parameters
        shapes = SHAPES if others else SHAPES[:1]
        return [
            np.clip([start, *(p.centre + shape * p.scale for p in others)], self.low, self.high)
            for start, shape in product(first.starts, shapes)
        ]

    def _moved(self, one: _Tried) -> Array:
        """Coordinates one step from the base with the effect as tried."""
        u, jacobian = self._beside(one)
        there = Point(u, self.base.computed + one.columns[:, 0] * one.values[0] / self.scales[0], jacobian)
        return u + self._search.step(there, NO_DAMPING)

    def found(self, component: str, near: Array | None = None) -> Response | None:
        """Where it fits best beside the others; None if it cannot be solved.

        From the best of its starts, or one step from values `near` which were best around another point.
        """
        first, u = self.parameters[0], self.base.u
        starts = self._starts() if near is None else [near]
        tried = [one for start in starts if (one := self.at(start, np.zeros_like(u))) is not None]
        if not tried:
            return None if near is None else self.found(component)
        best, end = min(tried, key=lambda one: one.cost), None
        moves = any(np.any(one.columns) for one in tried)  # else a search would fit the parameters alone
        if moves and np.sum(self.projected.residual**2) > self.projected.n:
            end = self._end(tried) if near is None else None
            there = self._moved(best) if end is None else end.u
            values, step = there[len(u) :], there[: len(u)] - u
            if abs(values[0]) >= SMALLEST * self.scales[0]:
                best = self.at(values, step) or best
        mean = (self.centres - best.values) / self.scales
        mean[0] = 0.0
        cause = Cause(
            self.added.name, component, best.columns, place=self.added.location.suffix,
            low=first.low / first.scale, high=first.high / first.scale, mean=mean,
        )  # fmt: skip
        return Response(cause, np.concatenate([[0.0], best.values[1:]]), best.values, end)


def listed_causes(
    fitting: Fitting,
    base: Point,
    others: Effects,
    added: Effects,
    problem: Problem,
    V: Array,
    component_of: Callable[[Effect], str],
    near: Sequence[Array | None],
    tick: Tick,
) -> list[Response | None]:
    """Listed effects at their places, each by its response where it and the baseline's parameters fit best.

    The response of the first parameter is a secant from where the effect is absent, those of shapes are
    differences; what the parameters do beyond their own derivatives belongs to it.

    Parameters
    ----------
    fitting : Fitting
    base : Point
        The baseline at its mode, with other effects.
    others : tuple of AddedEffect
        These.
    added : tuple of AddedEffect
    problem : Problem
        The baseline and the other effects, linear there.
    V : array (n,)
        Variances of the errors in which a size is sought.
    component_of : callable
    near : sequence of array or None
        Values of each at which it was best around another point.
    tick : callable

    Returns
    -------
    list of Response or None
        Of each effect, which may change nothing at all; None where no start could be solved.
    """
    projected = Projected(problem, V)
    listed = [_Listed(fitting, base, others, one, problem, projected) for one in added]
    names = [component_of(one.effect) or one.name for one in added]
    found: list[Response | None] = []
    with threads(fitting.cores) as pool:
        for one in pool.map(_Listed.found, listed, names, near):
            found.append(one)
            tick(added[len(found) - 1].name, len(found) / len(listed))
    return found


class _Differences:
    """Solves of free functions around a baseline, and steps whose changes are heard above the noise."""

    def __init__(self, forward: SearchModel, at: Array, base: Array, S: Array) -> None:
        self.forward, self.at, self.base, self.S = forward, at, base, S

    def __call__(self, function: FreeFunction, values: Array) -> Array | None:
        """Change of the coefficients (n,) by the function's values, or None where the solve failed."""
        forward, model = self.forward, self.forward.model
        forward.solves += 1
        try:
            series = model.solve(function.apply(model.configure(forward.theta(self.at)), values))
        except FAILURES:
            forward.failures[(function.name,)] += 1
            return None
        return np.asarray(forward.errors.flat(series) - self.base)

    def along(self, function: FreeFunction, direction: Array, central: bool) -> tuple[Array, bool] | None:
        """Derivative along a direction of one prior sd, and whether the opposite step has another."""
        step, found = DIFFERENCE, None
        for part in RETREAT:
            found = self(function, part * step * direction)
            if found is not None:
                step *= part
                break
        if found is None:
            return None
        heard = math.sqrt(float(np.mean(found**2 / self.S)))
        if not HEARD <= heard <= LOUD:
            wanted = math.copysign(float(np.clip(abs(step) / max(heard, 1e-12), SHORTEST, LONGEST)), step)
            if (again := self(function, wanted * direction)) is not None:
                step, found = wanted, again
        opposite = self(function, -step * direction) if central else None
        if opposite is None:
            return found / step, False
        bent = float(np.linalg.norm(found + opposite)) > STRAIGHT * float(np.linalg.norm(found))
        return 0.5 * (found - opposite) / step, bent


def free_causes(
    fitting: Fitting,
    forward: SearchModel,
    base: Point,
    functions: Sequence[FreeFunction],
    S: Array,
    tick: Tick,
) -> list[tuple[Cause, Origin]]:
    """Free functions of components, of each of their lengths, by derivatives at a fit.

    Differences are taken along the directions that a function's prior allows at its shortest length, of
    solves whose discretisation is kept.

    Parameters
    ----------
    fitting : Fitting
    forward : SearchModel
        The baseline, or with effects, on one discretisation.
    base : Point
        Solved there.
    functions : sequence of FreeFunction
    S : array (n,)
        Variances in whose sds a change is heard.
    tick : callable

    Returns
    -------
    list of (Cause, Origin)
    """
    solve = _Differences(forward, base.u, base.computed, S)
    derivatives: dict[str, list[tuple[Array, Array]]] = {f.name: [] for f in functions}
    bent = dict.fromkeys(derivatives, True)
    first = [(f, direction) for f in functions for direction in _directions(f).T[:1]]
    others = [(f, direction) for f in functions for direction in _directions(f).T[1:]]
    done = 0
    with threads(fitting.cores) as pool:
        for jobs in (first, others):  # the strongest direction tells whether one-sided differences will do
            results = pool.map(lambda job: solve.along(job[0], job[1], bent[job[0].name]), jobs)
            for (f, direction), result in zip(jobs, results, strict=True):
                done += 1
                tick(f.component, done / (len(first) + len(others)))
                if result is not None:
                    derivatives[f.name].append((direction, result[0]))
                    if jobs is first:
                        bent[f.name] = result[1]
    found = []
    for f in functions:
        if not (solved := derivatives[f.name]):
            continue
        D, X = (np.stack(part, axis=1) for part in zip(*solved, strict=True))
        by_value = X @ np.linalg.pinv(D)
        for length in f.lengths or (None,):
            columns = by_value @ (f.size * f.root(length))
            place = "" if length is None else f"({f'{length:.3g} {f.argument_unit}'.removesuffix(' 1')})"
            cause = Cause(f.name, f.component, columns, free=True, place=place)
            found.append((cause, Origin(function=f, length=length)))
    return found


def _directions(function: FreeFunction) -> Array:
    """Directions (n_points, m) of one prior sd each, of the function's shortest length."""
    root = function.root(min(function.lengths) if function.lengths else None)
    size = np.sum(root**2, axis=0)
    return np.asarray(function.size * root[:, size > RESOLVED * size.max()])
