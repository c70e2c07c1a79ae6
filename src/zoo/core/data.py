"""Measured series, whatever they measure: times, values, labels, units, and which share their noise."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.arrays import Brief

Array = NDArray[np.float64]


class DataError(ValueError):
    """Data that do not fit together; the text names the field and says what to change."""


EVEN = 1e-6
"""Relative difference of steps up to which they are equal."""


def _even(times: Array) -> bool:
    steps = np.diff(times)
    return len(steps) == 0 or bool(np.ptp(steps) <= EVEN * abs(steps.mean()))


def squared(unit: str) -> str:
    """A unit's square, such as "mmHg2", "(ml/s)2" or "1"."""
    return unit if unit == "1" else f"{unit}2" if unit.isalpha() else f"({unit})2"


@dataclass(frozen=True, eq=False, repr=False)
class Data(Brief):
    """Series that were measured at the same times; frozen, with read-only arrays.

    Parameters
    ----------
    times : array (n_times,)
        Ascending, in `time_unit`; in equal steps or not.
    values : array (n_series, n_times)
        Each series in its own unit. NaN, and what is masked, is not measured: times at which a series was not
        are left out of all, with a warning that says how many.
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

    def __post_init__(self) -> None:
        if np.ma.is_masked(self.times):
            raise DataError(f"{self._where}times are masked: give the time of each sample")
        times = np.array(self.times, dtype=np.float64)
        values = np.array(np.ma.filled(np.ma.asarray(self.values, dtype=np.float64), np.nan))
        if values.ndim == 1:
            values = values[None]
        turned = values.ndim == 2 and len(values) == times.size
        if times.ndim != 1 or values.ndim != 2 or values.shape[1] != len(times):
            raise DataError(
                f"{self._where}values have shape {values.shape} and times {times.shape}: give one row for "
                f"each series and one column for each time{', as values.T has' if turned else ''}"
            )
        self._check_period(times)
        times, values = self._measured(times, values)
        for name, array in (("times", times), ("values", values)):
            if not np.all(np.isfinite(array)):
                at = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
                raise DataError(
                    f"{self._where}{name}{list(at)} = {array[at]}: must be finite; correct or leave out"
                )
            array.flags.writeable = False
        if len(times) > 1 and np.diff(times).min() <= 0:
            raise DataError(f"{self._where}times must ascend; sort the samples, each time once")
        n = len(values)
        put: dict[str, Any] = {"times": times, "values": values}
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

    def _check_period(self, times: Array) -> None:
        """Whether times, measured at or not, are of one period."""
        if self.period is None or len(times) < 2:
            return
        even, covered = _even(times), float(np.ptp(times))
        if even:
            covered = len(times) * (times[1] - times[0])
        if covered >= self.period * (1.0 + EVEN) or (even and covered < self.period * (1.0 - EVEN)):
            raise DataError(
                f"{self._where}period = {self.period}: the {len(times)} times cover {covered:g} "
                f"{self.time_unit}; sample one period at m period/n, or give period=None"
            )

    def _measured(self, times: Array, values: Array) -> tuple[Array, Array]:
        """Times at which every series was measured."""
        kept = ~np.isnan(values).any(axis=0)
        if kept.all():
            return times, values
        if kept.sum() < 2:
            raise DataError(f"{self._where}at {kept.sum()} times all series are measured: give at least two")
        others = int(np.sum(~np.isnan(values[:, ~kept])))
        lost = f", with {others} values of other series" if others else ""
        warnings.warn(
            f"{self._where}{np.sum(~kept)} of {len(times)} times are left out, at which a series was not "
            f"measured{lost}",
            stacklevel=4,
        )
        return times[kept], values[:, kept]

    @property
    def even(self) -> bool:
        """Whether times are in equal steps, which cover a period if there is one."""
        step = self.duration / max(self.n_times, 1)
        return _even(self.times) and (
            self.n_times < 2 or abs(self.times[1] - self.times[0] - step) < EVEN * step
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
        """Number of samples of each series."""
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
