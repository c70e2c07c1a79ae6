"""`zoo sample` and `zoo compare`, on a tree of three vessels."""

from __future__ import annotations

import contextlib
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from commands import TRUE, fails, run, run_json

from zoo.blood.blood_flow import BloodFlow
from zoo.blood.study import load_study, save_study
from zoo.cli.command import UsageError
from zoo.cli.sample import _keeps_what_is_there
from zoo.core.arviz_lines import of_draws
from zoo.core.diagnosis import solve_store
from zoo.core.inference.record import RunRecord
from zoo.core.posterior.files import find
from zoo.core.posterior.storage import load
from zoo.report.gates import read_comparison

QUICK = ("--draws", 60, "--tune", 150, "--chains", 2, "--cores", 1, "--seed", 3)


@pytest.fixture(scope="module")
def sampled(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    path = tmp_path_factory.mktemp("posteriors") / "A.nc"
    return path, run("sample", "a", tiny, "-o", path, "--thin", 2, *QUICK)


def test_sample_writes_the_posterior_and_a_verdict(sampled: tuple[Path, str], tiny: Path) -> None:
    path, output = sampled
    idata = load(path)
    assert dict(idata.posterior.sizes)["draw"] == 60
    assert set(idata.posterior.data_vars) == {"f3", "psi1", "psi2", "c", "noise_pressure_mmHg"}
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
    psi2 = idata.posterior.psi2.to_numpy()
    assert abs(psi2.mean() - TRUE["psi2"]) < 4 * psi2.std()


def test_the_summary_for_machines_is_that_of_the_screen(sampled: tuple[Path, str], tiny: Path) -> None:
    path, output = sampled
    found = run_json("sample", "a", tiny, "-o", path, "--thin", 2, *QUICK)
    draws = load(path).posterior
    assert [row["parameter"] for row in found["parameters"]] == list(draws.data_vars)
    for row in found["parameters"]:
        assert row["median"] == pytest.approx(float(np.median(draws[row["parameter"]])))
        assert row["unit"] == draws[row["parameter"]].attrs["units"]
    assert found["converged"] is False
    assert found["verdict"] in output
    assert (found["model"], found["study"], found["chains"], found["seed"]) == ("A", "tiny", 2, 3)


def test_several_studies_are_subjects_of_one_posterior(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("rest", "exercise"):
        shutil.copytree(tiny, name)
    prior = "--prior", "f3=log_uniform(2e4,4e5)"
    words = "sample", "A", "rest", "exercise", "--share", "f3", "--population", "c", *prior
    output = run(*words, *QUICK)
    assert "model A of 2 subjects" in output
    idata = load(Path("A-rest-exercise.nc"))
    posterior = idata["posterior"]
    assert posterior["f3"].dims == ("chain", "draw")
    for name in ("psi1", "psi2", "c", "noise_pressure_mmHg"):
        assert posterior[name].dims == ("chain", "draw", "subject")
    assert posterior["subject"].values.tolist() == ["rest", "exercise"]
    assert posterior["f3"].attrs["units"] == "g cm-1 s-2"
    record = RunRecord.of(idata)
    assert (record.model, record.study) == ("A of 2 subjects", "rest, exercise")
    again = run(*words, *QUICK)
    assert "resumed (sitting 2)" in again
    np.testing.assert_array_equal(load(Path("A-rest-exercise.nc"))["posterior"]["f3"], posterior["f3"])
    wrong = "sample", "A", "rest", "exercise", "-o", "new.nc", "--share", "f4"
    assert "--share f4: subject rest: " in fails(*wrong, *QUICK)
    assert "--share f3: is of several studies" in fails("sample", "A", "rest", "--share", "f3", *QUICK)
    assert "STUDY rest: is given twice" in fails("sample", "A", "rest", "rest", *QUICK)


def test_sample_goes_on_from_its_checkpoint(sampled: tuple[Path, str], tiny: Path) -> None:
    path, _ = sampled
    assert path.with_suffix(".checkpoint").is_dir()
    refused = fails("sample", "a", tiny, "-o", path, "--thin", 3, *QUICK)
    assert "is of another run: --thin was 2, here it is 3; add --fresh to replace it" in refused
    few = "sample", "a", tiny, "-o", path, "--thin", 2, *QUICK[2:], "--draws", 10
    assert "holds 60 draws of each chain, which this run would replace by others; add --fresh" in fails(*few)
    path.rename(path.with_suffix(".kept"))
    refused = fails("sample", "a", tiny, "-o", path, "--thin", 3, *QUICK)
    path.with_suffix(".kept").rename(path)
    assert "thin is 2 there and 3 here" in refused
    assert "--fresh removes it" in refused
    more = path.with_name("A.nc")
    there = load(path)
    before, sittings = there.posterior.c.to_numpy(), RunRecord.of(there).sittings
    output = run("sample", "a", tiny, "-o", more, "--thin", 2, *QUICK[2:], "--draws", 80, "-q")
    after = load(more)
    assert after.posterior.sizes["draw"] == 80
    np.testing.assert_array_equal(after.posterior.c[:, :60], before)
    assert RunRecord.of(after).sittings == sittings + 1
    assert "model A on tiny" not in output  # -q


@pytest.mark.parametrize(
    ("before", "goal", "there", "refused"),
    [
        (None, None, "nothing", False),
        (5000.0, None, "run.json", True),
        (400.0, 400.0, "nothing", False),
        (400.0, 300.0, "nothing", True),
        (400.0, 300.0, "an empty folder", True),
        (400.0, 300.0, "run.json", True),
        (400.0, 500.0, "an empty folder", True),
        (400.0, 500.0, "run.json", False),
        (None, 300.0, "run.json", True),
    ],
)
def test_draws_are_replaced_by_the_same_and_more_alone(
    before: float | None, goal: float | None, there: str, refused: bool, tmp_path: Path, monkeypatch
) -> None:
    held = of_draws({"posterior": {"a": np.zeros((2, 40))}})
    record = SimpleNamespace(settings={"first check": 10, "until_ess": before})
    monkeypatch.setattr("zoo.core.posterior.storage.load", lambda path: held)
    monkeypatch.setattr(RunRecord, "of", lambda idata: record)
    if there != "nothing":
        (tmp_path / "A.checkpoint").mkdir()
    if there == "run.json":
        (tmp_path / "A.checkpoint" / "run.json").write_text("{}")
    wanted = {"draws": 10, "until_ess": goal}
    with pytest.raises(UsageError, match="holds 40 draws") if refused else contextlib.nullcontext():
        _keeps_what_is_there(tmp_path / "A.nc", wanted)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("Z",), "model 'Z': unknown; use one of A, B"),
        (("A", "--until", "400"), "--until 400: write --until ess=400"),
        (("A", "--until", "ess=-1"), "write --until ess=400"),
        (("A", "--chains", "0"), "--chains 0: must be a whole number of at least 1"),
        (("A", "-o", "nowhere/A.nc"), "folder nowhere does not exist"),
        (("A", "-o", "A.checkpoint"), "is the place of its own checkpoint; give a file such as A.other.nc"),
    ],
)
def test_sample_says_what_to_change(tiny: Path, tmp_path: Path, monkeypatch, arguments, message) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in fails("sample", arguments[0], tiny, *arguments[1:])


def test_fresh_removes_only_a_checkpoint(tiny: Path, tmp_path: Path) -> None:
    """One file of another kind, and nothing is removed; a link is not followed, with or without --fresh."""
    folder = tmp_path / "A.checkpoint"
    words = "sample", "A", tiny, "-o", tmp_path / "A.nc", *QUICK
    folder.mkdir()
    (folder / "chain-0.memo").write_text("mine")
    for name in ("chain-0.memo", "run.json", "diary.txt"):
        (folder / name).write_text("mine")
        if name != "run.json":
            assert "holds files that are not a checkpoint's" in fails(*words, "--fresh")
    assert {file.name for file in folder.iterdir()} - {"lock"} == {"chain-0.memo", "diary.txt", "run.json"}
    (folder / "diary.txt").unlink()
    for content in ("mine", "{}", '{"identity": {"format": 4}}'):  # of another program
        (folder / "run.json").write_text(content)
        assert "holds files that are not a checkpoint's; move chain-0.memo away" in fails(*words, "--fresh")
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    for fresh in ([], ["--fresh"]):
        assert f"{folder} is a link" in fails(*words, *fresh)
    assert {file.name for file in folder.iterdir()} - {"lock"} == {"chain-0.memo", "run.json"}


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (("--method", "guess"), "--method guess: must be one of"),
        (("--method", "surrogate", "--thin", 2), "--thin 2: method surrogate has no use for it"),
        (("--max-draws", 3), "--max-draws 3: must be a whole number of at least 60"),
    ],
)
def test_fresh_removes_nothing_where_another_option_is_wrong(
    sampled: tuple[Path, str], tiny: Path, tmp_path: Path, wrong: tuple[object, ...], said: str
) -> None:
    folder = Path(shutil.copytree(sampled[0].with_suffix(".checkpoint"), tmp_path / "A.checkpoint"))
    before = sorted(folder.iterdir())
    assert said in fails("sample", "A", tiny, "-o", tmp_path / "A.nc", "--fresh", *QUICK, *wrong)
    assert sorted(folder.iterdir()) == before
    for name in ("chain-theirs.memo", ".zoo-notes.part"):
        (folder / name).write_text("mine")
        refused = fails("sample", "A", tiny, "-o", tmp_path / "A.nc", "--fresh", *QUICK)
        assert f"holds files that are not a checkpoint's; move {name} away" in refused
        (folder / name).unlink()
    assert sorted(folder.iterdir()) == before


def test_fresh_does_not_take_a_checkpoint_from_a_running_job(tiny: Path, tmp_path: Path) -> None:
    from zoo.core.inference.checkpoint import Folder

    held = Folder(tmp_path / "A.checkpoint")
    (held.path / "run.json").write_text("{}")
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
    compare = ("compare", tiny.resolve(), "--n-draws", 40)
    into = ("--posteriors", sampled[0].parent, "-o", out)
    output = run(*compare, "--models", "A,b", *into, *QUICK)
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
    again = run(*compare, "--models", "A,B", "--posteriors", sampled[0], "-o", out, "--no-figures")
    assert "model B: posterior of" in again
    assert "sampled" not in again
    # posteriors in the working directory are found by their names, if they belong
    here = tmp_path / "here"
    here.mkdir()
    shutil.copy(sampled[0], here / "A.nc")
    shutil.copy(out / "B.nc", here / "B.nc")
    monkeypatch.chdir(here)
    found = run(*compare, "--models", "A,B", "--no-figures")
    assert "model A: posterior of A.nc" in found
    assert "model B: posterior of B.nc" in found


def test_compare_finds_what_sample_wrote_under_its_own_name(
    sampled: tuple[Path, str], tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(sampled[0], tmp_path / "A-tiny.nc")
    (tmp_path / "A.nc").write_bytes(b"of something else")
    monkeypatch.chdir(tmp_path)
    found = run("compare", tiny.resolve(), "--models", "A", "--no-figures", "--n-draws", 40)
    assert "passed over: A.nc: " in found
    assert "model A: posterior of A-tiny.nc" in found
    assert "sampled" not in found


def test_compare_is_red_on_a_model_made_worse_and_green_again(
    sampled: tuple[Path, str], tiny: Path, tmp_path: Path
) -> None:
    """As .github/workflows/model-comparison.yml does it, with a prior that is changed and changed back."""
    base = tmp_path / "base.json"
    words = ("compare", tiny, "--models", "A", "--no-figures", *QUICK, "--posteriors", sampled[0].parent)
    assert f"wrote {base}" in run(*words, "-o", tmp_path / "first", "--json", base)

    def gated(name: str, *more: object, code: int = 0) -> str:
        out = [tmp_path / f"{name}.{end}" for end in ("", "json", "md", "xml")]
        files = zip(("-o", "--json", "--markdown", "--junit"), out, strict=True)
        gates = ("--baseline", base, "--fail-if", "waic > baseline + 2 se")
        told = run(*words, *(x for pair in files for x in pair), *gates, *more, code=code)
        return told + out[2].read_text(encoding="utf-8") + out[3].read_text(encoding="utf-8")

    red = gated("red", "--prior", "c=uniform(3, 4)", code=3)
    assert "error: tiny, model A: waic > baseline + 2 se (waic is" in red
    assert "gates that failed: 1 of 1" in red
    green = gated("green")
    assert "error:" not in green
    assert "sampled" not in green
    assert "gates that failed: 0 of 1" in green
    assert 'failures="0"' in green
    strict = run(*words, "-o", tmp_path / "strict", "--strict", code=3)
    assert "converged=no (converged is no)" in strict
    assert "no.json: cannot be read" in fails(*words, "--baseline", tmp_path / "no.json")
    then = read_comparison(base)
    elsewhere = then.model_copy(update={"studies": {"elsewhere": then.studies["tiny"]}})
    (tmp_path / "else.json").write_text(elsewhere.to_text(), encoding="utf-8")
    assert "is of elsewhere, not of" in fails(*words, "--baseline", tmp_path / "else.json")
    assert "gate 'waic': is none" in fails(*words, "--fail-if", "waic")
    assert "unknown; did you mean 'waic'" in fails(*words, "--fail-if", "wiac > 3")
    assert "there is no baseline; give --baseline" in fails(*words, "--fail-if", "waic > baseline")


def test_an_unchanged_model_is_compared_and_reported_again_without_a_solve(
    sampled: tuple[Path, str], tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    solves = []
    solve = BloodFlow.solve
    monkeypatch.setattr(BloodFlow, "solve", lambda *given: solves.append(given) or solve(*given))
    words = "compare", tiny, "--models", "A", "--no-figures", "--n-draws", 40, "-o", tmp_path / "out"

    def compared(posterior: Path, n: int) -> str:
        before = len(solves)
        run(*words, "--posteriors", posterior)
        assert (len(solves) > before) is (n > 0)
        assert len(solves) - before <= n
        return (tmp_path / "out" / "comparison.csv").read_text(encoding="utf-8")

    first = compared(sampled[0], 40 + 3)  # the draws, and the medians of all chains and of each
    assert compared(sampled[0], 0) == first
    report = "report", tiny, "--models", "A", "--posteriors", sampled[0], "--n-draws", 40
    kept = "--solves", tmp_path / "out" / "solves", "-o", tmp_path / "r.html"
    before = len(solves)
    run(*report, *kept)
    assert len(solves) > before  # what compare drew no figures of
    before = len(solves)
    run(*report, *kept, "--title", "Again", "--fresh")
    assert len(solves) == before
    run("sample", "a", tiny, "-o", tmp_path / "A.nc", *QUICK[:-1], 4)
    assert compared(tmp_path / "A.nc", 40 + 3) != first
    assert compared(sampled[0], 0) == first
    monkeypatch.setattr(solve_store, "_program", lambda: "another version")
    assert compared(sampled[0], 40 + 3) == first


def test_compare_says_what_to_change(sampled: tuple[Path, str], tiny: Path, tmp_path: Path) -> None:
    path = sampled[0]
    assert "give each model once" in fails("compare", tiny, "--models", "A,A")
    assert "model 'Q': unknown" in fails("compare", tiny, "--models", "A,Q")
    assert "no such file or folder" in fails(
        "compare", tiny, "--posteriors", tmp_path / "no.nc", "-o", tmp_path / "o"
    )
    (tmp_path / "none.nc").write_text("no posterior")
    fails("compare", tiny, "--posteriors", tmp_path / "none.nc", "-o", tmp_path / "o")
    assert not (tmp_path / "o").exists()
    assert "--n-draws 3" in fails("compare", tiny, "--n-draws", 3)
    both = ("--models", "A,B", "--posteriors", path, "-o", tmp_path / "p")
    changed = fails("compare", tiny, *both, "--set", "conventions.friction=rest")
    assert "conventions is printed, here it is custom (printed with friction=rest)" in changed
    assert not (tmp_path / "p").exists()
    other = tmp_path / "other"
    study = load_study(tiny)
    series = replace(study.series[0], value=study.series[0].value + 0.5)
    save_study(replace(study, series=(series,)), other)
    assert "A.nc: is of model A on other data named tiny; sample again" in fails("compare", other, *both)
    assert "--fresh: samples every model anew" in fails("compare", tiny, "--posteriors", path, "--fresh")
    file = tmp_path / "file"
    file.write_text("", encoding="utf-8")
    assert f"--output {file}: is there, and not as zoo wrote it" in fails("compare", tiny, "-o", file)
    # in a folder such a posterior is passed over, which is said; so is a file that is none
    folder = tmp_path / "folder"
    folder.mkdir()
    shutil.copy(path, folder / "A.nc")
    (folder / "B.nc").write_text("no NetCDF", encoding="utf-8")
    said: list[str] = []
    assert find([folder], ["A", "B"], load_study(other), say=said.append) == {}
    assert said[0] == f"passed over: {folder / 'A.nc'}: is of model A on other data named tiny; sample again"
    assert said[1].startswith(f"passed over: {folder / 'B.nc'}: is no posterior: ")
    # so are those of another study and of models that are not asked for
    said.clear()
    assert find([folder], ["A", "B"], load_study("demo"), say=said.append) == {}
    assert said[0] == f"passed over: {folder / 'A.nc'}: is of model A on tiny, not on demo"
    said.clear()
    assert find([folder], ["B", "C"], study, say=said.append) == {}
    assert said[0] == f"passed over: {folder / 'A.nc'}: is of model A, not of B, C"
