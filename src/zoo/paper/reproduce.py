"""Paun et al. 2020 again: the nine models on the measured mouse, beside the published Table 4.

Numbers of the paper are in ``data/paun2020/published.toml``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from zoo.core.inference.convergence import judged
from zoo.core.inference.record import RunRecord
from zoo.core.posterior.files import matching, refuse_other_settings, sample_to
from zoo.models import MODELS, get_model

if TYPE_CHECKING:
    import arviz as az
    import pymc as pm

    from zoo.blood.study import Study

PARAMETERS = ("f1", "f2", "f3", "gamma", "psi1", "psi2", "c", "w", "b")
REFERENCE = "B"
"""The model that differences of WAIC are taken to."""
WAIC_LIMITS = {"A": 25.0, "D": 25.0, "F": 25.0}
WAIC_LIMIT = 5.0
"""Accepted distance of a difference of WAIC from the published one; wider for independent errors."""
FIRST_SCENARIO = "mismatch, 1 vessel"
"""The synthetic scenario that ratios of joint densities are taken to."""
WAIC_LEVEL = 40.0
"""Accepted distance of a WAIC itself: the paper's 512 samples are not public, and their wiggles decide it."""
NOT_EXPLAINED, UNCONVERGED = "not explained", "not converged"
QUARTER = 0.25
"""Accepted distance of medians, in widths of the published 95 % interval."""


class Interval(NamedTuple):
    """Median and 95 % interval."""

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class Published:
    """One row of Table 4."""

    model: str
    waic: float
    sse: float
    iterations: int
    emulator: bool
    parameters: dict[str, Interval]


@lru_cache(maxsize=1)
def _numbers() -> dict[str, Any]:
    return tomllib.loads((files("zoo") / "data" / "paun2020" / "published.toml").read_text("utf-8"))


def published_table4() -> dict[str, Published]:
    """Table 4 of the paper, by model.

    References
    ----------
    Paun et al. 2020, doi 10.1098/rsif.2020.0886.
    """
    rows = {}
    for model, row in _numbers()["table4"].items():
        parameters = {name: Interval(*row[name]) for name in PARAMETERS if name in row}
        rows[model] = Published(
            model, row["waic"], row["sse"], row["iterations"], row["emulator"], parameters
        )
    return rows


def reasons() -> dict[str, str]:
    """Known reasons for cells that do not agree: "MODEL.parameter", or "MODEL" for all of its cells."""
    return dict(_numbers().get("reasons", {}))


# -------------------------------------------------------------------------------------------------
# posteriors


def nine_posteriors(
    study: Study,
    folder: Path,
    names: Sequence[str] = MODELS,
    *,
    say: Callable[[str], None] = lambda text: None,
    **settings: Any,
) -> tuple[dict[str, az.InferenceData], dict[str, pm.Model]]:
    """Posteriors of models on a study: those in `folder`, the others sampled into it.

    Parameters
    ----------
    study : Study
    folder : Path
        Holds X.nc for each model X that is done, and the checkpoint of one that is not.
    names : sequence of str
        Letters of models.
    say : callable
        Told what is read and what was sampled, one line each.
    **settings
        Of `zoo.sample`.

    Returns
    -------
    posteriors, models : dict
        By letter.

    Raises
    ------
    zoo.core.posterior.files.PosteriorError
        If a posterior there was drawn with another seed or other settings.
    """
    folder.mkdir(parents=True, exist_ok=True)
    posteriors, models = {}, {}
    for name in names:
        models[name] = get_model(name)(study)
        path = folder / f"{name}.nc"
        stored = matching(path, models[name])
        if stored is not None:
            refuse_other_settings(path, stored, settings)
            posteriors[name] = stored
            found = judged(stored)
            lacks = "" if found.passes else f", not converged (R-hat {found.max_rhat:.3f})"
            say(f"model {name}: posterior of {path}, {found.chains} chains of {found.draws} draws{lacks}")
        else:
            posteriors[name] = sample_to(path, models[name], **settings)
            say(f"model {name}: sampled, wrote {path}")
    return posteriors, models


# -------------------------------------------------------------------------------------------------
# Table 4


def parameter_table(posteriors: Mapping[str, az.InferenceData]) -> pd.DataFrame:
    """Medians and 95 % intervals, published and obtained, one row for each printed cell.

    Two medians agree if each lies in the other's interval and they are at most a quarter of the published
    interval apart, both up to the rounding of the printed number. `mc_errors` is their distance in standard
    errors: Monte Carlo error of our median and rounding of the printed one.

    Parameters
    ----------
    posteriors : mapping of model to InferenceData

    Returns
    -------
    DataFrame
        Columns model, parameter, published_median, published_low, published_high, median, low, high, mcse,
        mc_errors, widths (distance over the width of the published interval), agrees, reason.
    """
    import arviz as az

    known = reasons()
    rows = []
    for model, row in published_table4().items():
        if model not in posteriors:
            continue
        posterior = posteriors[model]["posterior"]
        converged = judged(posteriors[model]).passes
        for name, theirs in row.parameters.items():
            draws = posterior[name]
            ours = Interval(*np.quantile(draws.to_numpy(), (0.5, 0.025, 0.975)))
            mcse = float(az.mcse(draws, method="median")[name])
            widths = (ours.median - theirs.median) / (theirs.high - theirs.low)
            rounded = _rounding(theirs.median)
            inside = (
                theirs.low - rounded <= ours.median <= theirs.high + rounded
                and ours.low - rounded <= theirs.median <= ours.high + rounded
            )
            apart = max(0.0, abs(ours.median - theirs.median) - rounded)
            agrees = bool(inside and apart <= QUARTER * (theirs.high - theirs.low))
            why = known.get(f"{model}.{name}", known.get(model, NOT_EXPLAINED))
            reason = "" if agrees else why if converged else UNCONVERGED
            error = np.hypot(mcse, rounded / np.sqrt(3))
            rows.append(
                {
                    "model": model,
                    "parameter": name,
                    **{f"published_{key}": value for key, value in theirs._asdict().items()},
                    **ours._asdict(),
                    "mcse": mcse,
                    "mc_errors": (ours.median - theirs.median) / error,
                    "widths": widths,
                    "agrees": agrees,
                    "reason": reason,
                }
            )
    return pd.DataFrame(rows)


def _rounding(value: float) -> float:
    """Half a unit of the third significant digit, how Table 4 is printed (0.21 and 0.88 have two)."""
    digits = 1 if abs(value) < 1 else 2
    return float(0.5 * 10.0 ** (np.floor(np.log10(abs(value))) - digits))


def score_table(comparison: pd.DataFrame) -> pd.DataFrame:
    """WAIC and sums of squared errors, published and obtained.

    Differences are to model B. The paper most likely took the whole series as one observation, so that WAIC
    decides; the difference of the sequential one stands beside it.

    Parameters
    ----------
    comparison : DataFrame
        From `zoo.core.posterior.comparison.compare`.

    Returns
    -------
    DataFrame
        Index model, in the order of Table 4; columns published_waic, waic_one_observation, waic, waic_se,
        loo, level_agrees, published_difference, difference, difference_mcse (its Monte Carlo standard error),
        difference_sequential, agrees, reason,
        published_sse, sse, sse_mcse (its Monte Carlo standard error).
    """
    known = reasons()
    rows = {}
    theirs = published_table4()
    for model, row in theirs.items():
        if model not in comparison.index:
            continue
        mine = comparison.loc[model]
        entry: dict[str, Any] = {
            "published_waic": row.waic,
            "waic_one_observation": mine["waic_one_observation"],
            "waic": mine["waic"],
            "waic_se": mine["waic_se"],
            "loo": mine["loo"],
            "level_agrees": bool(abs(mine["waic_one_observation"] - row.waic) <= WAIC_LEVEL),
        }
        if REFERENCE in comparison.index:
            base = comparison.loc[REFERENCE]
            entry["published_difference"] = row.waic - theirs[REFERENCE].waic
            entry["difference"] = mine["waic_one_observation"] - base["waic_one_observation"]
            errors = mine["one_observation_mcse"], base["one_observation_mcse"]
            entry["difference_mcse"] = 0.0 if model == REFERENCE else float(np.hypot(*errors))
            entry["difference_sequential"] = mine["waic"] - base["waic"]
            limit = WAIC_LIMITS.get(model, WAIC_LIMIT)
            entry["agrees"] = bool(abs(entry["difference"] - entry["published_difference"]) <= limit)
            entry["reason"] = "" if entry["agrees"] else _waic_reason(known, model, mine, base)
        rows[model] = {**entry, "published_sse": row.sse, "sse": mine["sse"], "sse_mcse": mine["sse_mcse"]}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("model")


def _waic_reason(known: Mapping[str, str], model: str, mine: Any, base: Any) -> str:
    """Why a difference of WAIC is another than the published one, where both levels are near theirs."""
    if not (mine["converged"] and base["converged"]):
        return UNCONVERGED
    theirs = published_table4()
    own, other = (
        abs(row["waic_one_observation"] - theirs[name].waic)
        for name, row in ((model, mine), (REFERENCE, base))
    )
    if other > WAIC_LEVEL:
        return NOT_EXPLAINED
    return known.get(f"{model}.waic", NOT_EXPLAINED).format(own=own, other=other)


def cost_table(posteriors: Mapping[str, az.InferenceData]) -> pd.DataFrame:
    """What each posterior cost, beside the paper's iterations.

    Parameters
    ----------
    posteriors : mapping of model to InferenceData

    Returns
    -------
    DataFrame
        Index model; columns converged, rhat_max, ess_min, draws, solves, failed, minutes,
        solves_per_effective_draw, published_iterations (with an emulator where `published_emulator`),
        published_days (where the paper tells).
    """
    theirs = published_table4()
    days = _numbers()["time"]
    rows = {}
    for model, idata in posteriors.items():
        record, found = RunRecord.of(idata), judged(idata)
        solves = record.solves + record.mode_evaluations
        rows[model] = {
            "converged": found.passes,
            "rhat_max": found.max_rhat,
            "ess_min": found.min_ess,
            "draws": found.chains * found.draws,
            "solves": solves,
            "failed": sum(record.failures.values()),
            "minutes": record.wall_seconds / 60,
            "solves_per_effective_draw": solves / found.min_ess,
            "published_iterations": theirs[model].iterations if model in theirs else None,
            "published_emulator": theirs[model].emulator if model in theirs else None,
            "published_days": days.get(f"{model}_days"),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("model")


# -------------------------------------------------------------------------------------------------
# tables as text


def format_cell(parameter: str, interval: Interval) -> str:
    """Median (low, high) as Table 4 prints it: f1 in 1e5, f3 and w in 1e4."""
    scale = {"f1": 1e5, "f3": 1e4, "w": 1e4}.get(parameter, 1.0)
    return "{} ({}, {})".format(*(_three(value / scale) for value in interval))


def _three(value: float) -> str:
    """Three significant digits, two decimals at most."""
    if value == 0 or not np.isfinite(value):
        return f"{value:g}"
    places = int(np.clip(2 - np.floor(np.log10(abs(value))), 0, 2))
    return f"{value:.{places}f}"


HEADINGS = {
    "f1": "f1 (1e5)",
    "f3": "f3 (1e4)",
    "w": "w (1e4)",
}


def table4_rows(parameters: pd.DataFrame, scores: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    """Table 4 as text: two rows a model, published and obtained, with a mark on each obtained cell.

    Marks: "=" agrees, "x" does not. WAIC is of the whole series as one observation.

    Returns
    -------
    headings : list of str
    rows : list of list of str
    """
    headings = ["model", "", *(HEADINGS.get(name, name) for name in PARAMETERS), "WAIC", "WAIC - B", "SSE"]
    rows = []
    for model, theirs in published_table4().items():
        if model not in scores.index:
            continue
        score = scores.loc[model]
        above, below = [model, "published"], ["", "zoo"]
        cells = parameters[parameters["model"] == model].set_index("parameter")
        for name in PARAMETERS:
            if name not in cells.index:
                above.append("")
                below.append("")
                continue
            cell = cells.loc[name]
            mark = "=" if cell["agrees"] else "x"
            above.append(format_cell(name, theirs.parameters[name]))
            ours = Interval(*cell[["median", "low", "high"]].to_numpy(dtype=float))
            below.append(f"{format_cell(name, ours)} {mark}")
        above.append(f"{theirs.waic:.0f}")
        below.append(f"{score['waic_one_observation']:.0f}")
        if "difference" in scores.columns:
            above.append(f"{score['published_difference']:+.0f}")
            error = f" ± {score['difference_mcse']:.1f}" if model != REFERENCE else ""
            below.append(f"{score['difference']:+.1f}{error} {'=' if score['agrees'] else 'x'}")
        else:
            above.append("")
            below.append("")
        above.append(f"{theirs.sse:.0f}")
        below.append(f"{score['sse']:.0f} ± {score['sse_mcse']:.0f}")
        rows += [above, below]
    return headings, rows


def table4_lines(parameters: pd.DataFrame, scores: pd.DataFrame) -> list[list[str]]:
    """Table 4 as narrow text: model, quantity, published, obtained, mark; one row a cell.

    Returns
    -------
    list of list of str
    """
    headings, rows = table4_rows(parameters, scores)
    lines = []
    for above, below in zip(rows[::2], rows[1::2], strict=True):
        model = above[0]
        for heading, theirs, ours in zip(headings[2:], above[2:], below[2:], strict=True):
            if ours:
                mark = ours[-1] if ours.endswith((" =", " x")) else ""
                lines.append([model, heading, theirs, ours.removesuffix(f" {mark}"), mark])
                model = ""
    return lines


def disagreements(parameters: pd.DataFrame, scores: pd.DataFrame) -> list[str]:
    """One line for each cell that does not agree, with its reason."""
    lines = []
    for _, cell in parameters[~parameters["agrees"]].iterrows():
        lines.append(
            f"{cell['model']} {cell['parameter']}: {cell['widths']:+.2f} published interval widths from the "
            f"published median: {cell['reason']}"
        )
    if "agrees" in scores.columns:
        for model, row in scores[~scores["agrees"].astype(bool)].iterrows():
            lines.append(
                f"{model} WAIC - B: {row['difference']:+.1f}, published {row['published_difference']:+.0f}: "
                f"{row['reason']}"
            )
    return lines


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A pipe table."""
    lines = [headings, ["---"] * len(headings), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


# -------------------------------------------------------------------------------------------------
# the whole


@dataclass(frozen=True)
class Reproduction:
    """What `reproduce` found: Table 4 in three parts, and the ranking with the pointwise decompositions."""

    parameters: pd.DataFrame
    scores: pd.DataFrame
    costs: pd.DataFrame
    comparison: pd.DataFrame

    def lines(self) -> list[str]:
        """Agreement in words: how many cells agree, and each that does not with its reason."""
        cells = self.parameters["agrees"]
        lines = [f"parameters: {int(cells.sum())} of {len(cells)} cells agree with Table 4"]
        if "agrees" in self.scores.columns:
            right = self.scores["agrees"].astype(bool).drop(REFERENCE)
            lines.append(f"differences of WAIC from model B: {int(right.sum())} of {len(right)} agree")
        return [*lines, *disagreements(self.parameters, self.scores)]

    def markdown(self) -> str:
        """Table 4 and the costs as pipe tables."""
        costs = self.costs.reset_index()
        rows = [[_short(value) for value in row] for row in costs.itertuples(index=False)]
        parts = [markdown(*table4_rows(self.parameters, self.scores)), markdown(list(costs.columns), rows)]
        return "\n".join([*parts, *(f"- {line}" for line in self.lines()), ""])


def _short(value: Any) -> str:
    if value is None or value is pd.NA or (isinstance(value, float) and np.isnan(value)):
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def reproduce(
    study: Study,
    folder: Path,
    names: Sequence[str] = MODELS,
    *,
    figures: bool = True,
    say: Callable[[str], None] = lambda text: None,
    **settings: Any,
) -> Reproduction:
    """Sample the models on a study, score them, and set the results beside Table 4.

    Everything goes to `folder`: X.nc for each model, table4.csv, scores.csv, costs.csv, comparison.csv,
    table4.md, interval-widths.csv and, in figures/, the figures of the paper.

    Parameters
    ----------
    study : Study
        The measured mouse, or another one (then the published columns are only for orientation).
    folder : Path
        Posteriors that it holds are taken, checkpoints resumed.
    names : sequence of str
        Letters of models.
    figures : bool
        Draw figures 4 to 9.
    say : callable
        Told what was done, one line each.
    **settings
        Of `zoo.sample`.

    Returns
    -------
    Reproduction
    """
    from zoo.core.posterior.comparison import compare

    posteriors, models = nine_posteriors(study, folder, names, say=say, **settings)
    comparison = compare(posteriors, models)
    found = Reproduction(
        parameter_table(posteriors), score_table(comparison), cost_table(posteriors), comparison
    )
    found.parameters.to_csv(folder / "table4.csv", index=False)
    found.scores.to_csv(folder / "scores.csv")
    found.costs.to_csv(folder / "costs.csv")
    comparison.to_csv(folder / "comparison.csv")
    (folder / "table4.md").write_text(found.markdown(), encoding="utf-8")
    if figures:
        paper_figures(study, posteriors, models, found, folder, say=say)
    return found


def paper_figures(
    study: Study,
    posteriors: Mapping[str, az.InferenceData],
    models: Mapping[str, pm.Model],
    found: Reproduction,
    folder: Path,
    *,
    say: Callable[[str], None] = lambda text: None,
) -> None:
    """Figures 4 to 9 of the paper, from the models that are there, and the widths of its table S1."""
    from zoo import plots
    from zoo.blood import predictive

    place = folder / "figures"
    place.mkdir(exist_ok=True)

    def save(figure: Any, name: str) -> None:
        plots.save_figure(figure, place / f"{name}.png")

    save(plots.intervals_figure(found.parameters), "table4-intervals")
    save(plots.comparison_figure(found.comparison), "comparison")
    medians, pressures, at_medians, widths = {}, {}, {}, {}
    for name, idata in posteriors.items():
        waves = predictive.vessel_waves(models[name], idata)
        widths[name] = predictive.interval_widths(waves)
        one = predictive.one_place(waves)
        medians[name] = predictive.median_waves(waves)
        pressures[name] = predictive.bands(one, "pressure_mmHg", (0.95,), errors=True)
        at_medians[name] = predictive.waves_at_medians(models[name], idata)
        for quantity in ("pressure_mmHg", "flow_ml_s"):
            shown = (
                pressures[name] if quantity == "pressure_mmHg" else predictive.bands(one, quantity, (0.95,))
            )
            title = f"model {name}, {quantity.split('_')[0]}"
            save(plots.all_vessels_figure(shown, study, title=title), f"all-{quantity.split('_')[0]}-{name}")
        save(plots.trace_figure(idata, list(models[name].zoo.parameters)), f"trace-{name}")
        save(plots.rank_figure(idata, list(models[name].zoo.parameters)), f"rank-{name}")
        say(f"model {name}: waves in all vessels")
    every = [int(v) for v in next(iter(at_medians.values()))["vessel"].to_numpy()]
    pd.concat(widths, names=["model", "vessel"]).to_csv(folder / "interval-widths.csv")
    if {"A", "B"} <= set(posteriors):
        names = ("f3", "psi1", "psi2", "c")
        save(plots.posteriors_figure({m: posteriors[m] for m in ("A", "B")}, names), "figure4a")
    for name in {"B", "I"} & set(posteriors):
        shown = predictive.with_stiffness(models[name], posteriors[name])
        save(plots.posteriors_figure({name: shown}), f"figure4b-{name}")
    some = [name for name in ("A", "B", "I") if name in posteriors] or list(posteriors)[:3]
    save(plots.uncertainty_figure({name: pressures[name] for name in some}, study), "figure5")
    if "E" in posteriors:
        save(plots.pair_figure(posteriors["E"], ["f1", "f2", "f3", "psi1", "psi2", "c"]), "figure6-left")
    own = {name: predictive.stiffness_draws(models[name], posteriors[name]) for name in posteriors}
    save(plots.stiffness_figure({n: d for n, d in own.items() if n == "G"} or own), "figure6-right")
    estimate = float(posteriors["B"]["posterior"]["f3"].median()) if "B" in posteriors else None
    curve = predictive.pressure_against_stiffness(study)
    curve.to_csv(folder / "figure7.csv", index=False)
    save(plots.pressure_stiffness_figure(curve, estimate), "figure7")
    save(plots.models_figure(medians, study), "figure8")
    save(plots.models_figure(medians, study, quantity="flow_ml_s"), "figure9-flow")
    save(plots.loops_figure(at_medians), "figure9-loops")
    save(plots.loops_figure(at_medians, vessels=every), "loops-all-vessels")
    save(plots.loops_figure(at_medians, vessels=every, standardised=True), "loops-all-vessels-standardised")


# -------------------------------------------------------------------------------------------------
# the synthetic studies


def synthetic_tables(scores: pd.DataFrame) -> pd.DataFrame:
    """Tables 3 and 5 beside the published ones.

    Joint densities depend on the units of the parameters, which the paper does not tell: only their ratios
    to the first scenario with mismatch can be compared.

    Parameters
    ----------
    scores : DataFrame
        From `zoo.paper.coverage.run`.

    Returns
    -------
    DataFrame
        Index scenario; columns of `zoo.paper.coverage.summarise`, published_relative_sse,
        published_density_NAME, joint_ratio and published_joint_ratio (to "mismatch, 1 vessel").
    """
    from zoo.paper.coverage import THETA, summarise

    table = summarise(scores)
    numbers = _numbers()
    published = {
        "no mismatch, 1 vessel": numbers["table3"]["no"],
        FIRST_SCENARIO: numbers["table3"]["yes"],
        "mismatch, 3 vessels": numbers["table5"]["3"],
        "mismatch, 21 vessels": numbers["table5"]["21"],
    }
    one = float(numbers["table5"]["1"]["joint"])
    rows = {}
    for scenario in map(str, table.index):
        theirs = published.get(scenario, {})
        row = {"published_relative_sse": theirs.get("relative_sse", np.nan)}
        densities = theirs.get("marginal", [np.nan] * len(THETA))
        row |= {f"published_density_{name}": d for name, d in zip(THETA, densities, strict=True)}
        joint = one if scenario == FIRST_SCENARIO else theirs.get("joint", np.nan)
        rows[scenario] = {**row, "published_joint_ratio": float(np.max(joint)) / one}
    table = table.join(pd.DataFrame.from_dict(rows, orient="index"))
    if FIRST_SCENARIO in table.index:
        table["joint_ratio"] = table["joint_direct"] / float(table["joint_direct"].loc[FIRST_SCENARIO])
    return table


def synthetic_figures(scores: pd.DataFrame, base: Study, folder: Path) -> None:
    """Figures 3 (three data sets, without and with mismatch) and 10 (all data sets together, by vessels).

    Parameters
    ----------
    scores : DataFrame
        From `zoo.paper.coverage.run`: which fits there are.
    base : Study
        What the data sets were made from.
    folder : Path
        Holds the posteriors; figure3.png and figure10.png are written there.
    """
    from dataclasses import asdict

    from zoo import plots
    from zoo.core.posterior.storage import load
    from zoo.paper.coverage import PAPER_TRUTH, THETA

    def draws(file: str) -> dict[str, Any]:
        posterior = load(folder / file)["posterior"]
        return {name: posterior[name].to_numpy().ravel() for name in THETA}

    truth = {name: asdict(PAPER_TRUTH)[name] for name in THETA}
    groups: dict[str, list[dict[str, Any]]] = {}
    for scenario, group in scores.groupby("scenario", sort=False):
        groups[str(scenario)] = [draws(file) for file in group["file"]]
    one = {name: fits[:3] for name, fits in groups.items() if name.endswith("1 vessel")}
    if one:
        plots.save_figure(plots.truth_figure(one, truth), folder / "figure3.png")
    pooled = {
        name: [{key: np.concatenate([fit[key] for fit in fits]) for key in THETA}]
        for name, fits in groups.items()
        if name.startswith("mismatch")
    }
    if pooled:
        plots.save_figure(plots.truth_figure(pooled, truth, overlay=True), folder / "figure10.png")
