"""Gradients of error models computed in NumPy, and what follows a gradient in the nine models."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import arviz as az
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest

import zoo
from test_errors import CASES, StudentT, some_data, some_errors
from test_gaussian_process import TIME_S, B, W, draw_residual, process, reference_terms
from test_op import small_study
from zoo.blood.solver_input import SolverOptions
from zoo.core.data import Data
from zoo.core.errors.base import ErrorModelError
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.errors.groups import GroupProcess
from zoo.core.errors.variables import ErrorGradientOp, ErrorsRV, ErrorTermsOp
from zoo.core.forward import Outputs, content_key
from zoo.core.inference.sampling import has_gradient
from zoo.core.inference.sampling import sample as sample_exact
from zoo.core.model import bayesian_model
from zoo.core.op import MissingGradientError
from zoo.core.parameters import InverseGamma, LogUniform, Parameter, Population, Uniform, unpack

PROCESSES = ["gaussian process", "process"]
ALIKE = np.full((3, 14), 1.7)
"""Weights as those of a log-density, the same at all times."""


def extrapolated(f: Any, h: float) -> float:
    """Derivative at 0 by central differences of three steps, extrapolated to none: of sixth order."""
    coarse, middle, fine = ((f(step) - f(-step)) / (2 * step) for step in (h, h / 2, h / 4))
    return float((64 * fine - 20 * middle + coarse) / 45)


@pytest.mark.parametrize("kind", [ErrorTermsOp, ErrorGradientOp, ErrorsRV])
def test_operations_of_errors_that_differ_are_never_taken_for_one(kind: Any) -> None:
    """PyTensor merges equal operations on equal inputs: of two error models one would be lost."""
    errors, given = CASES["gaussian process"]
    other = dataclasses.replace(errors, noise_variance=0.02)
    assert kind(errors) == kind(dataclasses.replace(errors))
    assert hash(kind(errors)) == hash(kind(dataclasses.replace(errors)))
    assert kind(errors) != kind(other)
    if kind is not ErrorTermsOp:
        return
    residual = some_errors(errors, given)
    terms = [kind(e)(residual, *given.values()) for e in (errors, other)]
    found = pytensor.function([], terms)()
    for e, values in zip((errors, other), found, strict=True):
        np.testing.assert_array_equal(values, e.terms(residual, given))
    assert not np.array_equal(*found)


@pytest.mark.parametrize("name", PROCESSES)
@pytest.mark.parametrize("weight", [ALIKE, np.random.default_rng(3).standard_normal((3, 14))])
def test_gradient_is_that_of_differences(name: str, weight: np.ndarray) -> None:
    errors, given = CASES[name]
    values = {k: np.asarray(v, dtype=float) for k, v in given.items()}
    residual = some_errors(errors, values)
    by_residual, by_parameter = errors.gradient(residual, values, weight)

    def total(residual: np.ndarray, values: dict[str, np.ndarray]) -> float:
        return float((weight * errors.terms(residual, values)).sum())

    assert set(by_parameter) == set(values)
    for k, at in values.items():
        expected = extrapolated(lambda h, k=k, at=at: total(residual, {**values, k: at * (1 + h)}), 0.02)
        assert float(at * by_parameter[k]) == pytest.approx(expected, rel=1e-6, abs=1e-8)
    for seed in range(5):
        way = np.random.default_rng(seed).standard_normal(residual.shape)
        expected = extrapolated(lambda h, way=way: total(residual + h * way, values), 0.01)
        assert np.vdot(by_residual, way) == pytest.approx(expected, rel=1e-6, abs=1e-8)


def test_a_known_noise_is_not_differentiated() -> None:
    data = some_data(["u"] * 3, period=0.14)
    errors = GroupProcess(known={data.labels[0]: 0.4}).bind(data)
    values = {"noise_u": np.array(0.4), "amplitude_u": 1.1, "w_u": 150.0, "b_u": 12.0}
    residual = some_errors(errors, values)
    found = errors.gradient(residual, values, ALIKE)[1]["noise_u"]

    def total(h: float) -> float:
        return float((ALIKE * errors.terms(residual, {**values, "noise_u": 0.4 + h})).sum())

    assert found == pytest.approx(extrapolated(total, 0.01), rel=1e-6)


def test_terms_and_gradient_are_those_of_plain_pytensor() -> None:
    residual, w, b = pt.dmatrix(), pt.dscalar(), pt.dscalar()
    values, weight = draw_residual(3), np.random.default_rng(4).standard_normal((3, len(TIME_S)))
    ours = ErrorTermsOp(process(values))(residual, w, b)
    wanted = [
        output
        for terms in (ours, reference_terms(residual, TIME_S, w, b))
        for cost in ((weight * terms).sum(), terms.sum())
        for output in (terms, *pytensor.grad(cost, [residual, w, b]))
    ]
    found = pytensor.function([residual, w, b], wanted)(values, W, B)
    assert found[0].shape == (3, len(TIME_S))
    for one, other in zip(found[:8], found[8:], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6 * np.abs(other).max())


def test_where_there_is_no_law_the_gradient_is_zero() -> None:
    errors = process(draw_residual(3))
    by_residual, by_parameter = errors.gradient(draw_residual(3), {"w": np.inf, "b": B}, np.ones((3, 40)))
    assert not by_residual.any()
    assert by_parameter == {"w": 0.0, "b": 0.0}


def test_errors_without_a_gradient_say_so() -> None:
    errors = StudentT(LogUniform(1e-3, 1e2)).bind(some_data(["u"] * 3))
    assert not errors.differentiable
    scale = pt.dscalar()
    with pytest.raises(MissingGradientError, match=r"pm.sample\(step=zoo.step\(model\)\)"):
        pytensor.grad(ErrorTermsOp(errors)(errors.on.values, scale).sum(), scale)
    with pytest.raises(ErrorModelError, match="error model student-t: has no gradient"):
        errors.gradient(errors.on.values, {"scale": 1.0}, ALIKE)


# the nine models


EXACT = SolverOptions(dx_cm=0.05, steps_per_beat=2048, tolerance_mmHg=1e-10, max_beats=300)
"""Fixed steps, and so near the periodic state that differences are of rounding."""


@pytest.mark.parametrize("letter", "ABCDEFGHI")
def test_each_model_has_the_gradient_of_its_log_posterior(letter: str) -> None:
    model = getattr(zoo, f"model_{letter}")(small_study(), options=EXACT)
    assert has_gradient(model)
    logp, slope = model.compile_logp(), model.compile_dlogp()
    point = model.initial_point()
    sizes = [np.size(x) for x in point.values()]
    gradient = slope(point)
    assert gradient.shape == (sum(sizes),)
    assert np.all(np.isfinite(gradient))
    way = np.sign(gradient) * np.random.default_rng(6).uniform(0.5, 1.5, len(gradient))
    steps = dict(zip(point, np.split(way, np.cumsum(sizes)[:-1]), strict=True))

    def along(h: float) -> float:
        moved = {k: x + h * steps[k].reshape(np.shape(x)) for k, x in point.items()}
        return float(logp(moved))

    assert gradient @ way == pytest.approx(extrapolated(along, 2e-3), rel=1e-5)


# what follows the gradient, on curves that cost nothing


TIMES = np.linspace(0.0, 0.1, 30)
LAW = GaussianProcess(LogUniform(1e3, 9e4), LogUniform(1.0, 500.0), 2e4, 100.0, noise_variance=0.01)
N = 3
WAVES = Outputs(tuple(f"y{i}" for i in range(N)), TIMES)
LEVEL = Parameter("level", Uniform(-5.0, 5.0), start=0.2)
POPULATION = (
    Parameter("mean", Uniform(0.2, 3.0), start=1.0, hyper=True),
    Parameter("spread", InverseGamma(3.0, 0.5), start=0.2, log=True, hyper=True),
    Parameter("speed", Population("mean", "spread"), start=1.0, log=True, dims="series", size=N),
)


@dataclass(frozen=True)
class Waves:
    """y_s(t) = level + 2 sin(30 speed_s t), and its derivatives."""

    parameters: tuple[Parameter, ...]
    outputs: Outputs = WAVES
    name: str = "waves"
    families: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        return content_key(self.name, repr(self.parameters))

    def configure(self, theta: Any) -> dict[str, Any]:
        return dict(unpack(self.parameters, theta))

    def solve(self, configuration: Any, outputs: Outputs | None = None) -> np.ndarray:
        return configuration["level"] + 2 * np.sin(30 * np.outer(configuration["speed"], TIMES))

    def solve_derivatives(self, configure: Any, theta: Any, scales: Any, outputs: Any = None) -> Any:
        at = configure(theta)
        turn = 60 * TIMES * np.cos(30 * np.outer(at["speed"], TIMES))
        by = {"speed": np.eye(N)[:, :, None] * turn, "level": np.ones((1, N, TIMES.size))}
        none = np.zeros((1, N, TIMES.size))
        return self.solve(at), np.concatenate([by.get(p.name, none) for p in self.parameters])


def wave_model(parameters: tuple[Parameter, ...]) -> pm.Model:
    forward = Waves(parameters)
    truth = forward.solve({"speed": np.array([0.9, 1.0, 1.2]), "level": 0.3})
    values = {"w": 2e4, "b": 100.0}
    blank = Data(TIMES, truth, units=["V"] * N)
    errors = LAW.bind(blank).draw(np.random.default_rng(9), values)
    return bayesian_model("waves", forward, Data(TIMES, truth + errors, units=["V"] * N), LAW)


# gradients are compared with differences above, moments with an analytic law in test_nuts.py
@pytest.mark.nightly
@pytest.mark.filterwarnings("ignore")
def test_nuts_has_the_moments_of_the_exact_sampler() -> None:
    model = wave_model((*POPULATION, LEVEL))
    settings: dict[str, Any] = {"chains": 2, "cores": 0, "progress": False}
    exact = sample_exact(model, draws=1800, seed=2, **settings)
    with model:
        nuts = pm.sample(
            250, tune=250, chains=2, cores=1, step=pm.NUTS(), random_seed=1, progressbar=False,
        )  # fmt: skip
    assert float(nuts.sample_stats["diverging"].mean()) < 0.02
    for name in (rv.name for rv in model.free_RVs):
        log = name in ("w", "b", "spread")
        rows = []
        for idata in (exact, nuts):
            draws = idata.posterior[name]
            draws = np.log(draws) if log else draws
            flat = draws.to_numpy().reshape(*draws.shape[:2], -1)
            ess = np.array([float(az.ess(flat[..., i])) for i in range(flat.shape[2])])
            assert ess.min() > 80, (name, ess)
            x = flat.reshape(-1, flat.shape[2])
            rows.append((x.mean(0), x.std(0), ess))
        (mean, sd, n), (other, spread, m) = rows
        assert np.all(np.abs(mean - other) < 4 * np.sqrt(sd**2 / n + spread**2 / m)), name
        assert np.all(np.abs(np.log(sd / spread)) < 4 * np.sqrt(1 / n + 1 / m)), (
            name
        )  # sd of log sd: < 1/sqrt(ess)
