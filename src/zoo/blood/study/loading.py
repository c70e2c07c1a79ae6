"""A study from its folder, or from those that come with the package."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zoo.blood.conventions import Conventions, ConventionsError, get_conventions
from zoo.blood.study.parts import QUANTITIES, Series, StudyError, Vessel
from zoo.blood.study.reading import inside, read_toml
from zoo.blood.study.samples import (
    PRESSURE_COLUMNS,
    Samples,
    as_read,
    fetched_inflow,
    fetched_observations,
    read_inlet,
    read_observations,
    read_outflow,
)
from zoo.blood.study.schema import (
    FetchedInflowTable,
    FetchedObservationsTable,
    StudyTable,
    checked_numerics,
    validated,
    visible_name,
)
from zoo.blood.study.settings import put_in
from zoo.blood.study.study import Study
from zoo.blood.study.suspicion import warn_of_units
from zoo.blood.study.tree import NOMINAL, read_network_file
from zoo.core.arrays import Array
from zoo.core.words import meant, nearest, short

_BUILT_IN = Path(__file__).parents[2] / "data"


def list_studies() -> tuple[str, ...]:
    """Names of the studies that come with the package."""
    return tuple(sorted(path.parent.name for path in _BUILT_IN.glob("*/study.toml")))


def _find(name_or_folder: str | Path) -> tuple[Path, Path | str]:
    """Folder of a study, and what to call it."""
    folder = Path(name_or_folder)
    folder = folder.parent if folder.name == "study.toml" else folder
    try:
        here = (folder / "study.toml").is_file()
    except OSError as error:  # a name that is too long
        raise StudyError(f"{short(str(name_or_folder))}: cannot be read ({error.strerror})") from None
    if here and (wrong := inside(folder, "study.toml")):
        raise StudyError(f"{folder}: study.toml {wrong}")
    if isinstance(name_or_folder, str) and name_or_folder in list_studies():
        built_in = _BUILT_IN / name_or_folder
        if here and folder.resolve() != built_in.resolve():
            raise StudyError(
                f"{name_or_folder}: both a built-in study and a folder here; write ./{name_or_folder} for "
                "the folder, or work in another one"
            )
        return built_in, f"built-in study {name_or_folder}"
    if here:
        return folder, folder
    if folder.is_dir():
        raise StudyError(f"{folder}: no study.toml in this folder; add one")
    known = list_studies()
    beside = [str(path.parent) for path in sorted(folder.parent.glob("*/study.toml"))]
    question = meant(name_or_folder, (*beside, *known))
    raise StudyError(
        f"{name_or_folder}: neither a folder with a study.toml nor a built-in study; {question}use one of "
        f"{', '.join(known)}, or a folder"
    )


def _file(where: str, folder: Path, name: str, value: Any) -> Path:
    if not isinstance(value, str):
        raise StudyError(f"{where}: {name} = {short(value)}: must be a file name; write it in quotes")
    if wrong := inside(folder, value):
        raise StudyError(f"{where}: {name} = {short(value)}: {wrong}")
    return folder / value


def study_files(name_or_folder: str | Path, settings: Mapping[str, Any] | None = None) -> list[Path]:
    """The files that a study is read from; none of a built-in one.

    Parameters
    ----------
    name_or_folder, settings
        As `load_study` takes them.
    """
    folder, source = _find(name_or_folder)
    if source != folder:
        return []
    data = read_toml(folder / "study.toml")[0]
    where = put_in(data, settings or {}, StudyTable, str(folder / "study.toml"))
    table = validated(StudyTable, data, where)
    named = (table.network, table.inflow, table.inlet_pressure, table.outflow_pressure, table.observations)
    return [folder / name for name in ("study.toml", *named) if isinstance(name, str)]


def load_study(
    name_or_folder: str | Path,
    conventions: str | Mapping[str, Any] | Conventions | None = None,
    *,
    settings: Mapping[str, Any] | None = None,
) -> Study:
    """Load and check a study.

    Parameters
    ----------
    name_or_folder : str or Path
        A built-in name (see `list_studies`), or a folder with a ``study.toml``.
    conventions : str, mapping or Conventions
        Instead of the study's own; as in `zoo.blood.conventions.get_conventions`.
    settings : mapping, optional
        Fields of study.toml and network.toml in the place of the study's own, by names with dots, such as
        ``{"conventions.friction": "rest", "vessel.radius_cm": 0.05}``; None leaves a field out.

    Returns
    -------
    Study

    Raises
    ------
    StudyError
        If anything in it is wrong: one line with the file, row, field, value and remedy.
    zoo.blood.fetch.FetchError
        If it is made of measured data that cannot be had.
    zoo.blood.conventions.ConventionsError
        If `conventions` do not exist.

    Warns
    -----
    zoo.blood.study.UnitWarning
        If a quantity has the size of another unit.
    zoo.blood.study.LoadWarning
        If some terminals have a load and others none.
    """
    return read_study(name_or_folder, conventions, settings)


def read_study(
    name_or_folder: str | Path,
    conventions: str | Mapping[str, Any] | Conventions | None = None,
    settings: Mapping[str, Any] | None = None,
    fold: Callable[[Samples, float], Samples] = as_read,
) -> Study:
    """A study as `load_study` reads it, of samples that `fold` makes one beat of."""
    folder, source = _find(name_or_folder)
    path = folder / "study.toml"
    data, settings = read_toml(path)[0], settings or {}
    where = put_in(data, settings, StudyTable, str(path))
    table = validated(StudyTable, data, where)
    name = visible_name(where, table.name, of_file=True)
    try:
        own = get_conventions(table.conventions)
    except ConventionsError as error:
        raise StudyError(f"{where}: {error}") from None
    chosen = own if conventions is None else get_conventions(conventions)

    network = _file(where, folder, "network", table.network)
    tree = read_network_file(network, settings)
    known = [v.id for v in tree.vessels]
    inflow_note = ""

    inflow_time, inflow, pressure = (np.empty(0) for _ in range(3))
    if table.inlet_pressure is not None:
        if table.inflow is not None:
            raise StudyError(
                f"{where}: inlet_pressure = {short(table.inlet_pressure)}: is given beside inflow, which "
                "follows from it; leave one out"
            )
        inlet_path = _file(where, folder, "inlet_pressure", table.inlet_pressure)
        _, pressure, inflow_note = read_inlet(inlet_path, table.period_s, fold, columns=PRESSURE_COLUMNS)
    elif table.inflow is None:
        raise StudyError(f"{where}: inflow: is missing; add it, or inlet_pressure")
    elif isinstance(table.inflow, dict):
        fetched = validated(FetchedInflowTable, table.inflow, f"{where}: inflow")
        inflow_time, inflow = fetched_inflow(fetched, table.period_s)
    else:
        inflow_path = _file(where, folder, "inflow", table.inflow)
        inflow_time, inflow, inflow_note = read_inlet(inflow_path, table.period_s, fold)
    if inflow.size and not inflow.mean() > 0:
        raise StudyError(
            f"{where}: inflow = {short(table.inflow)}: mean flow_ml_s = {inflow.mean():.6g}: must be "
            "positive; count flow into the root as positive"
        )

    outflow: Array = np.empty(0)
    if table.outflow_pressure is not None:
        outflow_path = _file(where, folder, "outflow_pressure", table.outflow_pressure)
        outflow = read_outflow(outflow_path, table.period_s)
        if constant := tree.given["outflow_pressure_mmHg"]:
            raise StudyError(
                f"{network}: surroundings: outflow_pressure_mmHg = {constant!r}: study.toml gives the "
                "pressure behind the outlets over the beat (outflow_pressure); leave one of the two out"
            )

    time: Array = np.empty(0)
    series: tuple[Series, ...] = ()
    if isinstance(table.observations, dict):
        observed = validated(FetchedObservationsTable, table.observations, f"{where}: observations")
        time, series = fetched_observations(f"{where}: observations", observed, table.period_s, known)
    elif table.observations is not None:
        observations_path = _file(where, folder, "observations", table.observations)
        time, series = read_observations(observations_path, table.period_s, known, fold)

    check_terminals(tree.vessels, tree.places, series, tree.nominal, by_pressure=pressure.size > 0)
    study = Study(
        name=name,
        period_s=table.period_s,
        vessels=tree.vessels,
        inflow_time_s=inflow_time,
        inflow_ml_s=inflow,
        time_s=time,
        series=series,
        conventions=chosen,
        source=source,
        priors=_checked_priors(where, table.priors, table.parameters),
        parameters=table.parameters,
        noise_sd=_checked_noise(where, table.noise_sd, series),
        numerics=checked_numerics(f"{where}: numerics", table.numerics),
        inflow_note=inflow_note,
        outflow_wave_mmHg=outflow,
        inlet_pressure_mmHg=pressure,
        **tree.given,
    )
    warn_of_units(study)
    return study


def _checked_priors(where: str, priors: Mapping[str, Any], held: Mapping[str, float]) -> Mapping[str, Any]:
    """The table of priors, each of which can be read, and none of which is of a parameter that is held."""
    if not (priors or held):
        return priors
    from zoo.blood.prior_tables import PriorsError, check_held, read_priors  # slow, and seldom needed

    try:
        read_priors(priors)
        check_held(held, priors)
    except PriorsError as error:
        raise StudyError(f"{where}: priors: {error}") from None
    return priors


def _checked_noise(where: str, noise_sd: Mapping[str, float], series: Sequence[Series]) -> dict[str, float]:
    """Standard deviations by quantity or series, positive, of series that there are."""
    known = [*QUANTITIES, *(s.label for s in series)]
    for name, value in noise_sd.items():
        if name not in known:
            raise StudyError(f"{where}: noise_sd: {short(name)}: {nearest(name, known)}")
        if not value > 0:
            raise StudyError(f"{where}: noise_sd: {name} = {value!r}: must be positive; correct it")
    return {name: float(value) for name, value in noise_sd.items()}


NO_MEAN_FLOW = (
    "is nominal or missing at a terminal, and cannot be derived without a mean flow, where inlet_pressure is "
    "given instead of inflow; add windkessel = { R1, R2, C } or a resistance, in cgs"
)


class LoadWarning(UserWarning):
    """Loads of a study that are odd: forgotten at some terminals, too fast, or that give energy."""


def root_pressure(vessels: Sequence[Vessel], series: Sequence[Series]) -> Series | None:
    """The observed pressure nearest to the inlet of the root, from which nominal loads can be derived."""
    root = next(v.id for v in vessels if v.parent is None)
    found = [s for s in series if s.vessel == root and s.quantity == "pressure_mmHg"]
    return min(found, key=lambda s: s.position, default=None)


def check_terminals(
    vessels: Sequence[Vessel],
    places: Sequence[str],
    series: Sequence[Series],
    nominal: Collection[int] = (),
    *,
    by_pressure: bool = False,
) -> None:
    """Refuse a terminal without a load that cannot be derived; warn of one that alone has none.

    Parameters
    ----------
    vessels : sequence of Vessel
    places : sequence of str
        Where each of them stands in the file.
    series : sequence of Series
        What is observed.
    nominal : collection of int
        Vessels whose load is to be derived, as their file says.
    by_pressure : bool
        Whether the pressure is given at the root's inlet, and no flow.

    Raises
    ------
    StudyError
        If a terminal has no load, and no pressure is observed in the root, or no flow given there.

    Warns
    -----
    LoadWarning
        If some terminals have a load, and others none without saying so.
    """
    feeding = {v.parent for v in vessels}
    root = next(v.id for v in vessels if v.parent is None)
    ends = [(v, place) for v, place in zip(vessels, places, strict=True) if v.id not in feeding]
    without = [(v, place) for v, place in ends if not v.has_load]
    if without and by_pressure:
        raise StudyError(f"{without[0][1]}: windkessel: {NO_MEAN_FLOW}")
    if without and root_pressure(vessels, series) is None:
        raise StudyError(
            f"{without[0][1]}: windkessel: is missing at a terminal, and cannot be derived without an "
            f"observed pressure_mmHg in the root (vessel {root}); add windkessel = {{ R1, R2, C }} or a "
            "resistance, in cgs"
        )
    forgotten = [(v, place) for v, place in without if v.id not in nominal]
    if forgotten and len(without) < len(ends):
        names = ", ".join(str(v.id) for v, _ in forgotten)
        warnings.warn(
            f"{forgotten[0][1]}: windkessel: is missing at terminal {names}, while other terminals have a "
            "load; a nominal one is derived from "
            f'the pressure observed in the root; add what is missing, or say windkessel = "{NOMINAL}"',
            LoadWarning,
            stacklevel=4,
        )
