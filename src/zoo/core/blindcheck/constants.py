"""Answers that never look at the data: what a score must beat to say anything."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Iterable, Sequence
from typing import Any

import numpy as np

from zoo.core.blindcheck.case_score import CaseScore
from zoo.core.blindcheck.keys import SECOND
from zoo.core.blindcheck.rates import rate
from zoo.core.diagnosis.hypothesis import NONPARAMETRIC, NULL

COVER = 0.95
"""What an interval states that it holds."""
ROUNDS = 200
"""Of the search for the probabilities with the best log score."""


def best_constants(cases: Sequence[CaseScore]) -> dict[str, dict[str, Any]]:
    """For every score the constant answer that is best at it, chosen with the key at hand.

    Parameters
    ----------
    cases : sequence of CaseScore

    Returns
    -------
    dict
        Name of a score in `summarise` -> "answer", in words, and its figure: a rate, or numbers of the same
        names as the score's.
    """
    listed = [c for c in cases if c.kind == "listed"]
    placed = [c for c in listed if c.distance is not None]
    given = [c for c in cases if c.answered]
    effect = _commonest([c.truth] for c in listed)
    anything = _commonest(c.accepted for c in cases)
    of_two = _commonest(set(c.accepted) - {NONPARAMETRIC} for c in cases if c.truth == SECOND)
    place = _commonest([c.place] for c in placed)
    first = rate(c.truth == effect for c in listed)
    found: dict[str, dict[str, Any]] = {
        "effect_first": {"answer": f"always {effect}", **first},
        "effect_or_group_first": {"answer": f"always {effect}", **first},
        "right": {"answer": f"always {anything}", **rate(anything in c.accepted for c in cases)},
        "false_alarms": {"answer": f"always {NULL}", **rate(False for c in cases if c.kind == "none")},
        "outside_called_unlisted": {
            "answer": f"always {NONPARAMETRIC}",
            **rate(True for c in cases if c.kind == "outside"),
        },
        "second_effect_one_of_two_first": {
            "answer": f"always {of_two}",
            **rate(of_two in c.accepted for c in cases if c.truth == SECOND),
        },
        "place_exact": {"answer": f"always {place}", **rate(c.place == place for c in placed)},
        "amplitude_interval_holds_truth": {
            "answer": "the prior's 95 % interval",
            **rate(c.prior_covered for c in cases if c.amplitude_covered is not None),
        },
    }
    share = float(np.mean([c.right for c in given])) if given else math.nan
    found["leader_brier"] = {"answer": f"always {share:.3f}", "value": share * (1 - share)}
    log_score, brier = frequencies([c.accepted for c in given])
    words = "the frequencies of what is true"
    for name, value in (("log_score", log_score), ("brier", brier)):
        found[name] = found["group_" + name] = {"answer": words, "value": value}
    for name, field in (("gap", "gap_true"), ("left", "left_true")):
        true = [x for c in cases if (x := getattr(c, field)) is not None]
        low, high = _shortest(true)
        found[name + "_interval_holds_truth"] = {
            "answer": f"always {low:.3g} to {high:.3g}",
            "width": high - low,
            **rate(low <= x <= high for x in true),
        }
    resolved = [c.left_true for c in cases if c.left_ratio is not None and c.left_true is not None]
    if resolved:
        middle = float(np.median(resolved))
        found["left_ratio"] = {"answer": f"always {middle:.3g}", **spread(middle / x for x in resolved)}
    small = [c.left_true for c in cases if c.left_error is not None and c.left_true is not None]
    if small:
        middle = float(np.median(small))
        found["left_error"] = {"answer": f"always {middle:.3g}", **sizes(middle - x for x in small)}
    return found


def spread(ratios: Iterable[float]) -> dict[str, Any]:
    """Median, quartiles and worst (farthest from 1 on a logarithmic scale) of ratios."""
    x = np.array(list(ratios))
    if not len(x):
        return {"n": 0}
    low, middle, high = (float(q) for q in np.quantile(x, (0.25, 0.5, 0.75)))
    worst = float(x[np.argmax(np.abs(np.log(np.maximum(x, 1e-12))))])
    return {"n": len(x), "median": middle, "low": low, "high": high, "worst": worst}


def sizes(errors: Iterable[float]) -> dict[str, Any]:
    """Median, upper quartile and largest of the sizes of errors."""
    x = np.abs(np.array(list(errors)))
    if not len(x):
        return {"n": 0}
    return {
        "n": len(x),
        "median": float(np.median(x)),
        "high": float(np.quantile(x, 0.75)),
        "worst": float(x.max()),
    }


def _commonest(names: Iterable[Iterable[Hashable]]) -> Hashable:
    """The name that occurs in most cases; the first by alphabet of several."""
    count = Counter(name for one in names for name in one)
    return min(count, key=lambda name: (-count[name], str(name)), default=None)


def _shortest(values: Sequence[float]) -> tuple[float, float]:
    """The shortest interval that holds 95 % of some values."""
    if not values:
        return math.nan, math.nan
    x = np.sort(values)
    held = math.ceil(COVER * len(x) - 1e-9)
    widths = x[held - 1 :] - x[: len(x) - held + 1]
    i = int(np.argmin(widths))
    return float(x[i]), float(x[i + held - 1])


def frequencies(accepted: Sequence[Sequence[str]]) -> tuple[float, float]:
    """Log and Brier score of the constant probabilities whose log score is best.

    They are the frequencies of what is true; where two names are right, they share the case as they share the
    rest, found by expectation and maximisation.
    """
    names = sorted({name for one in accepted for name in one})
    if not names:
        return math.nan, math.nan
    holds = np.array([[name in one for name in names] for one in accepted], dtype=float)
    q = np.full(len(names), 1 / len(names))
    for _ in range(ROUNDS):
        shares = holds * q
        q = np.mean(shares / shares.sum(axis=1, keepdims=True), axis=0)
    p = holds @ q
    return float(np.mean(np.log(p))), float(np.mean((p - 1) ** 2 + (1 - holds) @ q**2))
