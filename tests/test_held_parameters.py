"""Parameters that are held at a value, and those that are given twice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import zoo
from zoo.blood.baseline import get_baseline
from zoo.blood.prior_tables import PriorsError
from zoo.blood.study import StudyError, load_study, save_study
from zoo.blood.study_priors import with_priors
from zoo.cli import app
from zoo.core.model import record_of

UNIFORM = {"log_uniform": [2e4, 4e5]}


def names(study: zoo.Study, base: str = "B") -> list[str]:
    return [p.name for p in get_baseline(base).forward(study).parameters]


def test_a_held_parameter_is_no_longer_free() -> None:
    study = load_study("demo")
    held = with_priors(study, None, {"psi1": 1.3, "stiffness": 6e4})
    free, fewer = get_baseline("B").forward(study), get_baseline("B").forward(held)
    assert [p.name for p in fewer.parameters] == ["psi2", "c"]
    assert free.key != fewer.key
    both = dict.fromkeys(("psi2", "c"), np.asarray(0.9))
    whole = zoo.pack(free.parameters, {"f3": 6e4, "psi1": 1.3, **both})
    less = fewer.configure(zoo.pack(fewer.parameters, both))
    assert free.solve(free.configure(whole)) == pytest.approx(fewer.solve(less), rel=1e-4)
    other = free.configure(zoo.pack(free.parameters, {"f3": 6e4, "psi1": 1.0, **both}))
    assert free.solve(other) != pytest.approx(fewer.solve(less), rel=1e-3)


def test_an_argument_in_python_and_its_record() -> None:
    model = zoo.model_B(load_study("demo"), fixed={"psi1": 1.0})
    assert "psi1" not in {v.name for v in model.free_RVs}
    assert record_of(model).settings["held"] == {"psi1": 1.0}
    assert record_of(model).priors["psi1"] == "held at 1"  # by which a posterior of another value is refused
    assert "held" not in record_of(zoo.model_B(load_study("demo"))).settings


def test_a_table_in_the_study_is_kept_and_freed_by_a_prior(tmp_path: Path) -> None:
    save_study(load_study("demo", settings={"parameters.psi1": 1.0}), tmp_path / "s")
    study = load_study(tmp_path / "s")
    assert study.parameters == {"psi1": 1.0}
    assert study != load_study("demo")
    assert names(study) == ["f3", "psi2", "c"]
    assert names(with_priors(study, {"psi1": {"uniform": [0.5, 2]}})) == ["f3", "psi1", "psi2", "c"]


def test_an_option_holds_what_the_study_gives_a_prior() -> None:
    study = load_study("demo", settings={"priors.stiffness": UNIFORM})
    held = with_priors(study, None, {"f3": 5e4})
    assert not held.priors
    assert names(held) == ["psi1", "psi2", "c"]


@pytest.mark.parametrize("other", ["f3", "m_chi"])
def test_one_parameter_under_two_names(other: str) -> None:
    both = {"stiffness": UNIFORM, other: UNIFORM}
    with pytest.raises(StudyError, match=f"{other} and stiffness: are one parameter under two names"):
        load_study("demo", settings={f"priors.{name}": law for name, law in both.items()})
    study = load_study("demo", settings={"priors.stiffness": UNIFORM})
    with pytest.raises(PriorsError, match=f"{other} and stiffness"):
        with_priors(study, {other: UNIFORM})
    with pytest.raises(PriorsError, match=f"{other} and stiffness"):
        with_priors(load_study("demo"), None, {"stiffness": 5e4, other: 6e4})


def test_a_prior_and_a_value_at_once() -> None:
    with pytest.raises(PriorsError, match="f3 and stiffness: has a prior and a value"):
        with_priors(load_study("demo"), {"stiffness": UNIFORM}, {"f3": 5e4})
    with pytest.raises(StudyError, match="psi1: has a prior and a value"):
        load_study("demo", settings={"priors.psi1": {"uniform": [0.5, 2]}, "parameters.psi1": 1.0})


@pytest.mark.parametrize(
    ("base", "held", "told"),
    [
        ("B", {"psi3": 1.0}, "psi3: did you mean|psi3: "),
        ("B", {"psi1": -1.0}, "psi1 = -1: lies outside its prior"),
        ("B", {"noise_pressure_mmHg": 1.0}, "noise_pressure_mmHg: "),
        ("G", {"stiffness": 5e4}, "stiffness = 50000: is of a population"),
        ("B", {"psi1": float("nan")}, "psi1 = nan: must be a number"),
    ],
)
def test_what_cannot_be_held(base: str, held: dict[str, float], told: str) -> None:
    with pytest.raises(PriorsError, match=told):
        names(with_priors(load_study("demo"), None, held), base)


def test_the_option(tmp_path: Path) -> None:
    def run(*words: str) -> tuple[int, str]:
        done = CliRunner().invoke(app, ["priors", "demo", "--n-draws", "10", "-q", *words])
        return done.exit_code, done.output

    code, text = run("--fix", "psi1=1.0", "--fix", "gamma=3")
    assert code == 0, text
    assert "psi2" in text
    assert "psi1" not in text
    assert "model B has no gamma: the value that it is held at is not used" in text
    for words, told in (
        (("--fix", "psi1"), "write NAME=NUMBER"),
        (("--fix", "psi1=1", "--fix", "psi1=2"), "psi1 was given before"),
        (("--fix", "psi1=1", "--prior", "psi1=uniform(1,2)"), "psi1: has a prior and a value"),
        (("--prior", "f3=uniform(1e4,2e4)", "--prior", "stiffness=uniform(1e4,2e4)"), "f3 and stiffness"),
    ):
        code, text = run(*words)
        assert code == 2
        assert told in " ".join(text.split())
