"""Effects on the blood and its friction."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from zoo.blood.case import Case, with_offset, with_physics, with_true_lengths, with_viscosity
from zoo.blood.effects.catalogue import effect
from zoo.core.arrays import Array
from zoo.core.effects import EffectParameter, Location


def relative_viscosity(diameter_um: ArrayLike) -> Array:
    """Viscosity of blood in a tube over that of its plasma, at a haematocrit of 0.45.

    mu = 220 exp(-1.3 d) + 3.2 - 2.44 exp(-0.06 d^0.645).

    Parameters
    ----------
    diameter_um : array
        Micrometres.

    Returns
    -------
    array

    References
    ----------
    Pries et al. 1992, doi 10.1152/ajpheart.1992.263.6.H1770.
    """
    d = np.asarray(diameter_um, dtype=np.float64)
    return np.asarray(220 * np.exp(-1.3 * d) + 3.2 - 2.44 * np.exp(-0.06 * d**0.645))


LARGE_VESSEL_VISCOSITY = 3.2
"""Limit of `relative_viscosity` in wide tubes."""
GRAVITY = 980.665
"""cm/s2."""


@effect(
    "velocity-profile",
    "fluid",
    equation="alpha = (zeta + 2)/(zeta + 1), friction -2 (zeta + 2) pi nu q/A, zeta = 2/a",
    source="Alastruey et al. 2011, doi 10.1016/j.jbiomech.2011.05.041",
    signature="another loss along the tree: a shift of the mean with flow and a steeper or flatter decay",
    parameters=[EffectParameter("2/zeta", "1", 0.7, 0.05, 1.5, (1.0, 0.25), continuous=False)],
    why="from nearly flat to parabolic (1): the range of steady laminar profiles",
)
def velocity_profile(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The velocity profile is a power of the radius, not flat with a Stokes layer; parabolic at 1."""
    zeta = 2 / values[0]
    return with_physics(
        case,
        momentum_correction=(zeta + 2) / (zeta + 1),
        stokes_friction=0.0,
        viscous_friction=2 * (zeta + 2),
    )


@effect(
    "radius-dependent-viscosity",
    "fluid",
    equation="mu -> mu (1 + s (m(d)/3.2 - 1)), m = 220 exp(-1.3 d) + 3.2 - 2.44 exp(-0.06 d^0.645), d in um",
    source="Pries et al. 1992, doi 10.1152/ajpheart.1992.263.6.H1770 (haematocrit 0.45)",
    signature="a little less loss in small vessels; hardly seen, the Windkessels take it up",
    parameters=[EffectParameter("share", "1", 1.0, 0.0, 1.5, (1.0, 0.5))],
    why="1 is the published law; half as much again as its bound",
)
def radius_dependent_viscosity(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """Blood is thinner in narrow vessels (Fahraeus-Lindqvist)."""
    diameter_um = 1e4 * (case.network.radius_in_cm + case.network.radius_out_cm)
    relative = relative_viscosity(diameter_um) / LARGE_VESSEL_VISCOSITY
    return with_viscosity(case, 1 + values[0] * (relative - 1))


@effect(
    "hydrostatic",
    "fluid",
    equation="P = wall(A) + rho g s x, P = p + rho g s x the measured pressure, x the path from the root",
    source="Clark et al. 2011, doi 10.1152/japplphysiol.00775.2010 (gravity in the lung's arteries)",
    signature="distends low vessels and narrows high ones; changes wave speed and compliance along the tree",
    parameters=[EffectParameter("slope", "1", 0.5, -1.0, 1.0, (0.6, -0.6))],
    why="sine of the mean slope, -1 to 1 by definition; paths turn, so seldom near its bounds",
)
def hydrostatic(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The tree rises from the heart; pressures are a fluid-filled catheter's, its zero at the root."""
    net = with_true_lengths(case).network
    start = np.zeros(len(net.ids))
    for i, parent in enumerate(net.parent):
        if parent >= 0:
            start[i] = start[parent] + net.length_cm[parent]
    weight = net.density * GRAVITY * values[0]
    return with_offset(case, weight * start, weight * (start + net.length_cm))
