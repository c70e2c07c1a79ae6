"""The tree of vessels, coloured by the probability that a listed effect acts in them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from zoo.plots.style import COLOURS, INK, draw_shares
from zoo.plots.subject import location_of

if TYPE_CHECKING:
    from zoo.blood.study import Study, Vessel
    from zoo.core.diagnosis import Diagnosis

LOCATION_COLOURS = ("#DDE2E8", "#E69F00", "#B23A00")
"""From improbable to certain; the first still shows on white."""
LABELLED_VESSELS = 45


def tree_layout(vessels: Sequence[Vessel]) -> dict[int, tuple[float, float, float, float]]:
    """Layered layout of a tree: vessel -> x and y of its inlet, x and y of its outlet; leaves one apart."""
    children: dict[int | None, list[int]] = {}
    for vessel in vessels:
        children.setdefault(vessel.parent, []).append(vessel.id)
    order: list[tuple[int, int]] = []  # vessel and depth, parents first
    stack = [(root, 0) for root in reversed(children.get(None, []))]
    while stack:
        vessel_id, depth = stack.pop()
        order.append((vessel_id, depth))
        stack += [(child, depth + 1) for child in reversed(children.get(vessel_id, []))]
    height: dict[int, float] = {}
    leaf = 0
    for vessel_id, _ in order:
        if vessel_id not in children:
            height[vessel_id] = -float(leaf)
            leaf += 1
    for vessel_id, _ in reversed(order):
        if vessel_id in children:
            height[vessel_id] = float(np.mean([height[child] for child in children[vessel_id]]))
    parent = {vessel.id: vessel.parent for vessel in vessels}
    return {
        v: (float(depth), height[v if parent[v] is None else parent[v]], depth + 1.0, height[v])  # type: ignore[index]
        for v, depth in order
    }


def _below(vessels: Sequence[Vessel], vessel: int) -> set[int]:
    """A vessel and all below it."""
    inside, more = {vessel}, True
    while more:
        new = {v.id for v in vessels if v.parent in inside} - inside
        inside |= new
        more = bool(new)
    return inside


def draw_tree(axes: Axes, d: Diagnosis, study: Study) -> None:
    """Vessels coloured by the probability that a listed effect acts in them, with the sensors."""
    vessels = study.vessels
    probability = {v.id: 0.0 for v in vessels}
    everywhere = 0.0
    for share in d.file.where.place:
        if share.part is None:
            everywhere += share.probability
        else:
            vessel_id = int(share.part)
            for v in _below(vessels, vessel_id) if share.subtree else {vessel_id}:
                probability[v] += share.probability
    colours = mpl.colors.LinearSegmentedColormap.from_list("locations", LOCATION_COLOURS)
    layout = tree_layout(vessels)
    sensors = dict.fromkeys((s.vessel, s.position) for s in study.series)
    marked = {vessel for vessel, position in sensors if abs(position - 0.5) < 0.25}
    thickest = max(v.radius_cm for v in vessels)
    for vessel in vessels:
        x0, y0, x1, y1 = layout[vessel.id]
        width = 1.5 + 6.0 * vessel.radius_cm / thickest
        colour = colours(probability[vessel.id])
        [line] = axes.plot((x0, x1), (y0, y1), color=colour, lw=width, solid_capstyle="round")
        line.set_gid(f"vessel-{vessel.id}")
        if len(vessels) <= LABELLED_VESSELS:
            along = 0.25 if vessel.id in marked else 0.5
            axes.annotate(
                str(vessel.id),
                (x0 + along * (x1 - x0), y0 + along * (y1 - y0)),
                ha="center",
                va="center",
                fontsize=7,
                bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
            )
    wanted = d.file.next_measurement
    marks: list[tuple[tuple[int, float], str, str, str]] = [(p, "o", "white", "observed") for p in sensors]
    if wanted is not None:
        at = wanted.model_extra or {}
        marks.append(((at["vessel"], at["position"]), "*", COLOURS[0], "measure next"))
    for (vessel_id, position), marker, fill, label in marks:
        x0, y0, x1, y1 = layout[vessel_id]
        x, y = x0 + position * (x1 - x0), y0 + position * (y1 - y0)
        size = 13 if marker == "*" else 7
        first = None if label in axes.get_legend_handles_labels()[1] else label
        axes.plot(x, y, marker=marker, ms=size, mfc=fill, mec=INK, ls="", label=first, zorder=4)
    axes.annotate(
        f"everywhere alike: {100 * everywhere:.0f} %",
        (0.02, 0.98),
        xycoords="axes fraction",
        va="top",
        color="white" if everywhere > 0.6 else INK,
        bbox={"boxstyle": "round,pad=0.5", "fc": colours(everywhere), "ec": "#888888"},
    )
    listed = [p for p in d.file.where.place if p.part is not None and p.probability >= 0.01][:3]
    axes.annotate(
        "\n".join(f"{location_of(p)}: {100 * p.probability:.0f} %" for p in listed),
        (0.01, 0.91),
        xycoords="axes fraction",
        va="top",
        fontsize="small",
    )
    axes.set_axis_off()
    axes.margins(0.06)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.16 * (high - low))
    axes.set_title("location")
    axes.legend(loc="lower left", fontsize="small")
    scale = mpl.cm.ScalarMappable(mpl.colors.Normalize(0, 1), colours)
    bar = axes.figure.colorbar(scale, ax=axes, shrink=0.6, aspect=30)
    bar.set_label("probability that an effect acts in the vessel", fontsize="small")
    bar.outline.set_visible(False)


def draw_locations(axes: Axes, d: Diagnosis) -> None:
    """Locations with the probability that a listed effect acts there, for data that are not of a tree."""
    shares = {location_of(p): p.probability for p in d.file.where.place}
    draw_shares(axes, shares, "location", LOCATION_COLOURS[1])
    axes.set_ylim(max(len(shares), 6) - 0.4, -0.6)
    axes.set_xlabel("probability that an effect acts there (%)")
