"""Networks of svZeroDSolver: a JSON file, in cgs, as a study where they are a tree.

A lumped vessel has R = 8 mu l/(pi r^4), C = 3 pi r^2 l/(2 chi) and, where it gives no length, an inertance
L = rho l/(pi r^2): its radius, length and stiffness follow, with a parabolic profile.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from zoo.blood.conventions import PRINTED
from zoo.blood.importing.imported import Imported, ImportedFileError, study_of
from zoo.blood.importing.table import DENSITY, VISCOSITY
from zoo.blood.study import Blood, Vessel, Windkessel
from zoo.blood.study.reading import read_text
from zoo.core.words import short


def import_svzerodsolver(path: str | Path) -> Imported:
    """A study from svZeroDSolver's JSON; ImportedFileError where a study cannot express it."""
    path = Path(path)
    try:
        file = json.loads(read_text(path))
        given = {one["bc_name"]: one for one in file["boundary_conditions"]}
        vessels, junctions = file["vessels"], file.get("junctions", [])
        settings = file.get("simulation_parameters", {})
        density = _number(path, "density", settings.get("density", DENSITY))
        viscosity = _number(path, "viscosity", settings.get("viscosity", VISCOSITY))
        parents: dict[int, int] = {}
        for joint in junctions:
            if len(joint["inlet_vessels"]) != 1 or set(joint["outlet_vessels"]) & parents.keys():
                raise ImportedFileError(
                    f"{path}: junction {short(joint.get('junction_name'))}: several vessels flow into "
                    "it or out of it into one: a study is a tree; cut it open there to import it"
                )
            parents |= dict.fromkeys(joint["outlet_vessels"], joint["inlet_vessels"][0])
        found = tuple(_vessel(path, one, parents, given, density, viscosity) for one in vessels)
        (inlet,) = (one["boundary_conditions"]["inlet"] for one in vessels if one["vessel_id"] not in parents)
        curve = _inflow(path, given[inlet])
    except json.JSONDecodeError as error:
        raise ImportedFileError(
            f"{path}, row {error.lineno}: not read as JSON: {error.msg}; correct it"
        ) from None
    except (KeyError, TypeError, AttributeError, ValueError, RecursionError) as error:
        if isinstance(error, ImportedFileError):
            raise
        raise ImportedFileError(
            f"{path}: {short(str(error))}: is missing or of another kind; is this a file of svZeroDSolver?"
        ) from None
    period = float(curve[-1, 0])
    blood = Blood(density, viscosity, velocity_profile_order=2.0)
    study, distance = study_of(path, found, blood, curve[:-1], period)
    flow = study.inflow_ml_s
    converted = (
        "radii, lengths and stiffnesses from R_poiseuille, C and vessel_length, or L where that is absent",
        f"inflow: {len(curve) - 1} samples, became {len(flow)}, at most {distance:.2g} ml/s off",
    )
    lost = [v["vessel_name"] for v in vessels if v["zero_d_element_values"].get("stenosis_coefficient")]
    left = [f"stenosis_coefficient of {', '.join(map(str, lost))}"] if lost else []
    read = (f"{len(found)} vessels; inflow: period {period:g} s, mean {flow.mean():.4g} ml/s",)
    return Imported(study, read, converted, (*left, "simulation_parameters", "losses of junctions"))


def _number(path: Path, field: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 1e-30 < value < 1e30:
        raise ImportedFileError(f"{path}: {field} = {short(value)}: must be a positive number; correct it")
    return float(value)


def _vessel(
    path: Path, one: Any, parents: dict[int, int], given: dict[str, Any], density: float, viscosity: float
) -> Vessel:
    """A vessel in whose tube the elements are what they are."""
    where, elements = f"vessel {one['vessel_name']}", one["zero_d_element_values"]
    R, C = (_number(path, f"{where}: {name}", elements.get(name)) for name in ("R_poiseuille", "C"))
    if "vessel_length" in one:
        length = _number(path, f"{where}: vessel_length", one["vessel_length"])
        radius = (8 * viscosity * length / (math.pi * R)) ** 0.25
    else:
        inertance = _number(path, f"{where}: L", elements.get("L"))
        radius = math.sqrt(8 * viscosity * inertance / (density * R))
        length = inertance * math.pi * radius**2 / density
    end = given.get(one.get("boundary_conditions", {}).get("outlet"), {})
    kind, values = end.get("bc_type"), end.get("bc_values", {})
    load = resistance = None
    if kind == "RCR":
        load = Windkessel(*(_number(path, f"{where}: {name}", values[name]) for name in ("Rp", "Rd", "C")))
    elif kind == "RESISTANCE":
        resistance = _number(path, f"{where}: R", values["R"])
    elif kind is not None:
        raise ImportedFileError(f"{path}: {where}: outlet {short(kind)}: a study has RCR and RESISTANCE")
    parent = parents.get(one["vessel_id"])
    return Vessel(
        one["vessel_id"] + 1,
        one["vessel_name"],
        length,
        radius,
        radius,
        None if parent is None else parent + 1,
        load,
        resistance=resistance,
        stiffness_g_cm_s2=1.5 * math.pi * radius**2 * length / C,
        outflow_pressure_mmHg=float(values.get("Pd", 0.0)) / PRINTED.mmhg if kind else None,
    )


def _inflow(path: Path, inlet: Any) -> Any:
    """Times (s) and flow (ml/s), the last sample being the first."""
    if inlet["bc_type"] != "FLOW":
        raise ImportedFileError(f"{path}: inlet {short(inlet['bc_type'])}: the import reads a FLOW there")
    t, q = (np.asarray(inlet["bc_values"][name], dtype=np.float64) for name in ("t", "Q"))
    if len(t) < 2 or t[0] != 0 or not np.all(np.diff(t) > 0) or q[-1] != q[0]:
        raise ImportedFileError(f"{path}: inlet: t must begin at 0 and rise, and Q end with its first value")
    return np.column_stack([t, q])
