"""What the sizes of effects are parts of: from anything with a `network` to a size of its study."""

from __future__ import annotations

import numpy as np

from zoo.blood.effects.locations import Tree
from zoo.core.effects import Measure


def period_s(model: Tree) -> float:
    """Of the beat."""
    return float(model.network.period_s)


def mean_radius_cm(model: Tree) -> float:
    """Of all vessels."""
    network = model.network
    return float(np.mean(0.5 * (network.radius_in_cm + network.radius_out_cm)))


def terminal_radius_cm(model: Tree) -> float:
    """Mean over the ends of the terminals."""
    network = model.network
    return float(np.mean(network.radius_out_cm[network.terminals]))


BEATS = Measure("beats", period_s)
MEAN_RADII = Measure("mean radii", mean_radius_cm)
TERMINAL_RADII = Measure("mean radii of the terminals", terminal_radius_cm)
