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

import difflib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.conventions import PRINTED
from zoo.blood.importing.imported import Imported, ImportedFileError
from zoo.blood.importing.yaml import Table, read_yaml
from zoo.blood.study import Blood, Study, Vessel, Windkessel
from zoo.blood.study.reading import inside, read_text
from zoo.blood.study.resampling import even_samples
from zoo.core.words import short

Array = NDArray[np.float64]

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

_TOP = {"project_name", "inlet_file", "write_results", "output_directory", "blood", "solver", "network"}
_SOLVER = {"Ccfl", "cycles", "jump", "convergence_tolerance"}
_BLOOD = {"rho", "mu"}
_VESSEL = {
    *("label", "sn", "tn", "L", "E", "R0", "Rp", "Rd", "h0", "Pext", "gamma_profile"),
    *("outlet", "R1", "R2", "Cc", "Rt", "inlet_impedance_matching"),
    *("inlet", "inlet_file", "inlet_number"),
}
_VESSEL_LEFT_OUT = {"M", "to_save", "initial_pressure", "initial_flow"}
_REFUSED = {
    "visco-elastic": "a viscoelastic wall is no part of a study's tree",
    "visco_elastic": "a viscoelastic wall is no part of a study's tree",
    "phi": "a viscoelastic wall is no part of a study's tree",
    "Rc": "walls that buckle under a critical radius cannot be expressed",
}
_OUTLETS = ("wk2", "wk3", "reflection")


class _File:
    """An openBF file while it is read: where things stand, and what is told of them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.top = self.table(read_yaml(path), "the file", _TOP)
        self.notes: list[str] = []

    def fail(self, where: str, reason: str) -> ImportedFileError:
        return ImportedFileError(f"{self.path}{where}: {reason}")

    def table(self, value: Any, what: str, known: set[str], row: int | None = None) -> Table:
        """A table with the spelling of today: files of before have spaces in their keys."""
        at = "" if row is None else f", row {row}"
        if not isinstance(value, Table):
            raise self.fail(at, f"{what}: must be a table of keys and values; is this an openBF file?")
        renamed = Table()
        for key, inner in value.items():
            name = key.replace(" ", "_")
            place = f", row {value.rows[key]}"
            if name in _REFUSED and inner not in (None, False, 0, 0.0):
                raise self.fail(
                    place, f"{what}: {key} = {short(inner)}: {_REFUSED[name]}; remove it to import without"
                )
            if name not in known and name not in _REFUSED:
                close = difflib.get_close_matches(name, sorted(known), 1, 0.6)
                hint = f"did you mean {close[0]}? " if close else ""
                raise self.fail(
                    place, f"{what}: {key}: unknown key; {hint}use one of {', '.join(sorted(known))}"
                )
            renamed[name] = inner
            renamed.rows[name] = value.rows[key]
        return renamed

    def number(
        self, table: Table, what: str, key: str, default: float | None = None, *, least: float | None = None
    ) -> float:
        """A positive number, or one that is at least `least`."""
        value = table.get(key, default)
        at = f", row {table.rows[key]}" if key in table else ""
        if value is None:
            raise self.fail(at, f"{what}: {key}: is missing; add it")
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.fail(at, f"{what}: {key} = {short(value)}: must be a number; correct it")
        if abs(value) > MOST or 0 < abs(value) < 1 / MOST:
            raise self.fail(
                at,
                f"{what}: {key} = {short(value)}: its size must be between {1 / MOST:g} and {MOST:g}; "
                "correct it",
            )
        if value <= 0 if least is None else value < least:
            word = "positive" if least is None else "zero or positive"
            raise self.fail(at, f"{what}: {key} = {short(value)}: must be {word}; correct it")
        return float(value)

    def name(self, table: Table, key: str, default: str) -> str:
        value = table.get(key)
        text = default if value is None else str(value)
        if not text.strip() or not text.isprintable():
            raise self.fail(
                f", row {table.rows[key]}", f"{key} = {text!r}: must be one line of visible text; correct it"
            )
        return text

    def node(self, table: Table, what: str, key: str) -> int:
        value = table.get(key)
        at = f", row {table.rows[key]}" if key in table else ""
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.fail(
                at, f"{what}: {key} = {short(value)}: must be the whole number of a node; correct it"
            )
        return value


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
        If the file is wrong, or holds what a study cannot express: loops, several inlets, a pressure at the
        inlet, viscoelastic walls, outlets of another kind.

    References
    ----------
    Melis 2018, doi 10.15131/shef.data.7166183.
    """
    file = _File(Path(path))
    blood = file.table(file.top.get("blood"), "blood", _BLOOD, file.top.rows.get("blood"))
    solver = file.table(file.top.get("solver", Table()), "solver", _SOLVER, file.top.rows.get("solver"))
    density = _times(file.number(blood, "blood", "rho"), _CGS_DENSITY)
    viscosity = _times(file.number(blood, "blood", "mu"), _CGS_PRESSURE)
    network = file.top.get("network")
    if not isinstance(network, list) or not network:
        raise file.fail("", "network: must be a list of vessels; is this an openBF file?")
    left_out = [f"solver settings {', '.join(solver)}"] if solver else []
    left_out += [name for name in ("write_results", "output_directory") if name in file.top]

    tables, names = [], []
    for i, entry in enumerate(network, 1):
        label = entry.get("label") if isinstance(entry, Table) else None
        what = f"vessel {label if label is not None else i}"
        tables.append(file.table(entry, what, _VESSEL | _VESSEL_LEFT_OUT))
        names.append(file.name(tables[-1], "label", f"v{i}"))
    for key in sorted(_VESSEL_LEFT_OUT):
        n = sum(key in table for table in tables)
        left_out += [f"{key} of {n} vessels"] if n else []

    parents = _tree(file, tables, names)
    root = parents.index(None)
    fed = {parent for parent in parents if parent is not None}
    vessels = tuple(
        _vessel(file, tables[i], i + 1, names[i], parent, i not in fed, density)
        for i, parent in enumerate(parents)
    )
    outside = {v.external_pressure_mmHg for v in vessels}
    everywhere = outside.pop() if len(outside) == 1 else None
    if everywhere is not None:
        vessels = tuple(replace(v, external_pressure_mmHg=None) for v in vessels)
    order = _profile(file, tables, names)
    times, flow, period = _inflow(file, tables[root])
    study = Study(
        name=file.name(file.top, "project_name", file.path.stem),
        period_s=period,
        blood=Blood(density, viscosity, velocity_profile_order=order),
        vessels=vessels,
        inflow_time_s=times,
        inflow_ml_s=flow,
        time_s=np.empty(0),
        series=(),
        source=file.path,
        external_pressure_mmHg=everywhere or 0.0,
    )
    return Imported(study, tuple(_told(study)), tuple(_converted(file)), tuple(left_out))


def _tree(file: _File, tables: Sequence[Table], names: Sequence[str]) -> list[int | None]:
    """Index of the vessel that feeds each; None for the root."""
    ends: dict[int, int] = {}
    starts = [file.node(table, f"vessel {name}", "sn") for table, name in zip(tables, names, strict=True)]
    for i, (table, name) in enumerate(zip(tables, names, strict=True)):
        node = file.node(table, f"vessel {name}", "tn")
        if node == starts[i]:
            raise file.fail(
                f", row {table.rows['tn']}", f"vessel {name}: begins and ends at node {node}; correct it"
            )
        if node in ends:
            raise file.fail(
                f", row {table.rows['tn']}",
                f"node {node}: vessels {names[ends[node]]} and {name} both flow into it: a loop or "
                "several inlets, and a study is a tree; cut it open there to import it",
            )
        ends[node] = i
    roots = [i for i, node in enumerate(starts) if node not in ends]
    if not roots:
        raise file.fail(
            "", "network: every vessel is fed by another: the network is a loop, and a study is a tree"
        )
    if len(roots) > 1:
        listed = ", ".join(names[i] for i in roots[:5])
        raise file.fail(
            "", f"network: several inlets ({listed}), and a study has one; import each of the trees by itself"
        )
    return [ends.get(node) for node in starts]


def thickness(radius_m: float) -> float:
    """Thickness of a wall from its radius, both in m: h0 = R0 (a exp(b R0) + c exp(d R0)).

    References
    ----------
    Avolio 1980, doi 10.1007/BF02441895.
    """
    a, b, c, d = AVOLIO
    return radius_m * (a * math.exp(b * radius_m) + c * math.exp(d * radius_m))


def _vessel(
    file: _File, table: Table, number: int, name: str, parent: int | None, terminal: bool, density: float
) -> Vessel:
    what = f"vessel {name}"
    given = "R0" if "R0" in table else "Rp"
    radius = file.number(table, what, given)
    out = radius if given == "R0" else file.number(table, what, "Rd", radius)
    modulus = file.number(table, what, "E")
    if "h0" in table:
        wall = wall_out = file.number(table, what, "h0")
    else:
        wall, wall_out = thickness(radius), thickness(out)
        file.notes.append(
            "walls without h0 got h0 = R0 (0.2802 exp(-505.3 R0) + 0.1324 exp(-11.14 R0)), in m"
        )
    outside = file.number(table, what, "Pext", 0.0, least=-math.inf)
    stated = any(key in table for key in ("outlet", "R1", "R2", "Cc", "Rt"))
    if stated and not terminal and table.get("outlet") not in (None, "none"):
        raise file.fail(
            f", row {table.rows['outlet']}", f"{what}: outlet: it feeds other vessels; remove the outlet"
        )
    # a wave's impedance at rest, rho c/A0 with c^2 = (2/3) E h0/(rho R0)
    speed = math.sqrt(2 * modulus * _CGS_PRESSURE * wall_out / (3 * density * out))
    impedance = density * speed / (math.pi * (out * _CM) ** 2)
    load, single, behind = _outlet(file, table, what, impedance, outside) if terminal else (None, None, None)
    return Vessel(
        id=number,
        name=name,
        length_cm=_times(file.number(table, what, "L"), _CM),
        radius_cm=_times(radius, _CM),
        radius_out_cm=_times(out, _CM),
        parent=None if parent is None else parent + 1,
        windkessel=load,
        resistance=single,
        youngs_modulus_g_cm_s2=_times(modulus, _CGS_PRESSURE),
        wall_thickness_cm=_times(wall, _CM),
        wall_thickness_out_cm=None if wall_out == wall else _times(wall_out, _CM),
        outflow_pressure_mmHg=behind,
        external_pressure_mmHg=_mmhg(outside) if outside else None,
    )


def _times(value: float, factor: float) -> float:
    """The product to 14 digits, so that 0.126 m are 12.6 cm."""
    return float(f"{value * factor:.14g}")


def _mmhg(pascal: float) -> float:
    return pascal * _CGS_PRESSURE / PRINTED.mmhg


def _outlet(
    file: _File, table: Table, what: str, impedance: float, outside: float
) -> tuple[Windkessel | None, float | None, float | None]:
    """Windkessel, or a single resistance with the pressure behind it; `impedance` in dyn s/cm5."""
    kind = table.get("outlet")
    kind = None if kind == "none" else kind
    if kind is not None and kind not in _OUTLETS:
        raise file.fail(
            f", row {table.rows['outlet']}",
            f"{what}: outlet = {short(kind)}: unknown; use one of {', '.join(_OUTLETS)}",
        )
    if kind is None:
        kind = "reflection" if not table.get("R1") and table.get("Rt") is not None else "wk3"
    if kind == "reflection":
        return None, _reflecting(file, table, what, impedance), _mmhg(outside) if outside else None
    R1 = _times(file.number(table, what, "R1"), _CGS_RESISTANCE)
    R2 = _times(file.number(table, what, "R2", 0.0, least=0.0), _CGS_RESISTANCE)
    if not R2 and not table.get("Cc"):
        return None, R1, None
    C = _times(file.number(table, what, "Cc"), _CGS_COMPLIANCE)
    if R2 and not table.get("inlet_impedance_matching"):
        if kind == "wk2":
            raise file.fail(
                f", row {table.rows['R2']}", f"{what}: R2: wk2 has R1 and Cc alone; remove R2, or write wk3"
            )
        return Windkessel(R1, R2, C), None, None
    total = R1 + R2
    if total <= impedance:
        raise file.fail(
            f", row {table.rows['R1']}",
            f"{what}: R1 = {table['R1']:g}: the resistance, {total:.4g} dyn s/cm5, is below the vessel's "
            f"impedance, {impedance:.4g}, so that nothing is left behind it; correct it",
        )
    if R2:
        file.notes.append("inlet_impedance_matching: R1 is the vessel's impedance at rest, and stays so")
    else:
        file.notes.append(
            "outlets with R1 and Cc alone: rho c/A0 of the vessel at rest in front, the rest of R1 behind"
        )
    return Windkessel(impedance, total - impedance, C), None, None


def _reflecting(file: _File, table: Table, what: str, impedance: float) -> float:
    """The resistance that reflects a small wave by Rt = (R - Z)/(R + Z)."""
    value = table.get("Rt")
    at = f", row {table.rows['Rt']}" if "Rt" in table else ""
    if isinstance(value, bool) or not isinstance(value, int | float) or not -1 < value < 1:
        raise file.fail(
            at, f"{what}: Rt = {short(value)}: must be a number between -1 and 1, itself neither; correct it"
        )
    file.notes.append(
        "reflection: Rt became the resistance Z (1 + Rt)/(1 - Rt), Z the vessel's impedance at rest"
    )
    return impedance * (1 + value) / (1 - value)


def _profile(file: _File, tables: Sequence[Table], names: Sequence[str]) -> float:
    """The one order of the velocity profile."""
    orders = [
        file.number(table, f"vessel {name}", "gamma_profile", DEFAULT_PROFILE)
        for table, name in zip(tables, names, strict=True)
    ]
    for table, name, order in zip(tables, names, orders, strict=True):
        if order != orders[0]:
            at = f", row {table.rows['gamma_profile']}" if "gamma_profile" in table else ""
            raise file.fail(
                at,
                f"vessel {name}: gamma_profile = {order:g}, but {orders[0]:g} in {names[0]}: a study has one "
                "order of the velocity profile; give the same in all vessels",
            )
    if not any("gamma_profile" in table for table in tables):
        file.notes.append(
            f"no gamma_profile: a velocity profile of order {DEFAULT_PROFILE}, openBF's default"
        )
    return orders[0]


def _inflow(file: _File, root: Table) -> tuple[Array, Array, float]:
    """Times (s) and inflow (ml/s) without the last sample, which repeats the first, and the period (s)."""
    kind = root.get("inlet", "Q")
    if kind != "Q":
        raise file.fail(
            f", row {root.rows['inlet']}",
            f"inlet = {short(kind)}: a study has a flow at its inlet; give one, with inlet: Q",
        )
    name = root.get("inlet_file") or file.top.get("inlet_file") or f"{file.top.get('project_name')}_inlet.dat"
    if wrong := inside(file.path.parent, str(name)):
        raise file.fail("", f"inlet_file = {short(str(name))}: {wrong}")
    path = file.path.parent / str(name)
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
        file.notes.append(
            f"inflow: {len(gaps)} samples at uneven times, linear between, became {len(even)} even ones: "
            f"{how}"
        )
        flow = np.append(even, even[0])
    n = len(flow) - 1
    return np.asarray(np.arange(n) * (period / n), dtype=np.float64), flow[:-1], period


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


def _converted(file: _File) -> list[str]:
    return [
        "SI to cgs: m to cm, Pa to dyn/cm2 and mmHg, kg/m3 to g/cm3, Pa s to g/(cm s), m3/s to ml/s",
        *dict.fromkeys(file.notes),
    ]
