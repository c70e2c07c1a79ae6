"""Learned functions and impedances on the figures and the page of a diagnosis."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pages import read, table_of

from zoo import plots, report
from zoo.core.data import Data
from zoo.core.diagnosis import Diagnosis
from zoo.core.diagnosis.file import LearnedFunction
from zoo.plots.root_impedance import impedance_figure, impedances_of

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
    "probability": 0.7,
    "laws": [
        {"name": "power", "shape": "exponent", "value": 2.0, "interval": (1.8, 2.2), "left": 0.05}
        | {"probability": 0.9}
    ],
}
LAW = "power of the stretch, exponent 2 (1.8 to 2.2); leaves 5 %"
PLACES = CURVE | {
    "name": "log-radius",
    "argument": "vessel",
    "labels": ["1", "2", "7"],
    "unit": "1",
    "probability": 0.1,
    "laws": [],
}


@pytest.fixture
def found(one: Diagnosis) -> Diagnosis:
    first, second = one.file.components[:2]
    curve, places = (LearnedFunction.model_validate(given) for given in (CURVE, PLACES))
    components = [
        first.model_copy(update={"name": "geometry", "functions": [places]}),
        second.model_copy(update={"name": "wall", "functions": [curve]}),
    ]
    rows = [
        row.model_copy(update={"components": {"geometry": 0.25, "wall": 0.5}}) for row in one.file.sensitivity
    ]
    return one.with_file(components=components, sensitivity=rows)


def test_learned_functions_are_on_the_page(found: Diagnosis, tmp_path: Path) -> None:
    written = report.write_diagnosis(found, tmp_path)
    assert {p.name for p in written} | {"states.png"} == set(report.diagnosis_files())
    rows = table_of(read(tmp_path / "report.html"), "Learned functions")
    assert rows == [
        ["log radius", "geometry", "10 %", "7", "0.5 (0.3 to 0.7)", "1", ""],
        ["tube law", "wall", "70 %", "1.2", "0.5 (0.3 to 0.7) mmHg", "1 mmHg", LAW],
    ]


def test_without_functions_the_page_has_no_such_chapter(one: Diagnosis, tmp_path: Path) -> None:
    written = {p.name for p in report.write_diagnosis(one, tmp_path)}
    assert set(report.diagnosis_files()) - written == {"functions.png", "states.png"}
    page = read(tmp_path / "report.html")
    assert not {"functions", "states"} & {h.attributes["id"] for h in page.all("h2")}


def test_the_most_probable_function_is_drawn_first(found: Diagnosis) -> None:
    curve, places = plots.plot_functions(found).axes
    line = curve.get_lines()[1]
    np.testing.assert_array_equal(line.get_xdata(), [1.0, 1.1, 1.2])
    np.testing.assert_array_equal(line.get_ydata(), [0.0, 0.25, 0.5])
    assert curve.get_ylabel() == "tube law (mmHg)"
    assert curve.get_title(loc="left") == "wall: probability 70 %"
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


def test_one_cause_has_the_whole_gap_and_no_cause_leaves_it(one: Diagnosis) -> None:
    assert one.file.components[0].share.mean == pytest.approx(1.0, abs=0.1)
    nothing = next(row for row in one.file.sets if not row.causes)
    assert nothing.gap_after == pytest.approx(one.file.gap.before, rel=0.2)
