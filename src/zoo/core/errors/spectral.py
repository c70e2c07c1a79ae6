"""Errors described in coefficients that are independent: harmonics of periodic series, cosines of others.

What is added to the series is taken as stationary: noise, and a smooth discrepancy. Its covariance is then
diagonal in the coefficients, so that likelihoods, whitening and the marginal likelihood of a linearised model
cost a sum over them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import dct, idct
from scipy.linalg import helmert

from zoo.core.data import Data
from zoo.core.errors.base import ErrorModel, ErrorModelError
from zoo.core.parameters import LogNormal, Normal, Parameter, Prior, variable_name

Array = NDArray[np.float64]

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
            If there are no series, or fewer than eight samples.
        """
        if not data.n_series or data.n_times < SMALLEST_SERIES:
            raise ErrorModelError(
                f"{data.source or data.name}: {data.name!r} has {data.n_series} series of {data.n_times} "
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
        """Coefficients of each series."""
        return self.on.n_times

    @property
    def size(self) -> int:
        """Coefficients of all series."""
        return self.on.n_times * self.on.n_series

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
        """Coefficients as one vector, (..., n_series * n_times)."""
        found = self.transform(series)
        return found.reshape(*found.shape[:-2], self.size)

    def unflat(self, coefficients: Array) -> Array:
        """Series of coefficients (..., n_series * n_times)."""
        values = np.asarray(coefficients)
        return self.inverse(values.reshape(*values.shape[:-1], self.on.n_series, self.n))

    def part(self, coefficients: Array, group: str) -> Array:
        """One group's coefficients, (..., n_series of it, n_times), of flat ones."""
        apart = coefficients.reshape(*coefficients.shape[:-1], self.on.n_series, self.n)
        return np.asarray(apart[..., self.rows[group], :])

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

    def spectrum(self, errors: GroupErrors, n_series: int, *, noise: bool = True) -> Array:
        """Variances (n_series, n_times) of the coefficients of one group's series."""
        S = np.zeros((n_series, self.n))
        if noise:
            S += errors.sigma**2 * (1.0 + errors.ratio**2 * self.rough(errors.tau))
        if errors.delta > 0.0:
            share = np.full(n_series, 1.0 - errors.shared)
            share[0] += n_series * errors.shared
            shape = self.rough if errors.rough else self.smooth
            S += errors.delta**2 * np.outer(share, shape(errors.length))
        return S

    def variances(self, errors: Mapping[str, GroupErrors], *, noise: bool = True) -> Array:
        """Variances of all coefficients, (n_series * n_times,)."""
        S = np.empty((self.on.n_series, self.n))
        for group, rows in self.rows.items():
            S[rows] = self.spectrum(errors[group], len(rows), noise=noise)
        return S.reshape(self.size)

    # -- scales -----------------------------------------------------------------------------------

    @property
    def typical_length(self) -> float:
        """Median of the discrepancy's length scale, in the data's unit of time."""
        return self.length[0] * self.on.duration

    def fine(self, residual: Array, group: str) -> Array:
        """Coefficients (n_series, n) of one group's residual whose frequencies are those of noise alone."""
        found: Array = self.part(residual, group)[:, self.k > FINE * self.k.max()]
        return found

    # -- the error model --------------------------------------------------------------------------

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """For each group sigma where it is not known, ratio, tau, and delta where its prior is given."""
        median, spread, top = self.correlation_time
        T, found = self.on.duration, []
        for group, rows in self.rows.items():
            unit, given = self.on.unit(group), self.priors.get(group)
            typical = 0.01 * float(np.ptp(self.on.values[rows])) or 1.0
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
        return self.variances(errors).reshape(self.on.n_series, self.n)

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
        return np.asarray(-0.5 * (self.transform(residual) ** 2 / S + np.log(2.0 * math.pi * S)))

    def observe(self, name: str, mean: Any, ok: Any, variables: Mapping[str, Any]) -> Any:
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
        """ "harmonics"."""
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
        """ "cosines"."""
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
    """Errors of series whose times are in unequal steps, as where samples are missing.

    The coefficients are those of an orthonormal basis Q of the measured samples, made of the harmonics of
    the period or the cosines of the record, B at the measured times, from slow to fast: B = Q R. White noise
    is white in them, and a process with the spectrum h has the variances

        diag(Q' B diag(h) B' Q);

    what it has besides these is left out, which is little where few samples are missing.
    """

    uneven: ClassVar[bool] = True

    @property
    def name(self) -> str:
        """ "uneven"."""
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
    def _functions(self) -> Array:
        """B: each column a harmonic or a cosine at the measured times."""
        n, T = self.n, self.on.duration
        t = self.on.times - self.on.times[0]
        if self.on.period is None:
            t = t + 0.5 * T / n
        phase = np.outer(t, self.omega)
        sines = (self.on.period is not None) & (np.arange(n) % 2 == 0)
        found = np.where(sines, np.sin(phase), np.cos(phase)) * math.sqrt(2.0 / n)
        found[:, 0] = 1.0 / math.sqrt(n)
        if self.on.period is not None and n % 2 == 0:  # what alternates
            found[:, -1] /= math.sqrt(2.0)
        return np.asarray(found)

    @cached_property
    def _orthonormal(self) -> Array:
        q, r = np.linalg.qr(self._functions)
        return np.asarray(q * np.where(np.diag(r) < 0.0, -1.0, 1.0))

    @cached_property
    def _mixing(self) -> Array:
        return np.asarray((self._orthonormal.T @ self._functions) ** 2)

    def diagonal(self, spectrum: Any) -> Any:
        """Variances (n_times,) of the coefficients of a process with this spectrum at their frequencies."""
        return spectrum.__rmatmul__(self._mixing) if hasattr(spectrum, "owner") else self._mixing @ spectrum

    def _forward(self, series: Array) -> Array:
        return np.asarray(series @ self._orthonormal)

    def _backward(self, coefficients: Array) -> Array:
        return np.asarray(coefficients @ self._orthonormal.T)


def spectral_errors(data: Data) -> Spectral:
    """Uneven where times are in unequal steps, else harmonics for periodic data and cosines for others."""
    if not data.even:
        return Uneven()
    return Cosines() if data.period is None else Harmonics()


def log_density(coefficients: Array, S: Array) -> Any:
    """Log-density (...,) of independent normal coefficients of variances S (..., n)."""
    return -0.5 * np.sum(coefficients**2 / S + np.log(2.0 * math.pi * S), axis=-1)
