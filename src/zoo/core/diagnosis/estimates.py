"""How large an effect is: the posterior of its parameters, from a scan of the first of them.

The linearisation at the mode is enough to weigh explanations, and too little to state an interval. The
posterior of a size may be skewed or stand at a bound, the noise and the allowance are not known exactly, and
with precise data the error of the solver's grid moves a size by more than the noise does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import logsumexp, ndtri_exp

from zoo.core.diagnosis.discrepancy import possible_noise
from zoo.core.diagnosis.evidence import Fit, marginal
from zoo.core.diagnosis.hypothesis import HypothesisModel
from zoo.core.diagnosis.screening import DELTA_GRID, Screening
from zoo.core.diagnosis.search import NO_DAMPING, Point, Search, SearchError, as_matrix
from zoo.core.priors import log_normal_mass, log_normal_tails

Array = NDArray[np.float64]

NEXT_ORDER = 1 / 3
"""Error of a grid of half the cells, in parts of what halving them changed: 1/(2^2 - 1) at second order. It
is taken off, and is the standard deviation of the doubt about what is left: it may be none, or, at first
order, three times as much."""
STRIDE = 0.8
"""First step of a scan, in standard deviations of the linearised posterior."""
FALL = 9.0
"""Fall of the log posterior at which a scan ends: 4 standard deviations of a normal one."""
MOST_POINTS = 16
"""Values that a scan tries on either side at most."""
SLOW, STEEP = 0.4, 4.0
"""Change of the log posterior between two values of a scan: a step that changes it by less than the first is
followed by one twice as long; one that changes it by more than the second, near the top, is halved."""
SAME = 1e-3
"""Values of a scan nearer than this part of its first step are one."""
STEPS = 3
"""Steps that the other parameters take at each value at most."""
LIKELY_NOISE = 1e-3
"""Weight, beside the largest, above which a noise and an allowance take part in a scan."""
FINE, QUANTILES, EACH = 2001, 400, 101
"""Values at which the density between the scan's is taken, values of equal probability that stand for it, and
quantiles that stand for a normal distribution around each."""
INTERVAL = (0.025, 0.975)
"""Probabilities at the ends of an interval."""


@dataclass(frozen=True)
class Posterior:
    """Mean, standard deviation and 95 % interval of one parameter, all of the same distribution."""

    mean: float
    sd: float
    low: float
    high: float


class _Slice:
    """A hypothesis with its first parameter held, and the solver's grid corrected."""

    def __init__(self, forward: HypothesisModel, value: float, correction: Array) -> None:
        self.forward, self.value, self.correction = forward, value, correction
        self.kept = np.delete(np.arange(len(forward.low)), forward.asked)
        self.low, self.high = forward.low[self.kept], forward.high[self.kept]
        self.units = forward.units[self.kept]
        self.last_failure = ""

    def whole(self, u: Array) -> Array:
        """Coordinates of the hypothesis."""
        return np.insert(u, self.forward.asked, self.value)

    def __call__(self, u: Array) -> Array | None:
        found = self.forward(self.whole(u))
        self.last_failure = self.forward.last_failure
        return None if found is None else found + self.correction

    def prior(self, u: Array) -> tuple[float, Array, Array]:
        total, precision, pull = self.forward.prior(self.whole(u))
        part = as_matrix(precision)[np.ix_(self.kept, self.kept)]
        return total, part, pull[self.kept]


@dataclass(frozen=True, eq=False)
class _Point:
    """One value of a scan: log posterior density, and what the other parameters are there."""

    value: float
    log_density: float
    mean: Array
    sd: Array
    at: Point


class Scan:
    """The posterior along an effect's first parameter; the others are fitted and integrated out at each.

    p(a | y) = integral of p(a, v | y) dv, of the model linearised in the other parameters v around their best
    values beside a, over the noise and the allowance on grids.

    Parameters
    ----------
    screening : Screening
    fit : Fit
        A hypothesis with an effect, at its mode.
    """

    def __init__(self, screening: Screening, fit: Fit) -> None:
        self.fit, self.errors, self.data = fit, screening.errors, screening.coefficients
        self.best = self.errors.variances(fit.errors)
        self.forward, self.correction, self.moved = self._refined(screening)
        self.S, self.log_weights = self._noises()
        self.points: dict[float, _Point] = {}

    def _refined(self, screening: Screening) -> tuple[HypothesisModel, Array, Array]:
        """The forward model on a finer grid, what is added to its series, and how it moves the parameters."""
        fit = self.fit
        finer = fit.forward.refined()
        computed = None if finer is None else finer(fit.u)
        if finer is None or computed is None:
            return fit.forward, np.zeros_like(fit.computed), np.zeros_like(fit.u)
        screening.forwards.append(finer)
        change = computed - fit.computed
        weighted = fit.jacobian / self.best[:, None]
        H = weighted.T @ fit.jacobian + as_matrix(fit.forward.prior(fit.u)[1])
        moved = -np.linalg.solve(H, weighted.T @ change)
        return finer, NEXT_ORDER * change, np.asarray(moved, dtype=np.float64)

    def _noises(self) -> tuple[Array, Array]:
        """Variances (n_noises, n) that are possible, and the logarithms of their prior weights."""
        fit, length = self.fit, self.errors.typical_length
        noise = possible_noise(fit)
        found, log_weights = [], []
        for asked, options in noise.items():
            for (log_prior, errors), factor in product(options, DELTA_GRID):
                now = {g: errors if g == asked else noise[g][0][1] for g in noise}
                found.append(
                    self.errors.variances(
                        {
                            g: replace(e, delta=factor * fit.allowances[g], length=length, rough=False)
                            for g, e in now.items()
                        }
                    )
                )
                log_weights.append(log_prior - 0.5 * factor**2)
        return np.stack(found), np.array(log_weights)

    def at(self, value: float, v: Array, jacobian: Array) -> _Point:
        """The others fitted beside a value of the first parameter, from v with their Jacobian."""
        held = _Slice(self.forward, value, self.correction)
        search = Search(held, self.data, self.best)
        point = search.descend(
            search.at(np.clip(v, held.low, held.high), jacobian), STEPS, damping=NO_DAMPING
        )
        log_prior, precision, pull = held.prior(point.u)
        log_z, step, C = marginal(self.data - point.computed, point.jacobian, self.S, precision, pull)
        mean, sd = point.u + step, np.sqrt(np.einsum("...dd->...d", C))
        log_z += log_normal_mass((held.low - mean) / sd, (held.high - mean) / sd).sum(axis=-1)
        log_w = log_z + self.log_weights
        total = float(logsumexp(log_w))
        if not self.points:  # noises that count for nothing are left out from here on
            likely = log_w > log_w.max() + math.log(LIKELY_NOISE)
            self.S, self.log_weights = self.S[likely], self.log_weights[likely]
            mean, sd, log_w = mean[likely], sd[likely], log_w[likely]
        w = np.exp(log_w - logsumexp(log_w))
        m = w @ mean
        found = _Point(value, total + log_prior, m, np.sqrt(w @ (sd**2 + (mean - m) ** 2)), point)
        self.points[value] = found
        return found

    def run(self) -> list[_Point]:
        """Points of the scan in the order of the first parameter.

        Raises
        ------
        SearchError
            If the solver fails where it begins.
        """
        fit, i = self.fit, self.fit.forward.asked
        low, high = fit.forward.low[i], fit.forward.high[i]
        kept = np.delete(np.arange(len(fit.u)), i)
        u = np.clip(fit.u + (1.0 + NEXT_ORDER) * self.moved, fit.forward.low, fit.forward.high)
        first = self.at(float(u[i]), u[kept], fit.jacobian[:, kept])
        top, stride = first.log_density, STRIDE * float(fit.sd[i])
        slope = fit.covariance[kept, i] / fit.covariance[i, i]
        for side in (1.0, -1.0):
            here, step, move = first, side * stride, slope
            for _ in range(MOST_POINTS):
                value = float(np.clip(here.value + step, low, high))
                if value == here.value:
                    break
                new = next((p for v, p in self.points.items() if abs(v - value) < SAME * stride), None)
                try:
                    new = new or self.at(value, here.at.u + move * (value - here.value), here.at.jacobian)
                except SearchError:
                    step *= 0.5
                    continue
                change = abs(new.log_density - here.log_density)
                top = max(top, new.log_density)
                if change > STEEP and here.log_density > top - STEEP:
                    step *= 0.5  # too far for a smooth curve between the two
                    continue
                move = (new.at.u - here.at.u) / (value - here.value)
                here = new
                if here.log_density < top - FALL:
                    break
                step *= 2.0 if change < SLOW else 1.0
        return [self.points[value] for value in sorted(self.points)]

    def posteriors(self) -> list[Posterior]:
        """Posteriors of the effect's parameters, the first of which is scanned."""
        points = self.run()
        values = np.array([p.value for p in points])
        drawn = _quantiles(values, np.array([p.log_density for p in points]))
        asked, f = self.fit.forward.asked, self.fit.forward
        doubt = NEXT_ORDER * np.abs(self.moved)
        found = [_mixture(drawn, np.full(len(drawn), doubt[asked]), f.low[asked], f.high[asked])]
        for i in range(asked + 1, len(f.low)):
            means, sds = (
                np.interp(drawn, values, [getattr(p, x)[i - 1] for p in points]) for x in ("mean", "sd")
            )
            found.append(_mixture(means, np.hypot(sds, doubt[i]), f.low[i], f.high[i]))
        return found


def _quantiles(values: Array, log_density: Array) -> Array:
    """Quantiles (QUANTILES,) of a density from its logarithm at some values."""
    if len(values) < 2:
        return np.full(QUANTILES, values[0])
    x = np.linspace(values[0], values[-1], FINE)
    smooth = CubicSpline(values, log_density)(x) if len(values) > 3 else np.interp(x, values, log_density)
    density = np.exp(np.minimum(smooth, log_density.max() + 1.0) - log_density.max())
    total = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.interp((np.arange(QUANTILES) + 0.5) / QUANTILES, total / total[-1], x)


def _mixture(means: Array, sds: Array, low: float, high: float) -> Posterior:
    """Of normal distributions of equal weight, each within the bounds."""
    draws = np.clip(means, low, high)
    if np.all(sds > 0.0):  # quantiles of each stand for it
        m, sd, p = means[:, None], sds[:, None], (np.arange(EACH) + 0.5) / EACH
        a, b = (low - m) / sd, (high - m) / sd
        log_a, log_b = log_normal_tails(a, b)
        z = ndtri_exp(log_b + np.log(p + (1.0 - p) * np.exp(log_a - log_b)))
        draws = np.clip(m + sd * np.where(a > 0.0, -z, z), low, high)
    ends = np.quantile(draws, INTERVAL, method="hazen")
    return Posterior(float(draws.mean()), float(draws.std()), float(ends[0]), float(ends[1]))


def linearised(fit: Fit) -> list[Posterior]:
    """Posteriors of the effect's parameters as the linearisation at the mode has them, within the bounds."""
    found = []
    for i in range(fit.forward.asked, len(fit.u)):
        one = (np.array([fit.mean[i]]), np.array([fit.sd[i]]))
        found.append(_mixture(*one, fit.forward.low[i], fit.forward.high[i]))
    return found


def posteriors_of(screening: Screening, fit: Fit) -> list[Posterior]:
    """Posteriors of an effect's parameters, from a scan; from the linearised model where none can be made.

    Parameters
    ----------
    screening : Screening
    fit : Fit
        A hypothesis with an effect, at its mode.

    Returns
    -------
    list of Posterior
        One for each parameter.
    """
    try:
        return Scan(screening, fit).posteriors()
    except SearchError:  # the finer grid has no solution at the mode
        return linearised(fit)
