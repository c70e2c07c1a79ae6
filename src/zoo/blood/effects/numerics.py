"""Effects on the numerical solution."""

from __future__ import annotations

from dataclasses import replace

from zoo.blood.case import Case
from zoo.blood.effects.catalogue import effect
from zoo.core.effects import EffectParameter, Location


@effect(
    "coarse-grid",
    "numerics",
    equation="y -> y + a (y(2 dx) - y); a = 1/3 adds the error of these cells once more, -1/3 takes it off",
    source="Richardson 1911, doi 10.1098/rsta.1911.0009 (a scheme of second order)",
    signature="dispersion behind steep fronts",
    parameters=[EffectParameter("blend", "1", 1.0, -2.0, 4.0, (-0.333, 1.0))],
    why="the error of these cells, of which a diagnosis takes one off beforehand, and of cells twice as long",
)
def coarse_grid(case: Case, values: tuple[float, ...], location: Location) -> Case:
    """The grid is too coarse."""
    return replace(case, coarse_blend=case.coarse_blend + values[0])
