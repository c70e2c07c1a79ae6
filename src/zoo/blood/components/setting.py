"""What the free functions of a study are made from: its model, a solve at its parameters, and its data."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from zoo.blood.case import Case, simulate
from zoo.core.arrays import Array
from zoo.core.data import Data

MOST_HARMONICS = 20
"""Beyond this harmonic a filter's gain and delay no longer change."""
GAIN_KNOTS, DELAY_KNOTS, RADIUS_KNOTS = 10, 6, 6
SAMPLES = 256
"""Of a beat, where the ranges are read off that a function's argument has."""
RANGE_MARGIN = 0.15
"""Part of such a range by which knots go beyond it."""


@dataclass(frozen=True, eq=False)
class Setting:
    """A forward model of a study at given parameters, beside the data.

    Parameters
    ----------
    model : forward model
        `zoo.blood.blood_flow.BloodFlow`, also with effects.
    case : Case
        Its solve at the parameters.
    data : Data
    """

    model: Any
    case: Case
    data: Data

    @property
    def period_s(self) -> float:
        """s."""
        return float(self.case.network.period_s)

    @property
    def vessels(self) -> tuple[str, ...]:
        """Names of the vessels, in the order of the network."""
        return tuple(f"vessel {vessel}" for vessel in self.case.network.ids)

    @property
    def log_radius(self) -> Array:
        """Of every vessel's mean radius at rest, log cm, (n_vessels,)."""
        network = self.case.network
        return np.asarray(np.log(0.5 * (network.radius_in_cm + network.radius_out_cm)))

    def radius_knots(self) -> Array | None:
        """Knots over the radii of the tree, log cm; None where all are alike."""
        low, high = self.log_radius.min(), self.log_radius.max()
        return np.linspace(low, high, RADIUS_KNOTS) if high - low > 0.1 else None

    def frequency_knots(self, n: int) -> Array:
        """n knots from the first harmonic to the last that counts, log Hz."""
        last = max(4, min(MOST_HARMONICS, int(self.data.measured.sum(axis=1).max()) // 4))
        return np.asarray(np.linspace(0.0, math.log(last), n) - math.log(self.period_s))

    @property
    def pressures(self) -> Array | None:
        """Observed pressures, mmHg, all in one; None without any."""
        rows = self.data.rows.get("pressure_mmHg")
        return np.concatenate([self.data.samples(i) for i in rows]) if rows else None

    @cached_property
    def beat(self) -> dict[str, Array]:
        """Pressure (mmHg), flow (ml/s), stretch sqrt(A/A0) and velocity (cm/s), (n_vessels, 2, n_times).

        Over the beat, at the inlets and outlets of the vessels; what sensors do to the waves is left out.

        Raises
        ------
        SolveError
            If the solve fails.
        """
        network = self.case.network
        names = ("pressure_mmHg", "flow_ml_s", "area_cm2")
        places = [(int(v), end, name) for name in names for v in network.ids for end in (0.0, 1.0)]
        times = np.arange(SAMPLES) * (self.period_s / SAMPLES)
        plain = replace(self.case, waves=(), coarse_blend=0.0)
        pressure, flow, area = simulate(plain, places, times).reshape(3, len(network.ids), 2, SAMPLES)
        radius = np.stack([network.radius_in_cm, network.radius_out_cm], axis=1)
        stretch = np.sqrt(area / (math.pi * radius[..., None] ** 2))
        return {"pressure": pressure, "flow": flow, "stretch": stretch, "velocity": flow / area}


def range_knots(values: Array, n: int) -> Array:
    """n knots over the range of values and `RANGE_MARGIN` beyond on both sides."""
    low, high = float(np.min(values)), float(np.max(values))
    margin = RANGE_MARGIN * (high - low)
    return np.linspace(low - margin, high + margin, n)


def span_of(at: Array) -> float:
    """The range of knots."""
    return float(at[-1] - at[0])
