"""The record of a run, through JSON and back."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gaussian import a_record, independent_draws
from zoo.core.arviz_lines import InferenceData
from zoo.core.inference.record import ResultsError, RunRecord


@pytest.fixture
def record() -> RunRecord:
    return a_record()


@pytest.fixture
def idata() -> InferenceData:
    return independent_draws()


def test_record_holds_the_versions(record):
    import pymc

    assert record.versions["pymc"] == pymc.__version__
    assert record.versions["numpy"] == np.__version__
    assert set(record.versions) == {"python", "zoo", "pymc", "pytensor", "arviz", "numpy"}


def test_record_in_plain_json_from_numpy_values(record):
    from dataclasses import replace

    odd = replace(record, seed=np.int64(3), solver={"dx_cm": np.float64(0.5), "points": np.arange(2)})
    raw = json.loads(odd.to_json())
    assert raw["seed"] == 3
    assert raw["solver"] == {"dx_cm": 0.5, "points": [0, 1]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "run record: not JSON"),
        ("[1]", "not a JSON object"),
        ("{}", "field 'model' is missing"),
    ],
)
def test_broken_record(text, message):
    with pytest.raises(ResultsError, match=message):
        RunRecord.from_json(text)


def test_record_of_a_later_version_drops_what_it_does_not_know(record):
    raw = json.loads(record.to_json())
    raw["weather"] = "fine"
    assert RunRecord.from_json(json.dumps(raw)) == record


def test_no_record(idata):
    with pytest.raises(ResultsError, match="no run record in this InferenceData"):
        RunRecord.of(idata)
