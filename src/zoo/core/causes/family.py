"""Errors of a record: white or correlated noise, and a discrepancy that belongs to no component.

The variance of coefficient i, of the series of a group g, is

    V_i = sigma_g^2 (1 + ratio^2 g_i(tau_c)) + delta^2 range_g^2 lambda_i h_i(nu, length).

g is the spectrum of an Ornstein-Uhlenbeck process, h a Matern one, h ~ (1 + (omega length)^2)^-(nu + 1/2),
both of mean 1; lambda = 1 + (n - 1) rho for the mean of a group's n series, 1 - rho for their differences.
Beside causes lambda h may be the power of what these do instead, harmonic by harmonic.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr

from zoo.core.errors.spectral import LEAST_NOISE, Spectral

Array = NDArray[np.float64]

EXPONENTS = (0.5, 1.5, 2.5)
"""Exponents nu of the Matern spectra: from rough to smooth, alike beforehand."""
LENGTHS, LENGTH = (0.01, 0.02, 0.04, 0.08, 0.16), (0.05, 1.0)
"""Lengths in parts of the record; median and sd of the logarithm of their log-normal prior."""
SHARED = (0.0, 0.5, 0.9)
"""Correlations between the series of a group, alike beforehand."""
SIZES: Array = 4e-5 * 2.5 ** np.arange(11.0)
"""Sizes, in parts of a group's range, at which the evidence and its slope are computed."""
NUMERICS = 1e-3
"""Scale of the half-normal error of a simulator's numerics, in parts of a group's range."""
UNEXPLAINED, UNEXPLAINED_ODDS = 0.05, 0.1
"""Scale of the half-normal size of what nobody can name, and the odds that there is such."""
CARICATURE = 0.1
"""Scale of the half-normal model error of a cause (of its response), in parts of its signal."""
IN_PROPORTION = 0.5
"""Prior probability that the model error of causes has the spectrum of what these do."""
COLOURED = 0.5
"""Prior probability that noise is correlated."""
RATIOS, TIMES = (0.25, 0.5, 1.0, 2.0, 4.0), (0.012, 0.03, 0.075)
"""Correlated over white noise, half-normal of scale 1; its correlation time in parts of the record."""
TIME = (0.03, 0.5)
"""Median and sd of the logarithm of the correlation time."""
NOISE_SPREAD = 2.0
"""Sd of the logarithm of the white noise beforehand, around `NOISE` of a group's range."""
NOISE = 0.01
FINE = 24
"""Points between two sizes at which the evidence is interpolated."""


def half_normal_mass(edges: Array, scale: float) -> Array:
    """Mass of a half-normal distribution between the edges (m,), (m - 1,)."""
    return np.asarray(2.0 * np.diff(ndtr(edges / scale)))


@dataclass(frozen=True, eq=False)
class ErrorFamily:
    """All errors that are integrated over, bound to a record.

    Parameters
    ----------
    errors : Spectral
        Bound to the data.
    ranges : mapping of group to float
        In whose parts sizes are told.
    """

    errors: Spectral
    ranges: Mapping[str, float]
    known: Mapping[str, float] = field(default_factory=dict)
    own: Array | None = field(init=False, default=None, repr=False)
    """Variances (n,) of a discrepancy of size 1 in proportion to what causes do, one spectrum more."""

    def beside(self, signal: Array) -> ErrorFamily:
        """The same beside causes that change the coefficients by a signal (n,)."""
        errors, found = self.errors, np.empty_like(signal)
        harmonic = np.rint(np.asarray(errors.omega) * errors.on.duration / (2.0 * math.pi)).astype(int)
        harmonic = np.broadcast_to(harmonic, errors.there.shape)[errors.there]
        # the mean of a group's series, and their differences together
        part = 2 * self.member + errors.leading[errors.there]
        for at in (np.flatnonzero(part == one) for one in np.unique(part)):
            per = 1.0 / np.maximum(np.bincount(harmonic[at]), 1)
            found[at] = (np.bincount(harmonic[at], signal[at] ** 2) * per)[harmonic[at]]
        made = copy(self)  # with all that is computed already
        object.__setattr__(made, "own", found / self.relative(signal) ** 2)
        return made

    @cached_property
    def groups(self) -> tuple[str, ...]:
        """Names, in the order of `member`."""
        return tuple(self.ranges)

    @cached_property
    def member(self) -> NDArray[np.int_]:
        """Index of the group of each coefficient, (n,)."""
        found = np.empty((self.errors.on.n_series, self.errors.n), int)
        for index, group in enumerate(self.groups):
            found[self.errors.rows[group]] = index
        return found[self.errors.there]

    @cached_property
    def one_of(self) -> Array:
        """1 where a coefficient is of a group, (n_groups, n)."""
        return np.asarray(self.member[None, :] == np.arange(len(self.groups))[:, None], float)

    @cached_property
    def shapes(self) -> tuple[tuple[float, float, float], ...]:
        """Exponent, length in parts of the record, and correlation between series of each discrepancy."""
        alone = all(len(rows) == 1 for rows in self.errors.rows.values())
        return tuple(product(EXPONENTS, LENGTHS, (0.0,) if alone else SHARED))

    @cached_property
    def log_shapes(self) -> Array:
        """Log prior of each spectrum but that in proportion to causes."""
        log = np.array(
            [-0.5 * (math.log(length / LENGTH[0]) / LENGTH[1]) ** 2 for _, length, _ in self.shapes]
        )
        return np.asarray(log - logsumexp(log))

    @cached_property
    def discrepancies(self) -> Array:
        """Variances (n_shapes, n) of a discrepancy of size 1."""
        omega, T = np.asarray(self.errors.omega), self.errors.on.duration
        found = np.empty((len(self.shapes), self.errors.on.n_series, self.errors.n))
        for i, (exponent, length, rho) in enumerate(self.shapes):
            h = (1.0 + (omega * length * T) ** 2) ** -(exponent + 0.5)
            for group, rows in self.errors.rows.items():
                found[i, rows] = self.ranges[group] ** 2 * self.errors.process(h, group, rho)
        return found[:, self.errors.there]

    @cached_property
    def colours(self) -> tuple[tuple[float, float], ...]:
        """Ratio and correlation time of each correlated noise."""
        return tuple(product(RATIOS, TIMES))

    @cached_property
    def log_colours(self) -> Array:
        """Log prior of each."""
        edges = np.concatenate([[0.0], np.sqrt(np.multiply(RATIOS[1:], RATIOS[:-1])), [np.inf]])
        ratio = np.log(half_normal_mass(edges, 1.0))
        time = np.array([-0.5 * (math.log(t / TIME[0]) / TIME[1]) ** 2 for t in TIMES])
        return np.asarray((ratio[:, None] + time - logsumexp(time)).reshape(-1))

    def discrepancy(self, shape: int) -> Array:
        """Variances (n,) of a discrepancy of size 1 and one spectrum."""
        return self.discrepancies[shape] if self.own is None or shape < len(self.shapes) else self.own

    @cached_property
    def _noises(self) -> Array:
        """Variances (n_noises, n) of white noise and of each correlated one, in those of the white noise."""
        omega, T = np.asarray(self.errors.omega), self.errors.on.duration
        found = np.ones((1 + len(self.colours), *self.errors.there.shape))
        for i, (ratio, t) in enumerate(self.colours, 1):
            for group, rows in self.errors.rows.items():
                found[i, rows] += ratio**2 * self.errors.process(1.0 / (1.0 + (omega * t * T) ** 2), group)
        return found[:, self.errors.there]

    def of(self, kinds: NDArray[np.int_]) -> tuple[Array, Array]:
        """Error models by their indices: white noise, each correlated one, each spectrum at each size.

        Returns
        -------
        noise : array (m, n)
            Variance in that of the white noise.
        discrepancy : array (m, n)
            Variance of the discrepancy.
        """
        noise, discrepancy = np.ones((2, len(kinds), self.errors.size))
        for i, kind in enumerate(kinds):
            shape, size = divmod(kind - len(self._noises), len(SIZES))
            if shape < 0:
                noise[i], discrepancy[i] = self._noises[kind], 0.0
            else:
                discrepancy[i] = SIZES[size] ** 2 * self.discrepancy(shape)
        return noise, discrepancy

    @property
    def n_kinds(self) -> int:
        """How many beside no cause."""
        return 1 + len(self.colours) + len(self.shapes) * len(SIZES)

    @property
    def own_kinds(self) -> NDArray[np.int_]:
        """Indices of the error models in proportion to what causes do, whose spectrum is the last."""
        return np.asarray(self.n_kinds + np.arange(len(SIZES)))

    def kinds_of(self, shapes: NDArray[np.int_]) -> NDArray[np.int_]:
        """Indices of the error models of some spectra, with all that are noise alone."""
        first = 1 + len(self.colours)
        after = first + shapes[:, None] * len(SIZES) + np.arange(len(SIZES))
        return np.concatenate([np.arange(first), after.reshape(-1)])

    # -- priors of noise and size ------------------------------------------------------------------

    @cached_property
    def noise_centre(self) -> Array:
        """Median (n_groups,) of the logarithm of the white noise, beforehand."""
        return np.log([NOISE * self.ranges[g] for g in self.groups])

    @cached_property
    def noise_free(self) -> NDArray[np.bool_]:
        """Whether the noise of each group is to be found, (n_groups,)."""
        return np.array([g not in self.known for g in self.groups])

    @cached_property
    def least_noise(self) -> Array:
        """Logarithm (n_groups,) of the noise below which none is found; a known one is kept."""
        return np.log([min(LEAST_NOISE * self.ranges[g], self.known.get(g, np.inf)) for g in self.groups])

    @cached_property
    def noise_start(self) -> Array:
        """Logarithms (n_groups,) of the known noise, or of what the finest coefficients have."""
        values = self.errors.flat(self.errors.on.values)
        found = []
        for g in self.groups:
            fine = float(np.sqrt(np.mean(self.errors.fine(values, g) ** 2)))
            found.append(math.log(self.known.get(g, max(fine, LEAST_NOISE * self.ranges[g]))))
        return np.array(found)

    @cached_property
    def grid(self) -> tuple[Array, Array]:
        """Logarithms of the sizes at which evidence is integrated, and the edges of their cells."""
        first = math.log(SIZES[0]) - 1.5
        points = np.concatenate([[first], np.log(SIZES)])
        x = np.concatenate([np.linspace(a, b, FINE, endpoint=False) for a, b in pairwise(points)])
        x = np.append(x, points[-1])
        edges = np.concatenate([[-np.inf], 0.5 * (x[1:] + x[:-1]), [np.inf]])
        return x, np.exp(edges)

    def log_sizes(self, scales: Mapping[float, float]) -> Array:
        """Log prior mass of each cell of the grid, for a mixture of half-normals: scale -> weight."""
        mass = sum(weight * half_normal_mass(self.grid[1], scale) for scale, weight in scales.items())
        return np.log(np.maximum(mass, 1e-300))

    def relative(self, signal: Array) -> float:
        """Rms of coefficients (n,) in parts of their groups' ranges."""
        ranges = np.array([self.ranges[g] for g in self.groups])[self.member]
        return float(np.sqrt(np.mean((signal / ranges) ** 2)))
