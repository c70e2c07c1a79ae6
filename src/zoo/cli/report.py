"""`zoo report`: a page on stored posteriors."""

from __future__ import annotations

import os
from contextlib import nullcontext
from pathlib import Path
from typing import Literal

from zoo.cli.checks import at_least, model_names
from zoo.cli.command import Role, argument, command, option, typed_command
from zoo.cli.options import QUIET, PluginOptions, StudyOptions
from zoo.cli.screen import say
from zoo.core.outputs import output_file


@command
def report(
    studies: list[str] | None = argument(
        "STUDY...", "Studies, a chapter each; all built-in ones if absent.", Role.STUDY, default=None
    ),
    posteriors: list[Path] | None = option(
        None, "Folder of posteriors; may be repeated. Here if absent.", Role.SEARCHED
    ),
    output: Path = option(Path("report.html"), "HTML file.", "--output", "-o", Role.WRITES),
    models: str = option("A,B,C,D,E,F,G,H,I", "Those to take, with commas.", Role.MODELS),
    criterion: Literal["waic", "loo"] = option("waic", "Criterion to rank by: waic or loo.", "--ic"),
    n_draws: int = option(1000, "Draws of each posterior that are scored."),
    solves: Path | None = option(
        None, "Folder that keeps what is solved, such as `solves` of `zoo compare`.", Role.WRITES
    ),
    title: str = option("Models of blood flow", "Page title."),
    quiet: bool = QUIET,
    *,
    options: StudyOptions,
    plugins: PluginOptions,
) -> None:
    """Write one HTML page on stored posteriors: comparison, fits, convergence, how they were made."""
    from zoo.blood.study import list_studies
    from zoo.cli.compare import kept_solves
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
    every = {f"{one.name} {name}": model for one in chapters for name, model in one.models.items()}
    with nullcontext() if solves is None else kept_solves(every, solves):
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
