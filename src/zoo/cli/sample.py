"""`zoo sample`: the posterior of a model on a study."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zoo.cli.checks import model_name
from zoo.cli.command import NOT_CONVERGED, UsageError, command
from zoo.cli.options import (
    ConventionOptions,
    DaskOption,
    NumericalOptions,
    PluginOptions,
    PriorOptions,
    SamplingOptions,
    StrictOption,
    StudyArgument,
)
from zoo.cli.screen import plain_table, say
from zoo.core.outputs import output_file

if TYPE_CHECKING:
    import arviz as az

    from zoo.blood.study import Study
    from zoo.core.inference.convergence import Verdict


@command
def sample(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="A to I, or one of --models-from.")],
    study: StudyArgument,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="NetCDF file; MODEL-STUDY.nc by default.", show_default=False),
    ] = None,
    effects: Annotated[
        str | None,
        typer.Option(
            "--effects",
            help="Put these into the model, with commas: viscoelastic-wall,local-stiffness@2 (vessel 2; 2+ "
            "with all below). The model's name becomes MODEL+EFFECT.",
            metavar="NAMES",
            show_default=False,
        ),
    ] = None,
    strict: StrictOption = False,
    dask: DaskOption = None,
    *,
    sampling: SamplingOptions,
    priors: PriorOptions,
    conventions: ConventionOptions,
    numerical: NumericalOptions,
    plugins: PluginOptions,
) -> None:
    """Sample a model's posterior on a study, until converged; an interrupted run goes on where it was."""
    from zoo.blood.study import study_files
    from zoo.core.inference.cluster import connect

    plugins.load()
    added = [part.strip() for part in (effects or "").split(",") if part.strip()]
    name = model_name("+".join([model, *added]))
    settings = sampling.settings()
    loaded = numerical.on(priors.into(conventions.load(study)))
    path = output_file(
        Path(f"{name}-{loaded.name}.nc") if output is None else output, "--output", study_files(study)
    )
    with connect(dask) as executor:
        settings["executor"] = executor
        idata = sample_with_checkpoint(
            name, loaded, path, settings, resume=sampling.resume, progress=not sampling.quiet
        )
    found = verdict_of(idata, settings["until_ess"])
    say(*_posterior_summary(idata, found), f"wrote {path}")
    if strict and not found.passes:
        raise typer.Exit(NOT_CONVERGED)


def verdict_of(idata: az.InferenceData, goal: float | None) -> Verdict:
    """Have the chains converged, with the effective sample size that was asked for."""
    from zoo.core.inference.convergence import ess_to_count, verdict

    return verdict(idata, ess=ess_to_count(goal))


def build_model(name: str, study: Study) -> Any:
    """A model on a study, by its name."""
    from zoo.blood.plugins import get_model
    from zoo.blood.priors import without_use
    from zoo.core.model import ModelError, record_of

    model = get_model(name)(study)
    try:
        there = record_of(model).parameters
    except ModelError as error:
        raise UsageError(f"model {name}: {error}") from None
    for parameter in without_use(study, there):
        say(f"model {name} has no {parameter}: the prior of {parameter} is not used")
    return model


def sample_with_checkpoint(
    name: str, study: Study, path: Path, settings: Mapping[str, Any], *, resume: bool, progress: bool
) -> az.InferenceData:
    """Run a model with the checkpoint beside its output, and write the output."""
    from zoo.core.inference.checkpoint import CheckpointError, CheckpointInUseError
    from zoo.core.posterior.files import checkpoint_of, sample_to

    try:
        if not resume:
            _remove_checkpoint(checkpoint_of(path))
        return sample_to(path, build_model(name, study), groups=True, progress=progress, **settings)
    except CheckpointInUseError as error:
        raise UsageError(str(error)) from None
    except CheckpointError as error:
        raise UsageError(f"{error} (--fresh removes it)") from None


def _remove_checkpoint(folder: Path) -> None:
    """Delete the files of a checkpoint that no run is using, and nothing else."""
    from zoo.core.inference.checkpoint import Folder

    if folder.is_dir() or folder.is_symlink():
        Folder(folder).remove()  # refused while another run holds it


def _posterior_summary(idata: az.InferenceData, found: Verdict) -> list[Any]:
    import numpy as np
    from rich.text import Text

    from zoo.core.inference.elements import arrays, scalars
    from zoo.core.inference.record import RunRecord

    table = plain_table()
    table.add_column("parameter")
    for column in ("median", "2.5 %", "97.5 %", "R-hat", "ESS bulk", "ESS tail"):
        table.add_column(column, justify="right")
    judged = {p.name: p for p in found.parameters}
    aside = set(found.uninformed)
    for label, values in scalars(arrays(idata)):
        if label in judged:
            p = judged[label]
            cells = [f"{q:.4g}" for q in np.quantile(values, (0.5, 0.025, 0.975))]
            cells += [f"{p.rhat:.3f}", f"{p.ess_bulk:.0f}", f"{p.ess_tail:.0f}"]
            table.add_row(label, *cells, style=None if p.passes or label in aside else "yellow")
    record = RunRecord.of(idata)
    failed = ", ".join(f"{n} {status}" for status, n in record.failures.items()) or "none"
    return [
        table,
        Text(found.text, style="green" if found.passes and not found.bounds else "yellow"),
        f"{found.chains} chains of {found.draws} draws, seed {record.seed}; {record.solves} solves "
        f"({record.solves_per_step:.2f} a step), failed: {failed}; {record.wall_seconds:.0f} s",
        *([record.solver["grid"]] if "grid" in record.solver else []),
    ]
