"""The effects of a case: drawn from their priors until their size is in range."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.bench import Added, Bench
from zoo.blood.blind.causes import CAUSES, COMPONENTS, Cause, of_component
from zoo.blood.blind.draw import GAP_OVER_NOISE, PLUS
from zoo.blood.blind.noise import periodic_noise
from zoo.blood.blind.outside import OUTSIDE
from zoo.blood.effects import CATALOGUE
from zoo.core.blindcheck.keys import PAIR, SECOND
from zoo.core.effects import EVERYWHERE, Effect, Location

Array = NDArray[np.float64]

DRAWS = 12
"""Locations and parameters that are drawn of one effect before another effect is."""
TRIES = 60
"""Effects or networks to draw before giving up."""
COMPARABLE = 2.5
"""Most that one discrepancy of a pair is of the other."""
FAR_OFF = 3.0
"""Factor outside the range beyond which the linearised discrepancy of a cause decides."""


def location_fields(location: Location) -> dict[str, Any]:
    """A location as the key tells it."""
    return {"vessel": location.part, "subtree": location.subtree}


def another(rng: np.random.Generator, kind: str) -> str:
    """What to try first of another component, or pair of components."""
    if kind == PAIR:
        return PLUS.join(COMPONENTS[int(i)] for i in np.sort(rng.permutation(len(COMPONENTS))[:2]))
    part = of_component(str(rng.choice(COMPONENTS)))
    return part[int(rng.integers(len(part)))].name


class EffectDraw:
    """Draws effects for a bench until the size of one is in range.

    Parameters
    ----------
    rng : numpy.random.Generator
    bench : Bench
    noise : float
        Standard deviation of the pressures' noise, mmHg.
    limits : (float, float)
        Of the model discrepancy over it.

    Attributes
    ----------
    shapes : dict
        Cause -> the numbers of its shape as last drawn.
    redrawn : dict
        Effect -> how many draws of it were "kept", and drawn again because the model discrepancy was "below"
        or "above" the range or the solve failed ("unsolved").
    """

    def __init__(
        self,
        rng: np.random.Generator,
        bench: Bench,
        noise: float,
        limits: tuple[float, float] = GAP_OVER_NOISE,
    ) -> None:
        self.rng, self.bench = rng, bench
        self.limits = tuple(x * noise for x in limits)
        self.shapes: dict[str, dict[str, float]] = {}
        self.redrawn: dict[str, Counter[str]] = {}

    def draw(self, name: str, kind: str, effects: Sequence[str]) -> tuple[str, Added, Array] | None:
        """Name, effects and noise-free waveforms, or None if nothing that was drawn is in range.

        Parameters
        ----------
        name : str
            To be tried first; of a pair, its two components.
        kind : {"outside", "listed", "component", "pair"}
        effects : sequence of str
            Listed ones to draw from.
        """
        if kind == "pair":
            return self._pair(*name.split(PLUS))
        if kind == "component":
            same = of_component(CAUSES[name].component)
            for one in (CAUSES[name], *(same[int(i)] for i in self.rng.permutation(len(same)))):
                drawn = self._cause(one, self.limits)
                if drawn is not None:
                    return one.name, *drawn[:2]
            return None
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

    def _verdict(self, name: str, waves: Array | None) -> bool:
        """Whether the discrepancy of noise-free waveforms is in range; counted."""
        return self._gap(name, waves, *self.limits) is not None

    def _gap(self, name: str, waves: Array | None, low: float, high: float) -> float | None:
        """The discrepancy of noise-free waveforms where it is in a range; counted."""
        gap = 0.0
        # a refit leaves little of what is small before it
        if waves is None or self.bench.change(waves) > 0.5 * low:
            gap = self.bench.discrepancy(waves)
        kept = low <= gap <= high
        why = "kept" if kept else "below" if gap < low else "above" if math.isfinite(gap) else "unsolved"
        self.redrawn.setdefault(name, Counter())[why] += 1
        return gap if kept else None

    def _cause(self, one: Cause, limits: Sequence[float]) -> tuple[Added, Array, float] | None:
        """A cause of drawn size and shape, its waveforms and its discrepancy."""
        low, high = limits
        for _ in range(DRAWS):
            effect, size, shape = one.draw(self.rng)
            added: Added = ((effect, (size,), EVERYWHERE),)
            waves = self.bench.solve(added)
            near = math.inf if waves is None else self.bench.linear_discrepancy(waves)
            if waves is not None and not low / FAR_OFF < near < high * FAR_OFF:
                self.redrawn.setdefault(one.name, Counter())["below" if near < low else "above"] += 1
                continue
            gap = self._gap(one.name, waves, low, high)
            if waves is not None and gap is not None:
                self.shapes[one.name] = shape
                return added, waves, gap
        return None

    def _pair(self, first: str, second: str) -> tuple[str, Added, Array] | None:
        """Causes of two components whose discrepancies are comparable, each and together in range."""
        low, high = self.limits
        for _ in range(TRIES // 12):
            one, other = (self.rng.choice(np.array(of_component(c), dtype=object)) for c in (first, second))
            a = self._cause(one, self.limits)
            if a is None:
                continue
            near = max(low, a[2] / COMPARABLE), min(high, a[2] * COMPARABLE)
            b = self._cause(other, near)
            if b is None:
                continue
            added = (*a[0], *b[0])
            waves = self.bench.solve(added)
            if self._verdict(PAIR, waves):
                assert waves is not None
                return PLUS.join((one.name, other.name)), added, waves
        return None

    def _one(self, effect: Effect) -> tuple[Added, Array] | None:
        """The effect at a location and amplitudes from its prior, and its waveforms."""
        bench, rng = self.bench, self.rng
        locations = effect.locations(bench.flow)
        for _ in range(DRAWS):
            location = locations[int(rng.integers(len(locations)))]
            values = tuple(float(f"{p.prior.draw(rng, 1, {})[0]:.6g}") for p in effect.parameters)
            if effect.apply is None:  # correlated errors
                pressure = np.array([[float(q == "pressure_mmHg")] for _, _, q in bench.sensors])
                noise = periodic_noise(rng, values[1], bench.study.period_s, bench.clean.shape)
                waves: Array | None = np.asarray(bench.clean + values[0] * pressure * noise)
            else:
                waves = bench.solve(((effect, values, location),))
            if self._verdict(effect.name, waves):
                assert waves is not None
                return ((effect, values, location),), waves
        return None

    def _two(self, effects: Sequence[str]) -> tuple[Added, Array] | None:
        """Two listed effects, each of which and whose sum is in range."""
        listed = [n for n in effects if CATALOGUE[n].apply is not None]
        first: Added = ()
        for _ in range(TRIES // 3):
            name = str(self.rng.choice(listed))
            if first and name == first[0][0].name:
                continue
            found = self._one(CATALOGUE[name])
            if found is None:
                continue
            if not first:
                first = found[0]
                continue
            added = (*first, *found[0])
            waves = self.bench.solve(added)
            if self._verdict(SECOND, waves):
                assert waves is not None
                return added, waves
        return None
