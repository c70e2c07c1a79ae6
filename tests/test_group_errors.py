"""Noise, and a Gaussian process, for each group of series: densities, units, priors, recovery."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pymc as pm
import pytest
from numpy.typing import NDArray
from scipy import stats

from test_op import small_study
from zoo.blood.predictive import bands, predictive_draws, vessel_waves
from zoo.blood.study import Study, load_study
from zoo.core.data import Data
from zoo.core.errors.base import ErrorModelError
from zoo.core.errors.groups import GroupNoise, GroupProcess
from zoo.core.errors.independent import Independent
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.inference.mode import find_mode
from zoo.core.inference.sampling import sample
from zoo.core.model import bayesian_model
from zoo.core.parameters import LogNormal, LogUniform, Normal, Parameter, log_prior
from zoo.core.posterior.comparison import compare
from zoo.models import get_model

Array = NDArray[np.float64]

N = 24
GROUPS = ("p", "q", "p")
UNITS = ("mmHg", "ml/s", "mmHg")
LABELS = ("p1", "q1", "p2")
VALUES = {
    "noise_p": 0.3, "amplitude_p": 1.2, "w_p": 250.0, "b_p": 9.0,
    "noise_q": 0.02, "amplitude_q": 0.05, "w_q": 700.0, "b_q": 30.0,
}  # fmt: skip


def some_data(period: float = 0.4, scale: float = 1.0) -> Data:
    times = np.arange(N) * period / N
    size = np.array([10.0, 0.4, 7.0])[:, None] * scale
    values = size * np.sin(2 * np.pi * times / period + np.arange(3)[:, None])
    return Data(times, values, labels=LABELS, units=UNITS, groups=GROUPS, period=period)


def covariance(data: Data, group: str, noise: float, values: Mapping[str, float]) -> Array:
    """Of one series, entry by entry from eq. 4.29 of Rasmussen and Williams, over cycles."""
    a, w, b = (values[f"{name}_{group}"] for name in ("amplitude", "w", "b"))
    t = data.times / data.duration
    K = np.empty((N, N))
    for i in range(N):
        for j in range(N):
            sides = math.sqrt((1 + 2 * (b + w * t[i] ** 2)) * (1 + 2 * (b + w * t[j] ** 2)))
            K[i, j] = a**2 * 2 / math.pi * math.asin(2 * (b + w * t[i] * t[j]) / sides)
    return K + noise**2 * np.eye(N)


def residuals(seed: int = 3) -> Array:
    return np.array([1.0, 0.05, 1.0])[:, None] * np.random.default_rng(seed).standard_normal((3, N))


@pytest.mark.parametrize("period", [0.11, 0.9])
def test_the_density_is_that_of_each_series_normal_law(period: float) -> None:
    data, r = some_data(period), residuals()
    noise = {"p1": 0.5, "q1": VALUES["noise_q"], "p2": VALUES["noise_p"]}
    process = GroupProcess(known={"p1": 0.5}).bind(data)
    plain = GroupNoise(known={"p1": 0.5}).bind(data)
    terms, white = process.terms(r, VALUES), plain.terms(r, VALUES)
    for i, (label, group) in enumerate(zip(LABELS, GROUPS, strict=True)):
        K = covariance(data, group, noise[label], VALUES)
        assert terms[i].sum() == pytest.approx(stats.multivariate_normal(cov=K).logpdf(r[i]), rel=1e-9)
        np.testing.assert_allclose(white[i], stats.norm(scale=noise[label]).logpdf(r[i]), rtol=1e-12)
        np.testing.assert_allclose(process.variance(VALUES)[i], np.diag(K), rtol=1e-9)
        z = process.whiten(r, VALUES)
        np.testing.assert_allclose(np.linalg.cholesky(K) @ z[i], r[i], atol=1e-9)
        np.testing.assert_allclose(process.unwhiten(z, VALUES)[i], r[i], atol=1e-9)  # type: ignore[index]
    left_out = process.terms(r, VALUES, "leave-one-out")
    K, others = covariance(data, "q", noise["q1"], VALUES), np.arange(N) != 5
    weights = np.linalg.solve(K[np.ix_(others, others)], K[others, 5])
    law = stats.norm(weights @ r[1, others], math.sqrt(K[5, 5] - weights @ K[others, 5]))
    assert left_out[1, 5] == pytest.approx(law.logpdf(r[1, 5]), rel=1e-8)


def test_the_law_of_pymc_is_the_same_one() -> None:
    """`pm.gp.Marginal` with a kernel written as PyMC's own functions."""
    import pytensor.tensor as pt

    class Network(pm.gp.cov.Covariance):
        def full(self, X, Xs=None):  # type: ignore[no-untyped-def]
            w, b = VALUES["w_p"], VALUES["b_p"]
            norm = 1 + 2 * (b + w * X**2)
            return 2 / np.pi * pt.arcsin(2 * (b + w * X @ X.T) / pt.sqrt(norm @ norm.T))

    data, r = some_data(), residuals()
    with pm.Model() as model:
        gp = pm.gp.Marginal(cov_func=VALUES["amplitude_p"] ** 2 * Network(1))
        cycles = (data.times / data.duration)[:, None]
        gp.marginal_likelihood("y", cycles, r[0], VALUES["noise_p"], jitter=0.0)
    terms = GroupProcess().bind(data).terms(r, VALUES)
    assert terms[0].sum() == pytest.approx(float(model.compile_logp()({})), rel=1e-6)


@pytest.mark.parametrize("law", [GroupNoise(), GroupProcess()])
def test_another_unit_scales_the_posterior(law: GroupNoise) -> None:
    """Pressures in kPa, flows in l/min: the density changes by the Jacobian alone, wherever it is taken."""
    factor = {"p": 0.133322, "q": 0.06}
    rows = np.array([factor[g] for g in GROUPS])[:, None]
    data, r = some_data(), residuals()
    there = replace(data, values=data.values * rows)
    differences = []
    for spread in (1.0, 1.7):
        x = [spread * VALUES[name] for name in law.bind(data).parameter_names]
        names = law.bind(data).parameter_names
        sizes = [factor[name[-1]] if name[:-2] in ("noise", "amplitude") else 1.0 for name in names]
        scaled = {name: size * value for name, size, value in zip(names, sizes, x, strict=True)}
        one, other = law.bind(data), law.bind(there)
        here = one.log_density(r, dict(zip(names, x, strict=True))) + log_prior(one.parameters, x)
        elsewhere = other.log_density(r * rows, scaled)
        elsewhere += log_prior(other.parameters, list(scaled.values()))
        differences.append(here - elsewhere)
    assert differences[0] == pytest.approx(differences[1], abs=1e-9)


def test_priors_hold_what_sensors_have() -> None:
    """On a pulse of 10 mmHg noises from 0.002 to 1 mmHg, and 2 % of a flow, are well inside."""
    times = np.arange(N) / N
    data = Data(times, np.array([10.0, 0.4])[:, None] * (times > 0.5), groups=["p", "q"], units=["mmHg", "1"])
    priors = {p.name: p.prior for p in GroupProcess().bind(data).parameters}
    law = {"p": stats.lognorm(2.0, scale=0.05), "q": stats.lognorm(2.0, scale=0.002)}
    for group, values in {"p": (0.002, 1.0), "q": (0.008,)}.items():
        for value in values:
            assert 0.04 < law[group].cdf(value) < 0.96
            prior = priors[f"noise_{group}"]
            # what lies below 1e-5 of the range is cut off
            assert prior.log_density(np.array([value]), {}) == pytest.approx(
                law[group].logpdf(value), abs=2e-3
            )
    drawn = priors["noise_p"].draw(np.random.default_rng(1), 4000, {})
    assert stats.kstest(drawn, law["p"].cdf).pvalue > 1e-3
    assert drawn.min() > 1e-4


def test_what_is_known_is_no_parameter() -> None:
    data = some_data()
    assert GroupNoise(known={"p": 0.3, "q": 0.01}).bind(data).parameters == ()
    assert GroupNoise(known={"p1": 0.3}).bind(data).parameter_names == ("noise_p", "noise_q")
    assert GroupNoise(known={"p1": 0.3, "p2": 0.2}).bind(data).parameter_names == ("noise_q",)
    both = GroupNoise(known={"p": 0.3, "p2": 0.1}).bind(data)  # the series goes before its group
    np.testing.assert_allclose(both.variance({"noise_q": 1.0})[:, 0], [0.09, 1.0, 0.01])
    with pytest.raises(ErrorModelError, match=r"known: 'pressure': no such name; use one of p, q, p1, q1,"):
        GroupNoise(known={"pressure": 0.3}).bind(data)
    with pytest.raises(ErrorModelError, match=r"known: p = 0.0: a standard deviation must be positive"):
        GroupNoise(known={"p": 0.0})


def test_priors_can_be_given_by_name() -> None:
    mine = LogUniform(1e-3, 1.0)
    errors = GroupProcess(priors={"noise_p": mine}).bind(some_data())
    found = {p.name: p for p in errors.parameters}
    assert found["noise_p"].prior == mine
    assert isinstance(found["noise_q"].prior, LogNormal)
    assert 1e-3 < found["noise_p"].first < 1.0
    with pytest.raises(ErrorModelError, match=r"priors: 'noise': no such name; use one of noise_p,"):
        GroupProcess(priors={"noise": mine}).bind(some_data())


def test_ranks_of_the_truth_among_posterior_draws_are_uniform() -> None:
    """Simulation-based calibration: laws from NumPy, the posterior by weighting draws of the prior."""
    rng = np.random.default_rng(5)
    data = replace(some_data(), values=np.zeros((3, N)))
    spreads = {"noise_p": (0.3, 0.5), "amplitude_p": (0.8, 0.5), "w_p": (200.0, 0.7), "b_p": (10.0, 0.7)}
    spreads |= {"noise_q": (0.02, 0.4), "amplitude_q": (0.02, 0.4), "w_q": (300.0, 0.5), "b_q": (20.0, 0.5)}
    priors = {name: LogNormal(*two) for name, two in spreads.items()}
    errors = GroupProcess(priors=priors).bind(data)
    names = [name for name in errors.parameter_names if name.endswith("_p")]
    kept = {name: np.exp(np.log(m) + s * rng.standard_normal(6000)) for name, (m, s) in spreads.items()}
    truths, series = [], []
    for _ in range(150):
        true = {name: math.exp(math.log(m) + s * rng.standard_normal()) for name, (m, s) in spreads.items()}
        law = covariance(data, "p", true["noise_p"], true)
        truths.append([true[name] for name in names])
        series.append(rng.multivariate_normal(np.zeros(N), law, size=2))
    y = np.zeros((len(series), 3, N))
    y[:, [0, 2]] = series
    logs = np.empty((6000, len(series)))
    for k in range(6000):
        values = {name: column[k] for name, column in kept.items()}
        z = errors.whiten(y, values)
        unit = errors.terms(y[0], values)[[0, 2]].sum() + 0.5 * (z[0, [0, 2]] ** 2).sum()  # type: ignore[index]
        logs[k] = unit - 0.5 * (z[:, [0, 2]] ** 2).sum(axis=(1, 2))  # type: ignore[index]
    weights = np.exp(logs - logs.max(axis=0))
    weights /= weights.sum(axis=0)
    for name, true in zip(names, np.array(truths).T, strict=True):
        ranks = (weights * (kept[name][:, None] < true)).sum(axis=0)
        assert stats.kstest(ranks, "uniform").pvalue > 1e-3, name


# ---------------------------------------------------------------------------------------------------
# Models


def lines(theta: Mapping[str, float], times: Array) -> Array:
    """A pressure and a flow, linear in level and slope."""
    level, slope = theta["level"], theta["slope"]
    t = times / 0.4
    return np.array([level + slope * np.sin(2 * np.pi * t), 0.02 * slope * np.cos(2 * np.pi * t)])


def linear_model(errors: GroupNoise, sd: tuple[float, float], n: int = 64, seed: int = 1) -> pm.Model:
    times = np.arange(n) * 0.4 / n
    level = Parameter("level", Normal(10.0, 5.0), start=8.0)
    slope = Parameter("slope", Normal(3.0, 5.0), start=1.0)
    forward = FunctionModel(lines, (level, slope), Outputs(("p", "q"), times), "lines")
    y = lines({"level": 12.0, "slope": 4.0}, times)
    y += np.array(sd)[:, None] * np.random.default_rng(seed).standard_normal(y.shape)
    data = Data(times, y, labels=["p", "q"], units=["mmHg", "ml/s"], groups=["p", "q"], period=0.4)
    return bayesian_model("lines", forward, data, errors)


@pytest.mark.parametrize("errors", [GroupNoise(), GroupProcess()])
def test_noises_of_two_quantities_are_recovered(errors: GroupNoise) -> None:
    model = linear_model(errors, (0.3, 0.002))
    idata = sample(model, draws=300, until_ess=None, chains=2, cores=0, seed=3, progress=False)
    for name, true in {"level": 12.0, "slope": 4.0, "noise_p": 0.3, "noise_q": 0.002}.items():
        low, high = np.quantile(idata.posterior[name], [0.005, 0.995])
        assert low < true < high, name
        if name.startswith("noise"):
            assert high / low < 2.0
    prior = pm.sample_prior_predictive(20, model=model, random_seed=1)
    assert np.all(np.isfinite(prior.prior_predictive["y"]))
    assert all(np.all(np.isfinite(prior.prior[name])) for name in model.zoo.parameters)


def test_the_model_s_density_is_that_of_priors_and_errors() -> None:
    for errors in (GroupNoise(), GroupProcess(), GroupNoise(known={"p": 0.3, "q": 0.002})):
        model = linear_model(errors, (0.3, 0.002))
        record = model.zoo
        theta = {"level": 11.0, "slope": 3.5}
        values = {p.name: 1.3 * p.first for p in record.errors.parameters}
        density = record.errors.log_density(record.data.values - lines(theta, record.data.times), values)
        density += log_prior(record.forward.parameters, list(theta.values()))
        density += log_prior(record.errors.parameters, list(values.values()))
        every = theta | values
        point = {
            model.rvs_to_values[rv].name: every[rv.name]
            if model.rvs_to_transforms[rv] is None
            else model.rvs_to_transforms[rv].forward(every[rv.name], *rv.owner.inputs).eval()
            for rv in model.free_RVs
        }
        assert float(model.compile_logp(jacobian=False)(point)) == pytest.approx(density, abs=1e-4)
        assert np.isfinite(find_mode(model).logp)


def mixed_study(sd: float, flow: float, **tables: object) -> Study:
    """Three vessels at known parameters: a pressure with white noise of sd mmHg, a flow with 1/100 of it."""
    study = replace(small_study(quantities=("pressure_mmHg", "flow_ml_s")), priors={}, **tables)
    forward = get_model("A")(study).zoo.forward
    rng = np.random.default_rng(2)
    y = forward.solve(forward.configure([5e4, 0.3, 0.9, 1.2]))
    y = y + np.array([sd, flow])[:, None] * rng.standard_normal(y.shape)
    return replace(study, series=tuple(replace(s, value=row) for s, row in zip(study.series, y, strict=True)))


@pytest.mark.parametrize(("name", "sd", "flow"), [("B", 0.3, 0.01), ("B", 0.002, 1e-4)])
def test_the_search_ends_at_the_noise_whatever_its_size(name: str, sd: float, flow: float) -> None:
    mode = find_mode(get_model(name)(mixed_study(sd, flow)))
    n = 32
    assert float(mode.values["noise_pressure_mmHg"]) == pytest.approx(sd, rel=4 / math.sqrt(2 * n))
    assert float(mode.values["noise_flow_ml_s"]) == pytest.approx(flow, rel=4 / math.sqrt(2 * n))
    assert float(mode.values["f3"]) == pytest.approx(5e4, rel=0.2 if sd > 0.1 else 0.01)


def test_pressure_with_flow_from_sampling_to_comparison() -> None:
    study = mixed_study(0.3, 0.01, noise_sd={"flow_ml_s": 0.01})
    models = {name: get_model(name)(study) for name in "AB"}
    assert models["A"].zoo.error_parameters == ("noise_pressure_mmHg",)
    assert "noise_flow_ml_s" not in models["B"].zoo.parameters
    found = {
        name: sample(model, draws=60, tune=150, until_ess=None, chains=2, cores=0, seed=1, progress=False)
        for name, model in models.items()
    }
    table = compare(found, models, n_draws=60)
    assert np.all(np.isfinite(table[["waic", "loo", "waic_one_observation"]]))
    residual = models["A"].zoo.data.values
    for i, quantity in enumerate(("pressure_mmHg", "flow_ml_s")):
        near = (np.array([0.3, 0.01])[i] ** 2) * residual.shape[1]
        assert 0.3 * near < table.loc["A", f"sse_{quantity}"] < 3 * near
    assert "sse" not in table
    for name in "AB":
        means, predictions = predictive_draws(models[name], found[name], n_draws=40)
        spread = (predictions - np.repeat(means, 10, axis=0)[: len(predictions)]).std(axis=(0, 2))
        assert spread[1] < 0.2 < spread[0] < 1.0
        waves = vessel_waves(models[name], found[name], n_draws=10, n_times=16)
        assert float(waves["error_variance_flow_ml_s"].min()) >= 0.99e-4
        for quantity in ("pressure_mmHg", "flow_ml_s"):
            shown = bands(waves, quantity, (0.9,), errors=True)
            assert np.all(shown["prediction_low"] < shown["low"])


def test_any_error_model_takes_other_priors_of_its_parameters() -> None:
    mine = LogUniform(1e-3, 1.0)
    assert Independent().with_priors({"sigma2": mine}).sigma2 == mine
    assert dict(GroupNoise().with_priors({"noise_p": mine}).bind(some_data()).priors) == {"noise_p": mine}
    with pytest.raises(ErrorModelError, match=r"error model iid: no prior 'w'; use one of sigma2"):
        Independent().with_priors({"w": mine})


def test_the_search_does_not_take_the_signal_for_error() -> None:
    """From the prior's median, a stiffness of 2e5, a process of the size of the pulse is a lesser mode."""
    study = load_study(Path(__file__).parents[1] / "docs" / "example-study")
    for name in "AB":
        mode = find_mode(get_model(name)(study))
        assert float(mode.values["f3"]) == pytest.approx(6.13e4, rel=0.03)
        assert float(mode.values["noise_pressure_mmHg"]) == pytest.approx(0.08, rel=0.1)
