"""The score of a blind check."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from zoo.core.diagnosis.hypothesis import NONPARAMETRIC
from zoo.plots.style import COLOURS, INK, new_figure

if TYPE_CHECKING:
    from zoo.core.blindcheck import CheckScore

RIGHT, WRONG = COLOURS[0], COLOURS[1]


def score_figures(score: CheckScore) -> dict[str, Figure]:
    """All figures of a blind check's score by name: reliability, accuracy, confusion, sizes."""
    return {
        "reliability": plot_reliability(score),
        "accuracy": plot_accuracy(score),
        "confusion": plot_confusion(score),
        "sizes": plot_sizes(score),
    }


def plot_reliability(score: CheckScore) -> Figure:
    """How often stated probabilities came true, with 95 % binomial bands around what they state.

    Parameters
    ----------
    score : zoo.core.blindcheck.CheckScore

    Returns
    -------
    matplotlib.figure.Figure
        Left the leading group of each case, right every group with at least 1 %. Hollow bins have fewer
        than eight cases.
    """
    from zoo.core.blindcheck.rates import FULL_BIN

    panels = (
        ("leading explanation with its group", score.reliability),
        ("all groups", score.reliability_all),
    )
    with new_figure((8.6, 4.2)) as figure:
        for axes, (title, bins) in zip(figure.subplots(1, 2, sharey=True), panels, strict=True):
            axes.plot((0, 1), (0, 1), color="#888888", lw=0.9, ls=(0, (4, 2)))
            for b in bins:
                low, high = (x / b.n for x in b.band)
                axes.plot((b.stated, b.stated), (low, high), color="#C8CED6", lw=7, solid_capstyle="butt")
                colour = RIGHT if b.inside else WRONG
                face = colour if b.n >= FULL_BIN else "white"
                axes.plot(b.stated, b.right / b.n, "o", color=colour, mfc=face, ms=6, zorder=3)
                axes.annotate(
                    str(b.n),
                    (b.stated, b.right / b.n),
                    (6, -9),
                    textcoords="offset points",
                    fontsize="x-small",
                )
            axes.set(xlim=(-0.03, 1.05), ylim=(-0.03, 1.05), aspect="equal", xlabel="stated probability")
            axes.set_title(title)
        figure.axes[0].set_ylabel("share that is true (number: cases)")
    return figure


def plot_accuracy(score: CheckScore) -> Figure:
    """From which discrepancy on an answer can be trusted: share right against its size, and the rates.

    Parameters
    ----------
    score : zoo.core.blindcheck.CheckScore

    Returns
    -------
    matplotlib.figure.Figure
        Left the share of listed effects that (or whose group) were ranked first with Wilson's 95 % interval,
        a tick for each case, those above right. Right the rates of the summary with theirs; crosses are the
        best constant answers.
    """
    from zoo.core.blindcheck.tables import HEADLINES

    with new_figure((11.0, 5.6)) as figure:
        left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
        listed = [c for c in score.cases if c.kind == "listed"]
        for hit, y, marker in ((True, 1.06, "|"), (False, -0.06, "|")):
            x = [c.gap_over_noise for c in listed if c.group_first == hit]
            left.plot(x, np.full(len(x), y), marker, color=RIGHT if hit else WRONG, ms=8)
        curve = [row for row in score.curve if row["n"]]
        x = [row["median"] for row in curve]
        share, low, high = (np.array([row[name] for row in curve]) for name in ("share", "low", "high"))
        if curve:
            error = np.clip(np.stack([share - low, high - share]), 0, None)
            left.errorbar(x, share, error, fmt="o-", color=COLOURS[0], ms=5, lw=1.3, capsize=3)
            left.set_xscale("log")
            left.xaxis.set_major_locator(mpl.ticker.LogLocator(subs=(1, 2, 3, 5)))
            left.xaxis.set_major_formatter(mpl.ticker.StrMethodFormatter("{x:g}"))
            left.xaxis.set_minor_formatter(mpl.ticker.NullFormatter())
        left.set_ylim(-0.12, 1.12)
        left.set_yticks(np.linspace(0.0, 1.0, 6))
        left.set_xlabel("discrepancy / sd of the noise")
        left.set_ylabel("true effect or its group first")
        left.set_title("accuracy by size of the discrepancy")
        rates = [(name, words, score.summary[name]) for name, words in HEADLINES if score.summary[name]["n"]]
        for row, (name, _, rate) in enumerate(rates):
            if name in score.constants:
                right.plot(100 * score.constants[name]["share"], row, "x", color="#888888", ms=6)
            right.plot((100 * rate["low"], 100 * rate["high"]), (row, row), color=COLOURS[0], lw=1.3)
            right.plot(100 * rate["share"], row, "o", color=COLOURS[0], ms=6)
        right.set_yticks(
            range(len(rates)), [textwrap.fill(words, 46) for _, words, _ in rates], fontsize="x-small"
        )
        right.set_ylim(len(rates) - 0.4, -0.6)
        right.set_xlim(-3, 103)
        right.set_xlabel("% of cases (lines: 95 %, crosses: best constant answer)")
        right.grid(axis="x", color="#DDDDDD", lw=0.7)
        right.set_axisbelow(True)
    return figure


def plot_confusion(score: CheckScore) -> Figure:
    """What was ranked first, by what is true.

    Parameters
    ----------
    score : zoo.core.blindcheck.CheckScore

    Returns
    -------
    matplotlib.figure.Figure
        Rows are true, columns ranked first; framed cells are the right ones.
    """
    true = sorted(score.confusion)
    said = sorted({name for row in score.confusion.values() for name in row})
    count = np.array([[score.confusion[t].get(s, 0) for s in said] for t in true])
    count = count.reshape(len(true), len(said))
    with new_figure((3.4 + 0.3 * len(said), 2.6 + 0.26 * len(true))) as figure:
        axes = figure.subplots()
        axes.imshow(count, cmap="Blues", vmin=0, vmax=max(1, int(count.max(initial=1))) * 1.4, aspect="auto")
        for i, t in enumerate(true):
            outside = any(c.truth == t and c.kind == "outside" for c in score.cases)
            for j, s in enumerate(said):
                if count[i, j]:
                    dark = count[i, j] > 0.7 * count.max()
                    axes.text(
                        j, i, str(count[i, j]), ha="center", va="center", fontsize="small",
                        color="white" if dark else INK,
                    )  # fmt: skip
                if s == t or (outside and s == NONPARAMETRIC):
                    box = mpl.patches.Rectangle((j - 0.5, i - 0.5), 1, 1, fill=False, ec=INK, lw=1.2)
                    axes.add_patch(box)
        axes.set_xticks(range(len(said)), said, rotation=90, fontsize="small")
        axes.set_yticks(range(len(true)), true, fontsize="small")
        axes.set_xlabel("ranked first")
        axes.set_ylabel("true")
    return figure


def plot_sizes(score: CheckScore) -> Figure:
    """Stated against true: the discrepancy that the leading effect leaves, and the effects' parameters.

    Parameters
    ----------
    score : zoo.core.blindcheck.CheckScore

    Returns
    -------
    matplotlib.figure.Figure
        Bars are 95 % intervals; discrepancies are in sds of the noise, effect parameters over the true ones.
    """
    rows = [c for c in score.cases if c.amplitude is not None and c.amplitude_true]
    names = sorted({c.truth for c in rows})
    with new_figure((10.5, max(4.4, 1.2 + 0.3 * len(names)))) as figure:
        left, right = figure.subplots(1, 2)
        for c in score.cases:
            if c.left is None or c.left_low is None or c.left_high is None or c.left_true is None:
                continue
            colour = RIGHT if c.left_covered else WRONG
            x, y, low, high = (v / c.noise for v in (c.left_true, c.left, c.left_low, c.left_high))
            left.plot((x, x), (low, high), color=colour, lw=1)
            left.plot(x, y, "o", color=colour, ms=4)
        top = max(*left.get_xlim(), *left.get_ylim())
        left.plot((0, top), (0, top), color="#888888", lw=0.9, ls=(0, (4, 2)))
        left.set_xlim(0, top)
        left.set_ylim(0, top)
        left.set_xlabel("true discrepancy / sd of the noise")
        left.set_ylabel("stated discrepancy / sd of the noise")
        left.set_title("what the leading effect leaves")
        for c in rows:
            assert c.amplitude is not None
            assert c.amplitude_true is not None
            ratio, sd = c.amplitude / c.amplitude_true, (c.amplitude_sd or 0.0) / abs(c.amplitude_true)
            colour = RIGHT if c.amplitude_covered else WRONG
            alike = [other.case for other in rows if other.truth == c.truth]
            k = names.index(c.truth) + 0.7 * ((alike.index(c.case) + 0.5) / len(alike) - 0.5)
            right.errorbar(ratio, k, xerr=1.96 * sd, fmt="o", color=colour, ms=4, lw=1, capsize=2)
        right.axvline(1, color="#888888", lw=0.9)
        right.set_xlim(-0.6, 2.6)
        right.set_yticks(range(len(names)), names, fontsize="small")
        right.set_ylim(len(names) - 0.4, -0.6)
        right.set_xlabel("stated effect parameter / true one")
        right.set_title("parameter of the true effect, at the true location")
    return figure
