"""Outlets that depend on the pressure, sections of both signs, and impedances, against the solver's waves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from test_physics import PERIOD, STIFFNESS, bifurcation, solver, waves
from zoo.blood.case import Case
from zoo.blood.conventions import PRINTED
from zoo.blood.functions import OutletFunction
from zoo.blood.loads import outlet_impedance, with_more_impedance
from zoo.blood.network import Network
from zoo.blood.physics import Physics
from zoo.blood.solver import SolverArgumentError, SolverOptions
from zoo.blood.units import MMHG

QUICK = SolverOptions(steps_per_beat=2048, tolerance_mmHg=1e-6, max_beats=200)
OMEGA = 2 * np.pi / PERIOD * np.arange(13)
NEGATIVE = {
    "section_resistance": np.array([[1, 0, 0], [1.1, -0.06, 0.1], [0.9, -0.05, -0.03]]),
    "section_compliance": np.array([[1, 0, 0], [1.0, -0.6, 0.3], [1.2, -0.4, -2.0]]),
}


def case(network: Network | None = None, **physics: Any) -> Case:
    network = network or bifurcation()
    time = np.arange(64) * PERIOD / 64
    one = np.ones(3)
    given = (STIFFNESS, 2 * one, 1.2 * one, 0.9 * one, 1.1 * one)
    return Case(network, time, one[0] + 0 * time, PRINTED, "linear", QUICK, Physics(**physics), *given)


def harmonics(values: Any) -> Any:
    return np.fft.rfft(values)[: len(OMEGA)]


# --- the pressure changes what is behind R1


@pytest.mark.parametrize("name", ["outlet_resistance_function", "outlet_compliance_function"])
def test_a_constant_is_another_resistance_or_compliance(name: str) -> None:
    constant = {name: OutletFunction(0.0, 3e4, [np.log(1.3)] * 4)}
    factors = {"psi2": 1.3} if "resistance" in name else {"c": 1.3}
    one = solver(options=QUICK, **constant).solve(STIFFNESS)
    other = solver(options=QUICK).solve(STIFFNESS, **factors)
    np.testing.assert_allclose(waves(one), waves(other), atol=1e-6 * np.abs(waves(other)).max())


@pytest.mark.parametrize("outside", [0.0, 3e3])
def test_the_pressure_behind_the_first_resistance_obeys_its_own_equation(outside: float) -> None:
    """C exp(g(v)) dv/dt = q - (v - p_out)/(R2 exp(f(v))), integrated by another program."""
    behind = np.array([0.0, 1e3, 2e3])
    f = OutletFunction(2e3, 2.2e4, 0.3 * np.sin(np.arange(8)))
    g = OutletFunction(2e3, 2.2e4, np.linspace(0.5, -1.0, 6))
    functions = {"outlet_resistance_function": f, "outlet_compliance_function": g}
    s = solver(
        options=SolverOptions(steps_per_beat=4096, tolerance_mmHg=1e-7, max_beats=300),
        n_times=1024,
        outflow_pressure=behind,
        offset_in=np.full(3, outside),
        offset_out=np.full(3, outside),
        **functions,
    )
    solution = s.solve(STIFFNESS)
    time = np.arange(1025) * PERIOD / 1024
    network = s.network
    for row, k in ((3, 1), (5, 2)):
        p, q = (np.append(x[row], x[row, 0]) for x in (solution.pressure_mmHg * MMHG, solution.flow_ml_s))
        v = p - network.R1[k] * q
        flow = CubicSpline(time, q, bc_type="periodic")

        def right(t: float, y: Any, flow: Any = flow, k: int = k) -> Any:
            R, C = network.R2[k] * np.exp(f(y)), network.C[k] * np.exp(g(y))
            return (flow(t) - (y - behind[k]) / R) / C

        exact = solve_ivp(right, (0, PERIOD), [v[0]], t_eval=time, rtol=1e-9, atol=1e-3, max_step=1e-3)
        assert np.ptp(v) > 500
        np.testing.assert_allclose(v, exact.y[0], atol=1e-3 * np.ptp(v))
    assert abs(solution.outflow_ml - solution.inflow_ml) < 1e-7 * solution.inflow_ml
    without = solver(options=QUICK, n_times=1024, outflow_pressure=behind).solve(STIFFNESS)
    assert np.abs(without.pressure_mmHg - solution.pressure_mmHg).max() > 0.5


@pytest.mark.parametrize(
    ("bad", "match"),
    [((0.0, 1e4, [31.0] * 4), r"values\[0\] = 31.0: must be between -30"), ((0.0, 1e4, [0.0]), "1 values")],
)
def test_what_an_outlet_cannot_have_is_named(bad: Any, match: str) -> None:
    with pytest.raises(SolverArgumentError, match=match):
        OutletFunction(*bad)


# --- impedances


@pytest.mark.parametrize("physics", [{}, NEGATIVE, {**NEGATIVE, "inertance": np.array([0.0, 30.0, 8.0])}])
def test_waves_at_the_outlets_have_the_impedance(physics: Any) -> None:
    s = solver(
        options=SolverOptions(steps_per_beat=8192, tolerance_mmHg=1e-6, max_beats=300),
        n_times=2048,
        **physics,
    )
    solution = s.solve(STIFFNESS, psi1=1.2, psi2=0.9, c=1.1)
    Z = outlet_impedance(case(**physics), OMEGA)
    assert Z.shape == (2, 13)
    for row, expected in zip((3, 5), Z, strict=True):
        p, q = harmonics(solution.pressure_mmHg[row] * MMHG), harmonics(solution.flow_ml_s[row])
        np.testing.assert_allclose(p[:8], (expected * q)[:8], atol=2e-3 * np.abs(p[1]))
    assert abs(solution.outflow_ml - solution.inflow_ml) < 1e-7 * solution.inflow_ml


def test_negative_sections_that_outweigh_the_first_resistance_are_refused() -> None:
    low = replace(bifurcation(), R1=np.array([np.nan, 1e3, 3e4]))
    with pytest.raises(SolverArgumentError, match=r"in vessel 2: the negative sections.*smaller than psi1"):
        solver(network=low, options=QUICK, **NEGATIVE).solve(STIFFNESS)
    solver(network=low, options=QUICK, **NEGATIVE).solve(STIFFNESS, psi1=6.0)


@pytest.mark.parametrize("physics", [{}, {**NEGATIVE, "inertance": np.array([0.0, 30.0, 8.0])}])
def test_waves_at_the_outlets_have_more_impedance_where_it_is_asked(physics: Any) -> None:
    """A late echo of a fifth, which no circuit of resistances and compliances has, and its half again."""
    base = case(**physics)
    w = 1j * OMEGA
    more = 0.2 * outlet_impedance(base, OMEGA) * np.exp(-0.03 * w) / (1 + w / OMEGA[4])
    changed = with_more_impedance(with_more_impedance(base, more), 0.5 * more[:, :8])
    wanted = outlet_impedance(base, OMEGA) + 1.5 * more
    np.testing.assert_allclose(outlet_impedance(changed, OMEGA)[:, :8], wanted[:, :8], rtol=1e-9)
    s = solver(
        network=changed.network,
        options=SolverOptions(steps_per_beat=8192, tolerance_mmHg=1e-6, max_beats=300),
        n_times=2048,
        **physics,
    )
    solution = s.solve(STIFFNESS, psi1=1.2, psi2=0.9, c=1.1)
    for row, expected in zip((3, 5), wanted, strict=True):
        p, q = harmonics(solution.pressure_mmHg[row] * MMHG), harmonics(solution.flow_ml_s[row])
        np.testing.assert_allclose(p[:8], (expected * q)[:8], atol=2e-3 * np.abs(p[1]))
