"""Tables 3 and 5 and figures 3 and 10 of Paun et al. 2020, from fits of synthetic data."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from zoo.paper.table4 import numbers

if TYPE_CHECKING:
    from zoo.blood.study import Study

FIRST_SCENARIO = "mismatch, 1 vessel"
"""The synthetic scenario that ratios of joint densities are taken to."""


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
    from zoo.paper.coverage import summarise
    from zoo.paper.truth import THETA

    table = summarise(scores)
    printed = numbers()
    published = {
        "no mismatch, 1 vessel": printed["table3"]["no"],
        FIRST_SCENARIO: printed["table3"]["yes"],
        "mismatch, 3 vessels": printed["table5"]["3"],
        "mismatch, 21 vessels": printed["table5"]["21"],
    }
    one = float(printed["table5"]["1"]["joint"])
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
    from zoo.paper.truth import PAPER_TRUTH, THETA

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
