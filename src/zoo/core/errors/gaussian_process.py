"""The Gaussian process of Paun et al. 2020 as an error model: a neural-network kernel in time."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

from zoo.core.arrays import Array
from zoo.core.data import Data
from zoo.core.errors.base import ErrorModel, ErrorModelError, TermsInNumba
from zoo.core.parameters import Parameter, Prior

NOISE_VARIANCE = 2.44e-6  # in the squared unit of the series, fixed in the published code
JITTER = 1e-6  # added to it there
NOISE = NOISE_VARIANCE + JITTER

_LOG_2PI = math.log(2.0 * math.pi)
_BLOCK = 128  # rows of the kernel at a time: they stay in cache, and most of the upper triangle is skipped
_FACTORS_KEPT = 8  # of two points with a few groups of series


def neural_network_kernel(time_s: ArrayLike, w: float, b: float, other_s: ArrayLike | None = None) -> Array:
    """Covariance of a network with one infinite layer, in time.

    k(t, t') = (2/pi) asin(2 x'Sx / sqrt((1 + 2 x'Sx) (1 + 2 x''Sx''))), x = (1, t), S = diag(b, w).

    Parameters
    ----------
    time_s : array (n,)
        Times in s, from the start of the record: the kernel is not stationary.
    w : float
        Variance of the weights, s-2.
    b : float
        Variance of the bias.
    other_s : array (m,)
        Times of the columns; `time_s` when absent.

    Returns
    -------
    array (n, m)
        In the squared unit of the series; below 1 everywhere.

    References
    ----------
    Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, eq. 4.29.
    """

    def scaled(t: Array) -> Array:
        factor = np.sqrt(2.0 / (1.0 + 2.0 * (b + w * t * t)))
        return np.stack([math.sqrt(b) * factor, math.sqrt(w) * factor * t], axis=1)

    rows = scaled(np.asarray(time_s, dtype=np.float64))
    columns = rows if other_s is None else scaled(np.asarray(other_s, dtype=np.float64))
    kernel: Array = rows @ columns.T
    np.arcsin(kernel, out=kernel)
    kernel *= 2.0 / math.pi
    return kernel


class _Factor(NamedTuple):
    lower: Array  # (n, n) Cholesky factor; LAPACK neither reads nor clears the upper triangle
    log_diagonal: Array  # (n,)

    def triangle(self) -> Array:
        """A copy with zeros above the diagonal, in column order."""
        return np.triu(self.lower.T).T


@lru_cache(maxsize=1)
def _blas() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")


def _one_thread() -> Any:
    """Context with one BLAS thread: at these sizes more are slower, far slower when chains share cores."""
    return _blas().limit(limits=1)


@lru_cache(maxsize=_FACTORS_KEPT)
def _factor(times: bytes, w: float, b: float, noise: float) -> _Factor | None:
    """Cholesky factor of kernel plus noise, shared by all series; None where there is none."""
    if not (0.0 < w < math.inf and 0.0 < b < math.inf):
        return None
    time_s = np.frombuffer(times)
    n = len(time_s)
    covariance = np.zeros((n, n), order="F")
    for start in range(0, n, _BLOCK):
        stop = start + _BLOCK
        covariance.T[start:stop, start:] = neural_network_kernel(time_s[start:stop], w, b, time_s[start:])
    covariance[np.diag_indices(n)] += noise
    lower, info = lapack.dpotrf(covariance, lower=1, overwrite_a=1, clean=0)
    if info != 0:
        return None
    lower.flags.writeable = False
    return _Factor(lower, np.log(np.diag(lower)))


def _factor_at(time_s: ArrayLike, w: Any, b: Any, noise: float = NOISE) -> _Factor | None:
    times = np.ascontiguousarray(time_s, dtype=np.float64).tobytes()
    return _factor(times, float(np.asarray(w)), float(np.asarray(b)), float(noise))


def _whiten(factor: _Factor, residual: Array) -> Array:
    """Solve L z = residual for every series, (n_series, n_times)."""
    z, _ = lapack.dtrtrs(factor.lower, residual.T, lower=1)
    return np.asarray(z.T)


def gp_sequential(residual: ArrayLike, time_s: ArrayLike, w: float, b: float, noise: float = NOISE) -> Array:
    """Terms log p(y_i | y_<i) of the Gaussian process; over a series they add up to its joint log-density.

    With K = L L' and z = L^-1 (y - mu): -(log 2 pi)/2 - log L_ii - z_i^2/2.

    Parameters
    ----------
    residual : array (n_series, n_times)
        Measured minus computed; the series are independent and share the kernel.
    time_s : array (n_times,)
        s.
    w, b : float
        Of `neural_network_kernel`.
    noise : float
        Variance added to the kernel's diagonal.

    Returns
    -------
    array (n_series, n_times)
        -inf where the covariance has no Cholesky factor.
    """
    residual = np.atleast_2d(np.asarray(residual, dtype=np.float64))
    with _one_thread():
        factor = _factor_at(time_s, w, b, noise)
        if factor is None:
            return np.full(residual.shape, -np.inf)
        z = _whiten(factor, residual)
    terms: Array = -0.5 * (_LOG_2PI + z * z) - factor.log_diagonal
    return terms


def gp_leave_one_out(
    residual: ArrayLike, time_s: ArrayLike, w: float, b: float, noise: float = NOISE
) -> Array:
    """Terms log p(y_i | y_-i) of the Gaussian process, each given all other points of its series.

    With g = K^-1 (y - mu) and v_i = 1/(K^-1)_ii: -(log 2 pi v_i)/2 - g_i^2 v_i/2.

    Parameters
    ----------
    residual : array (n_series, n_times)
        Measured minus computed; the series are independent and share the kernel.
    time_s : array (n_times,)
        s.
    w, b : float
        Of `neural_network_kernel`.
    noise : float
        Variance added to the kernel's diagonal.

    Returns
    -------
    array (n_series, n_times)
        -inf where the covariance has no Cholesky factor.

    References
    ----------
    Buerkner, Gabry and Vehtari 2021, doi 10.1007/s00180-020-01045-4.
    """
    found = gp_left_out(residual, time_s, w, b, noise)
    if found is None:
        return np.full(np.atleast_2d(residual).shape, -np.inf)
    z, v = found
    return np.asarray(-0.5 * (_LOG_2PI + np.log(v) + z * z))


def gp_left_out(
    residual: ArrayLike, time_s: ArrayLike, w: float, b: float, noise: float = NOISE
) -> tuple[Array, Array] | None:
    """Each point less its mean given all others, in standard deviations, and its variance then.

    That is g_i v_i^(1/2), (n_series, n_times), and v_i, (n_times,), of `gp_leave_one_out`; None where the
    covariance has no Cholesky factor.
    """
    residual = np.atleast_2d(np.asarray(residual, dtype=np.float64))
    with _one_thread():
        factor = _factor_at(time_s, w, b, noise)
        if factor is None:
            return None
        inverse, _ = lapack.dtrtri(factor.triangle(), lower=1, overwrite_c=1)
        g = _whiten(factor, residual) @ inverse
        v = 1.0 / np.einsum("ji,ji->i", inverse, inverse)
    return g * np.sqrt(v), v


def gp_gradient(
    residual: Array, weight: Array, time_s: ArrayLike, w: Any, b: Any, noise: float = NOISE
) -> tuple[Array, float, float, float]:
    """Gradient of sum_i g_i log p(y_i | y_<i), by the residual, by w, by b and by the noise's variance.

    With K = L L' and z = L^-1 r it is -L^-T (g z) by the residual. By K it is the matrix L^-T P L^-1, P the
    lower triangle of (g z) z' - diag(g) with half its diagonal, which is contracted with dK/dw, dK/db and the
    unit matrix. Where g is the same at all times, as in a log-density, K^-1 makes that matrix sooner.

    Parameters
    ----------
    residual, weight : array (n_series, n_times)
        r of each series, and g.
    time_s : array (n_times,)
        s.
    w, b : float
        Of `neural_network_kernel`.
    noise : float
        Variance added to the kernel's diagonal.

    Returns
    -------
    by_residual : array (n_series, n_times)
    by_w, by_b, by_noise : float
        All zero where the covariance has no Cholesky factor.

    References
    ----------
    Murray 2016, Differentiation of the Cholesky decomposition, arXiv:1602.07527.
    """
    with _one_thread():
        factor = _factor_at(time_s, w, b, noise)
        if factor is None:
            return np.zeros_like(residual), 0.0, 0.0, 0.0
        z = _whiten(factor, residual)
        by_residual = -_backwards(factor, (weight * z).T).T
        diagonal = np.diag_indices(z.shape[1])
        if np.all(
            weight == weight[:, :1]
        ):  # L^-T P L^-1 + its transpose = sum_s g_s (a_s a_s' - K^-1), a = L^-T z
            inverse, _ = lapack.dpotri(factor.lower, lower=1)
            by_covariance = -by_residual.T @ _backwards(factor, z.T).T
            by_covariance -= weight[:, 0].sum() * inverse.T
            by_covariance = np.triu(by_covariance)
            by_covariance[diagonal] *= 0.5
        else:
            inner = np.tril((weight * z).T @ z)
            inner[diagonal] = 0.5 * (inner[diagonal] - weight.sum(0))
            by_covariance = _backwards(factor, _backwards(factor, inner).T)  # its transpose: dK is symmetric
        by_w, by_b = _kernel_slopes(by_covariance, np.asarray(time_s, dtype=np.float64), float(w), float(b))
    return by_residual, by_w, by_b, float(np.trace(by_covariance))


def _backwards(factor: _Factor, columns: Array) -> Array:
    """Solve L' x = columns, (n_times, n)."""
    x, _ = lapack.dtrtrs(factor.lower, columns, lower=1, trans=1)
    return np.asarray(x)


def _kernel_slopes(by_kernel: Array, t: Array, w: float, b: float) -> tuple[float, float]:
    """Sums over all entries of `by_kernel` (n, n) times the derivative of the kernel k by w, and by b.

    With c = 2 (b + w t t'), n = 1 + 2 (b + w t^2) and D = n n' - c^2, written without a difference of large
    numbers, dk/dw = 2/(pi sqrt D) (2 t t' - c (t^2/n + t'^2/n')), dk/db = 2/(pi sqrt D) (2 - c (1/n + 1/n')).
    """
    half = 0.5 + 2.0 * b + 2.0 * w * t * t
    root = np.subtract.outer(t, t)
    root *= root
    root *= 4.0 * b * w
    root += half
    root += half[:, None]
    scaled = np.divide(by_kernel, np.sqrt(root, out=root), out=root)
    ones, n = np.ones_like(t), 1.0 + 2.0 * (b + w * t * t)
    sums, moments = ((scaled @ x, x @ scaled) for x in (ones, t))
    weighed = 2.0 * (
        b * (sums[0] + sums[1]) + w * t * (moments[0] + moments[1])
    )  # sums of c by row and column
    by_w = 2.0 * t @ moments[0] - (t * t / n) @ weighed
    by_b = 2.0 * sums[0].sum() - (1.0 / n) @ weighed
    return float(2.0 / math.pi * by_w), float(2.0 / math.pi * by_b)


def whiten_by_process(residuals: Array, time_s: ArrayLike, w: Any, b: Any, noise: float) -> Array | None:
    """z = L^-1 r of residuals (..., n_times), L L' the covariance; None where it has no Cholesky factor."""
    with _one_thread():
        factor = _factor_at(time_s, w, b, noise)
        if factor is None:
            return None
        rows = np.reshape(residuals, (-1, residuals.shape[-1]))
        return _whiten(factor, rows).reshape(residuals.shape)


def colour_by_process(z: Array, time_s: ArrayLike, w: Any, b: Any, noise: float) -> Array | None:
    """r = L z of standard normal numbers (..., n_times), the inverse of `whiten_by_process`."""
    with _one_thread():
        factor = _factor_at(time_s, w, b, noise)
        return None if factor is None else np.asarray(z @ factor.triangle().T)


class Processes(ErrorModel):
    """Errors of which each series has a Gaussian process with the neural-network kernel, and noise.

    Some series may share a covariance, a^2 (K(w, b) + v I).
    """

    @abstractmethod
    def _parts(self, values: Mapping[str, ArrayLike]) -> Iterator[tuple[Any, float, tuple[Any, ...]]]:
        """Series and times that share a covariance, its amplitude a, and its times, w, b and noise v.

        The first is an index of arrays (..., series, times).
        """

    def variance(self, values: Mapping[str, ArrayLike]) -> Array:
        """a^2 (k(t, t) + v), (n_series, n_times); NaN where nothing was measured."""
        found = np.full((self.on.n_series, self.on.n_times), np.nan)
        for at, a, (times, w, b, noise) in self._parts(values):
            product = 2.0 * (b + w * times**2)
            found[at] = a * a * (2.0 / math.pi * np.arcsin(product / (1.0 + product)) + noise)
        return found

    def whiten(self, residuals: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """z = L^-1 r with L L' the covariance of each series; None where it has no Cholesky factor."""
        return self._linear(whiten_by_process, residuals, values, -1)

    def unwhiten(self, z: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """r = L z; None where the covariance has no Cholesky factor."""
        return self._linear(colour_by_process, z, values, 1)

    def _linear(self, map_: Any, series: Array, values: Mapping[str, ArrayLike], power: int) -> Array | None:
        found = np.zeros(series.shape)
        for at, a, law in self._parts(values):
            part = map_(series[at], *law)
            if part is None:
                return None
            found[at] = a**power * part
        return found

    def terms(
        self, residual: Array, values: Mapping[str, ArrayLike], decomposition: str = "sequential"
    ) -> Array:
        """`gp_sequential` or `gp_leave_one_out` of each part, (n_series, n_times)."""
        function = gp_leave_one_out if decomposition == "leave-one-out" else gp_sequential
        found = np.zeros(residual.shape)
        for at, a, law in self._parts(values):
            found[at] = function(residual[at] / a, *law) - math.log(a)
        return found

    def left_out(self, residual: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """That of `gp_left_out` in each part."""
        found = np.zeros(residual.shape)
        for at, a, law in self._parts(values):
            part = gp_left_out(residual[at] / a, *law)
            if part is None:
                return None
            found[at] = part[0]
        return found


@dataclass(frozen=True)
class GaussianProcess(Processes):
    """A Gaussian process around each series, with the neural-network kernel and fixed noise.

    y ~ N(mean, K(w, b) + (noise_variance + jitter) I), independently for each series, with one w and b. The
    kernel's amplitude, 1, and the noise belong to one unit.

    Parameters
    ----------
    w : Prior
        Of the variance of the kernel's weights, per squared unit of time.
    b : Prior
        Of the variance of the kernel's bias.
    w_start, b_start : float, optional
        Where a search begins.
    noise_variance, jitter : float
        In the squared unit of the series.
    unit : str
        The one unit of series that it holds for, such as "mmHg"; empty if it may be any.

    References
    ----------
    Paun et al. 2020, eq. (4.6), doi 10.1098/rsif.2020.0886. Rasmussen and Williams 2006, Gaussian Processes
    for Machine Learning, eq. 4.29.

    Examples
    --------
    >>> from zoo.core.parameters import LogUniform
    >>> errors = GaussianProcess(LogUniform(1e4, 9e4), LogUniform(1, 500), unit="mmHg")
    >>> t = np.linspace(0.0, 0.1, 4)
    >>> bound = errors.bind(Data(t, np.zeros((1, 4)), units=["mmHg"]))
    >>> bound.variance({"w": 5e4, "b": 100.0}).round(3)
    array([[0.936, 0.949, 0.965, 0.974]])
    """

    w: Prior
    b: Prior
    w_start: float | None = None
    b_start: float | None = None
    noise_variance: float = NOISE_VARIANCE
    jitter: float = JITTER
    unit: str = ""

    @property
    def name(self) -> str:
        """Its name, "gp"."""
        return "gp"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Variance "w" of the weights and variance "b" of the bias."""
        time_unit = self.data.time_unit if self.data is not None else "s"
        return (
            Parameter("w", self.w, f"{time_unit}-2", self.w_start, "variance of the kernel's weights"),
            Parameter("b", self.b, "1", self.b_start, "variance of the kernel's bias"),
        )

    @property
    def noise(self) -> float:
        """Variance on the diagonal besides the kernel's."""
        return self.noise_variance + self.jitter

    def bind(self, data: Data) -> Self:
        """The same for given data.

        Raises
        ------
        ErrorModelError
            If a series is in another unit.
        """
        for label, unit in zip(data.labels, data.units, strict=True):
            if self.unit and unit != self.unit:
                raise ErrorModelError(
                    f"{data.source or 'data'}: {data.name!r} observes {label}: the Gaussian process' "
                    f"amplitude and noise are in {self.unit}2; keep the series in {self.unit} only, or use "
                    "zoo.GroupProcess()"
                )
        return super().bind(data)

    def _parts(self, values: Mapping[str, ArrayLike]) -> Iterator[tuple[Any, float, tuple[Any, ...]]]:
        every = ..., np.arange(self.on.n_series)[:, None], np.arange(self.on.n_times)
        w, b = (float(np.asarray(values[name])) for name in ("w", "b"))
        yield every, 1.0, (self.on.times, w, b, self.noise)

    def gradient(
        self, residual: Array, values: Mapping[str, ArrayLike], weight: Array
    ) -> tuple[Array, dict[str, float]]:
        """`gp_gradient`."""
        [(_, _, law)] = self._parts(values)
        by_residual, by_w, by_b, _ = gp_gradient(residual, weight, *law)
        return by_residual, {"w": by_w, "b": by_b}

    def in_numba(self) -> TermsInNumba:
        """Of one process."""
        from zoo.core.errors.process_in_numba import Part, processes

        return processes(self.on.times, [Part(tuple(range(self.on.n_series)), w=0, b=1, variance=self.noise)])
