"""Figures: fits, chains, comparisons, waves, predictions in all vessels; the only use of matplotlib."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, SymmetricalLogLocator
from numpy.typing import ArrayLike, NDArray

from zoo.blood.effects import Place
from zoo.blood.predictive import one_place
from zoo.core.diagnosis.diagnosis import PHASES, HypothesisResult, PlaceShare, SeriesGap, phases
from zoo.core.diagnosis.screening import CORRELATED, NO_GAP, UNLISTED

if TYPE_CHECKING:
    import arviz as az
    import pandas as pd
    import xarray as xr

    from zoo.blood.blind import Score
    from zoo.blood.study import Study, Vessel
    from zoo.core.diagnosis.diagnosis import Diagnosis
    from zoo.paper.calibration import RankTest

Array = NDArray[np.float64]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8A7A00")
"""Okabe and Ito's palette without black, its yellow darkened; told apart with any colour vision."""
INK = "#222222"
STYLE: Any = {
    "axes.edgecolor": "#666666",
    "axes.labelcolor": INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": "medium",
    "axes.titleweight": "bold",
    "figure.dpi": 110,
    "font.size": 9.5,
    "legend.frameon": False,
    "savefig.bbox": "tight",
    "savefig.dpi": 160,
    "text.color": INK,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
}
QUANTITY_LABELS = {
    "pressure_mmHg": "pressure (mmHg)",
    "flow_ml_s": "flow (ml/s)",
    "area_cm2": "area (cm$^2$)",
}
PARAMETER_LABELS = {
    "f1": "$f_1$ (g cm$^{-1}$ s$^{-2}$)",
    "f2": "$f_2$ (1/radius unit)",
    "f3": "$f_3$ (g cm$^{-1}$ s$^{-2}$)",
    "chi": r"$\chi$ (g cm$^{-1}$ s$^{-2}$)",
    "m_chi": r"$m_\chi$ (g cm$^{-1}$ s$^{-2}$)",
    "v_chi": r"$v_\chi$ (10$^8$ g$^2$ cm$^{-2}$ s$^{-4}$)",
    "gamma": r"$\gamma$",
    "psi1": r"$\psi_1$",
    "psi2": r"$\psi_2$",
    "c": "$c$",
    "sigma2": r"$\sigma^2$ (mmHg$^2$)",
    "w": "$w$ (s$^{-2}$)",
    "b": "$b$",
}
SCALES = {"f1": 5, "f3": 4, "chi": 4, "m_chi": 4, "w": 4}
"""Powers of ten that axes of these parameters are in."""

SOLID, DASHED, DOTTED = "-", (0, (4, 1.6)), (0, (1, 1.2))
MODEL_STYLES: dict[str, tuple[str, Any]] = {
    "A": (COLOURS[0], DASHED),
    "B": (COLOURS[0], SOLID),
    "C": (COLOURS[5], DOTTED),
    "D": (COLOURS[4], DASHED),
    "E": (COLOURS[4], SOLID),
    "F": (COLOURS[2], DASHED),
    "G": (COLOURS[2], SOLID),
    "H": (COLOURS[1], SOLID),
    "I": (COLOURS[3], SOLID),
}
"""Colour and line of each model: colours tell wall and stiffness, dashes independent errors."""
SEVEN_VESSELS = (1, 2, 3, 4, 8, 12, 21)
"""The paper's text names six of the seven vessels in its figures 8 and 9; 21 is ours."""
FOUR_VESSELS = (1, 3, 8, 21)


class FigureError(ValueError):
    """A figure that cannot be written; its text says what to change."""


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure; the ending (.png, .pdf, .svg) chooses the format.

    Raises
    ------
    FigureError
        If the format is unknown or the folder does not exist.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise FigureError(f"{path}: folder {path.parent} does not exist; create it or choose another path")
    formats = figure.canvas.get_supported_filetypes()
    if path.suffix.lstrip(".").lower() not in formats:
        raise FigureError(f"{path}: unknown figure format {path.suffix!r}; use .png, .pdf or .svg")
    with mpl.rc_context(STYLE):
        figure.savefig(path)
    return path


# -------------------------------------------------------------------------------------------------
# fits


def fit_figure(
    study: Study, means: ArrayLike, predictions: ArrayLike | None = None, *, title: str = ""
) -> Figure:
    """Observations, posterior median, 95 % credible and prediction bands, and the residual below.

    Parameters
    ----------
    study : Study
        Gives observations and times.
    means : array (n_draws, n_series, n_times)
        Waveforms of posterior draws, in the series' units.
    predictions : array (n_predictions, n_series, n_times), optional
        The same with errors.
    title : str
        Above the panels.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels for each observed series.
    """
    means = np.asarray(means, dtype=float)
    n = len(study.series)
    time_ms = 1e3 * np.asarray(study.time_s)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(max(5.2, 4.2 * n), 5.0), layout="constrained")
        axes = figure.subplots(2, n, squeeze=False, sharex=True, height_ratios=(3, 1))
        for k, series in enumerate(study.series):
            top, bottom = axes[0, k], axes[1, k]
            median = np.median(means[:, k], axis=0)
            low, high = np.quantile(means[:, k], (0.025, 0.975), axis=0)
            if predictions is not None:
                band = np.quantile(np.asarray(predictions)[:, k], (0.025, 0.975), axis=0)
                top.fill_between(time_ms, *band, color=COLOURS[5], alpha=0.28, lw=0, label="95 % prediction")
                bottom.fill_between(time_ms, *(band - median), color=COLOURS[5], alpha=0.28, lw=0)
            top.fill_between(time_ms, low, high, color=COLOURS[0], alpha=0.45, lw=0, label="95 % credible")
            top.plot(time_ms, median, color=COLOURS[0], lw=1.4, label="posterior median")
            top.plot(time_ms, series.value, color=INK, lw=0.9, ls=(0, (4, 2)), label="observed")
            bottom.fill_between(time_ms, low - median, high - median, color=COLOURS[0], alpha=0.45, lw=0)
            bottom.axhline(0, color=COLOURS[0], lw=1)
            bottom.plot(time_ms, series.value - median, color=INK, lw=0.9)
            top.set_title(series.label.rsplit(" ", 1)[0])
            top.set_ylabel(QUANTITY_LABELS[series.quantity])
            bottom.set_ylabel("residual")
            bottom.set_xlabel("time in the beat (ms)")
            top.margins(x=0)
        axes[0, 0].legend(loc="best", fontsize="small")
        if title:
            figure.suptitle(title)
    return figure


# -------------------------------------------------------------------------------------------------
# chains


def _names(idata: az.InferenceData, var_names: Iterable[str] | None) -> list[str]:
    """Variables to show: those asked for, or all that are not waveforms."""
    if var_names is not None:
        return list(var_names)
    posterior = idata["posterior"]
    return [str(name) for name in posterior.data_vars if "time" not in posterior[name].dims]


def _arviz(function: Any, *args: Any, labels: Mapping[str, str] | None = None, **kwargs: Any) -> Figure:
    """Call an ArviZ plot in our style, and take its figure from pyplot so that its last user frees it."""
    import arviz as az
    import matplotlib.pyplot as plt

    with (
        mpl.rc_context({**STYLE, "figure.constrained_layout.use": True}),
        az.rc_context({"plot.max_subplots": 100}),
    ):
        labeller = az.labels.MapLabeller(var_name_map=labels or PARAMETER_LABELS)
        axes = np.atleast_1d(function(*args, labeller=labeller, **kwargs))
        figure: Figure = axes.flat[0].figure
        plt.close(figure)
    return figure


def trace_figure(idata: az.InferenceData, var_names: Iterable[str] | None = None) -> Figure:
    """Marginal densities and traces of each chain.

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
    import arviz as az

    names = _names(idata, var_names)
    return _arviz(az.plot_trace, idata, var_names=names, compact=True, figsize=(9.0, 1.5 * len(names)))


def rank_figure(idata: az.InferenceData, var_names: Iterable[str] | None = None) -> Figure:
    """Rank plots: flat bars if the chains agree (Vehtari et al. 2021, doi 10.1214/20-BA1221).

    Parameters and returns as `trace_figure`.
    """
    import arviz as az

    names = _names(idata, var_names)
    size = (9.0, 2.2 * math.ceil(len(names) / 3))
    return _arviz(az.plot_rank, idata, var_names=names, kind="bars", figsize=size)


def pair_figure(idata: az.InferenceData, var_names: Iterable[str] | None = None) -> Figure:
    """Scatter plots of pairs of parameters, marginal densities on the diagonal.

    Parameters and returns as `trace_figure`; at least two variables.
    """
    import arviz as az

    names = _names(idata, var_names)
    posterior = idata["posterior"][names]
    size = 1.7 * sum(int(np.prod(posterior[name].shape[2:])) for name in names)
    figure = _arviz(
        az.plot_pair,
        az.InferenceData(posterior=posterior.map(lambda values: values / 10.0 ** SCALES.get(values.name, 0))),
        var_names=names,
        labels={name: _parameter_label(name) for name in names},
        figsize=(size, size),
        textsize=8,
        marginals=True,
        kind="scatter",
        scatter_kwargs={"alpha": 0.25, "s": 9, "color": COLOURS[0]},
        marginal_kwargs={"color": COLOURS[0]},
    )
    figure.axes[0].set_yticks([])
    return figure


# -------------------------------------------------------------------------------------------------
# models


def comparison_figure(table: pd.DataFrame) -> Figure:
    """The criterion of each model with its standard error, and the differences to the best with theirs.

    Parameters
    ----------
    table : DataFrame
        From `zoo.core.posterior.comparison.compare`: one row a model, deviance scale.

    Returns
    -------
    matplotlib.figure.Figure
    """
    criterion = table.attrs.get("ic", "waic")
    name = {"waic": "WAIC", "loo": "PSIS-LOO"}.get(criterion, str(criterion))
    rows = np.arange(len(table))
    colours = [COLOURS[2] if good else COLOURS[1] for good in table["converged"]]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 1.5 + 0.42 * len(table)), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, values, errors in (
            (left, table[criterion], table[f"{criterion}_se"]),
            (right, table["difference"], table["difference_se"]),
        ):
            for row, value, error, colour in zip(rows, values, errors, colours, strict=True):
                axes.errorbar(value, row, xerr=error, fmt="o", color=colour, ms=5, capsize=3, lw=1.3)
            axes.grid(axis="x", color="#DDDDDD", lw=0.7)
            axes.set_axisbelow(True)
        left.set_yticks(rows, [str(label) for label in table.index])
        left.set_ylabel("model")
        left.invert_yaxis()
        left.margins(y=0.25)
        left.set_xlabel(f"{name}, lower is better (bar: standard error)")
        right.set_xlabel("difference to the best (bar: its standard error)")
        right.axvline(0, color="#888888", lw=1, ls=":")
        right.margins(x=0.12)
        if float(np.max(np.abs(table["difference"]))) > 300:
            right.set_xscale("symlog", linthresh=10)
            right.set_xlabel("difference to the best, logarithmic above 10 (bar: its standard error)")
            right.set_xlim(-5, 3 * float(np.max(table["difference"] + table["difference_se"])))
        for row, weight in zip(rows, table["weight"], strict=True):
            right.annotate(
                f"weight {weight:.2f}",
                (1.0, row),
                xycoords=("axes fraction", "data"),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize="small",
                color="#666666",
            )
        figure.suptitle(f"{name} of {len(table)} models")
        if not all(table["converged"]):
            left.plot([], [], "o", color=COLOURS[1], label="not converged")
            left.legend(loc="best", fontsize="small")
    return figure


# -------------------------------------------------------------------------------------------------
# waves


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
        vessels only the first position is drawn.
    """
    shown = [int(v) for v in (waves["vessel"].to_numpy() if vessels is None else vessels)]
    few = len(shown) <= len(COLOURS)
    positions = [float(p) for p in waves["position"].to_numpy()][: 3 if few else 1]
    time_ms = 1e3 * waves["time"].to_numpy()
    observed = study.series if study is not None else ()
    observed_ms = 1e3 * np.asarray(study.time_s) if study is not None else np.empty(0)
    styles: dict[float, Any] = dict(zip(positions, ("-", (0, (5, 2)), (0, (1, 1.5))), strict=False))
    colours = COLOURS if few else mpl.colormaps["viridis"](np.linspace(0, 0.93, len(shown)))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 3.9), layout="constrained")
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
        line = mpl.lines.Line2D
        handles = [line([], [], color=c, label=f"vessel {v}") for v, c in zip(shown, colours, strict=False)]
        handles += [line([], [], color="#666666", ls=styles[p], label=f"position {p:g}") for p in positions]
        columns = math.ceil(len(handles) / 14)
        figure.legend(handles=handles, loc="outside right center", fontsize="small", ncols=columns)
    return figure


# -------------------------------------------------------------------------------------------------
# predictions in all vessels


def model_style(name: str, place: int = 0) -> tuple[str, Any]:
    """Colour and line of a model, by its letter, or by its place for a model outside the nine."""
    return MODEL_STYLES.get(name, (COLOURS[place % len(COLOURS)], (SOLID, DASHED, DOTTED)[place // 7 % 3]))


def _vessels(data: xr.Dataset, wanted: Sequence[int] | None, usual: Sequence[int]) -> list[int]:
    """Vessels to show: those asked for, the usual ones, or as many from the root on."""
    there = [int(v) for v in data["vessel"].to_numpy()]
    chosen = list(usual if wanted is None else wanted)
    if wanted is None and not set(chosen) <= set(there):
        chosen = there[: len(usual)]
    for vessel in chosen:
        if vessel not in there:
            raise FigureError(
                f"vessel {vessel}: the waves have {', '.join(map(str, there))}; choose of these"
            )
    return chosen


def _vessel_title(data: xr.Dataset, vessel: int) -> str:
    name = str(data["name"].sel(vessel=vessel).item()) if "name" in data.coords else ""
    return f"vessel {vessel}" if name in ("", f"v{vessel}") else name


def _first(mapping: Mapping[str, Any], what: str) -> Any:
    if not mapping:
        raise FigureError(f"no {what}: give at least one")
    return next(iter(mapping.values()))


def _observed(study: Study | None, quantity: str, data: xr.Dataset, vessel: int) -> list[ArrayLike]:
    """Measured series of a quantity where the vessel is looked at."""
    if study is None:
        return []
    place = float(data["position"].sel(vessel=vessel)) if "position" in data.coords else 0.0
    found = [s for s in study.series if (s.vessel, s.quantity) == (vessel, quantity)]
    return [s.value for s in found if s.position == place]


def _draw_measured(axes: Axes, study: Study | None, quantity: str, data: xr.Dataset, vessel: int) -> bool:
    measured = _observed(study, quantity, data, vessel)
    for values in measured:
        time_ms = 1e3 * np.asarray(study.time_s) if study is not None else np.empty(0)
        axes.plot(time_ms, np.asarray(values), color="black", lw=1.1, zorder=3)
    return bool(measured)


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


def _band_handles(prob: float, colour: str, *, prediction: bool, measured: bool) -> list[Any]:
    patch = mpl.patches.Patch
    handles: list[Any] = [Line2D([], [], color=colour, lw=1.4, label="posterior median")]
    handles.append(patch(color=colour, alpha=0.55, lw=0, label=f"{100 * prob:g} % credible"))
    if prediction:
        handles.append(patch(color=colour, alpha=0.2, lw=0, label=f"{100 * prob:g} % prediction"))
    if measured:
        handles.append(Line2D([], [], color="black", lw=1.1, label="measured"))
    return handles


def _check_prob(data: xr.Dataset, prob: float) -> None:
    if prob not in data["prob"]:
        have = ", ".join(f"{float(p):g}" for p in data["prob"].to_numpy())
        raise FigureError(f"prob = {prob:g}: the bands have {have}; choose of these")


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
        From `zoo.blood.predictive.bands`, one for each model, of one quantity; prediction bands are drawn if there.
    study : Study, optional
        Its measured series are drawn where they were measured.
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
    first = one_place(_first(bands, "bands"))
    shown = _vessels(first, vessels, FOUR_VESSELS)
    quantity = str(first.attrs["quantity"])
    pressure = quantity == "pressure_mmHg"
    measured = False
    with mpl.rc_context(STYLE):
        size = (1.2 + 2.7 * len(bands), 1.0 + 1.75 * len(shown))
        figure = Figure(figsize=size, layout="constrained")
        grid = figure.subplots(
            len(shown), len(bands), squeeze=False, sharex=True, sharey="all" if pressure else "row"
        )
        for column, (name, data) in enumerate(bands.items()):
            _check_prob(data, prob)
            data = one_place(data)
            for row, vessel in enumerate(shown):
                axes = grid[row, column]
                _draw_bands(axes, data, vessel, prob, model_style(name, column)[0])
                measured |= _draw_measured(axes, study, quantity, data, vessel)
                if column == 0:
                    axes.set_ylabel(f"{_vessel_title(data, vessel)}\n{QUANTITY_LABELS[quantity]}")
            grid[0, column].set_title(f"model {name}")
            grid[-1, column].set_xlabel("time in the beat (ms)")
        prediction = any("prediction_low" in data for data in bands.values())
        handles = _band_handles(prob, "#555555", prediction=prediction, measured=measured)
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
        Its measured series are drawn where they were measured.
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
    measured = False
    with mpl.rc_context(STYLE):
        figure, panels, rest = _panels(len(shown), sharey=quantity == "pressure_mmHg", spare=1)
        for axes, vessel in zip(panels, shown, strict=True):
            factor = _area_factor(quantity)
            _draw_bands(axes, _scaled(data, factor), vessel, prob, colour)
            measured |= _draw_measured(axes, study, quantity, data, vessel)
            axes.set_title(_vessel_title(data, vessel))
        figure.supxlabel("time in the beat (ms)", fontsize="medium")
        figure.supylabel(_quantity_label(quantity), fontsize="medium")
        prediction = "prediction_low" in data
        rest[0].legend(
            handles=_band_handles(prob, colour, prediction=prediction, measured=measured), loc="center"
        )
        if title:
            figure.suptitle(title)
    return figure


def _area_factor(quantity: str) -> float:
    return 1e3 if quantity == "area_cm2" else 1.0


def _quantity_label(quantity: str) -> str:
    return "area (10$^{-3}$ cm$^2$)" if quantity == "area_cm2" else QUANTITY_LABELS[quantity]


def _scaled(data: xr.Dataset, factor: float) -> xr.Dataset:
    return data if factor == 1 else data.map(lambda variable: variable * factor, keep_attrs=True)


def _panels(
    n: int, *, sharey: bool = False, sharex: bool = True, spare: int = 0
) -> tuple[Figure, list[Axes], list[Axes]]:
    """Figure with `n` panels and `spare` empty ones at least, and the empty ones without frames."""
    columns = min(n + spare, 4 if n + spare <= 8 else 6)
    rows = math.ceil((n + spare) / columns)
    figure = Figure(figsize=(1.0 + 2.05 * columns, 0.9 + 1.75 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=sharex, sharey=sharey)
    every: list[Axes] = list(grid.flat)
    for axes in every[n:]:
        axes.set_axis_off()
    if sharex:
        for axes in every[max(0, n - columns) : n]:
            axes.tick_params(labelbottom=True)
    return figure, every[:n], every[n:]


def _width(place: int, n: int) -> float:
    """Line width, less for later models, so that those on top of each other can be seen."""
    return 2.3 - 1.3 * place / max(1, n - 1) if n > 1 else 1.3


def _model_handles(names: Iterable[str]) -> list[Any]:
    handles = []
    for place, name in enumerate(names):
        colour, line = model_style(name, place)
        handles.append(Line2D([], [], color=colour, ls=line, lw=1.6, label=f"model {name}"))
    return handles


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
        Its measured series are drawn where they were measured, and give a last panel with the residuals,
        measured minus median, of the first of them.
    quantity : str
        pressure_mmHg, flow_ml_s or area_cm2.
    vessels : sequence of int, optional
        Panels; seven if absent.

    Returns
    -------
    matplotlib.figure.Figure
        Colours tell wall and stiffness, dashes independent errors.

    Raises
    ------
    FigureError
        If there are no models, or a vessel or quantity is unknown.
    """
    first = _first(medians, "medians")
    if quantity not in QUANTITY_LABELS:
        raise FigureError(f"quantity = {quantity!r}: must be one of {', '.join(QUANTITY_LABELS)}")
    shown = _vessels(first, vessels, SEVEN_VESSELS)
    observed = [v for v in shown if _observed(study, quantity, first, v)]
    factor = _area_factor(quantity)
    with mpl.rc_context(STYLE):
        figure, panels, rest = _panels(len(shown) + bool(observed), spare=0 if observed else 1)
        waves = panels[: len(shown)]
        if quantity == "pressure_mmHg":
            for axes in waves[1:]:
                axes.sharey(waves[0])
                place_in_grid = axes.get_subplotspec()
                axes.tick_params(labelleft=place_in_grid is None or place_in_grid.is_first_col())
            waves[0].yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        for axes, vessel in zip(waves, shown, strict=True):
            for place, (name, data) in enumerate(medians.items()):
                colour, line = model_style(name, place)
                wave = factor * data[quantity].sel(vessel=vessel)
                axes.plot(1e3 * data["time"], wave, color=colour, ls=line, lw=_width(place, len(medians)))
            _draw_measured(axes, study, quantity, first, vessel)
            axes.set_title(_vessel_title(first, vessel))
            axes.set_xlim(0, 1e3 * float(first["time"][-1] + first["time"][1]))
        handles = _model_handles(medians)
        if observed and study is not None:
            handles.append(Line2D([], [], color="black", lw=1.1, label="measured"))
            _draw_residuals(panels[-1], medians, study, quantity, observed[0])
            panels[-1].set_title(f"residual, {_vessel_title(first, observed[0])}")
        figure.supxlabel("time in the beat (ms)", fontsize="medium")
        figure.supylabel(_quantity_label(quantity), fontsize="medium")
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
    for place, (name, data) in enumerate(medians.items()):
        colour, line = model_style(name, place)
        [measured, *_] = _observed(study, quantity, data, vessel)
        wave = data[quantity].sel(vessel=vessel).to_numpy()
        predicted = np.interp(time_s, data["time"].to_numpy(), wave, period=study.period_s)
        axes.plot(
            1e3 * time_s,
            np.asarray(measured) - predicted,
            color=colour,
            ls=line,
            lw=_width(place, len(medians)),
        )


def loops_figure(
    waves: Mapping[str, xr.Dataset],
    *,
    vessels: Sequence[int] | None = None,
    standardised: bool = False,
) -> Figure:
    """Pressure against cross-sectional area over the beat (figure 9, right, of the paper).

    The walls are elastic, so pressure is a function of area and a loop is a curve, passed in both directions.
    Areas are those of the vessels, in cm2. The paper shows (A - l)/(u - l), with the least and largest area
    l and u of each vessel; with `standardised` so does this figure, l and u taken over the models shown.

    Parameters
    ----------
    waves : mapping of name to Dataset
        From `zoo.blood.predictive.waves_at_medians`, one for each model: in one solve pressure and area belong
        together, as they do not in pointwise medians.
    vessels : sequence of int, optional
        Panels; seven if absent. All vessels: ``list(waves[name].vessel.values)``.
    standardised : bool
        Areas between 0 and 1.

    Returns
    -------
    matplotlib.figure.Figure
        Colours tell wall and stiffness, dashes independent errors.

    Raises
    ------
    FigureError
        If there are no models, or a vessel is unknown.
    """
    first = _first(waves, "waves")
    shown = _vessels(first, vessels, SEVEN_VESSELS)
    with mpl.rc_context(STYLE):
        figure, panels, rest = _panels(len(shown), sharey=True, sharex=standardised, spare=1)
        for axes, vessel in zip(panels, shown, strict=True):
            areas = {name: data["area_cm2"].sel(vessel=vessel).to_numpy() for name, data in waves.items()}
            least = min(area.min() for area in areas.values())
            largest = max(area.max() for area in areas.values())
            for place, (name, data) in enumerate(waves.items()):
                colour, line = model_style(name, place)
                area = (areas[name] - least) / (largest - least) if standardised else 1e3 * areas[name]
                pressure = data["pressure_mmHg"].sel(vessel=vessel).to_numpy()
                order = np.argsort(area)  # passed once, so that dashes stay dashes
                axes.plot(area[order], pressure[order], color=colour, ls=line, lw=_width(place, len(waves)))
            axes.set_title(_vessel_title(first, vessel))
            if not standardised:
                axes.xaxis.set_major_locator(MaxNLocator(4))
        panels[0].yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        label = "standardised area" if standardised else _quantity_label("area_cm2")
        figure.supxlabel(label, fontsize="medium")
        figure.supylabel(QUANTITY_LABELS["pressure_mmHg"], fontsize="medium")
        rest[0].legend(handles=_model_handles(waves), loc="center", ncols=2 if len(waves) > 5 else 1)
    return figure


# -------------------------------------------------------------------------------------------------
# several posteriors


def _parameter_label(name: str) -> str:
    """Label with unit, in the power of ten of `SCALES`."""
    label = PARAMETER_LABELS.get(name, name)
    if name not in SCALES:
        return label
    return label.replace(" (", f" (10$^{SCALES[name]}$ ", 1)


def _in_scale(name: str, values: ArrayLike) -> Array:
    return np.asarray(values, dtype=float) / 10.0 ** SCALES.get(name, 0)


def posteriors_figure(
    posteriors: Mapping[str, az.InferenceData | xr.Dataset], var_names: Iterable[str] | None = None
) -> Figure:
    """Marginal densities and pairs of parameters of several posteriors (figure 4 of the paper).

    Densities are scaled to the same height, since a posterior with independent errors is many times narrower.

    Parameters
    ----------
    posteriors : mapping of name to InferenceData or Dataset
        Such as those of models A and B; from `zoo.blood.predictive.with_stiffness` they have the stiffness of a
        vessel in place of f1, f2 and f3.
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

    _first(posteriors, "posteriors")
    draws: dict[str, dict[str, Array]] = {}
    for name, posterior in posteriors.items():
        data = posterior["posterior"] if isinstance(posterior, az.InferenceData) else posterior
        scalars = [str(v) for v in data.data_vars if set(data[v].dims) == {"chain", "draw"}]
        draws[name] = {v: _in_scale(v, data[v].transpose("chain", "draw")).ravel() for v in scalars}
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
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(1.0 + 1.65 * n, 0.6 + 1.5 * n), layout="constrained")
        grid = figure.subplots(n, n, squeeze=False, sharex="col")
        for place, values in reversed(list(enumerate(draws.values()))):
            colour = COLOURS[place % len(COLOURS)]
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
                grid[i, 0].set_ylabel(_broken(_parameter_label(below)), fontsize="small")
            grid[-1, i].set_xlabel(_broken(_parameter_label(below)), fontsize="small")
        figure.align_ylabels(grid[1:, 0])
        handles = [
            Line2D([], [], color=COLOURS[place % len(COLOURS)], lw=2, label=f"model {model}")
            for place, model in enumerate(draws)
        ]
        figure.legend(handles=handles, loc="upper right")
    return figure


def _broken(label: str) -> str:
    """Unit on a second line."""
    return label.replace(" (", "\n(", 1)


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
    _first(stiffness, "stiffness draws")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.2, 4.2), layout="constrained")
        axes = figure.subplots()
        tops: dict[int, tuple[float, float]] = {}
        for place, (name, draws) in enumerate(stiffness.items()):
            radius = draws["radius_cm"].to_numpy()
            low, median, high = _in_scale("chi", draws.quantile((0.025, 0.5, 0.975), ("chain", "draw")))
            x = _apart(radius, 0.0006) + 0.00018 * (place - (len(stiffness) - 1) / 2)
            colour = COLOURS[place % len(COLOURS)]
            errors = np.stack([median - low, high - median])
            axes.errorbar(
                x,
                median,
                errors,
                fmt="osD^v"[place % 5],
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
        axes.set_ylabel(_parameter_label("chi"))
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
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(5.6, 3.8), layout="constrained")
        axes = figure.subplots()
        for place, name in enumerate(("systolic", "diastolic", "pulse")):
            pressure = good[f"{name}_mmHg"].to_numpy()
            axes.plot(chi, pressure, color=COLOURS[place], lw=1.6, label=name)
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


def intervals_figure(table: pd.DataFrame) -> Figure:
    """Published medians and 95 % intervals beside ours, a panel for each parameter.

    Parameters
    ----------
    table : DataFrame
        Columns model, parameter, published_median, published_low, published_high, median, low, high, in the
        units of the parameters; NaN where the paper has no number.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    FigureError
        If a column is missing, or there is no row.
    """
    ends = ("median", "low", "high")
    columns = ["model", "parameter", *(f"published_{end}" for end in ends), *ends]
    missing = [column for column in columns if column not in table.columns]
    if missing or table.empty:
        what = f"no column {missing[0]!r}" if missing else "no row"
        raise FigureError(f"table of intervals: {what}; give {', '.join(columns)}")
    models = list(dict.fromkeys(table["model"]))
    names = list(dict.fromkeys(table["parameter"]))
    across = min(3, len(names))
    rows = math.ceil(len(names) / across)
    with mpl.rc_context(STYLE):
        size = (1.0 + 2.9 * across, 0.8 + rows * (0.75 + 0.24 * len(models)))
        figure = Figure(figsize=size, layout="constrained")
        grid = list(figure.subplots(rows, across, squeeze=False, sharey=True).flat)
        for axes, name in zip(grid, names, strict=False):
            part = table[table["parameter"] == name]
            for prefix, shift, colour, marker in (
                ("published_", -0.16, INK, "o"),
                ("", 0.16, COLOURS[0], "s"),
            ):
                median, low, high = (_in_scale(name, part[f"{prefix}{end}"]) for end in ends)
                y = np.array([models.index(model) for model in part["model"]]) + shift
                error = np.stack([median - low, high - median])
                face = "white" if prefix else colour
                axes.errorbar(
                    median, y, xerr=error, fmt=marker, color=colour, mfc=face, ms=4, lw=1.2, capsize=2
                )
            values = _in_scale(name, part[[f"{p}{e}" for p in ("published_", "") for e in ends]])
            if np.nanmin(values) > 0 and np.nanmax(values) > 50 * np.nanmin(values):
                axes.set_xscale("log")
            else:
                axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
            axes.set_xlabel(_parameter_label(name))
            axes.grid(axis="y", color="#EEEEEE", lw=0.7)
            axes.set_axisbelow(True)
            axes.tick_params(axis="y", length=0)
        for axes in grid[len(names) :]:
            axes.set_axis_off()
        grid[0].set_yticks(range(len(models)), models)
        grid[0].set_ylim(len(models) - 0.5, -0.5)
        for axes in grid[: len(names) : across]:
            axes.set_ylabel("model")
        published = Line2D([], [], color=INK, marker="o", mfc="white", ms=4, lw=1.2, label="published")
        ours = Line2D([], [], color=COLOURS[0], marker="s", ms=4, lw=1.2, label="zoo")
        figure.legend(handles=[published, ours], loc="outside upper right", ncols=2, fontsize="small")
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
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(2.5 * columns, rows * (0.75 + 0.2 * len(models))), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=False):
            for row, model in enumerate(models):
                if model not in found[name]:
                    continue
                low, q1, median, q3, high = np.quantile(found[name][model], (0.025, 0.25, 0.5, 0.75, 0.975))
                axes.plot((low, high), (row, row), color=COLOURS[0], lw=1.2)
                axes.plot((q1, q3), (row, row), color=COLOURS[0], lw=3.2, solid_capstyle="butt")
                axes.plot(median, row, "o", color="white", mec=COLOURS[0], mew=1.4, ms=5)
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


def calibration_figure(test: RankTest, *, title: str = "") -> Figure:
    """Ranks of truths among posterior draws, and the difference of their ECDF to a uniform one.

    Parameters
    ----------
    test : zoo.paper.calibration.RankTest
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
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(1.0 + 1.75 * columns, 4.2), layout="constrained")
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
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(2.3 * len(names), 0.7 + 1.9 * rows), layout="constrained")
        grid = figure.subplots(rows, len(names), squeeze=False, sharex="col")
        for place, (label, posteriors) in enumerate(fits.items()):
            row = grid[0 if overlay else place]
            for axes, name in zip(row, names, strict=True):
                for number, draws in enumerate(posteriors):
                    values = np.asarray(_in_scale(name, draws[name]), dtype=float)
                    x, density = az.kde(values)  # ends where the draws do
                    colour = COLOURS[place if overlay else number]
                    axes.plot(x, density, color=colour, lw=1.5, label=label if axes is row[0] else None)
                axes.set_yticks([])
                axes.spines["left"].set_visible(False)
            if not overlay:
                row[0].set_ylabel(label)
        for column, name in enumerate(names):
            for axes in grid[:, column]:
                axes.axvline(float(_in_scale(name, truth[name])), color=INK, lw=1.1, ls=(0, (4, 2)))
            grid[-1, column].set_xlabel(_broken(_parameter_label(name)))
        if overlay:
            figure.legend(
                *grid[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=len(fits)
            )
    return figure


# -------------------------------------------------------------------------------------------------
# the diagnosis

GAP_COLOUR, CAUSE_COLOUR, ALL_COLOUR = COLOURS[1], COLOURS[0], COLOURS[2]
ALONE = "#9AA5B1"
"""Of explanations that are no group: nothing else looks like them."""
PLACE_COLOURS = ("#DDE2E8", "#E69F00", "#B23A00")
"""From improbable to certain; the first still shows on white."""
LABELLED_VESSELS = 45


def _parts(figure: Figure | SubFigure, rows: int, columns: int, **ratios: Any) -> list[SubFigure]:
    found: Any = figure.subfigures(rows, columns, squeeze=False, **ratios)
    return list(found.flat)


def _cause_name(d: Diagnosis) -> str:
    """The leading effect with its place; empty where no listed effect leads."""
    leader = d.file.hypotheses[0]
    if leader.name in (NO_GAP, UNLISTED, CORRELATED):
        return ""
    return leader.name if leader.place is None else f"{leader.name}, {_place_name(leader)}"


def _place_name(place: HypothesisResult | PlaceShare) -> str:
    """Such as "vessel 2 and below"."""
    vessel = place.place if isinstance(place, HypothesisResult) else place.vessel
    return str(Place(vessel, place.subtree))


def _spans(index: NDArray[np.int_]) -> list[tuple[int, int, int]]:
    """Runs of equal values: first, one past the last, value."""
    edges = [0, *(np.flatnonzero(np.diff(index)) + 1), len(index)]
    return [(int(a), int(b), int(index[a])) for a, b in pairwise(edges)]


def _shade_phases(axes: Axes, phase: NDArray[np.int_], period_ms: float, *, named: bool) -> None:
    """Every other phase shaded; the two short ones are named a line higher."""
    step = period_ms / len(phase)
    spans = _spans(phase)
    widest = {k: max((b - a, a) for a, b, value in spans if value == k)[1] for _, _, k in spans}
    for first, last, k in spans:
        if k % 2:
            axes.axvspan(first * step, last * step, color="#EEF1F4", lw=0, zorder=0)
        if named and widest[k] == first:
            axes.annotate(
                PHASES[k],
                (0.5 * (first + last) * step, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0, 11 if k % 2 else 2),
                textcoords="offset points",
                ha="center",
                fontsize=7,
                color="#666666",
            )
    axes.set_xlim(0, period_ms)


def _draw_gap(figure: Figure | SubFigure, d: Diagnosis) -> None:
    study = d.study
    n = len(study.series)
    columns = min(n, 3)
    blocks = math.ceil(n / columns)
    cause = _cause_name(d)
    time_ms = 1e3 * np.asarray(study.time_s)
    period_ms = 1e3 * study.period_s
    labels = [s.label for s in study.series]
    timing = next(i for i, label in enumerate(labels) if label in d.file.where.series)
    phase = phases(study.values[timing], study.period_s)
    grid = figure.subplots(2 * blocks, columns, squeeze=False, height_ratios=(3, 1.6) * blocks)
    for axes in grid.flat[:]:
        axes.set_axis_off()
    for i, (series, row) in enumerate(zip(study.series, d.file.gap.per_series, strict=True)):
        top, bottom = (grid[2 * (i // columns) + k, i % columns] for k in (0, 1))
        for axes in (top, bottom):
            axes.set_axis_on()
            _shade_phases(axes, phase, period_ms, named=axes is top)
        top.plot(time_ms, series.value, color=INK, lw=2.2, alpha=0.35, label="measured")
        computed = series.value - d.before.residual[i]
        top.plot(time_ms, computed, color=GAP_COLOUR, lw=1.2, ls=DASHED, label="base")
        drawn = [("base", d.before, GAP_COLOUR)]
        if cause:
            computed = series.value - d.after.residual[i]
            top.plot(time_ms, computed, color=CAUSE_COLOUR, lw=1.2, label=f"base + {cause}")
            drawn.append(("base + cause", d.after, CAUSE_COLOUR))
        if len(d.file.steps) > 1:
            label = f"base + {' + '.join(step.name for step in d.file.steps)}"
            top.plot(time_ms, d.computed[1][i], color=ALL_COLOUR, lw=1.1, ls=DOTTED, label=label)
        noise = row.noise_floor
        bottom.axhspan(-noise, noise, color="#B8C0C8", alpha=0.45, lw=0, zorder=1, label="noise (sd)")
        bottom.axhline(0, color="#888888", lw=0.7)
        for label, found, colour in drawn:
            mean, sd = found.mean[i], 1.96 * found.sd[i]
            label = f"discrepancy of {label}, 95 %"
            bottom.fill_between(time_ms, mean - sd, mean + sd, color=colour, alpha=0.3, lw=0, zorder=2)
            bottom.plot(time_ms, mean, color=colour, lw=1.2, zorder=3, label=label)
        top.set_title(f"{series.label.rsplit(' ', 1)[0]}: {_shrinks(row, bool(cause))}", pad=24)
        top.set_ylabel(QUANTITY_LABELS[series.quantity])
        top.tick_params(labelbottom=False)
        bottom.set_ylabel(f"gap ({row.unit})")
        bottom.set_xlabel("time in the beat (ms)")
    handles = [handle for axes in grid[:2, 0] for handle in axes.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize="small")


def _shrinks(row: SeriesGap, cause: bool) -> str:
    """Such as "gap 0.25 to 0.01 mmHg"."""
    after = f" to {row.after.mean:.2g}" if cause else ""
    return f"gap {row.before.mean:.2g}{after} {row.unit}"


def plot_gap(d: Diagnosis) -> Figure:
    """Each observed series with the base and the base with its cause; below, what these leave.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
        Two panels for each observed series; phases of the beat are shaded and named, bands hold 95 %, the
        grey strip is one standard deviation of the noise.
    """
    n = len(d.study.series)
    columns = min(n, 3)
    size = (max(6.4, 4.3 * columns), 0.5 + 4.9 * math.ceil(n / columns))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        _draw_gap(figure, d)
    return figure


def _group_colours(d: Diagnosis) -> dict[int, str]:
    """Colours of the leader's group and of those with more than one member."""
    sizes = Counter(h.group for h in d.file.hypotheses)
    first = d.file.hypotheses[0].group
    shared = [g for g in dict.fromkeys(h.group for h in d.file.hypotheses) if sizes[g] > 1 or g == first]
    return {g: COLOURS[k % len(COLOURS)] for k, g in enumerate(shared)}


def _draw_hypotheses(figure: Figure | SubFigure, d: Diagnosis) -> None:
    axes = figure.subplots()
    found = d.file.hypotheses
    unit = d.file.record.get("gap_unit", "mmHg")
    colours = _group_colours(d)
    zero = next(h.log_evidence for h in found if h.name == NO_GAP)
    special = {NO_GAP: "noise alone", UNLISTED: "none of those listed", CORRELATED: "correlated noise"}
    for row, h in enumerate(found):
        hidden = h.name in d.file.invisible
        bar = axes.barh(
            row,
            h.log_evidence - zero,
            height=0.72,
            color="white" if hidden else colours.get(h.group, ALONE),
            edgecolor=ALONE if hidden else "#333333" if h.name in special else "none",
            hatch="////" if h.name in special else None,
            lw=0.8,
        )
        bar.set_label(h.name)
        words = f"{h.log_evidence - zero:+.0f}: "
        words += f"{100 * h.probability:.0f} %" if h.probability >= 0.005 else "<1 %"
        if hidden:
            words = "invisible here"
        elif h.name not in (UNLISTED, CORRELATED):
            words += f", gap {h.gap_after_mmHg:.2g} {unit}"
        axes.annotate(
            words,
            (1.0, row),
            xycoords=("axes fraction", "data"),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize="small",
            color="#666666",
        )
    axes.axvline(0, color="#888888", lw=0.9)
    axes.set_xscale("symlog", linthresh=10)
    axes.xaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=10))
    axes.margins(x=0.08)
    names = [
        f"{h.name} ({special[h.name]})"
        if h.name in special and h.name != CORRELATED
        else h.name
        if h.place is None
        else f"{h.name}, {_place_name(h)}"
        for h in found
    ]
    axes.set_yticks(np.arange(len(found)), names)
    axes.set_ylim(len(found) - 0.4, -0.6)
    axes.grid(axis="x", color="#DDDDDD", lw=0.7)
    axes.set_axisbelow(True)
    axes.set_xlabel("log evidence over noise alone (linear within ±10)")
    axes.set_title("explanations, most probable first")
    sizes = Counter(h.group for h in found)
    patch = mpl.patches.Patch
    handles = [
        patch(color=colour, label="leader" if sizes[g] == 1 else f"group {g}: not told apart")
        for g, colour in colours.items()
    ]
    if any(h.group not in colours and h.name not in d.file.invisible for h in found):
        handles.append(patch(color=ALONE, label="told apart"))
    handles.append(patch(facecolor="white", edgecolor="#333333", hatch="////", label="no listed effect"))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize="small")


def _hypotheses_height(d: Diagnosis) -> float:
    return 1.7 + 0.24 * len(d.file.hypotheses)


def plot_hypotheses(d: Diagnosis) -> Figure:
    """Log evidence of each explanation over that of noise alone, with the gap that it leaves.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
        A bar for each explanation, most probable first, coloured by group; hatched are those that name no
        listed effect, hollow those that this study cannot show.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.4, _hypotheses_height(d)), layout="constrained")
        _draw_hypotheses(figure, d)
    return figure


def _tree(vessels: Sequence[Vessel]) -> dict[int, tuple[float, float, float, float]]:
    """Layered layout of a tree: vessel -> x and y of its inlet, x and y of its outlet; leaves one apart."""
    children: dict[int | None, list[int]] = {}
    for vessel in vessels:
        children.setdefault(vessel.parent, []).append(vessel.id)
    order: list[tuple[int, int]] = []  # vessel and depth, parents first
    stack = [(root, 0) for root in reversed(children.get(None, []))]
    while stack:
        vessel_id, depth = stack.pop()
        order.append((vessel_id, depth))
        stack += [(child, depth + 1) for child in reversed(children.get(vessel_id, []))]
    height: dict[int, float] = {}
    leaf = 0
    for vessel_id, _ in order:
        if vessel_id not in children:
            height[vessel_id] = -float(leaf)
            leaf += 1
    for vessel_id, _ in reversed(order):
        if vessel_id in children:
            height[vessel_id] = float(np.mean([height[child] for child in children[vessel_id]]))
    parent = {vessel.id: vessel.parent for vessel in vessels}
    return {
        v: (float(depth), height[v if parent[v] is None else parent[v]], depth + 1.0, height[v])  # type: ignore[index]
        for v, depth in order
    }


def _below(vessels: Sequence[Vessel], vessel: int) -> set[int]:
    """A vessel and all below it."""
    inside, more = {vessel}, True
    while more:
        new = {v.id for v in vessels if v.parent in inside} - inside
        inside |= new
        more = bool(new)
    return inside


def _draw_tree(axes: Axes, d: Diagnosis) -> None:
    vessels = d.study.vessels
    probability = {v.id: 0.0 for v in vessels}
    everywhere = 0.0
    for share in d.file.where.place:
        if share.vessel is None:
            everywhere += share.probability
        else:
            for v in _below(vessels, share.vessel) if share.subtree else {share.vessel}:
                probability[v] += share.probability
    colours = mpl.colors.LinearSegmentedColormap.from_list("places", PLACE_COLOURS)
    layout = _tree(vessels)
    places = dict.fromkeys((s.vessel, s.position) for s in d.study.series)
    marked = {vessel for vessel, position in places if abs(position - 0.5) < 0.25}
    thickest = max(v.radius_cm for v in vessels)
    for vessel in vessels:
        x0, y0, x1, y1 = layout[vessel.id]
        width = 1.5 + 6.0 * vessel.radius_cm / thickest
        colour = colours(probability[vessel.id])
        [line] = axes.plot((x0, x1), (y0, y1), color=colour, lw=width, solid_capstyle="round")
        line.set_gid(f"vessel-{vessel.id}")
        if len(vessels) <= LABELLED_VESSELS:
            along = 0.25 if vessel.id in marked else 0.5
            axes.annotate(
                str(vessel.id),
                (x0 + along * (x1 - x0), y0 + along * (y1 - y0)),
                ha="center",
                va="center",
                fontsize=7,
                bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
            )
    wanted = d.file.next_measurement
    marks: list[tuple[tuple[int, float], str, str, str]] = [(p, "o", "white", "measured") for p in places]
    if wanted is not None:
        marks.append(((wanted.vessel, wanted.position), "*", COLOURS[0], "measure next"))
    for (place, position), marker, fill, label in marks:
        x0, y0, x1, y1 = layout[place]
        x, y = x0 + position * (x1 - x0), y0 + position * (y1 - y0)
        size = 13 if marker == "*" else 7
        first = None if label in axes.get_legend_handles_labels()[1] else label
        axes.plot(x, y, marker=marker, ms=size, mfc=fill, mec=INK, ls="", label=first, zorder=4)
    axes.annotate(
        f"everywhere alike: {100 * everywhere:.0f} %",
        (0.02, 0.98),
        xycoords="axes fraction",
        va="top",
        color="white" if everywhere > 0.6 else INK,
        bbox={"boxstyle": "round,pad=0.5", "fc": colours(everywhere), "ec": "#888888"},
    )
    listed = [p for p in d.file.where.place if p.vessel is not None and p.probability >= 0.01][:3]
    axes.annotate(
        "\n".join(f"{_place_name(p)}: {100 * p.probability:.0f} %" for p in listed),
        (0.01, 0.91),
        xycoords="axes fraction",
        va="top",
        fontsize="small",
    )
    axes.set_axis_off()
    axes.margins(0.06)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.16 * (high - low))
    axes.set_title("place")
    axes.legend(loc="lower left", fontsize="small")
    scale = mpl.cm.ScalarMappable(mpl.colors.Normalize(0, 1), colours)
    bar = axes.figure.colorbar(scale, ax=axes, shrink=0.6, aspect=30)
    bar.set_label("probability that the cause acts in the vessel", fontsize="small")
    bar.outline.set_visible(False)


def _draw_where(figure: Figure | SubFigure, d: Diagnosis) -> None:
    left, right = _parts(figure, 1, 2, width_ratios=(1, 1.9))
    where = d.file.where
    panels = (("phase of the beat", where.phase), ("harmonic", where.harmonic), ("series", where.series))
    ratios = [max(2.5, float(len(shares))) for _, shares in panels]
    for axes, (title, shares) in zip(left.subplots(3, 1, height_ratios=ratios), panels, strict=True):
        axes.barh(np.arange(len(shares)), [100 * v for v in shares.values()], color=GAP_COLOUR, height=0.7)
        axes.set_yticks(np.arange(len(shares)), [name.rsplit("_", 1)[0] for name in shares], fontsize="small")
        axes.set_ylim(len(shares) - 0.4, -0.6)
        axes.set_xlim(0, 100)
        axes.set_title(title)
    axes.set_xlabel("share of the gap's energy (%)")
    _draw_tree(right.subplots(), d)


def plot_where(d: Diagnosis) -> Figure:
    """Where the gap lies: shares by phase, harmonic and series, and the probability of each place.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
        Vessels are coloured by the probability that the cause acts in them, alone or with others below or
        above them; the box is for "everywhere alike". All given that a listed effect is the cause.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, _where_height(d)), layout="constrained")
        _draw_where(figure, d)
    return figure


def _where_height(d: Diagnosis) -> float:
    terminals = len(d.study.vessels) - len({v.parent for v in d.study.vessels} - {None})
    bars = 5 + len(d.file.where.harmonic) + len(d.file.where.series)
    return min(24.0, max(1.8 + 0.24 * bars, 1.5 + 0.3 * terminals))


def plot_diagnosis(d: Diagnosis) -> Figure:
    """The whole diagnosis on one page: `plot_gap`, `plot_hypotheses` and `plot_where`, the verdict above.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
    """
    n = len(d.study.series)
    heights = (0.5 + 4.9 * math.ceil(n / min(n, 3)), max(_hypotheses_height(d), _where_height(d)))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(17.0, 0.6 + sum(heights)), layout="constrained")
        top, bottom = _parts(figure, 2, 1, height_ratios=heights)
        _draw_gap(top, d)
        left, right = _parts(bottom, 1, 2, width_ratios=(1, 1.1))
        _draw_hypotheses(left, d)
        _draw_where(right, d)
        title = f"{d.file.study}, base {d.file.base}. {d.file.verdict}"
        figure.suptitle(textwrap.fill(title, 150), x=0.01, ha="left")
    return figure


# -------------------------------------------------------------------------------------------------
# the blind check

RIGHT, WRONG = COLOURS[0], COLOURS[1]


def score_figures(score: Score) -> dict[str, Figure]:
    """All figures of a blind check's score by name: reliability, accuracy, confusion, sizes."""
    return {
        "reliability": plot_reliability(score),
        "accuracy": plot_accuracy(score),
        "confusion": plot_confusion(score),
        "sizes": plot_sizes(score),
    }


def plot_reliability(score: Score) -> Figure:
    """How often stated probabilities came true, with 95 % binomial bands around what they state.

    Parameters
    ----------
    score : zoo.blood.blind.Score

    Returns
    -------
    matplotlib.figure.Figure
        Left the leading group of each case, right every group with at least 1 %. Hollow bins have fewer
        than eight cases.
    """
    from zoo.blood.blind import FULL_BIN

    panels = (
        ("leading explanation with its group", score.reliability),
        ("all groups", score.reliability_all),
    )
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.6, 4.2), layout="constrained")
        for axes, (title, bins) in zip(figure.subplots(1, 2, sharey=True), panels, strict=True):
            axes.plot((0, 1), (0, 1), color="#888888", lw=0.9, ls=(0, (4, 2)))
            for b in bins:
                low, high = (x / b.n for x in b.band)
                axes.plot((b.stated, b.stated), (low, high), color="#C8CED6", lw=7, solid_capstyle="butt")
                colour = RIGHT if b.inside else WRONG
                face = colour if b.n >= FULL_BIN else "white"
                axes.plot(b.stated, b.right / b.n, "o", color=colour, mfc=face, ms=6, zorder=3)
                axes.annotate(
                    str(b.n),
                    (b.stated, b.right / b.n),
                    (6, -9),
                    textcoords="offset points",
                    fontsize="x-small",
                )
            axes.set(xlim=(-0.03, 1.05), ylim=(-0.03, 1.05), aspect="equal", xlabel="stated probability")
            axes.set_title(title)
        figure.axes[0].set_ylabel("share that is true (number: cases)")
    return figure


def plot_accuracy(score: Score) -> Figure:
    """From which gap on an answer can be trusted: share right against gap over noise, and the rates.

    Parameters
    ----------
    score : zoo.blood.blind.Score

    Returns
    -------
    matplotlib.figure.Figure
        Left the share of listed effects that (or whose group) were ranked first with Wilson's 95 % interval,
        a tick for each case, those above right. Right the rates of the summary with theirs.
    """
    from zoo.blood.blind import HEADLINES

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 4.2), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
        listed = [c for c in score.cases if c.kind == "listed"]
        for hit, y, marker in ((True, 1.06, "|"), (False, -0.06, "|")):
            x = [c.gap_over_noise for c in listed if c.group_first == hit]
            left.plot(x, np.full(len(x), y), marker, color=RIGHT if hit else WRONG, ms=8)
        curve = [row for row in score.curve if row["n"]]
        x = [row["median"] for row in curve]
        share, low, high = (np.array([row[name] for row in curve]) for name in ("share", "low", "high"))
        if curve:
            error = np.clip(np.stack([share - low, high - share]), 0, None)
            left.errorbar(x, share, error, fmt="o-", color=COLOURS[0], ms=5, lw=1.3, capsize=3)
            left.set_xscale("log")
            left.xaxis.set_major_locator(mpl.ticker.LogLocator(subs=(1, 2, 3, 5)))
            left.xaxis.set_major_formatter(mpl.ticker.StrMethodFormatter("{x:g}"))
            left.xaxis.set_minor_formatter(mpl.ticker.NullFormatter())
        left.set_ylim(-0.12, 1.12)
        left.set_yticks(np.linspace(0.0, 1.0, 6))
        left.set_xlabel("gap / sd of the noise")
        left.set_ylabel("true effect or its group first")
        left.set_title("accuracy by size of the gap")
        rates = [(words, score.summary[name]) for name, words in HEADLINES if score.summary[name]["n"]]
        for row, (_, rate) in enumerate(rates):
            right.plot((100 * rate["low"], 100 * rate["high"]), (row, row), color=COLOURS[0], lw=1.3)
            right.plot(100 * rate["share"], row, "o", color=COLOURS[0], ms=6)
        right.set_yticks(
            range(len(rates)), [textwrap.fill(words, 34) for words, _ in rates], fontsize="small"
        )
        right.set_ylim(len(rates) - 0.4, -0.6)
        right.set_xlim(-3, 103)
        right.set_xlabel("% of cases (line: 95 % interval)")
        right.grid(axis="x", color="#DDDDDD", lw=0.7)
        right.set_axisbelow(True)
    return figure


def plot_confusion(score: Score) -> Figure:
    """What was ranked first, by what is true.

    Parameters
    ----------
    score : zoo.blood.blind.Score

    Returns
    -------
    matplotlib.figure.Figure
        Rows are true, columns ranked first; framed cells are the right ones.
    """
    true = sorted(score.confusion)
    said = sorted({name for row in score.confusion.values() for name in row})
    count = np.array([[score.confusion[t].get(s, 0) for s in said] for t in true])
    count = count.reshape(len(true), len(said))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.4 + 0.3 * len(said), 2.6 + 0.26 * len(true)), layout="constrained")
        axes = figure.subplots()
        axes.imshow(count, cmap="Blues", vmin=0, vmax=max(1, int(count.max(initial=1))) * 1.4, aspect="auto")
        for i, t in enumerate(true):
            outside = any(c.truth == t and c.kind == "outside" for c in score.cases)
            for j, s in enumerate(said):
                if count[i, j]:
                    dark = count[i, j] > 0.7 * count.max()
                    axes.text(
                        j, i, str(count[i, j]), ha="center", va="center", fontsize="small",
                        color="white" if dark else INK,
                    )  # fmt: skip
                if s == t or (outside and s == UNLISTED):
                    box = mpl.patches.Rectangle((j - 0.5, i - 0.5), 1, 1, fill=False, ec=INK, lw=1.2)
                    axes.add_patch(box)
        axes.set_xticks(range(len(said)), said, rotation=90, fontsize="small")
        axes.set_yticks(range(len(true)), true, fontsize="small")
        axes.set_xlabel("ranked first")
        axes.set_ylabel("true")
    return figure


def plot_sizes(score: Score) -> Figure:
    """Stated against true: what part of the gap the cause removes, and the effects' amplitudes.

    Parameters
    ----------
    score : zoo.blood.blind.Score

    Returns
    -------
    matplotlib.figure.Figure
        Bars are 95 % intervals; amplitudes are divided by the true ones.
    """
    rows = [c for c in score.cases if c.amplitude is not None and c.amplitude_true]
    names = sorted({c.truth for c in rows})
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.5, max(4.4, 1.2 + 0.3 * len(names))), layout="constrained")
        left, right = figure.subplots(1, 2)
        for c in score.cases:
            if c.shrinkage is None or c.shrinkage_low is None or c.shrinkage_high is None:
                continue
            assert c.shrinkage_true is not None
            colour = RIGHT if c.shrinkage_within else WRONG
            x = 100 * c.shrinkage_true
            left.plot((x, x), (100 * c.shrinkage_low, 100 * c.shrinkage_high), color=colour, lw=1)
            left.plot(x, 100 * c.shrinkage, "o", color=colour, ms=4)
        low, high = left.get_xlim()
        line = np.array([low, high])
        left.fill_between(line, line - 10, line + 10, color="#DDE2E8", lw=0, zorder=0)
        left.set_xlim(low, high)
        left.set_ylim(top=101.5)  # all of it, and room for the marks
        left.set_xlabel("true shrinkage of the gap (%)")
        left.set_ylabel("stated shrinkage (%)")
        left.set_title("what the cause removes (strip: ± 10 points)")
        for c in rows:
            assert c.amplitude is not None
            assert c.amplitude_true is not None
            ratio, sd = c.amplitude / c.amplitude_true, (c.amplitude_sd or 0.0) / abs(c.amplitude_true)
            colour = RIGHT if c.amplitude_covered else WRONG
            alike = [other.case for other in rows if other.truth == c.truth]
            k = names.index(c.truth) + 0.7 * ((alike.index(c.case) + 0.5) / len(alike) - 0.5)
            right.errorbar(ratio, k, xerr=1.96 * sd, fmt="o", color=colour, ms=4, lw=1, capsize=2)
        right.axvline(1, color="#888888", lw=0.9)
        right.set_xlim(-0.6, 2.6)
        right.set_yticks(range(len(names)), names, fontsize="small")
        right.set_ylim(len(names) - 0.4, -0.6)
        right.set_xlabel("stated amplitude / true one")
        right.set_title("amplitude of the true effect, at the true place")
    return figure
