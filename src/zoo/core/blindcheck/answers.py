"""What a diagnosis answers about a case, reduced to what is scored."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any

from zoo.core.effects import EVERYWHERE, Location


@dataclass(frozen=True)
class Explanation:
    """One explanation of the data.

    Parameters
    ----------
    name : str
        Of an effect; "no-gap" (null hypothesis) or "unlisted" (nonparametric discrepancy).
    probability : float
    group : hashable, optional
        The same for explanations that the data cannot tell apart; one of its own if None.
    location : Location
    amplitude, amplitude_sd : float, optional
        Posterior mean and standard deviation of the effect's first parameter.
    """

    name: str
    probability: float
    group: Hashable = None
    location: Location = EVERYWHERE
    amplitude: float | None = None
    amplitude_sd: float | None = None


@dataclass(frozen=True)
class Answer:
    """Explanations of a case's data, the most probable first.

    Parameters
    ----------
    explanations : tuple of Explanation
    invisible : frozenset of str
        Names of explanations that these data cannot show; a uniform guess gives them no share.
    cause : tuple of str
        Names that the diagnosis calls the cause together.
    removed, removed_low, removed_high : float, optional
        Part of the model discrepancy that the cause removes, and its 95 % interval.
    parents : mapping, optional
        Part of the simulator -> the part above it, None for the root: distances between locations.
    seconds : float
        What the diagnosis took.
    checksum : str
        Of the data.
    """

    explanations: tuple[Explanation, ...]
    invisible: frozenset[str] = frozenset()
    cause: tuple[str, ...] = ()
    removed: float | None = None
    removed_low: float | None = None
    removed_high: float | None = None
    parents: Mapping[Any, Any] = field(default_factory=dict)
    seconds: float = math.nan
    checksum: str = ""

    @classmethod
    def ranked(cls, probabilities: Mapping[str, float]) -> Answer:
        """The answer of probabilities by name alone, each explanation a group of its own."""
        order = sorted(probabilities, key=lambda name: -probabilities[name])
        return cls(tuple(Explanation(name, probabilities[name]) for name in order))

    @property
    def groups(self) -> list[Hashable]:
        """Group of each explanation."""
        return [(i,) if e.group is None else e.group for i, e in enumerate(self.explanations)]

    @property
    def group_probabilities(self) -> dict[Hashable, float]:
        """Of each group, in the order of their first explanations."""
        total: dict[Hashable, float] = {}
        for group, explanation in zip(self.groups, self.explanations, strict=True):
            total[group] = total.get(group, 0.0) + explanation.probability
        return total


def as_answer(found: Any, parents: Mapping[Any, Any] | None = None) -> Answer:
    """The answer that a diagnosis gives.

    Parameters
    ----------
    found : Answer, DiagnosisFile or Diagnosis
        An answer is given back as it is; a diagnosis is read from the fields of its diagnosis.json.
    parents : mapping, optional
        As in `Answer`.

    Returns
    -------
    Answer
    """
    if isinstance(found, Answer):
        return found
    file = getattr(found, "file", found)
    low, high = file.gap.removed_interval
    explanations = tuple(
        Explanation(
            h.name,
            h.probability,
            h.group,
            Location(h.place, h.subtree),
            h.amplitude.mean if h.amplitude else None,
            h.amplitude.sd if h.amplitude else None,
        )
        for h in file.hypotheses
    )
    return Answer(
        explanations,
        frozenset(file.invisible),
        tuple(file.cause),
        file.gap.removed,
        low,
        high,
        parents or {},
        float(file.record.get("screening_seconds", math.nan)),
        file.study_checksum,
    )
