"""Samples at uneven times, linear between, as samples at even times."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.arrays import Array

MOST_SAMPLES = 32768
"""Most even samples of a period that uneven ones become."""
_WANTED = 1e-4  # of the peak to peak: how far the even samples may be from the straight lines
_TIME_ROUNDING_S = 2e-8  # two times printed with 8 decimals


def even_samples(time_s: ArrayLike, value: ArrayLike, period_s: float) -> tuple[Array, float]:
    """Even samples of a periodic curve that is linear between uneven ones.

    Where all times are whole multiples of some period_s/n with n up to `MOST_SAMPLES`/2, the coarsest such
    grid is taken, and the curve is the same. Otherwise n is a power of 2, and the curves differ by at most
    h/4 max abs(change of slope) with h = period_s/n, which is 1e-4 of the peak to peak or n is
    `MOST_SAMPLES`.

    Parameters
    ----------
    time_s : array (m,)
        Ascending from 0, below period_s; s.
    value : array (m,)
        Any unit.
    period_s : float
        s.

    Returns
    -------
    value : array (n,)
        At times i period_s/n.
    distance : float
        Largest difference of the two curves, unit of `value`; 0 where there is none.

    Examples
    --------
    >>> values, distance = even_samples([0.0, 0.1, 0.3], [0.0, 1.0, 3.0], 0.5)
    >>> values.round(9).tolist(), distance
    ([0.0, 1.0, 2.0, 3.0, 1.5], 0.0)
    """
    times, values = np.asarray(time_s, dtype=np.float64), np.asarray(value, dtype=np.float64)
    at, own = np.append(times, period_s), np.append(values, values[0])
    least = math.ceil(min(period_s / np.min(np.diff(at)) * (1 - 1e-6), MOST_SAMPLES))
    for n in range(max(2, least), MOST_SAMPLES // 2 + 1):
        steps = times * (n / period_s)
        if np.max(np.abs(steps - np.rint(steps))) <= n / period_s * _TIME_ROUNDING_S + 1e-9:
            at[:-1] = np.rint(steps) * (period_s / n)
            return np.interp(np.arange(n) * (period_s / n), at, own), 0.0
    slope = np.diff(own) / np.diff(at)
    turn = float(np.max(np.abs(slope - np.roll(slope, 1))))
    if not turn:
        return np.full(2, values[0]), 0.0  # a constant
    wanted = period_s * turn / (4 * _WANTED * float(np.ptp(values)))
    n = min(MOST_SAMPLES, max(1024, 1 << math.ceil(math.log2(min(wanted, MOST_SAMPLES)))))
    return np.interp(np.arange(n) * (period_s / n), at, own), turn * period_s / (4 * n)


def beat_mean(time_s: ArrayLike, value: ArrayLike, period_s: float) -> float:
    """Mean over a period of a curve that is linear between samples; of even ones their mean.

    Parameters
    ----------
    time_s : array (n,)
        Ascending, less than a period from first to last; s.
    value : array (n,)
        Any unit.
    period_s : float
        s.

    Examples
    --------
    >>> beat_mean([0.0, 1.0, 3.0], [0.0, 1.0, 0.0], 4.0)
    0.375
    """
    times, values = np.asarray(time_s, dtype=np.float64), np.asarray(value, dtype=np.float64)
    steps = np.diff(times, append=times[0] + period_s)
    if np.ptp(steps) <= 1e-6 * steps.mean():
        return float(values.mean())
    return float(np.sum(0.5 * (values + np.roll(values, -1)) * steps) / period_s)


def denser(value: ArrayLike, least: int = 32) -> Array:
    """At least so many even samples of a period, on the lines between those that are given."""
    samples = np.asarray(value, dtype=np.float64)
    while len(samples) < least:
        samples = np.stack([samples, 0.5 * (samples + np.roll(samples, -1))], axis=1).ravel()
    return samples
