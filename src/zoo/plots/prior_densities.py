"""What a model says before data: densities of its priors, and its series beside the observed ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from zoo.plots.style import (
    COLOURS,
    INK,
    QUANTITY_LABELS,
    cells_of,
    handles_of,
    legend_below,
    measured,
    new_figure,
    size_of,
)

if TYPE_CHECKING:
    from zoo.blood.prior_predictive import PriorPredictive, PriorRow
    from zoo.blood.study import Study

COLUMNS = 4
"""Panels beside each other."""


def priors_figure(rows: Sequence[PriorRow], *, title: str = "") -> Figure:
    """Median and 95 % interval of each prior with its density; positive ones on a logarithmic axis.

    Parameters
    ----------
    rows : sequence of PriorRow
    title : str
        Above the panels.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each parameter.
    """
    with new_figure(size_of(len(rows), COLUMNS, 2.7, 2.0)) as figure:
        for row, [axes] in zip(rows, cells_of(figure, len(rows), COLUMNS), strict=True):
            _panel(axes, row)
        if title:
            figure.suptitle(title, parse_math=False)
    return figure


def _panel(axes: Any, row: PriorRow) -> None:
    p = row.parameter
    axes.set_yticks([])
    axes.set_xlabel(p.name if p.unit == "1" else f"{p.name} ({p.unit})")
    axes.set_title(row.origin, fontsize="x-small", weight="normal")
    logarithmic = row.low > 0 and row.high > 3 * row.low
    if not math.isfinite(row.high) or row.high > 1e30 * max(row.median, 1e-30):
        axes.text(0.5, 0.5, "too vague to be drawn", ha="center", transform=axes.transAxes, size="small")
        return
    if not p.prior.depends_on:
        q = np.linspace(0.001, 0.999, 400)
        x = p.prior.quantile(q)
        u = np.log(x) if logarithmic else x
        axes.fill_between(0.5 * (x[1:] + x[:-1]), np.diff(q) / np.diff(u), color=COLOURS[0], alpha=0.4, lw=0)
    if logarithmic:
        axes.set_xscale("log")
        narrow = row.high < 30 * row.low
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if narrow else (1.0,)))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(bottom=0)
    axes.axvline(row.median, color=INK, lw=1.2)
    for bound in (row.low, row.high):
        axes.axvline(bound, color=INK, lw=0.8, ls=(0, (4, 2)))


def prior_predictive_figure(study: Study, found: PriorPredictive, *, title: str = "") -> Figure:
    """The series of prior draws beside the observed ones: median, bands of 50 and 95 %.

    Parameters
    ----------
    study : Study
    found : PriorPredictive
        Without errors.
    title : str
        Above the panels.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each observed series.
    """
    n = len(study.series)
    time_ms = 1e3 * np.asarray(study.time_s)
    with new_figure(size_of(n, 3, 4.2, 3.4, least=5.2)) as figure:
        cells = cells_of(figure, n, 3)
        for k, (series, [axes]) in enumerate(zip(study.series, cells, strict=True)):
            axes.margins(x=0)
            if len(found.series):
                low, lower, median, upper, high = np.quantile(
                    found.series[:, k], (0.025, 0.25, 0.5, 0.75, 0.975), axis=0
                )
                axes.fill_between(time_ms, low, high, color=COLOURS[5], alpha=0.3, lw=0, label="95 %")
                axes.fill_between(
                    time_ms, lower, upper, color=COLOURS[0], alpha=0.35, lw=0, label="50 % of prior"
                )
                axes.plot(time_ms, median, color=COLOURS[0], lw=1.4, label="prior median")
            axes.plot(*measured(time_ms, series.value), color=INK, lw=0.9, ls=(0, (4, 2)), label="observed")
            axes.set_title(series.label.rsplit(" ", 1)[0])
            axes.set_xlabel("time in the beat (ms)")
            axes.set_ylabel(QUANTITY_LABELS[series.quantity])
        legend_below(figure, handles_of(*cells[0]), 4)
        if title:
            figure.suptitle(title, parse_math=False)
    return figure
