"""What a baseline model misses: where the discrepancy lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from zoo.core import digests
from zoo.core.data import Data
from zoo.core.diagnosis.answer import FitDiscrepancy, answer
from zoo.core.diagnosis.bounds import Excluded, freed
from zoo.core.diagnosis.components.pairs import Pair, pairs_of
from zoo.core.diagnosis.components.refining import explain
from zoo.core.diagnosis.components.subsets import several_effects
from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.file import DiagnosisError, DiagnosisFile, HypothesisResult, Where
from zoo.core.diagnosis.hooks import Hooks
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC
from zoo.core.diagnosis.scoring import SENSOR, Scored, score
from zoo.core.diagnosis.screening import MORE, Screened, Screening
from zoo.core.diagnosis.search import SearchError
from zoo.core.diagnosis.states import OtherState, StateResult, hold_in, same_system, state_warning
from zoo.core.effects import AddedEffect, Effect, EffectError
from zoo.core.errors.base import ErrorModel
from zoo.core.errors.spectral import Spectral, spectral_errors
from zoo.core.forward import ForwardModel, SolveError, WithPriors
from zoo.core.outputs import output_folder, write_file

if TYPE_CHECKING:
    from zoo.core.diagnosis.posteriors import SampledExplanations
    from zoo.core.diagnosis.sets import CauseSets

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What `diagnose` found; `file` is the content of diagnosis.json.

    Attributes
    ----------
    data : Data
    file : DiagnosisFile
    rounds : tuple of Scored
        One for each effect that was added, the last one finding no more.
    before, after : FitDiscrepancy
        What the baseline leaves, and what the baseline with its cause leaves.
    computed : tuple of array (n_series, n_times)
        Series of the baseline and of the baseline with all causes.
    sampled : SampledExplanations or None
        Posteriors of the leading explanations.
    hooks : Hooks
        What it was told about the field.
    states : tuple of StateResult
        What it leaves in other states.
    """

    plotter: ClassVar[Callable[[Diagnosis], Any] | None] = None
    """Draws a diagnosis; figures are not of this package."""

    data: Data
    file: DiagnosisFile
    rounds: tuple[Scored, ...] = field(repr=False)
    before: FitDiscrepancy = field(repr=False)
    after: FitDiscrepancy = field(repr=False)
    computed: tuple[Array, Array] = field(repr=False)
    sampled: SampledExplanations | None = field(default=None, repr=False)
    hooks: Hooks = field(default_factory=Hooks, repr=False)
    states: tuple[StateResult, ...] = field(default=(), repr=False)

    def __repr__(self) -> str:
        return f"<Diagnosis of {self.data.name!r}, baseline {self.file.base}: {self.file.verdict}>"

    @property
    def where(self) -> Where:
        """Shares of the discrepancy by series, phase, harmonic and location."""
        return self.file.where

    @property
    def cause(self) -> list[str]:
        """The leading explanation, with all that the data cannot tell from it."""
        return self.file.cause

    @property
    def shrinkage(self) -> float:
        """Part of the discrepancy that the cause removes."""
        return self.file.gap.removed

    @property
    def hypotheses(self) -> list[HypothesisResult]:
        """All explanations, most probable first."""
        return self.file.hypotheses

    def plot(self) -> Any:
        """Discrepancy, hypotheses and locations on one page, by the `plotter` that `zoo.front` sets."""
        if Diagnosis.plotter is None:
            raise DiagnosisError("no figures here: call zoo.plots.plot_diagnosis(d)")
        return Diagnosis.plotter(self)

    def with_posteriors(
        self,
        *,
        cores: int = 2,
        seed: int = 1,
        folder: str | Path | None = None,
        tick: Callable[[str, float], None] | None = None,
    ) -> Self:
        """Sample the posteriors of the baseline and the leading explanations in PyMC, and compare them.

        Parameters
        ----------
        cores, seed : int
        folder : path, optional
            Where posteriors and checkpoints are stored; a killed run goes on there.
        tick : callable, optional
            Called with a text and the share done.

        Returns
        -------
        Diagnosis
            With `sampled`, and its summary in `file`.
        """
        from zoo.core.diagnosis.posteriors import sample_explanations

        began = time.monotonic()
        found = sample_explanations(self.rounds[0], cores=cores, seed=seed, folder=folder, tick=tick)
        record = self.file.record | {"posterior_seconds": time.monotonic() - began}
        content = self.file.model_copy(update={"posteriors": found.summary(), "record": record})
        return replace(self, file=content, sampled=found)

    def sets(self, *, cores: int = 2, tick: Callable[[str, float], None] | None = None) -> CauseSets:
        """The posterior over sets of causes, of which every probability is a sum (docs/causes.md).

        Parameters
        ----------
        cores : int
            Threads.
        tick : callable, optional
            Called with a text and the share done.

        Returns
        -------
        CauseSets
        """
        from zoo.core.diagnosis.sets import cause_sets

        return cause_sets(self.rounds[0].screened, self.hooks, cores=cores, tick=tick)

    confirmed = with_posteriors
    """The former name of `with_posteriors`."""

    def save(self, folder: str | Path) -> Path:
        """Write diagnosis.json, with the digest of its content, into a folder; returns its path."""
        folder = output_folder(folder, ["diagnosis.json"], deep=True)
        folder.mkdir(parents=True, exist_ok=True)
        return write_file(folder / "diagnosis.json", digests.to_text(json.loads(self.file.model_dump_json())))


def _scored(
    screened: Screened,
    hooks: Hooks,
    cores: int,
    tick: Callable[[str, float], None] | None,
    first: bool,
) -> Scored:
    """Probabilities of all explanations; in the first round of the components of the simulator too."""
    screening = screened.screening
    best: dict[str, Fit] = {}
    for fit in sorted(screened.fits.values(), key=lambda f: -f.log_z):
        best.setdefault(fit.hypothesis.name, fit)
    leading = list(best)[:MORE]
    more = dict(zip(leading, screening.and_more([best[n] for n in leading]), strict=True))
    if not first:
        return score(screened, more=more)
    several = several_effects(screened)
    if hooks.components is None:
        return replace(score(screened, more=more), several=several)
    functions = hooks.components(screening.baseline, screened.base.values, screening.data)
    belongs = {name: hooks.component_of(one) for name, one in screening.effects.items()}
    belongs[NONPARAMETRIC] = SENSOR
    explained, pairs = None, list[Pair]()
    if functions:
        explained = explain(screened, functions, cores=cores, tick=tick)
        pairs = pairs_of(screened, explained, functions, cores=cores, tick=tick)
    return replace(score(screened, explained, more, belongs, pairs), several=several)


def _stronger(scored: Scored, exhaust: bool) -> AddedEffect | None:
    """The effect to add before looking further, or None."""
    leader = scored.leader
    if exhaust and leader in (NONPARAMETRIC, CORRELATED):
        leader = next(
            (n for n in scored.names if n in scored.locations and n not in scored.invisible), leader
        )
    if leader not in scored.locations:
        return None
    return scored.best[leader].hypothesis.added[-1]


def _checked(
    data: Data, model: ForwardModel, effects: Sequence[Effect], errors: ErrorModel | None
) -> Spectral:
    if not isinstance(data, Data):
        raise DiagnosisError(f"data = {data!r}: give a zoo.core.data.Data (times, values, labels, units)")
    if not isinstance(model, ForwardModel):
        raise DiagnosisError(
            f"model = {model!r}: has not all of name, parameters, outputs, families, key, configure and "
            "solve; give a zoo.core.forward.ForwardModel, such as a FunctionModel"
        )
    if model.outputs.shape != data.values.shape:
        raise DiagnosisError(
            f"{data.source or data.name}: {model.name} gives series {model.outputs.shape}, the data are "
            f"{data.values.shape}: ask the forward model for the data's series and times"
        )
    if isinstance(effects, str | Effect) or not all(isinstance(one, Effect) for one in effects):
        raise DiagnosisError(f"effects = {effects!r}: give a list of effects")
    for one in effects:
        if not one.offered(model.name):
            only = ", ".join(one.baselines)
            raise EffectError(f"effect {one.name}: cannot be added to {model.name}, only to {only}")
    chosen = spectral_errors(data) if errors is None else errors
    if not isinstance(chosen, Spectral):
        raise DiagnosisError(
            f"errors = {chosen.name}: a diagnosis weighs errors in independent coefficients; give "
            "Harmonics() for periodic series or Cosines() for others"
        )
    for label, series in zip(data.labels, data.values, strict=True):
        if np.ptp(series) == 0.0:
            raise DiagnosisError(
                f"{data.source or data.name}: series {label} is {series[0]:g} throughout; give one that "
                "varies, or leave it out"
            )
    return chosen


def _in_states(
    found: Diagnosis,
    states: Sequence[OtherState],
    freed_model: ForwardModel | None,
    cores: int,
    seed: int,
    tick: Callable[[str, float], None] | None,
) -> Diagnosis:
    """With what it leaves in other states; bounds that were lifted are lifted there too.

    Of a state in which the baseline cannot be solved only that is said.
    """
    first, began = found.rounds[0], time.monotonic()
    group = found.data.groups[found.hooks.rows(found.data)[0]]
    priors = {} if freed_model is None else {p.name: p.prior for p in freed_model.parameters}
    leader, functions, smooth = first.own(first.leader), found.hooks.components, found.hooks.smooth
    results, warnings = [], []
    for state in states:
        given = replace(state, model=WithPriors(state.model, priors)) if priors else state
        try:
            one = hold_in(first, given, group, functions, smooth=smooth, cores=cores, seed=seed, tick=tick)
        except (SearchError, SolveError) as error:
            warnings.append(
                f"in {state.data.name} the baseline cannot be solved ({error}), so that nothing is said of "
                f"this state; {found.hooks.advice}"
            )
            continue
        results.append(one)
        warnings += [*one.warnings, *filter(None, [state_warning(one.file, leader)])]
    file = found.file.model_copy(
        update={
            "states": [one.file for one in results],
            "warnings": [*found.file.warnings, *warnings],
            "record": found.file.record | {"states_seconds": time.monotonic() - began},
        }
    )
    return replace(found, file=file, states=tuple(results))


def diagnose(
    data: Data,
    model: ForwardModel,
    effects: Sequence[Effect],
    *,
    errors: ErrorModel | None = None,
    hooks: Hooks | None = None,
    states: Sequence[OtherState] = (),
    max_effects: int = 3,
    exhaust: bool = False,
    posteriors: bool = False,
    cores: int = 2,
    seed: int = 1,
    tick: Callable[[str, float], None] | None = None,
    folder: str | Path | None = None,
) -> Diagnosis:
    """Find where a baseline model misses data, which unmodelled effect explains it, and how well.

    Every effect is fitted with the baseline and weighed by its marginal likelihood, beside the null
    hypothesis "no-gap" (noise alone), "correlated-noise", and "unlisted" (a nonparametric smooth
    discrepancy). The best is added and the rest weighed again, until noise or nothing listed explains what
    is left.

    Parameters
    ----------
    data : Data
        What was measured.
    model : ForwardModel
        The baseline, with priors of its parameters; its outputs are the data's series and times.
    effects : sequence of Effect
        What the baseline may lack.
    errors : Spectral, optional
        `Harmonics` for periodic series, `Cosines` for others; which is chosen from the data if absent.
    hooks : Hooks, optional
        Phases of the record, candidate measurements, words.
    states : sequence of OtherState
        Other states of the same system, in which what was learned is fixed and compared with the baseline
        and with the discrepancy that was seen at the sensor; they change no probability.
    max_effects : int
        Most effects to add.
    exhaust : bool
        Go on adding the best listed effect where a nonparametric discrepancy explains more: what the effects
        can do at most. The verdict is that of the first round all the same.
    posteriors : bool
        Sample the posteriors of the leading explanations in PyMC.
    cores : int
        Threads, and processes of the posterior sampling.
    seed : int
        Of the draws.
    tick : callable, optional
        Called with a text and the share of the screening that is done.
    folder : path, optional
        Where the posterior sampling stores its posteriors and checkpoints.

    Returns
    -------
    Diagnosis

    Raises
    ------
    DiagnosisError
        If an argument is out of range, a series does not vary, or the baseline cannot be fitted.
    EffectError
        If an effect cannot be added to this baseline.

    References
    ----------
    Kennedy and O'Hagan 2001, doi 10.1111/1467-9868.00294.
    """
    for what, count in (("max_effects", max_effects), ("cores", cores)):
        if count < 1:
            raise DiagnosisError(f"{what} = {count}: must be at least 1")
    chosen, hooks = _checked(data, model, effects, errors), hooks or Hooks()
    for state in states:  # before the work
        _checked(state.data, state.model, (), state.errors)
        same_system(data, model, state)
    for i, state in enumerate(states):
        if state.data.checksum in [one.data.checksum for one in states[:i]]:
            raise DiagnosisError(f"{state.data.source or state.data.name}: given twice as another state")
    began = time.monotonic()
    started = datetime.now(UTC).isoformat(timespec="seconds")
    rounds: list[Scored] = []
    excluded: Excluded | None = None
    added: list[AddedEffect] = []
    while True:
        start = rounds[-1].best[added[-1].name].u if added else None
        screening = Screening(
            data,
            model,
            effects,
            errors=chosen,
            added=added,
            start=start,
            smooth=hooks.smooth,
            kinks=hooks.kinks,
            cores=cores,
            tick=tick,
        )
        try:
            if not rounds:
                screening, excluded = freed(screening)
                model = screening.baseline
            scored = _scored(screening.run(stop_at_noise=bool(rounds)), hooks, cores, tick, not rounds)
        except (SearchError, SolveError) as error:
            if rounds:
                break
            raise DiagnosisError(
                f"{data.source or data.name}: the baseline {model.name!r} cannot be solved ({error}); "
                f"{hooks.advice}"
            ) from None
        rounds.append(scored)
        best = _stronger(scored, exhaust)
        if best is None or len(added) == max_effects:
            break
        added.append(best)
    first = rounds[0]
    file, before, after = answer(rounds, hooks, seed, started, time.monotonic() - began, excluded)
    last = rounds[-1].screened.least if len(rounds) > 1 else first.best[first.leader]
    base, cause = (first.screened.screening.errors.unflat(f.computed) for f in (first.screened.least, last))
    found = Diagnosis(data, file, tuple(rounds), before, after, (base, cause), hooks=hooks)
    if states:
        found = _in_states(found, states, model if excluded else None, cores, seed, tick)
    return found.with_posteriors(cores=cores, seed=seed, folder=folder, tick=tick) if posteriors else found
