"""Every model of the zoo: priors as published, finite where it should be, ready for PyMC and ArviZ."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import arviz as az
import cloudpickle
import numpy as np
import pymc as pm
import pytest
from scipy import stats

from test_op import small_study
from zoo.blood.conventions import PUBLISHED_CODE
from zoo.blood.network import Network
from zoo.blood.op import blood_flow
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Study
from zoo.core.errors.likelihood import (
    ERROR_PARAMETERS,
    LogUniform,
    ModelRecord,
    gp_errors,
    iid_errors,
    study_model,
)
from zoo.models import MODELS, get_model, suggested

pytestmark = pytest.mark.filterwarnings(
    "ignore:For one or more samples the posterior variance",
    "ignore:The inplace keyword in DataFrame.sort_values",
)

# Table 2 of Paun et al. 2020: wall, error, bounds of the uniform priors, bounds of the log-uniform ones
SCALES = {"psi1": (0.05, 2.5), "psi2": (0.05, 2.5), "c": (0.05, 2.5)}
CONSTANT = {"f3": (2e4, 1e5)}
BY_RADIUS = {"f1": (1e3, 1e7), "f2": (-300, -50), "f3": (3e4, 6e4)}
# where their priors are compared, that of chi at this mean and variance
POPULATION = {"m_chi": (1e4, 1.1e5), "v_chi": (0.5, 30), "chi": (2e4, 1e5)}
MEAN, VARIANCE = 5e4, 2.25
GAMMA = {"gamma": (1, 2 * np.pi)}
GP_BOUNDS = {"w": (1e4, 9e4), "b": (1, 500)}
TABLE_2: dict[str, tuple[str, str, dict[str, tuple[float, float]], dict[str, tuple[float, float]]]] = {
    "A": ("linear", "iid", CONSTANT | SCALES, {}),
    "B": ("linear", "gp", CONSTANT | SCALES, GP_BOUNDS),
    "C": ("linear", "gp", CONSTANT | SCALES, GP_BOUNDS),
    "D": ("linear", "iid", BY_RADIUS | SCALES, {}),
    "E": ("linear", "gp", BY_RADIUS | SCALES, GP_BOUNDS),
    "F": ("linear", "iid", POPULATION | SCALES, {}),
    "G": ("linear", "gp", POPULATION | SCALES, GP_BOUNDS),
    "H": ("tangent", "gp", {"f3": (3e4, 5e5)} | GAMMA | SCALES, GP_BOUNDS),
    "I": (
        "tangent",
        "gp",
        {"f1": (5e3, 1e5), "f2": (-200, 0), "f3": (1e4, 5e5)} | GAMMA | SCALES,
        GP_BOUNDS,
    ),
}
NAMES = list(MODELS)
# of the small study, whose errors are white: any w and b
TRUTH = {"f3": 5e4, "psi1": 0.3, "psi2": 0.9, "c": 1.2, "sigma2": 0.0025, "w": 5e4, "b": 100.0}


@pytest.fixture(scope="module")
def study() -> Study:
    return small_study()


def shape_of(model: pm.Model, name: str) -> tuple[int, ...]:
    """Of one free parameter."""
    return tuple(int(n) for n in model[name].shape.eval())


def likelihood_terms(model: pm.Model, parameters: dict[str, float]) -> np.ndarray:
    """Terms of "y" at values of the free parameters."""
    names = list(model.zoo.parameters)
    values = {name: np.broadcast_to(parameters[name], shape_of(model, name)) for name in names}
    idata = az.from_dict(posterior={name: value[None, None] for name, value in values.items()})
    return (
        pm.compute_log_likelihood(idata, model=model, progressbar=False).log_likelihood["y"].to_numpy()[0, 0]
    )


def test_registry(study: Study) -> None:
    assert {"A", "B"} <= set(NAMES)
    assert set(NAMES) <= set("ABCDEFGHI")
    for name in NAMES:
        assert get_model(name)(study).zoo.name == name
        assert get_model(name).__name__ == f"model_{name}"
        assert get_model(name.lower()) is get_model(name)
    with pytest.raises(ValueError, match=r"model 'Z': must be one of A, B"):
        get_model("Z")


def test_every_model_of_the_registry_has_its_row_of_table_2() -> None:
    assert set(NAMES) == set(TABLE_2)


@pytest.mark.parametrize("name", NAMES)
def test_priors_are_those_of_table_2(name: str, study: Study) -> None:
    wall, error, uniform, log_uniform = TABLE_2[name]
    model = get_model(name)(study)
    assert (model.zoo.wall, model.zoo.error) == (wall, error)
    assert model.zoo.parameters == (*uniform, *ERROR_PARAMETERS[error])
    priors = {p: stats.uniform(low, high - low) for p, (low, high) in uniform.items()}
    priors |= {p: stats.loguniform(low, high) for p, (low, high) in log_uniform.items()}
    if "m_chi" in priors:
        priors |= {
            "m_chi": stats.norm(6e4, 1.5e4),
            "v_chi": stats.invgamma(3, scale=7.78),
            "chi": stats.norm(MEAN, 1e4 * np.sqrt(VARIANCE)),
        }
    if error == "iid":
        priors["sigma2"] = stats.invgamma(0.001, scale=0.001)
    assert set(priors) == set(model.zoo.parameters)
    for parameter, prior in priors.items():
        low, high = (uniform | log_uniform).get(parameter, (1e-3, 10.0))
        inside = np.linspace(low, high, 7)[1:-1]
        x = np.array([low - 1e-3 * (high - low), *inside, high + 1e-3 * (high - low)])
        given = {model["m_chi"]: MEAN, model["v_chi"]: VARIANCE} if parameter == "chi" else {}
        # one value of each component of a vector at a time
        graphs = [pm.logp(model[parameter], np.full(shape_of(model, parameter), v)) for v in x]
        found = [graph.eval(given).flat[0] for graph in graphs]
        np.testing.assert_allclose(found, prior.logpdf(x), err_msg=parameter)


@pytest.mark.parametrize("name", ["F", "G"])
def test_prior_of_each_vessels_stiffness(name: str, study: Study) -> None:
    """Table 2: 90 % of it in (2e4, 1e5)."""
    model = get_model(name)(study)
    chi = pm.draw(model["chi"], draws=20_000, random_seed=4)
    assert chi.shape[1:] == (len(Network.from_study(study).ids),)
    assert np.mean((chi > 2e4) & (chi < 1e5)) == pytest.approx(0.9, abs=0.01)
    # information is shared: the stiffnesses of two vessels are correlated
    assert 0.2 < np.corrcoef(chi[:, 0], chi[:, 1])[0, 1] < 0.6


@pytest.mark.parametrize("name", ["F", "G"])
def test_limits_of_the_population(name: str, study: Study) -> None:
    """Its variance gone, all vessels are equal, which is model A or B; its variance large, they are free."""
    model = get_model(name)(study)
    values = suggested(name) | {"sigma2": 0.3, "w": 3e4, "b": 40.0}
    simple = get_model({"F": "A", "G": "B"}[name])(study)
    collapsed = pm.draw(pm.do(model, {"m_chi": 4.7e4, "v_chi": 1e-14})["chi"], draws=5, random_seed=1)
    np.testing.assert_allclose(collapsed, 4.7e4, rtol=1e-6)
    np.testing.assert_allclose(
        likelihood_terms(model, values | {"chi": collapsed[0]}),
        likelihood_terms(simple, values | {"f3": 4.7e4}),
        rtol=1e-6,
        atol=1e-5,
    )
    stiffness = np.geomspace(2e4, 9e4, collapsed.shape[1])
    wide = {model["m_chi"]: 5e4, model["v_chi"]: 1e8}
    free, same = (pm.logp(model["chi"], at).eval(wide).sum() for at in (stiffness, collapsed[0]))
    assert abs(free - same) < 1e-3


@pytest.mark.parametrize("name", NAMES)
def test_suggested_parameters_give_a_finite_density(name: str, study: Study) -> None:
    model = get_model(name)(study)
    assert tuple(suggested(name)) == model.zoo.parameters
    assert dict(model.zoo.suggested) == suggested(name)
    terms = likelihood_terms(model, suggested(name))
    assert terms.shape == (2, 32)
    assert np.all(np.isfinite(terms))
    assert np.isfinite(model.compile_logp()(model.initial_point()))


@pytest.mark.parametrize("name", NAMES)
def test_dimensions_and_record(name: str, study: Study) -> None:
    options = SolverOptions(dx_cm=0.05)
    model = get_model(name)(study, options=options, conventions=PUBLISHED_CODE)
    assert model.coords["vessel"] == tuple(Network.from_study(study).ids)
    assert model.coords["series"] == tuple(series.label for series in study.series)
    np.testing.assert_array_equal(model.coords["time"], study.time_s)
    assert model.named_vars_to_dims["y"] == ("series", "time")
    record = model.zoo
    assert isinstance(record, ModelRecord)
    assert record.study is study
    assert record.options == options
    assert record.op.solver.conventions == PUBLISHED_CODE
    assert record.error_parameters == ERROR_PARAMETERS[record.error]


@pytest.mark.parametrize("name", NAMES)
def test_a_pickled_model_keeps_its_density_and_record(name: str, study: Study) -> None:
    model = get_model(name)(study)
    copy = pickle.loads(cloudpickle.dumps(model))
    point = model.initial_point()
    model.zoo.op.clear_cache()
    model.zoo.op.reset_counts()
    assert float(copy.compile_logp()(point)) == float(model.compile_logp()(point))
    assert (copy.zoo.name, copy.zoo.parameters) == (model.zoo.name, model.zoo.parameters)
    assert copy.zoo.op == model.zoo.op
    assert copy.zoo.op.counts["solves"] == 1  # in one process copies share their solved points


def test_likelihood_of_a(study: Study) -> None:
    values = {"f3": 4.7e4, "psi1": 0.25, "psi2": 0.95, "c": 1.1, "sigma2": 0.3}
    solution = Solver.for_study(study).solve(4.7e4, 2.0, 0.25, 0.95, 1.1)
    expected = stats.norm.logpdf(study.values, solution.pressure_mmHg, np.sqrt(0.3))
    np.testing.assert_allclose(likelihood_terms(get_model("A")(study), values), expected, rtol=1e-10)


def test_likelihood_of_b(study: Study) -> None:
    values = {"f3": 4.7e4, "psi1": 0.25, "psi2": 0.95, "c": 1.1, "w": 3e4, "b": 40.0}
    residual = study.values - Solver.for_study(study).solve(4.7e4, 2.0, 0.25, 0.95, 1.1).pressure_mmHg
    t = study.time_s
    norm = 1 + 2 * (40.0 + 3e4 * t**2)
    k = 2 / np.pi * np.arcsin(2 * (40.0 + 3e4 * np.outer(t, t)) / np.sqrt(np.outer(norm, norm)))
    normal = stats.multivariate_normal(np.zeros(len(t)), k + 3.44e-6 * np.eye(len(t)))
    terms = likelihood_terms(get_model("B")(study), values)
    np.testing.assert_allclose(terms.sum(axis=1), normal.logpdf(residual), rtol=1e-6)


def sample(model: pm.Model, draws: int = 30, **settings: Any) -> az.InferenceData:
    with model:
        return pm.sample(
            step=pm.DEMetropolisZ(),
            draws=draws,
            tune=draws,
            chains=2,
            cores=2,
            progressbar=False,
            compute_convergence_checks=False,
            random_seed=3,
            **settings,
        )


def start(model: pm.Model) -> dict[str, Any]:
    """Suggested values, and the truth where it is known."""
    values = suggested(model.zoo.name) | {p: TRUTH[p] for p in model.zoo.parameters if p in TRUTH}
    return {name: np.broadcast_to(value, shape_of(model, name)) for name, value in values.items()}


def test_sampling_waic_and_predictive_draws_of_all(study: Study) -> None:
    idatas = {}
    for name in NAMES:
        model = get_model(name)(study)
        idata = sample(
            model,
            initvals=start(model),
        )
        assert set(idata.posterior) == set(model.zoo.parameters)
        pm.compute_log_likelihood(idata, model=model, progressbar=False)
        assert idata.log_likelihood["y"].dims == ("chain", "draw", "series", "time")
        assert np.all(np.isfinite(idata.log_likelihood["y"]))
        predictive = pm.sample_posterior_predictive(
            idata, model=model, var_names=["y"], progressbar=False, random_seed=1
        ).posterior_predictive["y"]
        assert predictive.shape == (2, 30, 2, 32)
        assert np.all(np.isfinite(predictive))
        idatas[name] = idata
    table = az.compare(idatas, ic="waic", scale="deviance")
    assert set(table.index) == set(NAMES)
    assert np.all(np.isfinite(table["elpd_waic"]))


def stiff_model(study: Study, errors: Callable) -> pm.Model:
    """A wall that may be so stiff that no time step allowed is short enough."""
    with study_model("stiff", study) as model:
        f3 = LogUniform("f3", 1e3, 1e12)
        mean, ok = blood_flow(study, "linear", f3, 0.3, 0.9, 1.2)
        errors(mean, ok, study)
    return model


@pytest.mark.parametrize("errors", [iid_errors, gp_errors])
def test_no_density_where_the_solve_fails_and_finite_elsewhere(errors: Callable, study: Study) -> None:
    model = stiff_model(study, errors)
    record = model.zoo
    assert record.name == "stiff"
    record.op.clear_cache()
    record.op.reset_counts()
    others = {"sigma2": 0.1, "w": 5e4, "b": 100.0}
    assert np.all(np.isfinite(likelihood_terms(model, {"f3": 2e5, **others})))
    assert np.all(likelihood_terms(model, {"f3": 1e11, **others}) == -np.inf)
    assert record.op.counts["failures"] == {"cfl": 1}


def test_a_chain_leaves_failed_solves_out(study: Study) -> None:
    model = stiff_model(study, iid_errors)
    idata = sample(model, initvals={"f3": 5e4})
    pm.compute_log_likelihood(idata, model=model, progressbar=False)
    assert np.all(np.isfinite(idata.log_likelihood["y"]))


def test_errors_refuse_what_they_cannot_hold_for() -> None:
    mixed = small_study(quantities=("pressure_mmHg", "flow_ml_s"))
    with pytest.raises(
        ValueError, match="observes flow_ml_s and pressure_mmHg: one sigma2 cannot hold for both"
    ):
        get_model("A")(mixed)
    with pytest.raises(ValueError, match=r"observes v2@0.5 flow_ml_s: the Gaussian process' amplitude"):
        get_model("B")(mixed)
    get_model("A")(small_study(quantities=("flow_ml_s", "flow_ml_s")))


def test_a_model_made_without_study_model_is_recorded_too(study: Study) -> None:
    coords = {"series": [0, 1], "time": study.time_s}
    with pm.Model(coords=coords) as model:
        f3 = pm.Uniform("f3", 2e4, 1e5)
        mean, ok = blood_flow(study, "linear", f3, 0.3, 0.9, 1.2)
        iid_errors(mean, ok, study)
    assert (model.zoo.name, model.zoo.parameters) == ("custom", ("f3", "sigma2"))
