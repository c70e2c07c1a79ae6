"""The physics of a study: what it says of walls, profile, junctions, outlets and pressures; solves have it.

Steady flows have closed forms: a tube of radius r loses 2 (zeta + 2) mu q L/(pi r^4), Bernoulli's pressure
falls by alpha rho q^2/2 (1/A'^2 - 1/A^2) where it narrows, and an outlet has p = p_out + R q.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from zoo.blood.blood_flow import BloodFlow, constant_stiffness, scaled_stiffness
from zoo.blood.effects.given import added_effects
from zoo.blood.physics import NO_PHYSICS, physics_words
from zoo.blood.plugins import load_models
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import (
    Blood,
    Series,
    Study,
    StudyError,
    Vessel,
    Windkessel,
    even_samples,
    load_study,
    save_study,
)
from zoo.core.effects import EffectError
from zoo.core.parameters import Parameter, Uniform

MMHG = 1333.22
PERIOD = 0.5
N = 64
FINE = SolverOptions(dx_cm=0.1, tolerance_mmHg=1e-5, max_beats=400)
LOAD = Windkessel(300.0, 2500.0, 2e-4)


def vessel(id: int, parent: int | None = None, **given: Any) -> Vessel:
    sizes = {"length_cm": 4.0, "radius_cm": 0.4} | given
    sizes.setdefault("radius_out_cm", sizes["radius_cm"])
    return Vessel(id, f"v{id}", parent=parent, **sizes)


def study(*vessels: Vessel, flow: NDArray[np.float64] | None = None, **given: Any) -> Study:
    times = np.arange(N) * (PERIOD / N)
    blood = given.pop("blood", Blood(1.06, 0.04))
    pulse = 10 + 25 * np.maximum(0, np.sin(2 * np.pi * times / PERIOD)) ** 2
    inflow = pulse if flow is None else flow
    return Study("made", PERIOD, blood, vessels, times, inflow, np.empty(0), (), **given)


def waves(
    made: Study, *places: tuple[int, float], stiffness: Any = None, **options: Any
) -> NDArray[np.float64]:
    """Pressure and flow, (2, n_places, 100), mmHg and ml/s."""
    settings = replace(FINE, **options)
    solver = Solver.for_study(made, series=places, times_s=np.arange(100) * PERIOD / 100, options=settings)
    solution = solver.solve(solver.network.stiffness_in if stiffness is None else stiffness)
    return np.array([solution.pressure_mmHg, solution.flow_ml_s])


STEADY = np.full(N, 12.0)


# ---------------------------------------------------------------------------------------------------
# The files


EVERYTHING = study(
    vessel(
        1, radius_out_cm=0.35, youngs_modulus_g_cm_s2=4e6, wall_thickness_cm=0.05, wall_thickness_out_cm=0.04
    ),
    vessel(
        2, 1, stiffness_g_cm_s2=5e5, stiffness_out_g_cm_s2=6e5, resistance=4000.0, outflow_pressure_mmHg=7.5
    ),
    vessel(
        3, 1, stiffness_g_cm_s2=5e5, windkessel=LOAD, external_pressure_mmHg=-2.0, radius_pressure_mmHg=0.0
    ),
    blood=Blood(1.06, 0.04, velocity_profile_order=9, momentum_correction=1.1),
    junction_pressure="total",
    external_pressure_mmHg=1.5,
    outflow_pressure_mmHg=3.0,
    radius_pressure_mmHg=80.0,
)


def test_round_trip(tmp_path: Path) -> None:
    save_study(EVERYTHING, tmp_path)
    back = load_study(tmp_path)
    assert back == EVERYTHING
    assert back.vessels == EVERYTHING.vessels
    assert back.blood == EVERYTHING.blood
    assert back.physics == EVERYTHING.physics


def test_checksum_holds_physics_only_where_there_is_some() -> None:
    assert load_study("demo").checksum == "849e20038bd7f8126918edefe4fc38d34f78b408e998713117717710bee5c816"
    plain = study(vessel(1, windkessel=LOAD))
    changes: list[dict[str, Any]] = [
        {"junction_pressure": "total"},
        {"external_pressure_mmHg": 1.0},
        {"outflow_pressure_mmHg": 1.0},
        {"radius_pressure_mmHg": 1.0},
        {"blood": Blood(1.06, 0.04, velocity_profile_order=2)},
        {"blood": Blood(1.06, 0.04, momentum_correction=1.2)},
        {"vessels": (vessel(1, windkessel=LOAD, stiffness_g_cm_s2=5e5),)},
        {"vessels": (vessel(1, windkessel=LOAD, outflow_pressure_mmHg=1.0),)},
        {"vessels": (vessel(1, resistance=3000.0),)},
    ]
    sums = [plain.checksum, *(replace(plain, **change).checksum for change in changes)]
    assert len(set(sums)) == len(sums)
    same = {"junction_pressure": "static", "radius_pressure_mmHg": 0.0, "blood": Blood(1.06, 0.04, None, 1.0)}
    assert replace(plain, **same).checksum == plain.checksum


NETWORK = """\
[blood]
density_g_cm3 = 1.06
viscosity_g_cm_s = 0.04
velocity_profile_order = 9
momentum_correction = 1.0

[junctions]
pressure = "total"

[surroundings]
outflow_pressure_mmHg = 5
external_pressure_mmHg = 0
radius_pressure_mmHg = 75

[[vessel]]
id = 1
length_cm = 4.0
radius_cm = 0.4
radius_out_cm = 0.35
youngs_modulus_g_cm_s2 = 4e6
wall_thickness_cm = 0.05

[[vessel]]
id = 2
length_cm = 4.0
radius_cm = 0.3
parent = 1
stiffness_g_cm_s2 = 5e5
stiffness_out_g_cm_s2 = 6e5
resistance = 4000
outflow_pressure_mmHg = 7
"""
INFLOW = "time_s,flow_ml_s\n" + "".join(f"{m * 0.02:.2f},{10 + m % 5}\n" for m in range(25))
FOLDER = 'name = "x"\nnetwork = "network.toml"\ninflow = "inflow.csv"\nperiod_s = 0.5\n'


def write(folder: Path, network: str = NETWORK, inflow: str = INFLOW) -> Path:
    files = {"study.toml": FOLDER, "network.toml": network, "inflow.csv": inflow}
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def test_fields_are_read(tmp_path: Path) -> None:
    made = load_study(write(tmp_path))
    assert made.blood == Blood(1.06, 0.04, 9, 1.0)
    assert made.physics == {
        "junction_pressure": "total",
        "outflow_pressure_mmHg": 5.0,
        "radius_pressure_mmHg": 75.0,
    }
    first, second = made.vessels
    assert first.stiffness == (4e6 * 0.05 / 0.4, 4e6 * 0.05 / 0.35)
    assert second.stiffness == (5e5, 6e5)
    assert made.pressure_mmHg("outflow", second) == 7
    assert made.pressure_mmHg("radius", second) == 75


V2 = r"network\.toml, row \d+: vessel 2: "
V1 = r"network\.toml, row \d+: vessel 1: "


# fmt: off
MISTAKES = [
    ("order = 9", "order = 0", r"blood: velocity_profile_order = 0: must be positive; correct it"),
    ('"total"', '"totl"', r"junctions: pressure = 'totl': unknown; did you mean 'total'\? use one of static"),
    ('pressure = "', 'presure = "', r"junctions: presure: unknown field; did you mean 'pressure'\?"),
    ("[surroundings]", "[surounding]",
     r"network\.toml: surounding: unknown field; did you mean 'surroundings'"),
    ("wall_thickness_cm = 0.05", "", V1 + r"youngs_modulus_g_cm_s2 = 4000000\.0: needs wall_thickness_cm"),
    ("youngs_modulus_g_cm_s2 = 4e6", "", V1 + r"wall_thickness_cm = 0\.05: needs youngs_modulus_g_cm_s2"),
    ("wall_thickness_cm = 0.05", "wall_thickness_cm = -0.05",
     V1 + r"wall_thickness_cm = -0\.05: must be pos"),
    ("stiffness_g_cm_s2 = 5e5", "", V2 + r"stiffness_out_g_cm_s2 = 600000\.0: needs stiffness_g_cm_s2"),
    ("wall_thickness_cm = 0.05", "wall_thickness_cm = 0.05\nstiffness_g_cm_s2 = 4e5",
     V1 + r"youngs_modulus_g_cm_s2 = 4000000\.0: stiffness_g_cm_s2 says .*; give one of the two"),
    ("stiffness_g_cm_s2 = 5e5\nstiffness_out_g_cm_s2 = 6e5", "",
     V2 + r"stiffness_g_cm_s2: is missing, but vessel 1 has a stiffness; give all vessels one"),
    ("resistance = 4000", "resistance = 4000\nwindkessel = { R1 = 1.0, R2 = 2.0, C = 1e-5 }",
     V2 + r"resistance = 4000\.0: a windkessel is the outlet already; give one of the two"),
    ("resistance = 4000", "", V2 + r"windkessel: is missing at a terminal, .* or a resistance, in cgs"),
    ("wall_thickness_cm = 0.05", "wall_thickness_cm = 0.05\nresistance = 10.0",
     V1 + r"resistance = 10\.0: only a terminal may have one, .*; remove it"),
    ("pressure_mmHg = 75", "pressure_mmHg = 600",
     V1 + r"radius_pressure_mmHg = 600\.0: .* must be below 500"),
]
# fmt: on


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_a_mistake_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in NETWORK
    with pytest.raises(StudyError, match=message) as error:
        load_study(write(tmp_path, NETWORK.replace(old, new, 1)))
    assert "\n" not in str(error.value)


def test_a_study_made_in_python_is_checked_too() -> None:
    with pytest.raises(StudyError, match=r"vessel 1: resistance = -1\.0: must be positive and finite"):
        Solver.for_study(study(vessel(1, resistance=-1.0)))
    with pytest.raises(StudyError, match=r"junction_pressure = 'both': must be one of static, total"):
        study(vessel(1, windkessel=LOAD), junction_pressure="both")


# ---------------------------------------------------------------------------------------------------
# Steady flows


@pytest.mark.parametrize(("order", "friction"), [(2, 8), (9, 22)])
def test_a_tube_loses_the_pressure_of_its_profile_in_front_of_a_resistance(
    order: float, friction: float
) -> None:
    resistance, p_out = 9000.0, 6.0
    tube = vessel(1, length_cm=10.0, radius_cm=0.2, resistance=resistance, stiffness_g_cm_s2=1e8)
    made = study(
        tube, flow=STEADY, blood=Blood(1.06, 0.04, velocity_profile_order=order), outflow_pressure_mmHg=p_out
    )
    pressure, flow = waves(made, (1, 0.0), (1, 1.0))
    expected = p_out + resistance * 12 / MMHG
    np.testing.assert_allclose(pressure[1], expected, rtol=1e-5)
    wide = 1 + expected * MMHG / (4 / 3 * 1e8)  # of the radius
    loss = friction * math.pi * 0.04 * 12 * 10 / (math.pi * (0.2 * wide) ** 2) ** 2 / MMHG
    np.testing.assert_allclose(pressure[0] - pressure[1], loss, rtol=2e-3)
    np.testing.assert_allclose(flow, 12, rtol=1e-5)


@pytest.mark.parametrize("alpha", [1.0, 4 / 3])
def test_a_narrowing_tube_has_bernoullis_pressure(alpha: float) -> None:
    tube = vessel(
        1,
        radius_cm=0.3,
        radius_out_cm=0.2,
        windkessel=LOAD,
        youngs_modulus_g_cm_s2=4e8,
        wall_thickness_cm=0.05,
    )
    blood = Blood(1.06, 1e-6, velocity_profile_order=2, momentum_correction=alpha)
    pressure, _ = waves(study(tube, flow=STEADY, blood=blood), (1, 0.0), (1, 1.0))
    fall = alpha * 1.06 * 12**2 / 2 * (1 / (math.pi * 0.04) ** 2 - 1 / (math.pi * 0.09) ** 2) / MMHG
    np.testing.assert_allclose(pressure[0] - pressure[1], fall, rtol=5e-3)


@pytest.mark.parametrize("kind", ["static", "total"])
def test_what_vessels_share_where_they_meet(kind: str) -> None:
    wide = vessel(1, radius_cm=0.3, stiffness_g_cm_s2=1e8)
    narrow = vessel(2, 1, radius_cm=0.2, stiffness_g_cm_s2=1e8, windkessel=LOAD)
    made = study(wide, narrow, flow=STEADY, junction_pressure=kind)
    pressure, _ = waves(made, (1, 1.0), (2, 0.0))
    ratio = 1 / (math.pi * 0.04) ** 2 - 1 / (math.pi * 0.09) ** 2
    fall = 0.5 * 1.06 * 12**2 * ratio / MMHG if kind == "total" else 0.0
    np.testing.assert_allclose(pressure[0] - pressure[1], fall, atol=0.01 * 1.06)


# ---------------------------------------------------------------------------------------------------
# Pulses


def tree(**given: Any) -> Study:
    return study(
        vessel(1, radius_out_cm=0.36, youngs_modulus_g_cm_s2=4e6, wall_thickness_cm=0.05),
        vessel(2, 1, radius_cm=0.28, youngs_modulus_g_cm_s2=4e6, wall_thickness_cm=0.04, windkessel=LOAD),
        vessel(3, 1, radius_cm=0.25, youngs_modulus_g_cm_s2=4e6, wall_thickness_cm=0.04, resistance=5000.0),
        **given,
    )


PLACES = ((1, 0.0), (2, 0.5), (3, 1.0))


def test_pressures_outside_and_behind_raise_everything_alike() -> None:
    plain = waves(tree(), *PLACES)
    raised = waves(tree(external_pressure_mmHg=6.0, outflow_pressure_mmHg=6.0), *PLACES)
    np.testing.assert_allclose(raised[0], plain[0] + 6, atol=2e-4)
    np.testing.assert_allclose(raised[1], plain[1], atol=2e-4)
    outside = waves(tree(external_pressure_mmHg=6.0), *PLACES)
    assert np.max(np.abs(outside[0] - plain[0])) > 0.1


def test_pressures_of_single_vessels_take_the_place_of_the_studys() -> None:
    own = tree(outflow_pressure_mmHg=6.0, external_pressure_mmHg=3.0)
    each = tree()
    each = replace(
        each,
        vessels=tuple(
            replace(v, external_pressure_mmHg=3.0, outflow_pressure_mmHg=6.0 if v.id > 1 else None)
            for v in each.vessels
        ),
    )
    np.testing.assert_array_equal(waves(each, *PLACES), waves(own, *PLACES))


def test_radii_given_at_a_pressure_are_those_of_another_rest_radius() -> None:
    """R0 = R_d (1 - p_d/K_d), chi = 3/4 K_d R0/R_d with K_d = (4/3) E h/R_d: the same law."""
    at = 75.0
    given = study(
        vessel(1, stiffness_g_cm_s2=5e5),
        vessel(2, 1, radius_cm=0.3, stiffness_g_cm_s2=6e5, windkessel=LOAD),
        radius_pressure_mmHg=at,
    )
    converted = []
    for v in given.vessels:
        K = 4 / 3 * v.stiffness_g_cm_s2  # type: ignore[operator]
        rest = v.radius_cm * (1 - at * MMHG / K)
        stiffness = 0.75 * K * rest / v.radius_cm
        converted.append(replace(v, radius_cm=rest, radius_out_cm=rest, stiffness_g_cm_s2=stiffness))
    other = replace(given, vessels=tuple(converted), radius_pressure_mmHg=0.0)
    places = ((1, 0.0), (2, 0.5))
    np.testing.assert_allclose(waves(given, *places), waves(other, *places), atol=3e-3)
    assert (
        np.max(np.abs(waves(replace(given, radius_pressure_mmHg=0.0), *places)[0] - waves(given, *places)[0]))
        > 1
    )


def test_a_taper_is_the_limit_of_a_chain_of_short_vessels() -> None:
    """E h/r along the vessel, with E and h constant: twice the pieces have half the difference."""
    blood = Blood(1.06, 0.04, velocity_profile_order=2)
    wall = {"youngs_modulus_g_cm_s2": 4e6, "wall_thickness_cm": 0.05}
    tapered = vessel(1, length_cm=12.0, radius_cm=0.5, radius_out_cm=0.25, windkessel=LOAD, **wall)
    whole = waves(study(tapered, blood=blood, junction_pressure="total"), (1, 0.0), (1, 1.0))
    chains = []
    for n in (12, 24):
        radii = 0.5 - 0.25 * (np.arange(n) + 0.5) / n
        chain = [
            vessel(
                i + 1, i or None, length_cm=12.0 / n, radius_cm=float(r),
                windkessel=LOAD if i == n - 1 else None, **wall,
            )
            for i, r in enumerate(radii)
        ]  # fmt: skip
        made = waves(study(*chain, blood=blood, junction_pressure="total"), (1, 0.0), (n, 1.0))
        chains.append(made[0])
    size = np.ptp(whole[0])
    first, second = (float(np.max(np.abs(chain - whole[0])) / size) for chain in chains)
    assert second == pytest.approx(first / 2, rel=0.05)
    assert np.max(np.abs(2 * chains[1] - chains[0] - whole[0])) < 5e-3 * size
    constant = waves(
        study(replace(tapered, youngs_modulus_g_cm_s2=None, wall_thickness_cm=None), blood=blood),
        (1, 0.0), stiffness=4e6 * 0.05 / 0.5,
    )  # fmt: skip
    assert np.max(np.abs(constant[0][0] - whole[0][0])) > 0.05 * size


def test_stiffness_that_rises_linearly_is_that_of_a_thickening_wall() -> None:
    linear = vessel(1, stiffness_g_cm_s2=4e5, stiffness_out_g_cm_s2=8e5, windkessel=LOAD)
    thick = vessel(
        1, youngs_modulus_g_cm_s2=4e6, wall_thickness_cm=0.04, wall_thickness_out_cm=0.08, windkessel=LOAD
    )
    np.testing.assert_allclose(
        waves(study(linear), (1, 0.0)), waves(study(thick), (1, 0.0)), rtol=1e-10, atol=1e-10
    )


def test_a_pulse_takes_the_integral_of_1_over_c_through_a_stiffening_vessel() -> None:
    """c^2 = (2/3) chi/rho at rest; small pulse, no friction, an outlet that lets it out."""
    chi, end, length, rho = 4e5, 6e5, 60.0, 1.06
    c_out = math.sqrt(2 / 3 * end / rho)
    tube = vessel(
        1, length_cm=length, stiffness_g_cm_s2=chi, stiffness_out_g_cm_s2=end,
        resistance=rho * c_out / (math.pi * 0.4**2),
    )  # fmt: skip
    times = np.arange(N) * PERIOD / N
    flow = 1e-4 + 1e-2 * np.exp(-(((times - 0.1) / 0.025) ** 2))
    made = study(tube, flow=flow, blood=Blood(rho, 1e-9, velocity_profile_order=2))
    _, flows = waves(made, (1, 0.0), (1, 1.0))
    x = np.linspace(0, length, 2001)
    speed = np.sqrt(2 / 3 * (chi + (end - chi) * x / length) / rho)
    expected = np.trapezoid(1 / speed, x)
    t = np.arange(100) * PERIOD / 100
    arrival = [np.sum(t * (q - q.min()) ** 2) / np.sum((q - q.min()) ** 2) for q in flows]
    assert arrival[1] - arrival[0] == pytest.approx(expected, rel=0.01)


# ---------------------------------------------------------------------------------------------------
# The inflow


def test_uneven_inflow_on_a_grid_of_its_own_is_kept_exactly(tmp_path: Path) -> None:
    times = np.cumsum([0, *([0.01] * 10), *([0.04] * 9)])
    flow = 5 + 3 * np.sin(np.arange(20))
    rows = "".join(f"{t:.2f},{q!r}\n" for t, q in zip(times, flow.tolist(), strict=True))
    made = load_study(write(tmp_path, inflow="time_s,flow_ml_s\n" + rows))
    assert len(made.inflow_ml_s) == 50
    assert "20 samples at uneven times, linear between, read at 50 even times, which hold all of them" in (
        made.inflow_note
    )
    np.testing.assert_allclose(made.inflow_ml_s[np.rint(times * 100).astype(int)], flow, rtol=1e-14)
    assert made.inflow_ml_s[48] == pytest.approx(flow[-1] + (flow[0] - flow[-1]) * 2 / 4)
    closed = rows + f"0.50,{flow.tolist()[0]!r}\n"
    assert load_study(write(tmp_path, inflow="time_s,flow_ml_s\n" + closed)) == made
    assert any("inflow: 20 samples" in line for line in physics_words(made))


def test_uneven_inflow_without_a_grid_is_near_its_lines() -> None:
    rng = np.random.default_rng(1)
    times = np.sort(np.concatenate([[0.0], rng.uniform(0.001, 0.49, 40)]))
    values = rng.normal(5, 2, 41)
    even, distance = even_samples(times, values, 0.5)
    assert 0 < distance < 0.05 * np.ptp(values)
    t = np.linspace(0, 0.5, 200_001)
    lines = np.interp(t, np.append(times, 0.5), np.append(values, values[0]))
    read = np.interp(t, np.arange(len(even) + 1) * 0.5 / len(even), np.append(even, even[0]))
    assert np.max(np.abs(read - lines)) <= distance * (1 + 1e-6)


# ---------------------------------------------------------------------------------------------------
# Models and effects


def f3(name: str = "f3") -> Parameter:
    return Parameter(name, Uniform(0.1, 1e7), "g/(cm s2)", start=4e5)


def test_models_have_the_studys_physics_and_a_stiffness_of_their_own() -> None:
    made = tree(radius_pressure_mmHg=20.0, junction_pressure="total")
    flow = BloodFlow(made, "linear", constant_stiffness, [f3()])
    case = flow.configure([4e5])
    assert case.physics.total_pressure == 1
    assert case.physics.stiffness_exponent is None
    assert case.physics.stiffness_ratio is None
    assert set(case.stiffness) == {4e5}
    own = BloodFlow(made, "linear", scaled_stiffness, [f3("stiffness_factor")])
    scaled = own.configure([1.1])
    assert scaled.physics.stiffness_exponent is not None
    np.testing.assert_allclose(scaled.stiffness, [1.1 * v.stiffness[0] for v in made.vessels])  # type: ignore[index]
    assert own.key != flow.key
    plain = BloodFlow(study(vessel(1, windkessel=LOAD)), "linear", constant_stiffness, [f3()])
    assert plain.configure([4e5]).physics is NO_PHYSICS
    with pytest.raises(StudyError, match="stiffness_g_cm_s2: is missing, and there is nothing to scale"):
        BloodFlow(plain.study, "linear", scaled_stiffness, [f3("stiffness_factor")]).configure([1.0])


def observed(made: Study) -> Study:
    """The study with the pressure of its root's inlet, as it is without errors."""
    pressure = waves(made, (1, 0.0))[0]
    series = (Series(1, 0.0, "pressure_mmHg", pressure[0]),)
    return replace(made, time_s=np.arange(100) * (PERIOD / 100), series=series)


def test_the_documented_model_infers_a_factor_of_the_given_stiffness(tmp_path: Path) -> None:
    text = (Path(__file__).resolve().parents[1] / "docs" / "study-format.md").read_text(encoding="utf-8")
    [code] = [c for c in re.findall(r"```python\n(.*?)```", text, flags=re.S) if c.startswith("# scaled.py")]
    (tmp_path / "scaled.py").write_text(code, encoding="utf-8")
    [build] = load_models(tmp_path / "scaled.py").values()
    made = observed(tree(radius_pressure_mmHg=20.0, outflow_pressure_mmHg=4.0, junction_pressure="total"))
    flow = build(made, options=FINE).zoo.forward
    start = {p.name: 1.0 for p in flow.parameters}
    assert set(start) >= {"stiffness_factor", "psi1", "psi2", "c"}
    series = flow.solve(flow.configure([1.0] * len(flow.parameters)))
    np.testing.assert_allclose(series, made.values, atol=1e-8)
    softer = flow.solve(flow.configure([0.9, 1.0, 1.0, 1.0]))
    assert np.max(np.abs(softer - series)) > 0.1


def test_effects_add_to_the_studys_physics_or_are_refused() -> None:
    made = tree(junction_pressure="total", external_pressure_mmHg=2.0, outflow_pressure_mmHg=4.0)
    flow = BloodFlow(made, "linear", constant_stiffness, [f3()])
    for name in ("total-pressure-junctions", "structured-tree", "distributed-outflow"):
        with pytest.raises(EffectError, match=f"{name}: cannot be added to this study"):
            added_effects([name], flow)
    (outside,) = added_effects(["external-pressure"], flow)
    case = outside.effect.apply(flow.configure([4e5]), (3.0,), outside.location)  # type: ignore[misc]
    np.testing.assert_allclose(case.physics.offset_in, 5 * MMHG)
    np.testing.assert_allclose(case.physics.outflow_pressure, 4 * MMHG)
    static = BloodFlow(tree(), "linear", constant_stiffness, [f3()])
    assert len(added_effects(["total-pressure-junctions"], static)) == 1
