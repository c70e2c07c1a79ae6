"""Where chains walk: a Gaussian around a posterior, the constrained space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytensor.tensor as pt
from pymc.distributions.transforms import IntervalTransform
from pymc.pytensorf import constant_fold
from scipy.special import expit, log_expit, logit

from zoo.core.arrays import Array
from zoo.core.inference.logposterior import Point

T_DOF = 5.0
"""Degrees of freedom of the t distributions that proposals and starts are drawn from."""


@dataclass(frozen=True)
class Gaussian:
    """Centre and scatter of a posterior in the unconstrained space.

    Parameters
    ----------
    mean : array (n_dim,)
    covariance : array (n_dim, n_dim)
    """

    mean: Array
    covariance: Array
    cholesky: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "cholesky", np.linalg.cholesky(self.covariance))

    def whiten(self, q: Array) -> Array:
        """Coordinates (n_dim,) in which the Gaussian is standard normal."""
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(self.cholesky, q - self.mean, lower=True, check_finite=False))

    def colour(self, u: Array) -> Array:
        """The inverse of `whiten`; u may be (n, n_dim)."""
        return np.asarray(self.mean + u @ self.cholesky.T)

    def refit(self, points: Array) -> Gaussian:
        """Blend with the moments of correlated draws of a chain.

        A chain of n draws in d dimensions is counted as n / (4 d) independent ones, the present covariance
        as d of them and the present mean as two.

        Parameters
        ----------
        points : array (n, n_dim)
        """
        n, d = points.shape
        weight = n / (4.0 * d)
        mean = (points.mean(0) * weight + self.mean * 2.0) / (weight + 2.0)
        covariance = (np.cov(points.T).reshape(d, d) * weight + self.covariance * d) / (weight + d)
        return Gaussian(mean, covariance)


@dataclass(frozen=True)
class ConstrainedSpace:
    """Coordinates in which variables between two fixed bounds are constrained, the others unconstrained.

    x = a + (b - a) / (1 + exp(-q)). Where a posterior leans against a bound, a ridge that is straight in x is
    bent in q, and a walk that is tuned to one end of it is lost at the other.

    Parameters
    ----------
    index : array (n,)
        Where those variables are in the unconstrained vector.
    lower, width : array (n,)
        a and b - a.
    """

    index: Any
    lower: Array
    width: Array

    @classmethod
    def of(cls, model: Any, variables: Sequence[Any], point: Point) -> ConstrainedSpace:
        """Of all variables of a step method (value variables) whose interval is fixed."""
        index: list[int] = []
        lower: list[float] = []
        upper: list[float] = []
        n = 0
        for variable in variables:
            size = np.size(point[variable.name])
            bounds = _fixed_interval(model, model.values_to_rvs[variable])
            if bounds is not None:
                index += range(n, n + size)
                for ends, bound in zip((lower, upper), bounds, strict=True):
                    ends += np.broadcast_to(bound, np.shape(point[variable.name])).ravel().tolist()
            n += size
        return cls(np.array(index, dtype=int), np.array(lower), np.array(upper) - np.array(lower))

    def values(self, q: Array) -> Array:
        """From unconstrained vectors, (..., n_dim)."""
        x = np.array(q, dtype=float)
        x[..., self.index] = self.lower + self.width * expit(q[..., self.index])
        return x

    def vector(self, x: Array) -> Array:
        """The inverse of `values`; not finite outside the bounds."""
        q = np.array(x, dtype=float)
        q[..., self.index] = logit((x[..., self.index] - self.lower) / self.width)
        return q

    def slopes(self, q: Array) -> Array:
        """dx/dq of the variables between two bounds, (n,)."""
        share = expit(q[self.index])
        return np.asarray(self.width * share * (1.0 - share))

    def log_volume(self, q: Array) -> float:
        """Logarithm of the determinant of dx/dq at q (n_dim,)."""
        at = q[self.index]
        return float((np.log(self.width) + log_expit(at) + log_expit(-at)).sum())


def _fixed_interval(model: Any, variable: Any) -> tuple[Array, Array] | None:
    """Bounds of a free variable that is sampled as a logit between two constants, or None."""
    transform = model.rvs_to_transforms[variable]
    if not isinstance(transform, IntervalTransform):
        return None
    bounds = transform.args_fn(*variable.owner.inputs)
    if any(bound is None for bound in bounds):
        return None
    a, b = constant_fold([pt.as_tensor(bound) for bound in bounds], raise_not_constant=False)
    if not (isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and np.all(np.isfinite(b - a))):
        return None
    return a, b
