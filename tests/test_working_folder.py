"""Nothing of the working folder is run: commands and processes beside files named as modules."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from test_op import small_study
from zoo.blood.study import save_study

TESTS = Path(__file__).parent
TRAP = "open({marker!r}, 'w').close()\nraise SystemExit('run from the working folder')\n"
COMMAND = "from zoo.cli import app\napp()\n"
POOL = f"""
import sys
sys.path.append({str(TESTS)!r})
from test_workers import square
from zoo.core.inference.workers import each
if __name__ == "__main__":
    print(sorted(each(square, [1, 2, 3], 2)))
"""
MODEL = """
from dataclasses import replace
import zoo
import beside

@zoo.effect("damped", "inflow", parameters=[zoo.EffectParameter("share", "1", 0.1, 0.0, 0.9, (0.1,))])
def damped(case, values, location):
    "The inflow is drawn to its mean."
    return replace(case, inflow_ml_s=beside.change(case.inflow_ml_s, values[0]))

def model_mine(study, **settings):
    from beside_later import build
    return build(study, effects=[damped], **settings)
"""
BESIDE = """
from further_beside import mean

def change(flow, share):
    return flow + share * (mean(flow) - flow)
"""
BESIDE_LATER = """
from zoo.models.model_a import model_A as build
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A study among files named as every module of Python and of every installed package, each a trap."""
    folder = tmp_path / "work"
    folder.mkdir()
    names = {*sys.stdlib_module_names, *metadata.packages_distributions(), "sitecustomize", "usercustomize"}
    for name in filter(str.isidentifier, names):
        (folder / f"{name}.py").write_text(TRAP.format(marker=str(tmp_path / f"ran-{name}")))
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text(TRAP.format(marker=str(tmp_path / f"ran-{name}-folder")))
    save_study(small_study(), folder / "small")
    return folder


def run(folder: Path, code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """A script that stands elsewhere, as the command `zoo` does, run in the folder; no trap was sprung."""
    script = folder.parent / "scripts" / "zoo_script.py"
    script.parent.mkdir(exist_ok=True)
    script.write_text(code)
    inherited = os.pathsep.join(p for p in sys.path if p and Path(p) != TESTS)
    done = subprocess.run(
        [sys.executable, str(script), *words],
        cwd=folder, env={**os.environ, "PYTHONPATH": inherited}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert sorted(path.name for path in folder.parent.glob("ran-*")) == [], done.stderr[-2000:]
    return done


FEW = ["--draws", "5", "--tune", "5", "--chains", "2", "--until", "none", "--quiet"]


def test_a_command_and_its_chains_run_nothing_of_the_working_folder(folder: Path) -> None:
    done = run(folder, COMMAND, "sample", "A", "small", "-o", "a.nc", "--cores", "1", *FEW)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (folder / "a.nc").is_file()


def test_a_pool_runs_nothing_of_the_working_folder(folder: Path) -> None:
    done = run(folder, POOL)
    assert done.stdout == "[(1, 1), (2, 4), (3, 9)]\n", done.stderr[-2000:]


def test_a_model_of_ones_own_imports_what_stands_beside_it_but_nothing_else(folder: Path) -> None:
    """It stands in the working folder; the chains' processes have its functions and those that they call."""
    (folder / "mine.py").write_text(MODEL)
    (folder / "beside.py").write_text(BESIDE)
    (folder / "further_beside.py").write_text("from numpy import mean\n")
    (folder / "beside_later.py").write_text(BESIDE_LATER)
    words = ["sample", "mine", "small", "--models-from", "mine.py", "-o", "a.nc", "--cores", "1"]
    done = run(folder, COMMAND, *words, *FEW)
    assert done.returncode == 0, done.stderr[-2000:]


def test_the_traps_work(folder: Path) -> None:
    """With the working folder first in the path, as `python -c` has it, one is run."""
    with pytest.raises(AssertionError, match="ran-json"):
        run(folder, "import sys; sys.path.insert(0, ''); import json")
