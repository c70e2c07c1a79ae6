"""Normal distributions inside bounds: their mass, and the normal distribution of the same moments."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.priors import log_normal_mass

Array = NDArray[np.float64]
FAR = 6.0
"""Sds inside of a bound from which on it does nothing."""


def truncate(
    mean: Array, C: Array, at: NDArray[np.int_], low: Array, high: Array
) -> tuple[Array, Array, Array]:
    """Take the bounds of some coordinates in, one after another, those that are most in the way first.

    With the bounds of coordinate i, of variance v, its moments become those of a truncated normal
    distribution, m' and v', and all others follow,

        mean + c (m' - m),    C - c c' (v - v'),    c = C_i / v,

    which is exact for the mass and the moments of one bounded coordinate, and moment matching for the next.

    Parameters
    ----------
    mean : array (..., p)
    C : array (..., p, p)
    at : int array (b,)
        Coordinates with bounds.
    low, high : array (b,)

    Returns
    -------
    log_mass : array (...)
        Inside all bounds.
    mean : array (..., p)
    C : array (..., p, p)

    References
    ----------
    Opper 1998, A Bayesian approach to on-line learning; Cunningham, Hennig and Lacoste-Julien 2011, Gaussian
    probabilities and expectation propagation, arXiv 1111.6832.
    """
    log_mass: Any = np.zeros(mean.shape[:-1])
    if not len(at):
        return log_mass, mean, C
    sd = np.sqrt(np.einsum("...ii->...i", C)[..., at])
    room = np.minimum(mean[..., at] - low, high - mean[..., at]) / sd
    least = room.reshape(-1, len(at)).min(axis=0)
    for i in np.argsort(least):
        j = at[i]
        m, v = mean[..., j], C[..., j, j]
        s = np.sqrt(v)
        a, b = (low[i] - m) / s, (high[i] - m) / s
        if np.all((a < -FAR) & (b > FAR)):
            continue
        mass = log_normal_mass(a, b)
        log_mass = log_mass + mass
        edges = []
        for x in (a, b):
            finite = np.where(np.isfinite(x), x, 0.0)
            density = np.exp(-0.5 * finite**2 - 0.5 * math.log(2.0 * math.pi) - mass)
            edges.append((np.where(np.isfinite(x), density, 0.0), finite))
        (first, a), (last, b) = edges
        moved = first - last
        left = np.clip(1.0 + a * first - b * last - moved**2, 1e-9, 1.0)
        c = C[..., j] / v[..., None]
        mean = mean + c * (s * moved)[..., None]
        C = C - c[..., :, None] * c[..., None, :] * (v * (1.0 - left))[..., None, None]
    return np.asarray(log_mass), mean, C
