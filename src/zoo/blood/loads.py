"""The impedance of a case's outlets, and outlets that have another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.blood.case import Case, wall_slope, with_physics
from zoo.blood.solve_errors import SolverArgumentError
from zoo.core.arrays import finite_array

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PARALLEL = 6.0
"""R_p of an outlet with an inertance, in rho c/A0 of the vessel's end at rest."""
SECTIONS = 10
_SMALL = 1e-9
_RIDGES = (1e-3, 3e-3, 1e-2, 3e-2)
"""Price of a section as large as R1, beside the relative miss of an impedance, the least that serves."""
_NEGATIVE = 10.0
"""How many times a negative section costs a positive one."""


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


def with_impedance_change(
    case: Case, omega: ArrayLike, change: ArrayLike, *, times_s: ArrayLike | None = None
) -> Case:
    """The case with outlets whose impedances are exp(change) times their own, as near as circuits come to it.

        Z'(w) = Z(w) + dR1 + sum_m r_m/(1 + i w tau_m)

    in which tau_m are the times R_k C_k of the sections that there are, and of new ones, and r_m of either
    sign, by least squares of what is left of Z'/Z at the frequencies and a little of r_m/R1. A change that no
    circuit has (one that is not causal, or an impedance with a negative real part) is not met;
    `outlet_impedance` of the case that comes back says how near it is.

    Parameters
    ----------
    case : Case
        Whose terminals all have a Windkessel or sections.
    omega : array (n,)
        Angular frequencies, rad/s, such as those of the first harmonics; 0 for the steady resistance.
    change : array (n,) or (n_terminals, n)
        Complex change of log Z, of all terminals or of each.
    times_s : array (m,)
        tau_m of the new sections; ten from a third of the shortest 1/omega to ten times the longest if
        absent.

    Returns
    -------
    Case
        With other `psi1`, and sections in its physics.

    Raises
    ------
    SolverArgumentError
        If a value is out of range, or the negative sections together are no smaller than R1.
    """
    w = finite_array("omega", omega, error=SolverArgumentError)
    network, ends = case.network, case.network.terminals
    if not np.all(network.R2[ends] > 0):
        raise SolverArgumentError("outlets: one is a single resistance without sections; give it R2 and C")
    if times_s is None:
        moving = w[w > 0]
        if not moving.size:
            raise SolverArgumentError(f"omega = {w.tolist()}: must have a positive one; give harmonics")
        times = np.geomspace(0.33 / moving.max(), 10.0 / moving.min(), SECTIONS)
    else:
        times = finite_array("times_s", times_s, error=SolverArgumentError)
        if not np.all(times > 0):
            raise SolverArgumentError(f"times_s = {times.tolist()}: must be positive; correct them")
    wanted = np.broadcast_to(np.asarray(change, dtype=np.complex128), (len(ends), len(w)))
    Z = outlet_impedance(case, w)
    R1, resistance, compliance = _parts(case)
    n = resistance.shape[1]
    first = np.empty(len(ends))
    rho, kappa = np.zeros((2, len(network.ids), n + len(times)))
    for i, k in enumerate(ends):
        tau = np.concatenate([resistance[i] * compliance[i], times])
        parts = np.concatenate([np.ones((1, len(w))), 1 / (1 + 1j * w * tau[:, None])])
        already = np.abs(resistance[i]) / R1[i]
        found = _passive(Z[i], np.expm1(wanted[i]), parts, R1[i], resistance[i], already)
        if found is None:
            raise SolverArgumentError(
                f"change: at the outlet of vessel {int(network.ids[k])} negative sections would be larger "
                "than R1; make it smaller"
            )
        first[i], R = found[0], found[1:]
        R[:n] += resistance[i]
        there = (R != 0) & (tau > 0)
        rho[k, there] = R[there] / (case.psi2[k] * network.R2[k])
        kappa[k, there] = tau[there] / (R[there] * case.c[k] * network.C[k])
    psi1 = case.psi1.copy()
    psi1[ends] += first / network.R1[ends]
    return with_physics(replace(case, psi1=psi1), section_resistance=rho, section_compliance=kappa)


def _passive(
    Z: Complex, change: Complex, parts: Complex, R1: float, there: Array, already: Array
) -> Array | None:
    """Changes of R1 and of all sections, dyn s/cm5; None where none keeps R1 above the negative sections."""
    from scipy.optimize import nnls

    n, size = len(already), np.abs(Z)
    relative = parts * R1 / size
    columns = np.concatenate([relative.real, relative.imag], axis=1).T
    target = np.concatenate([(Z * change / size).real, (Z * change / size).imag])
    for ridge in _RIDGES:
        # positive and negative parts apart: no two sections that cancel each other
        price = np.full((2, len(parts)), ridge)
        price[1] *= _NEGATIVE
        price[:, 1 : 1 + n] /= np.maximum(already, _SMALL)
        rows = np.concatenate([np.concatenate([columns, -columns], axis=1), np.diag(price.ravel())])
        both, _ = nnls(rows, np.concatenate([target, np.zeros(price.size)]), maxiter=1000)
        found = R1 * (both[: len(parts)] - both[len(parts) :])
        found[np.abs(found) < _SMALL * R1] = 0.0
        after = found[1:].copy()
        after[:n] += there
        if R1 + found[0] + np.minimum(after, 0.0).sum() > 0:
            return np.asarray(found)
    return None
