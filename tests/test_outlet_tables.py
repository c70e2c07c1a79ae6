"""Outlets given by their impedance: the solver's waves beside transmission-line theory, and studies of them.

Small pulses in one vessel obey the line's equations, with Z of a wave 2 pi k/T in closed form; trees are
computed a second time by the recursion of `benchmarks.structured_trees`.
"""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.structured_trees import tree
from numpy.typing import NDArray

from test_study_physics import FINE, vessel
from test_study_physics import study as study_of
from zoo.blood.blood_flow import BloodFlow, constant_stiffness
from zoo.blood.case import Case
from zoo.blood.conventions import PRINTED
from zoo.blood.directions import Point
from zoo.blood.loads import outlet_impedance, with_more_impedance
from zoo.blood.network import Network
from zoo.blood.outlet_tables import MEMORY_BEATS, StructuredTree, circuit_of
from zoo.blood.physics import NO_PHYSICS, Physics, physics_words
from zoo.blood.solver import Solver, SolverArgumentError, SolverOptions
from zoo.blood.study import Blood, LoadWarning, Series, Study, StudyError, load_study, save_study
from zoo.core.parameters import Parameter, Uniform

LUNG = StructuredTree(0.805, 0.639, 33.5, 0.0094, 2e7, -20.0, 3e5)
DENSITY, VISCOSITY, PERIOD, RADIUS = 1.057, 0.032, 0.9, 1.1
OMEGA = 2 * math.pi / PERIOD * np.arange(21)


def lung(**changes: Any) -> np.ndarray:
    return replace(LUNG, **changes).impedance(RADIUS, DENSITY, VISCOSITY, OMEGA)


def one_vessel(impedance: Any, **given: Any) -> Network:
    end = vessel(1, length_cm=4.3, radius_cm=RADIUS, impedance=impedance, stiffness_g_cm_s2=4e5, **given)
    return Network.from_vessels([end], Blood(DENSITY, VISCOSITY), PERIOD)


def case_of(network: Network, physics: Physics = NO_PHYSICS, psi1: float = 1.0) -> Case:
    one, time = np.ones(1), np.arange(8) * PERIOD / 8
    given = (4e5 * one, one, psi1 * one, one, one)
    return Case(network, time, 1 + 0 * time, PRINTED, "linear", SolverOptions(), physics, *given)


@pytest.mark.parametrize(
    "changes", [{}, {"alpha": 0.88, "beta": 0.6, "smallest_radius_cm": 0.0035}, {"f2": -5.0, "f3": 1e5}]
)
@pytest.mark.parametrize("by_radius", [True, False])
def test_a_tree_is_that_of_another_recursion(changes: dict[str, float], by_radius: bool) -> None:
    made = replace(LUNG, viscosity_by_radius=by_radius, **changes)
    rules: dict[str, Any] = {} if by_radius else {"viscosity": lambda r: VISCOSITY}
    other = tree(
        RADIUS,
        OMEGA,
        daughters=(made.alpha, made.beta),
        length=made.length_ratio,
        smallest_cm=made.smallest_radius_cm,
        slope=lambda r: 2 / 3 * (made.f1 * math.exp(made.f2 * r) + made.f3),
        density=DENSITY,
        **rules,
    )
    found = made.impedance(RADIUS, DENSITY, VISCOSITY, OMEGA)
    np.testing.assert_allclose(found, other, rtol=1e-10)


@pytest.mark.parametrize("stiffness", [1e5, 3e5, 8e5])
@pytest.mark.parametrize("radius", [0.9, 1.1])
def test_the_circuit_and_its_response_meet_every_harmonic(stiffness: float, radius: float) -> None:
    Z = replace(LUNG, f3=stiffness).impedance(radius, DENSITY, VISCOSITY, OMEGA)
    network = one_vessel(tuple((z.real, z.imag) for z in Z))
    np.testing.assert_allclose(outlet_impedance(case_of(network), OMEGA)[0], Z, rtol=1e-9)


def test_a_windkessel_by_its_impedance_is_that_windkessel() -> None:
    R1, R2, C = 100.0, 600.0, 2e-3
    loads, cosine, sine = circuit_of(R1 + R2 / (1 + 1j * OMEGA * R2 * C), PERIOD)
    np.testing.assert_allclose(loads, (R1, R2, C), rtol=0.02)
    assert max(np.abs(cosine).max(), np.abs(sine).max()) < 0.05 / C


def test_waves_of_a_vessel_with_a_tree_are_those_of_line_theory() -> None:
    """rho/A q_t + 22 pi mu q/A^2 = -p_x, (A/slope) p_t = -q_x, and the tree's own impedance at the end."""
    time, m = np.arange(1024) * PERIOD / 1024, np.arange(1, 11)
    flow = 1e-3 * (1 + np.sum(np.cos(OMEGA[1:11, None] * time + m[:, None]) / m[:, None], axis=0))
    times = np.arange(256) * PERIOD / 256
    solver = Solver(
        one_vessel(LUNG),
        time,
        flow,
        series=[(1, 0.0), (1, 1.0)],
        times_s=times,
        options=SolverOptions(dx_cm=0.2, tolerance_mmHg=1e-9),
        physics=Physics(stokes_friction=0.0, viscous_friction=22.0),
    )
    found = solver.solve(np.array([4e5]))
    p, q = (np.fft.rfft(one)[:, :11] for one in (found.pressure_mmHg * PRINTED.mmhg, found.flow_ml_s))
    slope, area, w = 2 / 3 * 4e5, math.pi * RADIUS**2, OMEGA[1:11]
    end = tree(
        RADIUS, w, daughters=(0.805, 0.639), length=33.5, smallest_cm=0.0094,
        slope=lambda r: 2 / 3 * (2e7 * math.exp(-20 * r) + 3e5),
    )  # fmt: skip
    np.testing.assert_allclose(p[1, 1:] / q[1, 1:], end, rtol=1e-3)
    along = 1j * w * DENSITY / area + 22 * math.pi * VISCOSITY / area**2
    across = 1j * w * area / slope
    wave, turn = np.sqrt(along / across), np.tanh(4.3 * np.sqrt(along * across))
    np.testing.assert_allclose(
        p[0, 1:] / q[0, 1:], wave * (end + wave * turn) / (wave + end * turn), rtol=3e-3
    )


def test_the_factors_scale_all_of_an_impedance() -> None:
    """psi1 = psi2 = 1/c = k is k Z, with what was added to it."""
    made = case_of(one_vessel(LUNG))
    twice = replace(made, psi1=2 * made.psi1, psi2=2 * made.psi2, c=0.5 * made.c)
    np.testing.assert_allclose(outlet_impedance(twice, OMEGA)[0], 2 * lung(), rtol=1e-9)
    more = 0.1 * lung()
    changed = with_more_impedance(replace(made, psi1=2 * made.psi1), [more])
    without = outlet_impedance(replace(made, psi1=2 * made.psi1), OMEGA)[0]
    np.testing.assert_allclose(outlet_impedance(changed, OMEGA)[0], without + more, rtol=1e-9)


def test_a_wider_tree_has_its_resonances_at_lower_frequencies() -> None:
    """Z r^2 is one function of f r, if the smallest radius and the viscosity go with r."""

    def scaled(r: float, ratio: float, viscosity: float = VISCOSITY) -> NDArray[np.complex128]:
        like = replace(LUNG, f1=0.0, viscosity_by_radius=False, smallest_radius_cm=0.01 * r)
        return like.impedance(r, DENSITY, viscosity * r, ratio * OMEGA[1:]) * r**2

    np.testing.assert_allclose(scaled(1.1, 0.9 / 1.1), scaled(0.9, 1.0), rtol=1e-9)
    assert np.abs(scaled(1.1, 1.0) / scaled(0.9, 1.0) - 1).max() > 0.3
    # as great a change of the viscosity is felt less
    assert np.abs(scaled(0.9, 1.0, 1.1 / 0.9 * VISCOSITY) / scaled(0.9, 1.0) - 1).max() < 0.1


def test_slopes_by_the_loads_are_those_of_differences() -> None:
    made = study_of(vessel(1, radius_cm=RADIUS, impedance=LUNG), blood=Blood(DENSITY, VISCOSITY))
    solver = Solver.for_study(made, options=replace(FINE, tolerance_mmHg=1e-8, steps_per_beat=4096))
    step = 1e-4

    def at(psi1: float) -> np.ndarray:
        return solver.solve(np.array([4e5]), psi1=psi1).pressure_mmHg

    direction = [Point(s / (2 * step), np.array([4e5]), psi1=1 + s * step) for s in (1, -1)]
    found = solver.jacobian(np.array([4e5]), directions=[direction]).pressure_mmHg[0]
    wanted = (at(1 + step) - at(1 - step)) / (2 * step)
    np.testing.assert_allclose(found, wanted, atol=1e-4 * np.abs(wanted).max())


def test_a_study_keeps_its_tables_and_trees(tmp_path: Path) -> None:
    table = ((700.0, 0.0), (200.0, -150.0), (110.0, -30.0))
    made = study_of(
        vessel(1, radius_cm=1.35),
        vessel(2, 1, radius_cm=0.9, impedance=table),
        vessel(3, 1, radius_cm=RADIUS, impedance=LUNG),
        blood=Blood(DENSITY, VISCOSITY),
    )
    save_study(made, tmp_path)
    again = load_study(tmp_path)
    assert again.vessels == made.vessels
    other = replace(made.vessels[2], impedance=replace(LUNG, f3=4e5))
    assert again.checksum == made.checksum != replace(made, vessels=(*made.vessels[:2], other)).checksum
    assert "1 structured tree and 1 table of impedance" in physics_words(again)[0]
    wave = Solver.for_study(again, options=FINE).solve(np.full(3, 4e5))
    assert wave.ok


TABLES = {
    "impedance = [[700.0, 0.0], [200.0]]": r"impedance\[1\] = \[200.0\]: must be \[real, imaginary\]",
    "impedance = [[700.0, 1.0]]": r"impedance\[0\] = .*: must be a positive resistance",
    "impedance = [[700.0, 0.0], [-2.0, 1.0]]": r"impedance\[1\] = .* takes energy",
    "impedance = []": "impedance: 0 harmonics: give 1 to",
    "impedance = [[1e3, 0.0]]\nresistance = 3.0": "resistance = 3.0: an impedance is the outlet already",
    "impedance = { alpha = 0.8 }": "impedance: length_ratio: is missing",
    "impedance = { LAST }": "give alpha and beta, or exponent and asymmetry",
    "impedance = { alpha = 0.8, beta = 0.7, exponent = 2.7, LAST }": "give alpha and beta, or",
    "impedance = { alpha = 0.8, beta = 1.7, LAST }": "beta = 1.7: must be at most 0.98",
    "impedance = { alpha = 0.8, beta = 0.7, LAST, viscosity_by_radius = 3 }": "viscosity_by_radius = 3",
}


@pytest.mark.parametrize("line", TABLES)
def test_a_wrong_table_is_told_by_its_field(line: str, tmp_path: Path) -> None:
    made = study_of(vessel(1, radius_cm=1.0, impedance=LUNG), blood=Blood(DENSITY, VISCOSITY))
    save_study(made, tmp_path)
    text = (tmp_path / "network.toml").read_text()
    own = next(row for row in text.splitlines() if row.startswith("impedance"))
    rest = "length_ratio = 30.0, smallest_radius_cm = 0.01, f1 = 0.0, f2 = 0.0, f3 = 3e5"
    (tmp_path / "network.toml").write_text(text.replace(own, line.replace("LAST", rest)))
    with pytest.raises(StudyError, match=TABLES[line]):
        load_study(tmp_path)


def test_an_exponent_and_an_asymmetry_are_two_daughters(tmp_path: Path) -> None:
    """alpha^xi + beta^xi = 1, and beta^2/alpha^2 the asymmetry (Olufsen 1999)."""
    made = study_of(vessel(1, radius_cm=1.0, impedance=LUNG), blood=Blood(DENSITY, VISCOSITY))
    save_study(made, tmp_path)
    path = tmp_path / "network.toml"
    path.write_text(
        path.read_text().replace("alpha = 0.805, beta = 0.639", "exponent = 2.7, asymmetry = 0.41")
    )
    found = load_study(tmp_path).vessels[0].impedance
    assert isinstance(found, StructuredTree)
    assert found.alpha**2.7 + found.beta**2.7 == pytest.approx(1)
    assert (found.beta / found.alpha) ** 2 == pytest.approx(0.41)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"alpha": 0.99}, "alpha = 0.99: must be positive and at most 0.98"),
        ({"length_ratio": 0.0}, "length_ratio = 0.0: must be positive"),
        ({"smallest_radius_cm": 1e-4}, "must be at least 0.0005 of the vessel's radius"),
        ({"smallest_radius_cm": 1.2e-3, "beta": 0.05}, "have no viscosity by radius"),
        ({"f1": 0.0, "f3": 0.0}, "f1 = 0.0 and f3 = 0.0 are no stiffness"),
    ],
)
def test_a_tree_that_cannot_be_is_refused(given: dict[str, float], words: str) -> None:
    with pytest.raises(StudyError, match=words):
        one_vessel(replace(LUNG, **given))


FACTORS = {"tree_daughters": 0.98, "tree_length": 1.3, "tree_smallest_radius": 1.2, "tree_stiffness": 0.7}


def observed_tree() -> Study:
    made = study_of(
        vessel(1, radius_cm=1.35),
        vessel(2, 1, radius_cm=0.9, impedance=((700.0, 0.0), (200.0, -150.0), (110.0, -30.0))),
        vessel(3, 1, radius_cm=RADIUS, impedance=LUNG),
        blood=Blood(DENSITY, VISCOSITY),
    )
    pressure = Series(1, 0.0, "pressure_mmHg", np.zeros(64))
    return replace(made, time_s=np.arange(64) * made.period_s / 64, series=(pressure,))


def model(study: Study, *names: str) -> BloodFlow:
    given = [Parameter(name, Uniform(0.1, 9e5), "1", start=1.0) for name in ("f3", *names)]
    options = replace(FINE, tolerance_mmHg=1e-7, steps_per_beat=4096)
    return BloodFlow(study, "linear", constant_stiffness, given, options=options)


def test_parameters_of_a_model_are_factors_of_its_trees() -> None:
    study = observed_tree()
    tree = StructuredTree(0.98 * 0.805, 0.98 * 0.639, 1.3 * 33.5, 1.2 * 0.0094, 0.7 * 2e7, -20.0, 0.7 * 3e5)
    end = replace(study.vessels[2], impedance=tree)
    other = model(replace(study, vessels=(*study.vessels[:2], end)))
    found = model(study, *FACTORS)
    wanted = other.solve(other.configure([4e5]))
    np.testing.assert_allclose(found.solve(found.configure([4e5, *FACTORS.values()])), wanted, atol=1e-6)
    assert np.abs(found.solve(found.configure([4e5, 1, 1, 1, 1])) - wanted).max() > 0.5
    with pytest.raises(SolverArgumentError, match=r"vessel 3: tree: alpha = 1.0465\d*: must be positive"):
        found.configure([4e5, 1.3, 1, 1, 1])


def test_slopes_by_the_trees_parameters_are_those_of_differences() -> None:
    flow = model(observed_tree(), "tree_length", "tree_stiffness")
    theta, step = np.array([4e5, 1.0, 1.0]), 1e-4
    _, slopes = flow.solve_derivatives(flow.configure, theta, np.array([4e5, 1.0, 1.0]))
    for i in (1, 2):
        near = [flow.solve(flow.configure(theta + s * step * np.eye(3)[i])) for s in (1, -1)]
        wanted = (near[0] - near[1]) / (2 * step)
        np.testing.assert_allclose(slopes[i], wanted, atol=1e-3 * np.abs(wanted).max())


ROUGH = ((600.0, 0.0), (90.0, -40.0), (20.0, 95.0), (95.0, -20.0), (30.0, -90.0), (60.0, 80.0))
"""A table whose every harmonic takes energy, and whose outlet gives energy between them."""


def study_with(impedance: Any) -> Study:
    time = np.arange(64) * PERIOD / 64
    end = vessel(7, length_cm=4.0, radius_cm=RADIUS, impedance=impedance, stiffness_g_cm_s2=4e5)
    return Study("lung", PERIOD, Blood(DENSITY, VISCOSITY), (end,), time, 50 + 0 * time, np.empty(0), ())


def test_an_outlet_that_gives_energy_is_warned_of_with_its_frequency() -> None:
    with pytest.warns(LoadWarning, match=r"'lung': network.toml: vessel 7: impedance: .* at .* Hz") as said:
        Network.from_study(study_with(ROUGH))
    real, frequency = re.search(r"part (\S+) dyn s/cm5 at (\S+) Hz", str(said[0].message)).groups()  # type: ignore[union-attr]
    loads, cosine, sine = circuit_of([complex(*pair) for pair in ROUGH], PERIOD)
    t = np.arange(200_000) * (20 * MEMORY_BEATS * PERIOD / 200_000)  # of the response to a unit of volume
    turns = 2 * np.pi / PERIOD * np.arange(6)[:, None] * t
    response = np.exp(-t / (MEMORY_BEATS * PERIOD)) * (cosine @ np.cos(turns) + sine @ np.sin(turns))

    def part(hertz: float) -> float:
        w = 2 * np.pi * hertz
        circuit = loads[0] + loads[1] / (1 + (w * loads[1] * loads[2]) ** 2)
        return float(circuit + np.trapezoid(response * np.cos(w * t), t))

    assert float(real) == pytest.approx(part(float(frequency)), rel=1e-3)
    assert float(real) == pytest.approx(min(part(m / (16 * PERIOD)) for m in range(192)), rel=1e-3)


@pytest.mark.parametrize("impedance", [LUNG, tuple((900 / (1 + m), -50.0 * (m > 0)) for m in range(8))])
def test_an_outlet_that_takes_energy_everywhere_is_not_warned_of(impedance: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Network.from_study(study_with(impedance))
