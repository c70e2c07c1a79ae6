"""What a solver is given beside network and physics: numerical settings, inlet, places; all checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from zoo.blood.solve_errors import SolverArgumentError
from zoo.core.arrays import Array, finite_array, real_number, refuse_where, shown, whole_number

TOLERANCE_SHARE = 7.5e-5
"""Accepted distance from the periodic state over the pulse: a quarter of the default accuracy, 0.03 %."""


@dataclass(frozen=True)
class SolverOptions:
    """Numerical settings of a solve.

    Parameters
    ----------
    dx_cm : float
        Target cell length; each vessel has the nearest whole number of cells, at least two.
        The convention ``truncate_lengths`` has its own grid, 40 cells per cm.
    cells : tuple of int
        Cells of each vessel, in the order of ``Network.ids``, instead of those of `dx_cm`; one is enough.
    refine : int
        Divides the cells and, with them, the time step.
    cfl : float
        Wanted largest (abs(u) + c) dt/dx, between 0 and 1.
    steps_per_beat : int
        Time steps in a beat before refinement; 0 chooses them from `cfl`, in multiples of 32.
    least_steps : int
        At least so many, before refinement, where they are chosen; so that their number does not change from
        one set of parameters to the next as long as these are enough.
    max_steps, max_beats : int
        Limits beyond which a solve fails.
    tolerance_mmHg : float
        Largest accepted distance from the periodic state, estimated from the last beat's change; if absent,
        a part `TOLERANCE_SHARE` of the pressure's range at the root's inlet.
    accelerate : bool
        Extrapolate from beat to beat.
    """

    dx_cm: float = 0.025
    cells: tuple[int, ...] = ()
    refine: int = 1
    cfl: float = 0.95
    steps_per_beat: int = 0
    least_steps: int = 0
    max_steps: int = 65536
    max_beats: int = 500
    tolerance_mmHg: float | None = None
    accelerate: bool = True

    def __post_init__(self) -> None:
        for name in ("dx_cm", "cfl", "tolerance_mmHg"):
            value = getattr(self, name)
            if name == "tolerance_mmHg" and value is None:
                continue
            real_number(name, value, "a positive and finite number", above=0.0, error=SolverArgumentError)
        least = {"refine": 1, "steps_per_beat": 0, "least_steps": 0, "max_steps": 32, "max_beats": 1}
        for name, low in least.items():
            object.__setattr__(
                self, name, whole_number(name, getattr(self, name), low, error=SolverArgumentError)
            )
        if not isinstance(self.accelerate, bool | np.bool_ | int):
            raise SolverArgumentError(f"accelerate = {shown(self.accelerate)}: must be true or false")
        try:
            given = tuple(self.cells)
        except TypeError:
            raise SolverArgumentError(
                f"cells = {shown(self.cells)}: must be a list, one number of cells for each vessel"
            ) from None
        cells = tuple(
            whole_number(f"cells[{i}]", n, 1, error=SolverArgumentError) for i, n in enumerate(given)
        )
        object.__setattr__(self, "cells", cells)
        if not self.cfl < 1:
            raise SolverArgumentError(f"cfl = {self.cfl}: must be below 1, the scheme's stability limit")
        if self.steps_per_beat and not 32 <= self.steps_per_beat * self.refine <= self.max_steps:
            raise SolverArgumentError(
                f"steps_per_beat = {self.steps_per_beat}: must be 0 (chosen from cfl) or, times refine, "
                f"between 32 and max_steps = {self.max_steps}"
            )
        if not 0 <= self.least_steps * self.refine <= self.max_steps:
            raise SolverArgumentError(
                f"least_steps = {self.least_steps}: must, times refine, be between 0 and max_steps = "
                f"{self.max_steps}"
            )


def checked_inflow(times: ArrayLike, flow: ArrayLike, period_s: float) -> tuple[Array, Array]:
    """Copies of the times (s) and values (ml/s) of the flow into the root, each (n,).

    Raises
    ------
    SolverArgumentError
        If they are not numbers of one length over one period at m period/n, to a hundredth of a step, or
        their mean is not positive.
    """
    t = finite_array("inflow_time_s", times, error=SolverArgumentError).copy()
    q = finite_array("inflow_ml_s", flow, error=SolverArgumentError).copy()
    n = len(q)
    if len(t) != n:
        raise SolverArgumentError(
            f"inflow_time_s has {len(t)} values and inflow_ml_s {n}: give one time for each value"
        )
    if n < 4:
        raise SolverArgumentError(f"inflow_ml_s has {n} values: needs at least 4, over one period")
    with np.errstate(over="ignore"):
        mean = q.mean()
    if not 0 < mean < np.inf:
        raise SolverArgumentError(
            f"inflow_ml_s: its mean is {mean:.6g} ml/s: must be positive and finite; count flow into the "
            "root as positive"
        )
    step = period_s / n
    words = f"within a hundredth of a step of m period/n, n = {n}; resample the inflow to uniform times"
    refuse_where(
        "inflow_time_s", t, np.abs(t - np.arange(n) * step) > 0.01 * step, words, error=SolverArgumentError
    )
    return t, q


def checked_inlet_pressure(pressure: ArrayLike) -> Array:
    """Copy of the pressure at the root's inlet (mmHg, absolute) at times m period/n, (n,).

    Raises
    ------
    SolverArgumentError
        If it is not made of finite numbers, at least 4.
    """
    p = finite_array("inlet_pressure_mmHg", pressure, error=SolverArgumentError).copy()
    if len(p) < 4:
        raise SolverArgumentError(
            f"inlet_pressure_mmHg has {len(p)} values: needs at least 4, over one period"
        )
    return p


def checked_places(series: Sequence[tuple[int, float]]) -> tuple[tuple[int, float], ...]:
    """Pairs of a vessel's id and a position, whatever the network.

    Raises
    ------
    SolverArgumentError
        If an id is not a whole number, or a position not a number.
    """
    try:
        pairs = [(vessel, position) for vessel, position in series]
    except (TypeError, ValueError):
        raise SolverArgumentError(
            f"series = {shown(series)}: must be a list of pairs, vessel id and position"
        ) from None
    return tuple(
        (
            whole_number(
                f"series[{i}]: vessel",
                vessel,
                -(2**31) + 1,
                2**31 - 1,
                words="a whole number, a vessel's id",
                error=SolverArgumentError,
            ),
            real_number(f"series[{i}]: position", position, error=SolverArgumentError),
        )
        for i, (vessel, position) in enumerate(pairs)
    )
