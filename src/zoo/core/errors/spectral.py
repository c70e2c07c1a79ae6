"""Errors described in coefficients that are independent: harmonics of periodic series, cosines of others.

What is added to the series is taken as stationary: noise, and a smooth discrepancy. Its covariance is then
diagonal in the coefficients, so that likelihoods, whitening and the marginal likelihood of a linearised model
cost a sum over them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations_with_replacement, pairwise
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import dct, idct
from scipy.linalg import helmert

from zoo.core.arrays import Array, real_number
from zoo.core.data import Data
from zoo.core.errors.base import DIMS, ErrorModel, ErrorModelError
from zoo.core.parameters import LogNormal, Normal, Parameter, Prior, variable_name
from zoo.core.words import nearest

SMALLEST_SERIES = 8
FINE = 0.6
"""Part of the largest frequency above which a residual is taken for noise alone."""
LEAST_NOISE = 1e-5
"""Noise in parts of a group's range below which none is fitted: series are not told more exactly."""


@dataclass(frozen=True)
class GroupErrors:
    """Noise and discrepancy of the series of one group, in its unit.

    S_k = sigma^2 (1 + ratio^2 g_k(tau)) + delta^2 lambda h_k(length): g the spectrum of an Ornstein-Uhlenbeck
    process, h that of a squared-exponential one (or of another Ornstein-Uhlenbeck one, if `rough`), all with
    mean 1 over the coefficients; lambda = 1 + (n - 1) shared for the mean of n series, 1 - shared for their
    differences.

    Parameters
    ----------
    sigma : float
        Sd of the white noise.
    ratio : float
        Sd of the correlated noise, over sigma.
    tau : float
        Its correlation time, in the data's unit of time.
    delta : float
        Sd of the discrepancy.
    length : float
        Its length scale, in the data's unit of time.
    shared : float
        Its correlation between series.
    rough : bool
        Whether it is an Ornstein-Uhlenbeck process.
    """

    sigma: float
    ratio: float = 0.0
    tau: float = 0.003
    delta: float = 0.0
    length: float = 0.005
    shared: float = 0.0
    rough: bool = False

    @property
    def noise(self) -> float:
        """Sd of white and correlated noise together."""
        return self.sigma * math.hypot(1.0, self.ratio)


@dataclass(frozen=True)
class GroupPriors:
    """Priors of one group's errors, for sampling: the white noise and the allowance of a hypothesis."""

    sigma: Prior
    delta: Prior


@dataclass(frozen=True)
class Spectral(ErrorModel):
    """Stationary errors that are independent in the coefficients of an orthonormal transform of each series.

    Series of one group are rotated so that the first stands for their mean. Times are in parts of the data's
    duration T, a period or the whole record.

    Parameters
    ----------
    largest_ratio : float
        Upper limit, and scale of the half-normal prior, of (sd of the correlated noise)/(sd of the white
        noise): what sensors and averaging leave correlated is no larger than what they leave white. Without a
        limit noise takes the place of a discrepancy.
    correlation_time : (median, spread, limit)
        Prior of the noise's correlation time: median in parts of T, sd of the logarithm, and upper limit.
        Noise forgets within a few per cent of T; what lasts longer than a tenth of it is a discrepancy.
    length : (median, spread)
        Prior of the discrepancy's length scale: median in parts of T, sd of the logarithm. A discrepancy
        follows the features of the series, which last some twentieth of a period.
    shared : tuple of float
        Correlations between series of a discrepancy that are tried: what is wrong in one part of a simulator
        is wrong in its neighbours too, but the baseline's parameters may have taken the common part away.
    priors : mapping of group to GroupPriors
        For sampling; without them the noise is log-normal around a hundredth of the series' range.
    known : mapping of group to float
        Sd of the white noise where a data sheet gives it, in the group's unit; elsewhere it is fitted.
    """

    largest_ratio: float = 1.0
    correlation_time: tuple[float, float, float] = (0.03, 0.5, 0.1)
    length: tuple[float, float] = (0.05, 0.5)
    shared: tuple[float, ...] = (0.0, 0.4, 0.7, 0.9)
    priors: Mapping[str, GroupPriors] = field(default_factory=dict)
    known: Mapping[str, float] = field(default_factory=dict)

    def bind(self, data: Data) -> Self:
        """The same for given data.

        Raises
        ------
        ErrorModelError
            If there are no series, or fewer than eight samples; if a known sd is of no group or not positive.
        """
        for group, sd in self.known.items():
            if group not in data.groups:
                raise ErrorModelError(f"noise of {group!r}: {nearest(group, list(data.rows))}")
            real_number(f"noise of {group}", sd, "a positive number", above=0.0, error=ErrorModelError)
        least = min(data.measured.sum(axis=1), default=0)
        if not data.n_series or least < SMALLEST_SERIES:
            raise ErrorModelError(
                f"{data.source or data.name}: {data.name!r} has {data.n_series} series of {least} "
                f"samples: give at least one series of {SMALLEST_SERIES} samples"
            )
        if not (data.even or self.uneven):
            raise ErrorModelError(
                f"{data.source or data.name}: {self.name} are of times in equal steps, these are not; use "
                "Uneven()"
            )
        return replace(self, data=data)

    uneven: ClassVar[bool] = False
    """Whether times may be in unequal steps."""

    # -- the transform ----------------------------------------------------------------------------

    def _forward(self, series: Array) -> Array:
        raise NotImplementedError

    def _backward(self, coefficients: Array) -> Array:
        raise NotImplementedError

    @cached_property
    def omega(self) -> Array:
        """Angular frequency of each coefficient of a series, (n_times,), in 1/time."""
        raise NotImplementedError

    @cached_property
    def k(self) -> NDArray[np.int_]:
        """Number of each coefficient's harmonic or cosine, (n_times,)."""
        raise NotImplementedError

    @property
    def n(self) -> int:
        """Coefficients of each series at most."""
        return self.on.n_times

    @property
    def size(self) -> int:
        """Coefficients of all series."""
        return int(self.counts.sum())

    @cached_property
    def counts(self) -> NDArray[np.int_]:
        """Coefficients of each series, (n_series,)."""
        return np.full(self.on.n_series, self.n)

    @cached_property
    def there(self) -> NDArray[np.bool_]:
        """Which coefficients there are, (n_series, n_times)."""
        return np.asarray(np.arange(self.n) < self.counts[:, None])

    @cached_property
    def leading(self) -> NDArray[np.bool_]:
        """Which coefficients are of the mean of a group's series, (n_series, n_times)."""
        found = np.zeros(self.there.shape, bool)
        found[[rows[0] for rows in self.rows.values()]] = True
        return found

    @cached_property
    def rows(self) -> dict[str, list[int]]:
        """Indices of the series of each group."""
        return self.on.rows

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups."""
        return tuple(self.rows)

    @cached_property
    def _rotation(self) -> Array:
        rotation = np.eye(self.on.n_series)
        for group in self.rows.values():
            rotation[np.ix_(group, group)] = helmert(len(group), full=True)
        return rotation

    def transform(self, series: Array) -> Array:
        """Coefficients (..., n_series, n_times) of series (..., n_series, n_times)."""
        return np.asarray(np.einsum("ij,...jk->...ik", self._rotation, self._forward(series)))

    def inverse(self, coefficients: Array) -> Array:
        """Series (..., n_series, n_times) of coefficients (..., n_series, n_times)."""
        return self._backward(np.einsum("ji,...jk->...ik", self._rotation, coefficients))

    def flat(self, series: Array) -> Array:
        """Coefficients that there are as one vector, (..., n)."""
        return self.transform(series)[..., self.there]

    def unflat(self, coefficients: Array) -> Array:
        """Series (..., n_series, n_times) of flat coefficients (..., n)."""
        values = np.zeros((*np.shape(coefficients)[:-1], *self.there.shape))
        values[..., self.there] = coefficients
        return self.inverse(values)

    def part(self, coefficients: Array, *groups: str) -> Array:
        """Coefficients (..., m) of one group or several, of flat ones."""
        own = np.zeros(self.there.shape, bool)
        own[[i for group in groups for i in self.rows[group]]] = True
        return np.asarray(coefficients[..., own[self.there]])

    # -- spectra ----------------------------------------------------------------------------------

    def diagonal(self, spectrum: Any) -> Any:
        """Variances (n_times,) of the coefficients of a process with this spectrum at their frequencies."""
        return spectrum

    def rough(self, tau: Any) -> Any:
        """Spectrum (n_times,), of mean 1, of an Ornstein-Uhlenbeck process; of a number or a tensor."""
        f = self.diagonal(1.0 / (1.0 + (self.omega * tau) ** 2))
        return f / f.mean()

    def smooth(self, length: float) -> Array:
        """The same of a squared-exponential process."""
        f: Array = self.diagonal(np.exp(-0.5 * (self.omega * length) ** 2))
        return np.asarray(f / f.mean())

    def process(self, spectrum: Array, group: str, shared: float = 0.0) -> Array:
        """Variances (n_series of the group, n_times) of a process of sd 1, its correlation between series."""
        n, h = len(self.rows[group]), self.diagonal(spectrum)
        share = np.full(n, 1.0 - shared)
        share[0] += n * shared
        return np.outer(share, h / h.mean())

    def spectrum(self, errors: GroupErrors, group: str, *, noise: bool = True) -> Array:
        """Variances (n_series, n_times) of the coefficients of one group's series."""
        S = np.zeros((len(self.rows[group]), self.n))
        if noise:
            rough = 1.0 / (1.0 + (self.omega * errors.tau) ** 2)
            S += errors.sigma**2 * (1.0 + errors.ratio**2 * self.process(rough, group))
        if errors.delta > 0.0:
            at = self.omega * errors.length
            h = 1.0 / (1.0 + at**2) if errors.rough else np.exp(-0.5 * at**2)
            S += errors.delta**2 * self.process(h, group, errors.shared)
        return S

    def variances(self, errors: Mapping[str, GroupErrors], *, noise: bool = True) -> Array:
        """Variances of all coefficients that there are, (n,)."""
        S = np.empty((self.on.n_series, self.n))
        for group, rows in self.rows.items():
            S[rows] = self.spectrum(errors[group], group, noise=noise)
        return S[self.there]

    # -- scales -----------------------------------------------------------------------------------

    @property
    def typical_length(self) -> float:
        """Median of the discrepancy's length scale, in the data's unit of time."""
        return self.length[0] * self.on.duration

    def fine(self, residual: Array, group: str) -> Array:
        """Coefficients (m,) of one group's residual whose frequencies are those of noise alone."""
        fine = self.k > FINE * self.k[self.counts - 1][:, None]
        fine[[i for other, rows in self.rows.items() if other != group for i in rows]] = False
        return np.asarray(residual[fine[self.there]])

    # -- the error model --------------------------------------------------------------------------

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """For each group sigma where it is not known, ratio, tau, and delta where its prior is given."""
        median, spread, top = self.correlation_time
        T, found = self.on.duration, []
        for group, rows in self.rows.items():
            unit, given = self.on.unit(group), self.priors.get(group)
            typical = 0.01 * float(np.ptp(np.concatenate([self.on.samples(i) for i in rows]))) or 1.0
            sigma = given.sigma if given else LogNormal(typical, 2.0)
            if group not in self.known:
                found.append(Parameter(f"sigma_{group}", sigma, unit, log=True))
            ratio = Normal(0.0, self.largest_ratio, 0.0, self.largest_ratio)
            found.append(Parameter(f"ratio_{group}", ratio, start=0.5 * self.largest_ratio))
            tau = LogNormal(median * T, spread, 1e-3 * T, top * T)
            found.append(Parameter(f"tau_{group}", tau, self.on.time_unit, log=True))
            if given:
                found.append(Parameter(f"delta_{group}", given.delta, unit))
        return tuple(found)

    def _sigma(self, values: Mapping[str, Any], group: str) -> Any:
        """Sd of one group's white noise: known, or among the values."""
        return self.known[group] if group in self.known else values[f"sigma_{group}"]

    def _at(self, values: Mapping[str, ArrayLike]) -> Array:
        """Variances (n_series, n_times) of the coefficients at parameters."""
        errors = {}
        for group in self.groups:
            ratio, tau = (float(np.asarray(values[f"{n}_{group}"])) for n in ("ratio", "tau"))
            sigma = float(np.asarray(self._sigma(values, group)))
            delta = float(np.asarray(values.get(f"delta_{group}", 0.0)))
            errors[group] = GroupErrors(sigma, ratio, tau, delta, self.typical_length)
        S = np.ones(self.there.shape)
        S[self.there] = self.variances(errors)
        return S

    @property
    def _basis(self) -> Array:
        """Matrix (n_times, n_times) of the transform of one series: coefficients are basis @ series."""
        return np.asarray(self._forward(np.eye(self.n)).T)

    def variance(self, values: Mapping[str, ArrayLike]) -> Array:
        """Marginal variance (n_series, n_times) of the errors at each time."""
        S = self._at(values) @ self._basis**2  # in rotated series
        return np.asarray(np.einsum("ji,jk->ik", self._rotation**2, S))

    def whiten(self, residuals: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """Coefficients over their standard deviations."""
        return np.asarray(self.transform(residuals) / np.sqrt(self._at(values)))

    def unwhiten(self, z: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """Series whose coefficients are z standard deviations."""
        return self.inverse(z * np.sqrt(self._at(values)))

    def terms(
        self, residual: Array, values: Mapping[str, ArrayLike], decomposition: str = "sequential"
    ) -> Array:
        """A term for each coefficient: given the parameters they are independent, in every decomposition."""
        S = self._at(values)
        return np.asarray(-0.5 * (self.transform(residual) ** 2 / S + np.log(2.0 * math.pi * S)) * self.there)

    def observe(
        self, name: str, mean: Any, ok: Any, variables: Mapping[str, Any], dims: Sequence[str] = DIMS
    ) -> Any:
        """Observe the data's coefficients: independent normal around those of the mean."""
        import pytensor.tensor as pt

        from zoo.core.errors.variables import IidErrors

        S = pt.zeros((self.on.n_series, self.n))
        for group, rows in self.rows.items():
            sigma, ratio, tau = (
                self._sigma(variables, group),
                *(variables[f"{n}_{group}"] for n in ("ratio", "tau")),
            )
            row = sigma**2 * (1.0 + ratio**2 * self.rough(tau))
            if f"delta_{group}" in variables:
                row = row + variables[f"delta_{group}"] ** 2 * self.smooth(self.typical_length)
            S = pt.set_subtensor(S[rows], row[None, :])
        coefficients = pt.dot(self._rotation, pt.dot(mean, self._basis.T))
        return IidErrors(name, coefficients, ok, S, observed=self.transform(self.on.values))

    def suggested(self, errors: Mapping[str, GroupErrors]) -> dict[str, float]:
        """Values of the sampled parameters at a fit's errors, moved inside their bounds."""
        T, found = self.on.duration, {}
        for group, e in errors.items():
            if group not in self.known:
                found[f"sigma_{group}"] = e.sigma
            found[f"ratio_{group}"] = min(max(e.ratio, 0.05 * self.largest_ratio), 0.95 * self.largest_ratio)
            median, _, limit = (T * part for part in self.correlation_time)
            found[f"tau_{group}"] = min(max(e.tau, median), 0.95 * limit)  # in any unit of time
            if group in self.priors:
                found[f"delta_{group}"] = max(e.delta, 0.1 * getattr(self.priors[group].delta, "sd", e.delta))
        return {variable_name(name): value for name, value in found.items()}


@dataclass(frozen=True)
class Harmonics(Spectral):
    """Errors of periodic series in the harmonics of the period.

    The coefficients are the orthonormal real Fourier transform over one period: mean, cosines, sines.
    """

    @property
    def name(self) -> str:
        """Its name, "harmonics"."""
        return "harmonics"

    def bind(self, data: Data) -> Self:
        """The same for given data.

        Raises
        ------
        ErrorModelError
            If they are not periodic, or too few.
        """
        if data.period is None:
            raise ErrorModelError(
                f"{data.source or data.name}: not periodic (period is None); use Cosines() or give it"
            )
        return super().bind(data)

    @cached_property
    def _weight(self) -> Array:
        m = self.n // 2 + 1
        weight = np.full(m, math.sqrt(2.0))
        weight[0] = 1.0
        if self.n % 2 == 0:
            weight[-1] = 1.0
        return weight

    @cached_property
    def _imaginary(self) -> NDArray[np.bool_]:
        imaginary = np.ones(self.n // 2 + 1, bool)
        imaginary[0] = False
        if self.n % 2 == 0:
            imaginary[-1] = False
        return imaginary

    @cached_property
    def k(self) -> NDArray[np.int_]:
        """Harmonic of each coefficient, (n_times,)."""
        m = np.arange(self.n // 2 + 1)
        return np.concatenate([m, m[self._imaginary]])

    @cached_property
    def omega(self) -> Array:
        """2 pi k / period."""
        return np.asarray(2.0 * math.pi * self.k / self.on.duration)

    def _forward(self, series: Array) -> Array:
        c = np.fft.rfft(series, norm="ortho") * self._weight
        return np.concatenate([c.real, c.imag[..., self._imaginary]], axis=-1)

    def _backward(self, coefficients: Array) -> Array:
        m = self.n // 2 + 1
        c = coefficients[..., :m].astype(complex)
        c[..., self._imaginary] += 1j * coefficients[..., m:]
        return np.asarray(np.fft.irfft(c / self._weight, n=self.n, norm="ortho"))


@dataclass(frozen=True)
class Cosines(Spectral):
    """Errors of series that are not periodic, in the cosines of the record.

    The coefficients are the orthonormal discrete cosine transform (of the second kind) of the whole record,
    which stands for its even extension: unlike a Fourier transform it sees no jump between its ends.
    """

    @property
    def name(self) -> str:
        """Its name, "cosines"."""
        return "cosines"

    @cached_property
    def k(self) -> NDArray[np.int_]:
        """Number of each cosine, (n_times,); cosine k has k half periods in the record."""
        return np.arange(self.n)

    @cached_property
    def omega(self) -> Array:
        """pi k / duration."""
        return np.asarray(math.pi * self.k / self.on.duration)

    def _forward(self, series: Array) -> Array:
        return np.asarray(dct(series, type=2, norm="ortho", axis=-1))

    def _backward(self, coefficients: Array) -> Array:
        return np.asarray(idct(coefficients, type=2, norm="ortho", axis=-1))


@dataclass(frozen=True)
class Uneven(Spectral):
    """Errors of series whose times are in unequal steps, as where samples are missing or clocks differ.

    The coefficients of a series are those of an orthonormal basis Q of its own samples, made of the harmonics
    of the period or the cosines of the record, B at its own times, from slow to fast: B = Q R. Those of one
    number are rotated among the series of a group that have it, the first in proportion to the root of their
    numbers of samples, which is what a process that they share does. White noise is white in them. A process
    with the spectrum h and the correlation rho between series i and j has, G = Q'B, the variances

        sum_ij U_ri U_rj (rho + (1 - rho) [i = j]) diag(G_i diag(h) G_j')

    in the rotation U; what it has besides these is left out, which is little where few samples are missing.
    """

    uneven: ClassVar[bool] = True

    @property
    def name(self) -> str:
        """Its name, "uneven"."""
        return "uneven"

    @cached_property
    def k(self) -> NDArray[np.int_]:
        """Number of each coefficient's harmonic or cosine, (n_times,)."""
        return np.arange(self.n) if self.on.period is None else (np.arange(self.n) + 1) // 2

    @cached_property
    def omega(self) -> Array:
        """pi k / duration, or 2 pi k / period."""
        half = 1.0 if self.on.period is None else 2.0
        return np.asarray(half * math.pi * self.k / self.on.duration)

    @cached_property
    def counts(self) -> NDArray[np.int_]:
        """Coefficients of each series: its samples, (n_series,)."""
        return np.asarray(self.on.measured.sum(axis=1))

    @cached_property
    def _clocks(self) -> tuple[NDArray[np.bool_], NDArray[np.int_]]:
        """Times at which some series was measured, one row for all series alike, and each series' row."""
        clocks, own = np.unique(self.on.measured, axis=0, return_inverse=True)
        return clocks, own.reshape(-1)

    def _functions(self, at: NDArray[np.bool_]) -> Array:
        """B: each column a harmonic or a cosine at the measured times."""
        n, T = int(at.sum()), self.on.duration
        t = self.on.times[at] - self.on.times[0]
        if self.on.period is None:
            t = t + 0.5 * T / self.on.n_times
        phase = np.outer(t, self.omega[:n])
        sines = (self.on.period is not None) & (np.arange(n) % 2 == 0)
        found = np.where(sines, np.sin(phase), np.cos(phase)) * math.sqrt(2.0 / n)
        found[:, 0] = 1.0 / math.sqrt(n)
        if self.on.period is not None and n % 2 == 0:  # what alternates
            found[:, -1] /= math.sqrt(2.0)
        return np.asarray(found)

    @cached_property
    def _bases(self) -> list[tuple[Array, Array]]:
        """Q and G = Q'B of each clock."""
        found = []
        for at in self._clocks[0]:
            functions = self._functions(at)
            q, r = np.linalg.qr(functions)
            q = q * np.where(np.diag(r) < 0.0, -1.0, 1.0)
            found.append((q, q.T @ functions))
        return found

    @cached_property
    def _turns(self) -> list[tuple[list[int], slice, Array]]:
        """Series of a group that have some coefficients, which these are, and their rotation."""
        found = []
        for group in self.rows.values():
            edges = [0, *np.unique(self.counts[group]).tolist()]
            for first, last in pairwise(edges):
                rows = [i for i in group if self.counts[i] >= last]
                found.append((rows, slice(first, last), weighted_helmert(np.sqrt(self.counts[rows]))))
        return found

    @cached_property
    def leading(self) -> NDArray[np.bool_]:
        """Which coefficients are of the mean of a group's series, (n_series, n_times)."""
        found = np.zeros(self.there.shape, bool)
        for rows, part, _ in self._turns:
            found[rows[0], part] = True
        return found

    def transform(self, series: Array) -> Array:
        """Coefficients (..., n_series, n_times) of series (..., n_series, n_times), 0 where there is none."""
        found = np.zeros(np.shape(series))
        for i, (count, clock) in enumerate(zip(self.counts, self._clocks[1], strict=True)):
            found[..., i, :count] = series[..., i, self.on.measured[i]] @ self._bases[clock][0]
        for rows, part, turn in self._turns:
            found[..., rows, part] = np.einsum("ij,...jk->...ik", turn, found[..., rows, part])
        return found

    def inverse(self, coefficients: Array) -> Array:
        """Series (..., n_series, n_times) of coefficients of that shape, NaN where not measured."""
        own, found = np.array(coefficients, dtype=np.float64), np.full(np.shape(coefficients), np.nan)
        for rows, part, turn in self._turns:
            own[..., rows, part] = np.einsum("ji,...jk->...ik", turn, own[..., rows, part])
        for i, (count, clock) in enumerate(zip(self.counts, self._clocks[1], strict=True)):
            found[..., i, self.on.measured[i]] = own[..., i, :count] @ self._bases[clock][0].T
        return found

    @cached_property
    def _mixing(self) -> dict[tuple[int, int], Array]:
        """G_i G_j, element by element, of each pair of clocks of one group."""
        own = [g for _, g in self._bases]
        pairs = {pair for rows in self.rows.values() for pair in self._pairs(rows)}
        least = {(i, j): min(len(own[i]), len(own[j])) for i, j in pairs}
        return {(i, j): own[i][:m, :m] * own[j][:m, :m] for (i, j), m in least.items()}

    def _pairs(self, rows: list[int]) -> list[tuple[int, int]]:
        """Pairs of the clocks of some series, each once, in their order."""
        return list(combinations_with_replacement(sorted(set(self._clocks[1][rows].tolist())), 2))

    def process(self, spectrum: Array, group: str, shared: float = 0.0) -> Array:
        """Variances (n_series of the group, n_times) of a process of sd 1, its correlation between series."""
        clocks, rows = self._clocks[1], self.rows[group]
        mixed = {
            (i, j): (mixing := self._mixing[i, j]) @ spectrum[: mixing.shape[1]]
            for i, j in self._pairs(rows)
            if shared or i == j
        }
        size = {i: math.sqrt(mixed[i, i].mean()) for i in set(clocks[rows].tolist())}
        found = np.zeros((self.on.n_series, self.n))
        for own, part, turn in self._turns:
            for a, i in enumerate(own if own[0] in rows else ()):
                for b, j in enumerate(own):
                    if i == j or shared:
                        pair = min(clocks[i], clocks[j]), max(clocks[i], clocks[j])
                        both = mixed[pair][part] / (size[pair[0]] * size[pair[1]])
                        found[own, part] += np.outer(turn[:, a] * turn[:, b], both * (i == j or shared))
        return found[rows]

    def diagonal(self, spectrum: Any) -> Any:
        """Variances (n_times,) of the coefficients of a process with this spectrum at their frequencies."""
        self._alike()
        return pt_dot(self._mixing[0, 0], spectrum)

    def _alike(self) -> Array:
        """Q of series that all have the same times.

        Raises
        ------
        ErrorModelError
            If they have not.
        """
        if not self.on.whole:
            raise ErrorModelError(
                f"{self.on.source or self.on.name}: {self.name} of series that are not all measured at the "
                "same times are for a diagnosis without posteriors; sample with GroupNoise() or "
                "GroupProcess()"
            )
        return self._bases[0][0]

    def _forward(self, series: Array) -> Array:
        return np.asarray(series @ self._alike())


def pt_dot(matrix: Array, vector: Any) -> Any:
    """The product with an array, or with a tensor of PyTensor."""
    return vector.__rmatmul__(matrix) if hasattr(vector, "owner") else matrix @ vector


def weighted_helmert(weights: Array) -> Array:
    """A rotation (n, n) whose first row is in proportion to weights; Helmert's where they are equal."""
    plain = helmert(len(weights), full=True)
    if np.ptp(weights) == 0.0:
        return np.asarray(plain)
    q, r = np.linalg.qr(np.column_stack([weights, plain[1:].T]))
    return np.asarray((q * np.where(np.diag(r) < 0.0, -1.0, 1.0)).T)


def spectral_errors(data: Data) -> Spectral:
    """Uneven where some series' times are in unequal steps, else harmonics if periodic, cosines if not."""
    if not data.even:
        return Uneven()
    return Cosines() if data.period is None else Harmonics()


def log_density(coefficients: Array, S: Array) -> Any:
    """Log-density (...,) of independent normal coefficients of variances S (..., n)."""
    return -0.5 * np.sum(coefficients**2 / S + np.log(2.0 * math.pi * S), axis=-1)
