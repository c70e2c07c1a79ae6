"""Options that several commands share, in groups: of a study, of sampling.

A group is a dataclass; a command that has a parameter of its type has all its options (`zoo.cli.command`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zoo.cli.command import Role, UsageError

if TYPE_CHECKING:
    from zoo.blood.study import Study

StudyArgument = Annotated[
    str, typer.Argument(metavar="STUDY", help="A built-in study (see `zoo studies`) or a folder."), Role.STUDY
]
StrictOption = Annotated[
    bool, typer.Option("--strict", help="End with exit code 3 if chains have not converged."), Role.ASIDE
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table."), Role.ASIDE]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="No progress."), Role.ASIDE]

DaskOption = Annotated[
    str | None,
    typer.Option(
        "--dask",
        help="Work on the workers of a dask.distributed scheduler, tcp://HOST:8786, instead.",
        metavar="ADDRESS",
    ),
    Role.ASIDE,
]


@dataclass(frozen=True)
class PluginOptions:
    """Files with effects and models of one's own."""

    effects_from: Annotated[
        list[Path] | None,
        typer.Option(
            "--effects-from",
            help="Python file that defines effects; it is run. May be repeated.",
            metavar="FILE",
        ),
    ] = None
    models_from: Annotated[
        list[Path] | None,
        typer.Option(
            "--models-from",
            help="Python file with functions model_NAME(study, **settings); it is run. May be repeated.",
            metavar="FILE",
        ),
    ] = None

    def load(self) -> None:
        """Run the files, so that what they define can be named."""
        from zoo.blood.plugins import add_effects, load_models

        for path in self.effects_from or []:
            add_effects(path)
        for path in self.models_from or []:
            load_models(path)


def _each_once(
    option: str, texts: list[str] | None, read: Callable[[str], tuple[str, Any]], refused: type[Exception]
) -> dict[str, Any]:
    """Name and value of each use of an option that may be repeated, with another name each time."""
    found: dict[str, Any] = {}
    for text in texts or []:
        try:
            name, value = read(text)
        except refused as error:
            raise UsageError(f"{option} {error}") from None
        if name in found:
            raise UsageError(f"{option} {text}: {name} was given before; give it once")
        found[name] = value
    return found


@dataclass(frozen=True)
class PriorOptions:
    """Priors instead of some of a study's own."""

    prior: Annotated[
        list[str] | None,
        typer.Option(
            "--prior",
            help="Instead of the study's own: stiffness=log_uniform(2e4,4e5), f3=..., wave_speed_m_s=1,4 or "
            "set=paun2020; laws uniform, log_uniform, normal, log_normal, inverse_gamma. May be repeated.",
            metavar="NAME=LAW(...)",
        ),
    ] = None

    def table(self) -> dict[str, Any]:
        """What was given, as the table [priors] of study.toml has it.

        Raises
        ------
        UsageError
            If an option cannot be read, or two are of one name.
        """
        from zoo.blood.prior_tables import PriorsError, read_option, read_priors

        def read(text: str) -> tuple[str, Any]:
            name, value = read_option(text)
            read_priors({name: value})
            return name, value

        return _each_once("--prior", self.prior, read, PriorsError)


@dataclass(frozen=True)
class StudyOptions(PriorOptions):
    """What stands in the place of a study's own fields."""

    fix: Annotated[
        list[str] | None,
        typer.Option(
            "--fix",
            help="Hold a parameter at a value, such as psi1=1.0 or stiffness=5e4, in the place of its prior. "
            "May be repeated.",
            metavar="NAME=NUMBER",
        ),
    ] = None
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="A field of study.toml or network.toml, such as conventions=published-code, "
            "conventions.friction=rest, numerics.dx_cm=0.01, blood.velocity_profile_order=9, or "
            "vessel.resistance=3e4: one value, or one per vessel with commas. May be repeated.",
            metavar="KEY=VALUE",
        ),
    ] = None
    accuracy: Annotated[
        float | None,
        typer.Option(
            "--accuracy",
            help="Choose cells and steps for this error, % of the pulse (default 0.03).",
            metavar="PERCENT",
        ),
    ] = None

    def load(self, name: str) -> Study:
        """A study with these settings and priors.

        Raises
        ------
        UsageError
            If an option cannot be read.
        """
        from zoo.blood.prior_tables import PriorsError, read_held
        from zoo.blood.priors import with_priors
        from zoo.blood.study import load_study

        held = _each_once("--fix", self.fix, read_held, PriorsError)
        return with_priors(load_study(name, settings=self.changes()), self.table(), held)

    def changes(self) -> dict[str, Any]:
        """The settings by their keys."""
        from zoo.blood.study import StudyError
        from zoo.blood.study.settings import read_setting

        found = _each_once("--set", self.settings, read_setting, StudyError)
        if self.accuracy is not None:
            found["numerics.accuracy_percent"] = self.accuracy
        return found


@dataclass(frozen=True)
class SamplingOptions:
    """How a posterior is sampled."""

    draws: Annotated[
        int | None,
        typer.Option("--draws", help="Stored draws of each chain; without it, until converged."),
        Role.ASIDE,
    ] = None
    tune: Annotated[
        int | None, typer.Option("--tune", help="Steps to adapt, thrown away; 100 a dimension, at least 600.")
    ] = None
    chains: Annotated[int, typer.Option("--chains", help="Chains; at least 4 for a verdict.")] = 4
    cores: Annotated[
        int | None, typer.Option("--cores", help="Processes at a time; all cores by default."), Role.ASIDE
    ] = None
    method: Annotated[
        str,
        typer.Option(
            "--method",
            help="exact: chains with the solver itself; surrogate: NUTS on a surrogate of it, each stored "
            "draw corrected with it; nuts: NUTS with the solver's derivatives; auto chooses by model.",
        ),
    ] = "auto"
    thin: Annotated[
        int | None,
        typer.Option("--thin", help="Steps for each stored draw; a quarter of the dimension by default."),
    ] = None
    seed: Annotated[int | None, typer.Option("--seed", help="Seed; recorded if not given.")] = None
    until: Annotated[
        str | None,
        typer.Option(
            "--until",
            help="ess=400 (default without --draws): until every parameter has it and R-hat <= 1.01; "
            "or none.",
        ),
        Role.ASIDE,
    ] = None
    max_draws: Annotated[
        int | None,
        typer.Option("--max-draws", help="Limit of --until; 40 times the first check."),
        Role.ASIDE,
    ] = None
    quiet: QuietOption = False

    def settings(self) -> dict[str, Any]:
        """Arguments of `zoo.sample`.

        Raises
        ------
        UsageError
            If `--until` cannot be read, or a number is too small.
        """
        from zoo.core.inference.convergence import FIRST_CHECK

        for option, value in (("--draws", self.draws), ("--cores", self.cores)):
            if value is not None and value < 1:
                raise UsageError(f"{option} {value}: must be at least 1")
        return {
            "method": self.method,
            "draws": FIRST_CHECK if self.draws is None else self.draws,
            "tune": self.tune,
            "chains": self.chains,
            "cores": self.cores or max(1, min(self.chains, os.cpu_count() or 1)),
            "thin": self.thin,
            "seed": self.seed,
            "until_ess": self.ess_target(),
            "max_draws": self.max_draws,
        }

    def ess_target(self) -> float | None:
        """Effective sample size to reach; None for a fixed number of draws."""
        if self.until is None:
            from zoo.core.inference.convergence import ESS_TARGET

            return ESS_TARGET if self.draws is None else None
        if self.until.lower() == "none":
            return None
        name, _, number = self.until.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if name.strip().lower() != "ess" or not (math.isfinite(value) and value > 0):
            raise UsageError(
                f"--until {self.until}: write --until ess=400, or --until none for a fixed number of draws"
            )
        return value
