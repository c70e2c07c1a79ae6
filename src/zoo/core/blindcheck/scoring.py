"""How near answers are to their keys: proper scores without a floor, each beside the best constant answer."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binom, binomtest

from zoo.core.blindcheck.cases import Answer, CaseKey, Explanation, Size
from zoo.core.diagnosis.hypothesis import NONPARAMETRIC

BIN_EDGES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 0.97, 1.0)
"""Of the reliability of stated probabilities."""
FULL_BIN = 8
"""Cases from which a bin of it counts."""
SURE = 0.9
IMPOSSIBLE = 1e-6
"""A truth of less probability is named: one of 0 makes the log score -inf."""
ROUNDS = 2000


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


COLUMNS = (
    *("case", "kind", "label", "right", "gap_over_noise", "noise", "answered", "leader", "stated"),
    *("group_size", "rank", "first", "group_first", "probability", "log_score", "brier", "false_alarm"),
    *("true_parameter", "true_left", "seconds", "parameter_mean", "parameter_low", "parameter_high"),
    *("left_mean", "left_low", "left_high", "prior_low", "prior_high"),
)
"""Of the table of cases, before its tags.

`right` is what may be named, `leader` what is ranked first, `stated` the probability of its group; `rank`
that of the best-placed group which holds what is true, `probability` that of what is true. `first` and
`group_first` say whether what is true, or its group, is ranked first. The parameter is that of the true
effect at the true location, whatever leads; `left` is the discrepancy that the leading effect leaves.
Scores are None without an answer, `false_alarm` where there is an effect.
"""


def score_case(key: CaseKey, answer: Answer | None, *, by_component: bool = False) -> dict[str, Any] | None:
    """Score one answer.

    Parameters
    ----------
    key : CaseKey
    answer : Answer or None
        None where the diagnosis failed.
    by_component : bool
        Ask for the component of every cause, listed effects too; else only where no explanation is right.

    Returns
    -------
    dict or None
        A row of the table of cases, by `COLUMNS` and the key's tags; None where the case cannot be asked for
        so: it has no component.
    """
    listed = answer.explanations if answer else ()
    right = key.accepted
    if by_component or not right:
        right = key.components or tuple(name for name in right if key.kind == "none")
        listed = answer.by_component() if answer else ()
        if by_component and not right:
            return None
        if answer and not answer.components and not by_component:
            right, listed = (NONPARAMETRIC,), answer.explanations  # a diagnosis that knows no components
    noise = math.nan if key.noise is None else key.noise
    ratio = math.nan if key.gap is None or not key.noise else key.gap / key.noise
    row: dict[str, Any] = dict.fromkeys((*COLUMNS, *key.tags)) | key.tags
    row |= {"case": key.case, "kind": key.kind, "label": key.label, "right": right, "noise": noise}
    row |= {"gap_over_noise": ratio, "answered": False, "leader": "", "stated": 0.0, "group_size": 0}
    row |= {"first": False, "group_first": False, "probability": 0.0}
    row["false_alarm"] = False if key.kind == "none" else None
    if answer is None or not listed:
        return row
    groups = [(i,) if e.group is None else e.group for i, e in enumerate(listed)]
    total: dict[Any, float] = {}
    for group, e in zip(groups, listed, strict=True):
        total[group] = total.get(group, 0.0) + e.probability
    true = {group for group, e in zip(groups, listed, strict=True) if e.name in right}
    p = min(1.0, sum(e.probability for e in listed if e.name in right))
    others = sum(e.probability**2 for e in listed if e.name not in right)
    ranks = [i + 1 for i, group in enumerate(total) if group in true]
    return row | {
        "answered": True,
        "leader": listed[0].name,
        "stated": min(1.0, total[groups[0]]),
        "group_size": groups.count(groups[0]),
        "rank": min(ranks, default=len(total) + 1),
        "first": listed[0].name in right,
        "group_first": groups[0] in true,
        "probability": p,
        "log_score": math.log(p) if p else -math.inf,
        "brier": (p - 1) ** 2 + others,
        "false_alarm": groups[0] not in true if key.kind == "none" else None,
        "seconds": answer.seconds,
        **_sizes(key, answer),
    }


def _sizes(key: CaseKey, answer: Answer) -> dict[str, Any]:
    """What is stated of sizes, and what is true of them."""
    found: dict[str, Any] = {}
    where = (key.label, key.place, key.subtree)
    stated: Explanation | None = next(
        (e for e in answer.explanations if (e.name, e.place, e.subtree) == where), None
    )
    if key.parameter is not None and stated and stated.parameter:
        low, high = key.prior_95 or (None, None)
        found = {"true_parameter": key.parameter, "prior_low": low, "prior_high": high}
        found |= _columns("parameter", stated.parameter)
    left = None if answer.left is None else answer.left.true
    if answer.left and left is None and answer.fitted and key.truth:
        left = answer.fitted.left(key.truth)[1]
    if answer.left and left is not None:
        found |= {"true_left": left, **_columns("left", answer.left)}
    return found


def _columns(name: str, size: Size) -> dict[str, float]:
    return {f"{name}_{x}": getattr(size, x) for x in ("mean", "low", "high")}


def constant_shares(rights: Sequence[Sequence[str]]) -> dict[str, float]:
    """The probabilities that, given to every case alike, have the best log score.

    Where one name is right in each case they are the frequencies; where several are, the fixed point of
    expectation and maximisation.

    Parameters
    ----------
    rights : sequence of sequence of str
        What is right in each case.
    """
    names = sorted({name for right in rights for name in right})
    member = np.array([[name in right for name in names] for right in rights], dtype=float)
    shares = np.full(len(names), 1 / max(1, len(names)))
    for _ in range(ROUNDS if rights else 0):
        weight = member * shares
        shares = (weight / weight.sum(axis=1, keepdims=True)).mean(axis=0)
    return dict(zip(names, shares.tolist(), strict=True))


def _mean(values: Iterable[float]) -> float:
    given = list(values)
    return float(np.mean(given)) if given else math.nan


def _median(values: pd.Series) -> float:
    return float(np.median(values.astype(float))) if len(values) else math.nan


def summarise(cases: pd.DataFrame) -> dict[str, Any]:
    """Rates and mean scores of some cases, and those of the best constant answers.

    Parameters
    ----------
    cases : pandas.DataFrame
        A row for each case, as of `score_case`.

    Returns
    -------
    dict
        docs/blind.md says what each is; "constant" has the best constant answer by the same names.
    """
    given = cases[cases["answered"].astype(bool)]
    shares = constant_shares(given["right"].tolist())
    commonest = Counter(name for right in cases["right"] for name in right).most_common(1)
    always = commonest[0][0] if commonest else ""
    p = [sum(shares[name] for name in right) for right in given["right"]]
    squares = sum(x**2 for x in shares.values())
    sure, rare = given[given["stated"] > SURE], given["probability"] < IMPOSSIBLE
    sized, left = cases[cases["parameter_mean"].notna()], cases[cases["true_left"].notna()]
    known = sized[sized["prior_low"].notna()]
    middle = _median(left["true_left"])
    hit = Rate.of(always in right for right in cases["right"])
    return {
        "n": len(cases),
        "failed": len(cases) - len(given),
        "log_score": _mean(given["log_score"]),
        "log_score_of_possible": _mean(given["log_score"][~rare]),
        "impossible": given["case"][rare].tolist(),
        "brier": _mean(given["brier"]),
        "first": Rate.of(cases["first"]),
        "group_first": Rate.of(cases["group_first"]),
        "mean_rank": _mean(given["rank"]),
        "group_size": _mean(given["group_size"]),
        "false_alarms": Rate.of(cases["false_alarm"]),
        "sure": Rate.of(sure["group_first"]),
        "sure_stated": _mean(sure["stated"]),
        "parameter": _inside(sized, "parameter_low", "true_parameter", "parameter_high"),
        "parameter_width": _median(
            (known["parameter_high"] - known["parameter_low"]) / (known["prior_high"] - known["prior_low"])
        ),
        "left": _inside(left, "left_low", "true_left", "left_high"),
        "left_error": _median((left["left_mean"] - left["true_left"]).abs()),
        "seconds": _median(given["seconds"].dropna()),
        "constant": {
            "always": always,
            "shares": shares,
            "log_score": _mean(math.log(x) for x in p),
            "brier": _mean(
                (x - 1) ** 2 + squares - sum(shares[n] ** 2 for n in right)
                for x, right in zip(p, given["right"], strict=True)
            ),
            "first": hit,
            "group_first": hit,
            "false_alarms": Rate(0, int(cases["false_alarm"].notna().sum())),
            "parameter": _inside(known, "prior_low", "true_parameter", "prior_high"),
            "left_error": _median((left["true_left"] - middle).abs()),
            "left": middle,
        },
    }


def _inside(cases: pd.DataFrame, low: str, true: str, high: str) -> Rate:
    return Rate.of(((cases[low] <= cases[true]) & (cases[true] <= cases[high])).tolist())


@dataclass(frozen=True)
class Score:
    """Score of a set of answers.

    Attributes
    ----------
    cases : tuple of dict
        Rows of the table of cases, as of `score_case`.
    summary : dict
        Of all cases, as of `summarise`.
    by : dict
        What it is grouped by -> value -> summary.
    reliability : list of ReliabilityBin
        Of the leading group's probability, a case each.
    components : Score or None
        The same cases asked for the component of their cause, listed effects too.
    without_key : int
        Answers that the key says nothing about.
    failed : mapping
        Case without an answer -> reason, where it is known.
    """

    cases: tuple[dict[str, Any], ...]
    summary: dict[str, Any]
    by: dict[str, dict[str, dict[str, Any]]]
    reliability: list[ReliabilityBin]
    components: Score | None = None
    without_key: int = 0
    failed: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        from zoo.core.blindcheck.tables import score_text

        return score_text(self)


def assemble(
    cases: Sequence[dict[str, Any]],
    *,
    by: Sequence[str] = ("kind",),
    components: Score | None = None,
    without_key: int = 0,
    failed: Mapping[str, str] | None = None,
) -> Score:
    """Put the scores of cases together, grouped by "kind", "label" and tags that all cases have."""
    heads = None if cases else list(dict.fromkeys((*COLUMNS, *by)))  # those of rows, of which there are none
    table = pd.DataFrame(list(cases), columns=heads, dtype=object)
    grouped = {
        name: {value: summarise(part) for value, part in table.groupby(table[name].map(str))} for name in by
    }
    told = table[table["answered"].astype(bool)]
    bins = reliability(told["stated"].tolist(), told["group_first"].tolist())
    return Score(tuple(cases), summarise(table), grouped, bins, components, without_key, failed or {})


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
    by, without_key, failed
        As in `assemble`.

    Returns
    -------
    Score
    """
    named = [score_case(key, answers.get(key.case)) for key in keys]
    parts = [score_case(key, answers.get(key.case), by_component=True) for key in keys]
    placed = [c for c in parts if c is not None]
    knows = any(a is not None and a.components for a in answers.values())
    components = assemble(placed, by=by) if placed and knows else None
    cases = [c for c in named if c is not None]
    return assemble(cases, by=by, components=components, without_key=without_key, failed=failed)
