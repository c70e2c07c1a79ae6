"""What the blood's friction may lack."""

from __future__ import annotations

import functools

import numpy as np

from zoo.blood.case import Case, with_physics, with_viscosity
from zoo.blood.components.curves import curve, factors
from zoo.blood.components.declared import free_function
from zoo.blood.components.setting import RANGE_MARGIN, Setting, span_of
from zoo.blood.functions import FrictionFunction
from zoo.core.arrays import Array
from zoo.core.components import FreeFunction

FRICTION_KNOTS = 8
FINE_KNOTS = 33
"""Of the solver's function, so that its spline between positive values is positive."""


def scaled_friction(case: Case, values: Array, at: Array) -> Case:
    """Friction times exp(v(abs(u))), v a curve through values at speeds (cm/s)."""
    speeds = np.linspace(at[0], at[-1], FINE_KNOTS)
    factor = factors(curve(at, speeds) @ values)
    old = case.physics.friction_function
    if old is not None and old.changes:
        factor = factor * old(speeds)
    made = FrictionFunction(float(at[0]), float(at[-1]), tuple(factor))
    return with_physics(case, friction_function=made)


def scaled_viscosity(case: Case, values: Array, basis: Array) -> Case:
    """mu -> mu exp(v), v a curve of the vessels' radii."""
    return with_viscosity(case, factors(basis @ values))


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """Friction by speed, and viscosity by radius; one value where all radii are alike."""
    fastest = (1 + RANGE_MARGIN) * float(np.max(np.abs(setting.beat["velocity"])))
    speeds = np.linspace(0.0, fastest, FRICTION_KNOTS)
    knots = setting.radius_knots()
    if knots is None:
        knots = np.array([float(np.mean(setting.log_radius))])
    basis = curve(knots, setting.log_radius)
    return (
        free_function(
            "friction-law", speeds, functools.partial(scaled_friction, at=speeds), lengths_of=span_of(speeds)
        ),
        free_function("viscosity-by-radius", knots, functools.partial(scaled_viscosity, basis=basis)),
    )
