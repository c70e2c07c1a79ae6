"""Components of a simulator that may be wrong, and the free functions by which each may be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.arrays import Array
from zoo.core.effects import EVERYWHERE, AddedEffect, Effect, EffectParameter, Location
from zoo.core.forward import ForwardModel

ROUNDING = 1e-10
"""Part of the largest eigenvalue of a correlation below which a direction is taken as absent."""
REACH = 8.0
"""Bounds of standard normal weights, so that a search stays where a simulator can be solved."""


POINTS = 9
"""Points at which a function of a simulator's own quantity is free."""
MARGIN = 0.05
"""Part of the range of that quantity that is added at both ends."""
LENGTHS = (1 / 6, 1 / 3, 2 / 3)
"""Correlation lengths of such a function, in parts of the range."""


class ComponentError(ValueError):
    """A free function whose pieces do not fit; the text says which."""


@dataclass(frozen=True, eq=False)
class FreeFunction:
    """A function that a component of a simulator may lack, by its values at points of its argument.

    The values v are normal beforehand, v ~ N(0, s^2 R(l)): s half-normal of scale `size`, R the correlation
    of length l, one of `lengths` with equal weights, or the identity where there are none.

    Parameters
    ----------
    name : str
        Unique among the functions of a study, such as "tube-law".
    component : str
        What it belongs to, such as "wall".
    at : array (n,)
        Points of the argument at which its values are free; between them `apply` interpolates.
    argument, argument_unit, unit : str
        Names on axes, and units.
    size : float
        Scale of its sd, in `unit`.
    why : str
        Where that size comes from.
    apply : function
        ``apply(configuration, values (n,)) -> configuration``, a changed copy.
    lengths : tuple of float
        Correlation lengths to be tried, in the argument's unit.
    period : float, optional
        Of a periodic argument.
    labels : tuple of str
        Names of the points where they are places and not numbers.
    equation : str
    location : Location
        Where it acts.
    """

    name: str
    component: str
    at: Array
    size: float
    apply: Callable[[Any, Array], Any] = field(repr=False)
    argument: str = ""
    argument_unit: str = "1"
    unit: str = "1"
    why: str = ""
    lengths: tuple[float, ...] = ()
    period: float | None = None
    labels: tuple[str, ...] = ()
    equation: str = ""
    location: Location = EVERYWHERE

    def __post_init__(self) -> None:
        at = np.asarray(self.at, dtype=np.float64)
        object.__setattr__(self, "at", at)
        if at.ndim != 1 or not len(at) or not np.all(np.isfinite(at)):
            raise ComponentError(f"function {self.name}: at: give finite points of the argument, (n,)")
        if not self.size > 0.0 or not np.isfinite(self.size):
            raise ComponentError(f"function {self.name}: size = {self.size}: must be positive and finite")
        if any(not length > 0.0 for length in self.lengths):
            raise ComponentError(f"function {self.name}: lengths = {self.lengths}: must be positive")
        if self.labels and len(self.labels) != len(at):
            raise ComponentError(
                f"function {self.name}: {len(self.labels)} labels for {len(at)} points: give one for each"
            )

    def correlation(self, length: float | None) -> Array:
        """R (n, n): squared-exponential of the argument's distance, around the period where there is one."""
        if length is None:
            return np.eye(len(self.at))
        apart = self.at[:, None] - self.at[None, :]
        if self.period is not None:
            apart = self.period / np.pi * np.sin(np.pi * apart / self.period)
        return np.asarray(np.exp(-0.5 * (apart / length) ** 2))

    def root(self, length: float | None) -> Array:
        """L (n, m), L L' = R, of the directions that R has: v = s L z for standard normal z (m,)."""
        values, vectors = np.linalg.eigh(self.correlation(length))
        kept = values > ROUNDING * values[-1]
        return np.asarray((vectors[:, kept] * np.sqrt(values[kept]))[:, ::-1])

    def effect(self, sd: float, length: float | None) -> AddedEffect:
        """The function of that sd and length as an effect, whose parameters are the standard normal z."""
        root = sd * self.root(length)

        def change(configuration: Any, values: tuple[float, ...], location: Location) -> Any:
            z = np.asarray(values)
            return self.apply(configuration, root @ z) if np.any(z) else configuration

        weights = tuple(
            EffectParameter(f"z{i}", "1", 1.0, -REACH, REACH, (0.5,)) for i in range(root.shape[1])
        )
        return Effect(f"{self.component}:{self.name}", weights, change, equation=self.equation).at(
            self.location
        )


@dataclass(frozen=True)
class FunctionOf:
    """A free function of a quantity inside a simulator whose range is not known yet, by `free_function`."""

    name: str
    along: str
    size: float
    unit: str
    along_unit: str
    component: str
    why: str

    def on(self, model: ForwardModel, theta: Array) -> FreeFunction:
        """The function with its points over the values for which the simulator asks at `theta` (n_values,).

        Raises
        ------
        ComponentError
            If the simulator never asks for it, or for one value only.
        """
        asked: list[Array] = []

        def listen(x: ArrayLike) -> Array:
            asked.append(np.ravel(np.asarray(x, dtype=np.float64)))
            return np.zeros(np.shape(x))

        model.solve({**model.configure(theta), self.name: listen})
        values = np.concatenate(asked) if asked else np.zeros(1)
        low, high = float(np.min(values)), float(np.max(values))
        if not low < high < np.inf:
            raise ComponentError(
                f"free function {self.name}: the simulator asks for it at no more than one value; let it add "
                f"parameters[{self.name!r}](x), where x is the {self.along}"
            )
        edge = MARGIN * (high - low)
        at = np.linspace(low - edge, high + edge, POINTS)
        return FreeFunction(
            self.name, self.component, at, self.size, partial(_interpolate, self.name, at),
            argument=self.along, argument_unit=self.along_unit, unit=self.unit, why=self.why,
            lengths=tuple(part * (high - low) for part in LENGTHS),
        )  # fmt: skip


def _interpolate(name: str, at: Array, configuration: Any, values: Array) -> Any:
    """The configuration with a function, which beyond its last points keeps its values there."""
    return {**configuration, name: partial(np.interp, xp=at, fp=values)}


def free_function(
    name: str,
    *,
    along: str,
    size: float,
    unit: str = "1",
    along_unit: str = "1",
    component: str = "",
    why: str = "",
) -> FunctionOf:
    """Make a function that a simulator may lack and that no listed effect describes.

    It is learned from the data: f(x) ~ N(0, s^2) with s half-normal of scale `size`, smooth over a sixth, a
    third or two thirds of the values that x takes in the baseline. The simulator says where it acts: it adds
    ``parameters[name](x)``, which is 0 in the baseline.

    Parameters
    ----------
    name : str
        Under which the simulator finds the function among its parameters.
    along : str
        What x is, for axes and tables, such as "velocity".
    size : float
        Scale of the function's standard deviation, in `unit`.
    unit, along_unit : str
        Of the function and of x.
    component : str
        Part of the simulator that it belongs to, as an effect's family; its own name if absent.
    why : str
        Reason for the size.

    Returns
    -------
    FunctionOf
        To be given to `zoo.diagnose` among the effects.

    Examples
    --------
    >>> friction = free_function("friction", along="velocity", size=15.0, unit="N", along_unit="m/s")
    """
    return FunctionOf(name, along, size, unit, along_unit, component or name, why)
