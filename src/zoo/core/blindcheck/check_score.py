"""The scores of many cases together: rates, mean scores, reliability, and what was taken for what."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from zoo.core.blindcheck.answers import Answer
from zoo.core.blindcheck.case_score import CaseScore, as_asked, score_case
from zoo.core.blindcheck.component_rates import component_summary
from zoo.core.blindcheck.component_score import ComponentScore, score_components
from zoo.core.blindcheck.constants import best_constants, sizes, spread
from zoo.core.blindcheck.keys import SECOND, CaseKey
from zoo.core.blindcheck.rates import FULL_BIN, ReliabilityBin, rate, reliability
from zoo.core.inference.record import versions

FORMAT = 2
CURVE_BINS = 6
LEAST_STATED = 0.01
"""Groups of less probability are left out of the reliability of all groups."""
SURE = 0.9999
FAR = 5.0
"""Stated sds from the truth that an amplitude should never be."""


@dataclass(frozen=True, eq=False)
class CheckScore:
    """Score of a set of answers.

    Attributes
    ----------
    cases : tuple of CaseScore
    summary : dict
        Of all cases.
    constants : dict
        Score -> the best constant answer and its figure, as of `best_constants`.
    by : dict
        "kind", "effect", ... -> value -> summary.
    amplitudes : dict
        Effect -> how many sds its stated amplitudes are from the true ones.
    reliability : list of ReliabilityBin
        Of the leading group's probability, a case each; without those that the prior alone gives.
    reliability_all : list of ReliabilityBin
        Of every group's probability of at least 1 %.
    curve : list of dict
        Effect or its group ranked first against discrepancy over noise, listed effects only.
    confusion : dict
        What is true -> what was ranked first -> how often.
    key_checked : bool
        Whether the key was checked against a digest.
    without_key : int
        Answers that the key says nothing about.
    failed : mapping
        Case without an answer -> reason, where it is known.
    components : dict
        Scores by component, as of `component_summary`; empty where keys or answers know none.
    """

    cases: tuple[CaseScore, ...]
    summary: dict[str, Any]
    constants: dict[str, dict[str, Any]]
    by: dict[str, dict[str, dict[str, Any]]]
    amplitudes: dict[str, dict[str, Any]]
    reliability: list[ReliabilityBin]
    reliability_all: list[ReliabilityBin]
    curve: list[dict[str, Any]]
    confusion: dict[str, dict[str, int]]
    key_checked: bool = False
    without_key: int = 0
    failed: Mapping[str, str] = field(default_factory=dict)
    components: dict[str, Any] = field(default_factory=dict)

    def record(self) -> dict[str, Any]:
        """Content of score.json, without NaN."""
        bins = {
            name: [asdict(b) | {"inside": b.inside} for b in getattr(self, name)]
            for name in ("reliability", "reliability_all")
        }
        found: dict[str, Any] = _without_nan(
            {
                "format": FORMAT,
                "versions": versions(),
                "key_checked": self.key_checked,
                "answers_without_key": self.without_key,
                "summary": self.summary,
                "constants": self.constants,
                "by": self.by,
                "amplitudes": self.amplitudes,
                **bins,
                "curve": self.curve,
                "confusion": self.confusion,
                "components": self.components,
                "cases": [c.record() for c in self.cases],
            }
        )
        return found

    def __str__(self) -> str:
        from zoo.core.blindcheck.tables import rates_text

        return rates_text(self)


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _without_nan(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _mean(values: Iterable[float | None]) -> float:
    given = [v for v in values if v is not None]
    return float(np.mean(given)) if given else math.nan


def _median(values: Iterable[float | None]) -> float:
    given = [v for v in values if v is not None]
    return float(np.median(given)) if given else math.nan


def _width(low: float | None, high: float | None) -> float | None:
    return None if low is None or high is None else high - low


def _over_prior(c: CaseScore) -> float | None:
    """Width of the stated interval of an amplitude over that of the prior's."""
    own, prior = (
        _width(*x)
        for x in ((c.amplitude_low, c.amplitude_high), (c.amplitude_prior_low, c.amplitude_prior_high))
    )
    return own / prior if own is not None and prior else None


def amplitude_errors(cases: Sequence[CaseScore]) -> dict[str, dict[str, Any]]:
    """For each effect, how many stated sds its stated amplitudes are from the true ones."""
    found: dict[str, list[tuple[float, bool]]] = {}
    for c in cases:
        if c.z is not None:
            found.setdefault(c.truth, []).append((c.z, bool(c.amplitude_covered)))
    return {
        name: {
            "n": len(z),
            "mean": float(np.mean([x for x, _ in z])),
            "largest": max((x for x, _ in z), key=abs),
            "beyond_5_sd": sum(abs(x) > FAR for x, _ in z),
            "held": sum(held for _, held in z),
        }
        for name, z in sorted(found.items())
    }


def summarise(cases: Sequence[CaseScore]) -> dict[str, Any]:
    """Rates with their 95 % intervals, and mean scores, of some cases.

    Parameters
    ----------
    cases : sequence of CaseScore

    Returns
    -------
    dict
        JSON's types; docs/blind.md says what each is.
    """
    listed = [c for c in cases if c.kind == "listed"]
    placed = [c for c in listed if c.place is not None and c.answered]
    named = [c for c in placed if c.leader_place is not None]
    given = [c for c in cases if c.answered]
    sure = [c for c in given if c.leader_probability > SURE]
    z = [abs(c.z) for c in cases if c.z is not None]
    return {
        "n": len(cases),
        "failed": sum(not c.answered for c in cases),
        "effect_first": rate(c.first for c in listed),
        "effect_or_group_first": rate(c.group_first for c in listed),
        "right": rate(c.right for c in cases),
        "mean_rank": _mean(c.rank for c in listed),
        "mean_group_rank": _mean(c.group_rank for c in listed),
        "false_alarms": rate(c.false_alarm for c in cases),
        "outside_called_unlisted": rate(c.called_unlisted for c in cases),
        "second_effect_one_of_two_first": rate(c.group_first for c in cases if c.truth == SECOND),
        "gap_interval_holds_truth": rate(c.gap_covered for c in cases)
        | {"width": _median(_width(c.gap_low, c.gap_high) for c in cases)},
        "left_interval_holds_truth": rate(c.left_covered for c in cases)
        | {"width": _median(_width(c.left_low, c.left_high) for c in cases)},
        "left_ratio": spread(c.left_ratio for c in cases if c.left_ratio is not None),
        "left_error": sizes(c.left_error for c in cases if c.left_error is not None),
        "amplitude_interval_holds_truth": rate(c.amplitude_covered for c in cases)
        | {"width_over_prior": _median(_over_prior(c) for c in cases)},
        "amplitude_ratio_median": _median(
            c.amplitude / c.amplitude_true for c in cases if c.amplitude is not None and c.amplitude_true
        ),
        "amplitude_beyond_5_sd": rate(x > FAR for x in z),
        "leader_brier": _mean((c.leader_probability - c.right) ** 2 for c in given),
        "prior_only": rate(c.prior_only for c in given),
        "prior_only_right": rate(c.right for c in given if c.prior_only),
        "sure": rate(c.leader_probability > SURE for c in given),
        "sure_right": rate(c.right for c in sure),
        "place_named": rate(c.leader_place is not None for c in placed),
        "place_exact": rate(c.distance == 0 for c in named),
        "place_within_1": rate(c.distance is not None and c.distance <= 1 for c in named),
        "place_mean_distance": _mean(c.distance for c in named),
        **{
            name: _mean(getattr(c, name) for c in cases)
            for name in ("log_score", "group_log_score", "brier", "group_brier")
        },
        "screening_seconds": float(np.nansum([c.seconds for c in cases])),
    }


def accuracy_curve(cases: Sequence[CaseScore]) -> list[dict[str, Any]]:
    """Share of true effects (or their groups) ranked first against discrepancy over noise, in equal bins."""
    listed = sorted(
        (c for c in cases if c.kind == "listed" and not math.isnan(c.gap_over_noise)),
        key=lambda c: c.gap_over_noise,
    )
    bins = max(1, min(CURVE_BINS, len(listed) // FULL_BIN))
    found = []
    for part in np.array_split(np.arange(len(listed)), bins) if listed else []:
        x = [listed[i].gap_over_noise for i in part]
        found.append(
            {"from": x[0], "to": x[-1], "median": float(np.median(x))}
            | rate(listed[i].group_first for i in part)
        )
    return found


def _grouped(cases: Sequence[CaseScore], name: str, gap_edges: Sequence[float]) -> dict[str, dict[str, Any]]:
    """Summaries by kind, effect, tag (in alphabetical order) or discrepancy (by size)."""

    def value(c: CaseScore) -> tuple[int, str]:
        if name == "kind":
            return 0, c.kind
        if name == "effect":
            return 0, c.truth
        if name != "gap":
            return 0, c.tags[name]
        if c.kind == "none":
            return -1, "no effect"
        i = int(np.searchsorted(gap_edges, c.gap, side="right")) - 1
        low, high = gap_edges[i], gap_edges[i + 1]
        return i, f"{low:g} to {high:g}" if math.isfinite(high) else f"over {low:g}"

    values = [value(c) for c in cases]
    return {
        v[1]: summarise([c for c, own in zip(cases, values, strict=True) if own == v])
        for v in sorted(set(values))
    }


def assemble(
    cases: Sequence[CaseScore],
    stated: Sequence[tuple[float, bool]] = (),
    *,
    by: Sequence[str] = ("kind", "effect"),
    gap_edges: Sequence[float] = (0.0, math.inf),
    key_checked: bool = False,
    without_key: int = 0,
    failed: Mapping[str, str] | None = None,
    by_component: Sequence[ComponentScore] = (),
) -> CheckScore:
    """Put the scores of cases together.

    Parameters
    ----------
    cases : sequence of CaseScore
    stated : sequence of (float, bool)
        Probability of every group of every case, and whether it holds what is true.
    by : sequence of str
        What to group by: "kind", "effect", "gap", or a tag that all cases have.
    gap_edges : sequence of float
        Of the bins of "gap", the size of the model discrepancy; the last is infinite.
    key_checked, without_key, failed
        As in `CheckScore`.
    by_component : sequence of ComponentScore
        Of the cases whose key and answer know components.

    Returns
    -------
    CheckScore
    """
    confusion: dict[str, dict[str, int]] = {}
    for c in cases:
        row = confusion.setdefault(c.truth, {})
        said = c.leader if c.answered else "failed"
        row[said] = row.get(said, 0) + 1
    told = [c for c in cases if c.answered and not c.prior_only]
    kept = [(p, right) for p, right in stated if p >= LEAST_STATED]
    return CheckScore(
        tuple(cases),
        summarise(cases),
        best_constants(cases),
        {name: _grouped(cases, name, gap_edges) for name in by},
        amplitude_errors(cases),
        reliability([c.leader_probability for c in told], [c.right for c in told]),
        reliability([p for p, _ in kept], [right for _, right in kept]),
        accuracy_curve(cases),
        confusion,
        key_checked,
        without_key,
        failed or {},
        component_summary(by_component),
    )


def score_answers(
    keys: Sequence[CaseKey], answers: Mapping[str, Answer | None], **settings: Any
) -> CheckScore:
    """Score answers against their keys.

    Parameters
    ----------
    keys : sequence of CaseKey
    answers : mapping
        Case -> its answer; None (or nothing) where the diagnosis failed.
    **settings
        As in `assemble`.

    Returns
    -------
    CheckScore
    """
    cases, stated, by_component = [], [], []
    for one in keys:
        answer = answers.get(one.case)
        key = as_asked(one, answer)
        cases.append(score_case(key, answer))
        if (found := score_components(key, answer, cases[-1])) is not None:
            by_component.append(found)
        if answer is None:
            continue
        right = {
            group
            for group, e in zip(answer.groups, answer.explanations, strict=True)
            if e.name in key.accepted
        }
        stated += [(p, group in right) for group, p in answer.group_probabilities.items()]
    return assemble(cases, stated, by_component=by_component, **settings)
