"""The vessel tree of a network.toml: one root, no circles, loads at terminals only."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from zoo.blood.study.parts import Blood, StudyError, Vessel, Windkessel
from zoo.blood.study.tables import BloodTable, NetworkTable, VesselTable, read_toml, validated, visible_name


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


def read_network_places(path: Path) -> tuple[Blood, tuple[Vessel, ...], list[str]]:
    """Blood, vessels, and what an error calls each vessel."""
    data, text = read_toml(path)
    table = validated(NetworkTable, data, str(path))
    blood = validated(BloodTable, table.blood, f"{path}: blood")
    heads = [n for n, line in enumerate(text.splitlines(), 1) if re.match(r"\s*\[\[\s*vessel\s*\]\]", line)]
    vessels, where = [], []
    for i, data in enumerate(table.vessel):
        row = f", row {heads[i]}" if len(heads) == len(table.vessel) else ""
        place = f"{path}{row}: vessel {data.get('id', f'number {i + 1}')}"
        v = validated(VesselTable, data, place)
        load = v.windkessel and Windkessel(v.windkessel.R1, v.windkessel.R2, v.windkessel.C)
        out = v.radius_cm if v.radius_out_cm is None else v.radius_out_cm
        name = visible_name(place, v.name or f"v{v.id}")
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
    blood, vessels, _ = read_network_places(Path(path))
    return blood, vessels
