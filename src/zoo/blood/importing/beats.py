"""Raw records of pressure and flow over several beats, averaged into a study of one vessel."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.interpolate import CubicSpline

from zoo.blood.importing.imported import Imported, ImportedFileError, check_flow, check_positive
from zoo.blood.importing.table import DENSITY, VISCOSITY
from zoo.blood.study import STUDY_FILES, Blood, Series, Study, Vessel
from zoo.blood.study.reading import read_text
from zoo.blood.study.samples import FEWEST_BEATS, MIN_SAMPLES, number
from zoo.core.arrays import Array
from zoo.core.outputs import write_file
from zoo.core.words import short

UNITS = {
    "pressure_mmHg": {"mmhg": 1.0, "kpa": 7.500617, "pa": 7.500617e-3},
    "flow_ml_s": {"ml/s": 1.0, "ml_s": 1.0, "cm3/s": 1.0, "l/min": 1000 / 60, "l_min": 1000 / 60},
}
"""Quantity -> unit as a file may call it -> factor to the study's unit."""

COVARIANCE_FILES = {quantity: f"covariance_{quantity}.csv" for quantity in UNITS}
"""Quantity -> file beside the study with the covariance of single beats over the cycle."""

DIFFERS = 3.0
"""A beat differs whose RMS from the median beat is so many times that of the middle one."""
_GAP = 2.5  # steps: samples further apart than this have others missing between them
_DAY_S = 86400.0


@dataclass(frozen=True)
class Record:
    """Samples of one quantity on a clock of its own; those that were not measured are left out."""

    path: Path
    quantity: str
    unit: str
    times: Array
    values: Array
    missing: int

    @property
    def step(self) -> float:
        """Median time between two samples, s."""
        return float(np.median(np.diff(self.times)))

    def at(self, times: Array) -> Array:
        """Values at other times, by a cubic spline."""
        return np.asarray(CubicSpline(self.times, self.values)(times), dtype=np.float64)

    def measured(self, begin: float, end: float) -> bool:
        """Whether samples cover this time without a gap."""
        if begin < self.times[0] - 1e-9 or end > self.times[-1] + 1e-9:
            return False
        first = max(0, int(np.searchsorted(self.times, begin, side="right")) - 1)
        last = int(np.searchsorted(self.times, end, side="left"))
        return bool(np.all(np.diff(self.times[first : last + 1]) <= _GAP * self.step))


@dataclass(frozen=True)
class ImportedBeats(Imported):
    """A study of averaged beats, with the beats themselves.

    Parameters
    ----------
    beats : dict of str to array (n_beats, n_times)
        Quantity -> whole beats, each stretched to the mean length, in the study's unit.
    covariance : dict of str to array (n_times, n_times)
        Quantity -> covariance of single beats over the cycle; that of their mean is smaller by the number of
        beats. Its rank is at most the number of beats less one.
    offset_s : float or None
        By how much the flow's rise is later than the pressure's; None where the clocks share no time.
    offset_scatter_s : float or None
        Standard deviation of that between beats.
    """

    files: ClassVar[tuple[str, ...]] = (*STUDY_FILES, *COVARIANCE_FILES.values())
    beats: dict[str, Array] = field(default_factory=dict, repr=False)
    covariance: dict[str, Array] = field(default_factory=dict, repr=False)
    offset_s: float | None = None
    offset_scatter_s: float | None = None

    def save(self, folder: str | Path, *, replace: bool = False) -> Study:
        """Write the study as a folder with the covariances beside it, and load it from there.

        Parameters
        ----------
        folder : str or Path
            Made when absent.
        replace : bool
            The files that are in the folder.

        Returns
        -------
        Study

        Raises
        ------
        ImportedFileError
            If a file is in the folder already, or the records make no study.
        zoo.core.outputs.OutputFileError
            If the folder or a file cannot be written.
        """
        study, folder = super().save(folder, replace=replace), Path(folder)
        for quantity, matrix in self.covariance.items():
            times = study.time_s.tolist()
            rows = [",".join(["time_s", *map(repr, times)])]
            rows += [",".join(map(repr, (t, *row))) for t, row in zip(times, matrix.tolist(), strict=True)]
            write_file(folder / COVARIANCE_FILES[quantity], "\n".join(rows) + "\n")
        return study


def import_beats(
    pressure: str | Path,
    flow: str | Path,
    length_cm: float,
    radius_cm: float,
    *,
    position: float = 0.0,
    density_g_cm3: float = DENSITY,
    viscosity_g_cm_s: float = VISCOSITY,
    name: str | None = None,
) -> ImportedBeats:
    """A study of one vessel from raw records of its pressure and its inflow over several beats.

    The flow is the inflow, the mean pressure the observation, and the scatter between beats its noise. Both
    records are cut where the flow begins to rise. Their timing is told, and left as it is.

    Parameters
    ----------
    pressure, flow : str or Path
        CSV: lines that begin with # as remarks, a header, a column of times in s or as hh:mm:ss, and one of
        values. The unit stands at the end of the column's name, such as flow_ml_s, or in a remark as
        "unit: l/min". An empty cell and nan are not measured.
    length_cm, radius_cm : float
        Of the vessel, whose end is a three-element Windkessel.
    position : float
        Of the pressure along the vessel, from 0 at the inlet to 1.
    density_g_cm3, viscosity_g_cm_s : float
        Of blood.
    name : str
        Of the study; that of the pressure's file when absent.

    Returns
    -------
    ImportedBeats

    Raises
    ------
    ImportedFileError
        If an argument is out of range, a file cannot be read, or there are no whole beats.
    """
    p = read_record(Path(pressure), "pressure_mmHg")
    q = read_record(Path(flow), "flow_ml_s")
    sizes = {"length": length_cm, "radius": radius_cm}
    check_positive(p.path, **sizes, density=density_g_cm3, viscosity=viscosity_g_cm_s)
    if not 0 <= position <= 1:
        raise ImportedFileError(
            f"{p.path}: position = {position!r}: must be in [0, 1]; give the fraction of the vessel's length"
        )
    starts_q = beat_starts(q)
    shared = min(p.times[-1], q.times[-1]) - max(p.times[0], q.times[0])
    one_clock = shared > float(np.median(np.diff(starts_q)))
    starts_p = starts_q if one_clock else beat_starts(p)
    cut: dict[str, list[tuple[float, float]]] = {"pressure_mmHg": [], "flow_ml_s": []}
    left_out: list[str] = []
    if one_clock:
        for k, (begin, end) in enumerate(pairwise(starts_q.tolist()), 1):
            lacking = [r.quantity for r in (p, q) if not r.measured(begin, end)]
            if lacking:
                left_out.append(f"beat {k}: {' and '.join(lacking)} not measured throughout")
                continue
            for ends in cut.values():
                ends.append((begin, end))
    else:
        for r, starts in ((p, starts_p), (q, starts_q)):
            ends = list(pairwise(starts.tolist()))
            cut[r.quantity] = [(a, b) for a, b in ends if r.measured(a, b)]
            if len(cut[r.quantity]) < len(ends):
                left_out.append(
                    f"{len(ends) - len(cut[r.quantity])} of {len(ends)} beats of {r.quantity}, not measured "
                    "throughout"
                )
    for r in (p, q):
        if len(cut[r.quantity]) < FEWEST_BEATS:
            raise ImportedFileError(
                f"{r.path}: {len(cut[r.quantity])} whole beats of {r.quantity}: at least {FEWEST_BEATS} are "
                "needed for their scatter; give a longer record, or make a study of one beat"
            )
    lengths = {quantity: np.array([b - a for a, b in ends]) for quantity, ends in cut.items()}
    period = float(lengths["flow_ml_s"].mean())
    n = max(MIN_SAMPLES, round(period / min(p.step, q.step)))
    phase = np.arange(n) / n
    beats = {r.quantity: np.array([r.at(a + phase * (b - a)) for a, b in cut[r.quantity]]) for r in (p, q)}
    mean = {quantity: values.mean(axis=0) for quantity, values in beats.items()}
    check_flow(q.path, mean["flow_ml_s"])
    covariance = {quantity: np.cov(values, rowvar=False) for quantity, values in beats.items()}
    sd = {quantity: float(np.sqrt(np.trace(c) / n)) for quantity, c in covariance.items()}
    if not all(value > 0 for value in sd.values()):
        quantity = min(sd, key=lambda one: sd[one])
        raise ImportedFileError(
            f"{(p if quantity == p.quantity else q).path}: {quantity}: all beats are the same: they are "
            "averaged already; make a study of one beat"
        )

    read = [
        f"{r.quantity}: {len(r.times)} samples every {1000 * r.step:.3g} ms over "
        f"{r.times[-1] - r.times[0]:.4g} s, {r.missing} not measured"
        for r in (p, q)
    ]
    number_of = len(cut["pressure_mmHg"])
    read.append(
        f"{number_of} whole beats, {period:.4g} s long ({lengths['flow_ml_s'].min():.4g} to "
        f"{lengths['flow_ml_s'].max():.4g} s), averaged from where the flow begins to rise"
    )
    for quantity, values in beats.items():
        read += scatter_lines(quantity, values, sd[quantity], period)
    offset, scatter = None, None
    if one_clock:
        offset, scatter, height, limit = _offset(p, q, cut["flow_ml_s"])
        late = "late" if offset > 0 else "early"
        read.append(
            f"timing: flow is {1000 * abs(offset):.0f} ms {late} against the pressure, by cross-correlation "
            f"of their derivatives ({height:.2f}); between beats the standard deviation is "
            f"{1000 * scatter:.1f} ms, a sample is {1000 * max(p.step, q.step):.3g} ms; NOT corrected: both "
            "are cut at the same times"
        )
        if abs(offset) > limit:
            read.append(
                "timing: that is more than a sample and the scatter: pressure and flow in one place rise "
                "together but for waves and load; suspect a delay in one of the two instruments"
            )
    else:
        ratio = float(np.mean(lengths["pressure_mmHg"])) / period
        read.append(
            "timing: the two clocks share no whole beat: each record is cut where it begins to rise itself, "
            "so what lies between them is NOT measured, and no shift found later means anything; beats by "
            f"the pressure's clock are {100 * (ratio - 1):+.2g} % longer"
        )
    converted = tuple(
        f"{r.quantity}: from {r.unit}" for r in (p, q) if UNITS[r.quantity][r.unit.lower()] != 1.0
    )
    times = phase * period
    study = Study(
        name=name or p.path.stem,
        period_s=period,
        blood=Blood(density_g_cm3, viscosity_g_cm_s),
        vessels=(Vessel(1, "vessel", length_cm, radius_cm, radius_cm),),
        inflow_time_s=times,
        inflow_ml_s=mean["flow_ml_s"],
        time_s=times,
        series=(Series(1, position + 0.0, "pressure_mmHg", mean["pressure_mmHg"]),),
        source=p.path,
        noise_sd={"pressure_mmHg": sd["pressure_mmHg"]},
    )
    return ImportedBeats(study, tuple(read), converted, tuple(left_out), beats, covariance, offset, scatter)


def read_record(path: Path, quantity: str) -> Record:
    """A record of one quantity, in the study's unit."""
    if not path.is_file():
        raise ImportedFileError(f"{path}: no such file; give a .csv of times and {quantity}")
    lines = list(enumerate(read_text(path).splitlines(), 1))
    remarks = " ".join(line for _, line in lines if line.lstrip().startswith("#"))
    body = [(row, line) for row, line in lines if line.strip() and not line.lstrip().startswith("#")]
    cells = [(row, [c.strip() for c in next(csv.reader([line]))]) for row, line in body]
    if not cells:
        raise ImportedFileError(f"{path}: the file is empty; its first row is time_s,{quantity}")
    for row, found in cells:
        if len(found) != 2:
            raise ImportedFileError(
                f"{path}, row {row}: {len(found)} cells; give two columns, times and {quantity}"
            )
    unit = _unit(path, cells[0][1][1], remarks, quantity)
    times: list[float] = []
    values: list[float] = []
    missing, days = 0, 0.0
    for row, (time, text) in cells[1:]:
        t = _seconds(f"{path}, row {row}", cells[0][1][0], time) + days
        if times and t < times[-1] - _DAY_S / 2:  # past midnight
            t, days = t + _DAY_S, days + _DAY_S
        if text == "" or text.lower() == "nan":
            missing += 1
            continue
        if times and t <= times[-1]:
            raise ImportedFileError(
                f"{path}, row {row}: {cells[0][1][0]} = {short(time)}: not after the row before; sort the "
                "rows by time, and keep one of each"
            )
        times.append(t)
        values.append(number(f"{path}, row {row}", cells[0][1][1], text))
    if len(times) < FEWEST_BEATS * MIN_SAMPLES:
        raise ImportedFileError(
            f"{path}: {len(times)} samples: too few for {FEWEST_BEATS} beats; give at least "
            f"{FEWEST_BEATS * MIN_SAMPLES}"
        )
    factor = UNITS[quantity][unit.lower()]
    return Record(path, quantity, unit, np.array(times), factor * np.array(values), missing)


def _unit(path: Path, column: str, remarks: str, quantity: str) -> str:
    known = UNITS[quantity]
    ends = [unit for unit in known if column.lower().endswith("_" + unit)]
    if ends:
        return max(ends, key=len)
    told = re.search(r"unit:\s*([^;\s]+)", remarks)
    if told is None or told[1].lower() not in known:
        what = f"unit = {short(told[1])}" if told else f"column {short(column)}: no unit"
        raise ImportedFileError(
            f"{path}: {what}: must be one of {', '.join(known)}; name the column {quantity}, or add the line "
            f'"# unit: {next(iter(known))}"'
        )
    return told[1]


def _seconds(where: str, name: str, text: str) -> float:
    parts = text.split(":")
    if len(parts) not in (1, 3):
        raise ImportedFileError(f"{where}: {name} = {short(text)}: write seconds, or hh:mm:ss.fff")
    seconds = 0.0
    for part in parts:
        seconds = 60 * seconds + number(where, name, part)
    return seconds


def _even(record: Record) -> tuple[Array, Array]:
    times = np.arange(record.times[0], record.times[-1], record.step)
    return times, np.interp(times, record.times, record.values)


def beat_starts(record: Record) -> Array:
    """Times at which the quantity begins to rise, one for each beat.

    The length of a beat is where the record resembles itself most; in each beat the steepest rise is found,
    and from it, by the tangent of the mean beat, where the rise begins: the same lead for all beats.
    """
    times, values = _even(record)
    x = values - values.mean()
    n, most = len(x), len(x) // 2
    size = 2 ** int(np.ceil(np.log2(2 * n)))
    raw = np.fft.irfft(np.abs(np.fft.rfft(x, size)) ** 2, size)[:most] / np.arange(n, n - most, -1)
    peaks = [i for i in range(2, most - 1) if raw[i] > raw[i - 1] and raw[i] >= raw[i + 1] and raw[i] > 0]
    if not peaks:
        raise ImportedFileError(
            f"{record.path}: {record.quantity}: does not repeat itself within half of the record; give "
            "several beats"
        )
    best = max(raw[i] for i in peaks)
    lag = next(i for i in peaks if raw[i] >= 0.8 * best)  # two beats resemble two beats as well
    slope = np.gradient(values, record.step)
    found: list[int] = []
    for i in np.argsort(slope)[::-1]:
        if slope[i] < 0.5 * slope.max():
            break
        if all(abs(int(i) - j) > 0.6 * lag for j in found):
            found.append(int(i))
    found.sort()
    leads = []
    for i in found:
        before = values[max(0, i - lag // 4) : i + 1]
        leads.append((values[i] - before.min()) / slope[i])
    at = _aligned(slope, np.array(found, dtype=np.float64), lag)
    return np.asarray(times[0] + at * record.step - float(np.median(leads)), dtype=np.float64)


def _aligned(slope: Array, places: Array, lag: int) -> Array:
    """Places of the rises, in samples, where each beat's slope fits best to the mean of all.

    The steepest sample alone moves with the noise.
    """
    around = np.arange(-(lag // 4), lag // 2)
    tried = np.arange(-(lag // 8), lag // 8 + 1)
    index = np.arange(len(slope), dtype=np.float64)

    def read(places: Array) -> Array:
        return np.interp(places, index, slope, left=np.nan, right=np.nan)

    for _ in range(5):
        template = np.nanmean(read(places[:, None] + around), axis=0)
        moved = []
        for place in places:
            windows = read(place + tried[:, None] + around)
            fits = np.nanmean((windows - template) ** 2, axis=1)
            best = int(np.argmin(fits))
            moved.append(place + tried[best] + _vertex(-fits, best))
        before, places = places, np.array(moved)
        if np.max(np.abs(places - before)) < 0.01:
            break
    return places


def _vertex(values: Array, i: int) -> float:
    """Where the parabola through a largest sample and its neighbours is largest, from that sample."""
    if not 0 < i < len(values) - 1:
        return 0.0
    a, b, c = values[i - 1 : i + 2]
    bend = a - 2 * b + c
    return float(np.clip(0.5 * (a - c) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def _offset(p: Record, q: Record, cut: Sequence[tuple[float, float]]) -> tuple[float, float, float, float]:
    """Lateness of the flow (s), its scatter between beats (s), the correlation, what is no wonder (s)."""
    step = min(p.step, q.step)
    longest = float(np.mean([b - a for a, b in cut])) / 4
    lags = np.arange(-round(longest / step), round(longest / step) + 1)
    curves = []
    for begin, end in cut:
        t = np.arange(begin, end, step)
        dp = np.gradient(p.at(t), step)
        inside = (t >= q.times[0] + longest) & (t <= q.times[-1] - longest)
        if inside.sum() < MIN_SAMPLES:
            inside[:] = True
        sums = []
        for lag in lags:
            at = np.clip(t + lag * step, q.times[0], q.times[-1])
            dq = q.at(np.minimum(at + step / 2, q.times[-1])) - q.at(np.maximum(at - step / 2, q.times[0]))
            sums.append(float(np.corrcoef(dp[inside], dq[inside])[0, 1]))
        curves.append(np.array(sums))
    total = np.mean(curves, axis=0)

    def latest(curve: Array) -> float:
        i = int(np.argmax(curve))
        return float((lags[i] + _vertex(curve, i)) * step)

    each = np.array([latest(curve) for curve in curves])
    scatter = float(each.std(ddof=1))
    return latest(total), scatter, float(total.max()), max(step, 2 * scatter)


def scatter_lines(quantity: str, beats: Array, sd: float, period: float) -> list[str]:
    """What is told of a quantity's beats: scatter and how long it lasts, drift, beats that differ."""
    unit = quantity.split("_", 1)[1].replace("ml_s", "ml/s")
    n = beats.shape[1]
    residual = beats - beats.mean(axis=0)
    power = np.abs(np.fft.rfft(residual, axis=1)) ** 2
    along = np.fft.irfft(power.sum(axis=0), n)
    fallen = np.flatnonzero(along[: n // 2] < along[0] / np.e)
    lasts = f"{1000 * fallen[0] * period / n:.0f} ms" if len(fallen) else "the whole beat"
    levels = beats.mean(axis=1)
    drift, level = np.polyfit(np.arange(len(levels)), levels, 1)
    error = float(np.sqrt(np.sum((levels - level - drift * np.arange(len(levels))) ** 2)))
    error /= np.sqrt(max(1, len(levels) - 2) * np.sum((np.arange(len(levels)) - (len(levels) - 1) / 2) ** 2))
    lines = [
        f"{quantity}: scatter between beats {sd:.3g} {unit} (of their mean {sd / np.sqrt(len(beats)):.2g}), "
        f"correlated over {lasts}; drift {drift:+.2g} +- {error:.1g} {unit} a beat"
    ]
    off = np.sqrt(np.mean((beats - np.median(beats, axis=0)) ** 2, axis=1))
    usual = float(np.median(off))
    lines += [
        f"{quantity}: beat {k} differs: {one:.3g} {unit} RMS from the median beat, where the others are "
        f"{usual:.2g}; it is averaged too"
        for k, one in enumerate(off, 1)
        if one > DIFFERS * usual
    ]
    return lines
