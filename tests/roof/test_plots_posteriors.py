"""Figures of several posteriors carry their medians, intervals and densities."""

from __future__ import annotations

import arviz as az
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from drawn import texts

from zoo import plots

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


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
    narrow = density[plots.model_style("B")[0]].get_xdata()
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


def test_forest_has_the_quantiles_of_each_model() -> None:
    rng = np.random.default_rng(5)
    names = {"A": ["f3", "c"], "B": ["f3", "c", "w"]}
    posteriors = {
        model: az.from_dict(posterior={name: rng.normal(size=(4, 100)) for name in own})
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
