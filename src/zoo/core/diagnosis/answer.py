"""The answer of a diagnosis as sums over the posterior of sets of causes, and in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.causes.posterior import CausePosterior
from zoo.core.causes.problem import Problem
from zoo.core.causes.reference import Reference
from zoo.core.causes.sets import ODDS
from zoo.core.components import FreeFunction
from zoo.core.diagnosis.bounds import Excluded, at_bounds
from zoo.core.diagnosis.draws import (
    CauseDraws,
    Discrepancy,
    SetDraws,
    discrepancies,
    draw_causes,
    draw_set,
    interval_of,
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
    LiftedBound,
    LocationShare,
    NextMeasurement,
    SensitivityRow,
    SeriesGap,
    SetResult,
    Where,
)
from zoo.core.diagnosis.heldout import hold_out
from zoo.core.diagnosis.hooks import Hooks
from zoo.core.diagnosis.sets import CauseSets
from zoo.core.diagnosis.solved import SIZE_PRIORS, Which
from zoo.core.effects import EffectParameter, Location
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
POOR_FIT = 0.2
"""Residual over the data's range above which input is suspected: four prior sds of the unexplained."""
STUCK = 0.5
"""Part of the series' variance that a best fit should explain at least."""
STEADY = 1e-6
"""Rms difference of two solves at the same parameters, in parts of the range, up to which they are one."""
OUTLIER = 8.0
"""Residual of a sample in robust standard deviations from which on it is named as an outlier."""
NEIGHBOURS, ROBUST = 3, 1.4826
"""Samples on either side whose median it is compared with, and sds over the median of absolute values."""
WRONG_NOISE = 2.0
"""Factor between the noise that is stated and the fine scatter of the series above which that is said."""
SAME_NOISE, LEAST_FINE = 0.95, 8
"""Correlation of two series' fine scatter above which they are copies, and coefficients that tell it."""
WRONG = 3.0
"""Log evidence that the linear model may be wrong by, and other sets be given too much, unsaid."""
MISSED = 0.05
"""Probability that may be missed up to which it is not said."""
RIVAL = 0.1
"""Probability of a component from which on the verdict names it, though another one is more probable."""
FAILING = 0.05
"""Part of the solves that fail from which on it is said."""
IMPLAUSIBLE = 2.5
"""Rms of a learned function, in its prior's scale, above which it is said that it can hardly be."""


@dataclass(frozen=True, eq=False)
class Answer:
    """A diagnosis' file, the discrepancies of baseline and leading set, and the draws they are made of."""

    file: DiagnosisFile
    before: Discrepancy
    after: Discrepancy
    draws: CauseDraws


def table_of(found: CauseSets, about: int) -> tuple[list[SetResult], dict[Which, float]]:
    """The table of sets, most probable first, and their probabilities normalised over it.

    Parameters
    ----------
    found : CauseSets
    about : int
        Index of the group whose gap is told.
    """
    posterior = found.posterior
    kept = {w: p for w, p in posterior.probability.items() if p >= LEAST or not w}
    total, rows = sum(kept.values()), []
    unit = found.search.fitting.data.unit(found.search.family.groups[about])
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
                gap_after=float(found.gap_after(which)[about]) if solved else None,
                negligible=None if which else _negligible(found),
                unit=unit,
            )
        )
    return rows, {which: p / total for which, p in kept.items()}


def _negligible(found: CauseSets) -> float:
    """Part of the empty set's probability in which what is left does not matter."""
    family = found.search.family
    noise = min(found.noise[g] / family.ranges[g] for g in family.groups)
    return found.posterior.negligible(noise, SIZE_PRIORS.numerics)


def _gap(found: CauseSets, before: Discrepancy, after: Discrepancy, rows: list[int]) -> Gap:
    data, noise = found.search.fitting.data, found.noise
    b, a = before.interval(rows), after.interval(rows)
    size = max(b.mean, 1e-300)
    removed = interval_of(1.0 - after.rms(rows) / size, after.weights) if found.leader else None
    held = hold_out(found, rows) if found.leader else None
    return Gap(
        unit=data.units[rows[0]],
        before=b.mean,
        before_interval=(b.low, b.high),
        noise_floor=noise[data.groups[rows[0]]],
        after=a.mean,
        after_interval=(a.low, a.high),
        residual_rms_before=_rms(before.residual[rows]),
        residual_rms_after=_rms(after.residual[rows]),
        removed=removed.mean if removed else 0.0,
        removed_interval=(removed.low, removed.high) if removed else (0.0, 0.0),
        held_out_before=held.before if held else None,
        held_out_after=held.after if held else None,
        held_out_removed=held.removed if held else None,
        held_out=held.what if held else "",
        per_series=[
            SeriesGap(
                series=label,
                unit=data.units[i],
                before=before.interval([i]),
                after=after.interval([i]),
                noise_floor=noise[data.groups[i]],
                residual_rms_before=_rms(before.residual[i]),
                residual_rms_after=_rms(after.residual[i]),
            )
            for i, label in enumerate(data.labels)
        ],
    )


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _where(found: CauseSets, p: dict[Which, float], d: Discrepancy, hooks: Hooks) -> Where:
    data, errors = found.search.fitting.data, found.search.family.errors
    rows = hooks.rows(data)
    energy = d.mean**2
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
        places = [] if first.free else _places(found, p, own)
        rows.append(
            CauseResult(
                name=name,
                component=first.component,
                free=first.free,
                probability=probability,
                prior_probability=prior[first.component] * share,
                places=[
                    one.model_copy(update={"probability": one.probability / probability}) for one in places
                ]
                if probability > TOLD
                else [],
                estimates=[] if first.free else _estimates(found, draws, set(own)),
            )
        )
    return sorted(rows, key=lambda one: -one.probability)


def _estimates(found: CauseSets, draws: CauseDraws, own: set[int]) -> list[Estimate]:
    """Of an effect's parameters over all drawn sets that hold it; alone at its mode where none does."""
    holding = draws.holding(lambda which: bool(own & set(which)))
    if not holding:
        return []
    values, weights = list[Array](), list[Array]()
    parameters: tuple[EffectParameter, ...] = ()
    for one in holding:
        places = one.solved.places(found.search.origins)
        i = next(i for i in one.which if i in own)
        values.append(one.values(places[i]))
        weights.append(one.weights)
        parameters = found.search.origins[i].effect().effect.parameters
    x, w = np.concatenate(values), np.concatenate(weights)
    estimates = []
    for p, draws_ in zip(parameters, x.T, strict=True):
        one_ = interval_of(draws_, w)
        sd = math.sqrt(float(w @ (draws_ - one_.mean) ** 2 / w.sum()))
        estimates.append(
            Estimate(name=p.name, mean=one_.mean, sd=sd, interval=(one_.low, one_.high), unit=p.unit)
        )
    return estimates


def _share(found: CauseSets, draws: CauseDraws, component: str, group: str) -> Interval:
    """Shapley's share of a component in the energy of truth minus baseline, 0 in sets without it.

    Signals are those of the linear model, less what the baseline's fit takes of them; what a set computes
    beyond their sum is shared in proportion to their energies.
    """
    search, base = found.search, found.solved[()].evidence
    J = search.jacobian / base.variances(base.best(SIZE_PRIORS))[:, None]

    def own(one: SetDraws, part: slice) -> Array:
        signal = one.signal(part)
        taken = np.linalg.lstsq(J.T @ search.jacobian, J.T @ signal.T, rcond=None)[0]
        return search.family.errors.part(signal - (search.jacobian @ taken).T, group)

    def of(one: SetDraws) -> Array:
        index = next((i for i in one.which if search.causes[i].component == component), None)
        if index is None:
            return np.zeros(len(one.x))
        signals = {i: own(one, p) for i, p in one.solved.places(search.origins).items()}
        energy = {i: np.sum(x**2, axis=(1, 2)) for i, x in signals.items()}
        computed = search.family.errors.part(one.computed - search.base.computed, group)
        gap = computed + search.family.errors.part(one.left, group)
        beyond = np.sum((computed - sum(signals.values())) * gap, axis=(1, 2))
        shared = np.sum(signals[index] * gap, axis=(1, 2))
        shared += beyond * energy[index] / np.maximum(sum(energy.values()), 1e-300)
        return np.asarray(shared / np.maximum(np.sum(gap**2, axis=(1, 2)), 1e-300))

    return draws.interval(of)


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
    p = search.problem
    problem = Problem(predicted, p.jacobian, p.precision, p.pull, p.log_prior, p.low, p.high)
    reference = Reference(problem, search.causes, V)
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
    found: CauseSets, p: dict[Which, float], draws: CauseDraws, group: str
) -> list[ComponentResult]:
    prior, groups = found.posterior.priors.inclusion(), confounded(found)
    rows = [
        ComponentResult(
            name=name,
            probability=_holding(found, p, {name}, "component"),
            prior_probability=prior[name],
            share=_share(found, draws, name, group),
            confounded=groups.get(name, []),
            group_probability=_holding(found, p, {name, *groups.get(name, [])}, "component"),
            functions=_functions(found, p, draws, name),
        )
        for name in found.posterior.priors.names
    ]
    return sorted(rows, key=lambda one: -one.probability)


def sensitivity(posterior: CausePosterior) -> list[SensitivityRow]:
    """Probabilities under other priors; nothing is solved again."""
    sizes = SIZE_PRIORS
    under = {
        "as stated": posterior,
        "odds of causes halved": posterior.under(odds=0.5 * ODDS),
        "odds of causes doubled": posterior.under(odds=2.0 * ODDS),
        "unexplained half as large": posterior.under(replace(sizes, unexplained=0.5 * sizes.unexplained)),
        "unexplained twice as large": posterior.under(replace(sizes, unexplained=2.0 * sizes.unexplained)),
        "odds of the unexplained 1": posterior.under(replace(sizes, odds=1.0)),
        "effects half as large": posterior.under(replace(sizes, effects=0.5)),
        "effects twice as large": posterior.under(replace(sizes, effects=2.0)),
        "functions half as large": posterior.under(replace(sizes, functions=0.5)),
        "functions twice as large": posterior.under(replace(sizes, functions=2.0)),
        "causes exact": posterior.under(replace(sizes, caricature=0.0)),
        "causes twice as inexact": posterior.under(replace(sizes, caricature=2.0 * sizes.caricature)),
    }
    return [
        SensitivityRow(prior=name, nothing=one.probability[()], components=one.components)
        for name, one in under.items()
    ]


def _leading(row: SensitivityRow) -> frozenset[str]:
    return frozenset(name for name, x in row.components.items() if x > 0.5)


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
        **dict(candidates[i].words),
    )


def _verdict(file: DiagnosisFile, leader: Sequence[str]) -> str:
    gap, unit = file.gap, "" if file.gap.unit == "1" else f" {file.gap.unit}"
    wrong = [c for c in file.components if c.probability > 0.5]
    nothing = next(row.probability for row in file.sets if not row.causes)
    if not wrong and nothing > 0.5:
        if file.no_gap > 0.5:
            return f"no gap ({file.no_gap:.0%}): noise of {gap.noise_floor:.3g}{unit} explains what is left"
        return (
            f"none of the listed effects or components ({nothing:.0%}): a discrepancy of "
            f"{gap.before:.2g}{unit} that nothing here explains"
        )
    named = ", ".join(f"{c.name} {c.probability:.0%}" for c in wrong)
    held = [row for row in file.sets if row.causes]
    best = next((row for row in held if row.solved), held[0])  # the leading set, where one leads
    by = " and ".join(best.causes)
    after = gap.after if leader or best.gap_after is None else best.gap_after
    left = f"{by} ({best.probability:.0%}) takes the gap of {gap.before:.2g}{unit} to {after:.2g}{unit}"
    if not wrong:
        others = ", ".join(f"{c.name} {c.probability:.0%}" for c in file.components[:3])
        return f"these data do not decide (nothing {nothing:.0%}; {others}): most probable is that {left}"
    groups = "; ".join(
        f"{c.name} cannot be told from {' or '.join(c.confounded)} (any of them {c.group_probability:.0%})"
        for c in wrong
        if c.confounded
    )
    near = [c for c in file.components if RIVAL < c.probability <= 0.5]
    rivals = ", ".join(f"{c.name} {c.probability:.0%}" for c in near)
    told = [f"wrong is {named}: {left}", groups, rivals and f"it may also be {rivals}"]
    return "; ".join(filter(None, told))


def _not_decided(file: DiagnosisFile, most: int) -> list[str]:
    """What the answer depends on, first and aloud."""
    told = []
    stated, *others = file.sensitivity
    moved = [row.prior for row in others if _leading(row) != _leading(stated)]
    if moved:
        told.append(f"the answer depends on the prior: it is another with {', '.join(moved)}")
    if len(file.number) > most and file.number[most] > 0.5:
        told.append(
            f"{most} components are said to be wrong, the most that may be: no set of causes is right at "
            "this noise, and the least wrong one is picked; do not believe it"
        )
    if file.linear_error > WRONG and file.missed > MISSED:
        told.append(
            f"sets that were not solved may be better or worse than stated by {file.linear_error:.0f} in log "
            f"evidence: {file.missed:.0%} of the probability may be missed"
        )
    return told


def _warnings(found: CauseSets, file: DiagnosisFile, before: Discrepancy, hooks: Hooks) -> list[str]:
    """What should be looked at before the answer is believed."""
    data, told = found.search.fitting.data, list[str]()
    rows, gap = hooks.rows(data), file.gap
    unit = "" if gap.unit == "1" else f" {gap.unit}"
    spread = float(max(np.ptp(data.values[i]) for i in rows))
    if gap.residual_rms_before > POOR_FIT * spread:
        told.append(
            f"the baseline misses the data by {gap.residual_rms_before:.2g}{unit}, "
            f"{gap.residual_rms_before / spread:.0%} of their range: {hooks.advice}"
        )
    for i, label in enumerate(data.labels):
        explained = 1.0 - float(np.var(before.residual[i]) / np.var(data.values[i]))
        if explained < STUCK:
            told.append(
                f"{label}: the best fit of the baseline explains {max(explained, 0.0):.0%} of its variance, "
                "hardly more than a constant would: it may not have been found; give priors nearer to it"
            )
    told += [one.text for _, one in at_bounds(found.search.fitting.forward, found.search.base.u)]
    for name in found.search.idle:
        told.append(
            f"effect {name}: none of its starts changes any sample: the simulator does not read what it sets"
        )
    told += _solves(found, hooks) + _outliers(found) + _noise(found)
    if not found.leader:
        return told
    leader = found.solved[found.leader]
    stuck = {p.name for p, _ in at_bounds(found.search.fitting.forward, found.search.base.u)}
    n = leader.n_listed
    for p, one in at_bounds(leader.forward, leader.point.u):
        index = [q.name for q in leader.forward.parameters].index(p.name)
        if p.name not in stuck and index < n:
            told.append(f"with {found.name(found.leader)}, {one.text}")
    for c in file.components:
        for f in c.functions[:1] if c.probability > 0.5 else ():
            told += _implausible(found, f, hooks)
    return told


def _implausible(found: CauseSets, learned: LearnedFunction, hooks: Hooks) -> list[str]:
    function = next(
        o.function for o in found.search.origins if o.function and o.function.name == learned.name
    )
    assert function is not None
    good, why = (hooks.plausible or expected)(function, np.asarray(learned.mean))
    return [] if good else [f"{function.component}: what was learned can hardly be: {why}"]


def expected(function: FreeFunction, values: Array) -> tuple[bool, str]:
    """Whether the values of a function are of the size that its prior expects, and a sentence about it."""
    rms, unit = _rms(values), "" if function.unit == "1" else f" {function.unit}"
    why = f" ({function.why})" if function.why else ""
    text = (
        f"{function.name} would have an rms of {rms:.2g}{unit}, {rms / function.size:.1f} times the "
        f"{function.size:.2g}{unit} that is expected{why}"
    )
    return rms <= IMPLAUSIBLE * function.size, text


def _solves(found: CauseSets, hooks: Hooks) -> list[str]:
    """That the simulator is not the same each time, or fails often."""
    fitting, told = found.search.fitting, []
    if found.search.unsteady > STEADY:
        told.append(
            f"two solves of {fitting.baseline.name} at the same parameters differ by "
            f"{found.search.unsteady:.2g} of the range: probabilities and sizes here cannot be believed; fix "
            "its random numbers"
        )
    if fitting.failures > FAILING * fitting.solves:
        told.append(
            f"{fitting.failures} of {fitting.solves} solves failed ({fitting.last_failure}): what lies there "
            f"counts as impossible, which may cut a cause off; {hooks.advice}"
        )
    return told


def _outliers(found: CauseSets) -> list[str]:
    """Samples far from their neighbours in what the leading set leaves."""
    data, told = found.search.fitting.data, []
    left = found.search.family.errors.unflat(found.search.data - found.solved[found.leader].point.computed)
    for label, series, values in zip(data.labels, left, data.values, strict=True):
        k = NEIGHBOURS
        around = np.pad(series, k, mode="reflect" if data.period is None else "wrap")
        odd = series - np.median(np.lib.stride_tricks.sliding_window_view(around, 2 * k + 1), axis=1)
        steps = np.abs(np.diff(around))
        scale = ROBUST / math.sqrt(2.0) * float(np.median(steps)) + 1e-12 * float(np.ptp(values))
        at = np.flatnonzero(np.abs(odd) > OUTLIER * scale)
        if 0 < len(at) < 0.1 * len(series):
            told.append(
                f"{label}: samples {', '.join(map(str, at[:10]))} stand out from their "
                "neighbours: if they are outliers, correct them; they count here as all others do"
            )
    return told


def _noise(found: CauseSets) -> list[str]:
    """That a stated noise does not fit the fine scatter of the data, or that two series share theirs."""
    fitting, told = found.search.fitting, list[str]()
    data, errors = fitting.data, fitting.errors
    residual = found.search.data - found.search.base.computed
    for group, rows in data.rows.items():
        fine, unit = errors.fine(residual, group), data.unit(group)
        if fine.shape[1] < LEAST_FINE:
            continue
        known, scatter = errors.known.get(group), float(np.sqrt(np.mean(fine**2)))
        if known is not None and not known / WRONG_NOISE < scatter < known * WRONG_NOISE:
            told.append(
                f"noise_sd of {group} is {known:.3g} {unit}, but its series scatter by {scatter:.3g} {unit} "
                "from sample to sample: correct it, or leave it out and it is fitted; all probabilities "
                "here hold for that noise alone"
            )
        waves = np.fft.rfft(errors.unflat(residual)[rows])[:, -fine.shape[1] // 2 :]
        for i in range(len(rows)):
            for j in range(i + 1, len(rows)):
                size = float(np.linalg.norm(waves[i]) * np.linalg.norm(waves[j]))
                if size > 0 and float(np.vdot(waves[i], waves[j]).real) > SAME_NOISE * size:
                    told.append(
                        f"{data.labels[rows[i]]} and {data.labels[rows[j]]} have the same noise, as "
                        "copies of one record have: leave one out, for what they share looks like an effect"
                    )
    return told


def _beyond(excluded: Excluded | None, gap: Gap) -> str:
    """The beginning of a verdict: what the baseline's prior excludes comes before any effect."""
    if excluded is None:
        return ""
    where = " and ".join(
        f"{one.place} ({value:.3g} fits best)"
        for one, value in zip(excluded.bounds, excluded.values, strict=True)
    )
    unit = "" if gap.unit == "1" else f" {gap.unit}"
    them = "it" if len(excluded.bounds) == 1 else "them"
    return (
        f"the baseline's prior excludes what fits best: {where}; with {them} free the gap is "
        f"{gap.before:.2g}{unit}, and then: "
    )


def _lifted(excluded: Excluded | None, hooks: Hooks) -> list[str]:
    if excluded is None:
        return []
    return [
        f"{one.text} in other commands too; here causes are weighed with it free; if {value:.3g} "
        f"cannot be, {hooks.advice}"
        for one, value in zip(excluded.bounds, excluded.values, strict=True)
    ]


def _excluded(excluded: Excluded | None, found: CauseSets, rows: list[int], unit: str) -> ExcludedFit | None:
    if excluded is None:
        return None
    unflat = found.search.family.errors.unflat
    bounds = [
        LiftedBound.model_validate(
            {"parameter": b.parameter, "unit": b.unit, "side": b.side, "bound": b.bound, "best": value}
        )
        for b, value in zip(excluded.bounds, excluded.values, strict=True)
    ]
    return ExcludedFit(
        unit=unit,
        bounds=bounds,
        residual_rms_within=_rms(unflat(excluded.within)[rows]),
        residual_rms_free=_rms(unflat(excluded.free)[rows]),
    )


def _parameters(found: CauseSets, draws: CauseDraws) -> dict[str, dict[str, float]]:
    """Of the baseline: at its best fit, and over all sets of causes, with standard deviations."""
    forward = found.search.fitting.forward
    names = [p.name for p in forward.parameters]
    n, rows = len(names), {}
    alone = draws.holding(lambda which: not which) or [draw_set(found, (), 1.0, np.random.default_rng(0))]
    for label, sets in (("base", alone), ("over all sets", draws.sets)):
        u = np.concatenate([one.values(slice(0, n)) for one in sets])
        w = np.concatenate([one.weights for one in sets])
        x = np.stack([np.asarray(p.value(u[:, i])) for i, p in enumerate(forward.parameters)], axis=1)
        mean = w @ x / w.sum()
        sd = np.sqrt(w @ (x - mean) ** 2 / w.sum())
        rows[label] = dict(zip(names, mean.tolist(), strict=True)) | {
            f"{name} sd": float(s) for name, s in zip(names, sd, strict=True)
        }
    return rows


def answer(
    found: CauseSets, hooks: Hooks, seed: int, record: dict[str, Any], excluded: Excluded | None = None
) -> Answer:
    """The content of diagnosis.json, and the discrepancies and draws behind it.

    Parameters
    ----------
    found : CauseSets
    hooks : Hooks
    seed : int
        Of the draws.
    record : dict
        How it was made.
    excluded : Excluded, optional
        What the baseline's prior excluded; the sets are of the baseline with these bounds lifted.

    Returns
    -------
    Answer
    """
    data = found.search.fitting.data
    rows = hooks.rows(data)
    group = data.groups[rows[0]]
    draws = draw_causes(found, seed)
    before, after = discrepancies(draws)
    sets, p = table_of(found, found.search.family.groups.index(group))
    number = np.zeros(1 + max(len(which) for which in p))
    for which, x in p.items():
        number[len(which)] += x
    gap = _gap(found, before, after, rows)
    leader = next(row for row in sets if row.solved)
    file = DiagnosisFile(
        study=data.name,
        study_checksum=data.checksum,
        base=found.search.fitting.baseline.name,
        verdict="",
        decided=True,
        cause=leader.causes,
        excluded=_excluded(excluded, found, rows, data.units[rows[0]]),
        gap=gap,
        where=_where(found, p, before, hooks),
        no_gap=p[()] * (next(row.negligible for row in sets if not row.causes) or 0.0),
        number=number.tolist(),
        sets=sets,
        missed=found.missed,
        linear_error=found.linear_error,
        components=_components(found, p, draws, group),
        causes=_causes(found, p, draws),
        sensitivity=sensitivity(found.posterior),
        failed=list(found.search.failed),
        next_measurement=next_measurement(found, hooks),
        base_parameters=_parameters(found, draws),
        record=record | {"noise": found.noise},
    )
    doubts = _not_decided(file, found.posterior.priors.most)
    warnings = [*hooks.warnings, *_lifted(excluded, hooks), *doubts, *_warnings(found, file, before, hooks)]
    verdict = _beyond(excluded, gap) + _verdict(file, leader.causes)
    update = {"verdict": verdict, "decided": not doubts, "warnings": warnings}
    return Answer(file.model_copy(update=update), before, after, draws)
