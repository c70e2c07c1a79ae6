"""What a diagnosis answers about a case, reduced to what is scored."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.diagnosis.diagnosis import Diagnosis
from zoo.core.diagnosis.file import ComponentResult
from zoo.core.effects import EVERYWHERE, Location

Array = NDArray[np.float64]


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
    amplitude_interval : (float, float), optional
        Its 95 % interval; mean ± 1.96 sd if None.
    prior_probability : float, optional
        What the prior alone gives it beside others of the same evidence; None where there are none.
    """

    name: str
    probability: float
    group: Hashable = None
    location: Location = EVERYWHERE
    amplitude: float | None = None
    amplitude_sd: float | None = None
    amplitude_interval: tuple[float, float] | None = None
    prior_probability: float | None = None


@dataclass(frozen=True)
class Size:
    """A stated size with its 95 % interval."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class StatedFunction:
    """A function that a component lacks, as a diagnosis states it.

    Parameters
    ----------
    name, unit : str
    at : array (n,)
        Its points.
    mean, low, high : array (n,)
        Its values with their 95 % band.
    labels : tuple of str
        Names of the points where they are places.
    prior_sd : float, optional
        Scale of its values before the data.
    narrowed : int
        Directions in which the data halve the prior's sd.
    beside : mapping
        The baseline's parameters with it.
    """

    name: str
    at: Array
    mean: Array
    low: Array
    high: Array
    unit: str = "1"
    labels: tuple[str, ...] = ()
    prior_sd: float | None = None
    narrowed: int = 0
    beside: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class StatedComponent:
    """A component of the simulator as a diagnosis states it.

    Parameters
    ----------
    name : str
    probability : float
        Of a cause in it, listed effects included.
    group : hashable
        The same for components that the data cannot tell apart.
    share : float, optional
        Of the discrepancy's energy.
    functions : tuple of StatedFunction
        The most probable first.
    one_of_several : bool
        It is said that others hold part of the discrepancy too.
    """

    name: str
    probability: float
    group: Hashable
    share: float | None = None
    functions: tuple[StatedFunction, ...] = ()
    one_of_several: bool = False


@dataclass(frozen=True)
class Fitted:
    """Series that an answer fits to the data.

    Parameters
    ----------
    base, leader : array (n_series, n_times)
        Of the baseline, and of the leading explanation; the baseline's where that is no effect.
    rows : tuple of int
        The series that the stated discrepancy is of.
    """

    base: Array
    leader: Array
    rows: tuple[int, ...]

    def left(self, truth: Array) -> tuple[float, float]:
        """Rms of the noise-free data minus the baseline's fit, and minus the leader's.

        Raises
        ------
        ValueError
            If the series have other lengths.
        """
        if truth.shape != self.base.shape:
            raise ValueError(f"the key's series have the shape {truth.shape}, the fit's {self.base.shape}")
        rows = list(self.rows)
        base, leader = (float(np.sqrt(np.mean((truth - x)[rows] ** 2))) for x in (self.base, self.leader))
        return base, leader


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
    gap_before, gap_after : Size, optional
        Stated model discrepancy of the baseline, and with the leading explanation.
    fitted : Fitted, optional
        What these are compared with, beside the noise-free data.
    parents : mapping, optional
        Part of the simulator -> the part above it, None for the root: distances between locations.
    seconds : float
        What the diagnosis took.
    checksum : str
        Of the data.
    states_prior : bool
        Whether it says of its explanations what the prior alone gives.
    components : tuple of StatedComponent
        The most probable first; empty where a diagnosis knows none.
    belongs : mapping
        Listed effect -> its component.
    """

    explanations: tuple[Explanation, ...]
    invisible: frozenset[str] = frozenset()
    cause: tuple[str, ...] = ()
    gap_before: Size | None = None
    gap_after: Size | None = None
    fitted: Fitted | None = field(default=None, compare=False)
    parents: Mapping[Any, Any] = field(default_factory=dict)
    seconds: float = math.nan
    checksum: str = ""
    states_prior: bool = False
    components: tuple[StatedComponent, ...] = field(default=(), compare=False)
    belongs: Mapping[str, str] = field(default_factory=dict)

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


def as_answer(
    found: Any,
    parents: Mapping[Any, Any] | None = None,
    fitted: Fitted | None = None,
    belongs: Mapping[str, str] | None = None,
) -> Answer:
    """The answer that a diagnosis gives.

    Parameters
    ----------
    found : Answer, DiagnosisFile or Diagnosis
        An answer is given back as it is; a diagnosis is read from the fields of its diagnosis.json.
    parents : mapping, optional
        As in `Answer`.
    fitted : Fitted, optional
        That of a file, which has no series; a `Diagnosis` has its own.
    belongs : mapping, optional
        As in `Answer`.

    Returns
    -------
    Answer
    """
    if isinstance(found, Answer):
        return found
    if isinstance(found, Diagnosis):
        fitted = fitted_series(found)
    file = getattr(found, "file", found)
    explanations = tuple(
        Explanation(
            h.name,
            h.probability,
            h.group,
            Location(h.place, h.subtree),
            h.amplitude.mean if h.amplitude else None,
            h.amplitude.sd if h.amplitude else None,
            getattr(h.amplitude, "interval", None),
            getattr(h, "prior_probability", None),
        )
        for h in file.hypotheses
    )
    return Answer(
        _with_components(explanations, file),
        frozenset(file.invisible),
        tuple(file.cause),
        Size(file.gap.before, *file.gap.before_interval),
        Size(file.gap.after, *file.gap.after_interval),
        fitted,
        parents or {},
        float(file.record.get("screening_seconds", math.nan)),
        file.study_checksum,
        any(getattr(h, "log10_bayes_factor", None) is not None for h in file.hypotheses),
        tuple(_component(c) for c in file.components),
        belongs or {},
    )


def _with_components(explanations: tuple[Explanation, ...], file: Any) -> tuple[Explanation, ...]:
    """Explanations with what components lack by themselves, the leading one first.

    Those in the file's `cause` are of one group; another component's is one of its own.
    """
    if not file.components:
        return explanations
    cause = set(file.cause)
    group = next((e.group for e in explanations if e.name in cause), "cause")
    own = [
        Explanation(
            c.name,
            c.probability if c.own_probability is None else c.own_probability,
            group if c.name in cause else f"component {c.name}",
        )
        for c in file.components
    ]
    first = file.cause[0] if file.cause else ""
    return tuple(sorted([*explanations, *own], key=lambda e: (e.name != first, -e.probability)))


def _component(found: ComponentResult) -> StatedComponent:
    functions = tuple(
        StatedFunction(
            f.name,
            np.array(f.values),
            np.array(f.mean),
            np.array(f.low),
            np.array(f.high),
            f.unit,
            tuple(f.labels),
            f.prior_size,
            len(f.narrowed),
            dict(f.beside),
        )
        for f in found.functions
    )
    share = found.share.mean if found.share else None
    return StatedComponent(found.name, found.probability, found.group, share, functions, found.one_of_several)


def fitted_series(found: Diagnosis) -> Fitted:
    """The series that a diagnosis fitted with the baseline, and with its leading explanation alone."""
    first = found.rounds[0]
    fits = (first.screened.least, first.best[first.leader] if first.is_cause(first.leader) else None)
    errors = first.screened.screening.errors
    base, leader = (errors.unflat((fit or fits[0]).computed) for fit in fits)
    return Fitted(base, leader, tuple(found.hooks.rows(found.data)))
