"""`zoo import`, `zoo import-beats`: networks, tables of vessels, and raw records, as studies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zoo.cli.command import REQUIRED, Role, UsageError, argument, command, option
from zoo.cli.screen import say
from zoo.core.outputs import output_folder

if TYPE_CHECKING:
    from zoo.blood.importing.imported import Imported

YAML = (".yaml", ".yml")
FILES = (
    "openBF's or jaxFlowSim's .yaml, svOneDSolver's .in, svZeroDSolver's .json, VaMpy's .cfg, or a .csv with "
    "a row for each vessel"
)


@dataclass(frozen=True)
class TableOptions:
    """What a table of vessels does not say itself."""

    inflow: Path | None = option(None, "Inflow of a .csv: columns time_s, flow_ml_s.")
    period_s: float | None = option(None, "Length of the beat of a .csv, s.", "--period", metavar="S")
    observations: Path | None = option(None, "Observations of a .csv, as a study has them.")
    density_g_cm3: float | None = option(None, "Density of blood, for a .csv; 1.06 g/cm3.", "--density")
    viscosity_g_cm_s: float | None = option(
        None, "Viscosity of blood, for a .csv; 0.04 g/(cm s).", "--viscosity"
    )
    velocity_profile_order: float | None = option(
        None, "Order of the velocity profile, for a .csv; a flat one without it.", "--profile-order"
    )


@command
def import_(
    file: Path = argument("FILE", f"{FILES}."),
    output: Path = option(REQUIRED, "Folder of the new study.", "--output", "-o", Role.WRITES),
    name: str | None = option(None, "Name of the study; that of the file if absent."),
    *,
    table: TableOptions,
) -> None:
    """Make a study of another program's network, or of a CSV table of vessels."""
    from zoo.blood.importing.openbf import import_openbf
    from zoo.blood.importing.svonedsolver import import_svonedsolver
    from zoo.blood.importing.svzerodsolver import import_svzerodsolver
    from zoo.blood.importing.table import import_table
    from zoo.blood.importing.vampy import import_vampy
    from zoo.blood.study import STUDY_FILES

    output_folder(output, STUDY_FILES, "--output")
    if not file.is_file():
        raise UsageError(f"{file}: no such file; give {FILES}")
    suffix = file.suffix.lower()
    given: dict[str, Any] = {option: value for option, value in vars(table).items() if value is not None}
    readers = {
        "yaml": import_openbf,
        "in": import_svonedsolver,
        "json": import_svzerodsolver,
        "cfg": import_vampy,
    }
    kind = "yaml" if suffix in YAML else suffix[1:]
    if kind in readers:
        for option, value in given.items():
            raise UsageError(
                f"{option} = {value}: belongs to a .csv; {file.name} says that itself: leave it out"
            )
        found = readers[kind](file)
        if name is not None:
            found = replace(found, study=replace(found.study, name=name))
    elif suffix == ".csv":
        if table.inflow is None or table.period_s is None:
            lacking = "--inflow inflow.csv" if table.inflow is None else "--period 0.85"
            raise UsageError(f"{file}: a table of vessels has no inflow: add {lacking}")
        found = import_table(file, name=name, **given)
    else:
        raise UsageError(f"{file}: unknown ending {file.suffix!r}; give {FILES}")
    _save(
        found, output, "simulate", "" if any(v.stiffness for v in found.study.vessels) else " --stiffness 6e4"
    )


def _save(found: Imported, output: Path, following: str, options: str = "") -> None:
    """Write a study into a folder whose files are checked, and tell what became of what was read."""
    from zoo.blood.network import with_nominal_loads
    from zoo.blood.study import StudyError

    study = found.save(output, replace=True)
    say(study.name, *(f"  read: {line}" for line in found.read))
    say(*(f"  converted: {line}" for line in found.converted))
    say(*(f"  left out: {line}" for line in found.left_out))
    try:
        with_nominal_loads(study)
        then = f"zoo {following} {output}{options}"
    except StudyError as error:
        then = f"add what lacks: {error}"
    say(f"wrote {output}", f"next: {then}")


@dataclass(frozen=True)
class BeatOptions:
    """What records of pressure and flow do not say themselves."""

    length_cm: float | None = option(None, "Of the vessel, cm.", "--length", metavar="CM")
    radius_cm: float | None = option(None, "Of the vessel, cm.", "--radius", metavar="CM")
    position: float | None = option(None, "Of the pressure along the vessel, 0 (inlet) to 1; 0.")
    density_g_cm3: float | None = option(None, "Of blood; 1.06 g/cm3.", "--density")
    viscosity_g_cm_s: float | None = option(None, "Of blood; 0.04 g/(cm s).", "--viscosity")


@command
def import_beats(
    pressure: Path = argument(
        "PRESSURE", ".csv: times, pressure over beats; or the folder of a study whose samples go over beats."
    ),
    flow: Path | None = argument("[FLOW]", ".csv: times, flow into the vessel.", default=None),
    *,
    output: Path = option(REQUIRED, "Folder of the new study.", "--output", "-o", Role.WRITES),
    name: str | None = option(None, "Of the study; that of PRESSURE if absent."),
    beats: BeatOptions,
) -> None:
    """Make a study of raw records: find the beats, average them, tell their scatter and timing."""
    from zoo.blood.importing.beats import ImportedBeats
    from zoo.blood.importing.beats import import_beats as read
    from zoo.blood.importing.study_beats import average_beats

    given: dict[str, Any] = {option: value for option, value in vars(beats).items() if value is not None}
    if pressure.is_dir():
        for option, value in (({} if flow is None else {"FLOW": flow}) | given).items():
            raise UsageError(f"{option} = {value}: the study {pressure} says that itself: leave it out")
    elif flow is None or beats.length_cm is None or beats.radius_cm is None:
        raise UsageError(
            f"{pressure}: add FLOW, --length and --radius, or give the folder of a study in its place"
        )
    output_folder(output, ImportedBeats.files, "--output")
    if flow is None:
        found = average_beats(pressure)
        if name is not None:
            found = replace(found, study=replace(found.study, name=name))
    else:
        found = read(pressure, flow, name=name, **given)
    _save(found, output, "diagnose")
