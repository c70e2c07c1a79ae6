"""One study's part of the page: comparison, fits, convergence, how the posteriors were made."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from zoo.blood.predictive import median_waves, one_place, predictive_draws, vessel_waves
from zoo.blood.study import suspect_units
from zoo.core.arviz_lines import InferenceData, dataset
from zoo.core.inference.convergence import Diagnostics, diagnostics
from zoo.core.inference.record import RunRecord
from zoo.core.posterior.comparison import compare
from zoo.core.words import listed
from zoo.models import MODELS, get_model
from zoo.plots import comparison_figure, fit_figure, forest_figure, models_figure, pair_figure, rank_figure
from zoo.report.filters import settings_text
from zoo.report.page import ReportError, picture_of
from zoo.report.parameter_table import parameter_rows
from zoo.report.sentences import CRITERION, summary

if TYPE_CHECKING:
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
    note : str
        A paragraph under the heading.
    commands : sequence of str
        Run before those that make the posteriors, which come from their records.
    """

    name: str
    posteriors: Mapping[str, InferenceData]
    study: Study | None = None
    models: Mapping[str, pm.Model] = field(default_factory=dict)
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
    if not record.sittings:  # of another sampler
        return f"# {record.model} of {record.study}: draws of {settings['step']}"
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
    study, posteriors, table = chapter.study, chapter.posteriors, None
    checks = {name: diagnostics(idata, model=chapter.models.get(name)) for name, idata in posteriors.items()}
    records = {name: RunRecord.of(idata) for name, idata in posteriors.items()}
    pictures: dict[str, Any] = {}
    if study is not None and posteriors:
        if missing := [name for name in posteriors if name not in chapter.models]:
            raise ReportError(
                f"{chapter.name}: posterior {missing[0]!r} has no model; give one, or leave it out"
            )
        say(f"{chapter.name}: scoring {', '.join(posteriors)}")
        found = {name: check.verdict for name, check in checks.items()}
        table = compare(posteriors, chapter.models, ic=ic, n_draws=n_draws, verdicts=found)  # type: ignore[arg-type]
        if len(table) > 1:
            pictures["ranking"] = picture_of(comparison_figure(table))
        say(f"{chapter.name}: waves in the vessels")
        medians = {
            name: median_waves(one_place(vessel_waves(chapter.models[name], idata, n_draws=WAVE_DRAWS)))
            for name, idata in posteriors.items()
        }
        pictures["waves"] = {
            quantity.split("_")[0]: picture_of(models_figure(medians, study, quantity=quantity))
            for quantity in dict.fromkeys(series.quantity for series in study.series)
        }
    if posteriors:
        pictures["forest"] = picture_of(forest_figure(posteriors))
    details = []
    for name in posteriors:
        say(f"{chapter.name}: model {name}")
        details.append(_model_part(name, chapter, checks[name], f"{anchor}-{name.lower()}"))
    return {
        "name": chapter.name,
        "anchor": anchor,
        "note": chapter.note,
        "warnings": [] if study is None else suspect_units(study),
        "facts": _facts(chapter, records),
        "failing": [name for name, check in checks.items() if not check.verdict.passes],
        "summary": summary(table, checks, records) if posteriors else [],
        "table": table,
        "criterion": CRITERION[ic],
        "pictures": pictures,
        "wave_draws": WAVE_DRAWS,
        "models": details,
        "checks": checks,
        "records": records,
        "commands": [*chapter.commands, *(sampling_command(record) for record in records.values())],
    }


def _facts(chapter: Chapter, records: Mapping[str, RunRecord]) -> list[tuple[str, str]]:
    """What a study is and how its equations were solved."""
    facts = []
    study = chapter.study
    if study is not None:
        series = ", ".join(f"{s.label} ({s.n_samples} samples)" for s in study.series)
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


def _model_part(name: str, chapter: Chapter, check: Diagnostics, anchor: str) -> dict[str, Any]:
    idata, model = chapter.posteriors[name], chapter.models.get(name)
    posterior = dataset(idata)
    shown = [str(n) for n in posterior.data_vars if "time" not in posterior[n].dims]
    single = [n for n in shown if posterior[n].ndim == 2]
    pictures = {"ranks": picture_of(rank_figure(idata, single))}
    if chapter.study is not None and model is not None:
        pictures["fit"] = picture_of(fit_figure(chapter.study, *predictive_draws(model, idata)))
    if len(single) > 1:
        pictures["pairs"] = picture_of(pair_figure(idata, single))
    rows = parameter_rows(posterior, shown, check, model)
    return {
        "name": name,
        "anchor": anchor,
        "about": _about(name),
        "verdict": check.verdict,
        "single": [row for row in rows if "[" not in row["name"]],
        "many": [row for row in rows if "[" in row["name"]],
        "pictures": pictures,
        "draws": posterior.sizes["chain"] * posterior.sizes["draw"],
    }


def _about(name: str) -> str:
    """First line of a model's docstring, for the models of this package."""
    if name not in MODELS:
        return ""  # with effects it is another one
    return (get_model(name).__doc__ or "").strip().splitlines()[0]
