"""The command of this folder; see `benchmarks.nature`."""

from __future__ import annotations

import argparse
import resource
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.nature import CASES, GROUPS, DataError, __doc__, data_file, durance, list_digest, pig_aorta
from benchmarks.nature.falling_balls import (
    diagnose_air,
    diagnose_ball,
    diagnose_population,
    own_coefficient,
    read_areas_per_mass,
    read_drops,
)
from examples import tanks as two_tanks
from matplotlib.figure import Figure

from zoo.core.diagnosis import Diagnosis
from zoo.core.diagnosis.states import BASELINE, SEEN


def main(arguments: Sequence[str] | None = None) -> None:
    """Print lists or answers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--lists", action="store_true", help="SHA-256 of the lists of rivals, and nothing else"
    )
    parser.add_argument(
        "--cases",
        nargs="+",
        default=tuple(ANSWERS),
        help="these only",
    )
    parser.add_argument("--balls", nargs="+", help="these only")
    parser.add_argument("--figures", type=Path, help="a folder for a figure of each case")
    asked = parser.parse_args(arguments)
    if asked.lists:
        for case in CASES:
            print(case, list_digest(case))
        return
    try:
        for name in asked.cases:
            ANSWERS[name](asked)
    except DataError as error:
        sys.exit(str(error))


def _row(found: Diagnosis, name: str, known: str, asked: str) -> str:
    """What is known and what was found: the probability of what is asked for, and of the first three."""
    p = {one.name: one.probability for one in found.causes}
    first = ", ".join(f"{cause} {x:.0%}" for cause, x in list(p.items())[:3])
    group = GROUPS.get(asked, ())
    named = found.sets.posterior.included(lambda one: asked if one.name in group else one.name)
    state = found.file.states[0]
    leader = [one.error for one in state.carried if set(one.names) == set(found.file.sets[0].components)]
    later = [state.baseline, *(leader or [one.error for one in state.carried][:1])]
    nothing = next(row.probability for row in found.file.sets if not row.causes)
    return (
        f"| {name} | {known} | {named.get(asked, 0.0):.0%} | {first} | {nothing:.0%} | "
        f"{found.file.gap.before:.3f} | {found.file.gap.after:.3f} | "
        f"{' -> '.join(f'{one.mean:.3f}' for one in later)} | {'yes' if found.file.decided else 'no'} | "
        f"{found.file.record['solves']} | {found.file.record['seconds']:.0f} |"
    )


def learned(found: Diagnosis) -> str:
    """Name of what leads, or of the first cause if nothing does, among series of the first state held out."""
    state, leader = found.states[0], found.file.sets[0]
    fixed = next(
        (k for k, one in enumerate(state.file.carried) if set(one.names) == set(leader.components)), 0
    )
    return [name for name in state.computed if name not in (BASELINE, SEEN)][fixed]


def draw(found: Diagnosis, path: Path | None, time_unit: str = "s") -> None:
    """The record that was fitted and one that was not, by the base and with the leading causes."""
    if path is None:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    state, data = found.states[0], found.data
    pairs = [
        (f"{data.labels[0]}, fitted", data, *found.computed),
        (
            f"{state.file.state}, not fitted",
            state.data,
            state.computed[BASELINE],
            state.computed[learned(found)],
        ),
    ]
    figure = Figure(figsize=(8.0, 3.0), layout="constrained")
    for axes, (title, seen, base, best) in zip(figure.subplots(1, 2), pairs, strict=True):
        axes.plot(seen.times, seen.values[0], ".", color="#888888", ms=3, label="measured")
        axes.plot(seen.times, base[0], color="#C2410C", lw=1.2, label="base")
        axes.plot(seen.times, best[0], color="#1D4ED8", lw=1.2, label=f"with {' + '.join(found.cause)}")
        axes.set(title=title, xlabel=f"time ({time_unit})", ylabel=data.units[0])
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    figure.savefig(path, dpi=80)


HEAD = (
    "| {} | known | {} | first three | nothing | {} before | {} after | {} | decided | solves | "
    "s |\n|---|---|---|---|---|---|---|---|---|---|---|"
)


def balls(asked: argparse.Namespace) -> None:
    """Every ball that was dropped."""
    known = CASES["falling-balls"]["known"]
    dropped = read_drops(data_file("falling-balls"))
    print(HEAD.format("ball", "drag", "m", "m", "second drop, m"))
    for ball in asked.balls or dropped:
        found = diagnose_ball(*dropped[ball])
        told = known.get(ball, "open")
        print(_row(found, ball, told, "drag"), flush=True)
        draw(found, asked.figures and asked.figures / f"nature-{ball}.png")


def air(asked: argparse.Namespace) -> None:
    """What the air does to the balls that it is known to slow down, as a function of speed and as a law."""
    known, dropped = CASES["falling-balls"]["known"], read_drops(data_file("falling-balls"))
    laws = ("power", "saturation", "threshold", "sine", "sign")
    print(
        f"| ball | exponent | {' | '.join(laws)} | m before | m after | second drop, m |\n|---{'|---' * 9}|"
    )
    for ball in (one for one in dropped if known.get(one) == "drag"):
        found = diagnose_air(*dropped[ball])
        of = {law.name: law for law in found.components[0].functions[0].laws}
        low, high = of["power"].interval or (0.0, 0.0)
        [state] = found.file.states
        told = " | ".join(f"{of[name].probability:.0%}, leaves {of[name].left:.0%}" for name in laws)
        print(
            f"| {ball} | {of['power'].value:.2f} ({low:.2f} to {high:.2f}) | {told} | "
            f"{found.file.gap.before:.2f} | {found.file.gap.after:.3f} | "
            f"{state.baseline.mean:.2f} -> {state.carried[0].error.mean:.3f} |",
            flush=True,
        )


def population(asked: argparse.Namespace) -> None:
    """The first drop of every ball, all together: causes that act on all, of one size."""
    path = data_file("falling-balls")
    drops = {ball: every[0] for ball, every in read_drops(path).items()}
    areas = read_areas_per_mass(path.parent / "balls.csv")
    found = diagnose_population(drops, areas)
    print(found)
    print("| cause | probability | size |\n|---|---|---|")
    for cause in found.causes:
        told = ", ".join(f"{one.mean:.3g} ± {one.sd:.2g} {one.unit}" for one in cause.estimates)
        print(f"| {cause.name} | {cause.probability:.1%} | {told} |")
    print("| ball | m before | m after | coefficient of its own |\n|---|---|---|---|")
    for (ball, drop), one in zip(drops.items(), found.file.gap.per_series, strict=True):
        own = own_coefficient(drop, areas[ball])
        print(f"| {ball} | {one.before.mean:.2f} | {one.after.mean:.2f} | {own:.2f} |")
    told, most = found.file.record, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{told['solves']} solves of a ball, {told['seconds']:.0f} s, {most:.2f} GiB")


def river(asked: argparse.Namespace) -> None:
    """The Durance, and its snow beside the satellites'."""
    catchment = durance.Catchment.read(data_file("durance").parent)
    found = durance.diagnose_river(catchment)
    print(HEAD.format("river", "snow", "mm/d", "mm/d", "second half, mm/d"))
    print(_row(found, "Durance", "snow", "snow"))
    durance.tell_held_out(catchment, found)
    draw(found, asked.figures and asked.figures / "nature-durance.png", "d")


def pig(asked: argparse.Namespace) -> None:
    """The aorta's Windkessel, and by how much a record is late."""
    found = pig_aorta.diagnose_pig(data_file("pig-aorta").parent)
    print(HEAD.format("pig", "timing", "mmHg", "mmHg", "record 2, mmHg"))
    print(_row(found, "aorta", "timing", "timing"))
    draw(found, asked.figures and asked.figures / "nature-pig-aorta.png")
    for cause in found.causes:
        if cause.name in GROUPS["timing"] and cause.estimates:
            shift = cause.estimates[0]
            print(f"{cause.name}: {1e3 * shift.mean:.1f} +- {1e3 * shift.sd:.1f} ms, where it is")


def tanks(asked: argparse.Namespace) -> None:
    """Two tanks, the upper one of which overflows."""
    record = two_tanks.read(data_file("cascaded-tanks"))
    found = two_tanks.diagnosed(record)
    print(two_tanks.report(found, record))
    if asked.figures:
        asked.figures.mkdir(parents=True, exist_ok=True)
        two_tanks.figure(found, record, asked.figures / "nature-cascaded-tanks.png")


ANSWERS = {
    "falling-balls": balls,
    "population": population,
    "air": air,
    "durance": river,
    "pig-aorta": pig,
    "cascaded-tanks": tanks,
}


if __name__ == "__main__":
    main()
