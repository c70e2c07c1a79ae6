"""Options that several commands share, in groups: of a study, of sampling.

A group is a dataclass; a command that has a parameter of its type has all its options (`zoo.cli.command`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zoo.cli.command import Role, UsageError, argument, option

if TYPE_CHECKING:
    from zoo.blood.study import Study

STUDY = argument("STUDY", "A built-in study (see `zoo studies`) or a folder.", Role.STUDY)
SHARE = option(
    None,
    "Parameters that are one for all of several studies, with commas, such as f3,c; all others "
    "are each study's own.",
    metavar="NAMES",
)
STRICT = option(False, "End with exit code 3 if chains have not converged.", Role.ASIDE)
JSON = option(False, "Print JSON instead of a table.", "--json", Role.ASIDE)
QUIET = option(False, "No progress.", "--quiet", "-q", Role.ASIDE)
DASK = option(
    None,
    "Work on the workers of a dask.distributed scheduler, tcp://HOST:8786, instead.",
    Role.ASIDE,
    metavar="ADDRESS",
)


@dataclass(frozen=True)
class PluginOptions:
    """Files with effects and models of one's own."""

    effects_from: list[Path] | None = option(
        None, "Python file that defines effects; it is run. May be repeated.", metavar="FILE"
    )
    models_from: list[Path] | None = option(
        None,
        "Python file with functions model_NAME(study, **settings); it is run. May be repeated.",
        metavar="FILE",
    )

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

    prior: list[str] | None = option(
        None,
        "Instead of the study's own: stiffness=log_uniform(2e4,4e5), f3=..., wave_speed_m_s=1,4 or "
        "set=paun2020; laws uniform, log_uniform, normal, log_normal, inverse_gamma. May be repeated.",
        metavar="NAME=LAW(...)",
    )

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

    fix: list[str] | None = option(
        None,
        "Hold a parameter at a value, such as psi1=1.0 or stiffness=5e4, in the place of its prior. "
        "May be repeated.",
        metavar="NAME=NUMBER",
    )
    settings: list[str] | None = option(
        None,
        "A field of study.toml or network.toml, such as conventions=published-code, "
        "conventions.friction=rest, numerics.dx_cm=0.01, blood.velocity_profile_order=9, or "
        "vessel.resistance=3e4: one value, or one per vessel with commas. May be repeated.",
        "--set",
        metavar="KEY=VALUE",
    )
    accuracy: float | None = option(
        None, "Choose cells and steps for this error, % of the pulse (default 0.03).", metavar="PERCENT"
    )

    def load(self, name: str) -> Study:
        """A study with these settings and priors.

        Raises
        ------
        UsageError
            If an option cannot be read.
        """
        from zoo.blood.prior_tables import PriorsError, read_held
        from zoo.blood.study import load_study
        from zoo.blood.study_priors import with_priors

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

    draws: int | None = option(None, "Stored draws of each chain; without it, until converged.", Role.ASIDE)
    tune: int | None = option(None, "Steps to adapt, thrown away; 100 a dimension, at least 600.")
    chains: int = option(4, "Chains; at least 4 for a verdict.")
    cores: int | None = option(None, "Processes at a time; all cores by default.", Role.ASIDE)
    method: str = option(
        "auto",
        "exact: chains with the solver itself; surrogate: NUTS on a surrogate of it, each stored "
        "draw corrected with it; nuts: NUTS with the solver's derivatives; auto chooses by model.",
    )
    thin: int | None = option(None, "Steps for each stored draw; a quarter of the dimension by default.")
    seed: int | None = option(None, "Seed; recorded if not given.")
    until: str | None = option(
        None,
        "ess=400 (default without --draws): until every parameter has it and R-hat <= 1.01; or none.",
        Role.ASIDE,
    )
    max_draws: int | None = option(None, "Limit of --until; 40 times the first check.", Role.ASIDE)
    quiet: bool = QUIET

    def settings(self) -> dict[str, Any]:
        """Arguments of `zoo.sample`.

        Raises
        ------
        UsageError
            If `--until` cannot be read, or a number is too small.
        """
        from zoo.core.inference.convergence import FIRST_CHECK

        for flag, value in (("--draws", self.draws), ("--cores", self.cores)):
            if value is not None and value < 1:
                raise UsageError(f"{flag} {value}: must be at least 1")
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
