"""Colours, lines, words and units that all figures share, and how a figure is written."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure, SubFigure
from numpy.typing import ArrayLike

from zoo.core.arrays import Array
from zoo.core.outputs import output_file, write_file

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8A7A00")
"""Okabe and Ito's palette without black, its yellow darkened; told apart with any colour vision."""
INK = "#222222"
STYLE: Any = {
    "axes.edgecolor": "#666666",
    "axes.labelcolor": INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": "medium",
    "axes.titleweight": "bold",
    "figure.dpi": 110,
    "font.size": 9.5,
    "legend.frameon": False,
    "savefig.bbox": "tight",
    "savefig.dpi": 160,
    "text.color": INK,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
}
QUANTITY_LABELS = {
    "pressure_mmHg": "pressure (mmHg)",
    "flow_ml_s": "flow (ml/s)",
    "area_cm2": "area (cm$^2$)",
}
RESIDUAL_LABELS = {name: f"residual{label[label.index(' (') :]}" for name, label in QUANTITY_LABELS.items()}
PARAMETER_LABELS = {
    "f1": "$f_1$ (g cm$^{-1}$ s$^{-2}$)",
    "f2": "$f_2$ (1/radius unit)",
    "f3": "$f_3$ (g cm$^{-1}$ s$^{-2}$)",
    "chi": r"$\chi$ (g cm$^{-1}$ s$^{-2}$)",
    "m_chi": r"$m_\chi$ (g cm$^{-1}$ s$^{-2}$)",
    "v_chi": r"$v_\chi$ (10$^8$ g$^2$ cm$^{-2}$ s$^{-4}$)",
    "gamma": r"$\gamma$",
    "psi1": r"$\psi_1$",
    "psi2": r"$\psi_2$",
    "c": "$c$",
    "sigma2": r"$\sigma^2$ (mmHg$^2$)",
    "w": "$w$ (s$^{-2}$)",
    "b": "$b$",
}
for _quantity, _label in QUANTITY_LABELS.items():  # errors of one quantity
    for _name, _text in (("noise", "noise of {}"), ("amplitude", "amplitude of {}")):
        PARAMETER_LABELS[f"{_name}_{_quantity}"] = _text.format(_label)
    _word = _label.partition(" (")[0]
    PARAMETER_LABELS[f"w_{_quantity}"] = f"$w$ of {_word} (cycle$^{{-2}}$)"
    PARAMETER_LABELS[f"b_{_quantity}"] = f"$b$ of {_word}"
SCALES = {"f1": 5, "f3": 4, "chi": 4, "m_chi": 4, "w": 4}
"""Powers of ten that axes of these parameters are in."""
SOLID, DASHED, DOTTED = "-", (0, (4, 1.6)), (0, (1, 1.2))
MODEL_STYLES: dict[str, tuple[str, Any]] = {
    "A": (COLOURS[4], DASHED),
    "B": (COLOURS[0], SOLID),
    "C": (COLOURS[5], DOTTED),
    "D": (COLOURS[6], DASHED),
    "E": (COLOURS[2], SOLID),
    "F": ("#7F7F7F", DASHED),
    "G": (COLOURS[3], SOLID),
    "H": (COLOURS[1], SOLID),
    "I": ("#5B3A8E", SOLID),
}
"""Each model's own colour, the same in every figure, and its line: dashes for independent errors."""
NARROW = 4.2
"""Width in inches of a figure for a narrow screen, one panel below the other."""
FAR = 50.0
"""A value that is so many times the one before it lies beyond the axis of those before it."""


class FigureError(ValueError):
    """A figure that cannot be written; its text says what to change."""


@contextmanager
def new_figure(size: tuple[float, float]) -> Iterator[Figure]:
    """An empty figure of a size in inches, and the style as long as it is drawn."""
    with mpl.rc_context(STYLE):
        yield Figure(figsize=size, layout="constrained")


def figure_path(path: str | Path) -> Path:
    """A path that a figure can be written to.

    Raises
    ------
    FigureError
        If the format is unknown.
    zoo.core.outputs.OutputFileError
        If the file cannot be written.
    """
    path = output_file(path)
    if path.suffix.lstrip(".").lower() not in FigureCanvasBase.get_supported_filetypes():
        raise FigureError(f"{path}: unknown figure format {path.suffix!r}; use .png, .pdf or .svg")
    return path


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure; the ending (.png, .pdf, .svg) chooses the format.

    Raises
    ------
    FigureError
        If the format is unknown.
    zoo.core.outputs.OutputFileError
        If the file cannot be written.
    """
    path = figure_path(path)
    drawn = BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(drawn, format=path.suffix.lstrip(".").lower())
    return write_file(path, drawn.getvalue())


def model_style(name: str, order: int = 0) -> tuple[str, Any]:
    """Colour and line of a model, by its letter, or by its order for a model outside the nine."""
    return MODEL_STYLES.get(name, (COLOURS[order % len(COLOURS)], (SOLID, DASHED, DOTTED)[order // 7 % 3]))


def axis_end(differences: Sequence[float], least: float) -> float | None:
    """Where a linear axis of differences to the best has to end so that the leading ones can be told apart.

    Parameters
    ----------
    differences : sequence of float
        At least 0.
    least : float
        Smaller ones need not be told apart.

    Returns
    -------
    float or None
        The last difference before the first that is `FAR` times as large; None if there is none, and the axis
        may hold all.

    Examples
    --------
    >>> axis_end([0.0, 3.0, 40.0, 4889.0], least=10.0)
    40.0
    >>> axis_end([0.0, 277.0, 609.0], least=10.0) is None
    True
    """
    before = least
    for value in sorted(differences):
        if value > FAR * before:
            return before
        before = max(before, value)
    return None


def parameter_label(name: str) -> str:
    """Label with unit, in the power of ten of `SCALES`."""
    label = PARAMETER_LABELS.get(name, name)
    if name not in SCALES:
        return label
    return label.replace(" (", f" (10$^{SCALES[name]}$ ", 1)


def parts(figure: Figure | SubFigure, rows: int, columns: int, **ratios: Any) -> list[SubFigure]:
    """Rows and columns of a figure, in one list."""
    found: Any = figure.subfigures(rows, columns, squeeze=False, **ratios)
    return list(found.flat)


def cells_of(
    figure: Figure | SubFigure, n: int, abreast: int, heights: Sequence[float] = (1.0,)
) -> list[list[Axes]]:
    """`n` cells, at most `abreast` beside each other, each of panels with these heights below each other."""
    columns = max(1, min(n, abreast))
    blocks = max(1, math.ceil(n / columns))
    ratios = tuple(heights) * blocks
    grid = figure.subplots(len(ratios), columns, squeeze=False, height_ratios=ratios)
    for axes in grid.flat[:]:
        axes.set_axis_off()
    cells = []
    for k in range(n):
        first = len(heights) * (k // columns)
        cells.append(list(grid[first : first + len(heights), k % columns]))
        for axes in cells[-1]:
            axes.set_axis_on()
    return cells


def size_of(
    n: int, abreast: int, width: float, height: float, least: float = 0.0, more: float = 0.0
) -> tuple[float, float]:
    """Size of a figure of `n` cells with a width and height each, a least width, and more height for all."""
    columns = max(1, min(n, abreast))
    return max(least, width * columns), more + height * max(1, math.ceil(n / columns))


def legend_below(figure: Figure | SubFigure, handles: Sequence[Any], columns: int) -> None:
    """A small legend below a figure."""
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize="small")


def measured(times: ArrayLike, values: ArrayLike) -> tuple[Array, Array]:
    """Times and values where these are no NaN, so that a line goes from sample to sample."""
    t, x = np.asarray(times, dtype=np.float64), np.asarray(values, dtype=np.float64)
    return t[~np.isnan(x)], x[~np.isnan(x)]


def handles_of(*panels: Axes) -> list[Any]:
    """Handles of what is labelled in panels."""
    return [handle for axes in panels for handle in axes.get_legend_handles_labels()[0]]


def grid_behind(axes: Axes, axis: str = "x") -> None:
    """Grey lines behind what is drawn."""
    axes.grid(axis=axis, color="#DDDDDD", lw=0.7)  # type: ignore[arg-type]
    axes.set_axisbelow(True)


def note_beside(axes: Axes, row: float, text: str, points: float) -> None:
    """Small grey words at the right of a row, so many points from the axes."""
    axes.annotate(
        text,
        (1.0, row),
        xycoords=("axes fraction", "data"),
        xytext=(points, 0),
        textcoords="offset points",
        va="center",
        fontsize="small",
        color="#666666",
    )


def draw_shares(axes: Axes, shares: Mapping[str, float], title: str, colour: str) -> None:
    """A bar for each share, from the top down, in percent."""
    rows = np.arange(len(shares))
    axes.barh(rows, [100 * share for share in shares.values()], color=colour, height=0.7)
    axes.set_yticks(rows, list(shares), fontsize="small")
    axes.set_ylim(max(len(shares), 1) - 0.4, -0.6)
    axes.set_xlim(0, 100)
    axes.set_title(title)
