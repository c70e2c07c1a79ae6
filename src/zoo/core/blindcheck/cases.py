"""What a case withholds, and what a diagnosis answers about it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from zoo.core.diagnosis.diagnosis import Diagnosis
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, NULL
from zoo.core.words import OneLineError

Array = NDArray[np.float64]
Place = int | str | None
REST = (NULL, CORRELATED)
"""What an answer gives probability to besides components; "unlisted" is the free function of one of these."""
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
        Names of explanations that are right; empty where no explanation is, and a component has to be named.
    components : sequence of str
        Components of the simulator that the cause lies in.
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
        Whatever else is withheld.
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


class Size(_Record):
    """A stated size with its 95 % interval, and the true one where it is known already."""

    mean: float
    low: float
    high: float
    true: float | None = None


class Explanation(_Record):
    """One explanation of the data: an effect or a component, "no-gap", "correlated-noise" or "unlisted".

    Explanations of one `group` are those that the data cannot tell apart; one without is alone. The
    `parameter` is the effect's first.
    """

    name: str
    probability: float
    group: int | str | None = None
    place: Place = None
    subtree: bool = False
    parameter: Size | None = None


class Fitted(_Record):
    """Series that an answer fits to the data, of the baseline and of the leading explanation alone.

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


class Answer(_Record):
    """What a diagnosis says of a case.

    Parameters
    ----------
    explanations : sequence of Explanation
        The leading one first.
    components : sequence of Explanation
        Components of the simulator, each with the probability of a cause in it, listed effects included;
        empty where a diagnosis knows none.
    gap, left : Size, optional
        Model discrepancy of the baseline, and with the leading explanation.
    fitted : Fitted, optional
        What these are compared with, beside the noise-free data.
    seconds : float, optional
    """

    explanations: tuple[Explanation, ...] = Field(min_length=1)
    components: tuple[Explanation, ...] = ()
    gap: Size | None = None
    left: Size | None = None
    fitted: Fitted | None = Field(default=None, repr=False)
    seconds: float | None = None

    @classmethod
    def ranked(cls, probabilities: Mapping[str, float]) -> Answer:
        """The answer of probabilities by name alone, each explanation a group of its own."""
        order = sorted(probabilities, key=lambda name: -probabilities[name])
        return cls(explanations=tuple(Explanation(name=n, probability=probabilities[n]) for n in order))

    def by_component(self) -> tuple[Explanation, ...]:
        """Components and what else there is, the most probable first."""
        rest = [e.model_copy(update={"group": None}) for e in self.explanations if e.name in REST]
        return tuple(sorted([*self.components, *rest], key=lambda e: -e.probability))


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
    file = getattr(found, "file", found)
    explanations = [
        Explanation(
            name=h.name,
            probability=h.probability,
            group=h.group,
            place=h.place,
            subtree=h.subtree,
            parameter=_size(h.amplitude),
        )
        for h in file.hypotheses
    ]
    cause = set(file.cause)
    group = next((e.group for e in explanations if e.name in cause), "cause")
    for c in file.components:  # what a component lacks by itself is an explanation, too
        own = c.probability if c.own_probability is None else c.own_probability
        mine = group if c.name in cause else f"component {c.name}"
        explanations.append(Explanation(name=c.name, probability=own, group=mine))
    first = file.cause[0] if file.cause else ""
    before, after = (
        Size(mean=mean, low=interval[0], high=interval[1])
        for mean, interval in (
            (file.gap.before, file.gap.before_interval),
            (file.gap.after, file.gap.after_interval),
        )
    )
    leads = file.cause and first not in (NULL, NONPARAMETRIC, CORRELATED)
    seconds = float(file.record.get("screening_seconds", math.nan))
    return Answer(
        explanations=tuple(sorted(explanations, key=lambda e: (e.name != first, -e.probability))),
        components=tuple(
            Explanation(name=c.name, probability=c.probability, group=c.group) for c in file.components
        ),
        gap=before,
        left=after if leads else None,
        fitted=_fitted(found) if isinstance(found, Diagnosis) else None,
        seconds=None if math.isnan(seconds) else seconds,
    )


def _size(estimate: Any) -> Size | None:
    """The 95 % interval of an estimate, as stated or of its standard deviation; None without either."""
    if estimate is None or (estimate.interval is None and not estimate.sd):
        return None
    low, high = estimate.interval or (
        estimate.mean - 1.96 * estimate.sd,
        estimate.mean + 1.96 * estimate.sd,
    )
    return Size(mean=estimate.mean, low=low, high=high)


def _fitted(found: Diagnosis) -> Fitted:
    """The series that a diagnosis fitted with the baseline, and with its leading explanation alone."""
    first = found.rounds[0]
    fits = (first.screened.least, first.best[first.leader] if first.is_cause(first.leader) else None)
    errors = first.screened.screening.errors
    base, leader = (
        tuple(map(tuple, np.round(errors.unflat((fit or fits[0]).computed), DIGITS).tolist())) for fit in fits
    )
    return Fitted(base=base, leader=leader, rows=tuple(found.hooks.rows(found.data)))
