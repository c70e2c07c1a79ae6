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

from zoo.core.arrays import Array
from zoo.core.diagnosis.file import unit_suffix
from zoo.core.words import unit_words
from zoo.plots.causes import causes_height, draw_causes, draw_functions, learned_functions
from zoo.plots.style import (
    COLOURS,
    DASHED,
    INK,
    NARROW,
    QUANTITY_LABELS,
    cells_of,
    draw_shares,
    handles_of,
    legend_below,
    measured,
    new_figure,
    parts,
    size_of,
)
from zoo.plots.subject import TOLD, study_of
from zoo.plots.vessel_tree import draw_locations, draw_tree

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


def _draw_discrepancy(figure: Figure | SubFigure, d: Diagnosis, abreast: int = 3) -> None:
    data = d.data
    causes = textwrap.shorten(" + ".join(d.cause), 60, placeholder=" + …")
    beat = study_of(d) is not None
    times = (1e3 if beat else 1.0) * data.times
    duration = (1e3 if beat else 1.0) * data.duration
    phase_names, phase = d.hooks.phases_of(data, d.hooks.rows(data))
    cells = cells_of(figure, data.n_series, abreast, (3, 1.6))
    for i, (values, row) in enumerate(zip(data.values, d.file.gap.per_series, strict=True)):
        top, bottom = cells[i]
        for axes in (top, bottom):
            _shade_phases(axes, phase_names, phase, times, named=axes is top)
            axes.set_xlim(times[0], times[0] + duration)
        top.plot(*measured(times, values), color=INK, lw=2.2, alpha=0.35, label="observed")
        base, leader = (series[i] for series in d.computed)
        top.plot(*measured(times, base), color=BASELINE_COLOUR, lw=1.2, ls=DASHED, label="baseline")
        drawn = [("baseline", d.before, BASELINE_COLOUR)]
        if causes:
            top.plot(*measured(times, leader), color=CAUSE_COLOUR, lw=1.2, label=f"baseline + {causes}")
            drawn.append(("leading set", d.after, CAUSE_COLOUR))
        noise = row.noise_floor
        bottom.axhspan(-noise, noise, color="#B8C0C8", alpha=0.45, lw=0, zorder=1, label="noise (sd)")
        bottom.axhline(0, color="#888888", lw=0.7)
        for label, found, colour in drawn:
            at, mean = measured(times, found.mean[i])
            sd = 1.96 * data.samples(i, found.sd)
            label = f"error of the {label}, 95 %"
            bottom.fill_between(at, mean - sd, mean + sd, color=colour, alpha=0.3, lw=0, zorder=2)
            bottom.plot(at, mean, color=colour, lw=1.2, zorder=3, label=label)
        group = data.groups[i]
        label = data.labels[i].removesuffix(f" {group}")
        after = f" to {row.after.mean:.2g}" if causes else ""
        top.set_title(f"{label}: error {row.before.mean:.2g}{after}{unit_words(row.unit)}", pad=24)
        top.set_ylabel(QUANTITY_LABELS.get(group, f"{group} ({data.units[i]})"))
        top.tick_params(labelbottom=False)
        bottom.set_ylabel("error" if row.unit == "1" else f"error ({row.unit})")
        bottom.set_xlabel("time in the beat (ms)" if beat else f"time ({data.time_unit})")
    legend_below(figure, handles_of(*cells[0]), abreast)


def _discrepancy_size(d: Diagnosis) -> tuple[float, float]:
    return size_of(d.data.n_series, 3, 4.3, 4.4, least=6.4, more=0.5)


def plot_discrepancy(d: Diagnosis, *, narrow: bool = False) -> Figure:
    """Each observed series with the baseline and with the leading set of causes; below, what these leave.

    Parameters
    ----------
    d : Diagnosis
    narrow : bool
        For a narrow screen.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels for each observed series; phases of the beat are shaded and named, bands hold 95 %, the
        grey strip is one standard deviation of the noise.
    """
    size = size_of(d.data.n_series, 1, NARROW, 4.4, more=1.3) if narrow else _discrepancy_size(d)
    with new_figure(size) as figure:
        _draw_discrepancy(figure, d, 1 if narrow else 3)
    return figure


def _shares(d: Diagnosis) -> list[tuple[str, dict[str, float]]]:
    """Shares that say something of these data: harmonics of a period, series where there are two."""
    where, data = d.file.where, d.data
    found = [("phase" if study_of(d) is None else "phase of the beat", where.phase)]
    if data.period is not None:
        found.append(("harmonic", where.harmonic))
    if len(where.series) > 1:
        units = dict(zip(data.labels, map(unit_suffix, data.units), strict=True))
        found.append(("series", {k.removesuffix(units[k]): share for k, share in where.series.items()}))
    return found


def _located(d: Diagnosis) -> bool:
    """Whether there is a place to show: of an effect, or of a next measurement in a tree."""
    placed = any(at.part is not None and at.probability >= TOLD for at in d.file.where.place)
    return placed or (study_of(d) is not None and d.file.next_measurement is not None)


def _draw_where(figure: Figure | SubFigure, d: Diagnosis, *, narrow: bool = False) -> None:
    shares, study = _shares(d), study_of(d)
    left, right = figure, None
    if _located(d):
        heights = [1.0, max(1.0, 3.6 / _shares_height(d))]
        left, right = (
            parts(figure, 2, 1, height_ratios=heights)
            if narrow
            else parts(figure, 1, 2, width_ratios=(1, 1.9))
        )
    if narrow or right is not None:
        ratios = [max(2.5, float(len(rows))) for _, rows in shares]
        panels = left.subplots(len(shares), 1, height_ratios=ratios, squeeze=False)
    else:
        panels = left.subplots(1, len(shares), squeeze=False)
    for axes, (title, rows) in zip(panels.flat, shares, strict=True):
        draw_shares(axes, rows, title, BASELINE_COLOUR)
    axes.set_xlabel("share of the model error's energy (%)")
    if right is None:
        return
    if study is None:
        draw_locations(right.subplots(), d)
    else:
        draw_tree(right.subplots(), d, study)


def _shares_height(d: Diagnosis) -> float:
    return 0.9 + sum(0.5 + 0.22 * len(rows) for _, rows in _shares(d))


def _where_height(d: Diagnosis) -> float:
    study = study_of(d)
    if not _located(d):
        return 1.2 + 0.22 * max(len(rows) for _, rows in _shares(d))
    terminals = len(d.file.where.place)
    if study is not None:
        terminals = len(study.vessels) - len({v.parent for v in study.vessels} - {None})
    return min(24.0, max(_shares_height(d), 1.5 + 0.3 * terminals))


def plot_where(d: Diagnosis, *, narrow: bool = False) -> Figure:
    """Where the gap lies: shares by phase, harmonic and series, and the probability of each location.

    Parameters
    ----------
    d : Diagnosis
    narrow : bool
        For a narrow screen.

    Returns
    -------
    matplotlib.figure.Figure
        Vessels are coloured by the probability that a listed effect acts in them, alone or with others below
        or above them; the box is for "everywhere alike". Without harmonics where the record has no period,
        and without locations where every effect acts everywhere.
    """
    size = (10.0, _where_height(d))
    if narrow:
        size = NARROW, _shares_height(d) + 3.6 * _located(d)
    with new_figure(size) as figure:
        _draw_where(figure, d, narrow=narrow)
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
        title = f"{d.file.study}, baseline {d.file.base}. {d.file.verdict}"
        figure.suptitle(textwrap.fill(title, 150), x=0.01, ha="left", parse_math=False)
    return figure
