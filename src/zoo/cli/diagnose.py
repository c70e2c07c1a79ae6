"""`zoo diagnose`: what a model misses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zoo.cli.checks import at_least
from zoo.cli.command import Role, UsageError, Without, command, typed_command
from zoo.cli.options import PluginOptions, QuietOption, StudyArgument, StudyOptions
from zoo.cli.screen import plain_table, say
from zoo.core.outputs import output_folder

if TYPE_CHECKING:
    from zoo.blood.conventions import Conventions
    from zoo.blood.study import Study
    from zoo.core.diagnosis import DiagnosisFile

EVERY_S = 1.5
"""Seconds between lines where there is no terminal."""
LEADING = 8
"""Explanations that the screen shows."""


@command
def diagnose(
    study: StudyArgument,
    base: Annotated[
        str,
        typer.Option(
            "--base",
            help="Baseline: linear-constant, linear-radius, tangent-constant, tangent-radius, or a model "
            "with that structure: A to I.",
        ),
    ] = "linear-constant",
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for what is found."), Role.WRITES
    ] = Path("gap"),
    posteriors: Annotated[
        bool,
        typer.Option("--posteriors", help="Sample the posteriors of the leading explanations too."),
        Role.ASIDE,
    ] = False,
    effects: Annotated[
        str | None,
        typer.Option(
            "--effects",
            help="Only these, with commas; all of `zoo effects` that fit the baseline if absent.",
            metavar="NAMES",
        ),
    ] = None,
    max_effects: Annotated[int, typer.Option("--max-effects", help="Most effects to add.")] = 3,
    exhaust: Annotated[
        bool,
        typer.Option(
            "--exhaust",
            help="Add the best listed effects even where a nonparametric discrepancy explains more.",
        ),
    ] = False,
    component_sizes: Annotated[
        float,
        typer.Option(
            "--component-sizes",
            help="Factor of the prior sizes of what components may lack: try 0.5 and 2; 0 leaves them out.",
            metavar="FACTOR",
        ),
    ] = 1.0,
    sets: Annotated[
        bool,
        typer.Option(
            "--sets",
            help="Weigh sets of causes by one posterior too: sets.csv and sensitivity.csv (docs/causes.md).",
        ),
    ] = False,
    states: Annotated[
        list[str] | None,
        typer.Option(
            "--state",
            help="Study of the same tree in another state, such as at another heart rate, in which what was "
            "learned is checked; may be given several times.",
            metavar="STUDY",
        ),
        Role.STUDY,
    ] = None,
    cores: Annotated[int, typer.Option("--cores", help="Threads and processes at a time."), Role.ASIDE] = 2,
    seed: Annotated[int, typer.Option("--seed", help="Of the draws.")] = 1,
    quiet: QuietOption = False,
    *,
    options: StudyOptions,
    plugins: Annotated[PluginOptions, Without("models_from")],
) -> None:
    """Find what a baseline misses in a study: where the discrepancy lies, its cause, how far it shrinks."""
    for option, count, least in (
        ("--max-effects", max_effects, 1),
        ("--cores", cores, 1),
        ("--seed", seed, 0),
    ):
        at_least(option, count, least)
    from zoo.core.inference.progress import Display

    with Display(not quiet, every_s=EVERY_S) as tell:
        tell.say(f"reading {study}")
        from zoo.blood.baseline import get_baseline

        plugins.load()
        chosen = get_baseline(base)
        names = _effect_names(effects, chosen.name)
        loaded, *others = (options.load(one) for one in (study, *(states or ())))
        # a baseline has a wall factor of its own unless one is asked for
        own = loaded.conventions if "conventions.wall_factor" in options.changes() else None

        from zoo.blood.diagnosis import diagnose as run
        from zoo.blood.diagnosis import same_tree
        from zoo.blood.forward import study_data
        from zoo.core.errors.spectral import Harmonics
        from zoo.report import diagnosis_files, write_diagnosis
        from zoo.report.sets import SET_FILES, sets_summary, write_sets

        output_folder(output, (*diagnosis_files(), *(SET_FILES if sets else ())), "--output")
        # a study without observations, or of another tree, is refused before the work
        for one in (loaded, *(same_tree(loaded, other) for other in others)):
            Harmonics().bind(study_data(one))
        output.mkdir(exist_ok=True)
        found = run(
            loaded,
            chosen.name,
            max_effects=max_effects,
            component_sizes=component_sizes,
            states=others,
            exhaust=exhaust,
            effects=names,
            conventions=own,
            cores=cores,
            seed=seed,
            tick=tell,
        )
        tell("figures and page", 1.0)
        written = write_diagnosis(found, output, command=typed_command())
        told: list[str] = []
        tables: list[Path] = []
        if sets:
            weighed = found.sets(cores=cores, tick=tell)
            tables, told = write_sets(weighed, output), sets_summary(weighed)
        if posteriors:  # takes longer and may be stopped: what was found is on disk
            folder = output / "posteriors" / _run_name(loaded, chosen.name, own, seed)
            output_folder(folder, option="--output", deep=True).mkdir(parents=True, exist_ok=True)
            tell.say(f"{found.file.verdict}; {output}/report.html is written, its posteriors follow")
            found = found.with_posteriors(cores=cores, seed=seed, folder=folder, tick=tell)
            tell("figures and page", 1.0)
            written = write_diagnosis(found, output, command=typed_command())
    every = ", ".join(path.name for path in (*written, *tables))
    say(*diagnosis_screen(found.file), *told, f"wrote {output}: {every}")


def _effect_names(text: str | None, base: str) -> list[str] | None:
    """Effects of an option, each of which the baseline can take; None for all."""
    from zoo.blood.diagnosis import effects_for

    if text is None:
        return None
    names = [part.strip() for part in text.split(",") if part.strip()]
    if not names:
        raise UsageError("--effects: no names; give some of `zoo effects` with commas, or leave it out")
    return [one.name for one in effects_for(base, names)]


def _run_name(study: Study, base: str, conventions: Conventions | None, seed: int) -> str:
    """Folder of a run's posteriors: another study, baseline, priors, conventions or seed has another one."""
    import hashlib

    own = sorted(study.priors.items())
    what = repr((study.checksum, study.conventions, conventions, seed, dict(study.numerics), *own)).encode()
    return f"{base}-{hashlib.sha256(what).hexdigest()[:8]}"


def diagnosis_screen(file: DiagnosisFile) -> list[Any]:
    """What the screen shows of a diagnosis."""
    from rich.text import Text

    from zoo.report.components import component_rows
    from zoo.report.diagnosis import (
        diagnosis_summary,
        hypothesis_row,
        next_measurement_words,
        total_seconds,
        where_sentences,
    )
    from zoo.report.words import maybe, with_error

    verdict, *rest = diagnosis_summary(file)
    lines: list[Any] = [Text(verdict, style="bold"), *rest, ""]
    if file.hypotheses[0].name != "no-gap":  # else there is nothing to locate
        lines += [*where_sentences(file), ""]
    left = f"left ({file.gap.unit})"
    if file.components:
        cells = [[row["name"], *(row["cells"][i] for i in (0, 3, 4))] for row in component_rows(file)]
        title = "components of the simulator, listed effects included"
        lines += [_table(title, ("component", "prob.", "share of the energy", left), cells, file.cause), ""]
    rows = [h for k, h in enumerate(file.hypotheses) if k < LEADING or h.name in ("no-gap", "unlisted")]
    every = [hypothesis_row(h, file) for h in rows]
    cells = [[row["name"], *(row["cells"][i] for i in (1, 3, 0, 5, 6))] for row in every]
    heads = ("explanation", "prob.", "group", "location", "effect parameter", left)
    lines.append(_table("explanations, most probable first", heads, cells, file.cause))
    if len(file.hypotheses) > len(rows):
        lines.append(
            f"and {len(file.hypotheses) - len(rows)} more; explanations of one group look alike here"
        )
    if not all(h.searched_twice for h in rows):
        lines.append("≤: found by one search only, and not to be compared")
    if file.invisible:
        lines.append(f"these data cannot show: {', '.join(file.invisible)}")
    if file.next_measurement is not None:
        m = file.next_measurement
        lines.append(
            f"next measurement: {next_measurement_words(file)}, which tells "
            f"{m.separates[0]} from {m.separates[1]} (expected log odds up to {m.expected_log_odds:.1f})"
        )
    for name, row in (file.posteriors or {}).items():
        converged = "converged" if row["converged"] else "not converged, see report.html"
        lines.append(
            f"posterior of {name}: log marginal likelihood "
            f"{with_error(row['log_marginal_likelihood'], row['log_marginal_likelihood_se'])}, "
            f"elpd (WAIC) {maybe(row['elpd_waic'])}; {converged}"
        )
    solves, seconds = file.record.get("solves", 0), total_seconds(file.record)
    lines.append(f"{solves} solves of the screening, {seconds:.0f} s in all")
    return [Text(line) if isinstance(line, str) else line for line in lines]


def _table(title: str, heads: Sequence[str], rows: Sequence[Sequence[str]], bold: Sequence[str]) -> Any:
    """A table of names and what belongs to them; texts may be folded, names and short numbers not."""
    table = plain_table(*heads, numbers=("prob.", "group"), title=title)
    for row in rows:
        table.add_row(*row, style="bold" if row[0] in bold else None)
    return table
