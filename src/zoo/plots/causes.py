"""Causes in a diagnosis: probabilities of components and sets, their sensitivity, learned functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch

from zoo.core.diagnosis.file import ComponentResult, LearnedFunction
from zoo.core.words import chance, percent
from zoo.plots.style import COLOURS, NARROW, cells_of, grid_behind, legend_below, new_figure, size_of
from zoo.plots.subject import TOLD, leading_sets, set_name

if TYPE_CHECKING:
    from zoo.core.diagnosis import Diagnosis

SHOWN_SETS, SHOWN_FUNCTIONS = 7, 6
"""Sets of causes besides that of none, and panels of learned functions, the most probable."""
TOLD_LABELS, MOST_WIDE = 40, 30
"""Most places that are named along an axis, and most letters of a line of a set's name."""
ROW, SET_ROW, LINE = 0.28, 0.4, 0.14
"""Heights of a component, of a set and of a line of its name, in inches."""
Learned = tuple[ComponentResult, LearnedFunction]
PROBABILITY_COLOUR, PRIOR_COLOUR = COLOURS[0], "#9AA5B1"


def _draw_bars(axes: Axes, bars: Sequence[tuple[str, float, float]]) -> None:
    """Name, probability and prior of each, from the top down; the probability with its number."""
    for row, (_, probability, prior) in enumerate(bars):
        axes.barh(row - 0.14, 100.0 * probability, color=PROBABILITY_COLOUR, height=0.44)
        axes.barh(row + 0.24, 100.0 * prior, color=PRIOR_COLOUR, height=0.24)
        at, text = (100.0 * probability, row - 0.14), chance(probability)
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
    heights = _heights(d)
    top, bottom = figure.subplots(2, 1, height_ratios=heights)
    _draw_bars(top, [(c.name, c.probability, c.prior_probability) for c in found])
    top.set_title("components that are wrong")
    _draw_bars(bottom, [(set_name(row), row.probability, math.exp(row.log_prior)) for row in sets])
    bottom.set_title("sets of causes (these and no others)")
    bottom.set_xlabel("probability (%)")
    handles = [
        Patch(color=PROBABILITY_COLOUR, label="probability"),
        Patch(color=PRIOR_COLOUR, label="before the data"),
    ]
    legend_below(figure, handles, 2)


def causes_height(d: Diagnosis) -> float:
    """Of the panels of `plot_causes`, in inches."""
    return 1.6 + sum(_heights(d))


def _heights(d: Diagnosis) -> tuple[float, float]:
    """Of both panels' rows, in inches; rows of sets have room for the name of most lines."""
    sets = leading_sets(d.file, SHOWN_SETS)
    lines = max(1 + _folded(set_name(row)).count("\n") for row in sets)
    return ROW * max(2, len(d.file.components)), max(SET_ROW, LINE * lines) * len(sets)


def plot_causes(d: Diagnosis, *, narrow: bool = False) -> Figure:
    """Probabilities of the components and of the leading sets of causes, each beside its prior.

    Parameters
    ----------
    d : Diagnosis
    narrow : bool
        For a narrow screen.

    Returns
    -------
    matplotlib.figure.Figure
        Above, the components; below, the sets and that of no cause.
    """
    with new_figure((NARROW if narrow else 8.4, causes_height(d))) as figure:
        draw_causes(figure, d)
    return figure


def plot_sensitivity(d: Diagnosis, *, narrow: bool = False) -> Figure:
    """Probability of no cause, and that each component is wrong, under each prior.

    Parameters
    ----------
    d : Diagnosis
    narrow : bool
        For a narrow screen.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each component: a bar under the stated prior, and a dot under each other one.
    """
    stated, *others = d.file.sensitivity
    names = ["no cause", *(c.name for c in d.file.components)]
    rows = np.arange(len(names))
    offsets = np.linspace(-0.36, 0.36, len(others))
    size = (NARROW, 3.2 + 0.4 * len(names)) if narrow else (8.4, 1.5 + 0.4 * len(names))
    with new_figure(size) as figure:
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
        legend_below(figure, axes.get_legend_handles_labels()[0], 1 if narrow else 3)
    return figure


def plot_functions(d: Diagnosis, *, narrow: bool = False) -> Figure:
    """What was learned of components: the most probable functions with their 95 % bands and their priors'.

    Parameters
    ----------
    d : Diagnosis
        With learned functions.
    narrow : bool
        For a narrow screen.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each function, at most `SHOWN_FUNCTIONS`; the grey strip is 1.96 standard deviations of
        the prior, and 0 is the baseline.
    """
    shown, abreast = learned_functions(d, TOLD)[:SHOWN_FUNCTIONS], 1 if narrow else 2
    with new_figure(size_of(len(shown), abreast, NARROW, 2.7, more=0.4)) as figure:
        draw_functions(figure, shown, abreast)
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
    axes.set_title(f"{component.name}: probability {percent(f.probability)}")


def _labelled(text: str, unit: str) -> str:
    return text if unit in ("", "1") else f"{text} ({unit})"
