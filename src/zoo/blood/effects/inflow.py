"""Effects on the flow into the root, or on the pressure there where a study gives that."""

from __future__ import annotations

import functools
from typing import Any

from zoo.blood.case import Case, filtered, with_inlet
from zoo.blood.effects.catalogue import effect
from zoo.blood.effects.measures import BEATS
from zoo.blood.effects.sensor_responses import delay, low_pass
from zoo.core.effects import EffectParameter, EverywhereIf, Location

_INFLOW = "Paun et al. 2020, doi 10.1098/rsif.2020.0886, takes the measured inflow as exact"
_OR_PRESSURE = "q the flow, or the pressure where that is given"


def flow_given(model: Any) -> bool:
    """Whether a model's study gives the flow into the root, and not the pressure there."""
    study = getattr(model, "study", None)
    return study is None or not study.inlet_pressure_mmHg.size


@effect(
    "inflow-gain",
    "inflow",
    equation=f"q(t) -> (1 + g) q(t), {_OR_PRESSURE}",
    source=_INFLOW,
    signature="scales pressure and flow; the baseline's stiffness and resistances take most of it up",
    parameters=[EffectParameter("gain", "1", 0.15, -0.6, 0.6, (0.15, -0.15))],
    why="error of a flow from ultrasound: 10 to 20 %",
)
def inflow_gain(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The inflow is measured too small or too large by a factor."""
    return with_inlet(case, case.inlet * (1 + values[0]))


@effect(
    "inflow-offset",
    "inflow",
    equation=f"q(t) -> q(t) + f mean(q), {_OR_PRESSURE}",
    source=_INFLOW,
    signature="a shift of the mean pressure against its pulse, which the resistances take up",
    parameters=[EffectParameter("offset", "mean", 0.1, -0.5, 0.5, (0.1, -0.1))],
    why="diastolic flow is read as 0 to within a tenth of the mean",
)
def inflow_offset(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The inflow's zero is off."""
    return with_inlet(case, case.inlet + values[0] * case.inlet.mean())


@effect(
    "inflow-shift",
    "inflow",
    equation=f"q(t) -> q(t - s), {_OR_PRESSURE}",
    source=_INFLOW + "; flow and pressure are recorded one after the other and aligned",
    signature="the whole beat moves in time; the derivative of the pressure",
    parameters=[EffectParameter("shift", "s", 0.03, -0.2, 0.2, (0.02, -0.02), measure=BEATS)],
    why="3 % of the beat: 26 ms of 845 ms in a pig (github.com/hpigot/windkessel-id, records 1, 2)",
)
def inflow_shift(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """Flow and pressure are not recorded at the same time."""
    later = functools.partial(delay, time_s=values[0])
    return with_inlet(case, filtered(case.inlet, case.network.period_s, later))


@effect(
    "inflow-bandwidth",
    "inflow",
    equation="tau dy/dt + y = q",
    source=_INFLOW,
    signature="a later, slower upstroke and a lower peak; like a catheter's resonance",
    parameters=[EffectParameter("tau", "s", 0.027, 0.0, 0.27, (0.02, 0.07), measure=BEATS)],
    why="2.7 % of the beat: a corner at the sixth harmonic, 53 Hz in a mouse",
    locations=EverywhereIf(flow_given),
)
def inflow_bandwidth(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The flow that enters is smoother than the one recorded."""
    smoother = functools.partial(low_pass, time_s=values[0])
    return with_inlet(case, filtered(case.inlet, case.network.period_s, smoother))
