"""Models beside each other: how well they predict, and their posteriors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.stats import binom

from zoo.core.arrays import Array
from zoo.core.arviz_lines import InferenceData, dataset
from zoo.plots.style import (
    COLOURS,
    PARAMETER_LABELS,
    axis_end,
    cells_of,
    grid_behind,
    legend_below,
    model_style,
    new_figure,
    note_beside,
    size_of,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

NEAR = 10.0
"""Differences of a criterion below which an axis need not tell models apart."""
EVEN = 0.94
"""Part of even, independent numbers that a band holds at each place, as in ArviZ."""


def comparison_figure(table: pd.DataFrame) -> Figure:
    """The criterion of each model with its standard error, and the differences to the best with theirs.

    Parameters
    ----------
    table : DataFrame
        From `zoo.core.posterior.comparison.compare`: one row a model, deviance scale.

    Returns
    -------
    matplotlib.figure.Figure
        Both axes are linear. Where some models are so far behind that the others could not be told apart,
        the axis of differences ends before them, and arrows stand for them. Every difference is printed at
        the right.
    """
    criterion = table.attrs.get("ic", "waic")
    name = {"waic": "WAIC", "loo": "PSIS-LOO"}.get(criterion, str(criterion))
    rows = np.arange(len(table))
    difference, error = (table[column].to_numpy(dtype=float) for column in ("difference", "difference_se"))
    end = axis_end(list(difference), NEAR)
    near = difference <= (np.inf if end is None else end)
    right_end = 1.15 * float(np.max((difference + error)[near], initial=NEAR))
    with new_figure((9.0, 1.6 + 0.42 * len(table))) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        for row, (label, good) in enumerate(zip(table.index, table["converged"], strict=True)):
            colour = model_style(str(label), row)[0]
            look = {"color": colour, "mfc": colour if good else "white", "ms": 5, "capsize": 3, "lw": 1.3}
            left.errorbar(
                table[criterion].iloc[row], row, xerr=table[f"{criterion}_se"].iloc[row], fmt="o", **look
            )
            if near[row]:
                right.errorbar(difference[row], row, xerr=error[row], fmt="o", **look)
            else:
                right.plot(right_end, row, ">", color=colour, mfc=look["mfc"], ms=7, clip_on=False)
            weight = table["weight"].iloc[row]
            note_beside(right, row, f"{difference[row]:.1f} ± {error[row]:.1f}, weight {weight:.2f}", 8)
        grid_behind(left)
        grid_behind(right)
        left.set_yticks(rows, [str(label) for label in table.index])
        left.set_ylabel("model")
        left.set_ylim(len(table) - 0.4, -0.6)
        left.set_xlabel(f"{name}, lower is better")
        right.set_xlabel("difference to the best")
        right.axvline(0, color="#888888", lw=1, ls=":")
        right.set_xlim(-0.05 * right_end, right_end)
        figure.suptitle(f"{name} of {len(table)} models (bars: standard errors)")
        handles = []
        if not all(table["converged"]):
            handles += left.plot([], [], "o", color=COLOURS[0], mfc="white", label="not converged")
        if not all(near):
            handles += right.plot([], [], ">", color="#666666", label="beyond the axis: see the number")
        if handles:
            legend_below(figure, handles, 2)
    return figure


def forest_figure(posteriors: Mapping[str, InferenceData]) -> Figure:
    """Medians, 50 % and 95 % intervals of the parameters that are single numbers, by model.

    Parameters
    ----------
    posteriors : mapping of model to InferenceData
        Drawn from the upper row of each panel down.

    Returns
    -------
    matplotlib.figure.Figure
        One panel for each parameter, with the models that have it.
    """
    found: dict[str, dict[str, Array]] = {}
    for model, idata in posteriors.items():
        posterior = dataset(idata)
        for name in map(str, posterior.data_vars):
            if set(posterior[name].dims) == {"chain", "draw"}:
                found.setdefault(name, {})[model] = posterior[name].to_numpy().ravel()
    known = list(PARAMETER_LABELS)
    names = sorted(found, key=lambda name: known.index(name) if name in known else len(known))
    models = list(posteriors)
    with new_figure(size_of(len(names), 4, 2.5, 0.75 + 0.2 * len(models))) as figure:
        for [axes], name in zip(cells_of(figure, len(names), 4), names, strict=True):
            for row, model in enumerate(models):
                if model not in found[name]:
                    continue
                low, q1, median, q3, high = np.quantile(found[name][model], (0.025, 0.25, 0.5, 0.75, 0.975))
                colour = model_style(model, row)[0]
                axes.plot((low, high), (row, row), color=colour, lw=1.2)
                axes.plot((q1, q3), (row, row), color=colour, lw=3.2, solid_capstyle="butt")
                axes.plot(median, row, "o", color="white", mec=colour, mew=1.4, ms=5)
            axes.set_yticks(range(len(models)), models)
            axes.set_ylim(len(models) - 0.5, -0.5)
            axes.set_xlabel(PARAMETER_LABELS.get(name, name))
            axes.xaxis.set_major_locator(MaxNLocator(3))
            axes.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4), useMathText=True)
            grid_behind(axes)
    return figure


def loo_pit_figure(pits: Mapping[str, xr.DataArray]) -> Figure:
    """How the samples' LOO-PIT are distributed in each model, less an even distribution.

    Parameters
    ----------
    pits : mapping of model to DataArray
        From `zoo.loo_pit`.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each model, with the band that holds 94 % of independent, even numbers at each place.
    """
    with new_figure(size_of(len(pits), 3, 3.2, 2.4)) as figure:
        for row, ([axes], (model, pit)) in enumerate(
            zip(cells_of(figure, len(pits), 3), pits.items(), strict=True)
        ):
            values = pit.to_numpy()[np.isfinite(pit)]
            at = np.linspace(0.0, 1.0, 201)
            law = binom(len(values), at)
            low, high = (law.ppf(p) / len(values) - at for p in (0.5 - EVEN / 2, 0.5 + EVEN / 2))
            axes.fill_between(at, low, high, color="0.88", lw=0)
            below = np.searchsorted(np.sort(values), at, side="right") / len(values)
            axes.plot(at, below - at, color=model_style(model, row)[0], lw=1.2)
            axes.set(title=f"model {model}", xlabel="LOO-PIT", ylabel="share below it, less even")
    return figure
