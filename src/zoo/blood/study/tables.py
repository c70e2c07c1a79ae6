"""Tables of the TOML files, and how a fault of theirs is said in one line."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from zoo.blood.study.parts import StudyError
from zoo.core.words import choices


class Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class StudyTable(Table):
    name: str
    network: str
    inflow: Any
    observations: Any = None
    period_s: float = Field(gt=0)
    conventions: Any = "printed"
    priors: dict[str, Any] = Field(default_factory=dict)
    noise_sd: dict[str, float] = Field(default_factory=dict)
    numerics: dict[str, Any] = Field(default_factory=dict)


class FetchedInflowTable(Table):
    fetch: str


class FetchedObservationsTable(Table):
    fetch: str
    vessel: int
    position: float
    quantity: str
    average: int = Field(default=1, ge=1)


class NetworkTable(Table):
    blood: dict[str, Any]
    junctions: dict[str, Any] = Field(default_factory=dict)
    surroundings: dict[str, Any] = Field(default_factory=dict)
    vessel: list[dict[str, Any]]


class BloodTable(Table):
    density_g_cm3: float = Field(gt=0)
    viscosity_g_cm_s: float = Field(gt=0)
    velocity_profile_order: float | None = Field(default=None, gt=0)
    momentum_correction: float = Field(default=1.0, ge=1)


class JunctionsTable(Table):
    pressure: str = "static"


class SurroundingsTable(Table):
    external_pressure_mmHg: float = 0.0
    outflow_pressure_mmHg: float = 0.0
    radius_pressure_mmHg: float = 0.0


class WindkesselTable(Table):
    R1: float = Field(gt=0)
    R2: float = Field(gt=0)
    C: float = Field(gt=0)


class VesselTable(Table):
    id: int = Field(ge=1, lt=2**31)
    name: str = ""
    length_cm: float = Field(gt=0)
    radius_cm: float = Field(gt=0)
    radius_out_cm: float | None = Field(default=None, gt=0)
    parent: int | None = None
    windkessel: WindkesselTable | None = None
    resistance: float | None = Field(default=None, gt=0)
    stiffness_g_cm_s2: float | None = Field(default=None, gt=0)
    stiffness_out_g_cm_s2: float | None = Field(default=None, gt=0)
    youngs_modulus_g_cm_s2: float | None = Field(default=None, gt=0)
    wall_thickness_cm: float | None = Field(default=None, gt=0)
    wall_thickness_out_cm: float | None = Field(default=None, gt=0)
    outflow_pressure_mmHg: float | None = None
    external_pressure_mmHg: float | None = None
    radius_pressure_mmHg: float | None = None


class NumericsTable(Table):
    accuracy_percent: float | None = Field(default=None, gt=0, lt=10)
    dx_cm: float | None = Field(default=None, gt=0)
    steps_per_beat: int | None = Field(default=None, ge=32, le=65536)
    tolerance_mmHg: float | None = Field(default=None, gt=0)
    max_beats: int | None = Field(default=None, ge=1)


_MEANING = {
    "missing": "is missing; add it",
    "greater_than": "must be positive; correct it",
    "greater_than_equal": "must be at least {ge}; correct it",
    "less_than": "must be below {lt}; correct it",
    "finite_number": "must be finite; correct it",
    "float_type": "must be a number; write it without quotes",
    "int_type": "must be a whole number; correct it",
    "string_type": "must be text; write it in quotes",
    "dict_type": "must be a table; write { ... } or a [heading]",
    "model_type": "must be a table; write { ... } or a [heading]",
    "list_type": "must be a list of tables; write [[vessel]]",
}


def short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def validated(model: type[Table], data: Any, where: str) -> Any:
    """Validate a table of a TOML file; its first fault is raised, a misspelt field before others."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        faults = sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
    loc, kind = faults[0]["loc"], faults[0]["type"]
    name = ".".join(str(part) for part in loc)
    if kind == "extra_forbidden":
        fields = list((WindkesselTable if loc[0] == "windkessel" else model).model_fields)
        raise StudyError(f"{where}: {name}: unknown field; {choices(loc[-1], fields)}")
    if kind == "missing":
        raise StudyError(f"{where}: {name}: {_MEANING[kind]}")
    meaning = _MEANING.get(kind, f"{faults[0]['msg']}; correct it")
    for limit, number in faults[0].get("ctx", {}).items():
        meaning = meaning.replace(f"{{{limit}}}", f"{number:g}" if isinstance(number, float) else str(number))
    raise StudyError(f"{where}: {name} = {short(faults[0]['input'])}: {meaning}")


def checked_numerics(where: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """The table [numerics] without what is absent.

    Raises
    ------
    StudyError
        If a field is unknown or out of range, or cells are asked for in two ways.
    """
    table = validated(NumericsTable, dict(given), where).model_dump(exclude_none=True)
    if "accuracy_percent" in table and "dx_cm" in table:
        raise StudyError(
            f"{where}: accuracy_percent and dx_cm are two ways to say how long cells are; leave one out"
        )
    return dict(table)


def read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise StudyError(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8") from None
    except OSError as error:
        raise StudyError(f"{path}: cannot be read ({error.strerror}); correct that") from None


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    text = read_text(path)
    try:
        return tomllib.loads(text), text
    except tomllib.TOMLDecodeError as error:
        raise StudyError(f"{path}: not valid TOML: {error}; correct that line") from None


def visible_name(where: str, name: str) -> str:
    if not name.strip() or not name.isprintable():
        raise StudyError(f"{where}: name = {name!r}: must be one line of visible text; correct it")
    return name
