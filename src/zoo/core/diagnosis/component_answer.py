"""The components of a simulator in the answer of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.core.diagnosis.components.heldout import predict_held_out
from zoo.core.diagnosis.components.learned import Judge, functions_of, plausible
from zoo.core.diagnosis.components.likeness import left_of, nearest_effects, principal_angles
from zoo.core.diagnosis.components.refining import Component
from zoo.core.diagnosis.components.shares import pair_of, shares_of
from zoo.core.diagnosis.components.subsets import Several
from zoo.core.diagnosis.estimates import INTERVAL
from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.file import (
    ComponentResult,
    HeldOutComponentResult,
    Interval,
    NearestEffect,
    SeveralResult,
)
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, NULL
from zoo.core.diagnosis.scoring import SENSOR, TOO_FAR, VISIBLE, Scored

Array = NDArray[np.float64]

HELD_OUT = 2
"""Components, the most probable first, that predict data held out."""


def ranked(scored: Scored) -> list[str]:
    """Components with functions of their own, the most probable first."""
    total = scored.of_component
    return sorted(scored.components, key=lambda n: (-total[n], -scored.log_z[n]))


def leading_fit(scored: Scored, component: str) -> Fit:
    """The most probable explanation by a component: its own function, or a listed effect of it."""
    own = [n for n, c in scored.belongs.items() if c == component and n in scored.locations]
    return scored.best[max([component, *own], key=scored.standing)]


def groups(scored: Scored, S: Array) -> dict[str, int]:
    """Components that these series cannot tell apart have one number; the most probable gives it.

    One is in the group of a more probable one if it could draw that one's signal to within the noise, and its
    evidence is not far behind.
    """
    found: dict[str, int] = {}
    leaders: list[str] = []
    base, explained = scored.screened.base, scored.explained
    if explained is None:
        return found
    evidence = {
        name: max(
            [scored.log_z[name]]
            + [scored.log_z[n] for n, c in scored.belongs.items() if c == name and n in scored.locations]
        )
        for name in scored.components
    }
    for name in ranked(scored):
        for other in leaders:
            signal = leading_fit(scored, other).computed - base.computed
            moved = 0.5 * float(np.sum(signal**2 / S)) > VISIBLE
            near = abs(evidence[name] - evidence[other]) < TOO_FAR
            if moved and near and left_of(signal, scored.components[name], explained.linearised, S) < VISIBLE:
                found[name] = found[other]
                break
        else:
            found[name] = len(leaders)
            leaders.append(name)
    return found


def _beside_each_other(
    scored: Scored, group: str, unit: str, seed: int
) -> tuple[dict[str, Interval], dict[str, HeldOutComponentResult], tuple[str, ...]]:
    """Shares of the gap, all together, what the leading ones predict of data held out, and several causes."""
    explained = scored.explained
    if explained is None or scored.leader in (NULL, CORRELATED):
        return {}, {}, ()
    order = ranked(scored)
    clean = {q: replace(e, delta=0.0) for q, e in scored.components[order[0]].best.learned.noise.items()}
    noise = clean if scored.leader in scored.components else dict(scored.screened.noise)
    around = scored.pair.around if scored.pair else explained.linearised
    problem = replace(around, noise=noise)
    found = shares_of(problem, group=group, seed=seed)
    draws = dict(zip(found.names, found.draws.T, strict=True))
    if SENSOR in draws:
        draws[SENSOR] = draws[SENSOR] + draws[NONPARAMETRIC]
    shares = {
        name: Interval(mean=float(x.mean()), low=float(np.quantile(x, INTERVAL[0])),
                       high=float(np.quantile(x, INTERVAL[1])))
        for name, x in draws.items()
    }  # fmt: skip
    asked = [(name,) for name in order[:HELD_OUT]]
    predicted = predict_held_out(problem, group, asked, seed=seed)
    held = {
        name: HeldOutComponentResult(
            baseline=predicted.baseline,
            sensor=predicted.sensor,
            component=predicted.components[(name,)],
            found=predicted.found(name),
            what=predicted.what,
            unit=unit,
        )
        for (name,) in asked
    }
    several = scored.pair.names if scored.pair else pair_of(found)
    return shares, held, several if len(several) > 1 else ()


def component_results(
    scored: Scored,
    gap_after: Mapping[str, Interval],
    unit: str,
    group_asked: str,
    judge: Judge | None = None,
    seed: int = 1,
) -> list[ComponentResult]:
    """Each component with its probability, what it leaves, and what was learned of it.

    Parameters
    ----------
    scored : Scored
    gap_after : mapping of component to Interval
        The discrepancy that its best function leaves.
    unit : str
        Of the discrepancy.
    group_asked : str
        Group of series that the verdict is about.
    judge : callable, optional
        Whether learned values can be believed, as in `Hooks`.
    seed : int
        Of draws.

    Returns
    -------
    list of ComponentResult
        The most probable first; empty where no components were weighed.
    """
    explained = scored.explained
    if explained is None:
        return []
    screened = scored.screened
    S = screened.screening.beside(screened.noise, screened.screening.numerics())
    group, total = groups(scored, S), scored.of_component
    angles = principal_angles(explained, S)
    shares, held, several = _beside_each_other(scored, group_asked, unit, seed)
    effects = {
        name: [screened.fits[h] for h in hypotheses if h in screened.fits]
        for name, hypotheses in screened.screening.hypotheses.items()
    }
    found = []
    for name in ranked(scored):
        component = scored.components[name]
        after = gap_after[name]
        if scored.pair and name == scored.pair.second.function.component:
            component = Component(name, (scored.pair.second,))  # what it is beside the other
        best = component.best
        near = nearest_effects(best, effects, explained.linearised, S)
        found.append(
            ComponentResult(
                name=name,
                probability=total[name],
                own_probability=scored.standing(name),
                log_evidence=scored.log_z[name],
                log10_bayes_factor=(scored.log_z[name] - scored.log_z[NULL]) / math.log(10.0),
                group=group[name],
                share=shares.get(name),
                one_of_several=name in several,
                together={
                    next(n for n in pair.names if n != name): p
                    for pair, p in scored.pairs
                    if name in pair.names
                },
                held_out=held.get(name),
                gap_after=after.mean,
                gap_after_interval=(after.low, after.high),
                unit=unit,
                plausible=plausible(best, judge),
                functions=functions_of(component),
                nearest_effects=[NearestEffect(name=n, share=s, opposite_sign=o) for n, s, o in near],
                angles=angles[name],
                refined=best.refined,
            )
        )
    return found


def several_result(several: Several | None) -> SeveralResult | None:
    """The best set of several listed effects as diagnosis.json has it; None where none was searched."""
    if several is None or not several.fits:
        return None
    return SeveralResult(
        names=[one.name for one in several.fits[0].hypothesis.added],
        log_odds=several.gain,
        log_bayes_factor=several.log_bayes_factor,
        weighed=several.subsets.weighed,
    )
