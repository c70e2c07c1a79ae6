"""Effects on what lies behind the outlets; the tree of small arteries is in `structured_tree`."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zoo.blood.case import (
    Case,
    members,
    total_resistance,
    with_more,
    with_offset,
    with_physics,
    with_true_lengths,
    with_wave,
)
from zoo.blood.effects.catalogue import effect
from zoo.blood.effects.locations import sides_and_terminals, windkessels_only
from zoo.blood.effects.measures import TERMINAL_RADII
from zoo.blood.effects.sensor_responses import add_to_pressures
from zoo.core.arrays import Array
from zoo.core.effects import EffectError, EffectParameter, EverywhereIf, Location


def ladder_sections(n: int) -> tuple[Array, Array]:
    """Foster form of a ladder of n equal sections, each C/n to ground, then R2/n on to the next.

    The nodes obey (C/n) dv/dt + (n/R2) T v = q e1 with T tridiagonal, so with eigenvalues l_k and
    eigenvectors u_k of T the impedance is the sum of R_k/(1 + i w R_k C_k), R_k = R2 u_k1^2/(n l_k) and
    C_k = C/(n u_k1^2).

    Parameters
    ----------
    n : int
        From 1, which is the Windkessel.

    Returns
    -------
    array (n,)
        rho, R_k/R2; they add up to 1.
    array (n,)
        kappa, C_k/C.
    """
    matrix = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    matrix[0, 0] = 1
    values, vectors = np.linalg.eigh(matrix)
    weight = n * vectors[0] ** 2
    return weight / (n**2 * values), 1 / weight


def sections_of(case: Case) -> tuple[Array, Array]:
    """Sections of every vessel's outlet, (n_vessels, n_sections); one, the Windkessel, unless changed."""
    old = case.physics
    if old.section_resistance is None or old.section_compliance is None:
        ones = np.ones((len(case.network.ids), 1))
        return ones, ones
    return old.section_resistance, old.section_compliance


def blended_sections(parts: Sequence[tuple[float | Array, Array, Array]]) -> dict[str, Array]:
    """Sections of a weighted sum of impedances: R_k weight, C_k/weight; those of no weight are left out."""
    rho = np.concatenate([weight * rho for weight, rho, _ in parts], axis=1)
    with np.errstate(divide="ignore"):
        kappa = np.concatenate([kappa / weight for weight, _, kappa in parts], axis=1)
    kept = np.any(rho != 0, axis=0)
    rho, kappa = rho[:, kept], kappa[:, kept]
    return {"section_resistance": rho, "section_compliance": np.where(rho == 0, 1.0, kappa)}


@effect(
    "venous-pressure",
    "outflow",
    equation="p - p_v = R1 q + v, C dv/dt = q - v/R2",
    source="Qureshi et al. 2014, doi 10.1007/s10237-014-0563-y (2 mmHg in the left atrium)",
    signature="the same mean with a smaller resistance: a faster diastolic decay towards p_v",
    parameters=[EffectParameter("p_v", "mmHg", 5.0, -10.0, 20.0, (5.0,))],
    why="2 to 12 mmHg in the atrium; below 0 only where the zero of the pressure is off",
)
def venous_pressure(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The Windkessels end at the left atrium's pressure instead of 0."""
    offset = np.full(len(case.network.ids), -values[0] * case.conventions.mmhg)
    return with_wave(
        with_offset(case, offset, offset), functools.partial(add_to_pressures, amount_mmHg=values[0])
    )


@effect(
    "uneven-resistance",
    "outflow",
    equation="R1, R2 -> R1 exp(a), R2 exp(a) on that side and exp(-a) on the other; or at one terminal",
    source="Qureshi et al. 2018, doi 10.1007/s10237-018-1078-8 (nominal shares by Poiseuille's law)",
    signature="flow moves to the other side; seen in flows and distal pressures more than at the root",
    parameters=[EffectParameter("log-resistance", "1", 0.5, -2.0, 2.0, (0.6, -0.6))],
    why="a nominal share goes with r^4: 12 % of the radius is 0.5 in its logarithm",
    locations=sides_and_terminals,
)
def uneven_resistance(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """One side of the tree, or one outlet, has more resistance than its nominal share."""
    otherwise = -values[0] if location.subtree else 0.0
    factor = np.exp(np.where(members(case.network, location), values[0], otherwise))
    return replace(case, psi1=case.psi1 * factor, psi2=case.psi2 * factor)


@effect(
    "terminal-inertance",
    "outflow",
    equation="p = v + R1 q + L dq/dt, L = rho l/A0 of the terminal, with 6 rho c/A0 parallel to L",
    source="Westerhof et al. 2009, doi 10.1007/s11517-008-0359-2",
    signature="high harmonics are reflected at the outlets; ripples after the upstroke",
    parameters=[EffectParameter("length", "cm", 30.0, 0.0, 120.0, (6.0, 18.0), measure=TERMINAL_RADII)],
    why="a small artery is 15 to 60 radii long (Colebank 2025, doi 10.1371/journal.pcbi.1013553)",
)
def terminal_inertance(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """Blood behind the outlets has inertia."""
    net = case.network
    added = np.zeros(len(net.ids))
    added[net.terminals] = net.density * values[0] / (math.pi * net.radius_out_cm[net.terminals] ** 2)
    return with_more(case, "inertance", added)


@effect(
    "side-branches",
    "outflow",
    equation="A_t + q_x = -G r0^m p; its sum over the tree is g times the sum of 1/(psi1 R1 + psi2 R2)",
    source="Olufsen et al. 2000, doi 10.1114/1.1326031 (the tree is cut where the image ends)",
    signature="a smaller resistance in all; waves are damped on their way",
    parameters=[
        EffectParameter("conductance", "1", 0.3, 0.0, 3.0, (0.3, 1.0)),
        EffectParameter(
            "exponent",
            "1",
            1.0,
            -1.0,
            4.0,
            (1.0,),
            "as many for each area of wall (1), give or take: for each length it is 0, for each volume 2",
            centre=1.0,
            zero_is_base=False,
        ),
    ],
    why="a few tenths of the terminals' conductance: most branches of this size are in the image",
)
def side_branches(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """Branches too small for the image leave the vessels all along."""
    net = with_true_lengths(case).network
    total = values[0] * np.sum(1 / total_resistance(case)[net.terminals])
    density = (0.5 * (net.radius_in_cm + net.radius_out_cm)) ** values[1]
    added = total * density / np.sum(density * net.length_cm)
    return with_more(case, "leak", added)


@effect(
    "distributed-outflow",
    "outflow",
    equation="R1, then n times (C/n to ground, R2/n onward); its impedance is linear in n between whole n",
    source="Olufsen & Nadim 2004, Math. Biosci. Eng. 1, 61-80 (lumped models of downstream trees)",
    signature="less compliance for fast waves: a slower late decay with a higher pulse",
    parameters=[EffectParameter("n - 1", "sections", 4.0, 0.0, 15.0, (2.0, 6.0))],
    why="beyond about 5 sections a ladder is near its limit, a transmission line",
    locations=EverywhereIf(windkessels_only),
)
def distributed_outflow(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """Compliance and resistance behind an outlet alternate in n sections instead of one."""
    if values[0] < 0:
        raise EffectError(f"effect distributed-outflow: n - 1 = {values[0]}: must not be negative")
    whole = math.floor(values[0])
    part = values[0] - whole
    n_vessels = len(case.network.ids)
    parts: list[tuple[float | Array, Array, Array]] = []
    for weight, n in ((1 - part, whole + 1), (part, whole + 2)):
        if weight:
            rho, kappa = ladder_sections(n)
            parts.append((weight, np.tile(rho, (n_vessels, 1)), np.tile(kappa, (n_vessels, 1))))
    return with_physics(case, **blended_sections(parts))
