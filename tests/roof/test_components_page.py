"""Components on the figures and the page of a diagnosis."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drawn import texts
from pages import read
from withheld import screen_of

from zoo import plots, report
from zoo.core.data import Data
from zoo.core.diagnosis import Diagnosis
from zoo.core.diagnosis.file import ComponentResult
from zoo.plots.impedance import impedance_figure, impedances_of


def interval(mean: float) -> dict[str, float]:
    return {"mean": mean, "low": 0.5 * mean, "high": 1.5 * mean}


def result(name: str, probability: float, group: int, **more: object) -> ComponentResult:
    given = {"name": name, "probability": probability, "group": group, "log_evidence": -3.0, "unit": "mmHg"}
    return ComponentResult.model_validate(given | more)


CURVE = {
    "name": "tube-law",
    "argument": "stretch",
    "argument_unit": "1",
    "unit": "mmHg",
    "values": [1.1, 1.0, 1.2],
    "mean": [0.25, 0.0, 0.5],
    "low": [0.2, -0.1, 0.3],
    "high": [0.3, 0.1, 0.7],
    "prior_sd": [1.0, 1.0, 1.0],
    "prior_size": 1.0,
    "narrowed": [[0.0, 0.0, 1.0]],
}
PLACES = CURVE | {"name": "log-radius", "argument": "vessel", "labels": ["1", "2", "7"], "unit": "1"}


@pytest.fixture
def found(one: Diagnosis) -> Diagnosis:
    held = {
        "baseline": interval(0.4),
        "sensor": interval(0.3),
        "component": interval(0.1),
        "found": True,
        "what": "eighths of the beat in turn",
        "unit": "mmHg",
    }
    components = [
        result(
            "geometry", 0.125, 1, functions=[PLACES], plausible={"value": False, "why": "radii off by 40 %"}
        ),
        result(
            "wall",
            0.75,
            1,
            share=interval(0.6),
            gap_after=0.031,
            gap_after_interval=(0.02, 0.04),
            log10_bayes_factor=12.34,
            functions=[CURVE],
            nearest_effects=[{"name": "tangent-wall", "share": 0.42, "opposite_sign": True}],
            held_out=held,
        ),
    ]
    return replace(one, file=one.file.model_copy(update={"components": components}))


def test_rows_are_those_of_the_file_most_probable_first(found: Diagnosis, tmp_path: Path) -> None:
    written = report.write_diagnosis(found, tmp_path)
    assert {p.name for p in written} | {"impedance.png", "states.png"} == set(report.diagnosis_files())
    text = read(tmp_path / "report.html").text
    rows = report.components.component_rows(found.file)
    assert [row["name"] for row in rows] == ["wall", "geometry"]
    assert rows[0]["cells"] == [
        "75 %", "1", "+12.3", "60 % (30 % to 90 %)", "0.031 (0.02 to 0.04)", "yes",
    ]  # fmt: skip
    for words in (
        "These sensors cannot separate wall and geometry: the answer is the group.",
        "the wall misses by 0.1 (0.05 to 0.15), a free discrepancy at the sensor by 0.3 (0.15 to 0.45)",
        "Geometry: radii off by 40 %.",
        "tangent-wall 42 % with the other sign",
        "0.5 (0.3 to 0.7) mmHg",
    ):
        assert words in text


def test_the_screen_has_the_same_rows(found: Diagnosis) -> None:
    lines = [" ".join(line.split()) for line in screen_of(found.file).splitlines()]
    first = next(i for i, line in enumerate(lines) if "components of the simulator" in line)
    wall, geometry = lines[first + 2 : first + 4]
    assert wall == "wall 75 % 60 % (30 % to 90 %) 0.031 (0.02 to 0.04)"
    assert geometry == "geometry 12 %"
    none = found.file.model_copy(update={"components": []})
    assert "components of the simulator" not in screen_of(none)


def test_without_components_the_page_has_no_such_chapter(one: Diagnosis, tmp_path: Path) -> None:
    none = replace(one, file=one.file.model_copy(update={"components": []}))
    written = {p.name for p in report.write_diagnosis(none, tmp_path)}
    there = set(report.diagnosis_files()) - {"impedance.png", "states.png"}
    assert there - written == {"components.png", "functions.png"}
    assert "Which component" not in read(tmp_path / "report.html").text


def test_the_figures_carry_the_numbers(found: Diagnosis) -> None:
    figure = plots.plot_components(found)
    first, second, third = figure.axes
    assert [bar.get_width() for bar in first.patches] == [75.0, 12.5]
    assert "wall (group 1)" in texts(figure)
    np.testing.assert_allclose(second.get_lines()[0].get_xdata(), (30.0, 90.0))
    np.testing.assert_allclose(third.get_lines()[0].get_xdata(), (0.02, 0.04))
    figure = plots.plot_functions(found)
    curve, places = figure.axes
    line = curve.get_lines()[1]
    np.testing.assert_array_equal(line.get_xdata(), [1.0, 1.1, 1.2])
    np.testing.assert_array_equal(line.get_ydata(), [0.0, 0.25, 0.5])
    assert curve.get_ylabel() == "tube law (mmHg)"
    assert [t.get_text() for t in places.get_xticklabels()] == ["1", "2", "7"]


def test_the_impedance_is_drawn_where_the_roots_pressure_is_observed(one: Diagnosis, tmp_path: Path) -> None:
    found = impedances_of(one)
    assert list(found) == ["measured", "baseline", "baseline + viscoelastic-wall"]
    own = found["measured"]
    # the cause that is true is nearer than the baseline where the flow is not weak
    told = ~own.weak & (np.arange(len(own.value)) > 0) & (np.arange(len(own.value)) < 6)
    misses = [
        np.abs(found[name].value - own.value)[told].sum()
        for name in ("baseline + viscoelastic-wall", "baseline")
    ]
    assert misses[0] < misses[1]
    modulus, phase = impedance_figure(found).axes
    np.testing.assert_array_equal(modulus.get_lines()[2].get_ydata(), found["baseline"].modulus)
    np.testing.assert_array_equal(phase.get_lines()[2].get_ydata(), found["baseline"].phase)
    assert "impedance.png" in {p.name for p in report.write_diagnosis(one, tmp_path)}
    nowhere = replace(one, data=replace_outputs(one))
    assert impedances_of(nowhere) == {}


def replace_outputs(d: Diagnosis) -> Data:
    data = d.data
    return Data(
        data.times, data.values, groups=data.groups, period=data.period, outputs=[(1, 1.0, "flow_ml_s")]
    )
