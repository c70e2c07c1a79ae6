"""Which explanation predicts data that were held out: baseline, free discrepancy, or a component's function.

All are normal models, linear around the baseline's mode. What is held out are whole series or contiguous
parts of one, so that conditioning is done in time: the noise of the samples that are kept has the covariance
that its spectrum gives it there, and a signal is predicted from them alone, its size and length as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from zoo.core.data import Data
from zoo.core.diagnosis.components.response import Linearised
from zoo.core.diagnosis.components.shares import LARGEST_SCALE, SILENT, visible
from zoo.core.diagnosis.discrepancy import SIZE_GRID, SIZE_PART
from zoo.core.diagnosis.estimates import INTERVAL
from zoo.core.diagnosis.file import Interval
from zoo.core.diagnosis.hypothesis import ranges
from zoo.core.diagnosis.search import as_matrix
from zoo.core.errors.spectral import GroupErrors, Spectral

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PARTS = 8
"""Contiguous parts of a record, of which one after the other is held out, or over which errors are drawn."""
SCALES = np.geomspace(0.01, LARGEST_SCALE, 24)
"""Scales of a function among which the kept data choose, in its prior's."""
LEFT = 3
"""Distance, in the grid of sizes, between those of the discrepancy that is left beside a component."""
TURNS = 3
"""Turns in which the functions of several components are chosen, each beside the others."""
RESAMPLED = 2000
"""Draws of the parts, with replacement, from which intervals of an error are made."""
SURE, SMALLER = 0.975, 0.9
"""Part of these draws in which a component must miss the data by less than a free discrepancy does, and the
part of that one's error that its own must be below: what is false of a component may carry over a little."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """Errors in data that were held out, in the unit of the group asked about.

    An error is the rms of measured minus predicted, the noise's part taken off, sqrt(max(0, mse - noise^2)).

    Parameters
    ----------
    baseline, sensor : Interval
        Of the baseline alone, and with an additive free discrepancy, predicted by its conditional mean.
    components : mapping of name to Interval
        With a component's free function, beside the discrepancy that the kept data leave it; pairs have
        the names of both.
    better : mapping of name to float
        Part of the draws in which its error is less than that of `sensor`.
    what : str
        What was held out.
    """

    baseline: Interval
    sensor: Interval
    components: Mapping[tuple[str, ...], Interval]
    better: Mapping[tuple[str, ...], float]
    what: str

    def found(self, *names: str) -> bool:
        """Whether a component, or several, predict what was held out better than a free discrepancy does."""
        return self.better[names] >= SURE and self.components[names].mean < SMALLER * self.sensor.mean


@dataclass(frozen=True, eq=False)
class _Kind:
    """Responses to the visible weights of a function at one length, sd 1 of its values, in time."""

    size: float
    columns: NDArray[np.int_]


class _InTime:
    """The linear model in the time domain: responses, a basis of the free discrepancy, and the noise."""

    def __init__(self, problem: Linearised) -> None:
        self.problem, self.errors = problem, problem.errors
        self.noise = {q: replace(e, delta=0.0, rough=False) for q, e in problem.noise.items()}
        S = self.errors.variances(self.noise)
        norms = np.sqrt(np.sum(problem.jacobian**2 / S[:, None], axis=0))
        unit = 1.0 / np.maximum(norms, 1e-300)
        self.P = as_matrix(problem.precision) * np.outer(unit, unit)
        self.pull = problem.pull * unit
        pieces, start = [problem.jacobian * unit], problem.jacobian.shape[1]
        self.n_base = start
        self.kinds: dict[str, list[_Kind]] = {name: [] for name in problem.components}
        for block in problem.blocks:
            f = block.function
            for length in f.lengths or (None,):
                pieces.append(visible(block, length, S))
                columns = np.arange(start, start + pieces[-1].shape[1])
                start += len(columns)
                self.kinds[f.component].append(_Kind(f.size, columns))
        self.spans = ranges(self.errors.on)
        largest = self.variances(LARGEST_SCALE, float(self.errors.length_grid[0]), 0.0)
        self.loud = np.flatnonzero(largest > SILENT * S)
        self.responses = self.errors.unflat(np.concatenate(pieces, axis=1).T)
        free = np.zeros((len(self.loud), self.errors.size))
        free[np.arange(len(self.loud)), self.loud] = 1.0
        self.free = self.errors.unflat(free)
        self.residual = self.errors.unflat(problem.residual)
        self.covariances = {q: self._covariance(q) for q in self.errors.groups}

    def variances(self, size: float, length: float, shared: float) -> Array:
        """Of a free discrepancy's coefficients, its size in units of the prior's scale."""
        at = {
            q: GroupErrors(
                0.0,
                delta=size * SIZE_PART * self.spans[q],
                length=length,
                shared=shared if len(rows) > 1 else 0.0,
            )
            for q, rows in self.errors.rows.items()
        }
        return self.errors.variances(at, noise=False)

    def _covariance(self, q: str) -> Array:
        """Of the noise of one series at its samples, (n_times, n_times)."""
        on = self.errors.on
        one: Spectral = replace(self.errors).bind(
            Data(on.times, np.zeros((1, on.n_times)), period=on.period, time_unit=on.time_unit)
        )
        basis = one.unflat(np.eye(on.n_times))[:, 0]
        S = self.errors.spectrum(self.noise[q], 1)[0]
        return np.asarray(basis.T @ (S[:, None] * basis))


class _Fold:
    """What the kept samples say of weights and of the free discrepancy, for one part that is held out."""

    def __init__(self, model: _InTime, kept: Mask) -> None:
        self.model, self.kept = model, kept
        everything = np.concatenate([model.responses, model.free, model.residual[None]])
        gram = np.zeros((len(everything), len(everything)))
        for q, rows in model.errors.rows.items():
            for i in rows:
                if not kept[i].any():
                    continue
                V = model.covariances[q][np.ix_(kept[i], kept[i])]
                white = solve_triangular(
                    np.linalg.cholesky(V), everything[:, i, kept[i]].T, lower=True, check_finite=False
                )
                gram += white.T @ white
        n, m = len(model.responses), len(model.free)
        self.YY, self.Yr = gram[:n, :n], gram[:n, -1]
        self.FY, self.FF, self.Fr = gram[n : n + m, :n], gram[n : n + m, n : n + m], gram[n : n + m, -1]

    @cached_property
    def left_to_free(self) -> list[_Beside]:
        """The free discrepancy that the kept data ask for beside the baseline, and smaller ones."""
        grid, tried = self.model.errors.length_grid, self.model.errors.shared
        several = any(len(rows) > 1 for rows in self.model.errors.rows.values())
        length, shared = float(grid[len(grid) // 2]), 0.0
        best = max((_Beside(self, s, length, shared) for s in SIZE_GRID), key=lambda b: b.alone)
        best = max((_Beside(self, best.size, float(x), shared) for x in grid), key=lambda b: b.alone)
        if several:
            best = max((_Beside(self, best.size, best.length, c) for c in tried), key=lambda b: b.alone)
        best = max((_Beside(self, s, best.length, best.shared) for s in SIZE_GRID), key=lambda b: b.alone)
        at = int(np.argmin(np.abs(SIZE_GRID - best.size)))
        smaller = [
            _Beside(self, s, best.length, best.shared) for s in SIZE_GRID[at - LEFT :: -LEFT] if at >= LEFT
        ]
        return [best, *smaller, _Beside(self, 0.0, best.length, best.shared)]


class _Beside:
    """The kept samples beside a free discrepancy of one size, length and correlation between series."""

    def __init__(self, fold: _Fold, size: float, length: float, shared: float) -> None:
        self.fold, self.model = fold, fold.model
        self.size, self.length, self.shared = float(size), length, shared
        self.root = np.sqrt(self.model.variances(self.size, length, shared)[self.model.loud])
        factor = np.linalg.cholesky(np.eye(len(self.root)) + np.outer(self.root, self.root) * fold.FF)
        self.factor = factor
        own = solve_triangular(factor, self.root * fold.Fr, lower=True, check_finite=False)
        self.log_z = 0.5 * float(own @ own) - float(np.sum(np.log(np.diag(factor))))
        if self.size > 0.0:
            self.log_z += math.log(self.size) - 0.5 * self.size**2
            self.log_z += self.model.errors.length_log_prior(length)
        self._own = own

    @cached_property
    def taken(self) -> Array:
        """Of the responses' products, what the discrepancy takes for itself."""
        return self._taken_of(np.arange(len(self.fold.YY)))

    def _taken_of(self, on: NDArray[np.int_]) -> Array:
        scaled = self.root[:, None] * self.fold.FY[:, on]
        return np.asarray(solve_triangular(self.factor, scaled, lower=True, check_finite=False))

    def products(self, on: NDArray[np.int_], with_: NDArray[np.int_]) -> Array:
        """Of responses with each other, the discrepancy integrated out."""
        found = self.fold.YY[np.ix_(on, with_)] - self.taken[:, on].T @ self.taken[:, with_]
        return np.asarray(found)

    def sides(self, on: NDArray[np.int_]) -> Array:
        """Of responses with the residual."""
        return np.asarray(self.fold.Yr[on] - self.taken[:, on].T @ self._own)

    @cached_property
    def alone(self) -> float:
        """Log evidence without any component."""
        n = np.arange(self.model.n_base)
        taken = self._taken_of(n)
        factor = np.linalg.cholesky(self.fold.YY[np.ix_(n, n)] - taken.T @ taken + self.model.P)
        b = self.fold.Yr[n] - taken.T @ self._own - self.model.pull
        root = solve_triangular(factor, b, lower=True, check_finite=False)
        return self.log_z + 0.5 * float(root @ root) - float(np.sum(np.log(np.diag(factor))))

    def _factor(self, chosen: Sequence[tuple[_Kind, float]]) -> tuple[Any, Any, Any, Any]:
        """Columns, their scales, the factor of their weights' precision and what their mean is made of."""
        n = self.model.n_base
        on = np.concatenate([np.arange(n), *(kind.columns for kind, _ in chosen)])
        scale = np.concatenate([np.ones(n), *(np.full(len(k.columns), s) for k, s in chosen)])
        H = self.products(on, on) * np.outer(scale, scale)
        H[:n, :n] += self.model.P
        H += np.diag(np.r_[np.zeros(n), np.ones(len(on) - n)])
        b = self.sides(on) * scale
        b[:n] -= self.model.pull
        return on, scale, np.linalg.cholesky(H), b

    def best_kind(
        self, kinds: Sequence[_Kind], others: Sequence[tuple[_Kind, float]]
    ) -> tuple[float, _Kind, float]:
        """The function, length and scale of a component that are most probable beside others'."""
        on, scale, factor, b = self._factor(others)
        found: list[tuple[float, _Kind, float]] = []
        mean = solve_triangular(factor, b, lower=True, check_finite=False)
        base = self.log_z + 0.5 * float(mean @ mean) - float(np.sum(np.log(np.diag(factor))))
        for kind in kinds:
            cross = self.products(on, kind.columns) * scale[:, None]
            part = solve_triangular(factor, cross, lower=True, check_finite=False)
            A = self.products(kind.columns, kind.columns) - part.T @ part
            gains, vectors = np.linalg.eigh(A)
            c = vectors.T @ (self.sides(kind.columns) - part.T @ mean)
            s2 = (SCALES[:, None] * kind.size) ** 2
            more = 1.0 + s2 * np.maximum(gains, 0.0)
            log_z = 0.5 * np.sum(s2 * c**2 / more - np.log(more), axis=1) + np.log(SCALES) - 0.5 * SCALES**2
            i = int(np.argmax(log_z))
            found.append((base + float(log_z[i]), kind, float(SCALES[i] * kind.size)))
        return max(found, key=lambda x: x[0])

    def prediction(self, chosen: Sequence[tuple[_Kind, float]]) -> Array:
        """Conditional mean of what is beside the baseline and the noise, in time, (n_series, n_times)."""
        on, scale, factor, b = self._factor(chosen)
        z = solve_triangular(factor, b, lower=True, check_finite=False)
        weights = scale * solve_triangular(factor, z, lower=True, trans="T", check_finite=False)
        left = self.root * (self.fold.Fr - self.fold.FY[:, on] @ weights)
        inner = solve_triangular(self.factor, left, lower=True, check_finite=False)
        free = self.root * solve_triangular(self.factor, inner, lower=True, trans="T", check_finite=False)
        return np.asarray(
            np.tensordot(weights, self.model.responses[on], 1) + np.tensordot(free, self.model.free, 1)
        )


def _explained(fold: _Fold, names: Sequence[str]) -> Array:
    """Prediction with the functions of some components, chosen by what is kept."""
    best, found = -math.inf, None
    for beside in fold.left_to_free:
        chosen: dict[str, tuple[_Kind, float]] = {}
        for _ in range(TURNS if len(names) > 1 else 1):
            for name in names:
                others = [x for other, x in chosen.items() if other != name]
                log_z, kind, scale = beside.best_kind(fold.model.kinds[name], others)
                chosen[name] = (kind, scale)
        if log_z > best:
            best, found = log_z, (beside, list(chosen.values()))
    assert found is not None
    return found[0].prediction(found[1])


def folds_of(errors: Spectral, group: str) -> list[Mask]:
    """What is held out in turn: each series of a group, or contiguous parts of the only one."""
    on, rows = errors.on, errors.rows[group]
    part = np.arange(on.n_times) * PARTS // on.n_times
    whole = [np.repeat(np.arange(on.n_series)[:, None] == i, on.n_times, axis=1) for i in rows]
    return whole if len(rows) > 1 else [whole[0] & (part == j) for j in range(PARTS)]


def intervals_of(units: Array, noise: float, seed: int = 0) -> tuple[list[Interval], Array]:
    """Rms errors beyond the noise with their intervals, and mean squares of draws of the parts.

    Parameters
    ----------
    units : array (n_parts, 1 + n)
        Of each part of a series: its samples, then the sum of squared errors of each explanation.
    noise : float
        Variance of a sample.
    seed : int
        Of the draws of parts with replacement.

    Returns
    -------
    list of Interval
    mse : array (n_draws, n)
    """
    rng = np.random.default_rng(seed)
    drawn = units[rng.integers(0, len(units), (RESAMPLED, len(units)))].sum(axis=1)
    mse = drawn[:, 1:] / drawn[:, :1]
    rms = np.sqrt(np.maximum(mse - noise, 0.0))
    total = units.sum(axis=0)
    mean = np.sqrt(np.maximum(total[1:] / total[0] - noise, 0.0))
    low, high = np.quantile(rms, INTERVAL, axis=0)
    intervals = [
        Interval(mean=float(m), low=float(min(a, m)), high=float(max(b, m)))
        for m, a, b in zip(mean, low, high, strict=True)
    ]
    return intervals, mse


def predict_held_out(
    problem: Linearised,
    group: str,
    asked: Sequence[tuple[str, ...]] = (),
    *,
    seed: int = 0,
) -> Predicted:
    """Errors of baseline, free discrepancy and components in data that their fits did not see.

    Of r = J d + X v + delta + e the kept samples A choose the function of a component, its size and length,
    and those of the free discrepancy delta beside it, as the most probable ones; then what is held out is
    predicted by the conditional mean E[J d + X v + delta | r_A]. `sensor` is the same without X v, the
    baseline without delta as well. So a component can only do better than `sensor` if its function carries
    over to where it was not fitted.

    Parameters
    ----------
    problem : Linearised
    group : str
        Whose series are held out: each in turn, or contiguous parts of the only one.
    asked : sequence of tuples of str
        Components, alone or several together; each alone if absent.
    seed : int
        Of the draws that give errors an interval: the parts of every series, with replacement.

    Returns
    -------
    Predicted
    """
    asked = list(asked) or [(name,) for name in problem.components]
    with threadpool_limits(1, user_api="blas"):  # threads cost more than such small matrices gain
        model = _InTime(problem)
        errors = problem.errors
        noise = float(np.mean(np.diag(model.covariances[group])))
        part = np.arange(errors.n) * PARTS // errors.n
        sums: list[list[float]] = []  # by part: samples, then squared errors of each explanation
        for out in folds_of(errors, group):
            fold = _Fold(model, ~out)
            none = _Beside(fold, 0.0, errors.typical_length, 0.0)
            found = [none.prediction([]), fold.left_to_free[0].prediction([])]
            found += [_explained(fold, names) for names in asked]
            for j in range(PARTS):
                here = out & (part == j)
                if here.any():
                    left = [float(np.sum((model.residual - x)[here] ** 2)) for x in found]
                    sums.append([float(here.sum()), *left])
    intervals, mse = intervals_of(np.array(sums), noise, seed)
    record = "beat" if errors.on.period is not None else "record"
    several = len(errors.rows[group]) > 1
    better = np.mean(mse[:, 2:] < mse[:, 1:2], axis=0)
    return Predicted(
        intervals[0],
        intervals[1],
        dict(zip(asked, intervals[2:], strict=True)),
        {names: float(x) for names, x in zip(asked, better, strict=True)},
        "each series in turn" if several else f"{PARTS} contiguous parts of the {record} in turn",
    )
