"""Kriging: a low polynomial and a Gaussian process, chosen by the error at points left out."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytensor.tensor as pt
from scipy import linalg
from scipy.spatial.distance import cdist

from zoo.core.arrays import Array
from zoo.core.draws import evenly

LENGTHS = (1.0, 2.0, 4.0, 8.0)
"""Lengths that are tried, in standard deviations of what the variables are whitened with."""
NUGGETS = (1e-9, 1e-5, 1e-3)
"""Variances of what is no function of the variables that are tried, over that of the process."""
MOST_TRIED, MOST_POINTS = 600, 2000
"""Most points with which lengths and nuggets are tried, and most points of a process, whose time goes with
their number cubed: of more, as many are taken evenly."""
SINGULAR = 1e-10
"""Least diagonal element of a triangular factor, over the largest, of columns that are independent."""


class FewDirectionsError(ValueError):
    """Points lie in too few directions, or too near to each other, for a function of all variables."""


def matern(distance: Array, length: float) -> Array:
    """Correlation of a process with three derivatives, Matern's of order 7/2."""
    r = distance * (np.sqrt(7.0) / length)
    return np.asarray((1.0 + r + 0.4 * r**2 + r**3 / 15.0) * np.exp(-r))


def trend(v: Array, quadratic: bool) -> Array:
    """Monomials (n, n_terms) of points (n, n_x): a plane's or a quadratic's."""
    columns = [np.ones((len(v), 1)), v]
    if quadratic:
        i, j = np.triu_indices(v.shape[1])
        columns.append(v[:, i] * v[:, j])
    return np.concatenate(columns, axis=1)


@dataclass(frozen=True)
class Kriging:
    """Values (n_values,) as phi(v)' beta + k(v)' w of v = L^-1 (x - centre), phi monomials.

    k_i(v) is Matern's correlation of order 7/2 of v and point i. All values share its length and nugget.

    Parameters
    ----------
    centre : array (n_x,)
    whitening : array (n_x, n_x)
        L^-1.
    quadratic : bool
        Whether the polynomial is a quadratic, or a plane.
    beta : array (n_terms, n_values)
    points : array (n_points, n_x)
        As v.
    of_points : array (n_points, n_values)
        The weights w.
    length : float
    nugget : float
        Variance of what is no function of v, over that of the process.
    residuals : array (n_points, n_values)
        Errors at each point of a fit without it.
    """

    centre: Array
    whitening: Array
    quadratic: bool
    beta: Array
    points: Array
    of_points: Array
    length: float
    nugget: float
    residuals: Array

    @classmethod
    def fit(cls, x: Array, values: Array, centre: Array, cholesky: Array) -> Kriging:
        """The one of the least error at points left out, of all lengths and nuggets.

        Parameters
        ----------
        x : array (n_points, n_x)
        values : array (n_points, n_values)
            In units that make their errors alike.
        centre : array (n_x,)
        cholesky : array (n_x, n_x)
            L, the factor of a covariance with which the variables are whitened.

        Raises
        ------
        FewDirectionsError
            If there is none.
        """
        n, d = x.shape
        whitening = linalg.solve_triangular(cholesky, np.eye(d), lower=True)
        v = (x - centre) @ whitening.T
        quadratic = (d + 1) * (d + 2) <= min(n, MOST_TRIED)

        def at(most: int, length: float, nugget: float) -> Kriging | None:
            some = evenly(n, most)
            return cls._of(centre, whitening, quadratic, v[some], values[some], length, nugget)

        pairs = itertools.product(LENGTHS, NUGGETS)
        tried = [made for pair in pairs if (made := at(MOST_TRIED, *pair)) is not None]
        if not tried:
            raise FewDirectionsError(f"{n} points are too near to each other, or in less than {d} directions")
        best = min(tried, key=lambda made: made.left_out)
        return at(MOST_POINTS, best.length, best.nugget) or at(MOST_POINTS, best.length, NUGGETS[1]) or best

    @classmethod
    def _of(
        cls,
        centre: Array,
        whitening: Array,
        quadratic: bool,
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
        both = np.concatenate([trend(v, quadratic), values], axis=1)
        z = linalg.solve_triangular(lower, both, lower=True)
        known, asked = np.split(z, [both.shape[1] - values.shape[1]], axis=1)
        q, upper = linalg.qr(known, mode="economic")
        diagonal = np.abs(np.diag(upper))
        if diagonal.min() < SINGULAR * diagonal.max():
            return None
        beta = linalg.solve_triangular(upper, q.T @ asked)
        w = linalg.solve_triangular(lower, asked - known @ beta, lower=True, trans="T")
        inverse, _ = linalg.lapack.dtrtri(lower, lower=1)
        precision = np.maximum(np.square(inverse).sum(0) - np.square(inverse.T @ q).sum(1), 1e-12)
        residuals = w / precision[:, None]
        return cls(centre, whitening, quadratic, beta, v, w, length, nugget, residuals)

    @property
    def left_out(self) -> float:
        """Mean squared norm of the errors at points left out."""
        return float(np.square(self.residuals).sum(1).mean())

    def __call__(self, x: Array) -> Array:
        """Values (n, n_values) at points (n, n_x)."""
        v = (x - self.centre) @ self.whitening.T
        near = matern(cdist(v, self.points), self.length)
        return np.asarray(trend(v, self.quadratic) @ self.beta + near @ self.of_points)

    def symbolic_variables(self, x: Any) -> Any:
        """Variables v (n_x,) as a graph of a vector x (n_x,)."""
        return pt.dot(self.whitening, x - self.centre)

    def symbolic(self, x: Any) -> Any:
        """Values (n_values,) as a graph of a vector x (n_x,)."""
        v = self.symbolic_variables(x)
        terms = [np.ones(1), v]
        if self.quadratic:
            i, j = np.triu_indices(len(self.centre))
            terms.append(v[i] * v[j])
        squared = pt.sum(pt.sqr(v - self.points), axis=1)
        r = pt.sqrt(squared + 1e-18) * (np.sqrt(7.0) / self.length)
        near = (1.0 + r * (1.0 + r * (0.4 + r / 15.0))) * pt.exp(-r)
        return pt.dot(pt.concatenate(terms), self.beta) + pt.dot(near, self.of_points)
