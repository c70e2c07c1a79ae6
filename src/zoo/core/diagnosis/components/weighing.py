"""Evidence for a free function of a component, over its size and length, and what it would be.

Around a point the series are linear, r = J d + X v + e, with the baseline's parameters d and v ~ N(0, s^2 R),
R = L L'. What the parameters absorb is projected out by M = S^-1 - S^-1 J H^-1 J' S^-1, H = J' S^-1 J + P.
With the eigenvalues g_i of L' X' M X L and the coordinates c_i, along its eigenvectors, of
L' X' S^-1 (r - J H^-1 (J' S^-1 r - pull)),

    log Z(s) = log Z(0) + sum_i (s^2 c_i^2/(1 + s^2 g_i) - log(1 + s^2 g_i))/2,

so that all sizes cost one eigendecomposition. Sizes are half-normal, lengths equally likely, and beside them
stands the same allowance as beside a listed effect.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.components import FreeFunction
from zoo.core.diagnosis.components.response import Block, Linearised
from zoo.core.diagnosis.evidence import marginal
from zoo.core.diagnosis.free import free_discrepancies
from zoo.core.diagnosis.hypothesis import HypothesisModel
from zoo.core.diagnosis.screening import DELTA_GRID
from zoo.core.errors.spectral import GroupErrors, Spectral

Array = NDArray[np.float64]
Option = tuple[float, Mapping[str, GroupErrors]]
Options = Callable[[Mapping[str, GroupErrors]], list[Option]]
"""From a noise to errors, with the logarithms of their prior weights."""

SIZES = np.geomspace(0.02, 8.0, 20)
"""Sizes of a function that are integrated over, in units of its prior's scale."""
NOISE_TURNS = 3
"""Turns in which a function and the noise beside it are found."""
SPARSE = 2
"""Every other size and length of a free discrepancy stands beside a function."""
MORE_SHARED = (0.0, 0.7)
"""Correlations of that between series."""
NEGLIGIBLE = 1e-6
"""Weight of a size, length and allowance below which it is left out of a posterior."""
HALVED = 3.0
"""Gain of a direction, (prior sd/posterior sd)^2 - 1, from which on the data halve its standard deviation."""


@dataclass(frozen=True, eq=False)
class Cell:
    """One size, length and error: posterior of the function's values and of the baseline's step."""

    log_weight: float
    sd: float
    length: float | None
    errors: Mapping[str, GroupErrors]
    mean: Array = field(repr=False)
    axes: Array = field(repr=False)
    spread: Array = field(repr=False)
    step: Array = field(repr=False)

    @property
    def covariance(self) -> Array:
        """Of the function's values, (n_points, n_points)."""
        return np.asarray((self.axes * self.spread) @ self.axes.T)


@dataclass(frozen=True, eq=False)
class Weighed:
    """A free function with its evidence and its posterior.

    Parameters
    ----------
    block : Block
        Responses, at the point of linearisation.
    log_z : float
        Log marginal likelihood, over sizes, lengths and what stands beside.
    best : Cell
        The most probable size, length and error.
    mean : array (n_points,)
        Of the function's values, over all of these.
    covariance : array (n_points, n_points)
    size : float
        Posterior mean of its sd.
    """

    block: Block
    log_z: float
    best: Cell
    mean: Array = field(repr=False)
    covariance: Array = field(repr=False)
    size: float

    @property
    def noise(self) -> Mapping[str, GroupErrors]:
        """Beside it, with the allowance or the free discrepancy."""
        return self.best.errors

    @property
    def function(self) -> FreeFunction:
        """What was weighed."""
        return self.block.function

    @property
    def sd(self) -> Array:
        """Of its values."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def band(self, width: float = 1.959964) -> tuple[Array, Array]:
        """Ends of its 95 % band."""
        return self.mean - width * self.sd, self.mean + width * self.sd

    def narrowed(self) -> list[Array]:
        """Directions of its values, of norm 1, in which the data halve the prior's sd; the best first."""
        root = self.best.sd * self.function.root(self.best.length)
        back = np.linalg.pinv(root)
        left, vectors = np.linalg.eigh(back @ self.best.covariance @ back.T)
        found = [root @ vectors[:, i] for i in range(len(left)) if left[i] < 1.0 / (1.0 + HALVED)]
        return [one / float(np.linalg.norm(one)) for one in found]


def allowance(allowances: Mapping[str, float]) -> Options:
    """Errors beside a function as beside a listed effect: what a caricature may leave."""
    weights = np.exp(-0.5 * DELTA_GRID**2)
    weights /= weights.sum()

    def options(clean: Mapping[str, GroupErrors]) -> list[Option]:
        return [
            (math.log(w), {q: replace(e, delta=factor * allowances[q]) for q, e in clean.items()})
            for factor, w in zip(DELTA_GRID, weights, strict=True)
        ]

    return options


def something_else(errors: Spectral) -> Options:
    """Errors beside a function with a free discrepancy, alike in all series to some degree."""

    def options(clean: Mapping[str, GroupErrors]) -> list[Option]:
        found, log_weights, _ = free_discrepancies(errors, clean, every=SPARSE, shared=MORE_SHARED)
        return list(zip(map(float, log_weights), found, strict=True))

    return options


def weigh(
    linearised: Linearised,
    block: Block,
    forward: HypothesisModel,
    u: Array,
    noise: Mapping[str, GroupErrors],
    options: Options,
    turns: int = NOISE_TURNS,
) -> Weighed:
    """Evidence and posterior of one free function beside the baseline.

    Parameters
    ----------
    linearised : Linearised
    block : Block
        One of its blocks, or another of the same shape.
    forward : HypothesisModel
        The baseline, whose prior counts at u.
    u : array (d,)
        Point of linearisation, in its coordinates.
    noise : mapping of group to GroupErrors
        Where the search of the noise begins.
    options : callable
        What stands beside the function and the noise: `allowance` or `something_else`.
    turns : int

    Returns
    -------
    Weighed
    """
    errors = linearised.errors
    clean = {
        q: replace(e, delta=0.0, length=errors.typical_length, shared=0.0, rough=False)
        for q, e in noise.items()
    }
    log_prior = forward.prior(u)[0]
    for turn in range(turns):
        cells = _cells(linearised, block, forward, u, options(clean))
        best = max(cells, key=lambda c: c.log_weight)
        log_z = float(logsumexp([c.log_weight for c in cells]))
        log_z += log_prior + sum(errors.noise_log_prior(e) for e in clean.values())
        if turn == turns - 1:
            break
        # what a function took of the noise is given back, on the average
        left = linearised.residual - linearised.jacobian @ best.step - block.columns @ best.mean
        power = np.sqrt(left**2 + _taken(linearised, block, best))
        fitted = {q: errors.fit_noise(power, q, best.errors[q]) for q in errors.groups}
        clean = {q: replace(e, delta=0.0, length=errors.typical_length) for q, e in fitted.items()}
    weights = np.exp([c.log_weight for c in cells] - logsumexp([c.log_weight for c in cells]))
    kept = [(w, c) for w, c in zip(weights, cells, strict=True) if w > NEGLIGIBLE]
    mean = np.sum([w * c.mean for w, c in kept], axis=0)
    covariance = np.sum(
        [w * (c.covariance + np.outer(c.mean - mean, c.mean - mean)) for w, c in kept], axis=0
    )
    size = float(sum(w * c.sd for w, c in kept))
    return Weighed(block, log_z, best, mean, covariance, size)


def _taken(linearised: Linearised, block: Block, cell: Cell) -> Array:
    """Posterior variance of J d + X v, (n,): what both together take of the noise, and not each alone."""
    J, S = linearised.jacobian, linearised.errors.variances(cell.errors)
    C = marginal(linearised.residual, J, S, linearised.precision, linearised.pull)[2]
    along = block.columns @ cell.axes
    along -= J @ (C @ (J.T @ (along / S[:, None])))
    return np.asarray(along**2 @ cell.spread + np.einsum("nd,de,ne->n", J, C, J))


def _cells(
    linearised: Linearised, block: Block, forward: HypothesisModel, u: Array, options: Sequence[Option]
) -> list[Cell]:
    """Every size and length beside each of some errors."""
    function, X, J = block.function, block.columns, linearised.jacobian
    lengths: Sequence[float | None] = function.lengths or (None,)
    sizes = SIZES * np.exp(-0.5 * SIZES**2)  # log-spaced sizes of a half-normal
    sizes /= sizes.sum()
    roots = [function.root(length) for length in lengths]
    found = []
    for log_weight, at in options:
        S = linearised.errors.variances(at)
        log_z0, step0, C = marginal(linearised.residual, J, S, linearised.precision, linearised.pull)
        scaled = X / S[:, None]
        K = J.T @ scaled
        CK = C @ K
        G = X.T @ scaled - K.T @ CK
        b = scaled.T @ linearised.residual - K.T @ step0
        for length, L in zip(lengths, roots, strict=True):
            gains, Q = np.linalg.eigh(L.T @ G @ L)
            gains = np.maximum(gains, 0.0)
            LQ = L @ Q
            c = LQ.T @ b
            s2 = (function.size * SIZES[:, None]) ** 2
            bend = 1.0 + s2 * gains
            log_z = log_z0 + 0.5 * np.sum(s2 * c**2 / bend - np.log(bend), axis=1)
            means = (s2 * c / bend) @ LQ.T
            parts = s2 / bend  # variances along the eigenvectors
            T = CK @ LQ
            steps = step0 - means @ CK.T
            spread = C + np.einsum("di,si,ei->sde", T, parts, T)
            log_z += forward.log_mass(u + steps, spread) - math.log(len(lengths))
            for i, size in enumerate(SIZES):
                found.append(
                    Cell(
                        log_weight + math.log(sizes[i]) + float(log_z[i]),
                        float(size * function.size),
                        length,
                        at,
                        means[i],
                        LQ,
                        parts[i],
                        steps[i],
                    )
                )
    return found
