"""The blind check of any simulator: scores by hand, sealed folders with resume, from draw to table."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zoo.core.blindcheck.folders as folders
from zoo.core.blindcheck import (
    Answer,
    BlindError,
    CaseKey,
    DrawnCase,
    Fitted,
    Group,
    LinearBaseline,
    ModelDraw,
    Size,
    as_answer,
    blind_check,
    draw_cases,
    paired,
    paired_table,
    score_answers,
    score_table,
    write_score,
)
from zoo.core.blindcheck.folders import MadeCase, read_answers, read_key, read_sealed, run_cases, write_cases
from zoo.core.blindcheck.scoring import Rate, Score, reliability, score_case
from zoo.core.data import Data
from zoo.core.diagnosis import diagnose
from zoo.core.effects import EffectParameter, effect
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.outputs import OutputFileError, Run
from zoo.core.parameters import Normal, Parameter


def size(mean: float, sd: float) -> Size:
    return Size(mean=mean, low=mean - 1.96 * sd, high=mean + 1.96 * sd)


def truth(label: str, kind: str = "listed", **fields: Any) -> CaseKey:
    given = {"case": "case-001", "accepted": (label,), "noise": 0.05, "gap": 0.5} | fields
    return CaseKey(kind=kind, label=label, **given)


TAPER = truth("taper", parameter=0.2, prior_95=(-0.4, 0.4), components=("geometry",))
QUIET = truth("no-gap", "none", case="quiet")
PAIR = truth("x+y", "pair", case="pair", accepted=(), components=("junctions", "sensor"))
SAID = Answer(
    components={"junctions": 0.7, "geometry": 0.4, "sensor": 0.02},
    nothing=0.1,
    effects={"minor-losses": 0.5, "taper": 0.3, "stenosis": 0.05},
    groups=(Group(names=("minor-losses", "taper"), probability=0.8),),
    sizes={"taper": size(0.25, 0.02)},
)


def score(*keys: CaseKey, answer: Answer = SAID) -> Score:
    return score_answers(keys, {key.case: answer for key in keys})


# -- scores ------------------------------------------------------------------------------------------


def test_scores_by_hand() -> None:
    row = score_case(TAPER, SAID)
    assert row["components_log"] == pytest.approx(math.log(0.3) + math.log(0.4) + math.log(0.98))
    assert row["components_brier"] == pytest.approx(0.7**2 + 0.6**2 + 0.02**2)
    assert row["nothing_log"] == pytest.approx(math.log(0.9))
    assert row["effects_log"] == pytest.approx(math.log(0.5) + math.log(0.3) + math.log(0.95))
    assert row["groups_log"] == pytest.approx(math.log(0.8) + math.log(0.95))  # stenosis is alone
    assert row["groups_brier"] == pytest.approx(0.2**2 + 0.05**2)
    assert (row["leader"], row["first"], row["false_alarm"]) == ("junctions", False, None)
    assert row["gap_over_noise"] == pytest.approx(10)
    s = score(TAPER).summary
    assert (s["parameter"].count, s["constant"]["parameter"].count) == (0, 1)
    assert s["parameter_width"] == pytest.approx(2 * 1.96 * 0.02 / 0.8)


def test_two_causes_may_both_be_right_and_nothing_is_a_cause_of_a_quiet_case() -> None:
    both = SAID.model_copy(update={"components": {"junctions": 0.95, "sensor": 0.9, "geometry": 0.92}})
    row = score_case(PAIR, both)
    assert row["components_log"] == pytest.approx(math.log(0.95) + math.log(0.9) + math.log(0.08))
    assert (row["first"], row["sure"], row["sure_right"]) == (True, 2, 1)
    assert row["effects_log"] is None  # no listed effect is right
    quiet = score_case(QUIET, SAID)
    assert (quiet["nothing_log"], quiet["false_alarm"]) == (pytest.approx(math.log(0.1)), True)
    assert quiet["components_log"] == pytest.approx(math.log(0.3) + math.log(0.6) + math.log(0.98))
    former = truth("x", "outside", accepted=("unlisted", "wall"), components=("wall",))
    assert (former.effects, former.wrong) == ((), ("wall",))  # what older keys accept is no effect
    assert truth("correlated-noise").wrong == ()
    assert truth("coarse-grid").wrong == ("coarse-grid",)  # of no component but its own


def test_the_constant_answer_are_base_rates_and_nobody_beats_a_true_probability() -> None:
    """Against sums over one-hot outcomes; answers that are drawn from what they state score best."""
    rng, names = np.random.default_rng(4), ["a", "b", "c"]
    p = rng.uniform(0, 1, (400, 3))
    there = rng.random((400, 3)) < p
    keys = [
        truth("x", case=f"{i}", accepted=(), components=tuple(np.array(names)[row]))
        for i, row in enumerate(there)
    ]

    def means(stated: Any) -> tuple[Any, Any]:
        said = {
            k.case: Answer(components=dict(zip(names, row, strict=True)), nothing=0.1)
            for k, row in zip(keys, stated, strict=True)
        }
        one = score_answers(keys, said).summary["questions"]["components"]
        return one, (one.log.mean, one.brier.mean)

    one, honest = means(p)
    so = np.where(there, p, 1 - p)
    assert honest == (
        pytest.approx(np.log(so).sum(axis=1).mean()),
        pytest.approx(((1 - so) ** 2).sum(axis=1).mean()),
    )
    assert one.log.error == pytest.approx(np.log(so).sum(axis=1).std(ddof=1) / 20)
    base = np.where(there, there.mean(axis=0), 1 - there.mean(axis=0))
    assert one.constant_log == pytest.approx(np.log(base).sum(axis=1).mean())
    assert one.constant_brier == pytest.approx(((1 - base) ** 2).sum(axis=1).mean())
    for other in (np.clip(p + 0.2, 0, 0.999), p**2, 1 / (1 + ((1 - p) / p) ** 3)):
        log, brier = means(other)[1]
        assert log < honest[0]
        assert brier > honest[1]


def test_what_was_called_impossible_is_minus_infinity_and_named() -> None:
    sure = SAID.model_copy(update={"components": {"geometry": 0.0, "sensor": 1.0}})
    rare = SAID.model_copy(update={"components": {"geometry": 1e-9, "sensor": 0.0}})
    keys = [TAPER, TAPER.model_copy(update={"case": "rare"}), QUIET]
    found = score_answers(keys, {"case-001": sure, "rare": rare, "quiet": SAID})
    one = found.summary["questions"]["components"]
    assert (one.log.mean, one.log.lost, one.log.n) == (-math.inf, 1, 3)
    assert [row[:2] for row in one.unlikely] == [
        ("case-001", "geometry"), ("case-001", "not sensor"), ("rare", "geometry")
    ]  # fmt: skip
    assert "| rare | components that are wrong | geometry | 1.0e-09 |" in score_table(found)
    lines = score_table(found).splitlines()
    for head, rule in pairwise(lines):
        if rule.startswith("|---"):  # else it is no table
            assert rule.count("|") == head.count("|"), head
    quiet = score_case(QUIET, SAID)["components_log"]
    assert f"-inf (2 of 3 below 1e-6; the others {quiet:.3f})" in score_table(found)


def test_cases_without_an_answer_are_counted() -> None:
    found = score_answers([TAPER, QUIET], {"quiet": SAID})
    s = found.summary
    assert (s["n"], s["failed"], s["first"], s["questions"]["nothing"].log.n) == (2, 1, Rate(0, 2), 1)
    assert s["false_alarms"] == Rate(1, 1)


def test_what_is_left_is_that_of_the_fit() -> None:
    """Rms of the noise-free data minus the fit, over the series that the answer is about, by hand."""
    zero = ((0.0,) * 8,) * 3
    leader = tuple((x,) * 8 for x in (0.03, 0.04, 9.0))
    fitted = Fitted(base=((0.3,) * 8,) * 3, leader=leader, rows=(0, 1))
    left = math.sqrt((0.03**2 + 0.04**2) / 2)
    key = truth("taper", truth=zero)
    gap, stated = Size(mean=0.25, low=0.2, high=0.28), Size(mean=0.05, low=0.02, high=0.06)
    s = score(key, answer=SAID.model_copy(update={"gap": gap, "left": stated, "fitted": fitted})).summary
    assert (s["gap"], s["left"], s["left_error"]) == (Rate(0, 1), Rate(1, 1), pytest.approx(0.05 - left))
    assert (s["removed"], s["true_removed"]) == (pytest.approx(0.8), pytest.approx(1 - left / 0.3))
    known = stated.model_copy(update={"true": 0.07})  # as frozen answers have it
    assert score(key, answer=SAID.model_copy(update={"left": known})).cases[0]["true_left"] == 0.07
    with pytest.raises(ValueError, match="shape"):
        fitted.left(zero[:2])


def test_intervals_of_the_baseline_s_parameters_are_counted_where_something_is_wrong() -> None:
    """Of two parameters, both alone, one of them true: over all causes both, twice as wide in the median."""
    true = {"base_parameters": {"a": 1.0, "b": 2.0, "untold": 3.0}}
    said = SAID.model_copy(
        update={
            "alone": {"a": size(1.0, 0.1), "b": size(1.0, 0.1)},
            "averaged": {"a": size(1.1, 0.1), "b": size(1.5, 0.3)},
        }
    )
    found = score(truth("taper", drawn=true), QUIET.model_copy(update={"drawn": true}), answer=said)
    s = found.summary
    assert (s["alone"], s["averaged"], s["wider"]) == (Rate(1, 2), Rate(2, 2), pytest.approx(2.0))
    assert "95 % interval of a baseline's parameter holds the true one" in str(found)
    assert "50 % (by itself)" in str(found)


def test_reliability_by_hand() -> None:
    bins = reliability([0.8, 0.8, 0.8, 0.8, 0.3, 1.0], [True, True, False, True, False, True])
    assert [(b.low, b.high, b.n, b.right) for b in bins] == [
        (0.3, 0.5, 1, 0),
        (0.7, 0.9, 4, 3),
        (0.99, 1.0, 1, 1),
    ]
    low = reliability([0.0, 0.005, 0.01], [False, True, True])  # a bin begins at its lower edge
    assert [(b.low, b.high, b.n, b.right) for b in low] == [(0.0, 0.01, 2, 1), (0.01, 0.05, 1, 1)]
    # P(0 right of 4) = 0.0016, P(at most 1) = 0.0272: the lower 2.5 % end at 1
    assert bins[1].band == (1, 4)
    assert all(b.inside for b in bins)
    assert not reliability([0.98] * 10, [True] * 7 + [False] * 3)[0].inside


def test_wilson_interval_against_its_equation() -> None:
    """The limits p solve (share - p)^2 = z^2 p (1 - p)/n."""
    for count, n in ((0, 7), (3, 10), (38, 40), (12, 12)):
        for p in Rate(count, n).interval:
            assert (count / n - p) ** 2 == pytest.approx(1.959964**2 * p * (1 - p) / n, rel=1e-5, abs=1e-12)
    assert all(math.isnan(x) for x in Rate(0, 0).interval)
    assert Rate(3, 12).share == 0.25


def test_differences_are_paired_by_case() -> None:
    """Of cases that both answered; where one is -inf the difference is of the others, and is counted."""
    keys = [truth("x", case=name, components=("x",)) for name in "abcd"]
    now, then = (
        score_answers(keys, {k.case: Answer.ranked({"x": x}) for k, x in zip(keys, p, strict=False)})
        for p in ((0.9, 0.5, 0.0), (0.6, 0.8, 0.5, 0.5))
    )
    one, other, log, brier = paired(now, then)["all"]["components"]
    assert (one.brier.n, other.brier.mean) == (3, pytest.approx((0.4**2 + 0.2**2 + 0.5**2) / 3))
    d = np.log([0.9 / 0.6, 0.5 / 0.8])
    assert (log.n, log.lost, log.mean) == (3, 1, -math.inf)
    assert (log.others, log.error) == (pytest.approx(d.mean()), pytest.approx(d.std(ddof=1) / 2**0.5))
    assert brier.mean == pytest.approx(np.mean([0.1**2 - 0.4**2, 0.5**2 - 0.2**2, 1 - 0.5**2]))
    assert "| listed | components that are wrong | 3 |" in paired_table(now, then)


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
    assert {name: a and ("no-gap" if a.nothing else "doubled") for name, a in found.items()} == {
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
    amount = rng.uniform(0.5, 1.5)
    shape = SHAPES.get(label, 5.0 * (TIME == TIME[20]) if label == "spike" else 0.0 * TIME)
    data = amount * shape + 0.05 * rng.standard_normal(50)
    return DrawnCase(data, {"parameter": amount if label in SHAPES else None, "noise": 0.05})


def fits(data: Any) -> Answer:
    """Least squares with each shape; what leaves least has the probability where it leaves but noise."""
    found = {name: float(data @ shape / (shape @ shape)) for name, shape in SHAPES.items()}
    left = {name: float(np.sum((data - x * SHAPES[name]) ** 2)) for name, x in found.items()}
    name = min(left, key=lambda n: left[n])
    sd = 0.05 / math.sqrt(float(SHAPES[name] @ SHAPES[name]))
    there = 0.9 if left[name] < 50 * 0.1**2 < float(data @ data) else 0.03
    said = Answer.ranked({n: there if n == name else 0.02 for n in SHAPES} | {"no-gap": 0.98 - there})
    return said.model_copy(update={"sizes": {name: size(found[name], sd)}})


def test_check_of_a_simulator_of_ones_own(tmp_path: Path) -> None:
    told: list[str] = []
    found = blind_check(line, fits, COUNTS, listed=tuple(SHAPES), seed=3, done=told.append)
    s = found.summary
    assert (s["n"], s["failed"], len(told)) == (40, 0, 40)
    assert {kind: part["first"].count for kind, part in found.by["kind"].items()} == {
        "listed": 30, "none": 5, "outside": 5
    }  # fmt: skip
    assert s["false_alarms"] == Rate(0, 10)  # a spike is nothing that this diagnosis can name
    assert (s["parameter"].n, s["parameter"].count >= 25) == (30, True)  # less has a probability of 1 %
    assert blind_check(line, fits, COUNTS, listed=tuple(SHAPES), seed=3) == found
    write_score(found, tmp_path / "score")
    record = json.loads((tmp_path / "score" / "score.json").read_text())
    assert len(record["cases"]) == 40
    assert (tmp_path / "score" / "cases.csv").read_text().count("\n") == 41
    assert (tmp_path / "score" / "score.md").read_text().startswith("| 40 cases, 0 without an answer |")


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


@pytest.mark.parametrize("counts", [{}, {"slope": 0}, {"slope": -1, "offset": 3}])
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
    assert found.summary["averaged"] == Rate(4, 4)
    assert found.summary["alone"].count < 4  # with the zero of the reading off, rate and start are not theirs
    assert found.summary["questions"]["effects"].log.n == 2
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
    """Inclusion probabilities of its file; effects of components that stand in for each other are a group."""
    times, rng = np.linspace(0.0, 4.0, 60), np.random.default_rng(2)
    model = FunctionModel(
        decay, (Parameter("rate", Normal(1.0, 0.1, 0.5, 2.0)),), Outputs(("y",), times), "d"
    )
    exact = model.solve({"rate": 1.0, "start": 2.0, "offset": 0.3})
    data = Data(times, exact + 0.02 * rng.standard_normal((1, 60)), labels=("y",), units=("V",))
    found = diagnose(data, FunctionModel(started, model.parameters, model.outputs, "d"), [offset])
    said, file = as_answer(found), found.file
    assert as_answer(said) is said
    assert (said.components, said.effects) == ({"offset": file.components[0].probability},) * 2
    assert said.nothing == pytest.approx(1 - said.components["offset"])
    assert said.sizes["offset"].low < 0.3 < said.sizes["offset"].high
    rate = file.base_parameters["base"]["rate"], file.base_parameters["over all sets"]["rate"]
    assert [(x.low, x.high) for x in (said.alone["rate"], said.averaged["rate"])] == [
        x.interval for x in rate
    ]
    assert said.gap is not None
    assert said.left is not None
    assert (said.gap.mean, said.left.mean) == (file.gap.before, file.gap.after)
    assert said.fitted is not None
    left = said.fitted.left(data.values.tolist())
    assert left == pytest.approx((file.gap.residual_rms_before, file.gap.residual_rms_after), rel=1e-3)
    other = file.components[0].model_copy(update={"name": "drift", "confounded": []})
    first = file.components[0].model_copy(update={"confounded": ["drift"]})
    more = file.causes[0].model_copy(update={"name": "creep", "component": "drift"})
    update = {"components": [first, other], "causes": [*file.causes, more]}
    [group] = as_answer(file.model_copy(update=update)).groups
    assert (group.names, group.probability) == (("offset", "creep"), pytest.approx(said.effects["offset"]))


def started(c: dict[str, Any], times: Any) -> Any:
    return decay({**c, "start": 2.0}, times)
