"""Exit codes, options in errors, tables that fit, outputs that are checked first."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import fails, run
from rich.text import Text

import zoo
import zoo.core.posterior.storage
from zoo.cli.screen import plain_table, say
from zoo.core.arviz_lines import datasets


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--draws", 0], "--draws 0: must be at least 1"),
        (["--cores", 0], "--cores 0: must be at least 1"),
        (["--tune", -1], "--tune -1: must be a whole number of at least 0"),
        (["--max-draws", 3], "--max-draws 3: must be a whole number of at least 500"),
    ],
)
def test_errors_of_values_name_the_option(arguments, message, tmp_path) -> None:
    assert message in fails("sample", "A", "demo", "-o", tmp_path / "A.nc", *arguments)


def test_errors_of_the_solvers_values_name_the_option() -> None:
    stiff = ["simulate", "demo", "--stiffness", "5e4"]
    assert "--psi1 -3: must be positive" in fails(*stiff, "--psi1", -3)


def test_strict_ends_with_its_own_code_and_still_writes(tiny: Path, tmp_path) -> None:
    path = tmp_path / "A.nc"
    words = ["sample", "A", tiny, "-o", path, "--draws", 8, "--tune", 8, "--seed", 1, "-q", "--strict"]
    shown = run(*words, code=3)
    assert "not converged" in shown
    assert f"wrote {path}" in shown
    groups = set(datasets(zoo.core.posterior.storage.load(path)))
    assert {"log_likelihood", "posterior_predictive", "prior", "constant_data"} <= groups


def printed(table: object, capsys: pytest.CaptureFixture[str], monkeypatch, width: int) -> list[str]:
    """Lines of a table."""
    monkeypatch.setenv("COLUMNS", str(width))
    say(table)
    return [line.rstrip() for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize("width", [40, 80, 200])
def test_columns_of_numbers_are_never_folded(width: int, capsys, monkeypatch) -> None:
    columns = ("WAIC", "SE", "as one", "PSIS-LOO", "diff.", "its SE", "weight", "SSE ((ml/s)2)", "converged")
    table = plain_table("model", *columns, numbers=columns, title="models")
    rows = [("B+viscoelastic-wall", *(f"{-4516.5 + i:.1f}" for i in range(9))), ("A", *"123456789")]
    for row in rows:
        table.add_row(*row)
    _title, *lines = printed(table, capsys, monkeypatch, width)
    assert [line.split() for line in lines] == [
        ["model", *" ".join(columns).split()],
        *(list(row) for row in rows),
    ]


def test_a_column_of_texts_is_folded_instead(capsys, monkeypatch) -> None:
    table = plain_table("name", "what it does")
    table.add_row("taper", Text(" ".join(["narrows along the vessel"] * 8)))
    lines = printed(table, capsys, monkeypatch, 80)
    assert max(map(len, lines)) <= 80
    assert sum(line.startswith("name") for line in lines) == 1


EFFECT = '''
from zoo.blood.effects import effect
from zoo.core.effects import EffectParameter


@effect("mine", family="fluid", parameters=[EffectParameter("a", "1", 0.5, -1.0, 3.0, starts=(0.1,))])
def mine(case, values, location):
    """Nothing."""
    return case
'''


def test_blind_run_takes_effects_of_ones_own(tmp_path, monkeypatch) -> None:
    file = tmp_path / "mine.py"
    file.write_text(EFFECT, encoding="utf-8")
    (tmp_path / "cases").mkdir()
    seen = {}

    def diagnosed(cases, output, **settings):
        from zoo.core.blindcheck.folders import Ran

        seen.update(settings)
        return Ran((), (), {})

    monkeypatch.setattr("zoo.blood.blind.diagnose_cases", diagnosed)
    run("blind", "run", tmp_path / "cases", "-o", tmp_path / "answers", "--effects-from", file, "-q")
    assert list(seen["effects_from"]) == [file]
    assert "no.py" in fails("blind", "run", tmp_path / "cases", "--effects-from", tmp_path / "no.py")
