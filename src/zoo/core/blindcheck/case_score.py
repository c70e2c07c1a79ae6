"""How near the answer about one case is to its key."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from zoo.core.blindcheck.answers import Answer, Explanation
from zoo.core.blindcheck.keys import SECOND, CaseKey
from zoo.core.diagnosis.hypothesis import NONPARAMETRIC, NULL

FLOOR = 1e-6
"""Least probability that the log score counts: one that was called impossible costs 13.8."""
WITHIN = 0.1
"""How near a stated shrinkage must be to the true one."""
MAJORITY = 0.5


@dataclass(frozen=True)
class CaseScore:
    """One case: what is true, what was answered, how near that is.

    Attributes
    ----------
    tags : mapping
        Of the key.
    gap, noise : float
        Model discrepancy of the refitted baseline, and standard deviation of the noise.
    rank, group_rank : int or None
        Of the best-placed true explanation and of its group; None without an answer.
    leader, leader_probability : str, float
        First explanation, and the probability of its group.
    right : bool
        The leader's group holds what is accepted as true.
    first, group_first : bool
        The true effect, or its group, is ranked first.
    probability, group_probability : float
        Of what is true; with all that the data cannot tell from it.
    log_score, brier : float
        log p, and the sum over explanations of (p - 1[true])^2; `group_`: a group counts as one explanation;
        `uniform_`: of a guess that gives every explanation the same probability.
    place, leader_place : int, str or None
        Part of the true location and of the leader's.
    distance : int or None
        Parts between the true location and the leader's; None if one of them has none.
    shrinkage, shrinkage_true, shrinkage_low, shrinkage_high : float or None
        Stated with its 95 % interval, and true.
    amplitude, amplitude_sd, amplitude_true : float or None
        Of the true effect, whatever leads.
    """

    case: str
    kind: str
    truth: str
    gap: float
    noise: float
    answered: bool
    tags: Mapping[str, str] = field(default_factory=dict)
    leader: str = ""
    leader_probability: float = 0.0
    right: bool = False
    rank: int | None = None
    group_rank: int | None = None
    first: bool = False
    group_first: bool = False
    false_alarm: bool | None = None
    called_unlisted: bool | None = None
    probability: float = 0.0
    group_probability: float = 0.0
    log_score: float | None = None
    group_log_score: float | None = None
    uniform_log_score: float | None = None
    uniform_group_log_score: float | None = None
    brier: float | None = None
    group_brier: float | None = None
    uniform_brier: float | None = None
    uniform_group_brier: float | None = None
    place: int | str | None = None
    leader_place: int | str | None = None
    distance: int | None = None
    shrinkage: float | None = None
    shrinkage_low: float | None = None
    shrinkage_high: float | None = None
    shrinkage_true: float | None = None
    amplitude: float | None = None
    amplitude_sd: float | None = None
    amplitude_true: float | None = None
    seconds: float = math.nan

    @property
    def gap_over_noise(self) -> float:
        """Discrepancy over the standard deviation of the noise."""
        return self.gap / self.noise

    @property
    def shrinkage_within(self) -> bool | None:
        """Whether the stated shrinkage is near the true one."""
        if self.shrinkage is None or self.shrinkage_true is None:
            return None
        return abs(self.shrinkage - self.shrinkage_true) <= WITHIN

    @property
    def shrinkage_covered(self) -> bool | None:
        """Whether its interval holds the true one."""
        if self.shrinkage_low is None or self.shrinkage_high is None or self.shrinkage_true is None:
            return None
        return self.shrinkage_low <= self.shrinkage_true <= self.shrinkage_high

    @property
    def amplitude_covered(self) -> bool | None:
        """Whether the stated amplitude's 95 % interval holds the true one."""
        if self.amplitude is None or self.amplitude_sd is None or self.amplitude_true is None:
            return None
        return abs(self.amplitude - self.amplitude_true) <= 1.96 * self.amplitude_sd

    def record(self) -> dict[str, Any]:
        """A row of cases.csv and of score.json."""
        values = asdict(self)
        tags: dict[str, Any] = values.pop("tags")
        first = {name: values.pop(name) for name in ("case", "kind", "truth")}
        derived = ("gap_over_noise", "shrinkage_within", "shrinkage_covered", "amplitude_covered")
        return first | tags | values | {name: getattr(self, name) for name in derived}


def tree_distance(parents: Mapping[Any, Any], a: Any, b: Any) -> int | None:
    """Branchings between two parts of a tree: 0 for the same, 1 for parent and daughter, 2 for sisters.

    Parameters
    ----------
    parents : mapping
        Each part -> the part above it, None for the root.
    a, b : int or str

    Returns
    -------
    int or None
        None for two parts of which the mapping does not hold both.
    """
    if a == b:
        return 0
    if a not in parents or b not in parents:
        return None

    def path(part: Any) -> list[Any]:
        found = []
        while part is not None:
            found.append(part)
            part = parents[part]
        return found

    up, other = path(a), path(b)
    shared = next(part for part in up if part in other)
    return up.index(shared) + other.index(shared)


def _scores(p: float, others: Iterable[float], share: float, parts: int) -> tuple[float, float, float, float]:
    """Log and Brier score, and those of a uniform guess that gives `share` to what is true and the rest to
    `parts` others alike."""
    uniform = (share - 1) ** 2 + ((1 - share) ** 2 / parts if parts else 0.0)
    return (
        math.log(max(p, FLOOR)),
        (p - 1) ** 2 + sum(x**2 for x in others),
        math.log(share),
        uniform,
    )


def score_case(key: CaseKey, answer: Answer | None) -> CaseScore:
    """Score one answer.

    Parameters
    ----------
    key : CaseKey
    answer : Answer or None
        None where the diagnosis failed.

    Returns
    -------
    CaseScore
    """
    place = key.effects[0].location.part if len(key.effects) == 1 else None
    blank = CaseScore(
        key.case, key.kind, key.label, key.before, key.noise, answer is not None, key.tags, place=place,
        false_alarm=False if key.kind == "none" else None,
        called_unlisted=False if key.kind == "outside" else None,
    )  # fmt: skip
    if answer is None:
        return blank
    explanations, group_of, total = answer.explanations, answer.groups, answer.group_probabilities
    names, groups = [e.name for e in explanations], list(total)
    leader = explanations[0]
    true = [i for i, name in enumerate(names) if name in key.names]
    accepted = [i for i, name in enumerate(names) if name in key.accepted]
    true_groups = {group_of[i] for i in accepted}

    # explanations that these data cannot show have no probability, and no share in a uniform guess
    visible = [i for i, name in enumerate(names) if name not in answer.invisible]
    k, known = len(visible), sum(i in visible for i in accepted)
    p = sum(explanations[i].probability for i in accepted)
    others = [e.probability for i, e in enumerate(explanations) if i not in accepted]
    one = _scores(p, others, max(1, known) / k, k - known)
    p_group = sum(total[g] for g in true_groups)
    inside = sum(group_of[i] in true_groups for i in visible)
    outer = [total[g] for g in groups if g not in true_groups]
    rest = len({group_of[i] for i in visible} - true_groups)
    group = _scores(p_group, outer, max(1, inside) / k, rest)

    leader_place = leader.location.part
    named = place is not None and leader_place is not None
    stated = _true_explanation(key, explanations)
    shrinks = key.shrinkage is not None
    return replace(
        blank,
        leader=leader.name,
        leader_probability=min(1.0, total[group_of[0]]),
        right=group_of[0] in true_groups,
        rank=min((i + 1 for i in true), default=len(names) + 1),
        group_rank=min((groups.index(group_of[i]) + 1 for i in true), default=len(groups) + 1),
        first=leader.name in key.names,
        group_first=group_of[0] in {group_of[i] for i in true},
        false_alarm=leader.name != NULL if key.kind == "none" else None,
        called_unlisted=_called_unlisted(key, answer) if key.kind == "outside" else None,
        probability=min(1.0, p),
        group_probability=min(1.0, p_group),
        log_score=one[0],
        brier=one[1],
        uniform_log_score=one[2],
        uniform_brier=one[3],
        group_log_score=group[0],
        group_brier=group[1],
        uniform_group_log_score=group[2],
        uniform_group_brier=group[3],
        leader_place=leader_place,
        distance=tree_distance(answer.parents, place, leader_place) if named else None,
        shrinkage=answer.removed if shrinks else None,
        shrinkage_low=answer.removed_low if shrinks else None,
        shrinkage_high=answer.removed_high if shrinks else None,
        shrinkage_true=key.shrinkage,
        amplitude=stated.amplitude if stated else None,
        amplitude_sd=stated.amplitude_sd if stated else None,
        amplitude_true=key.effects[0].amplitude if stated else None,
        seconds=answer.seconds,
    )


def _called_unlisted(key: CaseKey, answer: Answer) -> bool:
    """Whether the answer says, or leaves open, that no listed effect alone is the cause."""
    leader = answer.explanations[0]
    listed = [e.probability for e in answer.explanations if e.name not in (NULL, NONPARAMETRIC)]
    if NONPARAMETRIC in (leader.name, *answer.cause) or max(listed, default=0.0) <= MAJORITY:
        return True
    return key.label == SECOND and leader.name in key.names


def _true_explanation(key: CaseKey, explanations: tuple[Explanation, ...]) -> Explanation | None:
    """The answer about the true effect, if it stands at the true location and there is a size to compare."""
    if key.kind != "listed" or key.effects[0].amplitude is None:
        return None
    effect = key.effects[0]
    return next((e for e in explanations if (e.name, e.location) == (effect.name, effect.location)), None)
