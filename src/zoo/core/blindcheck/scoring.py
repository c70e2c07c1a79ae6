"""How near answers are to their keys: proper scores without a floor, each beside the best constant answer."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
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


def reliability(
    stated: Sequence[float], right: Sequence[bool], edges: Sequence[float] = BIN_EDGES
) -> list[ReliabilityBin]:
    """Stated probabilities against how often they came true, by bins that hold any.

    Parameters
    ----------
    stated : sequence of float
    right : sequence of bool
    edges : sequence of float
        A bin begins at its lower edge; the last one holds its upper edge, too.

    Returns
    -------
    list of ReliabilityBin
        The range is that of a binomial count with the bin's mean stated probability.
    """
    p, hits = np.clip(np.asarray(stated, dtype=float), 0, 1), np.asarray(right, dtype=bool)
    at = np.clip(np.searchsorted(edges, p, side="right") - 1, 0, len(edges) - 2)
    found = []
    for i, (low, high) in enumerate(pairwise(edges)):
        inside = at == i
        n = int(inside.sum())
        if n:
            mean = float(p[inside].mean())
            least, most = (int(x) for x in binom.interval(0.95, n, mean))
            found.append(ReliabilityBin(low, high, n, int(hits[inside].sum()), mean, (max(least, 0), most)))
    return found


@dataclass(frozen=True)
class CaseScore:
    """One case: what is true, what was answered, how near that is.

    `right` is what may be named, `leader` what is ranked first, `stated` the probability of its group; `rank`
    that of the best-placed group which holds what is true, `probability` that of what is true. `first` and
    `group_first` say whether what is true, or its group, is ranked first. The parameter is that of the true
    effect at the true location, whatever leads; `left` is the discrepancy that the leading effect leaves.
    Scores are None without an answer, `false_alarm` where there is an effect.
    """

    case: str
    kind: str
    label: str
    right: tuple[str, ...]
    tags: Mapping[str, str] = field(default_factory=dict)
    gap_over_noise: float = math.nan
    noise: float = math.nan
    answered: bool = False
    leader: str = ""
    stated: float = 0.0
    group_size: int = 0
    rank: int | None = None
    first: bool = False
    group_first: bool = False
    probability: float = 0.0
    log_score: float | None = None
    brier: float | None = None
    false_alarm: bool | None = None
    parameter: Size | None = None
    true_parameter: float | None = None
    prior_95: tuple[float, float] | None = None
    left: Size | None = None
    true_left: float | None = None
    seconds: float | None = None

    def row(self) -> dict[str, Any]:
        """A row of cases.csv."""
        found = {**vars(self), "right": " ".join(self.right)}
        tags, prior = found.pop("tags"), found.pop("prior_95")
        for name in ("parameter", "left"):
            size = found.pop(name)
            found |= {f"{name}_{x}": size and getattr(size, x) for x in ("mean", "low", "high")}
        low, high = prior or (None, None)
        return {**found, "prior_low": low, "prior_high": high, **tags}


def score_case(key: CaseKey, answer: Answer | None, *, by_component: bool = False) -> CaseScore | None:
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
    CaseScore or None
        None where the case cannot be asked for so: it has no component.
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
    told: dict[str, Any] = {"case": key.case, "kind": key.kind, "label": key.label, "right": right}
    told |= {"tags": key.tags, "gap_over_noise": ratio, "noise": noise}
    if answer is None or not listed:
        return CaseScore(**told, false_alarm=False if key.kind == "none" else None)
    groups = [(i,) if e.group is None else e.group for i, e in enumerate(listed)]
    total: dict[Any, float] = {}
    for group, e in zip(groups, listed, strict=True):
        total[group] = total.get(group, 0.0) + e.probability
    true = {group for group, e in zip(groups, listed, strict=True) if e.name in right}
    p = min(1.0, sum(e.probability for e in listed if e.name in right))
    others = sum(e.probability**2 for e in listed if e.name not in right)
    ranks = [i + 1 for i, group in enumerate(total) if group in true]
    told |= _sizes(key, answer)
    return CaseScore(
        **told,
        answered=True,
        leader=listed[0].name,
        stated=min(1.0, total[groups[0]]),
        group_size=groups.count(groups[0]),
        rank=min(ranks, default=len(total) + 1),
        first=listed[0].name in right,
        group_first=groups[0] in true,
        probability=p,
        log_score=math.log(p) if p else -math.inf,
        brier=(p - 1) ** 2 + others,
        false_alarm=groups[0] not in true if key.kind == "none" else None,
        seconds=answer.seconds,
    )


def _sizes(key: CaseKey, answer: Answer) -> dict[str, Any]:
    """What is stated of sizes, and what is true of them."""
    found: dict[str, Any] = {}
    where = (key.label, key.place, key.subtree)
    stated: Explanation | None = next(
        (e for e in answer.explanations if (e.name, e.place, e.subtree) == where), None
    )
    if key.parameter is not None and stated and stated.parameter:
        found = {"parameter": stated.parameter, "true_parameter": key.parameter, "prior_95": key.prior_95}
    left = None if answer.left is None else answer.left.true
    if answer.left and left is None and answer.fitted and key.truth:
        left = answer.fitted.left(key.truth)[1]
    if left is not None:
        found |= {"left": answer.left, "true_left": left}
    return found


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


def _mean(values: Iterable[float | None]) -> float:
    given = [v for v in values if v is not None]
    return float(np.mean(given)) if given else math.nan


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else math.nan


def summarise(cases: Sequence[CaseScore]) -> dict[str, Any]:
    """Rates and mean scores of some cases, and those of the best constant answers.

    Parameters
    ----------
    cases : sequence of CaseScore

    Returns
    -------
    dict
        docs/blind.md says what each is; "constant" has the best constant answer by the same names.
    """
    given = [c for c in cases if c.answered]
    shares = constant_shares([c.right for c in given])
    commonest = Counter(name for c in cases for name in c.right).most_common(1)
    always = commonest[0][0] if commonest else ""
    p = [sum(shares[name] for name in c.right) for c in given]
    squares = sum(x**2 for x in shares.values())
    sure = [c for c in given if c.stated > SURE]
    sized = [(c.parameter, c.true_parameter, c.prior_95) for c in cases if c.parameter is not None]
    left = [(c.left, c.true_left) for c in cases if c.left is not None and c.true_left is not None]
    middle = _median([true for _, true in left])
    hit = Rate.of(always in c.right for c in cases)
    return {
        "n": len(cases),
        "failed": len(cases) - len(given),
        "log_score": _mean(c.log_score for c in given),
        "log_score_of_possible": _mean(c.log_score for c in given if c.probability >= IMPOSSIBLE),
        "impossible": [c.case for c in given if c.probability < IMPOSSIBLE],
        "brier": _mean(c.brier for c in given),
        "first": Rate.of(c.first for c in cases),
        "group_first": Rate.of(c.group_first for c in cases),
        "mean_rank": _mean(c.rank for c in given),
        "group_size": _mean(c.group_size for c in given),
        "false_alarms": Rate.of(c.false_alarm for c in cases),
        "sure": Rate.of(c.group_first for c in sure),
        "sure_stated": _mean(c.stated for c in sure),
        "parameter": Rate.of(s.low <= true <= s.high for s, true, _ in sized if true is not None),
        "parameter_width": _median([(s.high - s.low) / (q[1] - q[0]) for s, _, q in sized if q]),
        "left": Rate.of(s.low <= true <= s.high for s, true in left),
        "left_error": _median([abs(s.mean - true) for s, true in left]),
        "seconds": _median([c.seconds for c in given if c.seconds is not None]),
        "constant": {
            "always": always,
            "shares": shares,
            "log_score": _mean(math.log(x) for x in p),
            "brier": _mean(
                (x - 1) ** 2 + squares - sum(shares[n] ** 2 for n in c.right)
                for x, c in zip(p, given, strict=True)
            ),
            "first": hit,
            "group_first": hit,
            "false_alarms": Rate.of(False for c in cases if c.false_alarm is not None),
            "parameter": Rate.of(q[0] <= t <= q[1] for _, t, q in sized if q and t is not None),
            "left_error": _median([abs(middle - true) for _, true in left]),
            "left": middle,
        },
    }


@dataclass(frozen=True)
class Score:
    """Score of a set of answers.

    Attributes
    ----------
    cases : tuple of CaseScore
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

    cases: tuple[CaseScore, ...]
    summary: dict[str, Any]
    by: dict[str, dict[str, dict[str, Any]]]
    reliability: list[ReliabilityBin]
    components: Score | None = None
    without_key: int = 0
    failed: Mapping[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        from zoo.core.blindcheck.tables import score_text

        return score_text(self)


def _value(case: CaseScore, name: str) -> str:
    return str(getattr(case, name)) if name in ("kind", "label") else case.tags[name]


def assemble(
    cases: Sequence[CaseScore],
    *,
    by: Sequence[str] = ("kind",),
    components: Score | None = None,
    without_key: int = 0,
    failed: Mapping[str, str] | None = None,
) -> Score:
    """Put the scores of cases together, grouped by "kind", "label" and tags that all cases have."""
    grouped: dict[str, dict[str, dict[str, Any]]] = {}
    for name in by:
        values = sorted({_value(c, name) for c in cases})
        grouped[name] = {v: summarise([c for c in cases if _value(c, name) == v]) for v in values}
    told = [c for c in cases if c.answered]
    bins = reliability([c.stated for c in told], [c.group_first for c in told])
    return Score(tuple(cases), summarise(cases), grouped, bins, components, without_key, failed or {})


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
