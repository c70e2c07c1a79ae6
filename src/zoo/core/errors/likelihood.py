"""Error models: what stands between the solver's series and the measured ones.

Two of them: independent errors of one variance, and the Gaussian process of Paun et al. 2020 with a
neural-network kernel. Each has a NumPy core that gives one log-likelihood term per observation, and a
PyMC face whose log-density is made of the same terms, so ``az.waic`` and ``az.loo`` work on both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from numpy.typing import ArrayLike, NDArray
from pymc.distributions.distribution import Continuous
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op
from pytensor.tensor.random.op import RandomVariable
from pytensor.tensor.variable import TensorVariable
from scipy.linalg import lapack
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

from zoo.blood.network import Network
from zoo.blood.op import BloodFlowOp, MissingGradientError
from zoo.blood.solver import SolverOptions
from zoo.core.distributions import LogUniform as LogUniform

if TYPE_CHECKING:
    from zoo.blood.study import Study

Array = NDArray[np.float64]

NOISE_VARIANCE = 2.44e-6  # mmHg2, fixed in the published code
JITTER = 1e-6  # mmHg2, added to it there
W_RANGE = (1e4, 9e4)  # weight variance, s-2
B_RANGE = (1.0, 500.0)  # bias variance
INVERSE_GAMMA = (0.001, 0.001)  # shape, and scale in the squared unit of the series

DECOMPOSITIONS = ("sequential", "leave-one-out", "joint")
ERROR_PARAMETERS = {"iid": ("sigma2",), "gp": ("w", "b")}

_LOG_2PI = math.log(2.0 * math.pi)
_BLOCK = 128  # rows of the kernel at a time: they stay in cache, and most of the upper triangle is skipped
_FACTORS_KEPT = 4


# ---------------------------------------------------------------------------------------------------
# NumPy cores


def neural_network_kernel(time_s: ArrayLike, w: float, b: float, other_s: ArrayLike | None = None) -> Array:
    """Covariance of a network with one infinite layer, in time.

    k(t, t') = (2/pi) asin(2 x'Sx / sqrt((1 + 2 x'Sx) (1 + 2 x''Sx''))), x = (1, t), S = diag(b, w).

    Parameters
    ----------
    time_s : array (n,)
        Times in s, from the start of the beat: the kernel is not stationary.
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
def _factor(times: bytes, w: float, b: float) -> _Factor | None:
    """Cholesky factor of kernel plus noise, shared by all series; None where there is none."""
    if not (0.0 < w < math.inf and 0.0 < b < math.inf):
        return None
    time_s = np.frombuffer(times)
    n = len(time_s)
    covariance = np.zeros((n, n), order="F")
    for start in range(0, n, _BLOCK):
        stop = start + _BLOCK
        covariance.T[start:stop, start:] = neural_network_kernel(time_s[start:stop], w, b, time_s[start:])
    covariance[np.diag_indices(n)] += NOISE_VARIANCE + JITTER
    lower, info = lapack.dpotrf(covariance, lower=1, overwrite_a=1, clean=0)
    if info != 0:
        return None
    lower.flags.writeable = False
    return _Factor(lower, np.log(np.diag(lower)))


def _factor_at(time_s: ArrayLike, w: float, b: float) -> _Factor | None:
    return _factor(np.ascontiguousarray(time_s, dtype=np.float64).tobytes(), float(w), float(b))


def _whiten(factor: _Factor, residual: Array) -> Array:
    """Solve L z = residual for every series, (n_series, n_times)."""
    z, _ = lapack.dtrtrs(factor.lower, residual.T, lower=1)
    return np.asarray(z.T)


def gp_sequential(residual: ArrayLike, time_s: ArrayLike, w: float, b: float) -> Array:
    """Terms log p(y_i | y_<i) of the Gaussian process; over a series they add up to its joint log-density.

    With K = L L' and z = L^-1 (y - mu): -(log 2 pi)/2 - log L_ii - z_i^2/2.

    Parameters
    ----------
    residual : array (n_series, n_times)
        Measured minus computed, mmHg; the series are independent and share the kernel.
    time_s : array (n_times,)
        s.
    w, b : float
        Of `neural_network_kernel`.

    Returns
    -------
    array (n_series, n_times)
        -inf where the covariance has no Cholesky factor.
    """
    residual = np.atleast_2d(np.asarray(residual, dtype=np.float64))
    with _one_thread():
        factor = _factor_at(time_s, w, b)
        if factor is None:
            return np.full(residual.shape, -np.inf)
        z = _whiten(factor, residual)
    terms: Array = -0.5 * (_LOG_2PI + z * z) - factor.log_diagonal
    return terms


def gp_leave_one_out(residual: ArrayLike, time_s: ArrayLike, w: float, b: float) -> Array:
    """Terms log p(y_i | y_-i) of the Gaussian process, each given all other points of its series.

    With g = K^-1 (y - mu) and v_i = 1/(K^-1)_ii: -(log 2 pi v_i)/2 - g_i^2 v_i/2.

    Parameters
    ----------
    residual : array (n_series, n_times)
        Measured minus computed, mmHg; the series are independent and share the kernel.
    time_s : array (n_times,)
        s.
    w, b : float
        Of `neural_network_kernel`.

    Returns
    -------
    array (n_series, n_times)
        -inf where the covariance has no Cholesky factor.

    References
    ----------
    Buerkner, Gabry and Vehtari 2021, doi 10.1007/s00180-020-01045-4.
    """
    residual = np.atleast_2d(np.asarray(residual, dtype=np.float64))
    with _one_thread():
        factor = _factor_at(time_s, w, b)
        if factor is None:
            return np.full(residual.shape, -np.inf)
        inverse, _ = lapack.dtrtri(factor.triangle(), lower=1, overwrite_c=1)
        g = _whiten(factor, residual) @ inverse
        v = 1.0 / np.einsum("ji,ji->i", inverse, inverse)
    terms: Array = -0.5 * (_LOG_2PI + np.log(v) + g * g * v)
    return terms


def iid_terms(residual: ArrayLike, sigma2: float) -> Array:
    """Terms log p(y_i) of independent normal errors of variance sigma2, the same in every decomposition.

    Parameters
    ----------
    residual : array (n_series, n_times)
        Measured minus computed, in the unit of the series.
    sigma2 : float
        In its square.

    Returns
    -------
    array (n_series, n_times)
    """
    residual = np.atleast_2d(np.asarray(residual, dtype=np.float64))
    terms: Array = -0.5 * (_LOG_2PI + math.log(sigma2) + residual * residual / sigma2)
    return terms


def whiten(
    error: str, residuals: Array, time_s: ArrayLike, parameters: Mapping[str, ArrayLike]
) -> Array | None:
    """Residuals in units of their errors: z = L^-1 r with L L' the covariance of a series.

    Parameters
    ----------
    error : {"iid", "gp"}
        Error model.
    residuals : array (..., n_times)
        In the series' own unit; each last axis is one series.
    time_s : array (n_times,)
    parameters : mapping of name to scalar
        "sigma2", or "w" and "b".

    Returns
    -------
    array (..., n_times) or None
        None where the covariance has no Cholesky factor.
    """
    if error == "iid":
        return np.asarray(residuals / np.sqrt(float(np.asarray(parameters["sigma2"]))))
    with _one_thread():
        factor = _factor_at(time_s, float(np.asarray(parameters["w"])), float(np.asarray(parameters["b"])))
        if factor is None:
            return None
        rows = np.reshape(residuals, (-1, residuals.shape[-1]))
        return _whiten(factor, rows).reshape(residuals.shape)


def pointwise_log_likelihoods(
    error: str,
    study: Study,
    means: Array,
    parameters: Mapping[str, ArrayLike],
    decompositions: Sequence[str] = DECOMPOSITIONS,
) -> dict[str, Array]:
    """Log-likelihood terms of many posterior draws, in several decompositions.

    Parameters
    ----------
    error : {"iid", "gp"}
        Error model.
    study : Study
        Measured series and their times.
    means : array (n_draws, n_series, n_times)
        The solver's series at each draw, in their own units; NaN where a solve failed.
    parameters : mapping of name to array (n_draws,)
        "sigma2", or "w" and "b".
    decompositions : sequence of str
        Of "sequential", log p(y_i | y_<i); "leave-one-out", log p(y_i | y_-i); "joint", log p(y), the
        log-density of all observations together.

    Returns
    -------
    dict
        Decomposition -> array (n_draws, n_series, n_times), (n_draws,) for "joint"; -inf where a solve
        failed.

    Raises
    ------
    ValueError
        If a name is unknown.

    References
    ----------
    Buerkner, Gabry and Vehtari 2021, doi 10.1007/s00180-020-01045-4.
    """
    if error not in ERROR_PARAMETERS:
        raise ValueError(f"error = {error!r}: must be one of {', '.join(ERROR_PARAMETERS)}")
    for decomposition in decompositions:
        if decomposition not in DECOMPOSITIONS:
            raise ValueError(f"decomposition = {decomposition!r}: must be one of {', '.join(DECOMPOSITIONS)}")
    columns = [np.asarray(parameters[name], dtype=np.float64) for name in ERROR_PARAMETERS[error]]
    residuals = study.values - means
    solved = np.isfinite(residuals).all(axis=(1, 2))
    found = {
        name: np.full(means.shape[:1] if name == "joint" else means.shape, -np.inf) for name in decompositions
    }
    for i in np.flatnonzero(solved):
        values = [column[i] for column in columns]
        for name, terms in found.items():  # the draw's factorisation is kept from one to the next
            if error == "iid":
                term = iid_terms(residuals[i], *values)
            elif name == "leave-one-out":
                term = gp_leave_one_out(residuals[i], study.time_s, *values)
            else:
                term = gp_sequential(residuals[i], study.time_s, *values)
            terms[i] = term.sum() if name == "joint" else term
    return found


def pointwise_log_likelihood(
    error: str,
    study: Study,
    means: Array,
    parameters: Mapping[str, ArrayLike],
    decomposition: str = "sequential",
) -> Array:
    """`pointwise_log_likelihoods` in one decomposition."""
    return pointwise_log_likelihoods(error, study, means, parameters, (decomposition,))[decomposition]


# ---------------------------------------------------------------------------------------------------
# PyTensor and PyMC faces. The random variables are classes of this module (a pm.CustomDist makes its
# class on the fly), so that a model unpickled in another process still finds its log-density.


class GPTermsOp(Op):
    """`gp_sequential` as an operation without a gradient: residual (n_series, n_times), time_s, w, b."""

    __props__ = ()

    def make_node(self, *inputs: Any) -> Apply:
        """A matrix, a vector and two scalars in, a matrix out."""
        tensors = [pt.as_tensor_variable(x, dtype="float64") for x in inputs]
        ndims = [x.ndim for x in tensors]
        if ndims != [2, 1, 0, 0]:
            raise ValueError(f"dimensions {ndims} of residual, time_s, w, b: must be 2, 1, 0, 0")
        return Apply(self, tensors, [tensors[0].type()])

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[Any]]) -> None:
        """Evaluate, with the factorisation of the last few (w, b) kept."""
        residual, time_s, w, b = inputs
        output_storage[0][0] = gp_sequential(residual, time_s, w.item(), b.item())

    def infer_shape(self, fgraph: Any, node: Apply, input_shapes: list[tuple[Variable, ...]]) -> list[Any]:
        """That of the residual."""
        return [input_shapes[0]]

    def L_op(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], output_grads: Sequence[Variable]
    ) -> NoReturn:
        """Raise MissingGradientError."""
        raise MissingGradientError("the Gaussian process' log-likelihood")

    pullback = L_op  # its name in PyTensor 3


gp_terms = GPTermsOp()


class IidErrorsRV(RandomVariable):
    """Draws of `IidErrors`."""

    name = "iid_errors"
    signature = "(),(),()->()"
    dtype = "float64"
    _print_name = ("IidErrors", "\\operatorname{IidErrors}")

    @classmethod
    def rng_fn(cls, rng: np.random.Generator, mean: Array, ok: Any, sigma2: Array, size: Any = None) -> Array:
        """NaN where the solve failed."""
        draw = rng.normal(mean, np.sqrt(sigma2), size=size)
        return np.where(ok, draw, np.nan)


class IidErrors(Continuous):
    """Independent normal errors of variance sigma2 around the solver's series; density 0 where ok is 0."""

    rv_op = IidErrorsRV()

    @classmethod
    def dist(cls, mean: Any, ok: Any, sigma2: Any, **kwargs: Any) -> Any:
        """Mean (n_series, n_times), scalars ok and sigma2."""
        return super().dist([mean, ok, sigma2], **kwargs)

    def support_point(rv, size, mean, ok, sigma2):  # type: ignore[no-untyped-def]
        return mean

    def logp(value, mean, ok, sigma2):  # type: ignore[no-untyped-def]
        terms = -0.5 * (_LOG_2PI + pt.log(sigma2) + (value - mean) ** 2 / sigma2)
        return pt.switch(ok, terms, -np.inf)


class GPErrorsRV(RandomVariable):
    """Draws of `GPErrors`."""

    name = "gp_errors"
    signature = "(s,t),(),(t),(),()->(s,t)"
    dtype = "float64"
    _print_name = ("GPErrors", "\\operatorname{GPErrors}")

    @classmethod
    def rng_fn(
        cls, rng: np.random.Generator, mean: Array, ok: Any, time_s: Array, w: Any, b: Any, size: Any = None
    ) -> Array:
        """NaN where the solve failed or the covariance has no Cholesky factor."""

        def draw(mean: Array, ok: Any, time_s: Array, w: Any, b: Any) -> Array:
            factor = _factor_at(time_s, w, b) if ok else None
            if factor is None:
                return np.full(mean.shape, np.nan)
            return mean + rng.standard_normal(mean.shape) @ factor.triangle().T

        if size is not None:
            mean = np.broadcast_to(mean, (*size, *mean.shape[-2:]))
        with _one_thread():
            return np.asarray(np.vectorize(draw, signature=cls.signature)(mean, ok, time_s, w, b))


class GPErrors(Continuous):
    """Gaussian process with the neural-network kernel and fixed noise around each of the solver's series.

    The log-density is left as its sequential terms, (n_series, n_times); 0 density where ok is 0.
    """

    rv_op = GPErrorsRV()

    @classmethod
    def dist(cls, mean: Any, ok: Any, time_s: Any, w: Any, b: Any, **kwargs: Any) -> Any:
        """Mean (n_series, n_times), scalar ok, time_s (n_times,), scalars w and b."""
        return super().dist([mean, ok, time_s, w, b], **kwargs)

    def support_point(rv, size, mean, ok, time_s, w, b):  # type: ignore[no-untyped-def]
        return mean

    def logp(value, mean, ok, time_s, w, b):  # type: ignore[no-untyped-def]
        return pt.switch(ok, gp_terms(value - mean, time_s, w, b), -np.inf)


# ---------------------------------------------------------------------------------------------------
# What a model file uses


@dataclass(frozen=True)
class ModelRecord:
    """What a model is made of, as ``model.zoo``.

    `name` is "A" to "I" or a user's; `error` is "iid" or "gp"; `parameters` are the names of all free
    parameters, those of the errors last; `mean` and `ok` are the solver's symbolic outputs; `suggested`
    are values of the parameters that a search for the mode may start from.
    """

    name: str
    study: Study
    error: str
    parameters: tuple[str, ...]
    mean: TensorVariable
    ok: TensorVariable
    suggested: Mapping[str, float] = field(default_factory=dict)

    @property
    def op(self) -> BloodFlowOp:
        """The operation that solves."""
        op = self.mean.owner.op
        assert isinstance(op, BloodFlowOp)
        return op

    @property
    def wall(self) -> str:
        """Either "linear" or "tangent"."""
        return self.op.solver.wall

    @property
    def options(self) -> SolverOptions:
        """Numerical settings."""
        return self.op.solver.options

    @property
    def error_parameters(self) -> tuple[str, ...]:
        """Names of the parameters of the errors."""
        return ERROR_PARAMETERS[self.error]


def study_model(name: str, study: Study, suggested: Mapping[str, float] | None = None) -> pm.Model:
    """Empty PyMC model with the dimensions of a study: vessel (ids), series (labels), time (s).

    Parameters
    ----------
    name : str
        Of the model, for its record ``model.zoo``.
    study : Study
        Vessels and observations.
    suggested : mapping of name to float
        Values of the parameters to start from, for the record.

    Returns
    -------
    pm.Model
    """
    coords = {
        "vessel": [int(i) for i in Network.from_study(study).ids],
        "series": [series.label for series in study.series],
        "time": np.asarray(study.time_s),
    }
    model = pm.Model(coords=coords)
    model.zoo_identity = {"name": name, "suggested": dict(suggested or {})}
    return model


def iid_errors(mean: TensorVariable, ok: TensorVariable, study: Study) -> TensorVariable:
    """Observe the study's series with independent normal errors: adds "sigma2" and "y" to the model.

    y_i ~ N(mean_i, sigma2), sigma2 ~ InverseGamma(0.001, 0.001); density 0 where the solve failed.

    Parameters
    ----------
    mean, ok : TensorVariable
        From ``blood_flow``.
    study : Study
        Measured series, all of one quantity.

    Returns
    -------
    TensorVariable (n_series, n_times)
        "y".

    Raises
    ------
    ValueError
        If the series have different quantities.

    References
    ----------
    Paun et al. 2020, eq. (4.5), doi 10.1098/rsif.2020.0886.
    """
    quantities = sorted({series.quantity for series in study.series})
    if len(quantities) > 1:
        raise ValueError(
            f"{study.source}: study {study.name!r} observes {' and '.join(quantities)}: "
            "one sigma2 cannot hold for both; keep the series of one quantity"
        )
    shape, scale = INVERSE_GAMMA
    sigma2 = pm.InverseGamma("sigma2", shape, scale)
    y = IidErrors("y", mean, ok, sigma2, observed=study.values, dims=("series", "time"))
    _record("iid", mean, ok, study)
    return y


def gp_errors(
    mean: TensorVariable,
    ok: TensorVariable,
    study: Study,
    *,
    w_range: tuple[float, float] = W_RANGE,
    b_range: tuple[float, float] = B_RANGE,
) -> TensorVariable:
    """Observe the study's series with a Gaussian process around each: adds "w", "b" and "y" to the model.

    y ~ MVN(mean, K(w, b) + (2.44e-6 + 1e-6 mmHg2) I) with the neural-network kernel, independently for
    each series; w and b log-uniform; density 0 where the solve failed. The log-density of "y" is left
    as its sequential terms log p(y_i | y_<i), (n_series, n_times).

    Parameters
    ----------
    mean, ok : TensorVariable
        From ``blood_flow``.
    study : Study
        Measured pressures, mmHg.
    w_range : (lower, upper)
        Of the variance of the weights, s-2.
    b_range : (lower, upper)
        Of the variance of the bias.

    Returns
    -------
    TensorVariable (n_series, n_times)
        "y".

    Raises
    ------
    ValueError
        If a series is no pressure: the kernel's amplitude and the noise are in mmHg2.

    References
    ----------
    Paun et al. 2020, eq. (4.6), doi 10.1098/rsif.2020.0886.
    """
    for series in study.series:
        if series.quantity != "pressure_mmHg":
            raise ValueError(
                f"{study.source}: study {study.name!r} observes {series.label}: the Gaussian process' "
                "amplitude and noise are in mmHg2; keep the pressures only, or use independent errors"
            )
    w = LogUniform("w", *w_range)
    b = LogUniform("b", *b_range)
    y = GPErrors("y", mean, ok, study.time_s, w, b, observed=study.values, dims=("series", "time"))
    _record("gp", mean, ok, study)
    return y


def _record(error: str, mean: TensorVariable, ok: TensorVariable, study: Study) -> None:
    model = pm.modelcontext(None)
    model.zoo = ModelRecord(
        **getattr(model, "zoo_identity", {"name": "custom"}),
        study=study,
        error=error,
        parameters=tuple(rv.name for rv in model.free_RVs),
        mean=mean,
        ok=ok,
    )
