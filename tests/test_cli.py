"""The commands, run as a user runs them, on a tree of three vessels."""

from __future__ import annotations

import csv
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from typer.testing import CliRunner

import zoo
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import Solver
from zoo.blood.study import Blood, Series, Study, Vessel, Windkessel, load_study, save_study
from zoo.cli import app
from zoo.core.inference.record import RunRecord
from zoo.core.posterior.files import find
from zoo.core.posterior.storage import load
from zoo.paper.synthetic import ejection

pytestmark = pytest.mark.filterwarnings("ignore:PyTensor could not link to a BLAS:UserWarning")

TRUE = {"stiffness": 5e4, "psi1": 0.9, "psi2": 1.1, "c": 0.8}


def run(*arguments: object, code: int = 0) -> str:
    """Output of a command that must end with `code`; all streams together, lines unwrapped."""
    result = CliRunner(env={"COLUMNS": "200"}).invoke(app, [str(a) for a in arguments])
    assert result.exit_code == code, result.output
    return result.output


def fails(*arguments: object) -> str:
    """The one line that a refused command prints."""
    output = run(*arguments, code=2).strip()
    assert output.count("\n") == 0
    assert output.startswith("error: ")
    assert "Traceback" not in output
    return output


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of three vessels whose pressure was made by the solver, with white noise."""
    flow_time, flow = ejection(256)
    outlets = (Windkessel(3e4, 9e4, 1.5e-6), Windkessel(4e4, 1.1e5, 1.2e-6))
    vessels = (
        Vessel(1, "trunk", 0.4, 0.047, 0.047, None, None),
        Vessel(2, "left", 0.35, 0.03, 0.03, 1, outlets[0]),
        Vessel(3, "right", 0.3, 0.035, 0.03, 1, outlets[1]),
    )
    times = np.arange(64) * 0.11 / 64
    empty = Study("tiny", 0.11, Blood(1.055, 0.049), vessels, flow_time, flow, times, ())
    clean = Solver.for_study(empty, series=[(1, 0.0)], times_s=times).solve(**TRUE).pressure_mmHg[0]
    noisy = clean + 0.1 * np.random.default_rng(0).standard_normal(64)
    folder = tmp_path_factory.mktemp("studies") / "tiny"
    save_study(replace(empty, series=(Series(1, 0.0, "pressure_mmHg", noisy),)), folder)
    return folder


SIMULATE = ("--stiffness", "5e4", "--psi1", "0.9", "--psi2", "1.1", "--c", "0.8")


# starting


def test_help_is_quick_and_lists_the_commands() -> None:
    command = [sys.executable, "-c", "from zoo.cli import app; app()", "--help"]
    best = np.inf
    for _ in range(3):
        began = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        best = min(best, time.monotonic() - began)
    for name in ("fetch", "studies", "simulate", "sample", "compare", "version"):
        assert name in done.stdout
    assert best < 2.0  # about 0.4 s on a free core; importing PyMC alone takes longer than this


def test_commands_import_nothing_heavy_before_they_run() -> None:
    heavy = "{'pymc', 'arviz', 'matplotlib', 'scipy', 'numpy'}"
    code = f"import sys, zoo.cli; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_version() -> None:
    output = run("version")
    assert f"zoo {zoo.__version__}" in output
    assert f"numpy {np.__version__}" in output


def test_studies() -> None:
    output = run("studies")
    assert "demo" in output
    assert "mouse-c6" in output


def test_fetch_unknown() -> None:
    assert "data set 'mouse-c7': unknown; did you mean 'mouse-c6'?" in fails("fetch", "mouse-c7")


@pytest.mark.needs_data
def test_fetch() -> None:
    output = run("fetch", "mouse-c6")
    assert output.count("sha256 as expected") == 2


# simulate


def test_simulate_writes_every_vessel_as_netcdf(tiny: Path, tmp_path: Path) -> None:
    path = tmp_path / "waves.nc"
    output = run("simulate", tiny, *SIMULATE, "-o", path, "--times", 100)
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
    assert f"64 observed values: {np.sum((clean - study.values) ** 2):.4g}" in output
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
    run("simulate", tiny, *options, "-o", tmp_path / "w.nc")
    time_s = np.arange(512) * 0.11 / 512
    expected = (
        Solver.for_study(study, wall, series=[(2, 1.0)], times_s=time_s).solve(**solve).pressure_mmHg[0]
    )
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


def test_simulate_conventions_and_single_switches(tiny: Path, tmp_path: Path) -> None:
    published = run("simulate", tiny, *SIMULATE, "--conventions", "published-code")
    assert "conventions published-code" in published
    one = run("simulate", tiny, *SIMULATE, "--friction", "rest")
    assert "conventions custom (printed with friction=rest)" in one
    both = run(
        "simulate",
        tiny,
        *SIMULATE,
        "--conventions",
        "published-code",
        "--true-lengths",
        "--mmhg",
        "1333.22",
        "--sample-lag",
        "0.25",
    )
    assert "published-code with truncate_lengths=False, mmhg=1333.22, sample_lag_beats=0.25" in both
    plain = run("simulate", tiny, *SIMULATE)
    assert (
        len({text.splitlines()[1] for text in (published, one, both, plain)}) == 4
    )  # four different pressures


def test_simulate_numerical_options(tiny: Path) -> None:
    assert "beats of 4096 steps" in run("simulate", tiny, *SIMULATE, "--steps", 4096)
    fine = run("simulate", tiny, *SIMULATE, "--dx", 0.01, "--tolerance", "1e-6")
    assert fine != run("simulate", tiny, *SIMULATE)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--stiffness", "5x"), "--stiffness 5x: '5x' is not a number; write 5.17e4 or 4e4,5e4"),
        (("--stiffness", "nan"), "'nan' is not finite"),
        (
            ("--stiffness", "4e4,5e4"),
            "--stiffness: 2 values; give one for all vessels, or one for each of the 3 vessels",
        ),
        ((), "no stiffness: give --stiffness 5.17e4, or --f3"),
        (("--stiffness", "5e4", "--f3", "5e4"), "two ways to say the same"),
        (("--f1", "5e4", "--f3", "5e4"), "--f1 and --f2 belong together"),
        (("--stiffness", "5e4", "--gamma", "2"), "--gamma belongs to the tangent wall: add --wall tangent"),
        (("--stiffness", "5e4", "--wall", "tangent"), "--wall tangent needs --gamma"),
        (("--stiffness", "5e4", "--wall", "rigid"), "wall = 'rigid': must be one of linear, tangent"),
        (("--stiffness", "-1"), "positive"),
        (("--stiffness", "5e4", "--psi1", "0"), "positive"),
        (("--stiffness", "5e4", "--dx", "-1"), "dx_cm = -1.0: must be positive"),
        (("--stiffness", "5e4", "--steps", "33"), "CFL"),
        (("--stiffness", "5e4", "--times", "1"), "--times 1: give at least 2"),
        (("--stiffness", "5e4", "--conventions", "printd"), "did you mean 'printed'?"),
        (
            ("--stiffness", "5e4", "--friction", "none"),
            "friction = 'none': unknown; use one of current, rest, fixed",
        ),
        (("--stiffness", "5e4", "-o", "waves.txt"), "unknown ending '.txt'; use .nc or .csv"),
        (("--stiffness", "5e4", "-o", "nowhere/waves.nc"), "folder nowhere does not exist"),
        (("--stiffness", "5e4", "--plot", "waves.xyz"), "unknown figure format '.xyz'"),
    ],
)
def test_simulate_says_what_to_change(tiny: Path, options, message) -> None:
    assert message in fails("simulate", tiny, *options)


def test_unknown_study() -> None:
    assert "did you mean 'demo'?" in fails("simulate", "demmo", "--stiffness", "5e4")


def test_debug_shows_the_traceback() -> None:
    result = CliRunner().invoke(app, ["--debug", "simulate", "demmo", "--stiffness", "5e4"])
    assert type(result.exception).__name__ == "StudyError"
    run("studies")  # and the next command starts without it
    assert "Traceback" not in fails("simulate", "demmo", "--stiffness", "5e4")


def test_a_fault_of_ours_is_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> None:
        raise ZeroDivisionError("nobody thought\nof this")

    monkeypatch.setattr("zoo.blood.study.list_studies", broken)
    output = run("studies", code=1)
    assert (
        output.strip()
        == "error: unexpected ZeroDivisionError: nobody thought of this; `zoo --debug ...` shows where"
    )


def test_interrupt_has_its_own_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("zoo.blood.study.list_studies", interrupted)
    assert "interrupted; the same command goes on" in run("studies", code=130)


@pytest.mark.needs_data
def test_simulate_the_mouse_at_the_published_medians() -> None:
    output = run("simulate", "mouse-c6", "--stiffness", "5.17e4", "--psi1", 0.21, "--psi2", 0.88, "--c", 1.44)
    sse = float(output.split("512 observed values: ")[1].split()[0])
    assert sse == pytest.approx(64.6, abs=2.5)


# sample and compare

QUICK = ("--draws", 60, "--tune", 150, "--chains", 2, "--cores", 2, "--seed", 3)


@pytest.fixture(scope="module")
def sampled(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    path = tmp_path_factory.mktemp("posteriors") / "A.nc"
    return path, run("sample", "a", tiny, "-o", path, "--thin", 2, *QUICK)


def test_sample_writes_the_posterior_and_a_verdict(sampled: tuple[Path, str], tiny: Path) -> None:
    path, output = sampled
    idata = load(path)
    assert dict(idata.posterior.sizes)["draw"] == 60
    assert set(idata.posterior.data_vars) == {"f3", "psi1", "psi2", "c", "sigma2"}
    record = RunRecord.of(idata)
    assert (record.model, record.study, record.seed) == ("A", "tiny", 3)
    assert record.study_checksum == load_study(tiny).checksum
    assert record.conventions["name"] == "printed"
    assert record.settings["thin"] == 2
    assert record.solves_per_step == pytest.approx(1.0, abs=0.02)
    assert "model A on tiny: 5 dimensions, 2 chains of demetropolisz" in output
    for name in idata.posterior.data_vars:
        assert f"\n{name} " in output
    assert "2 chains: at least 4 are needed" in output
    low, high = np.quantile(idata.posterior.psi2, (0.001, 0.999))
    assert low < TRUE["psi2"] < high


def test_sample_goes_on_from_its_checkpoint(sampled: tuple[Path, str], tiny: Path) -> None:
    path, _ = sampled
    assert path.with_suffix(".checkpoint").is_dir()
    refused = fails("sample", "A", tiny, "-o", path, "--thin", 3, *QUICK)
    assert "thin is 2 there and 3 here" in refused
    assert "--fresh removes it" in refused
    more = path.with_name("A.nc")
    before = load(path).posterior.c.to_numpy()
    output = run("sample", "A", tiny, "-o", more, "--thin", 2, *QUICK[2:], "--draws", 80, "-q")
    after = load(more)
    assert after.posterior.sizes["draw"] == 80
    np.testing.assert_array_equal(after.posterior.c[:, :60], before)
    assert RunRecord.of(after).sittings == 2
    assert "model A on tiny" not in output  # -q


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("Z",), "model 'Z': unknown; there is A, B"),
        (("A", "--until", "400"), "--until 400: write --until ess=400"),
        (("A", "--until", "ess=-1"), "write --until ess=400"),
        (("A", "--step", "nuts"), "step = 'nuts': must be one of demetropolisz, metropolis"),
        (("A", "--chains", "0"), "chains = 0: must be a whole number of at least 1"),
        (("A", "-o", "nowhere/A.nc"), "folder nowhere does not exist"),
    ],
)
def test_sample_says_what_to_change(tiny: Path, tmp_path: Path, monkeypatch, arguments, message) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in fails("sample", arguments[0], tiny, *arguments[1:])


def test_fresh_removes_only_a_checkpoint(tiny: Path, tmp_path: Path) -> None:
    folder = tmp_path / "A.checkpoint"
    folder.mkdir()
    (folder / "diary.txt").write_text("mine")
    (folder / "run.json").write_text("{}")
    message = fails("sample", "A", tiny, "-o", tmp_path / "A.nc", "--fresh", *QUICK)
    assert "holds files that are not a checkpoint's" in message
    assert [f.name for f in folder.iterdir()] == ["diary.txt"]


def test_fresh_does_not_take_a_checkpoint_from_a_running_job(tiny: Path, tmp_path: Path) -> None:
    from zoo.core.inference.checkpoint import Folder

    held = Folder(tmp_path / "A.checkpoint")
    message = fails("sample", "A", tiny, "-o", tmp_path / "A.nc", "--fresh", *QUICK)
    assert "another run is using this checkpoint folder" in message
    assert "--fresh" not in message
    assert held.path.is_dir()
    held.close()


@pytest.mark.slow
def test_compare_samples_what_is_missing_and_writes_table_and_figures(
    sampled: tuple[Path, str], tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    output = run(
        "compare",
        tiny,
        "--models",
        "A,b",
        "--posteriors",
        sampled[0].parent,
        "-o",
        out,
        "--n-draws",
        40,
        *QUICK,
    )
    assert f"model A: posterior of {sampled[0]}" in output
    assert "model B: sampled, wrote" in output
    table = pd.read_csv(out / "comparison.csv", index_col="model")
    assert set(table.index) == {"A", "B"}
    assert table["rank"].tolist() == [0, 1]
    # white noise of 0.1 mmHg was put in: the independent errors of A must win by far
    assert table.index[0] == "A"
    assert table.loc["B", "difference"] > 0
    kinds = ("fit", "trace", "rank", "pair", "pressure", "flow")
    names = {"comparison", "pressure", "flow", "loops", *(f"{kind}-{m}" for kind in kinds for m in "AB")}
    assert {f.stem for f in out.glob("*.png")} == names
    again = run(
        "compare",
        tiny,
        "--models",
        "A,B",
        "--posteriors",
        sampled[0],
        "-o",
        out,
        "--n-draws",
        40,
        "--no-figures",
    )
    assert "model B: posterior of" in again
    assert "sampled" not in again
    # posteriors in the working directory are found by their names, if they belong
    here = tmp_path / "here"
    here.mkdir()
    shutil.copy(sampled[0], here / "A.nc")
    shutil.copy(out / "B.nc", here / "B.nc")
    monkeypatch.chdir(here)
    found = run("compare", tiny.resolve(), "--models", "A,B", "--n-draws", 40, "--no-figures")
    assert "model A: posterior of A.nc" in found
    assert "model B: posterior of B.nc" in found


def test_compare_says_what_to_change(sampled: tuple[Path, str], tiny: Path, tmp_path: Path) -> None:
    path = sampled[0]
    assert "at least two different models" in fails("compare", tiny, "--models", "A")
    assert "at least two different models" in fails("compare", tiny, "--models", "A,A")
    assert "model 'Q': unknown" in fails("compare", tiny, "--models", "A,Q")
    assert "no such file or folder" in fails(
        "compare", tiny, "--posteriors", tmp_path / "no.nc", "-o", tmp_path / "o"
    )
    assert "--n-draws 3" in fails("compare", tiny, "--n-draws", 3)
    changed = fails(
        "compare", tiny, "--posteriors", path, "-o", tmp_path / "p", "--friction", "rest", "--models", "A,B"
    )
    assert "conventions is printed, here it is custom (printed with friction=rest)" in changed
    other = tmp_path / "other"
    study = load_study(tiny)
    series = replace(study.series[0], value=study.series[0].value + 0.5)
    save_study(replace(study, series=(series,)), other)
    assert "checksum of the study is" in fails(
        "compare", other, "--posteriors", path, "-o", tmp_path / "q", "--models", "A,B"
    )
    assert "--fresh: samples every model anew" in fails("compare", tiny, "--posteriors", path, "--fresh")
    file = tmp_path / "file"
    file.write_text("", encoding="utf-8")
    assert f"{file}: is a file where a folder is needed" in fails("compare", tiny, "-o", file)
    # in a folder such a posterior is passed over, which is said; so is a file that is none
    folder = tmp_path / "folder"
    folder.mkdir()
    shutil.copy(path, folder / "A.nc")
    (folder / "B.nc").write_text("no NetCDF", encoding="utf-8")
    said: list[str] = []
    assert find([folder], ["A", "B"], load_study(other), say=said.append) == {}
    assert said[0] == f"passed over: {folder / 'A.nc'}: of model A on other data named tiny; sample again"
    assert said[1].startswith(f"passed over: {folder / 'B.nc'}: ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nature2021"], "nature2021: no such paper; paun2020"),
        (["--models", "A"], "--models A: give at least two different models"),
        (["--synthetic", "--vessels", "1,99", "--study", "demo"], "--vessels 1,99: demo has 21 vessels"),
        (["--synthetic", "--data-sets", "0", "--study", "demo"], "--data-sets 0: give at least 1"),
        (["--points", "5"], "--points 5: is of the synthetic studies; add --synthetic"),
        (["--synthetic", "--points", "5", "--study", "demo"], "--points 5: give at least 1000"),
    ],
)
def test_reproduce_says_what_to_change(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert message in fails("reproduce", *arguments)
