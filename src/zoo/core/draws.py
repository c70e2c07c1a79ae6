"""Draws that numpy has no function for."""

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
