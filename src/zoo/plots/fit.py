"""What was observed, what a fitted model says of it, and the residual."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from zoo.plots.style import (
    COLOURS,
    INK,
    QUANTITY_LABELS,
    RESIDUAL_LABELS,
    cells_of,
    handles_of,
    legend_below,
    measured,
    new_figure,
    size_of,
)

if TYPE_CHECKING:
    from zoo.blood.study import Study


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
        Two panels for each observed series, three series beside each other.
    """
    means = np.asarray(means, dtype=float)
    n = len(study.series)
    time_ms = 1e3 * np.asarray(study.time_s)
    with new_figure(size_of(n, 3, 4.2, 5.0, least=5.2)) as figure:
        cells = cells_of(figure, n, 3, (3, 1))
        for k, (series, (top, bottom)) in enumerate(zip(study.series, cells, strict=True)):
            top.margins(x=0)
            bottom.margins(x=0)
            median = np.median(means[:, k], axis=0)
            low, high = np.quantile(means[:, k], (0.025, 0.975), axis=0)
            if predictions is not None:
                band = np.quantile(np.asarray(predictions)[:, k], (0.025, 0.975), axis=0)
                top.fill_between(time_ms, *band, color=COLOURS[5], alpha=0.28, lw=0, label="95 % prediction")
                bottom.fill_between(time_ms, *(band - median), color=COLOURS[5], alpha=0.28, lw=0)
            top.fill_between(time_ms, low, high, color=COLOURS[0], alpha=0.45, lw=0, label="95 % credible")
            top.plot(time_ms, median, color=COLOURS[0], lw=1.4, label="posterior median")
            top.plot(*measured(time_ms, series.value), color=INK, lw=0.9, ls=(0, (4, 2)), label="observed")
            top.set_title(series.label.rsplit(" ", 1)[0])
            top.set_ylabel(QUANTITY_LABELS[series.quantity])
            top.tick_params(labelbottom=False)
            bottom.fill_between(time_ms, low - median, high - median, color=COLOURS[0], alpha=0.45, lw=0)
            bottom.axhline(0, color=COLOURS[0], lw=1)
            bottom.plot(*measured(time_ms, series.value - median), color=INK, lw=0.9)
            bottom.set_ylabel(RESIDUAL_LABELS[series.quantity])
            bottom.set_xlabel("time in the beat (ms)")
        figure.align_ylabels()
        legend_below(figure, handles_of(cells[0][0]), 4)
        if title:
            figure.suptitle(title, parse_math=False)
    return figure
