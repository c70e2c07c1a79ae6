"""A cause of a known component that no catalogue lists: a law with a size and a drawn shape."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case
from zoo.core.effects import Effect, EffectParameter, Location

Array = NDArray[np.float64]
Change = Callable[..., Case]
"""``change(case, size, **shape) -> case``, a changed copy."""
FAMILIES = {"outlets": "outflow"}
"""Components whose effects have another name for their family."""
PATTERNS = 10_000
"""Draws of which vessels a cause acts on: the shape "pattern" is a whole number below this."""


@dataclass(frozen=True)
class Cause:
    """A law of physics or of a sensor that the baseline lacks and no catalogue has.

    Parameters
    ----------
    name, component : str
    unit : str
        Of its size, which is 0 in the baseline.
    low, high : float
        The size is drawn log-uniformly between them.
    equation, source : str
    change : function
        ``change(case, size, **shape) -> case``.
    shapes : mapping
        Name -> limits between which that number of its shape is uniform.
    statement : str
    """

    name: str
    component: str
    unit: str
    low: float
    high: float
    equation: str
    source: str
    change: Change
    shapes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    statement: str = ""

    def draw(self, rng: np.random.Generator) -> tuple[Effect, float, dict[str, float]]:
        """The cause with a drawn shape as an effect whose only parameter is the size; a size; the shape."""
        shape = {name: float(f"{rng.uniform(*limits):.6g}") for name, limits in self.shapes.items()}
        size = float(f"{math.exp(rng.uniform(math.log(self.low), math.log(self.high))):.6g}")
        return self.effect(shape), size, shape

    def effect(self, shape: Mapping[str, float]) -> Effect:
        """The cause of this shape as an effect; its prior is wide, so that a refit finds the size."""

        def apply(case: Case, values: tuple[float, ...], location: Location) -> Case:
            return self.change(case, values[0], **shape) if values[0] else case

        size = EffectParameter("size", self.unit, self.high, -2 * self.high, 2 * self.high, (self.low,))
        return Effect(
            self.name,
            (size,),
            apply,
            family=FAMILIES.get(self.component, self.component),
            statement=self.statement,
            equation=self.equation,
            source=self.source,
        )


def cause(
    name: str,
    component: str,
    unit: str,
    sizes: tuple[float, float],
    *,
    equation: str,
    source: str = "definition",
    **shapes: tuple[float, float],
) -> Callable[[Change], Cause]:
    """Make a cause of the function that changes the case; its statement is the docstring's first line."""

    def made(change: Change) -> Cause:
        text = (change.__doc__ or "").strip().splitlines()
        return Cause(name, component, unit, *sizes, equation, source, change, shapes, text[0] if text else "")

    return made


def phases(n: int) -> Array:
    """Uniform samples of a beat from 0, in beats, (n,)."""
    return np.asarray(np.arange(n) / n)


def bump(phase: Array, centre: float, width: float) -> Array:
    """A periodic bump of height 1: exp((cos(2 pi (phase - centre)) - 1)/(2 pi width)^2), width its sd."""
    return np.asarray(np.exp((np.cos(2 * np.pi * (phase - centre)) - 1) / (2 * np.pi * width) ** 2))


def ramp(x: Array) -> Array:
    """log(1 + exp(x)), a smooth max(x, 0)."""
    return np.asarray(np.logaddexp(0.0, x))


def picked(among: NDArray[Any], many: int, pattern: float) -> NDArray[Any]:
    """Some members, by the number of a pattern: the same number picks the same ones."""
    order = np.random.default_rng(int(pattern)).permutation(len(among))
    return np.asarray(among[np.sort(order[: max(1, min(many, len(among)))])])
