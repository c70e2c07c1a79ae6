"""Waves in the vessels of a tree: of one solve, medians of several models, and bands of one model."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from zoo.blood.predictive import one_place
from zoo.core.arrays import Array
from zoo.core.draws import evenly
from zoo.plots.style import (
    COLOURS,
    INK,
    QUANTITY_LABELS,
    FigureError,
    measured,
    model_style,
    new_figure,
)

if TYPE_CHECKING:
    import xarray as xr

    from zoo.blood.study import Study

SEVEN_VESSELS = (1, 2, 3, 4, 8, 12, 21)
"""The paper's text names six of the seven vessels in its figures 8 and 9; 21 is ours."""
PAPER_VESSELS = 21
MOST_NAMED = 28
"""Vessels that a legend can name; the colours of more are on a bar."""


def shown_vessels(
    data: xr.Dataset, wanted: Sequence[int] | None, usual: Sequence[int], study: Study | None = None
) -> list[int]:
    """Vessels to show: those asked for, or the usual ones in the paper's tree.

    Of other trees the first, those that were observed, and more that lie evenly from the first to the last.
    """
    there = [int(v) for v in data["vessel"].to_numpy()]
    if wanted is not None:
        chosen = list(wanted)
    elif there == list(range(1, PAPER_VESSELS + 1)):
        chosen = list(usual)
    else:
        observed = [s.vessel for s in study.series if s.vessel in there] if study is not None else []
        even = evenly(len(there), len(usual))
        wanted_first = dict.fromkeys([there[0], *observed, *(there[i] for i in even)])
        some = list(wanted_first)[: max(len(usual), 1 + len(set(observed)))]
        chosen = [vessel for vessel in there if vessel in some]
    for vessel in chosen:
        if vessel not in there:
            raise FigureError(
                f"vessel {vessel}: the waves have {', '.join(map(str, there))}; choose of these"
            )
    return chosen


def vessel_title(data: xr.Dataset, vessel: int) -> str:
    """A vessel's name, or its number where it has none."""
    name = str(data["name"].sel(vessel=vessel).item()) if "name" in data.coords else ""
    if name in ("", f"v{vessel}"):
        return f"vessel {vessel}"
    return textwrap.fill(name.replace("_", " "), 24).replace("$", r"\$")  # which else begins a formula


def observed_at(study: Study | None, quantity: str, data: xr.Dataset, vessel: int) -> list[ArrayLike]:
    """Observed series of a quantity where the vessel is looked at."""
    if study is None:
        return []
    position = float(data["position"].sel(vessel=vessel)) if "position" in data.coords else 0.0
    found = [s for s in study.series if (s.vessel, s.quantity) == (vessel, quantity)]
    return [s.value for s in found if s.position == position]


def draw_observed(
    axes: Axes, study: Study | None, quantity: str, data: xr.Dataset, vessel: int, factor: float = 1.0
) -> bool:
    """Draw what was observed where the vessel is looked at, times a factor; whether anything was."""
    observed = observed_at(study, quantity, data, vessel)
    for values in observed:
        time_ms = 1e3 * np.asarray(study.time_s) if study is not None else np.empty(0)
        axes.plot(*measured(time_ms, factor * np.asarray(values)), color="black", lw=1.1, zorder=3)
    return bool(observed)


def area_factor(quantity: str) -> float:
    """From a quantity's unit to that of its axis."""
    return 1e3 if quantity == "area_cm2" else 1.0


def quantity_label(quantity: str) -> str:
    """A quantity's name and unit on an axis."""
    return "area (10$^{-3}$ cm$^2$)" if quantity == "area_cm2" else QUANTITY_LABELS[quantity]


@contextmanager
def panels_of(
    n: int, *, sharey: bool = False, sharex: bool = True, spare: int = 0
) -> Iterator[tuple[Figure, list[Axes], list[Axes]]]:
    """Figure with `n` panels and `spare` empty ones at least, and the empty ones without frames."""
    columns = min(n + spare, 4 if n + spare <= 8 else 6)
    rows = math.ceil((n + spare) / columns)
    with new_figure((1.0 + 2.05 * columns, 0.9 + 1.75 * rows)) as figure:
        grid = figure.subplots(rows, columns, squeeze=False, sharex=sharex, sharey=sharey)
        every: list[Axes] = list(grid.flat)
        for axes in every[n:]:
            axes.set_axis_off()
        if sharex:
            for axes in every[max(0, n - columns) : n]:
                axes.tick_params(labelbottom=True)
        yield figure, every[:n], every[n:]


def width_of(order: int, n: int) -> float:
    """Line width, less for later models, so that those on top of each other can be seen."""
    return 2.3 - 1.3 * order / max(1, n - 1) if n > 1 else 1.3


def _model_looks(names: Collection[str]) -> dict[str, dict[str, Any]]:
    """Colour, line and width of each model."""
    looks = {}
    for k, name in enumerate(names):
        colour, line = model_style(name, k)
        looks[name] = {"color": colour, "ls": line, "lw": width_of(k, len(names))}
    return looks


def _model_handles(looks: Mapping[str, Mapping[str, Any]]) -> list[Any]:
    return [Line2D([], [], **{**look, "lw": 1.6}, label=f"model {name}") for name, look in looks.items()]


def _label_all(figure: Figure, x: str, y: str) -> None:
    figure.supxlabel(x, fontsize="medium")
    figure.supylabel(y, fontsize="medium")


def _first_of(waves: Mapping[str, xr.Dataset], what: str) -> xr.Dataset:
    if not waves:
        raise FigureError(f"no {what}: give at least one")
    return next(iter(waves.values()))


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
                    seen = measured(observed_ms, series.value)
                    axes.plot(*seen, color=INK, lw=1.6, ls=(0, (4, 2)), label=name)
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
    first = _first_of(medians, "medians")
    if quantity not in QUANTITY_LABELS:
        raise FigureError(f"quantity = {quantity!r}: must be one of {', '.join(QUANTITY_LABELS)}")
    shown = shown_vessels(first, vessels, SEVEN_VESSELS, study)
    observed = [v for v in shown if observed_at(study, quantity, first, v)]
    factor = area_factor(quantity)
    looks = _model_looks(medians)
    with panels_of(len(shown) + len(observed), spare=0 if observed else 1) as (figure, panels, rest):
        waves = panels[: len(shown)]
        if quantity == "pressure_mmHg":
            for axes in waves[1:]:
                axes.sharey(waves[0])
                place_in_grid = axes.get_subplotspec()
                axes.tick_params(labelleft=place_in_grid is None or place_in_grid.is_first_col())
            waves[0].yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        for axes, vessel in zip(waves, shown, strict=True):
            for name, data in medians.items():
                axes.plot(1e3 * data["time"], factor * data[quantity].sel(vessel=vessel), **looks[name])
            draw_observed(axes, study, quantity, first, vessel, factor)
            axes.set_title(vessel_title(first, vessel))
            axes.set_xlim(0, 1e3 * float(first["time"][-1] + first["time"][1]))
        handles = _model_handles(looks)
        if observed and study is not None:
            handles.append(Line2D([], [], color="black", lw=1.1, label="observed"))
            for axes, vessel in zip(panels[len(shown) :], observed, strict=True):
                _draw_residuals(axes, medians, looks, study, quantity, vessel)
                unit = quantity_label(quantity).partition(" ")[2]
                axes.set_title(f"residual {unit},\n{vessel_title(first, vessel)}")
        _label_all(figure, "time in the beat (ms)", quantity_label(quantity))
        if rest:
            rest[0].legend(handles=handles, loc="center", ncols=2 if len(handles) > 5 else 1)
        else:
            figure.legend(handles=handles, loc="outside right center", fontsize="small")
    return figure


def _draw_residuals(
    axes: Axes,
    medians: Mapping[str, xr.Dataset],
    looks: Mapping[str, Any],
    study: Study,
    quantity: str,
    vessel: int,
) -> None:
    time_s = np.asarray(study.time_s)
    axes.axhline(0, color="#999999", lw=0.8)
    for name, data in medians.items():
        [observed, *_] = observed_at(study, quantity, data, vessel)
        wave = data[quantity].sel(vessel=vessel).to_numpy()
        predicted = np.interp(time_s, data["time"].to_numpy(), wave, period=study.period_s)
        residual = area_factor(quantity) * (np.asarray(observed) - predicted)
        axes.plot(*measured(1e3 * time_s, residual), **looks[name])


def _is_curve(pressure: Array) -> bool:
    """Whether pressures, in the order of their areas, only rise; within a hundredth of their range."""
    return float(np.diff(pressure).min()) > -0.01 * float(np.ptp(pressure))


def loops_figure(waves: Mapping[str, xr.Dataset], *, vessels: Sequence[int] | None = None) -> Figure:
    """Pressure against cross-sectional area over the beat (figure 9, right, of the paper).

    With elastic walls pressure is a function of area: no loop, but a curve that is passed up and down, and
    the figure says so. What viscoelastic walls do is drawn as the loop that it is. Areas are those of the
    vessels, in cm2; the paper shows (A - l)/(u - l), with the least and largest area l and u of each vessel.

    Parameters
    ----------
    waves : mapping of name to Dataset
        From `zoo.blood.predictive.waves_at_medians`, one for each model: in one solve pressure and area
        belong together, as they do not in pointwise medians.
    vessels : sequence of int, optional
        Panels; seven if absent. All vessels: ``list(waves[name].vessel.values)``.

    Returns
    -------
    matplotlib.figure.Figure
        Each model has its colour; dashes tell independent errors.

    Raises
    ------
    FigureError
        If there are no models, or a vessel is unknown.
    """
    first = _first_of(waves, "waves")
    shown = shown_vessels(first, vessels, SEVEN_VESSELS)
    looks = _model_looks(waves)
    loops = False
    with panels_of(len(shown), sharey=True, sharex=False, spare=1) as (figure, panels, rest):
        for axes, vessel in zip(panels, shown, strict=True):
            for name, data in waves.items():
                one = data.sel(vessel=vessel)
                area, pressure = 1e3 * one["area_cm2"].to_numpy(), one["pressure_mmHg"].to_numpy()
                order = np.argsort(area)  # a curve is passed once, so that dashes stay dashes
                if not _is_curve(pressure[order]):
                    order, loops = np.append(np.arange(len(area)), 0), True
                axes.plot(area[order], pressure[order], **looks[name])
            axes.set_title(vessel_title(first, vessel))
            axes.xaxis.set_major_locator(MaxNLocator(4))
        if not loops:
            figure.suptitle("pressure against area over the beat: elastic walls have a curve, no loop")
        panels[0].yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        _label_all(figure, quantity_label("area_cm2"), QUANTITY_LABELS["pressure_mmHg"])
        rest[0].legend(handles=_model_handles(looks), loc="center", ncols=2 if len(waves) > 5 else 1)
    return figure


def draw_bands(axes: Axes, data: xr.Dataset, vessel: int, colour: str, factor: float = 1.0) -> None:
    """The widest prediction band if there is one, credible band and median of one vessel, times a factor."""
    one = data.sel(vessel=vessel, prob=data["prob"].max())
    time_ms = 1e3 * one["time"].to_numpy()
    for kind, alpha in (("prediction_", 0.2), ("", 0.5)):
        if f"{kind}low" in one:
            low, high = (factor * one[f"{kind}{end}"] for end in ("low", "high"))
            axes.fill_between(time_ms, low, high, color=colour, alpha=alpha, lw=0)
    axes.plot(time_ms, factor * one["median"], color=colour, lw=1.2)
    axes.set_xlim(time_ms[0], 1e3 * float(data["time"][-1] + data["time"][1]))


def band_handles(data: xr.Dataset, colour: str, *, observed: bool) -> list[Any]:
    """Handles of what `draw_bands` draws, and of observations."""
    prob = float(data["prob"].max())
    patch = mpl.patches.Patch
    handles: list[Any] = [Line2D([], [], color=colour, lw=1.4, label="posterior median")]
    handles.append(patch(color=colour, alpha=0.55, lw=0, label=f"{100 * prob:g} % credible"))
    if "prediction_low" in data:
        handles.append(patch(color=colour, alpha=0.2, lw=0, label=f"{100 * prob:g} % prediction"))
    if observed:
        handles.append(Line2D([], [], color="black", lw=1.1, label="observed"))
    return handles


def all_vessels_figure(bands: xr.Dataset, study: Study | None = None, *, title: str = "") -> Figure:
    """Bands of one model in all vessels.

    Parameters
    ----------
    bands : Dataset
        From `zoo.blood.predictive.bands`; the widest are drawn, prediction bands if there.
    study : Study, optional
        Its observed series are drawn where they were observed.
    title : str
        Above the panels.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each vessel; pressures have one scale.
    """
    data = one_place(bands)
    quantity = str(data.attrs["quantity"])
    shown = [int(v) for v in data["vessel"].to_numpy()]
    colour = model_style(str(data.attrs.get("model", "")))[0]
    observed = False
    with panels_of(len(shown), sharey=quantity == "pressure_mmHg", spare=1) as (figure, panels, rest):
        for axes, vessel in zip(panels, shown, strict=True):
            factor = area_factor(quantity)
            draw_bands(axes, data, vessel, colour, factor)
            observed |= draw_observed(axes, study, quantity, data, vessel, factor)
            axes.set_title(vessel_title(data, vessel))
        _label_all(figure, "time in the beat (ms)", quantity_label(quantity))
        rest[0].legend(handles=band_handles(data, colour, observed=observed), loc="center")
        if title:
            figure.suptitle(title, parse_math=False)
    return figure
