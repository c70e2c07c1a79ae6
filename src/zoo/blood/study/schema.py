"""Tables of the TOML files, and how a fault of theirs is said in one line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from zoo.blood.study.parts import StudyError
from zoo.core.arrays import MOST_COUNT
from zoo.core.words import choices, one_line, short

LONGEST_NAME = 100
"""Characters of a name of a study or a vessel."""
Size = Annotated[float, Field(ge=1e-8, le=1e8)]
"""Lengths and radii, cm: those of no vessel are beyond, in any unit."""
Positive = Annotated[float, Field(ge=1e-30, le=1e30)]
"""Other positive numbers: no product of a few powers of them is beyond a double."""
Pressure = Annotated[float, Field(ge=-1e6, le=1e6)]
Whole = Annotated[int, Field(ge=-(2**31), lt=2**31)]


class Table(BaseModel):
    """A table of a study's TOML files, which refuses fields that it does not know."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class StudyTable(Table):
    """Top level of study.toml."""

    name: str
    network: str
    inflow: Any = None
    inlet_pressure: Any = None
    outflow_pressure: Any = None
    observations: Any = None
    period_s: Positive
    conventions: Any = "printed"
    priors: dict[str, Any] = Field(default_factory=dict)
    parameters: dict[str, float] = Field(default_factory=dict)
    noise_sd: dict[str, Positive] = Field(default_factory=dict)
    numerics: dict[str, Any] = Field(default_factory=dict)


class FetchedInflowTable(Table):
    """Table [inflow] of a study whose inflow is fetched."""

    fetch: str


class FetchedObservationsTable(Table):
    """Table [observations] of a study whose series are fetched."""

    fetch: str
    vessel: Whole
    position: float
    quantity: str
    average: int = Field(default=1, ge=1, lt=2**31)


class NetworkTable(Table):
    """Top level of network.toml."""

    blood: dict[str, Any]
    junctions: dict[str, Any] = Field(default_factory=dict)
    surroundings: dict[str, Any] = Field(default_factory=dict)
    wall: dict[str, Any] = Field(default_factory=dict)
    vessel: list[dict[str, Any]]


class BloodTable(Table):
    """Table [blood]."""

    density_g_cm3: Positive
    viscosity_g_cm_s: Positive
    velocity_profile_order: Positive | None = None
    momentum_correction: float = Field(default=1.0, ge=1, le=1e6)


class JunctionsTable(Table):
    """Table [junctions]."""

    pressure: str = "static"


class WallTable(Table):
    """Table [wall]."""

    law: str = "linear"
    k1_g_cm_s2: float | None = Field(default=None, ge=0, le=1e30)
    k2_per_cm: float | None = Field(default=None, ge=-1e6, le=1e6)
    k3_g_cm_s2: float | None = Field(default=None, ge=0, le=1e30)


class SurroundingsTable(Table):
    """Table [surroundings]."""

    external_pressure_mmHg: Pressure = 0.0
    outflow_pressure_mmHg: Pressure = 0.0
    radius_pressure_mmHg: Pressure = 0.0


class WindkesselTable(Table):
    """A vessel's windkessel: R1, R2 and C."""

    R1: Positive
    R2: Positive
    C: Positive


class StenosisTable(Table):
    """A vessel's stenosis."""

    radius_cm: Size
    length_cm: Size
    position: float = Field(default=0.5, ge=0, le=1)
    Kt: float = Field(default=1.52, ge=0, le=1e6)
    Kv: float | None = Field(default=None, ge=0, le=1e12)


class TreeTable(Table):
    """A vessel's structured tree."""

    alpha: float | None = Field(default=None, ge=0.01, le=0.98)
    beta: float | None = Field(default=None, ge=0.01, le=0.98)
    exponent: float | None = Field(default=None, ge=1, le=10)
    asymmetry: float | None = Field(default=None, ge=0.01, le=1)
    length_ratio: Positive
    smallest_radius_cm: Size
    f1: float = Field(ge=0, le=1e30)
    f2: float = Field(ge=-1e6, le=1e6)
    f3: float = Field(ge=0, le=1e30)
    viscosity_by_radius: bool = True


class VesselTable(Table):
    """A vessel in network.toml."""

    id: int = Field(ge=1, lt=2**31)
    name: str = ""
    length_cm: Size
    radius_cm: Size
    radius_out_cm: Size | None = None
    parent: Whole | None = None
    windkessel: WindkesselTable | None = None
    impedance: list[Any] | dict[str, Any] | None = None
    stenosis: dict[str, Any] | None = None
    resistance: Positive | None = None
    stiffness_g_cm_s2: Positive | None = None
    stiffness_out_g_cm_s2: Positive | None = None
    youngs_modulus_g_cm_s2: Positive | None = None
    wall_thickness_cm: Size | None = None
    wall_thickness_out_cm: Size | None = None
    outflow_pressure_mmHg: Pressure | None = None
    external_pressure_mmHg: Pressure | None = None
    radius_pressure_mmHg: Pressure | None = None


class NumericsTable(Table):
    """Table [numerics]."""

    accuracy_percent: float | None = Field(default=None, ge=1e-9, lt=10)
    dx_cm: Size | None = None
    steps_per_beat: int | None = Field(default=None, ge=32, le=65536)
    tolerance_mmHg: Positive | None = None
    max_beats: int | None = Field(default=None, ge=1, le=MOST_COUNT)


_MEANING = {
    "missing": "is missing; add it",
    "greater_than": "must be positive; correct it",
    "greater_than_equal": "must be at least {ge}; correct it",
    "less_than": "must be below {lt}; correct it",
    "less_than_equal": "must be at most {le}; correct it",
    "finite_number": "must be finite; correct it",
    "float_type": "must be a number; write it without quotes",
    "int_type": "must be a whole number; correct it",
    "string_type": "must be text; write it in quotes",
    "dict_type": "must be a table; write {{ ... }} or a [heading]",
    "model_type": "must be a table; write {{ ... }} or a [heading]",
    "list_type": "must be a list of tables; write [[vessel]]",
}


def validated(model: type[Table], data: Any, where: str | Callable[[str], str]) -> Any:
    """Validate a table of a file; its first fault is raised, a misspelt field before others.

    Parameters
    ----------
    model : type of Table
    data : mapping
    where : str or function of str
        What an error calls the table, or the place of a field of this name.

    Raises
    ------
    StudyError
    """

    def fault(name: str, reason: str) -> StudyError:
        return StudyError(f"{where if isinstance(where, str) else where(name)}: {reason}")

    for name in data:
        if name not in model.model_fields:  # here, as the model would list each of a million
            hint = choices(name, list(model.model_fields))
            raise fault(name, f"{one_line(str(name), 100)}: unknown field; {hint}")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        first = min(error.errors(), key=lambda one: one["type"] != "extra_forbidden")
    loc, kind, limits = first["loc"], first["type"], dict(first.get("ctx", {}))
    name = one_line(".".join(str(part) for part in loc), 100)
    if kind == "extra_forbidden":
        raise fault(name, f"{name}: unknown field; {choices(loc[-1], list(WindkesselTable.model_fields))}")
    if kind == "missing":
        raise fault(name, f"{name}: {_MEANING[kind]}")
    least = limits.get("ge")
    if isinstance(least, float) and first["input"] <= 0 < least:
        kind = "greater_than"
    shown = {limit: f"{x:g}" if isinstance(x, float) else str(x) for limit, x in limits.items()}
    meaning = _MEANING[kind].format(**shown) if kind in _MEANING else f"{first['msg']}; correct it"
    raise fault(str(loc[0]), f"{name} = {short(first['input'])}: {meaning}")


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


def visible_name(where: str, name: str, *, of_file: bool = False) -> str:
    """A name as it is: of visible characters; one that names files too has no separators of paths."""
    if not name.strip() or not name.isprintable() or len(name) > LONGEST_NAME:
        raise StudyError(
            f"{where}: name = {short(name)}: must be one line of visible text, at most {LONGEST_NAME} "
            "characters; correct it"
        )
    if of_file and (set(name) & set("/\\") or name.strip(". ") == ""):
        raise StudyError(f"{where}: name = {short(name)}: names files too: leave out / and \\")
    return name
