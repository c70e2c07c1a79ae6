"""A study as a folder of its own."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from zoo.blood.outlet_tables import StructuredTree
from zoo.blood.study.parts import Vessel
from zoo.blood.study.samples import INFLOW_COLUMNS, OBSERVATION_COLUMNS, PRESSURE_COLUMNS
from zoo.blood.study.study import Study
from zoo.blood.study.tree import NOMINAL
from zoo.core.outputs import output_folder, write_file

STUDY_FILES = "study.toml", "network.toml", "inflow.csv", "inlet.csv", "outflow.csv", "observations.csv"
"""What a study is written into."""


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


def _vessel_lines(vessel: Vessel, nominal: bool) -> list[str]:
    lines = ["", "[[vessel]]", f"id = {int(vessel.id)}", f"name = {_quoted(vessel.name)}"]
    lines += [f"length_cm = {_value(vessel.length_cm)}", f"radius_cm = {_value(vessel.radius_cm)}"]
    if vessel.radius_out_cm != vessel.radius_cm:
        lines.append(f"radius_out_cm = {_value(vessel.radius_out_cm)}")
    if vessel.parent is not None:
        lines.append(f"parent = {int(vessel.parent)}")
    if vessel.windkessel is not None:
        load = ", ".join(f"{name} = {_value(x)}" for name, x in vars(vessel.windkessel).items())
        lines.append(f"windkessel = {{ {load} }}")
    elif nominal:
        lines.append(f"windkessel = {_quoted(NOMINAL)}")
    if vessel.impedance is not None:
        table = vars(vessel.impedance) if isinstance(vessel.impedance, StructuredTree) else vessel.impedance
        lines.append(f"impedance = {_value(table)}")
    lines += [f"{name} = {_value(value)}" for name, value in vessel.physics.items()]
    if vessel.stenosis is not None:
        table = {name: value for name, value in vars(vessel.stenosis).items() if value is not None}
        lines.append(f"stenosis = {_value(table)}")
    return lines


def save_study(study: Study, folder: str | Path) -> None:
    """Write a study as a folder that `load_study` reads back exactly, every digit included.

    Parameters
    ----------
    study : Study
    folder : str or Path
        Made when absent; files of the same names in it are replaced.

    Raises
    ------
    zoo.core.outputs.OutputFileError
        If the folder or a file cannot be written.
    """
    folder = output_folder(folder, STUDY_FILES, deep=True)
    folder.mkdir(parents=True, exist_ok=True)

    def write(name: str, lines: Sequence[str]) -> None:
        write_file(folder / name, "\n".join(lines) + "\n")

    lines = [f"name = {_quoted(study.name)}", 'network = "network.toml"']
    lines.append(
        'inlet_pressure = "inlet.csv"' if study.inlet_pressure_mmHg.size else 'inflow = "inflow.csv"'
    )
    if study.outflow_wave_mmHg.size:
        lines.append('outflow_pressure = "outflow.csv"')
    if study.series:
        lines.append('observations = "observations.csv"')
    lines.append(f"period_s = {_value(study.period_s)}")
    own = study.conventions
    changes = "".join(f", {name} = {_value(value)}" for name, value in own.changes.items())
    named = f"{{ base = {_quoted(own.base)}{changes} }}" if changes else _quoted(own.name)
    lines.append(f"conventions = {named}")
    for heading in ("priors", "parameters", "noise_sd", "numerics"):
        table = getattr(study, heading)
        if table:
            lines += [
                "",
                f"[{heading}]",
                *(f"{_key(name)} = {_value(value)}" for name, value in table.items()),
            ]
    write("study.toml", lines)

    blood = {name: getattr(study.blood, name) for name in ("density_g_cm3", "viscosity_g_cm_s")}
    tables = {
        "blood": blood | study.blood.physics,
        "junctions": {},
        "wall": {},
        "surroundings": dict(study.physics),
    }
    if "wall" in study.physics:
        tables["wall"] = {"law": tables["surroundings"].pop("wall")}
    if "junction_pressure" in study.physics:
        tables["junctions"] = {"pressure": tables["surroundings"].pop("junction_pressure")}
    if study.outflow_wave_mmHg.size:
        tables["surroundings"].pop("outflow_pressure_mmHg", None)
    tree: list[str] = []
    for heading, table in tables.items():
        if table:
            lines = [f"[{heading}]", *(f"{name} = {_value(value)}" for name, value in table.items())]
            tree += ["", *lines] if tree else lines
    feeding = {v.parent for v in study.vessels}
    loaded = any(v.has_load for v in study.vessels)
    for v in study.vessels:
        tree += _vessel_lines(v, loaded and v.id not in feeding and not v.has_load)
    write("network.toml", tree)

    if study.inflow_ml_s.size:
        pairs = zip(study.inflow_time_s.tolist(), study.inflow_ml_s.tolist(), strict=True)
        write("inflow.csv", [",".join(INFLOW_COLUMNS), *(f"{t!r},{q!r}" for t, q in pairs)])
    pressures = {"inlet.csv": study.inlet_pressure_mmHg, "outflow.csv": study.outflow_wave_mmHg}
    for file, pressure in pressures.items():
        if pressure.size:
            step, samples = study.period_s / len(pressure), enumerate(pressure.tolist())
            write(file, [",".join(PRESSURE_COLUMNS), *(f"{m * step!r},{p!r}" for m, p in samples)])
    if study.series:
        rows = [
            f"{int(s.vessel)},{float(s.position)!r},{s.quantity},{t!r},{'' if x != x else repr(x)}"
            for s in study.series
            for t, x in zip(study.time_s.tolist(), s.value.tolist(), strict=True)
        ]
        write("observations.csv", [",".join(OBSERVATION_COLUMNS), *rows])
