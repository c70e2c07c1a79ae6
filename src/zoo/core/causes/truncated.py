"""Normal distributions inside bounds: their mass, and the normal distribution of the same moments."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx

from zoo.core.priors import log_normal_mass

Array = NDArray[np.float64]
FAR, TINY = 6.0, 1e-15
"""Sds inside of a bound from which on it does nothing; least part of a variance that bounds leave."""


def densities(low: Array, high: Array) -> tuple[Array, Array]:
    """Of a standard normal distribution inside bounds, at these, however far from zero they are."""
    turned = low + high < 0.0
    a, b = np.where(turned, -high, low), np.where(turned, -low, high)
    falls = np.exp(0.5 * (a - b) * (a + b))
    near = math.sqrt(2.0 / math.pi) / (erfcx(a / math.sqrt(2.0)) - falls * erfcx(b / math.sqrt(2.0)))
    return np.where(turned, falls * near, near), np.where(turned, near, falls * near)


def truncate(
    mean: Array, columns: Array, at: NDArray[np.int_], low: Array, high: Array
) -> tuple[Array, Array, Array]:
    """Take the bounds of some coordinates in, one after another, those that are most in the way first.

    With the bounds of coordinate i, of variance v, its moments become those of a truncated normal
    distribution, m' and v', and all others follow,

        mean + c (m' - m) / v,    C - b b',    c = C_i,    b = c sqrt(v - v') / v,

    which is exact for the mass and the moments of one bounded coordinate, and moment matching for the next.

    Parameters
    ----------
    mean : array (..., p)
    columns : array (..., p, b)
        Those of the covariance C that belong to coordinates with bounds.
    at : int array (b,)
        These coordinates.
    low, high : array (b,)

    Returns
    -------
    log_mass : array (...)
        Inside all bounds.
    mean : array (..., p)
    lost : array (..., p, n)
        b of each bound that is in the way; C becomes C - b b' summed over them.

    References
    ----------
    Opper 1998, A Bayesian approach to on-line learning; Cunningham, Hennig and Lacoste-Julien 2011, Gaussian
    probabilities and expectation propagation, arXiv 1111.6832.
    """
    log_mass: Any = np.zeros(mean.shape[:-1])
    lost: list[Array] = []
    inner = columns[..., at, :]
    sd = np.sqrt(np.einsum("...ii->...i", inner))
    room = np.minimum(mean[..., at] - low, high - mean[..., at]) / sd
    for i in np.argsort(room.min(axis=tuple(range(room.ndim - 1)))):
        j = at[i]
        c = columns[..., i] - sum(b * b[..., [j]] for b in lost)
        m, v = mean[..., j], c[..., j]
        s = np.sqrt(v)
        a, b = (low[i] - m) / s, (high[i] - m) / s
        if np.all((a < -FAR) & (b > FAR)):
            continue
        log_mass = log_mass + log_normal_mass(a, b)
        first, last = densities(a, b)
        moved = first - last
        # a density that falls from its bound on has at most the sd of an exponential one
        outside = np.where(a > 0.0, moved - a, np.where(b < 0.0, b - moved, 1.0))
        ends = ((a, first, low[i]), (-b, last, high[i]))
        left = 1.0 + sum(x * density for x, density, end in ends if np.isfinite(end)) - moved**2
        left = np.clip(left, TINY, np.minimum(outside**2, 1.0))
        mean = mean + c * (moved / s)[..., None]
        lost.append(c * (np.sqrt(1.0 - left) / s)[..., None])
    return np.asarray(log_mass), mean, np.stack(lost, axis=-1) if lost else np.zeros((*mean.shape, 0))
