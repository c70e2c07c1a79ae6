"""The blind check of any simulator: scores by hand, sealed folders with resume, from draw to table."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import zoo.core.blindcheck.folders as folders
from zoo.core.blindcheck import (
    Answer,
    BlindError,
    CaseKey,
    DrawnCase,
    Explanation,
    Fitted,
    LinearBaseline,
    ModelDraw,
    Size,
    as_answer,
    blind_check,
    draw_cases,
    score_answers,
    score_table,
    write_score,
)
from zoo.core.blindcheck.folders import MadeCase, read_answers, read_key, read_sealed, run_cases, write_cases
from zoo.core.blindcheck.scoring import Rate, assemble, constant_shares, reliability, score_case
from zoo.core.data import Data
from zoo.core.diagnosis import diagnose
from zoo.core.effects import EffectParameter, effect
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.outputs import OutputFileError, Run
from zoo.core.parameters import Normal, Parameter


def size(mean: float, sd: float) -> Size:
    return Size(mean=mean, low=mean - 1.96 * sd, high=mean + 1.96 * sd)


def says(name: str, p: float, group: Any = None, **fields: Any) -> Explanation:
    return Explanation(name=name, probability=p, group=group, **fields)


def truth(label: str, kind: str = "listed", **fields: Any) -> CaseKey:
    given = {"case": "case-001", "accepted": (label,), "noise": 0.05, "gap": 0.5} | fields
    return CaseKey(kind=kind, label=label, **given)


TAPER = truth("taper", parameter=0.2, prior_95=(-0.4, 0.4), components=("geometry",))
FOUR = (
    says("minor-losses", 0.5, 0, parameter=size(2.0, 0.1)),
    says("taper", 0.3, 0, parameter=size(0.25, 0.02)),
    says("no-gap", 0.15, 1),
    says("unlisted", 0.05, 2),
)
PARTS = (says("junctions", 0.55, 0), says("geometry", 0.25, 1), says("sensor", 0.05, 1))


def score(key: CaseKey, *explanations: Explanation, by_component: bool = False, **fields: Any) -> Any:
    answer = Answer(explanations=explanations or FOUR, **fields)
    row = score_case(key, answer, by_component=by_component)
    return None if row is None else SimpleNamespace(**row)


# -- scores ------------------------------------------------------------------------------------------


def test_scores_by_hand() -> None:
    found = score(TAPER)
    assert (found.rank, found.first, found.group_first, found.group_size) == (1, False, True, 2)
    assert found.stated == pytest.approx(0.8)
    assert found.log_score == pytest.approx(math.log(0.3))
    assert found.brier == pytest.approx(0.5**2 + 0.7**2 + 0.15**2 + 0.05**2)
    assert (found.parameter_mean, found.true_parameter) == (0.25, 0.2)
    assert (found.prior_low, found.prior_high) == (-0.4, 0.4)
    assert found.gap_over_noise == pytest.approx(10)
    s = assemble([vars(found)]).summary
    assert (s["parameter"].count, s["constant"]["parameter"].count) == (0, 1)
    assert s["parameter_width"] == pytest.approx(2 * 1.96 * 0.02 / 0.8)
    assert score(truth("taper", parameter=0.2, place=3)).parameter_mean is None  # of another place


def test_scores_against_independent_sums() -> None:
    """Log and Brier scores of drawn answers, as means over cases of sums over one-hot outcomes."""
    rng, names = np.random.default_rng(4), ["a", "b", "c", "no-gap"]
    p = rng.dirichlet(np.ones(4), 50)
    labels = rng.integers(0, 4, 50)
    keys = [truth(names[i], case=f"case-{n}") for n, i in enumerate(labels)]
    answers = {
        k.case: Answer.ranked(dict(zip(names, row, strict=True))) for k, row in zip(keys, p, strict=True)
    }
    s = score_answers(keys, answers).summary
    hot = np.eye(4)[labels]
    assert s["log_score"] == pytest.approx(np.mean(np.log((p * hot).sum(axis=1))))
    assert s["brier"] == pytest.approx(np.mean(((p - hot) ** 2).sum(axis=1)))
    share = hot.mean(axis=0)
    assert s["constant"]["log_score"] == pytest.approx(np.mean(np.log(hot @ share)))
    assert s["constant"]["brier"] == pytest.approx(np.mean(((share - hot) ** 2).sum(axis=1)))
    ranks = 1 + (p > (p * hot).sum(axis=1, keepdims=True)).sum(axis=1)
    assert s["mean_rank"] == pytest.approx(ranks.mean())
    assert s["first"].count == (ranks == 1).sum()


def test_what_was_called_impossible_is_minus_infinity_and_named() -> None:
    impossible = score(truth("stenosis"))
    assert (impossible.rank, impossible.log_score) == (4, -math.inf)
    rare = score(truth("stenosis", case="rare"), FOUR[0], says("stenosis", 1e-9))
    found = assemble([vars(x) for x in (impossible, rare, score(TAPER))])
    assert found.summary["log_score"] == -math.inf
    assert found.summary["impossible"] == ["case-001", "rare"]
    assert found.summary["log_score_of_possible"] == pytest.approx(math.log(0.3))
    assert "log score | -inf (2 below 1e-6; the others -1.204)" in score_table(found)
    assert "| rare | stenosis | stenosis | 1.0e-09 | minor-losses" in score_table(found)


def test_components_are_scored_from_a_list_like_effects() -> None:
    """A listed effect's component, a cause that no explanation names, and one of two causes."""
    found = score(TAPER, by_component=True, components=PARTS)
    assert (found.leader, found.rank, found.group_first) == ("junctions", 2, False)
    assert found.log_score == pytest.approx(math.log(0.25))
    assert found.brier == pytest.approx(0.75**2 + 0.55**2 + 0.05**2 + 0.15**2)  # no-gap stands beside them
    pair = truth("x+y", "pair", accepted=(), components=("junctions", "sensor"))
    found = score(pair, components=PARTS)
    assert (found.first, found.probability) == (True, pytest.approx(0.6))
    quiet = truth("no-gap", "none", accepted=("no-gap", "correlated-noise"))
    assert score(quiet, by_component=True, components=PARTS).probability == pytest.approx(0.15)
    assert score(truth("coarse-grid"), by_component=True, components=PARTS) is None
    assert score(pair).right == ("unlisted",)  # a diagnosis that knows no components


def test_false_alarms_and_cases_without_an_answer() -> None:
    quiet = truth("no-gap", "none")
    assert score(quiet).false_alarm is True
    assert score(quiet, says("no-gap", 0.9), *FOUR[:2]).false_alarm is False
    cases = [vars(score(TAPER)), score_case(TAPER, None), vars(score(quiet))]
    s = assemble(cases).summary
    assert (s["n"], s["failed"], s["group_first"].share) == (3, 1, pytest.approx(1 / 3))
    assert s["false_alarms"] == Rate(1, 1)
    assert s["log_score"] == pytest.approx((math.log(0.3) + math.log(0.15)) / 2)


def test_what_is_left_is_that_of_the_leaders_own_fit() -> None:
    """Rms of the noise-free data minus the fit, over the series that the answer is about, by hand."""
    zero = ((0.0,) * 8,) * 3
    leader = tuple((x,) * 8 for x in (0.03, 0.04, 9.0))
    fitted = Fitted(base=((0.3,) * 8,) * 3, leader=leader, rows=(0, 1))
    left = math.sqrt((0.03**2 + 0.04**2) / 2)
    assert fitted.left(zero) == (pytest.approx(0.3), pytest.approx(left))
    key = truth("taper", truth=zero)
    stated = Size(mean=0.05, low=0.02, high=0.06)
    found = score(key, left=stated, fitted=fitted)
    assert found.true_left == pytest.approx(left)
    s = assemble([vars(found)]).summary
    assert (s["left"], s["left_error"]) == (Rate(1, 1), pytest.approx(0.05 - left))
    assert score(key, fitted=fitted).true_left is None  # no effect leads
    assert score(truth("taper"), left=stated, fitted=fitted).true_left is None
    assert score(key, left=stated.model_copy(update={"true": 0.07})).true_left == 0.07
    with pytest.raises(ValueError, match="shape"):
        fitted.left(zero[:2])


def test_the_best_constant_answer_is_the_best() -> None:
    """The shares beside the log score have the best one of all constant answers, by a search of scipy's."""
    rights = [("a",), ("a",), ("b",), ("a", "b"), ("b", "c"), ("c",)]
    shares = constant_shares(rights)

    def cost(x: Any) -> float:
        p = np.exp(x) / np.exp(x).sum()
        return -float(np.mean([math.log(sum(p["abc".index(n)] for n in right)) for right in rights]))

    best = minimize(cost, np.zeros(3))
    assert -best.fun == pytest.approx(
        np.mean([math.log(sum(shares[n] for n in r)) for r in rights]), abs=1e-6
    )
    assert constant_shares([("a",), ("b",), ("a",)]) == pytest.approx({"a": 2 / 3, "b": 1 / 3})


def test_reliability_by_hand() -> None:
    bins = reliability([0.8, 0.8, 0.8, 0.8, 0.3, 1.0], [True, True, False, True, False, True])
    assert [(b.low, b.high, b.n, b.right) for b in bins] == [
        (0.25, 0.5, 1, 0),
        (0.75, 0.9, 4, 3),
        (0.97, 1.0, 1, 1),
    ]
    low = reliability([0.0, 0.05, 0.1], [False, True, True])  # a bin begins at its lower edge
    assert [(b.low, b.high, b.n, b.right) for b in low] == [(0.0, 0.1, 2, 1), (0.1, 0.25, 1, 1)]
    # P(0 right of 4) = 0.0016, P(at most 1) = 0.0272: the lower 2.5 % end at 1
    assert bins[1].band == (1, 4)
    assert all(b.inside for b in bins)
    bad = reliability([0.99] * 10, [True] * 7 + [False] * 3)
    assert not bad[0].inside


def test_wilson_interval_against_its_equation() -> None:
    """The limits p solve (share - p)^2 = z^2 p (1 - p)/n."""
    for count, n in ((0, 7), (3, 10), (38, 40), (12, 12)):
        for p in Rate(count, n).interval:
            assert (count / n - p) ** 2 == pytest.approx(1.959964**2 * p * (1 - p) / n, rel=1e-5, abs=1e-12)
    assert all(math.isnan(x) for x in Rate(0, 0).interval)
    assert Rate(3, 12).share == 0.25


# -- folders -----------------------------------------------------------------------------------------


def weigh(name: str) -> MadeCase:
    label = "doubled" if name == "b" else "no-gap"
    return MadeCase(truth(label, case=name), {"weight.txt": "2" if name == "b" else "1"})


@dataclass(frozen=True)
class Scales:
    seed: int = 1
    broken: tuple[str, ...] = ("c",)
    marker: str = "weight.txt"

    def identity(self) -> Mapping[str, Any]:
        return {"seed": self.seed}

    def __call__(self, case: Path, answer: Path) -> Answer:
        if case.name in self.broken:
            raise RuntimeError("the scales\n are broken")
        value = float((case / self.marker).read_text())
        (answer / "notes.txt").write_text(f"{value}")
        return Answer.ranked({"doubled" if value > 1.5 else "no-gap": 1.0})


@pytest.fixture
def weighed(tmp_path: Path) -> tuple[Path, Path, Path]:
    cases, key, answers = tmp_path / "cases", tmp_path / "key.json", tmp_path / "answers"
    write_cases(cases, key, ["b", "a", "c"], weigh, head={"secret": "d"})
    return cases, key, answers


def test_folders_from_key_to_answers(weighed: tuple[Path, Path, Path]) -> None:
    cases, key, answers = weighed
    head, keys = read_key(key)
    assert (head, [k.case for k in keys]) == ({"secret": "d"}, ["a", "b", "c"])
    ran = run_cases(cases, answers, Scales())
    assert (ran.diagnosed, ran.kept, ran.failed) == (("a", "b"), (), {"c": "the scales are broken"})
    assert (answers / "c" / "failed.txt").read_text().startswith("the scales are broken\n\nTraceback")
    assert (answers / "b" / "notes.txt").read_text() == "2.0"
    found, others = read_answers(answers, read_sealed(key, answers))
    assert {name: a and a.explanations[0].name for name, a in found.items()} == {
        "a": "no-gap", "b": "doubled", "c": None
    }  # fmt: skip
    assert others == 0
    again = run_cases(cases, answers, Scales(broken=()))  # what failed is tried again
    assert (again.kept, again.failed) == (("a", "b"), {})
    assert not (answers / "c" / "failed.txt").exists()
    key.write_text(key.read_text().replace("doubled", "no-gap"))
    with pytest.raises(BlindError, match="not the key of these cases"):
        read_sealed(key, answers)
    (answers / "KEY.sha256").unlink()
    with pytest.raises(BlindError, match="cannot be checked"):
        read_sealed(key, answers)


def test_an_interrupted_run_goes_on(
    weighed: tuple[Path, Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kill between two files leaves no half answer; only what is missing is diagnosed again."""
    cases, _, answers = weighed
    written: list[Path] = []
    original = folders.write_file

    def stopping(path: Path, content: Any, **settings: Any) -> Path:
        if path == answers / "b" / "answer.json" and path not in written:
            written.append(path)
            raise KeyboardInterrupt
        return original(path, content, **settings)

    monkeypatch.setattr(folders, "write_file", stopping)
    with pytest.raises(KeyboardInterrupt):
        run_cases(cases, answers, Scales(broken=()))
    assert {p.name for p in (answers / "b").iterdir()} == {"failed.txt", "notes.txt"}
    (answers / "b").mkdir(exist_ok=True)  # killed while it wrote
    (answers / "b" / f".zoo-{'0' * 16}.part").write_text("half")
    assert run_cases(cases, answers, Scales(broken=())).kept == ("a",)
    assert run_cases(cases, answers, Scales(broken=())).kept == ("a", "b", "c")


@pytest.mark.parametrize("name", ["failed.txt", "answer.json", "notes.txt"])
def test_files_of_others_where_an_answer_goes_stay(name: str, weighed: tuple[Path, Path, Path]) -> None:
    cases, _, answers = weighed
    folder = answers / "a"
    folder.mkdir(parents=True)
    for other in {"failed.txt", name}:
        (folder / other).write_text("mine")
    with Run({"command": "blind run"}, fresh=True), pytest.raises(OutputFileError, match="not as zoo wrote"):
        run_cases(cases, answers, Scales(broken=()), fresh=True)
    assert (folder / name).read_text() == "mine"
    (folder / name).unlink()
    (folder / name).symlink_to(cases / "a" / "weight.txt")
    with pytest.raises(BlindError, match=f"{name}: is a link"):
        run_cases(cases, answers, Scales(broken=()), fresh=True)
    assert (cases / "a" / "weight.txt").read_text() != "mine"


def test_an_answer_of_others_that_came_meanwhile_stays(weighed: tuple[Path, Path, Path]) -> None:
    cases, _, answers = weighed

    def come(case: str) -> None:
        (answers / "b").mkdir(exist_ok=True)
        (answers / "b" / "answer.json").write_text("mine")

    with Run({"command": "blind run"}, fresh=True), pytest.raises(OutputFileError, match="not as zoo wrote"):
        run_cases(cases, answers, Scales(broken=()), cores=1, done=come)
    assert (answers / "b" / "answer.json").read_text() == "mine"


def test_a_digest_of_the_key_that_is_a_link_is_not_followed(weighed: tuple[Path, Path, Path]) -> None:
    cases, key, answers = weighed
    (cases / "KEY.sha256").unlink()
    (cases / "KEY.sha256").symlink_to(key)
    with pytest.raises(BlindError, match=r"KEY\.sha256: is a link; put the file itself there"):
        run_cases(cases, answers, Scales())
    assert not answers.exists()


def test_a_command_replaces_its_own_answers(weighed: tuple[Path, Path, Path]) -> None:
    """What failed is tried again by the same command; another one asks for --fresh."""
    cases, _, answers = weighed
    for broken, diagnosed in (("c",), 2), ((), 3):
        with Run({"command": "blind run"}):
            assert len(run_cases(cases, answers, Scales(broken=broken)).diagnosed) == diagnosed
    with Run({"command": "blind run", "--base": "B"}, fresh=True):
        assert run_cases(cases, answers, Scales(seed=2, broken=()), fresh=True).kept == ()


def test_the_key_is_not_the_folder_of_the_cases(tmp_path: Path) -> None:
    with pytest.raises(BlindError, match="put the key elsewhere"):
        write_cases(tmp_path / "x", tmp_path / "x", ["b"], weigh, head={})
    assert not (tmp_path / "x").exists()


def test_no_answer_of_another_run_is_replaced_unasked(weighed: tuple[Path, Path, Path]) -> None:
    cases, key, answers = weighed
    run_cases(cases, answers, Scales(broken=()))
    with pytest.raises(BlindError, match="--fresh to replace it"):
        run_cases(cases, answers, Scales(seed=2, broken=()))
    damaged = answers / "a" / "answer.json"
    damaged.write_bytes(damaged.read_bytes()[:-9])
    with pytest.raises(BlindError, match="--fresh to replace it"):
        run_cases(cases, answers, Scales(broken=()))
    assert run_cases(cases, answers, Scales(broken=()), fresh=True).kept == ("b", "c")
    (answers / "a" / "notes.txt").write_text("another")
    with pytest.raises(BlindError, match="a file beside it was changed"):
        read_answers(answers, read_key(key)[1])
    for name in ("a", "b"):
        (answers / name / "answer.json").write_bytes((answers / "c" / "answer.json").read_bytes())
        (answers / name / "notes.txt").write_bytes((answers / "c" / "notes.txt").read_bytes())
    with pytest.raises(BlindError, match="other data"):  # a and c hold the same file, b another
        read_answers(answers, read_key(key)[1])
    (answers / "c" / "answer.json").unlink()
    with pytest.raises(BlindError, match="other files than an answer's"):
        run_cases(cases, answers, Scales(), fresh=True)
    with pytest.raises(BlindError, match="finish"):
        read_answers(answers, [k for k in read_key(key)[1] if k.case == "c"])


@pytest.mark.parametrize("what", ["a file", "a folder", "a case", "an answer"])
def test_no_link_out_of_a_case_is_followed(
    what: str, weighed: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    """What a link of a case leads to reaches no worker, and an answer goes through none."""
    cases, _, answers = weighed
    secret = tmp_path / "secret"
    secret.mkdir()
    (secret / "weight.txt").write_text("7")
    if what == "an answer":
        answers.mkdir()
        (answers / "a").symlink_to(secret)
        with pytest.raises(BlindError, match="is a link"):
            run_cases(cases, answers, Scales(broken=()))
        assert [p.name for p in secret.iterdir()] == ["weight.txt"]
        return
    link, target = {
        "a file": (cases / "a" / "weight.txt", secret / "weight.txt"),
        "a folder": (cases / "a" / "more", secret),
        "a case": (cases / "d", secret),
    }[what]
    link.unlink(missing_ok=True)
    link.symlink_to(target)
    ran = run_cases(cases, answers, Scales(broken=()))
    case = "d" if what == "a case" else "a"
    assert list(ran.failed) == [case]
    assert "is a link" in ran.failed[case]
    assert not (answers / case).exists()


def test_runs_refuse_keys_among_cases_and_strange_folders(
    weighed: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    cases, key, answers = weighed
    for where in ("key.json", "my-Key-7.json", "a/key.json"):
        (cases / where).write_bytes(key.read_bytes())
        with pytest.raises(BlindError, match="a key lies with the cases"):
            run_cases(cases, answers, Scales())
        (cases / where).unlink()
    assert not answers.exists()
    (tmp_path / "empty").mkdir()
    for folder, out, words in (
        (tmp_path / "nothing", answers, "no such folder"),
        (tmp_path / "empty", answers, r"no folder with a weight\.txt"),
        (cases, cases / "answers", "lies inside"),
    ):
        with pytest.raises(BlindError, match=words):
            run_cases(folder, out, Scales())
    with pytest.raises(BlindError, match=r"holds KEY\.sha256; give a new or empty folder"):
        write_cases(cases, tmp_path / "other.json", ["a"], weigh, head={})
    with pytest.raises(BlindError, match="is there already"):
        write_cases(tmp_path / "more", key, ["a"], weigh, head={})
    with pytest.raises(BlindError, match="lies inside"):
        write_cases(tmp_path / "more", tmp_path / "more" / "key.json", ["a"], weigh, head={})


def test_files_are_written_together_in_an_order_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Times that can be set are one, and neither birth nor order tells how long a case took."""
    orders = set()
    original = Path.write_bytes
    for i in range(4):
        seen: list[str] = []

        def spy(self: Path, content: bytes, seen: list[str] = seen) -> int:
            seen.append(self.parent.name)
            return original(self, content)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "write_bytes", spy)
            write_cases(tmp_path / f"{i}", tmp_path / f"{i}.json", list("abcdef"), weigh, head={})
        orders.add(tuple(seen))
        times = {path.stat().st_mtime for path in (tmp_path / f"{i}", *(tmp_path / f"{i}").rglob("*"))}
        assert times == {1577836800.0}
    assert len(orders) > 1
    assert (tmp_path / "0.json").stat().st_mode & 0o077 == 0
    assert os.listdir(tmp_path / "0" / "a") == ["weight.txt"]


# -- any simulator -----------------------------------------------------------------------------------

TIME = np.linspace(0.0, 1.0, 50)
COUNTS = {"slope": 15, "offset": 15, "no-gap": 5, "spike": 5}
SHAPES = {"slope": TIME - 0.5, "offset": np.ones(50)}


def line(label: str, rng: np.random.Generator) -> DrawnCase:
    size = rng.uniform(0.5, 1.5)
    shape = SHAPES.get(label, 5.0 * (TIME == TIME[20]) if label == "spike" else 0.0 * TIME)
    data = size * shape + 0.05 * rng.standard_normal(50)
    return DrawnCase(data, {"parameter": size if label in SHAPES else None, "noise": 0.05})


def fits(data: Any) -> Answer:
    """Least squares with each shape; what has most of the sum of squares has the probability."""
    total = float(data @ data)
    found = {name: float(data @ shape / (shape @ shape)) for name, shape in SHAPES.items()}
    left = {name: total - x**2 * float(SHAPES[name] @ SHAPES[name]) for name, x in found.items()}
    name = min(left, key=lambda n: left[n])
    sd = 0.05 / math.sqrt(float(SHAPES[name] @ SHAPES[name]))
    explained = says(name, 0.9, parameter=size(found[name], sd))
    rest = [says(n, 0.02) for n in (*SHAPES, "no-gap", "unlisted") if n != name]
    quiet = total < 50 * 0.1**2
    if quiet or left[name] > 50 * 0.1**2:
        first = "no-gap" if quiet else "unlisted"
        explained, rest = says(first, 0.9), [says(n, 0.03) for n in (*SHAPES, "unlisted") if n != first]
    return Answer(explanations=(explained, *rest))


def test_check_of_a_simulator_of_ones_own(tmp_path: Path) -> None:
    told: list[str] = []
    found = blind_check(line, fits, COUNTS, listed=tuple(SHAPES), seed=3, done=told.append)
    s = found.summary
    assert (s["n"], s["failed"], len(told)) == (40, 0, 40)
    assert {kind: part["first"].count for kind, part in found.by["kind"].items()} == {
        "listed": 30, "none": 5, "outside": 5
    }  # fmt: skip
    assert s["false_alarms"] == Rate(0, 5)
    assert s["parameter"].n == 30
    assert s["parameter"].count >= 25  # of 95 %: less has a probability of 1 %
    assert "| label | cases |" in score_table(found)
    assert blind_check(line, fits, COUNTS, listed=tuple(SHAPES), seed=3) == found
    write_score(found, tmp_path / "score")
    record = json.loads((tmp_path / "score" / "score.json").read_text())
    assert len(record["cases"]) == 40
    assert (tmp_path / "score" / "cases.csv").read_text().count("\n") == 41
    assert (tmp_path / "score" / "score.md").read_text().startswith("| 40 cases, 0 without an answer |")


def test_a_diagnosis_that_always_blames_one_effect_scores_as_that() -> None:
    found = blind_check(
        line, lambda data: Answer.ranked({"slope": 0.9, "no-gap": 0.1}), COUNTS, listed=list(SHAPES)
    )
    s = found.summary
    assert (s["first"].share, s["false_alarms"].share) == (15 / 40, 1.0)
    assert s["constant"]["first"].share == 15 / 40
    assert (s["log_score"], len(s["impossible"])) == (-math.inf, 20)
    assert not found.reliability[0].inside


def test_cases_are_shuffled_and_the_key_is_apart() -> None:
    data, key = draw_cases(line, COUNTS, tuple(SHAPES), seed=2)
    assert list(data) == [k.case for k in key] == [f"case-{i:03d}" for i in range(1, 41)]
    assert {k.label: k.kind for k in key} == {
        "slope": "listed", "offset": "listed", "no-gap": "none", "spike": "outside"
    }  # fmt: skip
    labels = [k.label for k in key]
    assert labels != sorted(labels, key=list(COUNTS).index)
    assert all(isinstance(values, np.ndarray) for values in data.values())
    assert draw_cases(line, COUNTS, tuple(SHAPES), seed=4)[1] != key


def test_a_diagnosis_that_fails_is_no_answer() -> None:
    def sometimes(data: Any) -> Answer:
        if data.max() > 2:
            raise RuntimeError("too large")
        return fits(data)

    found = blind_check(line, sometimes, COUNTS, listed=tuple(SHAPES))
    assert set(found.failed.values()) == {"RuntimeError: too large"}
    assert found.summary["failed"] == len(found.failed) == 5

    def never(data: Any) -> Answer:
        raise KeyError("pressure")

    with pytest.raises(BlindError, match="no case could be diagnosed; the first: KeyError"):
        blind_check(line, never, {"slope": 2}, listed=tuple(SHAPES))


@pytest.mark.parametrize("counts", [{}, {"slope": 0}, {"slope": -1, "offset": 3}, {"unlisted": 2}])
def test_check_refuses(counts: dict[str, int]) -> None:
    with pytest.raises(BlindError):
        blind_check(line, fits, counts, listed=tuple(SHAPES))


def decay(c: dict[str, Any], times: Any) -> Any:
    """An exponential, on the grid that the model is told: the trapezoidal rule in so many steps."""
    n, rate = int(c.get("steps", 40)), float(c["rate"])
    fine = np.linspace(times[0], times[-1], n * (len(times) - 1) + 1)
    h = fine[1] - fine[0]
    y = float(c["start"]) * ((1 - rate * h / 2) / (1 + rate * h / 2)) ** np.arange(len(fine))
    return y[::n] + float(c.get("offset", 0.0))


@effect("offset", parameters=[EffectParameter("offset", "V", 0.2, -1.0, 1.0, (0.2,))])
def offset(c: dict[str, Any], values: tuple[float, ...], at: Any) -> dict[str, Any]:
    """The zero of the reading is off."""
    return {**c, "offset": values[0]}


def test_a_forward_model_draws_its_cases_and_is_diagnosed() -> None:
    """From priors, an effect, and a finer grid to the table; what the baseline leaves is that of a refit."""
    times = np.linspace(0.0, 4.0, 60)
    parameters = (
        Parameter("rate", Normal(1.0, 0.1, 0.5, 2.0)),
        Parameter("start", Normal(2.0, 0.2, 1.0, 3.0)),
    )
    fine = FunctionModel(decay, parameters, Outputs(("y",), times), "decay")
    coarse = FunctionModel(
        lambda c, t: decay({**c, "steps": 10}, t), parameters, Outputs(("y",), times), "coarse"
    )

    def observe(series: Any, rng: np.random.Generator) -> Data:
        return Data(times, series + 0.02 * rng.standard_normal(series.shape), labels=("y",), units=("V",))

    draw = ModelDraw(fine, [offset], observe, 0.02)
    case = draw("offset", np.random.default_rng(1))
    assert case.withheld["gap"] >= 0.01
    assert case.withheld["prior_95"][0] < case.withheld["parameter"] < case.withheld["prior_95"][1]
    found = blind_check(
        draw, lambda data: diagnose(data, coarse, [offset]), {"offset": 2, "no-gap": 1}, listed=["offset"]
    )
    assert found.summary["first"] == Rate(3, 3)
    assert found.summary["left"].n == 2
    with pytest.raises(BlindError, match="no draw of 60 leaves 900"):
        ModelDraw(fine, [offset], observe, 0.02, (900, 1000))("offset", np.random.default_rng(1))


def test_what_a_linear_baseline_leaves_is_orthogonal_to_it() -> None:
    times = np.linspace(0.0, 1.0, 40)
    model = FunctionModel(
        lambda c, t: c["a"] + c["b"] * t, (Parameter("a", Normal(0, 1)), Parameter("b", Normal(0, 1))),
        Outputs(("y",), times), "line",
    )  # fmt: skip
    series = np.sin(7 * times)[None]
    left = LinearBaseline(model, [0.3, -0.2]).left(series)[0]
    fit = np.polyval(np.polyfit(times, series[0], 1), times)
    np.testing.assert_allclose(left, series[0] - fit, atol=1e-8)


def test_an_answer_is_what_the_diagnosis_says() -> None:
    rng = np.random.default_rng(2)
    times = np.linspace(0.0, 1.0, 60)
    model = FunctionModel(
        lambda c, t: c["a"] * np.cos(5 * t),
        (Parameter("a", Normal(1, 0.3)),),
        Outputs(("y",), times),
        "cosine",
    )
    data = Data(
        times, model.solve(model.configure([1.2])) + 0.05 * rng.standard_normal((1, 60)), labels=("y",)
    )
    found = diagnose(data, model, [])
    said = as_answer(found)
    assert as_answer(said) is said
    assert {e.name: e.probability for e in said.explanations} == {
        h.name: h.probability for h in found.file.hypotheses
    }
    assert said.explanations[0].name == found.file.cause[0] == "no-gap"
    assert said.left is None  # no effect leads, which leaves nothing
    assert said.gap == Size(
        mean=found.file.gap.before,
        low=found.file.gap.before_interval[0],
        high=found.file.gap.before_interval[1],
    )
    assert said.fitted is not None
    residual = np.sqrt(np.mean((data.values - np.array(said.fitted.base)) ** 2))
    assert residual == pytest.approx(found.file.gap.residual_rms_before, rel=1e-3)
