"""The numbers that a solution depends on, as logarithms where a search steps in these."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike, NDArray

from zoo.core.parameters import Parameter, n_values

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Coordinates:
    """Coordinates x (n_x,) of a solve: its parameters but for hyperparameters, some as logarithms.

    Parameters
    ----------
    parameters : sequence of Parameter
        Of a forward model. Those with `log` enter as their logarithm, those with `hyper` do not enter.
    """

    parameters: Sequence[Parameter]

    @property
    def _read(self) -> Array:
        return np.concatenate([np.full(p.size, not p.hyper) for p in self.parameters])

    @property
    def _log(self) -> Array:
        return np.concatenate([np.full(p.size, p.log) for p in self.parameters if not p.hyper])

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return int(self._read.sum())

    def of(self, theta: ArrayLike) -> Array:
        """Coordinates (..., n_x) of parameters (..., n_values)."""
        x = np.array(np.asarray(theta, dtype=np.float64)[..., self._read])
        x[..., self._log] = np.log(x[..., self._log])
        return x

    def theta(self, x: ArrayLike) -> Array:
        """Parameters (..., n_values) with these coordinates; hyperparameters, which no solve reads, are 1."""
        x = np.array(x, dtype=np.float64)
        x[..., self._log] = np.exp(x[..., self._log])
        found = np.ones((*x.shape[:-1], n_values(self.parameters)))
        found[..., self._read] = x
        return found

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest x (n_x,) of the priors' supports; infinite where there is none."""
        ends: tuple[list[float], list[float]] = ([], [])
        for p in self.parameters:
            if not p.hyper:
                for end, values in zip(p.prior.support, ends, strict=True):
                    values += [end] * p.size
        with np.errstate(divide="ignore"):
            low, high = (
                np.where(self._log, np.log(np.maximum(values, 0.0)), values) for values in map(np.array, ends)
            )
        return low, high

    def symbolic(self, variables: Mapping[str, Any]) -> Any:
        """Coordinates as a PyTensor vector of variables by the parameters' names."""
        parts = []
        for p in self.parameters:
            if p.hyper:
                continue
            value = pt.as_tensor_variable(variables[p.name], dtype="float64")
            value = pt.log(value) if p.log else value
            parts.append(value if p.dims else pt.shape_padleft(value))
        return pt.concatenate(parts)
