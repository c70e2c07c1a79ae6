"""What the wall may lack."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np

from zoo.blood.blood_flow import stiffness_of_each_vessel
from zoo.blood.case import Case, with_physics
from zoo.blood.components.curves import curve, factors
from zoo.blood.components.declared import free_function
from zoo.blood.components.setting import Setting, range_knots, span_of
from zoo.blood.functions import WallFunction
from zoo.core.arrays import Array
from zoo.core.components import FreeFunction

LAW_KNOTS = 10
LAW_TABLE, FINE_KNOTS = 129, 513
"""Stretches at which the solver is told what is added to the law, and on which it is integrated."""
BELOW_REST = 0.1
"""Stretch below 1 at which that begins; a vessel may be narrower before it is periodic."""
WIDEST_PART = 0.95
"""Of the tangent wall's largest area, beyond which a curve has no knots."""
TIME_KNOTS = 24
TIME_SAMPLES = 256
"""Times of the beat at which the solver is told the stiffness, linear between."""


def law_slope(case: Case, stretch: Array) -> Array:
    """Derivative of the wall's law by s = sqrt(A/A0), in its scale K; (n,).

    It is 1 of the linear wall and 1/s^2 of Olufsen's.
    That of the tangent wall, 2 b s/cos^2(b (s^2 - 1)) with b = pi/gamma, has the mean gamma of the vessels.
    """
    if case.wall == "linear":
        return np.ones_like(stretch)
    if case.wall == "olufsen":
        return np.asarray(1 / stretch**2)
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
    if setting.case.wall == "tangent":
        widest = math.sqrt(1 + WIDEST_PART * float(np.mean(setting.case.gamma)) / 2)
        stretches = np.linspace(stretches[0], min(stretches[-1], widest), LAW_KNOTS)
    times: Array = np.arange(float(TIME_KNOTS)) * (period / TIME_KNOTS)
    found = [
        free_function(
            "wall-law", stretches, functools.partial(added_law, at=stretches), lengths_of=span_of(stretches)
        ),
        free_function(
            "wall-in-time",
            times,
            functools.partial(stiffness_in_time, at=times),
            lengths_of=period,
            period=period,
        ),
    ]
    if getattr(setting.model, "stiffness", None) is stiffness_of_each_vessel:
        return tuple(found)
    vessels = setting.vessels
    found.append(
        free_function("stiffness-scatter", np.arange(float(len(vessels))), scaled_stiffness, labels=vessels)
    )
    knots = setting.radius_knots()
    if knots is not None:
        apply = functools.partial(scaled_stiffness_by_radius, basis=curve(knots, setting.log_radius))
        found.append(free_function("stiffness-by-radius", knots, apply))
    return tuple(found)
