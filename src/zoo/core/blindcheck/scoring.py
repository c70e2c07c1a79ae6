"""How near answers are to their keys: proper scores without a floor, each beside the best constant answer.

An answer is asked four questions (`QUESTIONS`), each about events of which any number may be true. Its log
score is the sum over the events of log p, p the probability of what is so; its Brier score the sum of
(1 - p)^2.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import binom, binomtest

from zoo.core.blindcheck.cases import NULL, Answer, CaseKey, Group

CONSTANT = "best constant answer"
HALVES = (
    ("parameter", "95 % interval of the effect's parameter holds the true one"),
    ("gap", "95 % interval of the gap holds the true one"),
    ("left", "95 % interval of what the leading causes leave holds it"),
)
QUESTIONS = {
    "components": "components that are wrong",
    "nothing": "that nothing is wrong",
    "effects": "listed effects, where one is true",
    "groups": "listed effects, alike ones as one",
}
BIN_EDGES = (0.0, 0.01, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0)
"""Of the reliability of stated probabilities."""
FULL_BIN = 8
"""Events from which a bin of it counts."""
SURE = 0.9
UNLIKELY = 1e-6
"""What is so and has less probability is named: one of 0 makes the log score -inf."""


@dataclass(frozen=True)
class Rate:
    """A count out of n, its share, and the 95 % interval of Wilson; NaN of nothing."""

    count: int
    n: int

    @classmethod
    def of(cls, flags: Iterable[bool | None]) -> Rate:
        """Of the flags that are not None."""
        given = [flag for flag in flags if flag is not None]
        return cls(sum(given), len(given))

    @property
    def share(self) -> float:
        """count/n."""
        return self.count / self.n if self.n else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Of the share (Wilson 1927, doi 10.1080/01621459.1927.10502953)."""
        if not self.n:
            return math.nan, math.nan
        found = binomtest(self.count, self.n).proportion_ci(0.95, method="wilson")
        return float(found.low), float(found.high)

    def __str__(self) -> str:
        if not self.n:
            return "–"
        low, high = self.interval
        return f"{100 * self.share:.0f} % ({self.count} of {self.n}; {100 * low:.0f} to {100 * high:.0f} %)"


@dataclass(frozen=True)
class Mean:
    """A mean over n cases with its standard error, NaN of less than two; -inf if one is.

    `others` is the mean of the finite ones, of which `lost` are not.
    """

    mean: float
    error: float
    n: int
    others: float
    lost: int

    @classmethod
    def of(cls, values: Iterable[float]) -> Mean:
        """Of values."""
        x = np.array([v for v in values if not math.isnan(v)])
        ends = {v for v in x.tolist() if math.isinf(v)}
        finite = x[np.isfinite(x)]
        others = float(finite.mean()) if len(finite) else math.nan
        error = float(finite.std(ddof=1)) / math.sqrt(len(finite)) if len(finite) > 1 else math.nan
        lost = len(x) - len(finite)
        mean = ends.pop() if len(ends) == 1 else math.nan if ends else others
        return cls(mean, error, len(x), others, lost)

    def text(self, sign: str = "") -> str:
        """The mean with its error; of those that are finite beside it."""
        error = "" if math.isnan(self.error) else f" ± {self.error:.3f}"
        if not self.n:
            return "–"
        if not self.lost:
            return f"{self.mean:{sign}.3f}{error}"
        return f"{self.mean:{sign}.3f} ({self.lost} of {self.n}; the others {self.others:{sign}.3f}{error})"


@dataclass(frozen=True)
class ReliabilityBin:
    """Stated probabilities of one bin: how many came true, and the 95 % range if they are what they say."""

    low: float
    high: float
    n: int
    right: int
    stated: float
    band: tuple[int, int]

    @property
    def inside(self) -> bool:
        """Whether the count lies in the range."""
        return self.band[0] <= self.right <= self.band[1]


def reliability(stated: Sequence[float], right: Sequence[bool]) -> list[ReliabilityBin]:
    """Stated probabilities against how often they came true, by the bins of `BIN_EDGES` that hold any.

    Parameters
    ----------
    stated : sequence of float
    right : sequence of bool

    Returns
    -------
    list of ReliabilityBin
        A bin begins at its lower edge; the last one holds its upper edge, too. The range is
        that of a binomial count with the bin's mean stated probability.
    """
    p, hits = np.clip(np.asarray(stated, dtype=float), 0, 1), np.asarray(right, dtype=bool)
    at = np.clip(np.searchsorted(BIN_EDGES, p, side="right") - 1, 0, len(BIN_EDGES) - 2)
    found = []
    for i, (low, high) in enumerate(pairwise(BIN_EDGES)):
        inside = at == i
        n = int(inside.sum())
        if n:
            mean = float(p[inside].mean())
            least, most = (int(x) for x in binom.interval(0.95, n, mean))
            found.append(ReliabilityBin(low, high, n, int(hits[inside].sum()), mean, (max(least, 0), most)))
    return found


@dataclass(frozen=True)
class Event:
    """Something that is so or not: the names of which any may be true, the stated probability, the truth."""

    names: tuple[str, ...]
    p: float
    true: bool

    @property
    def so(self) -> float:
        """The probability of what is so."""
        p = min(max(self.p, 0.0), 1.0)
        return p if self.true else 1.0 - p


def log_score(events: Iterable[Event]) -> float:
    """Sum of the log probabilities of what is so; -inf where one was impossible."""
    return math.fsum(math.log(x) if x else -math.inf for x in (one.so for one in events))


def brier_score(events: Iterable[Event]) -> float:
    """Sum of the squares of the probabilities of what is not so."""
    return math.fsum((1.0 - one.so) ** 2 for one in events)


def asked(key: CaseKey, answer: Answer) -> dict[str, tuple[Event, ...]]:
    """The events of each question that a case asks."""
    found = {
        "components": tuple(
            Event((name,), answer.components.get(name, 0.0), name in key.wrong)
            for name in dict.fromkeys((*answer.components, *key.wrong))
        ),
        "nothing": (Event((NULL,), answer.nothing, not key.wrong),),
    }
    if key.effects and answer.effects:
        names = tuple(dict.fromkeys((*answer.effects, *key.effects)))
        alone = set(names).difference(*(one.names for one in answer.groups))
        singles = [Group(names=(n,), probability=answer.effects.get(n, 0.0)) for n in names if n in alone]
        right = set(key.effects)
        found["effects"] = tuple(Event((n,), answer.effects.get(n, 0.0), n in right) for n in names)
        found["groups"] = tuple(
            Event(one.names, one.probability, bool(right & set(one.names)))
            for one in (*answer.groups, *singles)
        )
    return found


Row = dict[str, Any]
COLUMNS = (
    *("case", "kind", "label", "right", "gap_over_noise", "noise", "answered", "leader", "stated", "first"),
    *("false_alarm", "sure", "sure_right"),
    *(f"{question}_{score}" for question in QUESTIONS for score in ("log", "brier")),
    *("true_parameter", "parameter_mean", "parameter_low", "parameter_high", "prior_low", "prior_high"),
    *("true_gap", "gap_mean", "gap_low", "gap_high", "true_left", "left_mean", "left_low", "left_high"),
    *("alone", "alone_inside", "averaged", "averaged_inside", "wider"),
    *("seconds", "events"),
)
"""Of a case's row, before its tags.

`right` are the components that are wrong, "no-gap" where none is; `leader` is the most probable of
components and "no-gap", `stated` its probability, `first` whether it is right. `false_alarm` says, without a
cause, whether a component has more than half; `sure` counts components above 0.9, `sure_right` those of them
that are wrong indeed. Scores are None where a question is not asked. The parameter is that of the true
effect; `gap` is what the baseline leaves, `left` what the leading causes leave. Where something is wrong,
`alone` and `averaged` count the baseline's parameters whose true value is known, `_inside` those of them
whose 95 % interval holds it, of the baseline by itself and over all sets of causes; `wider` is the median of
the latter's width over the former's.
"""


def score_case(key: CaseKey, answer: Answer | None) -> Row:
    """Score one answer.

    Parameters
    ----------
    key : CaseKey
    answer : Answer or None
        None where the diagnosis failed.

    Returns
    -------
    dict
        By `COLUMNS` and the key's tags.
    """
    right = key.wrong or (NULL,)
    row: Row = {**dict.fromkeys(COLUMNS), **key.tags}
    row |= {"case": key.case, "kind": key.kind, "label": key.label, "right": right, "noise": key.noise}
    row |= {"answered": answer is not None, "leader": "", "first": False, "sure": 0, "sure_right": 0}
    row |= {"events": {}, "false_alarm": False if right == (NULL,) else None}
    if key.gap is not None and key.noise:
        row["gap_over_noise"] = key.gap / key.noise
    if answer is None:
        return row
    events = asked(key, answer)
    for question, own in events.items():
        row |= {f"{question}_log": log_score(own), f"{question}_brier": brier_score(own)}
    stated = {NULL: answer.nothing, **answer.components}
    leader = max(stated, key=lambda name: stated[name])
    sure = [name for name, p in answer.components.items() if p > SURE]
    if right == (NULL,):
        row["false_alarm"] = any(p > 0.5 for p in answer.components.values())
    row |= {"events": events, "leader": leader, "stated": stated[leader], "first": leader in right}
    row |= {"sure": len(sure), "sure_right": sum(name in right for name in sure), "seconds": answer.seconds}
    return row | _sizes(key, answer)


def _sizes(key: CaseKey, answer: Answer) -> Row:
    """What is stated of sizes, and what is true of them."""
    found: Row = {}
    stated = answer.sizes.get(key.label)
    if key.parameter is not None and stated:
        low, high = key.prior_95 or (None, None)
        found = {"true_parameter": key.parameter, "prior_low": low, "prior_high": high}
        found |= _columns("parameter", stated)
    true = answer.fitted.left(key.truth) if answer.fitted and key.truth else (None, None)
    for name, size, left in (("gap", answer.gap, true[0]), ("left", answer.left, true[1])):
        left = left if size is None or size.true is None else size.true
        if size and left is not None:
            found |= {f"true_{name}": left, **_columns(name, size)}
    if key.wrong and (known := key.parameters.keys() & answer.alone.keys() & answer.averaged.keys()):
        both = [(answer.alone[name], answer.averaged[name], key.parameters[name]) for name in sorted(known)]
        found |= {"alone": len(both), "averaged": len(both)}
        found["alone_inside"] = sum(one.low <= true <= one.high for one, _, true in both)
        found["averaged_inside"] = sum(one.low <= true <= one.high for _, one, true in both)
        widths = ((one.high - one.low, other.high - other.low) for one, other, _ in both)
        found["wider"] = _median(after / before for before, after in widths if before > 0.0)
    return found


def _columns(name: str, size: Any) -> dict[str, float]:
    return {f"{name}_{x}": getattr(size, x) for x in ("mean", "low", "high")}


@dataclass(frozen=True)
class Asked:
    """Scores of some cases in one question, beside the base rates of these cases given to each alike.

    `unlikely` are the cases, events and probabilities of what is so and was given less than `UNLIKELY`;
    `likely` is the log score of the cases without such an event.
    """

    log: Mean
    likely: Mean
    brier: Mean
    constant_log: float
    constant_brier: float
    unlikely: tuple[tuple[str, str, float], ...]

    def log_text(self) -> str:
        """The log score; where something was all but impossible, in how many cases, and of the others."""
        if not self.unlikely:
            return self.log.text()
        lost = f"{self.log.n - self.likely.n} of {self.log.n} below 1e-6; the others {self.likely.text()}"
        return f"{self.log.mean:.3f} ({lost})"


def ask(cases: Sequence[Row], question: str) -> Asked | None:
    """Scores of the cases that are asked a question; None where none is."""
    given = [row for row in cases if question in row["events"]]
    if not given:
        return None
    events: list[tuple[Event, ...]] = [row["events"][question] for row in given]
    single = "effects" if question == "groups" else question
    true = Counter(n for row in given for one in row["events"][single] if one.true for n in one.names)
    flat = [
        [Event(e.names, sum(true[name] for name in e.names) / len(given), e.true) for e in own]
        for own in events
    ]
    unlikely = tuple(
        (row["case"], f"{'' if e.true else 'not '}{' or '.join(e.names)}", e.so)
        for row, own in zip(given, events, strict=True)
        for e in own
        if e.so < UNLIKELY
    )
    lost = {case for case, _, _ in unlikely}
    return Asked(
        Mean.of(row[f"{question}_log"] for row in given),
        Mean.of(row[f"{question}_log"] for row in given if row["case"] not in lost),
        Mean.of(row[f"{question}_brier"] for row in given),
        float(np.mean([log_score(own) for own in flat])),
        float(np.mean([brier_score(own) for own in flat])),
        unlikely,
    )


def _median(values: Iterable[float]) -> float:
    given = list(values)
    return float(np.median(given)) if given else math.nan


def _with(cases: Sequence[Row], *columns: str) -> list[Row]:
    return [row for row in cases if all(row[name] is not None for name in columns)]


def _inside(cases: Sequence[Row], low: str, true: str, high: str) -> Rate:
    return Rate.of(row[low] <= row[true] <= row[high] for row in cases)


def summarise(cases: Sequence[Row]) -> dict[str, Any]:
    """Rates and mean scores of some cases, and those of the best constant answers.

    Parameters
    ----------
    cases : sequence of dict
        Of `score_case`.

    Returns
    -------
    dict
        docs/blind.md says what each is; "constant" has the best constant answer by the same names.
    """
    commonest = Counter(name for row in cases for name in row["right"]).most_common(1)
    always = commonest[0][0] if commonest else ""
    sized, left = _with(cases, "parameter_mean"), _with(cases, "true_left")
    known, gaps = _with(sized, "prior_low"), _with(cases, "true_gap")
    told = _with(cases, "averaged")
    both = [row for row in _with(left, "true_gap") if row["true_gap"] and row["gap_mean"]]
    return {
        "n": len(cases),
        "failed": sum(not row["answered"] for row in cases),
        "questions": {q: found for q in QUESTIONS if (found := ask(cases, q))},
        "first": Rate.of(row["first"] for row in cases),
        "false_alarms": Rate.of(row["false_alarm"] for row in cases),
        "sure": Rate(sum(row["sure_right"] for row in cases), sum(row["sure"] for row in cases)),
        "parameter": _inside(sized, "parameter_low", "true_parameter", "parameter_high"),
        "parameter_width": _median(
            (row["parameter_high"] - row["parameter_low"]) / (row["prior_high"] - row["prior_low"])
            for row in known
        ),
        "gap": _inside(gaps, "gap_low", "true_gap", "gap_high"),
        "left": _inside(left, "left_low", "true_left", "left_high"),
        "left_error": _median(abs(row["left_mean"] - row["true_left"]) for row in left),
        "removed": _median(1 - row["left_mean"] / row["gap_mean"] for row in both),
        "true_removed": _median(1 - row["true_left"] / row["true_gap"] for row in both),
        "alone": Rate(sum(row["alone_inside"] for row in told), sum(row["alone"] for row in told)),
        "averaged": Rate(sum(row["averaged_inside"] for row in told), sum(row["averaged"] for row in told)),
        "wider": _median(row["wider"] for row in told),
        "seconds": _median(row["seconds"] for row in _with(cases, "seconds")),
        "constant": {
            "always": always,
            "first": Rate.of(always in row["right"] for row in cases),
            "parameter": _inside(known, "prior_low", "true_parameter", "prior_high"),
        },
    }


@dataclass(frozen=True)
class Score:
    """Score of a set of answers.

    Attributes
    ----------
    cases : tuple of dict
        Of `score_case`.
    summary : dict
        Of all cases, as of `summarise`.
    by : dict
        What it is grouped by -> value -> summary.
    reliability : dict
        Question -> list of ReliabilityBin, over all its events.
    without_key : int
        Answers that the key says nothing about.
    failed : mapping
        Case without an answer -> reason, where it is known.
    """

    cases: tuple[Row, ...]
    summary: dict[str, Any]
    by: dict[str, dict[str, dict[str, Any]]]
    reliability: dict[str, list[ReliabilityBin]]
    without_key: int = 0
    failed: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return score_text(self)


def summary_rows(s: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """A summary in words: what, its figure, that of the best constant answer."""
    best = s["constant"]
    always = f"{100 * best['first'].share:.0f} % (always {best['always']})"
    rows = []
    for question, one in s["questions"].items():
        words = QUESTIONS[question]
        rows.append((f"{words}: log score", one.log_text(), f"{one.constant_log:.3f}"))
        rows.append((f"{words}: Brier score", one.brier.text(), f"{one.constant_brier:.3f}"))
    rows.append(("most probable is right, a component or nothing", str(s["first"]), always))
    if s["false_alarms"].n:
        rows.append(("nothing wrong, and a component above 50 %", str(s["false_alarms"]), "0 %"))
    if s["sure"].n:
        rows.append(("components above 90 % that are wrong indeed", str(s["sure"]), "–"))
    for name, words in HALVES:
        if s[name].n:
            prior = best["parameter"] if name == "parameter" else Rate(0, 0)
            rows.append((words, str(s[name]), f"{100 * prior.share:.0f} % (the prior's)" if prior.n else "–"))
    if s["averaged"].n:
        words = "95 % interval of a baseline's parameter holds the true one"
        rows.append((words, str(s["averaged"]), f"{100 * s['alone'].share:.0f} % (by itself)"))
        rows.append(("width of these over those by itself, median", f"{s['wider']:.2f}", "1"))
    if not math.isnan(s["parameter_width"]):
        rows.append(("width of the parameter's over the prior's, median", f"{s['parameter_width']:.3f}", "1"))
    if s["left"].n:
        rows.append(("error of what the leading causes leave, median", f"{s['left_error']:.3g}", "–"))
    if not math.isnan(s["removed"]):
        text = f"{s['removed']:.3f} (true {s['true_removed']:.3f})"
        rows.append(("part of the gap that they remove, median", text, "0"))
    return rows


def score_text(score: Score) -> str:
    """The score beside the best constant answers, a line each."""
    s = score.summary
    rows = summary_rows(s)
    wide, middle = (max(len(row[i]) for row in rows) for i in (0, 1))
    title = f"{s['n']} cases, {s['failed']} without an answer"
    lines = [f"{title:<{wide + middle + 4}}  {CONSTANT}".rstrip()]
    return "\n".join(lines + [f"{a:<{wide}}  {b:<{middle}}  {c}" for a, b, c in rows])


def grouped(cases: Sequence[Row], name: str) -> dict[str, list[Row]]:
    """Rows by the value of a column, in its order."""
    found: dict[str, list[Row]] = {}
    for value in sorted({str(row[name]) for row in cases}):
        found[value] = [row for row in cases if str(row[name]) == value]
    return found


def score_answers(
    keys: Sequence[CaseKey],
    answers: Mapping[str, Answer | None],
    *,
    by: Sequence[str] = ("kind",),
    without_key: int = 0,
    failed: Mapping[str, str] | None = None,
) -> Score:
    """Score answers against their keys.

    Parameters
    ----------
    keys : sequence of CaseKey
    answers : mapping
        Case -> its answer; None (or nothing) where the diagnosis failed.
    by : sequence of str
        What to group by: "kind", "label" and tags that all cases have.
    without_key, failed
        As in `Score`.

    Returns
    -------
    Score
    """
    cases = tuple(score_case(key, answers.get(key.case)) for key in keys)
    bins = {}
    for question in QUESTIONS:
        events = [e for row in cases for e in row["events"].get(question, ())]
        if events:
            bins[question] = reliability([e.p for e in events], [e.true for e in events])
    summaries = {name: {value: summarise(own) for value, own in grouped(cases, name).items()} for name in by}
    return Score(cases, summarise(cases), summaries, bins, without_key, failed or {})


def paired(
    now: Score, then: Score, name: str = "kind"
) -> dict[str, dict[str, tuple[Asked, Asked, Mean, Mean]]]:
    """Scores of the cases that both answered, and differences of log and Brier scores, now minus then.

    Returns
    -------
    dict
        Value of the column `name`, or "all" -> question -> (now, then, log score, Brier score). The
        difference of two log scores is infinite where one is.
    """
    former = {row["case"]: row for row in then.cases}
    rows = [row for row in now.cases if row["case"] in former]
    found: dict[str, dict[str, tuple[Asked, Asked, Mean, Mean]]] = {}
    for value, own in {**grouped(rows, name), "all": rows}.items():
        found[value] = {}
        for question in QUESTIONS:
            a = [
                row for row in own if question in row["events"] and question in former[row["case"]]["events"]
            ]
            b = [former[row["case"]] for row in a]
            one, other = ask(a, question), ask(b, question)
            if one and other:
                log, brier = (
                    Mean.of(
                        _minus(x[f"{question}_{s}"], y[f"{question}_{s}"]) for x, y in zip(a, b, strict=True)
                    )
                    for s in ("log", "brier")
                )
                found[value][question] = (one, other, log, brier)
    return found


def _minus(x: float, y: float) -> float:
    """A difference; infinite where either is."""
    return x - y if math.isfinite(x) and math.isfinite(y) else math.copysign(math.inf, (x > y) - 0.5)
