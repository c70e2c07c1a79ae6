"""The log-likelihood of a surrogate's coefficients under normal errors, as a graph with a gradient."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytensor.tensor as pt
from numpy.polynomial import chebyshev

from zoo.core.arrays import Array
from zoo.core.errors.base import ErrorModel
from zoo.core.surrogate.waveform import Surrogate, SurrogateError

MOST_PARAMETERS = 2
"""Most parameters of errors that a table is made over."""
NODES = (8, 12, 18, 26, 38, 54)
"""Numbers of nodes of a table in each direction, until it is exact to `EXACT`."""
EXACT = 1e-3
"""Largest error of the log-likelihood that a table may make, at coefficients as in the posterior."""
COARSE = 11
"""Points in each direction that are looked at before, to see where the likelihood is."""
FAR = 40.0
"""How far below its largest value the log-likelihood is left out of a table."""
FENCE = 1e4
"""What is taken from the log-likelihood at a table's own width beyond its ends, squared distances before."""
KEPT = 1e-6
"""Size of the singular values that a table keeps, in units of the log-likelihood."""


@dataclass(frozen=True)
class Table:
    """Log-likelihood of y - middle - sum a_k b_k under linear normal errors with parameters eta.

    With W the whitened rows (y - middle, b_1, ...) and s = (1, -a), it is c(eta) - s' W W' s/2. The matrix
    W W' and c, which depend on eta alone, are interpolated at Chebyshev nodes in log eta.

    Parameters
    ----------
    names : sequence of str
        The errors' parameters.
    low, high : array (n_eta,)
        Ends of log eta.
    nodes : int
    left : array (nodes ** n_eta, rank)
    right : array (rank, n_entries)
        Products with the Chebyshev polynomials and with the entries (c, s_i s_j).
    """

    names: tuple[str, ...]
    low: Array
    high: Array
    nodes: int
    left: Array
    right: Array

    @classmethod
    def of(cls, surrogate: Surrogate, errors: ErrorModel, points: Array) -> Table:
        """Of a surrogate's basis; its exactness is tried at points (n, n_values).

        Raises
        ------
        SurrogateError
            If the errors have too many parameters, have no bounds, or cannot be interpolated.
        """
        if why := no_table(errors):
            raise SurrogateError(f"{why}; sample with method exact")
        ends = np.array([p.prior.support for p in errors.parameters])
        low, high = np.log(ends).T
        rows = np.concatenate([(errors.on.values - surrogate.middle)[None], surrogate.basis])

        def entries(eta: Array) -> Array:
            values = dict(zip(errors.parameter_names, np.exp(eta), strict=True))
            z = errors.whiten(rows, values)
            if z is None:
                raise SurrogateError(
                    f"error model {errors.name}: no law at {values}: sample with method exact"
                )
            flat = z.reshape(len(rows), -1)
            constant = errors.log_density(np.zeros_like(rows[0]), values)
            return np.concatenate([[constant], -0.5 * (flat @ flat.T).ravel()])

        a = surrogate.coefficients(points)
        s = np.concatenate([np.ones((len(a), 1)), -a], axis=1)
        squares = (s[:, :, None] * s[:, None, :]).reshape(len(s), -1)
        probe = np.concatenate([np.ones((len(s), 1)), squares], axis=1)
        low, high = _where(lambda eta: float((probe @ entries(eta)).max()), low, high)
        rng = np.random.default_rng(0)
        tried = rng.uniform(low, high, (24, len(low)))
        truth = np.array([entries(eta) for eta in tried])
        error = np.inf
        for n in NODES:
            t = np.cos(np.pi * (np.arange(n) + 0.5) / n)
            grid = np.array(list(itertools.product(t, repeat=len(low))))
            at = np.array([entries(low + 0.5 * (x + 1.0) * (high - low)) for x in grid])
            at = np.linalg.solve(np.array([_products(x, n) for x in grid]), at)
            scale = np.sqrt((probe**2).mean(0)) + 1e-12
            u, size, v = np.linalg.svd(at * scale, full_matrices=False)
            rank = int(np.sum(size > KEPT))
            found = cls(errors.parameter_names, low, high, n, u[:, :rank] * size[:rank], v[:rank] / scale)
            guess = np.array([found._entries(eta) for eta in tried])
            error = float(np.abs((guess - truth) @ probe.T).max())
            if error <= EXACT:
                return found
        raise SurrogateError(
            f"error model {errors.name}: its covariance cannot be interpolated over the priors of "
            f"{', '.join(errors.parameter_names)} (error {error:.1g} with {NODES[-1]} nodes): sample with "
            "method exact"
        )

    def _entries(self, eta: Array) -> Array:
        t = 2.0 * (eta - self.low) / (self.high - self.low) - 1.0
        return np.asarray((_products(t, self.nodes) @ self.left) @ self.right)

    def symbolic(self, coefficients: Any, eta: Mapping[str, Any]) -> Any:
        """The log-likelihood of coefficients (n_basis,) with the errors' parameters, as a graph."""
        product, outside = None, 0.0
        for name, low, high in zip(self.names, self.low, self.high, strict=True):
            t = 2.0 * (pt.log(eta[name]) - low) / (high - low) - 1.0
            outside = outside + FENCE * pt.maximum(0.5 * (pt.abs(t) - 1.0), 0.0) ** 2
            angle = pt.arccos(pt.clip(t, -1.0 + 1e-12, 1.0 - 1e-12))
            each = pt.cos(np.arange(self.nodes) * angle)
            product = each if product is None else pt.outer(product, each).ravel()
        assert product is not None
        rank, size = len(self.right), math.isqrt(self.right.shape[1] - 1)
        s = pt.concatenate([np.ones(1), -coefficients])
        flat = self.right[:, 1:].reshape(rank, size, size).transpose(1, 0, 2).reshape(size, -1)
        half = pt.dot(s, flat).reshape((rank, size))
        factors = pt.dot(product, self.left)
        return pt.dot(factors, self.right[:, 0] + pt.dot(half, s)) - outside


def _products(t: Array, n: int) -> Array:
    """Products (n ** n_eta,) of the first n Chebyshev polynomials of each of t (n_eta,)."""
    found = np.ones(1)
    for x in t:
        found = np.multiply.outer(found, chebyshev.chebvander(x, n - 1)).ravel()
    return found


def no_table(errors: ErrorModel) -> str:
    """Why the log-likelihood of an error model cannot be tabled; empty if it can."""
    parameters = errors.parameters
    if len(parameters) > MOST_PARAMETERS or any(p.dims for p in parameters):
        return (
            f"error model {errors.name} is not written in PyTensor and has "
            f"{sum(p.size for p in parameters)} parameters, a "
            f"surrogate takes at most {MOST_PARAMETERS} of these"
        )
    ends = np.array([p.prior.support for p in parameters])
    if not (np.all(np.isfinite(ends)) and np.all(ends > 0)):
        return (
            f"error model {errors.name} is not written in PyTensor, and the priors of its parameters have no "
            "positive bounds"
        )
    return "" if _linear(errors) else f"the errors of {errors.name} are not normal"


def _linear(errors: ErrorModel) -> bool:
    """Whether an error model's `whiten` is linear, as that of normal errors."""
    values = {p.name: p.first for p in errors.parameters}
    one, other = np.random.default_rng(0).standard_normal((2, *errors.on.values.shape))
    parts = [errors.whiten(rows, values) for rows in (one, other, 3.0 * one + other)]
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return False
    alone, beside, both = known
    return bool(np.allclose(3.0 * alone + beside, both, rtol=1e-6, atol=1e-6 * np.abs(both).max()))


def _where(height: Callable[[Array], float], low: Array, high: Array) -> tuple[Array, Array]:
    """Ends of the part of a box where a function is less than `FAR` below its largest value."""
    axes = [np.linspace(a, b, COARSE) for a, b in zip(low, high, strict=True)]
    index = np.array(list(itertools.product(range(COARSE), repeat=len(low))))
    values = np.array([height(np.array([axis[i] for axis, i in zip(axes, at, strict=True)])) for at in index])
    there = index[values > values.max() - FAR]
    first, last = np.maximum(there.min(0) - 1, 0), np.minimum(there.max(0) + 1, COARSE - 1)
    ends = [np.array([axis[i] for axis, i in zip(axes, at, strict=True)]) for at in (first, last)]
    return ends[0], ends[1]
