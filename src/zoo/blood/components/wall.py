"""What the wall may lack."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case, with_physics
from zoo.blood.components.curves import curve, factors
from zoo.blood.components.setting import RADIUS, RADIUS_LENGTHS, RADIUS_UNIT, Setting
from zoo.blood.forward import stiffness_of_each_vessel
from zoo.core.components import FreeFunction

Array = NDArray[np.float64]
TIME_KNOTS = 24
TIME_SAMPLES = 256
"""Times of the beat at which the solver is told the stiffness, linear between."""
TIME_LENGTHS_BEATS = (0.05, 0.1, 0.2)
TIME_SIZE = 0.05
SCATTER_SIZE = 0.2


def scaled_stiffness(case: Case, values: Array) -> Case:
    """chi -> chi exp(v) of each vessel."""
    return replace(case, stiffness=case.stiffness * factors(values))


def scaled_stiffness_by_radius(case: Case, values: Array, basis: Array) -> Case:
    """chi -> chi exp(v), v a curve of the vessels' radii."""
    return scaled_stiffness(case, basis @ values)


def stiffness_in_time(case: Case, values: Array, at: Array) -> Case:
    """chi -> chi exp(v(t)) in all vessels at once."""
    if not np.any(values):
        return case
    period = case.network.period_s
    times = np.arange(TIME_SAMPLES) * (period / TIME_SAMPLES)
    wave = factors(curve(at, times, period=period) @ values)
    old = case.physics.stiffness_wave
    if old is not None:
        wave *= np.interp(times, np.arange(len(old)) * (period / len(old)), old, period=period)
    return with_physics(case, stiffness_wave=wave)


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """Stiffness in time, and, unless each vessel has its own already, its scatter and its trend by radius."""
    period = setting.period_s
    times: Array = np.arange(float(TIME_KNOTS)) * (period / TIME_KNOTS)
    found = [
        FreeFunction(
            "wall-in-time",
            "wall",
            times,
            TIME_SIZE,
            functools.partial(stiffness_in_time, at=times),
            "time",
            "s",
            "log stiffness",
            why="assumed: 5 %; walls creep and relax, and muscle may pull within a beat",
            lengths=tuple(part * period for part in TIME_LENGTHS_BEATS),
            period=period,
            equation="p = exp(v(t)) wall(A), v periodic, one for all vessels",
        )
    ]
    if getattr(setting.model, "stiffness", None) is stiffness_of_each_vessel:
        return tuple(found)
    found.append(
        FreeFunction(
            "stiffness-scatter",
            "wall",
            np.arange(float(len(setting.vessels))),
            SCATTER_SIZE,
            scaled_stiffness,
            "vessel",
            "1",
            "log stiffness",
            why="assumed: 20 %; the medians of 21 separate stiffnesses are nearly alike, and their common "
            "prior is a factor of 2.2 either way (Paun et al. 2020, doi 10.1098/rsif.2020.0886, models F, G)",
            labels=setting.vessels,
            equation="chi -> chi exp(v) in each vessel, independent",
        )
    )
    knots = setting.radius_knots()
    if knots is not None:
        found.append(
            FreeFunction(
                "stiffness-by-radius",
                "wall",
                knots,
                SCATTER_SIZE,
                functools.partial(scaled_stiffness_by_radius, basis=curve(knots, setting.log_radius)),
                RADIUS,
                RADIUS_UNIT,
                "log stiffness",
                why="assumed: 20 %; the distensibility of the lung's arteries hardly depends on their "
                "diameter (Krenz & Dawson 2003, doi 10.1152/ajpheart.00762.2002)",
                lengths=RADIUS_LENGTHS,
                equation="chi -> chi exp(v(log r0))",
            )
        )
    return tuple(found)
