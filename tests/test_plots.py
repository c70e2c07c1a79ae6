"""Figures carry the data, the bands and the units that they claim to."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import arviz as az
import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy import stats

from zoo import plots
from zoo.likelihood import neural_network_kernel
from zoo.study import Blood, Series, Study, Vessel, Windkessel

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

TIMES = np.arange(40) * 0.11 / 40


@pytest.fixture
def study() -> Study:
    vessels = (Vessel(1, "trunk", 0.4, 0.047, 0.047, None, Windkessel(3e4, 9e4, 1.5e-6)),)
    flow_time = np.arange(32) * 0.11 / 32
    series = (
        Series(1, 0.0, "pressure_mmHg", 15 + np.sin(TIMES * 57)),
        Series(1, 1.0, "flow_ml_s", 0.2 + 0.1 * np.sin(TIMES * 57)),
    )
    return Study("tube", 0.11, Blood(1.055, 0.049), vessels, flow_time, np.ones(32), TIMES, series)


@pytest.fixture
def idata() -> az.InferenceData:
    rng = np.random.default_rng(0)
    return az.from_dict(
        posterior={
            "f3": 5e4 + 1e3 * rng.normal(size=(4, 200)),
            "c": rng.normal(size=(4, 200)),
            "mean": rng.normal(size=(4, 200, 40)),
        },
        dims={"mean": ["time"]},
    )


def texts(figure) -> set[str]:
    """All words in a figure."""
    figure.canvas.draw()
    return {t.get_text() for t in figure.findobj(mpl.text.Text)}


def band_of(axes, label: str) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper edge of a filled band, at the study's times."""
    [band] = [c for c in axes.collections if c.get_label() == label]
    vertices = band.get_paths()[0].vertices
    x = 1e3 * TIMES
    low = [vertices[np.isclose(vertices[:, 0], t), 1].min() for t in x]
    high = [vertices[np.isclose(vertices[:, 0], t), 1].max() for t in x]
    return np.array(low), np.array(high)


def test_fit_shows_data_median_bands_and_residual(study):
    rng = np.random.default_rng(1)
    spread = rng.normal(size=(400, 2, 1))
    means = study.values + 0.3 + 0.05 * spread
    predictions = means + 0.2 * rng.normal(size=means.shape)
    figure = plots.fit_figure(study, means, predictions, title="model A on tube")
    top, _, bottom, _ = figure.axes
    lines = {line.get_label(): line.get_ydata() for line in top.get_lines()}
    np.testing.assert_array_equal(lines["observed"], study.values[0])
    np.testing.assert_allclose(lines["posterior median"], np.median(means[:, 0], axis=0))
    residual = bottom.get_lines()[-1].get_ydata()
    np.testing.assert_allclose(residual, study.values[0] - np.median(means[:, 0], axis=0))
    low, high = band_of(top, "95 % credible")
    expected = np.quantile(spread[:, 0, 0], (0.025, 0.975)) * 0.05
    np.testing.assert_allclose(low, study.values[0] + 0.3 + expected[0])
    np.testing.assert_allclose(high, study.values[0] + 0.3 + expected[1])
    outer_low, outer_high = band_of(top, "95 % prediction")
    assert np.all(outer_low < low)
    assert np.all(outer_high > high)
    found = texts(figure)
    assert {"pressure (mmHg)", "flow (ml/s)", "time in the beat (ms)", "residual", "v1@0", "v1@1"} <= found
    assert "model A on tube" in found


def test_fit_without_predictions(study):
    figure = plots.fit_figure(study, study.values[None].repeat(5, axis=0))
    assert "95 % prediction" not in texts(figure)


@pytest.mark.parametrize("error", ["iid", "gp"])
def test_predictions_have_the_variance_of_the_error_model(study, monkeypatch, error):
    """Against the analytic spread: posterior of the mean and of the errors are independent here."""
    rng = np.random.default_rng(2)
    n = 250
    means = study.values[None] + 0.4 * rng.standard_normal((4 * n, 1, 1))
    means[3] = np.nan
    errors = {"iid": ("sigma2",), "gp": ("w", "b")}[error]
    values = {"sigma2": np.full((4, n), 0.09), "w": np.full((4, n), 5e4), "b": np.full((4, n), 130.0)}
    idata = az.from_dict(posterior={name: values[name] for name in errors})
    record = SimpleNamespace(study=study, error=error, error_parameters=errors)
    monkeypatch.setattr("zoo.comparison.record_of", lambda model: record)
    monkeypatch.setattr("zoo.comparison.posterior_means", lambda model, posterior: means)
    got_means, predictions = plots.predictive_draws(None, idata, n_draws=None)
    assert got_means.shape == (4 * n - 1, 2, 40)
    assert predictions.shape == (10 * (4 * n - 1), 2, 40)
    variance = {"iid": np.full(40, 0.09), "gp": np.diag(neural_network_kernel(TIMES, 5e4, 130.0)) + 3.44e-6}[
        error
    ]
    sample = means[np.isfinite(means).all(axis=(1, 2))][:, 0, 0].var()
    np.testing.assert_allclose(predictions.var(axis=0), np.tile(sample + variance, (2, 1)), rtol=0.06)
    errors_alone = predictions.reshape(10, -1, 2, 40) - got_means
    scaled = errors_alone[..., 0, :] / np.sqrt(variance)
    assert stats.kstest(scaled[:, :, 7].ravel(), "norm").pvalue > 1e-3
    again = plots.predictive_draws(None, idata, n_draws=None)[1]
    np.testing.assert_array_equal(predictions, again)  # the seed is fixed


def test_chain_figures_have_units_and_leave_waveforms_out(idata, tmp_path):
    for draw in (plots.trace_figure, plots.rank_figure, plots.pair_figure):
        figure = draw(idata)
        words = " ".join(texts(figure))
        assert "$f_3$ (g cm$^{-1}$ s$^{-2}$)" in words
        assert "mean" not in words
        path = plots.save_figure(figure, tmp_path / f"{draw.__name__}.png")
        assert path.stat().st_size > 5000
    assert len(plots.trace_figure(idata, ["c"]).axes) == 2
    import matplotlib.pyplot as plt

    assert plt.get_fignums() == []  # nothing is left open


def test_comparison_shows_values_errors_weights_and_convergence():
    table = pd.DataFrame(
        {
            "waic": [-4489.0, -4486.0, 400.0],
            "waic_se": [30.0, 31.0, 35.0],
            "difference": [0.0, 3.0, 4889.0],
            "difference_se": [0.0, 2.0, 60.0],
            "weight": [0.7, 0.3, 0.0],
            "converged": [True, False, True],
        },
        index=list("HBA"),
    )
    table.attrs["ic"] = "waic"
    figure = plots.comparison_figure(table)
    left, right = figure.axes
    points = [line.get_xdata()[0] for line in left.get_lines() if len(line.get_xdata()) == 1]
    assert points[:3] == [-4489.0, -4486.0, 400.0] or set(points) >= {-4489.0, -4486.0, 400.0}
    assert right.get_xscale() == "symlog"
    found = texts(figure)
    assert {"H", "B", "A", "weight 0.70", "not converged", "WAIC of 3 models"} <= found
    near = plots.comparison_figure(table.iloc[:1])
    assert "not converged" not in texts(near)
    assert near.axes[1].get_xscale() == "linear"


@pytest.mark.parametrize(("n", "lines"), [(2, 6), (12, 12)])
def test_waves_draw_every_vessel(study, n, lines):
    shape = ("vessel", "position", "time")
    rng = np.random.default_rng(3)
    waves = xr.Dataset(
        {name: (shape, rng.normal(size=(n, 3, 40))) for name in plots.QUANTITY_LABELS},
        coords={"vessel": range(1, n + 1), "position": [0.0, 0.5, 1.0], "time": TIMES},
    )
    figure = plots.waves_figure(waves)
    assert [len(axes.get_lines()) for axes in figure.axes] == [lines] * 3
    np.testing.assert_array_equal(figure.axes[1].get_lines()[0].get_ydata(), waves.flow_ml_s[0, 0])
    assert {"pressure (mmHg)", "flow (ml/s)", "area (cm$^2$)", "vessel 2", "position 0"} <= texts(figure)
    observed = plots.waves_figure(waves, study, vessels=[1])
    assert [len(axes.get_lines()) for axes in observed.axes] == [4, 4, 3]
    assert "observed v1@0" in texts(observed)
    nothing = plots.waves_figure(waves, replace(study, series=(), time_s=np.empty(0)), vessels=[1])
    assert [len(axes.get_lines()) for axes in nothing.axes] == [3, 3, 3]


def test_save_says_what_is_wrong(study, tmp_path):
    figure = plots.fit_figure(study, study.values[None])
    with pytest.raises(plots.FigureError, match=r"unknown figure format '\.xyz'; use \.png"):
        plots.save_figure(figure, tmp_path / "a.xyz")
    with pytest.raises(plots.FigureError, match="does not exist; create it"):
        plots.save_figure(figure, tmp_path / "no" / "a.png")
