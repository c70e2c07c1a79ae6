"""Effects on how waves are recorded."""

from __future__ import annotations

import functools

from zoo.blood.case import Case, with_wave
from zoo.blood.effects.catalogue import effect
from zoo.blood.effects.measures import BEATS
from zoo.blood.effects.sensor_responses import (
    add_to_pressures,
    filter_wave,
    jitter,
    resonance,
    scale_pressures,
)
from zoo.core.effects import EffectParameter, Location


@effect(
    "catheter-resonance",
    "sensor",
    equation="y'' + 2 z w y' + w^2 y = w^2 p, w = 2 pi f_n",
    source="Gardner 1981, doi 10.1097/00000542-198103000-00010",
    signature="overshoot and ringing after the upstroke and the incisura, or a lag when damped",
    parameters=[
        EffectParameter("1/f_n", "s", 0.14, 0.0, 0.73, (0.09, 0.27), measure=BEATS),
        EffectParameter(
            "damping",
            "1",
            0.2,
            0.02,
            1.5,
            (0.3,),
            "catheters are mostly underdamped, 0.1 to 0.6",
            centre=0.3,
            zero_is_base=False,
        ),
    ],
    why="a resonance at the 7th harmonic, 8 Hz in man: lines fall from 18 to 7 Hz (Anesthesiology 92, 208)",
)
def catheter_resonance(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The catheter is a mass on a spring."""
    response = functools.partial(resonance, natural_period_s=values[0], damping=values[1])
    return with_wave(case, functools.partial(filter_wave, response=response, only_pressure=True))


@effect(
    "sensor-gain",
    "sensor",
    equation="p -> (1 + g) p",
    source="Gardner 1981, doi 10.1097/00000542-198103000-00010 (calibration of the transducer)",
    signature="scales the pressures; at one sensor the baseline's stiffness and resistances take it up",
    parameters=[EffectParameter("gain", "1", 0.1, -0.5, 0.5, (0.1, -0.1))],
    why="a calibration is good to a tenth at worst",
)
def sensor_gain(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The pressures are recorded too small or too large by a factor."""
    return with_wave(case, functools.partial(scale_pressures, gain=values[0]))


@effect(
    "sensor-offset",
    "sensor",
    equation="p -> p + p_0",
    source="Gardner 1981, doi 10.1097/00000542-198103000-00010 (levelling and zeroing of the transducer)",
    signature="a constant; the resistances take it up but for the vessels' width; almost external-pressure",
    parameters=[EffectParameter("offset", "mmHg", 2.0, -10.0, 10.0, (2.0, -2.0))],
    why="2.7 cm of height between transducer and heart; drift of a day",
)
def sensor_offset(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The pressures' zero is off."""
    return with_wave(case, functools.partial(add_to_pressures, amount_mmHg=values[0]))


@effect(
    "beat-jitter",
    "sensor",
    equation="y -> y * normal(0, sd) in time, around the beat",
    source="definition: the mean of copies shifted by normal(0, sd)",
    signature="lower peak, slower upstroke, shallower incisura; mean and phase unchanged",
    parameters=[EffectParameter("sd", "s", 0.036, 0.0, 0.18, (0.018, 0.055), measure=BEATS)],
    why="3.6 % of the beat: beats at rest differ by a few per cent of their length",
)
def beat_jitter(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The recorded beat is a mean of beats that were not aligned."""
    response = functools.partial(jitter, sd_s=values[0])
    return with_wave(case, functools.partial(filter_wave, response=response, only_pressure=False))
