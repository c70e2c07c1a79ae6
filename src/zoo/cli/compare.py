"""`zoo compare`: models by how well they predict."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from zoo.cli.checks import at_least, different_models
from zoo.cli.command import FRESH, GATE, Role, UsageError, Without, argument, command, option
from zoo.cli.options import STRICT, PluginOptions, SamplingOptions, StudyOptions
from zoo.cli.sample import build_model, sample_with_checkpoint
from zoo.cli.screen import complain, plain_table, say
from zoo.core.outputs import output_file, output_folder, write_file

if TYPE_CHECKING:
    from zoo.blood.study import Study
    from zoo.report.gates import ComparisonFile, Gate


@command
def compare(
    studies: list[str] = argument(
        "STUDY...", "Built-in studies (see `zoo studies`) or folders; a table each.", Role.STUDY
    ),
    models: str = option(
        "A,B", "With commas, such as A,B or B,B+viscoelastic-wall.", Role.MODELS, Role.ASIDE
    ),
    posteriors: list[Path] | None = option(
        None,
        "A file, or a folder of files, from `zoo sample`; may be repeated. A.nc or A-STUDY.nc and "
        "so on in the working directory are found without.",
        Role.SEARCHED,
        Role.ASIDE,
    ),
    output: Path = option(Path("comparison"), "Folder for table and figures.", "--output", "-o", Role.WRITES),
    criterion: Literal["waic", "loo"] = option(
        "waic", "Criterion to rank by: waic or loo.", "--ic", Role.ASIDE
    ),
    n_draws: int = option(1000, "Draws of each posterior that are scored.", Role.ASIDE),
    figures: bool = option(True, "Draw figures.", "--figures/--no-figures", Role.ASIDE),
    json: Path | None = option(None, "File for all numbers, to be a --baseline.", Role.WRITES),
    markdown: Path | None = option(None, "File for a summary of one screen.", Role.WRITES),
    junit: Path | None = option(None, "File for the gates as CI systems read tests.", Role.WRITES),
    baseline: Path | None = option(None, "An earlier file of --json to compare with.", Role.ASIDE),
    fail_if: list[str] | None = option(
        None,
        "End with exit code 3 if this is so of a model, such as converged=no, 'ess_min < 400' or "
        "'waic > baseline + 2 se'; may be given several times.",
        Role.ASIDE,
        metavar="GATE",
    ),
    strict: bool = STRICT,
    fresh: bool = FRESH,
    *,
    sampling: Annotated[SamplingOptions, Without("thin"), Role.ASIDE],
    options: StudyOptions,
    plugins: PluginOptions,
) -> None:
    """Rank models by how well they predict a study; posteriors that are missing are sampled first.

    The options of sampling are for those; posteriors that are there are taken as they are. One model alone is
    told too. Exit codes: 0, 2 for wrong input, 3 for a gate (--fail-if, --strict).
    """
    if posteriors and fresh:
        raise UsageError("--fresh: samples every model anew; leave out --posteriors, or --fresh")
    from zoo.core.posterior.files import find
    from zoo.report.gates import Gate, read_comparison

    gates = [Gate.read(text) for text in [*(fail_if or ()), *(["converged=no"] if strict else [])]]
    before = None if baseline is None else read_comparison(baseline)
    for gate in gates:
        if gate.of_baseline and before is None:
            raise UsageError(f"--fail-if {gate.text!r}: there is no baseline; give --baseline")
        gate.check(criterion)
    if before is not None:
        before.check(criterion)
    plugins.load()
    names = different_models(models)
    settings = sampling.settings()
    at_least("--n-draws", n_draws, 10)
    loaded = [options.load(study) for study in studies]
    if len({study.name for study in loaded}) < len(loaded):
        raise UsageError(f"{', '.join(studies)}: two studies of one name; give each once")
    if before is not None and not {study.name for study in loaded}.intersection(before.studies):
        raise UsageError(
            f"--baseline {baseline}: is of {', '.join(before.studies)}, not of {', '.join(studies)}"
        )
    folders = [output if len(loaded) == 1 else output / study.name for study in loaded]
    output_folder(output, option="--output")
    reports = {"json": json, "markdown": markdown, "junit": junit}
    for kind, path in reports.items():
        if path is not None:
            output_file(path, f"--{kind}")
    for folder in folders:
        sampled = [f"{name}.nc" for name in names if fresh or not (folder / f"{name}.nc").is_file()]
        output_folder(folder, [*_file_names(names, loaded), *sampled], "--output", deep=True)
    given = [find(posteriors or [], names, study, say=say) for study in loaded]
    tables = {}
    for study, folder, files in zip(loaded, folders, given, strict=True):
        built, found = _posteriors_of(
            study, names, files, posteriors or (), folder, settings, fresh, not sampling.quiet
        )
        tables[study.name] = _compare_on(study, built, found, folder, criterion, n_draws, figures)
    _tell_machines(tables, criterion, gates, before, reports)


def _tell_machines(
    tables: Mapping[str, Any],
    criterion: Literal["waic", "loo"],
    gates: Sequence[Gate],
    baseline: ComparisonFile | None,
    files: Mapping[str, Path | None],
) -> None:
    """Write what was asked for, and end with 3 if a gate fails."""
    from zoo.report.gates import comparison_file, judge
    from zoo.report.gates import junit as to_junit
    from zoo.report.gates import markdown as to_markdown

    found = comparison_file(tables, criterion)
    judged = judge(found, gates, baseline)
    makers = {
        "json": found.to_text,
        "markdown": lambda: to_markdown(found, judged, baseline),
        "junit": lambda: to_junit(judged),
    }
    for kind, path in files.items():
        if path is not None:
            say(f"wrote {write_file(path, makers[kind]())}")
    for one in judged:
        if one.failed:
            complain(f"{one.study}, model {one.model}: {one.gate.text} ({one.why})")
        elif one.failed is None:
            say(f"not judged: {one.study}, model {one.model}: {one.gate.text} ({one.why})")
    if any(one.failed for one in judged):
        raise typer.Exit(GATE)


SOLVES = "solves"
"""Folder in the output for the solves of a comparison, so that an unchanged model takes none again."""
KINDS = ("fit", "trace", "rank", "pair")
"""Figures of each model, beside one of each quantity."""


def _file_names(models: Sequence[str], studies: Sequence[Study]) -> list[str]:
    """Files that are written for each study."""
    shown = {series.quantity for study in studies for series in study.series} | {"pressure_mmHg", "flow_ml_s"}
    kinds = sorted(quantity.split("_")[0] for quantity in shown)
    of_models = [f"{kind}-{model}" for kind in (*KINDS, *kinds) for model in models]
    return ["comparison.csv", *(f"{name}.png" for name in ("comparison", "loops", *kinds, *of_models))]


def _posteriors_of(
    study: Study,
    names: Sequence[str],
    given: Mapping[str, Path],
    posteriors: Sequence[Path],
    output: Path,
    settings: Mapping[str, Any],
    fresh: bool,
    progress: bool,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Models on a study and their posteriors: given, of an earlier call, in the working directory, or new."""
    from zoo.core.inference.record import ResultsError
    from zoo.core.posterior.belonging import mismatch
    from zoo.core.posterior.files import load_posterior
    from zoo.core.posterior.storage import load

    files = {name: output / f"{name}.nc" for name in names if (output / f"{name}.nc").is_file()}
    named = {*files.values(), *(path for path in given.values() if path in posteriors)}
    files |= given
    built: dict[str, Any] = {}
    found: dict[str, Any] = {}
    for name in names:
        built[name] = build_model(name, study)
        here = [Path(f"{name}.nc"), Path(f"{name}-{study.name}.nc")]  # as `zoo sample` calls it
        for there in [files.pop(name)] if name in files else [path for path in here if path.is_file()]:
            wrong = None
            if there not in named:  # of a folder: those that do not belong are passed over
                try:
                    found[name] = load(there)
                    wrong = mismatch(found[name], built[name])
                except ResultsError as error:
                    wrong = str(error).removeprefix(f"{there}: ")
            if not wrong:
                files[name] = there
                break
            found.pop(name, None)
            say(f"passed over: {there}: {wrong}")
        if fresh:
            found.pop(name, None)
        elif name in files:
            found[name] = found.get(name) or load_posterior(files[name], built[name])
            say(f"model {name}: posterior of {files[name]}")
    output.mkdir(parents=True, exist_ok=True)
    for name in [name for name in names if name not in found]:
        path = output / f"{name}.nc"
        build = partial(built.__getitem__, name)
        found[name] = sample_with_checkpoint(build, path, settings, fresh=fresh, progress=progress)
        say(f"model {name}: sampled, wrote {path}")
    return built, {name: found[name] for name in names}


def _compare_on(
    study: Study,
    models: Mapping[str, Any],
    found: Mapping[str, Any],
    output: Path,
    criterion: Literal["waic", "loo"],
    n_draws: int,
    figures: bool,
) -> Any:
    """Write the table and figures; returns the table."""
    from zoo.core.posterior.comparison import compare as rank

    with kept_solves(models, output / SOLVES):
        table = rank(found, models, ic=criterion, n_draws=n_draws)
        drawn = _predictions(models, found) if figures else {}
    write_file(output / "comparison.csv", table.to_csv())
    say(*_comparison_summary(table, criterion, study), f"wrote {output / 'comparison.csv'}")
    if figures:
        _figures(table, models, found, drawn, study, output)
    return table


@contextmanager
def kept_solves(models: Mapping[str, Any], folder: Path) -> Iterator[None]:
    """Models whose solves at the observed series are taken from a folder, and kept there."""
    from zoo.core.diagnosis.solve_store import SolveStore, StoredModel

    store, records = SolveStore(folder), {name: model.zoo for name, model in models.items()}
    try:
        for name, record in records.items():
            models[name].zoo = replace(record, forward=StoredModel(record.forward, store))
        yield
    finally:
        store.close()
        for name, record in records.items():
            models[name].zoo = record


def _predictions(models: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    from zoo.blood import predictive

    return {name: predictive.predictive_draws(models[name], idata) for name, idata in found.items()}


def _comparison_summary(table: Any, criterion: str, study: Study) -> list[Any]:
    from rich.text import Text

    def each(text: str, when: Callable[[Any], bool], style: str = "", before: str = "") -> list[Any]:
        """A line for each model of which something is so."""
        told = [(model, row) for model, row in table.iterrows() if when(row)]
        return [Text(f"{before}model {model}: {text.format(**row)}", style=style) for model, row in told]

    name = {"waic": "WAIC", "loo": "PSIS-LOO"}[criterion]
    columns = {
        "WAIC": ("waic", ".1f"),
        "SE": ("waic_se", ".1f"),
        "as one": ("waic_one_observation", ".1f"),
        "PSIS-LOO": ("loo", ".1f"),
        "diff.": ("difference", ".1f"),
        "its SE": ("difference_se", ".1f"),
        "weight": ("weight", ".2f"),
    } | {f"SSE ({unit})": (sse, ".3g") for sse, unit in table.attrs["sums_of_squares"].items()}
    title = f"{study.name}: models by {name}, lower is better"
    numbers = (*columns, "converged")
    shown = plain_table("model", *numbers, numbers=numbers, title=title)
    for model, row in table.iterrows():
        cells = [f"{row[field]:{form}}" for field, form in columns.values()]
        shown.add_row(str(model), *cells, "yes" if row["converged"] else "no")
    return [
        shown,
        *each("{at_bounds}", lambda row: row["at_bounds"] and row["converged"], "yellow", "warning: "),
        "as one: WAIC with the whole series as one observation, which has no standard error; WAIC is of terms"
        " given the past, PSIS-LOO of terms given all other samples: each ranks models, do not mix the two",
        *each("{standing}", lambda row: row["rank"] > 0),
        *each(
            "{pareto_k_bad} points with too large a Pareto k for so many draws: do not trust PSIS-LOO there",
            lambda row: row["pareto_k_bad"] > 0,
        ),
        *each(
            "WAIC has terms whose log-likelihood has a variance above 0.4, it may be too low",
            lambda row: row["waic_warning"],
        ),
        *each("not informed by the data, posterior like prior: {uninformed}", lambda row: row["uninformed"]),
        *each("moved by the power of the priors: {prior_sensitive}", lambda row: row["prior_sensitive"]),
        *each("{convergence}", lambda row: not row["converged"], "yellow"),
    ]


def _figures(
    table: Any,
    models: Mapping[str, Any],
    found: Mapping[str, Any],
    drawn: Mapping[str, Any],
    study: Study,
    output: Path,
) -> None:
    from zoo import plots
    from zoo.blood import predictive

    def save(figure: Any, name: str) -> None:
        plots.save_figure(figure, output / f"{name}.png")

    save(plots.comparison_figure(table), "comparison")
    medians, loops = {}, {}
    quantities = dict.fromkeys(["pressure_mmHg", "flow_ml_s", *(s.quantity for s in study.series)])
    for name, idata in found.items():
        names = list(models[name].zoo.parameters)
        means, predictions = drawn[name]
        save(
            plots.fit_figure(study, means, predictions, title=f"model {name} on {study.name}"), f"fit-{name}"
        )
        save(plots.trace_figure(idata, names), f"trace-{name}")
        save(plots.rank_figure(idata, names), f"rank-{name}")
        single = [n for n in names if idata["posterior"][n].ndim == 2]
        save(plots.pair_figure(idata, single), f"pair-{name}")
        waves = predictive.vessel_waves(models[name], idata, n_draws=100)
        for quantity in quantities:
            kind = quantity.split("_")[0]
            errors = any(series.quantity == quantity for series in study.series)
            shown = predictive.bands(predictive.one_place(waves), quantity, (0.95,), errors=errors)
            save(plots.all_vessels_figure(shown, study, title=f"model {name}, {kind}"), f"{kind}-{name}")
        medians[name] = predictive.median_waves(waves)
        loops[name] = predictive.waves_at_medians(models[name], idata)
    vessels = [int(v) for v in next(iter(loops.values()))["vessel"].to_numpy()]
    for quantity in quantities:
        save(plots.models_figure(medians, study, quantity=quantity), quantity.split("_")[0])
    save(plots.loops_figure(loops, vessels=vessels), "loops")
    say(f"wrote figures to {output}")
