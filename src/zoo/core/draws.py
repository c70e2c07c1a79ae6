"""Draws that numpy has no function for, and some of many."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST_DRAW = 1e300
"""What stands for draws that no double can hold: half of those of an inverse gamma of shape 0.001."""


def inverse_gamma_draws(
    rng: np.random.Generator, shape: Any, scale: Any, size: Any = None
) -> NDArray[np.float64]:
    """The scale over gamma draws, at most `LARGEST_DRAW`."""
    scale = np.asarray(scale, dtype=np.float64)  # PyTensor hands on small constants as single precision
    return np.asarray(scale / np.maximum(rng.gamma(shape, size=size), scale / LARGEST_DRAW))


def seed_or_drawn(seed: int | None) -> int:
    """The seed that is given, or one of the operating system's."""
    return int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else int(seed)


def evenly(n: int, wanted: int) -> NDArray[np.int64]:
    """Which of n draws to keep, evenly from the first to the last; all of them if no more than `wanted`."""
    return np.unique(np.linspace(0, n - 1, max(1, min(n, wanted))).round().astype(np.int64))
