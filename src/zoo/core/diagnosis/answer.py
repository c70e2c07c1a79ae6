"""The answer of a diagnosis as sums over the posterior of sets of causes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.arrays import rms_of
from zoo.core.causes.evidence import SIZE_PRIORS
from zoo.core.causes.posterior import CausePosterior
from zoo.core.causes.reference import Reference
from zoo.core.causes.set_priors import ODDS
from zoo.core.diagnosis.cautions import cautions, lifted_bounds, rounded, undecided
from zoo.core.diagnosis.discrepancies import (
    CauseDraws,
    Discrepancy,
    SetDraws,
    discrepancies,
    draw_causes,
    draw_set,
    estimate_of,
    interval_of,
    together,
)
from zoo.core.diagnosis.file import (
    CauseResult,
    ComponentResult,
    DiagnosisFile,
    Estimate,
    ExcludedFit,
    Gap,
    Interval,
    LearnedFunction,
    LocationShare,
    NextMeasurement,
    SensitivityRow,
    SeriesGap,
    SetResult,
    Where,
)
from zoo.core.diagnosis.heldout import hold_out
from zoo.core.diagnosis.hooks import Hooks
from zoo.core.diagnosis.laws import simple_laws
from zoo.core.diagnosis.sets import CauseSets
from zoo.core.diagnosis.solved import Which
from zoo.core.diagnosis.wording import worded
from zoo.core.effects import Location
from zoo.core.forward import Outputs

Array = NDArray[np.float64]

LEAST = 1e-6
"""Probability of the least probable set of the table, over which all probabilities are normalised."""
TOLD = 1e-3
"""Least probability of a cause or place that is told."""
DOUBT = 0.01
"""Least probability of a rival that a next measurement is to rule out."""
CONFOUNDED = 3.0
"""Log evidence that a cause may lose in place of another, on data that this predicts, to be confounded."""
MAX_HARMONIC = 10
"""Harmonics whose shares are told one by one."""


def table_of(found: CauseSets, about: Sequence[str]) -> tuple[list[SetResult], dict[Which, float]]:
    """The table of sets, most probable first, and their probabilities normalised over it.

    Parameters
    ----------
    found : CauseSets
    about : sequence of str
        Groups, of one unit, whose gap is told.
    """
    posterior = found.posterior
    told = ((), found.leader)  # however improbable
    kept = {w: p for w, p in posterior.probability.items() if p >= LEAST or w in told}
    total, rows = sum(kept.values()), []
    family = found.search.family
    noise = min(found.noise[g] / family.ranges[g] for g in family.groups)
    negligible = posterior.negligible(noise, SIZE_PRIORS.numerics)
    for which, p in kept.items():
        log_prior, solved = posterior.priors.log_prior(which), which in found.solved
        rows.append(
            SetResult(
                causes=[posterior.causes[i].label for i in which],
                names=[posterior.causes[i].name for i in which],
                components=list(found.components(which)),
                log_prior=log_prior,
                log_evidence=posterior.log_joint[which] - log_prior,
                log_evidence_error=found.error(which),
                probability=p / total,
                solved=solved,
                gap_after=found.gap_after(which, about) if solved else None,
                negligible=None if which else negligible,
                unit=found.search.fitting.data.unit(about[0]),
            )
        )
    return rows, {which: p / total for which, p in kept.items()}


def _gap(found: CauseSets, before: Discrepancy, after: Discrepancy, rows: list[int]) -> Gap:
    data = found.search.fitting.data

    def series_gap(series: str, own: list[int]) -> SeriesGap:
        return SeriesGap(
            series=series,
            unit=data.units[own[0]],
            before=before.interval(own),
            after=after.interval(own),
            noise_floor=rms_of(np.array([found.noise[data.groups[i]] for i in own])),
            residual_rms_before=rms_of(before.residual[own]),
            residual_rms_after=rms_of(after.residual[own]),
        )

    whole, removed, held = series_gap("", rows), Interval(mean=0.0, low=0.0, high=0.0), None
    if found.leader:
        size = max(whole.before.mean, 1e-300)
        removed = interval_of(1.0 - after.rms(rows) / size, after.weights)
        held = hold_out(found, rows)
    held_before, held_after, held_out = held or (None, None, "")
    return Gap(
        **whole.model_dump(exclude={"series", "before", "after"}),
        before=whole.before.mean,
        before_interval=(whole.before.low, whole.before.high),
        after=whole.after.mean,
        after_interval=(whole.after.low, whole.after.high),
        removed=removed.mean,
        removed_interval=(removed.low, removed.high),
        held_out_before=held_before,
        held_out_after=held_after,
        held_out_removed=(1.0 - held[1] / held[0] if held[0] > 0 else 0.0) if held else None,
        held_out=held_out,
        per_series=[series_gap(label, [i]) for i, label in enumerate(data.labels)],
    )


def _where(found: CauseSets, p: dict[Which, float], d: Discrepancy, hooks: Hooks) -> Where:
    data, errors = found.search.fitting.data, found.search.family.errors
    rows = hooks.rows(data)
    energy = np.nan_to_num(d.mean) ** 2
    total = float(energy[rows].sum()) or 1.0
    names, phase = hooks.phases_of(data, rows)
    power = np.zeros(int(errors.k.max()) + 1)
    np.add.at(power, errors.k, np.sum(errors.transform(d.mean)[rows] ** 2, axis=0))
    power /= float(power.sum()) or 1.0
    by_harmonic = {str(k): float(power[k]) for k in range(min(MAX_HARMONIC + 1, len(power)))}
    by_harmonic[f"above {MAX_HARMONIC}"] = float(power[MAX_HARMONIC + 1 :].sum())
    return Where(
        series={data.labels[i]: float(energy[i].sum()) / total for i in rows},
        phase={name: float(energy[rows][:, phase == i].sum()) / total for i, name in enumerate(names)},
        harmonic=by_harmonic,
        place=_places(found, p, range(len(found.posterior.causes))),
    )


def _places(found: CauseSets, p: dict[Which, float], causes: Sequence[int]) -> list[LocationShare]:
    """Probability that one of some listed effects is there, at each of its places."""
    asked, shares = set(causes), dict[Location, float]()
    for which, x in p.items():
        at = {found.search.origins[i].added for i in which if i in asked}
        for location in {one.location for one in at if one is not None}:
            shares[location] = shares.get(location, 0.0) + x
    noun = next((at.noun for at in shares if at.noun), "part")
    return [
        LocationShare(part=at.part, subtree=at.subtree, probability=x, noun=noun)
        for at, x in sorted(shares.items(), key=lambda item: -item[1])
        if x >= TOLD
    ]


def _holding(found: CauseSets, p: dict[Which, float], names: set[str], of: str) -> float:
    """Probability of the sets that hold a cause or component of some names."""
    causes = found.posterior.causes
    return math.fsum(x for which, x in p.items() if any(getattr(causes[i], of) in names for i in which))


def _causes(found: CauseSets, p: dict[Which, float], draws: CauseDraws) -> list[CauseResult]:
    posterior, rows = found.posterior, []
    prior = posterior.priors.inclusion()
    for name in dict.fromkeys(one.name for one in posterior.causes):
        own = [i for i, one in enumerate(posterior.causes) if one.name == name]
        probability = _holding(found, p, {name}, "name")
        first = posterior.causes[own[0]]
        share = sum(math.exp(posterior.priors.log_shares[i]) for i in own)
        places = [] if first.free or probability <= TOLD else _places(found, p, own)
        rows.append(
            CauseResult(
                name=name,
                component=first.component,
                free=first.free,
                probability=probability,
                prior_probability=prior[first.component] * share,
                places=[
                    one.model_copy(update={"probability": min(1.0, one.probability / probability)})
                    for one in places
                ],
                estimates=[] if first.free else _estimates(found, draws, set(own)),
            )
        )
    return sorted(rows, key=lambda one: -one.probability)


def _estimates(found: CauseSets, draws: CauseDraws, own: set[int]) -> list[Estimate]:
    """Of an effect's parameters over all drawn sets that hold it; alone at its mode where none does."""
    origins = found.search.origins
    holding = [one for one in draws.sets if own & set(one.which)]
    if not holding:
        return []

    def amplitudes(one: SetDraws) -> Array:
        return one.values(one.solved.places(origins)[next(i for i in one.which if i in own)])

    x, w = together(holding, amplitudes)
    parameters = origins[min(own)].effect().effect.parameters
    return [estimate_of(p.name, p.unit, draws_, w) for p, draws_ in zip(parameters, x.T, strict=True)]


def _share(found: CauseSets, draws: CauseDraws, component: str, about: Sequence[str]) -> Interval:
    """Shapley's share of a component in the energy of truth minus baseline, 0 in sets without it.

    Signals are those of the linear model, less what the baseline's fit takes of them; what a set computes
    beyond their sum is shared in proportion to their energies.
    """
    search, base = found.search, found.solved[()].evidence
    J = search.jacobian / base.variances(base.best(SIZE_PRIORS))[:, None]

    def own(one: SetDraws, part: slice) -> Array:
        signal = one.signal(part)
        taken = np.linalg.lstsq(J.T @ search.jacobian, J.T @ signal.T, rcond=None)[0]
        return search.family.errors.part(signal - (search.jacobian @ taken).T, *about)

    def of(one: SetDraws) -> Array:
        index = next((i for i in one.which if search.causes[i].component == component), None)
        if index is None:
            return np.zeros(len(one.x))
        signals = {i: own(one, p) for i, p in one.solved.places(search.origins).items()}
        energy = {i: np.sum(x**2, axis=1) for i, x in signals.items()}
        computed = search.family.errors.part(one.computed - search.base.computed, *about)
        gap = computed + search.family.errors.part(one.left, *about)
        beyond = np.sum((computed - sum(signals.values())) * gap, axis=1)
        shared = np.sum(signals[index] * gap, axis=1)
        shared += beyond * energy[index] / np.maximum(sum(energy.values()), 1e-300)
        return np.asarray(shared / np.maximum(np.sum(gap**2, axis=1), 1e-300))

    return interval_of(*together(draws.sets, of))


def confounded(found: CauseSets) -> dict[str, list[str]]:
    """For each component of the leading set, others that can stand in for it there.

    On data that the leading set predicts, without noise, a cause of theirs in the place of its own loses less
    than 3 in log evidence, in the linear model.
    """
    search, which = found.search, found.leader
    if not which:
        return {}
    one = found.solved[which]
    V = one.evidence.variances(one.evidence.best(SIZE_PRIORS))
    predicted = one.point.computed - search.base.computed
    reference = Reference(replace(search.problem, residual=predicted), search.causes, V)
    groups = {}
    for i in which:
        rest = [j for j in which if j != i]
        gained, _ = reference.further(rest, [1.0] * len(rest))
        own = search.causes[i].component
        members = [j for j, one_ in enumerate(search.causes) if one_.component == own]
        top = max(gained[j] for j in members)
        others = {search.causes[j].component for j in rest} | {own}
        near = [
            c.component
            for j, c in enumerate(search.causes)
            if c.component not in others and gained[j] > top - CONFOUNDED
        ]
        groups[own] = list(dict.fromkeys(near))
    return groups


def _learned(found: CauseSets, p: dict[Which, float], one: SetDraws, index: int) -> LearnedFunction:
    cause, origin = found.search.causes[index], found.search.origins[index]
    f = origin.function
    assert f is not None
    part = one.solved.places(found.search.origins)[index]
    values = one.x[:, part] @ (f.size * f.root(origin.length)).T
    low, high = np.quantile(values, (0.025, 0.975), axis=0)
    free = [i for i in one.solved.order if found.search.origins[i].added is None]
    return LearnedFunction(
        name=f.name,
        argument=f.argument,
        argument_unit=f.argument_unit,
        unit=f.unit,
        values=f.at.tolist(),
        labels=list(f.labels),
        mean=values.mean(axis=0).tolist(),
        low=low.tolist(),
        high=high.tolist(),
        prior_sd=(f.size * np.sqrt(np.diag(f.correlation(origin.length)))).tolist(),
        location=f.location.part,
        equation=f.equation,
        prior_size=f.size,
        length=origin.length,
        probability=_holding(found, p, {cause.name}, "name"),
        laws=simple_laws(f, origin.length, one.solved.evidence, free.index(index)),
    )


def _functions(
    found: CauseSets, p: dict[Which, float], draws: CauseDraws, component: str
) -> list[LearnedFunction]:
    """Each free function of a component, from the most probable drawn set that holds it."""
    learned: dict[str, LearnedFunction] = {}
    for one in draws.sets:
        for i in one.which:
            cause = found.search.causes[i]
            if cause.component == component and cause.free and cause.name not in learned:
                learned[cause.name] = _learned(found, p, one, i)
    return sorted(learned.values(), key=lambda f: -f.probability)


def _components(
    found: CauseSets, p: dict[Which, float], draws: CauseDraws, about: Sequence[str]
) -> list[ComponentResult]:
    prior, groups = found.posterior.priors.inclusion(), confounded(found)
    rows = [
        ComponentResult(
            name=name,
            probability=_holding(found, p, {name}, "component"),
            prior_probability=prior[name],
            share=_share(found, draws, name, about),
            confounded=groups.get(name, []),
            group_probability=_holding(found, p, {name, *groups.get(name, [])}, "component"),
            functions=_functions(found, p, draws, name),
        )
        for name in found.posterior.priors.names
    ]
    return sorted(rows, key=lambda one: -one.probability)


def sensitivity(posterior: CausePosterior) -> list[SensitivityRow]:
    """Probabilities under other priors; nothing is solved again."""
    unexplained, caricature = SIZE_PRIORS.unexplained, SIZE_PRIORS.caricature
    sizes = {
        "unexplained discrepancy half as large": {"unexplained": 0.5 * unexplained},
        "unexplained discrepancy twice as large": {"unexplained": 2.0 * unexplained},
        "odds of an unexplained discrepancy 1": {"odds": 1.0},
        "effects half as large": {"effects": 0.5},
        "effects twice as large": {"effects": 2.0},
        "functions half as large": {"functions": 0.5},
        "functions twice as large": {"functions": 2.0},
        "effects modelled exactly": {"caricature": 0.0},
        "effects modelled half as well": {"caricature": 2.0 * caricature},
    }
    under = {
        "as stated": posterior,
        "odds of causes halved": posterior.under(odds=0.5 * ODDS),
        "odds of causes doubled": posterior.under(odds=2.0 * ODDS),
    } | {name: posterior.under(replace(SIZE_PRIORS, **changed)) for name, changed in sizes.items()}
    return [
        SensitivityRow(prior=name, nothing=one.probability[()], components=one.components)
        for name, one in under.items()
    ]


def next_measurement(found: CauseSets, hooks: Hooks) -> NextMeasurement | None:
    """The candidate in which the leading set and the most probable one of other components differ most.

    Expected log odds: half the squared difference of their series over the variance of the noise. That the
    parameters would move again is not counted, so it is an upper estimate.
    """
    if not found.leader or hooks.candidates is None:
        return None
    own = set(found.components(found.leader))
    rival = next(
        (
            which
            for which, p in found.posterior.probability.items()
            if p >= DOUBT and which and which in found.solved and set(found.components(which)) != own
        ),
        None,
    )
    fitting = found.search.fitting
    seen = set(fitting.data.outputs)
    candidates = [c for c in hooks.candidates(fitting.data, fitting.baseline) if c.output not in seen]
    if rival is None or not candidates:
        return None
    wanted = Outputs(tuple(c.output for c in candidates), fitting.baseline.outputs.times)
    solved = [found.solved[which] for which in (found.leader, rival)]
    first, second = (one.forward.series(one.point.u, wanted) for one in solved)
    if first is None or second is None:
        return None
    noise = found.noise
    noises = np.array(
        [
            noise.get(c.group, c.noise_part * float(np.abs(series).max()))
            for c, series in zip(candidates, first, strict=True)
        ]
    )
    gain = 0.5 * np.sum((first - second) ** 2, axis=1) / noises**2
    i = int(np.argmax(np.where(np.isfinite(gain), gain, -math.inf)))
    return NextMeasurement(
        separates=(found.name(found.leader), found.name(rival)),
        expected_log_odds=float(gain[i]),
        text=candidates[i].text,
        **dict(candidates[i].words),
    )


def _parameters(found: CauseSets, draws: CauseDraws) -> dict[str, dict[str, Estimate]]:
    """Of the baseline: by itself, with the leading set, and over all sets."""
    of, rows = found.search.fitting.forward.parameters, {}
    alone = [draw_set(found, found.search.fitted, 1.0, np.random.default_rng(0))]
    leading = [one for one in draws.sets if one.which == found.leader]
    for label, sets in (("base", alone), ("leading set", leading), ("over all sets", draws.sets)):
        u, w = together(sets, lambda one: one.values(slice(0, len(of))))
        pairs = zip(of, u.T, strict=True)
        rows[label] = {p.name: estimate_of(p.name, p.unit, np.asarray(p.value(x)), w) for p, x in pairs}
    return rows


def answer(
    found: CauseSets, hooks: Hooks, seed: int, record: dict[str, Any], excluded: ExcludedFit | None = None
) -> tuple[DiagnosisFile, Discrepancy, Discrepancy, CauseDraws]:
    """The content of diagnosis.json, and the discrepancies and draws behind it.

    Parameters
    ----------
    found : CauseSets
    hooks : Hooks
    seed : int
        Of the draws.
    record : dict
        How it was made.
    excluded : ExcludedFit, optional
        What the baseline's prior excluded; the sets are of the baseline with these bounds lifted.

    Returns
    -------
    file : DiagnosisFile
    before, after : Discrepancy
        Of the baseline, and of the leading set.
    draws : CauseDraws
    """
    data = found.search.fitting.data
    rows = hooks.rows(data)
    about = list(dict.fromkeys(data.groups[i] for i in rows))
    draws = draw_causes(found, seed)
    before, after = discrepancies(draws)
    sets, p = table_of(found, about)
    number = [math.fsum(x for which, x in p.items() if len(which) == k) for k in range(1 + max(map(len, p)))]
    file = DiagnosisFile(
        study=data.name,
        study_checksum=data.checksum,
        base=found.search.fitting.baseline.name,
        verdict="",
        decided=True,
        cause=[found.posterior.causes[i].label for i in found.leader],
        excluded=excluded,
        gap=_gap(found, before, after, rows),
        where=_where(found, p, before, hooks),
        no_gap=p[()] * (next(row.negligible for row in sets if not row.causes) or 0.0),
        number=number,
        sets=sets,
        missed=found.missed,
        linear_error=found.linear_error,
        components=_components(found, p, draws, about),
        causes=_causes(found, p, draws),
        sensitivity=sensitivity(found.posterior),
        failed=list(found.search.failed),
        next_measurement=next_measurement(found, hooks),
        base_parameters=_parameters(found, draws),
        labels={
            p.name: (hooks.labels.get(p.name, p.name), p.unit)
            for p in found.search.fitting.forward.parameters
        },
        record=record | {"noise": found.noise},
    )
    doubts = undecided(file, found.posterior.priors.most) + rounded(found, file)
    warnings = [
        *hooks.warnings,
        *lifted_bounds(excluded, hooks),
        *doubts,
        *cautions(found, file, before, hooks),
    ]
    file = file.model_copy(update={"decided": not doubts, "warnings": warnings})
    return worded(file), before, after, draws
