"""The blind check of any simulator: draw cases, diagnose them without their truth, score the answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from functools import partial
from typing import Any

import numpy as np

from zoo.core.blindcheck.cases import NULL, Answer, BlindError, CaseKey, as_answer
from zoo.core.blindcheck.drawing import DrawnCase
from zoo.core.blindcheck.scoring import Score, score_answers
from zoo.core.inference.workers import each


def draw_cases(
    draw: Callable[[str, np.random.Generator], DrawnCase],
    counts: Mapping[str, int],
    listed: Sequence[str],
    seed: int = 1,
) -> tuple[dict[str, Any], list[CaseKey]]:
    """Draw cases in a shuffled order, and part their data from their key; arguments are `blind_check`'s.

    Returns
    -------
    data : dict
        Name of the case -> what the diagnosis is given.
    keys : list of CaseKey

    Raises
    ------
    BlindError
        If there is nothing to draw.
    """
    if min(counts.values(), default=0) < 0 or not sum(counts.values()) or seed < 0:
        raise BlindError(
            f"counts = {dict(counts)}, seed = {seed}: give numbers of cases, and a seed from 0 on"
        )
    labels = [label for label, n in counts.items() for _ in range(n)]
    labels = [labels[i] for i in np.random.default_rng(seed).permutation(len(labels))]
    data, keys = {}, []
    for i, label in enumerate(labels):
        drawn = draw(label, np.random.default_rng([seed, i]))
        kind = "none" if label == NULL else "listed" if label in listed else "outside"
        accepted = (label,) if kind == "listed" else ()
        told = {"case": f"case-{i + 1:03d}", "kind": kind, "label": label, "accepted": accepted}
        keys.append(CaseKey(**(told | dict(drawn.withheld))))
        data[keys[-1].case] = drawn.data
    return data, keys


def _diagnosed(diagnose: Callable[[Any], Any], job: tuple[str, Any]) -> Answer | str:
    """The answer to named data, or why there is none."""
    try:
        return as_answer(diagnose(job[1]))
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def blind_check(
    draw: Callable[[str, np.random.Generator], DrawnCase],
    diagnose: Callable[[Any], Any],
    counts: Mapping[str, int],
    *,
    listed: Sequence[str],
    seed: int = 1,
    cores: int = 1,
    executor: Executor | None = None,
    by: Sequence[str] = ("kind", "label"),
    done: Callable[[str], None] = lambda case: None,
) -> Score:
    """Check a diagnosis on cases whose cause it is not told.

    The cases are drawn first, their causes are kept apart, and the diagnosis is given each case's data and
    nothing else, in a shuffled order.

    Parameters
    ----------
    draw : callable
        ``draw(label, rng) -> DrawnCase`` makes the data of a case with that cause; all that is random comes
        from `rng`, which is another one for each case. `ModelDraw` does so for any forward model.
    diagnose : callable
        ``diagnose(data)`` gives an `Answer`, or a diagnosis of `zoo.core.diagnosis`. One that raises an
        exception counts as no answer.
    counts : mapping of str to int
        Label -> how many cases: names of effects, "no-gap" for no effect, any other name for a cause that
        the diagnosis does not know.
    listed : sequence of str
        Effects that the diagnosis knows; any other label counts as outside: unless the case tells the
        components that it lies in, nothing that the diagnosis can name is right.
    seed : int
        The same seed gives the same cases.
    cores, executor
        As in `zoo.core.inference.workers.each`; with more than one process, `diagnose` and the data must be
        picklable.
    by : sequence of str
        What to group the scores by: "kind", "label", or a tag that all cases have.
    done : callable
        Told the name of each case that is diagnosed.

    Returns
    -------
    Score
        ``print(score)`` shows it beside the best constant answers; ``score.summary`` has it as numbers,
        `score_table` as Markdown.

    Raises
    ------
    BlindError
        If an argument cannot be used, or no case at all could be diagnosed.

    Examples
    --------
    >>> def draw(label, rng):
    ...     slope = {"no-gap": 0.0, "drift": 1.0, "step": 0.0}[label]
    ...     jump = 1.0 if label == "step" else 0.0
    ...     t = np.linspace(-1, 1, 100)
    ...     return DrawnCase(slope * t + jump * (t > 0) + 0.01 * rng.standard_normal(100))
    >>> def diagnose(data):
    ...     p = 0.98 if abs(data[-1] - data[50]) > 0.5 else 0.02
    ...     return Answer.ranked({"drift": p, "no-gap": 1 - p})
    >>> print(blind_check(draw, diagnose, {"drift": 2, "no-gap": 1, "step": 1}, listed=["drift"]))
    4 cases, 0 without an answer                                                   best constant answer
    components that are wrong: log score            -0.020 ± 0.000               -0.693
    components that are wrong: Brier score          0.000 ± 0.000                0.250
    that nothing is wrong: log score                -0.020 ± 0.000               -0.693
    that nothing is wrong: Brier score              0.000 ± 0.000                0.250
    listed effects, where one is true: log score    -0.020 ± 0.000               0.000
    listed effects, where one is true: Brier score  0.000 ± 0.000                0.000
    listed effects, alike ones as one: log score    -0.020 ± 0.000               0.000
    listed effects, alike ones as one: Brier score  0.000 ± 0.000                0.000
    most probable is right, a component or nothing  100 % (4 of 4; 51 to 100 %)  50 % (always drift)
    nothing wrong, and a component above 50 %       0 % (0 of 2; 0 to 66 %)      0 %
    components above 90 % that are wrong indeed     100 % (2 of 2; 34 to 100 %)  –
    """
    if cores < 1:
        raise BlindError(f"cores = {cores}: must be at least 1")
    data, keys = draw_cases(draw, counts, listed, seed)
    answers: dict[str, Answer | None] = {}
    failed: dict[str, str] = {}
    work = partial(_diagnosed, diagnose)
    with closing(
        each(work, list(data.items()), cores, executor=executor, name=lambda job: job[0])
    ) as results:
        for (name, _), found in results:
            if isinstance(found, str):
                failed[name] = found
            answers[name] = None if isinstance(found, str) else found
            done(name)
    if len(failed) == len(data):
        raise BlindError(f"no case could be diagnosed; the first: {failed[keys[0].case]}")
    return score_answers(keys, answers, by=by, failed=dict(sorted(failed.items())))
