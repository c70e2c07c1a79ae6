"""Every model of the zoo: priors as published, finite where it should be, ready for PyMC and ArviZ."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import cloudpickle
import numpy as np
import pymc as pm
import pytest
from scipy import stats

from test_op import STIFF, small_study
from zoo.blood.baseline import get_baseline, study_model
from zoo.blood.effects import CATALOGUE
from zoo.blood.network import Network
from zoo.blood.solver import Solver
from zoo.blood.study import Study, StudyError, load_study
from zoo.core.arviz_lines import ARVIZ_1, InferenceData, of_draws, ranked, waic
from zoo.core.effects import EffectError, EffectParameter, Location, effect
from zoo.core.errors.base import ErrorModel
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.errors.independent import Independent
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.model import ModelError
from zoo.core.parameters import LogUniform, pack
from zoo.models import MODELS, PAPER, get_model, suggested

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
SD = 1e4 * np.sqrt(VARIANCE)
GAMMA = {"gamma": (1, 2 * np.pi)}
TANGENT_BY_RADIUS = {"f1": (5e3, 1e5), "f2": (-200, 0), "f3": (1e4, 5e5)}
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
    "I": ("tangent", "gp", TANGENT_BY_RADIUS | GAMMA | SCALES, GP_BOUNDS),
}
NAMES = list(MODELS)
ERROR_PARAMETERS = {"iid": ("sigma2",), "gp": ("w", "b")}
# of the small study, whose errors are white: any w and b
TRUTH = {"f3": 5e4, "psi1": 0.3, "psi2": 0.9, "c": 1.2, "sigma2": 0.0025, "w": 5e4, "b": 100.0}


def shape_of(model: pm.Model, name: str) -> tuple[int, ...]:
    """Of one free parameter."""
    return tuple(int(n) for n in model[name].shape.eval())


def likelihood_terms(model: pm.Model, parameters: dict[str, float]) -> np.ndarray:
    """Terms of "y" at values of the free parameters."""
    names = list(model.zoo.parameters)
    values = {name: np.broadcast_to(parameters[name], shape_of(model, name)) for name in names}
    idata = of_draws({"posterior": {name: value[None, None] for name, value in values.items()}})
    terms = pm.compute_log_likelihood(idata, model=model, progressbar=False).log_likelihood["y"]
    return terms.to_numpy()[0, 0]


def test_registry(study: Study) -> None:
    assert set(PAPER) == set("ABCDEFGHI") == set(TABLE_2)
    assert set(PAPER) <= set(NAMES)
    for name in NAMES:
        assert get_model(name)(study).zoo.name == name
        assert get_model(name).__name__ == f"model_{name}"
        assert get_model(name.lower()) is get_model(name)
    with pytest.raises(ValueError, match=r"model 'Z': must be one of A, B"):
        get_model("Z")


@pytest.mark.parametrize("name", PAPER)
def test_priors_are_those_of_table_2(name: str, study: Study) -> None:
    wall, error, uniform, log_uniform = TABLE_2[name]
    model = get_model(name)(study)
    assert (model.zoo.forward.wall, model.zoo.errors.name) == (wall, error)
    assert model.zoo.parameters == (*uniform, *ERROR_PARAMETERS[error])
    priors = {p: stats.uniform(low, high - low) for p, (low, high) in uniform.items()}
    priors |= {p: stats.loguniform(low, high) for p, (low, high) in log_uniform.items()}
    if "m_chi" in priors:
        priors |= {
            "m_chi": stats.norm(6e4, 1.5e4),
            "v_chi": stats.invgamma(3, scale=7.78),
            "chi": stats.truncnorm(-MEAN / SD, np.inf, MEAN, SD),
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
def test_suggested_parameters_give_a_finite_density_that_a_pickle_keeps(name: str, study: Study) -> None:
    model = get_model(name)(study)
    assert tuple(suggested(name)) == model.zoo.parameters
    for parameter, value in model.zoo.suggested.items():
        np.testing.assert_array_equal(value, np.full(shape_of(model, parameter), suggested(name)[parameter]))
    terms = likelihood_terms(model, suggested(name))
    assert terms.shape == (2, 32)
    assert np.all(np.isfinite(terms))
    copy, point = pickle.loads(cloudpickle.dumps(model)), model.initial_point()
    model.zoo.op._state.clear()
    density = float(model.compile_logp()(point))
    assert np.isfinite(density)
    assert float(copy.compile_logp()(point)) == density
    assert (copy.zoo.name, copy.zoo.parameters) == (model.zoo.name, model.zoo.parameters)
    assert copy.zoo.op == model.zoo.op
    # in one process copies share their solved points, but functions that numba compiled keep none
    assert copy.zoo.op.counts["solves"] == (2 if ARVIZ_1 else 1)


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


def sample(model: pm.Model, draws: int = 30, **settings: Any) -> InferenceData:
    with model:
        settings |= {"progressbar": False, "compute_convergence_checks": False, "random_seed": 3}
        return pm.sample(draws, tune=draws, chains=2, cores=1, step=pm.DEMetropolisZ(), **settings)


def start(model: pm.Model) -> dict[str, Any]:
    """Suggested values, and the truth where it is known."""
    values = suggested(model.zoo.name) | {p: TRUTH[p] for p in model.zoo.parameters if p in TRUTH}
    return {name: np.broadcast_to(value, shape_of(model, name)) for name, value in values.items()}


def test_sampling_waic_and_predictive_draws(study: Study) -> None:
    """Of both walls, both errors, and all three laws of the stiffness."""
    names, idatas = ("A", "G", "I"), {}
    for name in names:
        model = get_model(name)(study)
        idata = sample(model, initvals=start(model))
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
    table = ranked({name: waic(idata.log_likelihood["y"]) for name, idata in idatas.items()}, "stacking")
    assert set(table.index) == set(names)
    assert np.all(np.isfinite(table["elpd"]))


@pytest.mark.parametrize(
    "errors", [Independent(), GaussianProcess(LogUniform(1e4, 9e4), LogUniform(1, 500), unit="mmHg")]
)
def test_no_density_where_the_solve_fails_and_finite_elsewhere(errors: ErrorModel, study: Study) -> None:
    model = study_model("stiff", STIFF, errors)(study)
    record = model.zoo
    assert record.name == "stiff"
    record.op._state.clear()
    others = {"sigma2": 0.1, "w": 5e4, "b": 100.0}
    assert np.all(np.isfinite(likelihood_terms(model, {"f3": 2e5, **others})))
    assert np.all(likelihood_terms(model, {"f3": 1e11, **others}) == -np.inf)
    assert record.op.counts["failures"] == {"cfl": 1}


def test_errors_refuse_what_they_cannot_hold_for() -> None:
    mixed = small_study(quantities=("pressure_mmHg", "flow_ml_s"))
    baseline = get_baseline("B")
    with pytest.raises(ValueError, match="observes flow_ml_s and pressure_mmHg: one sigma2 cannot hold for"):
        study_model("own", baseline, Independent())(mixed)
    process = GaussianProcess(LogUniform(1e4, 9e4), LogUniform(1, 500), unit="mmHg")
    with pytest.raises(ValueError, match=r"observes v2@0.5 flow_ml_s: the Gaussian process' amplitude"):
        study_model("own", baseline, process)(mixed)
    with pytest.raises(StudyError, match=r"'paun2020': its errors are of one quantity, the study observes"):
        get_model("A")(mixed)
    known = replace(small_study(), noise_sd={"pressure_mmHg": 0.05})
    with pytest.raises(StudyError, match=r"'paun2020': has a noise of its own, but noise_sd gives that of"):
        get_model("B")(known)
    get_model("A")(small_study(quantities=("flow_ml_s", "flow_ml_s")))


# log-posteriors that models written out in PyMC, parameter by parameter, gave in the study "demo"
WRITTEN_OUT = {
    "A": (-28214.297912940296, -23321.12775381646, -31683.14646619532),
    "B": (3142.0139746716536, 3147.0564253276425, 3137.463814935254),
    "C": (3142.1258218540424, 3147.2272622733963, 3137.575264005253),
    "D": (-47179.716130252214, -41802.877330705494, -50934.769205041885),
    "E": (3053.4681628359144, 3050.9769450566246, 3053.2218727532186),
    "F": (-112234.56727178529, -101461.24030746939, -120015.207127773),
    "G": (3120.4386020959264, 3125.981741104785, 3115.6875092673245),
    "H": (2579.2930981971017, 2568.764667282756, 2584.9996900052383),
    "I": (2812.9312401890193, 2807.132385624303, 2815.6331984568296),
}


@pytest.mark.parametrize("name", PAPER)
def test_log_posterior_is_that_of_the_model_written_out(name: str) -> None:
    """At the suggested values, and at 0.97 and 1.02 of them; stiffnesses fan out by 10 %."""
    model = get_model(name)(replace(load_study("demo"), priors={"set": "paun2020"}))
    logp = LogPosterior(model)
    for scale, expected in zip((1.0, 0.97, 1.02), WRITTEN_OUT[name], strict=True):
        values = {p: np.full(shape_of(model, p), scale * x) for p, x in suggested(name).items()}
        if "chi" in values:
            values["chi"] *= np.linspace(0.9, 1.1, len(values["chi"]))
            # the numbers are of a population that is normal; of one above zero it is so much denser
            above = stats.norm.logcdf(values["m_chi"] / (1e4 * np.sqrt(values["v_chi"])))
            expected -= len(values["chi"]) * float(above)
        assert logp(logp.from_values(values)) == pytest.approx(expected, rel=1e-9)


# ---------------------------------------------------------------------------------------------------
# Effects in a model


@pytest.mark.parametrize("name", [name for name in NAMES if name not in "BCDF"])  # with the walls of A, E, G
def test_effects_go_into_any_model(name: str, study: Study) -> None:
    offered = CATALOGUE["local-stiffness"].offered(get_model(name)(study).zoo.forward.name)
    assert offered or name not in "ABCDEHI"
    local = [("local-stiffness", 2)] if offered else []
    model = get_model(name)(study, effects=["viscoelastic-wall", *local])
    extra = ("viscoelastic-wall.tau", *["local-stiffness@2.log-stiffness" for _ in local])
    plain = get_model(name)(study)
    n = len(plain.zoo.error_parameters)
    assert model.zoo.parameters == (*plain.zoo.parameters[:-n], *extra, *plain.zoo.parameters[-n:])
    assert model.zoo.name == "+".join([name, "viscoelastic-wall", *["local-stiffness@2" for _ in local]])
    assert np.isfinite(model.compile_logp()(model.initial_point()))
    prior = pm.logp(model["viscoelastic-wall.tau"], 2e-3).eval()
    scale = CATALOGUE["viscoelastic-wall"].of(plain.zoo.forward).parameters[0].scale
    assert scale == pytest.approx(0.027 * study.period_s)
    assert prior == pytest.approx(stats.truncnorm(0, 10, scale=scale).logpdf(2e-3), rel=1e-3)
    off = {**suggested(name), **dict.fromkeys(extra, 0.0)}
    without = likelihood_terms(plain, suggested(name))
    np.testing.assert_allclose(likelihood_terms(model, off), without, rtol=1e-9, atol=1e-9)
    on = {**suggested(name), **dict.fromkeys(extra, 2e-3)}
    assert np.abs(likelihood_terms(model, on) - without).max() > 1e-4


def test_effects_are_given_in_many_ways_and_refused_with_words(study: Study) -> None:
    local = CATALOGUE["local-stiffness"]
    names = [
        get_model("B")(study, effects=[given]).zoo.name
        for given in ("local-stiffness@2", ("local-stiffness", 2), (local, "2"), local.at(Location(2)))
    ]
    assert names == ["B+local-stiffness@2"] * 4
    for model, given, words in (
        ("B", "stiffness", "effect 'stiffness': unknown; did you mean"),
        ("B", "local-stiffness", "the location is missing; it acts at vessel 1, vessel 2, vessel 3"),
        ("B", "local-stiffness@9", "cannot act at vessel 9; it acts at"),
        ("B", "local-stiffness@left", "give a vessel's id"),
        ("B", "taper@2", "cannot act at vessel 2; it acts everywhere"),
        ("H", "tangent-wall", "cannot be added to tangent-constant, only to linear-constant"),
        ("G", "local-stiffness@2", "cannot be added to linear-vessels, only to"),
        ("B", "correlated-noise", "is part of the errors"),
    ):
        with pytest.raises(EffectError, match=words):
            get_model(model)(study, effects=[given])
    with pytest.raises(EffectError, match="is given twice at everywhere"):
        get_model("A")(study, effects=["taper", "taper"])


def test_an_effect_of_ones_own_travels_with_the_model(study: Study) -> None:
    """By value: the process that unpickles it does not have the function's module."""

    @effect("louder", "sensor", parameters=[EffectParameter("share", "1", 0.1, -0.5, 0.5, (0.1,))])
    def louder(case: Any, values: tuple[float, ...], location: Location) -> Any:
        """More inflow."""
        return replace(case, inflow_ml_s=case.inflow_ml_s * (1 + values[0]))

    model = get_model("A")(study, effects=[louder])
    copy = pickle.loads(cloudpickle.dumps(model))
    point = model.initial_point()
    assert float(copy.compile_logp()(point)) == float(model.compile_logp()(point))
    assert copy.zoo.name == "A+louder"


@pytest.mark.parametrize("name", ["F", "G"])
def test_a_change_of_the_population_alone_needs_no_solve(name: str, study: Study) -> None:
    model = get_model(name)(study)
    op, forward = model.zoo.op, model.zoo.forward
    op._state.clear()
    values = {p.name: suggested(name)[p.name] for p in forward.parameters}
    for mean in (5e4, 6e4):
        op.evaluate(pack(forward.parameters, values | {"m_chi": mean, "v_chi": mean / 1e4}))
    assert op.counts["solves"] == 1
    op.evaluate(pack(forward.parameters, values | {"chi": 4e4}))
    assert op.counts["solves"] == 2


def test_a_graph_of_a_model_says_what_it_lacks(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """The Python package and the program `dot` have cures of their own."""
    model = get_model("A")(study)
    monkeypatch.setattr(pm.Model, "to_graphviz", lambda model, **options: options)
    monkeypatch.setattr("shutil.which", lambda program: f"/usr/bin/{program}")
    monkeypatch.setattr("zoo.core.model.find_spec", lambda package: package)
    assert model.to_graphviz(dpi=100) == {"dpi": 100}
    monkeypatch.setattr("shutil.which", lambda program: None)
    with pytest.warns(UserWarning, match="no program dot, which draws the graph: .*`apt install graphviz`"):
        assert model.to_graphviz() == {}
    monkeypatch.setattr("zoo.core.model.find_spec", lambda package: None)
    with pytest.raises(ModelError, match=r"no Python package graphviz: pip install 'pymc-zoo\[graphviz\]'"):
        model.to_graphviz()
