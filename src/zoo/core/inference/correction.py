"""Draws of an approximate posterior made exact: Pareto-smoothed weights, and resampling along the chains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zoo.core.arrays import Array
from zoo.core.arviz_lines import smoothed

K_LIMIT = 0.7
"""Largest Pareto k-hat with which importance weights are taken (Vehtari et al. 2024)."""
ALL_EFFECTIVE, ABOVE_MEAN = 0.99, 2.5
"""Least effective share, and largest weight in mean ones, of weights without a tail: where most are equal,
the k-hat of the few that are not means nothing."""


@dataclass(frozen=True)
class Weights:
    """Importance weights of draws.

    Parameters
    ----------
    smoothed : array (n_chains, n_draws)
        Pareto-smoothed weights, which add up to 1.
    k_hat : float
        Shape of the weights' tail: up to 0.7 they can be trusted; minus infinity of weights so alike that
        they have no tail.
    effective : float
        Kish's effective share of the draws, (sum w)^2 / (n sum w^2).
    """

    smoothed: Array
    k_hat: float
    effective: float

    @property
    def trusted(self) -> bool:
        """Whether k-hat is small enough."""
        return bool(self.k_hat <= K_LIMIT)


def pareto_weights(log_weights: Array) -> Weights:
    """Pareto-smoothed importance weights of draws.

    Parameters
    ----------
    log_weights : array (n_chains, n_draws)
        Logarithm of the posterior over the approximate one, up to a constant; -inf where a solve failed.

    Returns
    -------
    Weights

    References
    ----------
    Vehtari, Simpson, Gelman, Yao, Gabry (2024), Journal of Machine Learning Research 25(72).
    """
    flat = np.asarray(log_weights, dtype=np.float64).ravel()
    possible = np.isfinite(flat)
    if possible.sum() < 5:
        return Weights(np.full(np.shape(log_weights), 1.0 / flat.size), np.inf, 0.0)
    w, k = np.exp(np.where(possible, flat - flat[possible].max(), -np.inf)), -np.inf
    if _kish(w) < ALL_EFFECTIVE or w.max() > ABOVE_MEAN * w.mean():
        smooth, k = smoothed(flat[possible])
        w[possible] = np.exp(smooth)
    w /= w.sum()
    return Weights(w.reshape(np.shape(log_weights)), k, _kish(w))


def _kish(w: Array) -> float:
    return float(w.sum() ** 2 / (w.size * (w**2).sum()))


def along_chains(weights: Array, rng: np.random.Generator) -> NDArray[np.int64]:
    """Indices (n_chains, n_draws) of draws resampled within each chain, in its order.

    Systematic resampling: a draw of weight w stands n w times, rounded up or down. Copies of a draw stand
    beside each other, so that they count as what they are, autocorrelation, in effective sample sizes; and
    chains keep apart, so that R-hat can tell when they do not agree.

    Parameters
    ----------
    weights : array (n_chains, n_draws)
    rng : Generator

    References
    ----------
    Kitagawa (1996), doi 10.1080/10618600.1996.10474692.
    """
    n = weights.shape[1]
    found = []
    for w in weights:
        ends = np.cumsum(w) / w.sum()
        found.append(np.minimum(np.searchsorted(ends, (np.arange(n) + rng.uniform()) / n), n - 1))
    return np.array(found)
