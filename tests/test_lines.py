"""Both lines of PyMC and ArviZ give the same WAIC, and read each other's posteriors (`tests/lines.py`)."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pymc as pm
import pytest

import zoo
from lines import FOLDER, IN_NUMBA, LINES, OURS, posterior_with_groups, waic_of_nine
from zoo.core.arviz_lines import datasets
from zoo.core.inference.record import RunRecord
from zoo.core.posterior.storage import load, save_posterior
from zoo.models import get_model


def test_waic_of_the_nine_models_is_that_of_both_lines() -> None:
    ours = waic_of_nine()
    for line in LINES:
        theirs = json.loads((FOLDER / f"{line}.json").read_text(encoding="utf-8"))
        assert list(theirs) == list(ours)  # the ranking
        for name, row in theirs.items():
            assert ours[name] == pytest.approx(row, rel=1e-9, abs=1e-6), (line, name)


@pytest.mark.parametrize("line", LINES)
def test_a_posterior_of_each_line_is_read_and_written_by_this_one(line: str, tmp_path) -> None:
    found = load(FOLDER / f"{line}.nc")
    assert RunRecord.of(found).versions["pymc"].startswith(line.removeprefix("pymc-"))
    again = load(save_posterior(found, tmp_path / "again.nc"))
    ours = posterior_with_groups()
    assert set(datasets(found)) == set(datasets(ours))
    for name, group in datasets(found).items():
        assert datasets(again)[name].identical(group), name
        if name.startswith("prior"):  # of random variables that the lines draw in their own ways
            continue
        for variable, values in group.variables.items():
            mine = datasets(ours)[name].variables[variable]
            assert mine.dims == values.dims
            if mine.dtype.kind == "f":
                np.testing.assert_allclose(values, mine, rtol=1e-6, err_msg=f"{name} {variable}")
            else:
                np.testing.assert_array_equal(values, mine, err_msg=f"{name} {variable}")


def test_this_line_is_among_them() -> None:
    assert OURS in LINES


@pytest.mark.parametrize("letter", [pytest.param(x, marks=IN_NUMBA) for x in "AG"])
def test_models_run_in_numba_as_by_the_c_linker_and_without_a_warning(letter: str) -> None:
    """Both kinds of errors; their distributions and those of the parameters are drawn from too."""
    model = get_model(letter)(zoo.load_study("demo"))
    point = model.initial_point()
    graph, found, shapes = [model.logp(), model.dlogp()], {}, {}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", "PyTensor could not link to a BLAS")
        for mode in ("NUMBA", "CVM"):
            found[mode] = model.compile_fn(graph, mode=mode)(point)
            drawn = pm.draw(model.observed_RVs + model.free_RVs, mode=mode, random_seed=1)
            assert all(np.all(np.isfinite(values)) for values in drawn)
            shapes[mode] = [np.shape(values) for values in drawn]
    assert shapes["NUMBA"] == shapes["CVM"]
    for numba, c in zip(found["NUMBA"], found["CVM"], strict=True):
        np.testing.assert_allclose(numba, c, rtol=1e-9)
