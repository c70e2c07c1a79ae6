"""Pressure behind the outlets that changes over the beat.

Small waves in a vessel that is shut at its inlet have closed forms: with rho/A q_t + r q = -p_x and
(A/slope) p_t = -q_x, p = P cosh(g x), q = -P sinh(g x)/Zc, and at the outlet p = Z q + T f.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zoo.blood.blood_flow import BloodFlow, constant_stiffness
from zoo.blood.directions import Point
from zoo.blood.network import Network
from zoo.blood.outlet_tables import StructuredTree, circuit_of
from zoo.blood.physics import Physics, physics_words, study_physics
from zoo.blood.solver import Solver, SolverArgumentError, SolverOptions
from zoo.blood.study import (
    Blood,
    Study,
    StudyError,
    Vessel,
    Windkessel,
    load_study,
    save_study,
    study_files,
)
from zoo.core.parameters import Parameter, Uniform

PERIOD, N, MMHG = 0.8, 64, 1333.22
CHI, RADIUS, LENGTH, DENSITY, VISCOSITY = 4e5, 0.5, 20.0, 1.06, 0.04
LOAD = Windkessel(150.0, 900.0, 6e-4)
TREE = StructuredTree(0.8, 0.64, 33.5, 0.0094, 2e7, -20.0, 3e5)
AT = np.arange(N) * PERIOD / N
VEINS = 8 + 3 * np.cos(2 * np.pi * AT / PERIOD + 0.4) + 1.5 * np.sin(6 * np.pi * AT / PERIOD)
OPTIONS = SolverOptions(dx_cm=0.2, tolerance_mmHg=1e-7, max_beats=400)


def end(id: int = 1, parent: int | None = None, **given: Any) -> Vessel:
    sizes = {"length_cm": LENGTH, "radius_cm": RADIUS, "radius_out_cm": RADIUS, "stiffness_g_cm_s2": CHI}
    return Vessel(id, f"v{id}", parent=parent, **(sizes | given))


def made(*vessels: Vessel, flow: Any = None, **given: Any) -> Study:
    pulse = 40 + 30 * np.sin(2 * np.pi * AT / PERIOD) if flow is None else flow
    blood = Blood(DENSITY, VISCOSITY, velocity_profile_order=9)
    return Study("made", PERIOD, blood, vessels, AT, pulse, np.empty(0), (), **given)


def fork(**given: Any) -> Study:
    ends = end(2, 1, windkessel=LOAD, length_cm=10.0), end(3, 1, resistance=1500.0, length_cm=8.0)
    return made(end(), *ends, **given)


def solved(study: Study, *places: tuple[int, float], **given: Any) -> Any:
    solver = Solver.for_study(study, series=places, times_s=np.arange(128) * PERIOD / 128, options=OPTIONS)
    return solver.solve(solver.network.stiffness_in, **given)


@pytest.mark.parametrize("outlet", ["windkessel", "resistance", "impedance"])
def test_without_inflow_it_goes_up_the_vessel_as_line_theory_says(outlet: str) -> None:
    given: dict[str, Any] = {"windkessel": LOAD, "resistance": 700.0, "impedance": TREE}
    small = 1e-3 * (VEINS - VEINS.mean())
    study = made(end(**{outlet: given[outlet]}), flow=np.full(N, 1e-9), outflow_wave_mmHg=small)
    pressure = np.fft.rfft(solved(study, (1, 0.0), (1, 1.0)).pressure_mmHg) / 128
    k = np.array([1, 3])
    omega = 2 * np.pi * k / PERIOD
    behind = (np.fft.rfft(small) / N)[k] * np.sinc(k / N) ** 2  # of lines between the samples
    Z, passed = np.full(2, 700.0 + 0j), np.ones(2, dtype=complex)
    if outlet == "windkessel":
        passed = 1 / (1 + 1j * omega * LOAD.R2 * LOAD.C)
        Z = LOAD.R1 + LOAD.R2 * passed
    if outlet == "impedance":
        harmonics = 2 * np.pi / PERIOD * np.arange(21)
        table = TREE.impedance(RADIUS, DENSITY, VISCOSITY, harmonics)
        (_, R2, C), *_ = circuit_of(table, PERIOD)
        Z, passed = table[k], 1 / (1 + 1j * omega * R2 * C)
    area, slope = math.pi * RADIUS**2, 2 / 3 * CHI
    along = 1j * omega * DENSITY / area + 22 * math.pi * VISCOSITY / area**2
    across = 1j * omega * area / slope
    g, Zc = np.sqrt(along * across), np.sqrt(along / across)
    inlet = passed * behind / (np.cosh(g * LENGTH) + Z * np.sinh(g * LENGTH) / Zc)
    size = np.abs(inlet).max()
    np.testing.assert_allclose(pressure[0, k], inlet, rtol=2e-3, atol=2e-3 * size)
    np.testing.assert_allclose(pressure[1, k], inlet * np.cosh(g * LENGTH), rtol=2e-3, atol=2e-3 * size)


def test_a_wave_that_does_not_change_is_the_constant() -> None:
    constant = solved(fork(outflow_pressure_mmHg=8.0), (1, 0.0), (3, 1.0))
    wave = solved(fork(outflow_wave_mmHg=np.full(N, 8.0)), (1, 0.0), (3, 1.0))
    np.testing.assert_allclose(wave.pressure_mmHg, constant.pressure_mmHg, atol=1e-5)
    np.testing.assert_allclose(wave.flow_ml_s, constant.flow_ml_s, atol=1e-4)


def test_what_enters_leaves_and_the_mean_is_that_of_the_constant() -> None:
    """Of the wave itself, as behind it all resistances are linear, and the vessels nearly."""
    found = solved(fork(outflow_wave_mmHg=VEINS), (1, 0.0), (2, 1.0))
    assert found.outflow_ml == pytest.approx(found.inflow_ml, rel=1e-6)
    constant = solved(fork(outflow_pressure_mmHg=float(VEINS.mean())), (1, 0.0), (2, 1.0))
    np.testing.assert_allclose(
        found.pressure_mmHg.mean(axis=1), constant.pressure_mmHg.mean(axis=1), rtol=2e-3
    )
    assert np.ptp(found.pressure_mmHg - constant.pressure_mmHg) > 0.5


def test_the_same_pressure_outside_raises_everything_alike() -> None:
    raised = fork(outflow_wave_mmHg=VEINS + 6, external_pressure_mmHg=6.0)
    plain = solved(fork(outflow_wave_mmHg=VEINS), (1, 0.5)).pressure_mmHg
    np.testing.assert_allclose(solved(raised, (1, 0.5)).pressure_mmHg, plain + 6, atol=1e-5)


def test_a_vessel_with_a_pressure_of_its_own_has_no_wave() -> None:
    study = fork(outflow_wave_mmHg=VEINS)
    alone = replace(study.vessels[1], outflow_pressure_mmHg=4.0)
    study = replace(study, vessels=(study.vessels[0], alone, study.vessels[2]))
    found = study_physics(study, Network.from_study(study), mmhg=MMHG)
    assert found.outflow_wave is not None
    assert found.outflow_pressure is not None
    assert not found.outflow_wave[1].any()
    np.testing.assert_allclose(found.outflow_pressure[1:], [4 * MMHG, VEINS.mean() * MMHG])
    np.testing.assert_allclose(found.outflow_wave[2], (VEINS - VEINS.mean()) * MMHG)


@pytest.mark.parametrize("name", ["stiffness", "psi1", "psi2", "c"])
def test_derivatives_are_differences(name: str) -> None:
    study = fork(outflow_wave_mmHg=VEINS)
    solver = Solver.for_study(
        study, series=[(1, 0.0), (2, 1.0)], times_s=AT, options=replace(OPTIONS, steps_per_beat=4096)
    )
    at = {"stiffness": CHI, "psi1": 1.0, "psi2": 1.0, "c": 1.0}
    h = 1e-3 * at[name]
    more, less = ({**at, name: at[name] + sign * h} for sign in (1, -1))
    by = [Point(1 / (2 * h), **more), Point(-1 / (2 * h), **less)]
    slopes = solver.jacobian(**at, directions=[by])
    difference = (solver.solve(**more).pressure_mmHg - solver.solve(**less).pressure_mmHg) / (2 * h)
    np.testing.assert_allclose(slopes.pressure_mmHg[0], difference, atol=1e-4 * np.abs(difference).max())


def test_the_derivative_by_the_wave_is_a_difference() -> None:
    places, options = [(1, 0.0), (3, 1.0)], replace(OPTIONS, steps_per_beat=4096)

    def of(factor: float) -> Solver:
        wave = VEINS.mean() + factor * (VEINS - VEINS.mean())
        study = fork(outflow_wave_mmHg=wave)
        return Solver.for_study(study, series=places, times_s=AT, options=options)

    h = 0.01
    by = [Point(sign / (2 * h), CHI, solver=of(1 + sign * h)) for sign in (1, -1)]
    slopes = of(1.0).jacobian(CHI, directions=[by])
    difference = (of(1 + h).solve(CHI).pressure_mmHg - of(1 - h).solve(CHI).pressure_mmHg) / (2 * h)
    np.testing.assert_allclose(slopes.pressure_mmHg[0], difference, atol=1e-4 * np.abs(difference).max())


def test_models_solve_with_it() -> None:
    study = fork(outflow_wave_mmHg=VEINS)
    parameter = Parameter("f3", Uniform(1e5, 1e6), "g cm-1 s-2", start=CHI)
    forward = BloodFlow(study, "linear", constant_stiffness, (parameter,), options=OPTIONS)
    other = BloodFlow(
        fork(outflow_wave_mmHg=VEINS[::-1].copy()),
        "linear",
        constant_stiffness,
        (parameter,),
        options=OPTIONS,
    )
    assert forward.key != other.key
    assert forward.configure(np.array([CHI])).physics.outflow_wave is not None


# ---------------------------------------------------------------------------------------------------
# The files


def test_a_study_keeps_it(tmp_path: Path) -> None:
    study = fork(outflow_wave_mmHg=VEINS)
    assert study.outflow_pressure_mmHg == VEINS.mean()
    save_study(study, tmp_path)
    back = load_study(tmp_path)
    assert back == study
    np.testing.assert_array_equal(back.outflow_wave_mmHg, study.outflow_wave_mmHg)
    assert tmp_path / "outflow.csv" in study_files(tmp_path)
    assert "pressure behind the outlets: 8 mmHg, 4.508 to 11.49 over the beat" in physics_words(back)
    assert study.checksum != fork(outflow_wave_mmHg=np.roll(VEINS, 1)).checksum
    assert study.checksum != fork(outflow_pressure_mmHg=float(VEINS.mean())).checksum


# fmt: off
MISTAKES = [
    ("outflow.csv", "time_s,pressure_mmHg", "time_s,p", r"outflow\.csv"),
    ("outflow.csv", "0.0125,", "0.0135,", r"outflow\.csv, row \d+: time_s = .*outflow pressure: .*uniform"),
    ("outflow.csv", "0.0,", "0.0,x", r"outflow\.csv, row 2: pressure_mmHg = 'x.*: not a number"),
    ("study.toml", '"outflow.csv"', "5.0", r"study\.toml: outflow_pressure = 5\.0: must be a file name"),
    ("study.toml", '"outflow.csv"', '"../outflow.csv"', r"outflow_pressure = '\.\./outflow\.csv': "),
    ("network.toml", "[[vessel]]", "[surroundings]\noutflow_pressure_mmHg = 5.0\n[[vessel]]",
     r"network\.toml: surroundings: outflow_pressure_mmHg = 5\.0: study\.toml gives .*; leave one"),
]
# fmt: on


@pytest.mark.parametrize(("name", "old", "new", "message"), MISTAKES)
def test_a_mistake_is_one_line(tmp_path: Path, name: str, old: str, new: str, message: str) -> None:
    save_study(fork(outflow_wave_mmHg=VEINS), tmp_path)
    text = (tmp_path / name).read_text(encoding="utf-8")
    assert old in text
    (tmp_path / name).write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(StudyError, match=message) as error:
        load_study(tmp_path)
    assert "\n" not in str(error.value)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(StudyError, match=r"its mean is 8\.0, but outflow_pressure_mmHg = 5\.0"):
        fork(outflow_wave_mmHg=np.full(N, 8.0), outflow_pressure_mmHg=5.0)
    with pytest.raises(StudyError, match="must be finite numbers in one row"):
        fork(outflow_wave_mmHg=np.array([1.0, np.nan]))
    with pytest.raises(SolverArgumentError, match=r"outflow_wave has shape \(4,\): must be \(n_v"):
        Physics(outflow_wave=np.zeros(4))
