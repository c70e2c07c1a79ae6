"""Prior probabilities of sets of causes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zoo.core.causes.problem import Cause

Array = NDArray[np.float64]
Which = tuple[int, ...]
ODDS = 0.1
"""Of a component being wrong."""
FREE = 0.5
"""Part of a wrong component's probability that its free functions have; listed effects have the rest."""
MOST = 4
"""Components that are wrong at once at most."""


def likeness(sets: Sequence[Which], known: Sequence[Which], causes: Sequence[Cause]) -> Array:
    """Part (n_sets, n_known) of what two sets hold that both hold: causes, and components by sort."""
    sorts = {sort: i for i, sort in enumerate(dict.fromkeys((c.component, c.free) for c in causes))}
    of = np.array([sorts[c.component, c.free] for c in causes], int)

    def members(which: Sequence[Which]) -> Array:
        found = np.zeros((len(which), len(causes) + len(sorts)))
        for row, w in zip(found, which, strict=True):
            at = list(w)
            row[at] = 1.0
            row[len(causes) + of[at]] = 1.0
        return found

    asked, there = members(sets), members(known)
    both = asked @ there.T
    return np.asarray(both / np.maximum(asked.sum(axis=1)[:, None] + there.sum(axis=1) - both, 1.0))


@dataclass(frozen=True, eq=False)
class CausePriors:
    """Each component is wrong with the same odds, by one of its causes.

    p(S) is proportional to the product over the causes in S of odds times the cause's share of its component.
    A component's functions have half of it where it has listed effects too; names share it alike, then the
    lengths of a function or the places of an effect.

    Parameters
    ----------
    causes : sequence of Cause
    odds : float
    most : int
        Components that are wrong at once at most.
    """

    causes: Sequence[Cause]
    odds: float = ODDS
    most: int = MOST

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the components that have a cause."""
        return tuple(dict.fromkeys(one.component for one in self.causes))

    @cached_property
    def log_shares(self) -> Array:
        """Log share (n_causes,) of each cause in its component."""
        members: dict[tuple[str, bool], dict[str, int]] = {}
        for one in self.causes:
            names = members.setdefault((one.component, one.free), {})
            names[one.name] = names.get(one.name, 0) + 1
        found = []
        for one in self.causes:
            names = members[one.component, one.free]
            both = (one.component, not one.free) in members
            half = (FREE if one.free else 1.0 - FREE) if both else 1.0
            found.append(math.log(half) - math.log(len(names)) - math.log(names[one.name]))
        return np.array(found)

    @cached_property
    def log_nothing(self) -> float:
        """Log prior of the empty set."""
        n, k = len(self.names), self.most
        return -math.log(sum(math.comb(n, i) * self.odds**i for i in range(min(n, k) + 1)))

    def log_prior(self, which: Sequence[int]) -> float:
        """Log prior of a set of causes by their indices, each of another component."""
        return self.log_nothing + sum(math.log(self.odds) + float(self.log_shares[i]) for i in which)

    def inclusion(self) -> Mapping[str, float]:
        """Prior probability that each component is wrong."""
        n = len(self.names)
        terms = [math.comb(n - 1, i - 1) * self.odds**i for i in range(1, min(n, self.most) + 1)]
        return dict.fromkeys(self.names, sum(terms) * math.exp(self.log_nothing))
