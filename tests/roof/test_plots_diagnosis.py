"""Figures of a diagnosis carry its numbers."""

from __future__ import annotations

from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from drawn import texts
from matplotlib.patches import Rectangle

from zoo import plots
from zoo.blood.study_diagnosis import PHASES, phases
from zoo.core.data import Data
from zoo.core.diagnosis import Diagnosis
from zoo.core.diagnosis.file import Interval, LocationShare, StateFile
from zoo.core.diagnosis.states import BASELINE, SEEN, StateResult
from zoo.plots import causes, vessel_tree
from zoo.plots import diagnosis_figures as figures
from zoo.plots.subject import leading_sets


def words_of(figure: mpl.figure.Figure) -> str:
    return " ".join(texts(figure))


def test_the_discrepancy_figure_carries_the_numbers(three: Diagnosis) -> None:
    figure = plots.plot_discrepancy(three)
    found = words_of(figure)
    for series, row in zip(three.study.series, three.file.gap.per_series, strict=True):
        label = series.label.rsplit(" ", 1)[0]
        assert f"{label}: error {row.before.mean:.2g} to {row.after.mean:.2g} {row.unit}" in found
    assert {"pressure (mmHg)", "flow (ml/s)", "error (ml/s)", *PHASES} <= {
        t.get_text() for t in figure.findobj(mpl.text.Text)
    }
    top, bottom = figure.axes[0], figure.axes[3]
    lines = {line.get_label(): line.get_ydata() for line in top.get_lines()}
    np.testing.assert_array_equal(lines["observed"], three.study.values[0])
    np.testing.assert_allclose(lines["baseline"], three.computed[0][0], atol=1e-9)
    np.testing.assert_allclose(
        lines["baseline + viscoelastic-wall"], three.study.values[0] - three.after.residual[0]
    )
    left = {line.get_label(): line.get_ydata() for line in bottom.get_lines()}
    np.testing.assert_array_equal(left["error of the baseline, 95 %"], three.before.mean[0])
    [band] = [c for c in bottom.collections if np.isclose(c.get_paths()[0].vertices[:, 1].max(),
              np.max(three.before.mean[0] + 1.96 * three.before.sd[0]))]  # fmt: skip
    assert band is not None
    [strip] = [p for p in bottom.patches if isinstance(p, Rectangle) and p.get_label() == "noise (sd)"]
    assert strip.get_height() == pytest.approx(2 * three.file.gap.per_series[0].noise_floor)


def test_phases_are_shaded_where_they_are(one: Diagnosis) -> None:
    phase = phases(one.study.values[0], one.study.period_s)
    spans = figures._spans(phase)
    assert sum(last - first for first, last, _ in spans) == len(phase)
    for first, last, k in spans:
        assert set(phase[first:last]) == {k}
    shaded = [p for p in plots.plot_discrepancy(one).axes[0].patches if isinstance(p, Rectangle)]
    step = 110 / 64
    expected = [(first * step, (last - first) * step) for first, last, k in spans if k % 2]
    np.testing.assert_allclose([(p.get_x(), p.get_width()) for p in shaded], expected)


def test_a_bar_of_each_component_and_set_stands_beside_its_prior(three: Diagnosis) -> None:
    sets = list(three.file.sets)
    sets[1] = sets[1].model_copy(update={"solved": False, "gap_after": None, "probability": 0.2})
    figure = plots.plot_causes(three.with_file(sets=sets))
    components, bars = figure.axes
    for axes, expected in (
        (components, [(c.probability, c.prior_probability) for c in three.file.components]),
        (
            bars,
            [(s.probability, np.exp(s.log_prior)) for s in leading_sets(three.with_file(sets=sets).file, 7)],
        ),
    ):
        widths = [p.get_width() for p in axes.patches]
        np.testing.assert_allclose(widths, 100 * np.array(expected).ravel())
    assert "no cause" in texts(figure)


def test_the_name_of_a_set_ends_its_lines_between_causes() -> None:
    assert causes._folded("law (1 K) + push (0.12 s)") == "law (1 K) + push (0.12 s)"
    long = "a-cause-whose-name-is-longer-than-a-whole-line (2 s)"
    assert causes._folded(f"{long} + b + c") == f"{long}\n+ b + c"


def test_a_dot_of_each_component_under_each_other_prior(three: Diagnosis) -> None:
    [axes] = plots.plot_sensitivity(three).axes
    stated, *others = three.file.sensitivity
    names = [t.get_text() for t in axes.get_yticklabels()]
    assert names == ["no cause", *(c.name for c in three.file.components)]
    assert [bar.get_width() for bar in axes.patches] == pytest.approx(
        [100 * stated.nothing, *(100 * stated.components[name] for name in names[1:])]
    )
    for line, one in zip(axes.get_lines(), others, strict=True):
        assert line.get_label() == one.prior
        np.testing.assert_allclose(
            line.get_xdata(), [100 * one.nothing, *(100 * one.components[name] for name in names[1:])]
        )
        np.testing.assert_array_equal(np.round(line.get_ydata()), range(len(names)))
    assert len({(line.get_color(), line.get_marker()) for line in axes.get_lines()}) == len(others)


def test_the_tree_is_coloured_by_the_probability_of_the_location(three: Diagnosis) -> None:
    shares = [
        LocationShare(noun="vessel", part=2, subtree=True, probability=0.5),
        LocationShare(noun="vessel", part=None, subtree=False, probability=0.3),
        LocationShare(noun="vessel", part=4, subtree=False, probability=0.2),
        LocationShare(noun="vessel", part=5, subtree=False, probability=0.9),  # in sets with the first too
    ]
    where = three.file.where.model_copy(update={"place": shares})
    figure = plots.plot_where(three.with_file(where=where))
    lines = {
        int(line.get_gid().removeprefix("vessel-")): line
        for line in figure.findobj(mpl.lines.Line2D)
        if line.get_gid()
    }
    colours = mpl.colors.LinearSegmentedColormap.from_list("locations", vessel_tree.LOCATION_COLOURS)
    for vessel, p in {1: 0.0, 2: 0.5, 3: 0.0, 4: 0.7, 5: 1.0}.items():
        assert lines[vessel].get_color() == pytest.approx(colours(p))
    assert lines[1].get_linewidth() > lines[5].get_linewidth()
    for vessel in three.study.vessels:
        if vessel.parent is not None:
            start, end = lines[vessel.id].get_xydata()[0], lines[vessel.parent].get_xydata()[1]
            np.testing.assert_array_equal(start, end)
    found = words_of(figure)
    assert "everywhere alike: 30 %" in found
    assert "vessel 2 and below: 50 %" in found


def test_a_tree_listed_daughters_first_is_laid_out_too(three: Diagnosis) -> None:
    assert (
        vessel_tree.tree_layout(three.study.vessels[::-1]).keys()
        == vessel_tree.tree_layout(three.study.vessels).keys()
    )
    ends = [place[3] for v, place in vessel_tree.tree_layout(three.study.vessels).items() if v in (3, 4, 5)]
    assert sorted(ends) == [-2.0, -1.0, 0.0]


def other_state(name: str, unit: str, computed: list[str]) -> StateResult:
    times = np.arange(8) / 8
    size = {"mmHg": 1.0, "ml/s": 100.0}[unit]
    data = Data(times, size * np.sin(2 * np.pi * times), ["y"], [unit], ["y"], 1.0, name=name)
    error = Interval(mean=0.1, low=0.0, high=0.2)
    seen = {"baseline": error, "sensor": None, "carried": [], "failed": []}
    file = StateFile(state=name, checksum="0" * 64, unit=unit, noise=0.1, **seen)
    return StateResult(data, "y", file, {one: np.zeros((1, 8)) for one in computed})


def test_a_name_has_one_colour_in_all_states_and_a_unit_one_range() -> None:
    """Also where the first state shares no series with the study, and has no discrepancy at the sensor."""
    states = (
        other_state("rest", "mmHg", [BASELINE, "wall", "inflow"]),
        other_state("run", "mmHg", [BASELINE, SEEN, "inflow", "wall"]),
        other_state("flow", "ml/s", [BASELINE, "wall"]),
    )
    figure = plots.plot_states(SimpleNamespace(states=states, data=states[0].data))  # type: ignore[arg-type]
    [legend] = figure.legends
    by_name = dict(zip((t.get_text() for t in legend.get_texts()), legend.get_lines(), strict=True))
    assert set(by_name) == {BASELINE, SEEN, "wall", "inflow"}
    assert len({line.get_color() for line in by_name.values()}) == 4
    for axes, state in zip(figure.axes, states, strict=True):
        colours = [line.get_color() for line in axes.get_lines()]
        assert colours == [by_name[name].get_color() for name in state.computed]
    first, second, third = (axes.get_ylim()[1] for axes in figure.axes)
    assert first == second < 0.1 * third
