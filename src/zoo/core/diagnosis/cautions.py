"""What should be looked at before an answer is believed: priors, data, noise, solves, learned functions."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from zoo.core.causes.evidence import SIZE_PRIORS
from zoo.core.components import FreeFunction
from zoo.core.diagnosis.bounds import at_bounds
from zoo.core.diagnosis.discrepancies import Discrepancy
from zoo.core.diagnosis.file import DiagnosisFile, ExcludedFit, LearnedFunction
from zoo.core.diagnosis.hooks import Hooks
from zoo.core.diagnosis.sets import CauseSets
from zoo.core.inference.prior_check import AtBound
from zoo.core.words import chance, digits, listed, percent, unit_words

Array = NDArray[np.float64]

POOR_FIT = 0.2
"""Residual over the data's range above which input is suspected: four prior sds of the unexplained."""
NO_FIT = "a constant would be nearer to them"
"""What is said of a baseline that is farther from the data than these are from each other."""
STUCK = 0.5
"""Part of the series' variance that a best fit should explain at least."""
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
CORRELATED = 0.67
"""Probability that noise is correlated above which it is said: twice as probable as not; 0.5 beforehand."""
FAILING = 0.05
"""Part of the solves that fail from which on it is said."""
BEYOND = 5e-5
"""Probability on either side of a prior beyond which a parameter is named: four sds of a normal one."""
IMPLAUSIBLE = 2.5
"""Rms of a learned function, in its prior's scale, above which it is said that it can hardly be."""


def changed_by_priors(file: DiagnosisFile) -> list[str]:
    """Other priors under which other components are more probably wrong than not, and which these are."""
    stated, *others = file.sensitivity
    told = []
    for row in others:
        p, q = stated.components, row.components
        if moved := [f"{x} {percent(p[x])} → {percent(q[x])}" for x in sorted(row.wrong ^ stated.wrong)]:
            told.append(f"{row.prior} ({listed(moved)})")
    return told


def missing(file: DiagnosisFile) -> bool:
    """Whether sets that were not solved may have so much of the probability that it is warned of."""
    lead = set(file.cause)
    best = [row.probability for row in file.sets if (lead <= set(row.causes) if lead else not row.causes)]
    return file.missed > 0.5 > math.fsum(best) or (file.linear_error > WRONG and file.missed > MISSED)


def undecided(file: DiagnosisFile, most: int) -> list[str]:
    """Why an answer is not decided; empty if it is."""
    told = []
    if moved := changed_by_priors(file):
        told.append(f"the answer depends on the prior: it changes with {listed(moved)}")
    if len(file.number) > most and file.number[most] > 0.5:
        told.append(
            f"{most} components come out as wrong, the most that is allowed: no set of causes fits down to "
            "the noise, and the least wrong one is picked; do not believe it"
        )
    if file.failed and not file.cause and file.no_gap < 0.5:
        told.append(f"no listed cause explains the model error, and {listed(file.failed)} could not be tried")
    if missing(file):
        told.append(
            f"up to {percent(file.missed)} of the probability may belong to combinations of causes that were "
            f"only estimated by a linear model, not simulated: their log evidence may be off by "
            f"{digits(file.linear_error, 2)}; with fewer causes to choose from, more of these are simulated"
        )
    return told


def rounded(found: CauseSets, file: DiagnosisFile) -> list[str]:
    """Series of the baseline that are whole numbers, and within 1 of the data."""
    series = found.search.fitting.forward.series(found.search.base.u)
    return [
        f"the simulator gives whole numbers for {one.series}, within 1 of the data: if it rounds, "
        "small steps of its parameters change nothing or too much; let it return what it computes"
        for one, row in zip(file.gap.per_series, () if series is None else series, strict=False)
        if np.ptp(row) > 0.0 and np.all(row == np.rint(row)) and one.residual_rms_before < 1.0
    ]


def cautions(found: CauseSets, file: DiagnosisFile, before: Discrepancy, hooks: Hooks) -> list[str]:
    """What should be looked at before the answer is believed.

    Parameters
    ----------
    found : CauseSets
    file : DiagnosisFile
        With gap and components.
    before : Discrepancy
        Of the baseline.
    hooks : Hooks

    Returns
    -------
    list of str
    """
    fitting, told = found.search.fitting, list[str]()
    data, stuck = fitting.data, at_bounds(fitting.forward, found.search.base.u)
    rows, gap = hooks.rows(data), file.gap
    unit = unit_words(gap.unit)
    spread = float(max(np.ptp(data.samples(i)) for i in rows))
    if (part := gap.residual_rms_before / spread) > POOR_FIT:
        worse = f"; {NO_FIT}" if part > 1.0 else ""
        told.append(
            f"the baseline misses the data by {gap.residual_rms_before:.2g}{unit}, "
            f"{part:.0%} of their range{worse}: {hooks.advice}"
        )
    if file.cause and gap.removed < 0.0:
        told.append("with the leading causes the model error is larger than without: do not believe them")
    for i, label in enumerate(data.labels):
        explained = 1.0 - float(np.nanvar(before.residual[i]) / np.nanvar(data.values[i]))
        if explained < STUCK:
            told.append(
                f"{label}: the best fit of the baseline explains {max(explained, 0.0):.0%} of its variance, "
                "hardly more than a constant would: it may not have been found; give priors nearer to it"
            )
    told += [one.text for _, one in stuck]
    led = found.solved[found.leader].point.jacobian[:, : fitting.forward.n_base]
    read = np.any(found.search.jacobian, axis=0) | np.any(led, axis=0)
    given = {name for p in fitting.forward.parameters for name in p.parameter.prior.depends_on}
    told += [
        f"{p.name} changes no series where the baseline fits best: if the simulator never reads it, "
        "leave it out"
        for p, any_ in zip(fitting.forward.parameters, read, strict=True)
        if not any_ and p.parameter.name not in given
    ]
    told += _beyond_priors(found)
    for name in found.search.idle:
        told.append(
            f"effect {name}: none of its starts changes any sample: it acts nowhere here, or is not read"
        )
    for name, why in found.search.failed.items():
        told.append(f"effect {name}: the simulator failed at each of its starts ({why}): it was not weighed")
    if (failed := sum(model.failures.total() for model in fitting.models)) > FAILING * fitting.solves:
        of = listed(
            f"{'all' if n == failed else n} with {name}" for name, n in fitting.failures.most_common()
        )
        told.append(
            f"{failed} of {fitting.solves} solves failed, {of} ({fitting.last_failure}): "
            f"what lies there counts as impossible, which may cut a cause off; {hooks.advice}"
        )
    told += _outliers(found) + _noise(found)
    leader = found.solved[found.leader]
    if not found.leader:
        if (p := leader.evidence.correlated(SIZE_PRIORS)) > CORRELATED:
            known = "" if fitting.errors.known else ", or state the noise if it is known"
            told.append(
                f"the noise comes out as correlated from sample to sample ({chance(p)}), "
                f"and a cause that is not listed may look like that: list more causes{known}"
            )
        return told
    names = {p.name for p in leader.forward.parameters[: leader.n_listed]} - {p.name for p, _ in stuck}
    told += [
        f"with {found.name(found.leader)}, {one.text}"
        for p, one in at_bounds(leader.forward, leader.point.u)
        if p.name in names
    ]
    for c in file.components:
        for f in c.functions[:1] if c.probability > 0.5 else ():
            told += _implausible(found, f, hooks)
    return told


def _beyond_priors(found: CauseSets) -> list[str]:
    """Parameters of the baseline that its fit, or the leading set, takes far outside their priors."""
    told: dict[str, str] = {}
    for name, one in (
        ("the baseline fitted as if nothing were missing", found.search.fitted),
        (None, found.solved[found.leader]),
    ):
        forward = one.forward
        for p, x in zip(forward.parameters[: forward.n_base], forward.theta(one.point.u), strict=False):
            if p.name in told or p.parameter.prior.depends_on:
                continue
            low, high = np.asarray(p.parameter.prior.quantile([BEYOND, 1.0 - BEYOND]), dtype=np.float64)
            if not low <= x <= high:
                told[p.name] = (
                    f"with {name or found.name(found.leader)}, {p.name} = {x:.3g} is far outside its prior "
                    f"({low:.3g} to {high:.3g}, {1.0 - 2.0 * BEYOND:.2%}): if the prior or a unit is wrong, "
                    "an effect that makes up for it is called a cause"
                )
    return list(told.values())


def _implausible(found: CauseSets, learned: LearnedFunction, hooks: Hooks) -> list[str]:
    function = next(
        o.function for o in found.search.origins if o.function and o.function.name == learned.name
    )
    assert function is not None
    good, why = (hooks.plausible or expected)(function, np.asarray(learned.mean))
    return [] if good else [f"{function.component}: the learned function is implausible: {why}"]


def expected(function: FreeFunction, values: Array) -> tuple[bool, str]:
    """Whether the values of a function are of the size that its prior expects, and a sentence about it."""
    rms, unit = float(np.sqrt(np.mean(values**2))), unit_words(function.unit)
    why = f" ({function.why})" if function.why else ""
    text = (
        f"{function.name} would have an rms of {rms:.2g}{unit}, {rms / function.size:.1f} times the "
        f"{function.size:.2g}{unit} that its prior expects{why}"
    )
    return rms <= IMPLAUSIBLE * function.size, text


def _outliers(found: CauseSets) -> list[str]:
    """Samples far from their neighbours in what the leading set leaves."""
    data, told = found.search.fitting.data, []
    left = found.search.family.errors.unflat(found.search.data - found.solved[found.leader].point.computed)
    for i, label in enumerate(data.labels):
        series, values, k = data.samples(i, left), data.samples(i), NEIGHBOURS
        around = np.pad(series, k, mode="reflect" if data.period is None else "wrap")
        odd = series - np.median(np.lib.stride_tricks.sliding_window_view(around, 2 * k + 1), axis=1)
        steps = np.abs(np.diff(around))
        scale = ROBUST / math.sqrt(2.0) * float(np.median(steps)) + 1e-12 * float(np.ptp(values))
        at = np.flatnonzero(data.measured[i])[np.abs(odd) > OUTLIER * scale]
        if 0 < len(at) < 0.1 * len(series):
            step = float(np.median(np.diff(data.times)))
            places = max(4, 2 + math.ceil(math.log10(float(np.max(np.abs(data.times))) / step)))
            times = ", ".join(f"{data.times[k]:.{places}g}" for k in at[:10])
            told.append(
                f"{label}: what was measured at {times} {data.time_unit} stands out from its neighbours: if "
                "that is wrong, correct it or leave it out; it counts here as all else does"
            )
    return told


def _noise(found: CauseSets) -> list[str]:
    """That a stated noise does not fit the fine scatter of the data, or that two series share theirs."""
    fitting, told = found.search.fitting, list[str]()
    data, errors = fitting.data, fitting.errors
    residual = found.search.data - found.search.base.computed
    for group, rows in data.rows.items():
        fine, unit = errors.fine(residual, group), data.unit(group)
        if len(fine) < LEAST_FINE * len(rows):
            continue
        known, scatter = errors.known.get(group), float(np.sqrt(np.mean(fine**2)))
        if known is not None and not known / WRONG_NOISE < scatter < known * WRONG_NOISE:
            told.append(
                f"noise_sd of {group} is {known:.3g} {unit}, but its series scatter by {scatter:.3g} {unit} "
                "from sample to sample: correct it, or leave it out and it is fitted; all probabilities "
                "here hold for that noise alone"
            )
        left = errors.unflat(residual)
        for i, j in combinations(rows, 2):
            both = left[[i, j]][:, data.measured[i] & data.measured[j]]
            n = both.shape[1] * len(fine) // (2 * len(errors.part(residual, group)))
            if 2 * n < LEAST_FINE:
                continue
            one, other = np.fft.rfft(both)[:, -n:]
            size = float(np.linalg.norm(one) * np.linalg.norm(other))
            if size > 0 and float(np.vdot(one, other).real) > SAME_NOISE * size:
                told.append(
                    f"{data.labels[i]} and {data.labels[j]} have the same noise, as "
                    "copies of one record have: leave one out, for what they share looks like an effect"
                )
    return told


def lifted_bounds(excluded: ExcludedFit | None, hooks: Hooks) -> list[str]:
    """That the baseline's prior was widened for this diagnosis."""
    if excluded is None:
        return []
    return [
        f"{AtBound(b.parameter, b.side, b.bound, b.unit).text} in other commands too; here the bound is "
        f"lifted; if {b.best:.3g} is impossible, {hooks.advice}"
        for b in excluded.bounds
    ]
