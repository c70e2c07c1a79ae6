"""Starting the command line, its errors, and the commands on data."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytensor
import pytest
import scipy
from commands import fails, run, run_json
from typer.testing import CliRunner

import zoo
from zoo.blood.effects import CATALOGUE
from zoo.cli import app

LINES_ONLY = {"fetch", "make", "run"}
"""Commands that print no table, in modules of others that do."""


def test_help_is_quick_and_lists_the_commands() -> None:
    command = [sys.executable, "-m", "zoo", "--help"]
    best = np.inf
    for _ in range(3):
        began = time.monotonic()
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        best = min(best, time.monotonic() - began)
    assert "Usage: python -m zoo [OPTIONS]" in done.stdout
    for name in ("fetch", "studies", "simulate", "sample", "compare", "version"):
        assert name in done.stdout
    assert best < 2.0  # about 0.4 s on a free core; importing PyMC alone takes longer than this


def test_commands_import_nothing_heavy_before_they_run() -> None:
    heavy = "{'pymc', 'arviz', 'matplotlib', 'scipy', 'numpy'}"
    code = f"import sys, zoo.cli; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("typed", "found"),
    [
        ("simulate demo", ["demo", "demo-gap"]),
        ("report demo mouse-h", ["mouse-h1"]),
        ("sample B", ["B"]),
        ("sample A demo --effects stenosis,viscoelastic-w", ["stenosis,viscoelastic-wall"]),
        ("compare demo --models A,B+viscoelastic-w", ["A,B+viscoelastic-wall"]),
        ("effects viscoelastic-w", ["viscoelastic-wall"]),
    ],
)
def test_a_shell_completes_names_without_what_is_heavy(typed: str, found: list[str]) -> None:
    code = (
        "import atexit, sys; from zoo.cli import app; heavy = {'pymc', 'arviz', 'matplotlib', 'scipy'}; "
        "atexit.register(lambda: print(sorted(heavy & set(sys.modules)))); app(prog_name='zoo')"
    )
    asked = {"_ZOO_COMPLETE": "complete_bash", "COMP_WORDS": f"zoo {typed}"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | asked | {"COMP_CWORD": str(len(typed.split()))},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split("\n") == [*found, "[]", ""]


def test_version() -> None:
    assert run("--version").strip() == f"zoo {zoo.__version__}"
    output = run("version")
    assert f"zoo {zoo.__version__}" in output
    assert f"numpy {np.__version__}" in output


def test_studies() -> None:
    output = run("studies")
    assert "demo" in output
    assert "mouse-c6" in output


def test_studies_of_ones_own_are_read(tiny: Path, tmp_path: Path) -> None:
    output = run("studies", tiny)
    assert str(tiny) in output.replace("\n", "")
    assert "demo" not in output
    assert "no study.toml in this folder" in fails("studies", tmp_path)


def test_fetch_unknown() -> None:
    assert "data set 'mouse-c7': unknown; did you mean 'mouse-c6'?" in fails("fetch", "mouse-c7")


@pytest.mark.needs_data
def test_fetch() -> None:
    output = run("fetch", "mouse-c6")
    assert output.count("sha256 as expected") == 3


def test_unknown_study() -> None:
    assert "did you mean 'demo'?" in fails("simulate", "demmo", "--stiffness", "5e4")


def test_debug_shows_the_traceback() -> None:
    result = CliRunner().invoke(app, ["--debug", "simulate", "demmo", "--stiffness", "5e4"])
    assert type(result.exception).__name__ == "StudyError"
    run("studies")  # and the next command starts without it
    assert "Traceback" not in fails("simulate", "demmo", "--stiffness", "5e4")


def test_a_fault_of_ours_is_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> None:
        raise ZeroDivisionError("nobody thought\nof this")

    monkeypatch.setattr("zoo.blood.study.list_studies", broken)
    output = run("studies", code=1)
    assert (
        output.strip()
        == "error: unexpected ZeroDivisionError: nobody thought of this; `zoo --debug ...` shows where"
    )


def test_interrupt_has_its_own_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("zoo.blood.study.list_studies", interrupted)
    assert "interrupted; the same command goes on" in run("studies", code=130)


def test_doctor_tells_what_decides_the_speed_and_json_is_json() -> None:
    found = run_json("doctor")
    assert found["versions"]["zoo"] == zoo.__version__
    assert found["versions"].items() >= {"numba": numba.__version__, "scipy": scipy.__version__}.items()
    assert 0.0 < found["solve_ms"] < 1e4
    assert 1 <= found["cores_of_this_process"] <= found["cores"] == os.cpu_count()
    assert all(isinstance(one["threads"], int) for one in found["blas"])
    assert found["pytensor_blas_flags"] == (pytensor.config.blas__ldflags or None)
    assert found["studies"]["demo"] is True
    assert "PyTensor's BLAS" in run("doctor")
    assert run("doctor").count("\n") < 20
    rows = run_json("studies")
    assert {"study": "demo", "vessels": 21}.items() <= rows[0].items()
    [one] = run_json("effects", "stenosis")
    assert one["name"] == "stenosis"
    assert {p["name"] for p in one["parameters"]} == {p.name for p in CATALOGUE["stenosis"].parameters}


def test_every_command_that_prints_a_table_has_json() -> None:
    groups = [app, *(group.typer_instance for group in app.registered_groups)]
    functions = [one.callback.__wrapped__ for group in groups for one in group.registered_commands]
    source = {function: inspect.getsource(inspect.getmodule(function)) for function in functions}
    tables = [f for f in functions if "plain_table(" in source[f] and f.__name__ not in LINES_ONLY]
    assert len(tables) >= 9
    for function in tables:
        assert {"as_json", "json"} & inspect.signature(function).parameters.keys(), function
