"""The paper's tests of convergence against draws whose law is known."""

from __future__ import annotations

import numpy as np
import pytest

from gaussian import autoregressive
from zoo.core.inference.record import ResultsError
from zoo.paper.convergence import geweke, mpsrf


def test_geweke_is_uniform_for_stationary_chains_and_small_for_a_drift():
    rng = np.random.default_rng(11)
    p = geweke(autoregressive(rng, 400, 600, 0.5))
    # a part of 60 correlated draws is short: the test is a little too strict, not wrong
    assert 0.03 < np.mean(p < 0.05) < 0.12
    assert 0.4 < np.mean(p < 0.5) < 0.6
    drifting = autoregressive(rng, 20, 600, 0.5) + np.linspace(0, 3, 600)
    assert np.all(geweke(drifting) < 0.02)
    assert np.isnan(geweke(np.ones((1, 50)))[0])
    with pytest.raises(ResultsError, match="too few"):
        geweke(np.zeros((4, 39)))


@pytest.mark.parametrize(("phi", "expected"), [(0.908, 0.09), (0.724, 0.06)])
def test_geweke_with_few_effective_draws_is_below_a_twentieth_more_often(phi: float, expected: float):
    """Effective sizes of 120 and 400 a chain: the numbers in docs/statistics.md."""
    p = geweke(autoregressive(np.random.default_rng(12), 2000, 2500, phi))
    assert np.mean(p < 0.05) == pytest.approx(expected, abs=0.015)


def test_mpsrf_of_one_scalar_is_the_classical_factor_and_bounds_those_of_many():
    rng = np.random.default_rng(12)
    x = rng.normal(size=(4, 200)) + np.array([0.0, 0.1, 0.2, 0.5])[:, None]
    n, m = 200, 4
    within, between = x.var(axis=1, ddof=1).mean(), x.mean(axis=1).var(ddof=1)
    classical = (n - 1) / n + (m + 1) / m * between / within
    assert mpsrf({"x": x}) == pytest.approx(classical)
    assert mpsrf({"x": 1e6 * x + 3}) == pytest.approx(classical)
    y = rng.normal(size=(4, 200, 3))
    both = mpsrf({"x": x, "y": y, "constant": np.ones((4, 200))})
    assert both >= classical
    assert mpsrf({"y": rng.normal(size=(4, 5000, 3))}) == pytest.approx(1, abs=0.01)
    assert np.isnan(mpsrf({"x": x[:1]}))


def test_chains_that_hardly_moved_have_no_scale_reduction() -> None:
    """Draws on one line: the covariance of two parameters within the chains is singular."""
    steps = np.random.default_rng(3).standard_normal((4, 10))
    starts = np.array([[0.0], [1.0], [2.0], [3.0]])
    assert mpsrf({"a": steps + starts, "b": 2 * steps - starts}) == np.inf
