"""Effects that no catalogue holds, so that no diagnosis can name them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.effects import Amplitude, Case, Effect, Place, with_physics

Array = NDArray[np.float64]


def active_tone(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The walls stiffen within the beat, by a smooth bump in systole."""
    phase = np.arange(256) / 256
    bump = np.where(np.abs(phase - 0.3) < 0.25, np.cos(2 * np.pi * (phase - 0.3)) ** 2, 0.0)
    return with_physics(case, stiffness_wave=1 + values[0] * bump)


def _closure(flow: Array) -> int:
    """First sample after the peak at which the inflow is below 2 % of it."""
    peak = int(np.argmax(flow))
    below = np.flatnonzero(flow[peak:] < 0.02 * flow[peak])
    return min(peak + int(below[0]) if len(below) else peak, len(flow) - 8)


def leaking_valve(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """A share of the stroke flows back through the inlet's valve in diastole."""
    flow = case.inflow_ml_s
    start = _closure(flow)
    back = np.zeros(len(flow))
    back[start:] = np.sin(np.pi * np.arange(len(flow) - start) / (len(flow) - start)) ** 2
    return replace(case, inflow_ml_s=flow - values[0] * flow.mean() * back / back.mean())


def valve_click(case: Case, values: tuple[float, ...], place: Place) -> Case:
    """The inflow rings just after the valve closes."""
    flow = case.inflow_ml_s
    since = (np.arange(len(flow)) - _closure(flow)) / len(flow)
    ring = np.where(since > 0, np.sin(2 * np.pi * 9 * since) * np.exp(-np.clip(since, 0, None) / 0.05), 0.0)
    return replace(case, inflow_ml_s=flow + values[0] * float(flow.max()) * ring)


def _outside(
    name: str, family: str, change: Callable[..., Case], equation: str, amplitude: Amplitude
) -> Effect:
    text = (change.__doc__ or "").strip()
    return Effect(
        name, (amplitude,), change, family=family, statement=text, equation=equation, source="zoo.blood.blind"
    )


OUTSIDE: dict[str, Effect] = {
    made.name: made
    for made in (
        _outside(
            "active-tone",
            "wall",
            active_tone,
            "chi -> chi (1 + a b(t)), b a bump from 0.05 to 0.55 beats",
            Amplitude("rise", "1", 0.2, 0.0, 1.0, (0.2,)),
        ),
        _outside(
            "leaking-valve",
            "inflow",
            leaking_valve,
            "q -> q - f mean(q) w(t), w in diastole, of mean 1",
            Amplitude("share", "1", 0.1, 0.0, 0.6, (0.1,)),
        ),
        _outside(
            "valve-click",
            "inflow",
            valve_click,
            "q -> q + a max(q) sin(2 pi 9 s) exp(-s/0.05), s the beats since closure",
            Amplitude("size", "peak flow", 0.1, 0.0, 0.8, (0.1,)),
        ),
    )
}
"""Not in `zoo.blood.effects.CATALOGUE`; besides them there is `second-effect`, two listed ones at once."""
