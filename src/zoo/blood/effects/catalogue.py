"""The catalogue of effects, and the decorator that adds to it."""

from __future__ import annotations

from zoo.blood.blood_flow import FAMILIES
from zoo.core.effects import ENTRY_POINTS, Catalogue

CATALOGUE = Catalogue(FAMILIES, entry_points=ENTRY_POINTS, home="zoo.blood.effects:CATALOGUE")
"""Effects by name, in the order in which those of a family are applied."""

effect = CATALOGUE.effect
"""`zoo.core.effects.effect`, which also adds the effect to `CATALOGUE`."""
