"""A posterior over sets of causes, and what is summed from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.causes.evidence import SetEvidence, SizePriors
from zoo.core.causes.problem import Cause
from zoo.core.causes.sets import CausePriors

Array = NDArray[np.float64]
NOTHING = 0.1
"""Part of the noise below which a discrepancy does not matter."""


@dataclass(frozen=True, eq=False)
class SetRow:
    """A set of causes that was weighed beside all errors.

    Parameters
    ----------
    which : tuple of int
        Indices of the causes.
    log_prior : float
    evidence : SetEvidence
    solved : bool
        Whether it is linear around its own mode, found with the simulator.
    shift : float
        What is added to its log evidence, since sets like it delivered less or more than they promised.
    """

    which: tuple[int, ...]
    log_prior: float
    evidence: SetEvidence = field(repr=False)
    solved: bool = False
    shift: float = 0.0


@dataclass(frozen=True, eq=False)
class CausePosterior:
    """Sets of causes with their probabilities.

    p(S | data) is proportional to p(S) p(data | S); all else here is a sum over it.

    Parameters
    ----------
    causes : tuple of Cause
    priors : CausePriors
    sizes : SizePriors
    rows : tuple of SetRow
        Sets weighed beside all errors.
    guessed : mapping of indices to float
        Log prior plus a guess of the log evidence of sets that were not.
    shifts : mapping of indices to float
        As `SetRow.shift`, of guesses.
    """

    causes: tuple[Cause, ...]
    priors: CausePriors
    sizes: SizePriors
    rows: tuple[SetRow, ...] = field(repr=False)
    guessed: Mapping[tuple[int, ...], float] = field(repr=False, default_factory=dict)
    shifts: Mapping[tuple[int, ...], float] = field(repr=False, default_factory=dict)

    @cached_property
    def log_joint(self) -> dict[tuple[int, ...], float]:
        """Log prior plus log evidence of every set."""
        own = {row.which: row.log_prior + row.evidence.total(self.sizes) + row.shift for row in self.rows}
        return own | {w: g + self.shifts.get(w, 0.0) for w, g in self.guessed.items() if w not in own}

    @cached_property
    def probability(self) -> dict[tuple[int, ...], float]:
        """Of every set, most probable first."""
        total = logsumexp(list(self.log_joint.values()))
        found = {w: math.exp(x - total) for w, x in self.log_joint.items()}
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    @property
    def guessed_mass(self) -> float:
        """Probability of the sets that were not weighed beside all errors."""
        return sum(self.probability[w] for w in self.guessed)

    def included(self, of: Callable[[Cause], str]) -> dict[str, float]:
        """Probability that a set holds a cause of each name, most probable first."""
        found: dict[str, float] = {}
        for which, p in self.probability.items():
            for name in {of(self.causes[i]) for i in which}:
                found[name] = found.get(name, 0.0) + p
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    @property
    def components(self) -> dict[str, float]:
        """Probability that each component is wrong."""
        return dict.fromkeys(self.priors.names, 0.0) | self.included(lambda one: one.component)

    @property
    def number(self) -> Array:
        """Probability of 0, 1, ... causes."""
        found = np.zeros(1 + max(len(w) for w in self.probability))
        for which, p in self.probability.items():
            found[len(which)] += p
        return found

    def negligible(self, noise: float, numerics: float) -> float:
        """Probability, given no cause, of a discrepancy below the numerics' error or a tenth of the noise.

        Parameters
        ----------
        noise, numerics : float
            In parts of the range.
        """
        empty = next(row for row in self.rows if not row.which)
        return math.exp(empty.evidence.small(self.sizes, max(NOTHING * noise, numerics)))

    def no_gap(self, noise: float, numerics: float) -> float:
        """Probability of no cause and of a `negligible` discrepancy."""
        return self.probability[()] * self.negligible(noise, numerics)

    def under(self, sizes: SizePriors | None = None, odds: float | None = None) -> CausePosterior:
        """The same with another prior of the discrepancy's size, or other odds; guesses stay."""
        priors = self.priors if odds is None else replace(self.priors, odds=odds)
        rows = tuple(replace(row, log_prior=priors.log_prior(row.which)) for row in self.rows)
        guessed = {w: g - self.priors.log_prior(w) + priors.log_prior(w) for w, g in self.guessed.items()}
        return replace(self, priors=priors, sizes=sizes or self.sizes, rows=rows, guessed=guessed)
