"""Friction of the blood."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.causes.cause import cause, ramp
from zoo.blood.case import Case, with_physics
from zoo.blood.functions import FrictionFunction

Array = NDArray[np.float64]
FASTEST, KNOTS = 200.0, 401
"""Speed (cm/s) to which a table of a factor goes, and its knots."""


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


def _with_factor(case: Case, factor: Callable[[Array], Array]) -> Case:
    """Friction times a factor of the blood's speed (cm/s)."""
    speed = np.linspace(0.0, FASTEST, KNOTS)
    return with_physics(case, friction_function=FrictionFunction(0.0, FASTEST, tuple(factor(speed))))


@cause(
    "power-law-blood",
    "fluid",
    "1",
    (0.05, 1.2),
    equation="friction times ((u^2 + u_0^2)/u_r^2)^(-a/2)",
    source="Pedley 1980, The Fluid Mechanics of Large Blood Vessels (blood is thinner at higher shear)",
    least=(1.0, 5.0),
    reference=(8.0, 25.0),
)
def power_law_blood(case: Case, size: float, *, least: float, reference: float) -> Case:
    """Blood gets thinner the faster it flows, by a power."""
    return _with_factor(case, lambda u: ((u**2 + least**2) / reference**2) ** (-size / 2))


@cause(
    "disturbed-flow",
    "fluid",
    "1",
    (0.1, 10.0),
    equation="friction times 1 + a (w/u_c) log(1 + exp((u - u_c)/w)), w = u_c/10",
    source="Young and Tsai 1973, doi 10.1016/0021-9290(73)90099-7 (losses beyond a critical speed)",
    critical=(12.0, 35.0),
)
def disturbed_flow(case: Case, size: float, *, critical: float) -> Case:
    """Beyond a critical speed the flow is disturbed and rubs more."""
    width = critical / 10
    return _with_factor(case, lambda u: 1 + size * width / critical * ramp((u - critical) / width))


@cause(
    "aggregating-cells",
    "fluid",
    "1",
    (0.3, 12.0),
    equation="friction times 1 + a/(1 + (u/u_c)^2)",
    source="Chien 1970, doi 10.1126/science.168.3934.977 (red cells aggregate at low shear)",
    critical=(1.5, 10.0),
)
def aggregating_cells(case: Case, size: float, *, critical: float) -> Case:
    """Blood that hardly moves is thicker."""
    return _with_factor(case, lambda u: 1 + size / (1 + (u / critical) ** 2))


CAUSES = (viscous_small_vessels, power_law_blood, disturbed_flow, aggregating_cells)
