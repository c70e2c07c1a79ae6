"""Pressure that is lost where vessels meet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.causes.cause import cause, ramp
from zoo.blood.case import Case, with_physics
from zoo.blood.functions import JunctionFunction

Array = NDArray[np.float64]
FASTEST, KNOTS = 200.0, 801
"""Velocity (cm/s) to which a table of a loss goes either way, and its knots."""
REFERENCE = 40.0
"""cm/s, at which laws of other powers lose what the square does."""
WIDTH = 2.0
"""cm/s, over which flow begins to separate."""


def _with_loss(case: Case, loss: Callable[[Array], Array]) -> Case:
    """A loss in units of rho/2 u^2 (cm/s, squared)."""
    velocity = np.linspace(-FASTEST, FASTEST, KNOTS)
    lost = 0.5 * case.network.density * loss(velocity)
    return with_physics(case, junction_function=JunctionFunction(-FASTEST, FASTEST, tuple(lost)))


def _power(u: Array, power: float) -> Array:
    return np.asarray(np.sign(u) * REFERENCE**2 * (np.abs(u) / REFERENCE) ** power)


@cause(
    "steep-loss",
    "junctions",
    "1",
    (0.05, 8.0),
    equation="D = a rho/2 u_r^2 sign(u) (abs(u)/u_r)^m, m from 2.8 to 4.5",
    power=(2.8, 4.5),
)
def steep_loss(case: Case, size: float, *, power: float) -> Case:
    """Junctions lose more than with the square of the velocity."""
    return _with_loss(case, lambda u: size * _power(u, power))


@cause(
    "flat-loss",
    "junctions",
    "1",
    (0.05, 8.0),
    equation="D = a rho/2 u_r^2 sign(u) (abs(u)/u_r)^m, m from 1 to 1.4",
    power=(1.0, 1.4),
)
def flat_loss(case: Case, size: float, *, power: float) -> Case:
    """Junctions lose little more than in proportion to the velocity, as slow viscous flow does."""
    return _with_loss(case, lambda u: size * _power(u, power))


@cause(
    "separating-flow",
    "junctions",
    "1",
    (0.1, 12.0),
    equation="D = a rho/2 (w log(1 + exp((u - u_c)/w)))^2, w = 2 cm/s: nothing below u_c, nothing backwards",
    critical=(12.0, 35.0),
)
def separating_flow(case: Case, size: float, *, critical: float) -> Case:
    """Beyond a critical velocity the flow separates where it divides."""
    return _with_loss(case, lambda u: size * (WIDTH * ramp((u - critical) / WIDTH)) ** 2)


CAUSES = (steep_loss, flat_loss, separating_flow)
