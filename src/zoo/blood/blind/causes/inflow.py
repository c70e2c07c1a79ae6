"""Errors of the recorded inflow: what enters is the record and something more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.causes.cause import bump, cause, phases
from zoo.blood.case import Case

Array = NDArray[np.float64]


def _with(case: Case, added: Array) -> Case:
    return replace(case, inflow_ml_s=case.inflow_ml_s + added)


def _peak(flow: Array) -> float:
    return float(np.argmax(flow) / len(flow))


@cause(
    "late-saturation",
    "inflow",
    "1",
    (0.02, 0.6),
    equation="q_true = q (1 + a h(t) (q/q_max)^m), h from 0 to 1 within a few per cent of a beat about peak",
    power=(1.0, 3.0),
    rise=(0.01, 0.04),
    delay=(-0.02, 0.04),
)
def late_saturation(case: Case, size: float, *, power: float, rise: float, delay: float) -> Case:
    """The probe reads too little of the flow from the peak on, the less the larger it is."""
    flow = case.inflow_ml_s
    since = phases(len(flow)) - _peak(flow) - delay
    share = np.clip(flow / flow.max(), 0.0, None) ** power
    on = 0.5 * (1 + np.tanh(since / rise)) * 0.5 * (1 - np.tanh((since - 0.5) / rise))
    return _with(case, size * flow * share * on)


@cause(
    "baseline-reset",
    "inflow",
    "peak flow",
    (0.004, 0.25),
    equation="q_true = q + a q_max (s(t) - 1/2), s a saw-tooth over the beat, reset in a few per cent of it",
    at=(0.5, 0.95),
    reset=(0.01, 0.05),
    sign=(-1.0, 1.0),
)
def baseline_reset(case: Case, size: float, *, at: float, reset: float, sign: float) -> Case:
    """The zero of the probe drifts within each beat and is set back once in it."""
    flow = case.inflow_ml_s
    since = np.mod(phases(len(flow)) - at, 1.0)
    saw = np.where(since < reset, 0.5 + 0.5 * np.cos(np.pi * since / reset), (since - reset) / (1 - reset))
    return _with(case, np.copysign(size, sign) * flow.max() * (saw - saw.mean()))


@cause(
    "probe-ringing",
    "inflow",
    "1",
    (0.1, 2.5),
    equation="q = q_true + a k * q', k(s) = exp(-s/tau) sin(2 pi f s)/f, the edges' ringing",
    cycles=(8.0, 25.0),
    decay=(0.02, 0.08),
)
def probe_ringing(case: Case, size: float, *, cycles: float, decay: float) -> Case:
    """The probe rings after fast edges; the record holds that, and the flow does not."""
    flow = case.inflow_ml_s
    harmonic = 2j * np.pi * np.arange(len(flow) // 2 + 1)
    turn = 2 * np.pi * cycles
    kernel = turn / ((harmonic + 1 / decay) ** 2 + turn**2)
    rung = np.fft.irfft(np.fft.rfft(flow) * harmonic * kernel, len(flow))
    return _with(case, -size * rung)


@cause(
    "closing-backflow",
    "inflow",
    "peak flow",
    (0.02, 0.8),
    equation="q_true = q - a q_max b(t), b a bump of height 1 after the end of ejection",
    after=(0.28, 0.5),
    width=(0.015, 0.05),
)
def closing_backflow(case: Case, size: float, *, after: float, width: float) -> Case:
    """Some blood flows back while the valve closes, which the averaged record does not hold."""
    flow = case.inflow_ml_s
    return _with(case, -size * flow.max() * bump(phases(len(flow)), _peak(flow) + after, width))


CAUSES = (late_saturation, baseline_reset, probe_ringing, closing_backflow)
