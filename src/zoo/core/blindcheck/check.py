"""The blind check of any simulator: draw cases, diagnose them without their truth, score the answers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.blindcheck.answers import Answer, as_answer
from zoo.core.blindcheck.check_score import CheckScore, score_answers
from zoo.core.blindcheck.keys import CaseKey, TrueEffect
from zoo.core.blindcheck.sealing import BlindError
from zoo.core.diagnosis.hypothesis import NONPARAMETRIC, NULL
from zoo.core.effects import EVERYWHERE, Location
from zoo.core.inference.workers import each


@dataclass(frozen=True)
class DrawnCase:
    """Data that someone's simulator made, and what a diagnosis of them is not told.

    Parameters
    ----------
    data : object
        What the diagnosis is given.
    amplitude : float, optional
        Of the effect, in the unit of its first parameter; None for no effect or no stated size.
    location : Location
        Where the effect acts.
    noise : float, optional
        Standard deviation of the noise.
    before : float, optional
        Model discrepancy of the refitted baseline, as in `CaseKey`.
    truth : array (n_series, n_times), optional
        The data without noise; what a diagnosis states of the discrepancy is compared with it.
    prior : (float, float), optional
        Central 95 % interval of the prior of the amplitude.
    tags : mapping of str to str
        What else the scores should be grouped by.
    """

    data: Any
    amplitude: float | None = None
    location: Location = EVERYWHERE
    noise: float = math.nan
    before: float = math.nan
    truth: NDArray[np.float64] | None = None
    prior: tuple[float, float] | None = None
    tags: Mapping[str, str] = field(default_factory=dict)


DrawCase = Callable[[str, np.random.Generator], DrawnCase]


def draw_cases(
    draw_case: DrawCase, counts: Mapping[str, int], listed: Sequence[str], seed: int = 1
) -> tuple[dict[str, Any], list[CaseKey]]:
    """Draw cases in a shuffled order, and part their data from their key.

    Parameters
    ----------
    draw_case, counts, listed, seed
        As in `check`.

    Returns
    -------
    data : dict
        Name of the case -> what the diagnosis is given.
    key : list of CaseKey

    Raises
    ------
    BlindError
        If there is nothing to draw, or a label is "unlisted".
    """
    if min(counts.values(), default=0) < 0 or not sum(counts.values()) or seed < 0:
        raise BlindError(
            f"counts = {dict(counts)}, seed = {seed}: give numbers of cases, and a seed from 0 on"
        )
    if NONPARAMETRIC in (*counts, *listed):
        raise BlindError(
            f"{NONPARAMETRIC!r} is an answer and no cause; give a cause that is not listed its name"
        )
    labels = [label for label, n in counts.items() for _ in range(n)]
    labels = [labels[i] for i in np.random.default_rng(seed).permutation(len(labels))]
    data, key = {}, []
    for i, label in enumerate(labels):
        drawn = draw_case(label, np.random.default_rng([seed, i]))
        name = f"case-{i + 1:03d}"
        data[name] = drawn.data
        kind = "none" if label == NULL else "listed" if label in listed else "outside"
        effects = () if kind == "none" else (TrueEffect(label, drawn.location, drawn.amplitude, drawn.prior),)
        key.append(
            CaseKey(name, kind, label, effects, drawn.noise, drawn.before, drawn.truth, tags=drawn.tags)
        )
    return data, key


@dataclass(frozen=True)
class _Diagnosing:
    """One diagnosis of named data: its answer, or why there is none."""

    diagnose: Callable[[Any], Any]

    def __call__(self, job: tuple[str, Any]) -> Answer | str:
        try:
            return as_answer(self.diagnose(job[1]))
        except Exception as error:
            return f"{type(error).__name__}: {error}"


def check(
    draw_case: DrawCase,
    diagnose: Callable[[Any], Any],
    counts: Mapping[str, int],
    *,
    listed: Sequence[str],
    seed: int = 1,
    cores: int = 1,
    executor: Executor | None = None,
    by: Sequence[str] = ("kind", "effect"),
    gap_edges: Sequence[float] = (0.0, math.inf),
    done: Callable[[str], None] = lambda case: None,
) -> CheckScore:
    """Check a diagnosis on cases whose cause it is not told.

    The cases are drawn first, their causes are kept apart, and the diagnosis is given each case's data and
    nothing else, in a shuffled order.

    Parameters
    ----------
    draw_case : callable
        ``draw_case(label, rng) -> DrawnCase`` makes the data of a case with that cause; all that is random
        comes from `rng`, which is another one for each case.
    diagnose : callable
        ``diagnose(data)`` gives an `Answer`, or a diagnosis of `zoo.core.diagnosis`. One that raises an
        exception counts as no answer.
    counts : mapping of str to int
        Label -> how many cases: names of effects, "no-gap" for no effect, any other name for a cause that
        the diagnosis does not know.
    listed : sequence of str
        Effects that the diagnosis knows; any other label counts as outside.
    seed : int
        The same seed gives the same cases.
    cores : int
        Processes; with more than one, `diagnose` and the data must be picklable.
    executor : concurrent.futures.Executor, optional
        Runs the cases instead, as in `zoo.core.inference.workers.each`.
    by, gap_edges
        What to group the scores by, as in `assemble`.
    done : callable
        Told the name of each case that is diagnosed.

    Returns
    -------
    CheckScore
        ``print(score)`` shows the rates; ``score.summary`` has them as numbers, `score_table` as Markdown.

    Raises
    ------
    BlindError
        If an argument cannot be used, or no case at all could be diagnosed.

    Examples
    --------
    >>> def draw_case(label, rng):
    ...     slope = {"no-gap": 0.0, "drift": 1.0, "step": 0.0}[label]
    ...     jump = 1.0 if label == "step" else 0.0
    ...     t = np.linspace(-1, 1, 100)
    ...     return DrawnCase(slope * t + jump * (t > 0) + 0.01 * rng.standard_normal(100), amplitude=slope)
    >>> def diagnose(data):
    ...     p = 0.98 if abs(data[-1] - data[50]) > 0.5 else 0.02 if data.std() < 0.1 else 0.1
    ...     rest = ("unlisted", "no-gap") if data.std() > 0.1 else ("no-gap", "unlisted")
    ...     found = {"drift": p, rest[0]: 0.99 - p, rest[1]: 0.01}
    ...     return Answer.ranked(found)
    >>> print(check(draw_case, diagnose, {"drift": 2, "no-gap": 1, "step": 1}, listed=["drift"]))
    4 cases, 0 without an answer; in the last column the best constant answer
    what is true or its group ranked first, any kind  100 % (4 of 4; 51 to 100 %)  50 % (always drift)
    true effect or its group ranked first             100 % (2 of 2; 34 to 100 %)  100 % (always drift)
    true effect ranked first                          100 % (2 of 2; 34 to 100 %)  100 % (always drift)
    no-effect cases with a discrepancy found          0 % (0 of 1; 0 to 79 %)      0 % (always no-gap)
    outside cases called unlisted or left open        100 % (1 of 1; 21 to 100 %)  100 % (always unlisted)
    """
    if cores < 1:
        raise BlindError(f"cores = {cores}: must be at least 1")
    data, key = draw_cases(draw_case, counts, listed, seed)
    answers: dict[str, Answer | None] = {}
    failed: dict[str, str] = {}
    for (name, _), found in each(
        _Diagnosing(diagnose), list(data.items()), cores, executor=executor, name=lambda case: case[0]
    ):
        if isinstance(found, str):
            failed[name] = found
        answers[name] = None if isinstance(found, str) else found
        done(name)
    if len(failed) == len(data):
        raise BlindError(f"no case could be diagnosed; the first: {failed[key[0].case]}")
    return score_answers(key, answers, by=by, gap_edges=gap_edges, failed=dict(sorted(failed.items())))
