"""Effects on the vessels' shapes."""

from __future__ import annotations

import math

import numpy as np

from zoo.blood.case import Case, members, with_network, with_physics, with_true_lengths
from zoo.blood.effects.catalogue import effect
from zoo.blood.effects.locations import each_vessel
from zoo.core.effects import EffectParameter, Location

THROAT_RADII = 3.2
"""Length of a throat, in radii of the root; at most 0.8 of its vessel."""


@effect(
    "vessel-radius",
    "geometry",
    equation="r0 -> r0 exp(a) in one vessel",
    source="Paun et al. 2020, doi 10.1098/rsif.2020.0886, takes the radii of a micro-CT image as exact",
    signature="a reflection from both ends of the vessel; very like its stiffness",
    parameters=[EffectParameter("log-radius", "1", 0.15, -0.7, 0.7, (0.1, -0.1))],
    why="resolution of the image, and the tone that an excised lung has lost",
    locations=each_vessel,
)
def vessel_radius(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """One vessel is wider or narrower than measured."""
    factor = np.where(members(case.network, location), math.exp(values[0]), 1.0)
    net = case.network
    return with_network(
        case, radius_in_cm=net.radius_in_cm * factor, radius_out_cm=net.radius_out_cm * factor
    )


@effect(
    "vessel-length",
    "geometry",
    equation="L -> L exp(a) in one vessel",
    source="Paun et al. 2020, doi 10.1098/rsif.2020.0886, takes the lengths of a micro-CT image as exact",
    signature="moves in time what the vessel's far end sends back, and adds its volume's compliance",
    parameters=[EffectParameter("log-length", "1", 0.2, -1.0, 1.0, (0.2, -0.2))],
    why="where a vessel ends in a branching is known to about a diameter, a fifth of its length",
    locations=each_vessel,
)
def vessel_length(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """One vessel is longer or shorter than measured."""
    case = with_true_lengths(case)
    factor = np.where(members(case.network, location), math.exp(values[0]), 1.0)
    return with_network(case, length_cm=case.network.length_cm * factor)


@effect(
    "taper",
    "geometry",
    equation="r0(outlet) -> r0(outlet) (1 - t), linear from the inlet",
    source="Olufsen et al. 2000, doi 10.1114/1.1326031, has tapering vessels",
    signature="a higher and earlier peak: the pressure's reflections are spread over the vessels",
    parameters=[EffectParameter("taper", "1", 0.2, -0.5, 0.6, (0.15, -0.15))],
    why="daughters have 0.5 to 0.8 of the parent's radius, and a third of that may lie within a vessel",
)
def taper(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """Every vessel narrows towards its outlet."""
    return with_network(case, radius_out_cm=case.network.radius_out_cm * (1 - values[0]))


@effect(
    "stenosis",
    "geometry",
    equation="r0 -> r0 (1 - s (1 + cos(2 pi (x - L/2)/l))/2) within l; a loss K_t rho/2 (A0/A_t - 1)^2 u|u|",
    source="Young & Tsai 1973, doi 10.1016/0021-9290(73)90099-7 (K_t = 1.52)",
    signature="raises pressure above it while flow is large and delays what comes back from below",
    parameters=[EffectParameter("severity", "1", 0.3, 0.0, 0.85, (0.5, 0.25))],
    why="share of the radius: 0.3 halves the area",
    locations=each_vessel,
)
def stenosis(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """One vessel has a short throat in its middle."""
    inside = members(case.network, location)
    zero = np.zeros(len(inside))
    old = zero if case.physics.throat_severity is None else case.physics.throat_severity
    return with_physics(
        case,
        throat_severity=np.where(inside, 1 - (1 - old) * (1 - values[0]), old),
        throat_length=np.minimum(THROAT_RADII * case.network.radius_in_cm[0], 0.8 * case.network.length_cm),
    )
