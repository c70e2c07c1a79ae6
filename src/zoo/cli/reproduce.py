"""`zoo reproduce`: a paper again."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zoo.cli.checks import at_least, different_models
from zoo.cli.command import Role, UsageError, Without, command
from zoo.cli.options import SamplingOptions, StudyOptions
from zoo.cli.screen import say, text_table
from zoo.core.outputs import output_folder, write_file
from zoo.models import PAPER

if TYPE_CHECKING:
    from zoo.blood.study import Study

PAPERS = ("paun2020",)
REPRODUCED = (
    *(f"{name}.csv" for name in ("table4", "scores", "costs", "comparison", "interval-widths", "figure7")),
    "table4.md",
)


@dataclass(frozen=True)
class ReproductionOptions(SamplingOptions):
    """As a reproduction samples: with a seed of its own."""

    seed: Annotated[int | None, typer.Option("--seed", help="Seed; 1 by default.", show_default=False)] = None


@command
def reproduce(
    paper: Annotated[str, typer.Argument(metavar="PAPER", help="paun2020.")] = "paun2020",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Folder for posteriors, tables and figures; PAPER by default.",
            show_default=False,
        ),
        Role.WRITES,
    ] = None,
    models: Annotated[
        str | None,
        typer.Option("--models", help="With commas; all nine by default.", show_default=False),
        Role.ASIDE,
    ] = None,
    study: Annotated[str, typer.Option("--study", help="What to fit."), Role.STUDY] = "mouse-c6",
    synthetic: Annotated[
        bool, typer.Option("--synthetic", help="The studies on synthetic data instead: Tables 3 and 5.")
    ] = False,
    data_sets: Annotated[
        int | None,
        typer.Option("--data-sets", help="Synthetic data sets; 20 by default.", show_default=False),
    ] = None,
    vessels: Annotated[
        str | None,
        typer.Option(
            "--vessels",
            help="How many vessels have synthetic data: counts, with commas; 1,3,21 by default.",
            show_default=False,
        ),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option("--samples", help="Samples in a synthetic beat; 256 by default.", show_default=False),
    ] = None,
    points: Annotated[
        int | None,
        typer.Option(
            "--points",
            help="Solves of a pool that all synthetic data sets share; 16000 by default.",
            show_default=False,
        ),
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")] = True,
    *,
    sampling: Annotated[ReproductionOptions, Without("chains", "thin")],
    options: Annotated[StudyOptions, Without("prior")],
) -> None:
    """Do a paper again: its models on its data, its tables beside ours; goes on where it was interrupted."""
    if paper not in PAPERS:
        raise UsageError(f"{paper}: no such paper; {' or '.join(PAPERS)}")
    if synthetic and (models is not None or sampling.seed is not None):
        given = "--models" if models is not None else "--seed"
        raise UsageError(f"{given}: leave it out; the synthetic studies have models and seeds of their own")
    own = {"data-sets": data_sets, "vessels": vessels, "samples": samples, "points": points}
    for option, value in own.items():
        if value is not None and not synthetic:
            raise UsageError(
                f"--{option} {value}: is of the synthetic studies; add --synthetic, or leave it out"
            )
    names = list(PAPER) if models is None else different_models(models)
    folder = Path(paper) if output is None else output
    files = () if synthetic else (*(f"{name}.nc" for name in names), *REPRODUCED)
    output_folder(folder, files, "--output")
    asked = sampling.settings()
    settings = {name: asked[name] for name in ("cores", "tune", "max_draws", "draws", "until_ess")}
    loaded = options.load(study)
    if synthetic:
        counts = _vessel_counts(vessels or "1,3,21", loaded)
        _reproduce_synthetic(
            loaded,
            folder / "synthetic",
            settings
            | {
                "data_sets": 20 if data_sets is None else data_sets,
                "n_times": 256 if samples is None else samples,
                "points": 16_000 if points is None else points,
                "progress": not sampling.quiet,
            },
            counts,
            figures=figures,
        )
        return

    from zoo.core.inference.checkpoint import CheckpointError
    from zoo.paper.reproduce import reproduce as run
    from zoo.paper.table4 import WAIC_LIMIT, WAIC_LIMITS, table4_lines

    settings |= {
        "method": sampling.method,
        "seed": 1 if sampling.seed is None else sampling.seed,
        "progress": not sampling.quiet,
    }
    try:
        found = run(loaded, folder, names, figures=figures, say=say, **settings)
    except CheckpointError as error:
        raise UsageError(f"{error}; the folder is {folder}") from None
    limits = "; ".join([f"{WAIC_LIMIT:g}", *(f"{name}: {limit:g}" for name, limit in WAIC_LIMITS.items())])
    say(
        text_table(
            ["model", "quantity", "published", "zoo", ""],
            table4_lines(found.parameters, found.scores),
            f"Table 4 of {paper}, published and on {loaded.name}",
        ),
        f"cells: median (2.5 %, 97.5 %); = agrees, x does not (differences of WAIC: within {limits}); "
        "WAIC with the whole series as one observation; ±: Monte Carlo standard error",
        _cost_summary(found.costs),
        *found.lines(),
        f"wrote {folder}",
    )


def _beside(name: str, row: Any) -> str:
    return f"{row[name]:.2g} ({row[f'published_{name}']:.2g})"


def _cost_summary(costs: Any) -> Any:
    headings = ["model", "converged", "R-hat", "ESS", "solves", "minutes", "paper"]
    rows = []
    for model, row in costs.iterrows():
        paper = f"{row['published_iterations']:.0f}{'*' if row['published_emulator'] else ''}"
        if row["published_days"] and row["published_days"] == row["published_days"]:
            paper += f", {row['published_days']:.0f} days"
        rows.append(
            [
                str(model),
                "yes" if row["converged"] else "no",
                f"{row['rhat_max']:.3f}",
                f"{row['ess_min']:.0f}",
                f"{row['solves']:.0f}",
                f"{row['minutes']:.1f}",
                paper,
            ]
        )
    return text_table(headings, rows, "what the posteriors cost; paper: iterations, * of an emulator")


def _vessel_counts(text: str, study: Study) -> list[int]:
    try:
        counts = [int(part) for part in text.split(",")]
    except ValueError:
        raise UsageError(f"--vessels {text}: give whole numbers with commas, such as 1,3,21") from None
    for count in counts:
        if not 1 <= count <= len(study.vessels):
            raise UsageError(f"--vessels {text}: {study.name} has {len(study.vessels)} vessels")
    return counts


def _reproduce_synthetic(
    base: Study, folder: Path, settings: dict[str, Any], vessels: Sequence[int], *, figures: bool
) -> None:
    from zoo.paper import coverage
    from zoo.paper.synthetic_tables import synthetic_figures, synthetic_tables

    for name, least in (("data_sets", 1), ("n_times", 16), ("points", 1000)):
        at_least({"n_times": "--samples"}.get(name, f"--{name.replace('_', '-')}"), settings[name], least)
    wanted = [s for s in coverage.SCENARIOS if s.vessels in vessels]
    wanted += [coverage.Scenario(f"mismatch, {n} vessels", "E", n) for n in vessels if n not in (1, 3, 21)]
    scores = coverage.run(base, folder, scenarios=wanted, **settings)
    data_sets = settings["data_sets"]
    table, covered = synthetic_tables(scores), coverage.coverage(scores)
    write_file(folder / "tables-3-and-5.csv", table.to_csv())
    write_file(folder / "coverage.csv", covered.to_csv(index=False))
    shown = {"converged": lambda row: f"{row['converged']:.0f} of {row['data_sets']:.0f}"}
    for name in ("relative_sse", *(f"density_{name}" for name in coverage.THETA)):
        label = name.replace("density_", "p(") + "|y)" if name.startswith("density_") else "relative SSE"
        shown[label] = functools.partial(_beside, name)
    shown["p(theta|y), kernel"] = lambda row: f"{row['joint_kde']:.2g}"
    shown["p(theta|y), direct"] = lambda row: f"{row['joint_direct']:.2g}"
    shown["ratio to 1 vessel"] = lambda row: (
        f"{row.get('joint_ratio', math.nan):.3g} ({row['published_joint_ratio']:.3g})"
    )
    rows = [[label, *(text(row) for _, row in table.iterrows())] for label, text in shown.items()]
    headings = ["median of", *(str(scenario).replace(", ", ",\n") for scenario in table.index)]
    say(text_table(headings, rows, f"Tables 3 and 5: {data_sets} data sets (published)"))
    rows = []
    for (scenario, parameter), group in covered.groupby(["scenario", "parameter"], sort=False):
        cells = [
            f"{row['covered']} of {row['data_sets']}{'' if row['within'] else ' x'}"
            for _, row in group.iterrows()
        ]
        rows.append([str(scenario), str(parameter), *cells])
    headings = ["scenario", "parameter", *(f"{100 * level:.0f} %" for level in coverage.LEVELS)]
    say(
        text_table(headings, rows, "how often central intervals hold the truth"),
        "x: outside the central 95 % of the binomial with that probability",
    )
    if figures:
        synthetic_figures(scores, base, folder)
    say(f"wrote {folder}")
