"""Bounds of the baseline's priors that its best fit lies beyond, and the baseline with these lifted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.core.arrays import rms_of
from zoo.core.diagnosis.coordinates import Coordinate, SearchModel
from zoo.core.diagnosis.file import ExcludedFit, LiftedBound
from zoo.core.diagnosis.fitting import Fitting
from zoo.core.diagnosis.search import SearchError
from zoo.core.forward import ForwardModel, WithPriors
from zoo.core.inference.prior_check import AtBound
from zoo.core.parameters import LogNormal, LogUniform, Normal, Prior, Uniform

Array = NDArray[np.float64]

AT_BOUND = 0.01
"""How near to a bound a mode stands at it, in units of the search: some thousandth of the prior's width."""
VISIBLE = 3.0
"""Gain of the log-likelihood beyond a bound from which on the bound is said to be in the way."""
WIDENING = 10.0
"""Factor by which a positive bound is moved."""
WIDTHS = 2.0
"""Widths of its prior by which another bound is moved."""
WIDENINGS = 3
"""How often at most."""


def at_bounds(forward: SearchModel, u: Array) -> list[tuple[Coordinate, AtBound]]:
    """Coordinates of a point that stand at a bound of their prior; zero is where a positive number ends."""
    found = []
    for i, p in enumerate(forward.parameters):
        for side, bound, end in (("lower", p.low, forward.low[i]), ("upper", p.high, forward.high[i])):
            if bound != 0.0 and abs(u[i] - end) <= AT_BOUND * forward.units[i]:
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


def freed(fitting: Fitting, rows: list[int]) -> tuple[Fitting, ExcludedFit | None]:
    """A baseline that is free to fit best, and what its prior excluded.

    Where the baseline's best fit stands at a bound of its prior, the bound is moved and the baseline fitted
    again, a few times. If that raises the log-likelihood visibly, the bound was in the way.

    Parameters
    ----------
    fitting : Fitting
    rows : list of int
        Series whose residuals are stated.

    Returns
    -------
    Fitting
        The same, or one of the baseline with wider priors.
    ExcludedFit or None
    """
    stuck, free = at_bounds(fitting.forward, fitting.start.u), fitting
    bounds = [one for _, one in stuck]
    for _ in range(WIDENINGS):
        model = lifted(free.baseline, stuck)
        if model is None:  # also where nothing stands at a bound
            break
        wider = replace(free, baseline=model, start_at=free.start.u)
        try:
            stuck = at_bounds(wider.forward, wider.start.u)
        except SearchError:  # no solution there: as far as it goes
            break
        free = wider
    if free is fitting:
        return fitting, None
    within, beyond = (f.coefficients - f.start.computed for f in (fitting, free))
    sigma2 = float(np.mean(beyond**2))
    if 0.5 * float(np.sum(within**2 - beyond**2)) < VISIBLE * sigma2:
        return fitting, None
    names = [p.name for p in free.forward.parameters]
    theta = free.forward.theta(free.start.u)
    rms = [rms_of(fitting.errors.unflat(x)[rows]) for x in (within, beyond)]
    return free, ExcludedFit(
        unit=fitting.data.units[rows[0]],
        bounds=[
            LiftedBound.model_validate(
                {"parameter": b.parameter, "unit": b.unit, "side": b.side, "bound": b.bound}
                | {"best": float(theta[names.index(b.parameter)])}
            )
            for b in bounds
        ],
        residual_rms_within=rms[0],
        residual_rms_free=rms[1],
    )
