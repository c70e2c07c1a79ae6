"""Predictions in every vessel: against single solves, analytic quantiles, SciPy and PyMC's predictions."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pymc as pm
import pytest
import xarray as xr
from scipy import stats

from test_op import STIFF
from walls import wall_pressure_mmHg
from zoo.blood import predictive
from zoo.blood.baseline import study_model
from zoo.blood.blood_flow import study_data
from zoo.blood.network import stiffness_profile
from zoo.blood.predictive import (
    PredictiveError,
    bands,
    median_waves,
    one_place,
    predictive_draws,
    vessel_waves,
    waves_at_medians,
)
from zoo.blood.solver import Physics, Solver
from zoo.blood.study import Study
from zoo.core.arviz_lines import InferenceData, of_draws
from zoo.core.data import Data
from zoo.core.errors.base import ErrorModel
from zoo.core.errors.gaussian_process import GaussianProcess, neural_network_kernel
from zoo.core.errors.independent import Independent
from zoo.core.parameters import LogUniform
from zoo.core.posterior.comparison import forward_points, posterior_means
from zoo.models import get_model

CENTRE = {
    **{"f1": 3e4, "f2": -80.0, "f3": 4.5e4, "m_chi": 5e4, "v_chi": 1.0, "chi": 5.5e4},
    **{"psi1": 0.3, "psi2": 0.9, "c": 1.2, "gamma": 5.0, "sigma2": 0.09, "w": 5e4, "b": 100.0},
}
TIMES = np.arange(40) * 0.11 / 40
ERRORS: dict[str, ErrorModel] = {
    "iid": Independent(),
    "gp": GaussianProcess(LogUniform(1e4, 9e4), LogUniform(1, 500), unit="mmHg"),
}


def posterior(model: pm.Model, n_draws: int = 20, spread: float = 0.02) -> InferenceData:
    """Draws scattered around a point, two chains; a stiffness of each vessel has its own."""
    rng = np.random.default_rng(0)
    draws = {}
    for name in model.zoo.parameters:
        shape = (2, n_draws, *((3,) if name == "chi" else ()))
        draws[name] = CENTRE[name] * np.exp(spread * rng.standard_normal(shape))
    return of_draws({"posterior": draws})


@pytest.mark.parametrize("name", ["B", "I"])
def test_waves_are_those_of_single_solves(study: Study, name: str) -> None:
    """At the observed places and times the series of the likelihood; elsewhere a solver of its own."""
    study = replace(study, conventions=study.conventions.replace(sample_lag_beats=0.05))
    model = get_model(name)(study)
    idata = posterior(model, 3)
    seen: list[tuple[int, int]] = []
    waves = vessel_waves(model, idata, n_draws=6, n_times=32, progress=lambda i, n: seen.append((i, n)))
    assert waves.pressure_mmHg.dims == ("draw", "vessel", "position", "time")
    assert waves.pressure_mmHg.shape == (6, 3, 2, 32)
    assert seen == [(i + 1, 6) for i in range(6)]
    expected = posterior_means(model, idata["posterior"])
    place = waves.pressure_mmHg.sel(vessel=1, position=0.0), waves.pressure_mmHg.sel(vessel=2, position=0.5)
    np.testing.assert_allclose(np.stack(place, axis=1), expected, rtol=1e-6)
    k, draw = 4, {v: float(idata["posterior"][v][1, 1]) for v in model.zoo.parameters}
    assert (waves.chain[k], waves.posterior_draw[k]) == (1, 1)
    assert float(waves.w[k]) == draw["w"]
    chi = draw["f3"]
    if name == "I":
        chi = stiffness_profile([0.047, 0.026, 0.037], draw["f1"], draw["f2"], draw["f3"])
    wall = {"B": "linear", "I": "tangent"}[name]
    times = waves["time"].to_numpy() + 0.05 * 0.11
    conventions = model.zoo.forward.conventions
    alone = Solver.for_study(study, wall, series=[(3, 0.5)], times_s=times, conventions=conventions)
    scales = {p: draw[p] for p in ("psi1", "psi2", "c")}
    solution = alone.solve(chi, draw.get("gamma", 2.0), **scales)
    for quantity in ("pressure_mmHg", "flow_ml_s", "area_cm2"):
        found = waves[quantity][k].sel(vessel=3, position=0.5)
        np.testing.assert_allclose(found, getattr(solution, quantity)[0], rtol=2e-6, atol=1e-7)
    rest = np.pi * float(waves.radius_cm.sel(vessel=3)) ** 2
    stiffness = np.broadcast_to(chi, 3)[2]
    found = wall_pressure_mmHg(
        wall,
        waves.area_cm2[k].sel(vessel=3, position=0.5) / rest,
        stiffness,
        draw.get("gamma", 2.0),
        conventions=conventions,
    )
    np.testing.assert_allclose(found, waves.pressure_mmHg[k].sel(vessel=3, position=0.5), rtol=1e-4)


def test_waves_conserve_volume_and_survive_a_file(study: Study, tmp_path) -> None:
    model = get_model("A")(study)
    waves = vessel_waves(model, posterior(model), n_draws=5, positions=(0.0, 0.5, 1.0))
    flow = waves.flow_ml_s.mean("time")
    inflow = study.inflow_ml_s.mean()
    np.testing.assert_allclose(flow.sel(vessel=1), inflow, rtol=1e-4)
    np.testing.assert_allclose(flow.sel(vessel=2) + flow.sel(vessel=3), inflow, rtol=1e-4)
    assert waves.attrs["draws_failed"] == 0
    assert (waves.attrs["model"], waves.attrs["study"], waves.attrs["root"]) == ("A", "small", 1)
    assert waves.pressure_mmHg.attrs["units"] == "mmHg"
    waves.to_netcdf(tmp_path / "w.nc", engine="h5netcdf")
    with xr.open_dataset(tmp_path / "w.nc", engine="h5netcdf") as again:
        xr.testing.assert_identical(again.load(), waves)
    kept = vessel_waves(model, posterior(model), n_draws=5, positions=(0.0, 0.5, 1.0))
    xr.testing.assert_identical(kept, waves)
    everything = vessel_waves(model, posterior(model, 4), n_draws=100, n_times=16)
    assert everything.sizes["draw"] == 8


def test_draws_that_do_not_solve_are_left_out_and_counted(study: Study) -> None:
    model = study_model("stiff", STIFF, Independent())(study)
    f3_draws = np.array([[5e4, 1e11, 6e4], [1e11, 4e4, 1e11]])
    idata = of_draws({"posterior": {"f3": f3_draws, "sigma2": np.arange(1.0, 7.0).reshape(2, 3)}})
    waves = vessel_waves(model, idata, n_times=32)
    assert waves.attrs["draws_failed"] == 3
    assert waves.sigma2.to_numpy().tolist() == [1.0, 3.0, 5.0]
    systolic = waves.pressure_mmHg.sel(vessel=1, position=0.0).max("time").to_numpy()
    assert list(np.argsort(systolic)) == [2, 0, 1]  # stiffer, higher
    only = of_draws({"posterior": {"f3": f3_draws[1:, [0, 2]], "sigma2": np.ones((1, 2))}})
    with pytest.raises(PredictiveError, match="model stiff: none of 2 posterior draws solves"):
        vessel_waves(model, only)


def test_effects_are_in_the_predictions(study: Study) -> None:
    """Waves of a model with effects are those of a solver with their terms, in every vessel."""
    model = get_model("A")(study, effects=["viscoelastic-wall", "local-stiffness@2"])
    values = {"f3": 5e4, "psi1": 0.3, "psi2": 0.9, "c": 1.2, "sigma2": 0.1}
    values |= {"viscoelastic-wall.tau": 2e-3, "local-stiffness@2.log-stiffness": 0.4}
    idata = of_draws({"posterior": {name: np.array([[value]]) for name, value in values.items()}})
    waves = vessel_waves(model, idata, n_times=32)
    chi = np.array([5e4, 5e4 * np.exp(0.4), 5e4])
    [point] = forward_points(model, idata["posterior"])
    np.testing.assert_allclose(model.zoo.forward.configure(point).stiffness, chi)
    physics = Physics(viscoelastic_time=np.full(3, 2e-3))
    places = [(int(v), float(x)) for v in waves.vessel for x in waves.position]
    solver = Solver.for_study(study, series=places, times_s=waves["time"].to_numpy(), physics=physics)
    solution = solver.solve(chi, 2.0, 0.3, 0.9, 1.2)
    for name in ("pressure_mmHg", "flow_ml_s", "area_cm2"):
        expected = getattr(solution, name).reshape(3, 2, 32).astype(np.float32)
        np.testing.assert_array_equal(waves[name][0], expected)


def fake_waves(error: str = "iid", n: int = 4000, **parameters: np.ndarray) -> xr.Dataset:
    """Waves whose law is known: a normal level at each draw in two vessels, at two positions."""
    w_b = [dict(zip(parameters, row, strict=True)) for row in zip(*parameters.values(), strict=True)]
    bound = ERRORS[error].bind(Data(TIMES, np.zeros((1, 40)), units=["mmHg"]))
    variance = np.array([bound.variance(values)[0] for values in w_b])
    level = np.random.default_rng(5).normal(15.0, 0.4, size=n)
    shape = np.array([[0.0, 1.0], [2.0, 3.0]])[None, :, :, None] + np.sin(57 * TIMES)
    pressure = level[:, None, None, None] + shape
    return xr.Dataset(
        {
            "pressure_mmHg": (("draw", "vessel", "position", "time"), pressure),
            "flow_ml_s": (("draw", "vessel", "position", "time"), pressure / 100),
            "area_cm2": (("draw", "vessel", "position", "time"), pressure / 1000),
            **{name: ("draw", values) for name, values in parameters.items()},
            "error_variance_pressure_mmHg": (("draw", "time"), variance),
        },
        coords={
            "draw": np.arange(n),
            "vessel": [1, 2],
            "radius_cm": ("vessel", [0.05, 0.03]),
            "position": [0.0, 0.5],
            "time": TIMES,
        },
        attrs={"error": error, "root": 1},
    )


def test_bands_are_the_quantiles_of_a_known_law() -> None:
    """The level is normal, so the credible interval is that of SciPy; errors of one variance add to it."""
    waves = fake_waves(sigma2=np.full(4000, 0.09))
    found = bands(waves, "pressure_mmHg", (0.5, 0.95), errors=True)
    assert found.low.dims == ("prob", "vessel", "position", "time")
    centre = (
        waves.pressure_mmHg[0] - waves.pressure_mmHg[0, 0, 0, 0] + waves.pressure_mmHg[:, 0, 0, 0].median()
    )
    np.testing.assert_allclose(found["median"], centre)
    for prob in (0.5, 0.95):
        z = stats.norm.ppf(0.5 + prob / 2)
        one = found.sel(prob=prob)
        np.testing.assert_allclose(one.high - one.low, 2 * z * 0.4, rtol=0.05)
        np.testing.assert_allclose(one.prediction_high - one.prediction_low, 2 * z * 0.5, rtol=0.03)
    assert found.attrs["units"] == "mmHg"
    flow = bands(waves, "flow_ml_s", (0.95,))
    assert "prediction_low" not in flow
    np.testing.assert_allclose(100 * flow.high[0], found.high.sel(prob=0.95))


@pytest.mark.parametrize("error", ["iid", "gp"])
def test_prediction_quantiles_of_a_skew_mixture(error: str) -> None:
    """Errors of very different size: edges have the wanted probability under the mixture itself."""
    rng = np.random.default_rng(6)
    parameters = {
        "iid": {"sigma2": rng.lognormal(-2, 2, 300)},
        "gp": {"w": rng.uniform(1e4, 9e4, 300), "b": np.exp(rng.uniform(0, 6, 300))},
    }[error]
    waves = fake_waves(error, 300, **parameters)
    found = bands(waves, "pressure_mmHg", (0.8, 0.95), errors=True)
    means = waves.pressure_mmHg[:, 1, 1].to_numpy()
    if error == "iid":
        variance = np.tile(parameters["sigma2"][:, None], (1, 40))
    else:
        q = parameters["b"][:, None] + parameters["w"][:, None] * TIMES**2
        variance = 2 / np.pi * np.arcsin(2 * q / (1 + 2 * q)) + 2.44e-6 + 1e-6
    for i, prob in enumerate((0.8, 0.95)):
        for end, tail in (("low", (1 - prob) / 2), ("high", (1 + prob) / 2)):
            edge = found[f"prediction_{end}"][i, 1, 1].to_numpy()
            reached = stats.norm.cdf(edge, means, np.sqrt(variance)).mean(axis=0)
            np.testing.assert_allclose(reached, tail, atol=1e-5)


def test_places() -> None:
    waves = fake_waves(sigma2=np.full(4000, 0.09))
    placed = one_place(waves)
    assert placed.pressure_mmHg.dims == ("draw", "vessel", "time")
    offset = placed.pressure_mmHg[0].mean("time") - waves.pressure_mmHg[0, 0, 0].mean()
    np.testing.assert_allclose(offset, [0.0, 3.0], atol=1e-9)  # the root's inlet, the other's middle
    assert one_place(placed) is placed
    middle = median_waves(waves)
    assert middle.area_cm2.dims == ("vessel", "time")
    np.testing.assert_allclose(middle.area_cm2, placed.area_cm2.median("draw"))
    with pytest.raises(PredictiveError, match=r"no position 0\.5: make them"):
        one_place(waves.sel(position=[0.0]))


@pytest.mark.parametrize("error", ["iid", "gp"])
def test_predictions_have_the_variance_of_the_error_model(study: Study, monkeypatch, error: str) -> None:
    """Against the analytic spread: posterior of the mean and of the errors are independent here."""
    rng = np.random.default_rng(2)
    n = 250
    study = replace(study, time_s=TIMES, series=tuple(replace(s, value=np.ones(40)) for s in study.series))
    means = study.values[None] + 0.4 * rng.standard_normal((4 * n, 1, 1))
    means[3] = np.nan
    errors = {"iid": ("sigma2",), "gp": ("w", "b")}[error]
    values = {"sigma2": np.full((4, n), 0.09), "w": np.full((4, n), 5e4), "b": np.full((4, n), 130.0)}
    idata = of_draws({"posterior": {name: values[name] for name in errors}})
    record = SimpleNamespace(errors=ERRORS[error].bind(study_data(study)), error_parameters=errors)
    monkeypatch.setattr(predictive, "record_of", lambda model: record)
    monkeypatch.setattr(predictive, "posterior_means", lambda model, posterior: means)
    got_means, predictions = predictive_draws(None, idata, n_draws=None)
    assert got_means.shape == (4 * n - 1, 2, 40)
    assert predictions.shape == (10 * (4 * n - 1), 2, 40)
    gp_variance = np.diag(neural_network_kernel(TIMES, 5e4, 130.0)) + 3.44e-6
    variance = {"iid": np.full(40, 0.09), "gp": gp_variance}[error]
    sample = means[np.isfinite(means).all(axis=(1, 2))][:, 0, 0].var()
    np.testing.assert_allclose(predictions.var(axis=0), np.tile(sample + variance, (2, 1)), rtol=0.06)
    errors_alone = predictions.reshape(10, -1, 2, 40) - got_means
    scaled = errors_alone[..., 0, :] / np.sqrt(variance)
    assert stats.kstest(scaled[:, :, 7].ravel(), "norm").pvalue > 1e-3
    again = predictive_draws(None, idata, n_draws=None)[1]
    np.testing.assert_array_equal(predictions, again)  # the seed is fixed


def test_prediction_bands_hold_what_pymc_predicts(study: Study) -> None:
    """Of pm.sample_posterior_predictive, which draws whole series with correlated errors."""
    model = get_model("B")(study)
    idata = posterior(model, 200, spread=0.03)
    drawn = pm.sample_posterior_predictive(
        idata, model=model, var_names=["y"], progressbar=False, random_seed=1
    ).posterior_predictive["y"]
    waves = vessel_waves(model, idata, n_draws=100, n_times=32)
    found = bands(one_place(waves), "pressure_mmHg", (0.8,), errors=True).isel(prob=0)
    for i, vessel in enumerate((1, 2)):
        one = found.sel(vessel=vessel)
        below = float((drawn[:, :, i] < one.prediction_low.to_numpy()).mean())
        above = float((drawn[:, :, i] > one.prediction_high.to_numpy()).mean())
        assert below == pytest.approx(0.1, abs=0.03)
        assert above == pytest.approx(0.1, abs=0.03)


def test_waves_at_medians_are_one_solve(study: Study) -> None:
    model = get_model("A")(study)
    idata = posterior(model, 5, spread=0.1)
    found = waves_at_medians(model, idata, n_times=64)
    middle = {p: float(idata["posterior"][p].median()) for p in ("f3", "psi1", "psi2", "c")}
    times = np.arange(64) * 0.11 / 64
    solver = Solver.for_study(study, series=[(1, 0.0), (2, 0.5), (3, 0.5)], times_s=times)
    solution = solver.solve(middle["f3"], 2.0, middle["psi1"], middle["psi2"], middle["c"])
    np.testing.assert_allclose(found.pressure_mmHg, solution.pressure_mmHg, rtol=1e-6)
    np.testing.assert_allclose(found.area_cm2, solution.area_cm2, rtol=1e-6)


def test_what_is_wrong_is_said(study: Study) -> None:
    waves = fake_waves(sigma2=np.ones(4000))
    with pytest.raises(PredictiveError, match="errors of flow_ml_s: the model has errors of"):
        bands(waves, "flow_ml_s", errors=True)
    with pytest.raises(PredictiveError, match=r"probs = \(95,\): give probabilities between 0 and 1"):
        bands(waves, "area_cm2", (95,))
    model = get_model("A")(study)
    for settings in ({"n_draws": 0}, {"positions": (0.0, 2.0)}, {"positions": ()}):
        with pytest.raises(PredictiveError, match=rf"{next(iter(settings))} = .*: give"):
            vessel_waves(model, posterior(model, 2), **settings)
