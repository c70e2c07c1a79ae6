"""Causes in a diagnosis: probabilities of components and sets, their sensitivity, learned functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from zoo.core.diagnosis.file import ComponentResult, LearnedFunction
from zoo.plots.style import COLOURS, DOTTED, INK, cells_of, grid_behind, legend_below, new_figure, size_of
from zoo.plots.subject import leading_sets, percent, set_name

if TYPE_CHECKING:
    from zoo.core.diagnosis import Diagnosis

SHOWN_SETS, SHOWN_FUNCTIONS = 7, 6
"""Sets of causes besides that of none, and panels of learned functions, the most probable."""
TOLD_LABELS, MOST_WIDE = 40, 44
"""Most places that are named along an axis, and most letters of a line of a set's name."""
ROW, SET_ROW = 0.34, 0.46
"""Heights of a component and of a set, in inches: names of sets may have three lines."""
Learned = tuple[ComponentResult, LearnedFunction]
PROBABILITY_COLOUR, SHARE_COLOUR, PRIOR_COLOUR = COLOURS[0], COLOURS[1], "#9AA5B1"


def _draw_bars(axes: Axes, bars: Sequence[tuple[str, float, float]]) -> None:
    """Name, probability and prior of each, from the top down; the probability with its number."""
    for row, (_, probability, prior) in enumerate(bars):
        axes.barh(row - 0.14, 100.0 * probability, color=PROBABILITY_COLOUR, height=0.44)
        axes.barh(row + 0.24, 100.0 * prior, color=PRIOR_COLOUR, height=0.24)
        at, text = (100.0 * probability, row - 0.14), percent(probability)
        axes.annotate(text, at, xytext=(4, 0), textcoords="offset points", va="center", fontsize=7)
    axes.set_yticks(range(len(bars)), [_folded(name) for name, *_ in bars], fontsize="small")
    axes.set_ylim(len(bars) - 0.4, -0.6)
    axes.set_xlim(0, 100)
    grid_behind(axes)


def _folded(name: str) -> str:
    """A set's name in lines that end between its causes."""
    first, *rest = name.split(" + ")
    lines = [first]
    for cause in rest:
        longer = f"{lines[-1]} + {cause}"
        lines = [*lines[:-1], longer] if len(longer) <= MOST_WIDE else [*lines, f"+ {cause}"]
    return "\n".join(lines)


def draw_causes(figure: Figure | SubFigure, d: Diagnosis) -> None:
    """The panels of `plot_causes`."""
    file = d.file
    found, sets = file.components, leading_sets(file, SHOWN_SETS)
    heights, widths = (ROW * max(2, len(found)), SET_ROW * len(sets)), (1.7, 1.0)
    grid = figure.subplots(2, 2, sharey="row", height_ratios=heights, width_ratios=widths)
    (top, shares), (bottom, gaps) = grid
    _draw_bars(top, [(c.name, c.probability, c.prior_probability) for c in found])
    top.set_title("components that are wrong")
    for row, c in enumerate(found):
        span = (100.0 * c.share.low, 100.0 * c.share.high)
        shares.plot(span, (row, row), color=SHARE_COLOUR, lw=2.0, alpha=0.5, solid_capstyle="butt")
        shares.plot(100.0 * c.share.mean, row, "o", color=SHARE_COLOUR, ms=5, clip_on=False)
    low, high = shares.get_xlim()
    shares.set_xlim(0 if low > -10 else low, max(100, high))
    shares.set_xlabel("share of the gap's energy (%)")
    _draw_bars(bottom, [(set_name(row), row.probability, math.exp(row.log_prior)) for row in sets])
    bottom.set_title("sets of causes")
    bottom.set_xlabel("probability (%)")
    for y, one in enumerate(sets):
        if one.gap_after is not None:
            gaps.plot(one.gap_after, y, "o", color=SHARE_COLOUR, ms=5, clip_on=False)
        else:
            gaps.annotate(
                "not solved", (0.04, y), xycoords=("axes fraction", "data"), va="center", fontsize=7
            )
    unit = "" if file.gap.unit == "1" else f" ({file.gap.unit})"
    gaps.axvline(file.gap.before, color=INK, lw=1.0, ls=DOTTED)
    gaps.set_xlim(0, None)
    gaps.set_xlabel(f"gap left by simulation{unit}")
    for axes in (shares, gaps):
        grid_behind(axes)
        axes.tick_params(left=False, labelleft=False)
    handles = [
        Patch(color=PROBABILITY_COLOUR, label="probability"),
        Patch(color=PRIOR_COLOUR, label="prior alone"),
        Line2D([], [], color=INK, lw=1.0, ls=DOTTED, label="gap of the baseline"),
    ]
    legend_below(figure, handles, 3)


def causes_height(d: Diagnosis) -> float:
    """Of the panels of `plot_causes`, in inches."""
    return 1.9 + ROW * max(2, len(d.file.components)) + SET_ROW * len(leading_sets(d.file, SHOWN_SETS))


def plot_causes(d: Diagnosis) -> Figure:
    """Probabilities of the components and of the leading sets of causes, each beside its prior.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
        Above, the components with their shares of the gap's energy and 95 % intervals; below, the sets and
        that of no cause, with the gap that the simulator leaves at their modes.
    """
    with new_figure((8.4, causes_height(d))) as figure:
        draw_causes(figure, d)
    return figure


def plot_sensitivity(d: Diagnosis) -> Figure:
    """Probability of no cause, and that each component is wrong, under each prior.

    Parameters
    ----------
    d : Diagnosis

    Returns
    -------
    matplotlib.figure.Figure
        A row for each component: a bar under the stated prior, and a dot under each other one.
    """
    stated, *others = d.file.sensitivity
    names = ["no cause", *(c.name for c in d.file.components)]
    rows = np.arange(len(names))
    offsets = np.linspace(-0.36, 0.36, len(others))
    with new_figure((8.4, 1.5 + 0.5 * len(names))) as figure:
        axes = figure.subplots()
        for k, one in enumerate((stated, *others)):
            values = [100.0 * x for x in (one.nothing, *(one.components[name] for name in names[1:]))]
            if one is stated:
                axes.barh(rows, values, color="#DDE2E8", height=0.86, label=one.prior)
                continue
            axes.plot(
                values, rows + offsets[k - 1], "oD"[(k - 1) // len(COLOURS)], ms=4.5,
                color=COLOURS[(k - 1) % len(COLOURS)], clip_on=False, zorder=3, label=one.prior,
            )  # fmt: skip
        axes.set_yticks(rows, names)
        axes.set_ylim(len(names) - 0.4, -0.6)
        axes.set_xlim(0, 100)
        axes.set_xlabel("probability that the component is wrong (%)")
        grid_behind(axes)
        legend_below(figure, axes.get_legend_handles_labels()[0], 3)
    return figure


def plot_functions(d: Diagnosis) -> Figure:
    """What was learned of components: the most probable functions with their 95 % bands and their priors'.

    Parameters
    ----------
    d : Diagnosis
        With learned functions.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each function, at most `SHOWN_FUNCTIONS`; the grey strip is 1.96 standard deviations of
        the prior, and 0 is the baseline.
    """
    shown = learned_functions(d)[:SHOWN_FUNCTIONS]
    with new_figure(size_of(len(shown), 2, 4.3, 2.7, more=0.4)) as figure:
        draw_functions(figure, shown, 2)
    return figure


def learned_functions(d: Diagnosis, least: float = 0.0) -> list[Learned]:
    """Functions with their components that are more probable than `least`, the most probable first."""
    found = [(c, f) for c in d.file.components for f in c.functions if f.probability > least]
    return sorted(found, key=lambda pair: -pair[1].probability)


def draw_functions(figure: Figure | SubFigure, shown: Sequence[Learned], abreast: int) -> None:
    """The panels of `plot_functions`."""
    for [axes], (component, function) in zip(cells_of(figure, len(shown), abreast), shown, strict=True):
        _draw_function(axes, component, function)


def _draw_function(axes: Axes, component: ComponentResult, f: LearnedFunction) -> None:
    mean, low, high = (np.asarray(values) for values in (f.mean, f.low, f.high))
    prior = 1.96 * np.asarray(f.prior_sd)
    axes.axhline(0.0, color="#888888", lw=0.7)
    if f.labels:
        x = np.arange(len(mean), dtype=float)
        axes.fill_between(x, -prior, prior, color=PRIOR_COLOUR, alpha=0.25, lw=0, step="mid")
        axes.vlines(x, low, high, color=PROBABILITY_COLOUR, lw=1.6, alpha=0.6)
        axes.plot(x, mean, "o", color=PROBABILITY_COLOUR, ms=3.5)
        if len(mean) <= TOLD_LABELS:
            axes.set_xticks(x, f.labels, rotation=90, fontsize=6)
        axes.set_xlabel(f.argument)
    else:
        order = np.argsort(f.values)
        x, argument, unit = np.asarray(f.values)[order], f.argument, f.argument_unit
        if argument.startswith("log "):
            x, argument, unit = np.exp(x), argument.removeprefix("log "), unit.removeprefix("log ")
            axes.set_xscale("log")
        axes.fill_between(x, -prior[order], prior[order], color=PRIOR_COLOUR, alpha=0.25, lw=0)
        axes.fill_between(x, low[order], high[order], color=PROBABILITY_COLOUR, alpha=0.3, lw=0)
        axes.plot(x, mean[order], color=PROBABILITY_COLOUR, lw=1.4)
        axes.set_xlabel(_labelled(argument, unit))
    axes.set_ylabel(_labelled(f.name.replace("-", " "), f.unit), fontsize="small")
    axes.set_title(f"{component.name}: this function {percent(f.probability)}")


def _labelled(text: str, unit: str) -> str:
    return text if unit in ("", "1") else f"{text} ({unit})"
