"""What lies behind the outlets: circuits that are neither a Windkessel nor a listed tree."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.causes.cause import PATTERNS, cause, picked
from zoo.blood.case import Case, with_physics
from zoo.blood.effects.outflow import blended_sections, sections_of

Array = NDArray[np.float64]
SPREAD = 0.25
"""Between time constants of neighbouring sections of a constant-phase element, in their logarithm."""
SHORTEST, LONGEST = -5.0, 2.0
"""Logarithms of the least and largest time constant over R2 C."""
LADDER = 8


def constant_phase_sections(lack: float) -> tuple[float, Array, Array]:
    """Sections of R2/(1 + (i w R2 C)^(1 - lack)), by its distribution of time constants.

    Cole and Cole's distribution of x = log(tau/(R2 C)), sin(a pi)/(2 pi (cosh((1 - a) x) - cos(a pi))) with
    a the lack, in steps of `SPREAD`; what is faster than the shortest is a resistance.

    Parameters
    ----------
    lack : float
        1 - order, in (0, 1).

    Returns
    -------
    float
        Resistance without compliance, in units of R2.
    array (n,), array (n,)
        rho and kappa, as `Physics` has them.

    References
    ----------
    Cole and Cole 1941, doi 10.1063/1.1750906.
    """
    x = np.arange(round(-60 / SPREAD), round(60 / SPREAD) + 1) * SPREAD
    fine = x[:, None] + SPREAD * (np.arange(16) + 0.5 - 8) / 16
    density = np.sin(lack * np.pi) / (np.cosh((1 - lack) * fine) - np.cos(lack * np.pi))
    weight = density.mean(axis=1)
    weight /= weight.sum()
    held = (x >= SHORTEST) & (x <= LONGEST)
    rho = weight[held]
    rho[-1] += weight[x > LONGEST].sum()
    return float(weight[x < SHORTEST].sum()), rho, np.exp(x[held]) / rho


@functools.cache
def tapering_ladder(resistance: float, compliance: float, n: int = LADDER) -> tuple[Array, Array]:
    """Sections of a ladder whose resistances and compliances change by a factor from node to node.

    C_k dv_k/dt = (v_(k-1) - v_k)/R_(k-1) - (v_k - v_(k+1))/R_k, R_k = R_1 resistance^k, C_k alike; the first
    node is fed, the last drains. With eigenvalues l and vectors u of C^(-1/2) G C^(-1/2), Z is the sum of
    (u_1^2/C_1)/(l + i w).

    Parameters
    ----------
    resistance, compliance : float
        Factors from a node to the next.
    n : int

    Returns
    -------
    array (n,), array (n,)
        rho and kappa, in units of the whole resistance and compliance.
    """
    R, C = resistance ** np.arange(n), compliance ** np.arange(n)
    g, C = R.sum() / R, C / C.sum()
    G = np.diag(g) + np.diag(np.concatenate([[0.0], g[:-1]])) - np.diag(g[:-1], 1) - np.diag(g[:-1], -1)
    root = 1 / np.sqrt(C)
    values, vectors = np.linalg.eigh(root[:, None] * G * root)
    weight = vectors[0] ** 2 / C[0]
    return weight / values, 1 / weight


@cause(
    "constant-phase",
    "outlets",
    "1 - order",
    (0.03, 0.6),
    equation="Z = R1 + R2/(1 + (i w R2 C)^(1 - a)), by 29 sections",
    source="Cole and Cole 1941, doi 10.1063/1.1750906",
)
def constant_phase(case: Case, size: float) -> Case:
    """Resistance and compliance behind the outlets have a time constant of every length."""
    fast, rho, kappa = constant_phase_sections(abs(size))
    net, shape = case.network, (len(case.network.ids), 1)
    psi1 = case.psi1.copy()
    at = net.terminals
    psi1[at] += fast * (case.psi2 * net.R2)[at] / net.R1[at]
    changed = with_physics(
        case, section_resistance=np.tile(rho, shape), section_compliance=np.tile(kappa, shape)
    )
    return replace(changed, psi1=psi1)


@cause(
    "tapering-ladder",
    "outlets",
    "share",
    (0.05, 1.0),
    equation="Z = (1 - a) Z_3 + a Z_l, Z_l of a ladder of 8 nodes with R_k+1 = x R_k, C_k+1 = y C_k",
    source="Westerhof et al. 1969, doi 10.1016/0021-9290(69)90024-4 (ladders of a branching tree)",
    resistance=(0.3, 0.75),
    compliance=(1.3, 2.2),
)
def tapering_ladder_outlets(case: Case, size: float, *, resistance: float, compliance: float) -> Case:
    """Behind each outlet resistance lies near and compliance far, in generations."""
    rows = (len(case.network.ids), 1)
    rho, kappa = (np.tile(x, rows) for x in tapering_ladder(resistance, compliance))
    return with_physics(case, **blended_sections([(1 - size, *sections_of(case)), (size, rho, kappa)]))


@cause(
    "blocked-outlets",
    "outlets",
    "1",
    (0.2, 3.0),
    equation="R1, R2 -> exp(a) R1, exp(a) R2 and C -> exp(-a/2) C at two to four outlets",
    outlets=(2.0, 4.999),
    pattern=(0.0, PATTERNS),
)
def blocked_outlets(case: Case, size: float, *, outlets: float, pattern: float) -> Case:
    """A few outlets are blocked in part."""
    terminals = case.network.terminals
    some = picked(terminals, min(int(outlets), len(terminals) - 1), pattern)
    psi1, psi2, c = case.psi1.copy(), case.psi2.copy(), case.c.copy()
    psi1[some] *= np.exp(size)
    psi2[some] *= np.exp(size)
    c[some] *= np.exp(-size / 2)
    return replace(case, psi1=psi1, psi2=psi2, c=c)


CAUSES = (constant_phase, tapering_ladder_outlets, blocked_outlets)
