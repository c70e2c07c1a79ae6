"""What a diagnosis leaves in other states of its study."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from zoo.core.diagnosis.states import BASELINE, SEEN
from zoo.plots.style import COLOURS, INK, measured, new_figure
from zoo.plots.subject import study_of

if TYPE_CHECKING:
    from zoo.core.diagnosis import Diagnosis

SHOWN = 4
"""Explanations whose residuals are drawn, besides the baseline and the sensor's discrepancy."""


def plot_states(d: Diagnosis) -> Figure:
    """What is left of each series in other states: by the baseline, the sensor's discrepancy, and functions.

    Parameters
    ----------
    d : Diagnosis
        With states.

    Returns
    -------
    matplotlib.figure.Figure
        A row for each state, a column for each series of the group that the verdict is about; observed minus
        computed, the noise's standard deviation in grey. The functions are those of the first study, fixed.
    """
    beat = study_of(d) is not None
    rows = [(s, s.data.rows[s.group]) for s in d.states]
    columns = max(len(series) for _, series in rows)
    size = (2.2 + 3.0 * columns, 0.9 + 2.3 * len(rows))
    with new_figure(size) as figure:
        grid = figure.subplots(len(rows), columns, squeeze=False)
        for axes in grid.flat:
            axes.set_axis_off()
        names: list[str] = [BASELINE, SEEN]  # a name has one colour in all states
        lines: dict[str, Any] = {}
        for row, (state, series) in enumerate(rows):
            data = state.data
            times = (1e3 if beat else 1.0) * data.times
            learned = [name for name in state.computed if name not in (BASELINE, SEEN)]
            shown = [name for name in state.computed if name in (BASELINE, SEEN, *learned[:SHOWN])]
            names += [name for name in shown if name not in names]
            for column, i in enumerate(series):
                axes = grid[row, column]
                axes.set_axis_on()
                axes.axhspan(-state.file.noise, state.file.noise, color="#E4E7EB", lw=0)
                for name in shown:
                    k = names.index(name)
                    left = data.values[i] - state.computed[name][i]
                    colour = INK if k == 0 else COLOURS[(k - 1) % len(COLOURS)]
                    [lines[name]] = axes.plot(*measured(times, left), color=colour, lw=1.3 if k < 3 else 0.8)
                axes.set_xlim(times[0], times[-1])
                axes.set_title(f"{data.name}: {data.labels[i]}", fontsize=8, parse_math=False)
                if row == len(rows) - 1:
                    unit = "ms" if beat else d.data.time_unit
                    axes.set_xlabel(f"time ({unit})" if unit else "time")
                if column == 0:
                    unit = data.units[i]
                    axes.set_ylabel("observed − computed" + ("" if unit == "1" else f" ({unit})"))
        abreast = min(4, len(lines))
        figure.legend(lines.values(), lines, loc="outside lower center", ncols=abreast, fontsize=8)
        for same in {state.file.unit for state, _ in rows}:  # one range for each unit
            alike = [
                a
                for row, (state, _) in zip(grid, rows, strict=True)
                for a in row
                if a.axison and state.file.unit == same
            ]
            ends = [a.get_ylim() for a in alike]
            for axes in alike:
                axes.set_ylim(min(low for low, _ in ends), max(high for _, high in ends))
    return figure
