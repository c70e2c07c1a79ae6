"""Groups of options: every command of a group has all its options, and gets them filled in."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated

import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

from zoo.blood.conventions import SWITCHES
from zoo.blood.study import load_study
from zoo.blood.study.tables import NumericsTable
from zoo.cli import app
from zoo.cli.command import UsageError, Without, command
from zoo.cli.options import NUMERICAL_NAMES, ConventionOptions, NumericalOptions, SamplingOptions


def probe(words: list[str]) -> tuple[ConventionOptions, SamplingOptions]:
    """What a command gets that is called with these words."""
    got = []

    @command
    def look(
        *,
        conventions: ConventionOptions,
        sampling: Annotated[SamplingOptions, Without("thin")],
    ) -> None:
        got.append((conventions, sampling))

    tried = typer.Typer()
    tried.command()(look)
    result = CliRunner().invoke(tried, words)
    assert result.exit_code == 0, result.output
    return got[0]


def test_options_are_named_as_what_they_set() -> None:
    assert {field.name for field in fields(ConventionOptions)} == {"conventions", *SWITCHES}
    assert {field.name for field in fields(NumericalOptions)} == set(NUMERICAL_NAMES)
    assert set(NUMERICAL_NAMES) <= set(NumericsTable.model_fields)


def test_options_take_the_place_of_the_study_s_numerics() -> None:
    study = replace(load_study("demo"), numerics={"dx_cm": 0.025, "max_beats": 40})
    assert NumericalOptions().on(study) is study
    assert NumericalOptions(dx_cm=0.05).on(study).numerics == {"dx_cm": 0.05, "max_beats": 40}
    assert NumericalOptions(accuracy_percent=0.1).on(study).numerics == {
        "accuracy_percent": 0.1,
        "max_beats": 40,
    }
    given = NumericalOptions(accuracy_percent=0.1, steps_per_beat=1024)
    assert given.words() == ["--accuracy", "0.1", "--steps", "1024"]


@pytest.mark.parametrize("name", ["simulate", "sample", "compare", "diagnose"])
def test_the_resolution_is_an_option_of_every_command_that_solves(name: str) -> None:
    options = {p.name for p in get_command(app).commands[name].params}  # type: ignore[attr-defined]
    assert set(NUMERICAL_NAMES) <= options


@pytest.mark.parametrize("name", ["simulate", "sample", "compare", "diagnose"])
def test_every_switch_is_an_option_of_every_command_on_a_study(name: str) -> None:
    options = {p.name for p in get_command(app).commands[name].params}  # type: ignore[attr-defined]
    assert {field.name for field in fields(ConventionOptions)} <= options


def test_the_words_of_options_give_the_same_options_back() -> None:
    given = ConventionOptions(
        conventions="published-code",
        wall_factor=2.5,
        stiffness_radius_unit_cm=0.1,
        friction="fixed",
        friction_radius_cm=0.05,
        truncate_lengths=False,
        mmhg=1333.22,
        sample_lag_beats=0.25,
    )
    assert probe(given.words())[0] == given
    assert probe(["--truncate-lengths"])[0].words() == ["--truncate-lengths"]
    assert ConventionOptions().words() == probe([])[0].words() == []


def test_conventions_are_a_name_switches_or_both() -> None:
    printed = ConventionOptions().load("demo").conventions
    both = ConventionOptions(conventions="published-code", wall_factor=2.0).load("demo").conventions
    assert both.name == "custom (published-code with wall_factor=2.0)"
    one = ConventionOptions(friction="rest").load("demo").conventions
    assert one == printed.replace(friction="rest")
    assert ConventionOptions(conventions="published-code").load("demo").conventions.name == "published-code"


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
    assert not {"chains", "thin", "resume"} & options


def test_two_options_of_one_name_are_refused() -> None:
    @dataclass
    class Group:
        seed: Annotated[int, typer.Option("--seed")] = 1

    def twice(seed: int = 2, *, group: Group) -> None:
        raise AssertionError

    twice.__annotations__["group"] = Group
    with pytest.raises(AssertionError, match="twice: two options named seed"):
        command(twice)
