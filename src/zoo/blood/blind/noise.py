"""Noise of the sensors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]


def periodic_noise(
    rng: np.random.Generator, length_s: float, period_s: float, shape: tuple[int, int]
) -> Array:
    """Unit noise whose covariance is exp(-|t - t'|/length) around the beat."""
    n = shape[1]
    step = np.minimum(np.arange(n), n - np.arange(n)) * (period_s / n)
    power = np.clip(np.fft.rfft(np.exp(-step / length_s)).real, 0, None)
    return np.asarray(np.fft.irfft(np.fft.rfft(rng.standard_normal(shape)) * np.sqrt(power), n))


def autoregressive(rng: np.random.Generator, tau_s: float, step_s: float, shape: tuple[int, int]) -> Array:
    """Unit noise of first order, stationary from its first sample."""
    keep = math.exp(-step_s / tau_s)
    white = rng.standard_normal(shape)
    rest, _ = lfilter([math.sqrt(1 - keep**2)], [1.0, -keep], white[:, 1:], axis=1, zi=keep * white[:, :1])
    return np.concatenate([white[:, :1], rest], axis=1)
