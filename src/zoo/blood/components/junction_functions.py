"""What the junctions may lack."""

from __future__ import annotations

import functools

import numpy as np

from zoo.blood.case import Case, with_physics
from zoo.blood.components.curves import curve
from zoo.blood.components.declared import free_function
from zoo.blood.components.setting import Setting, range_knots, span_of
from zoo.blood.functions import JunctionFunction
from zoo.core.arrays import Array
from zoo.core.components import FreeFunction

LOSS_KNOTS = 8
FINE_KNOTS = 33
"""Of the solver's function."""


def lost_pressure(case: Case, values: Array, at: Array) -> Case:
    """D(u) = k(u) (u/U) rho U^2/2, k a curve through values at velocities (cm/s), U the largest of these."""
    velocities = np.linspace(at[0], at[-1], FINE_KNOTS)
    largest = float(np.max(np.abs(at)))
    loss = curve(at, velocities) @ values * velocities * (0.5 * case.network.density * largest)
    made = JunctionFunction(float(at[0]), float(at[-1]), tuple(loss))
    made = made.beside(case.physics.junction_function, 2 * FINE_KNOTS)
    return with_physics(case, junction_function=made)


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """The loss by velocity; nothing in a tree without junctions."""
    network = setting.case.network
    parents = np.unique(network.parent[network.parent >= 0])
    if not len(parents):
        return ()
    velocities = range_knots(np.append(setting.beat["velocity"][parents, 1], 0.0), LOSS_KNOTS)
    apply = functools.partial(lost_pressure, at=velocities)
    return (free_function("junction-loss", velocities, apply, lengths_of=span_of(velocities)),)
