"""The solver against analytic solutions, conservation, the published solver, and itself on finer grids."""

import gzip
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from test_physics import pulse
from zoo.blood.conventions import PRINTED, PUBLISHED_CODE
from zoo.blood.network import Network
from zoo.blood.solver import (
    CFLError,
    CollapseError,
    NotPeriodicError,
    Solver,
    SolverArgumentError,
    SolverError,
    SolverOptions,
    WallLimitError,
)
from zoo.blood.study import Blood, Vessel, Windkessel, load_study
from zoo.blood.units import MMHG

BLOOD = Blood(density_g_cm3=1.055, viscosity_g_cm_s=0.049)
THIN = Blood(density_g_cm3=1.055, viscosity_g_cm_s=1e-9)
A_MEDIANS = {"stiffness": 5.17e4, "psi1": 0.21, "psi2": 0.88, "c": 1.44}
H_MEDIANS = {"stiffness": 9.17e4, "gamma": 5.18, "psi1": 0.37, "psi2": 0.94, "c": 1.60}


def vessel(id, length, radius, parent=None, windkessel=None, radius_out=None):
    out = radius if radius_out is None else radius_out
    return Vessel(id, f"v{id}", length, radius, out, parent, windkessel)


def mouse(wall="linear", conventions=PRINTED, n_times=256, flow=None, **options):
    """The mouse tree with a smooth inflow, at the inlet and outlet of all vessels."""
    study = load_study("demo")
    flow = 0.55 * pulse(8192, study.period_s, 0.058) if flow is None else flow
    network = Network.from_study(study)
    series = [(int(v), x) for v in network.ids for x in (0.0, 1.0)]
    times = np.arange(n_times) * study.period_s / n_times
    time = np.arange(len(flow)) * study.period_s / len(flow)
    given = {"wall": wall, "conventions": conventions, "options": SolverOptions(**options)}
    return Solver(network, time, flow, series=series, times_s=times, **given)


def steadily(network, q, **given):
    """The solver of a steady inflow."""
    return Solver(network, np.arange(16) * network.period_s / 16, np.full(16, q), **given)


# --- analytic solutions


@pytest.mark.parametrize("pieces", [1, 8])
@pytest.mark.parametrize("wall", ["linear", "tangent", "olufsen"])
def test_steady_flow_has_the_pressure_of_the_steady_equation(wall, pieces):
    """Constant inflow: (A/rho dp/dA - q^2/A^2) dA/dx = -f(A) q, from the outlet's R q back to the inlet.

    Also where the vessel is cut into pieces: the friction of the half cells that meet is that of any other.
    """
    q, length, period = 0.3, 4.0, 0.11
    loads = Windkessel(R1=2e4, R2=3e4, C=2e-6)
    chain = [
        vessel(i, length / pieces, 0.05, i - 1 or None, loads if i == pieces else None)
        for i in range(1, pieces + 1)
    ]
    network = Network.from_vessels(chain, BLOOD, period)
    positions = np.linspace(0, 1, 9)
    series = [(i, x * pieces - i + 1) for x in positions for i in (min(int(x * pieces) + 1, pieces),)]
    solver = steadily(network, q, wall=wall, series=series, times_s=[0.0, 0.05])
    stiffness, gamma = 8e4, 4.0
    solution = solver.solve(stiffness, gamma)

    rho, nu = 1.055, 0.049 / 1.055
    delta, A0 = np.sqrt(nu * period / (2 * np.pi)), np.pi * 0.05**2

    def area_at(p):
        if wall == "linear":
            return A0 * (1 + 3 * p / (4 * stiffness)) ** 2
        if wall == "olufsen":
            return A0 / (1 - 3 * p / (4 * stiffness)) ** 2
        return A0 * (1 + gamma / np.pi * np.arctan(p / stiffness))

    def slope(A):
        if wall == "linear":
            return 2 / 3 * stiffness / np.sqrt(A * A0)
        if wall == "olufsen":
            return 2 / 3 * stiffness * np.sqrt(A0) / A**1.5
        return stiffness * np.pi / (gamma * A0) / np.cos(np.pi / gamma * (A / A0 - 1)) ** 2

    def right(x, A):
        friction = 2 * np.pi * nu * np.sqrt(A / np.pi) / delta / A
        return -friction * q / (A / rho * slope(A) - q**2 / A**2)

    p_out = (loads.R1 + loads.R2) * q
    backwards = (positions * length)[::-1]
    exact = solve_ivp(right, (length, 0), [area_at(p_out)], rtol=1e-10, atol=1e-14, t_eval=backwards)
    np.testing.assert_allclose(solution.area_cm2[:, 0], exact.y[0][::-1], rtol=2e-5)
    np.testing.assert_allclose(solution.pressure_mmHg[-1], p_out / MMHG, rtol=1e-6)
    np.testing.assert_allclose(solution.flow_ml_s, q, rtol=1e-6)


def small_waves(vessels, series, *, period=0.4, stiffness=5e4, amplitude=1e-3):
    """Harmonics of pressure (dyn/cm2) and flow of a small pulse on a small mean flow, without friction."""
    network = Network.from_vessels(vessels, THIN, period)
    n = 2048
    flow = 1e-3 + amplitude * pulse(n, period, 0.1)
    times = np.arange(n) * period / n
    options = SolverOptions(tolerance_mmHg=1e-7)
    s = Solver(network, times, flow, series=series, times_s=times, options=options).solve(stiffness)
    area = s.area_cm2.mean(axis=1)
    A0 = np.array([np.pi * network.radius_in_cm[network.index(v)] ** 2 for v, _ in series])
    speed = np.sqrt(2 / 3 * stiffness / 1.055 * np.sqrt(area / A0))
    p = np.fft.rfft(s.pressure_mmHg * MMHG, axis=1)[:, 1:9]
    q = np.fft.rfft(s.flow_ml_s, axis=1)[:, 1:9]
    return p, q, 1.055 * speed / area, speed, 2 * np.pi * np.arange(1, 9) / period


def matched(radius, stiffness=5e4):
    """A load that reflects almost nothing: R1 = rho c/A, and a large compliance behind it."""
    area = np.pi * radius**2
    return Windkessel(R1=1.055 * np.sqrt(2 / 3 * stiffness / 1.055) / area, R2=1.0, C=1.0)


def test_pulse_wave_speed():
    """A small pulse travels at c = sqrt(A/rho dp/dA)."""
    vessels = [vessel(1, 12.0, 0.05, windkessel=matched(0.05))]
    p, _, _, speed, omega = small_waves(vessels, [(1, 0.1), (1, 0.6)])
    phase = np.unwrap(np.angle(p[0] / p[1]))
    assert np.allclose(6.0 * omega / phase, speed[0], rtol=0.002)


def test_reflection_at_a_bifurcation():
    """Gamma = (Y0 - Y1 - Y2)/(Y0 + Y1 + Y2), Y = A/(rho c), from the waves at the parent's end."""
    daughters = [vessel(i, 3.0, r, 1, matched(r)) for i, r in ((2, 0.03), (3, 0.02))]
    p, q, z, _, _ = small_waves([vessel(1, 3.0, 0.05), *daughters], [(1, 1.0), (2, 0.0), (3, 0.0)])
    expected = (1 / z[0] - 1 / z[1] - 1 / z[2]) / (1 / z).sum()
    backward, forward = p[0] - z[0] * q[0], p[0] + z[0] * q[0]
    assert expected > 0.3
    np.testing.assert_allclose(backward / forward, expected, rtol=0.01)


def test_reflection_at_a_windkessel():
    """Gamma = (Z - Zc)/(Z + Zc) with Z = R1 + R2/(1 + i w R2 C), harmonic by harmonic."""
    load = Windkessel(R1=1e4, R2=6e4, C=5e-7)
    p, q, z, _, omega = small_waves([vessel(1, 3.0, 0.05, windkessel=load)], [(1, 1.0)])
    impedance = load.R1 + load.R2 / (1 + 1j * omega * load.R2 * load.C)
    expected = (impedance - z[0]) / (impedance + z[0])
    measured = (p[0] - z[0] * q[0]) / (p[0] + z[0] * q[0])
    np.testing.assert_allclose(np.abs(measured - expected) / np.abs(expected), 0, atol=0.01)


@pytest.mark.parametrize("wall", ["linear", "tangent"])
def test_steady_flow_in_a_tapered_vessel_obeys_bernoulli(wall):
    """Without friction p + rho u^2/2 is the same everywhere, whatever the taper."""
    load, q = Windkessel(R1=2e4, R2=2e4, C=1e-6), 0.2
    tapered = vessel(1, 1.0, 0.05, windkessel=load, radius_out=0.04)
    network = Network.from_vessels([tapered], THIN, 0.11)
    series = [(1, x) for x in np.linspace(0, 1, 7)]
    options = SolverOptions(tolerance_mmHg=1e-7, max_beats=500)
    solver = steadily(network, q, wall=wall, series=series, times_s=[0.0], options=options)
    s = solver.solve(1e5, gamma=4.0)
    dynamic = 0.5 * 1.055 * (s.flow_ml_s / s.area_cm2)[:, 0] ** 2
    assert np.ptp(dynamic) > 300.0
    total = s.pressure_mmHg[:, 0] * MMHG + dynamic
    np.testing.assert_allclose(total, total[-1], atol=1e-3 * np.ptp(dynamic))
    np.testing.assert_allclose(s.pressure_mmHg[-1], q * (load.R1 + load.R2) / MMHG, rtol=1e-6)


# --- conservation and periodicity


@pytest.mark.parametrize(("wall", "values"), [("linear", A_MEDIANS), ("tangent", H_MEDIANS)])
def test_mass_over_a_beat_and_at_every_junction(wall, values):
    solver = mouse(wall, tolerance_mmHg=1e-7, n_times=4096)
    s = solver.solve(**values)
    net, flow = solver.network, s.flow_ml_s.reshape(len(solver.network.ids), 2, -1)
    assert abs(s.outflow_ml - s.inflow_ml) < 1e-9 * s.inflow_ml
    ends = flow[net.terminals, 1].sum(axis=0).mean() * net.period_s
    assert abs(ends - flow[0, 0].mean() * net.period_s) < 1e-6 * s.inflow_ml
    peak = np.abs(flow).max()
    for k in range(len(net.ids)):
        children = net.children(k)
        if len(children):
            lost = flow[k, 1] - flow[children, 0].sum(axis=0)
            assert np.abs(lost).max() < 1e-10 * peak


def test_the_beat_repeats_itself_and_pressure_falls_towards_the_periphery():
    loose, tight = mouse().solve(**A_MEDIANS), mouse(tolerance_mmHg=1e-8, max_beats=200).solve(**A_MEDIANS)
    assert loose.distance_mmHg < 2e-3 < 1.0
    assert np.abs(loose.pressure_mmHg - tight.pressure_mmHg).max() < 4e-3
    mean = tight.pressure_mmHg.mean(axis=1).reshape(-1, 2)
    assert np.all(mean[:, 1] < mean[:, 0])


def test_extrapolation_reaches_the_state_of_plain_beats_in_fewer():
    tight = {"tolerance_mmHg": 1e-6, "max_beats": 200}
    plain, fast = (mouse(accelerate=a, **tight).solve(**A_MEDIANS) for a in (False, True))
    np.testing.assert_allclose(fast.pressure_mmHg, plain.pressure_mmHg, atol=5e-6)
    assert fast.beats < plain.beats


def test_extrapolation_follows_decays_over_hundreds_of_beats():
    """Plain beats take 2,522 to come as near."""
    slow = A_MEDIANS | {"c": 1000.0}
    plain, fast = (
        mouse(accelerate=a, tolerance_mmHg=1e-4, max_beats=m).solve(**slow)
        for a, m in ((False, 3000), (True, 100))
    )
    np.testing.assert_allclose(fast.pressure_mmHg, plain.pressure_mmHg, atol=2e-4)
    assert abs(fast.outflow_ml - fast.inflow_ml) < 1e-4 * fast.inflow_ml


@settings(max_examples=15, deadline=None)
@given(st.data())
def test_any_tree_conserves_mass(data):
    """Random trees: what flows in flows out, and the pressure is a number."""
    n = data.draw(st.integers(1, 9))
    parents = [None] + [data.draw(st.integers(1, i)) for i in range(1, n)]
    terminal = [i + 1 not in parents[i + 1 :] for i in range(n)]
    radius = [data.draw(st.floats(0.012, 0.05)) for _ in range(n)]
    vessels = []
    for i, r in enumerate(radius):
        length, out = data.draw(st.floats(0.05, 0.6)), data.draw(st.floats(0.8, 1.0)) * r
        load = Windkessel(R1=3e2 / r**2, R2=1.2e3 / r**2, C=8e-5 * r**2) if terminal[i] else None
        vessels.append(vessel(i + 1, length, r, parents[i], load, out))
    network = Network.from_vessels(vessels, BLOOD, 0.11)
    area = min(np.pi * r**2 for r in radius)
    flow = 60.0 * area * (0.2 + pulse(256, 0.11, 0.06))
    wall = data.draw(st.sampled_from(["linear", "tangent"]))
    given = {"wall": wall, "series": [(1, 0.0)], "options": SolverOptions(tolerance_mmHg=1e-5)}
    solver = Solver(network, np.arange(256) * 0.11 / 256, flow, times_s=[0.0, 0.05], **given)
    s = solver.solve(data.draw(st.floats(5e4, 2e5)), gamma=4.0)
    assert np.all(np.isfinite(s.pressure_mmHg))
    assert abs(s.outflow_ml - s.inflow_ml) < 1e-5 * s.inflow_ml
    assert s.junction_defect_ml_s < 1e-12


# --- the discretisation


@pytest.mark.parametrize(("wall", "values"), [("linear", A_MEDIANS), ("tangent", H_MEDIANS)])
@pytest.mark.parametrize("conventions", [PRINTED, PUBLISHED_CODE], ids=lambda c: c.name)
def test_order_of_convergence_on_the_full_tree(wall, values, conventions):
    grids = [
        mouse(wall, conventions, refine=r, steps_per_beat=2048, tolerance_mmHg=1e-7).solve(**values)
        for r in (1, 2, 4)
    ]
    for name in ("pressure_mmHg", "flow_ml_s"):
        coarse, middle, fine = (getattr(g, name) for g in grids)
        order = np.log2(np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine))
        assert order > 1.8, (name, order)


def test_default_accuracy():
    """Within 0.015 mmHg in the MPA of a four times finer grid at a tight periodic state."""
    for wall, values in (("linear", A_MEDIANS), ("tangent", H_MEDIANS)):
        default = mouse(wall).solve(**values)
        fine = mouse(wall, refine=4, tolerance_mmHg=1e-7).solve(**values)
        assert np.abs(default.pressure_mmHg - fine.pressure_mmHg)[0].max() < 0.015


# --- the published solver


def published(study):
    """The published solver's waveforms: (times, pressure, flow), rows v1 inlet, v1 outlet, v2 inlet, ..."""
    path = Path(os.environ["ZOO_DATA_DIR"]) / "reference" / "linear_constant_A.csv.gz"
    with gzip.open(path) as file:
        table = np.loadtxt(file, delimiter=",", skiprows=1)
    pressure, flow = table[:, 1::2].T, table[:, 2::2].T
    # that program writes row k after step 16 (k + 1): its inlet flow is that sample, to the digit
    sample = 16 * (np.arange(512) + 1) % 8192
    np.testing.assert_allclose(flow[0], study.inflow_ml_s[sample], atol=1e-6)
    return sample * study.period_s / 8192, pressure, flow


@pytest.mark.needs_data
def test_waveforms_of_the_published_solver():
    study = load_study("mouse-c6")
    times, pressure, flow = published(study)
    series = [(v, x) for v in range(1, 22) for x in (0.0, 1.0)]
    s = Solver.for_study(study, series=series, times_s=times).solve(**A_MEDIANS)
    rms = np.sqrt(np.mean((s.pressure_mmHg - pressure) ** 2, axis=1))
    assert rms[:2].max() <= 0.01
    assert rms.max() <= 0.03
    assert np.abs(s.flow_ml_s - flow).max() < 2e-3


@pytest.mark.needs_data
def test_sum_of_squared_errors_at_the_published_medians_of_model_a():
    study = load_study("mouse-c6")
    s = Solver.for_study(study).solve(**A_MEDIANS)
    assert np.sum((s.pressure_mmHg[0] - study.values[0]) ** 2) == pytest.approx(64.6, abs=2.5)


@pytest.mark.needs_data
@pytest.mark.parametrize("name", ["friction", "truncate_lengths", "mmhg", "sample_lag_beats"])
def test_each_switch_of_the_conventions_matters(name):
    study = load_study("mouse-c6")
    both = [
        Solver.for_study(study, conventions=c).solve(**A_MEDIANS).pressure_mmHg[0]
        for c in (PUBLISHED_CODE, PUBLISHED_CODE.replace(**{name: getattr(PRINTED, name)}))
    ]
    assert np.abs(both[0] - both[1]).max() > (0.005 if name == "mmhg" else 0.05)


# --- threads, times


def test_threads_share_a_solver():
    solver = mouse()
    values = np.linspace(4e4, 8e4, 8)
    alone = [solver.solve(v).pressure_mmHg for v in values]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda v: solver.solve(v).pressure_mmHg, values))
    np.testing.assert_array_equal(alone, together)


def test_samples_do_not_depend_on_the_order_of_times():
    solver = mouse()
    times = np.array([0.05, 0.0, 0.11, 0.02, 0.16])
    beat = solver.network, solver.inflow_time_s, solver.inflow_ml_s
    p = Solver(*beat, series=[(1, 0.0)], times_s=times).solve(**A_MEDIANS).pressure_mmHg[0]
    assert p[0] == p[4]  # one period later
    assert p[1] == pytest.approx(p[2], abs=5e-3)


# --- failures


def test_failures_raise_named_errors_that_say_what_to_change():
    with pytest.raises(SolverArgumentError, match="one per vessel"):
        mouse().solve(np.ones(5))
    with pytest.raises(NotPeriodicError, match="max_beats"):
        mouse(max_beats=1).solve(5e4)
    with pytest.raises(CFLError, match="steps_per_beat"):
        mouse(steps_per_beat=256).solve(5e4)
    failed = mouse(max_beats=1).solve(5e4, check=False)
    assert not failed.ok
    assert np.isnan(failed.pressure_mmHg).all()
    assert "beats" in failed.reason
    backflow = 0.02 + 0.9 * np.sin(np.linspace(0, 2 * np.pi, 512, endpoint=False))
    with pytest.raises((CollapseError, SolverError), match="vessel"):
        mouse(flow=backflow).solve(2e4)


def test_wall_limit_is_a_status_of_its_own():
    """A soft tangent wall under a load far above what it can hold runs into its largest area."""
    solver = mouse("tangent", flow=30 * 0.55 * pulse(1024, 0.11, 0.058), max_steps=16384)
    with pytest.raises((WallLimitError, CFLError)):
        solver.solve(500.0, gamma=1.0, psi1=5, psi2=20, c=0.05)
