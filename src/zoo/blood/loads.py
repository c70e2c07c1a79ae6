"""The impedance of a case's outlets."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.blood.case import Case, wall_slope
from zoo.blood.solve_errors import SolverArgumentError
from zoo.core.arrays import finite_array

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PARALLEL = 6.0
"""R_p of an outlet with an inertance, in rho c/A0 of the vessel's end at rest."""


def outlet_impedance(case: Case, omega: ArrayLike) -> Complex:
    """Impedance of every terminal's outlet, the pressure above that behind it over the flow.

        Z(w) = R1 + sum_k R_k/(1 + i w R_k C_k) + i w L/(1 + i w L/R_p),   R_p = 6 rho c/A0

    Parameters
    ----------
    case : Case
    omega : array (n,)
        Angular frequencies, rad/s.

    Returns
    -------
    array (n_terminals, n)
        dyn s/cm5, in the order of ``network.terminals``.

    References
    ----------
    Westerhof et al. 2009, doi 10.1007/s11517-008-0359-2.
    """
    w = 1j * finite_array("omega", omega, error=SolverArgumentError)
    network, added, ends = case.network, case.physics, case.network.terminals
    R1, resistance, compliance = _parts(case)
    Z: Complex = R1[:, None] + np.sum(
        resistance[:, :, None] / (1 + w * (resistance * compliance)[:, :, None]), axis=1
    )
    if added.inertance is None:
        return Z
    rest = np.pi * network.radius_out_cm[ends] ** 2
    speed = np.sqrt(_slope_at_outlets(case) / network.density)
    L, parallel = added.inertance[ends, None], (PARALLEL * network.density * speed / rest)[:, None]
    return np.asarray(Z + w * L / (1 + w * L / parallel))


def _parts(case: Case) -> tuple[Array, Array, Array]:
    """R1 (n_terminals,), and resistances and compliances of the sections (n_terminals, n_sections)."""
    network, added, ends = case.network, case.physics, case.network.terminals
    R1, R2, C = case.psi1 * network.R1, case.psi2 * network.R2, case.c * network.C
    rho = np.ones((len(ends), 1))
    kappa = rho
    if added.section_resistance is not None and added.section_compliance is not None:
        rho, kappa = added.section_resistance[ends], added.section_compliance[ends]
    return R1[ends], rho * R2[ends, None], kappa * C[ends, None]


def _slope_at_outlets(case: Case) -> Array:
    """dp/d(A/A0) of the terminals' ends at rest, dyn/cm2."""
    network, added, ends = case.network, case.physics, case.network.terminals
    slope = wall_slope(case)
    if added.wall_function is not None:
        scale = 4 / 3 if case.wall == "linear" else case.conventions.wall_factor
        slope = slope + 0.5 * scale * case.stiffness * added.wall_function.slope(1.0)
    if added.stiffness_ratio is not None:
        slope = slope * added.stiffness_ratio
    if added.stiffness_exponent is not None:
        slope = slope * (network.radius_in_cm / network.radius_out_cm) ** added.stiffness_exponent
    return np.asarray(slope[ends])
