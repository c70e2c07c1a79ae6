"""The blind check of any simulator: scores by hand, folders with resume, and a check from draw to table."""

from __future__ import annotations

import doctest
import json
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zoo.core.blindcheck import (
    Answer,
    BlindError,
    CaseKey,
    CheckScore,
    DrawnCase,
    Explanation,
    TrueEffect,
    as_answer,
    check,
    draw_cases,
    score_table,
    write_score,
)
from zoo.core.blindcheck.answers import Fitted, Size
from zoo.core.blindcheck.case_score import FLOOR, score_case, tree_distance
from zoo.core.blindcheck.check_score import assemble
from zoo.core.blindcheck.making import write_cases
from zoo.core.blindcheck.rates import Rate, reliability
from zoo.core.blindcheck.running import read_answers, run_folders
from zoo.core.blindcheck.sealing import MadeCase, read_sealed
from zoo.core.diagnosis import read_diagnosis
from zoo.core.effects import Location

ANSWERS = Path(__file__).parents[1] / "benchmarks" / "blind" / "independent" / "answers"


def answer(explanations: list[Explanation], **fields: Any) -> Answer:
    cause = tuple(e.name for e in explanations if e.group == explanations[0].group)
    return Answer(tuple(explanations), frozenset(), cause, **fields)


def truth(kind: str, label: str, *effects: TrueEffect, **fields: Any) -> CaseKey:
    values: dict[str, Any] = {"noise": 0.05, "before": 0.5} | fields
    return CaseKey("case-001", kind, label, effects, **values)


TAPER = TrueEffect("taper", Location(), 0.2, (-0.4, 0.4))
FOUR = [
    Explanation("minor-losses", 0.5, 0, amplitude=2.0, amplitude_sd=0.1),
    Explanation("taper", 0.3, 0, amplitude=0.25, amplitude_sd=0.02),
    Explanation("no-gap", 0.15, 1),
    Explanation("unlisted", 0.05, 2),
]

# -- scores ------------------------------------------------------------------------------------------


def test_scores_by_hand() -> None:
    found = score_case(truth("listed", "taper", TAPER), answer(FOUR))
    assert (found.rank, found.group_rank, found.first, found.group_first) == (2, 1, False, True)
    assert found.right
    assert found.leader_probability == pytest.approx(0.8)
    assert found.log_score == pytest.approx(math.log(0.3))
    assert found.group_log_score == pytest.approx(math.log(0.8))
    assert found.brier == pytest.approx(0.5**2 + 0.7**2 + 0.15**2 + 0.05**2)
    assert found.group_brier == pytest.approx(0.2**2 + 0.15**2 + 0.05**2)
    assert found.amplitude == 0.25
    assert found.z == pytest.approx(2.5)
    assert found.amplitude_covered is False
    assert found.prior_covered
    told = [FOUR[0], replace(FOUR[1], amplitude_interval=(0.19, 0.3))]  # not mean ± 1.96 sd, but as stated
    assert score_case(truth("listed", "taper", TAPER), answer(told)).amplitude_covered is True
    assert found.prior_only is None  # this answer does not say what the prior gives
    assert found.gap_over_noise == pytest.approx(10)


TRUE = np.zeros((3, 8))
FITTED = Fitted(TRUE + 0.3, TRUE + np.array([[0.03], [0.04], [9.0]]), (0, 1))


def test_what_is_left_is_that_of_the_leaders_own_fit() -> None:
    """Rms of the noise-free data minus the fit, over the series that the answer is about, by hand."""
    key = truth("listed", "taper", TAPER, truth=TRUE)
    left = math.sqrt((0.03**2 + 0.04**2) / 2)
    given = {"gap_before": Size(0.31, 0.28, 0.33), "fitted": FITTED}
    found = score_case(key, answer(FOUR, gap_after=Size(0.05, 0.02, 0.06), **given))
    assert (found.gap_true, found.left_true) == (pytest.approx(0.3), pytest.approx(left))
    assert (found.gap_covered, found.left_covered) == (True, True)
    assert found.left_ratio == pytest.approx(0.05 / left)  # above a fifth of 0.05
    assert found.left_error is None
    loud = score_case(replace(key, noise=0.5), answer(FOUR, gap_after=Size(0.05, 0.04, 0.06), **given))
    assert loud.left_ratio is None
    assert loud.left_error == pytest.approx(0.05 - left)
    assert loud.left_covered is False
    # where no effect leads there is nothing that it leaves
    none = score_case(key, answer([FOUR[2], *FOUR[:2]], gap_after=Size(0.05, 0.0, 0.1), **given))
    assert none.gap_true == pytest.approx(0.3)
    assert (none.left, none.left_true, none.left_covered) == (None, None, None)
    # without the series of the fit, or without the noise-free data, there is nothing to compare
    assert score_case(key, answer(FOUR, gap_after=Size(0.05, 0.0, 0.1))).left_true is None
    assert score_case(truth("listed", "taper", TAPER), answer(FOUR, **given)).gap_true is None
    with pytest.raises(ValueError, match="shape"):
        FITTED.left(np.zeros((2, 8)))


def test_a_probability_that_the_prior_alone_gives_is_told() -> None:
    key = truth("listed", "taper", TAPER)
    for prior, flagged in ((0.495, True), (0.511, False), (None, False)):
        stated = [replace(FOUR[0], prior_probability=prior), *FOUR[1:]]
        assert score_case(key, answer(stated, states_prior=True)).prior_only is flagged
    stated = [replace(FOUR[0], prior_probability=0.5), *FOUR[1:]]
    given = (answer(stated, states_prior=True), answer(FOUR, states_prior=True), answer(FOUR))
    found = assemble([score_case(key, one) for one in given])
    assert (found.summary["prior_only"]["count"], found.summary["prior_only"]["n"]) == (1, 2)
    assert found.summary["prior_only_right"]["count"] == 1
    assert sum(b.n for b in found.reliability) == 2  # the first says nothing of the data


def test_sds_that_are_too_small_are_counted_by_effect() -> None:
    far = replace(FOUR[1], amplitude_sd=0.005)  # 10 sds
    cases = [score_case(truth("listed", "taper", TAPER), answer([e, FOUR[2]])) for e in (far, FOUR[1])]
    found = assemble(cases)
    assert found.summary["amplitude_beyond_5_sd"]["count"] == 1
    z = found.amplitudes["taper"]
    assert (z["n"], z["beyond_5_sd"], z["held"]) == (2, 1, 0)
    assert (z["mean"], z["largest"]) == (pytest.approx(6.25), pytest.approx(10.0))


def test_a_constant_answer_scores_what_the_best_constant_says() -> None:
    """Each constant answer, given as an answer, has the figure that is printed beside the score."""
    labels = ["taper"] * 4 + ["minor-losses"] * 2 + ["no-gap"] * 2 + ["valve-click"] * 2
    keys = [
        truth("none" if n == "no-gap" else "outside" if n == "valve-click" else "listed", n,
              *([] if n == "no-gap" else [TrueEffect(n, Location(), 0.2)]))
        for n in labels
    ]  # fmt: skip

    def always(shares: dict[str, float]) -> CheckScore:
        return assemble([score_case(key, Answer.ranked(shares)) for key in keys])

    taper = always({"taper": 0.4, "minor-losses": 0.2, "no-gap": 0.2, "unlisted": 0.2})
    best = taper.constants
    for name in ("right", "effect_first", "effect_or_group_first"):
        assert best[name]["answer"] == "always taper"
        assert taper.summary[name]["share"] == best[name]["share"]
    assert best["right"]["share"] == 0.4
    for name in ("log_score", "brier", "leader_brier"):
        assert taper.summary[name] == pytest.approx(best[name]["value"])
        for other in ({"taper": 0.5, "minor-losses": 0.2, "no-gap": 0.2, "unlisted": 0.1}, {"taper": 1.0}):
            found = always(other).summary[name]
            assert found < taper.summary[name] if name == "log_score" else found > taper.summary[name]
    for label, name in (("no-gap", "false_alarms"), ("unlisted", "outside_called_unlisted")):
        found = always({label: 1.0}).summary
        assert best[name]["answer"] == f"always {label}"
        assert found[name]["share"] == best[name]["share"]


def test_constants_of_sizes_by_hand() -> None:
    """A constant size is the median; a constant interval the shortest with 95 % of the true ones."""
    true = [0.02 * 1.1**i for i in range(20)]
    cases = [
        replace(score_case(truth("listed", "taper", TAPER), answer(FOUR)),
                left=1.5 * x, left_true=x, left_low=0.5 * x, left_high=2.0 * x)
        for x in true
    ]  # fmt: skip
    found = assemble(cases)
    assert found.summary["left_ratio"]["median"] == pytest.approx(1.5)
    middle = float(np.median(true))
    assert found.constants["left_ratio"]["worst"] == pytest.approx(middle / true[0])
    own, constant = (x["left_interval_holds_truth"] for x in (found.summary, found.constants))
    assert own["width"] == pytest.approx(1.5 * middle)
    assert constant["width"] == pytest.approx(true[18] - true[0])
    assert constant["share"] == 0.95
    small = assemble([replace(c, noise=10.0) for c in cases])
    assert small.summary["left_ratio"] == {"n": 0}
    assert small.summary["left_error"]["worst"] == pytest.approx(0.5 * true[-1])
    assert "| what the leader leaves" in score_table(found)


def test_what_was_called_impossible_costs_the_floor() -> None:
    found = score_case(truth("listed", "stenosis", TrueEffect("stenosis", Location(3), 0.2)), answer(FOUR))
    assert found.rank == 5
    assert found.log_score == pytest.approx(math.log(FLOOR))
    assert not found.right


def test_no_effect_and_outside_cases() -> None:
    none = truth("none", "no-gap", before=0.0)
    assert score_case(none, answer(FOUR)).false_alarm is True
    calm = [replace(FOUR[2], probability=0.9), *FOUR[:2]]
    assert score_case(none, answer(calm)).false_alarm is False
    out = truth("outside", "valve-click", TrueEffect("valve-click"))
    assert score_case(out, answer(FOUR)).called_unlisted is True  # no listed effect above 50 %
    sure = [replace(FOUR[0], probability=0.6), *FOUR[1:]]
    assert score_case(out, answer(sure)).called_unlisted is False
    unlisted = [Explanation("unlisted", 0.9, 0), Explanation("taper", 0.1, 1)]
    found = score_case(out, answer(unlisted))
    assert found.called_unlisted
    assert found.right
    two = truth("outside", "second-effect", TAPER, TrueEffect("minor-losses", Location(), 2.0))
    found = score_case(two, answer(sure))
    assert (found.first, found.called_unlisted) == (True, True)
    assert found.probability == pytest.approx(0.6 + 0.3 + 0.05)


def test_place_and_amplitude_belong_to_the_place() -> None:
    parents = {1: None, 2: 1, 3: 1, 4: 2, 5: 2}
    distances = [tree_distance(parents, a, b) for a, b in ((4, 4), (4, 2), (4, 5), (4, 3), (1, 5))]
    assert distances == [0, 1, 2, 3, 2]

    def located(part: int) -> Answer:
        found = Explanation("stenosis", 0.9, 0, Location(part), amplitude=0.2, amplitude_sd=0.01)
        return replace(answer([found, Explanation("no-gap", 0.1, 1)]), parents=parents)

    there = truth("listed", "stenosis", TrueEffect("stenosis", Location(4), 0.2))
    near = located(2)
    found = score_case(there, near)
    assert (found.distance, found.amplitude) == (1, None)
    exact = located(4)
    found = score_case(there, exact)
    assert (found.distance, found.amplitude, found.amplitude_covered) == (0, 0.2, True)


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


def test_summary_counts_failures_and_rates() -> None:
    listed = truth("listed", "taper", TAPER)
    cases = [score_case(listed, answer(FOUR)), score_case(listed, None)]
    cases.append(score_case(truth("none", "no-gap", before=0.0), answer(FOUR)))
    found = assemble(cases, by=("gap",), gap_edges=(0.0, 0.4, 0.65, math.inf))
    s = found.summary
    assert (s["n"], s["failed"]) == (3, 1)
    assert s["effect_or_group_first"]["share"] == pytest.approx(0.5)
    assert s["false_alarms"]["count"] == 1
    assert s["group_log_score"] == pytest.approx((math.log(0.8) + math.log(0.15)) / 2)
    assert s["effect_or_group_first"]["low"] == pytest.approx(0.0945, abs=1e-3)  # Wilson, 1 of 2
    assert found.confusion == {"taper": {"minor-losses": 1, "failed": 1}, "no-gap": {"minor-losses": 1}}
    assert list(found.by["gap"]) == ["no effect", "0.4 to 0.65"]
    assert found.reliability[0].n == 2
    json.dumps(found.record(), allow_nan=False)


def test_wilson_interval_against_its_equation() -> None:
    """The limits p solve (share - p)^2 = z^2 p (1 - p)/n."""
    for count, n in ((0, 7), (3, 10), (38, 40), (12, 12)):
        for p in Rate(count, n).interval:
            assert (count / n - p) ** 2 == pytest.approx(1.959964**2 * p * (1 - p) / n, rel=1e-5, abs=1e-12)
    assert all(math.isnan(x) for x in Rate(0, 0).interval)


def test_an_answer_is_what_the_file_says() -> None:
    file = read_diagnosis(ANSWERS / "case-101")
    found = as_answer(file, {2: 1, 1: None})
    assert as_answer(found) is found
    content = json.loads((ANSWERS / "case-101" / "diagnosis.json").read_text())
    assert [e.name for e in found.explanations] == [h["name"] for h in content["hypotheses"]]
    assert [e.location.part for e in found.explanations] == [h["place"] for h in content["hypotheses"]]
    assert found.gap_after == Size(content["gap"]["after_mmHg"], *content["gap"]["after_interval_mmHg"])
    assert found.gap_before == Size(content["gap"]["before_mmHg"], *content["gap"]["before_interval_mmHg"])
    assert found.checksum == content["study_checksum"]
    assert found.seconds == content["record"]["screening_seconds"]
    assert sum(found.group_probabilities.values()) == pytest.approx(1.0, abs=1e-6)
    assert found.parents == {2: 1, 1: None}


# -- folders -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Weighing:
    """A case that is a file with a number, withheld in it a factor of 2."""

    name: str


def weigh(job: Weighing) -> MadeCase:
    files = {"weight.txt": "2" if job.name == "b" else "1"}
    return MadeCase({"case": job.name, "doubled": job.name == "b"}, files)


@dataclass(frozen=True)
class Scales:
    marker: str = "weight.txt"
    result: str = "answer.txt"

    def answered(self, case: Path, answer: Path) -> bool:
        return (answer / self.result).is_file()

    def diagnose(self, case: Path, answer: Path) -> None:
        value = float((case / self.marker).read_text())
        if case.name == "c":
            raise RuntimeError("the scales\n are broken")
        (answer / self.result).write_text("doubled" if value > 1.5 else "no-gap")


def test_folders_from_key_to_answers(tmp_path: Path) -> None:
    cases, key, answers = tmp_path / "cases", tmp_path / "key.json", tmp_path / "answers"
    jobs = [Weighing(name) for name in "abc"]
    write_cases(cases, key, jobs, weigh, head={"secret": "d"}, totals=lambda entries: {"n": len(entries)})
    assert json.loads(key.read_text())["n"] == 3
    (cases / "b" / "weight.txt").unlink()
    write_cases(cases, key, jobs, weigh, head={"secret": "d"})  # what was lost is made again
    assert (cases / "b" / "weight.txt").read_text() == "2"
    ran = run_folders(cases, answers, Scales())
    assert (ran.diagnosed, ran.kept, ran.failed) == (("a", "b"), (), {"c": "the scales are broken"})
    assert run_folders(cases, answers, Scales()).kept == ("a", "b")
    keys = [
        CaseKey(e["case"], "listed" if e["doubled"] else "none", "doubled" if e["doubled"] else "no-gap")
        for e in read_sealed(key, answers)
    ]
    found, others = read_answers(
        answers, keys, lambda f: Answer.ranked({(f / "answer.txt").read_text(): 1.0}), result="answer.txt"
    )
    assert {name: a and a.explanations[0].name for name, a in found.items()} == {
        "a": "no-gap", "b": "doubled", "c": None
    }  # fmt: skip
    assert others == 0
    key.write_text(key.read_text().replace("true", "false"))
    with pytest.raises(BlindError, match="not the key of these cases"):
        read_sealed(key, answers)


# -- any simulator -----------------------------------------------------------------------------------

TIME = np.linspace(0.0, 1.0, 50)
COUNTS = {"slope": 15, "offset": 15, "no-gap": 5, "spike": 5}
SHAPES = {"slope": TIME - 0.5, "offset": np.ones(50)}


def line(label: str, rng: np.random.Generator) -> DrawnCase:
    size = rng.uniform(0.5, 1.5)
    shape = SHAPES.get(label, 5.0 * (TIME == TIME[20]) if label == "spike" else 0.0 * TIME)
    data = size * shape + 0.05 * rng.standard_normal(50)
    return DrawnCase(data, size if label in SHAPES else None, noise=0.05, before=float(np.std(size * shape)))


def fits(data: Any) -> Answer:
    """Least squares with each shape; what has most of the sum of squares has the probability."""
    total = float(data @ data)
    size = {name: float(data @ shape / (shape @ shape)) for name, shape in SHAPES.items()}
    left = {name: total - x**2 * float(SHAPES[name] @ SHAPES[name]) for name, x in size.items()}
    name = min(left, key=lambda n: left[n])
    explained = Explanation(name, 0.9, amplitude=size[name], amplitude_sd=0.05)
    rest = [Explanation(n, 0.02) for n in (*SHAPES, "no-gap", "unlisted") if n != name]
    quiet = total < 50 * 0.1**2
    if quiet or left[name] > 50 * 0.1**2:
        first = "no-gap" if quiet else "unlisted"
        explained, rest = Explanation(first, 0.9), [Explanation(n, 0.03) for n in (*SHAPES, "unlisted")]
    return Answer((explained, *rest))


def test_check_of_a_simulator_of_ones_own() -> None:
    told: list[str] = []
    found = check(line, fits, COUNTS, listed=tuple(SHAPES), seed=3, done=told.append)
    s = found.summary
    assert (s["n"], s["failed"], len(told)) == (40, 0, 40)
    assert (s["effect_first"]["count"], s["effect_first"]["n"]) == (30, 30)
    assert (s["false_alarms"]["count"], s["false_alarms"]["n"]) == (0, 5)
    assert (s["outside_called_unlisted"]["count"], s["outside_called_unlisted"]["n"]) == (5, 5)
    assert s["amplitude_interval_holds_truth"]["n"] == 30
    assert s["amplitude_ratio_median"] == pytest.approx(1.0, abs=0.05)
    assert found.confusion["spike"] == {"unlisted": 5}
    assert "outside cases called unlisted" in str(found)
    assert "place" not in str(found)
    assert "| effect | cases |" in score_table(found)
    again = check(line, fits, COUNTS, listed=tuple(SHAPES), seed=3)
    assert again.record() == found.record()


def test_a_diagnosis_that_always_blames_one_effect_scores_as_that() -> None:
    found = check(
        line, lambda data: Answer.ranked({"slope": 0.9, "no-gap": 0.1}), COUNTS, listed=list(SHAPES)
    )
    s = found.summary
    assert s["effect_first"]["share"] == 0.5
    assert s["false_alarms"]["share"] == 1.0
    assert s["outside_called_unlisted"]["share"] == 0.0
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

    found = check(line, sometimes, COUNTS, listed=tuple(SHAPES))
    assert set(found.failed.values()) == {"RuntimeError: too large"}
    assert found.summary["failed"] == len(found.failed) == 5

    def never(data: Any) -> Answer:
        raise KeyError("pressure")

    with pytest.raises(BlindError, match="no case could be diagnosed; the first: KeyError"):
        check(line, never, {"slope": 2}, listed=tuple(SHAPES))


@pytest.mark.parametrize("counts", [{}, {"slope": 0}, {"slope": -1, "offset": 3}, {"unlisted": 2}])
def test_check_refuses(counts: dict[str, int]) -> None:
    with pytest.raises(BlindError):
        check(line, fits, counts, listed=tuple(SHAPES))


def test_a_score_is_written(tmp_path: Path) -> None:
    write_score(check(line, fits, COUNTS, listed=tuple(SHAPES)), tmp_path / "score")
    record = json.loads((tmp_path / "score" / "score.json").read_text())
    assert len(record["cases"]) == 40
    assert (tmp_path / "score" / "cases.csv").read_text().count("\n") == 41
    assert (tmp_path / "score" / "score.md").read_text().startswith("40 cases, 0 without an answer.")


def test_the_example_gives_what_it_shows() -> None:
    found = doctest.testmod(sys.modules[check.__module__])
    assert (found.attempted > 0, found.failed) == (True, 0)
