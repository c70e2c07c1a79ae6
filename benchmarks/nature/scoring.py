"""Scores a method on records of which the cause is known: from record, simulator and rivals to probabilities.

    from benchmarks.nature.scoring import balls, score
    print(score(lambda case: {("quadratic-drag",): 0.7, (): 0.3}, balls()))

A method states the probability of sets of causes, () for none; what it leaves out has none. A case's score is
the logarithm of what it gives to the sets that hold one of the right causes, or to () where nothing is wrong,
without a floor.
`even` is the constant answer to compare with, and `by_zoo` zoo's own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from benchmarks.nature import CASES, GROUPS, data_file, durance, falling_balls, pig_aorta
from examples import tanks as two_tanks
from numpy.typing import NDArray

import zoo

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """A record with its simulator and rivals, and the causes of which any is right; none of them if empty."""

    name: str
    times: Array
    measured: Array
    simulate: Callable[[Mapping[str, Any], Array], Array]
    priors: Mapping[str, Any]
    rivals: Sequence[Any]
    right: tuple[str, ...]

    def probability(self, stated: Mapping[tuple[str, ...], float]) -> float:
        """Stated probability (1) of what is right.

        Raises
        ------
        ValueError
            If a rival is not of this case, or the probabilities are none.
        """
        names = {one.name for one in self.rivals}
        for causes, p in stated.items():
            if strange := set(causes) - names:
                raise ValueError(
                    f"{self.name}: {min(strange)} is none of its rivals: {', '.join(sorted(names))}"
                )
            if not 0.0 <= p <= 1.0:
                raise ValueError(f"{self.name}: {causes} has {p}: give a probability from 0 to 1")
        if not math.isclose(total := math.fsum(stated.values()), 1.0, abs_tol=1e-6):
            raise ValueError(f"{self.name}: the probabilities of its sets add up to {total:.6g}: make it 1")
        right = set(self.right)
        return math.fsum(p for causes, p in stated.items() if (right & set(causes) if right else not causes))


Method = Callable[[Case], Mapping[tuple[str, ...], float]]


def balls() -> Iterator[Case]:
    """Falling balls of which the cause is known."""
    of, known = falling_balls, CASES["falling-balls"]["known"]
    for ball, drops in of.read_drops(data_file("falling-balls")).items():
        if ball in known:
            yield Case(ball, *drops[0], of.fall, of.PRIORS, of.RIVALS, GROUPS[known[ball]])


def river() -> Iterator[Case]:
    """First years of the Durance."""
    here = durance.Catchment.read(data_file("durance").parent)
    record = here.series(durance.FIRST, durance.HELD_OUT)
    yield Case("durance", *record, here.simulator(), durance.PRIORS, durance.RIVALS, ("snow",))


def pig() -> Iterator[Case]:
    """Mean beat of a pig's aorta."""
    of = pig_aorta
    period, times, pressure, flow = of.mean_beat(data_file("pig-aorta").parent, 1)
    yield Case(
        "pig-aorta", times, pressure, of.windkessel(period, flow), of.PRIORS, of.RIVALS, GROUPS["timing"]
    )


def tanks() -> Iterator[Case]:
    """Level of the lower one of two tanks."""
    record = two_tanks.read(data_file("cascaded-tanks"))
    model = two_tanks.tanks(record["uEst"])
    priors = {one.name: one for one in model.parameters}
    at, right = two_tanks.times(len(record["yEst"])), (CASES["cascaded-tanks"]["known"]["cascaded-tanks"],)
    yield Case("cascaded-tanks", at, record["yEst"], model.function, priors, two_tanks.EFFECTS, right)


def known_cases() -> Iterator[Case]:
    """All records of which the cause is known."""
    yield from balls()
    yield from river()
    yield from pig()
    yield from tanks()


def even(case: Case) -> dict[tuple[str, ...], float]:
    """The constant answer: nothing and each rival alone are as probable as each other."""
    sets = [(), *((one.name,) for one in case.rivals)]
    return dict.fromkeys(sets, 1.0 / len(sets))


def by_zoo(case: Case) -> dict[tuple[str, ...], float]:
    """Zoo's diagnosis, without what is held out."""
    found = zoo.diagnose(case.times, case.measured, case.simulate, case.priors, case.rivals)
    return {tuple(row.causes): row.probability for row in found.file.sets}


def score(method: Method, cases: Iterable[Case] | None = None) -> pd.DataFrame:
    """Score a method, beside the constant answer.

    Parameters
    ----------
    method : callable
        From a case to the probability of each set of causes.
    cases : iterable of Case, optional
        All that are known.

    Returns
    -------
    pandas.DataFrame
        A row a case: its right causes, their stated probability, its logarithm, and the constant answer's.

    Raises
    ------
    ValueError
        If the method names a rival that is none, or its probabilities are not.
    DataError
        If a record is not in ZOO_DATA_DIR.
    """
    rows = []
    for case in known_cases() if cases is None else cases:
        p, constant = case.probability(method(case)), case.probability(even(case))
        log_p = math.log(p) if p > 0.0 else -math.inf
        rows.append((case.name, " or ".join(case.right) or "none", p, log_p, math.log(constant)))
    return pd.DataFrame(rows, columns=["case", "right", "probability", "log_score", "log_score_of_even"])
