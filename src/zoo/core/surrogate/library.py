"""Solves that a surrogate is made from: points, their series, and how many there were."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from zoo.core.arrays import Array
from zoo.core.forward import ForwardModel, SolveError

Solved = Array | str
"""Series (n_series, n_times), or in what way a solve failed."""


class Library:
    """All solves of a forward model that were made for a surrogate, which every error model may use.

    Parameters
    ----------
    model : ForwardModel

    Attributes
    ----------
    theta : array (n, n_values)
        Points that could be solved.
    series : array (n, n_series, n_times)
    solves : int
        Solves, those that failed included.
    failures : Counter
        Failed solves by kind.
    known : dict
        What was found at points, by their bytes, in an earlier sitting: it is taken from there.
    told : callable or None
        Is called with each other point (n_values,) and what was found there.
    """

    def __init__(self, model: ForwardModel) -> None:
        self.model = model
        self.theta: Array = np.empty((0, sum(p.size for p in model.parameters)))
        self.series: Array = np.empty((0, *model.outputs.shape))
        self.solves = 0
        self.failures: Counter[str] = Counter()
        self.known: dict[bytes, Solved] = {}
        self.told: Callable[[Array, Solved], None] | None = None

    def __len__(self) -> int:
        return len(self.theta)

    def solve(self, points: Array, cores: int = 1) -> Array:
        """Series (n, n_series, n_times) at points (n, n_values), NaN where a solve fails; not kept."""
        known = dict(self.known)

        def one(theta: Array) -> Solved:
            if (key := theta.tobytes()) in known:
                return known[key]
            try:
                series = np.asarray(self.model.solve(self.model.configure(theta)), dtype=np.float64)
            except SolveError as error:
                return error.kind
            return series if np.all(np.isfinite(series)) else "not-finite"

        if cores > 1 and getattr(self.model, "threads", False):
            with ThreadPoolExecutor(cores) as pool:
                found = self._collected(points, pool.map(one, points), known)
        else:
            found = self._collected(points, map(one, points), known)
        self.solves += len(found)
        self.failures.update(item for item in found if isinstance(item, str))
        blank = np.full(self.model.outputs.shape, np.nan)
        return np.array([blank if isinstance(item, str) else item for item in found]).reshape(
            -1, *self.model.outputs.shape
        )

    def _collected(self, points: Array, found: Iterable[Solved], known: dict[bytes, Solved]) -> list[Solved]:
        every: list[Solved] = []
        for theta, one in zip(points, found, strict=True):
            every.append(one)
            if self.told is not None and theta.tobytes() not in known:
                self.told(theta, one)
        return every

    def add(self, points: Array, series: Array) -> None:
        """Keep solved points (n, n_values); those with NaN in their series are left out."""
        good = np.isfinite(series).all((1, 2))
        self.theta = np.concatenate([self.theta, points[good]])
        self.series = np.concatenate([self.series, series[good]])
