"""Figures, page and screen of a diagnosis that has nothing to do with blood."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn import texts
from pages import read, table_of
from withheld import screen_of

import zoo
from zoo import plots, report
from zoo.core.data import Data
from zoo.core.diagnosis import Diagnosis
from zoo.core.diagnosis.file import LocationShare, NextMeasurement
from zoo.core.effects import EffectParameter, Location, effect
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.parameters import Parameter, Uniform

TIMES = np.linspace(0.0, 6.0, 120)


def cooling(configuration: Any, times: Any) -> Any:
    """Two bodies that cool towards a room's temperature, in kelvin above it."""
    rates = np.array([configuration["a"], configuration["b"]])[:, None]
    return 10.0 * np.exp(-rates * times) + configuration.get("drift", np.zeros(2))[:, None] * times


MODEL = FunctionModel(
    cooling,
    (
        Parameter("a", Uniform(0.05, 2.0), "1/min", start=0.4, log=True),
        Parameter("b", Uniform(0.05, 2.0), "1/min", start=0.4),
    ),
    Outputs(("one", "two"), TIMES),
    "cooling",
)


@effect(
    "drift",
    parameters=[EffectParameter("slope", "K/min", 0.2, -1.0, 1.0, (0.1, -0.1))],
    locations=lambda model: (Location("one", noun="body"), Location("two", noun="body")),
)
def drift(configuration: Any, values: Any, location: Location) -> Any:
    """One body is warmed."""
    return {
        **configuration,
        "drift": values[0] * np.array([location.part in (None, x) for x in ("one", "two")]),
    }


@pytest.fixture(scope="module")
def cups() -> Diagnosis:
    values = MODEL.solve({"a": 0.5, "b": 0.8, "drift": np.array([0.0, 0.15])})
    values = values + 0.02 * np.random.default_rng(1).standard_normal(values.shape)
    data = Data(TIMES, values, ("one", "two"), ("K", "K"), ("T", "T"), time_unit="min", name="cups")
    found = zoo.diagnose(data, MODEL, [drift])
    wanted = NextMeasurement(
        separates=("drift @two", "nothing"), expected_log_odds=2.5, body="two", depth=0.25
    )
    return found.with_file(next_measurement=wanted)


def test_the_whole_is_drawn_with_the_words_of_the_data(cups: Diagnosis) -> None:
    found = texts(cups.plot())
    row = cups.file.gap.per_series[1]
    assert f"two: error {row.before.mean:.2g} to {row.after.mean:.2g} K" in found
    assert {"T (K)", "error (K)", "time (min)", "phase", "first quarter", "drift @two"} <= found
    assert "harmonic" not in found  # the record has no period
    assert not {text for text in found if "beat" in text or "vessel" in text or "mmHg" in text}


def test_series_stand_at_their_own_times(cups: Diagnosis) -> None:
    top = plots.plot_discrepancy(cups).axes[0]
    observed = next(line for line in top.get_lines() if line.get_label() == "observed")
    np.testing.assert_array_equal(observed.get_xdata(), cups.data.times)
    np.testing.assert_array_equal(observed.get_ydata(), cups.data.values[0])


def test_locations_are_bars_where_there_is_no_tree(cups: Diagnosis) -> None:
    shares = [
        LocationShare(part="two", subtree=False, probability=0.75, noun="body"),
        LocationShare(part=None, subtree=False, probability=0.25, noun="body"),
    ]
    where = cups.file.where.model_copy(update={"place": shares})
    figure = plots.plot_where(cups.with_file(where=where))
    axes = next(a for a in figure.axes if a.get_title(loc="left") == "location")
    assert [label.get_text() for label in axes.get_yticklabels()] == ["body two", "everywhere"]
    assert [bar.get_width() for bar in axes.patches] == [75.0, 25.0]


def test_phases_of_ones_own_are_not_shaded_where_they_are_unknown(cups: Diagnosis) -> None:
    where = cups.file.where.model_copy(update={"phase": {"early": 0.5, "late": 0.5}})
    figure = plots.plot_discrepancy(cups.with_file(where=where))
    assert "early" not in texts(figure)


def test_page_and_screen_have_the_numbers(cups: Diagnosis, tmp_path: Path) -> None:
    written = report.write_diagnosis(cups, tmp_path / "gap")
    assert all(path.is_file() for path in written)
    page = read(tmp_path / "gap" / "report.html")
    text, screen = page.text, screen_of(cups.file)
    for shown in (text, screen):
        assert cups.file.verdict in shown
        assert "vessel" not in shown
        assert "mmHg" not in shown
        assert "What would decide: body two, depth 0.25, which tells drift @two from nothing" in shown
        assert "By harmonic" not in shown
    guessed = [one.model_copy(update={"solved": False}) for one in cups.file.sets]
    for file, solved in ((cups.file, "yes"), (cups.with_file(sets=guessed).file, "no")):
        [line] = [x for x in screen_of(file).splitlines() if re.match(r" *drift @two .* %", x) and "+" in x]
        assert line.split()[-1] == solved
    rows = table_of(page, "Model error in each observed series")
    assert [row[:2] for row in rows] == [["one", "K"], ["two", "K"]]
    assert table_of(page, "Sets of causes")[0][0] == "drift @two"
    assert table_of(page, "Listed effects and free functions")[0][5].startswith("body two (")
    slope = cups.causes[0].estimates[0]
    assert slope.interval is not None
    size = f"slope {slope.mean:.2g} ({slope.interval[0]:.2g} to {slope.interval[1]:.2g}) K/min"
    assert size in " ".join(screen.split())
    assert [row[0] for row in table_of(page, "Parameters of the baseline")] == ["a", "b"]
