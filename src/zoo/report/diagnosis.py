"""The page of a diagnosis, and what it found in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zoo.core.diagnosis import DiagnosisFile
from zoo.core.diagnosis.answer import WRONG
from zoo.core.diagnosis.file import StateFile
from zoo.core.outputs import output_folder
from zoo.plots import (
    QUANTITY_LABELS,
    plot_causes,
    plot_diagnosis,
    plot_discrepancy,
    plot_functions,
    plot_sensitivity,
    plot_states,
    plot_where,
    save_figure,
)
from zoo.plots.impedance import impedance_figure, impedances_of
from zoo.plots.subject import TOLD, percent, study_of, unit_words
from zoo.report import tables
from zoo.report.page import picture_of, write_page
from zoo.report.words import listed, settings_text, span, value_text

if TYPE_CHECKING:
    from zoo.core.diagnosis import Diagnosis

FIGURES = {
    "gap": plot_discrepancy,
    "causes": plot_causes,
    "functions": plot_functions,
    "sensitivity": plot_sensitivity,
    "where": plot_where,
    "states": plot_states,
}
"""Figure -> what draws it."""
BEYOND = 0.1
"""Part of a state's range that was not visited before, from which on that is told."""


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
    lacking = set() if any(c.functions for c in file.components) else {"functions"}
    lacking |= set() if diagnosis.states else {"states"}
    pictures = {}
    for name in (name for name in FIGURES if name not in lacking):
        written.append(save_figure(FIGURES[name](diagnosis), folder / f"{name}.png"))
        pictures[name] = picture_of(written[-1])
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
        next=next_measurement_words(file),
        summary=diagnosis_summary(file),
        facts=_diagnosis_facts(diagnosis),
        where=where_sentences(file),
        tables=tables,
        state_sentences=state_sentences(file),
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


def diagnosis_summary(file: DiagnosisFile) -> list[str]:
    """What a diagnosis found, as a few sentences: verdict, what it depends on, gap, how many causes.

    Parameters
    ----------
    file : DiagnosisFile

    Returns
    -------
    list of str
    """
    gap, unit = file.gap, unit_words(file.gap.unit)
    lines = [f"Verdict: {file.verdict}.", *(f"Warning: {text}." for text in file.warnings)]
    before = f"{span(gap.before, gap.before_interval)}{unit}"
    noise = f"the noise is {gap.noise_floor:.2g}{unit}"
    if not file.cause:
        lines.append(f"The gap between baseline and data is {before}; {noise}.")
    else:
        lines.append(
            f"The gap between baseline and data is {before}, and {span(gap.after, gap.after_interval)}{unit} "
            f"with {listed(file.cause)}: {percent(gap.removed)} of it is removed "
            f"({percent(gap.removed_interval[0])} to {percent(gap.removed_interval[1])}); {noise}."
        )
    if gap.held_out_before is not None and gap.held_out_after is not None:
        lines.append(
            f"In data that were not fitted ({gap.held_out}) the gap goes from "
            f"{gap.held_out_before:.2g} to {gap.held_out_after:.2g}{unit}"
            + (", which is no more than the noise." if gap.held_out_after == 0.0 else ".")
        )
    number = [f"{k or 'none'} ({percent(p)})" for k, p in enumerate(file.number) if p >= TOLD]
    lines.append(
        f"Number of causes that act together: {listed(number)}. "
        f"That noise alone explains the data has a probability of {percent(file.no_gap)}."
    )
    lines += [
        f"The {c.name} cannot be told from the {' or the '.join(c.confounded)} in these data: that any of "
        f"them is wrong has a probability of {percent(c.group_probability)}."
        for c in file.components
        if c.confounded
    ]
    if file.missed >= TOLD and file.linear_error <= WRONG:  # else a warning says so
        lines.append(
            f"Sets of causes that were not solved by simulation may hold up to {percent(file.missed)} of the "
            f"probability: the linear model gives their log evidence to {file.linear_error:.1f}."
        )
    lines += state_sentences(file)
    if file.failed:
        lines.append(f"The solver failed wherever these were tried: {listed(file.failed)}.")
    return lines


def next_measurement_words(file: DiagnosisFile) -> str:
    """What to measure next: such as "flow in vessel 5 at 0.5 of its length"; empty where nothing would tell.

    Parameters
    ----------
    file : DiagnosisFile

    Returns
    -------
    str
    """
    words = {} if file.next_measurement is None else file.next_measurement.model_extra or {}
    if {"quantity", "vessel", "position"} <= set(words):
        quantity = QUANTITY_LABELS[words["quantity"]].partition(" (")[0]
        return f"{quantity} in vessel {words['vessel']} at {words['position']:g} of its length"
    return ", ".join(f"{name} {value_text(value)}" for name, value in words.items())


def _diagnosis_facts(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    data, file, study = diagnosis.data, diagnosis.file, study_of(diagnosis)
    series = ", ".join(f"{label} ({data.n_times} samples)" for label in data.labels)
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


def where_sentences(file: DiagnosisFile) -> list[str]:
    """Where the gap lies: a sentence each on phases, harmonics, series and locations."""
    where = file.where
    lines = []
    for what, shares in (("phase", where.phase), ("harmonic", where.harmonic), ("series", where.series)):
        named = [f"{name} ({percent(share)})" for name, share in shares.items() if share >= TOLD]
        lines.append(f"By {what}: {', '.join(named) or 'nothing'}.")
    lines.append(f"Probability that a listed effect acts there: {tables.places_text(where.place) or 'none'}.")
    return lines


def state_sentences(file: DiagnosisFile) -> list[str]:
    """For each other state what is left there, and what holds."""
    leading = next((row.components for row in file.sets if row.solved), [])
    return [_state_sentence(state, set(leading)) for state in file.states]


def _state_sentence(state: StateFile, components: set[str]) -> str:
    unit = unit_words(state.unit)
    lines = [
        f"In {state.state}, its parameters fitted again, the baseline misses by {state.baseline.mean:.2g}"
    ]
    if state.sensor is not None:
        lines.append(f"with the discrepancy that was seen at the sensor by {state.sensor.mean:.2g}")
    leader = next((c for c in state.carried if set(c.names) == components), None)
    if leader is not None:
        lines.append(f"with what was learned of {listed(leader.names)} by {leader.error.mean:.2g}")
    holding = [listed(c.names) for c in state.carried if c.holds]
    told = f"what holds there: {', '.join(holding)}" if holding else "nothing that was learned holds there"
    text = f"{', '.join(lines)}{unit}; {told}"
    if leader is not None and leader.beyond is not None and leader.beyond > BEYOND:
        text += f" ({percent(leader.beyond)} of the range there was not visited before)"
    return f"{text}."
