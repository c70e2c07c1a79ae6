"""What effects and free functions do to a simulator's series, around the baseline's best fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.causes.problem import Cause, Problem
from zoo.core.components import FreeFunction
from zoo.core.diagnosis.coordinates import FAILURES, SearchModel
from zoo.core.diagnosis.fitting import Fitting
from zoo.core.diagnosis.search import Point
from zoo.core.effects import AddedEffect, Effect

Array = NDArray[np.float64]
Tick = Callable[[str, float], None]
Effects = tuple[AddedEffect, ...]

SHAPES = (0.0, -0.7, 1.5)
"""Shapes of an effect from which a fit starts: prior standard deviations away from the centre."""
NEARER = 0.3
"""Part of a start that is tried where the start cannot be solved; step of a shape, in its prior's scale."""
REFITTED = 3
"""Times that an effect is solved again at the size that its response asks for."""
SETTLED = 0.1
"""Gain in the log posterior below which it is not."""
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

    def aim(self, columns: Array, mean: Array) -> Array:
        """Weights (m,) at the mode, each with a normal prior of sd 1 around `mean`."""
        R = self(columns)
        return np.asarray(np.linalg.solve(R.T @ R + np.eye(len(mean)), R.T @ self.residual + mean))

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
class _Tried:
    """An effect as solved at some size: the change of the series, and its response by each parameter."""

    values: Array
    change: Array = field(repr=False)
    columns: Array = field(repr=False)
    cost: float


class _Listed:
    """One effect at one place, around a fit of the baseline with other effects."""

    def __init__(
        self, fitting: Fitting, base: Point, others: Effects, added: AddedEffect, projected: Projected
    ) -> None:
        self.base, self.added, self.projected = base, added, projected
        self.parameters = added.effect.parameters
        self.scales = np.array([p.scale for p in self.parameters])
        self.centres = np.array([0.0, *(p.centre for p in self.parameters[1:])])
        self.low, self.high = (np.array([getattr(p, x) for p in self.parameters]) for x in ("low", "high"))
        self.forward = fitting.model((*others, added))

    def solve(self, values: Array) -> Array | None:
        """Change of the series (n,) by the effect of these parameters."""
        found = self.forward(np.concatenate([self.base.u, values]))
        return None if found is None else found - self.base.computed

    def at(self, values: Array) -> _Tried | None:
        """The effect solved there, with secants: of the first parameter from 0, of others by a step each."""
        change = self.solve(values)
        if change is None:
            values = values * np.array([NEARER, *np.ones(len(values) - 1)])
            change = self.solve(values)
        if change is None or values[0] == 0.0:
            return None
        columns = [change / values[0]]
        for i in range(1, len(values)):
            moved = values.copy()
            step = NEARER * self.scales[i]
            moved[i] += step if values[i] + step <= self.high[i] else -step
            other = self.solve(moved)
            columns.append(
                np.zeros_like(change) if other is None else (other - change) / (moved[i] - values[i])
            )
        z = (values - self.centres) / self.scales
        cost = self.projected.left(change) + 0.5 * float(z @ z)
        return _Tried(values, change, np.stack(columns, axis=1) * self.scales, cost)

    def found(self) -> _Tried | None:
        """Where it fits best, of its starts and of what their responses ask for."""
        first, *others = self.parameters
        shapes = SHAPES if others else SHAPES[:1]
        starts = [
            np.clip([start, *(p.centre + shape * p.scale for p in others)], self.low, self.high)
            for start, shape in product(first.starts, shapes)
        ]
        tried = [one for start in starts if (one := self.at(start)) is not None]
        if not tried:
            return None
        best = min(tried, key=lambda one: one.cost)
        for _ in range(REFITTED):
            mean = (self.centres - best.values) / self.scales
            mean[0] = 0.0
            w = self.projected.aim(best.columns, mean)
            aim = best.values + w * self.scales
            aim[0] = w[0] * self.scales[0]
            aim = np.clip(aim, self.low, self.high)
            if abs(aim[0]) < SMALLEST * self.scales[0]:
                break
            new = self.at(aim)
            if new is None or new.cost > best.cost - SETTLED:
                break
            best = new
        return best

    def cause(self, best: _Tried, component: str) -> tuple[Cause, Array]:
        """The response there as a cause, and the values from which its weights count."""
        first = self.parameters[0]
        mean = (self.centres - best.values) / self.scales
        mean[0] = 0.0
        cause = Cause(
            self.added.name, component, best.columns, place=self.added.location.suffix,
            low=first.low / first.scale, high=first.high / first.scale, mean=mean,
        )  # fmt: skip
        return cause, np.concatenate([[0.0], best.values[1:]])


def listed_causes(
    fitting: Fitting,
    base: Point,
    others: Effects,
    added: Effects,
    problem: Problem,
    V: Array,
    component_of: Callable[[Effect], str],
    tick: Tick,
) -> list[tuple[Cause, Array] | None]:
    """Listed effects at their places, each by its response at the size that fits best.

    The response of the first parameter is a secant from where the effect is absent, those of shapes are
    differences.

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
    tick : callable

    Returns
    -------
    list of (Cause, array) or None
        For each effect its response and the values from which its weights count, which may change nothing at
        all; None where no start could be solved.
    """
    projected = Projected(problem, V)
    listed = [_Listed(fitting, base, others, one, projected) for one in added]
    found: list[tuple[Cause, Array] | None] = []
    with ThreadPoolExecutor(max(1, fitting.cores)) as pool:
        for done, (one, best) in enumerate(zip(listed, pool.map(_Listed.found, listed), strict=True), 1):
            tick(one.added.name, done / len(listed))
            component = component_of(one.added.effect) or one.added.name
            found.append(None if best is None else one.cause(best, component))
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
            forward.failures += 1
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
    with ThreadPoolExecutor(max(1, fitting.cores)) as pool:
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
