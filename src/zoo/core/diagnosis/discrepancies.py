"""Draws from the posterior over sets of causes: what is true beside what the baseline computes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.causes.evidence import SIZE_PRIORS
from zoo.core.diagnosis.file import Estimate, Interval
from zoo.core.diagnosis.sets import CauseSets
from zoo.core.diagnosis.solved import SolvedSet, Which

Array = NDArray[np.float64]

DRAWS, TOLD, MOST = 400, 3e-3, 30
"""Draws of each set, the least probability of a set that is drawn from, and how many are at most."""
PARTS = 16
"""Parts in which draws of a set are taken back to their samples."""
INTERVAL = (0.025, 0.975)
"""Probabilities at the ends of an interval."""


def interval_of(draws: Array, weights: Array) -> Interval:
    """Mean and 95 % interval of weighted draws (n,)."""
    order = np.argsort(draws)
    total = np.cumsum(weights[order])
    low, high = np.interp(INTERVAL, (total - 0.5 * weights[order]) / total[-1], draws[order])
    return Interval(mean=float(weights @ draws / weights.sum()), low=float(low), high=float(high))


def estimate_of(name: str, unit: str, draws: Array, weights: Array) -> Estimate:
    """A parameter of weighted draws (n,)."""
    one = interval_of(draws, weights)
    sd = float(np.sqrt(weights @ (draws - one.mean) ** 2 / weights.sum()))
    return Estimate(name=name, mean=one.mean, sd=sd, interval=(one.low, one.high), unit=unit)


@dataclass(frozen=True, eq=False)
class SetDraws:
    """Draws of one solved set.

    Parameters
    ----------
    which : tuple of int
    solved : SolvedSet
    weight : float
        Probability of the set among those that are drawn from.
    x : array (n_draws, p)
        Steps and weights, as `SolvedSet.series` takes them.
    computed : array (n_draws, n)
        Coefficients that the set computes.
    left : array (n_draws, n)
        What is true beyond that: the discrepancy that nobody can name.
    """

    which: Which
    solved: SolvedSet = field(repr=False)
    weight: float
    x: Array = field(repr=False)
    computed: Array = field(repr=False)
    left: Array = field(repr=False)

    @property
    def weights(self) -> Array:
        """Of each draw."""
        return np.full(len(self.x), self.weight / len(self.x))

    def values(self, part: slice) -> Array:
        """Coordinates of the forward model (n_draws, m), inside their bounds."""
        point = self.solved.point.u - self.solved.seen
        forward = self.solved.forward
        return np.clip((self.x + point)[:, part], forward.low[part], forward.high[part])

    def signal(self, part: slice) -> Array:
        """What the coordinates of a cause do to the coefficients, (n_draws, n)."""
        origin = np.zeros(self.x.shape[1])
        if part.start < self.solved.n_listed:  # an effect is there from its first parameter's 0 on
            origin[part.start] = -self.solved.point.u[part.start]
        return np.asarray((self.x - origin)[:, part] @ self.solved.point.jacobian[:, part].T)


def together(sets: Iterable[SetDraws], of: Callable[[SetDraws], Array]) -> tuple[Array, Array]:
    """What is asked of each draw (n_draws, ...) of some sets, and the draws' weights."""
    values, weights = zip(*((of(one), one.weights) for one in sets), strict=True)
    return np.concatenate(values), np.concatenate(weights)


def draw_set(found: CauseSets, one: SolvedSet, weight: float, rng: np.random.Generator) -> SetDraws:
    """Draws of a solved set, over all errors that it was weighed beside."""
    evidence = one.evidence
    kinds = rng.choice(len(evidence.kinds), DRAWS, p=evidence.weights(SIZE_PRIORS))
    x = np.empty((DRAWS, evidence.mean.shape[1]))
    computed = np.empty((DRAWS, len(found.search.data)))
    left = np.empty_like(computed)
    for kind in np.unique(kinds):
        at = np.flatnonzero(kinds == kind)
        x[at] = rng.multivariate_normal(
            evidence.mean[kind], evidence.covariance[kind], len(at), method="eigh", check_valid="ignore"
        )
        computed[at] = one.series(x[at])
        noise, both = evidence.variances(kind, alone=True), evidence.variances(kind)
        part = 1.0 - noise / both
        missed = found.search.data - computed[at]
        left[at] = part * missed + np.sqrt(part * noise) * rng.standard_normal(missed.shape)
    return SetDraws(tuple(sorted(one.order)), one, weight, x, computed, left)


@dataclass(frozen=True, eq=False)
class CauseDraws:
    """Draws of the sets that were solved and are not improbable, each set's with its probability.

    Parameters
    ----------
    found : CauseSets
    sets : tuple of SetDraws
        The most probable first.
    """

    found: CauseSets
    sets: tuple[SetDraws, ...] = field(repr=False)


def draw_causes(found: CauseSets, seed: int) -> CauseDraws:
    """Draws of the leading solved sets of a posterior."""
    log = {which: x for which, x in found.posterior.log_joint.items() if which in found.solved}
    total = logsumexp(list(log.values()))
    p = {which: float(np.exp(x - total)) for which, x in log.items()}
    kept = sorted((which for which in p if p[which] >= TOLD), key=lambda which: -p[which])[:MOST]
    total, rng = sum(p[which] for which in kept), np.random.default_rng(seed)
    return CauseDraws(
        found, tuple(draw_set(found, found.solved[which], p[which] / total, rng) for which in kept)
    )


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """Truth minus series that were computed, with bands; in the series' own units.

    Parameters
    ----------
    draws : array (n_draws, n)
        Of the samples that were measured, series after series.
    weights : array (n_draws,)
    residual : array (n_series, n_times)
        Measured minus computed; NaN where not measured.
    """

    draws: Array = field(repr=False)
    weights: Array = field(repr=False)
    residual: Array = field(repr=False)

    @property
    def mean(self) -> Array:
        """(n_series, n_times)."""
        return self._placed(self.weights @ self.draws / self.weights.sum())

    @property
    def sd(self) -> Array:
        """(n_series, n_times)."""
        squares = self._placed(self.weights @ self.draws**2 / self.weights.sum())
        return np.asarray(np.sqrt(np.maximum(squares - self.mean**2, 0.0)))

    def _placed(self, samples: Array) -> Array:
        found = np.full(self.residual.shape, np.nan)
        found[~np.isnan(self.residual)] = samples
        return found

    def rms(self, rows: Sequence[int]) -> Array:
        """Over some series together, (n_draws,)."""
        series, _ = np.nonzero(~np.isnan(self.residual))
        return np.asarray(np.sqrt(np.mean(self.draws[:, np.isin(series, rows)] ** 2, axis=1)))

    def interval(self, rows: Sequence[int]) -> Interval:
        """Of that rms."""
        return interval_of(self.rms(rows), self.weights)


def discrepancies(drawn: CauseDraws) -> tuple[Discrepancy, Discrepancy]:
    """Of the baseline over all sets, and of the leading set: what it leaves."""
    found = drawn.found
    errors, base = found.search.family.errors, found.search.fitting.start  # what a best fit misses
    residual = errors.unflat(found.search.data - base.computed)
    there = ~np.isnan(residual)

    def samples(coefficients: Array) -> Array:  # some at a time: series of their own clocks are mostly gaps
        parts = np.array_split(coefficients, PARTS)
        return np.concatenate([errors.unflat(part)[:, there] for part in parts])

    truth, weights = together(drawn.sets, lambda one: samples(one.computed + one.left - base.computed))
    before = Discrepancy(truth, weights, residual)
    leader = next(one for one in drawn.sets if one.which == found.leader)
    if not found.leader:
        return before, before
    point = leader.solved.point
    left = leader.computed + leader.left - point.computed
    residual = errors.unflat(found.search.data - point.computed)
    after = Discrepancy(samples(left), leader.weights, residual)
    return before, after
