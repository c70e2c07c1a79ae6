"""The page of a diagnosis, and what it found in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zoo.blood.effects import CATALOGUE
from zoo.core.diagnosis import DiagnosisFile
from zoo.core.diagnosis.file import AddedStep, HypothesisResult, StateFile
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, NULL
from zoo.core.outputs import output_folder
from zoo.plots import (
    plot_components,
    plot_diagnosis,
    plot_discrepancy,
    plot_functions,
    plot_hypotheses,
    plot_states,
    plot_where,
    save_figure,
)
from zoo.plots.impedance import impedance_figure, impedances_of
from zoo.plots.subject import at_most, location_of, study_of, unit_words
from zoo.report.components import TOLD, component_rows, function_rows
from zoo.report.page import picture_of, write_page
from zoo.report.parameters import MEANINGS
from zoo.report.words import estimate, listed, percent, settings_text, span, value_text

if TYPE_CHECKING:
    from zoo.core.diagnosis import Diagnosis

FIGURES = {
    "gap": plot_discrepancy,
    "hypotheses": plot_hypotheses,
    "where": plot_where,
    "components": plot_components,
    "functions": plot_functions,
    "states": plot_states,
}
"""Figure -> what draws it."""
BEYOND = 0.1
"""Part of a state's range that was not visited before, from which on that is told."""
MADE_UP = {
    NULL: "Null hypothesis: noise explains what the baseline leaves.",
    NONPARAMETRIC: "Nonparametric discrepancy: something smooth that is not listed.",
}
"""Explanations outside the catalogue."""


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
    lacking = set() if file.components else {"components", "functions"}
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
        unit=file.gap.unit,
        study=study_of(diagnosis),
        nan=math.nan,
        next=_next_words(file),
        summary=diagnosis_summary(file),
        facts=_diagnosis_facts(diagnosis),
        where=where_sentences(file),
        hypotheses=[hypothesis_row(h, file) for h in file.hypotheses],
        components=component_rows(file),
        told=TOLD,
        unit_words=unit_words,
        functions=function_rows(file),
        state_sentences=state_sentences(file),
        spikes=impedances["measured"].sentences() if impedances else [],
        meanings=MEANINGS,
        location=partial(location_of, file),
        posteriors=sorted((file.posteriors or {}).items(), key=_worth, reverse=True),
        pictures=pictures,
        command=command,
    )
    return written


def total_seconds(record: Mapping[str, Any]) -> float:
    """Time of a diagnosis: of its screening, and of sampling the posteriors if that was done.

    Parameters
    ----------
    record : mapping
        Of a `DiagnosisFile`.

    Returns
    -------
    float
        s; NaN if the record has no time of the screening.
    """
    return float(record.get("screening_seconds", math.nan)) + float(record.get("posterior_seconds", 0.0))


def diagnosis_summary(file: DiagnosisFile) -> list[str]:
    """What a diagnosis found, as a few sentences: verdict, discrepancy, held-out data, what is left.

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
    floor = f"the noise {gap.noise_floor:.2g}{unit}"
    if file.hypotheses[0].name in (NULL, NONPARAMETRIC, CORRELATED):
        lines.append(f"Beside the noise the baseline leaves a discrepancy of {before}; {floor}.")
    else:
        lines.append(
            f"The discrepancy of the baseline is {before}, with its cause "
            f"{span(gap.after, gap.after_interval)}{unit}: {percent(gap.removed)} is removed "
            f"({percent(gap.removed_interval[0])} to {percent(gap.removed_interval[1])}); {floor}."
        )
    if gap.held_out_before is not None and gap.held_out_after is not None:
        lines.append(
            f"In data that were not fitted ({gap.held_out}) the discrepancy goes from "
            f"{gap.held_out_before:.2g} to {gap.held_out_after:.2g}{unit}"
            + (", what it misses there being no more than the noise." if gap.held_out_after == 0.0 else ".")
        )
    lines += state_sentences(file)
    if len(file.steps) > 1:
        lines.append(
            f"One after the other were added: {'; '.join(_step(step, file) for step in file.steps)}."
        )
    if file.failed:
        lines.append(f"The solver failed wherever these were tried: {listed(file.failed)}.")
    return lines


def _sizes(step: AddedStep) -> str:
    return ", ".join(f"{a.name} {estimate(a.mean, a.sd, a.unit)}" for a in step.amplitudes)


def _step(step: AddedStep, file: DiagnosisFile) -> str:
    where = "" if step.place is None else f" ({location_of(file, step.place, step.subtree)})"
    return (
        f"{step.name}{where}, {percent(step.probability)} probable, {_sizes(step)}: "
        f"{step.gap_before:.2g} to {step.gap_after:.2g}{unit_words(file.gap.unit)}"
    )


def next_measurement_words(file: DiagnosisFile) -> str:
    """What to measure next: such as "flow_ml_s in vessel 5 at 0.5"; empty where nothing would tell.

    Parameters
    ----------
    file : DiagnosisFile

    Returns
    -------
    str
    """
    if file.next_measurement is None:
        return ""
    words = file.next_measurement.model_extra or {}
    if {"quantity", "vessel", "position"} <= set(words):
        return f"{words['quantity']} in vessel {words['vessel']} at {words['position']:g}"
    return ", ".join(f"{name} {value_text(value)}" for name, value in words.items())


def _next_words(file: DiagnosisFile) -> str:
    """The same as the beginning of a sentence."""
    words = next_measurement_words(file)
    for quantity, name in (("pressure_mmHg", "Pressure"), ("flow_ml_s", "Flow")):
        if words.startswith(f"{quantity} in vessel"):
            return words.replace(quantity, name, 1) + " of its length"
    return words[:1].upper() + words[1:]


def _diagnosis_facts(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    data, file, study = diagnosis.data, diagnosis.file, study_of(diagnosis)
    series = ", ".join(f"{label} ({data.n_times} samples)" for label in data.labels)
    record = file.record
    noise = [
        f"{quantity}: " + ", ".join(f"{name} {value_text(value)}" for name, value in errors.items())
        for quantity, errors in record.get("noise", {}).items()
    ]
    if study is None:
        facts = [("data", data.name)]
    else:
        facts = [("study", f"{study.name}, {len(study.vessels)} vessels, period {1e3 * study.period_s:g} ms")]
    facts += [("observed", series), ("checksum", file.study_checksum), ("baseline", file.base)]
    facts += [] if study is None else [("conventions", study.conventions.name)]
    facts.append(("errors", "; ".join(noise)))
    wanted = ("started", "seed", "cores", "solves", "failed_solves", "screening_seconds", "posterior_seconds")
    told = {name: record.get(name) for name in wanted}
    if told["posterior_seconds"] is not None:
        told["total_seconds"] = total_seconds(record)
    for name, value in told.items():
        if value is not None:
            facts.append((name.replace("_", " "), f"{value:.1f}" if isinstance(value, float) else str(value)))
    facts.append(("versions", settings_text(record.get("versions", {}))))
    return facts


def where_sentences(file: DiagnosisFile) -> list[str]:
    """Where the discrepancy lies: a sentence each on phases, harmonics, series and locations."""
    where = file.where
    lines = []
    for what, shares in (("phase", where.phase), ("harmonic", where.harmonic), ("series", where.series)):
        named = [f"{name} ({percent(share)})" for name, share in shares.items() if share >= 0.005]
        lines.append(f"By {what}: {', '.join(named) or 'nothing'}.")
    found = [f"{location_of(file, p.part, p.subtree)} ({percent(p.probability)})" for p in where.place[:5]]
    lines.append(f"Location: {', '.join(found) or 'unknown'}.")
    return lines


def hypothesis_row(h: HypothesisResult, file: DiagnosisFile) -> dict[str, Any]:
    """An explanation with the cells of its row."""
    zero = next(x.log_evidence for x in file.hypotheses if x.name == NULL)
    parameters = [a for a in (h.amplitude, *h.other_amplitudes) if a is not None]
    free = h.name in (NONPARAMETRIC, CORRELATED)
    size = ", ".join(
        f"{a.name} " + (f"{a.mean:.3g} {a.unit}" if free else estimate(a.mean, a.sd, a.unit))
        for a in parameters
    )
    return {
        "name": h.name,
        "statement": CATALOGUE[h.name].statement if h.name in CATALOGUE else MADE_UP.get(h.name, ""),
        "hidden": h.name in file.invisible,
        "cells": [
            "" if h.place is None else location_of(file, h.place, h.subtree),
            "invisible" if h.name in file.invisible else percent(h.probability),
            "" if h.prior_probability is None else "= " * h.prior_made + percent(h.prior_probability),
            str(h.group),
            f"{(h.log_evidence - zero) / math.log(10.0):+.1f}",
            size,
            "" if free else at_most(h) + span(h.gap_after, h.gap_after_interval),
            f"{h.residual_rms:.3g}",
        ],
    }


def _worth(posterior: tuple[str, Mapping[str, Any]]) -> float:
    """What posteriors are ordered by: the marginal likelihood, which may be missing."""
    value = posterior[1]["log_marginal_likelihood"]
    return -math.inf if value is None else float(value)


def state_sentences(file: DiagnosisFile) -> list[str]:
    """For each other state what is left there, and whose functions hold."""
    return [_state_sentence(state, file.cause) for state in file.states]


def _state_sentence(state: StateFile, cause: list[str]) -> str:
    unit = unit_words(state.unit)
    lines = [
        f"In {state.state}, its parameters fitted again, the baseline misses by {state.baseline.mean:.2g}"
    ]
    if state.sensor is not None:
        lines.append(f"with the discrepancy that was seen at the sensor by {state.sensor.mean:.2g}")
    leader = next((c for c in state.carried if set(c.names) & set(cause)), None)
    if leader is not None:
        lines.append(f"with what was learned of {listed(leader.names)} by {leader.error.mean:.2g}")
    holding = [listed(c.names) for c in state.carried if c.holds]
    told = f"what holds there: {', '.join(holding)}" if holding else "nothing that was learned holds there"
    text = f"{', '.join(lines)}{unit}; {told}"
    if leader is not None and leader.beyond is not None and leader.beyond > BEYOND:
        text += f" ({percent(leader.beyond)} of the range there was not visited before)"
    return f"{text}."
