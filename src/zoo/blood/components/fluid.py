"""What the blood's friction may lack."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case, with_physics
from zoo.blood.components.curves import curve, factors
from zoo.blood.components.setting import RADIUS, RADIUS_LENGTHS, RADIUS_UNIT, Setting
from zoo.core.components import FreeFunction

Array = NDArray[np.float64]
VISCOSITY_SIZE = 0.3


def scaled_viscosity(case: Case, values: Array, basis: Array) -> Case:
    """mu -> mu exp(v), v a curve of the vessels' radii."""
    factor = factors(basis @ values)
    old = case.physics.viscosity_factor
    return with_physics(case, viscosity_factor=factor if old is None else old * factor)


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """Viscosity by radius; one value where all radii are alike."""
    knots = setting.radius_knots()
    alike = knots is None
    if knots is None:
        knots = np.array([float(np.mean(setting.log_radius))])
    return (
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
