"""How near the answer about one case is to the component that its cause lies in, and to the true function."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from zoo.core.blindcheck.answers import Answer, StatedFunction
from zoo.core.blindcheck.case_score import FLOOR, CaseScore
from zoo.core.blindcheck.keys import PAIR, CaseKey
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, NULL

REST = (NULL, CORRELATED)
"""What an answer gives probability to besides components; "unlisted" is the free function of one of these."""
SMALL_GROUP = 2
"""Components that a group may have to count as an answer."""
SURE = 0.9
NEARLY_ALL = 0.5
"""A listed effect of the true component that leaves less than this part of the noise is right, too."""
NARROW = 0.5
"""A band of less than this part of the prior's says something."""


@dataclass(frozen=True)
class Learned:
    """A learned function beside the true one.

    Parameters
    ----------
    name : str
    points, held : int
        Where the true one is known, and lies within the 95 % band.
    narrow, narrow_held : int
        Those of them at which the band has less than half the prior's width.
    width_over_prior : float
        Median of the band's width over the prior's.
    narrowed : int
        Directions in which the data halve the prior's sd.
    """

    name: str
    points: int
    held: int
    narrow: int
    narrow_held: int
    width_over_prior: float
    narrowed: int


@dataclass(frozen=True)
class ComponentScore:
    """One case by components.

    Attributes
    ----------
    true : tuple of str
        What is right: components, or "no-gap" (and "correlated-noise") without a cause.
    probabilities : mapping
        Of each component, listed effects included, and of what else there is.
    leader : str
        The most probable of these.
    group : tuple of str
        The leader and what the data cannot tell from it.
    found : bool
        The leader is right, or one of a group of at most two.
    wrong_and_sure : bool
        A listed effect or a component has more than 0.9, and is not right, nor is any of its group. Of a
        cause that no listed effect holds, a listed effect of its component counts as right if it leaves less
        than half of the noise.
    log_score, brier : float
        Of the probability of what is right.
    both, one : bool or None
        Of a pair: both (or one) of its components are among the two that are named as holding the discrepancy
        together (where none are, that have the largest shares of it), or share a group of two with one of
        them.
    noise_recognised : bool or None
        Without a cause: the leading explanation is "no-gap", or "correlated-noise" is in its group.
    learned : Learned or None
        The most probable function of the true component; None where the truth is no such function.
    """

    case: str
    kind: str
    tags: Mapping[str, str]
    true: tuple[str, ...]
    probabilities: Mapping[str, float] = field(default_factory=dict)
    leader: str = ""
    group: tuple[str, ...] = ()
    found: bool = False
    wrong_and_sure: bool = False
    log_score: float | None = None
    brier: float | None = None
    both: bool | None = None
    one: bool | None = None
    noise_recognised: bool | None = None
    learned: Learned | None = None

    @property
    def leader_probability(self) -> float:
        """Of the leader."""
        return self.probabilities.get(self.leader, 0.0)

    @property
    def leader_right(self) -> bool:
        """Whether the leader itself is right."""
        return self.leader in self.true

    def record(self) -> dict[str, Any]:
        """For score.json."""
        return asdict(self) | {"tags": dict(self.tags), "probabilities": dict(self.probabilities)}


def true_outcomes(key: CaseKey) -> tuple[str, ...]:
    """What is right by components; empty where the key does not say."""
    if key.kind == "none":
        return NULL, CORRELATED
    if key.components:
        return key.components
    return (CORRELATED,) if CORRELATED in key.names else ()


def score_components(key: CaseKey, answer: Answer | None, case: CaseScore) -> ComponentScore | None:
    """Score one answer by components; None where the key or the answer knows none.

    Parameters
    ----------
    key : CaseKey
    answer : Answer or None
        None where the diagnosis failed.
    case : CaseScore
        The same by explanations.

    Returns
    -------
    ComponentScore or None
    """
    true = true_outcomes(key)
    if not true or (answer is not None and not answer.components):
        return None
    pair = key.kind == PAIR
    if answer is None:
        missed = False if pair else None
        return ComponentScore(
            key.case, key.kind, key.tags, true, both=missed, one=missed,
            noise_recognised=False if key.kind == "none" else None,
        )  # fmt: skip
    own = {c.name: c.probability for c in answer.components}
    rest = dict.fromkeys(REST, 0.0)
    for e in answer.explanations:
        if e.name in rest:
            rest[e.name] += e.probability
    p = {**own, **rest}
    leader = max(p, key=lambda name: p[name])
    group = _group(answer, leader)
    stated = min(1.0, sum(p.get(name, 0.0) for name in true))
    both, one = _of_two(key, answer) if pair else (None, None)
    return ComponentScore(
        key.case,
        key.kind,
        key.tags,
        true,
        p,
        leader,
        group,
        leader in true or (len(group) <= SMALL_GROUP and bool(set(group) & set(true))),
        _wrong_and_sure(key, answer, case, leader, p[leader], group, true),
        math.log(max(stated, FLOOR)),
        (stated - 1) ** 2 + sum(x**2 for name, x in p.items() if name not in true),
        both,
        one,
        _noise_recognised(answer) if key.kind == "none" else None,
        _learned(key, answer) if key.by_component and not pair else None,
    )


def _group(answer: Answer, name: str) -> tuple[str, ...]:
    """A component and those that the data cannot tell from it."""
    mine = next((c.group for c in answer.components if c.name == name), None)
    if mine is None:
        return (name,)
    return tuple(c.name for c in answer.components if c.group == mine)


def _wrong_and_sure(
    key: CaseKey,
    answer: Answer,
    case: CaseScore,
    leader: str,
    p: float,
    group: tuple[str, ...],
    true: tuple[str, ...],
) -> bool:
    if leader not in REST and p > SURE and not set(group) & set(true):
        return True
    first = answer.explanations[0]
    named = {*REST, NONPARAMETRIC, *(c.name for c in answer.components)}
    if first.name in named or first.probability <= SURE:
        return False
    if answer.belongs.get(first.name) not in true:
        return True
    if not key.by_component or case.left_true is None:
        return False
    return case.left_true > NEARLY_ALL * key.noise


def _of_two(key: CaseKey, answer: Answer) -> tuple[bool, bool]:
    """Whether both components, and one of them, are among the two that are named or hold most."""
    shares = [c.share for c in answer.components]
    p = [c.probability for c in answer.components]
    size = p if None in shares else [float(x or 0.0) for x in shares]
    order = sorted(range(len(size)), key=lambda i: (-answer.components[i].one_of_several, -size[i]))
    said: set[str] = set()
    for i in order[:2]:
        group = _group(answer, answer.components[i].name)
        said |= set(group) if len(group) <= SMALL_GROUP else {answer.components[i].name}
    hits = sum(name in said for name in key.components)
    return hits == len(key.components), hits > 0


def _noise_recognised(answer: Answer) -> bool:
    groups = answer.groups
    together = {
        e.name for e, group in zip(answer.explanations, groups, strict=True) if group == groups[0]
    } | set(answer.cause)
    return answer.explanations[0].name == NULL or CORRELATED in together


def _learned(key: CaseKey, answer: Answer) -> Learned | None:
    """The most probable function of the true component beside the true one."""
    component = next((c for c in answer.components if c.name in key.components), None)
    if component is None or not component.functions or key.functions is None:
        return None
    stated: StatedFunction = component.functions[0]
    true = key.functions(component.name, stated)
    if true is None or not np.any(np.isfinite(true)):
        return None
    known = np.isfinite(true)
    held = known & (stated.low <= true) & (true <= stated.high)
    width = np.full(len(true), math.nan)
    if stated.prior_sd:
        width = (stated.high - stated.low) / (2 * 1.96 * stated.prior_sd)
    narrow = known & (width < NARROW)
    return Learned(
        stated.name,
        int(known.sum()),
        int(held.sum()),
        int(narrow.sum()),
        int((held & narrow).sum()),
        float(np.median(width[known])),
        stated.narrowed,
    )
