"""Stiffness of the vessels, and how the pressure depends on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from zoo.plots.style import (
    COLOURS,
    PARAMETER_LABELS,
    Array,
    first_of,
    in_scale,
    model_style,
    new_figure,
    parameter_label,
)

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


def stiffness_figure(stiffness: Mapping[str, xr.DataArray]) -> Figure:
    """Stiffness of every vessel against its radius at rest (figure 6, right, of the paper).

    Parameters
    ----------
    stiffness : mapping of name to DataArray
        From `zoo.blood.predictive.stiffness_draws`, one for each model.

    Returns
    -------
    matplotlib.figure.Figure
        Posterior medians and 95 % intervals, with the number of each vessel; those of nearly the same
        radius stand a little apart.
    """
    first_of(stiffness, "stiffness draws")
    with new_figure((8.2, 4.2)) as figure:
        axes = figure.subplots()
        tops: dict[int, tuple[float, float]] = {}
        for k, (name, draws) in enumerate(stiffness.items()):
            radius = draws["radius_cm"].to_numpy()
            widest = float(radius.max())
            low, median, high = in_scale("chi", draws.quantile((0.025, 0.5, 0.975), ("chain", "draw")))
            x = _apart(radius, 0.0128 * widest) + 0.0038 * widest * (k - (len(stiffness) - 1) / 2)
            colour = model_style(name, k)[0]
            errors = np.stack([median - low, high - median])
            axes.errorbar(
                x,
                median,
                errors,
                fmt="osD^v"[k % 5],
                color=colour,
                ms=4,
                lw=1.2,
                capsize=2,
                label=f"model {name}",
            )
            for vessel, at, top in zip(draws["vessel"].to_numpy(), x, high, strict=True):
                tops[int(vessel)] = at, max(top, tops.get(int(vessel), (0, 0))[1])
        for vessel, (at, top) in tops.items():
            axes.annotate(
                str(vessel), (at, top), (0, 3), textcoords="offset points", ha="center", fontsize="x-small"
            )
        axes.set_xlabel("radius at rest, $r_0$ (cm); the number is the vessel's")
        axes.set_ylabel(parameter_label("chi"))
        axes.set_ylim(bottom=0)
        axes.legend(loc="best", fontsize="small", title="median and 95 % interval", title_fontsize="small")
    return figure


def _apart(values: Array, distance: float) -> Array:
    """Values moved as little as possible so that neighbours are `distance` apart, groups kept centred."""
    order = np.argsort(values, kind="stable")
    moved = values[order].astype(float)
    for _ in range(200):
        gap = distance - np.diff(moved)
        push = 0.5 * np.clip(gap, 0, None)
        if not np.any(gap > 1e-9):
            break
        moved[:-1] -= 0.5 * push
        moved[1:] += 0.5 * push
    back = np.empty_like(moved)
    back[order] = moved
    return back


def pressure_stiffness_figure(table: pd.DataFrame, estimate: float | None = None) -> Figure:
    """Systolic, diastolic and pulse pressure against stiffness (figure 7 of the paper).

    Parameters
    ----------
    table : DataFrame
        From `zoo.blood.predictive.pressure_against_stiffness`; stiffnesses whose solve failed are left out.
    estimate : float, optional
        Stiffness to mark with crosses, g cm-1 s-2.

    Returns
    -------
    matplotlib.figure.Figure
    """
    good = table[table["status"] == "ok"].sort_values("stiffness_g_cm_s2")
    chi = good["stiffness_g_cm_s2"].to_numpy()
    with new_figure((5.6, 3.8)) as figure:
        axes = figure.subplots()
        for k, name in enumerate(("systolic", "diastolic", "pulse")):
            pressure = good[f"{name}_mmHg"].to_numpy()
            axes.plot(chi, pressure, color=COLOURS[k], lw=1.6, label=name)
            if estimate is not None:
                at = float(np.interp(math.log(estimate), np.log(chi), pressure))
                axes.plot(estimate, at, "x", color="black", ms=7, mew=1.6, zorder=3)
        if estimate is not None:
            exponent = math.floor(math.log10(estimate))
            text = rf"estimate, {estimate / 10**exponent:.2f} $\times$ 10$^{exponent}$"
            axes.plot([], [], "x", color="black", ms=7, mew=1.6, label=text)
        axes.set_xscale("log")
        axes.set_xlabel(PARAMETER_LABELS["chi"].replace(r"$\chi$", r"stiffness $\chi$"))
        axes.set_ylabel("pressure at the root's inlet (mmHg)")
        axes.set_ylim(bottom=0)
        axes.legend(loc="best", fontsize="small")
    return figure
