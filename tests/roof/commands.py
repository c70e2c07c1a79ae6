"""Commands run as a user runs them."""

from __future__ import annotations

import json
from typing import Any

from typer.testing import CliRunner

from zoo.cli import app

TRUE = {"stiffness": 5e4, "psi1": 0.9, "psi2": 1.1, "c": 0.8}
"""Parameters that made the study `tiny`."""


def run(*arguments: object, code: int = 0) -> str:
    """Output of a command that must end with `code`; all streams together, lines unwrapped."""
    result = CliRunner(env={"COLUMNS": "200"}).invoke(app, [str(a) for a in arguments])
    assert result.exit_code == code, result.output
    return result.output


def run_json(*arguments: object) -> Any:
    """What a command prints with --json: all of its standard output."""
    result = CliRunner().invoke(app, [*map(str, arguments), "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def fails(*arguments: object) -> str:
    """The one line that a refused command prints."""
    output = run(*arguments, code=2).strip()
    assert output.count("\n") == 0
    assert output.startswith("error: ")
    assert "Traceback" not in output
    return output
