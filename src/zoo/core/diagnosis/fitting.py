"""The baseline's best fit to one record, sought from several starts before the errors are known."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from zoo.core.causes.family import ErrorFamily
from zoo.core.data import Data
from zoo.core.diagnosis.coordinates import SearchModel, ranges
from zoo.core.diagnosis.file import DiagnosisError
from zoo.core.diagnosis.search import Point, Search, SearchError, as_matrix
from zoo.core.effects import AddedEffect
from zoo.core.errors.spectral import Spectral
from zoo.core.forward import Corrected, ForwardModel

Array = NDArray[np.float64]

LOOSE = 0.1
"""Errors of the first descents, in parts of the range, as good as a linearisation is far off."""
LEAST = 1e-6
"""Variance of a perfect fit's errors, in parts of these."""
TRIED, DESCENDED = 32, 3
"""Points of the prior that are solved, and how many of the best a descent starts from, besides the median."""
CENTRAL = 0.9
"""Part of a bounded prior's range in which they are; two units on either side of an unbounded one's start."""
STEPS, GAIN, ROUNDS = 10, 1e-3, 4
"""Steps of a first descent, the gain that ends it, and rounds of fresh differences after the best one."""
SINGULAR = 1e-12
"""Least eigenvalue of the information on parameters, each in its own sds, that tells them."""
ALIKE = 0.1
"""Part in the direction that the series tell least, above which a parameter is named as not told."""


@dataclass(eq=False)
class Fitting:
    """One record and one baseline, as searches need them.

    Parameters
    ----------
    data : Data
    baseline : ForwardModel
        Its outputs are the data's.
    errors : Spectral
        Bound to the data.
    smooth : bool
        As in `Hooks`.
    cores : int
        Threads.
    start_at : array, optional
        Coordinates from which the baseline is sought; the prior's median and points of the prior if absent.
    """

    data: Data
    baseline: ForwardModel
    errors: Spectral
    smooth: bool = True
    cores: int = 2
    start_at: Array | None = None
    models: list[SearchModel] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        self.family = ErrorFamily(self.errors, ranges(self.data), dict(self.errors.known))
        self.coefficients = self.errors.flat(self.data.values)

    def model(self, added: tuple[AddedEffect, ...] = (), baseline: ForwardModel | None = None) -> SearchModel:
        """The baseline, or another one, with effects; its solves are counted."""
        return self.counted(SearchModel(baseline or self.baseline, added, self.errors))

    def counted(self, model: SearchModel) -> SearchModel:
        """A model whose solves are counted from now on."""
        if model not in self.models:
            self.models.append(model)
        return model

    @property
    def solves(self) -> int:
        """So far."""
        return sum(model.solves for model in self.models)

    @property
    def failures(self) -> Counter[str]:
        """Solves that failed so far, by each effect that they were made with, or the baseline alone."""
        found = Counter[str]()
        for names, n in (item for model in self.models for item in model.failures.items()):
            found.update(dict.fromkeys(names or ("the baseline alone",), n))
        return found

    @property
    def last_failure(self) -> str:
        """Why one of them did."""
        return next((model.last_failure for model in self.models if model.last_failure), "")

    @cached_property
    def forward(self) -> SearchModel:
        """The baseline alone, at one discretisation where its error is taken off."""
        own = self.model()
        if self.start_at is None or not isinstance(self.baseline, Corrected):
            return own
        return self.counted(own.pinned(self.start_at))

    @cached_property
    def start(self) -> Point:
        """Where the baseline leaves least, of the fits from the prior's median and from points of the prior.

        Raises
        ------
        SearchError
            If it cannot be solved anywhere.
        DiagnosisError
            If the series do not tell its parameters.
        """
        search = Search(self.forward, self.coefficients, self._loose)
        tried = []
        first = self.forward.start if self.start_at is None else self.start_at
        for u in self._points() if self.start_at is None else ():
            if (computed := self.forward(u)) is not None:
                tried.append((search.cost(u, computed), u))
        tried.sort(key=lambda pair: pair[0])
        found: list[Point] = []
        for u in [first, *(u for _, u in tried[:DESCENDED])]:
            try:
                found.append(search.descend(search.at(u), STEPS, GAIN))
            except SearchError:
                continue
        if not found:
            raise SearchError(self.forward.last_failure)
        best = search.refine(min(found, key=lambda point: point.cost), ROUNDS)
        if not self._told(best):
            raise DiagnosisError(self._not_told(search, best.u))
        left = Search(self.forward, self.coefficients, self._left(best))  # as noise, all that it leaves
        return left.refine(left.resume(best), ROUNDS, fine=self.smooth)

    def corrected(self) -> Fitting:
        """The same with the baseline's discretisation error at its best fit taken off, and fitted again."""
        u, plain = self.start.u, self.forward
        found = plain.corrected(u)
        return self if found is plain else replace(self, baseline=found.baseline, start_at=u)

    @property
    def _loose(self) -> Array:
        sizes = np.array([self.family.ranges[g] for g in self.family.groups])
        return np.asarray((LOOSE * sizes[self.family.member]) ** 2)

    def _left(self, point: Point) -> Array:
        squares = (self.coefficients - point.computed) ** 2
        means = self.family.one_of @ squares / self.family.one_of.sum(axis=1)
        return np.asarray(np.maximum(means[self.family.member], LEAST * self._loose))

    def _points(self) -> Array:
        """Points (TRIED, d) spread over the prior."""
        f = self.forward
        q = qmc.Sobol(len(f.low), seed=1).random(TRIED)
        bounded = np.isfinite(f.low) & np.isfinite(f.high)
        low = np.where(bounded, f.low, np.maximum(f.low, f.start - 2.0 * f.units))
        high = np.where(bounded, f.high, np.minimum(f.high, f.start + 2.0 * f.units))
        return np.asarray(low + (high - low) * (0.5 + CENTRAL * (q - 0.5)))

    def _told(self, point: Point) -> bool:
        """Whether series and priors tell all parameters."""
        units = self.forward.units
        J = point.jacobian * units / np.sqrt(self._loose)[:, None]
        H = J.T @ J + as_matrix(self.forward.prior(point.u)[0]) * np.outer(units, units)
        size = np.sqrt(np.diag(H))
        return bool(np.all(size > 0.0) and np.linalg.eigvalsh(H / np.outer(size, size))[0] > SINGULAR)

    def _not_told(self, search: Search[SearchModel], u: Array) -> str:
        """Which parameters the series do not tell."""
        J = search.at(u).jacobian * self.forward.units
        names = [p.name for p in self.forward.parameters]
        unused = [name for name, size in zip(names, np.abs(J).max(axis=0), strict=True) if size == 0.0]
        if unused:
            return (
                f"{self.baseline.name}: its series do not depend on {', '.join(unused)}: leave "
                f"{'it' if len(unused) == 1 else 'them'} out of the model's parameters, or correct the model"
            )
        weak = np.linalg.svd(J / np.linalg.norm(J, axis=0))[2][-1]
        alike = [name for name, part in zip(names, weak, strict=True) if abs(part) > ALIKE]
        return (
            f"{self.baseline.name}: its series do not tell {' from '.join(alike)}: fix one of them, or give "
            "it a normal prior"
        )
