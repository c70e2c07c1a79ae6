"""A page to read and to print: what models say of studies, how far to trust it, and how it was made."""

from __future__ import annotations

import base64
import re
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jinja2 import Environment, StrictUndefined
from PIL import Image

from zoo.blood.effects import CATALOGUE, Place
from zoo.blood.fetch import FetchError
from zoo.blood.predictive import median_waves, one_place, predictive_draws, vessel_waves
from zoo.blood.study import load_study
from zoo.core.diagnosis.diagnosis import DiagnosisFile, HypothesisResult
from zoo.core.diagnosis.screening import CORRELATED, NO_GAP, UNLISTED
from zoo.core.inference.results import (
    ESS_TARGET,
    RHAT_LIMIT,
    Diagnostics,
    ResultsError,
    RunRecord,
    diagnostics,
    load,
    scalars,
    versions,
)
from zoo.core.posterior.comparison import compare, record_of
from zoo.core.posterior.files import find, load_for
from zoo.models import MODELS, get_model
from zoo.plots import (
    comparison_figure,
    fit_figure,
    forest_figure,
    models_figure,
    pair_figure,
    plot_diagnosis,
    plot_gap,
    plot_hypotheses,
    plot_where,
    rank_figure,
    save_figure,
)

if TYPE_CHECKING:
    import arviz as az
    import pandas as pd
    import pymc as pm

    from zoo.blood.study import Study
    from zoo.core.diagnosis.diagnosis import Diagnosis

BANNER = "not converged: do not cite"
MEANINGS = {
    "f1": ("stiffness: f1 in f1 exp(f2 r0) + f3", "g cm⁻¹ s⁻²"),
    "f2": ("stiffness: f2 in f1 exp(f2 r0) + f3", "1/radius unit"),
    "f3": ("stiffness: constant part", "g cm⁻¹ s⁻²"),
    "m_chi": ("stiffness: mean of the population", "g cm⁻¹ s⁻²"),
    "v_chi": ("stiffness: variance of the population", "(10⁴ g cm⁻¹ s⁻²)²"),
    "chi": ("stiffness of a vessel", "g cm⁻¹ s⁻²"),
    "gamma": ("shape of the tangent wall", "–"),
    "psi1": ("factor on the nominal R1", "–"),
    "psi2": ("factor on the nominal R2", "–"),
    "c": ("factor on the nominal C", "–"),
    "sigma2": ("variance of the errors", "mmHg²"),
    "w": ("error kernel: weights", "s⁻²"),
    "b": ("error kernel: bias", "–"),
}
"""Parameter -> what it is, and its unit."""
COLOURS = 64
"""Of a figure in the page: a quarter of the size, and no difference to the eye."""
WAVE_DRAWS = 60
CRITERION = {"waic": "WAIC", "loo": "PSIS-LOO"}


class ReportError(ValueError):
    """A report that cannot be written; its text says what to change."""


@dataclass(frozen=True)
class Chapter:
    """One study's part of the page.

    Parameters
    ----------
    name : str
        Of the study.
    posteriors : mapping of model to InferenceData
        Drawn by `zoo.sample`, or slimmed by `zoo.core.inference.results.slim`.
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


class Picture(NamedTuple):
    """A figure inside the page."""

    source: str
    width: int
    height: int
    alt: str
    caption: str


class Row(NamedTuple):
    """One scalar of a posterior, as text."""

    name: str
    meaning: str
    unit: str
    median: str
    low: str
    high: str
    rhat: str
    bulk: str
    tail: str
    geweke: str
    passes: bool


def write_report(
    path: str | Path,
    study: Study,
    posteriors: Mapping[str, az.InferenceData],
    models: Mapping[str, pm.Model],
    *,
    table: pd.DataFrame | None = None,
    title: str = "",
    note: str = "",
    **options: Any,
) -> Path:
    """Write the report on one study; see `write_chapters`.

    Parameters
    ----------
    path : path
        HTML file to write.
    study : Study
    posteriors : mapping of model to InferenceData
    models : mapping of model to pm.Model
    table : DataFrame, optional
        From `zoo.compare`; made here if absent.
    title, note : str
        Of the page; under the heading of the study.
    **options
        Of `write_chapters`.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    ReportError
        If a posterior has no model, or the folder does not exist.
    """
    chapter = Chapter(study.name, posteriors, study, models, table, note)
    return write_chapters(path, [chapter], title=title or f"Models of blood flow: {study.name}", **options)


def write_chapters(
    path: str | Path,
    chapters: Sequence[Chapter],
    *,
    title: str = "Models of blood flow",
    ic: str = "waic",
    n_draws: int = 1000,
    command: str = "",
    made: datetime | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write one self-contained HTML page with a chapter for each study.

    Figures and style are inside the page; nothing is loaded from elsewhere.

    Parameters
    ----------
    path : path
        HTML file to write.
    chapters : sequence of Chapter
    title : str
    ic : {"waic", "loo"}
        What ranks, in tables made here.
    n_draws : int
        Draws of each posterior that are scored, in tables made here.
    command : str
        The command that made the page.
    made : datetime
        Now if absent.
    say : callable
        Told what is being done, one line each.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    ReportError
        If there is nothing to report, a posterior has no model, or the folder does not exist.
    zoo.core.posterior.comparison.ComparisonError
        If posteriors and models do not fit each other.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise ReportError(f"{path}: folder {path.parent} does not exist; create it or choose another path")
    if not chapters:
        raise ReportError("no chapters: give at least one study")
    anchors: set[str] = set()
    parts = [_part(chapter, _anchor(chapter.name, anchors), ic, n_draws, say) for chapter in chapters]
    template = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    ).from_string((files("zoo") / "templates" / "report.html").read_text("utf-8"))
    text = template.render(
        title=title,
        made=(made or datetime.now(UTC)).strftime("%d %B %Y, %H:%M UTC").lstrip("0"),
        versions=versions(),
        parts=parts,
        command=command,
        banner=BANNER,
        limits={"rhat": RHAT_LIMIT, "ess": int(ESS_TARGET)},
    )
    path.write_text(text, encoding="utf-8")
    return path


def stored(
    folders: Iterable[Path], study: str, letters: Sequence[str] = MODELS
) -> dict[str, az.InferenceData]:
    """Posteriors of a study in folders, by the name in their records: for when its data are not here.

    Parameters
    ----------
    folders : iterable of Path
    study : str
        Its name.
    letters : sequence of str
        Models to take.

    Returns
    -------
    dict
        Model -> InferenceData, in the order of the models' names; of several the last.
    """
    found = {}
    for file in (file for folder in folders for file in sorted(folder.glob("*.nc"))):
        try:
            idata = load(file)
            record = RunRecord.of(idata)
        except ResultsError:
            continue
        if record.study == study and record.model in letters:
            found[record.model] = idata
    return dict(sorted(found.items()))


def gather(
    studies: Iterable[str],
    folders: Sequence[Path],
    *,
    letters: Sequence[str] = MODELS,
    data: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> list[Chapter]:
    """Chapters on studies with the posteriors that folders hold.

    A chapter on measured data that cannot be had shows what needs only the posteriors.

    Parameters
    ----------
    studies : iterable of str
        Names or folders, as `zoo.load_study` takes them.
    folders : sequence of Path
        With posteriors; each study finds its own by their records.
    letters : sequence of str
        Models to take.
    data : bool
        Refuse measured data that cannot be had.
    say : callable
        Told of files that are passed over, one line each.

    Returns
    -------
    list of Chapter

    Raises
    ------
    zoo.blood.fetch.FetchError
        If `data` and measured data cannot be had.
    zoo.core.posterior.files.PosteriorError
        If a folder does not exist, or a posterior was drawn with other conventions.
    ReportError
        If there is no posterior of any of the studies.
    """
    chapters = []
    for name in studies:
        try:
            study = load_study(name)
        except FetchError as error:
            if data:
                raise
            note = f"The measured data are not here, so there are no fits and no comparison. {error}"
            posteriors = stored(folders, name, letters)
            chapters.append(Chapter(name, posteriors, note=note, commands=[f"zoo fetch {name}"]))
            continue
        files_found = find(folders, letters, study, say=say)
        models = {letter: get_model(letter)(study) for letter in letters if letter in files_found}
        posteriors = {letter: load_for(files_found[letter], model) for letter, model in models.items()}
        commands = [] if posteriors else [f"zoo sample {x} {study.name} --seed 1 -o {x}.nc" for x in letters]
        chapters.append(Chapter(study.name, posteriors, study, models, commands=commands))
    if not any(chapter.posteriors for chapter in chapters):
        names, where = (", ".join(str(x) for x in given) for given in (studies, folders))
        raise ReportError(
            f"no posterior of {names} in {where or 'no folder'}; `zoo sample A {chapters[0].name} -o A.nc` "
            "makes one"
        )
    return chapters


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


def summary(
    table: pd.DataFrame | None, checks: Mapping[str, Diagnostics], records: Mapping[str, RunRecord]
) -> list[str]:
    """What was found, in sentences.

    Parameters
    ----------
    table : DataFrame or None
        From `zoo.compare`.
    checks : mapping of model to Diagnostics
    records : mapping of model to RunRecord

    Returns
    -------
    list of str
    """
    failing = [name for name, found in checks.items() if not found.verdict.passes]
    lines = [_convergence(checks, failing)]
    if table is not None:
        lines += _standing(table, provisional=str(table.index[0]) in failing)
    solves = sum(record.solves for record in records.values())
    failures = sum(sum(record.failures.values()) for record in records.values())
    lines.append(
        f"Sampling took {solves} solves of the flow equations; "
        + ("none failed." if not failures else f"{failures} of them failed, and those points were refused.")
    )
    return lines


def _convergence(checks: Mapping[str, Diagnostics], failing: Sequence[str]) -> str:
    if not failing and len(checks) == 1:
        return f"The posterior of model {next(iter(checks))} converged."
    if not failing:
        return f"{'Both' if len(checks) == 2 else f'All {len(checks)}'} posteriors converged."
    rhat, worst = max((checks[name].verdict.max_rhat, name) for name in failing)
    ess, least = min((checks[name].verdict.min_ess, name) for name in failing)
    return (
        f"Not converged: {_listed(failing)}. The largest R-hat is {rhat:.3f} (model {worst}, "
        f"limit {RHAT_LIMIT}), the smallest effective sample size {ess:.0f} "
        f"(model {least}, {ESS_TARGET:.0f} wanted)."
    )


def _standing(table: pd.DataFrame, provisional: bool) -> list[str]:
    ic = table.attrs.get("ic", "waic")
    name = CRITERION[ic]
    best = table.iloc[0]
    start = "For what such draws are worth, model" if provisional else "Model"
    lines = []
    if len(table) == 1:
        lines.append(f"Model {table.index[0]} has {name} {best[ic]:.1f}, with nothing to compare it to.")
    else:
        lines.append(
            f"{start} {table.index[0]} predicts the observations best of {len(table)} models by {name}: "
            f"{best[ic]:.1f} (lower is better)."
        )
        others = table.iloc[1:]
        near = others[others["difference"] <= others["difference_se"]]
        if len(near):
            lines.append(
                f"{_listed(near.index)} {'is' if len(near) == 1 else 'are'} within the standard error of the "
                f"difference ({_differences(near)}): these data do not tell "
                f"{'it' if len(near) == 1 else 'them'} from {table.index[0]}."
            )
        behind = others[others["difference"] > others["difference_se"]]
        if len(behind):
            lines.append(f"Behind by more than the standard error of the difference: {_differences(behind)}.")
    bad = table[table["pareto_k_bad"] > 0]
    if len(bad):
        where = ", ".join(f"{model} {int(row['pareto_k_bad'])}" for model, row in bad.iterrows())
        lines.append(f"PSIS-LOO is not to be trusted at some points (large Pareto k): {where}.")
    warned = table[table["waic_warning"]]
    if len(warned):
        lines.append(
            f"WAIC of {_listed(warned.index)} has terms that vary by more than 0.4 over the posterior: its "
            "estimate may be too low."
        )
    return lines


def _differences(rows: pd.DataFrame) -> str:
    return ", ".join(
        f"{model} by {_with_error(row['difference'], row['difference_se'])}" for model, row in rows.iterrows()
    )


def _with_error(value: float, error: float) -> str:
    return f"{value:.1f} ± {error:.1f}"


def _listed(names: Iterable[Any]) -> str:
    words = [str(name) for name in names]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


# -------------------------------------------------------------------------------------------------
# parts of the page


def _part(chapter: Chapter, anchor: str, ic: str, n_draws: int, say: Callable[[str], None]) -> dict[str, Any]:
    """What the template shows of a chapter."""
    posteriors = chapter.posteriors
    checks = {name: diagnostics(idata) for name, idata in posteriors.items()}
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
    pictures = {}
    if table is not None and len(table) > 1:
        caption = f"{CRITERION[table.attrs.get('ic', 'waic')]} of each model and its difference to the best."
        pictures["ranking"] = _picture(
            comparison_figure(table), f"{caption} The table has the numbers.", caption
        )
    if posteriors:
        caption = "Medians, 50 % (thick) and 95 % (thin) intervals of the parameters that are single numbers."
        alt = f"{caption} The tables below have the numbers."
        pictures["forest"] = _picture(forest_figure(posteriors), alt, caption)
    if posteriors and chapter.study is not None:
        say(f"{chapter.name}: pressure in the vessels")
        medians = {
            name: median_waves(one_place(vessel_waves(chapter.models[name], idata, n_draws=WAVE_DRAWS)))
            for name, idata in posteriors.items()
        }
        caption = (
            f"Median pressure of {WAVE_DRAWS} draws of each model at the inlet of the root and midway in "
            "the others; last, measured minus median. Where nothing was measured this is prediction alone."
        )
        pictures["waves"] = _picture(models_figure(medians, chapter.study), caption, caption)
    details = []
    for name in posteriors:
        say(f"{chapter.name}: model {name}")
        details.append(_model_part(name, chapter, checks[name], records[name], f"{anchor}-{name.lower()}"))
    return {
        "name": chapter.name,
        "anchor": anchor,
        "note": chapter.note,
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


def _anchor(name: str, taken: set[str]) -> str:
    base = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "study"
    anchor, n = base, 1
    while anchor in taken:
        n += 1
        anchor = f"{base}-{n}"
    taken.add(anchor)
    return anchor


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
        ("conventions", lambda record: _settings(record.conventions)),
        ("solver", lambda record: _settings(record.solver)),
        ("seed", lambda record: str(record.seed)),
    ):
        which: dict[str, list[str]] = {}
        for name, record in records.items():
            which.setdefault(get(record), []).append(name)
        for value, names in which.items():
            facts.append((label if len(which) == 1 else f"{label} of {_listed(names)}", value))
    return facts


def _settings(values: Mapping[str, Any]) -> str:
    named = [f"{name} {_value(value)}" for name, value in values.items() if name != "name"]
    return ", ".join([str(values["name"]), *named] if "name" in values else named)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _ranking(table: pd.DataFrame) -> list[dict[str, Any]]:
    rows = []
    for model, row in table.iterrows():
        cells = [
            _with_error(row["waic"], row["waic_se"]),
            _with_error(row["difference"], row["difference_se"]),
            f"{row['weight']:.2f}",
            _with_error(row["loo"], row["loo_se"]),
            str(int(row["pareto_k_bad"])),
            f"{row['waic_one_observation']:.1f}",
            f"{row['p_waic']:.1f}",
            f"{row['sse']:.3g}",
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
            _picture(fit_figure(chapter.study, means, predictions), f"Fit of {where}. {caption}", caption)
        )
    caption = "Ranks of each chain's draws among all; bars at the dashed line where the chains agree."
    pictures.append(_picture(rank_figure(idata, single), f"Rank plots of {where}. {caption}", caption))
    if len(single) > 1:
        caption = "Draws of pairs of parameters, marginal densities on the diagonal."
        pictures.append(_picture(pair_figure(idata, single), f"Pair plots of {where}. {caption}", caption))
    rows = _parameter_rows(posterior, shown, check, chapter.models.get(name))
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
        return ""
    return (get_model(name).__doc__ or "").strip().splitlines()[0]


def _parameter_rows(
    posterior: Any, names: Sequence[str], check: Diagnostics, model: pm.Model | None
) -> list[Row]:
    unit = "mmHg²"
    if model is not None:
        quantities = {series.quantity for series in record_of(model).study.series}
        unit = "mmHg²" if quantities == {"pressure_mmHg"} else "unit of the series, squared"
    judged = {p.name: p for p in check.verdict.parameters}
    draws = {name: posterior[name].transpose("chain", "draw", ...).to_numpy() for name in names}
    rows = []
    for label, values in scalars(draws):
        base = label.partition("[")[0]
        meaning, own = MEANINGS.get(base, ("", ""))
        median, low, high = (_number(q) for q in np.quantile(values.astype(float), (0.5, 0.025, 0.975)))
        p = judged.get(label)
        rhat, bulk, tail = "–", "–", "–"
        if p is not None:
            rhat, bulk, tail = f"{p.rhat:.3f}", f"{p.ess_bulk:.0f}", f"{p.ess_tail:.0f}"
        p_values = check.geweke.get(label, ())
        smallest = f"{min(p_values):.2f}" if p_values else "–"
        chosen = unit if base == "sigma2" else own
        rows.append(
            Row(label, meaning, chosen, median, low, high, rhat, bulk, tail, smallest, p is None or p.passes)
        )
    return rows


def _number(value: float) -> str:
    """Four significant digits, in full up to 1e6."""
    return f"{float(f'{value:.4g}'):.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:#.4g}"


def _check_row(name: str, check: Diagnostics, record: RunRecord) -> dict[str, Any]:
    found = check.verdict
    p_values = [p for values in check.geweke.values() for p in values if np.isfinite(p)]
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
        f"{check.mpsrf:.3f}",
        f"{below} of {len(p_values)}" if p_values else "too few draws",
        "–" if not rates else rates[0] if rates[0] == rates[1] else f"{rates[0]} to {rates[1]}",
        f"{record.solves + record.mode_evaluations}",
        failures,
        f"{record.wall_seconds / 60:.1f}",
    ]
    return {"model": name, "passes": found.passes, "cells": cells}


def _run_row(record: RunRecord) -> list[str]:
    settings = record.settings
    step = (
        str(settings.get("step", "")).replace("demetropolisz", "DE-MC_Z").replace("metropolis", "Metropolis")
    )
    numbers = [str(settings.get(key, "–")) for key in ("tune", "thin")]
    libraries = ", ".join(f"{name} {version}" for name, version in sorted(record.versions.items()))
    started = record.started.replace("T", " ").replace("+00:00", " UTC")
    return [record.model, str(record.seed), step, *numbers, started, str(record.sittings), libraries]


def _picture(figure: Any, alt: str, caption: str) -> Picture:
    """A figure as a PNG in a data URI, with its size in CSS pixels."""
    with tempfile.TemporaryDirectory() as folder:
        image = Image.open(save_figure(figure, Path(folder) / "figure.png")).convert("RGB")
    small = BytesIO()
    image.quantize(COLOURS).save(small, "PNG", optimize=True)
    source = "data:image/png;base64," + base64.b64encode(small.getvalue()).decode("ascii")
    return Picture(
        source, round(0.6 * image.width), round(0.6 * image.height), alt, caption
    )  # 160 dots an inch


# -------------------------------------------------------------------------------------------------
# the page of a diagnosis

DIAGNOSIS_FIGURES = {
    "gap": (
        plot_gap,
        "What was measured, the base, and the base with its cause; below, the discrepancy of each with 95 % "
        "bands, and one standard deviation of the noise in grey.",
    ),
    "hypotheses": (
        plot_hypotheses,
        "Log evidence of each explanation over that of noise alone, its probability, and the gap it leaves.",
    ),
    "where": (
        plot_where,
        "Shares of the gap's energy, and the tree with the probability that a listed cause acts in a vessel.",
    ),
}
"""Figure -> what draws it, and its caption."""


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
    ReportError
        If the folder is a file, or what it lies in does not exist.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ReportError(f"{folder}: is a file; choose a folder")
    if not folder.resolve().parent.is_dir():
        raise ReportError(
            f"{folder}: folder {folder.parent} does not exist; create it or choose another path"
        )
    written = [diagnosis.save(folder), folder / "report.html"]
    pictures = {}
    for name, (draw, caption) in DIAGNOSIS_FIGURES.items():
        figure = draw(diagnosis)
        written.append(save_figure(figure, folder / f"{name}.png"))
        pictures[name] = _picture(figure, f"{caption} The tables have the numbers.", caption)
    written.append(save_figure(plot_diagnosis(diagnosis), folder / "diagnosis.png"))
    file = diagnosis.file
    unit = str(file.record.get("gap_unit", "mmHg"))
    templates = files("zoo") / "templates"
    look = (templates / "report.html").read_text("utf-8")  # one style for all pages
    text = (
        Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
        .from_string((templates / "diagnosis.html").read_text("utf-8"))
        .render(
            style=look.partition("<style>")[2].partition("</style>")[0],
            title=f"What {file.base} misses in {file.study}",
            file=file,
            unit=unit,
            summary=diagnosis_summary(file),
            estimate=_estimate,
            facts=_diagnosis_facts(diagnosis),
            gap=[_gap_row(row) for row in file.gap.per_series],
            where=_where_sentences(file),
            hypotheses=[_hypothesis_row(h, file) for h in file.hypotheses],
            groups=_groups(file),
            moved=_moved(file),
            confirmation=_confirmed(file),
            pictures=pictures,
            command=command,
        )
    )
    written[1].write_text(text, encoding="utf-8")
    return written


def diagnosis_summary(file: DiagnosisFile) -> list[str]:
    """What a diagnosis found, as a few sentences: verdict, gap, data that were not fitted, what is left.

    Parameters
    ----------
    file : DiagnosisFile

    Returns
    -------
    list of str
    """
    gap, unit = file.gap, str(file.record.get("gap_unit", "mmHg"))
    lines = [f"Verdict: {file.verdict}.", *(f"Warning: {text}." for text in file.warnings)]
    before = f"{_span(gap.before_mmHg, gap.before_interval_mmHg)} {unit}"
    floor = f"the noise {gap.noise_floor_mmHg:.2g} {unit}"
    if file.hypotheses[0].name in (NO_GAP, UNLISTED, CORRELATED):
        lines.append(f"Beside the noise the base leaves a gap of {before}; {floor}.")
    else:
        lines.append(
            f"The gap of the base is {before}, with its cause "
            f"{_span(gap.after_mmHg, gap.after_interval_mmHg)} {unit}: {_percent(gap.removed)} is removed "
            f"({_percent(gap.removed_interval[0])} to {_percent(gap.removed_interval[1])}); {floor}."
        )
    if gap.held_out_before_mmHg is not None and gap.held_out_after_mmHg is not None:
        lines.append(
            f"In data that were not fitted ({gap.held_out}) the gap goes from "
            f"{gap.held_out_before_mmHg:.2g} to {gap.held_out_after_mmHg:.2g} {unit}."
        )
    if len(file.steps) > 1:
        lines.append(
            f"One after the other were added: {'; '.join(_step(step, unit) for step in file.steps)}."
        )
    if file.failed:
        lines.append(f"The solver failed wherever these were tried: {_listed(file.failed)}.")
    return lines


def _step(step: Any, unit: str) -> str:
    where = "" if step.place is None else f" ({Place(step.place, step.subtree)})"
    sizes = ", ".join(f"{a.name} {_estimate(a.mean, a.sd, a.unit)}" for a in step.amplitudes)
    return (
        f"{step.name}{where}, {_percent(step.probability)} probable, {sizes}: "
        f"{step.gap_before_mmHg:.2g} to {step.gap_after_mmHg:.2g} {unit}"
    )


def _span(value: float, interval: Sequence[float]) -> str:
    return f"{value:.2g} ({interval[0]:.2g} to {interval[1]:.2g})"


def _percent(share: float) -> str:
    text = f"{100 * share:.0f}"
    return f"{'<1' if text == '0' and share > 0 else text} %"


def _estimate(mean: float, sd: float, unit: str) -> str:
    return f"{mean:.3g} ± {sd:.2g} {unit}".removesuffix(" 1")


def _diagnosis_facts(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    study, file = diagnosis.study, diagnosis.file
    series = ", ".join(f"{s.label} ({len(s.value)} samples)" for s in study.series)
    record = file.record
    noise = [
        f"{quantity}: " + ", ".join(f"{name} {_value(value)}" for name, value in errors.items())
        for quantity, errors in record.get("noise", {}).items()
    ]
    facts = [
        ("study", f"{study.name}, {len(study.vessels)} vessels, period {1e3 * study.period_s:g} ms"),
        ("observed", series),
        ("checksum", file.study_checksum),
        ("base", file.base),
        ("conventions", study.conventions.name),
        ("errors", "; ".join(noise)),
    ]
    for name in ("started", "seed", "cores", "solves", "failed_solves", "screening_seconds", "total_seconds"):
        if name in record:
            value = record[name]
            facts.append((name.replace("_", " "), f"{value:.1f}" if isinstance(value, float) else str(value)))
    facts.append(("versions", _settings(record.get("versions", {}))))
    return facts


def _gap_row(row: Any) -> list[str]:
    removed = 1.0 - row.after.mean / row.before.mean if row.before.mean > 0 else 0.0
    return [
        row.series,
        row.unit,
        _span(row.before.mean, (row.before.low, row.before.high)),
        _span(row.after.mean, (row.after.low, row.after.high)),
        _percent(max(0.0, removed)),
        f"{row.noise_floor:.2g}",
        f"{row.residual_rms_before:.3g}",
        f"{row.residual_rms_after:.3g}",
    ]


def _where_sentences(file: DiagnosisFile) -> list[str]:
    where = file.where
    lines = []
    for what, shares in (("phase", where.phase), ("harmonic", where.harmonic), ("series", where.series)):
        named = [f"{name} ({_percent(share)})" for name, share in shares.items() if share >= 0.005]
        lines.append(f"By {what}: {', '.join(named) or 'nothing'}.")
    places = [f"{Place(p.vessel, p.subtree)} ({_percent(p.probability)})" for p in where.place[:5]]
    lines.append(f"Place: {', '.join(places) or 'unknown'}.")
    return lines


def _hypothesis_row(h: HypothesisResult, file: DiagnosisFile) -> dict[str, Any]:
    zero = next(x.log_evidence for x in file.hypotheses if x.name == NO_GAP)
    amplitudes = [a for a in (h.amplitude, *h.other_amplitudes) if a is not None]
    free = h.name in (UNLISTED, CORRELATED)
    size = ", ".join(
        f"{a.name} " + (f"{a.mean:.3g} {a.unit}" if free else _estimate(a.mean, a.sd, a.unit))
        for a in amplitudes
    )
    return {
        "name": h.name,
        "statement": CATALOGUE[h.name].statement if h.name in CATALOGUE else MADE_UP.get(h.name, ""),
        "hidden": h.name in file.invisible,
        "cells": [
            "" if h.place is None else str(Place(h.place, h.subtree)),
            "invisible" if h.name in file.invisible else _percent(h.probability),
            str(h.group),
            f"{h.log_evidence - zero:+.1f}",
            size,
            "" if free else _span(h.gap_after_mmHg, h.gap_after_interval_mmHg),
            f"{h.residual_rms_mmHg:.3g}",
        ],
    }


MADE_UP = {NO_GAP: "Noise explains what the base leaves.", UNLISTED: "Something smooth that is not listed."}
"""Explanations outside the catalogue."""


def _groups(file: DiagnosisFile) -> list[str]:
    members: dict[int, list[str]] = {}
    for h in file.hypotheses:
        members.setdefault(h.group, []).append(h.name)
    return [
        f"Group {group}: {_listed(names)} explain these data alike; the study cannot tell them apart, so the "
        "answer is the group."
        for group, names in members.items()
        if len(names) > 1
    ]


def _moved(file: DiagnosisFile) -> list[list[str]]:
    """Parameters of the base, without and with the cause, and the shift in standard deviations."""
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
                _estimate(value, sds[0], "1"),
                _estimate(after[name], sds[1], "1"),
                f"{shift:+.3g}",
                f"{shift / spread:+.1f}",
            ]
        )
    return rows


def _confirmed(file: DiagnosisFile) -> list[dict[str, Any]]:
    """Rows of the confirmation, best marginal likelihood first."""
    rows = []
    found = file.confirmation or {}

    def worth(name: str) -> float:
        value = found[name]["log_marginal_likelihood"]
        return -np.inf if value is None else float(value)

    for name in sorted(found, key=worth, reverse=True):
        row = found[name]
        difference = (row["elpd_waic_difference"], row["elpd_waic_difference_se"])
        parameters = ", ".join(
            f"{key} {_estimate(value['mean'], value['sd'], '1')}" for key, value in row["parameters"].items()
        )
        rows.append(
            {
                "name": name,
                "converged": bool(row["converged"]),
                "verdict": row["verdict"],
                "parameters": parameters,
                "cells": [
                    _maybe(row["log_marginal_likelihood"], row["log_marginal_likelihood_se"]),
                    _maybe(row["elpd_waic"]),
                    _maybe(*difference),
                    _maybe(row["elpd_loo"]),
                ],
            }
        )
    return rows


def _maybe(value: float | None, error: float | None = None) -> str:
    """A number that may be missing, as JSON has no NaN."""
    if value is None:
        return "–"
    return f"{value:.1f}" if error is None else _with_error(value, error)
