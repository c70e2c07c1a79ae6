"""Figures: fits with their bands, chains, comparisons of models, waves; the only use of matplotlib."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import arviz as az
    import pandas as pd
    import pymc as pm
    import xarray as xr

    from zoo.study import Study

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
    "gamma": r"$\gamma$",
    "psi1": r"$\psi_1$",
    "psi2": r"$\psi_2$",
    "c": "$c$",
    "sigma2": r"$\sigma^2$ (mmHg$^2$)",
    "w": "$w$ (s$^{-2}$)",
    "b": "$b$",
}


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


def predictive_draws(
    model: pm.Model, idata: az.InferenceData, *, n_draws: int = 200, seed: int = 0
) -> tuple[Array, Array]:
    """Waveforms of posterior draws, without and with the model's errors.

    A predicted value is y(t) = m(t) + e(t), with e(t) from the model's own marginal law at each draw: normal
    with variance sigma2, or with variance k(t, t; w, b) plus the fixed noise and jitter.

    Parameters
    ----------
    model : pymc.Model
        With a record (`model.zoo`).
    idata : InferenceData
        Its posterior.
    n_draws : int
        Draws of all chains together.
    seed : int
        Of the errors.

    Returns
    -------
    means : array (n_draws, n_series, n_times)
        In the series' own units; draws whose solve fails are left out.
    predictions : array (10 n_draws, n_series, n_times)
        Ten draws of the errors for each.
    """
    from zoo.comparison import posterior_means, record_of, thin
    from zoo.likelihood import JITTER, NOISE_VARIANCE, neural_network_kernel

    record = record_of(model)
    posterior = thin(idata, n_draws)
    means = posterior_means(model, posterior)
    errors = {
        name: posterior[name].transpose("chain", "draw", ...).to_numpy().ravel()
        for name in record.error_parameters
    }
    variance = np.empty((len(means), means.shape[-1]))
    for i in range(len(means)):
        if record.error == "iid":
            variance[i] = errors["sigma2"][i]
        else:
            kernel = neural_network_kernel(record.study.time_s, errors["w"][i], errors["b"][i])
            variance[i] = np.diag(kernel) + NOISE_VARIANCE + JITTER
    good = np.isfinite(means).all(axis=(1, 2))
    means, variance = means[good], variance[good]
    noise = np.random.default_rng(seed).standard_normal((10, *means.shape))
    predictions = means + np.sqrt(variance)[:, None, :] * noise
    return means, predictions.reshape(-1, *means.shape[1:])


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


def _arviz(function: Any, *args: Any, **kwargs: Any) -> Figure:
    """Call an ArviZ plot in our style, and take its figure from pyplot so that its last user frees it."""
    import arviz as az
    import matplotlib.pyplot as plt

    with (
        mpl.rc_context({**STYLE, "figure.constrained_layout.use": True}),
        az.rc_context({"plot.max_subplots": 100}),
    ):
        labeller = az.labels.MapLabeller(var_name_map=PARAMETER_LABELS)
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
    size = 1.7 * sum(int(np.prod(idata["posterior"][name].shape[2:])) for name in names)
    return _arviz(
        az.plot_pair,
        idata,
        var_names=names,
        figsize=(size, size),
        textsize=8,
        marginals=True,
        kind="scatter",
        scatter_kwargs={"alpha": 0.2, "s": 3, "color": COLOURS[0]},
        marginal_kwargs={"color": COLOURS[0]},
    )


# -------------------------------------------------------------------------------------------------
# models


def comparison_figure(table: pd.DataFrame) -> Figure:
    """The criterion of each model with its standard error, and the differences to the best with theirs.

    Parameters
    ----------
    table : DataFrame
        From `zoo.comparison.compare`: one row a model, deviance scale.

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
