"""Friction of the blood."""

from __future__ import annotations

from zoo.blood.blind.causes.cause import cause
from zoo.blood.case import Case, with_physics


@cause(
    "viscous-small-vessels",
    "fluid",
    "1",
    (0.3, 2.5),
    equation="mu -> mu (r_root/r)^a",
)
def viscous_small_vessels(case: Case, size: float) -> Case:
    """Blood is thicker the narrower the vessel."""
    net = case.network
    radius = 0.5 * (net.radius_in_cm + net.radius_out_cm)
    factor = (radius.max() / radius) ** size
    old = case.physics.viscosity_factor
    return with_physics(case, viscosity_factor=factor if old is None else old * factor)


CAUSES = (viscous_small_vessels,)
