"""What the measured radii and lengths may lack."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np

from zoo.blood.case import Case, with_network, with_true_lengths
from zoo.blood.components.curves import curve, factors
from zoo.blood.components.declared import free_function
from zoo.blood.components.setting import Setting
from zoo.blood.solver import PUBLISHED_CELLS_PER_CM
from zoo.core.arrays import Array
from zoo.core.components import FreeFunction

SHORTEST_CELL = 0.85
"""Cells may shrink to this part of the tree's shortest before a vessel has fewer of them."""


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
    vessels = setting.vessels
    index = np.arange(float(len(vessels)))
    found = [
        free_function("radius-scatter", index, scaled_radii, labels=vessels),
        free_function("length-scatter", index, scaled_lengths, labels=vessels),
    ]
    knots = setting.radius_knots()
    if knots is not None:
        apply = functools.partial(scaled_radii_by_size, basis=curve(knots, setting.log_radius))
        found.append(free_function("radius-by-size", knots, apply))
    return tuple(found)
