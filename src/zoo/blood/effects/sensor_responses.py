"""What sensors and records do to waves."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Wave, filtered
from zoo.core.arrays import Array


def add_to_pressures(wave: Wave, amount_mmHg: float) -> Wave:
    """Something added to every pressure, mmHg."""
    return replace(wave, value=wave.value + amount_mmHg * wave.is_pressure[:, None])


def scale_pressures(wave: Wave, gain: float) -> Wave:
    """Every pressure times 1 + gain."""
    return replace(wave, value=wave.value * (1 + gain * wave.is_pressure[:, None]))


def filter_wave(wave: Wave, response: Callable[[Array], NDArray[Any]], only_pressure: bool) -> Wave:
    """All series, or the pressures alone, through a linear filter of given response at rad/s."""
    changed = filtered(wave.value, wave.period_s, response)
    if only_pressure:
        changed = np.where(wave.is_pressure[:, None], changed, wave.value)
    return replace(wave, value=changed)


def low_pass(omega: Array, time_s: float) -> NDArray[Any]:
    """1/(1 + i omega tau)."""
    return np.asarray(1 / (1 + 1j * omega * time_s))


def delay(omega: Array, time_s: float) -> NDArray[Any]:
    """exp(-i omega t)."""
    return np.asarray(np.exp(-1j * omega * time_s))


def resonance(omega: Array, natural_period_s: float, damping: float) -> NDArray[Any]:
    """1/(1 - x^2 + 2 i z x), x = omega/omega_n, of a mass on a spring with damping z."""
    ratio = omega * natural_period_s / (2 * math.pi)
    return np.asarray(1 / (1 - ratio**2 + 2j * damping * ratio))


def jitter(omega: Array, sd_s: float) -> NDArray[Any]:
    """exp(-(omega sd)^2/2), of a mean of copies shifted by normal(0, sd)."""
    return np.asarray(np.exp(-0.5 * (omega * sd_s) ** 2))
