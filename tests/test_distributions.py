"""Distributions that PyMC does not have, against SciPy."""

from __future__ import annotations

import numpy as np
import pymc as pm
import pytest
from scipy import stats

from zoo.core.distributions import LogUniform
from zoo.core.draws import LARGEST_DRAW, inverse_gamma_draws


def test_log_uniform_against_scipy() -> None:
    x = np.array([0.5, 1.0, 7.0, 499.9, 501.0])
    distribution = LogUniform.dist(1.0, 500.0)
    np.testing.assert_allclose(pm.logp(distribution, x).eval(), stats.loguniform(1, 500).logpdf(x))
    draws = pm.draw(distribution, draws=2000, random_seed=4)
    assert stats.kstest(draws, stats.loguniform(1, 500).cdf).pvalue > 1e-3


def test_log_uniform_is_logistic_in_the_unconstrained_space() -> None:
    with pm.Model() as model:
        LogUniform("b", 1.0, 500.0)
    logp = model.compile_logp()
    for value in (-3.0, 0.0, 2.5):
        assert float(logp({"b_chain__": value})) == pytest.approx(stats.logistic.logpdf(value))


@pytest.mark.parametrize("scale", [0.001, np.float32(0.001)])
def test_draws_of_a_vague_inverse_gamma_are_numbers(scale: float) -> None:
    """Half of them are larger than a double can be: P(X > x) = P(gamma < scale/x)."""
    draws = inverse_gamma_draws(np.random.default_rng(2), 0.001, scale, 4000)
    assert np.all(draws <= LARGEST_DRAW * (1 + 1e-6))
    beyond = float(stats.gamma(0.001).cdf(0.001 / LARGEST_DRAW))
    assert np.mean(draws > 0.99 * LARGEST_DRAW) == pytest.approx(beyond, abs=0.03)
