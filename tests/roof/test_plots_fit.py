"""Figures of one posterior and of a comparison carry the data, the bands and the units that they claim to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from drawn import band_of, texts

from zoo import plots
from zoo.core.arviz_lines import of_draws
from zoo.core.outputs import OutputFileError

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def test_fit_shows_data_median_bands_and_residual(tube):
    rng = np.random.default_rng(1)
    spread = rng.normal(size=(400, 2, 1))
    means = tube.values + 0.3 + 0.05 * spread
    predictions = means + 0.2 * rng.normal(size=means.shape)
    figure = plots.fit_figure(tube, means, predictions, title="model A on tube")
    top, _, bottom, _ = figure.axes
    lines = {line.get_label(): line.get_ydata() for line in top.get_lines()}
    np.testing.assert_array_equal(lines["observed"], tube.values[0])
    np.testing.assert_allclose(lines["posterior median"], np.median(means[:, 0], axis=0))
    residual = bottom.get_lines()[-1].get_ydata()
    np.testing.assert_allclose(residual, tube.values[0] - np.median(means[:, 0], axis=0))
    low, high = band_of(top, "95 % credible")
    expected = np.quantile(spread[:, 0, 0], (0.025, 0.975)) * 0.05
    np.testing.assert_allclose(low, tube.values[0] + 0.3 + expected[0])
    np.testing.assert_allclose(high, tube.values[0] + 0.3 + expected[1])
    outer_low, outer_high = band_of(top, "95 % prediction")
    assert np.all(outer_low < low)
    assert np.all(outer_high > high)
    found = texts(figure)
    assert {
        "pressure (mmHg)",
        "flow (ml/s)",
        "time in the beat (ms)",
        "residual (mmHg)",
        "residual (ml/s)",
        "v1@0",
        "v1@1",
    } <= found
    assert "model A on tube" in found


def test_fit_of_many_series_has_panels_for_each(tube):
    many = replace(tube, series=tuple(replace(tube.series[i % 2], position=i / 7) for i in range(8)))
    figure = plots.fit_figure(many, np.stack([s.value for s in many.series])[None])
    shown = [axes for axes in figure.axes if axes.axison]
    assert len(shown) == 16
    assert [axes.get_ylabel() for axes in shown].count("residual (ml/s)") == 4
    width, height = figure.get_size_inches()
    assert width < 14 < height


def test_a_name_with_signs_of_mathtext_is_drawn_as_it_is(tube, tmp_path):
    named = replace(tube, name="$^$ and $x$")
    means = np.stack([series.value for series in tube.series])[None]
    figure = plots.fit_figure(named, means, title=f"model A on {named.name}")
    plots.save_figure(figure, tmp_path / "a.svg")
    assert (tmp_path / "a.svg").is_file()
    plots.save_figure(plots.priors_figure([], title=named.name), tmp_path / "b.svg")


def test_fit_without_predictions(tube):
    figure = plots.fit_figure(tube, tube.values[None].repeat(5, axis=0))
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


def test_pairs_are_in_the_power_of_ten_that_their_label_says(idata):
    figure = plots.pair_figure(idata, ["f3", "c"])
    [scatter] = [c for axes in figure.axes for c in axes.collections if len(c.get_offsets()) == 800]
    np.testing.assert_allclose(scatter.get_offsets()[:, 0], idata.posterior.f3.to_numpy().ravel() / 1e4)
    assert "$f_3$ (10$^4$ g cm$^{-1}$ s$^{-2}$)" in texts(figure)


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
    assert set(points) >= {-4489.0, -4486.0, 400.0}
    # A is so far behind that an axis with it would show H and B as one: an arrow stands for it
    drawn = {
        float(line.get_xdata()[0]): line.get_marker()
        for line in right.get_lines()
        if len(line.get_xdata()) == 1 and line.get_marker() in ("o", ">")
    }
    assert (drawn[0.0], drawn[3.0]) == ("o", "o")
    assert 4889.0 not in drawn
    high = right.get_xlim()[1]
    assert drawn[high] == ">"
    assert 5.0 < high < 15.0
    assert {right.get_xscale(), left.get_xscale()} == {"linear"}
    found = texts(figure)
    assert {"H", "B", "A", "not converged", "WAIC of 3 models (bars: standard errors)"} <= found
    assert {
        "0.0 ± 0.0, weight 0.70",
        "4889.0 ± 60.0, weight 0.00",
        "beyond the axis: see the number",
    } <= found
    hollow = [
        line
        for line in left.get_lines()
        if line.get_marker() == "o" and line.get_markerfacecolor() == "white"
    ]
    assert [line.get_xdata()[0] for line in hollow if len(line.get_xdata())] == [-4486.0]
    labels = [axes.xaxis.label.get_window_extent() for axes in figure.axes]
    assert labels[0].x1 < labels[1].x0  # not over each other
    near = plots.comparison_figure(table.iloc[:1])
    assert not {"not converged", "beyond the axis: see the number"} & texts(near)
    comparable = table.assign(difference=[0.0, 277.0, 609.0])
    high = plots.comparison_figure(comparable).axes[1].get_xlim()[1]
    assert high > 609  # all are seen, at their distances


def test_save_says_what_is_wrong(tube, tmp_path):
    figure = plots.fit_figure(tube, tube.values[None])
    with pytest.raises(plots.FigureError, match=r"unknown figure format '\.xyz'; use \.png"):
        plots.save_figure(figure, tmp_path / "a.xyz")
    with pytest.raises(OutputFileError, match="does not exist; create it"):
        plots.save_figure(figure, tmp_path / "no" / "a.png")


def test_forest_has_the_quantiles_of_each_model() -> None:
    rng = np.random.default_rng(5)
    names = {"A": ["f3", "c"], "B": ["f3", "c", "w"]}
    posteriors = {
        model: of_draws({"posterior": {name: rng.normal(size=(4, 100)) for name in own}})
        for model, own in names.items()
    }
    figure = plots.forest_figure(posteriors)
    panels = {axes.get_xlabel(): axes for axes in figure.axes if axes.get_visible()}
    assert len(panels) == len({*posteriors["A"].posterior, *posteriors["B"].posterior})
    outer, _, median = panels[plots.PARAMETER_LABELS["w"]].get_lines()  # B alone has w
    values = posteriors["B"].posterior["w"].to_numpy()
    np.testing.assert_allclose(outer.get_xdata(), np.quantile(values, (0.025, 0.975)))
    np.testing.assert_allclose(median.get_xdata(), [np.median(values)])
    assert list(outer.get_ydata()) == [1, 1]
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["A", "B"]


def test_the_band_of_loo_pits_holds_even_numbers_and_no_others() -> None:
    even = (np.arange(90) + 0.5) / 90
    pits = {name: xr.DataArray(values.reshape(2, 45)) for name, values in (("A", even), ("B", even**2))}
    pits["A"] = xr.concat([pits["A"], xr.full_like(pits["A"][:1], np.nan)], "dim_0")  # not measured
    figure = plots.loo_pit_figure(pits)
    for axes, inside in zip(figure.axes, (True, False), strict=True):
        [band], [line] = axes.collections, axes.lines
        path = band.get_paths()[0]
        points = np.column_stack(line.get_data())[10:-10]
        assert bool(path.contains_points(points).all()) == inside
