"""Samples of a beat: inlet, outlets and observations, from CSV and from fetched files."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from zoo.blood.fetch import fetch_file
from zoo.blood.study.parts import QUANTITIES, Series, StudyError
from zoo.blood.study.reading import read_csv, read_text
from zoo.blood.study.resampling import even_samples
from zoo.blood.study.schema import FetchedInflowTable, FetchedObservationsTable
from zoo.core.arrays import Array
from zoo.core.data import on_one_grid
from zoo.core.words import nearest, short

INFLOW_COLUMNS = ("time_s", "flow_ml_s")
PRESSURE_COLUMNS = ("time_s", "pressure_mmHg")
OBSERVATION_COLUMNS = ("vessel", "position", "quantity", "time_s", "value")
MIN_SAMPLES = 16
"""Fewest samples of a beat, in the inflow and in every observed series."""
FEWEST_BEATS = 3
"""Whole beats, of which a scatter can be told."""


_STEP_TOLERANCE = 0.02  # of a step: how far two neighbouring samples may be from the usual distance
_GRID_TOLERANCE = 0.1  # of a step: how far a sample may be from its place on the uniform grid
_PERIOD_TOLERANCE = 0.05  # of a step: how far the samples' length may be from the period
_SAME_TIME = 1e-12  # of all times: how far apart two are that are one
_TIME_ROUNDING_S = 2e-8  # two times printed with 8 decimals


def number(where: str, name: str, text: str) -> float:
    """A finite number from the text of a field, refused with the field's name if it is none."""
    try:
        value = float(text) if "_" not in text else None
    except ValueError:
        value = None
    if value is None:
        how = HOW_TO_WRITE.get(name, "correct it")
        raise StudyError(f"{where}: {name} = {short(text)}: not a number; {how}")
    if not math.isfinite(value):
        how = HOW_TO_WRITE["value"] if name == "value" else "interpolate it or cut the series"
        raise StudyError(f"{where}: {name} = {short(text)}: must be finite; {how}")
    if abs(value) > MOST_VALUE:
        raise StudyError(
            f"{where}: {name} = {short(text)}: must be at most {MOST_VALUE:g} in size; correct it"
        )
    return value


HOW_TO_WRITE = {
    "time_s": "give seconds from the start of the beat",
    "value": "leave it empty if not measured",
}
"""What to change where a field is no number."""
MOST_VALUE = 1e30
"""Largest size of a sample, so that no sum of squares is beyond a double."""


def numbers(path: Path, rows: Sequence[int], name: str, texts: Sequence[str]) -> Array:
    """A column of finite numbers, (n,)."""
    try:
        found = np.fromiter(map(float, texts), np.float64, len(texts))
        plain = not any("_" in text for text in texts) and bool(np.all(np.abs(found) <= MOST_VALUE))
    except ValueError:
        plain = False
    if not plain:  # one by one, to say which
        return np.array([number(f"{path}, row {row}", name, x) for row, x in zip(rows, texts, strict=True)])
    return found


@dataclass(frozen=True)
class Samples:
    """Samples of one series before they are on the grid, NaN where none was taken, and their rows."""

    path: Path | str
    label: str
    rows: Sequence[int]
    times: Array
    values: Array
    unit: str

    def fail(self, i: int, reason: str, name: str = "time_s") -> NoReturn:
        """Raise an error of the time, or of the value, of the sample that stands at this place."""
        value = (self.times if name == "time_s" else self.values)[i]
        raise StudyError(f"{self.path}, row {self.rows[i]}: {name} = {value:.10g}: {self.label}: {reason}")

    def one_period(self, period: float, otherwise: str) -> str:
        """What to do where the samples are no single period: the import of several beats, or `otherwise`."""
        span = float(np.ptp(self.times)) + float(np.median(np.diff(np.sort(self.times))))
        folder = Path(self.path).parent
        if round(span / period, 1) < FEWEST_BEATS or not (folder / "study.toml").is_file():
            return otherwise
        folder_name = shlex.quote(str(folder))
        return f"average several beats by `zoo import-beats {folder_name} -o NEW`, or correct period_s"

    def sorted(self) -> Samples:
        """The same in the order of their times."""
        order = np.argsort(self.times, kind="stable")
        rows = [self.rows[i] for i in order]
        return replace(self, rows=rows, times=self.times[order], values=self.values[order])

    def refuse_twice(self) -> None:
        """Raise where two samples, ascending in time, have the same time."""
        same = np.diff(self.times) <= _SAME_TIME * (self.times[-1] - self.times[0])
        if np.any(same):
            i = int(np.argmax(same))
            self.fail(i + 1, f"a second sample at this time, beside row {self.rows[i]}; keep one")

    def must_repeat(self, period: float) -> None:
        """Raise unless the last value is the first, as it must be a period later."""
        first, last = self.values[0], self.values[-1]
        if abs(last - first) > 1e-9 * np.ptp(self.values):
            self.fail(
                len(self.values) - 1,
                f"a period_s = {period:.10g} after the first sample ({first:.10g}), so it must repeat that "
                "one; remove this row, or correct period_s",
                self.unit,
            )


def _uneven(times: Array) -> NDArray[np.bool_]:
    """Which distances between ascending times are not the usual one, (n - 1,)."""
    gaps = np.diff(times)
    step = float(np.median(gaps))
    return np.asarray(np.abs(gaps - step) > _STEP_TOLERANCE * step + _TIME_ROUNDING_S)


def _own_times(samples: Samples, period: float) -> tuple[Array, Array]:
    """Times and values of an observed series: those of `_uniform`, or its own where they are uneven.

    Uneven times are put on a uniform grid with gaps where they are on one. What was not measured is NaN, and
    left out.
    """
    _refuse_few(samples, int(np.sum(~np.isnan(samples.values))))
    s = samples.sorted()
    s.refuse_twice()
    if not np.any(_uneven(s.times)):
        times, values = _uniform(samples, period, from_zero=False)
    else:
        times, values = s.times, s.values
        if times[0] < 0:
            s.fail(0, "before the beat; count from its start")
        if abs(times[-1] - period) <= _TIME_ROUNDING_S:
            s.must_repeat(period)
            times, values = times[:-1], values[:-1]
        if times[-1] >= period:
            remedy = s.one_period(period, "give one period, or correct period_s")
            past = f"past period_s = {period:.10g}; {remedy}"
            s.fail(len(times) - 1, past)
        step = period / max(1, round(period / float(np.median(np.diff(times)))))
        grid = times[0] + np.rint((times - times[0]) / step) * step
        off = float(np.max(np.abs(times - grid)))
        if _SAME_TIME * period < off <= _STEP_TOLERANCE * step and np.all(np.diff(grid) > 0.5 * step):
            times = grid
    there = ~np.isnan(values)
    return times[there], values[there]


def _refuse_few(samples: Samples, n: int) -> None:
    if n < MIN_SAMPLES:
        raise StudyError(
            f"{samples.path}: {samples.label}: {n} samples: too few for a beat; give at least {MIN_SAMPLES}"
        )


def _uniform(samples: Samples, period: float, *, from_zero: bool) -> tuple[Array, Array]:
    """Times and values on the uniform grid of one period that the samples are on.

    Times t0 + m period/n replace the printed ones, which may be rounded; a last sample that repeats the first
    one a period later is dropped.
    """
    _refuse_few(samples, len(samples.times))
    s = samples.sorted()
    times, values = s.times, s.values
    gaps = np.diff(times)
    s.refuse_twice()
    step = float(np.median(gaps))
    uneven = _uneven(times)
    if np.any(uneven):
        i = int(np.argmax(uneven))
        s.fail(
            i + 1,
            f"{gaps[i]:.6g} s after the sample before, where others are {step:.6g} s apart; "
            "resample to a uniform grid",
        )
    if abs(times[-1] - times[0] - period) <= _GRID_TOLERANCE * step:
        s.must_repeat(period)
        times, values = times[:-1], values[:-1]
    n = len(times)
    step = float(times[-1] - times[0]) / (n - 1)
    if abs(n * step - period) > _PERIOD_TOLERANCE * step:
        remedy = s.one_period(period, "correct period_s, or resample to one whole period")
        if abs(n * step / period - 1000.0) < 50.0:
            remedy = "divide the times by 1000, which seem to be in ms"
        raise StudyError(
            f"{s.path}, row {s.rows[n - 1]}: time_s = {times[-1]:.10g}: {s.label}: {n} samples {step:.6g} s "
            f"apart make a beat of {n * step:.8g} s, but period_s = {period:.10g} in study.toml; {remedy}"
        )
    if times[0] < 0:
        s.fail(0, "before the beat; count from its start")
    if times[0] > (1 - _GRID_TOLERANCE) * step:
        s.fail(n - 1, "past the period, as the series begins late; begin at time 0")
    if from_zero and times[0] > _PERIOD_TOLERANCE * step:
        s.fail(0, f"the {s.label} must begin at time 0; shift or resample it")
    start = 0.0 if from_zero else float(times[0])
    grid = np.asarray(start + np.arange(n) * (period / n), dtype=np.float64)
    off = np.abs(times - grid)
    if np.any(off > _GRID_TOLERANCE * step):
        i = int(np.argmax(off))
        s.fail(i, f"{off[i]:.3g} s from its place on a uniform grid; resample to one")
    return grid, values


def _evened(samples: Samples, period: float) -> tuple[Array, Array, str]:
    """Times and values on a uniform grid, from samples at uneven times; and what was done, in words."""
    s, times, values = samples, samples.times, samples.values
    s.sorted().refuse_twice()
    back = np.diff(times) < 0
    if np.any(back):
        i = int(np.argmax(back))
        s.fail(i + 1, f"before that of row {s.rows[i]}; sort the rows by time")
    if abs(times[0]) > _TIME_ROUNDING_S:
        s.fail(0, f"the {s.label} must begin at time 0; shift or resample it")
    end = len(times) - 1
    if abs(times[end] - period) <= _TIME_ROUNDING_S:
        s.must_repeat(period)
        times, values = times[:-1], values[:-1]
    elif times[end] > period:
        remedy = s.one_period(period, "give one period, or correct period_s")
        s.fail(end, f"past period_s = {period:.10g}; {remedy}")
    left, widest = period - times[-1], float(np.max(np.diff(times)))
    if left > widest * (1 + _STEP_TOLERANCE):
        s.fail(
            len(times) - 1,
            f"{left:.6g} s before period_s = {period:.10g} ends, but no other samples are more than "
            f"{widest:.6g} s apart; give the whole period, or correct period_s",
        )
    even, distance = even_samples(np.maximum(times, 0.0), values, period)
    unit = {"flow_ml_s": "ml/s", "pressure_mmHg": "mmHg"}[s.unit]
    how = f"at most {distance:.2g} {unit} from these lines" if distance else "which hold all of them"
    note = f"{len(times)} samples at uneven times, linear between, read at {len(even)} even times, {how}"
    return np.asarray(np.arange(len(even)) * (period / len(even)), dtype=np.float64), even, note


def as_read(samples: Samples, period: float) -> Samples:
    """The samples as they are."""
    return samples


def read_inlet(
    path: Path,
    period: float,
    fold: Callable[[Samples, float], Samples] = as_read,
    *,
    columns: tuple[str, str] = INFLOW_COLUMNS,
) -> tuple[Array, Array, str]:
    """Times and values of the flow into the root on a uniform grid, and what was done to them, in words.

    `columns` may be `PRESSURE_COLUMNS`, of the pressure there. `fold` is given the samples and the period,
    and makes one beat of several.
    """
    table = read_csv(path, columns)
    times, values = (numbers(path, table.rows, name, table.columns[name]) for name in columns)
    label = "inflow" if columns == INFLOW_COLUMNS else "inlet pressure"
    samples = fold(Samples(path, label, table.rows, times, values, columns[1]), period)
    if len(samples.times) >= MIN_SAMPLES and np.any(_uneven(np.sort(samples.times))):
        return _evened(samples, period)
    return *_uniform(samples, period, from_zero=True), ""


def read_outflow(path: Path, period: float) -> Array:
    """Pressure behind the outlets at times m period/n, mmHg; its samples must be at even times."""
    table = read_csv(path, PRESSURE_COLUMNS)
    times, pressure = (numbers(path, table.rows, name, table.columns[name]) for name in PRESSURE_COLUMNS)
    samples = Samples(path, "outflow pressure", table.rows, times, pressure, "pressure_mmHg")
    return _uniform(samples, period, from_zero=True)[1]


def _check_place(where: str, vessel: int, position: float, quantity: str, known: Sequence[int]) -> None:
    if vessel not in known:
        raise StudyError(
            f"{where}: vessel = {vessel}: not in the network; use one of {', '.join(map(str, sorted(known)))}"
        )
    if not 0 <= position <= 1:
        raise StudyError(
            f"{where}: position = {position!r}: must be in [0, 1]; give the fraction of the vessel's length"
        )
    if quantity not in QUANTITIES:
        raise StudyError(f"{where}: quantity = {short(quantity)}: {nearest(quantity, QUANTITIES)}")


def read_observations(
    path: Path, period: float, known: Sequence[int], fold: Callable[[Samples, float], Samples] = as_read
) -> tuple[Array, tuple[Series, ...]]:
    """Times (s) of a file's samples on one grid, and its series, NaN where nothing was measured.

    `fold` is given the samples of each series and the period, and makes one beat of several.
    """
    table = read_csv(path, OBSERVATION_COLUMNS)
    written: dict[tuple[str, str, str], list[int]] = {}
    for i, place in enumerate(zip(*(table.columns[name] for name in OBSERVATION_COLUMNS[:3]), strict=True)):
        written.setdefault(place, []).append(i)
    groups: dict[tuple[int, float, str], list[int]] = {}
    for (vessel, position, quantity), at in written.items():
        where = f"{path}, row {table.rows[at[0]]}"
        if not re.fullmatch(r"[+-]?\d{1,10}", vessel):
            raise StudyError(f"{where}: vessel = {short(vessel)}: not a whole number; use a vessel's id")
        place = int(vessel), number(where, "position", position) + 0.0, quantity
        if place not in groups:
            _check_place(where, *place, known)
        groups.setdefault(place, []).extend(at)
    if not groups:
        raise StudyError(f"{path}: no samples; add some, or remove observations from study.toml")
    all_times = numbers(path, table.rows, "time_s", table.columns["time_s"])
    texts = table.columns["value"]
    there = [i for i, text in enumerate(texts) if text]  # an empty cell was not measured
    all_values = np.full(len(texts), np.nan)
    all_values[there] = numbers(path, [table.rows[i] for i in there], "value", [texts[i] for i in there])

    found: list[tuple[tuple[int, float, str], Array, Array]] = []
    for place, at in groups.items():
        at.sort()
        rows = [table.rows[i] for i in at]
        times, values = all_times[at], all_values[at]
        if place[2] == "area_cm2" and np.any(values <= 0):
            i = int(np.argmax(values <= 0))
            raise StudyError(
                f"{path}, row {rows[i]}: value = {float(values[i])!r}: an area_cm2 must be positive; "
                "correct it"
            )
        label = Series(*place, np.empty(0)).label
        own, measured = _own_times(fold(Samples(path, label, rows, times, values, "value"), period), period)
        first = found[0][1] if found else own
        if len(own) == len(first) and np.max(np.abs(own - first)) <= _PERIOD_TOLERANCE * period / len(own):
            own = first
        found.append((place, own, measured))
    clocks, samples = [own for _, own, _ in found], [measured for *_, measured in found]
    grid, on_grid = on_one_grid(clocks, samples, _TIME_ROUNDING_S / period)
    return grid, tuple(Series(*place, row) for (place, *_), row in zip(found, on_grid, strict=True))


def _column(path: Path) -> Array:
    """Numbers of a file with one in each row."""
    lines = [(row, line.strip()) for row, line in enumerate(read_text(path).split("\n"), 1)]
    return np.array([number(f"{path}, row {row}", "value", line) for row, line in lines if line])


def fetched_inflow(table: FetchedInflowTable, period: float) -> tuple[Array, Array]:
    """Column of flows, the first one repeated at the end."""
    path = fetch_file(table.fetch)
    flow = _column(path)
    times = np.arange(len(flow)) * period / max(1, len(flow) - 1)
    return _uniform(
        Samples(path, "inflow", range(1, len(flow) + 1), times, flow, "value"), period, from_zero=True
    )


def fetched_observations(
    where: str, table: FetchedObservationsTable, period: float, known: Sequence[int]
) -> tuple[Array, tuple[Series, ...]]:
    """Column of samples of a beat; `average` neighbours become their mean, at their mean time."""
    _check_place(where, table.vessel, table.position, table.quantity, known)
    path = fetch_file(table.fetch)
    raw = _column(path)
    if len(raw) % table.average:
        raise StudyError(
            f"{where}: average = {table.average}: does not divide the {len(raw)} samples of "
            f"{table.fetch}; use a divisor"
        )
    times = np.arange(len(raw)) * period / len(raw)
    times, values = (a.reshape(-1, table.average).mean(axis=1) for a in (times, raw))
    series = Series(table.vessel, table.position + 0.0, table.quantity, values)
    rows = range(1, len(raw) + 1, table.average)
    grid, _ = _uniform(Samples(path, series.label, rows, times, values, "value"), period, from_zero=False)
    return grid, (series,)
