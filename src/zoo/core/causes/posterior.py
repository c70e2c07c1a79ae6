"""A posterior over sets of causes, and what is summed from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.causes.evidence import SetEvidence, SizePriors
from zoo.core.causes.problem import Cause
from zoo.core.causes.set_priors import CausePriors, likeness
from zoo.core.threads import threads

Array = NDArray[np.float64]
Indices = NDArray[np.int_]
NOTHING = 0.1
"""Part of the noise below which a discrepancy does not matter."""
PARTS = (1.0, 1 / 2, 1 / 4, 1 / 8, 1 / 16)
"""Parts of the record's information that are believed."""


@dataclass(frozen=True, eq=False)
class SetRow:
    """A set of causes that was weighed given all error models.

    Parameters
    ----------
    which : tuple of int
        Indices of the causes.
    log_prior : float
    evidence : SetEvidence
    shift : float
        What is added to its log evidence, since sets like it delivered less or more than they promised.
    """

    which: tuple[int, ...]
    log_prior: float
    evidence: SetEvidence = field(repr=False)
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
        Sets weighed given all error models.
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
        """Probability of the sets that were not weighed given all error models."""
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
        """The same with other priors of sizes, or other odds; guesses move as the set most like each."""
        priors = self.priors if odds is None else replace(self.priors, odds=odds)
        rows = tuple(replace(row, log_prior=priors.log_prior(row.which)) for row in self.rows)
        return self._with(rows, sizes or self.sizes, priors)

    def coarsened(self, part: float, *, cores: int = 2) -> CausePosterior:
        """The same where only a part of the record's information is believed.

        The likelihood is taken to the power `part` = alpha / (alpha + n), as by Miller and Dunson (2019, doi
        10.1080/01621459.2018.1469995): p(S | data coarsened) for distances of the data from the model, in
        relative entropy, of mean 1 / alpha beforehand. Each weighed set is computed again, its noise found
        again; solves are not done again, what they gained is taken in proportion. A guess keeps its
        difference from the weighed set most like it, in proportion.

        Parameters
        ----------
        part : float
            Between 0, the prior, and 1, the posterior.
        cores : int
            Threads.

        Returns
        -------
        CausePosterior
        """
        if part == 1.0:
            return self

        def one(row: SetRow) -> SetRow:
            return replace(row, evidence=row.evidence.coarsened(part), shift=part * row.shift)

        with threads(cores) as pool:
            rows = tuple(pool.map(one, self.rows))
        return self._with(rows, self.sizes, self.priors, part)

    def coarsening(self, parts: Sequence[float] = PARTS, *, cores: int = 2) -> Any:
        """Probability of each component, and of nothing, by the part of the information that is believed.

        Parameters
        ----------
        parts : sequence of float
        cores : int
            Threads.

        Returns
        -------
        pandas.DataFrame
            A row for each part.
        """
        import pandas as pd

        found = {part: self.coarsened(part, cores=cores) for part in parts}
        rows = {part: one.components | {"nothing": one.probability[()]} for part, one in found.items()}
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("part")

    def _with(
        self, rows: tuple[SetRow, ...], sizes: SizePriors, priors: CausePriors, power: float = 1.0
    ) -> CausePosterior:
        """With other rows; a guess keeps its difference, to a power, from the weighed set most like it."""
        sets, near = self._most_like
        before = np.array([self.log_joint[row.which] - row.log_prior for row in self.rows])
        after = np.array([row.evidence.total(sizes) + row.shift for row in rows])
        guesses = np.array([self.log_joint[w] - self.priors.log_prior(w) for w in sets])
        guesses = after[near] + power * (guesses - before[near])
        guessed = {w: g + priors.log_prior(w) for w, g in zip(sets, guesses, strict=True)}
        return replace(self, rows=rows, sizes=sizes, priors=priors, guessed=guessed, shifts={})

    @cached_property
    def _most_like(self) -> tuple[list[tuple[int, ...]], Indices]:
        """Guessed sets, and the index of the row most like each: in causes, then in components by sort."""
        known = [row.which for row in self.rows]
        sets = [w for w in self.guessed if w not in set(known)]
        like = likeness(sets, known, self.causes)
        like[:, [not w for w in known]] = 1e-9  # nothing, where no other is like it
        return sets, np.asarray(np.argmax(like, axis=1))
