"""Networks of openBF: a YAML file and its inflow, in SI units, as a study.

A vessel has p = P_ext + K (sqrt(A/A0) - 1) with K = (4/3) E h0/R0, friction -2 (gamma + 2) pi nu q/A for a
velocity profile of order gamma, and a momentum correction of 1; vessels share the static pressure at a node,
and outlets drain to a pressure of zero.

References
----------
Melis 2018, openBF, doi 10.15131/shef.data.7166183; Avolio 1980, doi 10.1007/BF02441895, for the thickness of
walls that have none.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from zoo.blood.conventions import PRINTED
from zoo.blood.importing.imported import Imported, ImportedFileError
from zoo.blood.importing.yaml import Table as Rows
from zoo.blood.importing.yaml import read_yaml
from zoo.blood.study import Blood, Study, Vessel, Windkessel
from zoo.blood.study.reading import inside, read_text
from zoo.blood.study.resampling import denser, even_samples
from zoo.blood.study.samples import MIN_SAMPLES
from zoo.blood.study.schema import Table, Whole, validated, visible_name
from zoo.core.arrays import Array
from zoo.core.words import short

EVEN = 0.02
"""Part of a step that the times of an even inflow may be off."""
DEFAULT_PROFILE = 2
"""Order of the velocity profile where a file gives none, as openBF has it."""
AVOLIO = 0.2802, -505.3, 0.1324, -11.14
"""a, b (1/m), c, d (1/m) in h0 = R0 (a exp(b R0) + c exp(d R0)), m."""

MOST = 1e20
"""Largest number of a file, and of its inverse."""

_CM = 100.0  # in 1 m
_CGS_DENSITY = 1e-3  # g/cm3 in 1 kg/m3
_CGS_PRESSURE = 10.0  # dyn/cm2 in 1 Pa; also g/(cm s) in 1 Pa s
_CGS_RESISTANCE = 1e-5  # dyn s/cm5 in 1 Pa s/m3
_CGS_COMPLIANCE = 1e5  # cm5/dyn in 1 m3/Pa
_ML = 1e6  # in 1 m3

Positive = Annotated[float, Field(ge=1 / MOST, le=MOST)]
Least = Annotated[float, Field(ge=0, le=MOST)]


class _Blood(Table):
    rho: Positive
    mu: Positive


class _Solver(Table):
    Ccfl: Any = None
    cycles: Any = None
    jump: Any = None
    convergence_tolerance: Any = None


class _Vessel(Table):
    label: Any = None
    sn: Whole
    tn: Whole
    L: Positive
    E: Positive
    R0: Positive | None = None
    Rp: Positive | None = None
    Rd: Positive | None = None
    h0: Positive | None = None
    Pext: float = Field(default=0.0, ge=-MOST, le=MOST)
    gamma_profile: Positive | None = None
    outlet: Literal["none", "wk2", "wk3", "reflection"] | None = None
    R1: Positive | None = None
    R2: Least = 0.0
    Cc: Least = 0.0
    Rt: float | None = Field(default=None, gt=-1, lt=1)
    inlet_impedance_matching: Any = None
    inlet: Literal["Q"] = "Q"
    inlet_file: str | None = None
    inlet_number: Any = None
    M: Any = None
    to_save: Any = None
    initial_pressure: Any = None
    initial_flow: Any = None


class _Network(Table):
    project_name: Any = None
    inlet_file: str | None = None
    write_results: Any = None
    output_directory: Any = None
    blood: Any
    solver: Any = None
    network: Any


_NAMES = {"proj_name": "project_name", "num_snapshots": "jump", "conv_tol": "convergence_tolerance"}
_KINDS = {"inlet": {1: "Q", 2: "p"}, "outlet": {1: "reflection", 2: "wk2", 3: "wk3"}}
"""Other names and numbers of the same things in jaxFlowSim's files."""
_LEFT_OUT = ("M", "initial_flow", "initial_pressure", "to_save")
_REFUSED = {
    "visco_elastic": "a viscoelastic wall is no part of a study's tree",
    "phi": "a viscoelastic wall is no part of a study's tree",
    "Rc": "walls that buckle under a critical radius cannot be expressed",
}


class _Part:
    """A table of the file, checked, with what an error calls it; older files have spaces in their keys."""

    def __init__(self, path: Path, model: type[Table], what: str, value: Any) -> None:
        if not isinstance(value, Rows):
            raise ImportedFileError(
                f"{path}: {what}: must be a table of keys and values; is this an openBF file?"
            )
        names = {key: _NAMES.get(key, re.sub("[ -]", "_", key)) for key in value}
        self.path, self.what = path, what
        self.rows = {name: value.rows[key] for key, name in names.items()}
        self.given = {name: value[key] for key, name in names.items() if value[key] is not None}
        for name, kinds in _KINDS.items():
            if type(self.given.get(name)) is int and self.given[name] in kinds:
                self.given[name] = kinds[self.given[name]]
        for name in _REFUSED.keys() & self.given.keys():
            if self.given[name]:
                raise self.fail(
                    name, f" = {short(self.given[name])}: {_REFUSED[name]}; remove it to import without"
                )
            del self.given[name]
        self.table = validated(model, self.given, self.place)

    def place(self, name: str) -> str:
        """File, row and table of a field, for errors."""
        row = f", row {self.rows[name]}" if name in self.rows else ""
        return f"{self.path}{row}: {self.what}"

    def fail(self, name: str, reason: str) -> ImportedFileError:
        """An error about a field."""
        return ImportedFileError(f"{self.place(name)}: {name}{reason}")

    def needed(self, name: str) -> float:
        """A positive number that only some tables need."""
        value = getattr(self.table, name)
        if not value:
            raise self.fail(name, ": is missing or zero; add it")
        return float(value)


def import_openbf(path: str | Path) -> Imported:
    """A study from openBF's YAML file and the inflow beside it.

    Parameters
    ----------
    path : str or Path
        Of the YAML file; its ``inlet_file`` is sought beside it.

    Returns
    -------
    Imported
        With the study, and what was read, converted and left out.

    Raises
    ------
    ImportedFileError
        If the file holds what a study cannot express: loops, several inlets, viscoelastic walls.
    zoo.blood.study.StudyError
        If a field is unknown, missing or out of range.

    References
    ----------
    Melis 2018, doi 10.15131/shef.data.7166183.
    """
    path = Path(path)
    top = _Part(path, _Network, "the file", read_yaml(path))
    file: _Network = top.table
    blood: _Blood = _Part(path, _Blood, "blood", file.blood).table
    solver = _Part(path, _Solver, "solver", file.solver or Rows())
    if not isinstance(file.network, list) or not file.network:
        raise top.fail("network", ": must be a list of vessels; is this an openBF file?")
    parts = []
    for i, one in enumerate(file.network, 1):
        label = one.get("label") if isinstance(one, Rows) else None
        parts.append(_Part(path, _Vessel, f"vessel {i if label is None else label}", one))
    notes: list[str] = []
    left_out = [f"solver settings {', '.join(solver.given)}"] if solver.given else []
    left_out += [name for name in ("write_results", "output_directory") if name in top.given]
    for name in _LEFT_OUT:
        n = sum(name in part.rows for part in parts)
        left_out += [f"{name} of {n} vessels"] if n else []

    density = _times(blood.rho, _CGS_DENSITY)
    parents = _tree(path, parts)
    vessels = tuple(
        _vessel(part, i, parents[i], i not in parents, density, notes) for i, part in enumerate(parts)
    )
    outside = {v.external_pressure_mmHg for v in vessels}
    everywhere = outside.pop() if len(outside) == 1 else None
    if everywhere is not None:
        vessels = tuple(replace(v, external_pressure_mmHg=None) for v in vessels)
    order = _profile(parts, notes)
    root: _Vessel = parts[parents.index(None)].table
    times, flow, period = _inflow(
        path, root.inlet_file or file.inlet_file or f"{file.project_name}_inlet.dat", notes
    )
    study = Study(
        name=visible_name(top.place("project_name"), str(file.project_name or path.stem)),
        period_s=period,
        blood=Blood(density, _times(blood.mu, _CGS_PRESSURE), velocity_profile_order=order),
        vessels=vessels,
        inflow_time_s=times,
        inflow_ml_s=flow,
        time_s=np.empty(0),
        series=(),
        source=path,
        external_pressure_mmHg=everywhere or 0.0,
    )
    units = "SI to cgs: m to cm, Pa to dyn/cm2 and mmHg, kg/m3 to g/cm3, Pa s to g/(cm s), m3/s to ml/s"
    return Imported(study, tuple(_told(study)), (units, *dict.fromkeys(notes)), tuple(left_out))


def _tree(path: Path, parts: Sequence[_Part]) -> list[int | None]:
    """Index of the vessel that feeds each; None for the root."""
    ends: dict[int, int] = {}
    for i, part in enumerate(parts):
        node = part.table.tn
        if node == part.table.sn:
            raise part.fail("tn", f" = {node}: begins and ends at node {node}; correct it")
        if node in ends:
            raise part.fail(
                "tn",
                f" = {node}: {parts[ends[node]].what} flows into this node too: a loop or several inlets, "
                "and a study is a tree; cut it open there to import it",
            )
        ends[node] = i
    parents = [ends.get(part.table.sn) for part in parts]
    roots = [part.what for part, parent in zip(parts, parents, strict=True) if parent is None]
    if not roots:
        raise ImportedFileError(
            f"{path}: network: every vessel is fed by another: the network is a loop, and a study is a tree"
        )
    if len(roots) > 1:
        raise ImportedFileError(
            f"{path}: network: several inlets ({', '.join(roots[:5])}), and a study has one; import each of "
            "the trees by itself"
        )
    return parents


def thickness(radius_m: float) -> float:
    """Thickness of a wall from its radius, both in m: h0 = R0 (a exp(b R0) + c exp(d R0)).

    References
    ----------
    Avolio 1980, doi 10.1007/BF02441895.
    """
    a, b, c, d = AVOLIO
    return radius_m * (a * math.exp(b * radius_m) + c * math.exp(d * radius_m))


def _vessel(
    part: _Part, i: int, parent: int | None, terminal: bool, density: float, notes: list[str]
) -> Vessel:
    """The i-th vessel, in cgs units."""
    given: _Vessel = part.table
    radius = given.Rp or given.R0 or part.needed("Rp")
    out = given.Rd or radius
    if given.R0 and (given.Rp or given.Rd):
        notes.append("R0 beside Rp or Rd: Rp and Rd are taken, as openBF does now; older versions took R0")
    wall = wall_out = given.h0
    if wall is None or wall_out is None:
        wall, wall_out = thickness(radius), thickness(out)
        notes.append("walls without h0 got h0 = R0 (0.2802 exp(-505.3 R0) + 0.1324 exp(-11.14 R0)), in m")
    if given.outlet not in (None, "none") and not terminal:
        raise part.fail("outlet", f" = {given.outlet!r}: it feeds other vessels; remove the outlet")
    # a wave's impedance at rest, rho c/A0 with c^2 = (2/3) E h0/(rho R0)
    speed = math.sqrt(2 * given.E * _CGS_PRESSURE * wall_out / (3 * density * out))
    impedance = density * speed / (math.pi * (out * _CM) ** 2)
    load, single, behind = _outlet(part, impedance, notes) if terminal else (None, None, None)
    return Vessel(
        id=i + 1,
        name=visible_name(part.place("label"), str(f"v{i + 1}" if given.label is None else given.label)),
        length_cm=_times(given.L, _CM),
        radius_cm=_times(radius, _CM),
        radius_out_cm=_times(out, _CM),
        parent=None if parent is None else parent + 1,
        windkessel=load,
        resistance=single,
        youngs_modulus_g_cm_s2=_times(given.E, _CGS_PRESSURE),
        wall_thickness_cm=_times(wall, _CM),
        wall_thickness_out_cm=None if wall_out == wall else _times(wall_out, _CM),
        outflow_pressure_mmHg=behind,
        external_pressure_mmHg=_mmhg(given.Pext) if given.Pext else None,
    )


def _times(value: float, factor: float) -> float:
    """The product to 14 digits, so that 0.126 m are 12.6 cm."""
    return float(f"{value * factor:.14g}")


def _mmhg(pascal: float) -> float:
    return pascal * _CGS_PRESSURE / PRINTED.mmhg


def _outlet(
    part: _Part, impedance: float, notes: list[str]
) -> tuple[Windkessel | None, float | None, float | None]:
    """Windkessel, or a single resistance with the pressure behind it; `impedance` in dyn s/cm5."""
    given: _Vessel = part.table
    unsaid = given.outlet in (None, "none") and not given.R1 and given.Rt is not None
    if given.outlet == "reflection" or unsaid:
        if given.Rt is None:
            raise part.fail("Rt", ": is missing; add it")
        notes.append(
            "reflection: Rt became the resistance Z (1 + Rt)/(1 - Rt), Z the vessel's impedance at rest"
        )
        behind = _mmhg(given.Pext) if given.Pext else None
        return None, impedance * (1 + given.Rt) / (1 - given.Rt), behind
    R1, R2 = _times(part.needed("R1"), _CGS_RESISTANCE), _times(given.R2, _CGS_RESISTANCE)
    if not R2 and not given.Cc:
        return None, R1, None
    C = _times(part.needed("Cc"), _CGS_COMPLIANCE)
    if R2 and not given.inlet_impedance_matching:
        if given.outlet == "wk2":
            raise part.fail("R2", f" = {given.R2:g}: wk2 has R1 and Cc alone; remove R2, or write wk3")
        return Windkessel(R1, R2, C), None, None
    total = R1 + R2
    if total <= impedance:
        raise part.fail(
            "R1",
            f" = {given.R1:g}: the resistance, {total:.4g} dyn s/cm5, is below the vessel's impedance, "
            f"{impedance:.4g}, so that nothing is left behind it; correct it",
        )
    if R2:
        notes.append("inlet_impedance_matching: R1 is the vessel's impedance at rest, and stays so")
    else:
        notes.append(
            "outlets with R1 and Cc alone: rho c/A0 of the vessel at rest in front, the rest of R1 behind"
        )
    return Windkessel(impedance, total - impedance, C), None, None


def _profile(parts: Sequence[_Part], notes: list[str]) -> float:
    """The one order of the velocity profile."""
    orders = [part.table.gamma_profile or DEFAULT_PROFILE for part in parts]
    for part, order in zip(parts, orders, strict=True):
        if order != orders[0]:
            raise part.fail(
                "gamma_profile",
                f" = {order:g}, but {orders[0]:g} in {parts[0].what}: a study has one order of the velocity "
                "profile; give the same in all vessels",
            )
    if not any(part.table.gamma_profile for part in parts):
        notes.append(f"no gamma_profile: a velocity profile of order {DEFAULT_PROFILE}, openBF's default")
    return float(orders[0])


def _inflow(file: Path, name: str, notes: list[str]) -> tuple[Array, Array, float]:
    """Times (s) and inflow (ml/s) without the last sample, which repeats the first, and the period (s)."""
    if wrong := inside(file.parent, name):
        raise ImportedFileError(f"{file}: inlet_file = {short(name)}: {wrong}")
    path = file.parent / name
    samples = _columns(path)
    if len(samples) < 3 or not np.all(np.abs(samples) <= MOST):
        raise ImportedFileError(
            f"{path}: must have two columns, s and m3/s, and a beat of samples; correct it"
        )
    times, flow = samples[:, 0], samples[:, 1] * _ML
    if times[0] != 0 or not np.all(np.diff(times) > 0):
        raise ImportedFileError(f"{path}: times must begin at 0 and rise; correct them")
    if abs(flow[-1] - flow[0]) > 1e-6 * np.ptp(flow):
        raise ImportedFileError(
            f"{path}, row {len(flow)}: flow = {samples[-1, 1]:g} m3/s, but the first is {samples[0, 1]:g}: "
            "the last sample ends the beat and must repeat the first; add one that does"
        )
    period, gaps = float(times[-1]), np.diff(times)
    if np.ptp(gaps) > EVEN * np.median(gaps):
        even, distance = even_samples(times[:-1], flow[:-1], period)
        how = f"at most {distance:.2g} ml/s off" if distance else "the same curve"
        notes.append(
            f"inflow: {len(gaps)} samples at uneven times, linear between, became {len(even)} even ones: "
            f"{how}"
        )
        flow = np.append(even, even[0])
    flow = denser(flow[:-1], MIN_SAMPLES)
    if len(gaps) < MIN_SAMPLES:
        notes.append(f"inflow: {len(gaps)} samples, linear between, became {len(flow)}: the same curve")
    n = len(flow)
    return np.asarray(np.arange(n) * (period / n), dtype=np.float64), flow, period


def _columns(path: Path) -> Array:
    """Numbers of a text file, a row for each line that is not a comment."""
    rows = []
    for row, line in enumerate(read_text(path).split("\n"), 1):
        cells = line.partition("#")[0].split()
        try:
            rows += [[float(cell) for cell in cells]] if cells else []
        except ValueError:
            raise ImportedFileError(f"{path}, row {row}: not two numbers; correct that row") from None
        if cells and len(cells) != 2:
            raise ImportedFileError(f"{path}, row {row}: {len(cells)} numbers: must be two, s and m3/s")
    return np.array(rows).reshape(-1, 2)


def _told(study: Study) -> list[str]:
    blood = study.blood
    tapered = sum(v.radius_out_cm != v.radius_cm for v in study.vessels)
    kinds = Counter("Windkessel" if v.windkessel else "resistance" for v in study.vessels if _ends(v))
    outlets = ", ".join(f"{n} x {kind}" for kind, n in kinds.items())
    outside = sorted({v.external_pressure_mmHg or study.external_pressure_mmHg for v in study.vessels})
    surroundings = " to ".join(f"{p:.4g}" for p in dict.fromkeys((outside[0], outside[-1])))
    return [
        f"{len(study.vessels)} vessels, {tapered} tapered; outlets: {outlets}",
        f"walls: Young's modulus and thickness, stiffness follows the radius; {surroundings} mmHg outside",
        f"blood: density {blood.density_g_cm3:g} g/cm3, viscosity {blood.viscosity_g_cm_s:g} g/(cm s); "
        f"velocity profile of order {blood.velocity_profile_order:g}",
        "static pressure at junctions; outlets drain to 0 mmHg",
        f"inflow: period {study.period_s:g} s, mean {study.inflow_ml_s.mean():.4g} ml/s",
    ]


def _ends(vessel: Vessel) -> bool:
    return vessel.windkessel is not None or vessel.resistance is not None
