"""What a baseline and an explanation leave in data that their refits did not see."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.diagnosis.fitting import Fitting
from zoo.core.diagnosis.search import Search, SearchError
from zoo.core.diagnosis.sets import CauseSets
from zoo.core.diagnosis.solved import SolvedSet

Array = NDArray[np.float64]

BLOCKS = 5
"""Of one series, held out in turn."""
STEPS = 8
"""Steps of a refit to what is not held out."""


def hold_out(found: CauseSets, rows: list[int]) -> tuple[float, float, str] | None:
    """Discrepancy before and after in data that a refit does not see: each series in turn, or blocks of one.

    Parameters
    ----------
    found : CauseSets
        Its leading set is compared with the baseline.
    rows : list of int
        Series that are held out.

    Returns
    -------
    (float, float, str) or None
        Rms of smooth residuals before and after in the series' unit, sqrt(max(0, rms^2 - noise^2)), and what
        was held out; None where a refit fails.
    """
    fitting, leader = found.search.fitting, found.solved[found.leader]
    data = fitting.data
    n = data.n_times
    if len(rows) > 1:
        folds = [np.repeat(np.arange(data.n_series)[:, None] == i, n, axis=1) for i in rows]
        what = "each series in turn"
    else:
        block = np.arange(n) * BLOCKS // n
        one = (np.arange(data.n_series) == rows[0])[:, None]
        folds = [np.tile(block == b, (data.n_series, 1)) & one for b in range(BLOCKS)]
        what = f"{BLOCKS} blocks of the {'beat' if data.period is not None else 'record'} in turn"
    noise = np.array([found.noise[group] for group in data.groups])[:, None] * np.ones(n)
    sums, count = np.zeros(2), 0
    for out in (fold & data.measured for fold in folds):
        for which, start in enumerate((found.search.fitted, leader)):
            series = _refit(fitting, start, data.measured & ~out, noise)
            if series is None:
                return None
            sums[which] += np.sum((data.values - series)[out] ** 2 - noise[out] ** 2)
        count += int(out.sum())
    before, after = np.sqrt(np.maximum(sums / count, 0.0)).tolist()
    return before, after, what


class _Kept:
    """Stands in for a hypothesis' coefficients: the samples that are fitted."""

    def __init__(self, forward: Any, kept: NDArray[np.bool_]) -> None:
        self.forward, self.kept = forward, kept
        self.low, self.high, self.units = forward.low, forward.high, forward.units
        self.prior, self.log_prior = forward.prior, forward.log_prior
        self.last_failure = ""
        self.all: dict[bytes, Array] = {}

    def __call__(self, u: Array) -> Array | None:
        series = self.forward.series(u)
        if series is None:
            self.last_failure = self.forward.last_failure
            return None
        self.all[u.tobytes()] = series
        return np.asarray(series[self.kept])


def _refit(fitting: Fitting, start: SolvedSet, kept: NDArray[np.bool_], noise: Array) -> Array | None:
    """All series as computed by a set that was fitted to the kept samples only."""
    forward = _Kept(start.forward, kept)
    search = Search(forward, fitting.data.values[kept], noise[kept] ** 2)
    jacobian = fitting.errors.unflat(start.point.jacobian.T)[:, kept].T
    try:
        point = search.at(start.point.u, jacobian)
    except SearchError:
        return None
    point = search.descend(point, STEPS)
    return forward.all[point.u.tobytes()]
