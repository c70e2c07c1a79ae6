"""Causes of a known component that no catalogue lists, and that no diagnosis draws functions from.

Laws of physics, and of probes and catheters, each with a size and a shape: none is a Gaussian process or a
spline of a few knots.
"""

from __future__ import annotations

from zoo.blood.blind.causes import fluid, geometry, inflow, junctions, outlets, sensor, wall
from zoo.blood.blind.causes.cause import Cause

__all__ = ["CAUSES", "COMPONENTS", "Cause", "of_component"]

CAUSES: dict[str, Cause] = {
    one.name: one
    for part in (inflow, wall, outlets, fluid, junctions, geometry, sensor)
    for one in part.CAUSES
}
"""By name; none of these is in `zoo.blood.effects.CATALOGUE`."""
COMPONENTS = tuple(dict.fromkeys(one.component for one in CAUSES.values()))
"""Of the simulator, in which a cause may lie."""


def of_component(component: str) -> tuple[Cause, ...]:
    """The causes of a component."""
    return tuple(one for one in CAUSES.values() if one.component == component)
