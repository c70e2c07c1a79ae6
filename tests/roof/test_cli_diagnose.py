"""`zoo diagnose`, run as a user runs it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from commands import fails, run, run_json
from pages import read
from withheld import FILES, TAU_S, as_if_sampled, made, screen_of

from zoo import report
from zoo.blood.study import Study, load_study, save_study
from zoo.core.diagnosis import (
    Diagnosis,
    read_diagnosis,
)
from zoo.core.diagnosis.file import NextMeasurement
from zoo.core.outputs import RECORD


@pytest.fixture(scope="module")
def commanded(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder and screen of `zoo diagnose`."""
    out = tmp_path_factory.mktemp("out") / "gap"
    options = ("--effects", "viscoelastic-wall,inflow-shift", "--component-sizes", 0, "--base", "a", "-q")
    words = ["diagnose", folder, *options, "--set", "conventions.friction=current", "-o", out]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["/somewhere/zoo", *map(str, words)])
        return out, run(*words)


def test_diagnose_writes_everything_and_says_what_it_found(commanded: tuple[Path, str]) -> None:
    out, screen = commanded
    assert sorted(p.name for p in out.iterdir()) == sorted([RECORD, *FILES])
    file = read_diagnosis(out)
    assert file.base == "linear-constant"
    assert file.cause == ["viscoelastic-wall"]
    [tau] = file.causes[0].estimates
    assert abs(tau.mean - TAU_S) < 4 * tau.sd
    assert file.verdict in screen
    assert all(line in " ".join(screen.split()) for line in file.lines)
    for words in ("everywhere", "no cause", "before the data"):
        assert words in screen
    assert tau.interval is not None
    size = f"tau {tau.mean:.2g} ({tau.interval[0]:.2g} to {tau.interval[1]:.2g}) s"
    assert size in " ".join(screen.split())
    assert f"{file.gap.removed:.0%}".replace("%", " %") in screen
    assert f"{file.record['solves']} solves" in screen
    assert f"wrote {out}: {', '.join(FILES)}" in screen
    assert "error:" not in screen
    command = read(out / "report.html").all("pre")[0].text
    assert command.startswith("zoo diagnose ")
    assert "--effects viscoelastic-wall,inflow-shift --component-sizes 0 --base a -q" in command
    assert "--set conventions.friction=current -o" in command
    assert "somewhere" not in command


def test_json_is_what_the_file_holds(folder: Path, tmp_path: Path) -> None:
    options = ("--effects", "inflow-shift", "--component-sizes", 0, "--base", "a", "-o", tmp_path / "gap")
    found = run_json("diagnose", folder, *options)
    assert found == json.loads((tmp_path / "gap" / "diagnosis.json").read_text("utf-8"))


def test_samples_that_were_not_measured_are_left_empty(folder: Path, tmp_path: Path) -> None:
    study = shutil.copytree(folder, tmp_path / "gaps")
    rows = (study / "observations.csv").read_text(encoding="utf-8").splitlines()
    for i in range(5, 10):
        rows[i] = rows[i].rpartition(",")[0] + ","
    (study / "observations.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    out = tmp_path / "out"
    options = ("--effects", "viscoelastic-wall", "--component-sizes", 0, "-q")
    run("diagnose", study, *options, "--set", "conventions.friction=current", "-o", out)
    assert read_diagnosis(out).cause == ["viscoelastic-wall"]


def test_another_state_is_fitted_with_what_was_learned(folder: Path, tmp_path: Path) -> None:
    """The wall's viscosity holds at a faster beat; a tree of other vessels is refused."""
    other, out = tmp_path / "faster", tmp_path / "gap"
    save_study(made((1, 0.0, "pressure_mmHg"), period=0.09, more=1.2, seed=4), other)
    options = ("--effects", "viscoelastic-wall,inflow-shift", "--component-sizes", 0, "-q")
    screen = " ".join(run("diagnose", folder, *options, "--state", other, "-o", out).split())
    [state] = read_diagnosis(out).states
    assert state.state == "faster"
    held = {tuple(c.names): c for c in state.carried}
    assert held[("wall",)].holds
    assert held[("wall",)].error.mean < 0.5 * state.baseline.mean
    assert "In faster, refitted: the baseline misses by" in screen
    assert "with what was learned of wall by" in screen
    assert "what holds there: wall" in screen
    page = read(out / "report.html")
    assert "Other states" in page.text
    assert (out / "states.png").stat().st_size > 5000
    error = fails("diagnose", folder, "--state", "demo", "-o", tmp_path / "no", "-q")
    assert "is not the same as in" in error
    assert not (tmp_path / "no").exists()


def test_studies_of_two_beats_have_one_cause_of_one_size(folder: Path, tmp_path: Path) -> None:
    other, out = tmp_path / "faster", tmp_path / "gap"
    save_study(made((1, 0.0, "pressure_mmHg"), period=0.09, more=1.2, seed=4), other)
    options = ("--effects", "viscoelastic-wall,inflow-shift", "--component-sizes", 0, "-q")
    run("diagnose", folder, other, "--share", "psi1,c", *options, "-o", out)
    file, one = read_diagnosis(out), load_study(folder).name
    assert file.cause == ["viscoelastic-wall"]
    estimates = {cause.name: cause.estimates for cause in file.causes}
    [tau] = estimates["viscoelastic-wall"]
    assert abs(tau.mean - TAU_S) < 4 * tau.sd
    named = set(file.base_parameters["base"])
    assert {"psi1", "c", f"f3[{one}]", "f3[faster]", f"psi2[{one}]", "psi2[faster]"} == named
    assert file.gap.held_out == "5 blocks of each beat in turn"
    assert file.gap.held_out_after < 0.5 * file.gap.held_out_before
    assert "faster/" in read(out / "report.html").text
    for words, told in (
        ((folder, "--share", "c"), "--share c: is of several studies; give two or more"),
        ((folder, other, "--state", other), "is another state of one study; give one STUDY"),
        ((folder, folder), f"studies: {one} is there twice; give it once, or another name"),
        ((folder, other, "--share", "psi"), "--share psi: experiment soft: unknown; did you mean 'psi2'?"),
        ((folder, other, "--base", "F", "--share", "chi"), "its prior depends on m_chi: share that too"),
    ):
        assert told in fails("diagnose", *words, *options, "-o", tmp_path / "no"), words


def test_the_screen_tells_of_the_next_measurement_and_posteriors(three: Diagnosis) -> None:
    measure = NextMeasurement(
        vessel=5,
        position=0.5,
        quantity="flow_ml_s",
        text="flow midway in vessel 5",
        separates=("taper", "minor-losses"),
        expected_log_odds=2.5,
    )
    file = as_if_sampled(three).with_file(next_measurement=measure).file
    screen = screen_of(file)
    assert "What would decide: flow midway in vessel 5, which tells taper from minor-losses" in screen
    assert "(expected odds up to 12 to 1)" in " ".join(screen.split())
    lines = [line.split() for line in screen.splitlines()]
    assert ["nothing", "yes", "-100.0", "±", "0.1", "-95.0"] in lines
    assert ["viscoelastic-wall", "no", "60.0", "±", "0.1", "65.0"] in lines
    assert "sampled posteriors" not in screen_of(three.file)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--base", "linear-constnt"), "baseline 'linear-constnt': unknown; did you mean 'linear-constant'?"),
        (("--base", "G", "--effects", "local-stiffness"), "cannot be added to linear-vessels, only to"),
        (("--effects", "taper,viscoelastic-wal"), "did you mean 'viscoelastic-wall'?"),
        (("--effects", " , "), "--effects: no names"),
        (("--base", "H", "--effects", "tangent-wall"), "cannot be added to tangent-constant, only to linear"),
        (("--cores", 0), "--cores 0: give at least 1"),
        (("--seed", -1), "--seed -1: give at least 0"),
        (("--set", "conventions=printd"), "did you mean 'printed'?"),
        (("-o", "nowhere/gap"), "does not exist; create it"),
        (("-o", "file"), "--output file: is there, and not as zoo wrote it"),
    ],
)
def test_diagnose_says_what_to_change_before_it_works(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[object, ...], message: str
) -> None:
    def worked(*_: object, **__: object) -> None:
        raise AssertionError("it worked")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("zoo.blood.study_diagnosis.diagnose", worked)
    Path("file").write_text("")
    assert message in fails("diagnose", folder, *options, "-q")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_study_without_observations_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    save_study(made(), "bare")
    assert "add observations.csv" in fails("diagnose", "bare", "-q")
    assert [p.name for p in tmp_path.iterdir()] == ["bare"]
    assert "did you mean 'demo'?" in fails("diagnose", "demmo", "-q")


def test_what_is_refused_inside_the_diagnosis_leaves_no_folder(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "nosuch: unknown; use one of f3" in fails("diagnose", folder, "--fix", "nosuch=1.0", "-q")
    assert not list(tmp_path.iterdir())


def test_options_reach_the_diagnosis(
    one: Diagnosis, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, object] = {}

    def caught(study: Study, base: str, **settings: object) -> Diagnosis:
        given.update(settings, study=study, base=base)
        return one

    def sampled(self: Diagnosis, **settings: object) -> Diagnosis:
        given.update(posteriors=True, folder=settings["folder"])
        return self

    monkeypatch.setattr("zoo.blood.study_diagnosis.diagnose", caught)
    monkeypatch.setattr(Diagnosis, "with_posteriors", sampled)
    written: list[bool] = []
    monkeypatch.setattr(report, "write_diagnosis", lambda *_, **__: written.append("folder" in given) or [])
    out = tmp_path / "gap"
    run("diagnose", folder, "-o", out, "--posteriors", "-q")
    assert written == [False, True]  # before the posteriors, which take longer, and with them
    assert (given["base"], given["posteriors"], given["effects"]) == ("linear-constant", True, None)
    assert (given["component_sizes"], given["cores"], given["seed"]) == (1.0, 2, 1)
    assert given["conventions"] is None
    first = Path(str(given["folder"]))
    assert first.is_dir()
    assert first.parent == out / "posteriors"
    given |= {"posteriors": False, "folder": None}
    options = ("--base", "I", "--set", "conventions.wall_factor=2", "--effects", "taper", "--seed", 5, "-q")
    run("diagnose", folder, "-o", out, "--fresh", *options)
    assert (given["base"], given["posteriors"], given["effects"]) == ("tangent-radius", False, ["taper"])
    assert given["folder"] is None
    conventions = given["conventions"]
    assert conventions is not None
    assert conventions.wall_factor == 2  # type: ignore[attr-defined]
    run("diagnose", folder, "-o", out, "--seed", 2, "--posteriors", "-q", "--fresh")
    assert Path(str(given["folder"])) != first


@pytest.mark.slow
def test_demo_by_its_name(tmp_path: Path) -> None:
    options = ("--effects", "sensor-offset", "--component-sizes", 0, "-q")
    screen = run("diagnose", "demo", *options, "-o", tmp_path / "gap")
    assert read_diagnosis(tmp_path / "gap").study_checksum == load_study("demo").checksum
    assert "wrote" in screen
