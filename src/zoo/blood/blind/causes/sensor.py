"""What catheters and transducers do to a pressure."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.causes.cause import cause
from zoo.blood.case import Case, Wave, filtered, with_wave

Array = NDArray[np.float64]
CATHETER = "Gardner 1981, doi 10.1097/00000542-198103000-00010"
BEATS = 3
"""Beats after which a reading that depends on its past repeats."""


def _on_pressures(wave: Wave, changed: Array) -> Wave:
    return replace(wave, value=np.where(wave.is_pressure[:, None], changed, wave.value))


def _bubble(omega: Array, *, period_s: float, damping: float, lag: float) -> NDArray[Any]:
    ratio = omega * period_s / (2 * np.pi)
    return np.asarray(1 / ((1 + 1j * lag * ratio) * (1 - ratio**2 + 2j * damping * ratio)))


def _echo(omega: Array, *, size: float, delay_s: float) -> NDArray[Any]:
    return np.asarray((1 + size * np.exp(-1j * omega * delay_s)) / (1 + size))


def _through(wave: Wave, *, response: Any) -> Wave:
    return _on_pressures(wave, filtered(wave.value, wave.period_s, response))


def _saturated(wave: Wave, *, size: float, share: float) -> Wave:
    low = wave.value.min(axis=1, keepdims=True)
    knee = low + share * (wave.value.max(axis=1, keepdims=True) - low)
    over = np.maximum(wave.value - knee, 0.0)
    return _on_pressures(wave, np.where(over > 0, knee + np.tanh(size * over) / size, wave.value))


def _sticking(wave: Wave, *, size: float, travel: float) -> Wave:
    value = wave.value
    steps = np.roll(value, -1, axis=1) - value
    side, kept = np.sign(steps), np.exp(-np.abs(steps) / travel)
    z = np.zeros_like(value)
    now = np.zeros(len(value))
    for _ in range(BEATS):
        for i in range(value.shape[1]):
            z[:, i] = now
            now = side[:, i] + (now - side[:, i]) * kept[:, i]
    return _on_pressures(wave, value - size * z)


@cause(
    "bubbly-catheter",
    "sensor",
    "s",
    (0.003, 0.04),
    equation="H = 1/((1 + i w b/w_n)(1 - (w/w_n)^2 + 2 i z w/w_n)), w_n = 2 pi/size",
    source=CATHETER,
    damping=(0.08, 0.4),
    lag=(0.3, 1.5),
)
def bubbly_catheter(case: Case, size: float, *, damping: float, lag: float) -> Case:
    """An underdamped catheter behind an air bubble: third order, ringing and late."""
    response = functools.partial(_bubble, period_s=size, damping=damping, lag=lag)
    return with_wave(case, functools.partial(_through, response=response))


@cause(
    "catheter-echo",
    "sensor",
    "1",
    (0.03, 0.9),
    equation="y(t) = (p(t) + a p(t - d))/(1 + a)",
    source=CATHETER,
    delay=(0.004, 0.02),
)
def catheter_echo(case: Case, size: float, *, delay: float) -> Case:
    """What the far end of the line sends back is read once more, some ms later."""
    response = functools.partial(_echo, size=size, delay_s=delay)
    return with_wave(case, functools.partial(_through, response=response))


@cause(
    "soft-saturation",
    "sensor",
    "1/mmHg",
    (0.01, 0.4),
    equation="y = k + tanh(a (p - k))/a above k, a part of the pulse above its foot",
    source=CATHETER,
    share=(0.0, 0.5),
)
def soft_saturation(case: Case, size: float, *, share: float) -> Case:
    """The transducer reads high pressures too low."""
    return with_wave(case, functools.partial(_saturated, size=size, share=share))


@cause(
    "sticking-transducer",
    "sensor",
    "mmHg",
    (0.03, 1.5),
    equation="y = p - a z, dz = (sign(dp) - z) |dp|/d: a lag of the amplitude, whatever the rate",
    source="Dahl 1968, A solid friction model",
    travel=(0.3, 4.0),
)
def sticking_transducer(case: Case, size: float, *, travel: float) -> Case:
    """The reading lags behind by an amount of pressure, as with friction."""
    return with_wave(case, functools.partial(_sticking, size=size, travel=travel))


CAUSES = (bubbly_catheter, catheter_echo, soft_saturation, sticking_transducer)
