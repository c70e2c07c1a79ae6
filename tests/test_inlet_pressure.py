"""The pressure given at the root's inlet instead of the flow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from test_derivatives import EXACT, differences
from test_outflow_pressure import (
    AT,
    CHI,
    DENSITY,
    LOAD,
    MMHG,
    OPTIONS,
    PERIOD,
    RADIUS,
    VISCOSITY,
    N,
    end,
    fork,
)
from test_outflow_pressure import made as made_tree
from zoo import model_A
from zoo.blood.blood_flow import BloodFlow, constant_stiffness, study_data
from zoo.blood.case import simulate
from zoo.blood.components import components
from zoo.blood.effects import CATALOGUE
from zoo.blood.effects.given import added_effects
from zoo.blood.impedance import ImpedanceError, measured_impedance, modelled_impedance
from zoo.blood.importing.study_beats import average_beats
from zoo.blood.network import Network, with_nominal_loads
from zoo.blood.solve_errors import InletAreaError, SolverArgumentError
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Series, Study, StudyError, load_study, save_study, study_files, suspect_units
from zoo.core.derivatives import jacobian
from zoo.core.effects import EffectError, with_effects
from zoo.core.parameters import Parameter, Uniform

DEMO = {"stiffness": 4.5e4, "psi1": 0.35, "psi2": 0.7, "c": 1.5}
PRESSURE = 90 + 15 * np.sin(2 * np.pi * AT / PERIOD) + 4 * np.cos(6 * np.pi * AT / PERIOD)


def by_pressure(study: Study, pressure: np.ndarray, **given: Any) -> Study:
    """The study with this pressure (mmHg) at its inlet and no flow."""
    none = np.empty(0)
    return replace(study, inflow_time_s=none, inflow_ml_s=none, inlet_pressure_mmHg=pressure, **given)


def with_series(study: Study, *places: tuple[int, float, str], n: int = 64) -> Study:
    """The study with zeros observed."""
    series = tuple(Series(*place, np.zeros(n)) for place in places)
    return replace(study, series=series, time_s=np.arange(n) * study.period_s / n)


def line(load: Callable[[np.ndarray], np.ndarray], length: float, omega: np.ndarray) -> np.ndarray:
    """Impedance (cgs) of a vessel of `end`, at rest, before a load: rho/A q_t + r q = -p_x, C p_t = -q_x."""
    area = np.pi * RADIUS**2
    friction = 2 * (9 + 2) * np.pi * VISCOSITY / area**2
    along, across = 1j * omega * DENSITY / area + friction, 1j * omega * area / (2 / 3 * CHI)
    own, turn = np.sqrt(along / across), np.tanh(np.sqrt(along * across) * length)
    return np.asarray(own * (load(omega) + own * turn) / (own + load(omega) * turn))


def windkessel(omega: np.ndarray) -> np.ndarray:
    return LOAD.R1 + LOAD.R2 / (1 + 1j * omega * LOAD.R2 * LOAD.C)


@pytest.mark.parametrize("tree", ["vessel", "fork"])
def test_the_admittance_of_small_pulses_is_that_of_line_theory(tree: str) -> None:
    """About the pressure outside and behind the outlets, at which vessels are at rest and no blood flows."""
    about = {"external_pressure_mmHg": 7.0, "outflow_pressure_mmHg": 7.0}
    study = fork(**about) if tree == "fork" else made_tree(end(windkessel=LOAD), **about)
    times = np.arange(2048) * PERIOD / 2048
    small = 7.0 + 1e-3 * sum(np.cos(2 * np.pi * k * times / PERIOD + k) for k in range(1, 9))
    study = by_pressure(study, np.asarray(small))
    solver = Solver.for_study(study, series=[(1, 0.0)], times_s=times, options=OPTIONS)
    found = solver.solve(solver.network.stiffness_in)
    ratio = np.fft.rfft(found.flow_ml_s[0])[1:9] / np.fft.rfft(found.pressure_mmHg[0])[1:9] / MMHG
    omega = 2 * np.pi * np.arange(1, 9) / PERIOD

    def ends(omega: np.ndarray) -> np.ndarray:
        one = line(windkessel, 10.0, omega)
        other = line(lambda w: np.full(len(w), 1500.0), 8.0, omega)
        return np.asarray(1 / (1 / one + 1 / other))

    expected = 1 / line(ends if tree == "fork" else windkessel, 20.0, omega)
    np.testing.assert_allclose(found.pressure_mmHg[0], small, atol=1e-9)
    np.testing.assert_allclose(np.abs(ratio - expected) / np.abs(expected), 0, atol=5e-3)
    assert abs(found.inflow_ml - found.outflow_ml) < 1e-9


SURROUNDINGS: dict[str, dict[str, Any]] = {
    "plain": {},
    "shifted": {"external_pressure_mmHg": 6.0, "radius_pressure_mmHg": 5.0, "outflow_pressure_mmHg": 4.0},
    "offsets": {"external_pressure_mmHg": 3.0, "own": {"external_pressure_mmHg": -2.0}},
    "waves": {"outflow_wave_mmHg": 4 + np.sin(2 * np.pi * AT / PERIOD), "junction_pressure": "total"},
}


@pytest.mark.parametrize("wall", ["linear", "tangent", "olufsen"])
@pytest.mark.parametrize("name", SURROUNDINGS)
def test_the_flow_that_made_a_pressure_comes_back_to_second_order(name: str, wall: str) -> None:
    given = dict(SURROUNDINGS[name])
    own = given.pop("own", {})
    study = fork(**given)
    study = replace(study, vessels=(study.vessels[0], replace(study.vessels[1], **own), study.vessels[2]))
    times = np.arange(2048) * PERIOD / 2048
    smooth = 40 + 30 * np.sin(2 * np.pi * times / PERIOD)
    study = replace(study, inflow_time_s=times, inflow_ml_s=smooth)
    places, errors = [(1, 0.0), (2, 0.5), (3, 1.0)], []
    for steps in (1024, 2048):
        options = SolverOptions(
            dx_cm=1.25 * 1024 / steps, steps_per_beat=steps, tolerance_mmHg=1e-8, max_beats=400
        )
        times = np.arange(steps) * PERIOD / steps
        flow = Solver.for_study(study, wall, series=places, times_s=times, options=options)
        first = flow.solve(CHI)
        back = by_pressure(study, first.pressure_mmHg[0])
        pressure = Solver.for_study(back, wall, series=places, times_s=times, options=options)
        second = pressure.solve(CHI)
        np.testing.assert_allclose(second.pressure_mmHg[0], first.pressure_mmHg[0], rtol=1e-6)
        error = np.abs(second.flow_ml_s - first.flow_ml_s).max(axis=1)
        errors.append(error / np.ptp(first.flow_ml_s, axis=1))
        assert abs(second.inflow_ml / first.inflow_ml - 1) < 1e-4
    assert np.all(errors[1] < 5e-4)
    order = np.log2(errors[0] / errors[1])
    assert np.all((order > 1.7) & (order < 2.6))


def flow_model(study: Study, **given: Any) -> BloodFlow:
    priors = {"f3": CHI, "psi1": 1.1, "psi2": 0.9, "c": 1.2}
    parameters = [Parameter(name, Uniform(0.1 * x, 10 * x), start=x) for name, x in priors.items()]
    return BloodFlow(study, "linear", constant_stiffness, parameters, **given)


FLOW_AND_PRESSURE = (1, 0.0, "flow_ml_s"), (2, 0.5, "pressure_mmHg"), (3, 1.0, "area_cm2")
PARAMETERS = [4e5, 1.1, 0.9, 1.2]


@pytest.mark.parametrize(
    ("effects", "values"),
    [
        ([], []),
        (["inflow-gain", "inflow-offset", "inflow-shift"], [0.02, -0.01, 0.01]),
        (["viscoelastic-wall", "external-pressure"], [0.002, 3.0]),
    ],
)
def test_derivatives_are_those_of_differences(effects: list[str], values: list[float]) -> None:
    study = with_series(by_pressure(fork(), PRESSURE), *FLOW_AND_PRESSURE)
    options = replace(EXACT, dx_cm=1.0)
    flow = flow_model(study, options=options)
    model = with_effects(flow, added_effects(effects, flow)) if effects else flow
    theta = np.array([*PARAMETERS, *values])
    found = jacobian(model, theta)
    assert found is not None
    for i in range(len(theta)):
        step = 1e-3 * (abs(theta[i]) or 1.0)
        expected = differences(lambda x: model.solve(model.configure(x)), theta, i, step)
        most = np.abs(expected).max(axis=1, keepdims=True)
        assert np.all(most > 0)
        assert np.all(np.abs(found.slopes[i] - expected) <= 2e-6 * most), (effects, i)


def test_numba_solves_and_differentiates_as_python_does() -> None:
    study = with_series(by_pressure(fork(), PRESSURE), *FLOW_AND_PRESSURE)
    model, theta = flow_model(study, options=SolverOptions(dx_cm=1.0)), np.array(PARAMETERS)
    compiled = model.in_numba()
    assert compiled is not None
    status, series = compiled.solve(theta)
    assert status == 0
    np.testing.assert_array_equal(series, model.solve(model.configure(theta)))
    status, _, slopes = compiled.differentiate(theta)
    found = jacobian(model, theta)
    assert status == 0
    assert found is not None
    np.testing.assert_allclose(slopes, found.slopes, rtol=1e-6, atol=1e-9 * np.abs(found.slopes).max())


def test_effects_on_the_inlet_act_on_its_pressure_where_that_is_meant() -> None:
    study = with_series(by_pressure(fork(), PRESSURE), *FLOW_AND_PRESSURE)
    flow = flow_model(study)
    case = flow.configure(np.array(PARAMETERS))
    for name, value, expected in (
        ("inflow-gain", 0.1, 1.1 * PRESSURE),
        ("inflow-offset", -0.05, PRESSURE - 0.05 * PRESSURE.mean()),
        ("inflow-shift", PERIOD / N, np.roll(PRESSURE, 1)),
    ):
        (added,) = added_effects([name], flow)
        changed = added.effect.apply(case, (value,), added.location)
        np.testing.assert_allclose(changed.inlet_pressure_mmHg, expected, atol=1e-9)
        assert not changed.inflow_ml_s.size
    assert CATALOGUE["inflow-bandwidth"].locations(flow_model(with_series(fork(), *FLOW_AND_PRESSURE)))
    with pytest.raises(EffectError, match="inflow-bandwidth: cannot be added to this study"):
        added_effects(["inflow-bandwidth"], flow)
    series = flow.solve(case)
    seen = replace(
        study, series=tuple(replace(s, value=x) for s, x in zip(study.series, series, strict=True))
    )
    free = components(flow, PARAMETERS, study_data(seen))
    assert free
    assert all(function.component != "inflow" for function in free)


def test_what_needs_a_recorded_flow_says_so() -> None:
    study = with_series(by_pressure(fork(), PRESSURE), *FLOW_AND_PRESSURE)
    case = flow_model(study, options=OPTIONS).configure(np.array(PARAMETERS))
    with pytest.raises(ImpedanceError, match="inlet_pressure, and no flow to divide by"):
        measured_impedance(study_data(study), case, noise_mmHg=0.1)
    by_flow = flow_model(with_series(fork(), *FLOW_AND_PRESSURE), options=OPTIONS).configure(
        np.array(PARAMETERS)
    )
    given = simulate(by_flow, [(1, 0.0, "pressure_mmHg")], np.arange(2048) * PERIOD / 2048)[0]
    found = modelled_impedance(replace(case, inlet_pressure_mmHg=given), harmonics=1)
    np.testing.assert_allclose(found.value, modelled_impedance(by_flow, harmonics=1).value, rtol=1e-3)
    bare = replace(
        study, vessels=(study.vessels[0], replace(study.vessels[1], windkessel=None), study.vessels[2])
    )
    with pytest.raises(
        StudyError, match=r"vessel 2: windkessel: .* without a mean flow, where inlet_pressure"
    ):
        Network.from_study(bare)


@pytest.mark.parametrize(
    ("wall", "pressure", "error"),
    [("linear", -2000.0, InletAreaError), ("olufsen", 500.0, InletAreaError)],
)
def test_a_pressure_that_the_wall_cannot_have_is_named(wall: str, pressure: float, error: type) -> None:
    wrong = np.where(np.arange(N) == N // 2, pressure, PRESSURE)
    solver = Solver.for_study(by_pressure(fork(), wrong), wall, options=OPTIONS)
    with pytest.raises(
        error, match=r"vessel 1.*inlet_pressure_mmHg \(the file inlet_pressure of study.toml\)"
    ):
        solver.solve(CHI)


def test_arguments() -> None:
    network = Network.from_study(fork())
    with pytest.raises(SolverArgumentError, match="inlet_pressure_mmHg: is given beside inflow_ml_s"):
        Solver(network, AT, 1 + 0 * AT, inlet_pressure_mmHg=PRESSURE)
    with pytest.raises(SolverArgumentError, match="inlet_pressure_mmHg has 3 values: needs at least 4"):
        Solver(network, inlet_pressure_mmHg=PRESSURE[:3])
    with pytest.raises(SolverArgumentError, match=r"inlet_pressure_mmHg\[1\] = nan"):
        Solver(network, inlet_pressure_mmHg=[90.0, np.nan, 90.0, 90.0])
    with pytest.raises(SolverArgumentError, match="inflow_ml_s has 0 values"):
        Solver(network)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    study = with_series(by_pressure(fork(), PRESSURE), *FLOW_AND_PRESSURE[:2])
    save_study(study, tmp_path / "one")
    return tmp_path / "one"


def test_a_study_is_read_back_as_it_was_written(folder: Path) -> None:
    study = load_study(folder)
    np.testing.assert_array_equal(study.inlet_pressure_mmHg, PRESSURE)
    again = with_series(by_pressure(fork(), PRESSURE), *FLOW_AND_PRESSURE[:2])
    assert study.checksum == again.checksum
    other = by_pressure(study, PRESSURE + 1e-9)
    assert other.checksum != study.checksum
    assert other != study
    assert {path.name for path in study_files(folder)} == {
        "study.toml", "network.toml", "inlet.csv", "observations.csv"
    }  # fmt: skip
    assert not (folder / "inflow.csv").exists()


def changed(folder: Path, file: str, old: str, new: str) -> None:
    path = folder / file
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("study.toml", "inlet_pressure", 'inflow = "inlet.csv"\ninlet_pressure', "is given beside inflow"),
        ("study.toml", 'inlet_pressure = "inlet.csv"', "", "inflow: is missing; add it, or inlet_pressure"),
        ("study.toml", "inlet.csv", "inlets.csv", "inlet_pressure = 'inlets.csv': no such file"),
        ("inlet.csv", "pressure_mmHg", "pressure_kPa", "row 1: 'pressure_kPa': unknown column"),
        ("observations.csv", "1,0.0,flow_ml_s", "1,0.0,pressure_mmHg", "is what inlet_pressure gives"),
        ("network.toml", "windkessel = {", "#", r"windkessel: .* without a mean flow, where inlet_pressure"),
    ],
)
def test_a_wrong_study_is_refused(folder: Path, file: str, old: str, new: str, message: str) -> None:
    changed(folder, file, old, new)
    with pytest.raises(StudyError, match=message):
        load_study(folder)


def test_uneven_times_are_read_as_those_of_an_inflow_and_told(folder: Path) -> None:
    lines = (folder / "inlet.csv").read_text(encoding="utf-8").splitlines()
    (folder / "inlet.csv").write_text("\n".join(lines[:3] + lines[4:]) + "\n", encoding="utf-8")
    study = load_study(folder)
    assert "63 samples at uneven times" in study.inflow_note
    times = np.arange(len(study.inlet_pressure_mmHg)) * PERIOD / len(study.inlet_pressure_mmHg)
    kept = np.delete(np.arange(N), 2)
    np.testing.assert_allclose(
        study.inlet_pressure_mmHg, np.interp(times, AT[kept], PRESSURE[kept], period=PERIOD), atol=0.05
    )


def test_several_beats_become_one(folder: Path) -> None:
    """Of the pressure that is given and of what is observed; the scatter of the former is no noise."""
    rng, lines = np.random.default_rng(1), ["time_s,pressure_mmHg"]
    beats = PRESSURE + rng.standard_normal((4, 1))
    lines += [
        f"{k * PERIOD + t!r},{p!r}"
        for k in range(4)
        for t, p in zip(AT.tolist(), beats[k].tolist(), strict=True)
    ]
    (folder / "inlet.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    seen = ["vessel,position,quantity,time_s,value"]
    seen += [f"1,0.0,flow_ml_s,{k * PERIOD + t!r},{rng.random()!r}" for k in range(4) for t in AT.tolist()]
    (folder / "observations.csv").write_text("\n".join(seen) + "\n", encoding="utf-8")
    with pytest.raises(StudyError, match=r"inlet pressure: .*import-beats"):
        load_study(folder)
    study = average_beats(folder).study
    np.testing.assert_allclose(study.inlet_pressure_mmHg, beats.mean(axis=0), rtol=1e-12)
    assert set(study.noise_sd) == {"v1@0 flow_ml_s"}


def test_a_pressure_in_kpa_is_suspected() -> None:
    assert not suspect_units(by_pressure(fork(), PRESSURE))
    (found,) = suspect_units(by_pressure(fork(), PRESSURE / 7.50062 / 10))
    assert found.fields == ("inlet_pressure: pressure_mmHg",)


def test_a_model_has_it_as_its_constant_and_the_demo_comes_back() -> None:
    """The demo's tree: at 256 samples of the pressure that its inflow made."""
    demo = load_study("demo")
    times = np.arange(256) * demo.period_s / 256
    demo = replace(demo, vessels=with_nominal_loads(demo))
    given = Solver.for_study(demo, series=[(1, 0.0)], times_s=times).solve(**DEMO)
    study = by_pressure(demo, given.pressure_mmHg[0], series=(), time_s=np.empty(0), priors={})
    found = Solver.for_study(study, series=[(1, 0.0)], times_s=times).solve(**DEMO)
    pulse = np.ptp(given.flow_ml_s)
    assert np.abs(found.flow_ml_s - given.flow_ml_s).max() < 5e-3 * pulse
    observed = replace(
        study, series=(Series(1, 0.0, "flow_ml_s", found.flow_ml_s[0] + 1e-3 * pulse),), time_s=times
    )
    constants = model_A(observed).zoo.constants
    dims, pressure, unit = constants["inlet_pressure"]
    np.testing.assert_array_equal(pressure, given.pressure_mmHg[0])
    assert (dims, unit) == (("inlet_time",), "mmHg")
    assert "inflow" not in constants
