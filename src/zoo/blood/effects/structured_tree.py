"""A tree of small arteries behind each outlet instead of its Windkessel."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.blood.case import Case, total_resistance
from zoo.blood.effects.catalogue import effect
from zoo.blood.effects.locations import windkessels_only
from zoo.blood.loads import outlet_impedance, with_more_impedance
from zoo.blood.outlet_tables import HARMONICS
from zoo.core.effects import EffectParameter, EverywhereIf, Location

TREE_ALPHA, TREE_BETA = 0.9, 0.6
"""Radii of the two daughters over their parent's, in the small arteries' tree."""
TREE_DEPTH = 0.1
"""The tree ends where the radius is this part of the terminal's."""


def _has_daughters(relative: float) -> bool:
    return relative >= TREE_DEPTH * (1 - 1e-9)


@functools.cache
def _tree_nodes() -> tuple[tuple[int, int, float, int], ...]:
    """Vessels of the tree by powers (i, j) of alpha and beta, smallest radii first.

    i, j, radius over the terminal's, and how many there are. Those whose radius is not below `TREE_DEPTH`
    have daughters.
    """
    many = {(0, 0): 1}
    for step in range(99):
        for i, j in [node for node in many if sum(node) == step]:
            if _has_daughters(TREE_ALPHA**i * TREE_BETA**j):
                for daughter in ((i + 1, j), (i, j + 1)):
                    many[daughter] = many.get(daughter, 0) + many[i, j]
    nodes = [(i, j, TREE_ALPHA**i * TREE_BETA**j, n) for (i, j), n in many.items()]
    return tuple(sorted(nodes, key=lambda node: node[2]))


@functools.lru_cache(maxsize=8)
def _tree_inertia(radius: tuple[float, ...], nu: float, omega: tuple[float, ...]) -> list[NDArray[Any]]:
    """1 - F of every vessel of the trees, a list of (n, m); see `tree_impedance`."""
    from scipy.special import jv

    inertia = []
    for _, _, relative, _ in _tree_nodes():
        r = np.array(radius)[:, None] * relative
        w = 1j**1.5 * r * np.sqrt(np.array(omega) / nu)
        inertia.append(1 - 2 * jv(1, w) / (w * jv(0, w)))
    return inertia


def tree_impedance(
    radius_cm: ArrayLike,
    resistance: ArrayLike,
    compliance: ArrayLike,
    density: float,
    viscosity: float,
    omega: ArrayLike,
) -> NDArray[np.complex128]:
    """Input impedance of the asymmetric tree of small arteries behind terminals.

    Every vessel of radius r has the length m r and daughters of 0.9 r and 0.6 r; one below a tenth of the
    terminal's radius has none, and the pressure at its end is 0. m and the wall's slope dp/d(A/A0), alike in
    the tree, are such that the steady resistance and the compliance of all vessels are the given ones. In a
    vessel, with F = 2 J1(w)/(w J0(w)) and w = i^1.5 r sqrt(omega/nu),

        Z(0) = (i/g tan(omega l/c) + Z(l))/(1 + i g Z(l) tan(omega l/c)),
        c^2 = slope (1 - F)/rho, g = c A0/slope,

    and 8 mu l/(pi r^4) + Z(l) at omega = 0.

    Parameters
    ----------
    radius_cm : array (n,)
        Of the terminals.
    resistance, compliance : array (n,)
        Of the whole trees, dyn s/cm5 and cm5/dyn.
    density, viscosity : float
        g/cm3 and g/(cm s).
    omega : array (m,)
        rad/s, the first of them 0.

    Returns
    -------
    complex array (n, m)
        dyn s/cm5.

    References
    ----------
    Olufsen et al. 2000, doi 10.1114/1.1326031.
    """
    root, wanted, stored = (
        np.asarray(values, dtype=np.float64)[:, None] for values in (radius_cm, resistance, compliance)
    )
    w = np.asarray(omega, dtype=np.float64)[1:]
    nodes = _tree_nodes()

    def joined(i: int, j: int, relative: float, among: Mapping[tuple[int, int], Any]) -> Any:
        """Impedance of two daughters, 0 where there are none."""
        return 1 / (1 / among[i + 1, j] + 1 / among[i, j + 1]) if _has_daughters(relative) else 0.0

    steady: dict[tuple[int, int], float] = {}  # in units of 8 mu m/(pi r^3) of the terminal's radius
    for i, j, relative, _ in nodes:
        steady[i, j] = relative**-3 + joined(i, j, relative, steady)
    volume = sum(many * relative**3 for _, _, relative, many in nodes)
    length_ratio = wanted * math.pi * root**3 / (8 * viscosity * steady[0, 0])
    slope = length_ratio * math.pi * root**3 * volume / stored

    waves: dict[tuple[int, int], NDArray[np.complex128]] = {}
    inertia = _tree_inertia(tuple(root[:, 0].tolist()), viscosity / density, tuple(w.tolist()))
    for (i, j, relative, _), inertial in zip(nodes, inertia, strict=True):
        r = root * relative
        speed = np.sqrt(slope * inertial / density)
        turn = np.tan(w * length_ratio * r / speed)
        g = speed * math.pi * r**2 / slope
        end = joined(i, j, relative, waves)
        waves[i, j] = (1j / g * turn + end) / (1 + 1j * g * end * turn)
    return np.concatenate([wanted.astype(np.complex128), waves[0, 0]], axis=1)


@effect(
    "structured-tree",
    "outflow",
    equation="Z -> (1 - s) Z + s Z_tree; daughters of 0.9 and 0.6 r, resistance and compliance as before",
    source="Olufsen et al. 2000, doi 10.1114/1.1326031",
    signature="less abrupt reflections: a smoother late systole, and a decay of many time constants",
    parameters=[EffectParameter("share", "1", 0.7, 0.0, 1.0, (0.5, 1.0))],
    why="1 is the tree alone, 0 the Windkessel alone",
    locations=EverywhereIf(windkessels_only),
)
def structured_tree(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """Behind each outlet lies a tree of small arteries, which sends waves back."""
    net, at = case.network, case.network.terminals
    omega = 2 * math.pi / net.period_s * np.arange(HARMONICS + 1)
    sizes = net.radius_out_cm[at], total_resistance(case)[at], (case.c * net.C)[at]
    tree = tree_impedance(*sizes, net.density, net.viscosity, omega)
    return with_more_impedance(case, values[0] * (tree - outlet_impedance(case, omega)))
