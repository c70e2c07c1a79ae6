"""Groups of options: every command of a group has all its options, and gets them filled in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from commands import fails
from typer.main import get_command
from typer.testing import CliRunner

from zoo.blood.study import load_study
from zoo.cli import app
from zoo.cli.command import UsageError, Without, command, option
from zoo.cli.options import SamplingOptions, StudyOptions


def probe(words: list[str]) -> tuple[StudyOptions, SamplingOptions]:
    """What a command gets that is called with these words."""
    got = []

    @command
    def look(*, options: StudyOptions, sampling: Annotated[SamplingOptions, Without("thin")]) -> None:
        got.append((options, sampling))

    tried = typer.Typer()
    tried.command()(look)
    result = CliRunner().invoke(tried, words)
    assert result.exit_code == 0, result.output
    return got[0]


@pytest.mark.parametrize("name", ["simulate", "priors", "sample", "compare", "diagnose", "report"])
def test_settings_are_options_of_every_command_on_a_study(name: str) -> None:
    options = {p.name for p in get_command(app).commands[name].params}  # type: ignore[attr-defined]
    assert {"settings", "accuracy", "prior"} <= options


def test_what_is_set_takes_the_place_of_the_study_s_own() -> None:
    words = ["--set", "conventions.friction=rest", "--set", "conventions=published-code", "--accuracy", "0.1"]
    study = probe([*words, "--set", "numerics.max_beats=40", "--prior", "c=uniform(1,2)"])[0].load("demo")
    assert study.conventions.name == "custom (published-code with friction=rest)"
    assert study.numerics == {"accuracy_percent": 0.1, "max_beats": 40}  # not the demo's dx_cm too
    assert study.priors["c"] == {"uniform": [1.0, 2.0]}
    assert probe([])[0].load("demo") == load_study("demo")


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("friction", "--set 'friction': write KEY=VALUE, such as conventions.friction=rest"),
        ("frictio=rest", "'frictio': no field of a study"),
        ("numerics.dx=1", "study.toml with numerics.dx=1: numerics: dx: unknown field; did you mean"),
        ("conventions=printd", "with conventions=printd: conventions: name = 'printd': unknown; did you"),
        ("junctions.pressure=both", "network.toml with junctions.pressure=both: junctions: pressure ="),
        ("vessel=3", "vessel: is set field by field, such as vessel.radius_cm=0.05"),
        ("vessel.radius_cm=1,2", "vessel.radius_cm: 2 values; give one for all vessels, or one for each of"),
        ("name.x=1", "name.x: name = 'demo': is no table; set name itself"),
    ],
)
def test_a_setting_that_cannot_be_used_is_one_line(setting: str, message: str) -> None:
    assert message in fails("simulate", "demo", "--stiffness", "5e4", "--set", setting)


def test_a_setting_is_given_once() -> None:
    with pytest.raises(UsageError, match="--set name=b: name was given before; give it once"):
        StudyOptions(settings=["name=a", "name=b"]).changes()


@pytest.fixture(scope="module", autouse=True)
def chains_in_this_process() -> None:
    """Settings are looked at here as they are, without the processes of conftest.py."""


def test_sampling_goes_on_until_converged_unless_draws_are_given() -> None:
    for words, draws, target in (
        ([], 500, 400.0),
        (["--draws", "70"], 70, None),
        (["--draws", "70", "--until", "ess=90"], 70, 90.0),
        (["--until", "NONE"], 500, None),
    ):
        settings = probe(words)[1].settings()
        assert (settings["draws"], settings["until_ess"]) == (draws, target)
    few = probe(["--chains", "1"])[1].settings()
    assert (few["chains"], few["cores"], few["thin"]) == (1, 1, None)
    with pytest.raises(UsageError, match="write --until ess=400"):
        SamplingOptions(until="rhat=1.01").settings()


def test_a_group_leaves_out_what_a_command_does_not_have() -> None:
    assert CliRunner().invoke(app, ["compare", "demo", "--thin", "3"]).exit_code == 2
    options = {p.name for p in get_command(app).commands["compare"].params}  # type: ignore[attr-defined]
    assert {"draws", "cores", "seed", "until"} <= options
    assert not {"thin"} & options


def test_two_options_of_one_name_are_refused() -> None:
    @dataclass
    class Group:
        seed: int = option(1, "Seed.")

    def twice(seed: int = 2, *, group: Group) -> None:
        raise AssertionError

    twice.__annotations__["group"] = Group
    with pytest.raises(TypeError, match="twice: two options named seed"):
        command(twice)
