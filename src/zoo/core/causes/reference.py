"""All causes given one error model and the causes of a set: a quick evidence, by which sets are sought.

With V given, the baseline's parameters are projected out of one matrix of products of all responses; a set S
is a Cholesky factor of the size of its weights, and a further cause j costs the eigenvalues of its own block,

    log p(r | S + j, s, V) - log p(r | S, V) = sum y^2 / (lambda + 1/s^2) / 2 - log(1 + lambda s^2) / 2,

lambda, y those of the block given S, for all sizes s at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import logsumexp

from zoo.core.causes.evidence import SCALES, log_scale_masses
from zoo.core.causes.problem import Cause, Problem
from zoo.core.priors import log_normal_mass

Array = NDArray[np.float64]
Indices = NDArray[np.int_]
NARROW = 3
"""Weights of a narrow block at most."""


class Reference:
    """Evidence given errors of some variances, of any set and one cause more.

    Parameters
    ----------
    problem : Problem
    causes : sequence of Cause
    V : array (n,)
    """

    def __init__(self, problem: Problem, causes: Sequence[Cause], V: Array) -> None:
        self.causes = causes
        root = 1.0 / np.sqrt(V)
        J, r = problem.jacobian * root[:, None], problem.residual * root
        X = np.concatenate([one.columns for one in causes], axis=1) * root[:, None]
        H, b = J.T @ J + problem.P, J.T @ r - problem.pull
        cross = np.linalg.solve(H, J.T @ X)
        m = X.shape[1]
        self.G, self.g = np.zeros((m + 1, m + 1)), np.zeros(m + 1)  # the last one stands for no weight
        self.G[:m, :m] = X.T @ X - (J.T @ X).T @ cross
        self.g[:m] = X.T @ r - cross.T @ b
        sizes = np.array([one.columns.shape[1] for one in causes])
        edges = np.cumsum([0, *sizes])
        self.own = [np.arange(a, b) for a, b in pairwise(edges)]
        narrow = sizes <= NARROW  # wide blocks apart, so that narrow ones cost little
        self.blocks = []
        for part in (np.flatnonzero(narrow), np.flatnonzero(~narrow)):
            if len(part):
                at = np.full((len(part), int(sizes[part].max())), m)
                for row, i in zip(at, part, strict=True):
                    row[: sizes[i]] = self.own[i]
                self.blocks.append((part, at))
        self.means = np.zeros(m + 1)
        self.means[:m] = np.concatenate([one.prior_mean for one in causes])
        self.free = np.array([one.free for one in causes])
        self.low, self.high = (np.array([getattr(one, x) for one in causes]) for x in ("low", "high"))
        centre = self.means[edges[:-1]]
        self.prior_mass = log_normal_mass(self.low - centre, self.high - centre)
        self.bounded = np.isfinite(self.low) | np.isfinite(self.high)

    def further(self, which: Sequence[int], scales: Sequence[float]) -> tuple[Array, Array]:
        """Log evidence gained (n_causes,) by each cause given those of `which`, and its best size."""
        there: tuple[Array, Array, Array] | None = None
        bounded = [i for i in which if self.bounded[i]]
        if len(which):
            own = np.concatenate([self.own[i] for i in which])
            s = np.concatenate([np.full(len(self.own[i]), x) for i, x in zip(which, scales, strict=True)])
            L = np.linalg.cholesky(self.G[np.ix_(own, own)] + np.diag(1.0 / s**2))
            Y = solve_triangular(L, self.G[own], lower=True)
            left = solve_triangular(L, self.g[own] + self.means[own] / s**2, lower=True)
            first = np.flatnonzero(np.isin(own, [self.own[i][0] for i in bounded]))
            rows = solve_triangular(L, np.eye(len(own))[:, first], lower=True).T
            there = Y, left, rows
        gained, best = np.empty(len(self.causes)), np.ones(len(self.causes))
        for part, at in self.blocks:
            gained[part], best[part] = self._each(part, at, there, np.array(bounded, int))
        return gained, best

    def _each(
        self, part: Indices, at: Indices, there: tuple[Array, Array, Array] | None, bounded: Indices
    ) -> tuple[Array, Array]:
        """The same of some causes, whose weights are at these places."""
        G, b = self.G[at[:, :, None], at[:, None, :]], self.g[at]
        if there is not None:
            Y, left, rows = there
            B = Y[:, at].transpose(1, 0, 2)  # (n_causes, m_there, m_each)
            G = G - B.transpose(0, 2, 1) @ B
            b = b - np.einsum("cij,i->cj", B, left)
        lam, U = np.linalg.eigh(G)
        lam = np.maximum(lam, 0.0)
        mu, free = self.means[at], self.free[part]
        y = np.einsum("cij,ci->cj", U, np.where(free[:, None], b, b + mu))
        inverse = 1.0 / SCALES**2
        each = 0.5 * np.sum(y[:, None] ** 2 / (lam[:, None] + inverse[:, None]), axis=2)
        each -= 0.5 * np.sum(np.log1p(lam[:, None] * SCALES[:, None] ** 2), axis=2)
        each += log_scale_masses(SCALES)
        one = 0.5 * np.sum(y**2 / (lam + 1.0), axis=1) - 0.5 * np.sum(np.log1p(lam), axis=1)
        one -= 0.5 * np.sum(mu**2, axis=1)
        mean = (U[:, 0] * y / (lam + 1.0)).sum(axis=1)
        sd = np.sqrt((U[:, 0] ** 2 / (lam + 1.0)).sum(axis=1))
        mass = log_normal_mass((self.low[part] - mean) / sd, (self.high[part] - mean) / sd)
        one += np.where(self.bounded[part], mass - self.prior_mass[part], 0.0)
        gained = np.where(free, logsumexp(each, axis=1), one)
        best = np.where(free, SCALES[np.argmax(each, axis=1)], 1.0)
        if there is not None and len(bounded):  # amplitudes that were there move, perhaps out of their bounds
            moves = (rows @ B) @ U  # (n_causes, n_bounded, m_each)
            D = 1.0 / (lam + 1.0 / best[:, None] ** 2)
            mean = rows @ left - np.einsum("cbi,ci->cb", moves, D * y)
            var = np.sum(rows**2, axis=1) + np.einsum("cbi,ci->cb", moves**2, D)
            gained += np.sum(
                self._inside(bounded, mean, var)
                - self._inside(bounded, rows @ left, np.sum(rows**2, axis=1)),
                axis=1,
            )
        return gained, best

    def _inside(self, which: Indices, mean: Array, var: Array) -> Array:
        """Log mass of bounded amplitudes inside their bounds."""
        sd = np.sqrt(var)
        return np.asarray(log_normal_mass((self.low[which] - mean) / sd, (self.high[which] - mean) / sd))
