"""Functions inside the solver against laws that are known, steady flow, and the relation that they state."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from test_physics import BLOOD, FINE, GAMMA, MU, PERIOD, RHO, STIFFNESS, WALLS, solver, waves
from zoo.blood.functions import FrictionFunction, JunctionFunction, KnotFunction, WallFunction
from zoo.blood.network import Network
from zoo.blood.physics import Physics
from zoo.blood.solver import Solver, SolverArgumentError, SolverOptions
from zoo.blood.study import Vessel, Windkessel
from zoo.blood.units import MMHG
from zoo.core.forward import SolveError

QUICK = SolverOptions(steps_per_beat=2048, tolerance_mmHg=1e-6, max_beats=200)
KINDS = (WallFunction, FrictionFunction, JunctionFunction)


def at(kind: type[KnotFunction], low: float, high: float, n: int, f: Any) -> Any:
    return kind(low, high, f(np.linspace(low, high, n)))


# --- the spline


@pytest.mark.parametrize("kind", KINDS)
def test_a_cubic_is_its_own_spline(kind: type[KnotFunction]) -> None:
    def cubic(x: Any) -> Any:
        return 4 + 0.3 * x - 0.2 * x**2 + 0.1 * x**3

    f, x = at(kind, 0.8, 1.7, 7, cubic), np.linspace(0.8, 1.7, 50)
    np.testing.assert_allclose(f(x), cubic(x), rtol=1e-13)
    np.testing.assert_allclose(f.slope(x), 0.3 - 0.4 * x + 0.3 * x**2, atol=1e-12)
    np.testing.assert_allclose(f.knots, np.linspace(0.8, 1.7, 7))
    for edge in (0.8, 1.7):  # and nothing jumps where it goes on
        assert f(edge + 1e-9) == pytest.approx(float(f(edge - 1e-9)), abs=1e-8)


def test_each_goes_on_beyond_its_knots_as_it_says() -> None:
    wall, friction, junction = (at(kind, 0.8, 1.7, 9, np.sin) for kind in KINDS)
    low, high = np.array([0.2, 0.5]), np.array([1.8, 3.0])
    np.testing.assert_allclose(friction(low), np.sin(0.8), rtol=1e-15)
    np.testing.assert_allclose(friction(high), friction.values[-1], rtol=1e-15)
    for f in (wall, junction):
        np.testing.assert_allclose(f(high), f(1.7) + f.slope(1.7) * (high - 1.7), rtol=1e-12)
    np.testing.assert_allclose(junction(low), junction(0.8) + junction.slope(0.8) * (low - 0.8), rtol=1e-12)
    # straight in the area
    area = np.array([0.1, 0.3, 0.5])
    assert np.diff(wall(np.sqrt(area)), 2) == pytest.approx(0.0, abs=1e-14)
    for f in (wall, friction, junction):
        for x in (*low, *high):
            slope = (f(x + 1e-6) - f(x - 1e-6)) / 2e-6
            assert f.slope(np.array([x]))[0] == pytest.approx(float(slope), abs=1e-7)


@pytest.mark.parametrize(
    ("kind", "given", "match"),
    [
        (WallFunction, (0.0, 1.5, [0.0] * 4), r"WallFunction: low = 0.0: must be between 0.001"),
        (WallFunction, (0.9, np.nan, [0.0] * 4), r"WallFunction: high = nan: must be a finite number"),
        (WallFunction, (1.5, 0.9, [0.0] * 4), r"high = 0.9: must be above low = 1.5"),
        (FrictionFunction, (-1.0, 50.0, [1.0] * 4), r"FrictionFunction: low = -1.0"),
        (FrictionFunction, (0.0, 50.0, [1.0, 1.0, -0.1, 1.0]), r"values\[2\] = -0.1: must be between 0 and"),
        (JunctionFunction, (0.0, 50.0, [1.0, 2.0, 3.0]), r"3 values: must be 4 to 4096"),
        (JunctionFunction, (0.0, 50.0, [1.0, 2.0, 3.0, np.inf]), r"values\[3\] = inf: must be finite"),
        (JunctionFunction, (0.0, 50.0, "abc"), r"values = .*: must be an array of real numbers"),
        (JunctionFunction, ("1", 50.0, [0.0] * 4), r"low = '1': must be a finite number"),
    ],
)
def test_what_is_out_of_range_is_named(kind: Any, given: Any, match: str) -> None:
    with pytest.raises(SolverArgumentError, match=match) as caught:
        kind(*given)
    assert "\n" not in str(caught.value)


def test_physics_takes_each_function_in_its_place_only() -> None:
    wrong: Any = FrictionFunction(0.0, 50.0, [2.0] * 4)
    with pytest.raises(SolverArgumentError, match=r"wall_function = .*: must be a WallFunction"):
        Physics(wall_function=wrong)
    with pytest.raises(SolverArgumentError, match=r"junction_function = 3"):
        Physics(junction_function=3)  # type: ignore[arg-type]
    given = Physics(friction_function=wrong)
    assert given.settings() == {"friction_function": {"low": 0.0, "high": 50.0, "values": [2.0] * 4}}
    assert pickle.loads(pickle.dumps(given)).friction_function == wrong


# --- the wall


def test_a_straight_function_of_the_linear_wall_is_another_stiffness() -> None:
    e = 0.3
    added = at(WallFunction, 0.9, 1.3, 5, lambda s: e * (s - 1))
    one = solver(options=QUICK, wall_function=added).solve(STIFFNESS)
    other = solver(options=QUICK).solve((1 + e) * STIFFNESS)
    np.testing.assert_allclose(waves(one), waves(other), rtol=1e-7)


@pytest.mark.parametrize("extra", [{}, {"total_pressure": 1.0, "viscoelastic_time": np.full(3, 3e-4)}])
def test_the_tangent_wall_as_a_function_of_the_linear_one_comes_near_to_fourth_order(extra: Any) -> None:
    """The same law twice; what is left falls with the fourth power of the knots' distance."""
    chi, gamma = 5e4, 4.0

    def missing(s: Any) -> Any:
        return np.tan(np.pi / gamma * (s**2 - 1)) / (4 / 3) - (s - 1)

    tangent = solver("tangent", options=QUICK, **extra).solve(chi, gamma)
    ratio = tangent.area_cm2.max() / (np.pi * 0.05**2)
    assert ratio > 1.1
    errors = []
    for n in (9, 17, 33):
        added = at(WallFunction, 0.9, 1.4, n, missing)
        solution = solver("linear", options=QUICK, wall_function=added, **extra).solve(chi)
        errors.append(np.abs(solution.pressure_mmHg - tangent.pressure_mmHg).max())
    assert errors[0] < 1e-2 * np.ptp(tangent.pressure_mmHg)
    assert errors[0] / errors[1] > 10
    assert errors[2] < 2e-6  # the beat is periodic to 1e-6


@pytest.mark.parametrize("wall", WALLS)
def test_pressure_is_that_of_the_whole_law_and_blood_is_kept(wall: str) -> None:
    added = at(WallFunction, 0.95, 1.3, 12, lambda s: 0.02 * np.sin(30 * s))
    s = solver(wall, options=QUICK, wall_function=added)
    solution = s.solve(STIFFNESS, GAMMA)
    radius = np.stack([s.network.radius_in_cm, s.network.radius_out_cm], axis=1).ravel()
    stretch = np.sqrt(solution.area_cm2 / (np.pi * radius**2)[:, None])
    chi, gamma = np.repeat(STIFFNESS, 2)[:, None], np.repeat(GAMMA, 2)[:, None]
    scale = 4 / 3 * chi if wall == "linear" else chi
    law = stretch - 1 if wall == "linear" else np.tan(np.pi / gamma * (stretch**2 - 1))
    np.testing.assert_allclose(solution.pressure_mmHg * MMHG, scale * (law + added(stretch)), atol=0.5)
    assert abs(solution.outflow_ml - solution.inflow_ml) < 1e-7 * solution.inflow_ml
    assert solution.junction_defect_ml_s < 1e-12


@pytest.mark.parametrize("wall", WALLS)
def test_a_wall_that_falls_is_a_failed_solve_and_not_a_crash(wall: str) -> None:
    falls = at(WallFunction, 0.9, 1.3, 12, lambda s: -9 * (s - 1))
    s = solver(wall, options=QUICK, wall_function=falls)
    with pytest.raises(SolveError, match=r"pressure does not rise with its area in vessel 1;") as caught:
        s.solve(STIFFNESS, GAMMA)
    assert caught.value.kind == "wall-falls"
    assert np.isnan(s.solve(STIFFNESS, GAMMA, check=False).pressure_mmHg).all()


def test_only_the_vessel_whose_own_law_does_not_outweigh_it_falls() -> None:
    """The tangent wall's slope at rest is 2 pi/gamma, in the stretch."""
    falls = at(WallFunction, 0.9, 1.3, 12, lambda s: -1.0 * (s - 1))
    found = solver("tangent", options=QUICK, wall_function=falls).solve(
        STIFFNESS, [4.0, 8.0, 5.0], check=False
    )
    assert found.reason.startswith("with the function added to its wall")
    assert found.vessel == 2


# --- friction


@pytest.mark.parametrize("extra", [{}, {"total_pressure": 1.0}])
def test_a_constant_factor_of_friction_is_that_of_both_frictions(extra: Any) -> None:
    plain = solver(options=FINE, stokes_friction=1.5, viscous_friction=6.0, **extra).solve(STIFFNESS)
    factor = FrictionFunction(0.0, 60.0, [1.5] * 5)
    same = solver(options=FINE, viscous_friction=4.0, friction_function=factor, **extra).solve(STIFFNESS)
    np.testing.assert_allclose(waves(same), waves(plain), atol=1e-6 * np.abs(waves(plain)).max())


@pytest.mark.parametrize("extra", [{}, {"total_pressure": 1.0}])
def test_steady_flow_loses_what_friction_at_its_speed_takes(extra: Any) -> None:
    """A p_x/rho + (q^2/A)_x = -phi(u) 8 pi nu u in a tapered vessel, integrated by another program."""
    q, chi, length, radii = 0.4, 4e4, 2.0, (0.06, 0.045)
    factor = at(FrictionFunction, 0.0, 90.0, 12, lambda u: 1 + (u / 40) ** 2)
    chain = [
        Vessel(1, "one", length, radii[0], radii[1], None, None),
        Vessel(2, "end", 0.5, radii[1], radii[1], 1, Windkessel(R1=1e4, R2=3e4, C=1e-6)),
    ]
    x = np.linspace(0.0, 1.0, 11)
    s = Solver(
        Network.from_vessels(chain, BLOOD, PERIOD),
        np.arange(64) * PERIOD / 64,
        np.full(64, q),
        series=[(1, y) for y in x],
        times_s=[0.0],
        options=SolverOptions(dx_cm=0.02, tolerance_mmHg=1e-7, max_beats=200),
        physics=Physics(stokes_friction=0.0, viscous_friction=8.0, friction_function=factor, **extra),
    )
    solution = s.solve(chi)

    def rest(z: float) -> float:
        return float(np.pi * (radii[0] + (radii[1] - radii[0]) * z / length) ** 2)

    def area(z: float, p: float) -> float:
        return rest(z) * (1 + p / (4 / 3 * chi)) ** 2

    def right(z: float, y: Any) -> Any:
        p, h = y[0], 1e-5
        A, K = area(z, p), 4 / 3 * chi
        u, per_p = q / A, 2 * A / (K + p)
        along = (area(z + h, p) - area(z - h, p)) / (2 * h)
        phi = 1 + (u / 40) ** 2
        # p' A/rho - q^2/A^2 (A_p p' + A_z) = -phi 8 pi nu u
        return [(-phi * 8 * np.pi * MU / RHO * u + u**2 * along) / (A / RHO - u**2 * per_p)]

    start = float(solution.pressure_mmHg[0, 0]) * MMHG
    exact = solve_ivp(right, (0, length), [start], t_eval=x * length, rtol=1e-10, atol=1e-6)
    fell = exact.y[0] - start
    assert fell[-1] < -200
    np.testing.assert_allclose(solution.pressure_mmHg[:, 0] * MMHG - start, fell, atol=2e-3 * abs(fell[-1]))


# --- junctions


@pytest.mark.parametrize("wall", WALLS)
@pytest.mark.parametrize("extra", [{}, {"total_pressure": 1.0, "junction_loss": 3.0}])
def test_daughters_lack_what_the_function_says(wall: str, extra: Any) -> None:
    lost = at(JunctionFunction, -60.0, 120.0, 12, lambda u: 500 * np.sin(u / 30) + 100)
    solution = solver(wall, options=QUICK, junction_function=lost, **extra).solve(STIFFNESS, GAMMA)
    p, u = solution.pressure_mmHg * MMHG, solution.flow_ml_s / solution.area_cm2
    tau, K = extra.get("total_pressure", 0.0), extra.get("junction_loss", 0.0)
    shared = p + tau * RHO / 2 * u**2
    expected = lost(u[1]) + K * RHO / 2 * u[1] * np.abs(u[1])
    assert np.ptp(u[1]) > 30
    for daughter in (2, 4):
        np.testing.assert_allclose(shared[1] - shared[daughter], expected, atol=5.0)
    assert solution.junction_defect_ml_s < 1e-12
    assert abs(solution.outflow_ml - solution.inflow_ml) < 1e-7 * solution.inflow_ml


def test_a_squared_velocity_is_the_loss_of_a_coefficient() -> None:
    """Blood does not flow back here, so that the square is all of u |u|, and its spline exact."""
    K = 4.0
    lost = at(JunctionFunction, 0.0, 150.0, 6, lambda u: K * RHO / 2 * u**2)
    one = solver(options=QUICK, junction_loss=K).solve(STIFFNESS)
    other = solver(options=QUICK, junction_function=lost).solve(STIFFNESS)
    assert (one.flow_ml_s[1] > 0).all()
    np.testing.assert_allclose(waves(other), waves(one), rtol=1e-7)
