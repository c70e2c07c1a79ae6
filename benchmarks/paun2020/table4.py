"""Table 4 of Paun et al. 2020 beside posteriors of the same models: which cells agree, and why others do not.

Numbers of the paper are in ``published.toml`` beside this file.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import arviz as az
import numpy as np
import pandas as pd

from zoo.core.arviz_lines import InferenceData, dataset
from zoo.core.inference.convergence import diagnostics
from zoo.core.inference.record import RunRecord

PARAMETERS = ("f1", "f2", "f3", "gamma", "psi1", "psi2", "c", "w", "b")
REFERENCE = "B"
"""The model that differences of WAIC are taken to."""
WAIC_LIMITS = {"A": 10.0, "D": 10.0, "F": 25.0}
WAIC_LIMIT = 5.0
"""Accepted distance of a difference of WAIC from the published one; wider for independent errors."""
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
def numbers() -> dict[str, Any]:
    """The printed numbers of the paper, as the file has them."""
    return tomllib.loads(Path(__file__).with_name("published.toml").read_text("utf-8"))


def published_table4() -> dict[str, Published]:
    """Table 4 of the paper, by model.

    References
    ----------
    Paun et al. 2020, doi 10.1098/rsif.2020.0886.
    """
    rows = {}
    for model, row in numbers()["table4"].items():
        parameters = {name: Interval(*row[name]) for name in PARAMETERS if name in row}
        rows[model] = Published(
            model, row["waic"], row["sse"], row["iterations"], row["emulator"], parameters
        )
    return rows


def reasons() -> dict[str, str]:
    """Known reasons for cells that do not agree, by model."""
    return dict(numbers().get("reasons", {}))


def parameter_table(posteriors: Mapping[str, InferenceData]) -> pd.DataFrame:
    """Medians and 95 % intervals, published and obtained, one row for each printed cell.

    Two medians agree if each lies in the other's interval and they are at most a quarter of the published
    interval apart, both up to the rounding of the printed number. `mc_errors` is their distance in standard
    errors: Monte Carlo error of our median and rounding of the printed one.

    Returns
    -------
    DataFrame
        Columns model, parameter, published_median, published_low, published_high, median, low, high, mcse,
        mc_errors, widths (distance over the width of the published interval), agrees, reason.
    """
    known = reasons()
    rows = []
    for model, row in published_table4().items():
        if model not in posteriors:
            continue
        posterior = dataset(posteriors[model])
        converged = diagnostics(posteriors[model]).verdict.passes
        for name, theirs in row.parameters.items():
            draws = posterior[name]
            ours = Interval(*np.quantile(draws.to_numpy(), (0.5, 0.025, 0.975)))
            mcse = float(az.mcse(draws.transpose("chain", "draw").to_numpy(), method="median"))
            widths = (ours.median - theirs.median) / (theirs.high - theirs.low)
            rounded = _rounding(theirs.median)
            inside = (
                theirs.low - rounded <= ours.median <= theirs.high + rounded
                and ours.low - rounded <= theirs.median <= ours.high + rounded
            )
            apart = max(0.0, abs(ours.median - theirs.median) - rounded)
            agrees = bool(inside and apart <= QUARTER * (theirs.high - theirs.low))
            reason = "" if agrees else known.get(model, NOT_EXPLAINED) if converged else UNCONVERGED
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
        loo, published_difference, difference, difference_mcse (its Monte Carlo standard error),
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
            why = known.get(model, NOT_EXPLAINED) if mine["converged"] and base["converged"] else UNCONVERGED
            entry["reason"] = "" if entry["agrees"] else why
        own = {name: mine[f"sse_pressure_mmHg{end}"] for name, end in (("sse", ""), ("sse_mcse", "_mcse"))}
        rows[model] = {**entry, "published_sse": row.sse, **own}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("model")


def cost_table(posteriors: Mapping[str, InferenceData]) -> pd.DataFrame:
    """What each posterior cost, beside the paper's iterations.

    Returns
    -------
    DataFrame
        Index model; columns converged, rhat_max, ess_min, draws, solves, failed, minutes,
        solves_per_effective_draw, published_iterations (with an emulator where `published_emulator`).
    """
    theirs = published_table4()
    rows = {}
    for model, idata in posteriors.items():
        record, found = RunRecord.of(idata), diagnostics(idata).verdict
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
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("model")


SCALES = {"f1": "1e5", "f3": "1e4", "w": "1e4"}
"""Units that Table 4 prints these in."""


def format_cell(parameter: str, interval: Sequence[float]) -> str:
    """Median (low, high) as Table 4 prints it, of three significant digits with two decimals at most."""
    numbers = []
    for value in np.asarray(interval, dtype=float) / float(SCALES.get(parameter, 1)):
        places = int(np.clip(2 - np.floor(np.log10(abs(value))), 0, 2)) if value else 0
        numbers.append(f"{value:.{places}f}")
    return "{} ({}, {})".format(*numbers)


def table4_rows(parameters: pd.DataFrame, scores: pd.DataFrame) -> tuple[list[str], list[list[str]]]:
    """Table 4 as text: two rows a model, published and obtained, with a mark on each obtained cell.

    Marks: "=" agrees, "x" does not. WAIC is of the whole series as one observation.

    Returns
    -------
    headings : list of str
    rows : list of list of str
    """
    units = [f"{name} ({SCALES[name]})" if name in SCALES else name for name in PARAMETERS]
    cells = parameters.set_index(["model", "parameter"])
    rows = []
    for model, theirs in published_table4().items():
        if model not in scores.index:
            continue
        score, pairs = scores.loc[model], [(model, ""), ("published", "zoo")]
        for name in PARAMETERS:
            pair = "", ""
            if (model, name) in cells.index:
                cell = cells.loc[(model, name)]
                own = format_cell(name, cell[["median", "low", "high"]])
                pair = format_cell(name, theirs.parameters[name]), f"{own} {'=' if cell['agrees'] else 'x'}"
            pairs.append(pair)
        pairs.append((f"{theirs.waic:.0f}", f"{score['waic_one_observation']:.0f}"))
        pair = "", ""
        if "difference" in scores.columns:
            error = f" ± {score['difference_mcse']:.1f}" if model != REFERENCE else ""
            own = f"{score['difference']:+.1f}{error} {'=' if score['agrees'] else 'x'}"
            pair = f"{score['published_difference']:+.0f}", own
        pairs.append(pair)
        pairs.append((f"{theirs.sse:.0f}", f"{score['sse']:.0f} ± {score['sse_mcse']:.0f}"))
        rows += [[pair[i] for pair in pairs] for i in (0, 1)]
    return ["model", "", *units, "WAIC", "WAIC - B", "SSE"], rows


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
