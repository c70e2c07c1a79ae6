"""What the free functions of a study are made from: its model, a solve at its parameters, and its data."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case
from zoo.core.data import Data

Array = NDArray[np.float64]
MOST_HARMONICS = 20
"""Beyond this harmonic a filter's gain and delay no longer change."""
GAIN_KNOTS, DELAY_KNOTS, RADIUS_KNOTS = 10, 6, 6
GAIN_LENGTHS = (0.35, 0.7, 1.4)
DELAY_LENGTHS = (0.7, 1.4, 2.8)
RADIUS_LENGTHS = (0.3, 0.6, 1.2)
FREQUENCY, FREQUENCY_UNIT = "log frequency", "log Hz"
RADIUS, RADIUS_UNIT = "log radius", "log cm"


@dataclass(frozen=True, eq=False)
class Setting:
    """A forward model of a study at given parameters, beside the data.

    Parameters
    ----------
    model : forward model
        `zoo.blood.forward.BloodFlow`, also with effects.
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
        last = max(4, min(MOST_HARMONICS, self.data.n_times // 4))
        return np.asarray(np.linspace(0.0, math.log(last), n) - math.log(self.period_s))

    @property
    def pressures(self) -> Array | None:
        """Observed pressures, mmHg, all in one; None without any."""
        rows = self.data.rows.get("pressure_mmHg")
        return None if not rows else np.asarray(self.data.values[rows]).ravel()
