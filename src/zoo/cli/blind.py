"""`zoo blind`: the diagnosis on cases whose effect is withheld."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zoo.cli.command import Role, UsageError, Without, command
from zoo.cli.options import (
    DaskOption,
    PluginOptions,
    PriorOptions,
    QuietOption,
)
from zoo.cli.screen import plain_table, say
from zoo.core.outputs import output_file, output_folder

if TYPE_CHECKING:
    from zoo.core.blindcheck import CheckScore


class _Counting:
    """A progress bar over cases."""

    def __init__(self, wanted: bool, total: int) -> None:
        from zoo.core.inference.progress import bar

        self.bar, self.total = bar(wanted), total

    def __enter__(self) -> _Counting:
        self.bar.__enter__()
        self.task = self.bar.add_task("cases", total=self.total)
        return self

    def __exit__(self, *error: Any) -> None:
        self.bar.__exit__(*error)

    def __call__(self, case: str) -> None:
        """One more is done."""
        self.bar.update(self.task, description=case, advance=1)


def _name_list(option: str, text: str | None) -> list[str] | None:
    if text is None:
        return None
    names = list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    if not names:
        raise UsageError(f"{option}: no names; give some with commas, or leave it out")
    return names


@command
def make(
    folder: Annotated[Path, typer.Argument(metavar="CASES", help="Folder for the cases."), Role.WRITES],
    n: Annotated[int, typer.Option("--n", help="Cases."), Role.ASIDE] = 40,
    key: Annotated[
        Path, typer.Option("--key", help="File for what is withheld, outside the folder."), Role.WRITES
    ] = Path("key.json"),
    kind: Annotated[
        str,
        typer.Option(
            "--kind",
            help="catalogue: listed effects, some outside, some none; component: a cause in a known "
            "component that no catalogue lists; pair: two of these; small: small ones of all; coloured: "
            "noise alone.",
        ),
        Role.ASIDE,  # as are all options of what is withheld: the record of a run lies beside the cases
    ] = "catalogue",
    secret: Annotated[
        str | None,
        typer.Option(
            "--secret",
            help="Of an older key, to make its cases again; a new one is drawn if absent.",
            metavar="HEX",
            show_default=False,
        ),
        Role.ASIDE,
    ] = None,
    effects: Annotated[
        str | None,
        typer.Option(
            "--effects",
            help="Draw from these, with commas; from all of `zoo effects` if absent.",
            metavar="NAMES",
            show_default=False,
        ),
        Role.ASIDE,
    ] = None,
    layouts: Annotated[
        str | None,
        typer.Option(
            "--layouts",
            help="Where sensors are, with commas: MPA, MPA+daughters, MPA+distal, MPA+flow (one daughter), "
            "MPA+flows (both); of the flows MPA+flow for a catalogue, MPA+flows for other kinds if absent.",
            metavar="NAMES",
            show_default=False,
        ),
        Role.ASIDE,
    ] = None,
    networks: Annotated[
        str,
        typer.Option("--networks", help="mouse, tree (generated), or both.", metavar="NAMES"),
        Role.ASIDE,
    ] = "mouse,tree",
    cores: Annotated[int, typer.Option("--cores", help="Processes at a time."), Role.ASIDE] = 2,
    quiet: QuietOption = False,
) -> None:
    """Write studies with a withheld cause each, and the key apart; goes on where it was interrupted."""
    from zoo.blood.blind import make_cases

    output_folder(folder, option="CASES", deep=True)
    output_file(key, "--key")
    with _Counting(not quiet, n) as counting:
        path = make_cases(
            folder,
            n,
            key,
            kind=kind,
            secret=secret,
            effects=_name_list("--effects", effects),
            layouts=_name_list("--layouts", layouts),
            networks=_name_list("--networks", networks) or [],
            cores=cores,
            done=counting,
        )
    say(f"wrote {n} cases in {folder}, and what they withhold in {path}")


@command
def run(
    cases: Annotated[Path, typer.Argument(metavar="CASES", help="Folder of studies, without their key.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the answers."), Role.WRITES
    ] = Path("answers"),
    base: Annotated[str, typer.Option("--base", help="Baseline, as in `zoo diagnose`.")] = "linear-constant",
    posteriors: Annotated[
        bool,
        typer.Option("--posteriors", "--confirm", help="Posterior sampling of the leading explanations too."),
    ] = False,
    max_effects: Annotated[int, typer.Option("--max-effects", help="Most effects to add.")] = 3,
    seed: Annotated[int, typer.Option("--seed", help="Of the draws.")] = 1,
    cores: Annotated[int, typer.Option("--cores", help="Cases at a time, a process each."), Role.ASIDE] = 2,
    dask: DaskOption = None,
    quiet: QuietOption = False,
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
    with connect(dask) as executor, _Counting(not quiet, len(studies)) as counting:
        found = diagnose_cases(
            cases,
            output,
            base=base,
            posteriors=posteriors,
            max_effects=max_effects,
            effects_from=plugins.effects_from or (),
            seed=seed,
            priors=priors.table(),
            cores=cores,
            executor=executor,
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
    answers: Annotated[Path, typer.Argument(metavar="ANSWERS", help="Folder of `zoo blind run`.")],
    key: Annotated[
        Path,
        typer.Option("--key", help="Of `zoo blind make`; or a folder of keys made elsewhere, one a case."),
    ] = Path("key.json"),
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the score."), Role.WRITES] = Path(
        "score"
    ),
) -> None:
    """Score answers against their key: score.json, score.md, cases.csv and figures."""
    from zoo.blood.blind import score_cases
    from zoo.core.blindcheck.tables import SCORE_FILES

    output_folder(output, SCORE_FILES, "--output")
    found = score_cases(answers, key, output)

    from zoo.plots import save_figure, score_figures

    figures = [
        save_figure(figure, output / f"{name}.png").name for name, figure in score_figures(found).items()
    ]
    say(*_score_summary(found))
    say(f"wrote {output}: score.json, score.md, cases.csv, {', '.join(figures)}")


def _score_summary(found: CheckScore) -> list[Any]:
    from zoo.core.blindcheck.rates import FULL_BIN
    from zoo.core.blindcheck.tables import (
        HEADLINES,
        MEANS,
        component_rows,
        constant_text,
        rate_text,
        size_rows,
    )

    s, best = found.summary, found.constants
    title = f"{s['n']} cases, {s['failed']} without an answer"
    if found.without_key:
        title += f"; {found.without_key} more answers have no key"
    table = plain_table("score", "", "best constant answer", title=title)
    for name, words in HEADLINES:
        if s[name]["n"]:
            table.add_row(words, rate_text(s[name]), constant_text(best.get(name)))
    for row in size_rows(found):
        table.add_row(*row)
    for name, words in MEANS:
        table.add_row(words, f"{s[name]:.3f}", constant_text(best[name]))
    for row in component_rows(found.components):
        table.add_row(*row)
    full = [b for b in found.reliability if b.n >= FULL_BIN]
    table.add_row(
        f"bins of stated probability with {FULL_BIN} cases or more that lie within their band",
        f"{sum(b.inside for b in full)} of {len(full)}",
    )
    checked = (
        "the key has the SHA-256 that the cases came with" if found.key_checked else "keys without SHA-256"
    )
    return [table, checked]
