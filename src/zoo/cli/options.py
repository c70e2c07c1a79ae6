"""Options that several commands share, in groups: of a study's conventions, of the solver, of sampling.

A group is a dataclass; a command that has a parameter of its type has all its options (`zoo.cli.command`).
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zoo.cli.command import UsageError

if TYPE_CHECKING:
    from zoo.blood.study import Study

DEFAULT_ESS = 400.0
NUMERICAL_NAMES = {
    "accuracy_percent": "--accuracy",
    "dx_cm": "--dx",
    "steps_per_beat": "--steps",
    "tolerance_mmHg": "--tolerance",
}
FIRST_CHECK = 500

StudyArgument = Annotated[
    str, typer.Argument(metavar="STUDY", help="A built-in study (see `zoo studies`) or a folder.")
]
StrictOption = Annotated[
    bool, typer.Option("--strict", help="End with exit code 3 if chains have not converged.")
]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")]


DaskOption = Annotated[
    str | None,
    typer.Option(
        "--dask",
        help="Work on the workers of a dask.distributed scheduler, tcp://HOST:8786, instead.",
        metavar="ADDRESS",
        show_default=False,
    ),
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
            show_default=False,
        ),
    ] = None
    models_from: Annotated[
        list[Path] | None,
        typer.Option(
            "--models-from",
            help="Python file with functions model_NAME(study, **settings); it is run. May be repeated.",
            metavar="FILE",
            show_default=False,
        ),
    ] = None

    def load(self) -> None:
        """Run the files, so that what they define can be named."""
        from zoo.blood.plugins import add_effects, load_models

        for path in self.effects_from or []:
            add_effects(path)
        for path in self.models_from or []:
            load_models(path)

    def words(self) -> list[str]:
        """The options as they were typed."""
        given = [("--effects-from", self.effects_from), ("--models-from", self.models_from)]
        return [word for option, paths in given for path in paths or [] for word in (option, str(path))]


@dataclass(frozen=True)
class ConventionOptions:
    """Conventions by name, and single switches of theirs by the names that `Conventions` gives them."""

    conventions: Annotated[
        str | None,
        typer.Option(
            "--conventions", help="printed or published-code, instead of the study's own.", metavar="NAME"
        ),
    ] = None
    wall_factor: Annotated[
        float | None,
        typer.Option("--wall-factor", help="Factor k of the tangent wall: p = k chi tan(...)."),
    ] = None
    stiffness_radius_unit_cm: Annotated[
        float | None,
        typer.Option("--stiffness-radius-unit", help="Unit of r0 in eq. 3.5, cm.", metavar="CM"),
    ] = None
    friction: Annotated[
        str | None,
        typer.Option("--friction", help="Radius of the friction term: current, rest or fixed."),
    ] = None
    friction_radius_cm: Annotated[
        float | None,
        typer.Option("--friction-radius", help="That of `--friction fixed`, cm.", metavar="CM"),
    ] = None
    truncate_lengths: Annotated[
        bool | None,
        typer.Option(
            "--truncate-lengths/--true-lengths", help="Vessels of whole cells of 0.025 cm, or true."
        ),
    ] = None
    mmhg: Annotated[float | None, typer.Option("--mmhg", help="dyn/cm2 in 1 mmHg.")] = None
    sample_lag_beats: Annotated[
        float | None,
        typer.Option(
            "--sample-lag", help="Compare this part of a beat after each sample's time.", metavar="BEATS"
        ),
    ] = None

    def switches(self) -> dict[str, Any]:
        """The single switches that were given."""
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in given.items() if name != "conventions" and value is not None}

    def load(self, name: str) -> Study:
        """A study with these conventions: a name, single switches, both, or its own."""
        from zoo.blood.conventions import get_conventions
        from zoo.blood.study import load_study

        switches = self.switches()
        if self.conventions is None and not switches:
            return load_study(name)
        named = (
            load_study(name).conventions if self.conventions is None else get_conventions(self.conventions)
        )
        return load_study(name, named.replace(**switches))

    def words(self) -> list[str]:
        """The options that were given, as they are typed."""
        words = [] if self.conventions is None else ["--conventions", self.conventions]
        for name, value in self.switches().items():
            option = name.removesuffix("_cm").removesuffix("_beats").replace("_", "-")
            if name == "truncate_lengths":
                words.append("--truncate-lengths" if value else "--true-lengths")
            else:
                words += [f"--{option}", str(value)]
        return words


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
            show_default=False,
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

        found: dict[str, Any] = {}
        for text in self.prior or []:
            try:
                name, value = read_option(text)
                read_priors({name: value})
            except PriorsError as error:
                raise UsageError(f"--prior {error}") from None
            if name in found:
                raise UsageError(f"--prior {text}: {name} was given before; give it once")
            found[name] = value
        return found

    def into(self, study: Study) -> Study:
        """The study with these priors."""
        from zoo.blood.priors import with_priors

        return with_priors(study, self.table())

    def words(self) -> list[str]:
        """The options as they were typed."""
        return [word for text in self.prior or [] for word in ("--prior", text)]


@dataclass(frozen=True)
class NumericalOptions:
    """Options of the solver: fields of a study's table [numerics], in whose place they stand."""

    accuracy_percent: Annotated[
        float | None,
        typer.Option(
            "--accuracy",
            help="Choose cells and steps for this error, % of the pulse (default 0.03).",
            metavar="PERCENT",
        ),
    ] = None
    dx_cm: Annotated[
        float | None, typer.Option("--dx", help="Cell length, cm, instead of choosing it.", metavar="CM")
    ] = None
    steps_per_beat: Annotated[
        int | None, typer.Option("--steps", help="Time steps in a beat; chosen by default.")
    ] = None
    tolerance_mmHg: Annotated[
        float | None,
        typer.Option("--tolerance", help="Accepted distance from the periodic state, mmHg.", metavar="MMHG"),
    ] = None

    def given(self) -> dict[str, Any]:
        """The options that were given, by their fields."""
        all_of_them = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in all_of_them.items() if value is not None}

    def on(self, study: Study) -> Study:
        """The study with these in its table [numerics].

        Raises
        ------
        UsageError
            If a value is out of range, or cells are asked for in two ways.
        """
        from dataclasses import replace

        from zoo.blood.study import StudyError
        from zoo.blood.study.tables import checked_numerics

        given = self.given()
        if not given:
            return study
        try:
            checked_numerics("", given)
        except StudyError as error:
            text = str(error).removeprefix(": ")
            for name, option in NUMERICAL_NAMES.items():
                text = text.replace(name, option)
            raise UsageError(text) from None
        cells = ("dx_cm", "accuracy_percent")
        kept = {
            name: value
            for name, value in study.numerics.items()
            if not (name in cells and any(other in given for other in cells))
        }
        return replace(study, numerics=kept | given)

    def words(self) -> list[str]:
        """The options that were given, as they are typed."""
        return [word for name, value in self.given().items() for word in (NUMERICAL_NAMES[name], str(value))]


@dataclass(frozen=True)
class SamplingOptions:
    """How a posterior is sampled."""

    draws: Annotated[
        int | None,
        typer.Option(
            "--draws",
            help="Stored draws of each chain; without it, until converged.",
            show_default=False,
        ),
    ] = None
    tune: Annotated[
        int | None,
        typer.Option(
            "--tune", help="Steps to adapt, thrown away; 100 a dimension, at least 600.", show_default=False
        ),
    ] = None
    chains: Annotated[int, typer.Option("--chains", help="Chains; at least 4 for a verdict.")] = 4
    cores: Annotated[
        int | None,
        typer.Option("--cores", help="Processes at a time; all cores by default.", show_default=False),
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
        typer.Option(
            "--thin",
            help="Steps for each stored draw; a quarter of the dimension by default.",
            show_default=False,
        ),
    ] = None
    seed: Annotated[
        int | None, typer.Option("--seed", help="Seed; recorded if not given.", show_default=False)
    ] = None
    until: Annotated[
        str | None,
        typer.Option(
            "--until",
            help="ess=400 (default without --draws): until every parameter has it and R-hat <= 1.01; "
            "or none.",
            show_default=False,
        ),
    ] = None
    max_draws: Annotated[
        int | None,
        typer.Option("--max-draws", help="Limit of --until; 40 times the first check.", show_default=False),
    ] = None
    resume: Annotated[
        bool,
        typer.Option(
            "--resume/--fresh", help="Go on from the checkpoint beside the output, or throw it away."
        ),
    ] = True
    quiet: QuietOption = False

    def settings(self) -> dict[str, Any]:
        """Arguments of `zoo.sample`.

        Raises
        ------
        UsageError
            If `--until` cannot be read, or a number is too small.
        """
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
            return DEFAULT_ESS if self.draws is None else None
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
