"""Several posteriors beside each other: densities, pairs, intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from zoo.plots.style import (
    PARAMETER_LABELS,
    Array,
    FigureError,
    broken,
    first_of,
    in_scale,
    model_style,
    new_figure,
    parameter_label,
)

if TYPE_CHECKING:
    import arviz as az
    import xarray as xr


def posteriors_figure(
    posteriors: Mapping[str, az.InferenceData | xr.Dataset], var_names: Iterable[str] | None = None
) -> Figure:
    """Marginal densities and pairs of parameters of several posteriors (figure 4 of the paper).

    Densities are scaled to the same height, since a posterior with independent errors is many times narrower.

    Parameters
    ----------
    posteriors : mapping of name to InferenceData or Dataset
        Such as those of models A and B.
    var_names : iterable of str, optional
        Scalars; those that all have if absent, in the order of the first.

    Returns
    -------
    matplotlib.figure.Figure
        Densities on the diagonal, scatter plots of at most 1000 draws each below.

    Raises
    ------
    FigureError
        If the posteriors have no parameter in common, or not those asked for.
    """
    import arviz as az

    first_of(posteriors, "posteriors")
    draws: dict[str, dict[str, Array]] = {}
    for name, posterior in posteriors.items():
        data = posterior["posterior"] if isinstance(posterior, az.InferenceData) else posterior
        scalars = [str(v) for v in data.data_vars if set(data[v].dims) == {"chain", "draw"}]
        draws[name] = {v: in_scale(v, data[v].transpose("chain", "draw")).ravel() for v in scalars}
    every = list(draws.values())
    names = [v for v in every[0] if all(v in each for each in every)]
    if var_names is not None:
        wanted = list(var_names)
        for v in wanted:
            if v not in names:
                raise FigureError(f"parameter {v!r}: the posteriors share {', '.join(names) or 'none'}")
        names = wanted
    if not names:
        raise FigureError("the posteriors have no scalar parameter in common; choose others")
    n = len(names)
    with new_figure((1.0 + 1.65 * n, 0.6 + 1.5 * n)) as figure:
        grid = figure.subplots(n, n, squeeze=False, sharex="col")
        for k, (name, values) in reversed(list(enumerate(draws.items()))):
            colour = model_style(name, k)[0]
            step = max(1, math.ceil(len(values[names[0]]) / 1000))
            for i, below in enumerate(names):
                x, density = az.kde(values[below])
                grid[i, i].plot(x, density / density.max(), color=colour, lw=1.5)
                grid[i, i].fill_between(x, density / density.max(), color=colour, alpha=0.2, lw=0)
                for j, across in enumerate(names[:i]):
                    points = values[across][::step], values[below][::step]
                    grid[i, j].scatter(*points, s=4, color=colour, alpha=0.3, lw=0, rasterized=True)
        for i, below in enumerate(names):
            for j in range(n):
                axes = grid[i, j]
                axes.xaxis.set_major_locator(MaxNLocator(3))
                axes.yaxis.set_major_locator(MaxNLocator(3))
                if j > i:
                    axes.set_axis_off()
                axes.tick_params(labelleft=j == 0 and i > 0, labelsize="small")
            grid[i, i].set_yticks([])
            grid[i, i].spines["left"].set_visible(False)
            grid[i, i].set_ylim(bottom=0)
            if i > 0:
                grid[i, 0].set_ylabel(broken(parameter_label(below)), fontsize="small")
            grid[-1, i].set_xlabel(broken(parameter_label(below)), fontsize="small")
        figure.align_ylabels(grid[1:, 0])
        handles = [
            Line2D([], [], color=model_style(model, k)[0], lw=2, label=f"model {model}")
            for k, model in enumerate(draws)
        ]
        figure.legend(handles=handles, loc="upper right")
    return figure


def forest_figure(posteriors: Mapping[str, az.InferenceData]) -> Figure:
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
        posterior = idata["posterior"]
        for name in map(str, posterior.data_vars):
            if set(posterior[name].dims) == {"chain", "draw"}:
                found.setdefault(name, {})[model] = posterior[name].to_numpy().ravel()
    known = list(PARAMETER_LABELS)
    names = sorted(found, key=lambda name: known.index(name) if name in known else len(known))
    columns = min(4, max(1, len(names)))
    rows = max(1, math.ceil(len(names) / columns))
    models = list(posteriors)
    with new_figure((2.5 * columns, rows * (0.75 + 0.2 * len(models)))) as figure:
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=False):
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
            axes.xaxis.set_major_locator(mpl.ticker.MaxNLocator(3))
            axes.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4), useMathText=True)
            axes.grid(axis="x", color="#DDDDDD", lw=0.7)
            axes.set_axisbelow(True)
        for axes in panels[len(names) :]:
            axes.set_visible(False)
    return figure
