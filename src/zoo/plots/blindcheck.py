"""The score of a blind check."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from zoo.plots.style import COLOURS, INK, new_figure

if TYPE_CHECKING:
    from zoo.core.blindcheck import Score

RIGHT, WRONG = COLOURS[0], COLOURS[1]


def score_figures(score: Score) -> dict[str, Figure]:
    """All figures of a blind check's score by name: reliability, confusion."""
    return {"reliability": plot_reliability(score), "confusion": plot_confusion(score)}


def plot_reliability(score: Score) -> Figure:
    """How often stated probabilities came true, with 95 % binomial bands around what they state.

    Parameters
    ----------
    score : zoo.core.blindcheck.Score

    Returns
    -------
    matplotlib.figure.Figure
        Of components, and of listed effects where one is true. Hollow bins have fewer than eight events.
    """
    from zoo.core.blindcheck.scoring import FULL_BIN, QUESTIONS

    asked = [q for q in ("components", "effects") if q in score.reliability] or list(score.reliability)[:1]
    panels = [(QUESTIONS[q], score.reliability[q]) for q in asked]
    with new_figure((4.3 * max(1, len(panels)), 4.2)) as figure:
        for axes, (title, bins) in zip(
            figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
        ):
            axes.plot((0, 1), (0, 1), color="#888888", lw=0.9, ls=(0, (4, 2)))
            for b in bins:
                low, high = (x / b.n for x in b.band)
                axes.plot((b.stated, b.stated), (low, high), color="#C8CED6", lw=7, solid_capstyle="butt")
                colour, share = RIGHT if b.inside else WRONG, b.right / b.n
                face = colour if b.n >= FULL_BIN else "white"
                axes.plot(b.stated, share, "o", color=colour, mfc=face, ms=6, zorder=3)
                axes.annotate(
                    str(b.n), (b.stated, share), (6, -9), textcoords="offset points", fontsize="x-small"
                )
            axes.set(xlim=(-0.03, 1.05), ylim=(-0.03, 1.05), aspect="equal", xlabel="stated probability")
            axes.set_title(title)
        figure.axes[0].set_ylabel("share that is true (number: events)")
    return figure


def plot_confusion(score: Score) -> Figure:
    """What is most probable, by what is true.

    Parameters
    ----------
    score : zoo.core.blindcheck.Score

    Returns
    -------
    matplotlib.figure.Figure
        Rows are true, columns the most probable component or none; framed cells are the right ones.
    """
    count = Counter((c["label"], c["leader"] if c["answered"] else "failed") for c in score.cases)
    right = {(c["label"], name) for c in score.cases for name in c["right"]}
    true, said = (sorted({pair[i] for pair in count}) for i in (0, 1))
    table = np.array([[count[t, s] for s in said] for t in true])
    with new_figure((3.4 + 0.3 * len(said), 2.6 + 0.26 * len(true))) as figure:
        axes = figure.subplots()
        axes.imshow(table, cmap="Blues", vmin=0, vmax=int(table.max()) * 1.4, aspect="auto")
        for (i, j), n in np.ndenumerate(table):
            if n:
                colour = "white" if n > 0.7 * table.max() else INK
                axes.text(j, i, str(n), ha="center", va="center", fontsize="small", color=colour)
            if (true[i], said[j]) in right:
                box = mpl.patches.Rectangle((j - 0.5, i - 0.5), 1, 1, fill=False, ec=INK, lw=1.2)
                axes.add_patch(box)
        axes.set_xticks(range(len(said)), said, rotation=90, fontsize="small")
        axes.set_yticks(range(len(true)), true, fontsize="small")
        axes.set_xlabel("most probable")
        axes.set_ylabel("true")
    return figure
