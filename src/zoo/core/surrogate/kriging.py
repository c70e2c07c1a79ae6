"""Kriging: a low polynomial and a Gaussian process, chosen by the error at points left out."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytensor.tensor as pt
from numpy.typing import NDArray
from scipy import linalg
from scipy.spatial.distance import cdist

from zoo.core.draws import evenly
from zoo.core.surrogate.monomials import Map, features, independent, table_of, total_degree

Array = NDArray[np.float64]

LENGTHS = (1.0, 2.0, 4.0, 8.0)
"""Lengths that are tried, in standard deviations of what the variables are whitened with."""
NUGGETS = (1e-9, 1e-5, 1e-3)
"""Variances of what is no function of the variables that are tried, over that of the process."""
TREND = 2
"""Degree of the polynomial beneath the process."""
MOST_TRIED, MOST_POINTS = 600, 2000
"""Most points with which lengths and nuggets are tried, and most points of a process, whose time goes with
their number cubed: of more, as many are taken evenly."""


def matern(distance: Array, length: float) -> Array:
    """Correlation of a process with three derivatives, Matern's of order 7/2."""
    r = distance * (np.sqrt(7.0) / length)
    return np.asarray((1.0 + r + 0.4 * r**2 + r**3 / 15.0) * np.exp(-r))


@dataclass(frozen=True)
class Kriging(Map):
    """Values (n_values,) as phi(v)' beta + k(v)' w of v = rotation (x - centre), phi monomials.

    k_i(v) is Matern's correlation of order 7/2 of v and point i. All values share its length and nugget.

    Parameters
    ----------
    centre, rotation, terms, weights, residuals
        As of `Map`.
    points : array (n_points, n_x)
        As v.
    of_points : array (n_points, n_values)
        The weights w.
    length : float
    nugget : float
        Variance of what is no function of v, over that of the process.
    lower : array (n_points, n_points)
        Cholesky factor of the points' covariance.
    known : array (n_points, n_terms)
        Monomials at the points, whitened by that factor.
    upper : array (n_terms, n_terms)
        Triangular factor of those.
    scale : float
        Mean variance of a point given the others, over that of the process.
    """

    points: Array
    of_points: Array
    length: float
    nugget: float
    lower: Array
    known: Array
    upper: Array
    scale: float

    @classmethod
    def beside(cls, other: Map, x: Array, values: Array) -> Kriging | None:
        """The one of the least error at points left out, in another map's variables; None if there is none.

        Parameters
        ----------
        other : Map
            Of the same points.
        x : array (n_points, n_x)
        values : array (n_points, n_values)
        """
        n, d = x.shape
        v = other.variables(x)
        terms = table_of(total_degree(d, TREND))
        if 2 * len(terms) > min(n, MOST_TRIED):
            terms = table_of(total_degree(d, 1))

        def at(most: int, length: float, nugget: float) -> Kriging | None:
            some = evenly(n, most)
            return cls._of(other, terms, v[some], values[some], length, nugget)

        pairs = itertools.product(LENGTHS, NUGGETS)
        tried = [made for pair in pairs if (made := at(MOST_TRIED, *pair)) is not None]
        if not tried:
            return None
        best = min(tried, key=lambda made: made.left_out)
        return at(MOST_POINTS, best.length, best.nugget) or at(MOST_POINTS, best.length, NUGGETS[1]) or best

    @classmethod
    def _of(
        cls,
        other: Map,
        terms: NDArray[np.int64],
        v: Array,
        values: Array,
        length: float,
        nugget: float,
    ) -> Kriging | None:
        """At one length and nugget; None where points are too near for it, or lie in too few directions."""
        covariance = matern(cdist(v, v), length)
        covariance[np.diag_indices(len(v))] += nugget
        try:
            lower = linalg.cholesky(covariance, lower=True, overwrite_a=True)
        except linalg.LinAlgError:
            return None
        both = np.concatenate([features(v, terms), values], axis=1)
        z = linalg.solve_triangular(lower, both, lower=True)
        known, asked = z[:, : len(terms)], z[:, len(terms) :]
        q, upper = linalg.qr(known, mode="economic")
        if not independent(upper):
            return None
        beta = linalg.solve_triangular(upper, q.T @ asked)
        w = linalg.solve_triangular(lower, asked - known @ beta, lower=True, trans="T")
        inverse, _ = linalg.lapack.dtrtri(lower, lower=1)
        precision = np.maximum(np.square(inverse).sum(0) - np.square(inverse.T @ q).sum(1), 1e-12)
        return cls(
            other.centre,
            other.rotation,
            terms,
            beta,
            w / precision[:, None],
            v,
            w,
            length,
            nugget,
            lower,
            known,
            upper,
            float(np.mean(1.0 / precision)),
        )

    @property
    def text(self) -> str:
        """What it is, for a line of progress."""
        return f"kriging of {len(self.residuals)} solves"

    def __call__(self, x: Array) -> Array:
        """Values (n, n_values) at points (n, n_x)."""
        v = self.variables(x)
        near = matern(cdist(v, self.points), self.length)
        return np.asarray(features(v, self.terms) @ self.weights + near @ self.of_points)

    def leverage(self, x: Array) -> Array:
        """Variance (n,) at points (n, n_x) over the mean one of a point that is left out, less 1."""
        near, trend = self._told(self.variables(x))
        variance = 1.0 + self.nugget - np.square(near).sum(0) + np.square(trend).sum(0)
        return np.asarray(variance / self.scale - 1.0)

    def uncertainty(self, x: Array) -> tuple[Array, float]:
        """Covariance (n, n) of the errors at points (n, n_x), and the variance of what solving one leaves."""
        v = self.variables(x)
        near, trend = self._told(v)
        covariance = matern(cdist(v, v), self.length) - near.T @ near + trend.T @ trend
        return np.asarray(covariance / self.scale), self.nugget / self.scale

    def _told(self, v: Array) -> tuple[Array, Array]:
        """What the points (n_points, n) and the trend (n_terms, n) tell of variables (n, n_x), whitened."""
        near = linalg.solve_triangular(self.lower, matern(cdist(self.points, v), self.length), lower=True)
        beneath = features(v, self.terms) - near.T @ self.known
        return near, linalg.solve_triangular(self.upper, beneath.T, trans="T")

    def symbolic(self, x: Any) -> Any:
        """Values (n_values,) as a graph of a vector x (n_x,)."""
        v = self.symbolic_variables(x)
        squared = pt.sum(pt.sqr(v - self.points), axis=1)
        r = pt.sqrt(squared + 1e-18) * (np.sqrt(7.0) / self.length)
        near = (1.0 + r * (1.0 + r * (0.4 + r / 15.0))) * pt.exp(-r)
        return pt.dot(self.symbolic_features(v), self.weights) + pt.dot(near, self.of_points)
