"""Models beside each other by how well they predict."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from zoo.plots.style import COLOURS, new_figure

if TYPE_CHECKING:
    import pandas as pd


def comparison_figure(table: pd.DataFrame) -> Figure:
    """The criterion of each model with its standard error, and the differences to the best with theirs.

    Parameters
    ----------
    table : DataFrame
        From `zoo.core.posterior.comparison.compare`: one row a model, deviance scale.

    Returns
    -------
    matplotlib.figure.Figure
    """
    criterion = table.attrs.get("ic", "waic")
    name = {"waic": "WAIC", "loo": "PSIS-LOO"}.get(criterion, str(criterion))
    rows = np.arange(len(table))
    colours = [COLOURS[2] if good else COLOURS[1] for good in table["converged"]]
    with new_figure((8.0, 1.5 + 0.42 * len(table))) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, values, errors in (
            (left, table[criterion], table[f"{criterion}_se"]),
            (right, table["difference"], table["difference_se"]),
        ):
            for row, value, error, colour in zip(rows, values, errors, colours, strict=True):
                axes.errorbar(value, row, xerr=error, fmt="o", color=colour, ms=5, capsize=3, lw=1.3)
            axes.grid(axis="x", color="#DDDDDD", lw=0.7)
            axes.set_axisbelow(True)
        left.set_yticks(rows, [str(label) for label in table.index])
        left.set_ylabel("model")
        left.invert_yaxis()
        left.margins(y=0.25)
        left.set_xlabel(f"{name}, lower is better (bar: standard error)")
        right.set_xlabel("difference to the best (bar: its standard error)")
        right.axvline(0, color="#888888", lw=1, ls=":")
        right.margins(x=0.12)
        if float(np.max(np.abs(table["difference"]))) > 300:
            right.set_xscale("symlog", linthresh=10)
            right.set_xlabel("difference to the best, logarithmic above 10 (bar: its standard error)")
            right.set_xlim(-5, 3 * float(np.max(table["difference"] + table["difference_se"])))
        for row, weight in zip(rows, table["weight"], strict=True):
            right.annotate(
                f"weight {weight:.2f}",
                (1.0, row),
                xycoords=("axes fraction", "data"),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize="small",
                color="#666666",
            )
        figure.suptitle(f"{name} of {len(table)} models")
        if not all(table["converged"]):
            left.plot([], [], "o", color=COLOURS[1], label="not converged")
            left.legend(loc="best", fontsize="small")
    return figure
