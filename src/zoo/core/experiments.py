"""Several experiments as one: their data side by side, and one forward model that solves all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.arrays import Array
from zoo.core.components import FreeFunction
from zoo.core.data import Data
from zoo.core.effects import Effect, Location
from zoo.core.forward import ForwardModel, Outputs, SolveError, content_key, pinned, refined
from zoo.core.parameters import Parameter, n_values, unpack
from zoo.core.words import nearest

Configurations = Mapping[str, Any]
OF_RECORD = "of its record"
"""Unit of time of experiments whose clocks differ."""


class ExperimentError(ValueError):
    """Experiments that cannot be taken as one; the text says which and why."""


class Experiments:
    """A forward model of several experiments, each with data, simulator, inputs and times of its own.

    Its parameters are those that are shared, one for all, and the others of each experiment, "k[first]"; a
    configuration has that of each experiment by name, and an effect changes every one of them.

    Parameters
    ----------
    models : mapping of str to ForwardModel
        Simulator of each experiment, by name, with the same parameters.
    records : mapping of str to Data
        What was measured in each, in the same order.
    share : iterable of str
        Names of parameters that are one for all.
    own_noise : bool
        Whether a quantity has another noise in each experiment, and a discrepancy that none shares; else one
        noise, as of one instrument, and a discrepancy that may be alike at the same part of each record.

    Raises
    ------
    ExperimentError
        If there are fewer than two, some are periodic and others not, or what is shared is unknown, not of
        one prior and unit, or has a prior that depends on what is not shared.
    """

    def __init__(
        self,
        models: Mapping[str, ForwardModel],
        records: Mapping[str, Data],
        share: Iterable[str] = (),
        own_noise: bool = False,
    ) -> None:
        if len(models) < 2:
            raise ExperimentError(f"{len(models)} experiments: give at least two")
        if odd := [name for name in models if not name or "/" in name]:
            raise ExperimentError(f"experiment {odd[0]!r}: a name without a slash is needed")
        self.models, self.records, self.own_noise = dict(models), dict(records), own_noise
        first = next(iter(self.models.values()))
        self.share = _shared(share, self.models)
        self.name = " and ".join(dict.fromkeys(model.name for model in self.models.values()))
        self.families = first.families
        self.parameters = (
            *(p for p in first.parameters if p.name in self.share),
            *(
                self._own(p, name)
                for name, model in self.models.items()
                for p in model.parameters
                if p.name not in self.share
            ),
        )
        self.outputs = Outputs(tuple(self.data.outputs), self.data.times)
        self.key = content_key(self.outputs, *self.share, *(f"{k} {m.key}" for k, m in self.models.items()))

    def _own(self, p: Parameter, name: str) -> Parameter:
        """A parameter of one experiment, whose prior may depend on others of it."""
        prior: Any = p.prior
        given = {f.name: getattr(prior, f.name) for f in fields(prior)} if prior.depends_on else {}
        own = {
            key: f"{value}[{name}]"
            for key, value in given.items()
            if value in prior.depends_on and value not in self.share
        }
        prior = replace(prior, **own) if own else prior
        return replace(p, name=f"{p.name}[{name}]", prior=prior, label=f"{p.label or p.name} [{name}]")

    def each(self, change: Callable[[ForwardModel], ForwardModel]) -> Experiments:
        """The same with each simulator changed."""
        return self._of({k: change(m) for k, m in self.models.items()})

    def _of(self, models: Mapping[str, ForwardModel]) -> Experiments:
        return Experiments(models, self.records, self.share, self.own_noise)

    # -- data -------------------------------------------------------------------------------------

    @cached_property
    def _clocks(self) -> dict[str, tuple[float, float, float]]:
        """Of each experiment: time t is at (t - first)/unit + shift of the clock that they have in common."""
        first, *others = self.records.values()
        if all(one.period == first.period and np.array_equal(one.times, first.times) for one in others):
            return dict.fromkeys(self.records, (0.0, 1.0, 0.0))
        half = {k: 0.0 if d.period else 0.5 / d.n_times for k, d in self.records.items()}
        return {k: (float(d.times[0]), d.duration, half[k]) for k, d in self.records.items()}

    def _to_common(self, name: str, times: Array) -> Array:
        first, unit, shift = self._clocks[name]
        return (times - first) / unit + shift

    @cached_property
    def data(self) -> Data:
        """All series as "experiment/series", in the groups that they are in, or in "experiment/group".

        Where their clocks differ times are in parts of each one's own record or period.
        """
        series = [(k, d, i) for k, d in self.records.items() for i in range(d.n_series)]
        first = next(iter(self.records.values()))
        if len({one.period is None for one in self.records.values()}) > 1:
            told = ", ".join(f"{k} {d.period}" for k, d in self.records.items())
            raise ExperimentError(f"period of {told}: give all experiments one, or none")
        own = next(iter(self._clocks.values())) == (0.0, 1.0, 0.0)
        return Data(
            [self._to_common(k, d.times[d.measured[i]]) for k, d, i in series],  # type: ignore[arg-type]
            [d.samples(i) for _, d, i in series],  # type: ignore[arg-type]
            labels=[f"{k}/{d.labels[i]}" for k, d, i in series],
            units=[d.units[i] for _, d, i in series],
            groups=[f"{k}/{d.groups[i]}" if self.own_noise else d.groups[i] for k, d, i in series],
            outputs=[(k, d.outputs[i]) for k, d, i in series],
            period=first.period if own or first.period is None else 1.0,
            time_unit=first.time_unit if own else OF_RECORD,
            name=", ".join(self.records),
        )

    def about(self, group: str = "") -> tuple[str, ...]:
        """Groups of all experiments for one: their first one if it is empty or not there; of one unit."""
        own = {k: group if group in d.rows else d.groups[0] for k, d in self.records.items()}
        named = {f"{k}/{g}" if self.own_noise else g: self.records[k].unit(g) for k, g in own.items()}
        first = next(iter(named.values()))
        return tuple(name for name, unit in named.items() if unit == first)

    @cached_property
    def alone(self) -> tuple[NDArray[np.bool_], ...]:
        """Series (n_series, 1) of each experiment, if others foretell it: none has parameters of its own."""
        if len(self.parameters) > len(self.share):
            return ()
        of = np.repeat([*self.records], [one.n_series for one in self.records.values()])
        return tuple((of == name)[:, None] for name in self.records)

    # -- solves -----------------------------------------------------------------------------------

    def of(self, name: str, theta: Array) -> Array:
        """Parameters of one experiment, from those of all."""
        values = unpack(self.parameters, theta)
        own = (p.name if p.name in self.share else f"{p.name}[{name}]" for p in self.models[name].parameters)
        parts = [np.atleast_1d(values[one]) for one in own]
        return np.concatenate(parts) if parts else np.zeros(0)

    def configure(self, theta: Array) -> dict[str, Any]:
        """The configuration of each experiment, by name."""
        return {name: model.configure(self.of(name, theta)) for name, model in self.models.items()}

    def solve(self, configuration: Configurations, outputs: Outputs | None = None) -> Array:
        """Series of all experiments; at common times between those of one, its own are interpolated.

        Raises
        ------
        SolveError
            If one of them has no solution.
        """
        wanted = outputs or self.outputs
        measured = np.array_equal(wanted.times, self.outputs.times)
        found = np.empty(wanted.shape)
        pairs: Sequence[Any] = wanted.series
        for name, model in self.models.items():
            rows = [i for i, (experiment, _) in enumerate(pairs) if experiment == name]
            if not rows:
                continue
            first, unit, shift = self._clocks[name]
            times = model.outputs.times if measured else first + unit * (wanted.times - shift)
            asked = Outputs(tuple(pairs[i][1] for i in rows), times)
            try:
                series = model.solve(configuration[name], asked)
            except SolveError as error:
                raise SolveError(f"{name}: {error}", error.kind) from None
            if len(times) != len(wanted.times):
                clock = self._to_common(name, times)
                series = np.array([np.interp(wanted.times, clock, row) for row in series])
            found[rows] = series
        return found

    def refined(self) -> Experiments | None:
        """With all simulators refined; None where one of them has no finer grid."""
        finer = {name: refined(model) for name, model in self.models.items()}
        known = {name: model for name, model in finer.items() if model is not None}
        return self._of(known) if len(known) == len(finer) else None

    def pinned(self, configuration: Configurations) -> Experiments:
        """With each simulator at the discretisation of its own solve; itself where none has one."""
        fixed = {name: pinned(model, configuration[name]) for name, model in self.models.items()}
        if all(fixed[name] is model for name, model in self.models.items()):
            return self
        return self._of(fixed)

    # -- causes -----------------------------------------------------------------------------------

    def effect(self, effect: Effect) -> Effect:
        """An effect on every experiment, of one size and at one of the places that it has in all of them.

        Where its prior follows from a simulator's own size, such as the beat, it is the widest.
        """
        own = [effect.of(model) for model in self.models.values()]
        made = max(own, key=lambda one: one.parameters[0].scale)
        places = [one.locations(model) for one, model in zip(own, self.models.values(), strict=True)]
        common = tuple(one for one in places[0] if all(one in others for others in places))
        apply = None if effect.apply is None else _OnEach(effect)
        return replace(made, apply=apply, locations=_At(common), home="")

    def functions(
        self, make: Callable[[ForwardModel, Array, Data], Sequence[FreeFunction]], theta: Array
    ) -> list[FreeFunction]:
        """Free functions that all experiments have, each one for all of them.

        One of a period is the same at each part of it; any other is the same function of its argument, over
        the values that it takes in some experiment.

        Parameters
        ----------
        make : function
            Those of one experiment, from its simulator, its parameters and its data.
        theta : array (n_values,)
            Parameters of all.
        """
        made = {
            name: {
                (f.name, f.location, f.labels): f
                for f in make(model, self.of(name, theta), self.records[name])
            }
            for name, model in self.models.items()
        }
        first, *others = made.values()
        return [
            _one_for_all({name: found[key] for name, found in made.items()})
            for key in first
            if all(key in found for found in others)
        ]


@dataclass(frozen=True)
class _OnEach:
    """What an effect does to the configuration of every experiment."""

    effect: Effect

    def __call__(
        self, configuration: Configurations, values: tuple[float, ...], location: Location
    ) -> Configurations:
        assert self.effect.apply is not None
        return {name: self.effect.apply(one, values, location) for name, one in configuration.items()}


@dataclass(frozen=True)
class _At:
    """Locations that are known already."""

    locations: tuple[Location, ...]

    def __call__(self, model: Any) -> tuple[Location, ...]:
        return self.locations


def _one_for_all(own: Mapping[str, FreeFunction]) -> FreeFunction:
    """A function of all experiments from that of each."""
    first = next(iter(own.values()))
    at, stretch = first.at, 1.0
    if first.period is None and not first.labels and len(at) > 1:
        low, high = min(f.at[0] for f in own.values()), max(f.at[-1] for f in own.values())
        at, stretch = np.linspace(low, high, len(at)), float((high - low) / np.ptp(at))
        at = first.at if stretch == 1.0 else at
    lengths = tuple(stretch * length for length in first.lengths)

    def change(configuration: Configurations, values: Array) -> Configurations:
        return {name: own[name].apply(one, there(own[name], values)) for name, one in configuration.items()}

    def there(f: FreeFunction, values: Array) -> Array:
        if first.period is not None and f.period is not None:
            return np.interp(f.at / f.period, at / first.period, values, period=1.0)
        return values if np.array_equal(f.at, at) or f.labels else np.interp(f.at, at, values)

    return replace(first, at=at, lengths=lengths, apply=change)


def _shared(share: Iterable[str], models: Mapping[str, ForwardModel]) -> tuple[str, ...]:
    """Names of shared parameters, in their order, each of one prior in all experiments."""
    if isinstance(share, str):
        raise ExperimentError(f"share = {share!r}: give a list, such as [{share!r}]")
    share = list(share)
    tables = {name: {p.name: p for p in model.parameters} for name, model in models.items()}
    origin, first = next(iter(tables.items()))
    for name in share:
        for experiment, table in tables.items():
            if name not in table:
                raise ExperimentError(
                    f"share = {name}: experiment {experiment}: {nearest(name, list(table))}"
                )
            if (one := _told(table[name])) != (known := _told(first[name])):
                raise ExperimentError(
                    f"share = {name}: it is {known} in {origin} and {one} in {experiment}: must be one; give "
                    "all experiments the same prior, or leave it to each"
                )
    for name in share:
        if lacking := [one for one in first[name].prior.depends_on if one not in share]:
            raise ExperimentError(f"share = {name}: its prior depends on {lacking[0]}: share that too")
    return tuple(name for name in first if name in share)


def _told(p: Parameter) -> str:
    """Prior, unit and size in words."""
    size = n_values([p])
    return f"{p.prior.text} {p.unit}".removesuffix(" 1") + (f" ({size} values)" if p.dims else "")
