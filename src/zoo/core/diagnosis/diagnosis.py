"""What a baseline model misses: where the discrepancy lies, which effect causes it, how far it shrinks."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.core import digests
from zoo.core.arrays import finite_array
from zoo.core.data import Data
from zoo.core.diagnosis.answer import answer
from zoo.core.diagnosis.bounds import freed
from zoo.core.diagnosis.discrepancies import CauseDraws, Discrepancy, estimate_of, interval_of, together
from zoo.core.diagnosis.file import (
    CauseResult,
    ComponentResult,
    DiagnosisError,
    DiagnosisFile,
    Estimate,
    SetResult,
    Where,
)
from zoo.core.diagnosis.fitting import Fitting
from zoo.core.diagnosis.hooks import Hooks
from zoo.core.diagnosis.importance import check_sets
from zoo.core.diagnosis.preflight import preflight
from zoo.core.diagnosis.search import SearchError
from zoo.core.diagnosis.sets import CauseSearch, CauseSets
from zoo.core.diagnosis.solve_store import SolveStore, StoredModel
from zoo.core.diagnosis.states import OtherState, StateResult, hold_in, same_system, state_warning
from zoo.core.diagnosis.wording import worded
from zoo.core.effects import Effect, EffectError
from zoo.core.errors.base import ErrorModel
from zoo.core.errors.spectral import Spectral, spectral_errors
from zoo.core.experiments import Experiments
from zoo.core.forward import ForwardModel, Outputs, SolveError, WithPriors
from zoo.core.inference.progress import Display
from zoo.core.inference.record import versions
from zoo.core.outputs import output_folder, write_file
from zoo.core.words import choices

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from zoo.core.diagnosis.posteriors import SampledExplanations

Array = NDArray[np.float64]
ROW = re.compile(r"\[\n[^\[\]{}]*\]|\[\n *\[[\d,\s]*\],[^\[\]{}]*\]")
"""A list of numbers, or a row of the table of sets, over many lines of JSON."""
EVERY_S = 5.0
"""Seconds between lines on the progress where there is no terminal."""
SAME_TIMES = 1e-3
"""Difference of times, in parts of the record, up to which they are the same."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What `diagnose` found.

    Attributes
    ----------
    data : Data
    file : DiagnosisFile
        The content of diagnosis.json.
    before, after : Discrepancy
        What is true beyond the baseline, and beyond the leading set of causes.
    draws : CauseDraws
        Draws from the posterior, with the sets' probabilities as weights.
    sets : CauseSets
        The posterior over sets of causes, and the sets that were solved.
    sampled : SampledExplanations or None
        Posteriors of the leading sets of listed effects.
    hooks : Hooks
        What it was told about the field.
    states : tuple of StateResult
        What it leaves in other states.
    """

    plotter: ClassVar[Callable[[Diagnosis], Figure] | None] = None
    """Draws a diagnosis; figures are not of this package."""

    data: Data
    file: DiagnosisFile = field(repr=False)
    before: Discrepancy = field(repr=False)
    after: Discrepancy = field(repr=False)
    draws: CauseDraws = field(repr=False)
    sets: CauseSets = field(repr=False)
    sampled: SampledExplanations | None = field(default=None, repr=False)
    hooks: Hooks = field(default_factory=Hooks, repr=False)
    states: tuple[StateResult, ...] = field(default=(), repr=False)

    def __repr__(self) -> str:
        return str(self.file)

    def _repr_html_(self) -> str:
        return self.file._repr_html_()

    def with_file(self, **changes: Any) -> Self:
        """The same with some fields of the file changed, and its answer in words again."""
        return replace(self, file=worded(self.file.model_copy(update=changes)))

    @property
    def computed(self) -> tuple[Array, Array]:
        """Series of the baseline, and of the baseline with the leading set of causes, (n_series, n_times)."""
        base, leader = (self.data.values - one.residual for one in (self.before, self.after))
        return base, leader

    @property
    def where(self) -> Where:
        """Shares of the discrepancy by series, phase, harmonic and location."""
        return self.file.where

    @property
    def cause(self) -> list[str]:
        """The causes of the most probable set that was solved; empty where that is nothing."""
        return self.file.cause

    @property
    def shrinkage(self) -> float:
        """Part of the discrepancy that the cause removes."""
        return self.file.gap.removed

    @property
    def components(self) -> list[ComponentResult]:
        """Components of the simulator, the most probably wrong first."""
        return self.file.components

    @property
    def causes(self) -> list[CauseResult]:
        """Listed effects and free functions, most probable first."""
        return self.file.causes

    @property
    def table(self) -> list[SetResult]:
        """Sets of causes with prior and evidence, most probable first."""
        return self.file.sets

    def plot(self) -> Figure:
        """Discrepancy, causes and locations on one page, by the `plotter` that `zoo.front` sets."""
        if Diagnosis.plotter is None:
            raise DiagnosisError("no figures here: call zoo.plots.plot_diagnosis(d)")
        return Diagnosis.plotter(self)

    def predict(
        self, outputs: Outputs | ArrayLike | None = None, *, draws: int = 100, seed: int = 1
    ) -> pd.DataFrame:
        """Predict the true series over all solved sets of causes, where measured or elsewhere.

        Parameters
        ----------
        outputs : Outputs or array (n_times,), optional
            Other series and times, or other times of the same series, solved at draws from the posterior. If
            absent those that were measured, with the discrepancy that no cause explains, from the linear
            model around each set.
        draws : int
            Solves, where outputs are given.
        seed : int

        Returns
        -------
        pandas.DataFrame
            Columns series, time, mean, low and high, the ends of the 95 % interval; noise is not included.

        Raises
        ------
        DiagnosisError
            If no solve succeeds.
        """
        import pandas as pd

        sets = self.draws.sets
        if outputs is None:
            flat, weights = together(sets, lambda one: one.computed + one.left)
            series = self.sets.search.family.errors.unflat(flat)
            labels, times = self.data.labels, self.data.times
        else:
            if not isinstance(outputs, Outputs):
                outputs = Outputs(
                    tuple(self.data.outputs), finite_array("times", outputs, error=DiagnosisError)
                )
            rng, solved = np.random.default_rng(seed), []
            for k in rng.choice(len(sets), draws, p=[one.weight for one in sets]):
                u = sets[k].values(slice(None))[rng.integers(len(sets[k].x))]
                if (one := sets[k].solved.forward.series(u, outputs)) is not None:
                    solved.append(one)
            if not solved:
                why = next((one.solved.forward.last_failure for one in sets), "")
                raise DiagnosisError(
                    f"outputs = {outputs.series} at {len(outputs.times)} times: no solve succeeds ({why}); "
                    "ask for others"
                )
            series, weights = np.array(solved), np.ones(len(solved))
            labels, times = tuple(map(str, outputs.series)), outputs.times
        bands = {
            (label, time): interval_of(series[:, i, j], weights)
            for i, label in enumerate(labels)
            for j, time in enumerate(times.tolist())
            if not np.isnan(series[0, i, j])
        }
        return pd.DataFrame(
            [(*at, band.mean, band.low, band.high) for at, band in bands.items()],
            columns=["series", "time", "mean", "low", "high"],
        )

    def estimate(self, quantity: Callable[[Mapping[str, float]], float], unit: str = "1") -> Estimate:
        """Estimate a quantity that the baseline's parameters give, over all solved sets of causes.

        Parameters
        ----------
        quantity : callable
            ``quantity(parameters)`` of a dict with a value for each parameter, such as
            ``lambda p: p["psi1"] + p["psi2"]``.
        unit : str

        Returns
        -------
        Estimate
            Mean, standard deviation and 95 % interval.

        Raises
        ------
        DiagnosisError
            If it asks for a parameter that is not there.

        See Also
        --------
        predict : for what the simulator computes, anywhere.
        """
        of = self.sets.search.fitting.forward.parameters
        u, weights = together(self.draws.sets, lambda one: one.values(slice(0, len(of))))
        values = [{p.name: float(p.value(x)) for p, x in zip(of, row, strict=True)} for row in u]
        try:
            draws = [float(quantity(parameters)) for parameters in values]
        except KeyError as error:
            names = [p.name for p in of]
            told = f"no parameter is named {error.args[0]!r}: {choices(str(error.args[0]), names)}"
            raise DiagnosisError(f"quantity: {told}") from None
        return estimate_of(getattr(quantity, "__name__", "quantity"), unit, np.array(draws), weights)

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
        found = sample_explanations(self.sets, cores=cores, seed=seed, folder=folder, tick=tick)
        record = self.file.record | {"posterior_seconds": time.monotonic() - began}
        return replace(self.with_file(posteriors=found.summary(), record=record), sampled=found)

    def with_check(
        self, *, draws: int = 64, seed: int = 1, tick: Callable[[str, float], None] | None = None
    ) -> Self:
        """Solve the leading sets away from their modes too, which corrects their evidence.

        Parameters
        ----------
        draws : int
            Of each set.
        seed : int
        tick : callable, optional
            Called with a text and the share done.

        Returns
        -------
        Diagnosis
            With what was found in the `record` of `file`, as "check".
        """
        checked = check_sets(self.sets, draws=draws, seed=seed, tick=tick or (lambda text, share: None))
        told = [asdict(one) | {"which": self.sets.name(one.which)} for one in checked]
        return self.with_file(record=self.file.record | {"check": told})

    def save(self, folder: str | Path) -> Path:
        """Write diagnosis.json, with the digest of its content, into a folder; returns its path."""
        folder = output_folder(folder, ["diagnosis.json"], deep=True)
        folder.mkdir(parents=True, exist_ok=True)
        text = digests.to_text(json.loads(self.file.model_dump_json()))
        return write_file(folder / "diagnosis.json", ROW.sub(lambda m: " ".join(m[0].split()), text))


def refuse_twice(names: Sequence[str]) -> None:
    """Raise DiagnosisError where an effect or a free function is given twice."""
    for i, name in enumerate(names):
        if name in names[:i]:
            raise DiagnosisError(
                f"effects: {name} is given twice; give it once, or another name to one of them"
            )


def _checked(
    data: Data, model: ForwardModel, effects: Sequence[Effect], errors: ErrorModel | None
) -> Spectral:
    if not isinstance(data, Data):
        raise DiagnosisError(f"data = {data!r}: give a zoo.Data (times, values, labels, units)")
    if not isinstance(model, ForwardModel):
        raise DiagnosisError(
            f"model = {model!r}: has not all of name, parameters, outputs, families, key, configure and "
            "solve; give a zoo.ForwardModel, such as a zoo.FunctionModel"
        )
    if not model.parameters:
        raise DiagnosisError(
            f"{model.name} has no parameters: give it at least one with a prior, such as "
            "priors={'offset': zoo.Normal(0, 1)}"
        )
    if model.outputs.shape != data.values.shape:
        raise DiagnosisError(
            f"{data.source or data.name}: {model.name} gives series {model.outputs.shape}, the data are "
            f"{data.values.shape}: ask the forward model for the data's series and times"
        )
    _same_outputs(data, model)
    if isinstance(effects, str | Effect) or not all(isinstance(one, Effect) for one in effects):
        raise DiagnosisError(f"effects = {effects!r}: give a list of effects")
    refuse_twice([one.name for one in effects])
    for one in effects:
        if not one.offered(model.name):
            only = ", ".join(one.baselines)
            raise EffectError(f"effect {one.name}: cannot be added to {model.name}, only to {only}")
    chosen = spectral_errors(data) if errors is None else errors
    if not isinstance(chosen, Spectral):
        raise DiagnosisError(
            f"errors = {chosen.name}: a diagnosis weighs errors in independent coefficients; give "
            "Harmonics() for periodic series, Uneven() for times in unequal steps, or Cosines()"
        )
    for label, series in zip(data.labels, map(data.samples, range(data.n_series)), strict=True):
        if np.ptp(series) == 0.0:
            raise DiagnosisError(
                f"{data.source or data.name}: series {label} is {series[0]:g} throughout; give one that "
                "varies, or leave it out"
            )
    return chosen


def _same_outputs(data: Data, model: ForwardModel) -> None:
    """Refuse a model that is asked for other series or times than were measured."""
    where, outputs = data.source or data.name, model.outputs
    off = np.abs((outputs.times - outputs.times[0]) - (data.times - data.times[0])).max()
    if off > SAME_TIMES * data.duration:
        raise DiagnosisError(
            f"{where}: {model.name} is solved at times {outputs.times[0]:g} to {outputs.times[-1]:g}, the "
            f"data are of {data.times[0]:g} to {data.times[-1]:g} {data.time_unit}: ask it for these times"
        )
    if tuple(outputs.series) != tuple(data.outputs):
        asked, measured = (", ".join(map(str, x)) for x in (outputs.series, data.outputs))
        raise DiagnosisError(
            f"{where}: {model.name} gives series {asked}, the data are {measured}: give Outputs of the "
            "data's series in their order, or Data(outputs=...) if only the labels differ"
        )


def _stored(model: ForwardModel, store: SolveStore) -> ForwardModel:
    """The model with its solves kept; of several experiments those of each."""
    if isinstance(model, Experiments):
        return model.each(lambda one: StoredModel(one, store))
    return StoredModel(model, store)


def _in_states(
    found: Diagnosis,
    states: Sequence[OtherState],
    store: SolveStore,
    cores: int,
    seed: int,
    tick: Callable[[str, float], None],
) -> Diagnosis:
    """With what it leaves in other states; bounds that were lifted are lifted there too.

    Of a state in which the baseline cannot be solved only that is said.
    """
    began = time.monotonic()
    group = found.data.groups[found.hooks.rows(found.data)[0]]
    lifted = found.sets.search.fitting.baseline.parameters if found.file.excluded else ()
    priors = {p.name: p.prior for p in lifted}
    results, warnings = [], []
    for state in states:
        model = StoredModel(state.model, store)
        given = replace(state, model=WithPriors(model, priors) if priors else model)
        try:
            one = hold_in(found.sets, given, group, found.hooks, cores=cores, seed=seed, tick=tick)
        except (SearchError, SolveError) as error:
            warnings.append(
                f"in {state.data.name} the baseline cannot be solved ({error}), so that nothing is said of "
                f"this state; {found.hooks.advice}"
            )
            continue
        results.append(one)
        warned = state_warning(one.file, found.sets.components(found.sets.leader))
        warnings += [*one.warnings, *filter(None, [warned])]
    changed = found.with_file(
        states=[one.file for one in results],
        warnings=[*found.file.warnings, *warnings],
        record=found.file.record | {"states_seconds": time.monotonic() - began},
    )
    return replace(changed, states=tuple(results))


def diagnose(
    data: Data,
    model: ForwardModel,
    effects: Sequence[Effect],
    *,
    errors: ErrorModel | None = None,
    hooks: Hooks | None = None,
    states: Sequence[OtherState] = (),
    posteriors: bool = False,
    cores: int = 2,
    seed: int = 1,
    tick: Callable[[str, float], None] | None = None,
    progress: bool = True,
    folder: str | Path | None = None,
    checkpoint: str | Path | None = None,
) -> Diagnosis:
    """Find where a baseline model misses data, which unmodelled causes explain it, and how well.

    p(S | z) is proportional to p(S) p(z | S), S a set of causes: listed effects, and free functions of the
    simulator's components, beside a discrepancy that nobody can name and noise (docs/diagnosis.md).

    Parameters
    ----------
    data : Data
        What was measured.
    model : ForwardModel
        The baseline, with priors of its parameters; its outputs are the data's series and times.
    effects : sequence of Effect
        What the baseline may lack.
    errors : Spectral, optional
        `Harmonics` for periodic series, `Cosines` for others, `Uneven` where times are in unequal steps;
        which is chosen from the data if absent.
    hooks : Hooks, optional
        Phases of the record, candidate measurements, words.
    states : sequence of OtherState
        Other states of the same system, in which what was learned is fixed and compared with the baseline
        and with the discrepancy that was seen at the sensor; they change no probability.
    posteriors : bool
        Sample the posteriors of the leading explanations in PyMC.
    cores : int
        Threads, and processes of the posterior sampling.
    seed : int
        Of the draws.
    tick : callable, optional
        Called with a text and the share of the screening that is done.
    progress : bool
        Without a `tick`, show on standard error what is being done.
    folder : path, optional
        Where the posterior sampling stores its posteriors and checkpoints.
    checkpoint : path, optional
        Folder in which solves are kept: a diagnosis that was interrupted goes on from there.

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
    if cores < 1:
        raise DiagnosisError(f"cores = {cores}: must be at least 1")
    chosen, hooks = _checked(data, model, effects, errors), hooks or Hooks()
    if posteriors and not data.whole:
        raise DiagnosisError(
            f"{data.source or data.name}: posteriors: need all series at the same times, and some lack "
            "samples that others have; leave them out, and sample a model with GroupNoise() or GroupProcess()"
        )
    for state in states:  # before the work
        _checked(state.data, state.model, (), state.errors)
        same_system(data, model, state)
    for i, state in enumerate(states):
        if state.data.checksum in [one.data.checksum for one in states[:i]]:
            raise DiagnosisError(f"{state.data.source or state.data.name}: given twice as another state")
    began = time.monotonic()
    started = datetime.now(UTC).isoformat(timespec="seconds")
    store = SolveStore(checkpoint)
    try:
        with Display(progress and tick is None, every_s=EVERY_S) as shown:
            tell = tick or shown
            stored = _stored(model, store)
            fitting = Fitting(data, stored, chosen.bind(data), smooth=hooks.smooth, cores=cores)
            offered = [e.of(model) for e in effects if e.apply is not None and e.offered(model.name)]
            preflight(fitting, model, offered, tell)
            found = _searched(fitting, offered, hooks, seed, tell)
            record = found.file.record | {
                "started": started, "solves": store.made, "failed_solves": store.failed,
                "seconds": time.monotonic() - began,
            }  # fmt: skip
            found = found.with_file(record=record)
            if states:
                found = _in_states(found, states, store, cores, seed, tell)
    except (Exception, KeyboardInterrupt) as error:
        if not isinstance(error, DiagnosisError):
            kept = "give checkpoint='FOLDER' to keep them" if checkpoint is None else f"kept in {checkpoint}"
            error.add_note(f"{store.made} solves were made until then: {kept}")
        raise
    finally:
        store.close()
    return found.with_posteriors(cores=cores, seed=seed, folder=folder, tick=tick) if posteriors else found


def _searched(
    fitting: Fitting,
    effects: Sequence[Effect],
    hooks: Hooks,
    seed: int,
    tick: Callable[[str, float], None],
) -> Diagnosis:
    """The diagnosis of one record."""
    data = fitting.data
    try:
        fitting, excluded = freed(fitting, hooks.rows(data))
        sets = CauseSearch(fitting, effects, hooks, tick).run()
        sets.search.tick = _silent  # a display cannot be sent to another process
    except (SearchError, SolveError) as error:
        raise DiagnosisError(
            f"{data.source or data.name}: the baseline {fitting.baseline.name!r} cannot be solved ({error}); "
            f"{hooks.advice}"
        ) from None
    record = {
        "versions": versions(),
        "seed": seed,
        "cores": fitting.cores,
        "gap_unit": data.units[hooks.rows(data)[0]],
    }
    return Diagnosis(data, *answer(sets, hooks, seed, record, excluded), sets, hooks=hooks)


def _silent(text: str, share: float) -> None:
    """Say nothing."""
