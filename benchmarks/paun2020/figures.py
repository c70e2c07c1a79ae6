"""Figures 4, 5 and 11 of the paper: several posteriors and their bands beside each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from zoo.blood.predictive import one_place
from zoo.core.arviz_lines import InferenceData, dataset
from zoo.plots.chains import density_of
from zoo.plots.style import QUANTITY_LABELS, SCALES, legend_below, model_style, new_figure, parameter_label
from zoo.plots.waves import band_handles, draw_bands, draw_observed, shown_vessels, vessel_title

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from zoo.blood.study import Study

FOUR_VESSELS = (1, 3, 8, 21)


def uncertainty_figure(bands: Mapping[str, xr.Dataset], study: Study) -> Figure:
    """Credible and prediction bands of several models in four vessels, on one scale (figure 5)."""
    first = one_place(next(iter(bands.values())))
    shown = shown_vessels(first, None, FOUR_VESSELS, study)
    quantity = str(first.attrs["quantity"])
    observed = False
    with new_figure((1.2 + 2.7 * len(bands), 1.0 + 1.75 * len(shown))) as figure:
        grid = figure.subplots(
            len(shown),
            len(bands),
            squeeze=False,
            sharex=True,
            sharey="all" if quantity == "pressure_mmHg" else "row",
        )
        for column, (name, data) in enumerate(bands.items()):
            data = one_place(data)
            for row, vessel in enumerate(shown):
                axes = grid[row, column]
                draw_bands(axes, data, vessel, model_style(name, column)[0])
                observed |= draw_observed(axes, study, quantity, data, vessel)
                if column == 0:
                    axes.set_ylabel(f"{vessel_title(data, vessel)}\n{QUANTITY_LABELS[quantity]}")
            grid[0, column].set_title(f"model {name}")
            grid[-1, column].set_xlabel("time in the beat (ms)")
        handles = band_handles(first, "#555555", observed=observed)
        legend_below(figure, handles, len(handles))
    return figure


def posteriors_figure(
    posteriors: Mapping[str, InferenceData], var_names: Sequence[str] | None = None
) -> Figure:
    """Marginal densities and pairs of the scalars that several posteriors share (figure 4).

    Densities are scaled to the same height, since a posterior with independent errors is many times narrower;
    scatter plots have at most 1000 draws each.
    """
    draws = {}
    for name, idata in posteriors.items():
        data = dataset(idata)
        scalars = [str(v) for v in data.data_vars if set(data[v].dims) == {"chain", "draw"}]
        draws[name] = {v: data[v].to_numpy().ravel() / 10.0 ** SCALES.get(v, 0) for v in scalars}
    every = list(draws.values())
    names = list(var_names or [v for v in every[0] if all(v in each for each in every)])
    n = len(names)
    with new_figure((1.0 + 1.65 * n, 0.6 + 1.5 * n)) as figure:
        grid = figure.subplots(n, n, squeeze=False, sharex="col")
        for k, (name, values) in reversed(list(enumerate(draws.items()))):
            colour = model_style(name, k)[0]
            step = max(1, math.ceil(len(values[names[0]]) / 1000))
            for i, below in enumerate(names):
                x, density = density_of(values[below])
                grid[i, i].plot(x, density / density.max(), color=colour, lw=1.5)
                grid[i, i].fill_between(x, density / density.max(), color=colour, alpha=0.2, lw=0)
                for j, across in enumerate(names[:i]):
                    points = values[across][::step], values[below][::step]
                    grid[i, j].scatter(*points, s=4, color=colour, alpha=0.3, lw=0, rasterized=True)
        for (i, j), axes in np.ndenumerate(grid):
            axes.xaxis.set_major_locator(MaxNLocator(3))
            axes.yaxis.set_major_locator(MaxNLocator(3))
            if j > i:
                axes.set_axis_off()
            axes.tick_params(labelleft=j == 0 and i > 0, labelsize="small")
        for i, name in enumerate(names):
            label = parameter_label(name).replace(" (", "\n(", 1)  # the unit on a second line
            grid[i, i].set_yticks([])
            grid[i, i].spines["left"].set_visible(False)
            grid[i, i].set_ylim(bottom=0)
            if i > 0:
                grid[i, 0].set_ylabel(label, fontsize="small")
            grid[-1, i].set_xlabel(label, fontsize="small")
        figure.align_ylabels(grid[1:, 0])
        handles = [
            Line2D([], [], color=model_style(model, k)[0], lw=2, label=f"model {model}")
            for k, model in enumerate(draws)
        ]
        figure.legend(handles=handles, loc="upper right")
    return figure
