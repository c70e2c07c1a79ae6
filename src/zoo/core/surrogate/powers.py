"""The numbers that a solution depends on, as powers or logarithms in which it is most nearly linear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike

from zoo.core.arrays import Array
from zoo.core.parameters import Parameter


@dataclass(frozen=True)
class Coordinates:
    """Coordinates x (n_x,) of a solve: its parameters but for hyperparameters, as powers or logarithms.

    Parameters
    ----------
    parameters : sequence of Parameter
        Of a forward model. Each enters as its `response` says, those with `hyper` do not enter.
    """

    parameters: Sequence[Parameter]

    @property
    def _read(self) -> Array:
        return np.concatenate([np.full(p.size, not p.hyper) for p in self.parameters])

    @property
    def _powers(self) -> Array:
        return np.concatenate([np.full(p.size, p.response) for p in self.parameters if not p.hyper])

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return int(self._read.sum())

    def of(self, theta: ArrayLike) -> Array:
        """Coordinates (..., n_x) of parameters (..., n_values)."""
        x, powers = np.asarray(theta, dtype=np.float64)[..., self._read], self._powers
        some = powers == 0
        found = np.array(x ** np.where(some, 1.0, powers))
        found[..., some] = np.log(x[..., some])
        return found

    def symbolic(self, variables: Mapping[str, Any]) -> Any:
        """Coordinates as a PyTensor vector of variables by the parameters' names."""
        parts = []
        for p in self.parameters:
            if p.hyper:
                continue
            value = pt.as_tensor_variable(variables[p.name], dtype="float64")
            if p.response != 1:
                value = value**p.response if p.response else pt.log(value)
            parts.append(value if p.dims else pt.shape_padleft(value))
        return pt.concatenate(parts)
