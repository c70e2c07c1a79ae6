"""`zoo simulate`, on a tree of three vessels."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from commands import TRUE, fails, run

from zoo.blood.network import Network, stiffness_profile
from zoo.blood.resolution import GIVEN_CELLS_MMHG
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import load_study, save_study

DX = f"numerics.dx_cm={SolverOptions.dx_cm}"
SIMULATE = ("--stiffness", "5e4", "--psi1", "0.9", "--psi2", "1.1", "--c", "0.8")


def test_simulate_writes_every_vessel_as_netcdf(tiny: Path, tmp_path: Path) -> None:
    path = tmp_path / "waves.nc"
    output = run("simulate", tiny, *SIMULATE, "-o", path, "--times", 100, "--set", DX)
    study = load_study(tiny)
    network = Network.from_study(study)
    with xr.open_dataset(path) as waves:
        assert dict(waves.sizes) == {"vessel": 3, "position": 3, "time": 100}
        time_s = waves.time.to_numpy()
        np.testing.assert_allclose(time_s, np.arange(100) * 0.11 / 100)
        for vessel, position in ((1, 0.0), (2, 0.5), (3, 1.0)):
            solver = Solver(
                network, study.inflow_time_s, study.inflow_ml_s, series=[(vessel, position)], times_s=time_s
            )
            solution = solver.solve(**TRUE)
            at = waves.sel(vessel=vessel, position=position)
            np.testing.assert_allclose(at.pressure_mmHg, solution.pressure_mmHg[0], rtol=1e-12)
            np.testing.assert_allclose(at.flow_ml_s, solution.flow_ml_s[0], rtol=1e-12)
            np.testing.assert_allclose(at.area_cm2, solution.area_cm2[0], rtol=1e-12)
        pressure = waves.pressure_mmHg.sel(vessel=1, position=0).to_numpy()
        assert waves.attrs["conventions"] == "printed"
        assert waves.pressure_mmHg.attrs["units"] == "mmHg"
    assert (
        f"systolic {pressure.max():.2f}, diastolic {pressure.min():.2f}, mean {pressure.mean():.2f} mmHg"
        in output
    )
    clean = Solver.for_study(study).solve(**TRUE).pressure_mmHg
    assert f"64 observed values of pressure: {np.sum((clean - study.values) ** 2):.4g} mmHg2" in output
    assert np.sum((clean - study.values) ** 2) == pytest.approx(64 * 0.01, rel=0.4)


def test_simulate_csv_has_the_format_of_observations(tiny: Path, tmp_path: Path) -> None:
    path, other = tmp_path / "waves.csv", tmp_path / "waves.nc"
    run("simulate", tiny, *SIMULATE, "-o", path, "--times", 64)
    run("simulate", tiny, *SIMULATE, "-o", other, "--times", 64)
    table = pd.read_csv(path)
    assert list(table.columns) == ["vessel", "position", "quantity", "time_s", "value"]
    assert len(table) == 3 * 3 * 3 * 64
    with xr.open_dataset(other) as waves:
        part = table[(table.vessel == 3) & (table.position == 0.5) & (table.quantity == "flow_ml_s")]
        np.testing.assert_allclose(part.value, waves.flow_ml_s.sel(vessel=3, position=0.5), rtol=1e-8)
    # and a study can be made of it
    folder = tmp_path / "study"
    folder.mkdir()
    for name in ("study.toml", "network.toml", "inflow.csv"):
        (folder / name).write_text((tiny / name).read_text())
    with open(tiny / "observations.csv") as old:
        header = next(csv.reader(old))
    assert header == list(table.columns)
    table.to_csv(folder / "observations.csv", index=False)
    assert len(load_study(folder).series) == 27


@pytest.mark.parametrize(
    ("options", "solve"),
    [
        (("--f3", "5e4"), {"stiffness": 5e4}),
        (
            ("--stiffness", "4e4,5e4,6e4", "--psi1", "1,0.9,1.2"),
            {"stiffness": [4e4, 5e4, 6e4], "psi1": [1, 0.9, 1.2]},
        ),
        (("--f1", "1e5", "--f2", "-40", "--f3", "4e4"), {"profile": (1e5, -40.0, 4e4)}),
        (("--wall", "tangent", "--stiffness", "5e4", "--gamma", "5.2"), {"stiffness": 5e4, "gamma": 5.2}),
    ],
)
def test_simulate_takes_the_parameters_of_any_model(tiny: Path, tmp_path: Path, options, solve) -> None:
    study = load_study(tiny)
    if "profile" in solve:
        solve = {"stiffness": stiffness_profile(Network.from_study(study).radius_in_cm, *solve["profile"])}
    wall = "tangent" if "gamma" in solve else "linear"
    run("simulate", tiny, *options, "-o", tmp_path / "w.nc", "--set", DX)
    time_s = np.arange(512) * 0.11 / 512
    options = SolverOptions(tolerance_mmHg=GIVEN_CELLS_MMHG)  # as a study's whose cells are given
    solver = Solver.for_study(study, wall, series=[(2, 1.0)], times_s=time_s, options=options)
    expected = solver.solve(**solve).pressure_mmHg[0]
    with xr.open_dataset(tmp_path / "w.nc") as waves:
        np.testing.assert_allclose(waves.pressure_mmHg.sel(vessel=2, position=1.0), expected, rtol=1e-12)


def test_simulate_per_vessel_values_follow_the_file_and_not_the_tree(tiny: Path, tmp_path: Path) -> None:
    """Vessels listed daughters first: the values belong to the vessels as listed."""
    folder = tmp_path / "reordered"
    folder.mkdir()
    study = load_study(tiny)
    save_study(study, folder)
    head, *vessels = (folder / "network.toml").read_text().split("[[vessel]]")
    (folder / "network.toml").write_text("[[vessel]]".join([head, vessels[2], vessels[0], vessels[1]]))
    assert [v.id for v in load_study(folder).vessels] == [3, 1, 2]
    run("simulate", folder, "--stiffness", "6e4,4e4,5e4", "-o", tmp_path / "a.nc")
    run("simulate", tiny, "--stiffness", "4e4,5e4,6e4", "-o", tmp_path / "b.nc")
    with xr.open_dataset(tmp_path / "a.nc") as a, xr.open_dataset(tmp_path / "b.nc") as b:
        for vessel in (1, 2, 3):
            np.testing.assert_allclose(
                a.area_cm2.sel(vessel=vessel), b.area_cm2.sel(vessel=vessel), rtol=1e-10
            )


def test_simulate_conventions_and_numerical_settings(tiny: Path) -> None:
    def said(*settings: str) -> str:
        return run("simulate", tiny, *SIMULATE, *(word for one in settings for word in ("--set", one)))

    published, plain = said("conventions=published-code"), said()
    assert "conventions published-code" in published
    one = said("conventions.friction=rest")
    assert "conventions custom (printed with friction=rest)" in one
    switches = "truncate_lengths=false", "mmhg=1333.22", "sample_lag_beats=0.25"
    both = said("conventions=published-code", *(f"conventions.{switch}" for switch in switches))
    assert "published-code with truncate_lengths=False, mmhg=1333.22, sample_lag_beats=0.25" in both
    pressures = {re.search("pressure at the inlet.*", text).group() for text in (published, one, both, plain)}
    assert len(pressures) == 4
    assert "beats of 4096 steps" in said("numerics.steps_per_beat=4096")
    fine = said("numerics.dx_cm=0.01", "numerics.tolerance_mmHg=1e-6")
    assert "error not estimated, since the cells were given" in fine
    cells, error = (re.findall(r"grid: (\d+) cells in 3 vessels .*error ([0-9.]+) %", plain))[0]
    assert float(error) <= 0.03
    more, less = (
        re.findall(r"grid: (\d+) cells", run("simulate", tiny, *SIMULATE, "--accuracy", a))[0]
        for a in ("0.005", "1")
    )
    assert int(more) > int(cells) > int(less)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--stiffness", "5x"), "--stiffness 5x: '5x' is not a number; write 5.17e4 or 4e4,5e4"),
        (("--stiffness", "4e4,5e4"), "--stiffness: 2 values; give one for all vessels, or one for each of"),
        (("--f1", "1", "--f2", "-1"), "--f1 and --f2 need --f3 in chi = f1 exp(f2 r0) + f3: give it too"),
        (("--stiffness", "5e4", "--f3", "5e4"), "two ways to say the same"),
        (("--stiffness", "5e4", "--gamma", "2"), "--gamma belongs to the tangent wall: add --wall tangent"),
        (("--stiffness", "5e4", "--wall", "tangent"), "--wall tangent needs --gamma"),
        (("--stiffness", "5e4", "--psi1", "0"), "positive"),
        (("--stiffness", "5e4", "--set", "numerics.steps_per_beat=33"), "steps_per_beat = 33: waves cross"),
        (("--stiffness", "5e4", "--set", "numerics.steps_per_beat=33", "--set", DX), "CFL"),
        (("--stiffness", "5e4", "--accuracy", "1", "--set", DX), "accuracy_percent and dx_cm are two ways"),
        (("--stiffness", "5e4", "--set", "vessel.stiffness_g_cm_s2=4e4"), "--set vessel.stiffness_g_cm_s2:"),
        (("--stiffness", "5e4", "-o", "waves.txt"), "unknown ending '.txt'; use .nc or .csv"),
        (("--stiffness", "5e4", "--set", "surroundings.radius_pressure_mmHg=60"), "60.0: without pressure"),
        (("--stiffness", "5e4", "--plot", "waves.xyz"), "unknown figure format '.xyz'"),
    ],
)
def test_simulate_says_what_to_change(tiny: Path, options, message) -> None:
    assert message in fails("simulate", tiny, *options)


def test_without_a_stiffness_the_prior_s_is_taken_and_told(tiny: Path) -> None:
    told = run("simulate", tiny)
    stated = re.search(r"no stiffness is given: solved with (\S+) g cm-1 s-2", told)
    assert stated is not None
    [used] = re.findall(r"(?m)^stiffness: (\S+) g/", told)
    assert float(used) == pytest.approx(float(stated[1]), rel=0.01)


@pytest.mark.needs_data
def test_simulate_the_mouse_at_the_published_medians() -> None:
    output = run("simulate", "mouse-c6", "--stiffness", "5.17e4", "--psi1", 0.21, "--psi2", 0.88, "--c", 1.44)
    sse = float(output.split("512 observed values of pressure: ")[1].split()[0])
    assert sse == pytest.approx(64.6, abs=2.5)


WALLS = {
    "g/(cm s2), E h/r": {
        "youngs_modulus_g_cm_s2": 4e6, "wall_thickness_cm": 1e-3, "wall_thickness_out_cm": 8e-4
    },
    "stiffness: 6e+04 to 8e+04 g/(cm s2)": {"stiffness_g_cm_s2": 6e4, "stiffness_out_g_cm_s2": 8e4},
}  # fmt: skip
"""What is said of a wall -> its fields."""


@pytest.mark.parametrize("words", WALLS)
def test_settings_do_what_the_fields_do_in_a_study_that_has_them(
    tiny: Path, tmp_path: Path, words: str
) -> None:
    blood = {"velocity_profile_order": 9.0, "momentum_correction": 1.1}
    around = {"external_pressure_mmHg": -2.0, "radius_pressure_mmHg": 5.0}
    base = load_study(tiny)
    made = replace(
        base,
        vessels=tuple(replace(v, **WALLS[words]) for v in base.vessels),
        blood=replace(base.blood, **blood),
        junction_pressure="total",
        outflow_pressure_mmHg=3.0,
        **around,
    )
    save_study(made, tmp_path / "made")
    groups = {"vessel": WALLS[words] | {"outflow_pressure_mmHg": 3}, "blood": blood, "surroundings": around}
    settings = [
        f"{group}.{name}={value}" for group, fields in groups.items() for name, value in fields.items()
    ]
    settings.append("junctions.pressure=total")
    options = [word for setting in settings for word in ("--set", setting)]
    switched = run("simulate", tiny, *options, "-o", tmp_path / "a.nc")
    said = run("simulate", tmp_path / "made", "-o", tmp_path / "b.nc")
    with xr.open_dataset(tmp_path / "a.nc") as a, xr.open_dataset(tmp_path / "b.nc") as b:
        for name in ("pressure_mmHg", "flow_ml_s", "area_cm2", "stiffness"):
            np.testing.assert_array_equal(a[name], b[name])
        for what in (
            words,
            "velocity profile of order 9, momentum correction 1.1;",
            "total pressure at junctions",
            "pressure at which radii are given: 5 mmHg",
            "pressure behind the outlets: 3 mmHg",
        ):
            for text in (switched, said, a.attrs["physics"]):
                assert what in " ".join(text.split())


def test_simulate_resistances_as_outlets(tiny: Path, tmp_path: Path) -> None:
    output = run(
        "simulate", tiny, "--stiffness", "5e4", "--set", "vessel.resistance=1e5",
        "--set", "vessel.outflow_pressure_mmHg=2", "-o", tmp_path / "w.nc",
    )  # fmt: skip
    assert "2 single resistances" in output
    with xr.open_dataset(tmp_path / "w.nc") as waves:
        end = waves.sel(vessel=[2, 3], position=1.0)
        np.testing.assert_allclose(end["pressure_mmHg"], 2 + 1e5 * end["flow_ml_s"] / 1333.22, atol=1e-9)
