"""Models beside each other by how well they predict."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from zoo.plots.style import COLOURS, axis_end, model_style, new_figure

if TYPE_CHECKING:
    import pandas as pd

NEAR = 10.0
"""Differences of a criterion below which an axis need not tell models apart."""


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
            right.annotate(
                f"{difference[row]:.1f} ± {error[row]:.1f}, weight {table['weight'].iloc[row]:.2f}",
                (1.0, row),
                xycoords=("axes fraction", "data"),
                xytext=(8, 0),
                textcoords="offset points",
                va="center",
                fontsize="small",
                color="#666666",
            )
        for axes in (left, right):
            axes.grid(axis="x", color="#DDDDDD", lw=0.7)
            axes.set_axisbelow(True)
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
            figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize="small")
    return figure
