"""What figures with a panel for each vessel share."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike

from zoo.core.draws import evenly
from zoo.plots.style import QUANTITY_LABELS, FigureError, model_style, new_figure

if TYPE_CHECKING:
    import xarray as xr

    from zoo.blood.study import Study

SEVEN_VESSELS = (1, 2, 3, 4, 8, 12, 21)
"""The paper's text names six of the seven vessels in its figures 8 and 9; 21 is ours."""
FOUR_VESSELS = (1, 3, 8, 21)
PAPER_VESSELS = 21


def shown_vessels(
    data: xr.Dataset, wanted: Sequence[int] | None, usual: Sequence[int], study: Study | None = None
) -> list[int]:
    """Vessels to show: those asked for; the usual ones in the paper's tree; of others the first, those that
    were observed, and more that lie evenly between the first and the last."""
    there = [int(v) for v in data["vessel"].to_numpy()]
    if wanted is not None:
        chosen = list(wanted)
    elif there == list(range(1, PAPER_VESSELS + 1)):
        chosen = list(usual)
    else:
        observed = [s.vessel for s in study.series if s.vessel in there] if study is not None else []
        even = evenly(len(there), len(usual))
        wanted_first = dict.fromkeys([there[0], *observed, *(there[i] for i in even)])
        some = list(wanted_first)[: max(len(usual), 1 + len(set(observed)))]
        chosen = [vessel for vessel in there if vessel in some]
    for vessel in chosen:
        if vessel not in there:
            raise FigureError(
                f"vessel {vessel}: the waves have {', '.join(map(str, there))}; choose of these"
            )
    return chosen


def vessel_title(data: xr.Dataset, vessel: int) -> str:
    name = str(data["name"].sel(vessel=vessel).item()) if "name" in data.coords else ""
    return f"vessel {vessel}" if name in ("", f"v{vessel}") else textwrap.fill(name.replace("_", " "), 24)


def observed_at(study: Study | None, quantity: str, data: xr.Dataset, vessel: int) -> list[ArrayLike]:
    """Observed series of a quantity where the vessel is looked at."""
    if study is None:
        return []
    position = float(data["position"].sel(vessel=vessel)) if "position" in data.coords else 0.0
    found = [s for s in study.series if (s.vessel, s.quantity) == (vessel, quantity)]
    return [s.value for s in found if s.position == position]


def draw_observed(
    axes: Axes, study: Study | None, quantity: str, data: xr.Dataset, vessel: int, factor: float = 1.0
) -> bool:
    """Draw what was observed where the vessel is looked at, times a factor; whether anything was."""
    observed = observed_at(study, quantity, data, vessel)
    for values in observed:
        time_ms = 1e3 * np.asarray(study.time_s) if study is not None else np.empty(0)
        axes.plot(time_ms, factor * np.asarray(values), color="black", lw=1.1, zorder=3)
    return bool(observed)


def area_factor(quantity: str) -> float:
    return 1e3 if quantity == "area_cm2" else 1.0


def quantity_label(quantity: str) -> str:
    return "area (10$^{-3}$ cm$^2$)" if quantity == "area_cm2" else QUANTITY_LABELS[quantity]


@contextmanager
def panels_of(
    n: int, *, sharey: bool = False, sharex: bool = True, spare: int = 0
) -> Iterator[tuple[Figure, list[Axes], list[Axes]]]:
    """Figure with `n` panels and `spare` empty ones at least, and the empty ones without frames."""
    columns = min(n + spare, 4 if n + spare <= 8 else 6)
    rows = math.ceil((n + spare) / columns)
    with new_figure((1.0 + 2.05 * columns, 0.9 + 1.75 * rows)) as figure:
        grid = figure.subplots(rows, columns, squeeze=False, sharex=sharex, sharey=sharey)
        every: list[Axes] = list(grid.flat)
        for axes in every[n:]:
            axes.set_axis_off()
        if sharex:
            for axes in every[max(0, n - columns) : n]:
                axes.tick_params(labelbottom=True)
        yield figure, every[:n], every[n:]


def width_of(order: int, n: int) -> float:
    """Line width, less for later models, so that those on top of each other can be seen."""
    return 2.3 - 1.3 * order / max(1, n - 1) if n > 1 else 1.3


def model_handles(names: Iterable[str]) -> list[Any]:
    handles = []
    for k, name in enumerate(names):
        colour, line = model_style(name, k)
        handles.append(Line2D([], [], color=colour, ls=line, lw=1.6, label=f"model {name}"))
    return handles
