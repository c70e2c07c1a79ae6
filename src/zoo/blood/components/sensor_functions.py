"""What the pressure sensors may do to the waves; what is added to a series freely stands in the core."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from zoo.blood.case import Case, Wave, with_wave
from zoo.blood.components.curves import curve, delay_response, gain_response
from zoo.blood.components.declared import free_function
from zoo.blood.components.setting import DELAY_KNOTS, GAIN_KNOTS, Setting
from zoo.blood.effects.sensor_responses import filter_wave
from zoo.core.arrays import Array
from zoo.core.components import FreeFunction

CURVE_KNOTS = 9
CURVE_MARGIN = 0.1
"""Part of the observed pressures' range by which the curve's knots go beyond it."""
CURVE_MMHG, CURVE_PART = 0.5, 0.005
"""Half of a transducer's tolerance: of 1 mmHg, and of 1 % of the reading."""


def sensed_gain(case: Case, values: Array, at: Array) -> Case:
    """All pressures pass a causal filter of given log gains."""
    if not np.any(values):
        return case
    response = functools.partial(gain_response, at=at, values=values)
    return with_wave(case, functools.partial(filter_wave, response=response, only_pressure=True))


def sensed_delay(case: Case, values: Array, at: Array) -> Case:
    """Each harmonic of all pressures is delayed by its own time."""
    if not np.any(values):
        return case
    response = functools.partial(delay_response, at=at, values=values)
    return with_wave(case, functools.partial(filter_wave, response=response, only_pressure=True))


def bent(wave: Wave, at: Array, values: Array) -> Wave:
    """y + delta(y) of the pressures, delta a spline through values (mmHg) at pressures (mmHg)."""
    rows = wave.is_pressure
    if not np.any(rows):
        return wave
    value = wave.value.copy()
    value[rows] += (curve(at, value[rows].ravel(), linear=True) @ values).reshape(value[rows].shape)
    return replace(wave, value=value)


def sensed_curve(case: Case, values: Array, at: Array) -> Case:
    """The reading of every pressure is a curve of it."""
    if not np.any(values):
        return case
    return with_wave(case, functools.partial(bent, at=at, values=values))


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """A filter's gain and delay, and a static curve; nothing where no pressure is observed."""
    pressures = setting.pressures
    if pressures is None:
        return ()
    span, middle = float(np.ptp(pressures)), float(np.mean(pressures))
    low, high = pressures.min() - CURVE_MARGIN * span, pressures.max() + CURVE_MARGIN * span
    readings = np.linspace(low, high, CURVE_KNOTS)
    gains, delays = setting.frequency_knots(GAIN_KNOTS), setting.frequency_knots(DELAY_KNOTS)
    return (
        free_function("sensor-filter", gains, functools.partial(sensed_gain, at=gains)),
        free_function(
            "sensor-timing", delays, functools.partial(sensed_delay, at=delays), size_of=setting.period_s
        ),
        free_function(
            "sensor-curve",
            readings,
            functools.partial(sensed_curve, at=readings),
            size_of=CURVE_MMHG + CURVE_PART * abs(middle),
            lengths_of=span,
        ),
    )
