"""The evidence of solved sets beside solves away from their modes, by importance sampling."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from zoo.core.arviz_lines import smoothed
from zoo.core.causes.evidence import SIZE_PRIORS
from zoo.core.diagnosis.sets import CauseSets
from zoo.core.diagnosis.solved import SolvedSet, Which
from zoo.core.threads import threads

Array = NDArray[np.float64]

LEAST, HEAVY, FEWEST = 0.01, 5, 16
"""Probability from which on a set is checked; degrees of freedom of the distribution with heavier tails;
draws from which on the largest weights have a distribution."""


@dataclass(frozen=True)
class CheckedSet:
    """What solves say of the evidence of one set.

    Attributes
    ----------
    which : tuple of int
        Its causes, by their indices.
    before, after : float
        Probability of the set as it is stated, and with the evidence of all checked sets corrected.
    change : float
        Log evidence by importance sampling less that of the linear model.
    error : float
        Standard error of the change.
    k : float
        Shape of the Pareto distribution of the largest weights; change and error are not to be trusted where
        it is above 0.7 (Vehtari et al. 2024).
    draws, failed : int
        Draws inside the bounds, and those of them that could not be solved.
    """

    which: Which
    before: float
    after: float
    change: float
    error: float
    k: float
    draws: int
    failed: int


def check_sets(
    sets: CauseSets,
    *,
    draws: int = 64,
    seed: int = 0,
    tick: Callable[[str, float], None] = lambda text, share: None,
) -> tuple[CheckedSet, ...]:
    """Solve the sets that matter at draws from their posteriors, and correct their evidence.

    The linear model has a normal posterior N(x) given the most probable error model and sizes of functions.
    With x drawn from q, half N and half a Student's t of five degrees of freedom, the evidence of the
    simulator over that of the linear model is

        sum(w r) / sum(w),    w = N(x) / q(x),    r = p(y | x) p(x) / (p_linear(y | x) p_linear(x)).

    Parameters
    ----------
    sets : CauseSets
    draws : int
        Of each set.
    seed : int
    tick : callable

    Returns
    -------
    tuple of CheckedSet
        Sets of 1 % and more that were solved, and the baseline alone.

    References
    ----------
    Hesterberg 1995, Weighted average importance sampling and defensive mixture distributions, Technometrics
    37, doi 10.1080/00401706.1995.10484303. Vehtari et al. 2024, Pareto smoothed importance sampling, JMLR 25,
    arXiv 1507.02646.
    """
    p = sets.posterior.probability
    there = [which for which in sets.solved if not which or p.get(which, 0.0) >= LEAST]
    found = []
    for i, which in enumerate(there):
        tick(f"checking {sets.name(which)}", i / len(there))
        found.append(_log_ratios(sets, sets.solved[which], draws, np.random.default_rng([seed, i])))
    change = {which: _mean(*logs)[0] for which, logs in zip(there, found, strict=True)}
    log = {which: x + change.get(which, 0.0) for which, x in sets.posterior.log_joint.items()}
    total = logsumexp(list(log.values()))
    return tuple(
        CheckedSet(
            which,
            p.get(which, 0.0),
            math.exp(log[which] - total),
            *_mean(*logs),
            len(logs[0]),
            int(np.isneginf(logs[0]).sum()),
        )
        for which, logs in zip(there, found, strict=True)
    )


def _mean(log_ratios: Array, log_weights: Array) -> tuple[float, float, float]:
    """Logarithm of the weighted mean, its standard error, and Pareto's k of the weights."""
    solved = ~np.isneginf(log_ratios)
    if not solved.any():
        return -math.inf, math.inf, math.inf
    log, k = log_ratios + log_weights, math.inf
    if solved.sum() >= FEWEST:
        smooth, k = smoothed(log[solved])  # normalised
        log[solved] = smooth + logsumexp(log[solved])
    w, linear = np.exp(log - log.max()), np.exp(log_weights)
    off = w / w.mean() - linear / linear.mean()
    mean = log.max() + math.log(w.mean()) - math.log(linear.mean())
    return float(mean), float(np.sqrt(np.mean(off**2) / len(w))), k


def _log_ratios(sets: CauseSets, one: SolvedSet, draws: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Logarithms of r, -inf where a solve failed, and of w, of the draws inside the bounds."""
    fitting, evidence, k = sets.search.fitting, one.evidence, one.n_listed
    best, problem, forward = evidence.best(SIZE_PRIORS), evidence.problem, one.forward
    mean, C = evidence.mean[best], evidence.covariance[best]
    z, d = rng.standard_normal((draws, len(mean))), len(mean)
    z[: draws // 2] /= np.sqrt(rng.chisquare(HEAVY, draws // 2) / HEAVY)[:, None]
    x = mean + z @ np.linalg.cholesky(C).T
    u = one.point.u + (x - one.seen)
    x, u, z = (a[np.all((u >= forward.low) & (u <= forward.high), axis=1)] for a in (x, u, z))
    square = np.sum(z**2, axis=1)  # log density of Student's t less that of the normal distribution
    heavier = gammaln(0.5 * (HEAVY + d)) - gammaln(0.5 * HEAVY) - 0.5 * d * math.log(0.5 * HEAVY)
    heavier += 0.5 * square - 0.5 * (HEAVY + d) * np.log1p(square / HEAVY)
    log_weights = math.log(2.0) - np.logaddexp(0.0, heavier)
    A = np.concatenate([problem.jacobian, *(cause.columns for cause in evidence.causes)], axis=1)
    linear = problem.residual - x @ A.T
    n_effects = len(one.order) - len(evidence.causes)
    own = fitting.model(forward.added[:n_effects]) if evidence.causes else forward
    with threads(fitting.cores) as pool:
        computed = list(pool.map(forward, u))
    found = np.full(len(x), -np.inf)
    V = evidence.variances(best)
    for i, series in enumerate(computed):
        if series is None:
            continue
        left = sets.search.data - series
        step = x[i, :k]
        quadratic = problem.log_prior - 0.5 * step @ problem.P @ step - problem.pull @ step
        found[i] = 0.5 * np.sum((linear[i] ** 2 - left**2) / V) + own.log_prior(u[i, :k]) - quadratic
    return found, log_weights
