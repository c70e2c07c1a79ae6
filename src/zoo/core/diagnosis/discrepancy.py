"""The error model of the diagnosis: noise, and a smooth discrepancy, in the harmonics of the beat.

The series are sampled evenly over one beat, and what is added to them is taken as periodic and stationary.
Its covariance is then diagonal in the harmonics, so that likelihoods, whitening and the marginal likelihood
of a linearised model cost a sum over coefficients.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import helmert
from scipy.optimize import minimize

from zoo.blood.study import Study

Array = NDArray[np.float64]

CORRELATED_RATIO = 1.0
"""Upper limit, and scale of the half-normal prior, of (sd of the correlated noise)/(sd of the white noise):
what sensors and averaging leave correlated is no larger than what they leave white. Without a limit noise
takes the place of a discrepancy."""
MEMORY_BEATS = (0.03, 0.5, 0.1)
"""Prior of the noise's correlation time in beats: median, sd of the logarithm, and upper limit. Noise forgets
within a few per cent of a beat; what lasts longer than a tenth of it is a discrepancy."""
LENGTH_BEATS = (0.05, 0.5)
"""Prior of the discrepancy's length scale in beats: median, and sd of the logarithm. An upstroke lasts some
tenth of a beat, and a discrepancy follows the features of the waveform."""
LENGTH_GRID = np.exp(np.linspace(-1.5, 1.5, 7) * LENGTH_BEATS[1]) * LENGTH_BEATS[0]
SHARED_GRID = np.array([0.0, 0.4, 0.7, 0.9])
"""Correlation between series of a discrepancy that has a physical cause: what is wrong in one vessel is
wrong in its neighbours too, but the base's parameters may have taken the common part away. Noise has none."""


class HarmonicError(ValueError):
    """A study whose series cannot be taken apart into harmonics."""


@dataclass(frozen=True)
class Errors:
    """Noise and discrepancy of the series of one quantity, in its unit.

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
        Its correlation time, s.
    delta : float
        Sd of the discrepancy.
    length : float
        Its length scale, s.
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


class Harmonics:
    """The orthonormal harmonics of a study's series, as one vector of n_series * n_times numbers.

    Series of one quantity are rotated so that the first stands for their mean.

    Parameters
    ----------
    study : Study
        At least eight samples in the beat.

    Raises
    ------
    HarmonicError
        If there are no series, or too few samples.
    """

    def __init__(self, study: Study) -> None:
        n = len(study.time_s)
        if not study.series or n < 8:
            raise HarmonicError(
                f"{study.source}: study {study.name!r} has {len(study.series)} series of {n} samples: the "
                "diagnosis needs at least one series of eight samples; add observations.csv"
            )
        self.n, self.period_s = n, study.period_s
        self.quantities = tuple(dict.fromkeys(s.quantity for s in study.series))
        rows = [[i for i, s in enumerate(study.series) if s.quantity == q] for q in self.quantities]
        self.rows = dict(zip(self.quantities, rows, strict=True))
        m = n // 2 + 1
        weight = np.full(m, math.sqrt(2.0))
        weight[0] = 1.0
        if n % 2 == 0:
            weight[-1] = 1.0
        self._weight = weight
        imaginary = np.ones(m, bool)
        imaginary[0] = False
        if n % 2 == 0:
            imaginary[-1] = False
        self._imaginary = imaginary
        self.k = np.concatenate([np.arange(m), np.arange(m)[imaginary]])
        """Harmonic of each coefficient of a series, (n_times,)."""
        self._rotation = np.eye(len(study.series))
        for group in rows:
            self._rotation[np.ix_(group, group)] = helmert(len(group), full=True)
        self.size = len(study.series) * n
        self._omega = 2.0 * math.pi * self.k / self.period_s

    def __call__(self, waves: Array) -> Array:
        """Coefficients (..., n_series * n_times) of series (..., n_series, n_times)."""
        c = np.fft.rfft(waves, norm="ortho") * self._weight
        packed = np.concatenate([c.real, c.imag[..., self._imaginary]], axis=-1)
        rotated = np.einsum("ij,...jk->...ik", self._rotation, packed)
        return np.asarray(rotated.reshape(*rotated.shape[:-2], self.size))

    def back(self, coefficients: Array) -> Array:
        """Series (..., n_series, n_times) of coefficients (..., n_series * n_times)."""
        n_series = len(self._rotation)
        packed = np.asarray(coefficients).reshape(*np.shape(coefficients)[:-1], n_series, self.n)
        packed = np.einsum("ji,...jk->...ik", self._rotation, packed)
        m = self.n // 2 + 1
        c = packed[..., :m].astype(complex)
        c[..., self._imaginary] += 1j * packed[..., m:]
        return np.fft.irfft(c / self._weight, n=self.n, norm="ortho")

    def rough(self, tau: Any) -> Any:
        """Spectrum (n_times,), of mean 1, of an Ornstein-Uhlenbeck process; of a number or a tensor."""
        f = 1.0 / (1.0 + (self._omega * tau) ** 2)
        return f / f.mean()

    def smooth(self, length: float) -> Array:
        """The same of a squared-exponential process."""
        f: Array = np.exp(-0.5 * (self._omega * length) ** 2)
        return np.asarray(f / f.mean())

    def spectrum(self, errors: Errors, n_series: int, *, noise: bool = True) -> Array:
        """Variances (n_series, n_times) of the coefficients of one quantity's series."""
        S = np.zeros((n_series, self.n))
        if noise:
            S += errors.sigma**2 * (1.0 + errors.ratio**2 * self.rough(errors.tau))
        if errors.delta > 0.0:
            share = np.full(n_series, 1.0 - errors.shared)
            share[0] += n_series * errors.shared
            shape = self.rough if errors.rough else self.smooth
            S += errors.delta**2 * np.outer(share, shape(errors.length))
        return S

    def variances(self, errors: Mapping[str, Errors], *, noise: bool = True) -> Array:
        """Variances of all coefficients, (n_series * n_times,)."""
        S = np.empty((len(self._rotation), self.n))
        for quantity, rows in self.rows.items():
            S[rows] = self.spectrum(errors[quantity], len(rows), noise=noise)
        return S.reshape(self.size)

    def part(self, coefficients: Array, quantity: str) -> Array:
        """One quantity's coefficients, (..., n_series of it, n_times)."""
        apart = coefficients.reshape(*coefficients.shape[:-1], len(self._rotation), self.n)
        return np.asarray(apart[..., self.rows[quantity], :])


LARGEST_DELTA = 2.0
"""Largest discrepancy beside a hypothesis, in units of the sd of its half-normal prior: 95 % of it."""


def log_density(coefficients: Array, S: Array) -> Any:
    """Log-density (...,) of independent normal coefficients of variances S (..., n)."""
    return -0.5 * np.sum(coefficients**2 / S + np.log(2.0 * math.pi * S), axis=-1)


def noise_log_prior(errors: Errors, period_s: float) -> float:
    """Log-prior of the noise: flat in log sigma, half-normal in the ratio, log-normal in tau."""
    median, sd, _ = MEMORY_BEATS
    x = math.log(errors.tau / (median * period_s)) / sd
    return -0.5 * (errors.ratio / CORRELATED_RATIO) ** 2 - 0.5 * x * x


def length_log_prior(length_s: float, period_s: float) -> float:
    """Log-prior of a discrepancy's length scale: log-normal, without its constant."""
    median, sd = LENGTH_BEATS
    x = math.log(length_s / (median * period_s)) / sd
    return -0.5 * x * x


def fit_noise(
    harmonics: Harmonics,
    residual: Array,
    quantity: str,
    start: Errors,
    *,
    free_delta: bool = False,
    scale: float = 0.0,
) -> Errors:
    """Noise that makes one quantity's residual most probable, beside a discrepancy that is given or free.

    Parameters
    ----------
    harmonics : Harmonics
    residual : array (n_series * n_times,)
        Coefficients of measured minus computed.
    quantity : str
    start : Errors
        Where the search starts; its discrepancy is kept unless `free_delta`.
    free_delta : bool
        Fit its size as well, with a half-normal prior of sd `scale`.
    scale : float
        In the quantity's unit.

    Returns
    -------
    Errors
    """
    part = harmonics.part(residual, quantity)
    power = part**2
    T = harmonics.period_s
    high = power[:, harmonics.k > 0.6 * harmonics.k.max()]
    floor = max(math.sqrt(float(high.mean())), 1e-9 * (1.0 + math.sqrt(float(power.mean()))))

    def errors_at(x: Array) -> Errors:
        found = replace(start, sigma=math.exp(x[0]), ratio=float(x[1]), tau=math.exp(x[2]))
        return replace(found, delta=float(x[3]) * scale) if free_delta else found

    def cost(x: Array) -> float:
        e = errors_at(x)
        S = harmonics.spectrum(e, len(part))
        value = 0.5 * float(np.sum(power / S + np.log(S))) - noise_log_prior(e, T)
        return value + (0.5 * float(x[3]) ** 2 if free_delta else 0.0)

    bounds = [(math.log(floor) - 2.0, math.log(floor) + 3.0), (0.0, CORRELATED_RATIO)]
    bounds += [(math.log(0.003 * T), math.log(MEMORY_BEATS[2] * T))]
    x0 = [math.log(floor), 0.5, math.log(MEMORY_BEATS[0] * T)]
    if free_delta:
        bounds.append((0.0, LARGEST_DELTA))
        x0.append(1.0)
    found = minimize(cost, np.array(x0), method="L-BFGS-B", bounds=bounds)
    return errors_at(found.x)


def marginal(
    residual: Array,
    jacobian: Array,
    S: Array,
    precision: Array,
    pull: Array,
) -> tuple[Any, Array, Array]:
    """Log marginal likelihood of a linear model with normal errors, and its parameters' posterior.

    r = J d + e, e ~ N(0, diag S), prior density exp(-d'P d/2 - pull'd) without its constant:
    log Z = log N(r; 0, S) + b'H^-1 b/2 - log|H/2 pi|/2, H = J'J/S + P, b = J'r/S - pull.

    Parameters
    ----------
    residual : array (n,)
        At the point of linearisation.
    jacobian : array (n, d)
    S : array (..., n)
        Any number of variances at once.
    precision : array (d,)
        P, 0 for a flat prior.
    pull : array (d,)

    Returns
    -------
    log_z : array (...,)
    step : array (..., d)
        H^-1 b, the mode seen from the point of linearisation.
    covariance : array (..., d, d)
        H^-1.
    """
    d = jacobian.shape[1]
    products = (jacobian[:, :, None] * jacobian[:, None, :]).reshape(len(jacobian), d * d)
    H = ((1.0 / S) @ products).reshape(*S.shape[:-1], d, d) + np.diag(precision)
    b = (1.0 / S) @ (jacobian * residual[:, None]) - pull
    size = np.sqrt(np.maximum(np.einsum("...dd->...d", H), 1e-300))
    scale = size[..., :, None] * size[..., None, :]
    C = np.linalg.inv(H / scale) / scale
    step = np.einsum("...de,...e->...d", C, b)
    _, logdet = np.linalg.slogdet(H / scale)
    logdet += 2.0 * np.log(size).sum(axis=-1)
    log_z = log_density(residual, S) + 0.5 * np.sum(b * step, axis=-1)
    return log_z + 0.5 * (d * math.log(2.0 * math.pi) - logdet), step, C


def smooth_part(harmonics: Harmonics, residual: Array, errors: Mapping[str, Errors]) -> tuple[Array, Array]:
    """Posterior mean and variance of the discrepancy's coefficients, given the residual: Wiener's filter."""
    total = harmonics.variances(errors)
    own = harmonics.variances(errors, noise=False)
    gain = own / total
    return gain * residual, own * (1.0 - gain)
