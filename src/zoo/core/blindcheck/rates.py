"""Rates with their binomial intervals, and the reliability of stated probabilities."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import binom, binomtest

BIN_EDGES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 0.97, 1.0)
"""Of the reliability diagram."""
FULL_BIN = 8
"""Cases from which a bin of the reliability diagram counts."""


@dataclass(frozen=True)
class Rate:
    """A count out of n, its share, and the 95 % interval of Wilson; NaN of nothing."""

    count: int
    n: int

    @property
    def share(self) -> float:
        """count/n."""
        return self.count / self.n if self.n else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Of the share (Wilson 1927, doi 10.1080/01621459.1927.10502953)."""
        if not self.n:
            return math.nan, math.nan
        found = binomtest(self.count, self.n).proportion_ci(0.95, method="wilson")
        return float(found.low), float(found.high)

    def record(self) -> dict[str, Any]:
        """For score.json."""
        low, high = self.interval
        return {"count": self.count, "n": self.n, "share": self.share, "low": low, "high": high}


def rate(flags: Iterable[bool | None]) -> dict[str, Any]:
    """Record of the rate of flags that are not None."""
    given = [flag for flag in flags if flag is not None]
    return Rate(sum(given), len(given)).record()


@dataclass(frozen=True)
class ReliabilityBin:
    """Stated probabilities of one bin: how many came true, and the 95 % range if they are what they say."""

    low: float
    high: float
    n: int
    right: int
    stated: float
    band: tuple[int, int]

    @property
    def inside(self) -> bool:
        """Whether the count lies in the range."""
        return self.band[0] <= self.right <= self.band[1]


def reliability(stated: Sequence[float], right: Sequence[bool]) -> list[ReliabilityBin]:
    """Stated probabilities against how often they came true, by bins of `BIN_EDGES` that hold any.

    Parameters
    ----------
    stated : sequence of float
    right : sequence of bool

    Returns
    -------
    list of ReliabilityBin
        The range is that of a binomial count with the bin's mean stated probability.
    """
    p, hits = np.clip(np.asarray(stated, dtype=float), 0, 1), np.asarray(right, dtype=bool)
    at = np.clip(np.searchsorted(BIN_EDGES, p, side="right") - 1, 0, len(BIN_EDGES) - 2)
    found = []
    for i, (low, high) in enumerate(pairwise(BIN_EDGES)):
        inside = at == i
        n = int(inside.sum())
        if n:
            mean = float(p[inside].mean())
            least, most = (int(x) for x in binom.interval(0.95, n, mean))
            found.append(ReliabilityBin(low, high, n, int(hits[inside].sum()), mean, (max(least, 0), most)))
    return found
