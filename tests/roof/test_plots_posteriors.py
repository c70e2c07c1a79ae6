"""Figures of several posteriors carry their medians, intervals and densities."""

from __future__ import annotations

import arviz as az
import numpy as np
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
