"""A set of causes at its mode, and the simulator linear around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zoo.core.causes.evidence import SIZE_PRIORS, SetEvidence
from zoo.core.causes.problem import Cause, Problem
from zoo.core.diagnosis.coordinates import SearchModel
from zoo.core.diagnosis.responses import Origin
from zoo.core.diagnosis.search import Point

Array = NDArray[np.float64]
Which = tuple[int, ...]


def places(order: Which, n_base: int, origins: Sequence[Origin]) -> dict[int, slice]:
    """Coordinates of causes in an order, after those of the baseline."""
    ends = np.cumsum([n_base, *(len(origins[i].effect().effect.parameters) for i in order)]).tolist()
    return {i: slice(*ends[k : k + 2]) for k, i in enumerate(order)}


@dataclass(frozen=True, eq=False)
class SolvedSet:
    """A set of causes at its mode: the point, and its evidence there.

    Parameters
    ----------
    order : tuple of int
        Its causes as the forward model has them, listed effects before functions.
    forward : SearchModel
    point : Point
        `computed` is without the simulator's discretisation error there, where it has a finer grid.
    evidence : SetEvidence
        Of listed effects by steps from the point, of functions by their weights, in the order of `order`.
    n_listed : int
        Coordinates before those of functions.
    """

    order: Which
    forward: SearchModel = field(repr=False)
    point: Point = field(repr=False)
    evidence: SetEvidence = field(repr=False)
    n_listed: int

    @cached_property
    def log_z(self) -> float:
        """Log evidence."""
        return self.evidence.total(SIZE_PRIORS)

    def series(self, x: Array) -> Array:
        """Linear predictions (..., n) at steps and weights (..., p), as `SetEvidence.mean` has them."""
        return np.asarray(self.point.computed + (x - self.seen) @ self.point.jacobian.T)

    @property
    def seen(self) -> Array:
        """The point itself as steps and weights, (p,)."""
        found = self.point.u.copy()
        found[: self.n_listed] = 0.0
        return found

    def places(self, origins: Sequence[Origin]) -> dict[int, slice]:
        """Coordinates of each cause by its index."""
        return places(self.order, self.forward.n_base, origins)


@dataclass(frozen=True, eq=False)
class Linear:
    """What each cause does around one set of causes at its mode.

    Parameters
    ----------
    centre : tuple of int
        The set; only sets that hold it are weighed here.
    u : array (k,)
        Coordinates of the baseline there.
    problem : Problem
    causes : tuple of Cause
        By their indices; those that cannot be added to the centre have no response.
    values : tuple of array
        Of the parameters of each cause, from which its weights count.
    log_z : float
        Log evidence of the centre.
    """

    centre: Which
    u: Array
    problem: Problem
    causes: tuple[Cause, ...]
    values: tuple[Array, ...]
    log_z: float

    @property
    def rank(self) -> tuple[int, float]:
        """Of two centres that a set holds, it is linear around the one with more causes, or more evidence."""
        return len(self.centre), self.log_z

    def start(
        self, which: Which, order: Which, mean: Array, origins: Sequence[Origin]
    ) -> tuple[Array, Array, Array]:
        """Coordinates of a set without and with its causes, and derivatives, at steps and weights (p,)."""
        k = len(self.u)
        sizes = [self.causes[i].columns.shape[1] for i in which]
        weights = dict(zip(which, np.split(mean[k:], np.cumsum(sizes)[:-1]), strict=True)) if which else {}
        without, at, columns = [self.u], [self.u + mean[:k]], [self.problem.jacobian]
        for i in order:
            without.append(self.values[i])
            at.append(self.values[i] + weights[i] * origins[i].scales)
            columns.append(self.causes[i].columns / origins[i].scales)
        return np.concatenate(without), np.concatenate(at), np.concatenate(columns, axis=1)


def tangents(
    centre: SolvedSet, residual: Array, causes: Sequence[Cause], origins: Sequence[Origin]
) -> tuple[Array, dict[int, tuple[Cause, Array]]]:
    """Own causes of a set as linear around its mode, and the residual without what they do.

    Weights of functions and of effects' first parameters count from where these are absent.

    Parameters
    ----------
    centre : SolvedSet
    residual : array (n,)
        At the mode.
    causes : sequence of Cause
        All, by their indices.
    origins : sequence of Origin

    Returns
    -------
    residual : array (n,)
    found : dict
        Cause, and values from which its weights count, by index.
    """
    found = {}
    for i, part in centre.places(origins).items():
        values, columns, scales = centre.point.u[part], centre.point.jacobian[:, part], origins[i].scales
        absent = np.full(len(values), causes[i].free)
        absent[0] = True
        residual = residual + columns[:, absent] @ values[absent]
        mean = np.where(absent, 0.0, (origins[i].centres - values) / scales)
        found[i] = replace(causes[i], columns=columns * scales, mean=mean), np.where(absent, 0.0, values)
    return residual, found
