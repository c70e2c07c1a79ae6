"""`zoo sample`: the posterior of a model on a study."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from zoo.cli.checks import model_name, names
from zoo.cli.command import FRESH, GATE, Role, UsageError, argument, command, option
from zoo.cli.options import (
    DASK,
    JSON,
    SHARE,
    STRICT,
    PluginOptions,
    SamplingOptions,
    StudyOptions,
)
from zoo.cli.screen import plain_table, say, say_json
from zoo.core.outputs import output_file, refuse_read

if TYPE_CHECKING:
    from zoo.blood.study import Study
    from zoo.core.arviz_lines import InferenceData
    from zoo.core.inference.convergence import Verdict


@command
def sample(
    model: str = argument("MODEL", "A to I, or one of --models-from.", Role.MODELS),
    studies: list[str] = argument(
        "STUDY...",
        "A built-in study (see `zoo studies`) or a folder; several are subjects of one posterior.",
        Role.STUDY,
    ),
    output: Path | None = option(
        None, "NetCDF file; MODEL-STUDY.nc by default.", "--output", "-o", Role.WRITES
    ),
    effects: str | None = option(
        None,
        "Put these into the model, with commas: viscoelastic-wall,local-stiffness@2 (vessel 2; 2+ "
        "with all below). The model's name becomes MODEL+EFFECT.",
        Role.EFFECTS,
        metavar="NAMES",
    ),
    share: str | None = SHARE,
    population: str | None = option(
        None,
        "Parameters of several studies that come from one population, whose median and spread are "
        "sampled too, with commas.",
        metavar="NAMES",
    ),
    errors: str | None = option(
        None,
        "student-t: errors with heavy tails, of which a few samples that are far off change little; "
        "the model's own without.",
        metavar="LAW",
    ),
    strict: bool = STRICT,
    fresh: bool = FRESH,
    dask: str | None = DASK,
    as_json: bool = JSON,
    *,
    sampling: SamplingOptions,
    options: StudyOptions,
    plugins: PluginOptions,
) -> None:
    """Sample a model's posterior on a study, until converged; an interrupted run goes on where it was."""
    from zoo.core.inference.cluster import connect

    plugins.load()
    name = model_name("+".join([model, *names(effects)]))
    settings = sampling.settings()
    loaded = _by_name([(study, options.load(study)) for study in studies])
    path = output_file(Path("-".join([name, *loaded]) + ".nc") if output is None else output, "--output")
    common = {"share": names(share), "population": names(population)}
    for flag, given in common.items() if len(loaded) == 1 else ():
        if given:
            raise UsageError(f"--{flag} {','.join(given)}: is of several studies; give two or more")
    if path.is_file() and not fresh:
        _keeps_what_is_there(path, settings)
    with connect(dask) as executor:
        settings["executor"] = executor
        idata = sample_with_checkpoint(
            lambda: _build(name, loaded, common, errors),
            path,
            settings,
            fresh=fresh,
            progress=not sampling.quiet,
        )
    found = verdict_of(idata, settings["until_ess"])
    if as_json:
        say_json(_record(idata, found, path))
    else:
        say(*_posterior_summary(idata, found), f"wrote {path}")
    if strict and not found.passes:
        raise typer.Exit(GATE)


def _by_name(studies: Sequence[tuple[str, Study]]) -> dict[str, Study]:
    """Studies by their names, or those of their folders where two have one name."""
    names = [study.name for _, study in studies]
    if len(set(names)) < len(names):
        names = [Path(given).resolve().name for given, _ in studies]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(
                f"STUDY {name}: is given twice; give each subject once, in folders of other names"
            )
    return dict(zip(names, (study for _, study in studies), strict=True))


def _build(
    name: str, studies: Mapping[str, Study], common: Mapping[str, Sequence[str]], errors: str | None
) -> Any:
    """The model of a study, or the joint one of several."""
    from zoo.core.joint import joint_model

    built = {subject: build_model(name, study, errors) for subject, study in studies.items()}
    if len(built) == 1:
        return next(iter(built.values()))
    return joint_model(built, **common)


def verdict_of(idata: InferenceData, goal: float | None) -> Verdict:
    """Have the chains converged, with the effective sample size that was asked for."""
    from zoo.core.inference.convergence import ess_to_count, verdict

    return verdict(idata, ess=ess_to_count(goal))


def build_model(name: str, study: Study, errors: str | None = None) -> Any:
    """A model on a study, by its name, with its own errors or others."""
    from zoo.blood.plugins import get_model
    from zoo.blood.prior_tables import names_of
    from zoo.blood.study_priors import without_use
    from zoo.core.model import ModelError, record_of

    model = get_model(name)(study, **({} if errors is None else {"errors": errors}))
    try:
        there = record_of(model).parameters
    except ModelError as error:
        raise UsageError(f"model {name}: {error}") from None
    for parameter in without_use(study, there):
        say(f"model {name} has no {parameter}: the prior of {parameter} is not used")
    held = record_of(model).settings.get("held", {})
    for parameter in study.parameters:
        if not {*names_of(parameter)} & held.keys():
            say(f"model {name} has no {parameter}: the value that it is held at is not used")
    return model


def sample_with_checkpoint(
    build: Callable[[], Any], path: Path, settings: Mapping[str, Any], *, fresh: bool, progress: bool
) -> InferenceData:
    """Run a model with the checkpoint beside its output, and write the output."""
    from zoo.core.inference.checkpoint import CheckpointError, CheckpointInUseError, foreign_in
    from zoo.core.posterior.files import checkpoint_of, sample_to

    checkpoint = checkpoint_of(path)
    if checkpoint == path or checkpoint.is_symlink():
        wrong = "is the place of its own checkpoint" if checkpoint == path else f"{checkpoint} is a link"
        raise UsageError(f"--output {path}: {wrong}; give a file such as {path.with_suffix('.other.nc')}")
    refuse_read(checkpoint, "--output")
    try:
        return sample_to(path, build(), groups=True, progress=progress, fresh=fresh, **settings)
    except CheckpointInUseError as error:
        raise UsageError(str(error)) from None
    except CheckpointError as error:
        removes = not fresh and checkpoint.is_dir() and foreign_in(checkpoint) is None
        raise UsageError(f"{error}{' (--fresh removes it)' if removes else ''}") from None


def _keeps_what_is_there(path: Path, settings: Mapping[str, Any]) -> None:
    """Refuse to put fewer draws in the place of those that a file holds."""
    from zoo.core.inference.record import RunRecord
    from zoo.core.posterior.files import checkpoint_of
    from zoo.core.posterior.storage import load

    idata = load(path)
    held, goal = idata["posterior"].sizes["draw"], settings["until_ess"]
    before = RunRecord.of(idata).settings
    if goal is None:
        again = (settings["draws"], None) == (before.get("first check"), before.get("until_ess"))
        less = held > settings["draws"] and not again
    else:
        begun = (checkpoint_of(path) / "run.json").is_file()
        more = held <= settings["draws"] or goal > (before.get("until_ess") or math.inf)
        less = goal != before.get("until_ess") and not (begun and more)
    if less:
        raise UsageError(
            f"--output {path}: holds {held} draws of each chain, which this run would replace by others; add "
            "--fresh to do that, or choose another path"
        )


def _rows(idata: InferenceData, found: Verdict) -> list[dict[str, Any]]:
    """What is told of each scalar that varies."""
    import numpy as np

    from zoo.core.arviz_lines import dataset
    from zoo.core.inference.elements import arrays, scalars

    posterior, judged = dataset(idata), {p.name: p for p in found.parameters}
    rows = []
    for label, values in scalars(arrays(idata)):
        if label in judged:
            p, unit = judged[label], posterior[label.partition("[")[0]].attrs.get("units", "")
            median, low, high = map(float, np.quantile(values, (0.5, 0.025, 0.975)))
            row = {"parameter": label, "unit": unit, "median": median, "low_95": low, "high_95": high}
            told = {name: getattr(p, name) for name in ("rhat", "ess_bulk", "ess_tail", "passes")}
            rows.append(row | told)
    return rows


def _record(idata: InferenceData, found: Verdict, path: Path) -> dict[str, Any]:
    """The summary for machines."""
    from zoo.core.inference.record import RunRecord

    record = RunRecord.of(idata)
    return {
        "model": record.model,
        "study": record.study,
        "output": str(path),
        "parameters": _rows(idata, found),
        "converged": found.passes,
        "verdict": found.text,
        "bounds": list(found.bounds),
        "uninformed": list(found.uninformed),
        "chains": found.chains,
        "draws_of_each_chain": found.draws,
        "seed": record.seed,
        "solves": record.solves,
        "failed_solves": dict(record.failures),
        "wall_s": record.wall_seconds,
    }


def _posterior_summary(idata: InferenceData, found: Verdict) -> list[Any]:
    from rich.text import Text

    from zoo.core.inference.record import RunRecord

    numbers = ("median", "2.5 %", "97.5 %", "R-hat", "ESS bulk", "ESS tail")
    table = plain_table("parameter", *numbers, numbers=numbers)
    for row in _rows(idata, found):
        label, aside = row["parameter"], row["parameter"] in found.uninformed
        cells = [f"{row[name]:.4g}" for name in ("median", "low_95", "high_95")]
        cells += [f"{row['rhat']:.3f}", f"{row['ess_bulk']:.0f}", f"{row['ess_tail']:.0f}"]
        table.add_row(label, *cells, style=None if row["passes"] or aside else "yellow")
    record = RunRecord.of(idata)
    failed = ", ".join(f"{n} {status}" for status, n in record.failures.items()) or "none"
    return [
        table,
        Text(found.text, style="green" if found.passes and not found.bounds else "yellow"),
        f"{found.chains} chains of {found.draws} draws, seed {record.seed}; {record.solves} solves "
        f"({record.solves_per_step:.2f} a step), failed: {failed}; {record.wall_seconds:.0f} s",
        *([record.solver["grid"]] if "grid" in record.solver else []),
    ]
