"""Amplitudes from an effect's prior that the data can show."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.stats import truncnorm

from zoo.core.effects import EffectParameter


def prior_draw(rng: np.random.Generator, amplitude: EffectParameter) -> float:
    """A value from the prior."""
    low, high = ((x - amplitude.centre) / amplitude.scale for x in (amplitude.low, amplitude.high))
    return float(truncnorm.rvs(low, high, amplitude.centre, amplitude.scale, random_state=rng))


def visible_amplitude(
    discrepancy: Callable[[float], float],
    amplitude: EffectParameter,
    value: float,
    limits: tuple[float, float],
    target: float,
) -> tuple[float | None, float, float]:
    """The amplitude nearest to one drawn whose model discrepancy lies within limits.

    Parameters
    ----------
    discrepancy : function
        From an amplitude to what the refitted baseline leaves, mmHg; infinite where the solve fails.
    amplitude : EffectParameter
    value : float
        Drawn; the side of 0 on which to look first.
    limits : (float, float)
        mmHg.
    target : float
        mmHg, within them: what to head for when the drawn amplitude's discrepancy is outside.

    Returns
    -------
    value : float or None
        None if no amplitude in [low, high] gives such a discrepancy.
    smallest, largest : float
        Of the discrepancies that were seen.
    """
    seen: list[float] = []
    for sign in (math.copysign(1.0, value), -math.copysign(1.0, value)):
        end = amplitude.high if sign > 0 else -amplitude.low
        if end <= 0:
            continue
        low, high, solved = max(0.0, amplitude.low if sign > 0 else -amplitude.high), end, True
        x = abs(value)
        for _ in range(14):
            found = discrepancy(sign * x)
            if math.isfinite(found):
                seen.append(found)
            if limits[0] <= found <= limits[1]:
                return sign * x, min(seen), max(seen)
            if found < limits[0]:
                if x >= high and solved:
                    break  # the bound itself does not show it
                low = x
            else:
                high, solved = x, False
            if high - low < 0.01 * high:
                break
            x = x * target / max(found, 1e-9) if math.isfinite(found) else 0.0
            x = min(x, high) if solved else x
            if not low < x < high and not (solved and x == high):
                x = math.sqrt(max(low, 0.003 * high) * high)
    return None, min(seen, default=math.inf), max(seen, default=0.0)
