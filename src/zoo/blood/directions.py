"""Directions in which a solve is differentiated, and what its derivatives are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from zoo.core.arrays import Array


@dataclass(frozen=True, eq=False)
class Point:
    """Arguments near those of a solve, and their weight in a direction.

    Parameters
    ----------
    weight : float
        w_i in the change sum_i w_i x_i of all arguments x; those of a direction sum to zero: 1/(2 h) and
        -1/(2 h) for arguments a step h to either side.
    stiffness, gamma, psi1, psi2, c : float or array (n_vessels,)
        As `Solver.solve` takes them.
    solver : Solver
        With other geometry, blood, inflow, loads or additions; None for the solver that is differentiated.
    """

    weight: float
    stiffness: ArrayLike
    gamma: ArrayLike = 2.0
    psi1: ArrayLike = 1.0
    psi2: ArrayLike = 1.0
    c: ArrayLike = 1.0
    solver: Any = None


Direction = Sequence[Point]


@dataclass(frozen=True)
class Derivatives:
    """A solve and its derivatives in several directions.

    `solution` is the solve's `Solution`. `pressure_mmHg`, `flow_ml_s` and `area_cm2` have shape
    (n_directions, n_series, n_times) and are NaN where the solve, or its derivatives, failed. `beats` counts
    linearised beats, the first of which was the solve's last if `along`, `vectors` the starts that went
    through one beside the directions themselves, `stepped` the points whose steps were computed one by one
    (geometry, blood, additions). `residual` is the estimated error that is left, over a direction's largest
    derivative of the pressure.
    """

    solution: Any
    pressure_mmHg: Array
    flow_ml_s: Array
    area_cm2: Array
    status: int
    reason: str
    beats: int
    along: bool
    vectors: int
    stepped: int
    residual: float

    @property
    def ok(self) -> bool:
        """Whether solve and derivatives are there."""
        return self.solution.ok and self.status == 0
