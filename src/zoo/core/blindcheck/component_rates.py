"""The scores of many cases by components, beside the best answers that do not look at the data."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from zoo.core.blindcheck.component_score import REST, ComponentScore
from zoo.core.blindcheck.constants import frequencies
from zoo.core.blindcheck.keys import PAIR
from zoo.core.blindcheck.rates import rate, reliability

LEAST_STATED = 0.01
"""Outcomes of less probability are left out of the reliability of all."""
COVER = 0.95


def component_summary(cases: Sequence[ComponentScore], tag: str = "series") -> dict[str, Any]:
    """Rates and mean scores by component, of all cases and by how many series they have.

    Parameters
    ----------
    cases : sequence of ComponentScore
    tag : str
        By which they are grouped.

    Returns
    -------
    dict
        JSON's types; "constants" has, for each score, the best constant answer; docs/blind.md says what each
        is.
    """
    if not cases:
        return {}
    told = [c for c in cases if c.probabilities]
    flat = [(p, name in c.true) for c in told for name, p in c.probabilities.items() if p >= LEAST_STATED]
    bins = {
        "reliability": reliability([c.leader_probability for c in told], [c.leader_right for c in told]),
        "reliability_all": reliability([p for p, _ in flat], [right for _, right in flat]),
    }
    groups = sorted({(c.kind, c.tags.get(tag, "")) for c in cases})
    return {
        **_summary(cases),
        "by": {
            f"{kind}, {value} series" if value else kind: _summary(
                [c for c in cases if (c.kind, c.tags.get(tag, "")) == (kind, value)]
            )
            for kind, value in groups
        },
        **{name: [asdict(b) | {"inside": b.inside} for b in found] for name, found in bins.items()},
        "cases": [c.record() for c in cases],
    }


def _summary(cases: Sequence[ComponentScore]) -> dict[str, Any]:
    told = [c for c in cases if c.probabilities]
    placed = [c for c in cases if c.kind not in ("none", PAIR)]
    learned = [c.learned for c in cases if c.learned is not None]
    points = sum(x.points for x in learned)
    narrow = sum(x.narrow for x in learned)
    commonest = _commonest(placed)
    log_score, brier = frequencies([c.true for c in told])
    pairs = [c for c in cases if c.kind == PAIR]
    two = tuple(name for name, _ in Counter(n for c in pairs for n in c.true).most_common(2))
    quiet = [c for c in cases if c.kind == "none"]
    return {
        "n": len(cases),
        "component_or_pair_of_them_first": rate(c.found for c in placed),
        "component_first": rate(c.leader_right for c in placed),
        "group_sizes": dict(sorted(Counter(len(c.group) for c in placed if c.group).items())),
        "wrong_and_sure": rate(c.wrong_and_sure for c in cases),
        "log_score": float(np.mean([c.log_score for c in told])) if told else math.nan,
        "brier": float(np.mean([c.brier for c in told])) if told else math.nan,
        "both_found": rate(c.both for c in cases),
        "one_found": rate(c.one for c in cases),
        "noise_recognised": rate(c.noise_recognised for c in cases),
        "points_held": {"count": sum(x.held for x in learned), "n": points}
        | {"share": sum(x.held for x in learned) / points if points else math.nan},
        "narrow_points_held": {"count": sum(x.narrow_held for x in learned), "n": narrow}
        | {"share": sum(x.narrow_held for x in learned) / narrow if narrow else math.nan},
        "functions": len(learned),
        "functions_with_narrowed_directions": rate(x.narrowed > 0 for x in learned),
        "narrowed_directions": float(np.mean([x.narrowed for x in learned])) if learned else math.nan,
        "width_over_prior": float(np.median([x.width_over_prior for x in learned])) if learned else math.nan,
        "constants": {
            "component_or_pair_of_them_first": {
                "answer": f"always {commonest}",
                **rate(commonest in c.true for c in placed),
            },
            "component_first": {"answer": f"always {commonest}", **rate(commonest in c.true for c in placed)},
            "wrong_and_sure": {"answer": f"always {REST[0]}", **rate(False for _ in cases)},
            "log_score": {"answer": "the frequencies of what is true", "value": log_score},
            "brier": {"answer": "the frequencies of what is true", "value": brier},
            "both_found": {
                "answer": "always " + " and ".join(two),
                **rate(set(two) == set(c.true) for c in pairs),
            },
            "one_found": {
                "answer": "always " + " and ".join(two),
                **rate(bool(set(two) & set(c.true)) for c in pairs),
            },
            "noise_recognised": {"answer": f"always {REST[0]}", **rate(True for _ in quiet)},
            "points_held": {"answer": "the prior's band", "share": COVER},
        },
    }


def _commonest(cases: Sequence[ComponentScore]) -> str | None:
    count = Counter(name for c in cases for name in c.true)
    return min(count, key=lambda name: (-count[name], name), default=None)
