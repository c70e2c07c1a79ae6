"""Models of several subjects: the log-posterior by SciPy, an analytic posterior, calibration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pymc as pm
import pytest
from scipy import stats

import zoo
from zoo.core.arviz_lines import dataset
from zoo.core.data import Data
from zoo.core.errors.groups import GroupNoise
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.inference.record import RunRecord
from zoo.core.joint import by_subject, joint_model, of_subject
from zoo.core.model import ModelError, bayesian_model
from zoo.core.parameters import LogNormal, LogUniform, Normal, Parameter, Prior, Uniform

TIMES = {"a": np.linspace(0.0, 1.0, 6), "b": np.linspace(0.2, 2.0, 9), "c": np.linspace(0.0, 0.5, 4)}
SD = 0.3


def line(c: Any, t: np.ndarray) -> np.ndarray:
    return c["level"] + c["slope"] * t


def subject(
    name: str, level: Prior | None = None, slope: Prior | None = None, known: bool = True
) -> pm.Model:
    """A line that was measured at this subject's times."""
    t = TIMES[name]
    parameters = (
        Parameter("level", level or Normal(1.0, 2.0), "V"),
        Parameter("slope", slope or Normal(0.0, 1.5), "V/s"),
    )
    noise = np.random.default_rng(ord(name)).normal(0, SD, len(t))
    data = Data(t, ord(name) - 97.0 + 0.7 * t + noise, labels=["u"], units=["V"], name=name)
    errors = GroupNoise(known={"u": SD} if known else {})
    return bayesian_model("line", FunctionModel(line, parameters, Outputs(("u",), t)), data, errors)


def log_likelihood(name: str, level: float, slope: float, sd: float = SD) -> float:
    data = subject(name).zoo.data
    return float(stats.norm.logpdf(data.values[0], level + slope * data.times, sd).sum())


def test_the_log_posterior_is_the_sum_of_its_parts() -> None:
    """Shared slope, a population of levels on the logarithmic scale, a noise for each; no Jacobians."""
    law = LogNormal(1.5, 0.4)
    models = {name: subject(name, level=law, known=False) for name in "abc"}
    model = joint_model(models, share=["slope"], population=["level"])
    median, s, slope, z = 1.7, 0.35, 0.6, np.array([0.4, -1.0, 0.2])
    noises = {f"noise_u[{name}]": sd for name, sd in zip("abc", (0.2, 0.4, 0.6), strict=True)}
    levels = np.exp(np.log(median) + s * z)
    expected = stats.lognorm.logpdf(median, 0.4, scale=1.5) + stats.halfnorm.logpdf(
        s, scale=0.4 * stats.norm.ppf(0.84)
    )
    expected += stats.norm.logpdf(z).sum() + stats.norm.logpdf(slope, 0, 1.5)
    for k, (name, sd) in enumerate(zip("abc", noises.values(), strict=True)):
        (noise,) = models[name].zoo.errors.parameters
        expected += noise.prior.log_density(np.array(sd), {}) + log_likelihood(name, levels[k], slope, sd)
    values = {"level_median": median, "level_sd": s, "level_offset": z, "slope": slope, **noises}
    assert set(values) == {rv.name for rv in model.free_RVs}
    found = sum(
        float(term)
        for term in pm.pytensorf.compile(
            [model.rvs_to_values[rv] for rv in model.free_RVs], model.logp(jacobian=False, sum=False)
        )(*[unconstrained(model, rv, values[rv.name]) for rv in model.free_RVs])
        for term in [np.sum(term)]
    )
    assert found == pytest.approx(expected, rel=1e-10)


def unconstrained(model: pm.Model, rv: Any, value: Any) -> np.ndarray:
    transform = model.rvs_to_transforms[rv]
    value = np.asarray(value, dtype=float)
    return value if transform is None else transform.forward(value, *rv.owner.inputs).eval()


def analytic() -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of slope and the levels of a, b and c, which is normal."""
    precision = np.diag(1 / np.array([1.5, 2.0, 2.0, 2.0]) ** 2)
    total = precision @ np.array([0.0, 1.0, 1.0, 1.0])
    for k, name in enumerate("abc"):
        data = subject(name).zoo.data
        design = np.zeros((len(data.times), 4))
        design[:, 0], design[:, 1 + k] = data.times, 1.0
        precision += design.T @ design / SD**2
        total += design.T @ data.values[0] / SD**2
    return np.linalg.solve(precision, total), np.linalg.inv(precision)


@pytest.fixture(scope="module")
def shared() -> pm.Model:
    return joint_model([subject(name) for name in "abc"], share=["slope"])


@pytest.fixture(scope="module")
def drawn(shared: pm.Model, tmp_path_factory: pytest.TempPathFactory) -> Any:
    path = tmp_path_factory.mktemp("joint") / "joint.nc"
    zoo.save_posterior(
        zoo.sample(shared, draws=800, tune=600, chains=4, seed=3, cores=0, progress=False), path
    )
    return zoo.load_posterior(path)


def test_a_shared_parameters_posterior_is_the_analytic_one(drawn: Any) -> None:
    posterior, (mean, covariance) = dataset(drawn), analytic()
    assert posterior["level"].dims == ("chain", "draw", "subject")
    assert posterior["level"].attrs["units"] == "V"
    assert posterior["slope"].attrs["units"] == "V/s"
    columns = [posterior["slope"], *(posterior["level"].sel(subject=name) for name in "abc")]
    for i, draws in enumerate(columns):
        verdict = zoo.verdict(drawn)
        ess = min(p.ess_bulk for p in verdict.parameters)
        sd = np.sqrt(covariance[i, i])
        assert float(draws.mean()) == pytest.approx(mean[i], abs=4.5 * sd / np.sqrt(ess))
        assert float(draws.std()) == pytest.approx(sd, rel=4.5 / np.sqrt(ess))
    assert RunRecord.of(drawn).study == "a, b, c"


def test_an_interrupted_run_goes_on_with_the_same_draws(shared: pm.Model, tmp_path: Path) -> None:
    settings = {"tune": 100, "chains": 2, "seed": 5, "cores": 0, "progress": False}
    whole = zoo.sample(shared, draws=60, **settings)
    zoo.sample(shared, draws=30, checkpoint=tmp_path / "run", **settings)
    again = zoo.sample(shared, draws=60, checkpoint=tmp_path / "run", **settings)
    np.testing.assert_array_equal(dataset(again)["level"], dataset(whole)["level"])
    assert RunRecord.of(again).sittings == 2


def test_studies_are_subjects_with_a_solver_each() -> None:
    """The density of both data sets is the sum of that of each, at the same parameters."""
    rest = zoo.load_study("demo")
    louder = tuple(replace(one, value=1.1 * one.value) for one in rest.series)
    both = [rest, replace(rest, name="other", series=louder)]
    priors = {"f3": LogUniform(2e4, 4e5)}
    model = zoo.model_B(both, share=["f3"], priors=priors)
    names = [rv.name for rv in model.free_RVs]
    assert names.count("f3") == 1
    assert {"c[demo]", "c[other]"} <= set(names)
    terms = model.point_logps()
    for one in both:
        alone = zoo.model_B(one, priors=priors)
        assert terms[f"y[{one.name}]"] == pytest.approx(alone.point_logps()["y"], rel=1e-9)
    with pytest.raises(ModelError, match="share = f3: is of several studies"):
        zoo.model_B(rest, share=["f3"])


def test_one_subjects_draws_go_on_with_its_own_model(drawn: Any, shared: pm.Model) -> None:
    own = of_subject(drawn, shared, "b")
    found = zoo.add_groups(own, subject("b"), n_draws=5, n_prior=0)
    joint = found["log_likelihood"]["y"].sum(("series", "time"))[0, 0]
    draws = dataset(drawn)
    at = draws["level"].sel(subject="b")[0, 0], draws["slope"][0, 0]
    assert float(joint) == pytest.approx(log_likelihood("b", *map(float, at)), rel=1e-5)
    with pytest.raises(ModelError, match=r"subject = 'd': .*a, b"):
        of_subject(drawn, shared, "d")


def test_a_population_between_two_bounds_stays_there() -> None:
    bounded = {name: subject(name, slope=Uniform(0.5, 2.0)) for name in "ab"}
    model = joint_model(bounded, population={"slope": "unconstrained"})
    with model:
        prior = pm.sample_prior_predictive(
            500, random_seed=1, var_names=["slope", "slope_median", "slope_sd"]
        )
    draws = dataset(prior, "prior")["slope"].values
    assert draws.min() > 0.5
    assert draws.max() < 2.0
    assert np.corrcoef(draws[0].T)[0, 1] > 0.2  # of one population


def test_draws_of_another_sampler_get_the_dimension(shared: pm.Model) -> None:
    with shared:
        idata = pm.sample(
            5, tune=5, chains=1, cores=1, step=zoo.step(shared), random_seed=1, progressbar=False,
            compute_convergence_checks=False,
        )  # fmt: skip
    assert dataset(by_subject(idata, shared))["level"].sizes["subject"] == 3


@pytest.mark.parametrize(
    ("models", "settings", "told"),
    [
        ([subject("a")], {}, "1 subjects: give at least two"),
        ([subject("a"), subject("a")], {}, "subject 'a': is there twice"),
        ([subject("a"), subject("b")], {"share": ["slop"]}, r"share = slop: subject a: .*slope"),
        ([subject("a"), subject("b")], {"share": "slope"}, r"share = 'slope': give a list"),
        (
            [subject("a"), subject("b", slope=Normal(1.0, 1.0))],
            {"share": ["slope"]},
            r"share = slope: its prior is .* in a and .* in b: must be one",
        ),
        (
            [subject("a"), subject("b")],
            {"share": ["slope"], "population": ["slope"]},
            "population = slope: is shared already",
        ),
        ([subject("a"), subject("b")], {"population": {"slope": "log"}}, "prior .* reaches below 0"),
        ([subject("a"), subject("b")], {"population": {"slope": "root"}}, "scale 'root': must be one of log"),
    ],
)
def test_what_cannot_be_joined(models: Any, settings: Any, told: str) -> None:
    with pytest.raises(ModelError, match=told):
        joint_model(models, **settings)
