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

from zoo.core.surrogate.polynomial import Polynomial, features, table_of, total_degree

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


def _monomials(n: int, degree: int) -> NDArray[np.int64]:
    return table_of(sorted(total_degree(n, degree), key=lambda term: (len(term), term)))


def matern(distance: Array, length: float) -> Array:
    """Correlation of a process with three derivatives, Matern's of order 7/2."""
    r = distance * (np.sqrt(7.0) / length)
    return np.asarray((1.0 + r + 0.4 * r**2 + r**3 / 15.0) * np.exp(-r))


@dataclass(frozen=True)
class Kriging:
    """Values (n_values,) as phi(v)' beta + k(v)' w of v = rotation (x - centre), phi monomials.

    k_i(v) is Matern's correlation of order 7/2 of v and point i. All values share its length and nugget.

    Parameters
    ----------
    centre : array (n_x,)
    rotation : array (n_x, n_x)
    terms : array of int (n_terms, degree)
        As of `Polynomial`.
    weights : array (n_terms, n_values)
    points : array (n_points, n_x)
        As v.
    of_points : array (n_points, n_values)
        The weights w.
    length : float
    nugget : float
        Variance of what is no function of v, over that of the process.
    lower : array (n_points, n_points)
        Cholesky factor of the points' covariance.
    scale : float
        Mean variance of a point given the others, over that of the process.
    residuals : array (n_points, n_values)
        Errors at each point of a fit without it.
    """

    centre: Array
    rotation: Array
    terms: NDArray[np.int64]
    weights: Array
    points: Array
    of_points: Array
    length: float
    nugget: float
    lower: Array
    scale: float
    residuals: Array

    @classmethod
    def beside(cls, polynomial: Polynomial, x: Array, values: Array) -> Kriging | None:
        """The one of the least error at points left out, in a polynomial's variables; None if there is none.

        Parameters
        ----------
        polynomial : Polynomial
            Of the same points.
        x : array (n_points, n_x)
        values : array (n_points, n_values)
        """
        n, d = x.shape
        v = (x - polynomial.centre) @ polynomial.rotation.T
        terms = _monomials(d, TREND)
        if 2 * len(terms) > min(n, MOST_TRIED):
            terms = _monomials(d, 1)

        def at(most: int, length: float, nugget: float) -> Kriging | None:
            some = np.unique(np.linspace(0, n - 1, most).astype(int))
            return cls._of(polynomial, terms, v[some], values[some], length, nugget)

        pairs = itertools.product(LENGTHS, NUGGETS)
        tried = [made for pair in pairs if (made := at(MOST_TRIED, *pair)) is not None]
        if not tried:
            return None
        best = min(tried, key=lambda made: made.left_out)
        return at(MOST_POINTS, best.length, best.nugget) or at(MOST_POINTS, best.length, NUGGETS[1]) or best

    @classmethod
    def _of(
        cls,
        polynomial: Polynomial,
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
        q, r = linalg.qr(known, mode="economic")
        diagonal = np.abs(np.diag(r))
        if diagonal.min() < 1e-10 * diagonal.max():
            return None
        beta = linalg.solve_triangular(r, q.T @ asked)
        w = linalg.solve_triangular(lower, asked - known @ beta, lower=True, trans="T")
        inverse, _ = linalg.lapack.dtrtri(lower, lower=1)
        precision = np.maximum(np.square(inverse).sum(0) - np.square(inverse.T @ q).sum(1), 1e-12)
        return cls(
            polynomial.centre,
            polynomial.rotation,
            terms,
            beta,
            v,
            w,
            length,
            nugget,
            lower,
            float(np.mean(1.0 / precision)),
            w / precision[:, None],
        )

    @property
    def text(self) -> str:
        """What it is, for a line of progress."""
        return f"kriging of {len(self.residuals)} solves"

    @property
    def left_out(self) -> float:
        """Mean squared norm of the errors at points left out."""
        return float(np.square(self.residuals).sum(1).mean())

    def __call__(self, x: Array) -> Array:
        """Values (n, n_values) at points (n, n_x)."""
        v = (x - self.centre) @ self.rotation.T
        near = matern(cdist(v, self.points), self.length)
        return np.asarray(features(v, self.terms) @ self.weights + near @ self.of_points)

    def leverage(self, x: Array) -> Array:
        """Variance (n,) at points (n, n_x) over the mean one of a point that is left out, less 1."""
        near, trend = self._known(x)
        variance = 1.0 + self.nugget - np.square(near).sum(0) + np.square(trend).sum(0)
        return np.asarray(variance / self.scale - 1.0)

    def uncertainty(self, x: Array) -> tuple[Array, float]:
        """Covariance (n, n) of the errors at points (n, n_x), and the variance of what solving one leaves."""
        near, trend = self._known(x)
        v = (x - self.centre) @ self.rotation.T
        covariance = matern(cdist(v, v), self.length) - near.T @ near + trend.T @ trend
        return np.asarray(covariance / self.scale), self.nugget / self.scale

    def _known(self, x: Array) -> tuple[Array, Array]:
        """What the points (n_points, n) and the trend (n_terms, n) tell of points (n, n_x), whitened."""
        v = (x - self.centre) @ self.rotation.T
        near = linalg.solve_triangular(self.lower, matern(cdist(self.points, v), self.length), lower=True)
        known = linalg.solve_triangular(self.lower, features(self.points, self.terms), lower=True)
        r = linalg.qr(known, mode="r")[0][: known.shape[1]]
        trend = linalg.solve_triangular(r, (features(v, self.terms) - near.T @ known).T, trans="T")
        return near, trend

    def symbolic(self, x: Any) -> Any:
        """Values (n_values,) as a graph of a vector x (n_x,)."""
        v = pt.dot(self.rotation, x - self.centre)
        padded = pt.concatenate([np.ones(1), v])
        trend = pt.prod(padded[self.terms], axis=1)
        squared = pt.sum(pt.sqr(v - self.points), axis=1)
        r = pt.sqrt(squared + 1e-18) * (np.sqrt(7.0) / self.length)
        near = (1.0 + r * (1.0 + r * (0.4 + r / 15.0))) * pt.exp(-r)
        return pt.dot(trend, self.weights) + pt.dot(near, self.of_points)
