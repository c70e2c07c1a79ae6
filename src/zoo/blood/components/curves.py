"""Smooth curves through values at knots, and linear filters whose gain or delay is such a curve."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.core.arrays import Array

LARGEST_LOG = 20.0
"""Logarithms of factors are held between minus and plus this, so that none overflows."""
CELLS_PER_KNOT = 32
"""Parts of the interval between two knots on which a gain's slope is taken as constant."""


def factors(log_factors: ArrayLike) -> Array:
    """exp(v), of v held within `LARGEST_LOG`; exactly 1 where v is 0."""
    return np.exp(np.clip(np.asarray(log_factors, dtype=np.float64), -LARGEST_LOG, LARGEST_LOG))


def curve(at: ArrayLike, x: ArrayLike, *, period: float | None = None, linear: bool = False) -> Array:
    """Matrix from values at knots to those of the cubic spline through them.

    Parameters
    ----------
    at : array (n,)
        Knots, increasing; of a periodic curve within one period.
    x : array (m,)
        Where it is wanted.
    period : float, optional
        Of a periodic curve; otherwise the spline is natural.
    linear : bool
        Whether it goes on linearly beyond the knots, instead of with the value at the last one.

    Returns
    -------
    array (m, n)
    """
    from scipy.interpolate import CubicSpline

    knots, wanted = np.asarray(at, dtype=np.float64), np.asarray(x, dtype=np.float64)
    unit = np.eye(len(knots))
    if period is not None:
        closed = np.append(knots, knots[0] + period)
        spline = CubicSpline(closed, np.vstack([unit, unit[:1]]), bc_type="periodic")
        return np.asarray(spline(knots[0] + np.mod(wanted - knots[0], period)))
    if len(knots) == 1:
        return np.ones((len(wanted), 1))
    spline = CubicSpline(knots, unit, bc_type="natural")
    inside = np.clip(wanted, knots[0], knots[-1])
    found = spline(inside)
    if linear:
        found = found + (wanted - inside)[:, None] * spline(inside, 1)
    return np.asarray(found)


def _bode_weight(u: Array) -> Array:
    """Integral from 0 to u of ln coth(|v|/2)."""
    from scipy.special import spence

    x = np.exp(-np.abs(u))
    return np.asarray(np.sign(u) * (math.pi**2 / 4 - spence(1 - x) + spence(1 + x)))


def minimum_phase(at: ArrayLike, x: ArrayLike) -> Array:
    """Matrix from log gains at knots of log frequency to the phase of the filter that is causal with them.

    phi(x) = (1/pi) times the integral of a'(u) ln coth(|u - x|/2) over u, where a is `curve` through the log
    gains.

    Parameters
    ----------
    at : array (n,)
        Knots, logarithms of frequencies.
    x : array (m,)
        Logarithms of the frequencies at which it is wanted.

    Returns
    -------
    array (m, n)
        Phase in rad for each unit of log gain.

    References
    ----------
    Bode 1945, Network Analysis and Feedback Amplifier Design, chapter 14.
    """
    knots, wanted = np.asarray(at, dtype=np.float64), np.asarray(x, dtype=np.float64)
    edges = np.linspace(knots[0], knots[-1], CELLS_PER_KNOT * (len(knots) - 1) + 1)
    slope = np.diff(curve(knots, edges), axis=0) / np.diff(edges)[:, None]
    weight = np.diff(_bode_weight(edges[None, :] - wanted[:, None]), axis=1)
    return np.asarray(weight @ slope / math.pi)


@functools.lru_cache(maxsize=16)
def _filter_matrices(at: tuple[float, ...], first: float, n: int) -> tuple[Array, Array]:
    """Log gain and phase at n harmonics, the first of log frequency `first`, (n, n_knots) each."""
    x = first + np.log(np.arange(1, n + 1))
    return curve(at, x), minimum_phase(at, x)


def gain_response(omega: Array, at: Array, values: Array) -> NDArray[np.complex128]:
    """Causal filter of given log gain, without delay of its own, at the angular frequencies of harmonics.

    Parameters
    ----------
    omega : array (m,)
        rad/s, of the harmonics from 0 up; steady values pass unchanged.
    at : array (n,)
        Knots, logarithms of frequencies in Hz.
    values : array (n,)
        Log gains there.

    Returns
    -------
    complex array (m,)
    """
    first = math.log(omega[1] / (2 * math.pi))
    gain, phase = _filter_matrices(tuple(at.tolist()), first, len(omega) - 1)
    log_gain = np.clip(gain @ values, -LARGEST_LOG, LARGEST_LOG)
    return np.concatenate([[1.0], np.exp(log_gain + 1j * (phase @ values))])


def delay_response(omega: Array, at: Array, values: Array) -> NDArray[np.complex128]:
    """exp(-i omega tau(omega)), of delays tau (s) at knots of log frequency (Hz); as `gain_response`."""
    first = math.log(omega[1] / (2 * math.pi))
    delay = curve(at, first + np.log(np.arange(1, len(omega)))) @ values
    return np.concatenate([[1.0], np.exp(-1j * omega[1:] * delay)])
