"""A table of vessels, CSV, with an inflow and observations as a study has them."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from zoo.blood.importing.imported import Imported, ImportedFileError, check_flow, check_positive
from zoo.blood.study import Blood, Series, Study, Windkessel
from zoo.blood.study.loading import check_terminals
from zoo.blood.study.parts import VESSEL_PHYSICS
from zoo.blood.study.reading import read_csv
from zoo.blood.study.samples import number, read_inlet, read_observations
from zoo.blood.study.tree import check_physics, sort_vessels, vessel_of
from zoo.core.arrays import Array
from zoo.core.words import short

REQUIRED = ("id", "parent", "length_cm", "radius_cm")
OPTIONAL = ("name", "radius_out_cm", "R1", "R2", "C", *VESSEL_PHYSICS)
"""Columns of the table; R1, R2 and C are the Windkessel's, the others are fields of network.toml."""

WITHOUT_HEADER = (
    REQUIRED,
    (*REQUIRED, "radius_out_cm"),
    (*REQUIRED, "R1", "R2", "C"),
    (*REQUIRED, "radius_out_cm", "R1", "R2", "C"),
)
"""Columns of a table of numbers alone, by how many there are."""
DENSITY, VISCOSITY = 1.06, 0.04
"""Of blood where none are given, g/cm3 and g/(cm s)."""


def import_table(
    vessels: str | Path,
    inflow: str | Path,
    period_s: float,
    *,
    observations: str | Path | None = None,
    density_g_cm3: float = DENSITY,
    viscosity_g_cm_s: float = VISCOSITY,
    velocity_profile_order: float | None = None,
    name: str | None = None,
) -> Imported:
    """A study from a CSV table with a row for each vessel.

    Parameters
    ----------
    vessels : str or Path
        Columns id, parent (empty for the root), length_cm, radius_cm; and, where wanted, name, radius_out_cm,
        R1, R2 and C (cgs, of terminals), resistance, and the walls and pressures of network.toml. An empty
        cell is a field that is not given.
    inflow : str or Path
        As a study's inflow.csv.
    period_s : float
        Length of the beat, s.
    observations : str or Path
        As a study's observations.csv.
    density_g_cm3, viscosity_g_cm_s : float
        Of blood, g/cm3 and g/(cm s).
    velocity_profile_order : float
        zeta, for friction -2 (zeta + 2) pi nu q/A; a flat profile with a Stokes layer when absent.
    name : str
        Of the study; that of the file when absent.

    Returns
    -------
    Imported

    Raises
    ------
    ImportedFileError
        If an argument is out of range.
    zoo.blood.study.StudyError
        If a file is wrong: one line with the file, row, field, value and remedy.
    """
    path = Path(vessels)
    check_positive(path, period=period_s, density=density_g_cm3, viscosity=viscosity_g_cm_s)
    if velocity_profile_order is not None:
        check_positive(path, profile_order=velocity_profile_order)
    found, places = [], []
    table = read_csv(path, REQUIRED, OPTIONAL, WITHOUT_HEADER)
    for i, row in enumerate(table.rows):
        cells = table.cells(i)
        where = f"{path}, row {row}: vessel {short(cells['id'], 20)[1:-1]}"
        found.append(vessel_of(_fields(where, cells), where))
        places.append(where)
    if not found:
        raise ImportedFileError(f"{path}: no vessels; add a row for each")
    sort_vessels(found, places)
    check_physics(found, places)
    times, flow, note = read_inlet(Path(inflow), period_s)
    check_flow(inflow, flow)
    grid: Array = np.empty(0)
    series: tuple[Series, ...] = ()
    if observations is not None:
        grid, series = read_observations(Path(observations), period_s, [v.id for v in found])
    check_terminals(found, places, series)
    study = Study(
        name=name or path.stem,
        period_s=period_s,
        blood=Blood(density_g_cm3, viscosity_g_cm_s, velocity_profile_order=velocity_profile_order),
        vessels=tuple(found),
        inflow_time_s=times,
        inflow_ml_s=flow,
        time_s=grid,
        series=series,
        source=path,
        inflow_note=note,
    )
    feeding = {v.parent for v in found}
    kinds = Counter(
        "Windkessel" if v.windkessel else "resistance" if v.resistance else "nominal load from the pressure"
        for v in found
        if v.id not in feeding
    )
    walls = "given" if found[0].stiffness else "not given: --stiffness, or a model's parameter"
    profile = "flat" if velocity_profile_order is None else f"of order {velocity_profile_order:g}"
    read = (
        f"{len(found)} vessels; outlets: {', '.join(f'{n} x {kind}' for kind, n in kinds.items())}",
        f"stiffness of the walls: {walls}",
        f"blood: density {density_g_cm3:g} g/cm3, viscosity {viscosity_g_cm_s:g} g/(cm s); velocity profile "
        f"{profile}",
        f"inflow: period {period_s:g} s, mean {flow.mean():.4g} ml/s" + (f"; {note}" if note else ""),
        f"observed: {', '.join(s.label for s in series) or 'nothing'}",
    )
    bare = table.rows[0] == 1
    columns = (f"no header: columns taken for {', '.join(table.columns)}",) if bare else ()
    return Imported(study, read, columns)


def _fields(where: str, cells: dict[str, str]) -> dict[str, Any]:
    """The fields of a [[vessel]] from the cells that are not empty."""
    fields: dict[str, Any] = {}
    load = {}
    for column, text in cells.items():
        if not text:
            continue
        if column == "name":
            fields[column] = text
        elif column in ("id", "parent"):
            if not re.fullmatch(r"\d{1,10}", text):
                raise ImportedFileError(
                    f"{where}: {column} = {short(text)}: must be a whole number; correct it"
                )
            fields[column] = int(text)
        elif column in Windkessel.__dataclass_fields__:
            load[column] = number(where, column, text)
        else:
            fields[column] = number(where, column, text)
    return fields | ({"windkessel": load} if load else {})
