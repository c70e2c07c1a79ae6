"""`zoo priors`, and `--prior` on the commands that build a model."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from commands import fails, run, run_json
from typer.testing import CliRunner

from zoo.cli import app

EXAMPLE = Path(__file__).parents[2] / "docs" / "example-study"


def test_priors_are_a_table_figures_and_what_could_be_solved(tmp_path: Path) -> None:
    found = run(
        "priors", EXAMPLE, "--model", "A", "--n-draws", 10, "-q", "-o", tmp_path / "p",
        "--prior", "c=log_uniform(0.5,2)",
    )  # fmt: skip
    for words in ("wave speeds of 0.7 to 20 m/s", "nominal loads", "log-uniform in [0.5, 2]; given"):
        assert words in found
    assert "10 of 10 prior draws could be solved" in found
    with (tmp_path / "p" / "priors.csv").open(newline="") as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    assert float(rows["c"]["median"]) == pytest.approx(1.0)
    assert rows["f3"]["unit"] == "g cm-1 s-2"
    assert (tmp_path / "p" / "priors.png").stat().st_size > 10_000
    assert (tmp_path / "p" / "prior-predictive.png").stat().st_size > 10_000


def test_the_table_for_machines(tmp_path: Path) -> None:
    rows = json.loads(run("priors", EXAMPLE, "--model", "A", "--json", "--prior", "c=log_uniform(0.5,2)"))
    by_name = {row["parameter"]: row for row in rows}
    assert by_name["c"]["median"] == pytest.approx(1.0)
    assert by_name["f3"]["from"] == "wave speeds of 0.7 to 20 m/s"
    assert "give one of them" in fails("priors", EXAMPLE, "--json", "-o", tmp_path / "p")


def test_the_table_fits_a_terminal_of_80_columns() -> None:
    result = CliRunner(env={"COLUMNS": "80"}).invoke(app, ["priors", str(EXAMPLE), "--n-draws", "10", "-q"])
    assert result.exit_code == 0
    table = result.output[: result.output.index("prior draws could")]
    assert "…" not in table
    assert max(len(line) for line in table.splitlines()) <= 80


@pytest.mark.parametrize(
    ("command", "option", "words"),
    [
        (["sample", "A"], "f3=loguniform(1,2)", "--prior f3: 'loguniform': unknown law; did you mean 'log_u"),
        (["diagnose", "-q"], "f3=uniform(2,1)", "--prior f3: uniform = [2.0, 1.0]: "),
        (["sample", "A"], "psi3=uniform(1,2)", "psi3: unknown; did you mean"),
        (["priors"], "w_presure_mmHg=uniform(1,2)", "did you mean 'w_pressure_mmHg'?"),
        (
            ["priors", "--model", "D"],
            "f4=uniform(1,2)",
            "psi1, psi2, c, noise_pressure_mmHg, stiffness",
        ),
        (["compare"], "f3", "--prior 'f3': write NAME=LAW(NUMBERS)"),
        (["report"], "set=paun", "--prior set = 'paun': unknown; did you mean 'paun2020'?"),
    ],
)
def test_options_that_cannot_be_used_are_one_line(command: list[str], option: str, words: str) -> None:
    assert words in fails(*command, EXAMPLE, "--prior", option)


def test_a_prior_that_a_model_has_no_use_for_is_said() -> None:
    found = run("priors", EXAMPLE, "--model", "A", "--n-draws", 10, "-q", "--prior", "f1=uniform(1,2)")
    assert "model A has no f1: the prior of f1 is not used" in found
    rows = run_json("priors", EXAMPLE, "--model", "A", "--prior", "f1=uniform(1,2)")
    assert "f1" not in {row["parameter"] for row in rows}
    assert "no f3" not in run(
        "priors", EXAMPLE, "--model", "A", "--n-draws", 10, "-q", "--prior", "stiffness=uniform(1e5,2e5)"
    )
