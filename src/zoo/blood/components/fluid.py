"""What the blood's friction may lack."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case, with_physics
from zoo.blood.components.curves import curve, factors
from zoo.blood.components.setting import (
    RADIUS,
    RADIUS_LENGTHS,
    RADIUS_UNIT,
    RANGE_MARGIN,
    Setting,
    range_lengths,
)
from zoo.blood.functions import FrictionFunction
from zoo.core.components import FreeFunction

Array = NDArray[np.float64]
FRICTION_KNOTS = 8
FRICTION_SIZE = 0.5
FINE_KNOTS = 33
"""Of the solver's function, so that its spline between positive values is positive."""
VISCOSITY_SIZE = 0.3


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
    factor = factors(basis @ values)
    old = case.physics.viscosity_factor
    return with_physics(case, viscosity_factor=factor if old is None else old * factor)


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """Friction by speed, and viscosity by radius; one value where all radii are alike."""
    fastest = (1 + RANGE_MARGIN) * float(np.max(np.abs(setting.beat["velocity"])))
    speeds = np.linspace(0.0, fastest, FRICTION_KNOTS)
    knots = setting.radius_knots()
    alike = knots is None
    if knots is None:
        knots = np.array([float(np.mean(setting.log_radius))])
    return (
        FreeFunction(
            "friction-law",
            "fluid",
            speeds,
            FRICTION_SIZE,
            functools.partial(scaled_friction, at=speeds),
            "speed",
            "cm/s",
            "log friction",
            why="assumed: 0.5; Poiseuille's friction is 4 delta/r times that of a flat profile with a Stokes "
            "layer of thickness delta, a factor of two to nine in a mouse's arteries",
            lengths=range_lengths(speeds),
            equation="f q/A -> exp(v(abs(u))) f q/A, u = q/A, one function for all vessels",
        ),
        FreeFunction(
            "viscosity-by-radius",
            "fluid",
            knots,
            VISCOSITY_SIZE,
            functools.partial(scaled_viscosity, basis=curve(knots, setting.log_radius)),
            RADIUS,
            RADIUS_UNIT,
            "log viscosity",
            why="assumed: 0.3; apparent viscosity falls by a tenth towards a radius of 0.13 mm and by a "
            "quarter towards 0.05 mm (Pries et al. 1992, doi 10.1152/ajpheart.1992.263.6.H1770), "
            "and the haematocrit and the shape of the velocity profile are not known",
            lengths=() if alike else RADIUS_LENGTHS,
            equation="mu -> mu exp(v(log r0))",
        ),
    )
