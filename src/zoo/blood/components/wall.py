"""What the wall may lack."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case, with_physics
from zoo.blood.components.curves import curve, factors
from zoo.blood.components.setting import (
    RADIUS,
    RADIUS_LENGTHS,
    RADIUS_UNIT,
    Setting,
    range_knots,
    range_lengths,
)
from zoo.blood.forward import stiffness_of_each_vessel
from zoo.blood.functions import WallFunction
from zoo.core.components import FreeFunction

Array = NDArray[np.float64]
LAW_KNOTS = 10
LAW_SIZE = 0.4
LAW_TABLE, FINE_KNOTS = 129, 513
"""Stretches at which the solver is told what is added to the law, and on which it is integrated."""
BELOW_REST = 0.1
"""Stretch below 1 at which that begins; a vessel may be narrower before it is periodic."""
WIDEST_PART = 0.95
"""Of the tangent wall's largest area, beyond which a curve has no knots."""
TIME_KNOTS = 24
TIME_SAMPLES = 256
"""Times of the beat at which the solver is told the stiffness, linear between."""
TIME_LENGTHS_BEATS = (0.05, 0.1, 0.2)
TIME_SIZE = 0.025
SCATTER_SIZE = 0.2


def law_slope(case: Case, stretch: Array) -> Array:
    """Derivative of the wall's law by s = sqrt(A/A0), in its scale K: 1 of the linear wall; (n,).

    That of the tangent wall, 2 b s/cos^2(b (s^2 - 1)) with b = pi/gamma, has the mean gamma of the vessels.
    """
    if case.wall == "linear":
        return np.ones_like(stretch)
    b = math.pi / float(np.mean(case.gamma))
    return np.asarray(2 * b * stretch / np.cos(b * (stretch**2 - 1)) ** 2)


def added_pressure(case: Case, at: Array, values: Array, stretch: Array) -> Array:
    """What a change v of the log slope of the law adds to it, in its scale K.

    delta(s) is the integral from 1 to s of law'(s) (exp(v(s)) - 1), v a curve, constant beyond its knots.

    Parameters
    ----------
    case : Case
        With the wall's law.
    at, values : array (n,)
        Stretches, and v there.
    stretch : array (m,)

    Returns
    -------
    array (m,)
    """
    from scipy.interpolate import CubicSpline

    ends = min(1.0, at[0], float(np.min(stretch))), max(1.0, at[-1], float(np.max(stretch)))
    fine = np.linspace(*ends, FINE_KNOTS)
    slope = law_slope(case, fine) * (factors(curve(at, fine) @ values) - 1)
    total = CubicSpline(fine, slope).antiderivative()
    return np.asarray(total(stretch) - total(1.0))


def added_law(case: Case, values: Array, at: Array) -> Case:
    """The slope of the wall's law, by stretch, times exp(v)."""
    knots = np.linspace(min(at[0], 1.0 - BELOW_REST), at[-1], LAW_TABLE)
    added = added_pressure(case, at, values, knots)
    old = case.physics.wall_function
    if old is not None and old.changes:
        knots = np.linspace(min(old.low, knots[0]), max(old.high, knots[-1]), LAW_TABLE)
        added = old(knots) + added_pressure(case, at, values, knots)
    made = WallFunction(float(knots[0]), float(knots[-1]), tuple(added))
    return with_physics(case, wall_function=made)


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
    """The law, stiffness in time, and, unless each vessel has its own already, its scatter and its trend."""
    period = setting.period_s
    stretches = range_knots(setting.beat["stretch"], LAW_KNOTS)
    if setting.case.wall != "linear":
        widest = math.sqrt(1 + WIDEST_PART * float(np.mean(setting.case.gamma)) / 2)
        stretches = np.linspace(stretches[0], min(stretches[-1], widest), LAW_KNOTS)
    times: Array = np.arange(float(TIME_KNOTS)) * (period / TIME_KNOTS)
    found = [
        FreeFunction(
            "wall-law",
            "wall",
            stretches,
            LAW_SIZE,
            functools.partial(added_law, at=stretches),
            "stretch",
            "1",
            "log stiffness",
            why="assumed: 0.4 in the logarithm of the law's slope; the tangent wall with the published "
            "1/gamma of 0.2 (Paun et al. 2020, doi 10.1098/rsif.2020.0886) is 0.3 to 0.9 above the linear "
            "one of the same stiffness at rest where arteries are stretched by 20 to 45 %",
            lengths=range_lengths(stretches),
            equation="dp/ds -> exp(v(s)) dp/ds, s = sqrt(A/A0), p = 0 at s = 1; one v for all vessels",
        ),
        FreeFunction(
            "wall-in-time",
            "wall",
            times,
            TIME_SIZE,
            functools.partial(stiffness_in_time, at=times),
            "time",
            "s",
            "log stiffness",
            why="2.5 %: a wall's radius lags little behind the pressure (Bergel 1961, "
            "doi 10.1113/jphysiol.1961.sp006687); assumed a viscous stress of a tenth of the pulsatile one, "
            "whose root mean square is a fourth of the mean; muscle is slower than a mouse's beat",
            lengths=tuple(part * period for part in TIME_LENGTHS_BEATS),
            period=period,
            equation="p = exp(v(t)) wall(A), v periodic, one for all vessels",
        ),
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
