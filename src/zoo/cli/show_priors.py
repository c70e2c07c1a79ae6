"""`zoo priors`: what a model of a study believes before the data."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from zoo.cli.checks import at_least, model_name
from zoo.cli.command import Role, UsageError, command, option
from zoo.cli.options import JSON, QUIET, STUDY, PluginOptions, StudyOptions
from zoo.cli.screen import plain_table, say, say_json
from zoo.core.outputs import output_folder, write_file

if TYPE_CHECKING:
    from zoo.blood.prior_predictive import PriorPredictive, PriorRow
    from zoo.blood.study import Study

WRITTEN = "priors.csv", "priors.png", "prior-predictive.png"
LEAST_SOLVED = 0.8
"""Part of the prior draws below which the screen says that many cannot be solved."""


@command
def priors(
    study: str = STUDY,
    model: str = option("B", "A to I, or one of --models-from.", Role.MODELS),
    output: Path | None = option(
        None, "Folder for table, figures; none if absent.", "--output", "-o", Role.WRITES
    ),
    n_draws: int = option(200, "Prior draws to solve."),
    seed: int = option(1, "Random seed."),
    as_json: bool = JSON,
    quiet: bool = QUIET,
    *,
    options: StudyOptions,
    plugins: PluginOptions,
) -> None:
    """Show the priors of a model on a study, and the series that they lead to beside the observed ones."""
    plugins.load()
    name = model_name(model)
    at_least("--n-draws", n_draws, 10)
    at_least("--seed", seed, 0)
    if as_json and output is not None:
        raise UsageError("--json: prints the priors alone, which -o stores with the rest; give one of them")
    loaded = options.load(study)
    if output is not None:
        output_folder(output, WRITTEN, "--output")

    from zoo.blood.prior_predictive import prior_predictive, prior_rows
    from zoo.cli.sample import build_model
    from zoo.core.inference.progress import Display

    built = build_model(name, loaded)
    rows = prior_rows(built)
    if as_json:
        say_json(_records(rows))
        return
    say(_table(rows, name, loaded))
    with Display(not quiet) as tell:
        found = prior_predictive(built, n_draws, seed, lambda done: tell("prior draws", done / n_draws))
    say(*_summary(found, loaded))
    if output is not None:
        output.mkdir(exist_ok=True)
        written = _write(rows, found, loaded, name, output)
        say(f"wrote {output}: {', '.join(written)}")


def _table(rows: tuple[PriorRow, ...], name: str, study: Study) -> Any:
    from zoo.blood.study_priors import prior_table

    title = f"priors of model {name} on {study.name}, set {prior_table(study).set}"
    numbers = ("median", "2.5 %", "97.5 %")
    table = plain_table("parameter", *numbers, "prior; where from", numbers=numbers, title=title)
    for row in rows:
        p = row.parameter
        label = p.name + (f" of {p.size}" if p.dims else "") + ("" if p.unit == "1" else f" ({p.unit})")
        cells = (f"{x:.3g}" for x in (row.median, row.low, row.high))
        table.add_row(label, *cells, f"{p.prior.text}; {row.origin}")
    return table


def _records(rows: tuple[PriorRow, ...]) -> list[dict[str, Any]]:
    """The table for machines."""
    return [
        {
            "parameter": row.parameter.name,
            "unit": row.parameter.unit,
            "prior": row.parameter.prior.text,
            "median": row.median,
            "low_95": row.low,
            "high_95": row.high,
            "from": row.origin,
        }
        for row in rows
    ]


def _summary(found: PriorPredictive, study: Study) -> list[Any]:
    import numpy as np
    from rich.text import Text

    from zoo.blood.case import UNITS

    few = len(found.series) < LEAST_SOLVED * len(found.draws)
    lines: list[Any] = [Text(found.text, style="yellow" if few else "")]
    for k, series in enumerate(study.series if len(found.series) else ()):
        quantity, unit = series.quantity.partition("_")[0], UNITS[series.quantity]
        low, high = np.quantile(found.series[:, k], (0.025, 0.975), axis=0)
        there = ~np.isnan(series.value)
        inside = np.mean(((series.value >= low) & (series.value <= high))[there])
        means = np.quantile(found.series[:, k, there].mean(axis=1), (0.025, 0.975))
        lines.append(
            f"{series.label}: {100 * inside:.0f} % of the samples lie in the prior's 95 % band; mean "
            f"{quantity} {series.value[there].mean():.4g}, prior {means[0]:.3g} to {means[1]:.3g} {unit}"
        )
    return lines


def _write(
    rows: tuple[PriorRow, ...], found: PriorPredictive, study: Study, name: str, output: Path
) -> list[str]:
    import pandas as pd

    from zoo import plots

    write_file(output / WRITTEN[0], pd.DataFrame(_records(rows)).to_csv(index=False))
    title = f"model {name} on {study.name}"
    figures = {
        "priors": plots.priors_figure(rows, title=f"priors of {title}"),
        "prior-predictive": plots.prior_predictive_figure(study, found, title=f"before the data: {title}"),
    }
    for stem, figure in figures.items():
        plots.save_figure(figure, output / f"{stem}.png")
    return list(WRITTEN)
