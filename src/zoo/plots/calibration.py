"""Posteriors of data whose truth is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from zoo.plots.style import COLOURS, INK, PARAMETER_LABELS, broken, in_scale, new_figure, parameter_label

if TYPE_CHECKING:
    from zoo.core.posterior.ranks import RankTest


def calibration_figure(test: RankTest, *, title: str = "") -> Figure:
    """Ranks of truths among posterior draws, and the difference of their ECDF to a uniform one.

    Parameters
    ----------
    test : zoo.core.posterior.ranks.RankTest
    title : str
        Above the panels.

    Returns
    -------
    matplotlib.figure.Figure
        For each quantity a histogram with the 95 % range of a single bin, and the ECDF difference with the
        95 % band that holds for all ranks together (Säilynoja et al. 2022, doi 10.1007/s11222-022-10090-6).
    """
    from scipy.stats import binom

    counts = test.histogram()
    bins = len(counts)
    edges = np.linspace(0, 1, bins + 1)
    low, high = binom.interval(0.95, test.n, 1 / bins)
    share = np.concatenate([[0.0], test.points, [1.0]])
    band = [np.concatenate([[0.0], limit, [0.0]]) for limit in test.band()]
    difference = test.ecdf_difference()
    largest = 1.15 * max(float(np.abs(difference).max()), float(np.abs(band).max()))
    columns = len(test.names)
    with new_figure((1.0 + 1.75 * columns, 4.2)) as figure:
        axes = figure.subplots(2, columns, squeeze=False, sharex=True, sharey="row")
        for k, name in enumerate(test.names):
            top, bottom = axes[:, k]
            top.axhspan(low, high, color="#DDDDDD", lw=0)
            top.axhline(test.n / bins, color="#888888", lw=0.8)
            top.stairs(counts[:, k], edges, fill=True, color=COLOURS[0], alpha=0.75)
            top.set_title(PARAMETER_LABELS.get(name, name.replace("_", " ")).split(" (")[0])
            bottom.fill_between(share, *band, color="#DDDDDD", lw=0)
            bottom.axhline(0, color="#888888", lw=0.8)
            steps = np.concatenate([[0.0], difference[:, k], [0.0]])
            bottom.step(share, steps, where="post", color=COLOURS[0], lw=1.3)
            bottom.set_ylim(-largest, largest)
            bottom.set_xlim(0, 1)
            bottom.set_xticks((0, 0.5, 1), ("0", "0.5", "1"))
        axes[0, 0].set_ylabel("truths in the bin")
        axes[1, 0].set_ylabel("ECDF difference")
        figure.supxlabel("rank of the truth / number of posterior draws", fontsize="medium")
        if title:
            figure.suptitle(title)
    return figure


def truth_figure(
    fits: Mapping[str, Sequence[Mapping[str, ArrayLike]]],
    truth: Mapping[str, float],
    *,
    overlay: bool = False,
) -> Figure:
    """Marginal densities of posteriors of data with a known truth, which a dashed line marks.

    Figures 3 and, with `overlay`, 10 of the paper.

    Parameters
    ----------
    fits : mapping of name to sequence of mappings
        For each way to fit, the draws of each data set by parameter.
    truth : mapping of parameter to value
        Panels.
    overlay : bool
        All ways in one row of panels, instead of a row for each.

    Returns
    -------
    matplotlib.figure.Figure
    """
    import arviz as az

    names = list(truth)
    rows = 1 if overlay else len(fits)
    with new_figure((2.3 * len(names), 0.7 + 1.9 * rows)) as figure:
        grid = figure.subplots(rows, len(names), squeeze=False, sharex="col")
        for k, (label, posteriors) in enumerate(fits.items()):
            row = grid[0 if overlay else k]
            for axes, name in zip(row, names, strict=True):
                for number, draws in enumerate(posteriors):
                    values = np.asarray(in_scale(name, draws[name]), dtype=float)
                    x, density = az.kde(values)  # ends where the draws do
                    colour = COLOURS[k if overlay else number]
                    axes.plot(x, density, color=colour, lw=1.5, label=label if axes is row[0] else None)
                axes.set_yticks([])
                axes.spines["left"].set_visible(False)
            if not overlay:
                row[0].set_ylabel(label)
        for column, name in enumerate(names):
            for axes in grid[:, column]:
                axes.axvline(float(in_scale(name, truth[name])), color=INK, lw=1.1, ls=(0, (4, 2)))
            grid[-1, column].set_xlabel(broken(parameter_label(name)))
        if overlay:
            figure.legend(
                *grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=len(fits)
            )
    return figure
