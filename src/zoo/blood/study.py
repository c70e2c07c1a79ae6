"""Studies: a vessel tree, its inflow over one beat, and what was observed, as a folder of four files.

``study.toml`` names the others: ``network.toml`` (blood and vessels), ``inflow.csv`` and
``observations.csv``. Everything is checked when it is loaded, and an error says in one line which file,
row and field is wrong, what it holds, and what to do.
"""

from __future__ import annotations

import csv
import difflib
import hashlib
import json
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from zoo.blood.conventions import PRINTED, Conventions, ConventionsError, get_conventions
from zoo.blood.fetch import fetch_file

Array = NDArray[np.float64]

QUANTITIES = ("pressure_mmHg", "flow_ml_s", "area_cm2")
INFLOW_COLUMNS = ("time_s", "flow_ml_s")
OBSERVATION_COLUMNS = ("vessel", "position", "quantity", "time_s", "value")
MIN_SAMPLES = 16
"""Fewest samples of a beat, in the inflow and in every observed series."""

_STEP_TOLERANCE = 0.02  # of a step: how far two neighbouring samples may be from the usual distance
_GRID_TOLERANCE = 0.1  # of a step: how far a sample may be from its place on the uniform grid
_PERIOD_TOLERANCE = 0.05  # of a step: how far the samples' length may be from the period
_TIME_ROUNDING_S = 2e-8  # two times printed with 8 decimals
_BUILT_IN = Path(__file__).parents[1] / "data"


class StudyError(ValueError):
    """A study that cannot be used: one line with the file, row, field, value and remedy."""


# ---------------------------------------------------------------------------------------------------
# What a study is


def read_only(values: ArrayLike, dtype: Any = np.float64) -> Any:
    """A read-only array that nobody else can write to; copied unless it is one already."""
    array = np.asarray(values)
    own = array.base is None and array.flags.c_contiguous and not array.flags.writeable
    if not own or array.dtype != dtype:
        array = np.array(values, dtype=dtype, order="C")
        array.flags.writeable = False
    return array


class ReadOnlyArrays:
    """Pickles of frozen dataclasses come back with their arrays read-only."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
        self.__dict__.update(state)


@dataclass(frozen=True)
class Windkessel:
    """Three-element load of a terminal vessel: R1 in series with R2 parallel to C (eq. 3.7).

    Parameters
    ----------
    R1, R2 : float
        dyn s/cm5.
    C : float
        cm5/dyn.
    """

    R1: float
    R2: float
    C: float


@dataclass(frozen=True)
class Vessel:
    """One vessel of the tree, at rest.

    Parameters
    ----------
    id : int
        Number in the study's files.
    name : str
    length_cm : float
    radius_cm, radius_out_cm : float
        At the inlet and at the outlet, linear between.
    parent : int or None
        Id of the vessel that feeds it; None for the root.
    windkessel : Windkessel or None
        Nominal load of a terminal; None there means that it is derived from the observations.
    """

    id: int
    name: str
    length_cm: float
    radius_cm: float
    radius_out_cm: float
    parent: int | None = None
    windkessel: Windkessel | None = None


@dataclass(frozen=True)
class Blood:
    """Density in g/cm3 and dynamic viscosity in g/(cm s)."""

    density_g_cm3: float
    viscosity_g_cm_s: float


@dataclass(frozen=True, eq=False)
class Series(ReadOnlyArrays):
    """One observed quantity at one place over the beat.

    Parameters
    ----------
    vessel : int
        Id.
    position : float
        Along the vessel, 0 at the inlet and 1 at the outlet.
    quantity : {"pressure_mmHg", "flow_ml_s", "area_cm2"}
    value : array (n_times,)
        In the quantity's unit, at the study's ``time_s``.
    """

    vessel: int
    position: float
    quantity: str
    value: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "value", read_only(self.value))

    @property
    def label(self) -> str:
        """Such as "v1@0 pressure_mmHg"."""
        return f"v{self.vessel}@{repr(float(self.position)).removesuffix('.0')} {self.quantity}"


@dataclass(frozen=True, eq=False)
class Study(ReadOnlyArrays):
    """A vessel tree, its inflow and its observations; frozen, with read-only arrays.

    Two studies are equal when their name, conventions, checksum and tables are.

    Parameters
    ----------
    name : str
    period_s : float
        Length of the beat, s.
    blood : Blood
    vessels : tuple of Vessel
        In the order of the file.
    inflow_time_s, inflow_ml_s : array (n,)
        Flow into the root at times m period/n, s and ml/s.
    time_s : array (n_times,)
        Times of all series, uniform over one period, s; empty without series.
    series : tuple of Series
    conventions : Conventions
    source : Path or str
        Where it came from.
    priors : mapping
        The table [priors] of study.toml, as it stands there.
    noise_sd : mapping of str to float
        Known standard deviations of the measurement noise: quantity, or label of a series -> its unit.
    numerics : mapping
        The table [numerics], as it stands there.
    checksum : str
        SHA-256 over everything but the names, the conventions, the source and these three tables. It is
        always computed: a value handed in is not read.

    Raises
    ------
    StudyError
        If the arrays do not fit each other.
    """

    name: str
    period_s: float
    blood: Blood
    vessels: tuple[Vessel, ...]
    inflow_time_s: Array
    inflow_ml_s: Array
    time_s: Array
    series: tuple[Series, ...]
    conventions: Conventions = PRINTED
    source: Path | str = ""
    priors: Mapping[str, Any] = field(default_factory=dict, repr=False)
    noise_sd: Mapping[str, float] = field(default_factory=dict, repr=False)
    numerics: Mapping[str, Any] = field(default_factory=dict, repr=False)
    checksum: str = field(default="", repr=False)

    def __post_init__(self) -> None:
        for name in ("inflow_time_s", "inflow_ml_s", "time_s"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        for name in ("vessels", "series"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        lengths = [("inflow_ml_s", self.inflow_ml_s, self.inflow_time_s)]
        lengths += [(series.label, series.value, self.time_s) for series in self.series]
        for name, values, times in lengths:
            if values.ndim != 1 or values.shape != times.shape:
                raise StudyError(
                    f"study {self.name!r}: {name}: shape {values.shape} does not fit the {len(times)} times; "
                    "give one value for each time"
                )
        object.__setattr__(self, "checksum", self._checksum())

    def _checksum(self) -> str:
        vessels = [
            [v.id, v.parent, *map(float, (v.length_cm, v.radius_cm, v.radius_out_cm))]
            + ([] if v.windkessel is None else [float(x) for x in vars(v.windkessel).values()])
            for v in self.vessels
        ]
        series = [[s.vessel, float(s.position), s.quantity] for s in self.series]
        blood = [float(x) for x in vars(self.blood).values()]
        digest = hashlib.sha256(json.dumps([float(self.period_s), blood, vessels, series]).encode())
        for array in (self.inflow_time_s, self.inflow_ml_s, self.time_s, *(s.value for s in self.series)):
            digest.update(f";{len(array)}:".encode() + array.astype("<f8").tobytes())
        return digest.hexdigest()

    @property
    def values(self) -> Array:
        """All series, shape (n_series, n_times), each in its own unit."""
        return np.array([s.value for s in self.series]).reshape(len(self.series), len(self.time_s))

    def _identity(self) -> tuple[str, Conventions, str, str]:
        tables = json.dumps([dict(self.priors), dict(self.noise_sd), dict(self.numerics)], sort_keys=True)
        return self.name, self.conventions, self.checksum, tables

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Study) and self._identity() == other._identity()

    def __hash__(self) -> int:
        return hash(self._identity())


# ---------------------------------------------------------------------------------------------------
# Tables of the TOML files


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _StudyTable(_Table):
    name: str
    network: str
    inflow: Any
    observations: Any = None
    period_s: float = Field(gt=0)
    conventions: Any = "printed"
    priors: dict[str, Any] = Field(default_factory=dict)
    noise_sd: dict[str, float] = Field(default_factory=dict)
    numerics: dict[str, Any] = Field(default_factory=dict)


class _FetchedInflow(_Table):
    fetch: str


class _FetchedObservations(_Table):
    fetch: str
    vessel: int
    position: float
    quantity: str
    average: int = Field(default=1, ge=1)


class _NetworkTable(_Table):
    blood: dict[str, Any]
    vessel: list[dict[str, Any]]


class _BloodTable(_Table):
    density_g_cm3: float = Field(gt=0)
    viscosity_g_cm_s: float = Field(gt=0)


class _WindkesselTable(_Table):
    R1: float = Field(gt=0)
    R2: float = Field(gt=0)
    C: float = Field(gt=0)


class _VesselTable(_Table):
    id: int = Field(ge=1, lt=2**31)
    name: str = ""
    length_cm: float = Field(gt=0)
    radius_cm: float = Field(gt=0)
    radius_out_cm: float | None = Field(default=None, gt=0)
    parent: int | None = None
    windkessel: _WindkesselTable | None = None


_MEANING = {
    "missing": "is missing; add it",
    "greater_than": "must be positive; correct it",
    "greater_than_equal": "must be at least 1; correct it",
    "less_than": "is too large; correct it",
    "finite_number": "must be finite; correct it",
    "float_type": "must be a number; write it without quotes",
    "int_type": "must be a whole number; correct it",
    "string_type": "must be text; write it in quotes",
    "dict_type": "must be a table; write { ... } or a [heading]",
    "model_type": "must be a table; write { ... } or a [heading]",
    "list_type": "must be a list of tables; write [[vessel]]",
}


def _near(word: object, known: Sequence[str]) -> str:
    """Hint at the nearest known word, then all of them."""
    close = difflib.get_close_matches(str(word), known, 1, 0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}use one of {', '.join(known)}"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _table(model: type[_Table], data: Any, where: str) -> Any:
    """Validate a table of a TOML file; its first fault is raised, a misspelt field before others."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        faults = sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
    loc, kind = faults[0]["loc"], faults[0]["type"]
    name = ".".join(str(part) for part in loc)
    if kind == "extra_forbidden":
        known = _WindkesselTable if loc[0] == "windkessel" else model
        raise StudyError(f"{where}: {name}: unknown field; {_near(loc[-1], list(known.model_fields))}")
    if kind == "missing":
        raise StudyError(f"{where}: {name}: {_MEANING[kind]}")
    meaning = _MEANING.get(kind, f"{faults[0]['msg']}; correct it")
    raise StudyError(f"{where}: {name} = {_short(faults[0]['input'])}: {meaning}")


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise StudyError(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8") from None
    except OSError as error:
        raise StudyError(f"{path}: cannot be read ({error.strerror}); correct that") from None


def _toml(path: Path) -> tuple[dict[str, Any], str]:
    text = _text(path)
    try:
        return tomllib.loads(text), text
    except tomllib.TOMLDecodeError as error:
        raise StudyError(f"{path}: not valid TOML: {error}; correct that line") from None


def _name(where: str, name: str) -> str:
    if not name.strip() or not name.isprintable():
        raise StudyError(f"{where}: name = {name!r}: must be one line of visible text; correct it")
    return name


# ---------------------------------------------------------------------------------------------------
# The tree


def sort_vessels(vessels: Sequence[Vessel], where: Sequence[str] | None = None) -> list[int]:
    """Check that vessels form one tree, and order them with parents before their children.

    Parameters
    ----------
    vessels : sequence of Vessel
    where : sequence of str
        What an error calls each vessel; "network: vessel ID" when absent.

    Returns
    -------
    list of int
        Indices into `vessels`, in their own order as far as parents before children allow.

    Raises
    ------
    StudyError
        If there is no vessel, an id occurs twice, a parent does not exist, there is not exactly one root,
        vessels feed each other in a circle, or a vessel that is not a terminal has a Windkessel.
    """
    where = where or [f"network: vessel {v.id}" for v in vessels]
    if not vessels:
        raise StudyError("network: no vessels; add at least one")
    index: dict[int, int] = {}
    for i, vessel in enumerate(vessels):
        if vessel.id in index:
            raise StudyError(
                f"{where[i]}: id = {vessel.id}: also the id of another vessel ({where[index[vessel.id]]}); "
                "give each vessel its own"
            )
        index[vessel.id] = i
    for i, vessel in enumerate(vessels):
        if vessel.parent is not None and vessel.parent not in index:
            raise StudyError(
                f"{where[i]}: parent = {vessel.parent}: no such vessel; use the id of the one that feeds it"
            )
    roots = [i for i, vessel in enumerate(vessels) if vessel.parent is None]
    if len(roots) > 1:
        raise StudyError(
            f"{where[roots[1]]}: parent: is missing, but vessel {vessels[roots[0]].id} is the root already; "
            "give every vessel but one a parent"
        )
    children: dict[int, list[int]] = {i: [] for i in range(len(vessels))}
    for i, vessel in enumerate(vessels):
        if vessel.parent is not None:
            children[index[vessel.parent]].append(i)

    order: list[int] = []
    ready = roots
    while ready:
        ready.sort(reverse=True)
        order.append(ready.pop())
        ready += children[order[-1]]
    if len(order) < len(vessels):
        placed, path = set(order), []
        i = next(i for i in range(len(vessels)) if i not in placed)
        while i not in path:
            path.append(i)
            i = index[vessels[i].parent]  # type: ignore[index]  # only the root has no parent, and it is placed
        circle = [str(vessels[j].id) for j in [*path[path.index(i) :], i]]
        raise StudyError(
            f"{where[i]}: parent = {vessels[i].parent}: vessels feed each other in a circle "
            f"({' <- '.join(circle)}); follow the flow from the root and correct a parent"
        )
    for i, vessel in enumerate(vessels):
        if vessel.windkessel is not None and children[i]:
            fed = ", ".join(str(vessels[j].id) for j in children[i])
            raise StudyError(
                f"{where[i]}: windkessel: only a terminal may have one, but this feeds {fed}; remove it"
            )
    return order


def _read_network(path: Path) -> tuple[Blood, tuple[Vessel, ...], list[str]]:
    """Blood, vessels, and what an error calls each vessel."""
    data, text = _toml(path)
    table = _table(_NetworkTable, data, str(path))
    blood = _table(_BloodTable, table.blood, f"{path}: blood")
    heads = [n for n, line in enumerate(text.splitlines(), 1) if re.match(r"\s*\[\[\s*vessel\s*\]\]", line)]
    vessels, where = [], []
    for i, data in enumerate(table.vessel):
        row = f", row {heads[i]}" if len(heads) == len(table.vessel) else ""
        place = f"{path}{row}: vessel {data.get('id', f'number {i + 1}')}"
        v = _table(_VesselTable, data, place)
        load = v.windkessel and Windkessel(v.windkessel.R1, v.windkessel.R2, v.windkessel.C)
        out = v.radius_cm if v.radius_out_cm is None else v.radius_out_cm
        name = _name(place, v.name or f"v{v.id}")
        vessels.append(Vessel(v.id, name, v.length_cm, v.radius_cm, out, v.parent, load))
        where.append(place)
    if not vessels:
        raise StudyError(f"{path}: vessel: the list is empty; add at least one [[vessel]]")
    sort_vessels(vessels, where)
    return Blood(blood.density_g_cm3, blood.viscosity_g_cm_s), tuple(vessels), where


def read_network(path: str | Path) -> tuple[Blood, tuple[Vessel, ...]]:
    """Blood and vessels of a network.toml.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    blood : Blood
    vessels : tuple of Vessel

    Raises
    ------
    StudyError
        If the file cannot be read or a field is wrong.
    """
    blood, vessels, _ = _read_network(Path(path))
    return blood, vessels


# ---------------------------------------------------------------------------------------------------
# Tables of samples


def _number(where: str, name: str, text: str) -> float:
    try:
        value = float(text) if "_" not in text else None
    except ValueError:
        value = None
    if value is None:
        raise StudyError(f"{where}: {name} = {text!r}: not a number; correct it")
    if not math.isfinite(value):
        raise StudyError(f"{where}: {name} = {text!r}: must be finite; interpolate it or cut the series")
    return value


def _read_csv(path: Path, columns: Sequence[str]) -> list[tuple[int, dict[str, str]]]:
    """Rows as (row number, cells by column); row 1 is the header, blank rows are left out."""
    reader = csv.reader(_text(path).splitlines(), strict=True)
    try:
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except csv.Error as error:
        raise StudyError(f"{path}, row {reader.line_num}: {error}; correct that row") from None
    lines = [(row, cells) for row, cells in rows if any(cells)]
    if not lines:
        raise StudyError(f"{path}: the file is empty; its first row is {','.join(columns)}")
    row, header = lines[0]
    for name in header:
        if name not in columns:
            raise StudyError(f"{path}, row {row}: {name!r}: unknown column; {_near(name, columns)}")
        if header.count(name) > 1:
            raise StudyError(f"{path}, row {row}: {name!r}: the column occurs twice; keep one")
    for name in columns:
        if name not in header:
            raise StudyError(f"{path}, row {row}: {name}: column missing; add it to {','.join(header)}")
    for row, cells in lines[1:]:
        if len(cells) != len(header):
            raise StudyError(
                f"{path}, row {row}: {len(cells)} cells where the header has {len(header)}; "
                f"give {','.join(header)}"
            )
    return [(row, dict(zip(header, cells, strict=True))) for row, cells in lines[1:]]


@dataclass(frozen=True)
class _Samples:
    """Samples of one series before they are on the grid, and the rows they came from."""

    path: Path | str
    label: str
    rows: Sequence[int]
    times: Array
    values: Array
    unit: str

    def fail(self, i: int, name: str, value: float, reason: str) -> NoReturn:
        raise StudyError(f"{self.path}, row {self.rows[i]}: {name} = {value:.10g}: {self.label}: {reason}")


def _uniform(samples: _Samples, period: float, *, from_zero: bool) -> tuple[Array, Array]:
    """Times and values on the uniform grid of one period that the samples are on.

    Times t0 + m period/n replace the printed ones, which may be rounded; a last sample that repeats the first
    one a period later is dropped.
    """
    if len(samples.times) < MIN_SAMPLES:
        raise StudyError(
            f"{samples.path}: {samples.label}: {len(samples.times)} samples: too few for a beat; "
            f"give at least {MIN_SAMPLES}"
        )
    order = np.argsort(samples.times, kind="stable")
    s = _Samples(
        samples.path,
        samples.label,
        [samples.rows[i] for i in order],
        samples.times[order],
        samples.values[order],
        samples.unit,
    )
    times, values = s.times, s.values
    gaps = np.diff(times)
    if np.any(gaps == 0):
        i = int(np.argmax(gaps == 0))
        s.fail(
            i + 1, "time_s", times[i + 1], f"a second sample at this time, beside row {s.rows[i]}; keep one"
        )
    step = float(np.median(gaps))
    uneven = np.abs(gaps - step) > _STEP_TOLERANCE * step + _TIME_ROUNDING_S
    if np.any(uneven):
        i = int(np.argmax(uneven))
        s.fail(
            i + 1,
            "time_s",
            times[i + 1],
            f"{gaps[i]:.6g} s after the sample before, where others are {step:.6g} s apart; "
            "resample to a uniform grid",
        )
    if abs(times[-1] - times[0] - period) <= _GRID_TOLERANCE * step:
        if abs(values[-1] - values[0]) > 1e-9 * np.ptp(values):
            s.fail(
                len(times) - 1,
                s.unit,
                values[-1],
                f"a period_s = {period:.10g} after the first sample ({values[0]:.10g}), so it must repeat "
                "that one; remove this row, or correct period_s",
            )
        times, values = times[:-1], values[:-1]
    n = len(times)
    step = float(times[-1] - times[0]) / (n - 1)
    if abs(n * step - period) > _PERIOD_TOLERANCE * step:
        raise StudyError(
            f"{s.path}, row {s.rows[n - 1]}: time_s = {times[-1]:.10g}: {s.label}: {n} samples {step:.6g} s "
            f"apart make a beat of {n * step:.8g} s, but period_s = {period:.10g} in study.toml; correct "
            "period_s, or resample to one whole period"
        )
    if times[0] < 0:
        s.fail(0, "time_s", times[0], "before the beat; count from its start")
    if times[0] > (1 - _GRID_TOLERANCE) * step:
        s.fail(n - 1, "time_s", times[-1], "past the period, as the series begins late; begin at time 0")
    if from_zero and times[0] > _PERIOD_TOLERANCE * step:
        s.fail(0, "time_s", times[0], "the inflow must begin at time 0; shift or resample it")
    start = 0.0 if from_zero else float(times[0])
    grid = np.asarray(start + np.arange(n) * (period / n), dtype=np.float64)
    off = np.abs(times - grid)
    if np.any(off > _GRID_TOLERANCE * step):
        i = int(np.argmax(off))
        s.fail(i, "time_s", times[i], f"{off[i]:.3g} s from its place on a uniform grid; resample to one")
    return grid, values


def _read_inflow(path: Path, period: float) -> tuple[Array, Array]:
    table = _read_csv(path, INFLOW_COLUMNS)
    numbers = np.array(
        [[_number(f"{path}, row {row}", c, cells[c]) for c in INFLOW_COLUMNS] for row, cells in table]
    ).reshape(-1, 2)
    samples = _Samples(path, "inflow", [row for row, _ in table], numbers[:, 0], numbers[:, 1], "flow_ml_s")
    return _uniform(samples, period, from_zero=True)


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
        raise StudyError(f"{where}: quantity = {quantity!r}: unknown; {_near(quantity, QUANTITIES)}")


def _read_observations(path: Path, period: float, known: Sequence[int]) -> tuple[Array, tuple[Series, ...]]:
    groups: dict[tuple[int, float, str], list[tuple[int, float, float]]] = {}
    for row, cells in _read_csv(path, OBSERVATION_COLUMNS):
        where = f"{path}, row {row}"
        if not re.fullmatch(r"[+-]?\d{1,10}", cells["vessel"]):
            raise StudyError(f"{where}: vessel = {cells['vessel']!r}: not a whole number; use a vessel's id")
        place = int(cells["vessel"]), _number(where, "position", cells["position"]) + 0.0, cells["quantity"]
        if place not in groups:
            _check_place(where, *place, known)
        time, value = (_number(where, name, cells[name]) for name in ("time_s", "value"))
        if cells["quantity"] == "area_cm2" and value <= 0:
            raise StudyError(f"{where}: value = {value!r}: an area_cm2 must be positive; correct it")
        groups.setdefault(place, []).append((row, time, value))
    if not groups:
        raise StudyError(f"{path}: no samples; add some, or remove observations from study.toml")

    series: list[Series] = []
    grid = np.empty(0)
    for place, samples in groups.items():
        rows = [row for row, _, _ in samples]
        times, values = np.array([sample[1:] for sample in samples]).T
        label = Series(*place, np.empty(0)).label
        own, on_grid = _uniform(_Samples(path, label, rows, times, values, "value"), period, from_zero=False)
        if not series:
            grid = own
        elif len(own) != len(grid) or np.max(np.abs(own - grid)) > _PERIOD_TOLERANCE * period / len(grid):
            raise StudyError(
                f"{path}, row {rows[0]}: time_s = {times[0]:.10g}: {label}: {len(own)} samples from "
                f"{own[0]:.6g} s, but {series[0].label} has {len(grid)} from {grid[0]:.6g} s; "
                "resample all series to the same times"
            )
        series.append(Series(*place, on_grid))
    return grid, tuple(series)


def _column(path: Path) -> Array:
    """Numbers of a file with one in each row."""
    lines = [(row, line.strip()) for row, line in enumerate(_text(path).split("\n"), 1)]
    return np.array([_number(f"{path}, row {row}", "value", line) for row, line in lines if line])


def _fetched_inflow(table: _FetchedInflow, period: float) -> tuple[Array, Array]:
    """Column of flows, the first one repeated at the end."""
    path = fetch_file(table.fetch)
    flow = _column(path)
    times = np.arange(len(flow)) * period / max(1, len(flow) - 1)
    return _uniform(
        _Samples(path, "inflow", range(1, len(flow) + 1), times, flow, "value"), period, from_zero=True
    )


def _fetched_observations(
    where: str, table: _FetchedObservations, period: float, known: Sequence[int]
) -> tuple[Array, tuple[Series, ...]]:
    """Column of samples of a beat; `average` neighbours become their mean, at their mean time."""
    _check_place(where, table.vessel, table.position, table.quantity, known)
    path = fetch_file(table.fetch)
    raw = _column(path)
    if len(raw) % table.average:
        raise StudyError(
            f"{where}: average = {table.average}: does not divide the {len(raw)} samples of {table.fetch}; "
            "use a divisor"
        )
    times = np.arange(len(raw)) * period / len(raw)
    times, values = (a.reshape(-1, table.average).mean(axis=1) for a in (times, raw))
    series = Series(table.vessel, table.position + 0.0, table.quantity, values)
    rows = range(1, len(raw) + 1, table.average)
    grid, _ = _uniform(_Samples(path, series.label, rows, times, values, "value"), period, from_zero=False)
    return grid, (series,)


# ---------------------------------------------------------------------------------------------------
# Whole studies


def list_studies() -> tuple[str, ...]:
    """Names of the studies that come with the package."""
    return tuple(sorted(path.parent.name for path in _BUILT_IN.glob("*/study.toml")))


def _find(name_or_folder: str | Path) -> tuple[Path, Path | str]:
    """Folder of a study, and what to call it."""
    folder = Path(name_or_folder)
    folder = folder.parent if folder.name == "study.toml" else folder
    here = (folder / "study.toml").is_file()
    if isinstance(name_or_folder, str) and name_or_folder in list_studies():
        built_in = _BUILT_IN / name_or_folder
        if here and folder.resolve() != built_in.resolve():
            raise StudyError(
                f"{name_or_folder}: both a built-in study and a folder here; write ./{name_or_folder} for "
                "the folder, or work in another one"
            )
        return built_in, f"built-in study {name_or_folder}"
    if here:
        return folder, folder
    if folder.is_dir():
        raise StudyError(f"{folder}: no study.toml in this folder; add one")
    known = list_studies()
    raise StudyError(
        f"{name_or_folder}: neither a folder with a study.toml nor a built-in study; "
        f"{_near(name_or_folder, known)}"
    )


def _file(where: str, folder: Path, name: str, value: Any) -> Path:
    if not isinstance(value, str):
        raise StudyError(f"{where}: {name} = {_short(value)}: must be a file name; write it in quotes")
    path = folder / value
    if not path.is_file():
        raise StudyError(f"{where}: {name} = {value!r}: no such file in {folder}; add it or correct the name")
    return path


def load_study(
    name_or_folder: str | Path, conventions: str | Mapping[str, Any] | Conventions | None = None
) -> Study:
    """Load and check a study.

    Parameters
    ----------
    name_or_folder : str or Path
        A built-in name (see `list_studies`), or a folder with a ``study.toml``.
    conventions : str, mapping or Conventions
        Instead of the study's own; as in `zoo.blood.conventions.get_conventions`.

    Returns
    -------
    Study

    Raises
    ------
    StudyError
        If anything in it is wrong: one line with the file, row, field, value and remedy.
    zoo.blood.fetch.FetchError
        If it is made of measured data that cannot be had.
    zoo.blood.conventions.ConventionsError
        If `conventions` do not exist.
    """
    folder, source = _find(name_or_folder)
    path = folder / "study.toml"
    table = _table(_StudyTable, _toml(path)[0], str(path))
    where = str(path)
    name = _name(where, table.name)
    try:
        own = get_conventions(table.conventions)
    except ConventionsError as error:
        raise StudyError(f"{where}: {error}") from None
    chosen = own if conventions is None else get_conventions(conventions)

    network = _file(where, folder, "network", table.network)
    blood, vessels, places = _read_network(network)
    known = [v.id for v in vessels]

    if isinstance(table.inflow, dict):
        fetched = _table(_FetchedInflow, table.inflow, f"{where}: inflow")
        inflow_time, inflow = _fetched_inflow(fetched, table.period_s)
    else:
        inflow_path = _file(where, folder, "inflow", table.inflow)
        inflow_time, inflow = _read_inflow(inflow_path, table.period_s)
    if not inflow.mean() > 0:
        raise StudyError(
            f"{where}: inflow = {_short(table.inflow)}: mean flow_ml_s = {inflow.mean():.6g}: must be "
            "positive; count flow into the root as positive"
        )

    time: Array = np.empty(0)
    series: tuple[Series, ...] = ()
    if isinstance(table.observations, dict):
        observed = _table(_FetchedObservations, table.observations, f"{where}: observations")
        time, series = _fetched_observations(f"{where}: observations", observed, table.period_s, known)
    elif table.observations is not None:
        observations_path = _file(where, folder, "observations", table.observations)
        time, series = _read_observations(observations_path, table.period_s, known)

    _check_terminals(vessels, places, series)
    return Study(
        name=name,
        period_s=table.period_s,
        blood=blood,
        vessels=vessels,
        inflow_time_s=inflow_time,
        inflow_ml_s=inflow,
        time_s=time,
        series=series,
        conventions=chosen,
        source=source,
        priors=table.priors,
        noise_sd=_checked_noise(where, table.noise_sd, series),
        numerics=table.numerics,
    )


def _checked_noise(where: str, noise_sd: Mapping[str, float], series: Sequence[Series]) -> dict[str, float]:
    """Standard deviations by quantity or series, positive, of series that there are."""
    known = [*QUANTITIES, *(s.label for s in series)]
    for name, value in noise_sd.items():
        if name not in known:
            raise StudyError(f"{where}: noise_sd: {name!r}: unknown; {_near(name, known)}")
        if not value > 0:
            raise StudyError(f"{where}: noise_sd: {name} = {value!r}: must be positive; correct it")
    return {name: float(value) for name, value in noise_sd.items()}


def root_pressure(vessels: Sequence[Vessel], series: Sequence[Series]) -> Series | None:
    """The observed pressure nearest to the inlet of the root, from which nominal loads can be derived."""
    root = next(v.id for v in vessels if v.parent is None)
    found = [s for s in series if s.vessel == root and s.quantity == "pressure_mmHg"]
    return min(found, key=lambda s: s.position, default=None)


def _check_terminals(vessels: Sequence[Vessel], places: Sequence[str], series: Sequence[Series]) -> None:
    feeding = {v.parent for v in vessels}
    root = next(v.id for v in vessels if v.parent is None)
    for vessel, place in zip(vessels, places, strict=True):
        if vessel.id in feeding or vessel.windkessel or root_pressure(vessels, series):
            continue
        raise StudyError(
            f"{place}: windkessel: is missing at a terminal, and cannot be derived without an observed "
            f"pressure_mmHg in the root (vessel {root}); add windkessel = {{ R1, R2, C }} in cgs"
        )


# ---------------------------------------------------------------------------------------------------
# Writing


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(name)} = {_value(inner)}" for name, inner in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, int):
        return repr(value)
    return _quoted(value) if isinstance(value, str) else repr(float(value))


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)


def _vessel_lines(vessel: Vessel) -> list[str]:
    lines = ["", "[[vessel]]", f"id = {int(vessel.id)}", f"name = {_quoted(vessel.name)}"]
    lines += [f"length_cm = {_value(vessel.length_cm)}", f"radius_cm = {_value(vessel.radius_cm)}"]
    if vessel.radius_out_cm != vessel.radius_cm:
        lines.append(f"radius_out_cm = {_value(vessel.radius_out_cm)}")
    if vessel.parent is not None:
        lines.append(f"parent = {int(vessel.parent)}")
    if vessel.windkessel is not None:
        load = ", ".join(f"{name} = {_value(x)}" for name, x in vars(vessel.windkessel).items())
        lines.append(f"windkessel = {{ {load} }}")
    return lines


def save_study(study: Study, folder: str | Path) -> None:
    """Write a study as a folder that `load_study` reads back exactly, every digit included.

    Parameters
    ----------
    study : Study
    folder : str or Path
        Made when absent; files of the same names in it are replaced.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)

    def write(name: str, lines: Sequence[str]) -> None:
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")

    lines = [f"name = {_quoted(study.name)}", 'network = "network.toml"', 'inflow = "inflow.csv"']
    if study.series:
        lines.append('observations = "observations.csv"')
    lines.append(f"period_s = {_value(study.period_s)}")
    own = study.conventions
    changes = "".join(f", {name} = {_value(value)}" for name, value in own.changes.items())
    named = f"{{ base = {_quoted(own.base)}{changes} }}" if changes else _quoted(own.name)
    lines.append(f"conventions = {named}")
    for heading in ("priors", "noise_sd", "numerics"):
        table = getattr(study, heading)
        if table:
            lines += [
                "",
                f"[{heading}]",
                *(f"{_key(name)} = {_value(value)}" for name, value in table.items()),
            ]
    write("study.toml", lines)

    blood = [f"{name} = {_value(value)}" for name, value in vars(study.blood).items()]
    write("network.toml", ["[blood]", *blood, *(line for v in study.vessels for line in _vessel_lines(v))])

    pairs = zip(study.inflow_time_s.tolist(), study.inflow_ml_s.tolist(), strict=True)
    write("inflow.csv", [",".join(INFLOW_COLUMNS), *(f"{t!r},{q!r}" for t, q in pairs)])
    if study.series:
        rows = [
            f"{int(s.vessel)},{float(s.position)!r},{s.quantity},{t!r},{x!r}"
            for s in study.series
            for t, x in zip(study.time_s.tolist(), s.value.tolist(), strict=True)
        ]
        write("observations.csv", [",".join(OBSERVATION_COLUMNS), *rows])
