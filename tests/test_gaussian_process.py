"""The Gaussian process and independent errors: terms against brute force, PyMC variables, failed solves."""

from __future__ import annotations

import math

import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pytensor.tensor.linalg import cholesky, solve_triangular
from scipy import stats

from zoo.core.data import Data
from zoo.core.errors import gaussian_process
from zoo.core.errors.gaussian_process import (
    JITTER,
    NOISE_VARIANCE,
    GaussianProcess,
    gp_leave_one_out,
    gp_sequential,
    neural_network_kernel,
)
from zoo.core.errors.variables import Errors, ErrorTermsOp, IidErrors
from zoo.core.parameters import LogUniform

pytestmark = pytest.mark.filterwarnings(
    "ignore:For one or more samples the posterior variance",
    "ignore:The inplace keyword in DataFrame.sort_values",
)

PERIOD_S = 0.11
TIME_S = (np.arange(40) + 0.5) * PERIOD_S / 40
W, B = 5.4e4, 137.0
W_RANGE, B_RANGE = (1e4, 9e4), (1.0, 500.0)


def covariance(time_s: np.ndarray, w: float, b: float) -> np.ndarray:
    """Kernel and noise written out entry by entry."""

    def product(t: float, u: float) -> float:
        return 2 * (b + w * t * u)

    kernel = [
        [
            2 / math.pi * math.asin(product(t, u) / math.sqrt((1 + product(t, t)) * (1 + product(u, u))))
            for u in time_s
        ]
        for t in time_s
    ]
    return np.array(kernel) + (2.44e-6 + 1e-6) * np.eye(len(time_s))


def draw_residual(n_series: int = 2, seed: int = 0, time_s: np.ndarray = TIME_S) -> np.ndarray:
    root = np.linalg.cholesky(covariance(time_s, W, B))
    return np.random.default_rng(seed).standard_normal((n_series, len(time_s))) @ root.T


def observed(values: np.ndarray, times: np.ndarray = TIME_S, quantity: str = "pressure") -> Data:
    n = len(values)
    labels = [f"v{i + 1}@0 {quantity}" for i in range(n)]
    return Data(times[: values.shape[1]], values, labels, ["mmHg"] * n, [quantity] * n, source="s.toml")


def process(values: np.ndarray, times: np.ndarray = TIME_S) -> GaussianProcess:
    return GaussianProcess(LogUniform(*W_RANGE), LogUniform(*B_RANGE), unit="mmHg").bind(
        observed(values, times)
    )


# the kernel


def test_kernel_is_the_written_out_formula() -> None:
    expected = covariance(TIME_S, W, B) - (NOISE_VARIANCE + JITTER) * np.eye(len(TIME_S))
    np.testing.assert_allclose(neural_network_kernel(TIME_S, W, B), expected, rtol=0, atol=1e-13)


def test_kernel_between_two_sets_of_times_is_a_block_of_the_whole() -> None:
    block = neural_network_kernel(TIME_S[:7], W, B, TIME_S[7:])
    np.testing.assert_allclose(block, neural_network_kernel(TIME_S, W, B)[:7, 7:], rtol=0, atol=1e-14)


def test_kernel_is_the_covariance_of_a_wide_random_network() -> None:
    # Williams 1998: erf units with normal weights; (2/pi) asin(...) is E[erf(a + v t) erf(a + v t')]
    rng = np.random.default_rng(3)
    t, u, w, b = 0.02, 0.07, 300.0, 0.5
    bias, weight = math.sqrt(b) * rng.standard_normal(400_000), math.sqrt(w) * rng.standard_normal(400_000)
    from scipy.special import erf

    sample = erf(bias + weight * t) * erf(bias + weight * u)
    [[k]] = neural_network_kernel([t], w, b, [u])
    assert abs(sample.mean() - k) < 5 * sample.std() / math.sqrt(len(sample))


# sequential and leave-one-out terms


@given(
    w=st.floats(1e4, 9e4),
    b=st.floats(1.0, 500.0),
    n=st.integers(2, 40),
    n_series=st.integers(1, 3),
    seed=st.integers(0, 1000),
)
@settings(max_examples=40, deadline=None)
def test_sequential_terms_add_up_to_the_multivariate_normal(
    w: float, b: float, n: int, n_series: int, seed: int
) -> None:
    residual = draw_residual(n_series, seed)[:, :n]
    joint = stats.multivariate_normal(np.zeros(n), covariance(TIME_S[:n], w, b))
    expected = np.atleast_1d(joint.logpdf(residual))
    np.testing.assert_allclose(
        gp_sequential(residual, TIME_S[:n], w, b).sum(axis=1), expected, rtol=1e-6, atol=1e-4
    )


def conditional(residual: np.ndarray, k: np.ndarray, i: int, given_index: np.ndarray) -> float:
    """log p(y_i | y_given) by conditioning the normal distribution."""
    if len(given_index) == 0:
        return float(stats.norm.logpdf(residual[i], 0, math.sqrt(k[i, i])))
    gain = np.linalg.solve(k[np.ix_(given_index, given_index)], k[given_index, i])
    variance = k[i, i] - gain @ k[given_index, i]
    return float(stats.norm.logpdf(residual[i], gain @ residual[given_index], math.sqrt(variance)))


def test_each_sequential_term_is_the_density_given_the_past() -> None:
    residual, k = draw_residual(), covariance(TIME_S, W, B)
    terms = gp_sequential(residual, TIME_S, W, B)
    for row, series in zip(terms, residual, strict=True):
        expected = [conditional(series, k, i, np.arange(i)) for i in range(len(TIME_S))]
        np.testing.assert_allclose(row, expected, rtol=1e-6, atol=1e-6)


def test_terms_at_the_size_of_the_measured_series() -> None:
    time_s = (np.arange(512) + 0.25) * PERIOD_S / 512
    residual = draw_residual(1, 5, time_s)
    k = covariance(time_s, W, B)
    expected = stats.multivariate_normal(np.zeros(512), k).logpdf(residual)
    assert gp_sequential(residual, time_s, W, B).sum() == pytest.approx(expected, rel=1e-6)
    inverse = np.linalg.inv(k)
    v = 1 / np.diag(inverse)
    expected_terms = stats.norm.logpdf((inverse @ residual[0]) * v, 0, np.sqrt(v))
    np.testing.assert_allclose(
        gp_leave_one_out(residual, time_s, W, B)[0], expected_terms, rtol=1e-5, atol=1e-5
    )


@pytest.mark.parametrize(("w", "b"), [(math.nan, B), (W, math.nan), (-1.0, B), (W, 0.0), (math.inf, B)])
def test_no_nan_where_there_is_no_covariance(w: float, b: float) -> None:
    residual = draw_residual()
    assert np.all(gp_sequential(residual, TIME_S, w, b) == -np.inf)
    assert np.all(gp_leave_one_out(residual, TIME_S, w, b) == -np.inf)


def test_terms_are_finite_over_the_whole_prior_box() -> None:
    time_s = (np.arange(512) + 0.25) * PERIOD_S / 512
    for w in W_RANGE:
        for b in B_RANGE:
            assert np.all(np.isfinite(gp_sequential(np.full((1, 512), 100.0), time_s, w, b)))


def test_one_factorisation_for_repeated_w_and_b() -> None:
    gaussian_process._factor.cache_clear()
    for residual in (draw_residual(1), draw_residual(3), draw_residual(2, 9)):
        gp_sequential(residual, TIME_S, W, B)
        gp_leave_one_out(residual, TIME_S, W, B)
    assert gaussian_process._factor.cache_info().misses == 1
    gp_sequential(draw_residual(), TIME_S, W + 1, B)
    assert gaussian_process._factor.cache_info().misses == 2


def test_the_noise_of_the_error_model_is_that_of_the_published_code() -> None:
    """2.44e-6 and a jitter of 1e-6 on the diagonal, in the density too."""
    t = np.linspace(0.0, 0.1, 12)
    bound = GaussianProcess(LogUniform(1e4, 9e4), LogUniform(1, 500)).bind(Data(t, np.zeros((1, 12))))
    at = {"w": 5e4, "b": 100.0}
    K = neural_network_kernel(t, 5e4, 100.0)
    np.testing.assert_allclose(bound.variance(at)[0] - np.diag(K), 3.44e-6, rtol=1e-6)
    residual = 1e-3 * np.random.default_rng(1).standard_normal(12)
    wanted = stats.multivariate_normal(np.zeros(12), K + 3.44e-6 * np.eye(12)).logpdf(residual)
    assert bound.log_density(residual[None], at) == pytest.approx(wanted, rel=1e-6)


def test_an_unknown_decomposition_is_refused() -> None:
    errors, means = process(draw_residual()), np.zeros((1, 2, 40))
    with pytest.raises(ValueError, match=r"decomposition = 'loo': must be one of sequential, leave-one-out,"):
        errors.pointwise(means, {"w": [W], "b": [B]}, ("loo",))


# PyTensor and PyMC faces


def reference_terms(
    residual: pt.TensorVariable, time_s: np.ndarray, w: pt.TensorVariable, b: pt.TensorVariable
):
    """The sequential terms in plain PyTensor."""
    t = pt.constant(time_s)
    norm = 1 + 2 * (b + w * t * t)
    inner = 2 * (b + w * t[:, None] * t[None, :]) / pt.sqrt(norm[:, None] * norm[None, :])
    k = 2 / np.pi * pt.arcsin(inner) + (NOISE_VARIANCE + JITTER) * pt.eye(len(time_s))
    root = cholesky(k, lower=True)
    z = solve_triangular(root, residual.T, lower=True).T
    return -0.5 * (np.log(2 * np.pi) + z**2) - pt.log(pt.diag(root))


def test_op_checks_dimensions_and_knows_its_shape() -> None:
    gp_terms = ErrorTermsOp(process(draw_residual(3)))
    with pytest.raises(ValueError, match="of residual, w, b: must be 2, 0, 0"):
        gp_terms(pt.dvector(), W, B)
    residual = pt.dmatrix()
    shape = pytensor.function([residual], gp_terms(residual, W, B).shape)
    assert not any(isinstance(node.op, ErrorTermsOp) for node in shape.maker.fgraph.apply_nodes)
    assert tuple(shape(np.zeros((3, 40)))) == (3, 40)


def test_draws_of_the_gp_have_its_covariance() -> None:
    n = 8
    errors = process(np.zeros((2, n)), TIME_S[::5])
    y = Errors.dist(np.full((2, n), 3.0), np.int8(1), 2e4, 5.0, errors=errors)
    draws = pm.draw(y, draws=4000, random_seed=2).reshape(-1, n)
    k = covariance(TIME_S[::5], 2e4, 5.0)
    np.testing.assert_allclose(draws.mean(axis=0), 3.0, atol=5 / math.sqrt(len(draws)))
    np.testing.assert_allclose(np.cov(draws.T), k, atol=8 / math.sqrt(len(draws)))
    assert stats.kstest(((draws - 3) @ np.linalg.inv(np.linalg.cholesky(k)).T).ravel(), "norm").pvalue > 1e-3


def test_draws_of_a_given_size() -> None:
    errors = process(np.zeros((2, 8)))
    gp = Errors.dist(np.zeros((2, 8)), np.int8(1), W, B, errors=errors, size=(3,))
    assert pm.draw(gp, random_seed=1).shape == (3, 2, 8)
    iid = IidErrors.dist(np.zeros((2, 8)), np.int8(1), 0.5, size=(3, 2, 8))
    draws = pm.draw(iid, draws=200, random_seed=1)
    assert draws.shape == (200, 3, 2, 8)
    assert draws.var() == pytest.approx(0.5, rel=0.05)
