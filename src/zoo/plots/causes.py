"""Components of the simulator in a diagnosis: which holds the discrepancy, and what was learned of each."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zoo.core.diagnosis.file import ComponentResult, DiagnosisFile, LearnedFunction
from zoo.plots.style import COLOURS, DOTTED, INK, cells_of, grid_behind, new_figure, size_of
from zoo.plots.subject import unit_words

if TYPE_CHECKING:
    from zoo.core.diagnosis import Diagnosis

SHOWN_FUNCTIONS = 6
"""Panels of learned functions, those of the most probable components."""
TOLD_LABELS = 40
"""Most places that are named along an axis."""
PROBABILITY_COLOUR, SHARE_COLOUR, PRIOR_COLOUR = COLOURS[0], COLOURS[1], "#9AA5B1"


def plot_components(d: Diagnosis) -> Figure:
    """Probability of each component, the share of the discrepancy that it holds, and what it would leave.

    Parameters
    ----------
    d : Diagnosis
        With components.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each component, most probable first; shares and discrepancies with 95 % intervals. A hollow
        dot is a component that no held-out data confirm. Components of one group, which the data cannot tell
        apart, have one number.
    """
    file = d.file
    found = sorted(file.components, key=lambda c: -c.probability)
    with new_figure((8.4, 1.5 + 0.34 * len(found))) as figure:
        first, second, third = figure.subplots(1, 3, sharey=True)
        rows = np.arange(len(found))
        first.barh(rows, [100 * c.probability for c in found], color=PROBABILITY_COLOUR, height=0.55)
        first.set_xlim(0, 100)
        first.set_xlabel("probability (%)")
        first.set_yticks(rows, [f"{c.name} (group {c.group})" for c in found])
        first.set_ylim(len(found) - 0.5, -0.5)
        for row, c in enumerate(found):
            if c.share is not None:
                _interval(second, row, 100 * c.share.mean, 100 * c.share.low, 100 * c.share.high, c)
            if c.gap_after is not None:
                low, high = c.gap_after_interval or (c.gap_after, c.gap_after)
                _interval(third, row, c.gap_after, low, high, c)
        second.set_xlim(0, 100)
        second.set_xlabel("share of the discrepancy (%)")
        third.axvline(file.gap.before, color=INK, lw=1.0, ls=DOTTED)
        third.set_xlim(0, None)
        third.set_xlabel(f"discrepancy it leaves{f' ({file.gap.unit})' if file.gap.unit != '1' else ''}")
        for axes in (first, second, third):
            grid_behind(axes)
        third.set_title(f"dotted: the baseline, {file.gap.before:.2g}{unit_words(file.gap.unit)}", fontsize=8)
    return figure


def _interval(axes: Axes, row: int, mean: float, low: float, high: float, c: ComponentResult) -> None:
    held = c.held_out
    axes.plot((low, high), (row, row), color=SHARE_COLOUR, lw=2.0, alpha=0.5, solid_capstyle="butt")
    hollow = held is not None and not held.found
    axes.plot(mean, row, "o", color=SHARE_COLOUR, mfc="white" if hollow else SHARE_COLOUR, ms=6)


def learned_functions(file: DiagnosisFile) -> list[tuple[ComponentResult, LearnedFunction]]:
    """The functions that are drawn: those of the most probable components, each with its component."""
    found = [
        (c, f) for c in sorted(file.components, key=lambda c: -c.probability) for f in c.functions if f.mean
    ]
    return found[:SHOWN_FUNCTIONS]


def plot_functions(d: Diagnosis) -> Figure:
    """What was learned of the most probable components: each function with its 95 % band and its prior's.

    Parameters
    ----------
    d : Diagnosis
        With components.

    Returns
    -------
    matplotlib.figure.Figure
        A panel for each function, at most `SHOWN_FUNCTIONS`; the grey strip is 1.96 standard deviations of
        the prior, and 0 is the baseline.
    """
    shown = learned_functions(d.file)
    with new_figure(size_of(len(shown), 2, 4.3, 2.7, more=0.4)) as figure:
        for [axes], (component, function) in zip(cells_of(figure, len(shown), 2), shown, strict=True):
            _draw_function(axes, component, function)
    return figure


def _draw_function(axes: Axes, component: ComponentResult, f: LearnedFunction) -> None:
    mean, low, high = (np.asarray(values) for values in (f.mean, f.low, f.high))
    prior = 1.96 * np.asarray(f.prior_sd or np.full(len(mean), math.nan))
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
    axes.set_ylabel(_labelled(f.name.replace("-", " "), f.unit))
    own = "" if f.probability is None else f", {100 * f.probability:.0f} % of it this"
    axes.set_title(f"{component.name} {100 * component.probability:.0f} %{own}")


def _labelled(text: str, unit: str) -> str:
    return text if unit in ("", "1") else f"{text} ({unit})"
