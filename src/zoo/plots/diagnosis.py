"""A diagnosis: the model discrepancy, its explanations, where it lies, and all three on one page."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from zoo.core.diagnosis.file import HypothesisResult, SeriesGap, unit_suffix
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, NULL
from zoo.plots.style import (
    COLOURS,
    DASHED,
    DOTTED,
    INK,
    QUANTITY_LABELS,
    SOLID,
    Array,
    axis_end,
    cells_of,
    draw_shares,
    grid_behind,
    handles_of,
    legend_below,
    new_figure,
    note_beside,
    parts,
    size_of,
)
from zoo.plots.subject import at_most, location_of, study_of, unit_words
from zoo.plots.tree import draw_locations, draw_tree

if TYPE_CHECKING:
    from zoo.core.diagnosis import Diagnosis

BASELINE_COLOUR, CAUSE_COLOUR, ALL_COLOUR = COLOURS[1], COLOURS[0], COLOURS[2]
NEAR = 5.0
"""Differences of log evidence below which an axis need not tell explanations apart."""
ALONE = "#9AA5B1"
"""Of explanations that are no group: nothing else looks like them."""


def _cause_name(d: Diagnosis) -> str:
    """The leading effect with its location; empty where no listed effect leads."""
    leader = d.file.hypotheses[0]
    if leader.name in (NULL, NONPARAMETRIC, CORRELATED):
        return ""
    return _named(leader, d)


def _named(h: HypothesisResult, d: Diagnosis) -> str:
    """An effect with its location, if that is not everywhere."""
    return h.name if h.place is None else f"{h.name}, {location_of(d.file, h.place, h.subtree)}"


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
    cause = _cause_name(d)
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
        computed = values - d.before.residual[i]
        top.plot(times, computed, color=BASELINE_COLOUR, lw=1.2, ls=DASHED, label="baseline")
        drawn = [("baseline", d.before, BASELINE_COLOUR)]
        if cause:
            computed = values - d.after.residual[i]
            top.plot(times, computed, color=CAUSE_COLOUR, lw=1.2, label=f"baseline + {cause}")
            drawn.append(("baseline + cause", d.after, CAUSE_COLOUR))
        if len(d.file.steps) > 1:
            label = f"baseline + {' + '.join(step.name for step in d.file.steps)}"
            top.plot(times, d.computed[1][i], color=ALL_COLOUR, lw=1.1, ls=DOTTED, label=label)
        noise = row.noise_floor
        bottom.axhspan(-noise, noise, color="#B8C0C8", alpha=0.45, lw=0, zorder=1, label="noise (sd)")
        bottom.axhline(0, color="#888888", lw=0.7)
        for label, found, colour in drawn:
            mean, sd = found.mean[i], 1.96 * found.sd[i]
            label = f"discrepancy of {label}, 95 %"
            bottom.fill_between(times, mean - sd, mean + sd, color=colour, alpha=0.3, lw=0, zorder=2)
            bottom.plot(times, mean, color=colour, lw=1.2, zorder=3, label=label)
        group = data.groups[i]
        label = data.labels[i].removesuffix(f" {group}")
        top.set_title(f"{label}: {_shrinks(row, bool(cause))}", pad=24)
        top.set_ylabel(QUANTITY_LABELS.get(group, f"{group} ({data.units[i]})"))
        top.tick_params(labelbottom=False)
        bottom.set_ylabel(f"discrepancy ({row.unit})")
        bottom.set_xlabel("time in the beat (ms)" if beat else f"time ({data.time_unit})")
    legend_below(figure, handles_of(*cells[0]), 3)


def _shrinks(row: SeriesGap, cause: bool) -> str:
    """Such as "discrepancy 0.25 to 0.01 mmHg"."""
    after = f" to {row.after.mean:.2g}" if cause else ""
    return f"discrepancy {row.before.mean:.2g}{after}{unit_words(row.unit)}"


def _discrepancy_size(d: Diagnosis) -> tuple[float, float]:
    return size_of(d.data.n_series, 3, 4.3, 4.9, least=6.4, more=0.5)


def plot_discrepancy(d: Diagnosis) -> Figure:
    """Each observed series with the baseline and the baseline with its cause; below, what these leave.

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


def _group_colours(d: Diagnosis) -> dict[int, str]:
    """Colours of the leader's group and of those with more than one member."""
    sizes = Counter(h.group for h in d.file.hypotheses)
    first = d.file.hypotheses[0].group
    shared = [g for g in dict.fromkeys(h.group for h in d.file.hypotheses) if sizes[g] > 1 or g == first]
    return {g: COLOURS[k % len(COLOURS)] for k, g in enumerate(shared)}


def _draw_hypotheses(figure: Figure | SubFigure, d: Diagnosis) -> None:
    axes = figure.subplots()
    found = d.file.hypotheses
    unit = unit_words(d.file.gap.unit)
    colours = _group_colours(d)
    best = max(h.log_evidence for h in found)
    behind = [best - h.log_evidence for h in found]
    end = axis_end(behind, NEAR)
    axis = 1.1 * max(NEAR, *(value for value in behind if end is None or value <= end))
    special = {NULL: "null hypothesis", NONPARAMETRIC: "nonparametric discrepancy", CORRELATED: ""}
    for row, (h, value) in enumerate(zip(found, behind, strict=True)):
        hidden, named = h.name in d.file.invisible, h.name not in special
        colour = ALONE if hidden else colours.get(h.group, ALONE)
        seen = end is None or value <= end
        axes.plot((0, min(value, axis)), (row, row), color=colour, lw=1.2, ls=DOTTED if hidden else SOLID)
        axes.plot(
            value if seen else axis,
            row,
            ("o" if named else "D") if seen else ">",
            color=colour,
            mfc="white" if hidden else colour,
            mec="#333333" if not named else colour,
            ms=7,
            clip_on=False,
            label=h.name,
        )
        words = f"{-value:.3g}: " if value >= 0.05 else "best: "
        words += f"{100 * h.probability:.0f} %" if h.probability >= 0.005 else "<1 %"
        if hidden:
            words = "invisible here"
        elif h.name not in (NONPARAMETRIC, CORRELATED):
            words += f", discrepancy {at_most(h)}{h.gap_after:.2g}{unit}"
        note_beside(axes, row, words, 9)
    axes.set_xlim(-0.04 * axis, axis)
    names = [f"{special[h.name]} ({h.name})" if special.get(h.name) else _named(h, d) for h in found]
    axes.set_yticks(np.arange(len(found)), names)
    axes.set_ylim(len(found) - 0.4, -0.6)
    grid_behind(axes)
    axes.set_xlabel("log evidence below the best")
    axes.set_title("explanations, most probable first")
    sizes = Counter(h.group for h in found)
    dot = partial(Line2D, [], [], ls="", ms=7)
    handles = [
        dot(marker="o", color=colour, label="leader" if sizes[g] == 1 else f"group {g}: not told apart")
        for g, colour in colours.items()
    ]
    if any(h.group not in colours and h.name not in d.file.invisible for h in found):
        handles.append(dot(marker="o", color=ALONE, label="told apart"))
    handles.append(dot(marker="D", color="white", mec="#333333", label="no listed effect"))
    if end is not None:
        handles.append(dot(marker=">", color="#666666", label="beyond the axis: see the number"))
    legend_below(figure, handles, 3)


def _hypotheses_height(d: Diagnosis) -> float:
    return 1.7 + 0.24 * len(d.file.hypotheses)


def plot_hypotheses(d: Diagnosis) -> Figure:
    """Log evidence of each explanation below that of the best, with the discrepancy that it leaves.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
        A dot for each explanation, most probable first, coloured by group, on a linear axis; diamonds name
        no listed effect, hollow dots are what these data cannot show. Where some are so far behind that the
        others could not be told apart, the axis ends before them, and arrows stand for them.
    """
    with new_figure((8.4, _hypotheses_height(d))) as figure:
        _draw_hypotheses(figure, d)
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
    axes.set_xlabel("share of the discrepancy's energy (%)")
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
    """Where the discrepancy lies: shares by phase, harmonic and series, and the probability of each location.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
        Vessels are coloured by the probability that the cause acts in them, alone or with others below or
        above them; the box is for "everywhere alike". All given that a listed effect is the cause.
    """
    with new_figure((10.0, _where_height(d))) as figure:
        _draw_where(figure, d)
    return figure


def plot_diagnosis(d: Diagnosis) -> Figure:
    """The whole diagnosis on one page: `plot_discrepancy`, `plot_hypotheses`, `plot_where` under the verdict.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
    """
    heights = (_discrepancy_size(d)[1], max(_hypotheses_height(d), _where_height(d)))
    with new_figure((17.0, 0.6 + sum(heights))) as figure:
        top, bottom = parts(figure, 2, 1, height_ratios=heights)
        _draw_discrepancy(top, d)
        left, right = parts(bottom, 1, 2, width_ratios=(1, 1.1))
        _draw_hypotheses(left, d)
        _draw_where(right, d)
        title = f"{d.file.study}, baseline {d.file.base}. {d.file.verdict}"
        figure.suptitle(textwrap.fill(title, 150), x=0.01, ha="left", parse_math=False)
    return figure
