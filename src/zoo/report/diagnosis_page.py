"""The page of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zoo.core.diagnosis import DiagnosisFile
from zoo.core.outputs import output_folder
from zoo.core.words import percent
from zoo.plots import (
    plot_causes,
    plot_diagnosis,
    plot_discrepancy,
    plot_functions,
    plot_sensitivity,
    plot_states,
    plot_where,
    save_figure,
)
from zoo.plots.causes import learned_functions
from zoo.plots.root_impedance import impedance_figure, impedances_of
from zoo.plots.subject import TOLD, study_of
from zoo.report import tables
from zoo.report.filters import settings_text, value_text
from zoo.report.page import picture_of, write_page

if TYPE_CHECKING:
    from zoo.core.diagnosis import Diagnosis

FIGURES: dict[str, Callable[..., Any]] = {
    "gap": plot_discrepancy,
    "causes": plot_causes,
    "functions": plot_functions,
    "sensitivity": plot_sensitivity,
    "where": plot_where,
    "states": plot_states,
}
"""Figure -> what draws it."""


def diagnosis_files() -> tuple[str, ...]:
    """Names of the files that `write_diagnosis` may write; not all are always there."""
    figures = (f"{name}.png" for name in (*FIGURES, "impedance", "diagnosis"))
    return "diagnosis.json", "report.html", *figures


def write_diagnosis(diagnosis: Diagnosis, folder: str | Path, *, command: str = "") -> list[Path]:
    """Write a diagnosis into a folder: diagnosis.json, a self-contained report.html, and its figures.

    Parameters
    ----------
    diagnosis : Diagnosis
    folder : path
        Made if it is missing.
    command : str
        The command that made it, for the page.

    Returns
    -------
    list of Path
        The written files.

    Raises
    ------
    zoo.core.outputs.OutputFileError
        If the folder is a file, what it lies in does not exist, or a file in it cannot be written.
    """
    folder = output_folder(folder, diagnosis_files())
    file = diagnosis.file
    written = [diagnosis.save(folder), folder / "report.html"]
    lacking = set() if learned_functions(diagnosis, TOLD) else {"functions"}
    lacking |= set() if diagnosis.states else {"states"}
    pictures = {}
    for name, draw in FIGURES.items():
        if name not in lacking:
            written.append(save_figure(draw(diagnosis), folder / f"{name}.png"))
            pictures[name] = picture_of(written[-1])
            if name != "states":
                narrow = picture_of(draw(diagnosis, narrow=True))
                pictures[name] = pictures[name]._replace(narrow=narrow.source)
    impedances = impedances_of(diagnosis)
    if impedances:
        written.append(save_figure(impedance_figure(impedances), folder / "impedance.png"))
        pictures["impedance"] = picture_of(written[-1])
    written.append(save_figure(plot_diagnosis(diagnosis), folder / "diagnosis.png"))
    write_page(
        written[1],
        "diagnosis.html",
        title=f"What {file.base} misses in {file.study}",
        file=file,
        study=study_of(diagnosis),
        facts=_diagnosis_facts(diagnosis),
        where=where_sentences(file, periodic=diagnosis.data.period is not None),
        tables=tables,
        spikes=impedances["measured"].sentences() if impedances else [],
        pictures=pictures,
        command=command,
    )
    return written


def total_seconds(record: Mapping[str, Any]) -> float:
    """Time of a diagnosis, with that of other states and of sampling posteriors if that was done.

    Parameters
    ----------
    record : mapping
        Of a `DiagnosisFile`.

    Returns
    -------
    float
        s; NaN if the record has no time.
    """
    rest = sum(float(record.get(name, 0.0)) for name in ("states_seconds", "posterior_seconds"))
    return float(record.get("seconds", math.nan)) + rest


def _diagnosis_facts(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    data, file, study = diagnosis.data, diagnosis.file, study_of(diagnosis)
    samples = zip(data.labels, data.measured.sum(axis=1), strict=True)
    series = ", ".join(f"{label} ({n} samples)" for label, n in samples)
    record = file.record
    noise = ", ".join(f"{group} {value_text(rms)}" for group, rms in record["noise"].items())
    if study is None:
        facts = [("data", data.name)]
    else:
        facts = [("study", f"{study.name}, {len(study.vessels)} vessels, period {1e3 * study.period_s:g} ms")]
    facts += [("observed", series), ("checksum", file.study_checksum), ("baseline", file.base)]
    facts += [] if study is None else [("conventions", study.conventions.name)]
    facts.append(("noise, rms", noise))
    seconds = ("seconds", "states_seconds", "posterior_seconds")
    told = ("started", "seed", "cores", "solves", "failed_solves", "component_sizes", *seconds)
    facts += [(name.replace("_", " "), _fact(record[name])) for name in told if name in record]
    facts.append(("total seconds", _fact(total_seconds(record))))
    facts.append(("versions", settings_text(record.get("versions", {}))))
    return facts


def _fact(value: Any) -> str:
    return f"{value:.1f}" if isinstance(value, float) else str(value)


def where_sentences(file: DiagnosisFile, *, periodic: bool) -> list[str]:
    """Where the model error lies: a sentence each on phases, harmonics of a period, series and locations."""
    where = file.where
    shares = [("phase", where.phase), *[("harmonic", where.harmonic)] * periodic, ("series", where.series)]
    lines = []
    for what, values in shares:
        named = [f"{name} ({percent(share)})" for name, share in values.items() if share >= TOLD]
        if len(values) > 1 and named:
            lines.append(f"By {what}: {', '.join(named)}.")
    if any(place.part is not None for place in where.place):
        lines.append(f"Probability that a listed effect acts there: {tables.places_text(where.place)}.")
    return lines
