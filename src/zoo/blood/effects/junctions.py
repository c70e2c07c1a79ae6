"""Effects on where vessels meet."""

from __future__ import annotations

from typing import Any

from zoo.blood.case import Case, with_physics
from zoo.blood.effects.catalogue import effect
from zoo.blood.effects.locations import has_junctions
from zoo.blood.physics import NO_PHYSICS
from zoo.core.effects import EffectParameter, EverywhereIf, Location


def static_pressure(model: Any) -> bool:
    """Whether vessels of a model's study meet, and share the static pressure where they do."""
    return has_junctions(model) and not getattr(model, "physics", NO_PHYSICS).total_pressure


@effect(
    "total-pressure-junctions",
    "junctions",
    equation="p + tau rho u^2/2 equal in all branches",
    source="Mynard & Valen-Sendstad 2015, doi 10.1002/cnm.2717",
    signature="a pressure step of rho u^2/2 at each junction in systole",
    parameters=[EffectParameter("share", "1", 1.0, 0.0, 1.5, (1.0, 0.5))],
    why="1 is Bernoulli's law without loss, 0 the baseline",
    locations=EverywhereIf(static_pressure),
)
def total_pressure_junctions(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """Vessels that meet share the total instead of the static pressure."""
    return with_physics(case, total_pressure=case.physics.total_pressure + values[0])


@effect(
    "minor-losses",
    "junctions",
    equation="p(daughter's inlet) = p(parent's outlet) - K rho/2 u|u|, u the parent's",
    source="Mynard & Valen-Sendstad 2015, doi 10.1002/cnm.2717",
    signature="lower distal pressure, higher proximal one, at peak flow; like taper",
    parameters=[EffectParameter("K", "1", 2.0, 0.0, 15.0, (1.5, 5.0))],
    why="losses at a branching are of the order of the dynamic pressure; more where angles are sharp",
    locations=EverywhereIf(has_junctions),
)
def minor_losses(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """Flow loses pressure where it divides."""
    return with_physics(case, junction_loss=case.physics.junction_loss + values[0])
