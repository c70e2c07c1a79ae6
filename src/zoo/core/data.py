"""Measured series, whatever they measure: times, values, labels, units, and which share their noise."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.arrays import Array, Brief, real_number, shown


class DataError(ValueError):
    """Data that do not fit together; the text names the field and says what to change."""


EVEN = 1e-6
"""Relative difference of steps up to which they are equal."""


def _even(times: Array) -> bool:
    steps = np.diff(times)
    return len(steps) == 0 or bool(np.ptp(steps) <= EVEN * abs(steps.mean()))


SAME_TIME = 1e-9
"""Difference of times of two series, in parts of the record, up to which they are one."""


def own_clocks(times: Any) -> bool:
    """Whether times are of each series: a sequence of arrays, or a row for each."""
    return np.iterable(times) and np.ndim(next(iter(times), 0.0)) > 0


def on_one_grid(
    times: Sequence[Array], values: Sequence[Array], within: float = SAME_TIME
) -> tuple[Array, Array]:
    """All times of series that have their own, and the series there, NaN where one has no sample.

    Parameters
    ----------
    times, values : sequence of array (n,)
        Of each series; times ascend.
    within : float
        Difference of times, in parts of the record, up to which they are one.

    Returns
    -------
    times : array (n_times,)
    values : array (n_series, n_times)
    """
    every = np.unique(np.concatenate(times))
    grid = every[np.append(True, np.diff(every) > within * np.ptp(every))]
    found = np.full((len(times), len(grid)), np.nan)
    for own, row, into in zip(times, values, found, strict=True):
        into[np.searchsorted(grid, own, side="right") - 1] = row
    return grid, found


def squared(unit: str) -> str:
    """A unit's square, such as "mmHg2", "(ml/s)2" or "1"."""
    return unit if unit == "1" else f"{unit}2" if unit.isalpha() else f"({unit})2"


@dataclass(frozen=True, eq=False, repr=False)
class Data(Brief):
    """Measured series on one grid of times; frozen, with read-only arrays.

    Parameters
    ----------
    times : array (n_times,), or sequence of array
        Ascending, in `time_unit`; in equal steps or not. Or those of each series: the grid is then of all
        times of all series.
    values : array (n_series, n_times), or sequence of array
        Each series in its own unit. NaN, and what is masked, is not measured; times at which no series was
        are left out, with a warning that says how many.
    labels : sequence of str
        A name for each series; "y0", "y1" and so on if absent.
    units : sequence of str
        Of each series; "1" if absent.
    groups : sequence of str, optional
        Series of one group are of one quantity: they have one unit, one noise and may share a discrepancy.
        Each series is a group of its own, named by its label, if absent.
    period : float, optional
        Of a record that repeats itself, in `time_unit`; the n_times then cover it once. None: not periodic.
    outputs : sequence of hashable, optional
        What a forward model is asked for, one for each series; the labels if absent.
    time_unit : str
    name : str
    source : str
        Where they come from; errors name it.

    Raises
    ------
    DataError
        If shapes do not fit, a value is infinite, times do not ascend, or a group has two units.

    Warns
    -----
    UserWarning
        Of times that are left out.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0, 1, 8, endpoint=False)
    >>> Data(t, np.sin(t)[None], labels=["y"], units=["V"]).values.shape
    (1, 8)
    """

    times: Array
    values: Array
    labels: Sequence[str] = ()
    units: Sequence[str] = ()
    groups: Sequence[str] = ()
    period: float | None = None
    outputs: Sequence[Hashable] = ()
    time_unit: str = "s"
    name: str = "data"
    source: str = ""
    checksum: str = field(default="", repr=False)
    given_times: Array = field(init=False, repr=False)
    """All that were given, those that are left out too, (n,)."""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise DataError(f"name = {shown(self.name)}: give a text")
        if own_clocks(self.times):
            times, values = self._on_one_grid()
        else:
            times, values = self._series_of(self.times, self.values)
        turned = values.ndim == 2 and len(values) == times.size
        if times.ndim != 1 or values.ndim != 2 or values.shape[1] != len(times):
            raise DataError(
                f"{self._where}values have shape {values.shape} and times {times.shape}: give one row for "
                f"each series and one column for each time{', as values.T has' if turned else ''}"
            )
        self._check_period(times)
        given, (times, values) = times, self._measured(times, values)
        given = times if len(given) == len(times) else given
        given.flags.writeable = False
        wrong = {"times": ~np.isfinite(times), "values": np.isinf(values)}
        for name, array in (("times", times), ("values", values)):
            for at in map(tuple, np.argwhere(wrong[name]).tolist()):
                raise DataError(
                    f"{self._where}{name}{list(at)} = {array[at]}: must be finite; correct or leave out"
                )
            array.flags.writeable = False
        if len(times) > 1 and np.diff(times).min() <= 0:
            raise DataError(f"{self._where}times must ascend; sort the samples, each time once")
        n = len(values)
        put: dict[str, Any] = {"times": times, "values": values, "given_times": given}
        for name in ("labels", "units", "groups"):
            if isinstance(text := getattr(self, name), str):
                raise DataError(f"{self._where}{name} = {text!r}: give a list, such as [{text!r}]")
        put["labels"] = tuple(str(x) for x in self.labels) or tuple(f"y{i}" for i in range(n))
        put["units"] = tuple(str(x) for x in self.units) or ("1",) * n
        put["groups"] = tuple(str(x) for x in self.groups) or put["labels"]
        put["outputs"] = tuple(self.outputs) or put["labels"]
        for name in ("labels", "units", "groups", "outputs"):
            if len(put[name]) != n:
                raise DataError(f"{self._where}{len(put[name])} {name} for {n} series: give one for each")
        if len(set(put["labels"])) < n:
            raise DataError(f"{self._where}labels {', '.join(put['labels'])}: must differ")
        for group in set(put["groups"]):
            units = {u for u, g in zip(put["units"], put["groups"], strict=True) if g == group}
            if len(units) > 1:
                raise DataError(
                    f"{self._where}group {group!r} has series in {' and '.join(sorted(units))}: series of "
                    "one group share their noise, so give them one unit, or groups of their own"
                )
        for name, value in put.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "checksum", self._checksum())

    def _series_of(self, times: Any, values: Any) -> tuple[Array, Array]:
        """Times (n_times,), and a row for each series, NaN where it is masked."""
        if np.ma.is_masked(times):
            raise DataError(f"{self._where}times are masked: give the time of each sample")
        clock, found = self._numbers("times", times), self._numbers("values", values)
        return clock, found[None] if found.ndim == 1 else found

    def _numbers(self, name: str, given: Any) -> Array:
        """A copy as numbers, NaN where it is masked."""
        kind, instead = "O", "must be real numbers; give an array of them"
        try:
            found = np.ma.asarray(given)
            if (kind := found.dtype.kind) not in "cmM" and found.ndim:
                return np.array(np.ma.filled(np.ma.asarray(found, dtype=np.float64), np.nan))
        except (TypeError, ValueError):
            pass
        first: Any = next(iter(given), None) if np.iterable(given) else None
        if isinstance(first, date | np.datetime64 | np.timedelta64):
            seconds = "[(x - t[0]) / np.timedelta64(1, 's') for x in t]"
            instead = f"are dates, must be real numbers; give seconds since the first, {seconds}"
        elif kind == "O" and np.ndim(first):
            instead = "are rows of different lengths; give NaN where nothing was measured, or times of each"
            instead += " series, times=[t1, t2] and values=[y1, y2]"
        raise DataError(f"{self._where}{name} = {shown(given)}: {instead}")

    def _on_one_grid(self) -> tuple[Array, Array]:
        """All times of series that have their own, and the series there, NaN where one has no sample."""
        if len(self.times) != len(self.values):
            raise DataError(
                f"{self._where}times of {len(self.times)} series and values of {len(self.values)}: give both "
                "for each"
            )
        pairs = [self._series_of(*pair) for pair in zip(self.times, self.values, strict=True)]
        for i, (own, row) in enumerate(pairs):
            if own.ndim != 1 or row.shape != (1, len(own)):
                raise DataError(
                    f"{self._where}series {i} has {row.size} values and {own.size} times: give one value for "
                    "each"
                )
            if not np.all(np.isfinite(own)) or np.any(np.diff(own) <= 0):
                raise DataError(f"{self._where}times of series {i} must be finite and ascend")
        return on_one_grid([own for own, _ in pairs], [row[0] for _, row in pairs])

    def _check_period(self, times: Array) -> None:
        """Whether times, measured at or not, are of one period."""
        if self.period is None or len(times) < 2:
            return
        real_number(f"{self._where}period", self.period, "positive, or None", above=0.0, error=DataError)
        even, covered = _even(times), float(np.ptp(times))
        if even:
            covered = len(times) * (times[1] - times[0])
        if covered >= self.period * (1.0 + EVEN) or (even and covered < self.period * (1.0 - EVEN)):
            raise DataError(
                f"{self._where}period = {self.period}: the {len(times)} times cover {covered:g} "
                f"{self.time_unit}; sample one period at m period/n, or give period=None"
            )

    def _measured(self, times: Array, values: Array) -> tuple[Array, Array]:
        """Times at which some series was measured."""
        measured = ~np.isnan(values)
        for i in np.flatnonzero(measured.sum(axis=1) < min(2, max(1, len(times)))):
            n = measured[i].sum()
            raise DataError(f"{self._where}series {i} has {n} measured values: give at least two")
        kept = measured.any(axis=0) if len(values) else np.ones(len(times), bool)
        if kept.all():
            return times, values
        warnings.warn(
            f"{self._where}{np.sum(~kept)} of {len(times)} times are left out, at which nothing was measured",
            stacklevel=4,
        )
        return times[kept], values[:, kept]

    @cached_property
    def measured(self) -> NDArray[np.bool_]:
        """Whether each series was measured at each time, (n_series, n_times)."""
        return ~np.isnan(self.values)

    @cached_property
    def whole(self) -> bool:
        """Whether every series was measured at all times."""
        return bool(self.measured.all())

    def samples(self, series: int, values: Array | None = None) -> Array:
        """Measured values of one series, or what others (n_series, n_times) have there."""
        return np.asarray((self.values if values is None else values)[series][self.measured[series]])

    def filled(self, values: Array, fill: float = 0.0) -> Array:
        """Values (..., n_series, n_times) with another one where nothing was measured."""
        return np.asarray(values if self.whole else np.where(self.measured, values, fill))

    @property
    def even(self) -> bool:
        """Whether all series are of times in equal steps, which cover a period if there is one."""
        step = self.duration / max(self.n_times, 1)
        return (
            self.whole
            and _even(self.times)
            and (self.n_times < 2 or abs(self.times[1] - self.times[0] - step) < EVEN * step)
        )

    @property
    def _where(self) -> str:
        return f"{self.source or self.name}: "

    def _checksum(self) -> str:
        words = [list(self.labels), list(self.units), list(self.groups), self.period, self.time_unit]
        digest = hashlib.sha256(json.dumps(words).encode())
        for array in (self.times, self.values):
            digest.update(array.astype("<f8").tobytes())
        return digest.hexdigest()

    @property
    def n_series(self) -> int:
        """Number of series."""
        return len(self.values)

    @property
    def n_times(self) -> int:
        """Number of times."""
        return len(self.times)

    @property
    def duration(self) -> float:
        """Period of periodic data, else n_times steps, in `time_unit`."""
        if self.period is not None:
            return float(self.period)
        if len(self.times) < 2:
            return 1.0
        step = self.times[1] - self.times[0] if _even(self.times) else np.diff(self.times).mean()
        return float(len(self.times) * step)

    @property
    def rows(self) -> dict[str, list[int]]:
        """Indices of the series of each group, in the order of their first series."""
        names = dict.fromkeys(self.groups)
        return {g: [i for i, other in enumerate(self.groups) if other == g] for g in names}

    def unit(self, group: str) -> str:
        """Unit of a group's series."""
        return self.units[list(self.groups).index(group)]
