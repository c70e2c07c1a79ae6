"""What maps from variables to coefficients share: whitened variables, monomials of them, left-out errors."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytensor.tensor as pt
from numpy.typing import NDArray

Array = NDArray[np.float64]

SINGULAR = 1e-10
"""Least diagonal element of a triangular factor, over the largest, of columns that are independent."""


@dataclass(frozen=True)
class Map:
    """Values (n_values,) as a function of v = rotation (x - centre), a polynomial at least.

    Parameters
    ----------
    centre : array (n_x,)
    rotation : array (n_x, n_x)
        Variables in the order of how much they matter.
    terms : array of int (n_terms, degree)
        Factors of each monomial: variables from 1 on, 0 for a factor of 1.
    weights : array (n_terms, n_values)
        Of the monomials.
    residuals : array (n_points, n_values)
        Errors at each point of a fit without it.
    """

    centre: Array
    rotation: Array
    terms: NDArray[np.int64]
    weights: Array
    residuals: Array

    @property
    def left_out(self) -> float:
        """Mean squared norm of the errors at points left out."""
        return float(np.square(self.residuals).sum(1).mean())

    def variables(self, x: Array) -> Array:
        """Variables v (n, n_x) at points (n, n_x)."""
        return np.asarray((x - self.centre) @ self.rotation.T)

    def symbolic_variables(self, x: Any) -> Any:
        """Variables v (n_x,) as a graph of a vector x (n_x,)."""
        return pt.dot(self.rotation, x - self.centre)

    def symbolic_features(self, v: Any) -> Any:
        """Monomials (n_terms,) as a graph of the variables v (n_x,)."""
        padded = pt.concatenate([np.ones(1), v])
        found = padded[self.terms[:, 0]]
        for column in self.terms.T[1:]:
            some = np.flatnonzero(column)
            if len(some) == len(column):
                found = found * padded[column]
            else:
                found = pt.set_subtensor(found[some], found[some] * padded[column[some]])
        return found


def total_degree(n: int, degree: int) -> set[tuple[int, ...]]:
    """Monomials of n variables up to a degree: sorted tuples of variables from 1 on, without a constant's."""
    return {
        term
        for d in range(degree + 1)
        for term in itertools.combinations_with_replacement(range(1, n + 1), d)
    }


def term_count(n: int, degree: int) -> int:
    """Number of monomials of n variables up to a degree."""
    return math.comb(n + degree, degree)


def table_of(monomials: Iterable[tuple[int, ...]]) -> NDArray[np.int64]:
    """Monomials as a table (n_terms, degree), those of few factors first, filled up with 0."""
    terms = sorted(monomials, key=lambda term: (len(term), term))
    degree = max(1, *(len(term) for term in terms))
    return np.array([(*term, *(0,) * (degree - len(term))) for term in terms], dtype=np.int64)


def features(v: Array, terms: NDArray[np.int64]) -> Array:
    """Monomials (n, n_terms) of points (n, n_x)."""
    padded = np.concatenate([np.ones((len(v), 1)), v], axis=1)
    found = padded[:, terms[:, 0]]
    for column in terms.T[1:]:
        found *= padded[:, column]
    return found


def independent(r: Array) -> bool:
    """Whether the columns of which r is the triangular factor are independent."""
    diagonal = np.abs(np.diag(r))
    return bool(diagonal.min() >= SINGULAR * diagonal.max())
