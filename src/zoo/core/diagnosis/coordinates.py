"""A baseline with effects, in the coordinates in which a search steps."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.data import Data
from zoo.core.diagnosis.search import FIRST_STEP
from zoo.core.effects import AddedEffect, with_effects
from zoo.core.errors.spectral import Spectral
from zoo.core.forward import Corrected, ForwardModel, Outputs, SolveError, pinned, refined
from zoo.core.parameters import FrozenPrior, LogNormal, LogUniform, Normal, Parameter, start_of, unpack
from zoo.core.words import choices

Array = NDArray[np.float64]

FAILURES = (ArithmeticError, RuntimeError, np.linalg.LinAlgError)
"""What numerics raise where there is no solution; any other exception is a mistake in a simulator's code."""
EXTRAPOLATED = 4 / 3
"""Error of second order in the cells' size, in parts of what half the size changes."""
UNIT = 0.1
"""Unit of a search: of a logarithm, and in parts of a flat prior's width; a normal one's is its sd."""


@dataclass(frozen=True)
class Coordinate:
    """One number of a hypothesis' parameters as a search steps in it: itself, or its logarithm.

    Parameters
    ----------
    name, unit : str
        Of the parameter; elements of a vector have their number in brackets.
    parameter : Parameter
    low, high : float
        Bounds of the prior, in the parameter's unit.
    log : bool
        Whether the search steps in the logarithm.
    """

    name: str
    unit: str
    parameter: Parameter
    low: float
    high: float
    log: bool

    @property
    def unit_step(self) -> float:
        """What one unit of the search stands for."""
        if self.log:
            return UNIT
        prior = self.parameter.prior
        return prior.sd if isinstance(prior, Normal | FrozenPrior) else UNIT * (self.high - self.low)

    def value(self, u: Array | float) -> Any:
        """Search coordinate to value."""
        return np.exp(u) if self.log else u

    def coordinate(self, value: float) -> float:
        """Value to search coordinate."""
        if not self.log:
            return value
        return math.log(value) if value > 0.0 else -math.inf


def coordinates(parameters: Sequence[Parameter]) -> tuple[Coordinate, ...]:
    """A coordinate for each number in parameters; positive ones with such a prior are logarithms."""
    found = []
    for p in parameters:
        low, high = p.prior.support
        log = p.log or isinstance(p.prior, LogUniform | LogNormal) or (low >= 0.0 and math.isinf(high))
        for i in range(p.size):
            name = f"{p.name}[{i}]" if p.dims else p.name
            found.append(Coordinate(name, p.unit, p, low, high, log))
    return tuple(found)


class SearchModel:
    """The series of a baseline with effects as coefficients, a function of the search's coordinates.

    Parameters
    ----------
    baseline : ForwardModel
    added : sequence of AddedEffect
    errors : Spectral
        Bound to the data.
    """

    def __init__(self, baseline: ForwardModel, added: Sequence[AddedEffect], errors: Spectral) -> None:
        self.baseline, self.added, self.errors = baseline, tuple(added), errors
        self.model = with_effects(baseline, self.added)
        every, self.n_base = coordinates(self.model.parameters), len(coordinates(baseline.parameters))
        amplitudes = (replace(one, log=False) for one in every[self.n_base :])  # they count from 0
        self.parameters = (*every[: self.n_base], *amplitudes)
        self.low = np.array([p.coordinate(p.low) for p in self.parameters])
        self.high = np.array([p.coordinate(p.high) for p in self.parameters])
        self.units = np.array([p.unit_step for p in self.parameters])
        self.hierarchical = any(p.prior.depends_on for p in self.model.parameters)
        self._log = np.array([p.log for p in self.parameters])
        self.solves, self.failures = 0, Counter[tuple[str, ...]]()  # these by the names of effects
        self.last_failure = ""

    @property
    def start(self) -> Array:
        """Where a search of the baseline and its effects begins."""
        values = start_of(self.model.parameters)
        theta = np.concatenate([np.atleast_1d(values[p.name]) for p in self.model.parameters])
        return np.array([p.coordinate(float(x)) for p, x in zip(self.parameters, theta, strict=True)])

    def theta(self, u: Array) -> Array:
        """Search coordinates to values (n_values,) of the forward model's parameters.

        A step to a bound ends beside it by a rounding error, where an effect may not exist.
        """
        inside = np.clip(u, self.low, self.high)
        return np.array([p.value(x) for p, x in zip(self.parameters, inside, strict=True)])

    def series(self, u: Array, outputs: Outputs | None = None) -> Array | None:
        """Series (n_series, n_times) in their own units, or None where the solve failed."""
        self.solves += 1
        try:
            found = self.model.solve(self.model.configure(self.theta(u)), outputs)
            reason = None if np.all(np.isfinite(found)) else "the solution is not finite"
        except FAILURES as error:
            told = f"{type(error).__name__}: {error}"
            found, reason = np.empty(0), (str(error) or error.kind) if isinstance(error, SolveError) else told
        except Exception as error:
            values = zip(self.parameters, self.theta(u), strict=True)
            at = ", ".join(f"{p.name} = {x:.6g}" for p, x in values)
            advice = "raise SolveError if none exists there"
            names = [p.name for p in self.parameters[: self.n_base]]  # an effect's sizes are its own
            asked = error.args[0] if isinstance(error, KeyError) and error.args else None
            if isinstance(asked, str) and asked not in names:
                advice = f"no prior is named {asked!r}: {choices(asked, names)}"
            error.add_note(f"{self.model.name} was solved with {at}; {advice}")
            raise
        if reason is not None:
            self.failures[tuple(one.name for one in self.added)] += 1
            self.last_failure = reason
            return None
        return found

    @property
    def _plain(self) -> ForwardModel:
        """The baseline with its error."""
        return self.baseline.model if isinstance(self.baseline, Corrected) else self.baseline

    def pinned(self, u: Array) -> SearchModel:
        """The same at the discretisation of one point, less its error there, so that it is smooth around it.

        Itself where it has none, or where the error is no longer taken off. An effect that is absent at the
        point is taken to be there a little, since it may need a grid of its own.
        """
        plain = self._plain
        absent = (u == 0.0) & (np.arange(len(u)) >= self.n_base)
        there = np.clip(np.where(absent, FIRST_STEP * self.units, u), self.low, self.high)
        try:
            on_grid = pinned(plain, self.model.configure(self.theta(there)))
        except FAILURES:
            return self
        found = self if on_grid is plain else SearchModel(on_grid, self.added, self.errors).corrected(u)
        return self if self.baseline is not plain and not isinstance(found.baseline, Corrected) else found

    def corrected(self, u: Array) -> SearchModel:
        """The same less its discretisation error at a point, by Richardson's extrapolation.

        Itself where there is no finer grid, or none that can be solved there, and where an error of the grid
        is among the effects.
        """
        plain = self._plain
        own = with_effects(plain, self.added)
        if (finer := refined(own)) is None:
            return self
        found = Corrected(plain, own, finer, self.theta(u), EXTRAPOLATED)
        try:
            exact = bool(np.all(np.isfinite(found.error())))
        except FAILURES:
            exact = False
        return SearchModel(found, self.added, self.errors) if exact else self

    def __call__(self, u: Array) -> Array | None:
        """Flat coefficients, or None where the solve failed."""
        found = self.series(u)
        return None if found is None else self.errors.flat(found)

    def log_prior(self, u: Array) -> float:
        """Log density of the coordinates beforehand."""
        values = unpack(self.model.parameters, self.theta(u))
        densities = (p.prior.log_density(values[p.name], values) for p in self.model.parameters)
        return sum(densities, float(np.sum(u[self._log])))

    def prior(self, u: Array) -> tuple[Array, Array]:
        """Precision and pull of the coordinates beforehand, around a point.

        The density there is exp(-d'P d/2 - pull'd) of its value at u, for a step d.

        Returns
        -------
        precision : array (n_dim,), or (n_dim, n_dim) of a hierarchical prior
        pull : array (n_dim,)
        """
        x = self.theta(u)
        values = unpack(self.model.parameters, x)
        slope, curvature = np.empty(len(u)), np.empty(len(u))
        at, where = 0, {}
        for p in self.model.parameters:
            part = slice(at, at + p.size)
            where[p.name] = part
            slope[part], curvature[part] = p.prior.curvature(x[part], values)
            at += p.size
        if not self.hierarchical:
            pull = -np.where(self._log, x * slope + 1.0, slope)
            precision = np.where(self._log, x * (x * curvature - slope), curvature)
            return np.maximum(precision, 0.0), pull  # some densities are not log-concave everywhere
        P = np.diag(curvature)
        for p in self.model.parameters:
            if not p.prior.depends_on:
                continue
            on = np.concatenate([np.arange(len(u))[where[name]] for name in p.prior.depends_on])
            own = np.arange(len(u))[where[p.name]]
            more, bend, cross = p.prior.dependence(np.atleast_1d(values[p.name]), values)
            slope[on] += more
            P[np.ix_(on, on)] += bend
            P[np.ix_(own, on)] += cross
            P[np.ix_(on, own)] += cross.T
        scale = np.where(self._log, x, 1.0)
        P = P * np.outer(scale, scale) - np.diag(np.where(self._log, x * slope, 0.0))
        pull = -np.where(self._log, x * slope + 1.0, slope)
        size = self.units  # a population's log-density is not concave everywhere
        eigenvalues, vectors = np.linalg.eigh(P * np.outer(size, size))
        P = (vectors * np.maximum(eigenvalues, 0.0)) @ vectors.T / np.outer(size, size)
        return P, pull


def ranges(data: Data) -> dict[str, float]:
    """Largest peak-to-peak range of a group's series, in its unit."""
    return {g: float(max(np.ptp(data.samples(i)) for i in rows)) for g, rows in data.rows.items()}
