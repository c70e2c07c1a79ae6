"""What `Physics` adds to the equations, against closed forms, steady equations and the base."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from walls import wall_pressure_mmHg
from zoo.blood.functions import FrictionFunction, JunctionFunction, WallFunction
from zoo.blood.network import Network
from zoo.blood.solver import Physics, Solver, SolverArgumentError, SolverOptions
from zoo.blood.study import Blood, Vessel, Windkessel, load_study
from zoo.blood.units import MMHG

RHO, MU = 1.055, 0.049
BLOOD = Blood(density_g_cm3=RHO, viscosity_g_cm_s=MU)
PERIOD = 0.11
STIFFNESS, GAMMA = np.array([5e4, 6e4, 5.5e4]), np.array([4.0, 4.5, 5.0])
FINE = SolverOptions(steps_per_beat=2048, tolerance_mmHg=1e-7, max_beats=200)
WALLS = ("linear", "tangent")


def pulse(n, period, width):
    """One smooth bump per period, C-infinity, zero elsewhere."""
    t = np.arange(n) / n * period
    x = np.clip(t / width, 1e-9, 1 - 1e-9)
    return np.where(t < width, np.exp(4.0 - 1.0 / (x * (1.0 - x))), 0.0)


def bifurcation(radius=(0.05, 0.035, 0.03)):
    loads = Windkessel(R1=2e4, R2=8e4, C=1e-6), Windkessel(R1=3e4, R2=1.2e5, C=6e-7)
    vessels = [
        Vessel(1, "parent", 0.5, radius[0], 0.96 * radius[0], None, None),
        Vessel(2, "left", 0.4, radius[1], radius[1], 1, loads[0]),
        Vessel(3, "right", 0.3, radius[2], 0.9 * radius[2], 1, loads[1]),
    ]
    return Network.from_vessels(vessels, BLOOD, PERIOD)


ENDS = [(1, 0.0), (1, 1.0), (2, 0.0), (2, 1.0), (3, 0.0), (3, 1.0)]


def solver(wall="linear", *, network=None, options=FINE, series=ENDS, n_times=256, **physics):
    network = network or bifurcation()
    n = 4096
    return Solver(
        network,
        np.arange(n) * PERIOD / n,
        0.05 + 0.45 * pulse(n, PERIOD, 0.06),
        wall=wall,
        series=series,
        times_s=np.arange(n_times) * PERIOD / n_times,
        options=options,
        physics=Physics(**physics) if physics else None,
    )


def waves(solution):
    return np.stack([solution.pressure_mmHg, solution.flow_ml_s, solution.area_cm2])


VISCOUS = {"stokes_friction": 0.0, "viscous_friction": 8.0}
ADDED = {
    "momentum_correction": {"momentum_correction": 4 / 3},
    "friction": VISCOUS | {"viscosity_factor": np.array([1.0, 1.4, 0.7])},
    "offset": {"offset_in": np.array([0.0, 2e3, -2e3]), "offset_out": np.array([2e3, 3e3, -4e3])},
    "stiffness_wave": {"stiffness_wave": 1.0 + 0.2 * np.sin(2 * np.pi * np.arange(4096) / 4096 + 0.7)},
    "viscoelastic": {"viscoelastic_time": np.array([6e-4, 3e-4, 9e-4])},
    "leak": {"leak": np.array([1e-6, 0.0, 2e-6])},
    "total_pressure": {"total_pressure": 1.0},
    "junction_loss": {"junction_loss": 3.0},
    "both at the junction": {"total_pressure": 1.0, "junction_loss": 15.0},
    "inertance": {"inertance": np.array([0.0, 60.0, 2.0])},
    "long inertance": {"inertance": np.array([0.0, 820.0, 1300.0])},  # of 3 cm
    "sections": {
        "section_resistance": np.array([[0, 0, 0], [0.6, 0.3, 0.1], [0.0, 0.8, 0.4]]),
        "section_compliance": np.array([[0, 0, 0], [1.0, 0.2, 0.05], [0.0, 0.7, 0.1]]),
    },
    "throat": {"throat_severity": np.array([0.3, 0.0, 0.2]), "throat_length": np.array([0.3, 0.15, 0.2])},
    "wall function": {"wall_function": WallFunction(0.9, 1.5, 0.03 * np.sin(np.arange(12) / 2))},
    "friction function": {"friction_function": FrictionFunction(0.0, 80.0, 1 + 0.5 * np.arange(6))},
    "junction function": {
        "junction_function": JunctionFunction(-50.0, 150.0, 80.0 * (np.arange(9) - 2) ** 2)
    },
}
APART = "both at the junction", "long inertance"
ADDED["everything"] = {k: v for name, one in ADDED.items() if name not in APART for k, v in one.items()}


# --- nothing added


@pytest.mark.parametrize("next_to_nothing", [{"total_pressure": 1e-200}, {"leak": np.full(3, 1e-200)}])
@pytest.mark.parametrize("wall", WALLS)
def test_loops_with_additions_agree_with_the_plain_ones(wall, next_to_nothing):
    options = SolverOptions(steps_per_beat=2048, accelerate=False)
    plain, forced = (solver(wall, options=options, **p) for p in ({}, next_to_nothing))
    for one, other in (
        (plain.solve(STIFFNESS, GAMMA), forced.solve(STIFFNESS, GAMMA)),
        (plain.solve(5e4, 4.0), forced.solve(5e4, 4.0)),
    ):
        for name in ("pressure_mmHg", "flow_ml_s", "area_cm2"):
            x, y = getattr(one, name), getattr(other, name)
            np.testing.assert_allclose(y, x, atol=1e-11 * np.abs(x).max(), rtol=0)


@pytest.mark.parametrize("wall", WALLS)
def test_amplitude_zero_is_the_base_bit_by_bit(wall):
    zero, one = np.zeros(3), np.ones(3)
    base = waves(solver(wall).solve(STIFFNESS, GAMMA))
    for nothing in (
        {"viscosity_factor": one},
        {"offset_in": zero, "offset_out": zero},
        {"viscoelastic_time": zero, "relaxation_time": 1e-4},
        {"stiffness_wave": [1.0, 1.0]},
        {"leak": zero},
        {"inertance": zero},
        {"section_resistance": one[:, None], "section_compliance": one[:, None]},
        {"section_resistance": np.eye(3)[[0, 0, 1]], "section_compliance": np.ones((3, 3))},
        {"throat_severity": zero, "throat_length": one},
        {
            "wall_function": WallFunction(0.9, 1.5, np.zeros(8)),
            "friction_function": FrictionFunction(0.0, 50.0, np.ones(8)),
            "junction_function": JunctionFunction(-50.0, 50.0, np.zeros(8)),
        },
    ):
        added = solver(wall, **nothing)
        np.testing.assert_array_equal(waves(added.solve(STIFFNESS, GAMMA)), base)


@pytest.mark.parametrize(
    "name", ["offset", "viscoelastic", "leak", "total_pressure", "junction_loss", "inertance", "throat"]
)
def test_small_amplitudes_go_over_into_the_base(name):
    """A thousandth of the addition does about a thousandth of what it does, so nothing jumps at zero."""
    base = waves(solver().solve(STIFFNESS))[:2]
    size = []
    for factor in (1e-2, 1e-4):
        small = {k: v if k in ("throat_length",) else factor * v for k, v in ADDED[name].items()}
        added = waves(solver(**small).solve(STIFFNESS))[:2]
        size.append(np.abs(added - base).max(axis=(1, 2)))
    np.testing.assert_array_less(size[1], 0.02 * size[0] + 1e-7)


# --- the discretisation


@pytest.mark.parametrize("wall", WALLS)
@pytest.mark.parametrize("name", ADDED)
def test_order_of_convergence(wall, name):
    steps = 4096 if name in ("viscoelastic", "everything") else 2048
    grids = []
    for r in (1, 2, 4):
        options = SolverOptions(steps_per_beat=steps, refine=r, tolerance_mmHg=1e-7, max_beats=300)
        grids.append(waves(solver(wall, options=options, **ADDED[name]).solve(STIFFNESS, GAMMA)))
    for quantity in (0, 1):
        coarse, middle, fine = (g[quantity] for g in grids)
        order = np.log2(np.linalg.norm(coarse - middle) / np.linalg.norm(middle - fine))
        assert 1.75 < order < 2.6, (quantity, order)


# --- friction and profile


def tube(stiffness=8e4, q=0.3, length=4.0, radius_out=None, cells=0.025, viscosity=MU, pieces=1, **physics):
    """Steady flow through one vessel, or one in equal pieces: positions, pressures (dyn/cm2)."""
    load, radius = Windkessel(R1=2e4, R2=3e4, C=2e-6), 0.05
    chain = [
        Vessel(i, f"piece {i}", length / pieces, radius, radius_out or radius, i - 1 or None, load)
        for i in range(1, pieces + 1)
    ]
    chain = [replace(v, windkessel=None) for v in chain[:-1]] + chain[-1:]
    network = Network.from_vessels(chain, Blood(RHO, viscosity), PERIOD)
    x = np.linspace(0, 1, 41)
    piece = np.minimum((x * pieces).astype(int), pieces - 1)
    solution = Solver(
        network,
        np.arange(16) * PERIOD / 16,
        np.full(16, q),
        series=[(int(i) + 1, float(v)) for i, v in zip(piece, x * pieces - piece, strict=True)],
        times_s=[0.0],
        options=SolverOptions(dx_cm=cells, tolerance_mmHg=1e-7, max_beats=500),
        physics=Physics(**physics),
    ).solve(stiffness)
    np.testing.assert_allclose(solution.pressure_mmHg[-1] * MMHG, q * (load.R1 + load.R2), rtol=1e-6)
    return x * length, solution.pressure_mmHg[:, 0] * MMHG


def steady(x, p_out, rest_area, *, q=0.3, alpha=1.0, friction=0.0, loss=lambda x: 0.0, stiffness=8e4):
    """Pressure of (alpha q^2/A)_x + (A/rho) p_x = -friction q/A - loss A q^2, from the outlet inwards."""
    K, h = 4 / 3 * stiffness, 1e-6

    def right(x, p):
        ratio = (1 + p / K) ** 2
        A, A_p = rest_area(x) * ratio, 2 * rest_area(x) * (1 + p / K) / K
        A_x = (rest_area(x + h) - rest_area(x - h)) / (2 * h) * ratio
        force = -friction * q / A - loss(x) * A * q**2 + alpha * q**2 / A**2 * A_x
        return force / (A / RHO - alpha * q**2 / A**2 * A_p)

    exact = solve_ivp(right, (x[-1], 0), [p_out], rtol=1e-10, atol=1e-8, t_eval=x[::-1], max_step=0.005)
    return exact.y[0][::-1]


@pytest.mark.parametrize("alpha", [1.0, 4 / 3])
def test_viscous_friction_has_the_pressure_drop_of_the_steady_equation(alpha):
    x, p = tube(**VISCOUS, momentum_correction=alpha)
    exact = steady(x, p[-1], lambda x: np.pi * 0.05**2, alpha=alpha, friction=8 * np.pi * MU / RHO)
    np.testing.assert_allclose(p - p[-1], exact - p[-1], atol=1e-4 * (p[0] - p[-1]))
    stiff_x, stiff = tube(1e8, **VISCOUS, momentum_correction=alpha, cells=0.1)
    poiseuille = 8 * MU * 0.3 * stiff_x[-1] / (np.pi * 0.05**4)
    assert stiff[0] - stiff[-1] == pytest.approx(poiseuille, rel=2e-3)


@pytest.mark.parametrize("total_pressure", [0.0, 1.0])
def test_friction_where_pieces_of_a_vessel_meet_is_that_within(total_pressure):
    """Pieces of one width have one pressure where they meet, static or total."""
    x, p = tube(pieces=8, stokes_friction=0.0, viscous_friction=8.0, total_pressure=total_pressure)
    exact = steady(x, p[-1], lambda x: np.pi * 0.05**2, friction=8 * np.pi * MU / RHO)
    np.testing.assert_allclose(p - p[-1], exact - p[-1], atol=1e-4 * (p[0] - p[-1]))


def test_momentum_correction_scales_the_dynamic_pressure():
    """Without friction p + alpha rho u^2/2 is the same everywhere in a tapered vessel."""
    x, p = tube(length=1.0, radius_out=0.04, viscosity=1e-9, momentum_correction=1.5)
    exact = steady(x, p[-1], lambda x: np.pi * (0.05 - 0.01 * x) ** 2, alpha=1.5)
    assert np.ptp(exact) > 500.0
    np.testing.assert_allclose(p, exact, atol=1e-3 * np.ptp(exact))


def test_viscosity_factor_is_another_viscosity():
    thick = Network.from_vessels(
        [Vessel(1, "v", 0.5, 0.05, 0.05, None, Windkessel(2e4, 8e4, 1e-6))], Blood(RHO, 2 * MU), PERIOD
    )
    thin = Network(**{**vars(thick), "viscosity": MU})
    for extra in ({}, {"viscous_friction": 4.0}):
        one = solver(network=thick, series=ENDS[:2], **extra).solve(6e4)
        other = solver(network=thin, series=ENDS[:2], viscosity_factor=np.array([2.0]), **extra).solve(6e4)
        np.testing.assert_allclose(waves(other), waves(one), rtol=1e-9)


# --- throat


SHAPE = ("severity", "length", "position")


@pytest.mark.parametrize("loss", [0.0, 1.52])
def test_throat_has_the_pressure_drop_of_the_steady_equation(loss):
    s, wide, L = 0.35, 0.3, 1.0
    throat = {f"throat_{name}": np.array([x]) for name, x in zip(SHAPE, (s, wide, 0.4), strict=True)}
    x, p = tube(length=L, cells=0.00625, throat_loss=loss, **throat, **VISCOUS)

    def bump(x):
        return np.where(abs(x - 0.4) < wide / 2, 0.5 * (1 + np.cos(2 * np.pi * (x - 0.4) / wide)), 0.0)

    A0 = np.pi * 0.05**2
    whole = 0.5 * loss * (1 / (1 - s) ** 2 - 1) ** 2 / A0**2
    lost = {"friction": 8 * np.pi * MU / RHO, "loss": lambda x: whole * 2 * bump(x) / wide}
    exact = steady(x, p[-1], lambda x: A0 * (1 - s * bump(x)) ** 2, **lost)
    drop = exact[0] - exact[-1]
    np.testing.assert_allclose(p, exact, atol=0.01 * np.ptp(exact))
    assert p[0] - p[-1] == pytest.approx(drop, rel=3e-3)
    if loss:
        young_tsai = 0.5 * RHO * loss * (1 / (1 - s) ** 2 - 1) ** 2 * (0.3 / A0) ** 2
        assert drop > young_tsai / 2.5  # the vessel is wider than at rest


# --- outlets


def wall_slope_at_rest(wall, chi, gamma):
    return 2 / 3 * chi if wall == "linear" else np.pi / gamma * chi


def harmonics(values, n=12):
    return np.fft.rfft(values, axis=-1)[..., : n + 1] / values.shape[-1]


@pytest.mark.parametrize("wall", WALLS)
@pytest.mark.parametrize("L", [0.0, 0.05, 5.0, 60.0, 1000.0])
def test_outlet_has_the_impedance_of_its_circuit(wall, L):
    """P(w)/Q(w) = R1 + 1/(1/(i w L) + 1/R_p) + sum_k R_k/(1 + i w R_k C_k) at the terminals' ends."""
    physics = {**ADDED["sections"], "inertance": np.full(3, L)}
    psi1, psi2, c = 0.7, 1.3, 1.2
    s = solver(wall, n_times=2048, **physics)
    solution = s.solve(STIFFNESS, GAMMA, psi1, psi2, c)
    net, omega = s.network, 2 * np.pi * np.arange(13) / PERIOD
    for vessel, row in ((1, 3), (2, 5)):
        p, q = harmonics(solution.pressure_mmHg[row] * MMHG), harmonics(solution.flow_ml_s[row])
        slope = wall_slope_at_rest(wall, STIFFNESS[vessel], GAMMA[vessel])
        beside = 6.0 * np.sqrt(RHO * slope) / (np.pi * net.radius_out_cm[vessel] ** 2)  # slope = rho c^2
        impedance = psi1 * net.R1[vessel] + 1j * omega * L * beside / (1j * omega * L + beside)
        for rho, kappa in zip(
            physics["section_resistance"][vessel], physics["section_compliance"][vessel], strict=True
        ):
            R, C = rho * psi2 * net.R2[vessel], kappa * c * net.C[vessel]
            impedance = impedance + R / (1 + 1j * omega * R * C)
        miss = np.abs(p - impedance * q)
        assert miss[0] < 1e-6 * abs(p[0])
        assert miss.max() < 2e-4 * np.abs(p[1:]).max(), miss / np.abs(p)


@pytest.mark.parametrize(("length", "refine"), [(0.3, 1), (0.3, 4), (1.0, 2), (3.0, 1), (3.0, 2)])
def test_inertances_of_long_columns_solve_at_every_resolution(length, refine):
    """With static pressure shared at junctions, waves that outlets return whole grow: some must leave."""
    study = load_study("demo")
    network = Network.from_study(study)
    inertance = np.zeros(len(network.ids))
    ends = network.terminals
    inertance[ends] = network.density * length / (np.pi * network.radius_out_cm[ends] ** 2)
    options = SolverOptions(refine=refine, max_beats=15)
    solution = Solver.for_study(study, options=options, physics=Physics(inertance=inertance)).solve(
        4.31e4, psi1=0.28, psi2=0.87, c=1.35
    )
    assert solution.ok


# --- junctions


@pytest.mark.parametrize("wall", WALLS)
@pytest.mark.parametrize(("tau", "K"), [(0.0, 2.0), (1.0, 0.0), (1.0, 2.0), (1.5, 15.0)])
def test_ends_of_the_branches_obey_the_junction_s_relation(wall, tau, K):
    solution = solver(wall, total_pressure=tau, junction_loss=K).solve(STIFFNESS, GAMMA)
    p, u = solution.pressure_mmHg * MMHG, solution.flow_ml_s / solution.area_cm2
    shared = p + tau * RHO / 2 * u**2
    lost = K * RHO / 2 * u[1] * np.abs(u[1])
    assert np.abs(p[1] - p[2]).max() > 300.0
    for daughter in (2, 4):
        np.testing.assert_allclose(shared[daughter], shared[1] - lost, atol=2e-3 * np.ptp(p[1]) / 100)
    assert solution.junction_defect_ml_s < 1e-12
    assert abs(solution.outflow_ml - solution.inflow_ml) < 1e-8 * solution.inflow_ml


@pytest.mark.parametrize("K", [0.0, 2.0])
def test_steady_flow_through_a_step_of_width_keeps_its_total_pressure(K):
    """The steady equation up to the step from either side, where p + rho u^2/2 falls by K rho u_0^2/2."""
    q, radii, length, stiffness = 0.3, (0.05, 0.038), 1.0, 8e4
    load = Windkessel(R1=2e4, R2=3e4, C=2e-6)
    chain = [
        Vessel(1, "wide", length, radii[0], radii[0], None, None),
        Vessel(2, "narrow", length, radii[1], radii[1], 1, load),
    ]
    x = np.linspace(0.0, 1.0, 21)
    p = Solver(
        Network.from_vessels(chain, BLOOD, PERIOD),
        np.arange(16) * PERIOD / 16,
        np.full(16, q),
        series=[(i, v) for i in (1, 2) for v in x],
        times_s=[0.0],
        options=SolverOptions(dx_cm=0.0125, tolerance_mmHg=1e-7, max_beats=500),
        physics=Physics(stokes_friction=0.0, viscous_friction=8.0, total_pressure=1.0, junction_loss=K),
    ).solve(stiffness).pressure_mmHg.reshape(2, -1) * MMHG  # fmt: skip

    def dynamic(p, radius):
        return RHO / 2 * (q / (np.pi * radius**2 * (1 + 0.75 * p / stiffness) ** 2)) ** 2

    friction = 8 * np.pi * MU / RHO
    narrow = steady(x * length, q * (load.R1 + load.R2), lambda x: np.pi * radii[1] ** 2, friction=friction)
    total = narrow[0] + dynamic(narrow[0], radii[1])
    end = brentq(lambda p: p + (1 - K) * dynamic(p, radii[0]) - total, 0.5 * total, 2 * total)
    wide = steady(x * length, end, lambda x: np.pi * radii[0] ** 2, friction=friction)
    assert narrow[0] < wide[-1] - 100.0
    np.testing.assert_allclose(p, [wide, narrow], atol=2e-4 * (wide[0] - narrow[-1]))


# --- leak


@pytest.mark.parametrize("wall", WALLS)
def test_what_flows_in_flows_out_or_leaks(wall):
    leak = ADDED["leak"]["leak"]
    x = np.linspace(0, 1, 25)
    series = [(v, y) for v in (1, 2, 3) for y in x]
    s = solver(wall, series=series, n_times=512, leak=leak)
    solution = s.solve(STIFFNESS, GAMMA)
    mean = (solution.pressure_mmHg * MMHG).mean(axis=1).reshape(3, len(x))
    lost = PERIOD * np.sum(leak * s.network.length_cm * np.trapezoid(mean, x, axis=1))
    assert lost > 0.05 * solution.inflow_ml
    assert solution.inflow_ml - solution.outflow_ml == pytest.approx(lost, rel=1e-4)


# --- walls


def wall_pressure(wall, area_ratio, chi, gamma):
    return wall_pressure_mmHg(wall, area_ratio, chi, gamma) * MMHG


def at_the_ends(s, solution, wall):
    """The wall's own pressures at both ends of each vessel, dyn/cm2."""
    net, ratio = s.network, solution.area_cm2 / np.pi
    ratio = ratio / np.stack([net.radius_in_cm, net.radius_out_cm], axis=1).reshape(-1, 1) ** 2
    return [wall_pressure(wall, a, STIFFNESS[k // 2], GAMMA[k // 2]) for k, a in enumerate(ratio)]


@pytest.mark.parametrize("wall", WALLS)
def test_viscoelastic_pressure_is_the_filtered_rate_of_the_wall_s(wall):
    """p - p_e = i w tau/(1 + i w tau_r) p_e, harmonic by harmonic, with p_e from the area."""
    tau, tau_r = np.array([2e-3, 1e-3, 3e-3]), 5e-4
    options = SolverOptions(steps_per_beat=8192, tolerance_mmHg=1e-6, max_beats=200)
    s = solver(wall, options=options, n_times=2048, viscoelastic_time=tau, relaxation_time=tau_r)
    solution = s.solve(STIFFNESS, GAMMA)
    omega = 2 * np.pi * np.arange(25) / PERIOD
    for row, p_e in enumerate(at_the_ends(s, solution, wall)):
        p_v = harmonics(solution.pressure_mmHg[row] * MMHG - p_e, 24)
        expected = 1j * omega * tau[row // 2] / (1 + 1j * omega * tau_r) * harmonics(p_e, 24)
        assert np.abs(p_v - expected).max() < 1e-3 * np.abs(expected).max()
        assert np.abs(expected).max() > 50.0


def test_an_offset_of_the_linear_wall_is_another_rest_state():
    """K (sqrt(A/A0) - 1) + p_x = K* (sqrt(A/A0*) - 1) with K* = K - p_x, r0* = r0 K*/K."""
    offset = np.array([3e3, 3e3, 3e3])
    options = SolverOptions(steps_per_beat=2048, accelerate=False)
    added = solver(options=options, offset_in=offset, offset_out=offset).solve(5e4)
    factor = 1 - 3e3 / (4 / 3 * 5e4)
    network = bifurcation(tuple(factor * np.array([0.05, 0.035, 0.03])))
    other = solver(options=options, network=network).solve(5e4 * factor)
    assert np.abs(added.pressure_mmHg - solver(options=options).solve(5e4).pressure_mmHg).max() > 0.1
    # the two differ in what a start is, and stop within the tolerance
    np.testing.assert_allclose(waves(added), waves(other), rtol=0, atol=4e-3)
    one, two = solver(offset_in=offset, offset_out=offset).solve(5e4), solver(network=network)
    np.testing.assert_allclose(waves(one), waves(two.solve(5e4 * factor)), rtol=0, atol=2e-7)


@pytest.mark.parametrize("wall", WALLS)
def test_wall_under_an_offset_carries_the_rest(wall):
    added = ADDED["offset"]
    s = solver(wall, **added)
    solution = s.solve(STIFFNESS, GAMMA)
    offset = np.stack([added["offset_in"], added["offset_out"]], axis=1).reshape(-1, 1)
    own = at_the_ends(s, solution, wall)
    np.testing.assert_allclose(solution.pressure_mmHg * MMHG, own + offset, atol=0.5)
    # the mean pressure at a terminal is that of its resistance, whatever the wall carries
    for row, k in ((3, 1), (5, 2)):
        mean = solution.flow_ml_s[row].mean() * (s.network.R1[k] + s.network.R2[k])
        assert solution.pressure_mmHg[row].mean() * MMHG == pytest.approx(mean, rel=1e-6)


CONSTANT_WITH = {"alone": {}, "viscoelastic": ADDED["viscoelastic"], "losses": ADDED["both at the junction"]}


@pytest.mark.parametrize("wall", WALLS)
@pytest.mark.parametrize("factor", [1.0, 1.3])
@pytest.mark.parametrize("beside", CONSTANT_WITH)
def test_a_constant_stiffness_wave_is_another_stiffness(wall, factor, beside):
    options = SolverOptions(steps_per_beat=4096, accelerate=False)
    beside = CONSTANT_WITH[beside]
    # 1e-200: the loops with additions even for a wave of 1
    forced = {"leak": np.full(3, 1e-200), "stiffness_wave": [factor] * 3}
    wave = solver(wall, options=options, **forced, **beside)
    plain = solver(wall, options=options, **beside)
    one, other = plain.solve(factor * STIFFNESS, GAMMA), wave.solve(STIFFNESS, GAMMA)
    for name in ("pressure_mmHg", "flow_ml_s", "area_cm2"):
        x, y = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(y, x, atol=1e-10 * np.abs(x).max(), rtol=0)
    assert one.beats == other.beats
    stiffest = solver(wall, stiffness_wave=[factor, 1.0]).solve(STIFFNESS, GAMMA)
    assert stiffest.max_cfl >= solver(wall, stiffness_wave=[1.0]).solve(STIFFNESS, GAMMA).max_cfl


@pytest.mark.parametrize("wall", WALLS)
def test_pressure_over_the_wall_s_is_the_stiffness_wave(wall):
    """At every end of a vessel and every time, and no blood is lost."""
    samples = np.array([0.8, 1.1, 1.3, 1.2, 0.9])
    s = solver(wall, stiffness_wave=samples)
    solution = s.solve(STIFFNESS, GAMMA)
    expected = np.interp(s.times_s, np.arange(6) * PERIOD / 5, [*samples, samples[0]])
    for p, own in zip(solution.pressure_mmHg * MMHG, at_the_ends(s, solution, wall), strict=True):
        np.testing.assert_allclose(p / own, expected, rtol=1e-10)
    assert solution.outflow_ml == pytest.approx(solution.inflow_ml, rel=1e-8)
    assert solution.junction_defect_ml_s < 1e-12


@pytest.mark.parametrize("wall", WALLS)
def test_stiffness_wave_in_a_short_vessel_is_that_of_a_chamber(wall):
    """A short wide vessel has one pressure: d(A L)/dt = q_in - q_out, p = s(t) wall(A)."""
    length, radius, chi, gamma = 0.1, 0.25, 5e4, 4.0
    load = Windkessel(R1=6e3, R2=9e4, C=1e-6)
    network = Network.from_vessels([Vessel(1, "v", length, radius, radius, None, load)], BLOOD, PERIOD)
    time = np.arange(256) * PERIOD / 256
    samples = 1.0 + 0.25 * np.sin(2 * np.pi * np.arange(64) / 64)
    s = solver(wall, network=network, series=[(1, 0.5)], stiffness_wave=samples)
    solution = s.solve(chi, gamma)
    A0 = np.pi * radius**2

    def right(t, y):
        stiff = np.interp(t, np.arange(64) * PERIOD / 64, samples, period=PERIOD)
        p = stiff * wall_pressure(wall, y[0] / A0, chi, gamma)
        out = (p - y[1]) / load.R1
        q_in = np.interp(t, s.inflow_time_s, s.inflow_ml_s, period=PERIOD)
        return [(q_in - out) / length, (out - y[1] / load.R2) / load.C]

    beats = 15
    y0 = [solution.area_cm2[0, 0], 0.9 * solution.pressure_mmHg[0, 0] * MMHG]
    last = time + (beats - 1) * PERIOD
    exact = solve_ivp(right, (0, last[-1]), y0, "LSODA", last, rtol=1e-6, atol=1e-8, max_step=2e-3)
    stiff = np.interp(time, np.arange(64) * PERIOD / 64, samples, period=PERIOD)
    p = stiff * wall_pressure(wall, exact.y[0] / A0, chi, gamma) / MMHG
    np.testing.assert_allclose(solution.pressure_mmHg[0], p, atol=5e-3 * np.ptp(p))
    without = solver(wall, network=network, series=[(1, 0.5)]).solve(chi, gamma).pressure_mmHg[0]
    assert np.abs(p - without).max() > 0.1 * np.ptp(p)


def test_vessels_may_stand_below_their_rest_state():
    offset = np.full(3, 15 * MMHG)
    solution = solver(offset_in=offset, offset_out=offset).solve(STIFFNESS)
    assert solution.pressure_mmHg.min() < 15.0
    assert solution.ok


# --- the Python face


@pytest.mark.parametrize(
    ("bad", "match"),
    [
        ({"momentum_correction": 0.0}, r"momentum_correction = 0.0: must be positive"),
        ({"leak": [0.0, -1.0, 0.0]}, r"leak\[1\] = -1.0: must be zero or positive"),
        ({"leak": [0.0, 0.0]}, r"leak has shape \(2,\): must have one row per vessel, 3"),
        ({"stiffness_wave": []}, r"stiffness_wave has shape \(0,\): must be \(n_times,\)"),
        ({"leak": [[0.0]]}, r"leak has shape \(1, 1\): must be \(n_vessels,\)"),
        ({"throat_severity": [0.0, 1.0, 0.0]}, r"throat_severity\[1\] = 1.0: must be at least 0 and below 1"),
        ({"section_resistance": np.ones((3, 1))}, "given together"),
        ({"section_resistance": np.ones((3, 1)), "section_compliance": np.ones((3, 2))}, "must be that of"),
        (
            {"section_resistance": np.ones((3, 1)), "section_compliance": np.zeros((3, 1))},
            "must be of the resistance.s sign",
        ),
        ({"section_resistance": np.eye(3), "section_compliance": np.ones((3, 3)) * [[1], [1], [1]]}, None),
        (
            {"section_resistance": np.zeros((3, 1)), "section_compliance": np.ones((3, 1))},
            "vessel 2 is a terminal",
        ),
    ],
)
def test_bad_values_are_named(bad, match):
    if match is None:
        solver(**bad)
        return
    with pytest.raises(SolverArgumentError, match=match):
        solver(**bad)


def test_physics_is_read_only_and_survives_a_pickle():
    added = solver(options=SolverOptions(), **ADDED["everything"])
    with pytest.raises(ValueError, match="read-only"):
        added.physics.leak[0] = 1.0
    again = pickle.loads(pickle.dumps(added))
    np.testing.assert_array_equal(waves(again.solve(STIFFNESS)), waves(added.solve(STIFFNESS)))
    with pytest.raises(ValueError, match="read-only"):
        again.physics.leak[0] = 1.0


def test_settings_tell_physics_apart():
    assert solver().settings()["physics"] == {}
    told = {json.dumps(solver(**p).settings()["physics"], sort_keys=True) for p in ({}, *ADDED.values())}
    assert len(told) == len(ADDED) + 1
    assert solver(leak=[0.0, 1e-6, 0.0]).settings()["physics"] == {"leak": [0.0, 1e-6, 0.0]}
