"""The chains of one posterior: traces, ranks, pairs of parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import gaussian_kde, rankdata

from zoo.core.arrays import Array
from zoo.core.arviz_lines import InferenceData, dataset
from zoo.core.inference.elements import arrays, scalars
from zoo.plots.style import COLOURS, PARAMETER_LABELS, SCALES, cells_of, new_figure, parameter_label

BINS = 20
"""Of a rank plot."""
FINE = 200
"""Points of a density."""


def _draws(idata: InferenceData, var_names: Iterable[str] | None) -> dict[str, Array]:
    """Draws (n_chains, n_draws, ...) of those asked for, or of all that are not waveforms."""
    if var_names is None:
        posterior = dataset(idata)
        var_names = [str(name) for name in posterior.data_vars if "time" not in posterior[name].dims]
    return arrays(idata, list(var_names))


def _label(element: str, labels: Callable[[str], str]) -> str:
    """Label of a variable, with the index of an element: such as that of chi, [3]."""
    name, bracket, index = element.partition("[")
    return labels(name) + (f" {bracket}{index}" if bracket else "")


def density_of(values: Array) -> tuple[Array, Array]:
    """Points from the smallest to the largest value, and the density there; 0 where all are the same."""
    x = np.linspace(values.min(), values.max(), FINE)
    return x, gaussian_kde(values)(x) if x[0] < x[-1] else np.zeros(FINE)


def trace_figure(idata: InferenceData, var_names: Iterable[str] | None = None) -> Figure:
    """Marginal densities and traces of each chain; elements of a vector share a row, each of its colour.

    Parameters
    ----------
    idata : InferenceData
        With a posterior.
    var_names : iterable of str, optional
        Variables; all but waveforms if absent.

    Returns
    -------
    matplotlib.figure.Figure
    """
    draws = _draws(idata, var_names)
    with new_figure((9.0, 1.5 * len(draws))) as figure:
        rows = figure.subplots(len(draws), 2, squeeze=False)
        for (left, right), (name, values) in zip(rows, draws.items(), strict=True):
            elements = [chains for _, chains in scalars({name: values})]
            for i, chains in enumerate(elements):
                for k, chain in enumerate(chains):
                    colour = COLOURS[(i if len(elements) > 1 else k) % len(COLOURS)]
                    left.plot(*density_of(chain), color=colour, lw=1.0)
                    right.plot(chain, color=colour, lw=0.5, alpha=0.7)
            left.set_yticks([])
            left.set_xlabel(PARAMETER_LABELS.get(name, name))
            right.set_xlabel("draw")
    return figure


def rank_figure(idata: InferenceData, var_names: Iterable[str] | None = None) -> Figure:
    """Rank plots: flat bars if the chains agree (Vehtari et al. 2021, doi 10.1214/20-BA1221).

    Parameters and returns as `trace_figure`.
    """
    found = dict(scalars(_draws(idata, var_names)))
    with new_figure((9.0, 2.2 * math.ceil(len(found) / 3))) as figure:
        for [axes], (name, chains) in zip(cells_of(figure, len(found), 3), found.items(), strict=True):
            edges = np.linspace(0.5, chains.size + 0.5, BINS + 1)
            level = chains.shape[1] / BINS
            for row, ranks in enumerate(rankdata(chains).reshape(chains.shape)):
                counts, _ = np.histogram(ranks, edges)
                look: Any = {
                    "color": COLOURS[row % len(COLOURS)],
                    "align": "edge",
                    "width": 0.95 * np.diff(edges),
                }
                axes.bar(edges[:-1], 0.8 * counts / level, bottom=1.3 * row, **look)
                axes.axhline(1.3 * row + 0.8, color="#888888", lw=0.8, ls="--")
            axes.set_yticks(1.3 * np.arange(len(chains)) + 0.4, [str(chain) for chain in range(len(chains))])
            axes.set_ylabel("chain")
            axes.set_xlabel("rank of all draws", fontsize="small")
            axes.set_title(_label(name, lambda name: PARAMETER_LABELS.get(name, name)))
    return figure


def pair_figure(idata: InferenceData, var_names: Iterable[str] | None = None) -> Figure:
    """Scatter plots of pairs of parameters, marginal densities on the diagonal.

    Parameters and returns as `trace_figure`; at least two variables.
    """
    draws = _draws(idata, var_names)
    scaled = {name: values / 10.0 ** SCALES.get(name, 0) for name, values in draws.items()}
    found = {name: values.ravel() for name, values in scalars(scaled)}
    labels = [_label(name, parameter_label) for name in found]
    n = len(found)
    with new_figure((1.7 * n, 1.7 * n)) as figure:
        panels = figure.subplots(n, n, squeeze=False, sharex="col")
        for (row, column), axes in np.ndenumerate(panels):
            x, y = (list(found.values())[i] for i in (column, row))
            if row < column:
                axes.set_axis_off()
            elif row == column:
                axes.plot(*density_of(x), color=COLOURS[0])
                axes.set_yticks([])
            else:
                axes.scatter(x, y, alpha=0.25, s=9, color=COLOURS[0])
            if row == n - 1:
                axes.set_xlabel(labels[column], fontsize="small")
            if column == 0 < row:
                axes.set_ylabel(labels[row], fontsize="small")
            elif column < row:
                axes.set_yticklabels([])
    return figure
