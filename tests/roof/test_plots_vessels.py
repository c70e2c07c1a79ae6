"""Figures of waves and bands show the vessels, positions and models that they were given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from drawn import TIMES, fake_waves, fill_of, lines_of, texts

from zoo import plots
from zoo.blood.predictive import bands, median_waves
from zoo.plots import waves as vessels

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


@pytest.mark.parametrize(("n", "lines"), [(2, 6), (12, 12)])
def test_waves_draw_every_vessel(tube, n, lines):
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
    observed = plots.waves_figure(waves, tube, vessels=[1])
    assert [len(axes.get_lines()) for axes in observed.axes] == [4, 4, 3]
    assert "observed v1@0" in texts(observed)
    nothing = plots.waves_figure(waves, replace(tube, series=(), time_s=np.empty(0)), vessels=[1])
    assert [len(axes.get_lines()) for axes in nothing.axes] == [3, 3, 3]


def test_all_vessels_have_a_panel_and_areas_readable_numbers(tube):
    figure = plots.all_vessels_figure(
        bands(fake_waves(), "pressure_mmHg", errors=True), tube, title="model A"
    )
    shown = [axes for axes in figure.axes if axes.axison]
    expected = bands(fake_waves(), "pressure_mmHg", errors=True).sel(vessel=4, position=0.5, prob=0.95)
    prediction, credible = shown[3].collections  # midway, other than the root
    np.testing.assert_allclose(fill_of(prediction), (expected.prediction_low[0], expected.prediction_high[0]))
    np.testing.assert_allclose(fill_of(credible), (expected.low[0], expected.high[0]))
    np.testing.assert_array_equal(lines_of(shown[0])[1], tube.series[0].value)
    assert [axes.get_title(loc="left") for axes in shown] == ["trunk", *(f"vessel {v}" for v in range(2, 10))]
    assert [len(axes.collections) for axes in shown] == [2] * 9
    assert {"observed", "model A", "pressure (mmHg)", "95 % prediction"} <= texts(figure)
    area = bands(fake_waves(), "area_cm2")
    drawn = plots.all_vessels_figure(area)
    assert "area (10$^{-3}$ cm$^2$)" in texts(drawn)
    expected = 1e3 * area["median"].sel(vessel=1, position=0.0)
    np.testing.assert_allclose(lines_of(drawn.axes[0])[0], expected)
    assert "95 % prediction" not in texts(drawn)


def test_a_vessel_with_signs_of_mathtext_is_drawn_as_it_is(tube, tmp_path):
    waves = fake_waves()
    waves = waves.assign_coords(name=("vessel", ["$^$"] * waves.sizes["vessel"]))
    shown = bands(waves, "pressure_mmHg", errors=True)
    for figure in (
        plots.all_vessels_figure(shown, tube, title="$^$"),
        plots.models_figure({"A": median_waves(waves), "B": median_waves(waves)}, tube),
    ):
        assert plots.save_figure(figure, tmp_path / "a.svg").is_file()


def test_models_share_panels_and_leave_residuals(tube):
    medians = {name: median_waves(fake_waves(level=15 + i)) for i, name in enumerate("ABH")}
    figure = plots.models_figure(medians, tube, vessels=(1, 2, 5))
    assert [len(axes.get_lines()) for axes in figure.axes] == [4, 3, 3, 4]
    for line, name in zip(lines_of(figure.axes[2]), medians, strict=True):
        np.testing.assert_allclose(line, medians[name].pressure_mmHg.sel(vessel=5))
    residual = lines_of(figure.axes[3])[2]
    np.testing.assert_allclose(residual, tube.series[0].value - medians["B"].pressure_mmHg.sel(vessel=1))
    assert {"model A", "model H", "residual (mmHg),\ntrunk", "observed"} <= texts(figure)
    styles = {line.get_linestyle() for line in figure.axes[0].get_lines()[:3]}
    assert styles == {"--", "-"}  # independent errors are dashed
    flow = plots.models_figure(medians, tube, quantity="flow_ml_s")
    assert sum(axes.axison for axes in flow.axes) == 7
    assert not any("residual" in text for text in texts(flow))
    with pytest.raises(plots.FigureError, match="no medians: give at least one"):
        plots.models_figure({})
    with pytest.raises(plots.FigureError, match="quantity = 'speed': must be one of pressure_mmHg"):
        plots.models_figure(medians, quantity="speed")


def test_loops_are_pressure_against_area():
    waves = {name: median_waves(fake_waves(level=15 + 2 * i)) for i, name in enumerate("GI")}
    figure = plots.loops_figure(waves)
    assert sum(axes.axison for axes in figure.axes) == 7
    first, _ = figure.axes[0].get_lines()
    area, pressure = np.asarray(first.get_xdata()), np.asarray(first.get_ydata())
    assert np.all(np.diff(area) >= 0)
    np.testing.assert_allclose(area, 1e3 * pressure / 5000)
    everything = plots.loops_figure(waves, vessels=list(waves["G"].vessel.values))
    assert sum(axes.axison for axes in everything.axes) == 9
    assert {"model G", "model I", "pressure (mmHg)", "vessel 9"} <= texts(everything)
    assert any("no loop" in text for text in texts(figure))


def test_a_loop_is_drawn_as_a_loop():
    wave = median_waves(fake_waves())
    late = wave.assign(area_cm2=wave.area_cm2.roll(time=3))  # the area follows the pressure later
    figure = plots.loops_figure({"B": late})
    [line] = figure.axes[0].get_lines()
    x, y = line.get_xdata(), line.get_ydata()
    assert (x[0], y[0]) == (x[-1], y[-1])
    enclosed = 0.5 * abs(np.dot(x[:-1], y[1:]) - np.dot(x[1:], y[:-1]))
    assert enclosed > 0.1 * np.ptp(x) * np.ptp(y)
    assert not any("no loop" in text for text in texts(figure))


def test_waves_of_many_vessels_have_a_bar_for_their_colours():
    waves = fake_waves(56).isel(draw=0)
    figure = plots.waves_figure(waves)
    assert [len(axes.get_lines()) for axes in figure.axes[:3]] == [56] * 3
    bar = figure.axes[3]
    assert [label.get_text() for label in bar.get_yticklabels()][:: len(bar.get_yticks()) - 1] == ["1", "56"]
    assert "vessel 30" not in texts(figure)
    widths = [axes.get_window_extent().width for axes in figure.axes[:3]]
    assert min(widths) > 0.2 * figure.get_window_extent().width


def test_vessels_shown_of_any_tree(tube):
    def shown(n, series=()):
        study = replace(tube, series=tuple(replace(tube.series[0], vessel=v) for v in series))
        return vessels.shown_vessels(fake_waves(n), None, vessels.SEVEN_VESSELS, study)

    assert shown(21) == [1, 2, 3, 4, 8, 12, 21]  # the paper's
    assert shown(4) == [1, 2, 3, 4]
    many = shown(56, (7, 40))
    assert len(many) == 7
    assert {1, 7, 40} <= set(many)
    assert set(range(10, 20)) <= set(shown(56, range(10, 20)))  # every one that was observed
    with pytest.raises(plots.FigureError, match="vessel 30: the waves have 1, 2, 3"):
        vessels.shown_vessels(fake_waves(3), [30], vessels.SEVEN_VESSELS)


def test_an_observed_area_is_in_the_unit_of_its_panel(tube):
    waves = fake_waves()
    area = replace(tube.series[0], quantity="area_cm2", value=np.full(40, 0.003))
    figure = plots.all_vessels_figure(bands(waves, "area_cm2"), replace(tube, series=(area,)))
    np.testing.assert_allclose(lines_of(figure.axes[0])[1], 3.0)


def test_nine_models_have_nine_styles():
    styles = [plots.model_style(name) for name in "ABCDEFGHI"]
    assert len(set(styles)) == 9
    assert len({colour for colour, _ in styles}) == 9
    others = [plots.model_style("mine", place) for place in range(21)]
    assert len(set(others)) == 21
