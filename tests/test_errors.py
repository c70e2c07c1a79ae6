"""What every error model promises, and an error model of a user's own from data to WAIC."""

from __future__ import annotations

import importlib
import math
import pickle
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pymc as pm
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from zoo.core.arviz_lines import InferenceData, dataset, of_draws, psis_loo
from zoo.core.arviz_lines import made as inference_data
from zoo.core.data import Data
from zoo.core.errors.base import ErrorModel, ErrorModelError
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.errors.groups import GroupNoise, GroupProcess
from zoo.core.errors.independent import Independent
from zoo.core.errors.spectral import Cosines, GroupPriors, Harmonics
from zoo.core.errors.student import GroupStudent
from zoo.core.forward import FunctionModel, Outputs, SolveError
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.inference.mode import find_mode
from zoo.core.inference.newton import gauss_newton
from zoo.core.inference.sampling import sample
from zoo.core.model import ModelError, bayesian_model, record_of
from zoo.core.parameters import (
    InverseGamma,
    LogNormal,
    LogUniform,
    Normal,
    Parameter,
    Prior,
    Uniform,
    random_variables,
)
from zoo.core.posterior.comparison import compare, log_likelihoods, loo_pit

Array = NDArray[np.float64]

pytestmark = pytest.mark.filterwarnings(
    "ignore:For one or more samples the posterior variance",
    "ignore:Estimated shape parameter of Pareto",
    "ignore:The inplace keyword in DataFrame.sort_values",
)

N_SERIES, N_TIMES = 3, 14
SCALE = LogUniform(1e-3, 1e2)


@dataclass(frozen=True)
class StudentT(ErrorModel):
    """Independent errors with heavy tails: (y_i - mean_i)/scale ~ t with `dof` degrees of freedom."""

    scale: Prior
    dof: float = 10.0

    @property
    def name(self) -> str:
        return "student-t"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("scale", self.scale, self.on.units[0], log=True),)

    def variance(self, values: Mapping[str, ArrayLike]) -> Array:
        shape = (self.on.n_series, self.on.n_times)
        return np.full(shape, float(values["scale"]) ** 2 * self.dof / (self.dof - 2))

    def whiten(self, residuals: Array, values: Mapping[str, ArrayLike]) -> Array:
        tail = stats.t.sf(np.abs(residuals) / values["scale"], self.dof)
        return np.copysign(stats.norm.isf(tail), residuals)

    def unwhiten(self, z: Array, values: Mapping[str, ArrayLike]) -> Array:
        return np.copysign(values["scale"] * stats.t.isf(stats.norm.sf(np.abs(z)), self.dof), z)

    def terms(
        self, residual: Array, values: Mapping[str, ArrayLike], decomposition: str = "sequential"
    ) -> Array:
        return stats.t.logpdf(residual, self.dof, scale=values["scale"])


# what every error model promises


def some_data(groups: list[str], period: float | None = None) -> Data:
    times = np.arange(N_TIMES) * 0.01
    values = np.random.default_rng(5).standard_normal((N_SERIES, N_TIMES))
    return Data(times, values, units=["V"] * N_SERIES, groups=groups, period=period)


ONE, TWO = ["u"] * 3, ["u", "v", "u"]
PRIORS = {g: GroupPriors(LogNormal(0.5, 1.0), Normal(0.0, 2.0, 0.0)) for g in ("u", "v")}
SPECTRAL = {
    "sigma_u": 0.4, "ratio_u": 0.6, "tau_u": 0.004, "delta_u": 1.5,
    "sigma_v": 0.9, "ratio_v": 0.2, "tau_v": 0.002, "delta_v": 0.3,
}  # fmt: skip
PROCESS = {
    "noise_u": 0.4, "amplitude_u": 1.1, "w_u": 150.0, "b_u": 12.0,
    "amplitude_v": 0.2, "w_v": 300.0, "b_v": 20.0,
}  # fmt: skip
CASES: dict[str, tuple[ErrorModel, dict[str, float]]] = {
    "independent": (Independent(InverseGamma(3, 1)).bind(some_data(ONE)), {"sigma2": 0.13}),
    "gaussian process": (
        GaussianProcess(LogUniform(1e2, 9e4), LogUniform(0.1, 500), noise_variance=0.01).bind(some_data(ONE)),
        {"w": 900.0, "b": 0.5},
    ),
    "harmonics": (Harmonics(priors=PRIORS).bind(some_data(TWO, period=N_TIMES * 0.01)), SPECTRAL),
    "cosines": (Cosines(priors=PRIORS).bind(some_data(TWO)), SPECTRAL),
    "noise": (GroupNoise().bind(some_data(TWO)), {"noise_u": 0.4, "noise_v": 0.9}),
    "process": (GroupProcess(known={"v": 0.3}).bind(some_data(TWO, period=N_TIMES * 0.01)), PROCESS),
    "robust": (
        GroupStudent(known={"v": 0.3}).bind(some_data(TWO)),
        {"noise_u": 0.4, "nu_u": 5.0, "nu_v": 3.0},
    ),
    "student-t": (StudentT(SCALE).bind(some_data(ONE)), {"scale": 0.3}),
}
NORMAL = [name for name in CASES if name not in ("robust", "student-t")]


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[ErrorModel, dict[str, float]]:
    return CASES[request.param]


@pytest.fixture(params=NORMAL)
def normal_case(request: pytest.FixtureRequest) -> tuple[ErrorModel, dict[str, float]]:
    return CASES[request.param]


def some_errors(errors: ErrorModel, values: Mapping[str, float], n: int | None = None) -> Array:
    shape = (N_SERIES, N_TIMES) if n is None else (n, N_SERIES, N_TIMES)
    return errors.unwhiten(np.random.default_rng(8).standard_normal(shape), values)


def covariance_of(errors: ErrorModel, values: Mapping[str, float]) -> Array:
    """U U' with U the linear map `unwhiten`, series after series."""
    n = errors.on.values.size
    columns = errors.unwhiten(np.eye(n).reshape(n, *errors.on.values.shape), values).reshape(n, n)
    return np.asarray(columns.T @ columns)


def coefficient_covariance(errors: ErrorModel, values: Mapping[str, float]) -> Array:
    """T S T' with S the covariance of the series and T the transform, written as a matrix."""
    size = N_SERIES * N_TIMES
    T = errors.transform(np.eye(size).reshape(size, N_SERIES, N_TIMES)).reshape(size, size).T
    return np.asarray(T @ covariance_of(errors, values) @ T.T)


def given_the_others(S: Array, c: Array) -> tuple[list[float], list[float]]:
    """Logarithm of the normal density of each of c given all others, and the probability below it."""
    density, below = [], []
    for i in range(len(c)):
        rest = np.delete(np.arange(len(c)), i)
        gain = np.linalg.solve(S[np.ix_(rest, rest)], S[rest, i])
        law = stats.norm(gain @ c[rest], math.sqrt(S[i, i] - gain @ S[rest, i]))
        density.append(law.logpdf(c[i]))
        below.append(law.cdf(c[i]))
    return density, below


def test_the_inverse_undoes_the_transform(case) -> None:
    errors, _ = case
    series = np.random.default_rng(1).standard_normal((4, N_SERIES, N_TIMES))
    np.testing.assert_allclose(errors.inverse(errors.transform(series)), series, rtol=0, atol=1e-12)


def test_unwhitening_undoes_whitening(case) -> None:
    errors, values = case
    z = np.random.default_rng(2).standard_normal((4, N_SERIES, N_TIMES))
    series = errors.unwhiten(z, values)
    np.testing.assert_allclose(errors.whiten(series, values), z, rtol=0, atol=1e-9)
    np.testing.assert_allclose(errors.whiten(series[2], values), z[2], rtol=0, atol=1e-9)


def test_sequential_terms_add_up_to_the_normal_density(normal_case) -> None:
    errors, values = normal_case
    residual = some_errors(errors, values)
    expected = stats.multivariate_normal(cov=covariance_of(errors, values)).logpdf(residual.ravel())
    assert errors.terms(residual, values).sum() == pytest.approx(expected, rel=1e-8)
    assert errors.log_density(residual, values) == pytest.approx(expected, rel=1e-8)


def test_whitened_residuals_have_the_density_of_the_terms(normal_case) -> None:
    """log p(r) = -z'z/2 - log det(2 pi S)/2."""
    errors, values = normal_case
    a, b = some_errors(errors, values, 2)
    squares = [float(np.sum(errors.whiten(r, values) ** 2)) for r in (a, b)]
    difference = errors.log_density(a, values) - errors.log_density(b, values)
    assert difference == pytest.approx(-0.5 * (squares[0] - squares[1]), rel=1e-8)


def test_leave_one_out_terms_by_conditioning(normal_case) -> None:
    errors, values = normal_case
    residual = some_errors(errors, values)
    S, c = coefficient_covariance(errors, values), errors.transform(residual).ravel()
    expected, below = given_the_others(S, c)
    found = errors.terms(residual, values, "leave-one-out")
    np.testing.assert_allclose(found.ravel(), expected, rtol=1e-6, atol=1e-8)
    z = errors.left_out(residual, values)
    np.testing.assert_allclose(stats.norm.cdf(z.ravel()), below, rtol=1e-6, atol=1e-8)


def test_what_is_left_out_is_as_refits_without_each_value_have_it(normal_case) -> None:
    """Two weights of a normal prior: posterior and prediction without a value are in closed form."""
    errors, values = normal_case
    rng = np.random.default_rng(5)
    shapes = rng.standard_normal((2, N_SERIES, N_TIMES))
    measured = np.tensordot([0.7, -0.4], shapes, 1) + errors.draw(rng, values)
    S, c = coefficient_covariance(errors, values), errors.transform(measured).ravel()
    A = errors.transform(shapes).reshape(2, -1).T
    refitted, below = given_the_others(S + A @ A.T, c)
    C = np.linalg.inv(np.eye(2) + A.T @ np.linalg.solve(S, A))
    draws = rng.multivariate_normal(C @ (A.T @ np.linalg.solve(S, c)), C, (4, 500))
    left = measured - np.tensordot(draws, shapes, 1)
    terms = np.array([[errors.terms(one, values, "leave-one-out") for one in chain] for chain in left])
    weights = {f"w{i}": draws[..., i] for i in range(2)}
    posterior = dataset(of_draws({"posterior": weights}))
    found = psis_loo(posterior, terms)
    assert found.elpd == pytest.approx(sum(refitted), abs=0.1)
    np.testing.assert_allclose(found.terms, refitted, rtol=0, atol=0.05)

    on = errors.on
    sums = FunctionModel(
        lambda given, _: np.tensordot([given["w0"], given["w1"]], shapes, 1),
        [Parameter(name, Normal(0.0, 1.0, 0.0)) for name in weights],
        Outputs(on.labels, on.times),
    )
    data = Data(on.times, measured, on.labels, on.units, groups=on.groups, period=on.period)
    model = bayesian_model("two weights", sums, data, replace(errors, data=None))
    everywhere = {name: np.full((4, 500), values[name]) for name in model.zoo.errors.parameter_names}
    pit = loo_pit(of_draws({"posterior": weights | everywhere}), model, n_draws=None)
    assert pit.dims == ("series", "time")
    assert list(pit["series"].to_numpy()) == list(on.labels)
    np.testing.assert_allclose(pit.to_numpy().ravel(), below, rtol=0, atol=0.02)


def test_the_variance_is_the_diagonal_of_the_covariance(normal_case) -> None:
    errors, values = normal_case
    variance = errors.variance(values)
    assert variance.shape == (N_SERIES, N_TIMES)
    np.testing.assert_allclose(variance.ravel(), np.diag(covariance_of(errors, values)), rtol=1e-9)


def test_draws_have_the_variance(case) -> None:
    errors, values = case
    rng = np.random.default_rng(3)
    squares = np.array([errors.draw(rng, values) for _ in range(4000)]) ** 2
    z = (squares.mean(axis=0) - errors.variance(values)) / (squares.std(axis=0) / math.sqrt(len(squares)))
    assert np.abs(z).max() < 4.5  # of 42 numbers


def made(errors: ErrorModel, values: Mapping[str, float] | None = None, ok: int = 1) -> pm.Model:
    """A PyMC model of the errors alone, around zero, its parameters free or fixed."""
    data = errors.on
    with pm.Model(coords={"series": list(data.labels), "time": data.times}) as model:
        given = random_variables(errors.parameters) if values is None else values
        errors.observe("y", pm.math.zeros_like(data.values), np.int8(ok), given)
    return model


def test_the_density_of_the_pymc_variable_is_that_of_the_terms(case) -> None:
    errors, values = case
    model = made(errors)
    logp = model.compile_fn(model.logp(vars=[model["y"]], sum=False)[0], inputs=model.value_vars)
    point = {v.name: np.asarray(0.3) for v in model.value_vars}
    free = model.replace_rvs_by_values([model[name] * 1.0 for name in values])
    at = dict(zip(values, map(float, model.compile_fn(free, inputs=model.value_vars)(point)), strict=True))
    np.testing.assert_allclose(logp(point), errors.terms(errors.on.values, at), rtol=1e-9)
    failed = made(errors, ok=0)
    logp = failed.compile_fn(failed.logp(vars=[failed["y"]], sum=False)[0], inputs=failed.value_vars)
    assert np.all(logp(point) == -np.inf)


def test_draws_of_the_pymc_variable_have_the_variance(case) -> None:
    errors, values = case
    draws = pm.draw(made(errors, values)["y"], draws=2000, random_seed=4)
    squares = errors.inverse(draws) ** 2
    z = (squares.mean(axis=0) - errors.variance(values)) / (squares.std(axis=0) / math.sqrt(len(squares)))
    assert np.abs(z).max() < 4.5
    assert np.all(np.isnan(pm.draw(made(errors, values, ok=0)["y"], random_seed=4)))


def survives_pickling(model: pm.Model) -> None:
    copy, point = pickle.loads(cloudpickle.dumps(model)), model.initial_point()
    assert float(copy.compile_logp()(point)) == float(model.compile_logp()(point))


def test_its_model_survives_pickling(case) -> None:
    survives_pickling(made(case[0]))


def test_terms_of_draws_are_those_of_each_draw(case) -> None:
    errors, values = case
    series = np.stack([np.zeros((N_SERIES, N_TIMES)), np.full((N_SERIES, N_TIMES), np.nan)])
    draws = {name: np.array([value, value]) for name, value in values.items()}
    found = errors.pointwise(series, draws)
    for decomposition in ("sequential", "leave-one-out"):
        expected = errors.terms(errors.on.values, values, decomposition)
        np.testing.assert_array_equal(found[decomposition][0], expected)
        assert np.all(found[decomposition][1] == -np.inf)
    assert found["joint"][0] == errors.log_density(errors.on.values, values)
    assert found["joint"][1] == -np.inf


def test_where_there_is_no_covariance_there_is_no_law() -> None:
    errors, values = CASES["gaussian process"]
    wrong = values | {"b": -1.0}
    assert errors.whiten(errors.on.values, wrong) is None
    assert errors.draw(np.random.default_rng(1), wrong) is None
    assert np.all(errors.terms(errors.on.values, wrong) == -np.inf)
    assert errors.unwhiten(errors.on.values, wrong) is None


def test_an_error_model_without_data_says_so() -> None:
    with pytest.raises(ErrorModelError, match=r"error model iid: has no data; call bind\(data\) first"):
        Independent().variance({"sigma2": 1.0})


# from data to WAIC with any forward model


TIMES = np.linspace(0.0, 2.0, 24)
TRUTH = {"rate": 1.1, "scales": (2.0, 3.0)}


def decay(configuration, times: Array) -> Array:
    if configuration["rate"] > 4.0:
        raise SolveError("too fast", "fast")
    return np.asarray(configuration["scales"])[:, None] * np.exp(-configuration["rate"] * times)


def decay_model() -> FunctionModel:
    parameters = (
        Parameter("rate", Uniform(0.1, 5.0), "s-1"),
        Parameter("scales", Uniform(0.1, 9.0), "V", dims="probe", size=2),
    )
    return FunctionModel(decay, parameters, Outputs(("a", "b"), TIMES), "decay")


def decay_data(heavy: bool = True) -> Data:
    rng = np.random.default_rng(11)
    noise = rng.standard_t(3, (2, 24)) if heavy else rng.standard_normal((2, 24))
    return Data(TIMES, decay(TRUTH, TIMES) + 0.1 * noise, ["a", "b"], ["V", "V"], ["volt", "volt"])


def decay_posterior_model(errors: ErrorModel) -> pm.Model:
    return bayesian_model("decay", decay_model(), decay_data(), errors, coords={"probe": ["a", "b"]})


SETTINGS = {"draws": 150, "tune": 300, "chains": 2, "thin": 2, "seed": 3, "progress": False}


@pytest.fixture(scope="module")
def sampled() -> dict[str, tuple[pm.Model, InferenceData]]:
    """The first in this process, the other in two worker processes."""
    laws = {"iid": Independent(), "student-t": StudentT(SCALE, dof=3.0)}
    models = {name: decay_posterior_model(errors) for name, errors in laws.items()}
    cores = {"iid": 0, "student-t": 2}
    return {name: (model, sample(model, cores=cores[name], **SETTINGS)) for name, model in models.items()}


def test_an_error_model_of_one_s_own_is_sampled_in_other_processes(sampled) -> None:
    model, idata = sampled["student-t"]
    assert set(idata.posterior) == {"rate", "scales", "scale"}
    assert idata.posterior["scales"].dims == ("chain", "draw", "probe")
    for name, truth in (("rate", 1.1), ("scale", 0.1)):
        draws = idata.posterior[name]
        assert abs(float(draws.mean()) - truth) < 5 * float(draws.std())
    in_this = sample(model, cores=0, **SETTINGS)
    np.testing.assert_array_equal(in_this.posterior["scale"], idata.posterior["scale"])


def test_an_error_model_of_one_s_own_is_compared(sampled) -> None:
    models, idatas = ({name: pair[i] for name, pair in sampled.items()} for i in (0, 1))
    table = compare(idatas, models, n_draws=200)
    assert table.index[0] == "student-t"  # the noise has heavy tails
    model, idata = sampled["student-t"]
    terms = log_likelihoods(idata, model, n_draws=20)
    scored = inference_data({"posterior": dataset(idata).isel(draw=[0, 149])})
    pm.compute_log_likelihood(scored, model=model, progressbar=False)
    np.testing.assert_allclose(
        terms["sequential"].isel(draw=[0, -1]), scored.log_likelihood["y"], rtol=1e-12, atol=1e-12
    )
    assert list(terms["series"].to_numpy()) == ["a", "b"]
    rate, scale = (float(idata.posterior[name][1, 0]) for name in ("rate", "scale"))
    mean = decay({"rate": rate, "scales": idata.posterior["scales"][1, 0].to_numpy()}, TIMES)
    expected = stats.t.logpdf(decay_data().values, 3.0, mean, scale)
    np.testing.assert_allclose(terms["sequential"][1, 0], expected, rtol=1e-12, atol=1e-12)


def test_an_error_model_of_one_s_own_is_predicted_with(sampled) -> None:
    model, idata = sampled["student-t"]
    with model:
        predicted = pm.sample_posterior_predictive(
            idata, var_names=["y"], progressbar=False, random_seed=1
        ).posterior_predictive["y"]
    draws = dataset(idata)
    times = predicted["time"]
    mean = draws["scales"].rename(probe="series") * np.exp(-draws["rate"] * times)
    standard = (predicted - mean) / draws["scale"]
    assert dict(standard.sizes) == {"chain": 2, "draw": 150, "series": 2, "time": 24}
    assert stats.kstest(standard.to_numpy().ravel(), stats.t(3.0).cdf).pvalue > 1e-3


def test_the_error_model_of_the_contributing_guide(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Written to a file of a user's, as it stands there."""
    text = (Path(__file__).parents[1] / "docs" / "extending.md").read_text(encoding="utf-8")
    [code] = [block for block in re.findall(r"```python\n(.*?)```", text, re.S) if "ErrorModel)" in block]
    (tmp_path / "heavy_tails.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    module: Any = importlib.import_module("heavy_tails")
    theirs, ours = (cls(SCALE, dof=10.0).bind(some_data(ONE)) for cls in (module.StudentT, StudentT))
    values = {"scale": 0.3}
    residual = some_errors(theirs, values)
    for method in ("terms", "whiten", "unwhiten"):
        np.testing.assert_array_equal(
            getattr(theirs, method)(residual, values), getattr(ours, method)(residual, values)
        )
    np.testing.assert_array_equal(theirs.variance(values), ours.variance(values))
    survives_pickling(made(theirs))


def test_gauss_newton_whitens_with_any_error_model(sampled) -> None:
    model, _ = sampled["student-t"]
    logp = LogPosterior(model)
    mode = find_mode(model)
    q = logp.from_values({"rate": 0.7, "scales": [1.0, 5.0], "scale": 0.5})
    _, value, _ = gauss_newton(logp, q, logp(q), limit=300)
    assert value == pytest.approx(mode.logp, abs=0.3)  # the sum of squares is not the density: near it
    assert logp(q) < value - 20


def test_data_that_a_forward_model_does_not_give_are_refused() -> None:
    data = Data(TIMES[:8], np.zeros((2, 8)), ["a", "b"], groups=["u", "u"])
    with pytest.raises(ModelError, match=r"gives series \(2, 24\), the data are \(2, 8\)"):
        bayesian_model("decay", decay_model(), data, Independent())


def test_the_record_of_a_model(sampled) -> None:
    model, _ = sampled["student-t"]
    record = record_of(model)
    assert record.parameters == ("rate", "scales", "scale")
    assert record.error_parameters == ("scale",)
    assert record.suggested["rate"] == pytest.approx(2.55)
    assert record.errors.data is record.data
    with pytest.raises(ModelError, match="has no record"):
        record_of(pm.Model())
