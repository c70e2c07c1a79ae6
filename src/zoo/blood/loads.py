"""The impedance of a case's outlets, and outlets that have another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.blood.case import Case, wall_slope
from zoo.blood.outlet_tables import response_impedance, response_of
from zoo.blood.solve_errors import SolverArgumentError
from zoo.blood.solver import CHI_WALLS
from zoo.core.arrays import Array, finite_array

Complex = NDArray[np.complex128]

PARALLEL = 6.0
"""R_p of an outlet with an inertance, in rho c/A0 of the vessel's end at rest."""


def outlet_impedance(case: Case, omega: ArrayLike) -> Complex:
    """Impedance of every terminal's outlet, the pressure above that behind it over the flow.

        Z(w) = R1 + sum_k R_k/(1 + i w R_k C_k) + i w L/(1 + i w L/R_p),   R_p = 6 rho c/A0

    and what the responses of `Network` add, psi1 sum_k (a_k (s + i w) + b_k w_k)/((s + i w)^2 + w_k^2), s =
    1/tau.

    Parameters
    ----------
    case : Case
    omega : array (n,)
        Angular frequencies, rad/s.

    Returns
    -------
    array (n_terminals, n)
        dyn s/cm5, in the order of ``network.terminals``; without what `outlet_resistance_function` and
        `outlet_compliance_function` change with the pressure.

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
    if network.response_cosine is not None and network.response_sine is not None:
        cosine, sine = network.response_cosine[ends], network.response_sine[ends]
        Z = Z + case.psi1[ends, None] * response_impedance(cosine, sine, network.period_s, w.imag)
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
        scale = 4 / 3 if case.wall in CHI_WALLS else case.conventions.wall_factor
        slope = slope + 0.5 * scale * case.stiffness * added.wall_function.slope(1.0)
    if added.stiffness_ratio is not None:
        slope = slope * added.stiffness_ratio
    if added.stiffness_exponent is not None:
        slope = slope * (network.radius_in_cm / network.radius_out_cm) ** added.stiffness_exponent
    return np.asarray(slope[ends])


def with_more_impedance(case: Case, more: ArrayLike) -> Case:
    """The case with outlets that have more impedance at the harmonics of the beat, by a response.

    Parameters
    ----------
    case : Case
    more : complex array (n_terminals, n + 1)
        At the harmonics 0 to n, dyn s/cm5; exact there. Where the sum is no passive outlet's, a solve may
        not come to a periodic state.

    Returns
    -------
    Case
        With other responses in its network.
    """
    network, ends = case.network, case.network.terminals
    n = np.shape(more)[-1]
    cosine, sine = responses = network.responses(n)
    responses[:, ends, :n] += np.array(response_of(more, network.period_s)) / case.psi1[ends, None]
    return replace(case, network=replace(network, response_cosine=cosine, response_sine=sine))
