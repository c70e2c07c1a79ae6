"""The notebooks run from a clean kernel, and say what is missing."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

from snippets import missing
from zoo import load_study
from zoo.core.arviz_lines import datasets, of_draws
from zoo.core.inference.convergence import diagnostics
from zoo.core.inference.record import RunRecord
from zoo.core.posterior.storage import load, save_posterior, slim_posterior
from zoo.models import MODELS, get_model, suggested

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
STORED = sorted((FOLDER / "posteriors").glob("*.nc"))


def run(name: str, folder: Path) -> nbformat.NotebookNode:
    """A notebook after all of its cells, run in a folder."""
    notebook = nbformat.read(FOLDER / name, as_version=4)
    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    return notebook


def printed(notebook: nbformat.NotebookNode) -> str:
    outputs = (o for cell in notebook.cells for o in cell.get("outputs", []))
    return "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stdout")


def pictures(notebook: nbformat.NotebookNode) -> int:
    outputs = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    return sum("image/png" in o.get("data", {}) for o in outputs)


def store(folder: Path, letter: str) -> None:
    """Draws around the suggested values, as a posterior of mouse-c6."""
    model = get_model(letter)(load_study("mouse-c6"))
    rng = np.random.default_rng(3)
    values = suggested(letter)
    draws = {name: values[name] * np.exp(0.002 * rng.normal(size=(4, 60))) for name in model.zoo.parameters}
    idata = of_draws({"posterior": draws})
    study, conventions = model.zoo.study, model.zoo.forward.conventions.name
    RunRecord(
        letter, study.name, study.checksum, {"name": conventions}, {}, {}, 1, 10, 10, 1, {}, 1.0, 1.0, 9.0,
        1, "",
    ).attach(idata)  # fmt: skip
    save_posterior(slim_posterior(idata), folder / f"{letter}.nc")


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda p: p.name)
def test_notebooks_are_stored_as_one_run_left_them(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert len(notebook.cells) > 10
    assert path.stat().st_size <= 1_000_000
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell.outputs]
    assert all(o.output_type != "error" and o.get("name") != "stderr" for o in outputs)
    assert str(FOLDER.parent) not in str(outputs)


def test_first_look(tmp_path: Path) -> None:
    notebook = run("01-first-look.ipynb", tmp_path)
    said = printed(notebook)
    assert "21 vessels, a beat of 110 ms" in said
    assert "solved: True" in said
    solves = int(re.search(r"(\d+) solves", said)[1])
    assert 720 <= solves <= 740  # 4 chains of 180 steps, one solve a step, and their starts
    assert "not converged:" in said
    assert pictures(notebook) == 6
    assert list(tmp_path.iterdir()) == []


def test_the_diagnosis_prints_what_is_stored(tmp_path: Path) -> None:
    stored = printed(nbformat.read(FOLDER / "03-diagnosis.ipynb", as_version=4))
    notebook = run("03-diagnosis.ipynb", tmp_path)
    lost = missing(stored.splitlines(), printed(notebook))
    assert not lost, lost
    assert "Most likely missing: viscoelastic wall, tau = " in stored
    assert pictures(notebook) == 1


@pytest.mark.needs_data
def test_nine_models_with_two_of_nine(tmp_path: Path) -> None:
    (tmp_path / "posteriors").mkdir()
    for letter in "AB":
        store(tmp_path / "posteriors", letter)
    notebook = run("02-nine-models.ipynb", tmp_path)
    said = printed(notebook)
    for letter in MODELS:
        missing = f"model {letter}: posteriors/{letter}.nc is missing; posteriors/README.md says how" in said
        assert missing == (letter not in "AB")
    assert "here: A, B" in said
    assert pictures(notebook) == 4 + 2 + 1 + 1  # chains and forest, a fit for each, LOO-PIT, ranking


@pytest.mark.needs_data
def test_nine_models_without_posteriors_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    notebook = nbformat.read(FOLDER / "02-nine-models.ipynb", as_version=4)
    first = next(cell.source for cell in notebook.cells if cell.cell_type == "code")
    with pytest.raises(FileNotFoundError, match=r"no posterior of mouse-c6; posteriors/README\.md says how"):
        exec("\n".join(line for line in first.splitlines() if not line.startswith("%")), {})


@pytest.mark.parametrize("path", STORED, ids=lambda p: p.name)
def test_stored_posteriors_hold_parameters_only(path: Path) -> None:
    assert path.stat().st_size < 500_000
    idata = load(path)
    assert list(datasets(idata)) == ["posterior"]
    record = RunRecord.of(idata)
    assert (record.model, record.study) == (path.stem, "mouse-c6")
    assert {str(v.dtype) for v in idata.posterior.data_vars.values()} == {"float32"}
    assert set(idata.posterior.dims) <= {"chain", "draw", "vessel"}
    assert set(suggested(record.model)) <= set(idata.posterior.data_vars) <= {*suggested(record.model), "chi"}
    assert diagnostics(idata).verdict.passes
