"""`zoo effects`: the catalogue as a table, and one effect."""

from __future__ import annotations

from commands import fails, run
from typer.testing import CliRunner

from zoo.blood.effects import CATALOGUE, FAMILIES
from zoo.cli import app


def test_effects_lists_the_catalogue_by_family() -> None:
    for columns in ("200", "80"):
        result = CliRunner(env={"COLUMNS": columns}).invoke(app, ["effects"])
        assert result.exit_code == 0
        assert max(len(line) for line in result.output.splitlines()) <= int(columns)
        for name in CATALOGUE:
            assert f"  {name} " in result.output
        lines = [line.strip() for line in result.output.splitlines()]
        assert [line for line in lines if line in FAMILIES] == list(FAMILIES)
        assert "tau (s)" in result.output
        assert "normal(0, 0.027) in [0, 0.27] beats" in result.output
        assert "…" not in result.output


def test_effects_tells_all_about_one() -> None:
    made = CATALOGUE["catheter-resonance"]
    found = run("effects", "catheter-resonance")
    for words in (made.statement, made.equation, made.signature, made.source, made.family):
        assert words in found
    for amplitude in made.parameters:
        assert (
            f"{amplitude.name} ({amplitude.unit}) ~ normal({amplitude.centre:g}, {amplitude.scale:g})"
            in found
        )
        assert amplitude.why in found
    assert "linear-constant, linear-radius" in run("effects", "tangent-wall")
    assert "did you mean 'stenosis'?" in fails("effects", "stenoses")
