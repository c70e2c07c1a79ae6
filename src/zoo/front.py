"""The front door of the diagnosis: a study or any other data go in, and what comes out can draw itself."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence, Sized
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from zoo.core import diagnosis
from zoo.core.arrays import Array
from zoo.core.components import FreeFunction, FunctionOf
from zoo.core.data import Data, own_clocks
from zoo.core.diagnosis import Diagnosis, Hooks, OtherState
from zoo.core.diagnosis.diagnosis import refuse_twice
from zoo.core.effects import Effect
from zoo.core.errors.spectral import Spectral, spectral_errors
from zoo.core.experiments import Experiments
from zoo.core.forward import ForwardModel, FunctionModel, Outputs, at_all_times
from zoo.core.parameters import Parameter, Prior, as_parameters
from zoo.core.user_code import unfit
from zoo.core.words import refuse_unknown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from zoo.blood.conventions import Conventions
    from zoo.blood.solver import SolverOptions
    from zoo.blood.study import Study
    from zoo.blood.study_diagnosis import StudyDiagnosis

Simulate = Callable[[dict[str, Any], Array], ArrayLike]
Priors = Mapping[str, Prior | Parameter] | Mapping[str, Any]
Causes = Sequence[Effect | FunctionOf] | Effect | FunctionOf
Record = tuple[ArrayLike, ArrayLike, Simulate]
"""Times, what was measured then, and the simulator of one experiment."""


class Running(TypedDict, total=False):
    """How a diagnosis is run, of whatever data."""

    posteriors: bool
    cores: int
    seed: int
    tick: Callable[[str, float], None] | None
    progress: bool
    folder: str | Path | None
    checkpoint: str | Path | None


class Weighing(Running, total=False):
    """What a diagnosis of other data than a study is told, too."""

    noise: float | Mapping[str, float] | None
    errors: Spectral | None
    hooks: Hooks | None


def _plot(found: Any) -> Figure:
    from zoo.plots import plot_diagnosis

    return plot_diagnosis(found)


Diagnosis.plotter = staticmethod(_plot)  # the core draws nothing itself


@overload
def diagnose(
    study: Study | str,
    base: str = "linear-constant",
    *,
    effects: Iterable[str | Effect] | None = None,
    conventions: Conventions | None = None,
    options: SolverOptions | None = None,
    priors: Mapping[str, Any] | None = None,
    fixed: Mapping[str, float] | None = None,
    component_sizes: float = 1.0,
    states: Sequence[Study] = (),
    **settings: Unpack[Running],
) -> StudyDiagnosis: ...


@overload
def diagnose(
    studies: Sequence[Study | str],
    base: str = "linear-constant",
    *,
    share: Iterable[str] = (),
    effects: Iterable[str | Effect] | None = None,
    conventions: Conventions | None = None,
    options: SolverOptions | None = None,
    priors: Mapping[str, Any] | None = None,
    fixed: Mapping[str, float] | None = None,
    component_sizes: float = 1.0,
    **settings: Unpack[Running],
) -> Diagnosis: ...


@overload
def diagnose(
    experiments: Mapping[str, Record] | Sequence[Record],
    priors: Priors,
    effects: Causes = (),
    *,
    share: Iterable[str] = (),
    labels: Sequence[str] = (),
    units: Sequence[str] = (),
    period: float | None = None,
    **settings: Unpack[Weighing],
) -> Diagnosis: ...


@overload
def diagnose(
    data: Data,
    model: ForwardModel,
    effects: Causes = (),
    *,
    states: Sequence[OtherState] = (),
    **settings: Unpack[Weighing],
) -> Diagnosis: ...


@overload
def diagnose(
    times: ArrayLike,
    measured: ArrayLike,
    simulate: Simulate,
    priors: Priors,
    effects: Causes = (),
    *,
    labels: Sequence[str] = (),
    units: Sequence[str] = (),
    period: float | None = None,
    name: str = "data",
    held_out: Mapping[str, Record] | None = None,
    **settings: Unpack[Weighing],
) -> Diagnosis: ...


def diagnose(*arguments: Any, **settings: Any) -> Any:
    """Find what a simulator lacks that data show, with a probability for every set of causes.

    p(S | y) is proportional to p(S) p(y | S), S a set of causes: effects and free functions, beside noise and
    a discrepancy that belongs to no cause. There are five ways to call it::

        diagnose(times, measured, simulate, priors, effects)    any function that simulates
        diagnose({"name": (times, measured, simulate), ...}, priors, effects, share=[...])
                                                                several experiments together
        diagnose(data, model, effects)                          a `Data` and a `ForwardModel`
        diagnose(study, base)                                   a study of blood flow, or its name
        diagnose([study, study, ...], base, share=[...])        several together

    Of several experiments a cause acts in all, with one size, and there is one posterior over sets of causes
    given all of them. A quantity has one noise in all, unless `noise` states that of "name/series".

    Parameters
    ----------
    times : array (n_times,), or sequence of array
        Ascending, in s; or those of each series. The simulator is called with all of them, those at which
        nothing was measured too.
    measured : array (n_times,) or (n_series, n_times), or sequence of array
        A row for each series, in its own unit; NaN, and what is masked, is not measured.
    simulate : function
        ``simulate(parameters, times) -> array`` of the shape of `measured`. `parameters` is a dict of numbers
        by name, which effects change and add to.
    priors : mapping
        By name of parameter: a prior such as `zoo.Normal`, a frozen distribution of SciPy, or a
        `zoo.Parameter`, which has a unit too. Of a study: instead of some of its own.
    effects : sequence of Effect or free function, or one
        What the simulator may lack, by `zoo.effect` and `zoo.free_function`. Of a study: names of the
        catalogue, too; all that fit the baseline if absent.
    labels, units : sequence of str
        Of each series; "y0", "y1" and so on, and "1", if absent.
    period : float, optional
        Of a record that repeats itself, in s; `times` then cover it once.
    name : str
        Of the data.
    fixed : mapping, optional
        Of a study: parameters that are held at a value, ``{"psi1": 1.0}``.
    held_out : mapping, optional
        Other records of the same system, ``{"name": (times, measured, simulate)}``. What was learned is fixed
        and checked there; they change no probability.
    experiments : mapping, or sequence
        ``{"name": (times, measured, simulate)}``, each with a simulator that knows its input; named "1", "2"
        and so on in a sequence.
    share : sequence of str
        Parameters of several experiments or studies that are one for all. All others are of each, such as
        "height[name]", with the same prior.
    data : Data
        Series of several groups, or with another unit of time.
    model : ForwardModel
        A simulator with parameters and priors of its own; its outputs are the data's series and times.
    noise : float or mapping, optional
        Sd of the white noise where it is known, as of a data sheet, in the unit of the series; of series in
        several units by their labels, ``{"tea": 0.1}``. It is fitted where it is absent.
    errors : Harmonics or Cosines, optional
        Noise and discrepancy of periodic series, and of others; chosen by the data if absent.
    hooks : Hooks, optional
        Phases of the record, candidate measurements, words of the field.
    study : Study or str
        As `zoo.load_study` gives it or takes its name.
    studies : sequence of Study or str
        Several of them, of trees in which the same effects can act.
    base : str
        Baseline: the letter of a model, or "linear-constant", "linear-radius", "linear-vessels",
        "tangent-constant", "tangent-radius".
    conventions : Conventions, optional
        Instead of the study's own.
    options : SolverOptions, optional
        Numerical settings instead of those that follow from the study.
    component_sizes : float
        Factor of the prior sizes of the free functions of blood flow; 0 leaves them out, and saves most of
        the time.
    states : sequence of Study, or of OtherState
        Other states of the same system, for a study and for a `Data`; see `held_out`.
    posteriors : bool
        Sample the posteriors of the leading sets of effects in PyMC too.
    cores : int
        Threads, and processes of the sampling.
    seed : int
        Of the draws.
    progress : bool
        Show on standard error what is being done and how far it is.
    tick : function, optional
        Instead of that, called with a text and the share done.
    checkpoint : path, optional
        Folder in which solves are kept: a diagnosis that was interrupted goes on from there, and none is made
        twice.
    folder : path, optional
        Where the sampling stores posteriors and checkpoints.

    Returns
    -------
    Diagnosis
        `print` shows the verdict; `table`, `components`, `causes`, `where` and `shrinkage` say more, `plot()`
        draws it on one page, `with_posteriors()` samples the posteriors of the leading sets of effects.

    Raises
    ------
    DiagnosisError
        If an argument is out of range, a series does not vary, or the baseline cannot be fitted.
    DataError
        If times and measured values do not fit together.
    ExperimentError
        If several experiments cannot be taken as one.
    TypeError
        For a setting that does not exist.

    Examples
    --------
    >>> import zoo
    >>> found = zoo.diagnose("demo", base="B")  # doctest: +SKIP
    >>> found.plot().savefig("gap.png")  # doctest: +SKIP

    References
    ----------
    Kennedy and O'Hagan 2001, doi 10.1111/1467-9868.00294.
    """
    from zoo.blood.study import Study, load_study
    from zoo.blood.study_diagnosis import diagnose as diagnose_study
    from zoo.blood.study_diagnosis import diagnose_studies

    kinds = ("study", "studies", "data", "experiments")
    first = arguments[0] if arguments else next((settings[one] for one in kinds if one in settings), None)
    function: Any = _diagnose_data if isinstance(first, Data) else _diagnose_series
    items = [*first] if isinstance(first, list | tuple) else []
    listed = [one for one in items if isinstance(one, list | tuple)]
    pairs = [one for one in listed if isinstance(one, tuple)]
    holds = any(callable(x) for one in listed for x in one)
    if isinstance(first, Mapping) or holds or any(isinstance(x, Sized) for one in pairs for x in one):
        function = _diagnose_experiments
    known = [*inspect.signature(function).parameters, *inspect.signature(diagnosis.diagnose).parameters]
    if isinstance(first, str | Study):
        function, known = diagnose_study, [*inspect.signature(diagnose_study).parameters]
    elif any(isinstance(one, str | Study) for one in items):
        function, known = (
            diagnose_studies,
            [*inspect.signature(diagnose_studies).parameters, *Running.__annotations__],
        )
        items = [load_study(one) if isinstance(one, str) else one for one in items]
        arguments, settings = (items, *arguments[1:]), {k: v for k, v in settings.items() if k != "studies"}
    refuse_unknown("diagnose", settings, [name for name in known if name != "settings"])
    inspect.signature(function).bind(*arguments, **settings)  # names what is missing
    if isinstance(first, str):
        arguments = (load_study(first), *arguments[1:])
    return function(*arguments, **settings)


def _diagnose_series(
    times: ArrayLike,
    measured: ArrayLike,
    simulate: Simulate,
    priors: Priors,
    effects: Causes = (),
    *,
    labels: Sequence[str] = (),
    units: Sequence[str] = (),
    period: float | None = None,
    name: str = "data",
    held_out: Mapping[str, Record] | None = None,
    noise: float | Mapping[str, float] | None = None,
    **settings: Any,
) -> Diagnosis:
    parameters = as_parameters(priors)
    here = _bound(name, (times, measured, simulate), parameters, labels, units, period)
    records = _records("held_out", {} if held_out is None else held_out)
    others = _bound_all(records, parameters, labels, units, period)
    return _diagnose_data(here.data, here.model, effects, states=others, noise=noise, **settings)


def _diagnose_experiments(
    experiments: Mapping[str, Record] | Sequence[Record],
    priors: Priors,
    effects: Causes = (),
    *,
    share: Iterable[str] = (),
    labels: Sequence[str] = (),
    units: Sequence[str] = (),
    period: float | None = None,
    hooks: Hooks | None = None,
    errors: Spectral | None = None,
    noise: float | Mapping[str, float] | None = None,
    **settings: Any,
) -> Diagnosis:
    if not isinstance(experiments, Mapping):
        experiments = {str(i): one for i, one in enumerate(experiments, 1)}
    bound = _bound_all(_records("experiments", experiments), as_parameters(priors), labels, units, period)
    models = {one.data.name: _at_given_times(one.data, one.model) for one in bound}
    known = errors.known if isinstance(errors, Spectral) else noise if isinstance(noise, Mapping) else ()
    own_noise = any(group.split("/")[0] in models for group in known)
    several = Experiments(models, {one.data.name: one.data for one in bound}, share, own_noise)
    hooks = hooks or Hooks()
    if isinstance(hooks.about, str):
        hooks = replace(hooks, about=several.about(hooks.about))
    return _diagnose_data(several.data, several, effects, hooks=hooks, errors=errors, noise=noise, **settings)


def _records(field: str, given: Any) -> Mapping[str, Record]:
    """Records by name, each of times, measured values and a simulator."""
    if not isinstance(given, Mapping) or not all(
        isinstance(one, str) and one and isinstance(x, tuple | list) and len(x) == 3
        for one, x in given.items()
    ):
        raise diagnosis.DiagnosisError(
            f"{field} = {given!r:.60}: give a dict of records, {{'name': (times, measured, simulate)}}"
        )
    return given


def _bound_all(
    records: Mapping[str, Record],
    parameters: tuple[Parameter, ...],
    labels: Sequence[str],
    units: Sequence[str],
    period: float | None,
) -> list[OtherState]:
    """Several records with their simulators; one that repeats itself covers its own period once."""
    return [
        _bound(name, record, parameters, labels, units, _own_period(record[0], period))
        for name, record in records.items()
    ]


def _own_period(times: Any, period: float | None) -> float | None:
    """What a record of even steps covers; else the period that is given."""
    try:
        steps = np.diff(np.asarray(times[0] if own_clocks(times) else times, dtype=np.float64))
    except (TypeError, ValueError):  # which is told where the times are taken
        return period
    even = period is not None and steps.ndim == 1 and steps.size and np.allclose(steps, steps[0])
    return float((len(steps) + 1) * steps[0]) if even else period


def _bound(
    name: str,
    record: Record,
    parameters: tuple[Parameter, ...],
    labels: Sequence[str],
    units: Sequence[str],
    period: float | None,
) -> OtherState:
    """A record and its simulator, as data and a forward model."""
    times, measured, simulate = record
    if wrong := unfit(simulate, 2):
        raise diagnosis.DiagnosisError(
            f"simulate = {simulate!r:.60}: is called as simulate(parameters, times), with a dict of "
            f"parameters by name: {wrong}"
        )
    data = Data(times, measured, labels, units, period=period, name=name)  # type: ignore[arg-type]
    called = getattr(simulate, "__name__", "simulator")
    return OtherState(
        data, FunctionModel(simulate, parameters, Outputs(tuple(data.outputs), data.times), called)
    )


def _at_given_times(data: Data, model: ForwardModel) -> ForwardModel:
    """A function's model that is called at all times that data were given with, where some are left out."""
    given = data.given_times
    if given is data.times or not isinstance(model, FunctionModel):
        return model
    if not any(np.array_equal(model.outputs.times, times) for times in (given, data.times)):
        return model  # which is refused
    finer = model.finer and at_all_times(model.finer, given)
    outputs = Outputs(model.outputs.series, data.times)
    return replace(model, function=at_all_times(model.function, given), outputs=outputs, finer=finer)


def _diagnose_data(
    data: Data,
    model: ForwardModel,
    effects: Causes = (),
    *,
    states: Sequence[OtherState] = (),
    hooks: Hooks | None = None,
    noise: float | Mapping[str, float] | None = None,
    **settings: Any,
) -> Diagnosis:
    if noise is not None:
        if not isinstance(noise, Mapping) and len(units := dict.fromkeys(data.units)) > 1:
            raise diagnosis.DiagnosisError(
                f"noise = {noise!r:.60}: the series are in {', '.join(units)}; give one for each, such as "
                f"{{{data.groups[0]!r}: 0.1}}"
            )
        if settings.get("errors") is not None:
            raise diagnosis.DiagnosisError(
                f"noise = {noise!r:.60}: errors are given too; state it in these, by `known`"
            )
        known = noise if isinstance(noise, Mapping) else dict.fromkeys(data.groups, noise)
        settings["errors"] = replace(spectral_errors(data), known=known)
    model = _at_given_times(data, model)
    states = [replace(one, model=_at_given_times(one.data, one.model)) for one in states]
    if isinstance(effects, Effect | FunctionOf):
        effects = [effects]
    if plain := [one for one in effects if not isinstance(one, Effect | FunctionOf)]:
        raise diagnosis.DiagnosisError(
            f"effects = {effects!r:.60}: {plain[0]!r:.60} is no effect; give a list of functions that are "
            "decorated with @zoo.effect(...), and of zoo.free_function(...)"
        )
    free = [one for one in effects if isinstance(one, FunctionOf)]
    listed = [one for one in effects if not isinstance(one, FunctionOf)]
    refuse_twice([one.name for one in effects])
    several = isinstance(model, Experiments)
    if isinstance(model, Experiments):
        listed = [model.effect(one) for one in listed]
    if free:

        def own(model: ForwardModel, theta: Array, data: Data) -> list[FreeFunction]:
            return [one.on(model, theta) for one in free]

        def components(model: Any, theta: Array, data: Data) -> list[FreeFunction]:
            return model.functions(own, theta) if several else own(model, theta, data)

        def knowing(model: Any) -> Any:
            if isinstance(model, Experiments):
                return model.each(knowing)
            return replace(model, functions=tuple(one.name for one in free))

        model, states = knowing(model), [replace(one, model=knowing(one.model)) for one in states]
        hooks = replace(hooks or Hooks(), components=components)
    return diagnosis.diagnose(data, model, listed, states=states, hooks=hooks, **settings)


def _whole_signature() -> inspect.Signature:
    """Of the first way to call it, with the settings of all three; `help` shows it."""
    shown = inspect.signature(_diagnose_series)
    own = [p for p in shown.parameters.values() if p.kind is not p.VAR_KEYWORD]
    settings = inspect.signature(diagnosis.diagnose).parameters.values()
    return shown.replace(parameters=[*own, *(p for p in settings if p.kind is p.KEYWORD_ONLY)])


diagnose.__signature__ = _whole_signature()  # type: ignore[attr-defined]
