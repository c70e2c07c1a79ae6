"""The page of a diagnosis, and what it found in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zoo.blood.effects import CATALOGUE
from zoo.core.diagnosis import DiagnosisFile
from zoo.core.diagnosis.file import AddedStep, HypothesisResult, SeriesGap
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
from zoo.report.components import component_rows, component_sentences, function_rows
from zoo.report.page import picture_of, write_page
from zoo.report.parameters import MEANINGS
from zoo.report.states import state_rows, state_sentences
from zoo.report.words import estimate, listed, maybe, percent, settings_text, span, value_text

if TYPE_CHECKING:
    from zoo.core.diagnosis import Diagnosis

DIAGNOSIS_FIGURES = {
    "gap": (
        plot_discrepancy,
        "What was observed, the baseline, and the baseline with its cause; below, the discrepancy of each "
        "with 95 % bands, and one standard deviation of the noise in grey.",
    ),
    "hypotheses": (
        plot_hypotheses,
        "Log evidence of each explanation below that of the best, its probability, and the discrepancy it "
        "leaves; ≤: found by one search only, and not to be compared.",
    ),
    "where": (
        plot_where,
        "Shares of the discrepancy's energy, and the tree with the probability that a listed cause acts in a "
        "vessel.",
    ),
}
"""Figure -> what draws it, and its caption."""
COMPONENT_FIGURES = {
    "components": (
        plot_components,
        "Probability that a component holds the main cause, the share of the discrepancy's energy that it "
        "holds beside all others, and the discrepancy that it would leave, with 95 % intervals; hollow: "
        "held-out data do not confirm it.",
    ),
    "functions": (
        plot_functions,
        "What was learned of the most probable components beside the baseline (0), with 95 % bands; grey: "
        "95 % of the prior.",
    ),
}
"""The same where components of the simulator were weighed."""
STATE_FIGURES = {
    "states": (
        plot_states,
        "What is left of each series in other states, the baseline's parameters fitted again: by the "
        "baseline, with the discrepancy that was seen at the sensor, and with functions as they were "
        "learned; grey: one standard deviation of the noise.",
    )
}
"""The same where other states were given."""
MADE_UP = {
    NULL: "Null hypothesis: noise explains what the baseline leaves.",
    NONPARAMETRIC: "Nonparametric discrepancy: something smooth that is not listed.",
}
"""Explanations outside the catalogue."""


def diagnosis_files() -> tuple[str, ...]:
    """Names of the files that `write_diagnosis` may write; not all are always there."""
    figures = (*DIAGNOSIS_FIGURES, *COMPONENT_FIGURES, *STATE_FIGURES, "impedance", "diagnosis")
    return "diagnosis.json", "report.html", *(f"{name}.png" for name in figures)


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
    written = [diagnosis.save(folder), folder / "report.html"]
    pictures = {}
    figures = DIAGNOSIS_FIGURES | (COMPONENT_FIGURES if diagnosis.file.components else {})
    figures |= STATE_FIGURES if diagnosis.states else {}
    for name, (draw, caption) in figures.items():
        if name == "where" and study_of(diagnosis) is None:
            caption = (
                "Shares of the discrepancy's energy, and the probability of each location of a listed cause."
            )
        written.append(save_figure(draw(diagnosis), folder / f"{name}.png"))
        pictures[name] = picture_of(written[-1], f"{caption} The tables have the numbers.", caption)
    impedances = impedances_of(diagnosis)
    if impedances:
        caption = (
            "Input impedance at the root, by harmonic: observed pressure over the recorded inflow, with 95 % "
            "intervals, and as modelled; hollow: the flow's harmonic is nearly zero."
        )
        written.append(save_figure(impedance_figure(impedances), folder / "impedance.png"))
        pictures["impedance"] = picture_of(written[-1], caption, caption)
    written.append(save_figure(plot_diagnosis(diagnosis), folder / "diagnosis.png"))
    file = diagnosis.file
    write_page(
        written[1],
        "diagnosis.html",
        title=f"What {file.base} misses in {file.study}",
        file=file,
        unit=file.gap.unit,
        next=_next_words(file),
        summary=diagnosis_summary(file),
        facts=_diagnosis_facts(diagnosis),
        discrepancy=[_discrepancy_row(row) for row in file.gap.per_series],
        where=where_sentences(file),
        hypotheses=[hypothesis_row(h, file) for h in file.hypotheses],
        groups=_groups(file),
        components=component_rows(file),
        component_sentences=component_sentences(file),
        functions=function_rows(file),
        states=state_rows(file),
        state_sentences=state_sentences(file),
        spikes=impedances["measured"].sentences() if impedances else [],
        moved=_moved(file),
        steps=[_step_row(step, file) for step in file.steps],
        posteriors=_posterior_rows(file),
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


def _step_row(step: AddedStep, file: DiagnosisFile) -> dict[str, Any]:
    return {
        "name": step.name,
        "where": "" if step.place is None else location_of(file, step.place, step.subtree),
        "probability": f"{100 * step.probability:.0f} %",
        "sizes": _sizes(step),
        "discrepancies": [f"{step.gap_before:.2g}", f"{step.gap_after:.2g}"],
    }


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


def _discrepancy_row(row: SeriesGap) -> list[str]:
    removed = 1.0 - row.after.mean / row.before.mean if row.before.mean > 0 else 0.0
    return [
        row.series,
        row.unit,
        span(row.before.mean, (row.before.low, row.before.high)),
        span(row.after.mean, (row.after.low, row.after.high)),
        percent(max(0.0, removed)),
        f"{row.noise_floor:.2g}",
        f"{row.residual_rms_before:.3g}",
        f"{row.residual_rms_after:.3g}",
    ]


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


def _groups(file: DiagnosisFile) -> list[str]:
    members: dict[int, list[str]] = {}
    for h in file.hypotheses:
        members.setdefault(h.group, []).append(h.name)
    return [
        f"Group {group}: {listed(names)} explain these data alike and cannot be told apart, so the "
        "answer is the group."
        for group, names in members.items()
        if len(names) > 1
    ]


def _moved(file: DiagnosisFile) -> list[list[str]]:
    """Parameters of the baseline, without and with the cause, and the shift in standard deviations."""
    before, after = (file.base_parameters.get(key, {}) for key in ("base", "with cause"))
    rows = []
    for name, value in before.items():
        if name.endswith(" sd") or name not in after:
            continue
        sds = [values.get(f"{name} sd", float("nan")) for values in (before, after)]
        shift = after[name] - value
        spread = sds[0] if sds[0] > 0 else float("nan")
        rows.append(
            [
                name,
                MEANINGS.get(name, ("", ""))[0],
                MEANINGS.get(name, ("", "–"))[1],
                estimate(value, sds[0], "1"),
                estimate(after[name], sds[1], "1"),
                f"{shift:+.3g}",
                f"{shift / spread:+.1f}",
            ]
        )
    return rows


def _posterior_rows(file: DiagnosisFile) -> list[dict[str, Any]]:
    """Rows of the posteriors that were sampled, best marginal likelihood first."""
    rows = []
    found = file.posteriors or {}

    def worth(name: str) -> float:
        value = found[name]["log_marginal_likelihood"]
        return -np.inf if value is None else float(value)

    for name in sorted(found, key=worth, reverse=True):
        row = found[name]
        difference = (row["elpd_waic_difference"], row["elpd_waic_difference_se"])
        parameters = ", ".join(
            f"{key} {estimate(value['mean'], value['sd'], '1')}" for key, value in row["parameters"].items()
        )
        rows.append(
            {
                "name": name,
                "converged": bool(row["converged"]),
                "verdict": row["verdict"],
                "parameters": parameters,
                "cells": [
                    maybe(row["log_marginal_likelihood"], row["log_marginal_likelihood_se"]),
                    maybe(row["elpd_waic"]),
                    maybe(*difference),
                    maybe(row["elpd_loo"]),
                ],
            }
        )
    return rows
