"""What the recorded inflow may lack."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case, filtered
from zoo.blood.components.curves import curve, delay_response, gain_response
from zoo.blood.components.setting import (
    DELAY_KNOTS,
    DELAY_LENGTHS,
    FREQUENCY,
    FREQUENCY_UNIT,
    GAIN_KNOTS,
    GAIN_LENGTHS,
    Setting,
)
from zoo.core.components import FreeFunction

Array = NDArray[np.float64]
FLOW_KNOTS = 40
FLOW_LENGTHS_BEATS = (0.025, 0.05, 0.1, 0.2)
FLOW_PART = 0.06
"""Of the inflow's range."""
GAIN_SIZE = 0.1
DELAY_BEATS = 0.02


def added_flow(case: Case, values: Array, at: Array) -> Case:
    """q(t) + delta(t), delta a periodic spline through values (ml/s) at times (s)."""
    added = curve(at, case.inflow_time_s, period=case.network.period_s) @ values
    return replace(case, inflow_ml_s=case.inflow_ml_s + added)


def filtered_flow(case: Case, values: Array, at: Array) -> Case:
    """The flow that enters is the recorded one through a causal filter of given log gains."""
    if not np.any(values):
        return case
    response = functools.partial(gain_response, at=at, values=values)
    return replace(case, inflow_ml_s=filtered(case.inflow_ml_s, case.network.period_s, response))


def delayed_flow(case: Case, values: Array, at: Array) -> Case:
    """The flow that enters is the recorded one, each harmonic delayed by its own time."""
    if not np.any(values):
        return case
    response = functools.partial(delay_response, at=at, values=values)
    return replace(case, inflow_ml_s=filtered(case.inflow_ml_s, case.network.period_s, response))


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """An added flow, and a filter's gain and delay."""
    period = setting.period_s
    times: Array = np.arange(float(FLOW_KNOTS)) * (period / FLOW_KNOTS)
    gains, delays = setting.frequency_knots(GAIN_KNOTS), setting.frequency_knots(DELAY_KNOTS)
    return (
        FreeFunction(
            "flow-record",
            "inflow",
            times,
            FLOW_PART * float(np.ptp(setting.case.inflow_ml_s)),
            functools.partial(added_flow, at=times),
            "time",
            "s",
            "ml/s",
            why="6 % of the record's range: systematic errors of flow by Doppler ultrasound are 6 % or less "
            "with suitable equipment, and random ones come on top (Gill 1985, "
            "doi 10.1016/0301-5629(85)90035-3)",
            lengths=tuple(part * period for part in FLOW_LENGTHS_BEATS),
            period=period,
            equation="q(t) -> q(t) + delta(t), periodic",
        ),
        FreeFunction(
            "flow-filter",
            "inflow",
            gains,
            GAIN_SIZE,
            functools.partial(filtered_flow, at=gains),
            FREQUENCY,
            FREQUENCY_UNIT,
            "log gain",
            why="assumed: a tenth in the gain of a harmonic; records are smoothed and means of many beats",
            lengths=GAIN_LENGTHS,
            equation="q_k -> H(f_k) q_k, log|H| free, H causal, H(0) = 1",
        ),
        FreeFunction(
            "flow-timing",
            "inflow",
            delays,
            DELAY_BEATS * period,
            functools.partial(delayed_flow, at=delays),
            FREQUENCY,
            FREQUENCY_UNIT,
            "s",
            why="assumed: 2 % of a beat, what two records aligned by their upstrokes or by the ECG may "
            "differ",
            lengths=DELAY_LENGTHS,
            equation="q_k -> exp(-2 pi i f_k tau(f_k)) q_k",
        ),
    )
