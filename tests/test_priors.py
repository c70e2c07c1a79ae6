"""Priors as values: their distribution functions and quantiles, against SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from zoo.core.parameters import InverseGamma, LogNormal, LogUniform, Normal, Population, Uniform

GIVEN = {"m": np.asarray(3.0), "v": np.asarray(0.7)}
LAWS = {
    "uniform": (Uniform(2.0, 5.0), stats.uniform(2.0, 3.0)),
    "log-uniform": (LogUniform(2e4, 4e5), stats.loguniform(2e4, 4e5)),
    "normal": (Normal(1.0, 2.0), stats.norm(1.0, 2.0)),
    "truncated normal": (Normal(1.0, 2.0, -1.0, 4.0), stats.truncnorm(-1.0, 1.5, 1.0, 2.0)),
    "upper tail of a normal": (Normal(0.0, 1.0, 6.0, 9.0), stats.truncnorm(6.0, 9.0)),
    "log-normal": (LogNormal(0.3, 0.8), stats.lognorm(0.8, scale=0.3)),
    "inverse gamma": (InverseGamma(3.0, 7.78), stats.invgamma(3.0, scale=7.78)),
    "population": (
        Population("m", "v", unit=2.0),
        stats.truncnorm(-3.0 / (2 * math.sqrt(0.7)), math.inf, 3.0, 2 * math.sqrt(0.7)),
    ),
}


@pytest.mark.parametrize("law", LAWS)
def test_quantiles_and_distribution_functions_are_scipys(law: str) -> None:
    prior, reference = LAWS[law]
    p = np.array([1e-6, 0.01, 0.3, 0.5, 0.9, 0.999])
    x = prior.quantile(p, GIVEN)
    np.testing.assert_allclose(x, reference.ppf(p), rtol=1e-6)
    np.testing.assert_allclose(prior.cdf(x, GIVEN), p, rtol=1e-8)
    assert float(prior.quantile(0.5, GIVEN)) == pytest.approx(reference.median())


@pytest.mark.parametrize("law", LAWS)
def test_no_mass_lies_outside_the_support(law: str) -> None:
    prior, _ = LAWS[law]
    low, high = prior.support
    outside = [max(low, -1e300) - 1.0, low, high, min(high, 1e300) * 2.0]
    np.testing.assert_array_equal(prior.cdf(outside, GIVEN), [0.0, 0.0, 1.0, 1.0])
    np.testing.assert_allclose(prior.quantile([0.0, 1.0], GIVEN), [low, high], atol=1e-12)


def test_mass_inside_bounds_of_a_log_normal() -> None:
    """Truncated to (a, b): (F(x) - F(a))/(F(b) - F(a))."""
    whole, prior = stats.lognorm(0.8, scale=0.3), LogNormal(0.3, 0.8, 0.1, 1.0)
    x = np.array([0.15, 0.3, 0.7])
    a, b = whole.cdf([0.1, 1.0])
    np.testing.assert_allclose(prior.cdf(x), (whole.cdf(x) - a) / (b - a), rtol=1e-12)
    np.testing.assert_allclose(prior.quantile(prior.cdf(x)), x, rtol=1e-10)
