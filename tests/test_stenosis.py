"""A stenosis of a vessel against Young and Tsai's law, dp = Kv mu/D0 U + Kt rho/2 (A0/A1 - 1)^2 U|U|."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zoo.blood.directions import Point
from zoo.blood.physics import physics_words
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Blood, Study, StudyError, Vessel, Windkessel, load_study, save_study
from zoo.blood.study.parts import Stenosis

PERIOD, N, MMHG, RHO, MU = 0.8, 64, 1333.22, 1.06, 0.04
AT = np.arange(N) * PERIOD / N
R0, R1, LENGTH = 0.3, 0.12, 1.5
OPTIONS = SolverOptions(dx_cm=0.2, tolerance_mmHg=1e-7, max_beats=400)


def made(stenosis: Stenosis | None, flow: Any = 8.0, *, stiffness: float = 1e8, **given: Any) -> Study:
    load = Windkessel(1000.0, 9000.0, 5e-5)
    sizes = {"radius_cm": R0, "radius_out_cm": R0} | given
    vessel = Vessel(1, "v1", 10.0, **sizes, windkessel=load, stiffness_g_cm_s2=stiffness, stenosis=stenosis)
    blood = Blood(RHO, MU, velocity_profile_order=2)
    return Study("made", PERIOD, blood, (vessel,), AT, flow + 0 * AT, np.empty(0), ())


def fall(study: Study) -> np.ndarray:
    """Pressure at the inlet less that at the outlet, dyn/cm2, (8,)."""
    solver = Solver.for_study(
        study, series=[(1, 0.0), (1, 1.0)], times_s=np.arange(8) * PERIOD / 8, options=OPTIONS
    )
    p = solver.solve(solver.network.stiffness_in).pressure_mmHg
    return np.asarray((p[0] - p[1]) * MMHG)


def law(flow: float, Kt: float, Kv: float, radius: float = R0) -> float:
    """With the area that the pressure of the outlet gives to the viscous part."""
    U = flow / (math.pi * radius**2)
    Kv /= (1 + flow * 1e4 / (4 / 3 * 1e8)) ** 4
    ratio = (radius / R1) ** 2
    return Kv * MU / (2 * radius) * U + Kt * RHO / 2 * (ratio - 1) ** 2 * U * abs(U)


@pytest.mark.parametrize("flow", [0.5, 8.0])
@pytest.mark.parametrize("position", [0.3, 0.5, 0.7])
def test_steady_flow_loses_what_the_law_says(flow: float, position: float) -> None:
    lost = fall(made(Stenosis(R1, LENGTH, position), flow)) - fall(made(None, flow))
    Kv = 32 * (0.83 * LENGTH + 1.64 * 2 * R1) / (2 * R0) * (R0 / R1) ** 4
    np.testing.assert_allclose(lost, law(flow, 1.52, Kv), rtol=2e-3)


@pytest.mark.parametrize(("Kt", "Kv"), [(1.0, 0.0), (0.0, 500.0), (2.0, 900.0)])
def test_its_constants_are_those_that_are_given(Kt: float, Kv: float) -> None:
    lost = fall(made(Stenosis(R1, LENGTH, 0.5, Kt, Kv))) - fall(made(None))
    np.testing.assert_allclose(lost, law(8.0, Kt, Kv), rtol=2e-3)


def test_in_a_taper_the_vessel_is_that_of_the_place() -> None:
    taper = {"radius_cm": 0.4, "radius_out_cm": 0.2}
    lost = fall(made(Stenosis(R1, LENGTH, 0.5), **taper)) - fall(made(None, **taper))
    Kv = 32 * (0.83 * LENGTH + 1.64 * 2 * R1) / 0.6 * (0.3 / R1) ** 4
    np.testing.assert_allclose(lost, law(8.0, 1.52, Kv), rtol=0.02)  # of areas along the stretch


def test_a_short_one_is_in_several_cells() -> None:
    """Which are longer without it: the loss is the same."""
    short = made(Stenosis(R1, 0.2, 0.47, 1.52, 0.0), stiffness=4e6)
    lost = fall(short) - fall(made(None, stiffness=4e6))
    np.testing.assert_allclose(lost, law(8.0, 1.52, 0.0), rtol=0.01)


def test_derivatives_are_differences() -> None:
    study = made(Stenosis(R1, LENGTH), 8 + 4 * np.sin(2 * np.pi * AT / PERIOD), stiffness=8e5)
    solver = Solver.for_study(
        study, series=[(1, 0.0), (1, 1.0)], times_s=AT, options=replace(OPTIONS, steps_per_beat=4096)
    )
    h = 100.0
    found = solver.jacobian(8e5, directions=[[Point(1 / (2 * h), 8e5 + h), Point(-1 / (2 * h), 8e5 - h)]])
    difference = (solver.solve(8e5 + h).pressure_mmHg - solver.solve(8e5 - h).pressure_mmHg) / (2 * h)
    np.testing.assert_allclose(found.pressure_mmHg[0], difference, atol=1e-4 * np.abs(difference).max())


def test_a_study_keeps_it(tmp_path: Path) -> None:
    study = made(Stenosis(R1, LENGTH, 0.4, Kv=600.0))
    save_study(study, tmp_path)
    back = load_study(tmp_path)
    assert back == study
    assert back.vessels == study.vessels
    assert "stenosis in vessel 1: loss of Young and Tsai" in physics_words(back)
    sums = {made(one).checksum for one in (None, Stenosis(R1, LENGTH), Stenosis(R1, LENGTH, Kt=1.0))}
    assert len(sums) == 3


# fmt: off
MISTAKES = [
    ("radius_cm = 0.12", "radius_cm = 0.3",
     r"vessel 1: stenosis: radius_cm = 0\.3: must be below that of the vessel there, 0\.3"),
    ("length_cm = 1.5", "length_cm = 11.0", r"stenosis: length_cm = 11\.0: reaches from -0\.5 to 10\.5 cm"),
    ("Kt = 1.52", "Kt = -1.0", r"stenosis: Kt = -1\.0: must be at least 0; correct it"),
    ("Kt = 1.52", "Ku = 1.2", r"stenosis: Ku: unknown field"),
]
# fmt: on


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_a_mistake_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    save_study(made(Stenosis(R1, LENGTH)), tmp_path)
    file = tmp_path / "network.toml"
    text = file.read_text(encoding="utf-8")
    at = text.index("stenosis =")
    assert old in text[at:]
    file.write_text(text[:at] + text[at:].replace(old, new, 1), encoding="utf-8")
    with pytest.raises(StudyError, match=message) as error:
        load_study(tmp_path)
    assert "\n" not in str(error.value)
