"""A diagnosis: the model discrepancy, where it lies, and both with its causes on one page."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from zoo.core.diagnosis.file import unit_suffix
from zoo.plots.causes import causes_height, draw_causes, draw_functions, learned_functions
from zoo.plots.style import (
    COLOURS,
    DASHED,
    INK,
    QUANTITY_LABELS,
    Array,
    cells_of,
    draw_shares,
    handles_of,
    legend_below,
    new_figure,
    parts,
    size_of,
)
from zoo.plots.subject import study_of, unit_words
from zoo.plots.tree import draw_locations, draw_tree

if TYPE_CHECKING:
    from zoo.core.diagnosis import Diagnosis

BASELINE_COLOUR, CAUSE_COLOUR = COLOURS[1], COLOURS[0]
LIKELY, ABREAST = 0.5, 3
"""Probability above which a learned function is on the page, and how many of them there are at most."""


def _spans(index: NDArray[np.int_]) -> list[tuple[int, int, int]]:
    """Runs of equal values: first, one past the last, value."""
    edges = [0, *(np.flatnonzero(np.diff(index)) + 1), len(index)]
    return [(int(a), int(b), int(index[a])) for a, b in pairwise(edges)]


def _shade_phases(
    axes: Axes, names: Sequence[str], phase: NDArray[np.int_], times: Array, *, named: bool
) -> None:
    """Every other phase shaded; the two short ones are named a line higher."""
    step = times[1] - times[0]
    spans = _spans(phase)
    widest = {k: max((b - a, a) for a, b, value in spans if value == k)[1] for _, _, k in spans}
    for first, last, k in spans:
        if k % 2:
            axes.axvspan(times[0] + first * step, times[0] + last * step, color="#EEF1F4", lw=0, zorder=0)
        if named and widest[k] == first:
            axes.annotate(
                names[k],
                (times[0] + 0.5 * (first + last) * step, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0, 11 if k % 2 else 2),
                textcoords="offset points",
                ha="center",
                fontsize=7,
                color="#666666",
            )


def _draw_discrepancy(figure: Figure | SubFigure, d: Diagnosis) -> None:
    data = d.data
    causes = textwrap.shorten(" + ".join(d.cause), 60, placeholder=" + …")
    beat = study_of(d) is not None
    times = (1e3 if beat else 1.0) * data.times
    duration = (1e3 if beat else 1.0) * data.duration
    phase_names, phase = d.hooks.phases_of(data, d.hooks.rows(data))
    cells = cells_of(figure, data.n_series, 3, (3, 1.6))
    for i, (values, row) in enumerate(zip(data.values, d.file.gap.per_series, strict=True)):
        top, bottom = cells[i]
        for axes in (top, bottom):
            _shade_phases(axes, phase_names, phase, times, named=axes is top)
            axes.set_xlim(times[0], times[0] + duration)
        top.plot(times, values, color=INK, lw=2.2, alpha=0.35, label="observed")
        base, leader = (series[i] for series in d.computed)
        top.plot(times, base, color=BASELINE_COLOUR, lw=1.2, ls=DASHED, label="baseline")
        drawn = [("baseline", d.before, BASELINE_COLOUR)]
        if causes:
            top.plot(times, leader, color=CAUSE_COLOUR, lw=1.2, label=f"baseline + {causes}")
            drawn.append(("leading set", d.after, CAUSE_COLOUR))
        noise = row.noise_floor
        bottom.axhspan(-noise, noise, color="#B8C0C8", alpha=0.45, lw=0, zorder=1, label="noise (sd)")
        bottom.axhline(0, color="#888888", lw=0.7)
        for label, found, colour in drawn:
            mean, sd = found.mean[i], 1.96 * found.sd[i]
            label = f"gap of the {label}, 95 %"
            bottom.fill_between(times, mean - sd, mean + sd, color=colour, alpha=0.3, lw=0, zorder=2)
            bottom.plot(times, mean, color=colour, lw=1.2, zorder=3, label=label)
        group = data.groups[i]
        label = data.labels[i].removesuffix(f" {group}")
        after = f" to {row.after.mean:.2g}" if causes else ""
        top.set_title(f"{label}: gap {row.before.mean:.2g}{after}{unit_words(row.unit)}", pad=24)
        top.set_ylabel(QUANTITY_LABELS.get(group, f"{group} ({data.units[i]})"))
        top.tick_params(labelbottom=False)
        bottom.set_ylabel("gap" if row.unit == "1" else f"gap ({row.unit})")
        bottom.set_xlabel("time in the beat (ms)" if beat else f"time ({data.time_unit})")
    legend_below(figure, handles_of(*cells[0]), 3)


def _discrepancy_size(d: Diagnosis) -> tuple[float, float]:
    return size_of(d.data.n_series, 3, 4.3, 4.9, least=6.4, more=0.5)


def plot_discrepancy(d: Diagnosis) -> Figure:
    """Each observed series with the baseline and with the leading set of causes; below, what these leave.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
        Two panels for each observed series; phases of the beat are shaded and named, bands hold 95 %, the
        grey strip is one standard deviation of the noise.
    """
    with new_figure(_discrepancy_size(d)) as figure:
        _draw_discrepancy(figure, d)
    return figure


def _draw_where(figure: Figure | SubFigure, d: Diagnosis) -> None:
    left, right = parts(figure, 1, 2, width_ratios=(1, 1.9))
    where = d.file.where
    study = study_of(d)
    series = {
        label.removesuffix(unit_suffix(d.data.units[d.data.labels.index(label)])): share
        for label, share in where.series.items()
    }
    title = "phase" if study is None else "phase of the beat"
    panels = ((title, where.phase), ("harmonic", where.harmonic), ("series", series))
    ratios = [max(2.5, float(len(shares))) for _, shares in panels]
    for axes, (title, shares) in zip(left.subplots(3, 1, height_ratios=ratios), panels, strict=True):
        draw_shares(axes, shares, title, BASELINE_COLOUR)
    axes.set_xlabel("share of the gap's energy (%)")
    if study is None:
        draw_locations(right.subplots(), d)
    else:
        draw_tree(right.subplots(), d, study)


def _where_height(d: Diagnosis) -> float:
    study = study_of(d)
    terminals = len(d.file.where.place)
    if study is not None:
        terminals = len(study.vessels) - len({v.parent for v in study.vessels} - {None})
    bars = 5 + len(d.file.where.harmonic) + len(d.file.where.series)
    return min(24.0, max(1.8 + 0.24 * bars, 1.5 + 0.3 * terminals))


def plot_where(d: Diagnosis) -> Figure:
    """Where the gap lies: shares by phase, harmonic and series, and the probability of each location.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
        Vessels are coloured by the probability that a listed effect acts in them, alone or with others below
        or above them; the box is for "everywhere alike".
    """
    with new_figure((10.0, _where_height(d))) as figure:
        _draw_where(figure, d)
    return figure


def plot_diagnosis(d: Diagnosis) -> Figure:
    """The whole diagnosis on one page: `plot_discrepancy`, `plot_causes`, `plot_where`, and what was learned.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
    """
    learned = learned_functions(d, LIKELY)[:ABREAST]
    heights = [_discrepancy_size(d)[1], max(causes_height(d), _where_height(d)), *[3.0] * bool(learned)]
    with new_figure((17.0, 0.6 + sum(heights))) as figure:
        top, bottom, *below = parts(figure, len(heights), 1, height_ratios=heights)
        _draw_discrepancy(top, d)
        left, right = parts(bottom, 1, 2, width_ratios=(1, 1.1))
        draw_causes(left, d)
        _draw_where(right, d)
        for part in below:
            draw_functions(part, learned, ABREAST)
        doubt = "" if d.file.decided else " (not decided: see the warnings)"
        title = f"{d.file.study}, baseline {d.file.base}. {d.file.verdict}{doubt}"
        figure.suptitle(textwrap.fill(title, 150), x=0.01, ha="left", parse_math=False)
    return figure
