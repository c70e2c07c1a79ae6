"""The vessel tree of a network.toml: one root, no circles, loads at terminals only."""

from __future__ import annotations

import heapq
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from zoo.blood.outlet_tables import StructuredTree
from zoo.blood.study.parts import VESSEL_PHYSICS, Blood, Stenosis, StudyError, Vessel, Windkessel
from zoo.blood.study.reading import read_toml
from zoo.blood.study.schema import (
    BloodTable,
    JunctionsTable,
    NetworkTable,
    StenosisTable,
    SurroundingsTable,
    TreeTable,
    VesselTable,
    WallTable,
    validated,
    visible_name,
)
from zoo.blood.study.settings import WALL_FIELDS, put_in
from zoo.blood.study.study import JUNCTION_PRESSURES, WALL_LAWS
from zoo.blood.units import MMHG
from zoo.core.words import nearest, short


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
        vessels feed each other in a circle, or a vessel that is not a terminal has a Windkessel or an
        impedance.
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
        order.append(heapq.heappop(ready))
        for child in children[order[-1]]:
            heapq.heappush(ready, child)
    if len(order) < len(vessels):
        placed, path = set(order), dict[int, int]()
        i = next(i for i in range(len(vessels)) if i not in placed)
        while i not in path:
            path[i] = len(path)
            i = index[vessels[i].parent]  # type: ignore[index]  # only the root has no parent, and it is placed
        circle = [str(vessels[j].id) for j in [*list(path)[path[i] :], i]]
        raise StudyError(
            f"{where[i]}: parent = {vessels[i].parent}: vessels feed each other in a circle "
            f"({' <- '.join(circle)}); follow the flow from the root and correct a parent"
        )
    for i, vessel in enumerate(vessels):
        if (vessel.windkessel or vessel.impedance) and children[i]:
            fed = ", ".join(str(vessels[j].id) for j in children[i])
            field = "windkessel" if vessel.windkessel else "impedance"
            raise StudyError(
                f"{where[i]}: {field}: only a terminal may have one, but this feeds {fed}; remove it"
            )
    return order


_PAIRS = (
    ("stiffness_out_g_cm_s2", "stiffness_g_cm_s2"),
    ("wall_thickness_out_cm", "wall_thickness_cm"),
    ("wall_thickness_cm", "youngs_modulus_g_cm_s2"),
    ("youngs_modulus_g_cm_s2", "wall_thickness_cm"),
)
"""Fields of a vessel that mean nothing without another."""
_TERMINALS_ONLY = ("resistance", "outflow_pressure_mmHg")


def check_physics(
    vessels: Sequence[Vessel], where: Sequence[str] | None = None, radius_pressure_mmHg: float = 0.0
) -> None:
    """Check what vessels say about their walls, outlets and pressures.

    Parameters
    ----------
    vessels : sequence of Vessel
    where : sequence of str
        What an error calls each vessel; "network: vessel ID" when absent.
    radius_pressure_mmHg : float
        The study's, for vessels without their own; mmHg.

    Raises
    ------
    StudyError
        If a value is out of range, a field lacks another that it belongs to, two fields say the same, only
        some of the vessels have a stiffness, or a wall would have no radius without pressure.
    """
    where = where or [f"network: vessel {v.id}" for v in vessels]
    feeding = {v.parent for v in vessels}
    stiff = next((v for v in vessels if v.stiffness), None)
    for v, place in zip(vessels, where, strict=True):
        for name, value in v.physics.items():
            positive = not name.endswith("_mmHg")
            if not math.isfinite(value) or (positive and value <= 0):
                word = "positive and finite" if positive else "finite"
                raise StudyError(f"{place}: {name} = {value!r}: must be {word}; correct it")
        for name, other in _PAIRS:
            if getattr(v, name) is not None and getattr(v, other) is None:
                raise StudyError(f"{place}: {name} = {getattr(v, name)!r}: needs {other} beside it; add that")
        if v.stiffness_g_cm_s2 is not None and v.youngs_modulus_g_cm_s2 is not None:
            raise StudyError(
                f"{place}: youngs_modulus_g_cm_s2 = {v.youngs_modulus_g_cm_s2!r}: stiffness_g_cm_s2 says "
                "how stiff the wall is already; give one of the two"
            )
        given = [name for name in ("windkessel", "impedance", "resistance") if getattr(v, name) is not None]
        if len(given) > 1:
            shown = f" = {v.resistance!r}" if v.resistance else ""
            article = "an" if given[0] == "impedance" else "a"
            raise StudyError(
                f"{place}: {given[1]}{shown}: {article} {given[0]} is the outlet already; give one of the two"
            )
        _check_impedance(v, place)
        _check_stenosis(v, f"{place}: stenosis")
        for name in _TERMINALS_ONLY:
            if v.id in feeding and getattr(v, name) is not None:
                raise StudyError(
                    f"{place}: {name} = {getattr(v, name)!r}: only a terminal may have one, but vessels "
                    "are fed by this one; remove it"
                )
        ends = v.stiffness
        if stiff and not ends:
            raise StudyError(
                f"{place}: stiffness_g_cm_s2: is missing, but vessel {stiff.id} has a stiffness; give all "
                "vessels one (stiffness_g_cm_s2, or youngs_modulus_g_cm_s2 and wall_thickness_cm), or none"
            )
        at = radius_pressure_mmHg if v.radius_pressure_mmHg is None else v.radius_pressure_mmHg
        if ends and at * MMHG >= 4 / 3 * min(ends):
            raise StudyError(
                f"{place}: radius_pressure_mmHg = {at!r}: without pressure the radius would be zero, for a "
                f"stiffness of {min(ends):.6g} g/(cm s2); it must be below {4 / 3 * min(ends) / MMHG:.6g}"
            )


def _check_stenosis(v: Vessel, place: str) -> None:
    """Refuse a stenosis that is none, or lies beyond the vessel's ends."""
    one = v.stenosis
    if one is None:
        return
    for name, value in vars(one).items():
        least = name in ("radius_cm", "length_cm")
        if value is not None and not (value >= 0 and math.isfinite(value) and (value > 0 or not least)):
            raise StudyError(f"{place}: {name} = {value!r}: must be positive and finite; correct it")
    radius = v.radius_cm + (v.radius_out_cm - v.radius_cm) * one.position
    if not one.radius_cm < radius:
        raise StudyError(
            f"{place}: radius_cm = {one.radius_cm!r}: must be below that of the vessel there, {radius:.6g}"
        )
    ends = [one.position * v.length_cm + side * one.length_cm / 2 for side in (-1, 1)]
    if ends[0] < -1e-9 * v.length_cm or ends[1] > v.length_cm * (1 + 1e-9):
        raise StudyError(
            f"{place}: length_cm = {one.length_cm!r}: reaches from {ends[0]:.6g} to {ends[1]:.6g} cm, beyond "
            f"the vessel's {v.length_cm:.6g} cm; shorten it, or move its position"
        )


def _check_impedance(v: Vessel, place: str) -> None:
    """Refuse a table that no passive outlet has, and a tree that does not end."""
    if isinstance(v.impedance, StructuredTree):
        wrong = v.impedance.fault(v.radius_out_cm)
        if wrong:
            raise StudyError(f"{place}: impedance: {wrong}")
        return
    for m, (real, imaginary) in enumerate(v.impedance or ()):
        if not (0 < real < math.inf and math.isfinite(imaginary)) or (m == 0 and imaginary):
            words = "a positive resistance, [R, 0.0]" if m == 0 else "finite, with a positive real part"
            raise StudyError(
                f"{place}: impedance[{m}] = [{real!r}, {imaginary!r}]: must be {words}: an outlet takes "
                "energy at every harmonic; correct it"
            )


MOST_HARMONICS = 200
NOMINAL = "nominal"
"""In the place of a Windkessel's numbers: the load is to be derived."""


class NetworkFile(NamedTuple):
    """What a network.toml holds, what an error calls each vessel, and which are to have nominal loads."""

    given: dict[str, Any]
    """Of a `Study`, but for its vessels."""
    vessels: tuple[Vessel, ...]
    places: list[str]
    nominal: frozenset[int]


def vessel_of(fields: Mapping[str, Any], where: str) -> Vessel:
    """A vessel from the fields of a [[vessel]], checked by themselves; `where` is what an error calls it."""
    load = fields.get("windkessel")
    if load == NOMINAL:
        fields = {name: value for name, value in fields.items() if name != "windkessel"}
    elif isinstance(load, str):
        raise StudyError(
            f'{where}: windkessel = {short(load)}: must be a table of R1, R2 and C; or write "{NOMINAL}"'
        )
    v = validated(VesselTable, fields, where)
    own = v.windkessel and Windkessel(v.windkessel.R1, v.windkessel.R2, v.windkessel.C)
    out = v.radius_cm if v.radius_out_cm is None else v.radius_out_cm
    name = visible_name(where, v.name or f"v{v.id}")
    given: dict[str, Any] = {field: getattr(v, field) for field in VESSEL_PHYSICS}
    outlet = None if v.impedance is None else _impedance(v.impedance, where)
    if v.stenosis is not None:
        given["stenosis"] = Stenosis(
            **validated(StenosisTable, v.stenosis, f"{where}: stenosis").model_dump()
        )
    return Vessel(v.id, name, v.length_cm, v.radius_cm, out, v.parent, own, outlet, **given)


def _with_stiffness(v: Vessel, wall: WallTable, where: str) -> Vessel:
    """The vessel with chi = k1 exp(k2 r0) + k3 at both ends, unless it has a stiffness of its own."""
    constants = (wall.k1_g_cm_s2, wall.k2_per_cm, wall.k3_g_cm_s2)
    if constants == (None, None, None):
        return v
    if None in constants:
        name = ("k1_g_cm_s2", "k2_per_cm", "k3_g_cm_s2")[constants.index(None)]
        raise StudyError(f"{where}: {name}: is missing; give k1, k2 and k3 of k1 exp(k2 r0) + k3, or none")
    if any(getattr(v, name) is not None for name in WALL_FIELDS):
        return v
    k1, k2, k3 = (float(k) for k in constants if k is not None)
    ends = [k1 * math.exp(min(k2 * r, 700.0)) + k3 for r in (v.radius_cm, v.radius_out_cm)]
    if not all(1e-30 <= chi <= 1e30 for chi in ends):
        raise StudyError(
            f"{where}: k1_g_cm_s2 = {k1!r}, k2_per_cm = {k2!r}, k3_g_cm_s2 = {k3!r}: make a stiffness of "
            f"{ends[0]:.3g} to {ends[1]:.3g} g/(cm s2) in vessel {v.id}; correct them"
        )
    tapers = v.radius_out_cm != v.radius_cm
    return replace(v, stiffness_g_cm_s2=ends[0], stiffness_out_g_cm_s2=ends[1] if tapers else None)


def _impedance(given: Any, where: str) -> tuple[tuple[float, float], ...] | StructuredTree:
    """Of the list or the table of a file."""
    if isinstance(given, list):
        numbers = (int, float)
        for m, pair in enumerate(given):
            good = isinstance(pair, list) and len(pair) == 2
            if not good or not all(isinstance(x, numbers) and not isinstance(x, bool) for x in pair):
                raise StudyError(
                    f"{where}: impedance[{m}] = {short(pair)}: must be [real, imaginary] of harmonic {m}, "
                    "dyn s/cm5; correct it"
                )
        if not 0 < len(given) <= MOST_HARMONICS:
            raise StudyError(
                f"{where}: impedance: {len(given)} harmonics: give 1 to {MOST_HARMONICS}, from 0 (steady) up"
            )
        return tuple((float(real), float(imaginary)) for real, imaginary in given)
    tree = validated(TreeTable, given, f"{where}: impedance").model_dump()
    exponent, asymmetry = tree.pop("exponent"), tree.pop("asymmetry")
    there = [one is not None for one in (tree["alpha"], tree["beta"], exponent, asymmetry)]
    if there not in ([True, True, False, False], [False, False, True, True]):
        raise StudyError(f"{where}: impedance: give alpha and beta, or exponent and asymmetry")
    if there[2]:
        tree["alpha"] = (1 + asymmetry ** (exponent / 2)) ** (-1 / exponent)
        tree["beta"] = tree["alpha"] * math.sqrt(asymmetry)
    return StructuredTree(**tree)


def _label(fields: Mapping[str, Any], i: int) -> str:
    """What an error calls the i-th vessel of a file."""
    given = fields.get("id", f"number {i + 1}")
    return given if isinstance(given, str) and len(given) < 20 else short(given, 20)


def read_network_file(path: Path, settings: Mapping[str, Any] | None = None) -> NetworkFile:
    """A network.toml with settings in the place of its own fields, checked."""
    data, text = read_toml(path)
    file = put_in(data, settings or {}, NetworkTable, str(path))
    table = validated(NetworkTable, data, file)
    blood = validated(BloodTable, table.blood, f"{file}: blood")
    junctions = validated(JunctionsTable, table.junctions, f"{file}: junctions")
    if junctions.pressure not in JUNCTION_PRESSURES:
        raise StudyError(
            f"{file}: junctions: pressure = {short(junctions.pressure)}: "
            f"{nearest(junctions.pressure, JUNCTION_PRESSURES)}"
        )
    wall = validated(WallTable, table.wall, f"{file}: wall")
    if wall.law not in WALL_LAWS:
        raise StudyError(f"{file}: wall: law = {short(wall.law)}: {nearest(wall.law, WALL_LAWS)}")
    surroundings = validated(SurroundingsTable, table.surroundings, f"{file}: surroundings").model_dump()
    heads = [n for n, line in enumerate(text.splitlines(), 1) if re.match(r"\s*\[\[\s*vessel\s*\]\]", line)]
    vessels, where = [], []
    for i, data in enumerate(table.vessel):
        row = f", row {heads[i]}" if len(heads) == len(table.vessel) else ""
        place = f"{file}{row}: vessel {_label(data, i)}"
        vessels.append(_with_stiffness(vessel_of(data, place), wall, f"{file}: wall"))
        where.append(place)
    if not vessels:
        raise StudyError(f"{file}: vessel: the list is empty; add at least one [[vessel]]")
    sort_vessels(vessels, where)
    check_physics(vessels, where, surroundings["radius_pressure_mmHg"])
    nominal = frozenset(
        v.id for v, data in zip(vessels, table.vessel, strict=True) if data.get("windkessel") == NOMINAL
    )
    given = {"blood": Blood(**blood.model_dump()), "junction_pressure": junctions.pressure, "wall": wall.law}
    return NetworkFile(given | surroundings, tuple(vessels), where, nominal)
