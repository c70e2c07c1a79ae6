"""A simulator linear around a point, and the causes that may be added to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SAME = 1e-9
"""Difference of responses, in parts of their size, up to which two causes are the same one."""


class CauseError(ValueError):
    """A cause or a problem whose pieces do not fit; the text says which."""


@dataclass(frozen=True, eq=False)
class Cause:
    """One thing that may be wrong: a listed effect at a place, or a free function of some length.

    It changes the series by s R w, w ~ N(mean, 1) in each element.

    Parameters
    ----------
    name : str
        Of the effect or function.
    component : str
        Part of the simulator that it belongs to.
    columns : array (n, m)
        R: change of the coefficients by each weight, in units of its prior standard deviation.
    free : bool
        Whether it is a free function, whose size s is half-normal of scale 1; else s = 1.
    place : str
        Where it acts; empty for everywhere.
    low, high : float
        Bounds of the first weight, in prior standard deviations.
    mean : array (m,), optional
        Prior mean of the weights; 0 if absent.
    """

    name: str
    component: str
    columns: Array = field(repr=False)
    free: bool = False
    place: str = ""
    low: float = -np.inf
    high: float = np.inf
    mean: Array | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.columns.ndim != 2 or not np.all(np.isfinite(self.columns)):
            raise CauseError(f"{self.label}: columns: give finite responses (n, m)")
        if not self.low < self.high:
            raise CauseError(f"{self.label}: bounds [{self.low:g}, {self.high:g}]: low must be below high")

    @property
    def label(self) -> str:
        """Name and place."""
        return f"{self.name} {self.place}".strip()

    @property
    def prior_mean(self) -> Array:
        """Of the weights, (m,)."""
        return np.zeros(self.columns.shape[1]) if self.mean is None else self.mean

    def same(self, other: Cause) -> bool:
        """Whether it is the same cause by another name: one component, one prior, one response."""
        if self.component != other.component or self.free != other.free:
            return False
        if self.columns.shape != other.columns.shape or (self.low, self.high) != (other.low, other.high):
            return False
        size = float(np.linalg.norm(self.columns))
        apart = float(np.linalg.norm(self.columns - other.columns))
        return apart <= SAME * size and bool(np.allclose(self.prior_mean, other.prior_mean))


@dataclass(frozen=True, eq=False)
class Problem:
    """Data given a baseline that is linear in its parameters: r = J d + what causes do + errors.

    The prior density of the step d is exp(log_prior - d'P d / 2 - pull'd).

    Parameters
    ----------
    residual : array (n,)
        Measured minus computed, in coefficients whose errors are independent.
    jacobian : array (n, k)
    precision : array (k,) or (k, k)
    pull : array (k,)
    log_prior : float
    low, high : array (k,), optional
        Bounds of the step.
    amplitudes : sequence of int
        Which parameters are amplitudes of listed effects, of independent normal priors.
    """

    residual: Array = field(repr=False)
    jacobian: Array = field(repr=False)
    precision: Array = field(repr=False)
    pull: Array = field(repr=False)
    log_prior: float = 0.0
    low: Array | None = field(default=None, repr=False)
    high: Array | None = field(default=None, repr=False)
    amplitudes: Sequence[int] = ()

    @property
    def P(self) -> Array:
        """The precision as a matrix."""
        return np.diag(self.precision) if self.precision.ndim == 1 else self.precision


def without_doubles(causes: Sequence[Cause]) -> list[Cause]:
    """Causes that differ: of those that are the same one the first."""
    kept: list[Cause] = []
    for one in causes:
        if not any(one.same(other) for other in kept):
            kept.append(one)
    return kept
