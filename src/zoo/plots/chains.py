"""The chains of one posterior: traces, ranks, pairs of parameters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from zoo.plots.style import COLOURS, PARAMETER_LABELS, SCALES, STYLE, parameter_label

if TYPE_CHECKING:
    import arviz as az


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
        labels={name: parameter_label(name) for name in names},
        figsize=(size, size),
        textsize=8,
        marginals=True,
        kind="scatter",
        scatter_kwargs={"alpha": 0.25, "s": 9, "color": COLOURS[0]},
        marginal_kwargs={"color": COLOURS[0]},
    )
    figure.axes[0].set_yticks([])
    return figure
