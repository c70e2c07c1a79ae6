"""The free functions of the blood simulator's components, against changes made by other means."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from benchmarks import structured_trees
from docs.pages import function_words
from scipy.interpolate import CubicSpline

from zoo.blood.baseline import get_baseline
from zoo.blood.blood_flow import study_data
from zoo.blood.case import simulate, with_physics
from zoo.blood.components import COMPONENTS, component_of, components, plausible
from zoo.blood.components.curves import curve, delay_response, gain_response, minimum_phase
from zoo.blood.components.declared import TABLE, free_function
from zoo.blood.components.plausibility import LIMITS
from zoo.blood.components.wall_functions import added_law, added_pressure
from zoo.blood.effects import CATALOGUE
from zoo.blood.effects.structured_tree import tree_impedance
from zoo.blood.functions import FrictionFunction
from zoo.blood.loads import outlet_impedance
from zoo.blood.solver import SolverOptions
from zoo.blood.study import load_study
from zoo.blood.study_diagnosis import HOOKS
from zoo.core.effects import Location
from zoo.core.forward import SolveError, pinned
from zoo.core.parameters import pack

THETA = {"f3": 4.6e4, "psi1": 0.35, "psi2": 0.9, "c": 1.2}
STEPS = 0.05
"""Of a difference, in prior sizes."""


class Bench:
    """A study's model with its number of steps kept, its solve at `THETA` and its free functions."""

    def __init__(self, name, base="linear-constant", theta=THETA):
        study = load_study(name)
        self.data = study_data(study)
        self.free = get_baseline(base).forward(study, options=SolverOptions(tolerance_mmHg=2e-4))
        self.theta = pack(self.free.parameters, theta)
        self.model = pinned(self.free, self.free.configure(self.theta))
        self.case = self.model.configure(self.theta)
        self.series = self.model.solve(self.case)
        self.functions = {f.name: f for f in components(self.free, self.theta, self.data)}

    def solved(self, name, values):
        return self.model.solve(self.functions[name].apply(self.case, np.asarray(values, dtype=float)))

    def changed(self, **given):
        return self.model.solve(replace(self.case, **given))

    def columns(self, name):
        function = self.functions[name]
        steps = STEPS * function.size * np.eye(len(function.at))
        return np.array([self.solved(name, step) - self.solved(name, -step) for step in steps]) / (2 * STEPS)


@pytest.fixture(scope="module")
def demo():
    return Bench("demo")


@pytest.fixture(scope="module", params=["demo", pytest.param("mouse-c6", marks=pytest.mark.needs_data)])
def bench(request):
    return Bench(request.param)


NAMES = tuple(LIMITS)


@pytest.mark.parametrize("name", NAMES)
def test_zero_values_give_the_baselines_bits(bench, name):
    assert np.array_equal(bench.solved(name, np.zeros(len(bench.functions[name].at))), bench.series)


@pytest.mark.parametrize("name", NAMES)
def test_every_value_moves_the_series_and_by_a_plausible_amount(bench, name):
    rms = np.sqrt(np.mean(bench.columns(name) ** 2, axis=(1, 2)))
    assert np.all(np.isfinite(rms))
    assert np.all(rms > 1e-4), "mmHg for one prior size"
    assert 0.02 < rms.max() < 5.0


def test_draws_from_twice_the_prior_size_are_solved(bench):
    """All but one in twenty; steps are chosen for each, as a solve outside a search does."""
    random, case = np.random.default_rng(3), bench.free.configure(bench.theta)
    solved = []
    for function in bench.functions.values():
        for k in range(4):
            root = function.root(function.lengths[k % len(function.lengths)] if function.lengths else None)
            values = 2 * function.size * root @ random.standard_normal(root.shape[1])
            try:
                bench.free.solve(function.apply(case, values))
                solved.append(True)
            except SolveError:
                solved.append(False)
    assert np.mean(solved) >= 0.95


@pytest.mark.parametrize("name", NAMES)
def test_values_beyond_reason_are_a_solve_error_or_a_solve(demo, name):
    function = demo.functions[name]
    for far in (100.0, -100.0):
        try:
            series = demo.free.solve(
                function.apply(demo.case, np.full(len(function.at), far * function.size))
            )
        except SolveError:
            continue
        assert np.all(np.isfinite(series))


def test_functions_have_unique_names_known_components_reasons_and_limits(demo):
    functions = components(demo.free, demo.theta, demo.data)
    assert tuple(f.name for f in functions) == NAMES
    assert [c for c in COMPONENTS if c in {f.component for f in functions}] == list(
        dict.fromkeys(f.component for f in functions)
    )
    for function in functions:
        assert function.why
        assert function.equation
        assert function.argument


def test_every_listed_effect_of_a_solve_belongs_to_a_component():
    for effect in CATALOGUE.values():
        assert (component_of(effect) in COMPONENTS) == (effect.family not in ("noise", "numerics"))
    assert component_of(CATALOGUE["external-pressure"]) == "wall"
    assert HOOKS.component_of is component_of
    assert component_of(CATALOGUE["structured-tree"]) == "outlets"
    assert component_of(CATALOGUE["correlated-noise"]) == ""


# ---------------------------------------------------------------------------------------------------
# inflow


def test_an_added_flow_is_the_inflow_with_its_samples_changed(demo):
    function = demo.functions["flow-record"]
    n = len(demo.case.inflow_ml_s)
    added = 0.03 * np.sin(2 * np.pi * np.arange(n) / n) + 0.01
    values = 0.03 * np.sin(2 * np.pi * function.at / function.period) + 0.01
    other = demo.changed(inflow_ml_s=demo.case.inflow_ml_s + added)
    np.testing.assert_allclose(demo.solved("flow-record", values), other, atol=2e-4)


def test_the_timing_of_all_harmonics_by_whole_samples_is_a_rolled_inflow(demo):
    n, period = len(demo.case.inflow_ml_s), demo.case.network.period_s
    other = demo.changed(inflow_ml_s=np.roll(demo.case.inflow_ml_s, 12))
    values = np.full(len(demo.functions["flow-timing"].at), 12 * period / n)
    np.testing.assert_allclose(demo.solved("flow-timing", values), other, atol=1e-6)


def test_a_filter_of_one_gain_for_all_harmonics_scales_the_flow_about_its_mean(demo):
    flow = demo.case.inflow_ml_s
    other = demo.changed(inflow_ml_s=flow.mean() + 1.1 * (flow - flow.mean()))
    values = np.full(len(demo.functions["flow-filter"].at), math.log(1.1))
    np.testing.assert_allclose(demo.solved("flow-filter", values), other, atol=1e-6)


def test_a_causal_filters_phase_is_that_of_a_low_pass_and_of_a_resonance():
    """Bode's relation, where the closed forms of two causal filters are known."""
    knots = np.linspace(math.log(1e-4), math.log(1e4), 400)
    x = np.linspace(math.log(0.1), math.log(10.0), 9)
    ratio = np.exp(x)
    low = -0.5 * np.log1p(np.exp(2 * knots))
    np.testing.assert_allclose(minimum_phase(knots, x) @ low, -np.arctan(ratio), atol=2e-3)
    made = 1 / (1 - np.exp(2 * knots) + 0.6j * np.exp(knots))
    phase = np.angle(1 / (1 - ratio**2 + 0.6j * ratio))
    np.testing.assert_allclose(minimum_phase(knots, x) @ np.log(np.abs(made)), phase, atol=4e-3)


def test_curves_go_through_their_knots_and_round_the_period():
    at, values = np.array([0.1, 0.3, 0.5, 0.9]), np.array([1.0, -1.0, 2.0, 0.5])
    np.testing.assert_allclose(curve(at, at) @ values, values)
    np.testing.assert_allclose(curve(at, at + 3.0, period=1.0) @ values, values)
    early, late = curve(at, [0.02], period=1.0), curve(at, [1.02], period=1.0)
    np.testing.assert_allclose(early, late)
    between = CubicSpline(np.append(at, 1.1), np.append(values, values[0]), bc_type="periodic")
    np.testing.assert_allclose(late @ values, between([1.02]))
    np.testing.assert_allclose(curve(at, [-5.0, 7.0]) @ values, values[[0, -1]])
    beyond = curve(at, [1.0, 1.1, 1.2], linear=True) @ values
    assert beyond[2] - beyond[1] == pytest.approx(beyond[1] - beyond[0])
    np.testing.assert_allclose(curve(at[:1], at) @ values[:1], 1.0)


# ---------------------------------------------------------------------------------------------------
# geometry, wall, outlets, fluid


def test_scattered_radii_and_lengths_are_a_network_of_others(demo):
    values = 0.1 * np.random.default_rng(1).standard_normal(len(demo.case.network.ids))
    net, scale = demo.case.network, np.exp(values)
    wider = replace(net, radius_in_cm=net.radius_in_cm * scale, radius_out_cm=net.radius_out_cm * scale)
    assert np.array_equal(demo.solved("radius-scatter", values), demo.changed(network=wider))
    longer = replace(net, length_cm=net.length_cm * scale)
    as_many = np.maximum(2, np.rint(net.length_cm / demo.case.options.dx_cm)).astype(int)
    options = replace(demo.case.options, cells=tuple(as_many.tolist()))
    other = demo.model.solve(replace(demo.case, network=longer, options=options))
    # a vessel that would have cells too short for the steps has fewer
    np.testing.assert_allclose(demo.solved("length-scatter", values), other, atol=5e-3)
    change = np.abs(other - demo.series).max()
    assert change > 0.02


def test_a_length_far_shorter_keeps_its_cells_long_enough_for_the_steps(demo):
    values = np.zeros(len(demo.case.network.ids))
    values[np.argmax(demo.case.network.length_cm)] = -1.5
    assert np.all(np.isfinite(demo.solved("length-scatter", values)))


def test_a_radius_by_size_is_a_scatter_that_follows_the_radius(demo):
    knots = demo.functions["radius-by-size"].at
    log_radius = np.log(demo.case.network.radius_in_cm)
    scatter = 0.05 + 0.1 * (log_radius - log_radius.mean())
    values = 0.05 + 0.1 * (knots - log_radius.mean())
    np.testing.assert_allclose(
        demo.solved("radius-by-size", values), demo.solved("radius-scatter", scatter), atol=1e-6
    )


def test_scattered_stiffness_and_loads_are_parameters_of_others(demo):
    random, net = np.random.default_rng(2), demo.case.network
    values = 0.2 * random.standard_normal(len(net.ids))
    other = demo.changed(stiffness=demo.case.stiffness * np.exp(values))
    assert np.array_equal(demo.solved("stiffness-scatter", values), other)

    values = 0.3 * random.standard_normal(len(net.terminals))
    scale = np.ones(len(net.ids))
    scale[net.terminals] = np.exp(values)
    both = demo.changed(psi1=demo.case.psi1 * scale, psi2=demo.case.psi2 * scale)
    assert np.array_equal(demo.solved("outlet-resistance", values), both)
    assert np.array_equal(
        demo.solved("outlet-first-resistance", values), demo.changed(psi1=demo.case.psi1 * scale)
    )
    assert np.array_equal(demo.solved("outlet-compliance", values), demo.changed(c=demo.case.c * scale))
    loads = demo.changed(psi1=demo.case.psi1 * scale, psi2=demo.case.psi2 * scale, c=demo.case.c / scale)
    assert np.allclose(demo.solved("outlet-loads", np.concatenate([values, -values])), loads, rtol=1e-12)


def test_a_law_whose_slope_is_the_tangent_walls_is_the_tangent_wall(demo):
    """Pressure, and what is added to the law, against eq. (3.4) with the same stiffness at rest."""
    gamma, at = 5.0, np.linspace(1.0, 1.7, 15)
    b = math.pi / gamma
    log_slope = np.log(at / np.cos(b * (at**2 - 1)) ** 2)
    stretch = np.array([1.0, 1.15, 1.33, 1.5])
    expected = np.tan(b * (stretch**2 - 1)) / (2 * b) - (stretch - 1)
    np.testing.assert_allclose(added_pressure(demo.case, at, log_slope, stretch), expected, atol=2e-4)
    tangent = CATALOGUE["tangent-wall"].apply(demo.case, (1 / gamma,), Location())
    found = demo.free.solve(added_law(demo.case, log_slope, at))
    other = demo.free.solve(tangent)
    np.testing.assert_allclose(found, other, atol=0.02)
    assert np.abs(other - demo.series).max() > 0.5
    # on top of a tangent wall the slope is that law's: back to half of its stiffness everywhere
    half = added_law(tangent, np.full(15, math.log(0.8)), at)
    weaker = replace(tangent, stiffness=0.8 * tangent.stiffness)
    np.testing.assert_allclose(demo.free.solve(half), demo.free.solve(weaker), atol=5e-3)


def test_a_law_of_one_factor_is_a_stiffness_and_two_of_them_add_up(demo):
    law = demo.functions["wall-law"]
    values = np.full(len(law.at), math.log(1.2))
    other = demo.changed(stiffness=1.2 * demo.case.stiffness)
    np.testing.assert_allclose(demo.solved("wall-law", values), other, atol=1e-3)
    first = law.apply(demo.case, 0.1 * np.sin(np.arange(len(law.at))))
    second = law.apply(first, np.zeros(len(law.at)))
    np.testing.assert_allclose(demo.model.solve(second), demo.model.solve(first), atol=1e-4)


def test_a_friction_of_one_factor_is_that_of_the_viscosity_whose_root_it_is(demo):
    """Friction goes with the viscosity over the Stokes layer's thickness, its square root."""
    values = np.full(len(demo.functions["friction-law"].at), 0.3)
    thicker = replace(demo.case.network, viscosity=demo.case.network.viscosity * math.exp(0.6))
    np.testing.assert_allclose(demo.solved("friction-law", values), demo.changed(network=thicker), atol=5e-4)


def test_a_friction_by_speed_is_the_solvers_factor_of_the_speed(demo):
    at = demo.functions["friction-law"].at
    speeds = np.linspace(0.0, at[-1], 60)
    table = FrictionFunction(0.0, float(at[-1]), tuple(np.exp(speeds / at[-1])))
    other = demo.model.solve(with_physics(demo.case, friction_function=table))
    np.testing.assert_allclose(demo.solved("friction-law", at / at[-1]), other, atol=1e-3)
    assert np.abs(other - demo.series).max() > 0.1


def test_a_loss_by_velocity_squared_is_the_listed_one(demo):
    function = demo.functions["junction-loss"]
    largest = np.abs(function.at).max()
    listed = CATALOGUE["minor-losses"].apply(demo.case, (0.8,), Location())
    other = demo.model.solve(listed)
    found = demo.solved("junction-loss", 0.8 * np.abs(function.at) / largest)
    assert np.abs(other - demo.series).max() > 0.2
    np.testing.assert_allclose(found, other, atol=0.02 * np.abs(other - demo.series).max())


def test_the_outlets_impedance_is_the_circuits_times_the_function(demo):
    """At all harmonics of the beat; v of a wider outlet is that of a lower frequency."""
    function, net = demo.functions["outlet-impedance"], demo.case.network
    radii = net.radius_out_cm[net.terminals]
    values = 0.4 * function.root(0.35) @ np.random.default_rng(5).standard_normal(len(function.at))
    omega = 2 * np.pi / net.period_s * np.arange(21)
    Z, found = (outlet_impedance(c, omega) for c in (demo.case, function.apply(demo.case, values)))
    through = CubicSpline(function.at, values, bc_type="natural")
    assert np.ptp(radii) > 0.1 * radii.mean()
    for radius, before, after in zip(radii, Z, found, strict=True):
        like = np.log(omega[1:] / (2 * np.pi) * radius / np.exp(np.log(radii).mean()))
        wanted = through(np.clip(like, function.at[0], function.at[-1]))
        np.testing.assert_allclose(np.log(np.abs(after / before)[1:]), wanted, atol=1e-9)
        assert after[0] == pytest.approx(before[0] * np.exp(values[0]))


def test_the_outlets_impedance_has_the_phase_of_a_causal_one(demo):
    """What a smaller resistance and a larger compliance behind R1 change, by its modulus alone."""
    function, net = demo.functions["outlet-impedance"], demo.case.network
    omega = 2 * np.pi / net.period_s * np.arange(21)
    other = replace(demo.case, psi2=0.8 * demo.case.psi2, c=1.5 * demo.case.c)
    i, radii = 3, net.radius_out_cm[net.terminals]
    frequencies = np.exp(function.at) * np.exp(np.log(radii).mean()) / radii[i]
    there = [outlet_impedance(c, 2 * np.pi * frequencies)[i] for c in (demo.case, other)]
    values = np.log(np.abs(there[1] / there[0]))
    Z, found, wanted = (
        outlet_impedance(c, omega)[i] for c in (demo.case, function.apply(demo.case, values), other)
    )
    assert np.abs(np.angle(wanted / Z))[1:6].max() > 0.05
    np.testing.assert_allclose(np.angle(found / Z)[2:16], np.angle(wanted / Z)[2:16], atol=0.03)


def test_an_impedance_times_a_number_is_resistances_and_a_compliance(demo):
    values = np.full(len(demo.functions["outlet-impedance"].at), 0.1)
    scale = math.exp(0.1)
    other = demo.changed(psi1=demo.case.psi1 * scale, psi2=demo.case.psi2 * scale, c=demo.case.c / scale)
    np.testing.assert_allclose(demo.solved("outlet-impedance", values), other, atol=5e-3)


def test_a_resistance_that_does_not_follow_the_pressure_is_a_resistance(demo):
    values = np.full(len(demo.functions["outlet-state"].at), 0.1)
    other = demo.changed(psi2=demo.case.psi2 * math.exp(0.1))
    np.testing.assert_allclose(demo.solved("outlet-state", values), other, atol=2e-3)


def test_a_resistance_at_pressures_that_are_not_visited_says_nothing(demo):
    function, case = demo.functions["outlet-state"], demo.case
    at = case.network.terminals
    places = [(int(v), 1.0, q) for q in ("pressure_mmHg", "flow_ml_s") for v in case.network.ids[at]]
    pressure, flow = simulate(case, places, demo.data.times).reshape(2, len(at), -1)
    behind = pressure - (case.psi1 * case.network.R1)[at, None] * flow / case.conventions.mmhg
    size = np.sqrt(np.mean(demo.columns("outlet-state") ** 2, axis=(1, 2)))
    assert function.at[0] < behind.min()
    assert behind.max() < function.at[-1]
    assert max(size[0], size[-1]) < 0.05 * size.max()
    assert abs(function.at[np.argmax(size)] - behind.mean()) < np.diff(function.at)[0]


def test_one_viscosity_for_all_radii_is_the_networks(demo):
    values = np.full(len(demo.functions["viscosity-by-radius"].at), 0.3)
    # the Stokes layer's thickness and friction both have the viscosity of the blood
    thicker = replace(demo.case.network, viscosity=demo.case.network.viscosity * math.exp(0.3))
    np.testing.assert_allclose(
        demo.solved("viscosity-by-radius", values), demo.changed(network=thicker), atol=1e-6
    )


def test_stiffness_that_is_constant_in_time_is_a_stiffness(demo):
    values = np.full(len(demo.functions["wall-in-time"].at), 0.1)
    other = demo.changed(stiffness=demo.case.stiffness * math.exp(0.1))
    np.testing.assert_allclose(demo.solved("wall-in-time", values), other, atol=1e-4)


def test_what_the_model_has_as_parameters_is_no_component():
    theta = {"m_chi": 4.6e4, "v_chi": 1e8, "chi": np.full(21, 4.6e4), "psi1": 0.35, "psi2": 0.9, "c": 1.2}
    names = set(Bench("demo", "linear-vessels", theta).functions)
    assert not names & {"stiffness-scatter", "stiffness-by-radius"}
    assert {"wall-in-time", "radius-scatter"} <= names


def test_functions_act_on_top_of_the_models_effects(demo):
    effect, location = CATALOGUE["vessel-radius"], Location(2, noun="vessel")
    changed = effect.apply(demo.case, (0.2,), location)
    values = np.zeros(21)
    values[1] = 0.2
    twice = np.zeros(21)
    twice[1] = 0.4
    radius = demo.functions["radius-scatter"]
    np.testing.assert_allclose(
        demo.model.solve(radius.apply(changed, values)), demo.solved("radius-scatter", twice), atol=1e-6
    )


# ---------------------------------------------------------------------------------------------------
# sensor


def test_the_sensors_filter_is_the_transfer_function_times_the_series_harmonics(demo):
    function = demo.functions["sensor-filter"]
    values = 0.2 * np.cos(np.arange(len(function.at)))
    n, period = demo.data.n_times, demo.case.network.period_s
    omega = 2 * np.pi / period * np.arange(n // 2 + 1)
    response = gain_response(omega, function.at, values)
    expected = np.fft.irfft(np.fft.rfft(demo.series) * response, n)
    np.testing.assert_allclose(demo.solved("sensor-filter", values), expected, atol=2e-3)
    # |H| goes through the values at the knots, and H(0) = 1
    at = np.exp(function.at[0])
    spline = CubicSpline(function.at, values, bc_type="natural")
    heard = slice(1, 1 + round(np.exp(function.at[-1]) * period))
    log_gain = spline(np.log(omega[heard] / (2 * np.pi)))
    np.testing.assert_allclose(np.abs(response[heard]), np.exp(log_gain))
    assert at == pytest.approx(1 / period)
    np.testing.assert_allclose(expected.mean(axis=1), demo.series.mean(axis=1))


def test_a_delay_of_all_harmonics_moves_the_series(demo):
    function, n = demo.functions["sensor-timing"], demo.data.n_times
    values = np.full(len(function.at), 3 * demo.case.network.period_s / n)
    np.testing.assert_allclose(
        demo.solved("sensor-timing", values), np.roll(demo.series, 3, axis=1), atol=2e-3
    )
    omega = np.arange(5.0)
    np.testing.assert_allclose(delay_response(omega, function.at, values * 0), 1.0)


def test_a_bent_reading_is_the_series_plus_a_curve_of_it(demo):
    function = demo.functions["sensor-curve"]
    values = -0.02 * (function.at - function.at.mean()) ** 2
    y = demo.series
    inside = (y > function.at[1]) & (y < function.at[-2])
    difference = demo.solved("sensor-curve", values) - (y - 0.02 * (y - function.at.mean()) ** 2)
    assert np.abs(difference[inside]).max() < 0.02
    # values on a line: exact, also beyond the knots
    line = 0.1 + 0.05 * function.at
    np.testing.assert_allclose(demo.solved("sensor-curve", line), 0.1 + 1.05 * y, atol=1e-4)


# ---------------------------------------------------------------------------------------------------
# plausibility


def test_what_is_believed_is_said_with_its_size_and_reason(demo):
    radius = demo.functions["radius-scatter"]
    believed, why = plausible(radius, np.full(21, math.log(1.1)))
    assert believed
    assert why.startswith("the radii would have to be off by 10 %: micro-CT of an excised lung can be")
    believed, why = plausible(radius, np.full(21, math.log(1.5)))
    assert not believed
    assert "by 50 %" in why
    assert "not believed" in why
    assert plausible(demo.functions["flow-timing"], [0.1] * 6)[0] is False
    assert "100 ms" in plausible(demo.functions["flow-timing"], [0.1] * 6)[1]
    assert "a factor of 3" in plausible(demo.functions["outlet-resistance"], [math.log(3.0)] * 11)[1]


def test_each_size_has_a_source():
    for name, said in TABLE.items():
        assert re.search(r"doi\s10\.\d{4}|computed|ANSI/AAMI", said["why"]), name
        assert not said["why"].startswith("assumed"), name


def test_a_structured_tree_by_recursion_is_the_effect_s_own():
    """Two programs of Olufsen's tree: the benchmark's, and the effect's from resistance and compliance."""
    root, length, slope = 0.02, 30.0, 4e4
    omega = 2 * np.pi / 0.11 * np.array([0.0, 1, 2, 5, 12, 20])
    found = structured_trees.tree(
        root, omega, daughters=(0.9, 0.6), length=length, smallest_cm=0.1 * root, slope=lambda r: slope,
        density=1.055, viscosity=lambda r: 0.049,
    )  # fmt: skip

    def volume(radius):  # of all vessels from this one on, each down to where a daughter has none
        own = np.pi * radius**3 * length
        if radius < 0.1 * root * (1 - 1e-9):
            return own
        return own + volume(0.9 * radius) + volume(0.6 * radius)

    [wanted] = tree_impedance([root], [found[0].real], [volume(root) / slope], 1.055, 0.049, omega)
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


def test_a_structured_tree_of_a_human_lung_is_what_the_outlets_prior_believes(demo):
    """Daughters of 0.805 and 0.639, lengths of 33.5 radii down to 0.094 mm, behind outlets of 0.9 and 1.1 cm.

    The nearest three-element circuit misses its first harmonic by about half. At a length of 0.75 what is
    missing would be ten times the size.
    """
    said = TABLE["outlet-impedance"]
    row = np.array([math.log(1e7), -20.0, math.log(2.8e5), 0.805, 0.639, 33.5, 0.0094])
    for impedance in structured_trees.of_a_lung(row):
        sizes = [
            structured_trees.size_beside_circuit(impedance, 0.9, length) for length in said["lengths"][:2]
        ]
        assert 0.5 * said["size"] < min(sizes) < 2 * said["size"]
        assert sizes[1] > 10 * sizes[0]
        rms = structured_trees.size_beside_circuit(impedance, 0.9, 0.0)
        assert plausible(demo.functions["outlet-impedance"], [rms])[0]


def test_a_flow_record_3_per_cent_of_a_beat_late_can_be_believed(demo):
    """26 ms of 845 ms, measured in a pig: one prior size of the inflow's timing, two of the sensor's."""
    late = 0.026 / 0.845 * demo.case.network.period_s
    for name, most in (("flow-timing", 1.1), ("sensor-timing", 2.1)):
        function = demo.functions[name]
        assert late < most * function.size
        assert plausible(function, [late] * len(function.at))[0]


def test_a_single_vessel_has_one_viscosity_without_a_length():
    one = free_function("viscosity-by-radius", np.array([0.1]), lambda case, values: case)
    assert one.lengths == ()


def test_the_page_of_a_function_says_its_size_and_what_is_believed(demo):
    words = function_words(demo.functions["outlet-impedance"])
    assert "Z(f) -> Z(f) exp(v(f r/r0))" in words
    assert "| prior size | 0.35 log impedance (41.9 %) |" in words  # exp(0.35) = 1.419
    assert "| believed up to | a factor of 2.01: " in words  # exp(2 * 0.35)
    assert "| free at | each vessel, 21 in `demo` |" in function_words(demo.functions["radius-scatter"])
