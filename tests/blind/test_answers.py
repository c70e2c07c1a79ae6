"""Diagnosing blind cases without their key, and scoring the answers against it."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import zoo.blood.blind.run as running
from zoo.blood.blind import BlindError, diagnose_cases, score_cases
from zoo.blood.blind.keys import read_key
from zoo.blood.blind.run import read_case_facts, read_fitted
from zoo.blood.diagnosis import diagnose
from zoo.blood.study import load_study
from zoo.cli import app
from zoo.core import digests
from zoo.core.blindcheck.sealing import KEY_DIGEST
from zoo.core.effects import Location

# loads and stiffness of a case are drawn, some of them beyond what is usual
pytestmark = pytest.mark.filterwarnings("ignore::zoo.blood.study.UnitWarning")


def test_run_answers_and_goes_on(
    made: tuple[Path, Path],
    answered: Path,
    tiny: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    answers = tmp_path / "answers"
    shutil.copytree(answered, answers)
    (answers / "case-002" / "diagnosis.json").write_text("{")  # as a kill leaves it
    asked: list[str] = []

    def refuse(study: Any, *arguments: Any, **settings: Any) -> Any:
        asked.append(study.name)
        raise RuntimeError("no more")

    monkeypatch.setattr(running, "diagnose", refuse)
    found = diagnose_cases(made[0], answers, effects=tiny["effects"], max_effects=1, cores=1)
    assert asked == ["case-002"]
    assert found.kept == ("case-001", "case-003")
    assert found.failed == {"case-002": "no more"}
    assert (answers / "case-002" / "failed.txt").read_text().startswith("no more\n")
    monkeypatch.setattr(running, "diagnose", diagnose)
    found = diagnose_cases(made[0], answers, effects=tiny["effects"], max_effects=1, cores=1)
    assert found.failed == {}
    assert not (answers / "case-002" / "failed.txt").exists()
    assert (
        diagnose_cases(made[0], answers, effects=tiny["effects"], seed=2, max_effects=1, cores=1).kept == ()
    )


@pytest.mark.parametrize("where", ["key.json", "my-Key-7.json", "case-001/key.json"])
def test_run_refuses_a_folder_with_a_key(where: str, made: tuple[Path, Path], tmp_path: Path) -> None:
    cases = tmp_path / "cases"
    shutil.copytree(made[0], cases)
    shutil.copy(made[1], cases / where)
    with pytest.raises(BlindError, match="a key lies with the cases"):
        diagnose_cases(cases, tmp_path / "answers")
    assert not (tmp_path / "answers").exists()


def test_run_opens_nothing_outside_the_cases(
    made: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []
    original = Path.read_text

    def spy(self: Path, *arguments: Any, **settings: Any) -> str:
        opened.append(self)
        return original(self, *arguments, **settings)

    monkeypatch.setattr(Path, "read_text", spy)

    def fail(*arguments: Any, **settings: Any) -> Any:
        raise RuntimeError

    monkeypatch.setattr(running, "diagnose", fail)
    answers = tmp_path / "answers"
    diagnose_cases(made[0], answers, cores=1)
    opened = [p for p in opened if p.parent.suffix != ".dist-info"]  # versions of packages
    assert opened
    assert all({made[0], answers} & set(path.parents) for path in opened)


def test_run_refuses_what_is_no_folder_of_cases(made: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(BlindError, match="no such folder"):
        diagnose_cases(tmp_path / "nothing", tmp_path / "answers")
    with pytest.raises(BlindError, match=r"no folder with a study\.toml"):
        diagnose_cases(tmp_path, tmp_path.parent / "answers")
    with pytest.raises(BlindError, match="lies inside"):
        diagnose_cases(made[0], made[0] / "answers")


def test_fitted_series_are_read_back_or_refused(
    made: tuple[Path, Path], answered: Path, tmp_path: Path
) -> None:
    """Against the data they leave the residuals that diagnosis.json states; damaged they are refused."""
    answers = tmp_path / "answers"
    shutil.copytree(answered, answers)
    for folder in sorted(answers.glob("case-*")):
        told = json.loads((folder / "diagnosis.json").read_text())["gap"]
        study = load_study(made[0] / folder.name)
        fitted = read_fitted(folder, study.checksum)
        assert fitted is not None
        with pytest.raises(BlindError, match=r"fitted\.json: is of another case"):
            read_fitted(folder, "another")
        base, leader = fitted.left(study.values)
        assert base == pytest.approx(told["residual_rms_before_mmHg"], rel=1e-3)
        assert leader == pytest.approx(told["residual_rms_after_mmHg"], rel=1e-3)
    path = answers / "case-001" / "fitted.json"
    text = path.read_text()
    digit = next(i for i, c in enumerate(text) if c == "." and text[i + 1] in "12345678") + 1
    for wrong in (text[:-30], text[:digit] + "9" + text[digit + 1 :], "[]", "{}"):
        path.write_text(wrong)
        with pytest.raises(BlindError, match=r"fitted\.json: is broken"):
            read_fitted(answers / "case-001", "any")
    path.unlink()
    assert read_fitted(answers / "case-001", "any") is None


def test_what_scoring_refuses_is_made_again(made: tuple[Path, Path], answered: Path, tmp_path: Path) -> None:
    """A broken fitted.json says that `zoo blind run` makes it again: it is no answer there."""
    answer, case = tmp_path / "case-001", made[0] / "case-001"
    shutil.copytree(answered / "case-001", answer)
    seed = json.loads((answer / "diagnosis.json").read_text())["record"]["seed"]
    asked = read_case_facts(answer)["effects"]
    diagnosis = running.CaseDiagnosis(running.BASELINE, False, 1, seed, tuple(asked))
    assert diagnosis.answered(case, answer)
    assert not replace(diagnosis, max_effects=2).answered(case, answer)
    assert not replace(diagnosis, effects=None).answered(case, answer)
    whole = (answer / "fitted.json").read_text()
    (answer / "fitted.json").write_text(whole[:-30])
    assert not diagnosis.answered(case, answer)
    (answer / "fitted.json").write_text(whole)
    shutil.copy(answered / "case-002" / "case.json", answer)
    assert not diagnosis.answered(case, answer)


def test_score_writes_and_checks_the_key(made: tuple[Path, Path], answered: Path, tmp_path: Path) -> None:
    found = score_cases(answered, made[1], tmp_path / "score")
    assert found.key_checked
    assert found.summary["n"] == 3
    record = json.loads((tmp_path / "score" / "score.json").read_text())
    assert [c["case"] for c in record["cases"]] == ["case-001", "case-002", "case-003"]
    assert (tmp_path / "score" / "cases.csv").read_text().count("\n") == 4
    tampered = tmp_path / "key.json"
    tampered.write_text(made[1].read_text().replace('"kind": "listed"', '"kind": "none"', 1))
    with pytest.raises(BlindError, match="not the key of these cases"):
        score_cases(answered, tampered, tmp_path / "score")
    copy = tmp_path / "answers"
    shutil.copytree(answered, copy)
    (copy / KEY_DIGEST).unlink()
    with pytest.raises(BlindError, match="cannot be checked"):
        score_cases(copy, made[1], tmp_path / "score")


def test_answers_about_other_data_or_unfinished_are_refused(
    made: tuple[Path, Path], answered: Path, tmp_path: Path
) -> None:
    shutil.copytree(answered, tmp_path / "answers")
    one, two = (tmp_path / "answers" / f"case-00{i}" for i in (1, 2))
    shutil.copy(two / "diagnosis.json", one / "diagnosis.json")
    with pytest.raises(BlindError, match=r"case\.json: is of another case"):
        score_cases(tmp_path / "answers", made[1], tmp_path / "score")
    shutil.copytree(two, one, dirs_exist_ok=True)
    with pytest.raises(BlindError, match="other data"):
        score_cases(tmp_path / "answers", made[1], tmp_path / "score")
    (one / "diagnosis.json").unlink()
    with pytest.raises(BlindError, match="finish"):
        score_cases(tmp_path / "answers", made[1], tmp_path / "score")
    assert not (tmp_path / "score").exists()


def other_key(**changes: Any) -> dict[str, Any]:
    return {
        "case": "case-101", "effect": "junction_loss", "in_library": True, "amplitude": 3.0, "extra": {},
        "layout": "MPA", "noise": {"white_sd_mmHg": 0.03, "ar1_sd_mmHg": 0.04},
        "base_fit": {"rms_noisefree_mmHg": [0.2, 0.4]},
        "refit_with_true_effect": {"rms_noisy_mmHg": [0.08, 0.06]},
    } | changes  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "kind", "label", "amplitude"),
    [
        ({}, "listed", "minor-losses", 3.0),
        ({"effect": None, "amplitude": 0.0}, "none", "no-gap", None),
        ({"effect": "active_tone", "in_library": False, "amplitude": 0.2}, "outside", "active-tone", 0.2),
        ({"effect": "distributed_outflow", "amplitude": 4}, "listed", "distributed-outflow", 3.0),
        ({"effect": "velocity_profile", "amplitude": 2.0}, "listed", "velocity-profile", 1.0),
        ({"effect": "nonlinear_wall", "amplitude": 0.3}, "listed", "tangent-wall", 0.3),
        ({"effect": "catheter_gain", "amplitude": 0.2}, "listed", "sensor-gain", 0.2),
    ],
)
def test_keys_made_elsewhere(
    changes: dict[str, Any], kind: str, label: str, amplitude: float | None, tmp_path: Path
) -> None:
    (tmp_path / "key").mkdir()
    (tmp_path / "key" / "case-101.json").write_text(json.dumps(other_key(**changes)))
    [found], checked = read_key(tmp_path / "key", tmp_path)
    assert not checked
    assert (found.kind, found.label) == (kind, label)
    assert [e.amplitude for e in found.effects] == ([] if amplitude is None else [amplitude])
    assert found.noise == pytest.approx(0.05)
    assert found.before == pytest.approx(math.sqrt((0.04 + 0.16) / 2))
    assert found.truth is None  # such keys do not have it


def test_keys_made_elsewhere_with_places_and_unknown_names(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.mkdir()
    place = other_key(effect="stenosis", extra={"vessel": 3})
    (key / "case-101.json").write_text(json.dumps(place))
    [found], _ = read_key(key, tmp_path)
    assert found.effects[0].location == Location(3)
    (key / "case-101.json").write_text(json.dumps(other_key(effect="warp_drive")))
    with pytest.raises(BlindError, match="not in the catalogue"):
        read_key(key, tmp_path)


@pytest.mark.parametrize("name", ["correlated_noise", "coarse_grid"])
def test_sizes_that_depend_on_more_than_the_effect_are_not_scored(name: str, tmp_path: Path) -> None:
    (tmp_path / "key").mkdir()
    (tmp_path / "key" / "case-101.json").write_text(json.dumps(other_key(effect=name)))
    [found], _ = read_key(tmp_path / "key", tmp_path)
    assert found.effects[0].amplitude is None


@pytest.mark.needs_data
def test_stored_answers_score_as_stored(tmp_path: Path, blind_key: Path) -> None:
    """The benchmark's answers to another simulator's cases, scored now, give the benchmark's score."""
    folder = Path(__file__).parents[2] / "benchmarks" / "blind" / "independent"
    found = score_cases(folder / "answers", blind_key, tmp_path / "score").record()
    stored = json.loads((folder / "score.json").read_text())
    assert found["confusion"] == stored["confusion"]
    for own, wanted in zip(found["cases"], stored["cases"], strict=True):
        assert own == wanted
    for title, value in stored["summary"].items():
        if isinstance(value, dict):  # limits of a rate: stored with z = 1.96
            assert found["summary"][title] == pytest.approx(value, abs=2e-5)
        else:
            assert found["summary"][title] == value


def test_commands_end_to_end(made: tuple[Path, Path], answered: Path, tmp_path: Path) -> None:
    runner = CliRunner()
    out = tmp_path / "score"
    result = runner.invoke(app, ["blind", "score", str(answered), "--key", str(made[1]), "-o", str(out)])
    assert result.exit_code == 0, result.output
    assert {p.name for p in out.iterdir()} == {
        "score.json", "score.md", "cases.csv", "reliability.png", "accuracy.png", "confusion.png", "sizes.png"
    }  # fmt: skip
    shown = " ".join(result.output.split())
    assert "best constant answer" in shown
    assert "100 % (always" in shown  # of two listed cases and one outside, which is always unlisted


def test_commands_complain_in_one_line(made: tuple[Path, Path], tmp_path: Path) -> None:
    runner = CliRunner()
    for words in (
        ["make", str(tmp_path / "c"), "--effects", "warp", "--key", str(tmp_path / "k.json")],
        ["make", str(tmp_path / "c"), "--key", str(tmp_path / "no" / "k.json")],
        ["run", str(tmp_path / "nothing")],
        ["run", str(made[0]), "-o", str(tmp_path / "a"), "--base", "spiral"],
        ["score", str(tmp_path / "nothing"), "--key", str(made[1]), "-o", str(tmp_path / "s")],
    ):
        result = runner.invoke(app, ["blind", *words])
        assert result.exit_code == 2, words
        errors = [line for line in result.stderr.splitlines() if line.startswith("error:")]
        assert len(errors) == 1, result.output


def test_facts_without_their_digest_or_with_a_name_twice_are_refused(tmp_path: Path) -> None:
    facts = {"checksum": "ab12", "parents": {"1": None}, "series": []}
    path, whole = tmp_path / "case.json", digests.to_text(facts)
    path.write_text(whole)
    assert read_case_facts(tmp_path)["parents"] == {1: None}
    twice = '{"checksum": "cd34", ' + whole[1:]  # the digest is that of the last value
    for wrong in (
        json.dumps(facts),
        whole.replace("sha256", "sha257"),
        whole.replace("sha256", "series"),
        twice,
    ):
        path.write_text(wrong)
        with pytest.raises(BlindError, match=r"case\.json: is missing or broken"):
            read_case_facts(tmp_path)
