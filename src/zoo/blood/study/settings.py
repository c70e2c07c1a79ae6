"""Fields of a study's files that are set for one call, before anything is checked."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any

from zoo.blood.study.parts import StudyError
from zoo.blood.study.schema import NetworkTable, StudyTable, Table
from zoo.core.words import choices, short

_FIELDS = {*StudyTable.model_fields, *NetworkTable.model_fields}
WALL_FIELDS = (
    "stiffness_g_cm_s2",
    "stiffness_out_g_cm_s2",
    "youngs_modulus_g_cm_s2",
    "wall_thickness_cm",
    "wall_thickness_out_cm",
)
"""What a vessel says of its stiffness."""
_INSTEAD = {
    "accuracy_percent": ("dx_cm",),
    "dx_cm": ("accuracy_percent",),
    "resistance": ("windkessel",),
    "windkessel": ("resistance",),
    "stiffness_g_cm_s2": WALL_FIELDS,
    "youngs_modulus_g_cm_s2": WALL_FIELDS,
}
"""Field -> others that say the same, in whose place it stands."""
_OF_TERMINALS = ("windkessel", "resistance", "outflow_pressure_mmHg")


def read_setting(text: str) -> tuple[str, Any]:
    """Read ``KEY=VALUE``, where the value is one of TOML, a text without quotes, or several with commas.

    Returns
    -------
    key : str
        Field of study.toml or network.toml, with dots.
    value : object
        None, where nothing stands after the sign, leaves the field out.

    Raises
    ------
    StudyError
        If there is no key, or no such field.

    Examples
    --------
    >>> read_setting("conventions.friction=rest")
    ('conventions.friction', 'rest')
    >>> read_setting("vessel.stiffness_g_cm_s2=4e4,5e4")
    ('vessel.stiffness_g_cm_s2', [40000.0, 50000.0])
    """
    key, sign, value = (part.strip() for part in text.partition("="))
    if not (key and sign):
        raise StudyError(f"{short(text)}: write KEY=VALUE, such as conventions.friction=rest")
    return key, _value(value) if value else None


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"x = {text}")["x"]
    except (ValueError, RecursionError):
        parts = text.split(",")
        return [_value(part.strip()) for part in parts] if len(parts) > 1 else text


def put_in(data: dict[str, Any], settings: Mapping[str, Any], model: type[Table], where: str) -> str:
    """Put settings into the table of a file, as if the file said them.

    Parameters
    ----------
    data : dict
        The whole table of the file, which is changed.
    settings : mapping
        Key -> value; those whose first part is a field of the model are put in. ``vessel.FIELD`` is of all
        vessels, or of all terminals: one value, or one for each vessel in the order of the file.
    model : type of Table
    where : str
        The file.

    Returns
    -------
    str
        What an error calls the file, with what was set in it.

    Raises
    ------
    StudyError
        If a key is of no field, or the number of values fits no vessels.
    """
    mine = []
    for key in sorted(settings, key=lambda key: key.count(".")):  # tables before their fields
        head, *rest = key.split(".")
        if head not in _FIELDS:
            raise StudyError(f"{short(key)}: no field of a study; {choices(head, sorted(_FIELDS))}")
        if head not in model.model_fields:
            continue
        rest = [".".join(rest)] if head == "noise_sd" and rest else rest  # "v2@0.5 flow_ml_s" is one name
        mine.append(f"{key}={settings[key]}")
        if head == "vessel":
            _put_in_vessels(data, key, rest, settings)
        else:
            _put(data, key, [head, *rest], settings[key], settings)
    return f"{where} with {', '.join(mine)}" if mine else where


def _put_in_vessels(data: dict[str, Any], key: str, rest: list[str], settings: Mapping[str, Any]) -> None:
    if not rest:
        raise StudyError("vessel: is set field by field, such as vessel.radius_cm=0.05")
    vessels = data.get("vessel")
    if not (isinstance(vessels, list) and all(isinstance(vessel, dict) for vessel in vessels)):
        return  # as no network is; that is said where it is checked
    value = settings[key]
    values = value if isinstance(value, list) else [value] * len(vessels)
    if len(values) != len(vessels):
        raise StudyError(
            f"{key}: {len(values)} values; give one for all vessels, or one for each of the {len(vessels)} "
            "vessels, with commas between them"
        )
    feeding = [vessel.get("parent") for vessel in vessels]
    for vessel, one in zip(vessels, values, strict=True):
        if rest[0] not in _OF_TERMINALS or vessel.get("id") not in feeding:
            _put(vessel, key, rest, one, settings)


def _put(table: dict[str, Any], key: str, path: list[str], value: Any, settings: Mapping[str, Any]) -> None:
    for part in path[:-1]:
        inner = table.get(part, {})
        if part == "conventions" and isinstance(inner, str):
            inner = {"base": inner}
        if not isinstance(inner, dict):
            raise StudyError(f"{key}: {part} = {short(inner)}: is no table; set {part} itself")
        table[part] = inner
        table = inner
    head = key.removesuffix(path[-1])
    for other in _INSTEAD.get(path[-1], ()):
        if other != path[-1] and head + other not in settings:
            table.pop(other, None)
    if value is None:
        table.pop(path[-1], None)
    else:
        table[path[-1]] = value
