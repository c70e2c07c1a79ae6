"""`zoo diagnose`: what a model misses."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zoo.cli.checks import at_least, some_names
from zoo.cli.command import GATE, Role, UsageError, Without, argument, command, option, typed_command
from zoo.cli.options import JSON, QUIET, SHARE, PluginOptions, StudyOptions
from zoo.cli.screen import complain, plain_table, say
from zoo.core.outputs import output_folder
from zoo.core.words import nearest, percent

if TYPE_CHECKING:
    from zoo.blood.conventions import Conventions
    from zoo.blood.study import Study
    from zoo.core.diagnosis import Diagnosis, DiagnosisFile

EVERY_S = 5.0
"""Seconds between lines where there is no terminal."""
K_TRUSTED = 0.7
"""Pareto's k up to which importance sampling is trusted (Vehtari et al. 2024, arXiv 1507.02646)."""
SOLVES = "solves"
"""Folder in the output for solves of a diagnosis that is not done."""
LEADING, PROBABLE = 5, 0.05
"""Sets of causes that the screen shows, and least probability of an effect or function that it shows."""


@command
def diagnose(
    studies: list[str] = argument(
        "STUDY...",
        "A built-in study (see `zoo studies`) or a folder; several are diagnosed together, for causes that "
        "act in all of them.",
        Role.STUDY,
    ),
    base: str = option(
        "linear-constant",
        "Baseline: linear-constant, linear-radius, tangent-constant, tangent-radius, or a model "
        "with that structure: A to I.",
        Role.MODELS,
    ),
    output: Path = option(
        Path("gap"), "Folder for page, figures and diagnosis.json.", "--output", "-o", Role.WRITES
    ),
    posteriors: bool = option(False, "Sample the posteriors of the leading sets of effects too.", Role.ASIDE),
    check: bool = option(
        False, "Check the evidence of the leading sets by solves around their modes.", Role.ASIDE
    ),
    effects: str | None = option(
        None,
        "Only these, with commas; all of `zoo effects` that fit the baseline if absent.",
        Role.EFFECTS,
        metavar="NAMES",
    ),
    component_sizes: float = option(
        1.0,
        "Factor of the prior sizes of what components may lack: try 0.5 and 2; 0 leaves them out.",
        metavar="FACTOR",
    ),
    share: str | None = SHARE,
    states: list[str] | None = option(
        None,
        "Study of the same tree in another state, such as at another heart rate, in which what was "
        "learned is checked; may be given several times.",
        "--state",
        Role.STUDY,
        metavar="STUDY",
    ),
    expect: list[str] | None = option(
        None,
        "End with exit code 3 unless the answer is decided and this cause or component, or "
        "`nothing`, has more than 50 %; may be given several times.",
        Role.EFFECTS,
        Role.ASIDE,
        metavar="NAME",
    ),
    cores: int = option(2, "Threads and processes at a time.", Role.ASIDE),
    seed: int = option(1, "Random seed."),
    as_json: bool = JSON,
    quiet: bool = QUIET,
    *,
    options: StudyOptions,
    plugins: Annotated[PluginOptions, Without("models_from")],
) -> None:
    """Find what a baseline misses in a study: where the discrepancy lies, its cause, how far it shrinks."""
    at_least("--cores", cores, 1)
    at_least("--seed", seed, 0)
    from zoo.core.inference.progress import Display

    with Display(not quiet, every_s=EVERY_S) as tell:
        tell.say(f"reading {', '.join(studies)}")
        from zoo.blood.baseline import get_baseline

        plugins.load()
        chosen = get_baseline(base)
        names = _effect_names(effects, chosen.name)
        _known(expect or (), chosen.name, names)
        together = [options.load(one) for one in studies]
        loaded, several = together[0], len(together) > 1
        if share and not several:
            raise UsageError(f"--share {share}: is of several studies; give two or more")
        if states and several:
            raise UsageError(f"--state {states[0]}: is another state of one study; give one STUDY")
        others = [options.load(one) for one in states or ()]
        # a baseline has a wall factor of its own unless one is asked for
        own = loaded.conventions if "conventions.wall_factor" in options.changes() else None

        from zoo.blood.blood_flow import study_data
        from zoo.blood.study_diagnosis import diagnose as run
        from zoo.blood.study_diagnosis import diagnose_studies, same_tree
        from zoo.core.errors.spectral import spectral_errors
        from zoo.report import diagnosis_files, write_diagnosis

        output_folder(output, diagnosis_files(), "--output")
        # a study without observations, or of another tree, is refused before the work
        for one in (*together, *(same_tree(loaded, other) for other in others)):
            data = study_data(one)
            spectral_errors(data).bind(data)
        settings: dict[str, Any] = {
            "component_sizes": component_sizes,
            "effects": names,
            "conventions": own,
            "cores": cores,
            "seed": seed,
            "tick": tell,
            "checkpoint": output / SOLVES,
        }
        found: Diagnosis = (
            diagnose_studies(together, chosen.name, share=some_names("--share", share) or (), **settings)
            if several
            else run(loaded, chosen.name, states=others, **settings)
        )
        if check:
            found = found.with_check(seed=seed, tick=tell)
        tell("figures and page")
        written = write_diagnosis(found, output, command=typed_command())
        shutil.rmtree(output / SOLVES, ignore_errors=True)  # what they were kept for is on disk
        if posteriors:  # takes longer and may be stopped: what was found is on disk
            folder = output / "posteriors" / _run_name(together, chosen.name, own, seed)
            output_folder(folder, option="--output", deep=True).mkdir(parents=True, exist_ok=True)
            tell.say(f"{found.file.verdict}; {output}/report.html is written, its posteriors follow")
            found = found.with_posteriors(cores=cores, seed=seed, folder=folder, tick=tell)
            tell("figures and page")
            written = write_diagnosis(found, output, command=typed_command())
    files = ", ".join(path.name for path in written)
    if as_json:
        print((output / "diagnosis.json").read_text(encoding="utf-8"), end="")
    else:
        say(*diagnosis_screen(found.file), *_check_lines(found.file), f"wrote {output}: {files}")
    for name in expect or ():
        if missed := _not_as_expected(found.file, name):
            complain(f"--expect {name}: {missed}")
            raise typer.Exit(GATE)


def _not_as_expected(file: DiagnosisFile, name: str) -> str:
    """Why an answer is not what was expected; empty if it is."""
    found = {c.name: c.probability for c in file.components} | {c.name: c.probability for c in file.causes}
    found["nothing"] = next(row.probability for row in file.sets if not row.causes)
    if name not in found:
        raise UsageError(f"--expect {name}: no cause or component; there are {', '.join(found)}")
    if not file.decided:
        return "the answer is not decided, see its warnings"
    return "" if found[name] > 0.5 else f"has a probability of {percent(found[name])}"


def _check_lines(file: DiagnosisFile) -> list[str]:
    """What importance sampling said of the leading sets."""
    lines = []
    for one in file.record.get("check", ()):
        doubt = "" if one["k"] <= K_TRUSTED else f"; its weights are too uneven to say (k = {one['k']:.2g})"
        before, after = (f"{100.0 * one[name]:.3g} %" for name in ("before", "after"))
        lines.append(
            f"Check of {one['which']} by {one['draws']} solves: log evidence {one['change']:+.2f} +- "
            f"{one['error']:.2f}, probability {before} -> {after}{doubt}."
        )
    return lines


def _effect_names(text: str | None, base: str) -> list[str] | None:
    """Effects of an option, each of which the baseline can take; None for all."""
    from zoo.blood.study_diagnosis import effects_for

    names = some_names("--effects", text)
    return names and [one.name for one in effects_for(base, names)]


def _known(expected: Sequence[str], base: str, effects: list[str] | None) -> None:
    """Refuse the name of no cause and no component."""
    from zoo.blood.components.declared import TABLE
    from zoo.blood.study_diagnosis import effects_for

    listed = [one.name for one in effects_for(base, effects)]
    components = [said["component"] for said in TABLE.values()]
    for name in expected:
        known = list(dict.fromkeys(("nothing", *components, *listed, *TABLE)))
        if name not in known:
            raise UsageError(f"--expect {name}: {nearest(name, known)}")


def _run_name(studies: Sequence[Study], base: str, conventions: Conventions | None, seed: int) -> str:
    """Folder of a run's posteriors: another study, baseline, priors, conventions or seed has another one."""
    import hashlib

    digest = hashlib.sha256()
    for study in studies:
        own, held = sorted(study.priors.items()), sorted(study.parameters.items())
        what = (study.checksum, study.conventions, conventions, seed, dict(study.numerics), *own, *held)
        digest.update(repr(what).encode())
    return f"{base}-{digest.hexdigest()[:8]}"


def diagnosis_screen(file: DiagnosisFile) -> list[Any]:
    """What the screen shows of a diagnosis."""
    from rich.text import Text

    from zoo.report import diagnosis_page as told
    from zoo.report import tables

    verdict, *rest = file.lines
    lines: list[Any] = [Text(verdict, style="bold"), *rest, ""]
    sets, found = tables.sets_table(file, LEADING), tables.components_table(file)
    causes = tables.causes_table(file)
    shown, sampled = sum(c.probability >= PROBABLE for c in file.causes), tables.posteriors_table(file)
    for table in (
        sets.only("causes", "probability", "prior", "log evidence", "solved"),
        found.only("component", "probability", "before the data", "other priors", "share of the error"),
        causes.only("cause", "probability", "before the data", "size", "place", first=shown),
        sampled.only(*sampled.heads[:4]),
    ):
        if not table.rows:
            continue
        drawn = plain_table(*table.heads, numbers=table.numbers, title=table.name)
        for row in table.rows:
            drawn.add_row(*row, style="bold" if row[0] in file.cause else None)
        lines += [drawn, ""]
    lines.append(f"{file.record['solves']} solves, {told.total_seconds(file.record):.0f} s in all")
    return [Text(line) if isinstance(line, str) else line for line in lines]
