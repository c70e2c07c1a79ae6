"""The catalogue of effects: 0 is the base, each has an answer known without the solver, stacking, bases."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pytest
from docs.pages import Response, cell, effect_words, responses, rms, typical_values
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.special import jv

import zoo
from walls import wall_pressure_mmHg
from zoo.blood.baseline import get_baseline
from zoo.blood.blood_flow import study_data
from zoo.blood.case import Case, Wave, members, simulate, total_resistance
from zoo.blood.components import components
from zoo.blood.effects import CATALOGUE, FAMILIES, Effect, EffectError, EffectParameter, Location, at_vessel
from zoo.blood.effects.fluid import relative_viscosity
from zoo.blood.effects.outflow import ladder_sections
from zoo.blood.effects.structured_tree import tree_impedance
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Blood, Study, StudyError, Vessel, Windkessel, load_study
from zoo.blood.study_diagnosis import effects_for
from zoo.blood.units import MMHG
from zoo.core.effects import effect, with_effects
from zoo.core.forward import SolveError
from zoo.core.parameters import pack, start_of

Array = NDArray[np.float64]

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "effects.md"
SOLVED = [name for name in CATALOGUE if CATALOGUE[name].apply is not None]
ROOT = [(1, 0.0, "pressure_mmHg")]


@pytest.fixture(scope="module")
def study() -> Study:
    return load_study("demo")


@pytest.fixture(scope="module")
def case(study: Study) -> Case:
    return of_baseline("linear-constant", study)


@pytest.fixture(scope="module")
def plain(case: Case) -> Array:
    return solved(case, ROOT)


PAPER = {"set": "paun2020"}


def of_baseline(name: str, study: Study, **settings: Any) -> Case:
    """The case at a baseline's start, the published medians."""
    model = get_baseline(name).forward(study, **{"priors": PAPER} | settings)
    return model.configure(pack(model.parameters, start_of(model.parameters)))


def beat(case: Case, n: int = 256) -> Array:
    return np.arange(n, dtype=np.float64) * (case.network.period_s / n)


def solved(case: Case, series: list[tuple[int, float, str]], n: int = 256) -> Array:
    return simulate(case, series, beat(case, n))


def added(case: Case, name: str, *values: float, place: Location | None = None) -> Case:
    """With one effect; the values of its shapes are their centres unless given."""
    effect = CATALOGUE[name].of(case)
    rest = tuple(a.centre for a in effect.parameters[len(values) :])
    return effect.apply(case, (*values, *rest), place or effect.locations(case)[0])


def tube(flow_ml_s: float = 0.02, **changed: Any) -> Case:
    """One short stiff vessel with a steady inflow: Poiseuille's and Kirchhoff's laws give its pressures."""
    vessel = {"length_cm": 0.5, "radius_cm": 0.03, "radius_out_cm": 0.03} | changed
    load = Windkessel(2e4, 8e4, 1e-7)
    network = Network.from_vessels([Vessel(1, "tube", windkessel=load, **vessel)], Blood(1.055, 0.049), 0.11)
    time = np.arange(64, dtype=np.float64) * (0.11 / 64)
    ones = np.ones(1)
    scales = {"stiffness": 1e6 * ones, "gamma": 2 * ones, "psi1": ones, "psi2": ones, "c": ones}
    flow, options = np.full(64, flow_ml_s), SolverOptions(tolerance_mmHg=1e-6, max_beats=200)
    demo = of_baseline("B", load_study("demo"))
    return replace(demo, network=network, inflow_time_s=time, inflow_ml_s=flow, options=options, **scales)


def harmonics(values: Array) -> NDArray[np.complex128]:
    return np.asarray(np.fft.rfft(values) / values.shape[-1])


# ---------------------------------------------------------------------------------------------------
# The catalogue


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_entry_is_complete(name: str) -> None:
    effect = CATALOGUE[name]
    assert effect.family in FAMILIES
    assert all(
        text and text == text.strip() for text in (effect.statement, effect.equation, effect.signature)
    )
    assert effect.statement.endswith(".")
    assert re.search(r"doi 10\.\d{4,}/\S+|definition|Math\. Biosci\. Eng\.", effect.source)
    assert effect.parameters[0].zero_is_base
    for amplitude in effect.parameters:
        assert amplitude.name
        assert amplitude.unit
        assert amplitude.why
        assert amplitude.scale > 0
        assert amplitude.low < amplitude.high
        assert amplitude.starts
        assert all(start != 0 and amplitude.low <= start <= amplitude.high for start in amplitude.starts)
        if not amplitude.zero_is_base:
            assert amplitude.low <= amplitude.centre <= amplitude.high
        elif amplitude.continuous:
            assert amplitude.low <= 0 <= amplitude.high
            assert amplitude.centre == 0
        else:
            assert amplitude.low > 0


def test_unknown_names_are_refused_with_the_nearest() -> None:
    with pytest.raises(EffectError, match=r"effect 'stenoses': unknown; did you mean 'stenosis'\?"):
        CATALOGUE["stenoses"]
    with pytest.raises(EffectError, match="family = 'walls': unknown; did you mean 'wall'"):
        CATALOGUE.add(Effect("x", (EffectParameter("a", "1", 1.0, 0.0, 1.0, (0.1,)),), None, family="walls"))


def test_wrong_values_and_places_are_refused(case: Case) -> None:
    apply = CATALOGUE["catheter-resonance"].apply
    with pytest.raises(EffectError, match=r"give finite numbers for 1/f_n \(s\), damping \(1\)"):
        apply(case, (0.01,), Location())
    with pytest.raises(EffectError, match="finite"):
        apply(case, (float("nan"), 0.3), Location())
    with pytest.raises(EffectError, match="stenosis: location: is missing"):
        added(case, "stenosis", 0.3, place=Location())
    with pytest.raises(StudyError, match="vessel = 99"):
        added(case, "stenosis", 0.3, place=at_vessel(99))
    with pytest.raises(EffectError, match="correlated-noise: is part of the errors"):
        with_effects(get_baseline("B").forward(load_study("demo")), [CATALOGUE["correlated-noise"].at()])
    with pytest.raises(EffectError, match="use a linear baseline"):
        added(of_baseline("H", load_study("demo")), "tangent-wall", 0.2)


def test_places(case: Case) -> None:
    network = case.network
    assert CATALOGUE["taper"].locations(case) == (Location(),)
    assert CATALOGUE["stenosis"].locations(case) == tuple(at_vessel(v) for v in range(1, 22))
    inner = CATALOGUE["local-stiffness"].locations(case)[21:]
    assert [place.part for place in inner] == [2, 3, 4, 6, 8, 10, 14, 16, 18]
    assert all(place.subtree for place in inner)
    sides = CATALOGUE["uneven-resistance"].locations(case)
    assert sides[0] == at_vessel(2, True)
    assert [p.part for p in sides[1:]] == [5, 7, 9, 11, 12, 13, 15, 17, 19, 20, 21]
    assert network.ids[members(network, at_vessel(8, True))].tolist() == [8, 10, 11, 12, 13]
    assert (str(Location()), str(at_vessel(3))) == ("everywhere", "vessel 3")
    assert str(at_vessel(3, True)) == "vessel 3 and below"


@pytest.mark.parametrize("name", CATALOGUE)
def test_pickles(name: str, case: Case) -> None:
    assert pickle.loads(pickle.dumps(CATALOGUE[name])) is CATALOGUE[name]
    if name in SOLVED:
        changed = added(case, name, *typical_values(CATALOGUE[name].of(case))[:1])
        again = pickle.loads(pickle.dumps(changed))
        assert len(again.waves) == len(changed.waves)
        np.testing.assert_array_equal(again.stiffness, changed.stiffness)


def one_vessel(period_s: float, radius_cm: float) -> Any:
    """The baseline of a study of one vessel."""
    load = Windkessel(180.0, 4400.0, 4.5e-4)
    vessel = Vessel(1, "aorta", length_cm=6.0, radius_cm=radius_cm, radius_out_cm=radius_cm, windkessel=load)
    time = np.arange(64) * (period_s / 64)
    study = Study("one", period_s, Blood(1.055, 0.04), (vessel,), time, 90 + 80 * np.sin(time), time, ())
    return get_baseline("linear-constant").forward(study)


def test_what_acts_where_vessels_meet_is_not_offered_to_one_vessel() -> None:
    """Its solves would differ by rounding alone, which leaves each with the probability of its prior."""
    one, tree = one_vessel(0.84, 1.1), get_baseline("linear-constant").forward(load_study("demo"))
    offered = {effect.name for effect in effects_for(one)}
    assert "viscoelastic-wall" in offered
    for name in ("total-pressure-junctions", "minor-losses"):
        assert name not in offered
        assert len(CATALOGUE[name].locations(tree)) == 1
        with pytest.raises(EffectError, match=f"effect {name}: acts nowhere in this study; leave it out"):
            effects_for(one, ["taper", name])


def test_sizes_follow_the_study() -> None:
    """A beat 7.6 times as long has a prior 7.6 times as wide; what is not a time is the same in both."""
    mouse, man = get_baseline("linear-constant").forward(load_study("demo")), one_vessel(0.84, 1.1)
    wanted = {
        "inflow-shift": (0.0033, 0.0252),
        "inflow-bandwidth": (0.00297, 0.02268),
        "viscoelastic-wall": (0.00297, 0.02268),
        "beat-jitter": (0.00396, 0.03024),
        "catheter-resonance": (0.0154, 0.1176),
        "terminal-inertance": (0.49364, 33.0),
        "sensor-offset": (2.0, 2.0),
        "minor-losses": (2.0, 2.0),
    }
    for name, sizes in wanted.items():
        for model, size in zip((mouse, man), sizes, strict=True):
            first = CATALOGUE[name].of(model).parameters[0]
            assert first.scale == pytest.approx(size, rel=1e-4), name
            ratio = first.scale / CATALOGUE[name].parameters[0].scale
            assert first.high == pytest.approx(CATALOGUE[name].parameters[0].high * ratio)
            assert first.starts == pytest.approx([s * ratio for s in CATALOGUE[name].parameters[0].starts])
    for name, centres in (
        ("correlated-noise", (0.00297, 0.02268)),
        ("radius-dependent-stiffness", (0.0164, 0.814)),
    ):
        for model, centre in zip((mouse, man), centres, strict=True):
            assert CATALOGUE[name].of(model).parameters[1].centre == pytest.approx(centre, rel=2e-3)


def test_a_flow_that_came_3_per_cent_of_a_beat_late_is_what_the_prior_believes() -> None:
    """26 ms of 845 ms, measured in a pig, and 25 ms of 840 ms: 0.9 to 1.1 sd; a mouse's 3 ms are 8 sd."""
    for late_s, period_s in ((0.026, 0.845), (0.025, 0.84)):
        shift = CATALOGUE["inflow-shift"].of(one_vessel(period_s, 1.1)).parameters[0]
        assert 0.9 < late_s / shift.scale < 1.1
        assert shift.low < -late_s - 0.003
    throat = CATALOGUE["stenosis"].apply(_configured(one_vessel(0.84, 1.1)), (0.5,), at_vessel(1))
    assert throat.physics.throat_length[0] == pytest.approx(3.2 * 1.1)


def _configured(model: Any) -> Case:
    return model.configure(pack(model.parameters, start_of(model.parameters)))


def test_a_model_with_effects_has_their_sizes_in_its_units(study: Study) -> None:
    model = get_baseline("linear-constant").forward(study)
    plain = CATALOGUE["inflow-shift"]
    for one in (plain, plain.of(model)):
        parameter = with_effects(model, [one.at()]).parameters[-1]
        assert parameter.prior.sd == pytest.approx(0.0033)
        assert parameter.start == pytest.approx(0.0022)
    own = Effect("own", (EffectParameter("a", "s", 0.003, -0.02, 0.02, (0.002,)),), plain.apply)
    assert own.of(model) is own
    with pytest.raises(EffectError, match="given twice"):
        with_effects(model, [plain.at(), plain.of(model).at()])
    sized = plain.of(model)
    assert sized.parameters[0].text == "normal(0, 0.0033) in [-0.022, 0.022] s"
    assert plain.parameters[0].text == "normal(0, 0.03) in [-0.2, 0.2] beats"
    assert pickle.loads(pickle.dumps(sized)) == sized
    assert pickle.loads(pickle.dumps(sized)).parameters[0].scale == pytest.approx(0.0033)


def test_a_diagnosis_is_offered_the_sizes_of_its_study(study: Study) -> None:
    model = get_baseline("linear-constant").forward(study)
    named = {one.name: one for one in effects_for("linear-constant")}
    sized = {one.name: one for one in effects_for(model)}
    assert named.keys() == sized.keys()
    assert named["beat-jitter"].parameters[0].measure is not None
    assert all(p.measure is None for one in sized.values() for p in one.parameters)


# ---------------------------------------------------------------------------------------------------
# Amplitude 0, small amplitudes, stacking


@pytest.mark.parametrize("name", SOLVED)
def test_amplitude_0_is_the_base(name: str, case: Case) -> None:
    effect = CATALOGUE[name].of(case)
    zero = (0.0, *typical_values(effect)[1:])
    assert all(effect.apply(case, zero, place) is case for place in effect.locations(case))


def test_the_order_of_effects_does_not_matter(study: Study, case: Case) -> None:
    places = {"vessel-length": at_vessel(18), "uneven-resistance": at_vessel(2, True)}
    names = "hydrostatic side-branches distributed-outflow structured-tree catheter-resonance sensor-offset"
    names = [*places, *names.split(), "inflow-shift", "coarse-grid"]
    chosen = [CATALOGUE[name].at(places.get(name, Location())) for name in names]
    found = []
    for order in (chosen, chosen[::-1]):
        model = with_effects(get_baseline("B").forward(study), order)
        theta = start_of(model.parameters)
        for one in order:
            values = typical_values(one.effect.of(case))
            theta |= {p.name: np.asarray(v) for p, v in zip(one.parameters, values, strict=True)}
        found.append(solved(model.configure(pack(model.parameters, theta)), ROOT))
    np.testing.assert_array_equal(*found)
    assert np.max(np.abs(found[0] - solved(case, ROOT))) > 0.5


def test_an_effect_twice_adds_up(case: Case) -> None:
    for name in ("external-pressure", "minor-losses", "viscoelastic-wall", "side-branches", "hydrostatic"):
        typical = typical_values(CATALOGUE[name].of(case))[0]
        a, b = 0.2 * typical, 0.3 * typical
        twice, once = added(added(case, name, a), name, b), added(case, name, a + b)
        np.testing.assert_allclose(solved(twice, ROOT), solved(once, ROOT), atol=1e-3)


# ---------------------------------------------------------------------------------------------------
# Geometry and wall


def test_geometry_changes_what_it_says(case: Case) -> None:
    net = case.network
    wide = added(case, "vessel-radius", 0.1, place=at_vessel(3)).network
    at = net.index(3)
    assert wide.radius_in_cm[at] / net.radius_in_cm[at] == pytest.approx(np.exp(0.1))
    assert wide.radius_out_cm[at] / net.radius_out_cm[at] == pytest.approx(np.exp(0.1))
    assert np.sum(wide.radius_in_cm != net.radius_in_cm) == 1
    np.testing.assert_allclose(added(case, "taper", 0.2).network.radius_out_cm, 0.8 * net.radius_out_cm)
    np.testing.assert_array_equal(added(case, "taper", 0.2).network.radius_in_cm, net.radius_in_cm)
    throat = added(case, "stenosis", 0.5, place=at_vessel(5)).physics
    assert throat.throat_severity[net.index(5)] == 0.5
    assert throat.throat_severity.sum() == 0.5
    assert throat.throat_length[net.index(5)] == pytest.approx(0.8 * 0.052)
    assert throat.throat_length[net.index(1)] == pytest.approx(3.2 * 0.047)


def test_what_the_solver_does_with_its_physics_is_given_as_it_is(case: Case) -> None:
    """Waves with each of these fields are those of their equations in tests/test_physics.py."""
    n, net = len(case.network.ids), case.network
    assert added(case, "total-pressure-junctions", 0.7).physics.total_pressure == 0.7
    assert added(case, "minor-losses", 3.0).physics.junction_loss == 3.0
    np.testing.assert_array_equal(
        added(case, "viscoelastic-wall", 2e-3).physics.viscoelastic_time, np.full(n, 2e-3)
    )
    wanted = np.zeros(n)
    wanted[net.terminals] = net.density * 0.1 / (np.pi * net.radius_out_cm[net.terminals] ** 2)
    np.testing.assert_allclose(added(case, "terminal-inertance", 0.1).physics.inertance, wanted)


def test_a_length_is_free_where_conventions_truncate_it(study: Study) -> None:
    case = of_baseline("B", study, conventions=study.conventions.replace(truncate_lengths=True))
    changed = added(case, "vessel-length", 0.01, place=at_vessel(1))
    assert not changed.conventions.truncate_lengths
    assert changed.network.length_cm[0] == pytest.approx(np.floor(40 * 0.41) / 40 * np.exp(0.01))
    difference = solved(changed, ROOT) - solved(case, ROOT)
    assert 1e-3 < np.max(np.abs(difference)) < 0.05


@pytest.mark.parametrize("inverse_gamma", [0.05, 0.2, 0.7])
def test_the_tangent_wall_has_the_linear_slope_at_rest(inverse_gamma: float, case: Case) -> None:
    changed = added(case, "tangent-wall", inverse_gamma)
    h = 1e-5
    ends = np.array([1 - h, 1 + h])
    wanted = np.diff(wall_pressure_mmHg("linear", ends, case.stiffness[0]))
    found = np.diff(wall_pressure_mmHg("tangent", ends, changed.stiffness[0], changed.gamma[0]))
    assert found == pytest.approx(wanted, rel=1e-6)
    assert changed.wall == "tangent"
    assert changed.gamma[0] == pytest.approx(1 / inverse_gamma)


def test_stiffness_by_radius_is_equation_3_5(case: Case) -> None:
    chi, a, decay, radius = case.stiffness[0], 1.3, 0.02, case.network.radius_in_cm
    f1 = a * chi * np.exp(radius.min() / decay)
    np.testing.assert_allclose(
        added(case, "radius-dependent-stiffness", a, decay).stiffness,
        stiffness_profile(radius, f1, -1 / decay, chi),
    )


def test_local_stiffness_of_a_subtree(case: Case) -> None:
    ratio = added(case, "local-stiffness", 0.4, place=at_vessel(8, True)).stiffness / case.stiffness
    stiff = case.network.ids[ratio > 1].tolist()
    assert stiff == [8, 10, 11, 12, 13]
    assert ratio[case.network.index(8)] == pytest.approx(np.exp(0.4))


# ---------------------------------------------------------------------------------------------------
# Fluid and junctions


def test_a_parabolic_profile_obeys_poiseuille() -> None:
    changed = added(tube(), "velocity-profile", 1.0)
    assert changed.physics.momentum_correction == pytest.approx(4 / 3)
    assert changed.physics.viscous_friction == 8
    pressure = solved(changed, [(1, 0.0, "pressure_mmHg"), (1, 1.0, "pressure_mmHg")]).mean(axis=1)
    drop = 8 * 0.049 * 0.5 * 0.02 / (np.pi * 0.03**4) / MMHG
    # the vessel is a little wider than at rest
    assert pressure[0] - pressure[1] == pytest.approx(drop, rel=0.02)


def test_the_viscosity_follows_pries() -> None:
    parabolic = added(tube(radius_cm=0.01, radius_out_cm=0.01), "velocity-profile", 1.0)
    changed = added(parabolic, "radius-dependent-viscosity", 1.0)
    d = 200.0
    wanted = (220 * np.exp(-1.3 * d) + 3.2 - 2.44 * np.exp(-0.06 * d**0.645)) / 3.2
    assert changed.physics.viscosity_factor[0] == pytest.approx(wanted)
    assert relative_viscosity(1e6) == pytest.approx(3.2)
    assert 1 < relative_viscosity(7.0) < 1.5 < relative_viscosity(100.0)


def test_a_hydrostatic_head_distends_the_far_end() -> None:
    slope, flow = 0.5, 1e-3
    changed = added(replace(tube(flow), stiffness=np.array([1e5])), "hydrostatic", slope)
    series = [(1, x, q) for x in (0.0, 1.0) for q in ("pressure_mmHg", "area_cm2")]
    p0, a0, p1, a1 = solved(changed, series).mean(axis=1)
    assert p0 == pytest.approx(p1, abs=0.02)  # total head: hardly any flow, hardly any drop
    head = 1.055 * 980.665 * slope * 0.5 / MMHG
    walls = wall_pressure_mmHg("linear", np.array([a0, a1]) / (np.pi * 0.03**2), 1e5)
    assert p0 - walls[0] == pytest.approx(0, abs=1e-3)
    assert p1 - walls[1] == pytest.approx(head, abs=1e-3)


# ---------------------------------------------------------------------------------------------------
# Outflow


def outlet_impedance(changed: Case, vessel: int) -> NDArray[np.complex128]:
    """Pressure over flow at a terminal's outlet, harmonics 0 to 8, dyn s/cm5."""
    series = [(vessel, 1.0, "pressure_mmHg"), (vessel, 1.0, "flow_ml_s")]
    p, q = harmonics(solved(changed, series, 1024))
    return np.asarray((MMHG * p / q)[:9])


def windkessel(case: Case, vessel: int) -> NDArray[np.complex128]:
    at, net = case.network.index(vessel), case.network
    omega = 2 * np.pi / net.period_s * np.arange(9)
    r2 = case.psi2[at] * net.R2[at]
    return np.asarray(case.psi1[at] * net.R1[at] + r2 / (1 + 1j * omega * r2 * case.c[at] * net.C[at]))


def close(found: NDArray[Any], wanted: NDArray[Any], share: float = 0.01) -> bool:
    return bool(np.all(np.abs(found - wanted) < share * np.abs(wanted)))


def ladder_impedance(n: int, w: Array) -> NDArray[np.complex128]:
    """From its far end to its near one: R/n, then C/n in parallel, with R = C = 1."""
    z: NDArray[np.complex128] = np.zeros(len(w), dtype=np.complex128)
    for _ in range(n):
        z = np.asarray(1 / (1 / (z + 1 / n) + 1j * w / n))
    return z


@pytest.mark.parametrize("n", [1, 2, 5, 16])
def test_ladder_sections_are_the_ladder(n: int) -> None:
    rho, kappa = ladder_sections(n)
    w = np.geomspace(0.01, 1000, 40)
    assert rho.sum() == pytest.approx(1)
    assert np.all(rho > 0)
    found = np.sum(rho / (1 + 1j * w[:, None] * rho * kappa), axis=1)
    np.testing.assert_allclose(found, ladder_impedance(n, w), rtol=1e-9)


@pytest.mark.parametrize("extra", [2.0, 2.5])
def test_distributed_outflow_in_a_solve(extra: float, case: Case) -> None:
    at, net = case.network.index(12), case.network
    omega = 2 * np.pi / net.period_s * np.arange(9)
    r2 = case.psi2[at] * net.R2[at]
    w = omega * r2 * case.c[at] * net.C[at]
    part = extra % 1
    ladder = (1 - part) * ladder_impedance(3, w) + part * ladder_impedance(4, w)
    changed = added(case, "distributed-outflow", extra)
    assert close(outlet_impedance(changed, 12), case.psi1[at] * net.R1[at] + r2 * ladder)
    assert changed.physics.section_resistance.shape[1] == (3 if part == 0 else 7)


def test_the_longest_ladder_has_at_most_40_sections(case: Case) -> None:
    assert added(case, "distributed-outflow", 14.5).physics.section_resistance.shape[1] <= 40
    with pytest.raises(EffectError, match="must not be negative"):
        added(case, "distributed-outflow", -0.5)


def branch(radius: float, least: float, m: float, slope: float, w: float) -> complex:
    """Impedance of one small artery and all below it, as chain matrices of a lossy line."""
    z = 0j
    if radius >= least * (1 - 1e-9):
        z = 1 / (1 / branch(0.9 * radius, least, m, slope, w) + 1 / branch(0.6 * radius, least, m, slope, w))
    area, length = np.pi * radius**2, m * radius
    if w == 0:
        return complex(8 * np.pi * 0.049 * length / area**2 + z)
    k = 1j**1.5 * radius * np.sqrt(w * 1.055 / 0.049)
    series = 1j * w * 1.055 / area / (1 - 2 * jv(1, k) / (k * jv(0, k)))
    shunt = 1j * w * area / slope
    turn, own = np.sqrt(series * shunt) * length, np.sqrt(series / shunt)
    return complex((np.cosh(turn) * z + own * np.sinh(turn)) / (np.sinh(turn) * z / own + np.cosh(turn)))


def count(radius: float, least: float) -> tuple[float, int]:
    """Volume over m pi of a tree of small arteries, and how many there are."""
    ends = [count(f * radius, least) for f in (0.9, 0.6)] if radius >= least * (1 - 1e-9) else []
    return radius**3 + sum(v for v, _ in ends), 1 + sum(n for _, n in ends)


def test_tree_impedance_is_that_of_its_vessels() -> None:
    radius, resistance, compliance = 0.015, 2e6, 6e-8
    w = 2 * np.pi / 0.11 * np.array([0.0, 1, 5, 20, 40])
    found = tree_impedance([radius, 0.02], [resistance, 1e6], [compliance, 1e-7], 1.055, 0.049, w)[0]
    volume, vessels = count(radius, 0.1 * radius)
    assert vessels > 300
    m = resistance / branch(radius, 0.1 * radius, 1.0, 1.0, 0.0).real
    slope = m * np.pi * volume / compliance
    wanted = np.array([branch(radius, 0.1 * radius, m, slope, float(x)) for x in w])
    np.testing.assert_allclose(found, wanted, rtol=1e-9)
    assert found[0] == pytest.approx(resistance)


def trees_of(case: Case, at: Any, omega: Array) -> NDArray[np.complex128]:
    net = case.network
    sizes = net.radius_out_cm[at], total_resistance(case)[at], (case.c * net.C)[at]
    return tree_impedance(*sizes, net.density, net.viscosity, omega)


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_structured_tree_in_a_solve(share: float, case: Case) -> None:
    omega = 2 * np.pi / case.network.period_s * np.arange(9)
    [tree] = trees_of(case, [case.network.index(12)], omega)
    found = outlet_impedance(added(case, "structured-tree", share), 12)
    assert close(found, (1 - share) * windkessel(case, 12) + share * tree, 0.01)


def test_venous_pressure_is_where_the_windkessels_end(case: Case) -> None:
    changed = added(case, "venous-pressure", 4.0)
    for vessel in (5, 12, 20):
        series = [(vessel, 1.0, "pressure_mmHg"), (vessel, 1.0, "flow_ml_s")]
        pressure, flow = solved(changed, series, 1024).mean(axis=1)
        resistance = total_resistance(case)[case.network.index(vessel)] / MMHG
        assert pressure == pytest.approx(4 + resistance * flow, abs=0.01)


def test_uneven_resistance_moves_flow_to_the_other_side(case: Case) -> None:
    a, net = 0.6, case.network
    one = added(case, "uneven-resistance", a, place=at_vessel(12))
    assert one.psi1[net.index(12)] / case.psi1[0] == pytest.approx(np.exp(a))
    assert np.sum(one.psi2 != case.psi2) == 1
    sides = added(case, "uneven-resistance", a, place=at_vessel(2, True))
    left = members(net, at_vessel(2, True))
    np.testing.assert_allclose(sides.psi1 / case.psi1, np.where(left, np.exp(a), np.exp(-a)))
    flows = [(2, 0.0, "flow_ml_s"), (3, 0.0, "flow_ml_s")]
    before, after = (solved(c, flows).mean(axis=1) for c in (case, sides))
    assert after.sum() == pytest.approx(before.sum(), rel=1e-3)
    ratio = (after[0] / after[1]) / (before[0] / before[1])
    assert np.exp(-2 * a) < ratio < 1.3 * np.exp(-2 * a)  # the vessels' own resistance stays


def test_side_branches_carry_what_does_not_arrive(case: Case) -> None:
    share, net = 0.4, case.network
    changed = added(case, "side-branches", share)
    per_area = changed.physics.leak / net.radius_in_cm
    np.testing.assert_allclose(per_area, per_area[0])
    assert np.ptp(added(case, "side-branches", share, 0.0).physics.leak) == 0
    conductance = np.sum(1 / total_resistance(case)[net.terminals])
    assert np.sum(changed.physics.leak * net.length_cm) == pytest.approx(share * conductance)
    ends = [(int(v), 1.0, "flow_ml_s") for v in net.ids[net.terminals]]
    arrived = solved(changed, ends, 512).mean(axis=1).sum()
    places = [(int(v), x, "pressure_mmHg") for v in net.ids for x in np.linspace(0, 1, 9)]
    pressures = solved(changed, places).mean(axis=1).reshape(len(net.ids), 9)
    along = np.trapezoid(pressures, dx=1 / 8, axis=1) * MMHG * net.length_cm
    lost = np.sum(changed.physics.leak * along)
    assert arrived + lost == pytest.approx(case.inflow_ml_s.mean(), rel=2e-3)
    assert share < lost / arrived < 1.2 * share  # pressures are higher on the way than at the ends


def test_an_external_pressure_is_added_to_the_wall(case: Case) -> None:
    changed = added(case, "external-pressure", -3.0)
    for vessel, x in ((1, 0.0), (18, 0.5)):
        at = case.network.index(vessel)
        pressure, area = solved(changed, [(vessel, x, "pressure_mmHg"), (vessel, x, "area_cm2")])
        rest = np.pi * case.network.radius_in_cm[at] ** 2
        wall = wall_pressure_mmHg("linear", area / rest, float(case.stiffness[at]))
        np.testing.assert_allclose(pressure, wall - 3, atol=2e-3)


# ---------------------------------------------------------------------------------------------------
# Inflow and sensors


def test_inflow_gain_and_offset(case: Case) -> None:
    np.testing.assert_allclose(added(case, "inflow-gain", 0.2).inflow_ml_s, 1.2 * case.inflow_ml_s)
    shifted = added(case, "inflow-offset", -0.3).inflow_ml_s
    assert shifted.mean() == pytest.approx(0.7 * case.inflow_ml_s.mean())
    assert np.ptp(shifted - case.inflow_ml_s) < 1e-12


def test_inflow_shift_is_later(case: Case) -> None:
    n, period = len(case.inflow_ml_s), case.network.period_s
    whole = added(case, "inflow-shift", 10 * period / n).inflow_ml_s
    np.testing.assert_allclose(whole, np.roll(case.inflow_ml_s, 10), atol=1e-9)
    part = added(case, "inflow-shift", -0.0013).inflow_ml_s
    k = np.arange(60)
    ratio = harmonics(part)[:60] / harmonics(case.inflow_ml_s)[:60]
    np.testing.assert_allclose(ratio, np.exp(2j * np.pi * k * 0.0013 / period), rtol=1e-9)


def test_inflow_bandwidth_solves_its_equation(case: Case) -> None:
    tau, period, n = 0.004, case.network.period_s, len(case.inflow_ml_s)
    smooth = added(case, "inflow-bandwidth", tau).inflow_ml_s
    rate = np.fft.irfft(np.fft.rfft(smooth) * 2j * np.pi / period * np.arange(n // 2 + 1), n)
    assert np.max(np.abs(tau * rate + smooth - case.inflow_ml_s)) < 1e-3 * np.max(case.inflow_ml_s)
    assert smooth.mean() == pytest.approx(case.inflow_ml_s.mean())


def acted(case: Case, values: Array, quantity: str = "pressure_mmHg") -> Array:
    """What the sensors of a case make of one wave."""
    wave = Wave(values[None, :], (quantity,), case.network.period_s)
    for act in case.waves:
        wave = act(wave)
    return np.asarray(wave.value[0])


@pytest.mark.parametrize("damping", [0.1, 0.7])
def test_catheter_resonance_solves_its_equation(damping: float, case: Case) -> None:
    period, sensor = case.network.period_s, added(case, "catheter-resonance", 0.02, damping)
    t = beat(case, 1024)
    w = 2 * np.pi / 0.02

    def pressure(time: Any) -> Any:
        return 12 + 4 * np.cos(2 * np.pi * time / period) + np.sin(2 * np.pi * 6 * time / period)

    def motion(time: float, state: Array) -> list[float]:
        return [state[1], w**2 * (pressure(time) - state[0]) - 2 * damping * w * state[1]]

    start = 12 * period
    done = solve_ivp(motion, (0, start + period), [12.0, 0.0], t_eval=start + t, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(acted(sensor, pressure(t)), done.y[0], atol=1e-4)
    np.testing.assert_array_equal(acted(sensor, pressure(t), "flow_ml_s"), pressure(t))


def test_beat_jitter_is_a_mean_of_shifted_beats(case: Case) -> None:
    sd, period, t = 0.004, case.network.period_s, beat(case, 1024)

    def pressure(time: Any) -> Any:
        return 12 + np.exp(2 * np.cos(2 * np.pi * time / period))

    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    mean = sum(w * pressure(t - sd * x) for x, w in zip(nodes, weights / weights.sum(), strict=True))
    for quantity in ("pressure_mmHg", "flow_ml_s"):
        found = acted(added(case, "beat-jitter", sd), pressure(t), quantity)
        np.testing.assert_allclose(found, mean, atol=1e-9)


def test_sensor_gain_and_offset_act_on_pressures(case: Case) -> None:
    series = [(1, 0.0, "pressure_mmHg"), (2, 0.5, "flow_ml_s"), (3, 1.0, "area_cm2")]
    base = solved(case, series)
    for name, value, wanted in (("sensor-gain", 0.1, 1.1 * base[0]), ("sensor-offset", -2.0, base[0] - 2)):
        found = solved(added(case, name, value), series)
        np.testing.assert_allclose(found[0], wanted, atol=2e-4)
        np.testing.assert_array_equal(found[1:], base[1:])


def test_the_sampling_of_sensors_is_fine_enough(case: Case, plain: Array) -> None:
    """A sensor that delays by a whole number of samples gives the samples of the solution itself."""
    shift = 8 * case.network.period_s / 256

    def later(wave: Wave) -> Wave:
        return replace(wave, value=np.roll(wave.value, 32, axis=1))

    found = solved(replace(case, waves=(later,)), ROOT)
    np.testing.assert_allclose(found, simulate(case, ROOT, beat(case) - shift), atol=1e-3)
    np.testing.assert_allclose(found, np.roll(plain, 8, axis=1), atol=1e-3)


# ---------------------------------------------------------------------------------------------------
# Numerics, failures, bases


def test_coarse_grid_blends_with_cells_of_twice_the_length(case: Case, plain: Array) -> None:
    coarse = replace(case, options=replace(case.options, dx_cm=0.05))
    np.testing.assert_allclose(solved(added(case, "coarse-grid", 1.0), ROOT), solved(coarse, ROOT), atol=1e-9)
    long = tube(length_cm=2.0)
    pulse = replace(
        long,
        stiffness=np.array([3e4]),
        inflow_time_s=beat(long, 1024),
        inflow_ml_s=0.02 + 0.02 * np.sin(2 * np.pi * np.arange(1024) / 1024) ** 3,
        options=SolverOptions(dx_cm=0.05, steps_per_beat=512, tolerance_mmHg=1e-6, max_beats=200),
    )
    fine = solved(replace(pulse, options=replace(pulse.options, refine=8)), ROOT)
    errors = [np.max(np.abs(solved(c, ROOT) - fine)) for c in (pulse, added(pulse, "coarse-grid", -1 / 3))]
    assert errors[1] < 0.2 * errors[0]
    hasty = replace(case, options=replace(case.options, max_beats=1), coarse_blend=1.0)
    with pytest.raises(SolveError, match="periodic"):
        simulate(hasty, ROOT, beat(case))


# ---------------------------------------------------------------------------------------------------
# Their pages and the document


def test_responses_have_their_sign_and_size(study: Study) -> None:
    model = get_baseline("B").forward(study)
    start = pack(model.parameters, start_of(model.parameters))
    curve = {one.name: one for one in components(model, start, study_data(study))}["sensor-curve"]
    found = {one.name: one for one in responses(model, [curve])}
    assert set(found) == {*SOLVED, curve.name}
    mean = {name: float(one.change_mmHg[0].mean()) for name, one in found.items()}
    raise_it = (
        "taper stenosis tangent-wall velocity-profile minor-losses venous-pressure inflow-gain inflow-offset "
        "sensor-gain sensor-offset"
    )
    for name in raise_it.split():
        assert mean[name] > 0.01, name
    for name in ("radius-dependent-viscosity", "side-branches"):
        assert mean[name] < -0.01, name
    for name in "inflow-shift inflow-bandwidth catheter-resonance beat-jitter viscoelastic-wall".split():
        assert abs(mean[name]) < 0.1 * rms(found[name].change_mmHg), name
        assert rms(found[name].left_mmHg) > 0.1, name
    np.testing.assert_allclose(found["sensor-offset"].change_mmHg, 2, atol=0.01)
    for one in found.values():
        assert rms(one.left_mmHg) < rms(one.change_mmHg)
    for name, low, high in (("sensor-gain", 0.98, 1.0), ("inflow-shift", 0.0, 0.9)):
        assert low < found[name].likeness(found["sensor-curve"]) < high  # a gain is a curve, a shift is none


def test_likeness_is_the_cosine_to_the_span_of_the_other() -> None:
    def of(*rows: list[float]) -> Response:
        return Response("x", "", np.array(rows), np.array(rows))

    one = of([3.0, 4.0, 0.0])
    assert one.likeness(one) == pytest.approx(1)
    assert one.likeness(of([-2.0, 0.0, 0.0])) == pytest.approx(0.6)
    assert one.likeness(of([0.0, 0.0, 1.0])) == pytest.approx(0, abs=1e-15)
    assert one.likeness(of([1.0, 1.0, 0.0], [1.0, -1.0, 0.0])) == pytest.approx(1)


def test_the_page_of_an_effect_says_what_the_effect_does(study: Study) -> None:
    words = effect_words(CATALOGUE["correlated-noise"], get_baseline("B").forward(study))
    assert "cov(e(t), e(t + d)) = sd^2 exp(-|d|/length)" in words
    assert "[doi 10.1111/1467-9868.00294](https://doi.org/10.1111/1467-9868.00294)" in words
    length = 0.027 * study.period_s
    assert f"| length | normal(0.027, 0.027) in [0.0018, 0.27] beats | {length:.3g} s |" in words


def test_a_doi_becomes_a_link_whatever_stands_around_it() -> None:
    link = "[doi 10.1016/0021-9290(73)90099-7](https://doi.org/10.1016/0021-9290(73)90099-7)"
    assert cell("Young, doi 10.1016/0021-9290(73)90099-7 (K_t)") == f"Young, {link} (K_t)"
    assert cell("(Young, doi 10.1016/0021-9290(73)90099-7)") == f"(Young, {link})"


def test_the_documents_own_effect_works(case: Case, plain: Array) -> None:
    blocks = re.findall(r"```python\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), flags=re.S)
    there: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(DOCUMENT), "exec"), there)
    own = next(one for one in there.values() if isinstance(one, Effect))
    assert own.name not in CATALOGUE
    values = typical_values(own)
    changed = solved(own.apply(case, values, Location()), ROOT)
    assert np.max(np.abs(changed - plain)) > 0.01
    again = pickle.loads(cloudpickle.dumps(own))
    np.testing.assert_array_equal(solved(again.apply(case, values, Location()), ROOT), changed)


def test_an_effect_of_an_unknown_family_is_refused_where_it_is_given(study: Study) -> None:
    @effect("crowded", "outflows", size=0.1)
    def crowded(case: Case, size: float) -> Case:
        """No family has this name."""
        return case

    with pytest.raises(EffectError, match="family = 'outflows': unknown; did you mean 'outflow'"):
        zoo.model_B(study, effects=[crowded])
    with pytest.raises(EffectError, match="effect crowded: family = 'outflows'"):
        effects_for("linear-constant", [crowded])


@pytest.mark.parametrize(
    "given", [{}, {"size": -1.0}, {"size": 0.1, "parameters": [EffectParameter("a", "1", 1, 0, 1, (1,))]}]
)
def test_an_effect_has_a_size_or_parameters(given: dict[str, Any]) -> None:
    with pytest.raises(EffectError, match=r"effect leak: size = .*: give a positive size, or parameters"):
        effect("leak", **given)


def test_an_effect_by_its_size_acts_where_it_is() -> None:
    @effect("leak", size=0.1, low=0.0, unit="1/s", locations=lambda model: (Location("lid"),))
    def leak(c: dict[str, Any], size: float, location: Location) -> dict[str, Any]:
        """Somewhere."""
        return {**c, location.part: size}

    [size] = leak.parameters
    assert (size.name, size.unit, size.scale, size.low, size.high, size.starts) == (
        "size",
        "1/s",
        0.1,
        0.0,
        1.0,
        (0.1,),
    )
    assert leak.apply({}, (0.3,), Location("lid")) == {"lid": 0.3}
    assert leak.apply({}, (0.0,), Location("lid")) == {}
    with pytest.raises(EffectError, match="effect leak: location: is missing"):
        leak.apply({}, (0.3,), Location())
    two_sided = effect("drift", size=2.0)(lambda c, size: {**c, "drift": size})
    assert two_sided.parameters[0].starts == (2.0, -2.0)
    assert two_sided.parameters[0].prior.support == (-20.0, 20.0)
