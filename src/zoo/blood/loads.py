"""The impedance of a case's outlets, and outlets that have another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.blood.case import Case, wall_slope, with_physics
from zoo.blood.outlet_tables import response_impedance
from zoo.blood.solve_errors import SolverArgumentError
from zoo.blood.solver import CHI_WALLS
from zoo.core.arrays import Array, finite_array

Complex = NDArray[np.complex128]

PARALLEL = 6.0
"""R_p of an outlet with an inertance, in rho c/A0 of the vessel's end at rest."""
SECTIONS = 10
_RIDGE = 1e-2
"""Keeps sections small that the impedance does not tell, beside the squared relative miss of it."""
_NEGATIVE, _BUDGET = 0.9, 1e3
"""Part of R1 that negative sections may sum up to, and the weight of that."""
_LEAST = 1e-9
"""R1 at least, in all resistances of an outlet: none is refused by the solver."""
_STEADY = 1e2
"""Weight of the impedance for steady flow."""


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


def with_impedance_change(
    case: Case, omega: ArrayLike, change: ArrayLike, *, times_s: ArrayLike | None = None
) -> Case:
    """The case with outlets whose impedances are exp(change) times their own, as near as circuits come to it.

        Z'(w) = Z(w) + dR1 + sum_m r_m/(1 + i w tau_m)

    in which tau_m are the times R_k C_k of the sections that there are, and of new ones. Sections keep their
    signs, those of new ones are free, and R1 outweighs the negative ones, so that the outlets stay passive at
    every frequency. A change that no circuit has (one that is not causal, or an impedance with a negative
    real part) is not met; `outlet_impedance` of the case that comes back says how near it is.

    Parameters
    ----------
    case : Case
        Whose terminals all have a Windkessel or sections.
    omega : array (n,)
        Angular frequencies, rad/s, such as those of the first harmonics; at 0 the change is met exactly.
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
        If a value is out of range.
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
    if not np.any(wanted):
        return case
    Z = outlet_impedance(case, w)
    R1, resistance, compliance = _parts(case)
    rho, kappa = np.zeros((2, len(network.ids), resistance.shape[1] + len(times)))
    psi1 = case.psi1.copy()
    for i, k in enumerate(ends):
        own = resistance[i] != 0
        tau = np.concatenate([resistance[i, own] * compliance[i, own], times])
        first, R = _passive(Z[i], wanted[i], w, R1[i], resistance[i, own], tau)
        there = np.flatnonzero(R)
        rho[k, there] = R[there] / (case.psi2[k] * network.R2[k])
        kappa[k, there] = tau[there] / (R[there] * case.c[k] * network.C[k])
        psi1[k] = first / network.R1[k]
    if network.response_cosine is not None and network.response_sine is not None:  # psi1 is theirs, too
        kept = np.where(np.isfinite(psi1), case.psi1 / psi1, 1.0)[:, None]
        cosine, sine = kept * network.response_cosine, kept * network.response_sine
        case = replace(case, network=replace(network, response_cosine=cosine, response_sine=sine))
    return with_physics(replace(case, psi1=psi1), section_resistance=rho, section_compliance=kappa)


def _passive(
    Z: Complex, change: Complex, omega: Array, R1: float, own: Array, tau: Array
) -> tuple[float, Array]:
    """R1 and the resistances of sections with times tau (n,), of which the first are there (own).

    By the non-negative least squares of what is left of Z exp(change) over Z.
    """
    from scipy.optimize import nnls

    n, m, scale = len(own), len(tau) - len(own), R1 + float(np.abs(own).sum())
    pairs = 1 / (1 + 1j * omega[:, None] * tau)
    signs = np.where(own < 0, -1.0, 1.0)
    # what may be: R1, own sections with their sign, new ones, new ones with the other sign, and what R1 has
    # more than it must
    columns = np.concatenate(
        [
            np.ones((len(omega), 1)), pairs[:, :n] * signs, pairs[:, n:], -pairs[:, n:],
            np.zeros((len(omega), 1)),
        ],
        axis=1,
    )  # fmt: skip
    target = Z * np.exp(change) - Z + R1 + pairs[:, :n] @ own
    weights = np.where(omega == 0, _STEADY, 1.0) / np.abs(Z)
    rows, target = columns * (scale * weights)[:, None], target * weights
    negative = np.concatenate([signs < 0, np.zeros(m), np.ones(m)])
    most = max(
        _NEGATIVE, float(-own[own < 0].sum() / R1)
    )  # those there are stay as they are without a change
    budget = _BUDGET * np.concatenate([[-most], negative, [1.0]])
    start = np.concatenate([[R1], np.abs(own), np.zeros(2 * m + 1)]) / scale
    ridge = np.sqrt(_RIDGE) * np.eye(len(start))
    ridge[-1] = 0.0
    found, _ = nnls(
        np.concatenate([rows.real, rows.imag, [budget], ridge]),
        np.concatenate([target.real, target.imag, [0.0], ridge @ start]),
        maxiter=100 * len(start),
    )
    first, kept, added, taken = np.split(scale * found[:-1], [1, 1 + n, 1 + n + m])
    return max(float(first[0]), _LEAST * scale), np.concatenate([signs * kept, added - taken])
