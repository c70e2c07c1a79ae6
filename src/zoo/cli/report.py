"""`zoo report`: a page on stored posteriors."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

import typer

from zoo.cli.checks import at_least, model_names
from zoo.cli.command import Role, command, typed_command
from zoo.cli.options import PluginOptions, QuietOption, StudyOptions
from zoo.cli.screen import say
from zoo.core.outputs import output_file


@command
def report(
    studies: Annotated[
        list[str] | None,
        typer.Argument(metavar="STUDY...", help="Studies, a chapter each; all built-in ones if absent."),
        Role.STUDY,
    ] = None,
    posteriors: Annotated[
        list[Path] | None,
        typer.Option("--posteriors", help="Folder of posteriors; may be repeated. Here if absent."),
        Role.SEARCHED,
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="HTML file."), Role.WRITES] = Path(
        "report.html"
    ),
    models: Annotated[
        str, typer.Option("--models", help="Those to take, with commas.")
    ] = "A,B,C,D,E,F,G,H,I",
    criterion: Annotated[
        Literal["waic", "loo"], typer.Option("--ic", help="Criterion to rank by: waic or loo.")
    ] = "waic",
    n_draws: Annotated[
        int, typer.Option("--n-draws", help="Draws of each posterior that are scored.")
    ] = 1000,
    title: Annotated[str, typer.Option("--title", help="Page title.")] = "Models of blood flow",
    quiet: QuietOption = False,
    *,
    options: StudyOptions,
    plugins: PluginOptions,
) -> None:
    """Write one HTML page on stored posteriors: comparison, fits, convergence, how they were made."""
    from zoo.blood.study import list_studies
    from zoo.report import gather, write_chapters

    plugins.load()
    letters = model_names(models)
    at_least("--n-draws", n_draws, 10)
    output_file(output, "--output")
    chapters = gather(
        studies or list_studies(),
        posteriors or [Path()],
        letters=letters,
        data=bool(os.environ.get("CI")),
        load=options.load,
        say=say,
    )
    write_chapters(
        output,
        chapters,
        title=title,
        ic=criterion,
        n_draws=n_draws,
        command=typed_command(),
        say=(lambda text: None) if quiet else say,
    )
    say(f"wrote {output}")
