"""`zoo blind`: the diagnosis on cases whose effect is withheld."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import typer

from zoo.cli.checks import some_names
from zoo.cli.command import FRESH, Role, Without, argument, command, option
from zoo.cli.options import DASK, JSON, QUIET, PluginOptions, PriorOptions
from zoo.cli.screen import plain_table, say
from zoo.core.outputs import output_file, output_folder


@contextlib.contextmanager
def _counting(quiet: bool, total: int) -> Iterator[Callable[[str], None]]:
    """Show how many cases are done; what it gives is to be called with each one's name."""
    from zoo.core.inference.progress import Display

    with Display(not quiet) as tell:
        tell(f"0 of {total} cases", 0.0)
        count = itertools.count(1)
        yield lambda case: tell(f"{(n := next(count))} of {total} cases, last {case}", n / max(1, total))


@command
def make(
    folder: Path = argument("CASES", "Folder for the cases.", Role.WRITES),
    n: int = option(40, "Cases.", Role.ASIDE),
    key: Path = option(Path("key.json"), "File for what is withheld, outside the folder.", Role.WRITES),
    secret: str | None = option(
        None,
        "Secret of an older key, to make its cases again; a new one is drawn if absent.",
        Role.ASIDE,
        metavar="HEX",
    ),
    effects: str | None = option(
        None,
        "Draw from these, with commas; from all of `zoo effects` if absent.",
        Role.EFFECTS,
        Role.ASIDE,
        metavar="NAMES",
    ),
    layouts: str | None = option(
        None,
        "Where sensors are, with commas: MPA, MPA+daughters, MPA+distal, MPA+flow (one daughter), "
        "MPA+flows (both); all of these if absent.",
        Role.ASIDE,
        metavar="NAMES",
    ),
    networks: str = option("mouse,tree", "mouse, tree (generated), or both.", Role.ASIDE, metavar="NAMES"),
    cores: int = option(2, "Processes at a time.", Role.ASIDE),
    quiet: bool = QUIET,
) -> None:
    """Write studies with a withheld effect each, or none, and the key apart."""
    from zoo.blood.blind import make_cases
    from zoo.blood.blind.study_cases import LAYOUTS

    output_folder(folder, option="CASES", deep=True)
    output_file(key, "--key")
    with _counting(quiet, n) as counting:
        path = make_cases(
            folder,
            n,
            key,
            secret=secret,
            effects=some_names("--effects", effects),
            layouts=some_names("--layouts", layouts) or LAYOUTS,
            networks=some_names("--networks", networks) or [],
            cores=cores,
            done=counting,
        )
    say(f"wrote {n} cases in {folder}, and what they withhold in {path}")


@command
def run(
    cases: Path = argument("CASES", "Folder of studies, without their key."),
    output: Path = option(Path("answers"), "Folder for the answers.", "--output", "-o", Role.WRITES),
    base: str = option("linear-constant", "Baseline, as in `zoo diagnose`.", Role.MODELS),
    seed: int = option(1, "Random seed."),
    cores: int = option(2, "Cases at a time, a process each.", Role.ASIDE),
    dask: str | None = DASK,
    fresh: bool = FRESH,
    quiet: bool = QUIET,
    *,
    priors: PriorOptions,
    plugins: Annotated[PluginOptions, Without("models_from")],
) -> None:
    """Diagnose every case of a folder; sees no key, and goes on where it was interrupted."""
    import time

    from zoo.blood.blind import diagnose_cases
    from zoo.core.inference.cluster import connect

    output_folder(output, option="--output", deep=True)
    plugins.load()
    began = time.monotonic()
    studies = [p for p in cases.iterdir() if (p / "study.toml").is_file()] if cases.is_dir() else []
    with connect(dask) as executor, _counting(quiet, len(studies)) as counting:
        found = diagnose_cases(
            cases,
            output,
            base=base,
            effects_from=plugins.effects_from or (),
            seed=seed,
            priors=priors.table(),
            cores=cores,
            executor=executor,
            fresh=fresh,
            done=counting,
        )
    words = f", {len(found.kept)} of them before" if found.kept else ""
    say(
        f"{len(found.diagnosed)} cases diagnosed{words}, {len(found.failed)} failed, "
        f"{time.monotonic() - began:.0f} s; answers in {output}"
    )
    for name, reason in found.failed.items():
        say(f"{name}: {reason}")
    if found.failed:
        say("mend these and give the command again; what was on the way is in failed.txt in their folders")
        raise typer.Exit(1)


@command
def score(
    answers: Path = argument("ANSWERS", "Folder of `zoo blind run`."),
    key: Path = option(Path("key.json"), "Key that `zoo blind make` wrote."),
    output: Path = option(Path("score"), "Folder for the score.", "--output", "-o", Role.WRITES),
    as_json: bool = JSON,
) -> None:
    """Score answers against their key: score.json, score.md, cases.csv and figures."""
    from zoo.blood.blind import score_cases
    from zoo.core.blindcheck.score_tables import SCORE_FILES
    from zoo.core.blindcheck.scoring import CONSTANT, summary_rows

    output_folder(output, SCORE_FILES, "--output")
    found = score_cases(answers, key, output)

    from zoo.plots import save_figure, score_figures

    figures = [
        save_figure(figure, output / f"{name}.png").name for name, figure in score_figures(found).items()
    ]
    if as_json:
        print((output / "score.json").read_text(encoding="utf-8"), end="")
        return
    title = f"{found.summary['n']} cases, {found.summary['failed']} without an answer"
    if found.without_key:
        title += f"; {found.without_key} more answers have no key"
    table = plain_table("score", "", CONSTANT, title=title)
    for row in summary_rows(found.summary):
        table.add_row(*row)
    say(table)
    say(f"wrote {output}: score.json, score.md, cases.csv, {', '.join(figures)}")
