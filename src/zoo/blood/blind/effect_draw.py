"""The effects of a case: drawn from their priors until some can be seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.bench import Added, Bench
from zoo.blood.blind.noise import periodic_noise
from zoo.blood.blind.outside import OUTSIDE
from zoo.blood.blind.visibility import prior_draw, visible_amplitude
from zoo.blood.effects import CATALOGUE
from zoo.core.blindcheck.keys import SECOND
from zoo.core.effects import Effect, Location

Array = NDArray[np.float64]

GAP_MMHG = (0.15, 1.0)
"""Discrepancy of the refitted baseline (rms over the pressures, without noise) that a case may have."""
TRIES = 60
"""Effects, networks or parameters to draw before giving up."""


def location_fields(location: Location) -> dict[str, Any]:
    """A location as the key tells it."""
    return {"vessel": location.part, "subtree": location.subtree}


class EffectDraw:
    """Draws effects for a bench until one can be seen.

    Parameters
    ----------
    rng : numpy.random.Generator
    bench : Bench

    Attributes
    ----------
    invisible : list of dict
        What was drawn and cannot be used, for the key.
    """

    def __init__(self, rng: np.random.Generator, bench: Bench) -> None:
        self.rng, self.bench = rng, bench
        self.invisible: list[dict[str, Any]] = []

    def draw(self, name: str, kind: str, effects: Sequence[str]) -> tuple[str, Added, Array] | None:
        """Name, effects and noise-free waveforms, or None if nothing that was drawn can be seen.

        Parameters
        ----------
        name : str
            To be tried first.
        kind : {"outside", "listed"}
        effects : sequence of str
            Listed ones to draw from.
        """
        names = [name]
        others: Sequence[str] = (*OUTSIDE, SECOND) if kind == "outside" else effects
        for _ in range(TRIES):
            name = names.pop() if names else str(self.rng.choice(others))
            if name == SECOND:
                found = self._two(effects)
            else:
                found = self._one(OUTSIDE[name] if kind == "outside" else CATALOGUE[name])
            if found is not None:
                return name, *found
        return None

    def _one(self, effect: Effect, limits: tuple[float, float] = GAP_MMHG) -> tuple[Added, Array] | None:
        """The effect at a location and amplitudes from its prior, scaled where needed; its waveforms."""
        bench, rng = self.bench, self.rng
        locations = effect.locations(bench.flow)
        location = locations[int(rng.integers(len(locations)))]
        values = [prior_draw(rng, p) for p in effect.parameters]
        target = math.exp(rng.uniform(math.log(1.1 * limits[0]), math.log(0.9 * limits[1])))
        rest = tuple(float(f"{x:.6g}") for x in values[1:])
        noise = np.zeros_like(bench.clean)
        if effect.apply is None:  # correlated errors of unit size
            pressure = np.array([[float(q == "pressure_mmHg")] for _, _, q in bench.sensors])
            noise = pressure * periodic_noise(rng, rest[0], bench.study.period_s, bench.clean.shape)

        def waves(x: float) -> Array | None:
            if effect.apply is None:
                return np.asarray(bench.clean + x * noise)
            return bench.solve(((effect, (float(f"{x:.6g}"), *rest), location),))

        found, smallest, largest = visible_amplitude(
            lambda x: bench.discrepancy(waves(x)), effect.parameters[0], values[0], limits, target
        )
        if found is None:
            why = (
                "invisible" if largest < limits[0] else "too large" if smallest > limits[1] else "not solved"
            )
            seen = [x if math.isfinite(x) else None for x in (smallest, largest)]
            self.invisible.append(
                {"effect": effect.name, **location_fields(location), "why": why, "gaps_mmHg": seen}
            )
            return None
        size = float(f"{found:.6g}")
        made = waves(size)
        assert made is not None
        return ((effect, (size, *rest), location),), made

    def _two(self, effects: Sequence[str]) -> tuple[Added, Array] | None:
        """Two listed effects, each of which could be seen alone, and whose sum can."""
        listed = [n for n in effects if CATALOGUE[n].apply is not None]
        limits = (GAP_MMHG[0], 0.6 * GAP_MMHG[1])
        first: Added = ()
        for _ in range(TRIES // 3):
            name = str(self.rng.choice(listed))
            if first and name == first[0][0].name:
                continue
            found = self._one(CATALOGUE[name], limits)
            if found is None:
                continue
            if not first:
                first = found[0]
                continue
            added = (*first, *found[0])
            waves = self.bench.solve(added)
            if waves is not None and GAP_MMHG[0] <= self.bench.discrepancy(waves) <= GAP_MMHG[1]:
                return added, waves
        return None
