"""Waves in the vessels of a tree: of one solve, and medians of several models."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from zoo.plots.style import (
    COLOURS,
    INK,
    QUANTITY_LABELS,
    Array,
    FigureError,
    first_of,
    model_style,
    new_figure,
)
from zoo.plots.vessels import (
    SEVEN_VESSELS,
    area_factor,
    draw_observed,
    model_handles,
    observed_at,
    panels_of,
    quantity_label,
    shown_vessels,
    vessel_title,
    width_of,
)

if TYPE_CHECKING:
    import xarray as xr

    from zoo.blood.study import Study


MOST_NAMED = 28
"""Vessels that a legend can name; the colours of more are on a bar."""


def waves_figure(
    waves: xr.Dataset, study: Study | None = None, *, vessels: Sequence[int] | None = None
) -> Figure:
    """Pressure, flow and area over the beat in the vessels of a tree, with the observations if given.

    Parameters
    ----------
    waves : Dataset
        Variables pressure_mmHg, flow_ml_s, area_cm2 with dimensions vessel, position, time (s).
    study : Study, optional
        Its observations are drawn over the waves.
    vessels : sequence of int, optional
        Vessels to show; all if absent.

    Returns
    -------
    matplotlib.figure.Figure
        One panel for each quantity; colour tells the vessel, the line the position. With more than seven
        vessels only the first position is drawn, and with more than `MOST_NAMED` a bar tells the colours.
    """
    shown = [int(v) for v in (waves["vessel"].to_numpy() if vessels is None else vessels)]
    few = len(shown) <= len(COLOURS)
    positions = [float(p) for p in waves["position"].to_numpy()][: 3 if few else 1]
    time_ms = 1e3 * waves["time"].to_numpy()
    observed = study.series if study is not None else ()
    observed_ms = 1e3 * np.asarray(study.time_s) if study is not None else np.empty(0)
    styles: dict[float, Any] = dict(zip(positions, ("-", (0, (5, 2)), (0, (1, 1.5))), strict=False))
    colours = COLOURS if few else mpl.colormaps["viridis"](np.linspace(0, 0.93, len(shown)))
    with new_figure((11.0, 3.9)) as figure:
        for axes, (quantity, label) in zip(figure.subplots(1, 3), QUANTITY_LABELS.items(), strict=True):
            for vessel, colour in zip(shown, colours, strict=False):
                for position in positions:
                    wave = waves[quantity].sel(vessel=vessel, position=position)
                    axes.plot(time_ms, wave, color=colour, ls=styles[position], lw=1.1)
            for series in observed:
                if series.quantity == quantity and series.vessel in shown:
                    name = f"observed {series.label.split()[0]}"
                    axes.plot(observed_ms, series.value, color=INK, lw=1.6, ls=(0, (4, 2)), label=name)
                    axes.legend(loc="best", fontsize="small")
            axes.set_title(label)
            axes.set_xlabel("time in the beat (ms)")
            axes.margins(x=0)
        handles = [Line2D([], [], color="#666666", ls=styles[p], label=f"position {p:g}") for p in positions]
        if len(shown) <= MOST_NAMED:
            named = [vessel_title(waves, v) if few else f"vessel {v}" for v in shown]
            pairs = zip(named, colours, strict=False)
            handles = [*(Line2D([], [], color=colour, label=name) for name, colour in pairs), *handles]
        else:
            scale = mpl.cm.ScalarMappable(mpl.colors.Normalize(1, len(shown)), "viridis")
            bar = figure.colorbar(scale, ax=figure.axes, fraction=0.03, pad=0.01, label="vessel")
            ticks = np.unique(np.linspace(1, len(shown), 6).round().astype(int))
            bar.set_ticks(ticks.tolist(), labels=[str(shown[i - 1]) for i in ticks])
        columns = math.ceil(len(handles) / 14)
        figure.legend(handles=handles, loc="outside right center", fontsize="small", ncols=columns)
    return figure


def models_figure(
    medians: Mapping[str, xr.Dataset],
    study: Study | None = None,
    *,
    quantity: str = "pressure_mmHg",
    vessels: Sequence[int] | None = None,
) -> Figure:
    """Median waves of all models in seven vessels, with the residuals (figure 8, and 9 left, of the paper).

    Parameters
    ----------
    medians : mapping of name to Dataset
        From `zoo.blood.predictive.median_waves`, one for each model.
    study : Study, optional
        Its observed series are drawn where they were observed, and give a panel each at the end with the
        residuals, observed minus median.
    quantity : str
        pressure_mmHg, flow_ml_s or area_cm2.
    vessels : sequence of int, optional
        Panels; seven if absent.

    Returns
    -------
    matplotlib.figure.Figure
        Each model has its colour; dashes tell independent errors.

    Raises
    ------
    FigureError
        If there are no models, or a vessel or quantity is unknown.
    """
    first = first_of(medians, "medians")
    if quantity not in QUANTITY_LABELS:
        raise FigureError(f"quantity = {quantity!r}: must be one of {', '.join(QUANTITY_LABELS)}")
    shown = shown_vessels(first, vessels, SEVEN_VESSELS, study)
    observed = [v for v in shown if observed_at(study, quantity, first, v)]
    factor = area_factor(quantity)
    with panels_of(len(shown) + len(observed), spare=0 if observed else 1) as (figure, panels, rest):
        waves = panels[: len(shown)]
        if quantity == "pressure_mmHg":
            for axes in waves[1:]:
                axes.sharey(waves[0])
                place_in_grid = axes.get_subplotspec()
                axes.tick_params(labelleft=place_in_grid is None or place_in_grid.is_first_col())
            waves[0].yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        for axes, vessel in zip(waves, shown, strict=True):
            for k, (name, data) in enumerate(medians.items()):
                colour, line = model_style(name, k)
                wave = factor * data[quantity].sel(vessel=vessel)
                axes.plot(1e3 * data["time"], wave, color=colour, ls=line, lw=width_of(k, len(medians)))
            draw_observed(axes, study, quantity, first, vessel, factor)
            axes.set_title(vessel_title(first, vessel))
            axes.set_xlim(0, 1e3 * float(first["time"][-1] + first["time"][1]))
        handles = model_handles(medians)
        if observed and study is not None:
            handles.append(Line2D([], [], color="black", lw=1.1, label="observed"))
            for axes, vessel in zip(panels[len(shown) :], observed, strict=True):
                _draw_residuals(axes, medians, study, quantity, vessel)
                unit = quantity_label(quantity).partition(" ")[2]
                axes.set_title(f"residual {unit},\n{vessel_title(first, vessel)}")
        figure.supxlabel("time in the beat (ms)", fontsize="medium")
        figure.supylabel(quantity_label(quantity), fontsize="medium")
        if rest:
            rest[0].legend(handles=handles, loc="center", ncols=2 if len(handles) > 5 else 1)
        else:
            figure.legend(handles=handles, loc="outside right center", fontsize="small")
    return figure


def _draw_residuals(
    axes: Axes, medians: Mapping[str, xr.Dataset], study: Study, quantity: str, vessel: int
) -> None:
    time_s = np.asarray(study.time_s)
    axes.axhline(0, color="#999999", lw=0.8)
    for k, (name, data) in enumerate(medians.items()):
        colour, line = model_style(name, k)
        [observed, *_] = observed_at(study, quantity, data, vessel)
        wave = data[quantity].sel(vessel=vessel).to_numpy()
        predicted = np.interp(time_s, data["time"].to_numpy(), wave, period=study.period_s)
        axes.plot(
            1e3 * time_s,
            area_factor(quantity) * (np.asarray(observed) - predicted),
            color=colour,
            ls=line,
            lw=width_of(k, len(medians)),
        )


def _is_curve(pressure: Array) -> bool:
    """Whether pressures, in the order of their areas, only rise; within a hundredth of their range."""
    return float(np.diff(pressure).min()) > -0.01 * float(np.ptp(pressure))


def loops_figure(
    waves: Mapping[str, xr.Dataset],
    *,
    vessels: Sequence[int] | None = None,
    standardised: bool = False,
) -> Figure:
    """Pressure against cross-sectional area over the beat (figure 9, right, of the paper).

    With elastic walls pressure is a function of area: no loop, but a curve that is passed up and down, and
    the figure says so. What viscoelastic walls do is drawn as the loop that it is. Areas are those of the
    vessels, in cm2. The paper shows (A - l)/(u - l), with the least and largest area l and u of each vessel;
    with `standardised` so does this figure, l and u taken over the models shown.

    Parameters
    ----------
    waves : mapping of name to Dataset
        From `zoo.blood.predictive.waves_at_medians`, one for each model: in one solve pressure and area
        belong together, as they do not in pointwise medians.
    vessels : sequence of int, optional
        Panels; seven if absent. All vessels: ``list(waves[name].vessel.values)``.
    standardised : bool
        Areas between 0 and 1.

    Returns
    -------
    matplotlib.figure.Figure
        Each model has its colour; dashes tell independent errors.

    Raises
    ------
    FigureError
        If there are no models, or a vessel is unknown.
    """
    first = first_of(waves, "waves")
    shown = shown_vessels(first, vessels, SEVEN_VESSELS)
    loops = False
    with panels_of(len(shown), sharey=True, sharex=standardised, spare=1) as (figure, panels, rest):
        for axes, vessel in zip(panels, shown, strict=True):
            areas = {name: data["area_cm2"].sel(vessel=vessel).to_numpy() for name, data in waves.items()}
            least = min(area.min() for area in areas.values())
            largest = max(area.max() for area in areas.values())
            for k, (name, data) in enumerate(waves.items()):
                colour, line = model_style(name, k)
                area = (areas[name] - least) / (largest - least) if standardised else 1e3 * areas[name]
                pressure = data["pressure_mmHg"].sel(vessel=vessel).to_numpy()
                order = np.argsort(area)  # a curve is passed once, so that dashes stay dashes
                if not _is_curve(pressure[order]):
                    order, loops = np.append(np.arange(len(area)), 0), True
                axes.plot(area[order], pressure[order], color=colour, ls=line, lw=width_of(k, len(waves)))
            axes.set_title(vessel_title(first, vessel))
            if not standardised:
                axes.xaxis.set_major_locator(MaxNLocator(4))
        if not loops:
            figure.suptitle("pressure against area over the beat: elastic walls have a curve, no loop")
        panels[0].yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        label = "standardised area" if standardised else quantity_label("area_cm2")
        figure.supxlabel(label, fontsize="medium")
        figure.supylabel(QUANTITY_LABELS["pressure_mmHg"], fontsize="medium")
        rest[0].legend(handles=model_handles(waves), loc="center", ncols=2 if len(waves) > 5 else 1)
    return figure
