"""The study itself: a vessel tree, its inlet and its observations, with its checksum."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from zoo.blood.conventions import PRINTED, Conventions
from zoo.blood.study.parts import Blood, ReadOnlyArrays, Series, StudyError, Vessel, read_only
from zoo.core.arrays import Array

JUNCTION_PRESSURES = ("static", "total")
WALL_LAWS = ("linear", "olufsen")
PRESSURES = ("external_pressure_mmHg", "outflow_pressure_mmHg", "radius_pressure_mmHg")


@dataclass(frozen=True, eq=False, repr=False)
class Study(ReadOnlyArrays):
    """A vessel tree, its inlet and its observations; frozen, with read-only arrays.

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
        Flow into the root at times m period/n, s and ml/s; empty where the pressure is given.
    time_s : array (n_times,)
        Times of all series, uniform over one period, s; empty without series.
    series : tuple of Series
    conventions : Conventions
    source : Path or str
        Where it came from.
    priors : mapping
        The table [priors] of study.toml, as it stands there.
    junction_pressure : {"static", "total"}
        What is equal in the vessels that meet: p, or p + rho u^2/2.
    external_pressure_mmHg, outflow_pressure_mmHg, radius_pressure_mmHg : float
        Outside all vessels, behind all outlets, and that (inside less outside) at which radii are given,
        mmHg; a vessel's own value takes its place.
    outflow_wave_mmHg : array (n,)
        Pressure behind all outlets at times m period/n, mmHg; empty where it does not change. Its mean is
        `outflow_pressure_mmHg`, which need not be given with it.
    inlet_pressure_mmHg : array (n,)
        Pressure at the root's inlet at times m period/n, mmHg, instead of the flow there; empty where that is
        given.
    wall : {"linear", "olufsen"}
        Law of all walls, p = (4/3) chi (sqrt(A/A0) - 1) or p = (4/3) chi (1 - sqrt(A0/A)).
    inflow_note : str
        What was done to the inflow when it was loaded; empty for nothing.
    noise_sd : mapping of str to float
        Known standard deviations of the measurement noise: quantity, or label of a series -> its unit.
    numerics : mapping
        The table [numerics], as it stands there.
    parameters : mapping of str to float
        The table [parameters]: those of models that are held at a value, in their unit.
    checksum : str
        SHA-256 over everything but the names, the conventions, the source and these four tables. It is
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
    parameters: Mapping[str, float] = field(default_factory=dict, repr=False)
    junction_pressure: str = "static"
    external_pressure_mmHg: float = 0.0
    outflow_pressure_mmHg: float = 0.0
    radius_pressure_mmHg: float = 0.0
    wall: str = "linear"
    outflow_wave_mmHg: Array = field(default_factory=lambda: np.empty(0), repr=False)
    inlet_pressure_mmHg: Array = field(default_factory=lambda: np.empty(0), repr=False)
    inflow_note: str = field(default="", repr=False)
    checksum: str = field(default="", repr=False)

    def __post_init__(self) -> None:
        for name in ("inflow_time_s", "inflow_ml_s", "time_s", "outflow_wave_mmHg", "inlet_pressure_mmHg"):
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
        for name, known in (("junction_pressure", JUNCTION_PRESSURES), ("wall", WALL_LAWS)):
            if getattr(self, name) not in known:
                raise StudyError(
                    f"study {self.name!r}: {name} = {getattr(self, name)!r}: must be one of "
                    f"{', '.join(known)}"
                )
        self._check_outflow()
        self._check_inlet()
        object.__setattr__(self, "checksum", self._checksum())

    def _check_outflow(self) -> None:
        wave, where = self.outflow_wave_mmHg, f"study {self.name!r}: outflow_wave_mmHg"
        if not wave.size:
            return
        if wave.ndim != 1 or not np.all(np.isfinite(wave)):
            raise StudyError(f"{where}: shape {wave.shape}: must be finite numbers in one row; correct it")
        mean, given = float(wave.mean()), self.outflow_pressure_mmHg
        if given and abs(given - mean) > 1e-9 * float(np.abs(wave).max()):
            raise StudyError(
                f"{where}: its mean is {mean!r}, but outflow_pressure_mmHg = {given!r}; leave that out"
            )
        object.__setattr__(self, "outflow_pressure_mmHg", mean)

    def _check_inlet(self) -> None:
        pressure, where = self.inlet_pressure_mmHg, f"study {self.name!r}: inlet_pressure_mmHg"
        if not pressure.size:
            return
        if pressure.ndim != 1 or not np.all(np.isfinite(pressure)):
            raise StudyError(
                f"{where}: shape {pressure.shape}: must be finite numbers in one row; correct it"
            )
        if self.inflow_ml_s.size:
            raise StudyError(f"{where}: is given beside inflow_ml_s; leave one of the two out")
        for series in self.series:
            root = next(v.id for v in self.vessels if v.parent is None)
            if (series.vessel, series.position, series.quantity) == (root, 0.0, "pressure_mmHg"):
                raise StudyError(
                    f"study {self.name!r}: observations: {series.label}: is what inlet_pressure gives, so no "
                    "model can miss it; leave this series out, or give inflow instead"
                )

    def _checksum(self) -> str:
        vessels = [
            [v.id, v.parent, *map(float, (v.length_cm, v.radius_cm, v.radius_out_cm))]
            + ([] if v.windkessel is None else [float(x) for x in vars(v.windkessel).values()])
            for v in self.vessels
        ]
        series = [[s.vessel, float(s.position), s.quantity] for s in self.series]
        blood = [float(self.blood.density_g_cm3), float(self.blood.viscosity_g_cm_s)]
        content: list[Any] = [float(self.period_s), blood, vessels, series]
        own = {v.id: v.physics for v in self.vessels if v.physics}
        narrow = [[v.id, repr(v.stenosis)] for v in self.vessels if v.stenosis is not None]
        if narrow:
            content.append(narrow)
        tables = {v.id: v.impedance for v in self.vessels if v.impedance is not None}
        if tables:
            content.append([[i, repr(table)] for i, table in tables.items()])
        if self.physics or self.blood.physics or own:  # a study without has the checksum that it always had
            content.append([self.physics, self.blood.physics, own])
        digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode())
        own_waves = [x for x in (self.outflow_wave_mmHg, self.inlet_pressure_mmHg) if x.size]
        arrays = [self.inflow_time_s, self.inflow_ml_s, self.time_s, *(s.value for s in self.series)]
        for array in (*arrays, *own_waves):
            digest.update(f";{len(array)}:".encode() + array.astype("<f8").tobytes())
        return digest.hexdigest()

    @property
    def physics(self) -> dict[str, str | float]:
        """Pressures, junctions and walls of the whole tree that are not at their default."""
        words = {"junction_pressure": "static", "wall": "linear"}
        given = {name: value for name, plain in words.items() if (value := getattr(self, name)) != plain}
        return given | {name: value for name in PRESSURES if (value := float(getattr(self, name)))}

    def pressure_mmHg(self, name: str, vessel: Vessel) -> float:
        """A vessel's own "outflow", "external" or "radius" pressure, or the study's; mmHg."""
        own: float | None = getattr(vessel, f"{name}_pressure_mmHg")
        return float(getattr(self, f"{name}_pressure_mmHg") if own is None else own)

    @property
    def values(self) -> Array:
        """All series, shape (n_series, n_times), each in its own unit."""
        return np.array([s.value for s in self.series]).reshape(len(self.series), len(self.time_s))

    def _identity(self) -> tuple[str, Conventions, str, str]:
        tables = [dict(one) for one in (self.priors, self.noise_sd, self.numerics, self.parameters)]
        return self.name, self.conventions, self.checksum, json.dumps(tables, sort_keys=True)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Study) and self._identity() == other._identity()

    def __hash__(self) -> int:
        return hash(self._identity())
