"""What a baseline and an explanation leave in data that their refits did not see."""

from __future__ import annotations

from collections.abc import Sequence
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
    """Discrepancy before and after in data that a refit does not see.

    Of several experiments that share all parameters that is each one in turn, else a block of each one's
    record; of one with several series each of these, and of one series its blocks.

    Parameters
    ----------
    found : CauseSets
        Its leading set is compared with the baseline.
    rows : list of int
        Series in which the discrepancy is told.

    Returns
    -------
    (float, float, str) or None
        Rms of smooth residuals before and after in the series' unit, sqrt(max(0, rms^2 - noise^2)), and what
        was held out; None where a refit fails.
    """
    fitting, leader = found.search.fitting, found.solved[found.leader]
    data = fitting.data
    n, index = data.n_times, np.arange(data.n_series)[:, None]
    told, alone = np.isin(index, rows), getattr(fitting.baseline, "alone", None)
    folds: Sequence[NDArray[np.bool_]]
    if alone:
        folds, what = alone, "each experiment in turn"
    elif alone is None and len(rows) > 1:
        folds, what = [index == i for i in rows], "each series in turn"
    else:
        block = np.arange(n) * BLOCKS // n
        folds = [told & (block == b) for b in range(BLOCKS)]
        record = "beat" if data.period is not None else "record"
        what = f"{BLOCKS} blocks of {'the' if alone is None else 'each'} {record} in turn"
    noise = np.array([found.noise[group] for group in data.groups])[:, None] * np.ones(n)
    sums, count = np.zeros(2), 0
    for out in (fold & data.measured for fold in folds):
        for which, start in enumerate((found.search.fitted, leader)):
            series = _refit(fitting, start, data.measured & ~out, noise)
            if series is None:
                return None
            here = out & told
            sums[which] += np.sum((data.values - series)[here] ** 2 - noise[here] ** 2)
        count += int((out & told).sum())
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
