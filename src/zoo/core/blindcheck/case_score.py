"""How near the answer about one case is to its key."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from zoo.core.blindcheck.answers import Answer, Explanation
from zoo.core.blindcheck.keys import SECOND, CaseKey
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, NULL

FLOOR = 1e-6
"""Least probability that the log score counts: one that was called impossible costs 13.8."""
PRIOR_ONLY = 0.01
"""A probability nearer to what the prior alone gives says nothing of the data."""
RESOLVED = 0.2
"""A discrepancy above this part of the noise is compared by its ratio, a smaller one by the difference."""
MAJORITY = 0.5


@dataclass(frozen=True)
class CaseScore:
    """One case: what is true, what was answered, how near that is.

    Attributes
    ----------
    tags : mapping
        Of the key.
    accepted : tuple of str
        Explanations that are right, by name.
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
        log p, and the sum over explanations of (p - 1[true])^2; `group_`: a group counts as one explanation.
    prior_probability, prior_only : float or None, bool or None
        What the prior alone gives the leading explanation beside others of the same evidence, and whether its
        probability is within 1 % of that.
    place, leader_place : int, str or None
        Part of the true location and of the leader's.
    distance : int or None
        Parts between the true location and the leader's; None if one of them has none.
    gap_stated, gap_low, gap_high, gap_true : float or None
        Discrepancy of the baseline: stated with its 95 % interval, and the rms of the noise-free data minus
        the fit.
    left, left_low, left_high, left_true : float or None
        The same with the leading explanation; only where that is an effect.
    amplitude, amplitude_sd, amplitude_low, amplitude_high, amplitude_true : float or None
        Of the true effect, whatever leads; low and high are the stated 95 % interval.
    amplitude_prior_low, amplitude_prior_high : float or None
        Central 95 % interval of its prior.
    """

    case: str
    kind: str
    truth: str
    gap: float
    noise: float
    answered: bool
    tags: Mapping[str, str] = field(default_factory=dict)
    accepted: tuple[str, ...] = ()
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
    brier: float | None = None
    group_brier: float | None = None
    prior_probability: float | None = None
    prior_only: bool | None = None
    place: int | str | None = None
    leader_place: int | str | None = None
    distance: int | None = None
    gap_stated: float | None = None
    gap_low: float | None = None
    gap_high: float | None = None
    gap_true: float | None = None
    left: float | None = None
    left_low: float | None = None
    left_high: float | None = None
    left_true: float | None = None
    amplitude: float | None = None
    amplitude_sd: float | None = None
    amplitude_low: float | None = None
    amplitude_high: float | None = None
    amplitude_true: float | None = None
    amplitude_prior_low: float | None = None
    amplitude_prior_high: float | None = None
    seconds: float = math.nan

    @property
    def gap_over_noise(self) -> float:
        """Discrepancy over the standard deviation of the noise."""
        return self.gap / self.noise

    @property
    def gap_covered(self) -> bool | None:
        """Whether the interval of the baseline's discrepancy holds the true one."""
        return _holds(self.gap_low, self.gap_high, self.gap_true)

    @property
    def left_covered(self) -> bool | None:
        """Whether the interval of what the leading explanation leaves holds what it does."""
        return _holds(self.left_low, self.left_high, self.left_true)

    @property
    def left_ratio(self) -> float | None:
        """Stated over true, where more than a fifth of the noise is left."""
        if self.left is None or self.left_true is None or not self.left_true > RESOLVED * self.noise:
            return None
        return self.left / self.left_true

    @property
    def left_error(self) -> float | None:
        """Stated minus true, where less is left."""
        if self.left is None or self.left_true is None or self.left_true > RESOLVED * self.noise:
            return None
        return self.left - self.left_true

    @property
    def z(self) -> float | None:
        """Stated amplitude minus the true one, over its stated sd."""
        if self.amplitude is None or self.amplitude_sd is None or self.amplitude_true is None:
            return None
        off = self.amplitude - self.amplitude_true
        return (
            off / self.amplitude_sd if self.amplitude_sd > 0 else math.copysign(math.inf, off) if off else 0.0
        )

    @property
    def amplitude_covered(self) -> bool | None:
        """Whether the stated amplitude's 95 % interval holds the true one."""
        return _holds(self.amplitude_low, self.amplitude_high, self.amplitude_true)

    @property
    def prior_covered(self) -> bool | None:
        """Whether the prior's 95 % interval holds the true amplitude."""
        return _holds(self.amplitude_prior_low, self.amplitude_prior_high, self.amplitude_true)

    def record(self) -> dict[str, Any]:
        """A row of cases.csv and of score.json."""
        values = asdict(self)
        tags: dict[str, Any] = values.pop("tags")
        values["accepted"] = " ".join(self.accepted)
        first = {name: values.pop(name) for name in ("case", "kind", "truth")}
        derived = ("gap_over_noise", "gap_covered", "left_covered", "z", "amplitude_covered")
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


def _holds(low: float | None, high: float | None, x: float | None) -> bool | None:
    return None if low is None or high is None or x is None else low <= x <= high


def _scores(p: float, others: Iterable[float]) -> tuple[float, float]:
    """Log and Brier score of the probability of what is true, and those of the rest."""
    return math.log(max(p, FLOOR)), (p - 1) ** 2 + sum(x**2 for x in others)


def as_asked(key: CaseKey, answer: Answer | None) -> CaseKey:
    """The key as a diagnosis can be asked about it: one that knows no components is asked for "unlisted"."""
    if answer is None or answer.components or not key.components or key.kind == "listed":
        return key
    return replace(key, kind="outside" if key.by_component else key.kind, components=())


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
    key = as_asked(key, answer)
    place = key.effects[0].location.part if len(key.effects) == 1 else None
    blank = CaseScore(
        key.case, key.kind, key.label, key.before, key.noise, answer is not None, key.tags,
        tuple(sorted(key.accepted)), place=place,
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

    p = sum(explanations[i].probability for i in accepted)
    one = _scores(p, [e.probability for i, e in enumerate(explanations) if i not in accepted])
    p_group = sum(total[g] for g in true_groups)
    group = _scores(p_group, [total[g] for g in groups if g not in true_groups])
    leader_place = leader.location.part
    named = place is not None and leader_place is not None
    stated = _true_explanation(key, explanations)
    blank = _with_gaps(blank, key, answer)
    interval = _interval(stated)
    prior_interval = (key.effects[0].prior if stated else None) or (None, None)
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
        group_log_score=group[0],
        group_brier=group[1],
        prior_probability=leader.prior_probability,
        prior_only=_prior_only(leader) if answer.states_prior else None,
        leader_place=leader_place,
        distance=tree_distance(answer.parents, place, leader_place) if named else None,
        amplitude=stated.amplitude if stated else None,
        amplitude_sd=stated.amplitude_sd if stated else None,
        amplitude_low=interval[0],
        amplitude_high=interval[1],
        amplitude_true=key.effects[0].amplitude if stated else None,
        amplitude_prior_low=prior_interval[0],
        amplitude_prior_high=prior_interval[1],
        seconds=answer.seconds,
    )


def _with_gaps(found: CaseScore, key: CaseKey, answer: Answer) -> CaseScore:
    """With the stated discrepancies and the true ones, where the key has the noise-free data."""
    before, after = answer.gap_before, answer.gap_after
    if key.truth is None or answer.fitted is None or before is None or after is None:
        return found
    gap, left = answer.fitted.left(key.truth)
    found = replace(found, gap_stated=before.mean, gap_low=before.low, gap_high=before.high, gap_true=gap)
    if answer.explanations[0].name in (NULL, NONPARAMETRIC, CORRELATED):
        return found
    return replace(found, left=after.mean, left_low=after.low, left_high=after.high, left_true=left)


def _called_unlisted(key: CaseKey, answer: Answer) -> bool:
    """Whether the answer says, or leaves open, that no listed effect alone is the cause."""
    leader = answer.explanations[0]
    others = {NULL, NONPARAMETRIC, *(c.name for c in answer.components)}
    listed = [e.probability for e in answer.explanations if e.name not in others]
    if NONPARAMETRIC in (leader.name, *answer.cause) or max(listed, default=0.0) <= MAJORITY:
        return True
    return key.label == SECOND and leader.name in key.names


def _prior_only(leader: Explanation) -> bool:
    """Whether its probability is what the prior alone gives."""
    prior = leader.prior_probability
    return prior is not None and abs(leader.probability - prior) <= PRIOR_ONLY


def _interval(stated: Explanation | None) -> tuple[float | None, float | None]:
    """The 95 % interval of an explanation's amplitude."""
    if stated is None or stated.amplitude is None or stated.amplitude_sd is None:
        return None, None
    if stated.amplitude_interval is not None:
        return stated.amplitude_interval
    return stated.amplitude - 1.96 * stated.amplitude_sd, stated.amplitude + 1.96 * stated.amplitude_sd


def _true_explanation(key: CaseKey, explanations: tuple[Explanation, ...]) -> Explanation | None:
    """The answer about the true effect, if it stands at the true location and there is a size to compare."""
    if key.kind != "listed" or key.effects[0].amplitude is None:
        return None
    effect = key.effects[0]
    return next((e for e in explanations if (e.name, e.location) == (effect.name, effect.location)), None)
