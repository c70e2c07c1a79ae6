"""Effects on the wall."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from zoo.blood.case import Case, members, wall_slope, with_more
from zoo.blood.effects.catalogue import effect
from zoo.blood.effects.locations import vessels_and_subtrees
from zoo.blood.effects.measures import BEATS, MEAN_RADII
from zoo.core.effects import EffectError, EffectParameter, Location

CONSTANT = ("linear-constant", "tangent-constant")
LINEAR = ("linear-constant", "linear-radius", "linear-vessels")
SHARED = ("linear-constant", "linear-radius", "tangent-constant", "tangent-radius")
"""Baselines whose vessels do not each have a stiffness of their own."""


@effect(
    "tangent-wall",
    "wall",
    equation="p = k chi_t tan(pi/gamma (A/A0 - 1)), k chi_t pi/gamma = (2/3) chi",
    source="Paun et al. 2020, doi 10.1098/rsif.2020.0886, eq. (3.4)",
    signature="higher, narrower peaks: waves run faster at high pressure",
    parameters=[EffectParameter("1/gamma", "1", 0.5, 0.02, 1.2, (0.2, 0.7), continuous=False)],
    why="models H and I allow 1/gamma from 0.16 to 1; the published medians are 0.19 and 0.20",
    baselines=LINEAR,
)
def tangent_wall(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The wall stiffens as it is stretched: eq. (3.4) with the linear wall's stiffness at rest."""
    if case.wall == "tangent":
        raise EffectError("effect tangent-wall: the case has a tangent wall already; use a linear baseline")
    gamma = 1 / values[0]
    stiffness = wall_slope(case) * gamma / (math.pi * case.conventions.wall_factor)
    return replace(case, wall="tangent", stiffness=stiffness, gamma=np.full(len(stiffness), gamma))


@effect(
    "radius-dependent-stiffness",
    "wall",
    equation="chi -> chi (1 + a exp(-(r0 - r_min)/l)), r_min the smallest radius of the tree",
    source="Olufsen et al. 2000, doi 10.1114/1.1326031; Paun et al. 2020, doi 10.1098/rsif.2020.0886, (3.5)",
    signature="stronger, earlier reflections from the periphery; smaller pulse volume of the small vessels",
    parameters=[
        EffectParameter("excess", "1", 1.0, -0.9, 8.0, (1.0, -0.4)),
        EffectParameter(
            "decay",
            "cm",
            0.27,
            0.14,
            2.7,
            (0.74,),
            "model I's median f2 is -6 per 0.1 cm where the mean radius is 0.22 mm, and a third either way",
            centre=0.74,
            zero_is_base=False,
            measure=MEAN_RADII,
        ),
    ],
    why="the narrowest vessels twice as stiff as wide ones; model I's medians give 1.3",
    baselines=CONSTANT,
)
def radius_dependent_stiffness(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """Narrow vessels are stiffer than wide ones, eq. (3.5)."""
    radius = case.network.radius_in_cm
    return replace(
        case, stiffness=case.stiffness * (1 + values[0] * np.exp(-(radius - radius.min()) / values[1]))
    )


@effect(
    "local-stiffness",
    "wall",
    equation="chi -> chi exp(a) in one vessel or subtree",
    source="Paun et al. 2020, doi 10.1098/rsif.2020.0886, models F and G (a stiffness for each vessel)",
    signature="a reflection at the ends of the stiff part, the sooner the nearer",
    parameters=[EffectParameter("log-stiffness", "1", 0.7, -2.5, 2.5, (0.5, -0.5))],
    why="a factor of two; models F and G allow each vessel 2e4 to 1e5, a factor of 2.2 either way",
    locations=vessels_and_subtrees,
    baselines=SHARED,
)
def local_stiffness(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """One vessel, or one vessel and all below it, is stiffer or softer than the rest."""
    factor = np.where(members(case.network, location), math.exp(values[0]), 1.0)
    return replace(case, stiffness=case.stiffness * factor)


@effect(
    "viscoelastic-wall",
    "wall",
    equation="p = p_e + tau dp_e/dt, p_e the elastic wall's pressure",
    source="Alastruey et al. 2011, doi 10.1016/j.jbiomech.2011.05.041",
    signature="damps high harmonics, the more the farther the wave has run; pressure leads area",
    parameters=[EffectParameter("tau", "s", 0.027, 0.0, 0.27, (0.018, 0.072), measure=BEATS)],
    why="pressure leads area by 2 pi tau/T in the first harmonic: 0.17 rad",
)
def viscoelastic_wall(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The wall resists fast stretching (Kelvin-Voigt)."""
    return with_more(case, "viscoelastic_time", np.full(len(case.network.ids), values[0]))
