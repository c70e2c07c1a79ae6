"""The answer of a diagnosis in sentences: the same for the command, `print`, the page and the file."""

from __future__ import annotations

import math
from collections.abc import Iterable

from zoo.core.diagnosis.cautions import NO_FIT, changed_by_priors, missing
from zoo.core.diagnosis.file import DiagnosisFile, Estimate, LearnedFunction, StateFile
from zoo.core.effects import Location
from zoo.core.words import chance, digits, estimate, listed, percent, span, unit_words

FURTHER = 0.05
"""Least probability of a further cause, given the leading ones, from which on it is named."""
NAMED = 3
"""Further causes, and parameters, that are named at most."""
SURE_PLACE = 0.95
"""Probability of a place from which on it is named without its probability."""
MOVED = 1.0
"""Shift of a parameter, in its standard deviations, from which on it is named."""
UNVERIFIED = 0.005
"""Probability of sets that were not solved, from which on it is stated."""
VISITED = 0.1
"""Part of a state's range that the study does not visit, from which on it is stated."""
UNLIKE = 0.3
"""Part of a learned function that a simple law leaves, from which on it is not said to be like it."""
MILLI = 0.1
"""Time in s below which an estimate is in ms."""


def worded(file: DiagnosisFile) -> DiagnosisFile:
    """The same file with its verdict and answer in words.

    Parameters
    ----------
    file : DiagnosisFile

    Returns
    -------
    DiagnosisFile
    """
    verdict = _headline(file)
    told = [verdict, *filter(None, (sentence(file) for sentence in SENTENCES)), *_laws(file), *_states(file)]
    return file.model_copy(update={"verdict": verdict, "answer": told})


def _leader(file: DiagnosisFile) -> set[str]:
    """Names of the causes of the leading set."""
    return set(file.leading.names)


def _holding(file: DiagnosisFile, names: set[str]) -> float:
    """Probability of all sets that hold these causes; of the empty set where there are none."""
    rows = (row for row in file.sets if (names <= set(row.names) if names else not row.names))
    return min(1.0, math.fsum(row.probability for row in rows))


def _rival(file: DiagnosisFile, leader: set[str]) -> tuple[set[str], float] | None:
    """The most probable causes that do not include the leading ones, wherever they act."""
    found: dict[frozenset[str], float] = {}
    for row in file.sets:
        if set(row.names) != leader and not (leader and leader <= set(row.names)):
            names = frozenset(row.names)
            found[names] = found.get(names, 0.0) + row.probability
    if not found:
        return None
    best = max(found, key=lambda names: found[names])
    return set(best), found[best]


def _sized(one: Estimate) -> str:
    factor, unit = (1e3, "ms") if one.unit == "s" and abs(one.mean) < MILLI else (1.0, one.unit)
    return f"{one.name} = {estimate(factor * one.mean, factor * one.sd, unit)}"


def _cause(file: DiagnosisFile, name: str, *, sized: bool = False) -> str:
    """A cause with its place, and with its size: "viscoelastic wall, tau = 4.3 ± 0.15 ms"."""
    one, text = next(c for c in file.causes if c.name == name), name.replace("-", " ")
    if one.free:
        text += "" if one.component == name else f" of the {one.component}"
        text += " as a learned function"
        learned = next((f for c in file.components for f in c.functions if f.name == name), None)
        if learned is None:
            return text
        where, value = learned.largest
        text += f" of {learned.argument.removeprefix('log ')}"
        return text + (f", {value} at {where}" if sized else "")
    if one.places and one.places[0].part is not None:
        at = one.places[0]
        text += f" at {Location(at.part, at.subtree, at.noun)}"
        text += "" if at.probability >= SURE_PLACE else f" ({percent(at.probability)})"
    return ", ".join([text, *(_sized(e) for e in one.estimates if sized)])


def _causes(file: DiagnosisFile, names: Iterable[str], *, sized: bool = False) -> str:
    """Several of them, the most probable first; or that there is none."""
    known = [c.name for c in file.causes if c.name in set(names)]
    return " and ".join(_cause(file, name, sized=sized) for name in known) or "no listed cause"


def _headline(file: DiagnosisFile) -> str:
    leader, unit = _leader(file), unit_words(file.gap.unit)
    nothing, held = _holding(file, set()), _holding(file, leader)
    wrong = [c for c in file.components if c.probability > 0.5]
    best = _causes(file, leader, sized=True)
    if not wrong and file.no_gap > 0.5:
        noise = f"noise of {file.gap.noise_floor:.2g}{unit}"
        if file.gap.before > file.gap.noise_floor:
            small = f"errors of {file.gap.before:.2g}{unit}, which a simulator's numerics may make"
            text = f"Nothing is missing ({chance(file.no_gap, 1)}) beyond {small}, and {noise}"
        else:
            text = f"Nothing is missing ({chance(file.no_gap, 1)}): {noise} explains what the baseline leaves"
    elif not wrong and nothing > 0.5:
        text = f"No listed cause explains the model error of {file.gap.before:.2g}{unit}"
        text += f" ({chance(nothing, 1)})"
    elif leader and held > 0.5:
        text = f"Most likely missing: {best} ({chance(held, 1)})"
    elif wrong:
        parts = listed(f"{c.name} ({chance(c.probability, 1)})" for c in wrong)
        text = f"Most likely wrong: {parts}; best explanation of those simulated: {best} ({chance(held)})"
    else:
        text = f"These data do not decide; best explanation: {best} ({chance(held)})"
    if any(NO_FIT in warning for warning in file.warnings):
        text = f"The baseline does not fit the data: {NO_FIT}. {text}"
    if not file.decided:  # what must not be believed is said before what comes out
        text = f"Not decided, see the warnings. {text}"
    if file.excluded is None:
        return text
    bounds = listed(
        f"{b.parameter} = {b.best:.3g} ({b.side} bound {b.bound:.3g})" for b in file.excluded.bounds
    )
    return f"The baseline's prior excludes its best fit, {bounds}. Without that bound: {text}"


def _runner_up(file: DiagnosisFile) -> str:
    leader = _leader(file)
    rival = _rival(file, leader)
    if rival is None:
        return ""
    names, p = rival
    alone = " alone" if names and names < leader else ""
    if p > _holding(file, leader):
        estimated = "More probable, but only estimated by a linear model, not simulated"
        return f"{estimated}: {_causes(file, names)} ({chance(p, 1)})"
    odds = _holding(file, leader) / p if p > 0.0 else math.inf
    times = f"{odds:.{0 if odds >= 10 else 1}f}" if odds < 1e3 else "more than 1000"
    return (
        f"Runner-up: {_causes(file, names)}{alone} ({chance(p, 1)}; the first is {times} times as probable)"
    )


def _further(file: DiagnosisFile) -> str:
    leader = _leader(file)
    if not leader:
        return ""
    whole = _holding(file, leader)
    given = {c.name: _holding(file, leader | {c.name}) / whole for c in file.causes if c.name not in leader}
    near = sorted((name for name in given if given[name] >= FURTHER), key=lambda name: -given[name])[:NAMED]
    if not near:
        return f"In addition to it: nothing with a probability of {percent(FURTHER)} or more" if given else ""
    further = listed(f"{_cause(file, name)} ({percent(given[name])})" for name in near)
    return f"Possibly in addition: {further}"


def _components(file: DiagnosisFile) -> str:
    """Components by name, where these are more than the causes."""
    likely = [c for c in file.components if c.probability >= FURTHER]
    if not likely or {c.name for c in likely} <= {c.name for c in file.causes}:
        return ""
    return f"Wrong component: {listed(f'{c.name} ({chance(c.probability)})' for c in likely)}"


def _alike(file: DiagnosisFile) -> str:
    return "; ".join(
        f"These data hardly distinguish {c.name} from {' or '.join(c.confounded)}: at least one of them is "
        f"wrong with a probability of {chance(c.group_probability)}"
        for c in file.components
        if c.confounded
    )


def _error(file: DiagnosisFile) -> str:
    gap, unit = file.gap, unit_words(file.gap.unit)
    text = f"Model error (rms beyond the noise of {gap.noise_floor:.2g}{unit}): "
    text += f"{span(gap.before, gap.before_interval)}{unit}"
    if not file.cause:
        return text
    after = span(gap.after, gap.after_interval)
    removed = f"{percent(gap.removed)} removed" if gap.removed > 0.0 else "nothing removed"
    return f"{text} before, {after}{unit} with it; {removed}"


def _other_units(file: DiagnosisFile) -> str:
    """The model error of series that are in another unit than the first one's."""
    others = [one for one in file.gap.per_series if one.unit != file.gap.unit][:NAMED]
    after = [f" → {one.after.mean:.2g}" if file.cause else "" for one in others]
    told = [
        f"{one.series} {one.before.mean:.2g}{x}{unit_words(one.unit)}"
        for one, x in zip(others, after, strict=True)
    ]
    arrow = ", before → with it" if file.cause else ""
    return f"Model error of series in other units{arrow}: {listed(told)}" if told else ""


def _held_out(file: DiagnosisFile) -> str:
    gap = file.gap
    if gap.held_out_before is None or gap.held_out_after is None:
        return ""
    change = f"{gap.held_out_before:.2g} before, {gap.held_out_after:.2g}{unit_words(gap.unit)} with it"
    return f"Model error in data left out of the fit ({gap.held_out}): {change}"


def _parameters(file: DiagnosisFile) -> str:
    if not file.cause:
        return ""
    rows = file.base_parameters
    before, after = rows["base"], rows.get("leading set", rows["over all sets"])
    told = {name: one for name, one in before.items() if one.sd > 0.0}
    shift = {name: abs(after[name].mean - one.mean) / one.sd for name, one in told.items()}
    moved = sorted((name for name in shift if shift[name] >= MOVED), key=lambda name: -shift[name])[:NAMED]
    if not moved:
        return "Parameters of the baseline: none moves by more than its standard deviation"
    texts = []
    for name in moved:
        (label, unit), one = file.labels.get(name, (name, "1")), after[name]
        texts.append(f"{label} {digits(before[name].mean, 3)} → {estimate(one.mean, one.sd, unit)}")
    return f"Parameters of the baseline, before → with it: {', '.join(texts)}"


def _laws(file: DiagnosisFile) -> list[str]:
    leader = _leader(file)
    return [_law(f) for c in file.components for f in c.functions if f.name in leader and f.laws]


def _law(f: LearnedFunction) -> str:
    best, second, *_ = f.laws
    odds = f"{chance(best.probability)}; {second.name} {chance(second.probability)}"
    name, left = f.name.replace("-", " "), percent(best.left)
    if best.left > UNLIKE:
        return f"None of five simple laws is like {name}: a {f.law} leaves {left} of it"
    return f"Of five simple laws, {name} is most like a {f.law} ({odds}), leaving {left} of it"


def _sensitivity(file: DiagnosisFile) -> str:
    stated, *others = file.sensitivity
    if not file.causes:
        return ""
    varied = f"Priors varied in {len(others)} ways"
    if moved := changed_by_priors(file):
        return f"{varied}: the answer changes with {listed(moved)}"
    ranges = []
    for name in sorted(stated.wrong, key=lambda name: -stated.components[name]):
        low, *_, high = sorted(row.components[name] for row in file.sensitivity)
        ends = dict.fromkeys(chance(x) for x in (low, high))
        ranges.append(f"{name} {' to '.join(ends)}")
    if not ranges and file.cause:
        ranges = ["no component above 50 %"]
    elif not ranges:
        ranges = [f"no listed cause {chance(min(row.nothing for row in file.sensitivity))} or more"]
    but = "" if file.decided else ", which does not take the warnings away"
    return f"{varied}: the same answer each time ({', '.join(ranges)}){but}"


def _next(file: DiagnosisFile) -> str:
    one = file.next_measurement
    if one is None:
        return ""
    first, second = one.separates
    what = one.text or ", ".join(f"{name} {value}" for name, value in (one.model_extra or {}).items())
    most = math.exp(min(one.expected_log_odds, 700.0))
    odds = f"up to {most:.2g}" if most < 1e3 else "above 1000"
    return f"What would decide: {what}, which tells {first} from {second} (expected odds {odds} to 1)"


def _unverified(file: DiagnosisFile) -> str:
    if file.missed < UNVERIFIED or missing(file):  # then a warning says so
        return ""
    estimated = "combinations of causes that were only estimated by a linear model, not simulated"
    return f"Up to {percent(file.missed)} of the probability may belong to {estimated}"


def _states(file: DiagnosisFile) -> list[str]:
    return [_state(state, set(file.leading.components)) for state in file.states]


def _state(state: StateFile, components: set[str]) -> str:
    unit = unit_words(state.unit)
    told = [f"In {state.state}, refitted: the baseline misses by {state.baseline.mean:.2g}"]
    if state.sensor is not None:
        told.append(f"with the discrepancy seen at the sensor by {state.sensor.mean:.2g}")
    leader = next((c for c in state.carried if set(c.names) == components), None)
    if leader is not None:
        told.append(f"with what was learned of {listed(leader.names)} by {leader.error.mean:.2g}")
    holding = [listed(c.names) for c in state.carried if c.holds]
    end = f"what holds there: {', '.join(holding)}" if holding else "nothing that was learned holds there"
    if state.baseline.mean == 0.0:
        end = "the baseline needs no cause there"
    if leader is not None and leader.beyond is not None and leader.beyond > VISITED:
        end += f" ({percent(leader.beyond)} of the range there is new)"
    return f"{', '.join(told)}{unit}; {end}"


SENTENCES = (
    _runner_up, _further, _components, _alike, _error, _other_units, _held_out, _parameters,
    _sensitivity, _next, _unverified,
)  # fmt: skip
