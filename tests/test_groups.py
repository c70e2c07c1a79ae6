"""The groups and units of an InferenceData, on a line whose posterior is known, and on the demo study."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import arviz as az
import numpy as np
import pymc as pm
import pytest
from scipy import stats
from typer.testing import CliRunner

import zoo
from test_errors import covariance_of
from zoo import find_mode, load_study, model_B
from zoo.cli import app
from zoo.core.arviz_lines import ARVIZ_1, datasets, of_draws
from zoo.core.data import Data
from zoo.core.errors.groups import GroupNoise
from zoo.core.errors.independent import Independent
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.inference.record import ResultsError, RunRecord
from zoo.core.model import bayesian_model
from zoo.core.parameters import InverseGamma, Normal, Parameter
from zoo.core.posterior.arviz_groups import N_TERMS, add_groups, by_place
from zoo.core.posterior.storage import load, save_posterior, slim_posterior
from zoo.report.chapter import sampling_command

TIMES = np.arange(12.0)
ROOT = Path(__file__).resolve().parents[1]


def line(c, t):
    return c["a"] + c["b"] * t


@pytest.fixture(scope="module")
def model():
    parameters = (Parameter("a", Normal(0.0, 2.0), "V"), Parameter("b", Normal(0.0, 1.0), "V/s"))
    values = 1.0 + 0.5 * TIMES + 0.3 * np.random.default_rng(5).standard_normal(12)
    data = Data(TIMES, values, labels=["u"], units=["V"], name="line")
    forward = FunctionModel(line, parameters, Outputs(("u",), TIMES))
    constants = {"gain": ((), 2.0, "V/A")}
    return bayesian_model("line", forward, data, Independent(InverseGamma(3.0, 0.3)), constants=constants)


@pytest.fixture(scope="module")
def draws():
    """Draws that stand for a posterior, more than are kept."""
    rng = np.random.default_rng(0)
    shape = (4, 400)
    values = {"a": 1.0 + 0.1 * rng.standard_normal(shape), "b": 0.5 + 0.01 * rng.standard_normal(shape)}
    return of_draws({"posterior": values | {"sigma2": 0.09 * np.exp(0.1 * rng.standard_normal(shape))}})


@pytest.fixture(scope="module")
def whole(model, draws):
    return add_groups(draws, model, seed=3)


def test_groups_are_arvizs(whole, draws):
    wanted = {"posterior", "log_likelihood", "posterior_predictive", "prior", "prior_predictive"}
    assert wanted | {"observed_data", "constant_data"} == set(datasets(whole))
    assert whole.posterior.sizes == draws.posterior.sizes
    assert list(datasets(draws)) == ["posterior"]
    assert "units" not in draws.posterior["a"].attrs


def test_log_likelihood_is_that_of_the_draws_it_names(whole, model):
    terms = whole.log_likelihood["y"]
    assert terms.dims == ("chain", "draw", "series", "time")
    assert terms.sizes["chain"] * terms.sizes["draw"] == N_TERMS
    for chain, draw in ((0, 0), (2, 100), (3, 249)):
        at = whole.posterior.sel(chain=chain, draw=int(terms["draw"][draw]))
        mean = float(at["a"]) + float(at["b"]) * TIMES
        expected = stats.norm(mean, math.sqrt(float(at["sigma2"]))).logpdf(model.zoo.data.values[0])
        np.testing.assert_allclose(terms[chain, draw, 0], expected, rtol=1e-5)


def test_predictions_have_the_errors_of_the_draws(whole):
    drawn = whole.posterior_predictive["y"].stack(all=("chain", "draw"))[0].to_numpy()
    variance = 0.09 * math.exp(0.005) + 0.1**2 + (0.01 * TIMES) ** 2
    np.testing.assert_allclose(drawn.mean(1), 1.0 + 0.5 * TIMES, atol=4 * math.sqrt(variance.max() / 1000))
    np.testing.assert_allclose(drawn.var(1), variance, rtol=0.25)
    prior = whole.prior_predictive["y"].to_numpy()[0, :, 0]
    assert np.isfinite(prior).all()
    np.testing.assert_allclose(prior.std(0), np.sqrt(4.0 + TIMES**2 + 0.15), rtol=0.25)


def test_units_are_attributes(whole):
    assert {n: v.attrs["units"] for n, v in whole.posterior.data_vars.items()} == {
        "a": "V", "b": "V/s", "sigma2": "V2",
    }  # fmt: skip
    assert whole.prior["b"].attrs["units"] == "V/s"
    assert "units" not in whole.log_likelihood["y"].attrs
    for group in (whole.log_likelihood, whole.posterior_predictive, whole.prior_predictive):
        assert group["unit"].to_numpy().tolist() == ["V"]
    assert whole.observed_data["y"].attrs["units"] == "V"
    assert whole.observed_data["time"].attrs["units"] == "s"
    assert whole.constant_data["gain"].attrs["units"] == "V/A"


def test_they_survive_a_file_and_a_slim_copy_does_without(whole, tmp_path):
    back = load(save_posterior(whole, tmp_path / "line.nc"))
    assert set(datasets(back)) == set(datasets(whole))
    assert back.posterior["b"].attrs["units"] == "V/s"
    np.testing.assert_array_equal(back.log_likelihood["y"], whole.log_likelihood["y"])
    assert az.loo(back).n_data_points == 12
    az.plot_ppc_dist(back, num_samples=5) if ARVIZ_1 else az.plot_ppc(back, num_pp_samples=5)


def test_draws_of_pymc_get_them_too(model):
    with model:
        idata = pm.sample(
            30, tune=30, chains=2, cores=1, step=zoo.step(model), random_seed=1, progressbar=False,
            compute_convergence_checks=False,
        )  # fmt: skip
    found = add_groups(idata, model, n_prior=0)
    assert found.log_likelihood["y"].shape == (2, 30, 1, 12)
    assert "prior" not in datasets(found)


def test_sample_has_all_groups_and_a_slim_copy_of_it_has_draws_alone():
    model = zoo.model_B(zoo.load_study("demo"))
    settings = {"draws": 20, "tune": 20, "cores": 0, "seed": 1, "progress": False}
    idata = zoo.sample(model, **settings)
    constants = idata.constant_data
    network = model.zoo.forward.network
    assert constants["vessel"].to_numpy().tolist() == [int(v) for v in network.ids]
    np.testing.assert_array_equal(constants["length"], network.length_cm)
    assert constants["inflow"].attrs["units"] == "ml/s"
    assert idata.posterior["f3"].attrs["units"] == "g cm-1 s-2"
    waves = by_place(idata)["pressure_mmHg"]
    assert waves.dims[2:] == ("vessel", "position", "time")
    assert waves.attrs["units"] == "mmHg"
    assert idata.posterior_predictive["y"].shape == (4, 20, *model.zoo.data.values.shape)
    joint = idata.log_likelihood["y"].sum(("series", "time"))[1, 7]
    at = {name: float(idata.posterior[name][1, 7]) for name in idata.posterior}
    values = {name: at[name] for name in model.zoo.errors.parameter_names}
    mean = model.zoo.forward.solve(
        model.zoo.forward.configure(np.array([at[n] for n in model.zoo.forward_parameters]))
    )
    residual = (model.zoo.data.values - mean).ravel()
    law = stats.multivariate_normal(cov=covariance_of(model.zoo.errors, values), allow_singular=True)
    assert float(joint) == pytest.approx(law.logpdf(residual), rel=1e-4)
    assert list(datasets(slim_posterior(idata, 40))) == ["posterior"]


def test_misspelt_settings_are_refused_with_the_nearest(model):
    study = zoo.load_study("demo")
    with pytest.raises(TypeError, match=r"sample\(\) got an unexpected keyword argument 'drws'"):
        zoo.sample(model, drws=10)
    with pytest.raises(TypeError, match=r"model_B\(\) got an unexpected keyword argument 'efects'"):
        zoo.model_B(study, efects=["taper"])
    with pytest.raises(TypeError, match="diagnose: setting 'statez': unknown; did you mean 'states'"):
        zoo.diagnose(study, base="B", statez=[])


def test_a_study_without_observations_is_solved_at_every_inlet():
    demo = zoo.load_study("demo")
    bare = replace(demo, series=(), time_s=np.empty(0))
    waves = zoo.Solver.for_study(bare).solve(stiffness=5e4)
    assert waves.pressure_mmHg.shape == (len(demo.vessels), 512)
    root = waves.flow_ml_s[0]
    inflow = np.interp(
        np.arange(512) / 512, np.arange(len(demo.inflow_ml_s)) / len(demo.inflow_ml_s), demo.inflow_ml_s
    )
    np.testing.assert_allclose(root, inflow, atol=0.01 * np.ptp(inflow))


def test_draws_of_another_sampler_go_into_the_command(tmp_path: Path) -> None:
    """Saved with their groups; without these the message says what to do."""
    study = load_study("demo")
    model, rng, shape = model_B(study), np.random.default_rng(1), (4, 100)
    at = find_mode(model).values
    drawn = {name: value * np.exp(0.01 * rng.standard_normal(shape)) for name, value in at.items()}
    plain = of_draws({"posterior": drawn})
    with pytest.raises(ResultsError, match=r"zoo.add_groups\(idata, model\) to the draws of another"):
        RunRecord.of(plain)
    found = add_groups(plain, model, n_draws=20, n_prior=0)
    assert not RunRecord.there(plain)
    record = RunRecord.of(found)
    assert (record.model, record.study, record.settings["chains"]) == ("B", "demo", 4)
    assert sampling_command(record) == "# B of demo: draws of another sampler"
    save_posterior(found, tmp_path / "B.nc")
    command = ["compare", "demo", "--posteriors", str(tmp_path), "--models", "B", "--no-figures"]
    result = CliRunner().invoke(app, [*command, "-o", str(tmp_path / "out")], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert not (tmp_path / "out" / "B.nc").exists()  # nothing was sampled


def test_series_are_selected_by_quantity_and_place_after_a_file(tmp_path: Path, draws) -> None:
    """Three series of two quantities at two places, one of which has no current."""
    parameters = (Parameter("a", Normal(0.0, 2.0), "V"), Parameter("b", Normal(0.0, 1.0), "V/s"))
    values = np.array([[1.0], [2.0], [3.0]]) + TIMES
    data = Data(
        TIMES,
        values,
        labels=["u at 1", "u at 2", "i at 2"],
        units=["V", "V", "A"],
        groups=["voltage", "voltage", "current"],
    )
    forward = FunctionModel(
        lambda c, t: line(c, t) + np.arange(3)[:, None], parameters, Outputs(tuple(data.labels), TIMES)
    )
    places = {"node": [1, 2, 2], "depth": [0.0, 0.5, 0.5]}
    model = bayesian_model("nodes", forward, data, GroupNoise(), places=places)
    noise = {f"noise_{group}": np.full((4, 400), 0.1) for group in ("voltage", "current")}
    posterior = of_draws({"posterior": {n: datasets(draws)["posterior"][n].values for n in "ab"} | noise})
    idata = add_groups(posterior, model, n_draws=8, n_prior=2, seed=1)
    save_posterior(idata, tmp_path / "nodes.nc")
    for one in (idata, load(tmp_path / "nodes.nc")):
        observed = by_place(one, "observed_data")
        assert observed["voltage"].dims == ("node", "depth", "time")
        assert observed["voltage"].sel(node=2, depth=0.5).values == pytest.approx(values[1])
        assert observed["current"].sel(node=2, depth=0.5).values == pytest.approx(values[2])
        assert np.isnan(observed["voltage"].sel(node=1, depth=0.5)).all()
        assert {name: v.attrs["units"] for name, v in observed.items()} == {"voltage": "V", "current": "A"}
        assert observed["time"].attrs["units"] == "s"
        drawn = by_place(one)["voltage"]
        assert drawn.dims == ("chain", "draw", "node", "depth", "time")
        raw = datasets(one)["posterior_predictive"]["y"]
        assert np.array_equal(drawn.sel(node=2, depth=0.5), raw.sel(series="u at 2"))
        assert "units" not in by_place(one, "log_likelihood")["current"].attrs
    with pytest.raises(ValueError, match="group = 'posterior': no such group with series by quantity"):
        by_place(idata, "posterior")
    with pytest.raises(ValueError, match=r"zoo\.add_groups"):
        by_place(posterior)


def test_draws_without_groups_have_units(model) -> None:
    idata = zoo.sample(model, draws=10, tune=10, chains=1, seed=1, cores=0, groups=False, progress=False)
    assert idata["posterior"]["b"].attrs["units"] == "V/s"
    assert RunRecord.of(idata).seed == 1
