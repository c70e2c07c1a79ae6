"""Priors as values and as variables of PyMC: their densities, quantiles and draws, against SciPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pymc as pm
import pytest
from pymc.model_graph import ModelGraph
from scipy import stats

from zoo import load_study
from zoo.core.distributions import LogUniform as LogUniformVariable
from zoo.core.distributions import TruncatedLogNormal
from zoo.core.parameters import (
    InverseGamma,
    LogNormal,
    LogUniform,
    Normal,
    Parameter,
    ParameterError,
    Population,
    Prior,
    Uniform,
    as_prior,
    random_variables,
)
from zoo.models import MODELS, get_model


class Between:
    """A distribution given that it is in (a, b): (F(x) - F(a))/(F(b) - F(a))."""

    def __init__(self, whole: Any, a: float, b: float) -> None:
        self.whole, self.low, self.mass = whole, whole.cdf(a), whole.cdf(b) - whole.cdf(a)

    def cdf(self, x: Any) -> Any:
        return (self.whole.cdf(x) - self.low) / self.mass

    def ppf(self, p: Any) -> Any:
        return self.whole.ppf(self.low + self.mass * p)

    def logpdf(self, x: Any) -> Any:
        return self.whole.logpdf(x) - math.log(self.mass)

    def median(self) -> Any:
        return self.ppf(0.5)


GIVEN = {"m": np.asarray(3.0), "v": np.asarray(0.7)}
LAWS = {
    "uniform": (Uniform(2.0, 5.0), stats.uniform(2.0, 3.0)),
    "log-uniform": (LogUniform(2e4, 4e5), stats.loguniform(2e4, 4e5)),
    "normal": (Normal(1.0, 2.0), stats.norm(1.0, 2.0)),
    "truncated normal": (Normal(1.0, 2.0, -1.0, 4.0), stats.truncnorm(-1.0, 1.5, 1.0, 2.0)),
    "upper tail of a normal": (Normal(0.0, 1.0, 6.0, 9.0), stats.truncnorm(6.0, 9.0)),
    "log-normal": (LogNormal(0.3, 0.8), stats.lognorm(0.8, scale=0.3)),
    "truncated log-normal": (LogNormal(0.3, 0.8, 0.1, 1.0), Between(stats.lognorm(0.8, scale=0.3), 0.1, 1.0)),
    "inverse gamma": (InverseGamma(3.0, 7.78), stats.invgamma(3.0, scale=7.78)),
    "population": (
        Population("m", "v", unit=2.0),
        stats.truncnorm(-3.0 / (2 * math.sqrt(0.7)), math.inf, 3.0, 2 * math.sqrt(0.7)),
    ),
}


@pytest.mark.parametrize("law", LAWS)
def test_quantiles_and_densities_are_those_of_the_distribution(law: str) -> None:
    """SciPy's; the curvature is that of differences of the density, which a search may ask for anywhere."""
    prior, reference = LAWS[law]
    p = np.array([1e-6, 0.01, 0.3, 0.5, 0.9, 0.999])
    x = prior.quantile(p, GIVEN)
    np.testing.assert_allclose(x, reference.ppf(p), rtol=1e-6)
    assert float(prior.quantile(0.5, GIVEN)) == pytest.approx(reference.median())
    low, high = prior.support
    np.testing.assert_allclose(prior.quantile([0.0, 1.0], GIVEN), [low, high], atol=1e-12)
    inner = x[1:]
    assert prior.log_density(inner, GIVEN) == pytest.approx(reference.logpdf(inner).sum(), rel=1e-9)
    slope, curvature = prior.curvature(inner, GIVEN)
    for value, first, second in zip(inner, slope, curvature, strict=True):
        h = 1e-4 * abs(value)
        below, here, above = (prior.log_density(np.array([value + d]), GIVEN) for d in (-h, 0.0, h))
        scale = 1e-4 / value**2
        assert first == pytest.approx((above - below) / (2 * h), rel=1e-4, abs=1e-6 / abs(value))
        assert second == pytest.approx((2 * here - above - below) / h**2, rel=1e-3, abs=scale)
    draws = prior.draw(np.random.default_rng(3), 4000, GIVEN)
    assert stats.kstest(draws, reference.cdf).pvalue > 1e-3


# ---------------------------------------------------------------------------------------------------
# A population above zero

POPULATION = (
    Parameter("m", Normal(6.0, 1.5)),
    Parameter("v", InverseGamma(3.0, 8.0)),
    Parameter("chi", Population("m", "v", unit=2.0), dims="vessel", size=3),
)


def differences(f: Callable[[np.ndarray], float], at: np.ndarray, h: float = 1e-4) -> tuple[Any, Any]:
    """Gradient and Hessian by central differences."""
    eye = h * np.eye(len(at))
    first = np.array([f(at + s) - f(at - s) for s in eye]) / (2 * h)
    second = [[f(at + s + r) - f(at + s - r) - f(at - s + r) + f(at - s - r) for r in eye] for s in eye]
    return first, np.array(second) / (4 * h * h)


@pytest.mark.parametrize("mean", [-1.5, 0.7, 4.0])
def test_derivatives_of_a_population_are_those_of_differences(mean: float) -> None:
    """Where Phi(m/s) is 0.2, 0.65 and 0.99: with respect to its elements, mean and variance."""
    prior = Population("m", "v", unit=2.0)
    at = np.array([mean, 0.8, 0.4, 2.5, 5.0])

    def density(theta: np.ndarray) -> float:
        return prior.log_density(theta[2:], {"m": theta[0], "v": theta[1]})

    gradient, hessian = differences(density, at)
    given = {"m": at[0], "v": at[1]}
    slope, curvature = prior.curvature(at[2:], given)
    first, second, cross = prior.dependence(at[2:], given)
    np.testing.assert_allclose(np.concatenate([first, slope]), gradient, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(second, -hessian[:2, :2], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(cross, -hessian[2:, :2], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(curvature, -np.diag(hessian)[2:], rtol=1e-5, atol=1e-5)


def test_a_population_is_sampled_as_its_logarithm() -> None:
    with pm.Model(coords={"vessel": [0, 1, 2]}) as model:
        random_variables(POPULATION)
    point = model.initial_point()
    assert set(point) == {"m", "v_log__", "chi_log__"}
    np.testing.assert_allclose(np.exp(point["chi_log__"]), 6.0)  # at its mean


@pytest.mark.parametrize(
    ("variable", "reference"),
    [
        (LogUniformVariable.dist(1.0, 500.0), stats.loguniform(1, 500)),
        (
            TruncatedLogNormal.dist(math.log(0.3), 0.8, math.log(0.1), 0.0),
            Between(stats.lognorm(0.8, scale=0.3), 0.1, 1.0),
        ),
    ],
)
def test_distributions_that_pymc_lacks_are_scipys(variable: Any, reference: Any) -> None:
    x = reference.ppf(np.array([0.0, 0.1, 0.5, 0.9]))
    np.testing.assert_allclose(pm.logp(variable, x[1:]).eval(), reference.logpdf(x[1:]))
    assert np.all(pm.logp(variable, [0.999 * x[0], 501.0]).eval() == -np.inf)
    assert stats.kstest(pm.draw(variable, draws=2000, random_seed=4), reference.cdf).pvalue > 1e-3


def test_log_uniform_is_logistic_in_the_unconstrained_space() -> None:
    with pm.Model() as model:
        LogUniform(1.0, 500.0).variable("b", {})
    logp = model.compile_logp()
    for value in (-3.0, 0.0, 2.5):
        assert float(logp({"b_chain__": value})) == pytest.approx(stats.logistic.logpdf(value))


def test_a_vague_inverse_gamma_can_be_drawn() -> None:
    """Half of its draws are beyond the largest double; the others have its law."""
    with pm.Model():
        vague = InverseGamma(0.001, 0.001).variable("x", {})
    for draws in (
        pm.draw(vague, draws=2000, random_seed=1),
        InverseGamma(0.001, 0.001).draw(np.random.default_rng(1), 2000, {}),
    ):
        assert np.all(np.isfinite(draws))
        assert np.all(draws > 0)
        for limit in (1.0, 1e100, 1e200):
            expected = float(stats.invgamma(0.001, scale=0.001).cdf(limit))
            assert np.mean(draws < limit) == pytest.approx(expected, abs=0.04)


@pytest.mark.parametrize("name", MODELS)
def test_every_model_can_be_drawn_from(name: str) -> None:
    model = get_model(name)(load_study("demo"))
    ModelGraph(model).get_plates()  # what pm.model_to_graphviz draws
    found = pm.sample_prior_predictive(2, model=model, random_seed=3)
    assert found.prior_predictive["y"].shape == (1, 2, *model.zoo.data.values.shape)
    assert all(np.all(np.isfinite(values)) for values in found.prior.values())


@pytest.mark.parametrize(
    "prior",
    [
        LogNormal(1e5, 1.0, 2e5, 4e5),
        LogNormal(3e5, 1.0, 2e5, 4e5),
        LogNormal(1e5, 1.0, 0.0, 5e4),
        LogNormal(1e5, 1.0, 2e5),
        Normal(0.0, 1.0, 0.5, 2.0),
        Normal(5.0, 1.0, high=2.0),
    ],
)
def test_a_search_begins_inside_the_bounds_wherever_these_are(prior: Prior) -> None:
    low, high = prior.support
    assert low < Parameter("x", prior).first < high
    with pm.Model(coords={"place": range(3)}) as model:
        prior.variable("x", {})
        prior.variable("y", {}, dims="place")
    assert all(np.all(np.isfinite(value)) for value in model.initial_point().values())
    assert np.isfinite(model.compile_logp()(model.initial_point()))
    assert np.shape(model.initial_point(0)[model.rvs_to_values[model["y"]].name]) == (3,)


def test_bounds_that_count_are_told() -> None:
    assert LogNormal(1e5, 1.0).text == "log-normal(100000, 1)"
    assert LogNormal(1e5, 1.0, 1e2).text == "log-normal(100000, 1)"  # a thousandth of the mass at most
    assert LogNormal(1e5, 1.0, 2e4, 4e5).text == "log-normal(100000, 1) in [20000, 400000]"


@pytest.mark.parametrize(
    ("frozen", "ours"),
    [
        (stats.norm(2.0, 0.5), Normal(2.0, 0.5)),
        (stats.uniform(loc=1.0, scale=3.0), Uniform(1.0, 4.0)),
        (stats.invgamma(3.0, scale=2.0), InverseGamma(3.0, 2.0)),
        (stats.lognorm(0.4, scale=2.0), LogNormal(2.0, 0.4)),
    ],
    ids=lambda x: getattr(x, "text", ""),
)
def test_a_frozen_distribution_of_scipy_is_the_prior_of_its_name(frozen: Any, ours: Prior) -> None:
    """Against the priors of zoo, whose derivatives are exact."""
    theirs = as_prior(frozen)
    assert as_prior(ours) is ours
    assert theirs == as_prior(frozen)
    assert theirs.support == pytest.approx(ours.support)
    p = np.array([0.05, 0.3, 0.5, 0.9])
    x = ours.quantile(p)
    np.testing.assert_allclose(theirs.quantile(p), x)
    assert theirs.log_density(x, {}) == pytest.approx(ours.log_density(x, {}))
    for mine, exact in zip(theirs.curvature(x, {}), ours.curvature(x, {}), strict=True):
        np.testing.assert_allclose(mine, exact, rtol=1e-3, atol=1e-3)
    with pm.Model() as model:
        theirs.variable("x", {})
    drawn = pm.draw(model["x"], 4000, random_seed=1)
    assert stats.kstest(drawn, frozen.cdf).pvalue > 1e-3
    log_density = pm.logp(model["x"], x[1:3]).eval()
    np.testing.assert_allclose(log_density, frozen.logpdf(x[1:3]), atol=0.01)


def test_what_is_no_continuous_distribution_is_no_prior() -> None:
    for given in (stats.poisson(3.0), stats.norm, 2.0):
        with pytest.raises(ParameterError, match="or a frozen continuous distribution of SciPy"):
            as_prior(given)
