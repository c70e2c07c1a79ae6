"""One study's part of the page: comparison, fits, convergence, how the posteriors were made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from zoo.blood.predictive import median_waves, one_place, predictive_draws, vessel_waves
from zoo.blood.study import suspect_units
from zoo.core.inference.convergence import Diagnostics, diagnostics
from zoo.core.inference.record import RunRecord
from zoo.core.posterior.comparison import compare
from zoo.models import MODELS, get_model
from zoo.paper.convergence import paper_tests
from zoo.plots import comparison_figure, fit_figure, forest_figure, models_figure, pair_figure, rank_figure
from zoo.report.page import ReportError, picture_of
from zoo.report.parameters import parameter_rows
from zoo.report.sentences import CRITERION, summary
from zoo.report.words import listed, settings_text, with_error

if TYPE_CHECKING:
    import arviz as az
    import pandas as pd
    import pymc as pm

    from zoo.blood.study import Study

WAVE_DRAWS = 60


@dataclass(frozen=True)
class Chapter:
    """One study's part of the page.

    Parameters
    ----------
    name : str
        Of the study.
    posteriors : mapping of model to InferenceData
        Drawn by `zoo.sample`, or slimmed by `zoo.core.posterior.storage.slim`.
    study : Study, optional
        Without it there are no fits and no ranking, and the chapter says so.
    models : mapping of model to pm.Model
        One for each posterior; needed for fits and ranking.
    table : DataFrame, optional
        From `zoo.compare`; made here if absent.
    note : str
        A paragraph under the heading.
    commands : sequence of str
        Run before those that make the posteriors, which come from their records.
    """

    name: str
    posteriors: Mapping[str, az.InferenceData]
    study: Study | None = None
    models: Mapping[str, pm.Model] = field(default_factory=dict)
    table: pd.DataFrame | None = None
    note: str = ""
    commands: Sequence[str] = ()


def sampling_command(record: RunRecord) -> str:
    """The `zoo sample` that makes a posterior again.

    Parameters
    ----------
    record : RunRecord

    Returns
    -------
    str
    """
    settings = record.settings
    target = settings.get("until_ess")
    draws = settings.get("first check" if target else "draws")
    options = {
        "--chains": settings.get("chains"),
        "--draws": draws,
        "--tune": settings.get("tune"),
        "--thin": settings.get("thin"),
        "--until": f"ess={target:g}" if target else "none",
        "--seed": record.seed,
    }
    words = ["zoo", "sample", record.model, record.study]
    words += [f"{option} {value}" for option, value in options.items() if value is not None]
    return " ".join([*words, "-o", f"{record.model}.nc"])


def part_of(
    chapter: Chapter, anchor: str, ic: str, n_draws: int, say: Callable[[str], None]
) -> dict[str, Any]:
    """What the template shows of a chapter."""
    posteriors = chapter.posteriors
    checks = {
        name: diagnostics(idata, paper_tests, model=chapter.models.get(name))
        for name, idata in posteriors.items()
    }
    records = {name: RunRecord.of(idata) for name, idata in posteriors.items()}
    table = chapter.table
    if chapter.study is not None and posteriors:
        if missing := [name for name in posteriors if name not in chapter.models]:
            raise ReportError(
                f"{chapter.name}: posterior {missing[0]!r} has no model; give one, or leave it out"
            )
        if table is None:
            say(f"{chapter.name}: scoring {', '.join(posteriors)}")
            found = {name: check.verdict for name, check in checks.items()}
            table = compare(posteriors, chapter.models, ic=ic, n_draws=n_draws, verdicts=found)  # type: ignore[arg-type]
    failing = [name for name, check in checks.items() if not check.verdict.passes]
    pictures: dict[str, Any] = {}
    if table is not None and len(table) > 1:
        caption = f"{CRITERION[table.attrs.get('ic', 'waic')]} of each model and its difference to the best."
        pictures["ranking"] = picture_of(
            comparison_figure(table), f"{caption} The table has the numbers.", caption
        )
    if posteriors:
        caption = "Medians, 50 % (thick) and 95 % (thin) intervals of the parameters that are single numbers."
        alt = f"{caption} The tables below have the numbers."
        pictures["forest"] = picture_of(forest_figure(posteriors), alt, caption)
    if posteriors and chapter.study is not None:
        say(f"{chapter.name}: waves in the vessels")
        medians = {
            name: median_waves(one_place(vessel_waves(chapter.models[name], idata, n_draws=WAVE_DRAWS)))
            for name, idata in posteriors.items()
        }
        quantities = dict.fromkeys(series.quantity for series in chapter.study.series)
        pictures["waves"] = [
            picture_of(models_figure(medians, chapter.study, quantity=quantity), caption, caption)
            for quantity, caption in ((q, _waves_caption(q)) for q in quantities)
        ]
    details = []
    for name in posteriors:
        say(f"{chapter.name}: model {name}")
        details.append(_model_part(name, chapter, checks[name], records[name], f"{anchor}-{name.lower()}"))
    return {
        "name": chapter.name,
        "anchor": anchor,
        "note": chapter.note,
        "warnings": [] if chapter.study is None else list(map(str, suspect_units(chapter.study))),
        "facts": _facts(chapter, records),
        "failing": failing,
        "summary": summary(table, checks, records) if posteriors else [],
        "ranking": [] if table is None else _ranking(table),
        "criterion": "" if table is None else CRITERION[table.attrs.get("ic", "waic")],
        "scored": "" if table is None else str(int(table["draws"].max())),
        "pictures": pictures,
        "models": details,
        "checks": [_check_row(name, checks[name], records[name]) for name in posteriors],
        "runs": [_run_row(records[name]) for name in posteriors],
        "commands": [*chapter.commands, *(sampling_command(record) for record in records.values())],
        "data": chapter.study is not None,
    }


def _waves_caption(quantity: str) -> str:
    return (
        f"Median {quantity.split('_')[0]} of {WAVE_DRAWS} draws of each model at the inlet of the root and "
        "midway in the others; last, observed minus median. Where nothing was observed it is prediction."
    )


def _facts(chapter: Chapter, records: Mapping[str, RunRecord]) -> list[tuple[str, str]]:
    """What a study is and how its equations were solved."""
    facts = []
    study = chapter.study
    if study is not None:
        series = ", ".join(f"{s.label} ({len(s.value)} samples)" for s in study.series)
        facts += [("vessels", str(len(study.vessels))), ("period", f"{1e3 * study.period_s:g} ms")]
        facts += [("observed", series), ("checksum", study.checksum)]
        if not records:
            facts.append(("conventions", study.conventions.name))
    else:
        facts += [("checksum", value) for value in sorted({r.study_checksum for r in records.values()})]
    for label, get in (
        ("conventions", lambda record: settings_text(record.conventions)),
        ("solver", lambda record: _solver_text(record.solver)),
        ("seed", lambda record: str(record.seed)),
    ):
        which: dict[str, list[str]] = {}
        for name, record in records.items():
            which.setdefault(get(record), []).append(name)
        for value, names in which.items():
            facts.append((label if len(which) == 1 else f"{label} of {listed(names)}", value))
    return facts


def _solver_text(solver: Mapping[str, Any]) -> str:
    """Settings of the solver that say something, and the cells in words."""
    settings = {name: value for name, value in solver.items() if name != "grid" and value not in ([], ())}
    return "; ".join(filter(None, [settings_text(settings), solver.get("grid", "")]))


def _ranking(table: pd.DataFrame) -> list[dict[str, Any]]:
    rows = []
    for model, row in table.iterrows():
        cells = [
            with_error(row["waic"], row["waic_se"]),
            with_error(row["difference"], row["difference_se"]),
            f"{row['weight']:.2f}",
            with_error(row["loo"], row["loo_se"]),
            str(int(row["pareto_k_bad"])),
            f"{row['waic_one_observation']:.1f}",
            f"{row['p_waic']:.1f}",
            ", ".join(f"{row[name]:.3g} {unit}" for name, unit in table.attrs["sums_of_squares"].items()),
        ]
        converged = bool(row["converged"])
        rows.append(
            {"model": str(model), "cells": cells, "standing": row["standing"], "converged": converged}
        )
    return rows


def _model_part(
    name: str, chapter: Chapter, check: Diagnostics, record: RunRecord, anchor: str
) -> dict[str, Any]:
    idata = chapter.posteriors[name]
    posterior = idata["posterior"]
    shown = [str(n) for n in posterior.data_vars if "time" not in posterior[n].dims]
    single = [n for n in shown if posterior[n].ndim == 2]
    pictures = []
    where = f"model {name} on {chapter.name}"
    if chapter.study is not None:
        means, predictions = predictive_draws(chapter.models[name], idata)
        caption = (
            "Observations, posterior median, 95 % credible band of the model's waveform and 95 % band of "
            "predicted observations; below, the residual to the median."
        )
        pictures.append(
            picture_of(fit_figure(chapter.study, means, predictions), f"Fit of {where}. {caption}", caption)
        )
    caption = "Ranks of each chain's draws among all; bars at the dashed line where the chains agree."
    pictures.append(picture_of(rank_figure(idata, single), f"Rank plots of {where}. {caption}", caption))
    if len(single) > 1:
        caption = "Draws of pairs of parameters, marginal densities on the diagonal."
        pictures.append(picture_of(pair_figure(idata, single), f"Pair plots of {where}. {caption}", caption))
    rows = parameter_rows(posterior, shown, check, chapter.models.get(name))
    return {
        "name": name,
        "anchor": anchor,
        "about": _about(name),
        "text": check.verdict.text[:1].upper() + check.verdict.text[1:],
        "passes": check.verdict.passes,
        "single": [row for row in rows if "[" not in row.name],
        "many": [row for row in rows if "[" in row.name],
        "pictures": pictures,
        "draws": posterior.sizes["chain"] * posterior.sizes["draw"],
        "whole": check.verdict.chains * check.verdict.draws,
    }


def _about(name: str) -> str:
    """First line of a model's docstring, for the models of this package."""
    if name not in MODELS:
        return ""  # with effects it is another one
    return (get_model(name).__doc__ or "").strip().splitlines()[0]


def _check_row(name: str, check: Diagnostics, record: RunRecord) -> dict[str, Any]:
    found = check.verdict
    p_values = [p for values in check.further.get("geweke", {}).values() for p in values if np.isfinite(p)]
    below = sum(p < 0.05 for p in p_values)
    rates = (
        [f"{100 * rate:.0f}" for rate in (min(check.acceptance), max(check.acceptance))]
        if check.acceptance
        else []
    )
    failures = ", ".join(f"{n} {status}" for status, n in record.failures.items()) or "none"
    parameters = found.parameters
    cells = [
        f"{found.chains} × {found.draws}",
        f"{found.max_rhat:.3f}",
        f"{min((p.ess_bulk for p in parameters), default=np.nan):.0f}",
        f"{min((p.ess_tail for p in parameters), default=np.nan):.0f}",
        f"{check.further.get('mpsrf', np.nan):.3f}",
        f"{below} of {len(p_values)}" if p_values else "too few draws",
        "–" if not rates else rates[0] if rates[0] == rates[1] else f"{rates[0]} to {rates[1]}",
        f"{record.solves + record.mode_evaluations}",
        failures,
        f"{record.wall_seconds / 60:.1f}",
    ]
    return {"model": name, "passes": found.passes, "cells": cells}


def _run_row(record: RunRecord) -> list[str]:
    settings = record.settings
    step = str(settings.get("step", "")).replace("demetropolisz", "DE-MC_Z")
    numbers = [str(settings.get(key, "–")) for key in ("tune", "thin")]
    libraries = ", ".join(f"{name} {version}" for name, version in sorted(record.versions.items()))
    started = record.started.replace("T", " ").replace("+00:00", " UTC")
    return [record.model, str(record.seed), step, *numbers, started, str(record.sittings), libraries]
