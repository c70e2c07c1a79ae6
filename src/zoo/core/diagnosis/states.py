"""Whether what was learned in one state of a system holds in another.

A constitutive function, such as a wall's law, is one for all states; an error of a record, or a discrepancy
that a sensor draws, belongs to the state in which it was seen. So the function is fixed as it was learned,
the baseline's own parameters are fitted again to the other state's data, and what is left is compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.causes.evidence import SIZE_PRIORS
from zoo.core.components import FreeFunction
from zoo.core.data import Data
from zoo.core.diagnosis.bounds import at_bounds
from zoo.core.diagnosis.discrepancies import INTERVAL
from zoo.core.diagnosis.file import CarriedResult, DiagnosisError, Interval, StateFile
from zoo.core.diagnosis.fitting import Fitting
from zoo.core.diagnosis.hooks import Hooks
from zoo.core.diagnosis.search import Search, SearchError
from zoo.core.diagnosis.sets import CauseSearch, CauseSets
from zoo.core.diagnosis.solved import SolvedSet, Which
from zoo.core.effects import AddedEffect
from zoo.core.errors.spectral import Spectral, spectral_errors
from zoo.core.forward import Around, ForwardModel, content_key
from zoo.core.words import unit_words

Array = NDArray[np.float64]
Change = Callable[[Any], Any]
STEPS = 8
"""Steps of a refit of the baseline's parameters beside what is fixed."""
SAME = 1e-9
"""Relative difference up to which series are the very same ones."""
PARTS, RESAMPLED = 8, 2000
"""Contiguous parts of each series that are drawn with replacement, and draws."""
SURE, SMALLER = 0.975, 0.9
"""Part of the draws in which what holds leaves less, and of what the others leave at most."""
BASELINE, SEEN = "baseline", "sensor's discrepancy"
"""Names of what learned functions are compared with."""


@dataclass(frozen=True, eq=False)
class OtherState:
    """Another state of the same system: other inputs, the same simulator and sensors.

    Parameters
    ----------
    data : Data
        What was measured in it; its name is the state's.
    model : ForwardModel
        The same baseline with that state's inputs; its outputs are the data's series and times.
    errors : Spectral, optional
        As in `zoo.core.diagnosis.diagnose`.
    """

    data: Data
    model: ForwardModel
    errors: Spectral | None = None


@dataclass(frozen=True, eq=False)
class StateResult:
    """What a baseline, a sensor's discrepancy and learned functions leave in another state.

    Parameters
    ----------
    data : Data
    group : str
        Whose errors are told.
    file : StateFile
        These errors, as diagnosis.json has them.
    computed : mapping of name to array (n_series, n_times)
        By the baseline, by `SEEN` at the sensor, and by what was carried, "a and b" of two components.
    warnings : tuple of str
        Bounds at which the baseline stands there.
    """

    data: Data
    group: str
    file: StateFile
    computed: Mapping[str, Array] = field(repr=False)
    warnings: tuple[str, ...] = ()


class _Changed(Around):
    """A forward model whose configuration is changed before each solve; itself a forward model."""

    def __init__(self, model: ForwardModel, changes: Sequence[Change], text: bytes) -> None:
        super().__init__(model)
        self._changes, self.parameters = tuple(changes), model.parameters
        self.key = content_key(model.key, text)

    def configure(self, theta: Array) -> Any:
        configuration = self.model.configure(theta)
        for change in self._changes:
            configuration = change(configuration)
        return configuration


@dataclass(frozen=True, eq=False)
class _Explanation:
    """What is fixed: functions with their values, or a listed effect with its amplitudes."""

    names: tuple[str, ...]
    functions: tuple[tuple[FreeFunction, Array], ...]
    effects: tuple[tuple[AddedEffect, tuple[float, ...]], ...]
    shift: Array

    @property
    def name(self) -> str:
        """Of all together."""
        return " and ".join(self.names)

    @property
    def text(self) -> bytes:
        """For the key of what it is added to."""
        values = [v.tobytes() for _, v in self.functions]
        return repr((self.words, values, [x for _, x in self.effects])).encode()

    @property
    def words(self) -> tuple[str, ...]:
        """Names of what is fixed."""
        return (*(f.name for f, _ in self.functions), *(one.name for one, _ in self.effects))


def explanations(found: CauseSets) -> list[_Explanation]:
    """The leading set, and of each further component the most probable solved set that holds it."""
    chosen: list[Which] = [found.leader] if found.leader else []
    told = set(found.components(found.leader))
    for which in found.posterior.probability:
        if which in found.solved and set(found.components(which)) - told:
            chosen.append(which)
            told |= set(found.components(which))
    return [_explanation(found, which) for which in chosen]


def _explanation(found: CauseSets, which: Which) -> _Explanation:
    """A solved set, with what its causes are at its mode."""
    one, search = found.solved[which], found.search
    values, n = one.forward.theta(one.point.u), one.forward.n_base
    functions, effects = [], []
    for i, part in one.places(search.origins).items():
        origin = search.origins[i]
        if origin.added is not None:
            effects.append((origin.added, tuple(float(x) for x in values[part])))
        elif origin.function is not None:
            f = origin.function
            functions.append((f, f.size * f.root(origin.length) @ values[part]))
    shift = one.point.u[:n] - search.base.u
    return _Explanation(found.components(which), tuple(functions), tuple(effects), shift)


def _apply(function: FreeFunction, values: Array, configuration: Any) -> Any:
    return function.apply(configuration, values)


def _add(one: AddedEffect, amplitudes: tuple[float, ...], configuration: Any) -> Any:
    assert one.effect.apply is not None
    return one.effect.apply(configuration, amplitudes, one.location)


def _changes(one: _Explanation, again: Mapping[str, FreeFunction]) -> list[Change] | None:
    """What each fixed piece does to a configuration of the other state; None where it has no counterpart.

    A function of the time within a period is that of the same part of the other's period; any other is the
    very same function of its argument.
    """
    found: list[Change] = []
    for f, values in one.functions:
        if f.period is None:
            found.append(partial(_apply, f, values))
            continue
        made = again.get(f.name)
        if made is None or made.period is None:
            return None
        moved = np.interp(made.at / made.period, f.at / f.period, values, period=1.0)
        found.append(partial(_apply, made, moved))
    for added, amplitudes in one.effects:
        found.append(partial(_add, added, amplitudes))
    return found


def _beyond(one: _Explanation, again: Mapping[str, FreeFunction]) -> float | None:
    parts = []
    for f, _ in one.functions:
        made = again.get(f.name)
        if made is None or f.labels or f.period is not None or len(f.at) < 2 or len(made.at) < 2:
            continue
        low, high = float(made.at[0]), float(made.at[-1])
        inside = max(0.0, min(high, float(f.at[-1])) - max(low, float(f.at[0])))
        parts.append(1.0 - inside / (high - low))
    return max(parts, default=None)


def seen_at_sensor(found: CauseSets) -> Array:
    """Posterior mean of the discrepancy beside no cause, as a sensor would draw it, (n_series, n_times).

    s = C (C + N)^-1 (r - J d), C its covariance, N that of the noise, at the mode of the parameters; of the
    most probable errors that have a discrepancy.
    """
    one = found.solved[()]
    weights = np.where(_has_discrepancy(one), one.evidence.weights(SIZE_PRIORS), 0.0)
    kind = int(np.argmax(weights))
    left = found.search.data - one.series(one.evidence.mean[kind])
    both = one.evidence.variances(kind)
    part = 1.0 - one.evidence.variances(kind, alone=True) / both
    return found.search.family.errors.unflat(part * left)


def _has_discrepancy(one: SolvedSet) -> NDArray[np.bool_]:
    _, discrepancy = one.evidence.family.of(one.evidence.kinds)
    return np.asarray(discrepancy.any(axis=1))


def _at_same_part(values: Array, first: Data, here: Data) -> Array | None:
    """Series of one state at the same part of the period or record of another, 0 for series of this only."""
    parts = [(d.times - d.times[0]) / d.duration for d in (first, here)]
    period = 1.0 if first.period is not None and here.period is not None else None
    found, any_ = np.zeros(here.values.shape), False
    for i, label in enumerate(here.labels):
        if label in first.labels:
            any_ = True
            row = first.labels.index(label)
            at = parts[0][first.measured[row]]
            found[i] = np.interp(parts[1], at, first.samples(row, values), period=period)
    return found if any_ else None


class _Refitted:
    """The baseline of another state, and its refits beside what is fixed."""

    def __init__(self, state: OtherState, smooth: bool, cores: int) -> None:
        errors = spectral_errors(state.data) if state.errors is None else state.errors
        fitting = Fitting(state.data, state.model, errors.bind(state.data), smooth=smooth, cores=cores)
        search = CauseSearch(fitting, (), Hooks(smooth=smooth), lambda text, share: None)
        self.fitting = search.fitting
        found = search.run()
        self.base, self.noise = search.base, found.noise
        one = search.solved[()].evidence
        self.S = one.variances(one.best(SIZE_PRIORS), alone=True)

    def computed(self, model: ForwardModel, data: Array, starts: Sequence[Array]) -> Array | None:
        """Series (n_series, n_times) of the best refit to `data`; None where nothing can be solved."""
        errors, forward = self.fitting.errors, self.fitting.model(baseline=model)
        search = Search(forward, errors.flat(data), self.S)
        points = []
        for u in starts:
            try:
                point = search.at(np.clip(u, forward.low, forward.high), self.base.jacobian)
                points.append(search.descend(point, STEPS))
            except SearchError:
                continue
        if not points:
            return None
        return errors.unflat(search.refine(min(points, key=lambda p: p.cost), 2, STEPS).computed)


def same_system(data: Data, model: ForwardModel, state: OtherState) -> None:
    """Refuse another state that is none: that of another system, or the first one itself.

    Raises
    ------
    DiagnosisError
    """
    here = state.data
    where = here.source or here.name
    asked, given = ([(p.name, p.size) for p in m.parameters] for m in (model, state.model))
    if given != asked:
        raise DiagnosisError(
            f"{where}: its baseline has other parameters than that of {data.name}: another state is one of "
            "the same system; give a study of the same network"
        )
    for label in here.labels:
        if label not in data.labels:
            continue
        units = [one.units[one.labels.index(label)] for one in (data, here)]
        if units[0] != units[1]:
            raise DiagnosisError(
                f"{where}: series {label} is in {units[1]}, in {data.name} in {units[0]}: give both in "
                "one unit"
            )
    pair = here.values, data.values
    if pair[0].shape == pair[1].shape and np.allclose(*pair, rtol=SAME, atol=0.0, equal_nan=True):
        raise DiagnosisError(
            f"{where}: has the same series as {data.name}, in which all was learned: give measurements of "
            "another state"
        )


def hold_in(
    found: CauseSets,
    state: OtherState,
    group: str,
    hooks: Hooks,
    *,
    cores: int = 2,
    seed: int = 0,
    tick: Callable[[str, float], None] | None = None,
) -> StateResult:
    """What a baseline and what was learned leave in another state, the baseline's parameters fitted again.

    A function holds there if it leaves less than nine tenths of what both the baseline and the discrepancy
    that was learned at the sensor leave, and less than either in 97.5 % of the draws of the parts of every
    series with replacement.

    Parameters
    ----------
    found : CauseSets
        Of the first state.
    state : OtherState
        Of the `same_system`.
    group : str
        Whose errors are told; the other state's first group where it has none of it.
    hooks : Hooks
        Give the free functions there, and whether solutions are smooth.
    cores, seed : int
    tick : callable, optional
        Called with a text and the share done.

    Returns
    -------
    StateResult

    Raises
    ------
    zoo.core.diagnosis.search.SearchError, zoo.core.forward.SolveError
        If the baseline cannot be solved there.
    """
    here = state.data
    say = tick or (lambda text, share: None)
    say(f"state {here.name}: baseline", 0.0)
    refitted = _Refitted(state, hooks.smooth, cores)
    group = group if group in here.rows else here.groups[0]
    base = refitted.base
    theta = refitted.fitting.forward.theta(base.u)
    made = hooks.components(state.model, theta, here) if hooks.components is not None else ()
    again = {f.name: f for f in made}
    wanted = explanations(found)
    model = refitted.fitting.baseline
    alone = refitted.computed(model, here.values, [base.u])  # by least squares, as all that follows
    computed = {BASELINE: refitted.fitting.errors.unflat(base.computed) if alone is None else alone}
    drawn = _at_same_part(seen_at_sensor(found), found.search.fitting.data, here)
    if drawn is not None:
        series = refitted.computed(model, here.values - drawn, [base.u])
        if series is not None:
            computed[SEEN] = series + drawn
    for i, one in enumerate(wanted):
        say(f"state {here.name}: {one.name}", (i + 1) / (len(wanted) + 1))
        changes = _changes(one, again)
        starts = [base.u + one.shift, base.u]
        changed = None if changes is None else _Changed(model, changes, one.text)
        series = None if changed is None else refitted.computed(changed, here.values, starts)
        if series is not None:
            computed[one.name] = series
    file = _compared(here, group, refitted.noise[group], computed, wanted, again, seed)
    bounds = tuple(f"in {here.name}, {one.text}" for _, one in at_bounds(refitted.fitting.forward, base.u))
    return StateResult(here, group, file, computed, bounds)


def intervals_of(units: Array, noise: float, seed: int = 0) -> tuple[list[Interval], Array]:
    """Rms errors beyond the noise with their intervals, and mean squares of draws of the parts.

    Parameters
    ----------
    units : array (n_parts, 1 + n)
        Of each part of a series: its samples, then the sum of squared errors of each explanation.
    noise : float
        Variance of a sample.
    seed : int
        Of the draws of parts with replacement.

    Returns
    -------
    list of Interval
    mse : array (n_draws, n)
    """
    rng = np.random.default_rng(seed)
    drawn = units[rng.integers(0, len(units), (RESAMPLED, len(units)))].sum(axis=1)
    mse = drawn[:, 1:] / drawn[:, :1]
    rms = np.sqrt(np.maximum(mse - noise, 0.0))
    total = units.sum(axis=0)
    mean = np.sqrt(np.maximum(total[1:] / total[0] - noise, 0.0))
    low, high = np.quantile(rms, INTERVAL, axis=0)
    intervals = [
        Interval(mean=float(m), low=float(min(a, m)), high=float(max(b, m)))
        for m, a, b in zip(mean, low, high, strict=True)
    ]
    return intervals, mse


def _compared(
    data: Data,
    group: str,
    noise: float,
    computed: Mapping[str, Array],
    wanted: Sequence[_Explanation],
    again: Mapping[str, FreeFunction],
    seed: int,
) -> StateFile:
    part = np.arange(data.n_times) * PARTS // data.n_times
    left = [(data.values - x) ** 2 for x in computed.values()]
    units = np.array(
        [
            [float(np.sum(own)), *(float(np.sum(x[i, own])) for x in left)]
            for i in data.rows[group]
            for own in (data.measured[i] & (part == j) for j in range(PARTS))
            if np.any(own)
        ]
    )
    intervals, mse = intervals_of(units, noise**2, seed)
    at = {name: i for i, name in enumerate(computed)}
    others = [at[name] for name in (BASELINE, SEEN) if name in at]
    least = min(intervals[k].mean for k in others)
    carried = []
    for one in wanted:
        if one.name not in at:
            continue
        i = at[one.name]
        better = float(np.mean(mse[:, i] < mse[:, others].min(axis=1)))
        carried.append(
            CarriedResult(
                names=list(one.names),
                functions=list(one.words),
                error=intervals[i],
                better=better,
                holds=better >= SURE and intervals[i].mean < SMALLER * least,
                beyond=_beyond(one, again),
                unit=data.unit(group),
            )
        )
    return StateFile(
        state=data.name,
        checksum=data.checksum,
        unit=data.unit(group),
        noise=noise,
        baseline=intervals[at[BASELINE]],
        sensor=intervals[at[SEEN]] if SEEN in at else None,
        carried=carried,
        failed=[one.name for one in wanted if one.name not in at],
    )


def state_warning(state: StateFile, leader: Sequence[str]) -> str:
    """That what leads does not hold in another state or cannot be tried; empty where nothing is missed there.

    Parameters
    ----------
    state : StateFile
    leader : sequence of str
        Names of what leads, as `CarriedResult.names`.

    Returns
    -------
    str
    """
    one = next((c for c in state.carried if set(c.names) == set(leader)), None)
    if one is None and any(set(name.split(" and ")) == set(leader) for name in state.failed):
        return (
            f"what was learned of {' and '.join(leader)} cannot be tried in {state.state}: no solve succeeds"
        )
    if one is None or one.holds or (state.baseline.low == 0.0 and one.error.low == 0.0):
        return ""
    sensor = "" if state.sensor is None else f", what was seen at the sensor {state.sensor.mean:.2g}"
    holding = [" and ".join(c.names) for c in state.carried if c.holds]
    instead = f"; {holding[0]} does" if holding else ""
    return (
        f"what was learned of {' and '.join(one.names)} does not hold in {state.state}: it leaves "
        f"{one.error.mean:.2g}{unit_words(state.unit)} there, the baseline {state.baseline.mean:.2g}"
        f"{sensor}{instead}"
    )
