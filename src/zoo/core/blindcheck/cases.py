"""What a case withholds, and what a diagnosis answers about it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from zoo.core.diagnosis.diagnosis import Diagnosis
from zoo.core.diagnosis.file import DiagnosisFile, Estimate
from zoo.core.words import OneLineError

Array = NDArray[np.float64]
Place = int | str | None
NULL = "no-gap"
"""Label of a case without a cause."""
NOISE = (NULL, "correlated-noise")
UNLISTED = "unlisted"
DIGITS = 7


class BlindError(OneLineError, ValueError):
    """Cases, answers or a key that cannot be used; the text says why and what to change."""


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class CaseKey(_Record):
    """What the key says about a case.

    Parameters
    ----------
    case : str
    kind : str
        What scores are grouped by, such as "none" (no effect) or "listed" (one that the diagnosis knows).
    label : str
        What is true, in words.
    accepted : sequence of str
        Names of listed effects that are right; empty where none is.
    components : sequence of str
        Components of the simulator that the cause lies in; where neither is given, nothing that a diagnosis
        can name is wrong.
    place, subtree
        Where the effect acts.
    parameter : float, optional
        Of the effect; None where there is no stated size to compare it with.
    prior_95 : (float, float), optional
        Central 95 % interval of the prior that the parameter was drawn from.
    noise : float, optional
        Standard deviation of the noise.
    gap : float, optional
        Model discrepancy of the refitted baseline, in the unit of the noise.
    truth : sequence of sequences of float, optional
        The data without noise, by series.
    tags : mapping of str to str
        What else tells cases apart; scores can be grouped by it.
    drawn : mapping
        Whatever else is withheld; the true values of the baseline's parameters as `base_parameters`.
    files : str
        Digest of the case's files; empty for a case in memory.
    """

    case: str
    kind: str
    label: str
    accepted: tuple[str, ...] = ()
    components: tuple[str, ...] = ()
    place: Place = None
    subtree: bool = False
    parameter: float | None = None
    prior_95: tuple[float, float] | None = None
    noise: float | None = None
    gap: float | None = None
    truth: tuple[tuple[float, ...], ...] | None = Field(default=None, repr=False)
    tags: dict[str, str] = {}
    drawn: dict[str, Any] = {}
    files: str = ""

    @property
    def parameters(self) -> dict[str, float]:
        """True values of the baseline's parameters, where they are told."""
        return dict(self.drawn.get("base_parameters", {}))

    @property
    def effects(self) -> tuple[str, ...]:
        """Listed effects that are right; older keys accept noise, and components beside "unlisted", too."""
        return () if UNLISTED in self.accepted else tuple(x for x in self.accepted if x not in NOISE)

    @property
    def wrong(self) -> tuple[str, ...]:
        """Components that are wrong; an effect in none is a component of its own."""
        return self.components or self.effects


class Size(_Record):
    """A stated size with its 95 % interval, and the true one where it is known already."""

    mean: float
    low: float
    high: float
    true: float | None = None


class Fitted(_Record):
    """Series that an answer fits to the data, of the baseline and with the leading causes.

    `rows` are the series that the stated discrepancy is of.
    """

    base: tuple[tuple[float, ...], ...]
    leader: tuple[tuple[float, ...], ...]
    rows: tuple[int, ...]

    def left(self, truth: Sequence[Sequence[float]]) -> tuple[float, float]:
        """Rms of the noise-free data minus the baseline's fit, and minus the leader's.

        Raises
        ------
        ValueError
            If the series have other lengths.
        """
        true, base, leader = (np.array(x, dtype=float) for x in (truth, self.base, self.leader))
        if true.shape != base.shape:
            raise ValueError(f"the key's series have the shape {true.shape}, the fit's {base.shape}")
        rows = list(self.rows)
        before, after = (float(np.sqrt(np.mean((true - x)[rows] ** 2))) for x in (base, leader))
        return before, after


class Group(_Record):
    """Listed effects that an answer cannot tell apart, and the probability of any of them.

    That holds what components lack by themselves, too, where the answer counts this to the group.
    """

    names: tuple[str, ...]
    probability: float


class Answer(_Record):
    """What a diagnosis says of a case: inclusion probabilities, of which several may be near 1.

    Parameters
    ----------
    components : mapping of str to float
        Probability that each component of the simulator is wrong, by a listed effect or by something else.
    nothing : float
        Probability that nothing is wrong that the diagnosis can name.
    effects : mapping of str to float
        Probability of each listed effect.
    groups : sequence of Group
        Each listed effect is in one; those without are alone.
    sizes : mapping of str to Size
        Of the first parameter of listed effects.
    alone, averaged : mapping of str to Size
        Of the baseline's parameters, by itself and over all sets of causes.
    gap, left : Size, optional
        Model discrepancy of the baseline, and with the leading causes.
    fitted : Fitted, optional
        What these are compared with, beside the noise-free data.
    seconds : float, optional
    """

    components: dict[str, float]
    nothing: float
    effects: dict[str, float] = {}
    groups: tuple[Group, ...] = ()
    sizes: dict[str, Size] = {}
    alone: dict[str, Size] = {}
    averaged: dict[str, Size] = {}
    gap: Size | None = None
    left: Size | None = None
    fitted: Fitted | None = Field(default=None, repr=False)
    seconds: float | None = None

    @classmethod
    def ranked(cls, probabilities: Mapping[str, float]) -> Answer:
        """The answer of probabilities of effects, each a component of its own, and of "no-gap"."""
        effects = {name: p for name, p in probabilities.items() if name != NULL}
        return cls(components=effects, nothing=probabilities.get(NULL, 0.0), effects=effects)


def _sizes(estimates: Mapping[str, Estimate]) -> dict[str, Size]:
    return {
        name: Size(mean=x.mean, low=x.interval[0], high=x.interval[1])
        for name, x in estimates.items()
        if x.interval
    }


def as_answer(found: Any) -> Answer:
    """The answer that a diagnosis gives.

    Parameters
    ----------
    found : Answer, DiagnosisFile or Diagnosis
        An answer is given back as it is; a diagnosis is read from the fields of its diagnosis.json. A
        `Diagnosis` has the series that it fitted, too.

    Returns
    -------
    Answer
    """
    if isinstance(found, Answer):
        return found
    file: DiagnosisFile = getattr(found, "file", found)
    gap, listed = file.gap, [one for one in file.causes if not one.free]
    before = Size(mean=gap.before, low=gap.before_interval[0], high=gap.before_interval[1])
    after = Size(mean=gap.after, low=gap.after_interval[0], high=gap.after_interval[1])
    return Answer(
        components={one.name: one.probability for one in file.components},
        nothing=math.fsum(row.probability for row in file.sets if not row.causes),
        effects={one.name: one.probability for one in listed},
        groups=_groups(file),
        sizes=_sizes({one.name: one.estimates[0] for one in listed if one.estimates}),
        alone=_sizes(file.base_parameters["base"]),
        averaged=_sizes(file.base_parameters["over all sets"]),
        gap=before,
        left=after if file.cause else None,
        fitted=_fitted(found) if isinstance(found, Diagnosis) else None,
        seconds=file.record.get("seconds"),
    )


def _groups(file: DiagnosisFile) -> tuple[Group, ...]:
    """Listed effects of components that can stand in for one another."""
    groups: list[set[str]] = []
    for one in file.components:
        if one.confounded:
            new = {one.name, *one.confounded}
            groups = [g for g in groups if not g & new] + [new.union(*(g for g in groups if g & new))]
    found = []
    for group in groups:
        names = tuple(one.name for one in file.causes if one.component in group and not one.free)
        p = math.fsum(row.probability for row in file.sets if group & set(row.components))
        found.append(Group(names=names, probability=p))
    return tuple(one for one in found if one.names)


def _fitted(found: Diagnosis) -> Fitted:
    """The series that a diagnosis fitted with the baseline, and with its leading causes."""
    base, leader = (tuple(map(tuple, np.round(one, DIGITS).tolist())) for one in found.computed)
    return Fitted(base=base, leader=leader, rows=tuple(found.hooks.rows(found.data)))
