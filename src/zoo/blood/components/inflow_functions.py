"""What the recorded inflow may lack."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from zoo.blood.case import Case, filtered
from zoo.blood.components.curves import curve, delay_response, gain_response
from zoo.blood.components.declared import free_function
from zoo.blood.components.setting import DELAY_KNOTS, GAIN_KNOTS, Setting
from zoo.core.arrays import Array
from zoo.core.components import FreeFunction

FLOW_KNOTS = 40


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
    """An added flow, and a filter's gain and delay; none where the pressure is given."""
    if not setting.case.inflow_ml_s.size:
        return ()
    period = setting.period_s
    times: Array = np.arange(float(FLOW_KNOTS)) * (period / FLOW_KNOTS)
    gains, delays = setting.frequency_knots(GAIN_KNOTS), setting.frequency_knots(DELAY_KNOTS)
    return (
        free_function(
            "flow-record",
            times,
            functools.partial(added_flow, at=times),
            size_of=float(np.ptp(setting.case.inflow_ml_s)),
            lengths_of=period,
            period=period,
        ),
        free_function("flow-filter", gains, functools.partial(filtered_flow, at=gains)),
        free_function("flow-timing", delays, functools.partial(delayed_flow, at=delays), size_of=period),
    )
