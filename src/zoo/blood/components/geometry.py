"""What the measured radii and lengths may lack."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case, with_network, with_true_lengths
from zoo.blood.components.curves import curve, factors
from zoo.blood.components.setting import RADIUS, RADIUS_LENGTHS, RADIUS_UNIT, Setting
from zoo.blood.solver import PUBLISHED_CELLS_PER_CM
from zoo.core.components import FreeFunction

Array = NDArray[np.float64]
RADIUS_SIZE = 0.1
LENGTH_SIZE = 0.2
SHORTEST_CELL = 0.85
"""Cells may shrink to this part of the tree's shortest before a vessel has fewer of them."""
IMAGE = (
    "Karau et al. 2001, doi 10.1152/ajpheart.2001.281.6.H2747, has the method, micro-CT of an excised lung; "
    "its segmentation is uncertain, Colebank et al. 2019, doi 10.1098/rsif.2019.0284"
)


def scaled_radii(case: Case, values: Array) -> Case:
    """r0 -> r0 exp(v) of each vessel, at both its ends."""
    network, scale = case.network, factors(values)
    return with_network(
        case, radius_in_cm=network.radius_in_cm * scale, radius_out_cm=network.radius_out_cm * scale
    )


def scaled_radii_by_size(case: Case, values: Array, basis: Array) -> Case:
    """r0 -> r0 exp(v), v a curve of the vessels' radii."""
    return scaled_radii(case, basis @ values)


def scaled_lengths(case: Case, values: Array) -> Case:
    """L -> L exp(v) of each vessel, with as many cells as before unless they would become too short."""
    if not np.any(values):
        return case
    truncated = case.conventions.truncate_lengths
    case = with_true_lengths(case)
    old, options = case.network.length_cm, case.options
    new = old * factors(values)
    case = with_network(case, length_cm=new)
    if case.physics.throat_severity is not None:
        return case
    if truncated:
        cells = np.maximum(2, np.rint(PUBLISHED_CELLS_PER_CM * old))
    else:
        cells = np.array(options.cells) if options.cells else np.maximum(2, np.rint(old / options.dx_cm))
    least = SHORTEST_CELL * np.min(old / cells)
    cells = np.where(new / cells < least, np.maximum(1, np.floor(new / least)), cells)
    return replace(case, options=replace(options, cells=tuple(int(n) for n in cells)))


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """Radii of each vessel and by size, and lengths of each vessel."""
    index = np.arange(float(len(setting.vessels)))
    knots = setting.radius_knots()
    found = [
        FreeFunction(
            "radius-scatter",
            "geometry",
            index,
            RADIUS_SIZE,
            scaled_radii,
            "vessel",
            "1",
            "log radius",
            why="10 %: half a voxel of 40 um (assumed; 30 to 50 um are usual for a mouse) is 4 to 15 % of "
            f"radii of 0.5 to 0.13 mm. {IMAGE}",
            labels=setting.vessels,
            equation="r0 -> r0 exp(v) in each vessel, independent",
        ),
        FreeFunction(
            "length-scatter",
            "geometry",
            index,
            LENGTH_SIZE,
            scaled_lengths,
            "vessel",
            "1",
            "log length",
            why="assumed: where a vessel ends in a branching is known to about a diameter, a fifth of its "
            f"length. {IMAGE}",
            labels=setting.vessels,
            equation="L -> L exp(v) in each vessel, independent",
        ),
    ]
    if knots is not None:
        found.append(
            FreeFunction(
                "radius-by-size",
                "geometry",
                knots,
                RADIUS_SIZE,
                functools.partial(scaled_radii_by_size, basis=curve(knots, setting.log_radius)),
                RADIUS,
                RADIUS_UNIT,
                "log radius",
                why="10 %: an image taken 5 mmHg from the pressure that is assumed shows radii 10 % off at a "
                "distensibility of 2 % for each mmHg (Krenz & Dawson 2003, "
                "doi 10.1152/ajpheart.00762.2002), and the edge of a narrow vessel is blurred over a larger "
                "part of it",
                lengths=RADIUS_LENGTHS,
                equation="r0 -> r0 exp(v(log r0))",
            )
        )
    return tuple(found)
