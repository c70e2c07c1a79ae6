"""The wall laws as formulas, eq. (3.3), (3.4) and Olufsen's, for tests to compare with."""

from __future__ import annotations

from typing import Any

import numpy as np

from zoo.blood.conventions import PRINTED, Conventions


def wall_pressure_mmHg(
    wall: str, area_ratio: Any, stiffness: float, gamma: float = 2.0, *, conventions: Conventions = PRINTED
) -> np.ndarray:
    """Pressure at A/A0."""
    a = np.asarray(area_ratio, dtype=np.float64)
    if wall == "linear":
        return 4 / 3 * stiffness * (np.sqrt(a) - 1) / conventions.mmhg
    if wall == "olufsen":
        return 4 / 3 * stiffness * (1 - 1 / np.sqrt(a)) / conventions.mmhg
    return conventions.wall_factor * stiffness * np.tan(np.pi / gamma * (a - 1)) / conventions.mmhg
