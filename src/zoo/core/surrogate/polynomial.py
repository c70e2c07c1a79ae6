"""Polynomials of several variables by least squares, chosen by the error at points left out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytensor.tensor as pt
from numpy.typing import NDArray
from scipy import linalg

from zoo.core.surrogate.monomials import Map, features, independent, table_of, term_count, total_degree

Array = NDArray[np.float64]

POINTS_A_TERM = 1.5
"""Fewest points for each term of a polynomial that is tried."""
MOST_TERMS = 700
"""Most terms of a polynomial that is tried."""


def _candidates(n: int, most: int) -> list[set[tuple[int, ...]]]:
    """Sets of monomials of at most so many terms: of all variables, and of a higher degree in the first."""
    found: list[set[tuple[int, ...]]] = []
    base: set[tuple[int, ...]] = set()
    for degree in range(8):
        if term_count(n, degree) > most:
            break
        base = total_degree(n, degree)
        found.append(base)
    for first in range(2, n):
        for more in (1, 2):
            if term_count(first, degree + more - 1) + len(base) > 2 * most:
                continue
            both = base | total_degree(first, degree + more - 1)
            if len(both) <= most:
                found.append(both)
    return found


@dataclass(frozen=True)
class Polynomial(Map):
    """Values (n_values,) as a polynomial of v = rotation (x - centre).

    Parameters
    ----------
    centre, rotation, terms, weights, residuals
        As of `Map`.
    spread : array (n_terms, n_terms)
        Inverse of the features' second moments, for the leverage.
    """

    spread: Array

    @classmethod
    def fit(cls, x: Array, values: Array, centre: Array, cholesky: Array) -> Polynomial:
        """The one of the least error at points left out one at a time (by the leverage, in closed form).

        Parameters
        ----------
        x : array (n_points, n_x)
        values : array (n_points, n_values)
            In units that make their errors alike.
        centre : array (n_x,)
        cholesky : array (n_x, n_x)
            Of a covariance: where it is whitened.
        """
        u = linalg.solve_triangular(cholesky, (x - centre).T, lower=True).T
        linear = np.concatenate([np.ones((len(u), 1)), u], axis=1)
        slopes = linalg.lstsq(linear, values)[0][1:]
        directions, _, _ = linalg.svd(slopes, full_matrices=True)
        rotation = directions.T @ linalg.solve_triangular(cholesky, np.eye(len(centre)), lower=True)
        v = (x - centre) @ rotation.T
        best: tuple[float, Any] = (np.inf, None)
        most = max(1, min(MOST_TERMS, int(len(x) / POINTS_A_TERM)))
        for chosen in _candidates(len(centre), most):
            terms = table_of(chosen)
            columns = features(v, terms)
            q, r = linalg.qr(columns, mode="economic")
            if not independent(r):
                continue
            kept = 1.0 - np.einsum("ij,ij->i", q, q)
            errors = (values - q @ (q.T @ values)) / np.maximum(kept, 1e-6)[:, None]
            score = float((errors**2).sum(1).mean())
            if score < best[0]:
                best = score, (terms, q, r, errors)
        terms, q, r, errors = best[1]
        inverse = linalg.solve_triangular(r, np.eye(len(r)))
        return cls(centre, rotation, terms, inverse @ (q.T @ values), errors, inverse @ inverse.T)

    @property
    def text(self) -> str:
        """What it is, for a line of progress."""
        return f"a polynomial of {len(self.terms)} terms from {len(self.residuals)} solves"

    def __call__(self, x: Array) -> Array:
        """Values (n, n_values) at points (n, n_x)."""
        return np.asarray(features(self.variables(x), self.terms) @ self.weights)

    def leverage(self, x: Array) -> Array:
        """phi' (Phi' Phi)^-1 phi (n,) at points (n, n_x): how far from the fitted ones they lie."""
        columns = features(self.variables(x), self.terms)
        return np.asarray(((columns @ self.spread) * columns).sum(1))

    def uncertainty(self, x: Array) -> tuple[Array, float]:
        """Covariance (n, n) of the errors at points (n, n_x), and the variance of what solving one leaves."""
        columns = features(self.variables(x), self.terms)
        return np.asarray(columns @ self.spread @ columns.T), 1.0

    def symbolic(self, x: Any) -> Any:
        """Values (n_values,) as a graph of a vector x (n_x,)."""
        return pt.dot(self.symbolic_features(self.symbolic_variables(x)), self.weights)
