"""The answer of a diagnosis: where the discrepancy lies, what causes it, how far it shrinks, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from zoo.core.diagnosis.bounds import Excluded, at_bounds
from zoo.core.diagnosis.component_answer import component_results, several_result
from zoo.core.diagnosis.components.learned import plausible
from zoo.core.diagnosis.components.pairs import SERIES
from zoo.core.diagnosis.discrepancy import model_discrepancy, smooth_part
from zoo.core.diagnosis.estimates import INTERVAL, linearised, posteriors_of
from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.file import (
    AddedStep,
    ComponentResult,
    DiagnosisFile,
    Estimate,
    ExcludedFit,
    Gap,
    HypothesisResult,
    Interval,
    LiftedBound,
    LocationShare,
    SeriesGap,
    Where,
)
from zoo.core.diagnosis.heldout import hold_out
from zoo.core.diagnosis.hooks import Hooks, next_measurement
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, NULL
from zoo.core.diagnosis.scoring import DOUBT, VISIBLE, Scored
from zoo.core.diagnosis.screening import Screened, Screening
from zoo.core.effects import Location
from zoo.core.inference.record import versions

Array = NDArray[np.float64]

MAX_HARMONIC = 10
"""Harmonics whose shares are told one by one."""
DRAWS = 400
"""Draws of a discrepancy from which its interval is made."""
TOLD = 1e-3
"""Least probability of a location that is told, and nearness of a probability to a simple fraction."""
POOR_FIT = 0.2
"""Discrepancy over the data's range above which input is suspected: four prior sds of a free discrepancy."""
SCANNED = 1e-3
"""Probability from which on the sizes of an effect come from a scan and not from the linearised model."""
WRONG_NOISE = 2.0
"""Factor between the noise that is stated and the fine scatter of the series above which that is said."""
SAME_NOISE, LEAST_FINE = 0.95, 8
"""Correlation of two series' fine scatter above which they are copies, and coefficients that tell it."""
SIMPLE_FRACTION = 20
"""Largest denominator of a fraction in a verdict."""
LITTLE = 0.5
"""Part of the discrepancy that an explanation should remove at least, lest a warning is given."""
NEARLY_ALL = 0.9
"""Upper end of the part removed from which on it is not known whether the explanation leaves most."""


@dataclass(frozen=True, eq=False)
class FitDiscrepancy:
    """The model discrepancy beside a fit, with bands; series in their own units."""

    mean: Array  # (n_series, n_times)
    sd: Array
    rms: Array  # (n_draws, n_series)
    unabsorbed: Array  # (n_draws, n_series), rms of what a fit to data without noise would leave
    residual: Array  # (n_series, n_times)

    def pooled(self, rows: list[int]) -> Array:
        """Rms over some series together, (n_draws,)."""
        return _over(self.rms, rows)

    def interval(self, rows: list[int]) -> Interval:
        """Of that rms; from what a fit to data without noise would leave to what this fit leaves.

        Where the noise is correlated the fits weigh the series otherwise, and the first may leave more.
        """
        draws = self.pooled(rows)
        both = np.stack([draws, _over(self.unabsorbed, rows)])
        low, high = np.quantile(both.min(axis=0), INTERVAL[0]), np.quantile(draws, INTERVAL[1])
        return Interval(mean=float(np.mean(draws)), low=float(low), high=float(high))

    def removed(self, rows: list[int], before: FitDiscrepancy) -> Interval:
        """Part of the discrepancy that this fit removes; its interval holds both meanings of what is left."""
        size = np.maximum(before.pooled(rows), 1e-12)
        fitted, free = (1.0 - _over(x, rows) / size for x in (self.rms, self.unabsorbed))
        low, high = np.quantile(fitted, INTERVAL[0]), np.quantile(np.maximum(fitted, free), INTERVAL[1])
        return Interval(mean=float(fitted.mean()), low=float(low), high=float(high))


def _over(rms: Array, rows: list[int]) -> Array:
    return np.asarray(np.sqrt(np.mean(rms[:, rows] ** 2, axis=1)))


def discrepancy_of(
    screened: Screened, fit: Fit, seed: int = 0, *, known_noise: bool = False
) -> FitDiscrepancy:
    """Posterior of the truth minus the fitted series: what is smooth in the residual beside the noise, and
    the error of the fitted parameters, which does not show there.

    Parameters
    ----------
    screened : Screened
    fit : Fit
    seed : int
        Of the draws that give its size an interval.
    known_noise : bool
        Take the noise as fitted, which is faster.

    Returns
    -------
    FitDiscrepancy
    """
    errors = screened.screening.errors
    rng = np.random.default_rng(seed)
    noise = {q: [(0.0, e)] for q, e in screened.noise.items()} if known_noise else screened.possible_noise
    found = model_discrepancy(fit, noise, rng, DRAWS)
    series = errors.unflat(found.draws)
    rms, unabsorbed = (np.sqrt(np.mean(x**2, axis=2)) for x in (series, errors.unflat(found.unabsorbed)))
    mean, residual = errors.unflat(found.mean), errors.unflat(fit.residual)
    return FitDiscrepancy(mean, series.std(axis=0), rms, unabsorbed, residual)


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _noun(scored: Scored) -> str:
    """What a part of the simulator is called."""
    nouns = [at.noun for found in scored.locations.values() for at, _ in found if at.noun]
    return nouns[0] if nouns else "part"


def _location_posterior(scored: Scored) -> list[LocationShare]:
    """Everywhere alike, or a part; what is missing to 1 is the probability of no listed effect."""
    shares: dict[Location, float] = {}
    for name, locations in scored.locations.items():
        for location, weight in locations:
            shares[location] = shares.get(location, 0.0) + weight * scored.probability[name]
    found = [
        LocationShare(part=at.part, subtree=at.subtree, probability=w, noun=_noun(scored))
        for at, w in sorted(shares.items(), key=lambda x: -x[1])
    ]
    return [p for p in found if p.probability >= TOLD]


def _where(scored: Scored, d: FitDiscrepancy, hooks: Hooks) -> Where:
    data = scored.screened.screening.data
    rows = hooks.rows(data)
    energy = d.mean**2
    total = float(energy[rows].sum()) or 1.0
    names, phase = hooks.phases_of(data, rows)
    by_phase = {p: float(energy[rows][:, phase == i].sum()) / total for i, p in enumerate(names)}
    errors = scored.screened.screening.errors
    coefficients = errors.transform(d.mean)[rows]
    power = np.zeros(int(errors.k.max()) + 1)
    np.add.at(power, errors.k, np.sum(coefficients**2, axis=0))
    power /= float(power.sum()) or 1.0
    by_harmonic = {str(k): float(power[k]) for k in range(min(MAX_HARMONIC + 1, len(power)))}
    by_harmonic[f"above {MAX_HARMONIC}"] = float(power[MAX_HARMONIC + 1 :].sum())
    by_series = {data.labels[i]: float(energy[i].sum()) / total for i in rows}
    return Where(series=by_series, phase=by_phase, harmonic=by_harmonic, place=_location_posterior(scored))


def _estimates(scored: Scored, name: str) -> list[Estimate]:
    """Of an effect's parameters; from a scan where the effect is not improbable."""
    fit = scored.best[name]
    leads = scored.group[name] == scored.group[scored.leader]
    scanned = leads or scored.probability[name] >= SCANNED
    found = posteriors_of(scored.screened.screening, fit) if scanned else linearised(fit)
    return [
        Estimate(name=p.name, mean=x.mean, sd=x.sd, interval=(x.low, x.high), unit=p.unit)
        for p, x in zip(fit.hypothesis.effect.parameters, found, strict=True)
    ]


def _free_estimates(fit: Fit) -> list[Estimate]:
    data, found = fit.forward.errors.on, []
    for q, e in fit.errors.items():
        found.append(Estimate(name=f"sd of {q}", mean=e.delta, sd=0.0, unit=data.unit(q)))
        found.append(Estimate(name=f"length scale of {q}", mean=e.length, sd=0.0, unit=data.time_unit))
    return found


def _results(
    scored: Scored, seed: int, known: Mapping[str, FitDiscrepancy], hooks: Hooks
) -> list[HypothesisResult]:
    screened = scored.screened
    data = screened.screening.data
    rows = hooks.rows(data)
    found = []
    top = max(z for name, z in scored.log_z.items() if name not in scored.invisible)
    for name in scored.names:
        if name in scored.components:
            continue
        fit = scored.best[name]
        if name in (NONPARAMETRIC, CORRELATED):
            mean, _ = smooth_part(fit)
            noise_left = screened.screening.errors.unflat(fit.residual - mean)
            after = np.array([0.0, 0.0, 0.0])
            rms = _rms(noise_left[rows])
        else:
            improbable = scored.standing(name) < DOUBT
            d = known.get(name) or discrepancy_of(screened, fit, seed, known_noise=improbable)
            if name in scored.locations:
                d = _no_more(d, known[NULL], rows)
            size = d.interval(rows)
            after = np.array([size.mean, size.low, size.high])
            rms = _rms(d.residual[rows])
        listed = name in scored.locations
        estimates = [] if name == NULL else _estimates(scored, name) if listed else _free_estimates(fit)
        shift = {}
        if listed:
            base = screened.least
            for i, p in enumerate(fit.forward.parameters[: fit.forward.n_base]):
                shift[p.name] = float(fit.values[i] - base.values[i])
        locations = scored.locations.get(name, [])
        found.append(
            HypothesisResult(
                name=name,
                place=fit.hypothesis.location.part if listed else None,
                subtree=fit.hypothesis.location.subtree if listed else False,
                probability=scored.probability[name],
                prior_probability=scored.prior_share[name],
                prior_made=scored.prior_made(name),
                and_more=scored.more.get(name),
                group=scored.group[name],
                log_evidence=scored.log_z[name],
                log10_bayes_factor=(scored.log_z[name] - scored.log_z[NULL]) / math.log(10.0),
                log10_bayes_factor_to_best=(scored.log_z[name] - top) / math.log(10.0),
                amplitude=estimates[0] if estimates else None,
                other_amplitudes=estimates[1:],
                gap_after=float(after[0]),
                gap_after_interval=(float(after[1]), float(after[2])),
                searched_twice=not listed or fit.hypothesis in screened.twice,
                residual_rms=rms,
                unit=data.units[rows[0]],
                shift_of_base=shift,
                places=[
                    LocationShare(part=at.part, subtree=at.subtree, probability=w, noun=at.noun or "part")
                    for at, w in locations
                    if w >= TOLD and len(locations) > 1
                ],
            )
        )
    return found


def _no_more(d: FitDiscrepancy, baseline: FitDiscrepancy, rows: list[int]) -> FitDiscrepancy:
    """What a cause leaves: it can be 0, so that none leaves more than the baseline."""
    return baseline if d.pooled(rows).mean() > baseline.pooled(rows).mean() else d


def _left(
    scored: Scored, seed: int, known: Mapping[str, FitDiscrepancy], rows: list[int]
) -> dict[str, Interval]:
    """What the best function of each component leaves; none leaves more than the baseline."""
    found = {}
    for name, component in scored.components.items():
        fit = component.best.fit
        d = known.get(name) if scored.best[name] is fit else None
        d = d or discrepancy_of(scored.screened, fit, seed, known_noise=True)
        d = _no_more(d, known[NULL], rows)
        found[name] = d.interval(rows)
    return found


def _prior_words(scored: Scored) -> str:
    """The beginning of a verdict whose probability the prior made."""
    share = scored.prior_share[scored.leader]
    if share is None or not scored.prior_made(scored.leader):
        return ""
    simple = Fraction(share).limit_denominator(SIMPLE_FRACTION)
    own = f" {simple}" if abs(share - simple) < TOLD and simple.denominator > 1 else ""
    others = scored.tied(scored.leader) or ["others of the same evidence"]
    return (
        f"these data do not tell {scored.leader} from {' or '.join(others)}: "
        f"{scored.probability[scored.leader]:.0%} is the prior's own{own}; "
    )


def _verdict(scored: Scored, gap: Gap) -> str:
    unit = "" if gap.unit == "1" else f" {gap.unit}"
    leader, p = scored.leader, scored.probability[scored.leader]
    if leader == NULL:
        return f"no gap: noise of {gap.noise_floor:.3g}{unit} explains what the baseline leaves ({p:.0%})"
    if leader in (NONPARAMETRIC, CORRELATED):
        text = "none of the listed effects" if leader == NONPARAMETRIC else "correlated noise"
        told = set() if _prior_words(scored) == "" else {leader, *scored.tied(leader)}
        twin = [n for n in scored.twins(leader) if n not in told]
        return f"{text} ({p:.0%}): a smooth discrepancy of {gap.before:.2g}{unit}" + (
            f"; these data cannot tell it from {' or '.join(twin)}" if twin else ""
        )
    members = [leader, *scored.twins(leader)]
    twins = f", which these data cannot tell from {', '.join(members[1:])}" if len(members) > 1 else ""
    grouped = " with its group" if twins else ""
    shrinks = f"the discrepancy of {gap.before:.2g}{unit} shrinks to {gap.after:.2g}{unit}"
    if scored.pair:
        p = dict(scored.pairs)[scored.pair]
        return _undecided(p) + (
            f"the components {' and '.join(scored.pair.names)} are not as the baseline has them, and no "
            f"listed effect is what they lack ({p:.0%}){twins}: with "
            f"{' and '.join(scored.pair.functions)} learned from the data {shrinks}"
        )
    if leader in scored.components:
        function = scored.components[leader].best.function
        beside = scored.more.get(leader, 0.0) > scored.probability[leader]
        rest = ", and something else remains" if beside else ""
        total = scored.of_component[leader] + sum(scored.probability[m] for m in members[1:])
        return _undecided(total) + (
            f"the component {leader} is not as the baseline has it, and no listed effect is what it lacks "
            f"({total:.0%}{grouped}){twins}: with a {function.name} learned from the data {shrinks}{rest}"
        )
    fit = scored.best[leader]
    at = fit.hypothesis.location
    where = f" in {at}" if at.part is not None else ""
    total = sum(scored.probability[m] for m in members)
    more = scored.more.get(leader, 0.0)
    if more > scored.probability[leader]:
        return (
            f"{leader}{where} and something else ({more:.0%}; alone {total:.0%}{grouped}){twins}: {shrinks}"
        )
    return f"{leader}{where} ({total:.0%}{grouped}){twins}: {shrinks}"


def _undecided(p: float) -> str:
    """The beginning of a verdict that is less probable than not."""
    return "these data do not decide; most probable is that " if p < 0.5 else ""


def _several(components: Sequence[ComponentResult]) -> str:
    """The end of a verdict where more than one component holds part of the gap for certain."""
    found = [one for one in components if one.one_of_several and one.share is not None]
    if any(one.share.low <= 0.0 for one in found if one.share):
        return ""
    found.sort(key=lambda one: -one.share.mean if one.share else 0.0)
    held = [f"{x.name} ({x.share.low:.0%} to {x.share.high:.0%})" for x in found if x.share]
    return f"; of its energy {' and '.join(held)} each hold a part" if held else ""


def _warnings(gap: Gap, scored: Scored, hooks: Hooks) -> list[str]:
    """What should be looked at before the answer is believed."""
    data = scored.screened.screening.data
    rows, found = hooks.rows(data), list[str]()
    unit = "" if gap.unit == "1" else f" {gap.unit}"
    spread = float(max(np.ptp(data.values[i]) for i in rows))
    if gap.before > POOR_FIT * spread:
        found.append(
            f"the baseline misses the data by {gap.before:.2g}{unit}, {gap.before / spread:.0%} of "
            f"their range, more than any effect of the catalogue should: {hooks.advice}"
        )
    found += _noise(scored)
    found += _together(scored)
    leader = scored.leader
    stuck = {p.name for p, _ in at_bounds(scored.screened.least)}
    found += [one.text for _, one in at_bounds(scored.screened.least)]
    learned = (scored.pair.first, scored.pair.second) if scored.pair else ()
    if leader in scored.components:
        for kind in learned or (scored.components[leader].best,):
            told = plausible(kind, hooks.plausible)
            if not told.value:
                name = kind.function.component
                found.append(f"{name}: what was learned can hardly be: {told.why}")
    if not scored.is_cause(leader):
        return found
    if gap.removed < LITTLE and gap.removed_interval[1] > NEARLY_ALL:
        low, high = (f"{share:.0%}" for share in gap.removed_interval)
        found.append(
            f"how much of the discrepancy goes with {leader} cannot be told from these data: {low} to {high}"
        )
    elif gap.removed < LITTLE:
        found.append(
            f"{leader} explains the data best of what is listed, but only {max(gap.removed, 0.0):.0%} of the "
            "discrepancy goes with it: most has another cause"
        )
    if data.n_series < SERIES and scored.components:
        found.append(f"from one series two causes at once cannot be told from one: {_two(scored.untold)}")
    found += _bounds_beside(scored, leader, stuck)
    if leader in scored.locations:
        found += _bounds_of_effect(scored, leader)
    elif scored.locations:  # a bound may hold a listed effect back
        found += _bounds_of_effect(scored, max(scored.locations, key=lambda n: scored.log_z[n]))
    return found


def _two(untold: float) -> str:
    """What the probabilities of components of one series say where two are wrong."""
    if (share := f"{untold:.0%}") == "0%":
        return "each probability is that of a component that is wrong, alone or beside something else"
    return f"the probability that two components are wrong, {share}, is shared equally by all components"


def _bounds_beside(scored: Scored, name: str, stuck: set[str]) -> list[str]:
    """Bounds at which parameters of the baseline stand with an explanation, and not without it."""
    base = {p.name for p in scored.screened.least.forward.parameters} - stuck
    return [f"with {name}, {one.text}" for p, one in at_bounds(scored.best[name]) if p.name in base]


def _bounds_of_effect(scored: Scored, name: str) -> list[str]:
    """Bounds at which parameters of a listed effect stand."""
    forward = scored.best[name].forward
    own = {p.name for p in forward.parameters[forward.asked :]}
    return [
        f"{p.name} of {name} stands at the {one.side} bound of its prior, {one.bound:g} {p.unit}: the data "
        "ask for more than the catalogue allows"
        for p, one in at_bounds(scored.best[name])
        if p.name in own
    ]


def _noise(scored: Scored) -> list[str]:
    """That a stated noise does not fit the fine scatter of the data, or that two series share theirs."""
    screening, found = scored.screened.screening, list[str]()
    data, errors, residual = screening.data, screening.errors, scored.screened.least.residual
    for group, rows in data.rows.items():
        fine, unit = errors.fine(residual, group), data.unit(group)
        if fine.shape[1] < LEAST_FINE:
            continue
        known, scatter = errors.known.get(group), float(np.sqrt(np.mean(fine**2)))
        if known is not None and not known / WRONG_NOISE < scatter < known * WRONG_NOISE:
            found.append(
                f"noise_sd of {group} is {known:.3g} {unit}, but its series scatter by {scatter:.3g} {unit} "
                "from sample to sample: correct it, or leave it out and it is fitted; all probabilities "
                "here hold for that noise alone"
            )
        waves = np.fft.rfft(errors.unflat(residual)[rows])[:, -fine.shape[1] // 2 :]
        for i, j in combinations(range(len(rows)), 2):
            size = float(np.linalg.norm(waves[i]) * np.linalg.norm(waves[j]))
            if size > 0 and float(np.vdot(waves[i], waves[j]).real) > SAME_NOISE * size:
                names = f"{data.labels[rows[i]]} and {data.labels[rows[j]]}"
                found.append(
                    f"{names} have the same noise, as copies of one record have: leave one out, for what "
                    "they share looks like an effect"
                )
    return found


def _together(scored: Scored) -> list[str]:
    """That several listed effects together explain what none does alone."""
    several = scored.several
    if several is None or several.gain < VISIBLE:
        return []
    return [
        f"{' and '.join(several.names)} together are more probable than any effect alone, by "
        f"{several.gain:.1f} in log odds: there may be more than one cause"
    ]


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


def _lifted_warnings(excluded: Excluded | None, hooks: Hooks) -> list[str]:
    if excluded is None:
        return []
    return [
        f"{one.text} in other commands too; here the explanations are weighed with it free; if {value:.3g} "
        f"cannot be, {hooks.advice}"
        for one, value in zip(excluded.bounds, excluded.values, strict=True)
    ]


def _excluded(
    excluded: Excluded | None, screening: Screening, rows: list[int], unit: str
) -> ExcludedFit | None:
    if excluded is None:
        return None
    within, free = (_rms(screening.errors.unflat(f.residual)[rows]) for f in (excluded.within, excluded.free))
    bounds = [
        LiftedBound.model_validate(
            {
                "parameter": one.parameter,
                "unit": one.unit,
                "side": one.side,
                "bound": one.bound,
                "best": value,
            }
        )
        for one, value in zip(excluded.bounds, excluded.values, strict=True)
    ]
    return ExcludedFit(unit=unit, bounds=bounds, residual_rms_within=within, residual_rms_free=free)


def answer(
    rounds: Sequence[Scored],
    hooks: Hooks,
    seed: int,
    started: str,
    seconds: float,
    excluded: Excluded | None = None,
) -> tuple[DiagnosisFile, FitDiscrepancy, FitDiscrepancy]:
    """The content of diagnosis.json, and the discrepancy before and after.

    Parameters
    ----------
    rounds : sequence of Scored
        One for each effect that was added, the first of which has the verdict.
    hooks : Hooks
    seed : int
        Of the draws.
    started : str
        When.
    seconds : float
        What the screening took.
    excluded : Excluded, optional
        What the baseline's prior excluded; the rounds are of the baseline with these bounds lifted.

    Returns
    -------
    DiagnosisFile
    before, after : FitDiscrepancy
        Of the baseline, and of the leading explanation where that is an effect.
    """
    first = rounds[0]
    single = first.best[first.leader]
    screenings = [scored.screened.screening for scored in rounds]
    data = screenings[0].data
    rows = hooks.rows(data)
    unit = data.units[rows[0]]
    screened = first.screened
    before = discrepancy_of(screened, screened.least, seed)
    caused = first.is_cause(first.leader)
    after = _no_more(discrepancy_of(screened, single, seed), before, rows) if caused else before
    held = hold_out(first, single, rows) if caused else None
    b, a, removed = before.interval(rows), after.interval(rows), after.removed(rows, before)
    gap = Gap(
        unit=unit,
        before=b.mean,
        before_interval=(b.low, b.high),
        noise_floor=screened.noise[data.groups[rows[0]]].noise,
        after=a.mean,
        after_interval=(a.low, a.high),
        residual_rms_before=_rms(before.residual[rows]),
        residual_rms_after=_rms(after.residual[rows]),
        removed=removed.mean if caused else 0.0,
        removed_interval=(removed.low, removed.high) if caused else (0.0, 0.0),
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
                noise_floor=screened.noise[data.groups[i]].noise,
                residual_rms_before=_rms(before.residual[i]),
                residual_rms_after=_rms(after.residual[i]),
            )
            for i, label in enumerate(data.labels)
        ],
    )
    steps = []
    for now, then in pairwise(rounds):
        one = then.screened.screening.added[-1]
        fits = (now.screened.least, then.screened.least)
        sizes = [float(discrepancy_of(now.screened, f, seed).pooled(rows).mean()) for f in fits]
        steps.append(
            AddedStep(
                name=one.name, place=one.location.part, subtree=one.location.subtree, unit=unit,
                probability=now.probability[one.name], amplitudes=_estimates(now, one.name),
                gap_before=sizes[0], gap_after=sizes[1],
            )
        )  # fmt: skip
    parameters = {}
    for label, fit in (("base", screened.least), ("with cause", single)):
        values = fit.values
        sds = fit.sd
        # weights of a free function mean nothing one by one
        shown = fit.forward.parameters[: fit.forward.n_base if first.leader in first.components else None]
        parameters[label] = {p.name: float(values[i]) for i, p in enumerate(shown)} | {
            f"{p.name} sd": float(sds[i] * (values[i] if p.log else 1.0)) for i, p in enumerate(shown)
        }
    known = {NULL: before} | ({first.leader: after} if caused else {})
    components = component_results(
        first, _left(first, seed, known, rows), unit, data.groups[rows[0]], hooks.plausible, seed
    )
    file = DiagnosisFile(
        study=data.name,
        study_checksum=data.checksum,
        base=screenings[0].baseline.name,
        gap=gap,
        where=_where(first, before, hooks),
        cause=first.members(first.leader),
        verdict=_beyond(excluded, gap) + _prior_words(first) + _verdict(first, gap) + _several(components),
        warnings=[
            *hooks.warnings,
            *_lifted_warnings(excluded, hooks),
            *_warnings(gap, first, hooks),
        ],
        excluded=_excluded(excluded, screenings[0], rows, unit),
        hypotheses=_results(first, seed, known, hooks),
        components=components,
        steps=steps,
        several=several_result(first.several),
        invisible=list(first.invisible),
        failed=list(first.failed),
        next_measurement=next_measurement(first, hooks),
        base_parameters=parameters,
        record={
            "versions": versions(),
            "seed": seed,
            "started": started,
            "screening_seconds": seconds,
            "solves": sum(s.solves for s in screenings),
            "failed_solves": sum(s.failures for s in screenings),
            "cores": screenings[0].cores,
            "noise": {q: vars(e) for q, e in screened.noise.items()},
            "gap_unit": unit,
        },
    )
    return file, before, after
