"""Evidence of one set of causes given each error model: linear in what the set does.

For errors of variance V, parameters and weights x = (d, w) are normal, and with A = [J, R],

    log p(r | S, s, V) = log N(r; 0, V) + b'H^-1 b / 2 - log |H/2 pi| / 2 + log p0,    H = A'V^-1 A + P,

b = A'V^-1 r - pull. The noise of each group is found by Fisher scoring and integrated around its mode, the
sizes s of free functions on a grid, that of the discrepancy by a cubic interpolation of the log evidence
between sizes at which its slope is known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.causes.family import (
    CARICATURE,
    COLOURED,
    FINE,
    IN_PROPORTION,
    NOISE_SPREAD,
    NUMERICS,
    SIZES,
    UNEXPLAINED,
    UNEXPLAINED_ODDS,
    ErrorFamily,
    half_normal_mass,
)
from zoo.core.causes.problem import Cause, Problem
from zoo.core.causes.truncated import truncate
from zoo.core.priors import log_normal_mass

Array = NDArray[np.float64]
Kinds = NDArray[np.int_]

SCALES: Array = 0.03 * 1.6 ** np.arange(11.0)
"""Sizes of a free function that are integrated over, in its prior scale."""
FEW_SCALES = SCALES[1::2]
"""The same where three functions or more are free at once."""
SCORING, LARGEST_STEP, CONVERGED = 12, 1.5, 0.01
"""Steps of scoring at most, the largest in the logarithm of the noise, and the one that ends it."""
OF_KINDS = ("kinds", "log_z", "slope", "log_noise", "mean", "covariance", "gains", "computed")
"""What a set's evidence has of each error model."""
REACH, NODES, FEWEST = 6.0, 15, 1e-9
"""Sds on either side of its mode over which the noise is integrated, at how many points; least number of
coefficients that tell it."""


def log_scale_masses(scales: Array) -> Array:
    """Log masses of the cells around sizes of a half-normal distribution."""
    edges = np.concatenate([[0.0], np.sqrt(scales[1:] * scales[:-1]), [np.inf]])
    return np.log(half_normal_mass(edges, 1.0))


def hermite(nodes: Array, values: Array, slopes: Array) -> Array:
    """Cubic interpolation (..., n) at `FINE` points from each node (m,) on, and the last, without overshoot.

    Where the slopes at both ends of an interval have one sign, or one of them is zero, they are at most three
    times its secant (by Fritsch and Carlson 1980, doi 10.1137/0717021); a peak between nodes stays below the
    tangents at both.
    """
    h, low, high = np.diff(nodes), slopes[..., :-1], slopes[..., 1:]
    secant = np.diff(values, axis=-1) / h
    along, peak = (low + high) * secant > 0.0, (low > 0.0) & (high < 0.0)
    monotone = (low * high > 0.0) | ((low * high == 0.0) & along)
    most = np.where(along, 3.0 * np.abs(secant), 0.0)
    low, high = (np.where(monotone, np.sign(m) * np.minimum(np.abs(m), most), m) for m in (low, high))
    t = np.arange(FINE) / FINE
    rise = t**2 * (3.0 - 2.0 * t)
    first, last = values[..., :-1, None], values[..., 1:, None]
    low, high = (h * low)[..., None], (h * high)[..., None]
    found = first * (1.0 - rise) + last * rise + low * t * (1.0 - t) ** 2 - high * t**2 * (1.0 - t)
    below = np.minimum(first + low * t, last - high * (1.0 - t))
    found = np.where(peak[..., None], np.minimum(found, below), found)
    return np.concatenate([found.reshape(*values.shape[:-1], -1), values[..., -1:]], axis=-1)


@lru_cache(64)
def _combinations(free: tuple[bool, ...], factor: float = 1.0) -> tuple[Array, Array]:
    """Sizes (n, n_causes) of all causes, and their log masses (n,), their prior scale times a factor."""
    scales = SCALES if sum(free) < 3 else FEW_SCALES
    logs = log_scale_masses(scales / factor)
    options = [list(zip(scales, logs, strict=True)) if one else [(1.0, 0.0)] for one in free]
    rows = list(product(*options))
    return (
        np.array([[s for s, _ in row] for row in rows]).reshape(len(rows), len(free)),
        np.array([sum(log for _, log in row) for row in rows]),
    )


@dataclass(frozen=True)
class SizePriors:
    """Priors of sizes: of the discrepancy, and of what causes do in parts of what they state.

    The discrepancy is the error of numerics and of causes, or what nobody can name.

    Parameters
    ----------
    numerics : float
        Scale of the error of the simulator's numerics, in parts of the range.
    caricature : float
        Scale of the model error of causes: the discrepancy of their response, in parts of its signal.
    unexplained, odds : float
        Scale of what nobody can name, and the odds that there is such.
    effects, functions : float
        Factors on the prior sd of listed effects' amplitudes, and on the scale of functions' sizes.
    """

    numerics: float = NUMERICS
    caricature: float = CARICATURE
    unexplained: float = UNEXPLAINED
    odds: float = UNEXPLAINED_ODDS
    effects: float = 1.0
    functions: float = 1.0

    def scales(self, signal: float | None) -> tuple[dict[float, float], dict[float, float]]:
        """Scales with their weights: of a discrepancy of a Matern spectrum, and of one like what causes do.

        Parameters
        ----------
        signal : float or None
            What causes do in parts of the range; None without a cause.
        """
        p = self.odds / (1.0 + self.odds)
        own = self.caricature * (signal or 0.0)
        like = 0.0 if signal is None else (1.0 - p) * IN_PROPORTION
        found = {math.hypot(self.numerics, own): 1.0 - p - like}
        found[self.unexplained] = found.get(self.unexplained, 0.0) + p
        return found, {max(own, 1e-9): like}


SIZE_PRIORS = SizePriors()
"""Those that are believed; only the sensitivity of an answer has others."""


@dataclass(frozen=True, eq=False)
class Amplitudes:
    """Amplitudes of a set's listed effects: their normal prior with its bounds, and their posterior.

    Parameters
    ----------
    centre, precision, low, high : array (a,)
    mean : array (n_kinds, n_sizes, a)
        Without the bounds, for each combination of the sizes of the set's functions.
    covariance : array (n_kinds, n_sizes, a, a)
    """

    centre: Array
    precision: Array
    low: Array
    high: Array
    mean: Array = field(repr=False)
    covariance: Array = field(repr=False)

    def change(self, factor: float) -> Array:
        """Change (n_kinds, n_sizes) of the log evidence with the prior sd times a factor.

        The mean, over the posterior, of the new prior's density over the old one's, and the same of the
        masses inside the bounds.
        """
        D = (1.0 / factor**2 - 1.0) * self.precision
        M = np.eye(len(D)) + self.covariance * D
        off = self.mean - self.centre
        moved = np.linalg.solve(M, off[..., None])[..., 0]
        gain = -0.5 * np.linalg.slogdet(M)[1] - len(D) * math.log(factor)
        gain = gain - 0.5 * np.sum(off * D * moved, axis=-1)
        now = np.asarray(np.linalg.solve(M, self.covariance), np.float64)
        prior_sd = 1.0 / np.sqrt(self.precision)
        for sign, mean, C, sd in (
            (1.0, np.asarray(self.centre + moved), now, factor * prior_sd),
            (-1.0, self.mean, self.covariance, prior_sd),
        ):
            posterior, _, _ = truncate(mean, C, np.arange(len(D)), self.low, self.high)
            ends = ((end - self.centre) / sd for end in (self.low, self.high))
            gain = gain + sign * (posterior - np.sum(log_normal_mass(*ends)))
        return np.asarray(gain)


@dataclass(frozen=True, eq=False)
class SetEvidence:
    """One set of causes given each error model that was tried.

    Parameters
    ----------
    family : ErrorFamily
    kinds : int array (n,)
        Which error models; log evidence, its slope in log size, and the noise's logarithm are of each.
    signal : float or None
        Rms of what the causes do and the baseline cannot take up, in parts of the range; None without
        a cause.
    mean : array (n_kinds, k)
        Step of the baseline's parameters, then weights of the causes in their order.
    free : tuple of bool
        Which causes are functions.
    gains : array (n_kinds, n_sizes)
        Terms of the log evidence for each combination of the functions' sizes, up to a constant.
    amplitudes : Amplitudes
    problem : Problem
    causes : tuple of Cause
    computed : array (n_kinds,)
        Log evidence of the model alone; `log_z` may be corrected.
    totals : dict
        Log evidence by the priors of sizes that it was asked for.
    """

    family: ErrorFamily
    kinds: Kinds
    log_z: Array = field(repr=False)
    slope: Array = field(repr=False)
    log_noise: Array = field(repr=False)
    signal: float | None
    mean: Array = field(repr=False)
    covariance: Array = field(repr=False)
    free: tuple[bool, ...]
    gains: Array = field(repr=False)
    amplitudes: Amplitudes = field(repr=False)
    problem: Problem = field(repr=False)
    causes: tuple[Cause, ...] = field(repr=False)
    computed: Array = field(repr=False)
    totals: dict[SizePriors, float] = field(init=False, repr=False, default_factory=dict)

    @property
    def _first(self) -> int:
        return 1 + len(self.family.colours)

    @property
    def shapes(self) -> Kinds:
        """Indices of the discrepancy's spectra among the error models."""
        after = self.kinds[self.kinds >= self._first] - self._first
        return np.unique(after // len(SIZES))

    def only(self, kinds: Kinds) -> SetEvidence:
        """The same given some of its error models, and all in proportion to what the causes do."""
        at = np.flatnonzero(np.isin(self.kinds, kinds) | (self.kinds >= self.family.n_kinds))
        a = self.amplitudes
        a = replace(a, mean=a.mean[at], covariance=a.covariance[at])
        own: dict[str, Any] = {name: getattr(self, name)[at] for name in OF_KINDS}
        return replace(self, amplitudes=a, **own)

    def joined(self, own: SetEvidence, signal: float) -> SetEvidence:
        """With error models in proportion to what the causes do, of that rms in parts of the range."""
        a, b = self.amplitudes, own.amplitudes
        mean, C = np.concatenate([a.mean, b.mean]), np.concatenate([a.covariance, b.covariance])
        pairs = {name: (getattr(self, name), getattr(own, name)) for name in OF_KINDS}
        both: dict[str, Any] = {name: np.concatenate(pair) for name, pair in pairs.items()}
        return replace(own, signal=signal, amplitudes=replace(a, mean=mean, covariance=C), **both)

    def coarsened(self, power: float) -> SetEvidence:
        """The same with the likelihood to a power; what corrects the linear model is taken in proportion."""
        model = SetModel(self.problem, self.causes, self.family)
        found = model.given(self.kinds, self.log_noise, power)
        log_z = found.log_z + power * (self.log_z - self.computed)
        return replace(found, log_z=log_z, signal=self.signal)

    def log_evidence(self, priors: SizePriors) -> Array:
        """Log evidence (n_kinds,) with the prior sizes of causes times their factors, the noise held."""
        if priors.effects == priors.functions == 1.0:
            return self.log_z
        gains = self.gains + _combinations(self.free, priors.functions)[1] - _combinations(self.free)[1]
        if priors.effects != 1.0:
            gains = gains + self.amplitudes.change(priors.effects)
        return np.asarray(self.log_z + logsumexp(gains, axis=1) - logsumexp(self.gains, axis=1))

    def interpolated(self, priors: SizePriors) -> Array:
        """Log evidence of each spectrum at the sizes of the family's grid, (n_shapes, n)."""
        x, _ = self.family.grid
        after = self.kinds >= self._first
        log_z = self.log_evidence(priors)
        L = log_z[after].reshape(-1, len(SIZES))
        change = L - self.log_z[after].reshape(-1, len(SIZES))
        slope = self.slope[after].reshape(-1, len(SIZES)) + np.gradient(change, np.log(SIZES), axis=1)
        none = float(log_z[self.kinds == 0][0])
        nodes = np.concatenate([[x[0]], np.log(SIZES)])
        L = np.concatenate([np.full((len(L), 1), none), L], axis=1)
        slope = np.concatenate([np.zeros((len(slope), 1)), slope], axis=1)
        return hermite(nodes, L, slope)

    def terms(self, priors: SizePriors) -> tuple[Array, Array]:
        """Log prior plus log evidence: each correlated noise (n,), each spectrum and size (n, m)."""
        shapes = self.shapes
        log_sizes = [self.family.log_sizes(scales) for scales in priors.scales(self.signal)]
        smooth = self.interpolated(priors) + math.log(1.0 - COLOURED)
        for row, shape in zip(smooth, shapes, strict=True):
            like = int(shape == len(self.family.shapes))
            row += log_sizes[like] + (0.0 if like else self.family.log_shapes[shape])
        there = (self.kinds > 0) & (self.kinds < self._first)
        colours = self.log_evidence(priors)[there] + math.log(COLOURED)
        colours += self.family.log_colours[self.kinds[there] - 1]
        return colours, smooth

    def total(self, priors: SizePriors) -> float:
        """Log evidence of the set."""
        if priors not in self.totals:
            colours, smooth = self.terms(priors)
            both = np.logaddexp(logsumexp(smooth), logsumexp(colours) if len(colours) else -np.inf)
            self.totals[priors] = float(both)
        return self.totals[priors]

    def correlated(self, priors: SizePriors) -> float:
        """Probability that the noise is correlated, given the set."""
        return float(np.sum(np.exp(self.terms(priors)[0] - self.total(priors))))

    def small(self, priors: SizePriors, size: float) -> float:
        """Log of the part of the evidence whose discrepancy is below a size."""
        colours, smooth = self.terms(priors)
        below = smooth[:, self.family.grid[0] < math.log(size)]
        parts = np.concatenate([colours, below.reshape(-1)])
        return float(logsumexp(parts)) - self.total(priors)

    def _log_weights(self, priors: SizePriors) -> Array:
        """Log prior plus log evidence (n,) of each error model, a size standing for those around it."""
        found = np.full(len(self.kinds), -np.inf)
        edges = np.concatenate([[0.0, SIZES[0]], np.sqrt(SIZES[1:] * SIZES[:-1]), [np.inf]])
        mass = [
            sum(weight * half_normal_mass(edges, scale) for scale, weight in mixture.items())
            for mixture in priors.scales(self.signal)
        ]
        logs, own = (np.log(np.maximum(m, 1e-300)) + math.log(1.0 - COLOURED) for m in mass)
        after = self.kinds >= self._first
        shapes = self.shapes[self.shapes < len(self.family.shapes)]
        each = (self.family.log_shapes[shapes][:, None] + logs[1:]).reshape(-1)
        found[after] = np.append(each, own[1:])[: np.count_nonzero(after)]
        found[0] = np.logaddexp(logs[0], own[0])
        there = (self.kinds > 0) & ~after
        found[there] = self.family.log_colours[self.kinds[there] - 1] + math.log(COLOURED)
        return np.asarray(self.log_evidence(priors) + found)

    def best(self, priors: SizePriors) -> int:
        """Index of the most probable error model."""
        return int(np.argmax(self._log_weights(priors)))

    def weights(self, priors: SizePriors) -> Array:
        """Probability (n,) of each error model, given the set."""
        log = self._log_weights(priors)
        return np.asarray(np.exp(log - logsumexp(log)))

    def variances(self, kind: int, *, alone: bool = False) -> Array:
        """Variances (n,) of one error model, by its index here, or of its noise alone."""
        noise, discrepancy = self.family.of(self.kinds[[kind]])
        sigma2 = np.exp(2.0 * self.log_noise[kind])[self.family.member]
        return np.asarray(sigma2 * noise[0] + (0.0 if alone else discrepancy[0]))

    def likely_variances(self, priors: SizePriors, *, alone: bool = False) -> Array:
        """Variances (n,) of the most probable errors, the discrepancy's size between those tried.

        With `alone`, of their noise.
        """
        colours, smooth = self.terms(priors)
        if len(colours) and colours.max() > smooth.max():
            return self.variances(self.best(priors), alone=alone)
        shape, at = np.unravel_index(np.argmax(smooth), smooth.shape)
        x, _ = self.family.grid
        own = np.flatnonzero(self.kinds >= self._first).reshape(-1, len(SIZES))[shape]
        tried = np.concatenate([x[:1], np.log(SIZES)])
        held = np.concatenate([self.log_noise[self.kinds == 0], self.log_noise[own]])
        log_noise = np.array([np.interp(x[at], tried, one) for one in held.T])
        noise = np.exp(2.0 * log_noise)[self.family.member]
        size = 0.0 if alone or at == 0 else math.exp(x[at])
        return np.asarray(noise + size**2 * self.family.discrepancy(self.shapes[shape]))


class SetModel:
    """A problem with some causes, and its evidence given many error models at once.

    Parameters
    ----------
    problem : Problem
    causes : sequence of Cause
    family : ErrorFamily
    """

    def __init__(self, problem: Problem, causes: Sequence[Cause], family: ErrorFamily) -> None:
        self.problem, self.causes, self.family = problem, causes, family
        k = problem.jacobian.shape[1]
        self.k, self.sizes = k, [one.columns.shape[1] for one in causes]
        self.A = np.concatenate([problem.jacobian, *(one.columns for one in causes)], axis=1)
        p = self.A.shape[1]
        self.edges = np.cumsum([k, *self.sizes])
        # weights of a function are alike beforehand in any basis; in this one its columns are orthogonal
        self.turn = np.eye(p)
        for one, first, after in zip(causes, self.edges, self.edges[1:], strict=False):
            if one.free:
                self.turn[first:after, first:after] = np.linalg.svd(np.linalg.qr(one.columns, mode="r"))[2].T
        self.A = self.A @ self.turn
        self.rows, self.columns = np.triu_indices(p)
        self.products = self.A[:, self.rows] * self.A[:, self.columns]  # a symmetric matrix's upper part
        self.Ar = self.A * problem.residual[:, None]
        self.mean = np.concatenate([np.zeros(k), *(one.prior_mean for one in causes)])
        self.P0 = np.zeros((p, p))
        self.P0[:k, :k] = problem.P
        self.pull = np.concatenate([problem.pull, np.zeros(p - k)])
        self.owner = np.repeat(np.arange(len(causes)), self.sizes)
        listed = [at for one, at in zip(causes, self.edges[:-1], strict=True) if not one.free]
        self.listed = np.array([*problem.amplitudes, *listed], int)
        k_low, k_high = np.full(k, -np.inf), np.full(k, np.inf)
        if problem.low is not None and problem.high is not None:
            k_low, k_high = problem.low, problem.high
        low = np.concatenate([k_low, [one.low for one in causes]])
        high = np.concatenate([k_high, [one.high for one in causes]])
        bounded = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
        self.bounded = np.concatenate([np.arange(k), self.edges[:-1]]).astype(int)[bounded]
        self.low, self.high = low[bounded], high[bounded]
        centres = np.array([float(one.prior_mean[0]) for one in causes])
        self.prior_mass = float(np.sum(log_normal_mass(low[k:] - centres, high[k:] - centres)))
        free = [i for i, one in enumerate(causes) if one.free]
        self.widest = max(free, key=lambda i: self.sizes[i]) if free else None
        wide = np.concatenate([np.zeros(k, bool), self.owner == self.widest])
        self.wide, self.narrow = np.flatnonzero(wide), np.flatnonzero(~wide)

    def precision(self, scales: Array) -> tuple[Array, Array]:
        """Prior precision (..., p, p) and pull (..., p) for sizes (..., n_causes)."""
        inverse = 1.0 / scales[..., self.owner] ** 2
        diagonal = np.concatenate([np.zeros((*inverse.shape[:-1], self.k)), inverse], axis=-1)
        P = self.P0 + diagonal[..., None] * np.eye(len(self.mean))
        return P, self.pull - diagonal * self.mean

    def solve(self, gram: Array, right: Array, scales: Array) -> tuple[Array, Array]:
        """Mean (..., p) and covariance (..., p, p) of parameters and weights, of one size of each cause."""
        P, pull = self.precision(scales)
        H = gram + P
        size = np.sqrt(np.maximum(np.einsum("...ii->...i", H), 1e-300))
        both = size[..., :, None] * size[..., None, :]
        C = np.linalg.inv(H / both) / both
        return np.einsum("...ij,...j->...i", C, right - pull), C

    def _inside(self, mean: Array, C: Array) -> tuple[Array, Array]:
        """Mean and covariance of parameters and weights inside their bounds."""
        _, mean, lost = truncate(mean, C[..., self.bounded], self.bounded, self.low, self.high)
        return mean, C - lost @ lost.swapaxes(-1, -2)

    def _alike(self, scales: Array) -> list[Kinds]:
        """Rows of sizes (n, n_causes) that differ in the size of the widest function only."""
        others = np.delete(scales, [] if self.widest is None else self.widest, axis=1)
        _, which = np.unique(others, axis=0, return_inverse=True)
        return [np.flatnonzero(which == i) for i in range(which.max() + 1)]

    def _left(self, mean: Array, C: Array, V: Array) -> Array:
        """Expected squares (n_kinds, n) of what parameters and weights leave, given errors of variance V.

        The posterior variance of what they predict is at most V, which an inverse of many figures can miss.
        """
        e = self.problem.residual - mean @ self.A.T
        both = np.where(self.rows == self.columns, 1.0, 2.0)
        variance = (C[:, self.rows, self.columns] * both) @ self.products.T
        return np.asarray(e**2 + np.clip(variance, 0.0, V))

    def evidence(
        self, kinds: Kinds, start: Array, signal: Callable[[Array], Array] | None = None
    ) -> SetEvidence:
        """Evidence given some error models, and those in proportion to what the causes do.

        Parameters
        ----------
        kinds : int array (n_kinds,)
            Error models, of which the latter are left out.
        start : array (..., n_groups)
            Where the noise's logarithms may be, for all or for each of them.
        signal : callable, optional
            What the causes do and the baseline cannot take up (n,), of the errors' variances (n,); that of
            the weights if absent.
        """
        common = kinds < self.family.n_kinds
        start = np.broadcast_to(start, (len(kinds), start.shape[-1]))[common]
        found = plain = self.given(kinds[common], start)
        if not self.causes and signal is None:
            return found
        for _ in range(2):  # again beside errors of that spectrum, if these are the most probable
            best = found.best(SizePriors())
            V = found.variances(best)
            change = self._signal(found.mean[best], V) if signal is None else signal(V)
            if not np.any(change):
                return plain
            beside = copy(self)
            beside.family = self.family.beside(change)
            own = beside.given(self.family.own_kinds, found.log_noise[best])
            found = plain.joined(own, self.family.relative(change))
            if found.best(SizePriors()) < len(plain.kinds):
                break
        return found

    def given(self, kinds: Kinds, start: Array, power: float = 1.0) -> SetEvidence:
        """Evidence given some error models, from where the noise's logarithms (..., n_groups) may be.

        With the likelihood to a power: p(r | w, V)^power is N(r; A w, V / power) times |V|^((1 - power) / 2)
        and a constant. The former factor is not the same for all sets, since V is found with each.
        """
        f = self.family
        noise, discrepancy = f.of(kinds)
        log_noise = np.array(np.broadcast_to(start, (len(kinds), len(f.groups))))
        ones = np.ones((len(kinds), len(self.causes)))
        active = np.arange(len(kinds))
        for _ in range(SCORING):
            own = np.exp(2.0 * log_noise[active])[:, f.member] * noise[active]
            V = own + discrepancy[active]
            gram, right = self._products(V / power)
            mean, C = self._inside(*self.solve(gram, right, ones[active]))
            q = self._left(mean, C, V / power) / V
            a = own / V
            first, second, left = (power * x @ f.one_of.T for x in (a, a**2, a * q))
            noises = AlikeCoefficients.of(
                first,
                second,
                left,
                (log_noise[active] - f.noise_centre) / NOISE_SPREAD,
                f.least_noise - log_noise[active],
            )
            step = np.clip(noises.mode() * f.noise_free, -LARGEST_STEP, LARGEST_STEP)
            log_noise[active] += step
            active = active[np.max(np.abs(step), axis=1) > CONVERGED]
            if not len(active):
                break
        own = np.exp(2.0 * log_noise)[:, f.member] * noise
        V = own + discrepancy
        gram, right = self._products(V / power)
        base = -0.5 * power * np.sum(self.problem.residual**2 / V + np.log(2.0 * math.pi * V), axis=1)
        base += self.problem.log_prior
        integral = NoiseIntegral(self, own / V, V, log_noise, power)
        free = tuple(one.free for one in self.causes)
        scales, masses = _combinations(free)
        gains = np.empty((len(kinds), len(scales)))
        own_mean = np.empty((*gains.shape, len(self.listed)))
        own_C = np.empty((*own_mean.shape, len(self.listed)))
        for alike in self._alike(scales):  # all sizes of the widest function at once
            basis = SizeBasis(self, gram, right, scales[alike])
            mass, mean, lost = basis.inside(self)
            gains[:, alike] = basis.gain + mass + integral(basis, mean, lost)
            own_mean[:, alike], own_C[:, alike] = basis.moments(np.searchsorted(self.narrow, self.listed))
        gains += masses
        log_z = base + logsumexp(gains, axis=1)
        mean, C = self._inside(*self.solve(gram, right, scales[np.argmax(gains, axis=1)]))
        amplitudes = self._amplitudes(own_mean, own_C)
        slope = power * np.sum(discrepancy / V * (self._left(mean, C, V / power) / V - 1.0), axis=1)
        mean, C = mean @ self.turn.T, self.turn @ C @ self.turn.T
        return SetEvidence(
            f,
            kinds,
            log_z,
            slope,
            log_noise,
            None,
            mean,
            C,
            free,
            gains,
            amplitudes,
            self.problem,
            tuple(self.causes),
            log_z,
        )

    def _amplitudes(self, mean: Array, C: Array) -> Amplitudes:
        n, k = len(self.problem.amplitudes), self.k
        P, low, high = self.P0.diagonal(), np.full(k, -np.inf), np.full(k, np.inf)
        if self.problem.low is not None and self.problem.high is not None:
            low, high = self.problem.low, self.problem.high
        at, causes = self.listed[:n], [one for one in self.causes if not one.free]
        return Amplitudes(
            np.concatenate([-self.pull[at] / P[at], self.mean[self.listed[n:]]]),
            np.concatenate([P[at], np.ones(len(causes))]),
            np.concatenate([low[at], [one.low for one in causes]]),
            np.concatenate([high[at], [one.high for one in causes]]),
            mean,
            C,
        )

    def _products(self, V: Array) -> tuple[Array, Array]:
        return self.grams(1.0 / V), (1.0 / V) @ self.Ar

    def grams(self, weights: Array) -> Array:
        """A' D A (..., p, p) of diagonals D (..., n)."""
        p, upper = len(self.mean), weights @ self.products
        found = np.empty((*upper.shape[:-1], p, p))
        found[..., self.rows, self.columns] = found[..., self.columns, self.rows] = upper
        return found

    def _signal(self, mean: Array, V: Array) -> Array:
        """What the causes do and the baseline's parameters cannot take up, (n,)."""
        return without(self.problem.jacobian, self.A[:, self.k :] @ (mean @ self.turn)[self.k :], V)


class SizeBasis:
    """Coordinates z in which H is diagonal for all sizes s of the widest function F at once.

    With R all else, H_RR = L L', T = L^-1 H_RF and H_FF - T'T = U lambda U' where s is infinite,

        (d, w)_R = L^-T (z_R - T U z_F),    w_F = U z_F,    H = diag(1, lambda + 1 / s^2),

    the other sizes being held.

    Parameters
    ----------
    model : SetModel
    gram, right : array (n_kinds, p, p) and (n_kinds, p)
    scales : array (n_sizes, n_causes)
        Differing in the widest function only.

    Attributes
    ----------
    gain : array (n_kinds, n_sizes)
        Of the log evidence, but for what only the error model decides.
    """

    def __init__(self, model: SetModel, gram: Array, right: Array, scales: Array) -> None:
        R, F = model.narrow, model.wide
        P, pull = model.precision(scales[0])
        H = gram[:, R[:, None], R] + P[R[:, None], R]
        size = np.sqrt(np.maximum(np.einsum("kii->ki", H), 1e-300))
        values, Q = np.linalg.eigh(H / (size[:, :, None] * size[:, None, :]))
        values = np.maximum(values, 1e-15)
        over = Q / np.sqrt(values)[:, None, :] / size[:, :, None]
        T = over.swapaxes(1, 2) @ gram[:, R[:, None], F]
        z = np.einsum("kij,ki->kj", over, right[:, R] - pull[R])
        lam, U = np.linalg.eigh(gram[:, F[:, None], F] - T.swapaxes(1, 2) @ T)
        y = np.einsum("kij,ki->kj", U, right[:, F] - np.einsum("kij,kj->ki", T.swapaxes(1, 2), z))
        s = np.ones(len(scales)) if model.widest is None else scales[:, model.widest]
        D = 1.0 / (np.maximum(lam, 0.0)[:, None, :] + 1.0 / s[:, None] ** 2)
        logdet = np.sum(np.log(values) + 2.0 * np.log(size), axis=1)[:, None] - np.log(D).sum(axis=2)
        self.rows, self.U = np.concatenate([over, -over @ (T @ U)], axis=2), U
        self.D = np.concatenate([np.ones((*D.shape[:2], len(R))), D], axis=2)
        self.mean = self.D * np.concatenate([z, y], axis=1)[:, None, :]
        self.gain = 0.5 * np.sum(self.mean**2 / self.D, axis=2)
        self.gain -= 0.5 * logdet + np.log(scales[:, model.owner]).sum(axis=1)
        self.gain += 0.5 * model.k * math.log(2.0 * math.pi) - 0.5 * float(model.mean @ model.mean)

    def moments(self, at: Kinds) -> tuple[Array, Array]:
        """Mean (n_kinds, n_sizes, q) and covariance of some of R, by their places in it."""
        rows = self.rows[:, None, at]
        C = (rows * self.D[:, :, None, :]) @ rows.swapaxes(2, 3)
        return self.mean @ self.rows[:, at].swapaxes(1, 2), C

    def inside(self, model: SetModel) -> tuple[Array, Array, Array]:
        """Log mass (n_kinds, n_sizes) inside the bounds; mean of z there, and what its variance loses."""
        at, p = np.searchsorted(model.narrow, model.bounded), len(model.mean)
        mean, C = self.moments(at)
        both = np.concatenate([self.mean, mean], axis=2)
        own = self.D[..., None] * self.rows[:, None, at].swapaxes(2, 3)
        columns = np.concatenate([own, C], axis=2)
        mass, both, lost = truncate(both, columns, p + np.arange(len(at)), model.low, model.high)
        return mass - model.prior_mass, both[..., :p], lost[..., :p, :]

    def matrix(self, model: SetModel) -> Array:
        """The coordinates (n_kinds, p, p) as columns."""
        R, F = model.narrow, model.wide
        W = np.zeros((len(self.U), len(model.mean), len(model.mean)))
        W[:, R] = self.rows
        W[:, F[:, None], np.arange(len(R), len(model.mean))] = self.U
        return W


@dataclass(frozen=True, eq=False)
class AlikeCoefficients:
    """Log likelihood of a group's noise as if all coefficients had one variance, and the noise's prior.

    When the noise's logarithm changes by t,

        log L(t) - log L(0) = -n (log v + q (1 / v - 1)) / 2,    v = 1 + m (exp(2 t) - 1),

    n the number of coefficients, m the part of their variance that is noise, q their mean square in
    variances.

    Parameters
    ----------
    n, m, q : array
    off : array
        Of t = 0 from the prior's centre, in prior sds.
    least : array
        Least t.
    """

    n: Array
    m: Array
    q: Array
    off: Array
    least: Array

    @classmethod
    def of(cls, first: Array, second: Array, left: Array, off: Array, least: Array) -> AlikeCoefficients:
        """With the slope and the information of coefficients that differ, of noise's parts a of variances V.

        Parameters
        ----------
        first, second, left : array
            n m, n m^2 and n m q: sums of a, a^2 and a r^2 / V.
        """
        first, second = (np.maximum(x, FEWEST) for x in (first, second))
        m = np.minimum(second / first, 1.0)
        return cls(first / m, m, np.maximum(left, 0.0) / first, off, least)

    def mode(self) -> Array:
        """Where the posterior of t is largest."""
        louder = 0.5 * np.log1p(np.maximum(self.q - 1.0, 0.0) / self.m)  # where v = q
        t = np.maximum(louder, self.least)
        for _ in range(SCORING):
            slope, bend, _ = self._slope(t)
            t = np.maximum(t + np.clip(slope / bend, -LARGEST_STEP, LARGEST_STEP), self.least)
        return np.asarray(t)

    def integral(self) -> Array:
        """Log of the likelihood integrated over the prior, by Gauss and Legendre around the mode."""
        t = self.mode()
        slope, _, bend = self._slope(t)
        reach = REACH / (np.sqrt(bend) + np.abs(slope))
        low = np.maximum(t - reach, self.least)
        half = 0.5 * (t + reach - low)
        points, weights = leggauss(NODES)
        nodes = (low + half)[..., None] + half[..., None] * points
        v = 1.0 + self.m[..., None] * np.expm1(2.0 * nodes)
        log = -0.5 * self.n[..., None] * (np.log(v) + self.q[..., None] * (1.0 / v - 1.0))
        log -= 0.5 * (self.off[..., None] + nodes / NOISE_SPREAD) ** 2
        scale = half / (NOISE_SPREAD * math.sqrt(2.0 * math.pi))
        return np.asarray(logsumexp(log, b=weights, axis=-1) + np.log(scale))

    def _slope(self, t: Array) -> tuple[Array, Array, Array]:
        """Slope of the log posterior, its bend for a step that does not overshoot, and as it is."""
        v = 1.0 + self.m * np.expm1(2.0 * t)
        a, q = self.m * np.exp(2.0 * t) / v, self.q / v
        slope, fisher, least = self.n * a * (q - 1.0), 2.0 * self.n * a**2, NOISE_SPREAD**-2
        bend = fisher * q - 2.0 * (1.0 - a) * slope + least
        whole = slope - (self.off + t / NOISE_SPREAD) / NOISE_SPREAD
        return whole, np.maximum(fisher, 2.0 * np.abs(slope)) + least, np.maximum(bend, 0.25 * least)


class NoiseIntegral:
    """The integral over the noise's logarithms, each from where it was held.

    With a the noise's part of V, D = diag(a / V) in a group, w ~ N(mean, C), the likelihood to a power c and
    G = c A'DA, the weights take up tr CG of the sum of c a, and tr CGCG of that of c a^2. What one group's
    noise does to another's is left out.

    Parameters
    ----------
    model : SetModel
    a, V : array (n_kinds, n)
        Noise's part of the variances, and these.
    log_noise : array (n_kinds, n_groups)
    power : float
        Of the likelihood.
    """

    def __init__(self, model: SetModel, a: Array, V: Array, log_noise: Array, power: float = 1.0) -> None:
        f = model.family
        self.model = model
        self.least = (f.least_noise - log_noise)[:, f.noise_free, None]
        self.off = (log_noise - f.noise_centre)[:, f.noise_free, None] / NOISE_SPREAD
        one_of = f.one_of[f.noise_free]
        D = power * (a / V)[:, None, :] * one_of
        self.gram = model.grams(D)
        self.right, self.squares = D @ model.Ar, (D @ model.problem.residual**2)[:, :, None]
        self.first, self.second = ((power * x @ one_of.T)[:, :, None] for x in (a, a**2))

    def __call__(self, basis: SizeBasis, mean: Array, lost: Array) -> Array:
        """Log of the integral (n_kinds, n_sizes), given the weights' posterior inside their bounds."""
        W = basis.matrix(self.model)[:, None]
        gram = W.swapaxes(2, 3) @ self.gram @ W
        right = (self.right[:, :, None, :] @ W)[:, :, 0]
        D, mean = basis.D.swapaxes(1, 2), mean.swapaxes(1, 2)
        left = np.sum(gram @ mean[:, None] * mean[:, None], axis=2) - 2.0 * right @ mean + self.squares
        first = self.first - np.einsum("kgii->kgi", gram) @ D
        second = self.second - np.sum(gram**2 @ D[:, None] * D[:, None], axis=2)
        if lost.shape[-1]:
            lost = lost[:, None]
            turned = gram[:, :, None] @ lost
            own = lost.swapaxes(-1, -2) @ turned
            first = first + np.einsum("...ii->...", own)
            second = second + 2.0 * np.sum(turned**2 * basis.D[:, None, :, :, None], axis=(-2, -1))
            second = second - np.sum(own**2, axis=(-2, -1))
        alike = AlikeCoefficients.of(first, second, left, self.off, self.least)
        return np.asarray(alike.integral().sum(axis=1))


def without(jacobian: Array, signal: Array, V: Array) -> Array:
    """What parameters cannot take up of a signal (n,), given errors of variance V."""
    J = jacobian / V[:, None]
    return np.asarray(signal - jacobian @ np.linalg.lstsq(J.T @ jacobian, J.T @ signal, rcond=None)[0])
