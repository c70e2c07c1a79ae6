"""Sets of cases that ask for more than the catalogue: which component of the simulator is wrong.

- component: a cause in one component that no catalogue lists, as many of each.
- pair: causes of two components; neither's gap alone is more than 2.5 times the other's.
- small: two fifths listed effects, two fifths causes of a component, a fifth none; gaps of 0.3 to 3
  times the noise.
- quiet: as small, but gaps of 0.1 to 0.4 mmHg in one series at a noise of 0.003 mmHg, as in measured beats
  that were averaged.
- coloured: no effect; beside the white noise one of first order of 0.3 to 2 times its size, of 1 to 8 ms.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.blind.causes import COMPONENTS, of_component

from zoo.blood.blind import study_cases
from zoo.blood.blind.study_cases import (
    GAP_OVER_NOISE,
    WHITE_MMHG,
    Added,
    Bench,
    Cause,
    case_of,
    correlation,
    draw_bench,
    draw_listed,
    nothing,
    stream,
)
from zoo.blood.study_diagnosis import effects_for
from zoo.core.blindcheck import NULL, BlindError
from zoo.core.blindcheck.folders import MadeCase, write_cases

KINDS = ("component", "pair", "small", "quiet", "coloured")
LAYOUTS = ("MPA", "MPA+daughters", "MPA+distal", "MPA+flows")
SMALL = (0.3, 3.0)
QUIET, QUIET_MMHG = (0.1, 0.4), 0.003
COLOURED, COLOURED_S = (0.3, 2.0), (1e-3, 8e-3)
COMPARABLE = 2.5
DRAWS = 12
"""Sizes and shapes that are drawn of one cause before another is."""
BENCHES, PATIENCE = 20, 5
"""Networks and layouts to be tried, and those of them after which another component (pair) is."""
PLUS = "+"


@dataclass(frozen=True)
class Job:
    """A case to be made; `first` is "no-gap", a listed effect, or components joined by "+"."""

    kind: str
    secret: str
    layouts: tuple[str, ...]
    index: int
    first: str


def plan(kind: str, n: int, secret: str) -> list[str]:
    """What is first tried in each case: everything once before anything twice, in a shuffled order."""
    rng = stream(secret, kind, "plan")

    def names(known: Sequence[str], wanted: int) -> list[str]:
        rounds = -(-wanted // len(known))
        return [str(x) for _ in range(rounds) for x in rng.permutation(known)][:wanted]

    none, listed = (
        (n, 0)
        if kind == "coloured"
        else (round(n / 5), round(n * 2 / 5))
        if kind in ("small", "quiet")
        else (0, 0)
    )
    effects = [one.name for one in effects_for(study_cases.BASELINE)]
    pairs = [PLUS.join(two) for two in itertools.combinations(COMPONENTS, 2)]
    rest = names(pairs if kind == "pair" else COMPONENTS, n - none - listed)
    found = [NULL] * none + names(effects, listed) + rest
    return [found[i] for i in rng.permutation(n)]


def draw_cause(
    rng: np.random.Generator, bench: Bench, part: str, limits: tuple[float, float]
) -> Cause | None:
    """A cause in a component, of drawn size and shape; None if none has a gap (mmHg) in the limits."""
    causes = of_component(part)
    for i in rng.permutation(len(causes)):
        for _ in range(DRAWS):
            effect, size, shape = causes[int(i)].draw(rng)
            added: Added = ((effect.at(), (size,)),)
            waves = bench.solve(added)
            gap = bench.gap(waves)
            if waves is not None and limits[0] <= gap <= limits[1]:
                told = {"shapes": {effect.name: shape}}
                return Cause("component", effect.name, (), (part,), added, waves, gap, told)
    return None


def draw_pair(
    rng: np.random.Generator, bench: Bench, parts: Sequence[str], limits: tuple[float, float]
) -> Cause | None:
    """Causes in two components whose gaps are comparable, each and together in the limits."""
    for _ in range(PATIENCE):
        one = draw_cause(rng, bench, parts[0], limits)
        if one is None:
            return None
        near = max(limits[0], one.gap / COMPARABLE), min(limits[1], one.gap * COMPARABLE)
        two = draw_cause(rng, bench, parts[1], near)
        if two is None:
            continue
        added = (*one.added, *two.added)
        waves = bench.solve(added)
        gap = bench.gap(waves)
        if waves is not None and limits[0] <= gap <= limits[1]:
            told = {"shapes": {**one.drawn["shapes"], **two.drawn["shapes"]}}
            return Cause("pair", PLUS.join((one.label, two.label)), (), tuple(parts), added, waves, gap, told)
    return None


def draw_truth(
    job: Job, noises: np.random.Generator
) -> tuple[Bench, Cause, tuple[float, float], dict[str, str]]:
    """A study, what is wrong with it, size and time of its correlated noise, and its tags.

    Raises
    ------
    BlindError
        If no cause that was drawn has a gap of the size that is wanted.
    """
    network, effects = (stream(job.secret, job.kind, x, job.index) for x in ("network", "effect"))
    correlated, first = correlation(noises), job.first
    if job.kind == "coloured":
        size, tau = (math.exp(noises.uniform(*np.log(x))) for x in (COLOURED, COLOURED_S))
        correlated = float(f"{WHITE_MMHG * size:.6g}"), float(f"{tau:.6g}")
    noise = math.hypot(WHITE_MMHG, correlated[0])
    low, high = (x * noise for x in (SMALL if job.kind == "small" else GAP_OVER_NOISE))
    layouts = job.layouts
    if job.kind == "quiet":
        (low, high), correlated, layouts = QUIET, (0.0, 1.0), ("MPA",)
    for tried in range(BENCHES):
        parts = first.split(PLUS)
        if tried and tried % PATIENCE == 0 and parts[0] in COMPONENTS:
            parts = [COMPONENTS[int(i)] for i in np.sort(effects.permutation(len(COMPONENTS))[: len(parts)])]
            first = PLUS.join(parts)
        bench, tags = draw_bench(network, f"case-{job.index + 1:03d}", layouts=layouts)
        if job.kind == "quiet":
            bench.sigma[:] = QUIET_MMHG
        cause: Cause | None = nothing(bench)
        if first != NULL and parts[0] not in COMPONENTS:
            names = (first, *(one.name for one in effects_for(study_cases.BASELINE)))
            cause = draw_listed(effects, bench, names, (low, high))
        elif first != NULL:
            draw: Any = (
                draw_pair if len(parts) == 2 else lambda rng, b, p, limits: draw_cause(rng, b, p[0], limits)
            )
            cause = draw(effects, bench, parts, (low, high))
        if cause is not None:
            return bench, cause, correlated, tags
    raise BlindError(
        f"case {job.index + 1}: no cause that was drawn has a gap of {low:.2g} to {high:.2g} mmHg"
    )


def draw_case(job: Job) -> MadeCase:
    """Draw a case: its files, and its entry of the key."""
    noises = stream(job.secret, job.kind, "noise", job.index)
    bench, cause, correlated, tags = draw_truth(job, noises)
    return case_of(bench, cause, noises, correlated, tags)


def make_set(
    folder: Path,
    key: Path,
    kind: str,
    n: int,
    secret: str,
    layouts: Sequence[str] = LAYOUTS,
    cores: int = 2,
) -> None:
    """Write a set of a kind, and its key; the same secret makes the same cases."""
    jobs = [Job(kind, secret, tuple(layouts), i, first) for i, first in enumerate(plan(kind, n, secret))]
    head = {"kind": kind, "n": n, "secret": secret, "layouts": list(layouts)}
    write_cases(folder, key, jobs, draw_case, head=head, cores=cores)
