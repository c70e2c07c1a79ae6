"""Credible and prediction bands in the vessels of a tree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from zoo.blood.predictive import one_place
from zoo.plots.style import QUANTITY_LABELS, FigureError, first_of, model_style, new_figure
from zoo.plots.vessels import (
    FOUR_VESSELS,
    area_factor,
    draw_observed,
    panels_of,
    quantity_label,
    shown_vessels,
    vessel_title,
)

if TYPE_CHECKING:
    import xarray as xr

    from zoo.blood.study import Study


def _draw_bands(axes: Axes, data: xr.Dataset, vessel: int, prob: float, colour: str) -> None:
    """Prediction band if there is one, credible band and median of one vessel."""
    one = data.sel(vessel=vessel)
    time_ms = 1e3 * one["time"].to_numpy()
    if "prediction_low" in one:
        low, high = (one[f"prediction_{end}"].sel(prob=prob) for end in ("low", "high"))
        axes.fill_between(time_ms, low, high, color=colour, alpha=0.2, lw=0)
    low, high = (one[end].sel(prob=prob) for end in ("low", "high"))
    axes.fill_between(time_ms, low, high, color=colour, alpha=0.5, lw=0)
    axes.plot(time_ms, one["median"], color=colour, lw=1.2)
    axes.set_xlim(time_ms[0], 1e3 * float(data["time"][-1] + data["time"][1]))


def _band_handles(prob: float, colour: str, *, prediction: bool, observed: bool) -> list[Any]:
    patch = mpl.patches.Patch
    handles: list[Any] = [Line2D([], [], color=colour, lw=1.4, label="posterior median")]
    handles.append(patch(color=colour, alpha=0.55, lw=0, label=f"{100 * prob:g} % credible"))
    if prediction:
        handles.append(patch(color=colour, alpha=0.2, lw=0, label=f"{100 * prob:g} % prediction"))
    if observed:
        handles.append(Line2D([], [], color="black", lw=1.1, label="observed"))
    return handles


def _check_prob(data: xr.Dataset, prob: float) -> None:
    if prob not in data["prob"]:
        have = ", ".join(f"{float(p):g}" for p in data["prob"].to_numpy())
        raise FigureError(f"prob = {prob:g}: the bands have {have}; choose of these")


def _scaled(data: xr.Dataset, factor: float) -> xr.Dataset:
    return data if factor == 1 else data.map(lambda variable: variable * factor, keep_attrs=True)


def uncertainty_figure(
    bands: Mapping[str, xr.Dataset],
    study: Study | None = None,
    *,
    vessels: Sequence[int] | None = None,
    prob: float = 0.95,
) -> Figure:
    """Credible and prediction bands of several models in a few vessels (figure 5 of the paper).

    Parameters
    ----------
    bands : mapping of name to Dataset
        From `zoo.blood.predictive.bands`, one for each model, of one quantity; prediction bands
        are drawn if there.
    study : Study, optional
        Its observed series are drawn where they were observed.
    vessels : sequence of int, optional
        Rows; four if absent.
    prob : float
        Of the bands.

    Returns
    -------
    matplotlib.figure.Figure
        A column for each model, a row for each vessel; one scale for all.

    Raises
    ------
    FigureError
        If a vessel or the probability is not in the bands.
    """
    first = one_place(first_of(bands, "bands"))
    shown = shown_vessels(first, vessels, FOUR_VESSELS, study)
    quantity = str(first.attrs["quantity"])
    pressure = quantity == "pressure_mmHg"
    observed = False
    with new_figure((1.2 + 2.7 * len(bands), 1.0 + 1.75 * len(shown))) as figure:
        grid = figure.subplots(
            len(shown), len(bands), squeeze=False, sharex=True, sharey="all" if pressure else "row"
        )
        for column, (name, data) in enumerate(bands.items()):
            _check_prob(data, prob)
            data = one_place(data)
            for row, vessel in enumerate(shown):
                axes = grid[row, column]
                _draw_bands(axes, data, vessel, prob, model_style(name, column)[0])
                observed |= draw_observed(axes, study, quantity, data, vessel)
                if column == 0:
                    axes.set_ylabel(f"{vessel_title(data, vessel)}\n{QUANTITY_LABELS[quantity]}")
            grid[0, column].set_title(f"model {name}")
            grid[-1, column].set_xlabel("time in the beat (ms)")
        prediction = any("prediction_low" in data for data in bands.values())
        handles = _band_handles(prob, "#555555", prediction=prediction, observed=observed)
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize="small")
    return figure


def all_vessels_figure(
    bands: xr.Dataset, study: Study | None = None, *, prob: float = 0.95, title: str = ""
) -> Figure:
    """Bands of one model in all vessels.

    Parameters
    ----------
    bands : Dataset
        From `zoo.blood.predictive.bands`; prediction bands are drawn if there.
    study : Study, optional
        Its observed series are drawn where they were observed.
    prob : float
        Of the bands.
    title : str
        Above the panels.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each vessel; pressures have one scale.

    Raises
    ------
    FigureError
        If the probability is not in the bands.
    """
    _check_prob(bands, prob)
    data = one_place(bands)
    quantity = str(data.attrs["quantity"])
    shown = [int(v) for v in data["vessel"].to_numpy()]
    colour = model_style(str(data.attrs.get("model", "")))[0]
    observed = False
    with panels_of(len(shown), sharey=quantity == "pressure_mmHg", spare=1) as (figure, panels, rest):
        for axes, vessel in zip(panels, shown, strict=True):
            factor = area_factor(quantity)
            _draw_bands(axes, _scaled(data, factor), vessel, prob, colour)
            observed |= draw_observed(axes, study, quantity, data, vessel, factor)
            axes.set_title(vessel_title(data, vessel))
        figure.supxlabel("time in the beat (ms)", fontsize="medium")
        figure.supylabel(quantity_label(quantity), fontsize="medium")
        prediction = "prediction_low" in data
        rest[0].legend(
            handles=_band_handles(prob, colour, prediction=prediction, observed=observed), loc="center"
        )
        if title:
            figure.suptitle(title)
    return figure
