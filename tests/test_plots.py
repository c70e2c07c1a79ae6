"""Figures carry the data, the bands and the units that they claim to."""

from __future__ import annotations

from dataclasses import replace

import arviz as az
import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
import xarray as xr

from zoo import plots
from zoo.blood.predictive import bands, median_waves
from zoo.blood.study import Blood, Series, Study, Vessel, Windkessel

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


def test_chain_figures_have_units_and_leave_waveforms_out(idata, tmp_path):
    for draw in (plots.trace_figure, plots.rank_figure, plots.pair_figure):
        figure = draw(idata)
        words = " ".join(texts(figure))
        assert "$f_3$ (g cm$^{-1}$ s$^{-2}$)" in words or "$f_3$ (10$^4$ g cm$^{-1}$ s$^{-2}$)" in words
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


def test_pairs_are_in_the_power_of_ten_that_their_label_says(idata):
    figure = plots.pair_figure(idata, ["f3", "c"])
    [scatter] = [c for axes in figure.axes for c in axes.collections if len(c.get_offsets()) == 800]
    np.testing.assert_allclose(scatter.get_offsets()[:, 0], idata.posterior.f3.to_numpy().ravel() / 1e4)
    assert "$f_3$ (10$^4$ g cm$^{-1}$ s$^{-2}$)" in texts(figure)


# predictions in all vessels


def fake_waves(n_vessels: int = 9, level: float = 15.0, n: int = 60) -> xr.Dataset:
    """Waves with a level that falls by 0.5 mmHg a vessel, an area proportional to the pressure."""
    rng = np.random.default_rng(4)
    vessel = np.arange(1, n_vessels + 1)
    shape = level + 2 * np.sin(57 * TIMES) - 0.5 * (vessel[:, None, None] - 1)
    pressure = shape + 0.3 * rng.standard_normal((n, 1, 1, 1)) * np.ones((2, 1))
    dims = ("draw", "vessel", "position", "time")
    return xr.Dataset(
        {
            "pressure_mmHg": (dims, pressure),
            "flow_ml_s": (dims, pressure / 100),
            "area_cm2": (dims, pressure / 5000),
            "sigma2": ("draw", np.full(n, 0.04)),
        },
        coords={
            "vessel": vessel,
            "radius_cm": ("vessel", np.linspace(0.05, 0.02, n_vessels)),
            "name": ("vessel", ["trunk", *(f"v{v}" for v in vessel[1:])]),
            "position": [0.0, 0.5],
            "time": TIMES,
        },
        attrs={"error": "iid", "root": 1, "observed_quantity": "pressure_mmHg", "model": "A"},
    )


def lines_of(axes) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata()) for line in axes.get_lines()]


def fill_of(collection) -> tuple[float, float]:
    """Lowest and highest value at time 0."""
    vertices = collection.get_paths()[0].vertices
    at = vertices[vertices[:, 0] == 0, 1]
    return at.min(), at.max()


def test_uncertainty_has_a_column_a_model_and_a_row_a_vessel(study):
    both = {
        name: bands(fake_waves(level=15 + i), "pressure_mmHg", (0.95,), errors=True)
        for i, name in enumerate("AB")
    }
    figure = plots.uncertainty_figure(both, study, vessels=(1, 4, 7))
    assert len(figure.axes) == 6
    found = texts(figure)
    assert {"model A", "model B", "95 % credible", "95 % prediction", "measured"} <= found
    assert "trunk\npressure (mmHg)" in found
    assert "vessel 7\npressure (mmHg)" in found
    expected = both["B"].sel(vessel=4, position=0.5, prob=0.95)  # midway, other than the root
    axes = figure.axes[3]
    prediction, credible = axes.collections
    np.testing.assert_allclose(fill_of(prediction), (expected.prediction_low[0], expected.prediction_high[0]))
    np.testing.assert_allclose(fill_of(credible), (expected.low[0], expected.high[0]))
    np.testing.assert_allclose(lines_of(axes)[0], expected["median"])
    assert [len(axes.get_lines()) for axes in figure.axes] == [2, 2, 1, 1, 1, 1]
    np.testing.assert_array_equal(lines_of(figure.axes[1])[1], study.series[0].value)
    assert "measured" not in texts(plots.uncertainty_figure({"A": bands(fake_waves(), "flow_ml_s")}))
    with pytest.raises(plots.FigureError, match=r"prob = 0\.9: the bands have 0\.95; choose"):
        plots.uncertainty_figure(both, prob=0.9)
    with pytest.raises(plots.FigureError, match="vessel 30: the waves have 1, 2, 3"):
        plots.uncertainty_figure(both, vessels=[30])
    with pytest.raises(plots.FigureError, match="no bands: give at least one"):
        plots.uncertainty_figure({})


def test_all_vessels_have_a_panel_and_areas_readable_numbers(study):
    figure = plots.all_vessels_figure(
        bands(fake_waves(), "pressure_mmHg", errors=True), study, title="model A"
    )
    shown = [axes for axes in figure.axes if axes.axison]
    assert [axes.get_title(loc="left") for axes in shown] == ["trunk", *(f"vessel {v}" for v in range(2, 10))]
    assert [len(axes.collections) for axes in shown] == [2] * 9
    assert {"measured", "model A", "pressure (mmHg)", "95 % prediction"} <= texts(figure)
    area = bands(fake_waves(), "area_cm2")
    drawn = plots.all_vessels_figure(area)
    assert "area (10$^{-3}$ cm$^2$)" in texts(drawn)
    expected = 1e3 * area["median"].sel(vessel=1, position=0.0)
    np.testing.assert_allclose(lines_of(drawn.axes[0])[0], expected)
    assert "95 % prediction" not in texts(drawn)


def test_models_share_panels_and_leave_residuals(study):
    medians = {name: median_waves(fake_waves(level=15 + i)) for i, name in enumerate("ABH")}
    figure = plots.models_figure(medians, study, vessels=(1, 2, 5))
    assert [len(axes.get_lines()) for axes in figure.axes] == [4, 3, 3, 4]
    for line, name in zip(lines_of(figure.axes[2]), medians, strict=True):
        np.testing.assert_allclose(line, medians[name].pressure_mmHg.sel(vessel=5))
    residual = lines_of(figure.axes[3])[2]
    np.testing.assert_allclose(residual, study.series[0].value - medians["B"].pressure_mmHg.sel(vessel=1))
    assert {"model A", "model H", "residual, trunk", "measured"} <= texts(figure)
    styles = {line.get_linestyle() for line in figure.axes[0].get_lines()[:3]}
    assert styles == {"--", "-"}  # independent errors are dashed
    flow = plots.models_figure(medians, study, quantity="flow_ml_s")
    assert sum(axes.axison for axes in flow.axes) == 7
    assert "residual, trunk" not in texts(flow)
    with pytest.raises(plots.FigureError, match="quantity = 'speed': must be one of pressure_mmHg"):
        plots.models_figure(medians, quantity="speed")


@pytest.mark.parametrize("standardised", [False, True])
def test_loops_are_pressure_against_area(standardised):
    waves = {name: median_waves(fake_waves(level=15 + 2 * i)) for i, name in enumerate("GI")}
    figure = plots.loops_figure(waves, standardised=standardised)
    assert sum(axes.axison for axes in figure.axes) == 7
    first, second = figure.axes[0].get_lines()
    area, pressure = np.asarray(first.get_xdata()), np.asarray(first.get_ydata())
    assert np.all(np.diff(area) >= 0)
    if standardised:
        assert area.min() == 0
        assert second.get_xdata().max() == 1
    else:
        np.testing.assert_allclose(area, 1e3 * pressure / 5000)
    everything = plots.loops_figure(waves, vessels=list(waves["G"].vessel.values), standardised=standardised)
    assert sum(axes.axison for axes in everything.axes) == 9
    assert {"model G", "model I", "pressure (mmHg)", "vessel 9"} <= texts(everything)


def test_nine_models_have_nine_styles():
    styles = [plots.model_style(name) for name in "ABCDEFGHI"]
    assert len(set(styles)) == 9
    others = [plots.model_style("mine", place) for place in range(21)]
    assert len(set(others)) == 21


def test_posteriors_show_common_parameters_only(idata):
    rng = np.random.default_rng(7)
    other = az.from_dict(
        posterior={"c": rng.normal(2, 1, (4, 50)), "f3": rng.normal(4e4, 10, (4, 50)), "w": np.ones((4, 50))}
    )
    figure = plots.posteriors_figure({"A": idata, "B": other["posterior"]})
    assert {"$f_3$\n(10$^4$ g cm$^{-1}$ s$^{-2}$)", "$c$", "model A", "model B"} <= texts(figure)
    assert "$w$\n(10$^4$ s$^{-2}$)" not in texts(figure)
    shown = [axes for axes in figure.axes if axes.axison]
    assert len(shown) == 3
    density = {line.get_color(): line for line in shown[0].get_lines()}
    assert all(line.get_ydata().max() == 1 for line in density.values())
    narrow = density[plots.COLOURS[1]].get_xdata()
    assert 3.99 < narrow.min() < narrow.max() < 4.01
    sizes = sorted(len(c.get_offsets()) for c in shown[1].collections)
    assert sizes == [200, 800]
    assert len(plots.posteriors_figure({"A": idata}, ["c"]).axes) == 1
    with pytest.raises(plots.FigureError, match="parameter 'w': the posteriors share f3, c"):
        plots.posteriors_figure({"A": idata, "B": other}, ["w"])
    with pytest.raises(plots.FigureError, match="no scalar parameter in common"):
        plots.posteriors_figure({"A": idata, "B": xr.Dataset()})


def test_stiffness_has_medians_and_intervals_of_every_vessel():
    rng = np.random.default_rng(8)
    values = np.array([4e4, 5e4, 6e4]) + 1e3 * rng.standard_normal((4, 500, 3))
    radius = ("vessel", [0.05, 0.03, 0.03])
    draws = xr.DataArray(
        values, dims=("chain", "draw", "vessel"), coords={"vessel": [1, 2, 3], "radius_cm": radius}
    )
    figure = plots.stiffness_figure({"G": draws})
    [axes] = figure.axes
    [container] = axes.containers
    points, _, [bars] = container
    np.testing.assert_allclose(points.get_ydata(), np.median(values, axis=(0, 1)) / 1e4)
    x = points.get_xdata()
    np.testing.assert_allclose(x, [0.05, 0.03, 0.03], atol=4e-4)
    assert x[2] - x[1] > 4e-4  # of the same radius, drawn apart
    ends = np.array([segment[:, 1] for segment in bars.get_segments()])
    np.testing.assert_allclose(ends.T, np.quantile(values, (0.025, 0.975), axis=(0, 1)) / 1e4)
    assert {"1", "2", "3", "model G", r"$\chi$ (10$^4$ g cm$^{-1}$ s$^{-2}$)"} <= texts(figure)


def test_pressure_against_stiffness_marks_the_estimate_and_leaves_failures_out():
    chi = np.array([1e4, 1e5, 1e6, 1e7])
    table = pd.DataFrame({"stiffness_g_cm_s2": chi, "status": ["ok"] * 3 + ["cfl"]})
    for i, name in enumerate(("systolic", "diastolic", "pulse")):
        table[f"{name}_mmHg"] = 3.0 * np.log10(chi) + i
    table.loc[3, "systolic_mmHg"] = np.nan
    figure = plots.pressure_stiffness_figure(table, 3e4)
    [axes] = figure.axes
    assert axes.get_xscale() == "log"
    curves = [line for line in axes.get_lines() if len(line.get_xdata()) == 3]
    assert [line.get_label() for line in curves] == ["systolic", "diastolic", "pulse"]
    crosses = [line.get_ydata()[0] for line in axes.get_lines() if len(line.get_xdata()) == 1]
    np.testing.assert_allclose(crosses, 3.0 * np.log10(3e4) + np.arange(3))
    assert r"estimate, 3.00 $\times$ 10$^4$" in texts(figure)
    assert len(plots.pressure_stiffness_figure(table).axes[0].get_lines()) == 3


def test_intervals_stand_beside_the_published_ones():
    rows = [
        ("A", "f3", 5.17e4, 5.09e4, 5.25e4, 5.18e4, 5.10e4, 5.26e4),
        ("B", "f3", 4.31e4, 3.91e4, 4.72e4, 4.30e4, 3.86e4, 4.71e4),
        ("B", "b", np.nan, np.nan, np.nan, 139.0, 102.0, 203.0),
        ("A", "f1", 0.58e5, 0.2e5, 0.97e5, 52e5, 2.6e5, 98e5),
    ]
    columns = [
        "model",
        "parameter",
        "published_median",
        "published_low",
        "published_high",
        "median",
        "low",
        "high",
    ]
    table = pd.DataFrame(rows, columns=columns)
    figure = plots.intervals_figure(table)
    first, second, third = figure.axes
    published, ours = first.containers
    np.testing.assert_allclose(published[0].get_xdata(), [5.17, 4.31])
    np.testing.assert_allclose(ours[0].get_xdata(), [5.18, 4.30])
    assert np.all(published[0].get_ydata() < ours[0].get_ydata())
    ends = [segment[:, 0] for segment in ours[2][0].get_segments()]
    np.testing.assert_allclose(ends, [[5.10, 5.26], [3.86, 4.71]])
    assert [axes.get_xscale() for axes in (first, second, third)] == ["linear", "linear", "log"]
    assert {"published", "zoo", "A", "B", "$f_3$ (10$^4$ g cm$^{-1}$ s$^{-2}$)"} <= texts(figure)
    with pytest.raises(plots.FigureError, match="no column 'published_low'; give model, parameter"):
        plots.intervals_figure(table.drop(columns="published_low"))


@pytest.mark.parametrize(("overlay", "rows"), [(False, 2), (True, 1)])
def test_truth_figure_marks_the_truth_in_every_panel(overlay, rows):
    rng = np.random.default_rng(1)
    truth = {"f3": 4.3e4, "psi1": 0.3}
    fits = {
        name: [{"f3": rng.normal(4.3e4, 1e3, 300), "psi1": rng.normal(0.3, 0.05, 300)} for _ in range(3)]
        for name in ("without", "with")
    }
    figure = plots.truth_figure(fits, truth, overlay=overlay)
    panels = figure.axes
    assert len(panels) == 2 * rows
    for axes, value in zip(panels[:2], (4.3, 0.3), strict=True):
        dashed = [line for line in axes.lines if len(set(line.get_xdata())) == 1]
        assert [float(line.get_xdata()[0]) for line in dashed] == pytest.approx([value])
        assert len(axes.lines) == 1 + 3 * (2 if overlay else 1)
