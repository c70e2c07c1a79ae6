"""The error model in harmonics, against dense covariance matrices."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import circulant
from scipy.stats import multivariate_normal

from zoo import load_study
from zoo.blood.study import Series, Study
from zoo.core.diagnosis.discrepancy import (
    Errors,
    HarmonicError,
    Harmonics,
    fit_noise,
    log_density,
    marginal,
    smooth_part,
)

QUANTITY = "pressure_mmHg"


def study_of(values: np.ndarray, quantity: str = QUANTITY) -> Study:
    demo = load_study("demo")
    n = values.shape[1]
    vessels = [v.id for v in demo.vessels]
    series = tuple(Series(vessels[i], 0.5, quantity, row) for i, row in enumerate(values))
    return replace(demo, time_s=np.arange(n) * demo.period_s / n, series=series)


def dense(H: Harmonics, errors: Errors, n_series: int, *, noise: bool = True) -> np.ndarray:
    """Covariance of all series in time, from autocovariances that are summed over harmonics here."""
    n, T = H.n, H.period_s
    k = np.minimum(np.arange(n), n - np.arange(n))
    omega = 2 * np.pi * k / T
    lags = np.cos(2 * np.pi * np.outer(np.arange(n), np.arange(n)) / n)

    def covariance(f: np.ndarray) -> np.ndarray:
        return np.asarray(circulant(lags @ (f / f.sum())))

    own = np.zeros((n, n))
    if noise:
        own = errors.sigma**2 * (
            np.eye(n) + errors.ratio**2 * covariance(1 / (1 + (omega * errors.tau) ** 2))
        )
    smooth = errors.delta**2 * covariance(np.exp(-0.5 * (omega * errors.length) ** 2))
    between = errors.shared + (1 - errors.shared) * np.eye(n_series)
    return np.asarray(np.kron(np.eye(n_series), own) + np.kron(between, smooth))


@pytest.mark.parametrize("n", [16, 17])
def test_harmonics_are_orthonormal_and_invertible(n: int) -> None:
    rng = np.random.default_rng(1)
    y = rng.standard_normal((3, n))
    H = Harmonics(study_of(y))
    z = H(y)
    assert z.shape == (3 * n,)
    assert np.sum(z**2) == pytest.approx(np.sum(y**2))
    np.testing.assert_allclose(H.back(z), y, atol=1e-12)
    np.testing.assert_allclose(H(np.stack([y, 2 * y])), np.stack([z, 2 * z]), atol=1e-12)


@pytest.mark.parametrize("n", [16, 17])
def test_density_is_that_of_the_dense_covariance(n: int) -> None:
    rng = np.random.default_rng(2)
    y = rng.standard_normal((3, n))
    H = Harmonics(study_of(y))
    errors = Errors(0.5, 0.8, 0.004, 0.7, 0.01, 0.6)
    wanted = multivariate_normal(np.zeros(3 * n), dense(H, errors, 3)).logpdf(y.ravel())
    assert log_density(H(y), H.variances({QUANTITY: errors})) == pytest.approx(wanted, rel=1e-10)


def test_smooth_part_is_the_conditional_mean() -> None:
    rng = np.random.default_rng(3)
    y = rng.standard_normal((2, 16))
    H = Harmonics(study_of(y))
    errors = Errors(0.5, 0.3, 0.004, 0.9, 0.02, 0.4)
    own, total = dense(H, errors, 2, noise=False), dense(H, errors, 2)
    mean, variance = smooth_part(H, H(y), {QUANTITY: errors})
    np.testing.assert_allclose(H.back(mean).ravel(), own @ np.linalg.solve(total, y.ravel()), atol=1e-10)
    wanted = np.trace(own - own @ np.linalg.solve(total, own))
    assert variance.sum() == pytest.approx(wanted, rel=1e-9)


def test_marginal_likelihood_is_that_of_the_joint_normal() -> None:
    """With a normal prior of mean m: r = J d + e is normal with covariance S + J P^-1 J'."""
    rng = np.random.default_rng(4)
    J, r, S = rng.standard_normal((20, 3)), rng.standard_normal(20), rng.uniform(0.5, 2, 20)
    precision, mean = np.array([1.0, 4.0, 0.25]), np.array([0.3, -0.2, 1.0])
    log_z, step, C = marginal(r, J, S, precision, -precision * mean)
    # the prior density at d = 0, which `marginal` leaves out
    constant = float(np.sum(0.5 * np.log(precision / (2 * math.pi)) - 0.5 * precision * mean**2))
    wanted = multivariate_normal(J @ mean, np.diag(S) + J @ np.diag(1 / precision) @ J.T).logpdf(r)
    assert log_z + constant == pytest.approx(wanted, rel=1e-10)
    H = J.T @ (J / S[:, None]) + np.diag(precision)
    np.testing.assert_allclose(C, np.linalg.inv(H), rtol=1e-8)
    np.testing.assert_allclose(step, np.linalg.solve(H, J.T @ (r / S) + precision * mean), rtol=1e-8)


def test_many_variances_at_once_give_the_same() -> None:
    rng = np.random.default_rng(6)
    J, r, S = rng.standard_normal((20, 3)), rng.standard_normal(20), rng.uniform(0.5, 2, (4, 2, 20))
    together = marginal(r, J, S, np.ones(3), np.zeros(3))
    for i, j in np.ndindex(4, 2):
        for whole, one in zip(together, marginal(r, J, S[i, j], np.ones(3), np.zeros(3)), strict=True):
            np.testing.assert_allclose(whole[i, j], one, rtol=1e-9)


def test_noise_is_recovered() -> None:
    rng = np.random.default_rng(5)
    H = Harmonics(study_of(np.zeros((3, 512))))
    T = H.period_s
    true = Errors(0.05, 0.8, 0.04 * T)
    z = np.sqrt(H.variances({QUANTITY: true})) * rng.standard_normal(H.size)
    found = fit_noise(H, z, QUANTITY, Errors(1.0))
    assert found.sigma == pytest.approx(true.sigma, rel=0.1)
    assert found.noise == pytest.approx(true.noise, rel=0.1)
    beside = fit_noise(H, z, QUANTITY, Errors(1.0, length=0.05 * T), free_delta=True, scale=0.02)
    assert beside.delta < 0.03


def test_a_study_without_series_is_refused() -> None:
    with pytest.raises(HarmonicError, match=r"has 0 series .* add observations\.csv"):
        Harmonics(replace(load_study("demo"), series=()))
