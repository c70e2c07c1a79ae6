"""Bounds of the baseline's priors that its best fit lies beyond, and the baseline with these lifted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.hypothesis import Coordinate
from zoo.core.diagnosis.scoring import VISIBLE
from zoo.core.diagnosis.screening import Screening
from zoo.core.diagnosis.search import SearchError
from zoo.core.forward import ForwardModel, WithPriors
from zoo.core.inference.prior_check import AtBound
from zoo.core.parameters import LogNormal, LogUniform, Normal, Prior, Uniform

AT_BOUND = 0.01
"""How near to a bound a mode stands at it, in units of the search: some thousandth of the prior's width."""
WIDENING = 10.0
"""Factor by which a positive bound is moved."""
WIDTHS = 2.0
"""Widths of its prior by which another bound is moved."""
WIDENINGS = 3
"""How often at most."""


@dataclass(frozen=True, eq=False)
class Excluded:
    """What a baseline's prior excludes: the bounds, the fit within them and the one beyond."""

    bounds: tuple[AtBound, ...]
    within: Fit
    free: Fit

    @property
    def values(self) -> list[float]:
        """What fits best, one for each bound."""
        names = [p.name for p in self.free.forward.parameters]
        return [float(self.free.values[names.index(one.parameter)]) for one in self.bounds]


def at_bounds(fit: Fit) -> list[tuple[Coordinate, AtBound]]:
    """Coordinates of a fit that stand at a bound of their prior; zero is where a positive number ends."""
    found = []
    for i, p in enumerate(fit.forward.parameters):
        for side, bound, end in (
            ("lower", p.low, fit.forward.low[i]),
            ("upper", p.high, fit.forward.high[i]),
        ):
            if bound != 0.0 and abs(fit.u[i] - end) <= AT_BOUND * fit.forward.units[i]:
                found.append((p, AtBound(p.name, side, bound, p.unit)))
    return found


def widened(prior: Prior, side: str) -> Prior | None:
    """The same kind of prior without that bound, or with one far off; None where there is no such."""
    low, high = prior.support
    if isinstance(prior, Normal):
        further = low / WIDENING if low > 0.0 else -math.inf
        return replace(prior, low=further) if side == "lower" else replace(prior, high=math.inf)
    if isinstance(prior, LogNormal):
        return replace(prior, low=0.0) if side == "lower" else replace(prior, high=math.inf)
    if not isinstance(prior, Uniform | LogUniform):
        return None
    if side == "lower":
        return replace(prior, low=low / WIDENING if low > 0.0 else low - WIDTHS * (high - low))
    return replace(prior, high=high * WIDENING if high > 0.0 and low >= 0.0 else high + WIDTHS * (high - low))


def lifted(model: ForwardModel, bounds: Sequence[tuple[Coordinate, AtBound]]) -> ForwardModel | None:
    """A model whose priors end beyond these bounds; None if none of them can be moved."""
    priors: dict[str, Prior] = {}
    for p, one in bounds:
        name = p.parameter.name
        wider = widened(priors.get(name, p.parameter.prior), one.side)
        if wider is not None:
            priors[name] = wider
    return WithPriors(model, priors) if priors else None


def _stuck(screening: Screening) -> list[tuple[Coordinate, AtBound]]:
    return at_bounds(screening.base.alone) or at_bounds(screening.base.fit)


def freed(screening: Screening) -> tuple[Screening, Excluded | None]:
    """A screening whose baseline is free to fit best, and what its prior excluded.

    Where the baseline's mode stands at a bound of its prior, the bound is moved and the baseline fitted
    again, a few times. If that raises the log-likelihood visibly, the bound was in the way.

    Parameters
    ----------
    screening : Screening
        Not run yet.

    Returns
    -------
    Screening
        The same, or one of the baseline with wider priors.
    Excluded or None
    """
    if not (stuck := _stuck(screening)):
        return screening, None
    bounds = tuple(one for _, one in stuck)
    free = screening
    for _ in range(WIDENINGS):
        model = lifted(free.baseline, stuck)
        if model is None:
            break
        wider = free.with_baseline(model, start=free.base.alone.u)
        try:
            stuck = _stuck(wider)
        except SearchError:  # no solution there: as far as it goes
            break
        free = wider
        if not stuck:
            break
    if free is screening:
        return screening, None
    fits = (screening.base.alone, free.base.alone)
    S = free.errors.variances(fits[1].errors)
    costs = [0.5 * float(np.sum(fit.residual**2 / S)) for fit in fits]
    if costs[0] - costs[1] < VISIBLE:
        return screening, None
    return free, Excluded(bounds, *fits)
