"""Olufsen's wall, p = (4/3) (E h/r0) (1 - sqrt(A0/A)), E h/r0 = k1 exp(k2 r0) + k3, as that of a study."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from made import THETA, baseline_of
from walls import wall_pressure_mmHg
from zoo.blood.baseline import get_baseline
from zoo.blood.case import Case, wall_slope
from zoo.blood.components.wall_functions import added_pressure
from zoo.blood.effects import CATALOGUE
from zoo.blood.solve_errors import SolverError
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Blood, Study, StudyError, Vessel, Windkessel, load_study, save_study
from zoo.core.effects import EVERYWHERE
from zoo.core.parameters import pack

PERIOD, N, MMHG, RHO = 0.8, 64, 1333.22, 1.06
AT = np.arange(N) * PERIOD / N
K1, K2, K3 = 2e7, -22.53, 8.65e5
"""Of Olufsen 1999, g/(cm s2), 1/cm, g/(cm s2)."""
OPTIONS = SolverOptions(dx_cm=0.25, tolerance_mmHg=1e-7, max_beats=400)


def chi(radius: float) -> float:
    return K1 * math.exp(K2 * radius) + K3


def made(scale: float = 1.0, **given: Any) -> Study:
    """An artery of 30 cm with a Windkessel; `scale` of all flows."""
    radius, load = 0.6, Windkessel(150.0, 1500.0, 5e-4)
    vessel = Vessel(1, "v1", 30.0, radius, radius, None, load, stiffness_g_cm_s2=chi(radius))
    flow = scale * (60 + 40 * np.sin(2 * np.pi * AT / PERIOD) + 25 * np.cos(4 * np.pi * AT / PERIOD))
    return Study("made", PERIOD, Blood(RHO, 0.04), (vessel,), AT, flow, np.empty(0), (), **given)


def solved(study: Study, **given: Any) -> Any:
    times, places = np.arange(128) * PERIOD / 128, [(1, 0.0), (1, 1.0)]
    solver = Solver.for_study(study, series=places, times_s=times, options=OPTIONS, **given)
    return solver.solve(solver.network.stiffness_in)


def test_the_area_of_a_solve_is_that_of_its_pressure() -> None:
    found = solved(made(wall="olufsen"))
    expected = wall_pressure_mmHg("olufsen", found.area_cm2 / (math.pi * 0.6**2), chi(0.6))
    np.testing.assert_allclose(found.pressure_mmHg, expected, rtol=1e-3)
    linear = solved(made())
    assert np.ptp(found.pressure_mmHg[0] - linear.pressure_mmHg[0]) > 0.5


def test_small_pulses_have_the_impedance_of_the_linear_wall_of_the_same_wave_speed() -> None:
    """c^2 = (2/3) chi/rho at rest of both; of larger pulses it is another."""
    impedance = []
    for scale in (1e-4, 1.0):
        for wall in ("linear", "olufsen"):
            one = solved(made(scale, wall=wall))
            p, q = (np.fft.rfft(x)[1:3] for x in (one.pressure_mmHg[0], one.flow_ml_s[0]))
            impedance.append(p / q)
    np.testing.assert_allclose(impedance[1], impedance[0], rtol=1e-4)
    assert np.all(np.abs(impedance[3] / impedance[2] - 1) > 0.02)


def test_it_bears_no_more_than_its_scale() -> None:
    soft = made(wall="olufsen")
    soft = replace(soft, vessels=(replace(soft.vessels[0], stiffness_g_cm_s2=5e4),))
    with pytest.raises(SolverError):
        solved(soft)


def demo_case() -> Case:
    model = baseline_of(load_study("demo"))
    return model.configure(pack(model.parameters[:4], THETA))


def test_the_slopes_that_effects_and_functions_read() -> None:
    case = replace(demo_case(), wall="olufsen")
    K = 4 / 3 * case.stiffness
    np.testing.assert_allclose(wall_slope(case), K / 2)
    h, s = 1e-4, np.linspace(0.9, 1.3, 9)
    zero = added_pressure(case, s, np.full(9, h), s) / np.expm1(h)  # the law itself, from 1
    np.testing.assert_allclose(zero, 1 - 1 / s, atol=1e-6)
    tangent = CATALOGUE["tangent-wall"].apply(case, (0.2,), EVERYWHERE)
    np.testing.assert_allclose(wall_slope(tangent), K / 2)


# ---------------------------------------------------------------------------------------------------
# The study


FILES = {
    "study.toml": 'name = "x"\nnetwork = "network.toml"\ninflow = "inflow.csv"\nperiod_s = 0.8\n',
    "inflow.csv": "time_s,flow_ml_s\n" + "".join(f"{t:.4f},{5 + m % 7}\n" for m, t in enumerate(AT)),
    "network.toml": """\
[blood]
density_g_cm3 = 1.06
viscosity_g_cm_s = 0.04

[wall]
law = "olufsen"
k1_g_cm_s2 = 2e7
k2_per_cm = -22.53
k3_g_cm_s2 = 8.65e5

[[vessel]]
id = 1
length_cm = 4.0
radius_cm = 0.4
radius_out_cm = 0.35

[[vessel]]
id = 2
length_cm = 4.0
radius_cm = 0.3
parent = 1
stiffness_g_cm_s2 = 5e5
resistance = 4000
""",
}


def written(folder: Path, old: str = "", new: str = "") -> Path:
    for name, text in FILES.items():
        (folder / name).write_text(text.replace(old, new, 1) if name == "network.toml" else text)
    return folder


def test_a_study_has_it_with_its_stiffness(tmp_path: Path) -> None:
    study = load_study(written(tmp_path))
    assert study.wall == "olufsen"
    assert study.vessels[0].stiffness == pytest.approx((chi(0.4), chi(0.35)))
    assert study.vessels[1].stiffness == (5e5, 5e5)  # its own
    assert Solver.for_study(study).wall == "olufsen"
    assert Solver.for_study(study, "linear").wall == "linear"
    assert study.checksum != replace(study, wall="linear").checksum
    (tmp_path / "again").mkdir()
    save_study(study, tmp_path / "again")
    assert load_study(tmp_path / "again") == study


def test_models_with_the_linear_wall_have_it(tmp_path: Path) -> None:
    study = load_study(written(tmp_path))
    assert get_baseline("B").forward(study, options=OPTIONS).wall == "olufsen"
    assert get_baseline("H").forward(study, options=OPTIONS).wall == "tangent"


# fmt: off
MISTAKES = [
    ('"olufsen"', '"olufson"', r"wall: law = 'olufson': unknown; did you mean 'olufsen'\?"),
    ("k2_per_cm = -22.53", "", r"network\.toml: wall: k2_per_cm: is missing; give k1, k2 and k3"),
    ("k1_g_cm_s2 = 2e7", "k1_g_cm_s2 = -2e7", r"wall: k1_g_cm_s2 = -20000000\.0: must be at least 0"),
    ("-22.53", "1e4", r"wall: k1_g_cm_s2 = .*: make a stiffness of .* in vessel 1; correct them"),
]
# fmt: on


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_a_mistake_is_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(StudyError, match=message) as error:
        load_study(written(tmp_path, old, new))
    assert "\n" not in str(error.value)
