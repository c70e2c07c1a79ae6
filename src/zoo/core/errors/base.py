"""What an error model is: one object for the PyMC model, evidence, WAIC and prediction."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.core.data import Data
from zoo.core.parameters import Parameter

Array = NDArray[np.float64]

DECOMPOSITIONS = ("sequential", "leave-one-out", "joint")


class ErrorModelError(ValueError):
    """An error model that does not fit the data; its text says what to change."""


@dataclass(frozen=True)
class ErrorModel(ABC):
    """The law of measured minus computed series.

    An error model is a value: made without data it is a statement for any, and `bind` gives it the data that
    its other methods need. Residuals are arrays (..., n_series, n_times) in the series' own units.

    Attributes
    ----------
    data : Data or None
        What it is bound to.
    """

    data: Data | None = None

    @property
    @abstractmethod
    def name(self) -> str:
        """As run records store it, such as "iid" or "gp"."""

    def bind(self, data: Data) -> Self:
        """The same for given data.

        Raises
        ------
        ErrorModelError
            If it cannot hold for them, such as one variance for two quantities.
        """
        return replace(self, data=data)

    @property
    def on(self) -> Data:
        """The data.

        Raises
        ------
        ErrorModelError
            If it is not bound.
        """
        if self.data is None:
            raise ErrorModelError(f"error model {self.name}: has no data; call bind(data) first")
        return self.data

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Its free parameters."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of its free parameters."""
        return tuple(p.name for p in self.parameters)

    def transform(self, series: Array) -> Array:
        """Series to the coefficients in which the errors are described; here the series themselves."""
        return series

    def inverse(self, coefficients: Array) -> Array:
        """Coefficients to series: the inverse of `transform`."""
        return coefficients

    @abstractmethod
    def variance(self, values: Mapping[str, ArrayLike]) -> Array:
        """Marginal variance (n_series, n_times) of the errors at each time."""

    @abstractmethod
    def whiten(self, residuals: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """Residuals as independent standard normal numbers of the same shape; None if there is no law."""

    @abstractmethod
    def unwhiten(self, z: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """Errors from independent standard normal numbers: the inverse of `whiten`."""

    @abstractmethod
    def terms(
        self, residual: Array, values: Mapping[str, ArrayLike], decomposition: str = "sequential"
    ) -> Array:
        """Log-likelihood terms (n_series, n_times) of one residual; -inf where there is no law.

        Parameters
        ----------
        residual : array (n_series, n_times)
        values : mapping of name to number
        decomposition : {"sequential", "leave-one-out"}
            log p(y_i | y_<i), which add up to the joint log-density, or log p(y_i | y_-i).
        """

    @abstractmethod
    def observe(self, name: str, mean: Any, ok: Any, variables: Mapping[str, Any]) -> Any:
        """Add the observed variable to the PyMC model in whose context it is called.

        Parameters
        ----------
        name : str
            Of the variable, such as "y"; its log-density is made of the terms, density 0 where ok is 0.
        mean : TensorVariable (n_series, n_times)
        ok : TensorVariable, int8 scalar
        variables : mapping
            PyMC variables of `parameters`.
        """

    def log_density(self, residual: Array, values: Mapping[str, ArrayLike]) -> float:
        """Joint log-density of one residual (n_series, n_times)."""
        return float(np.sum(self.terms(residual, values)))

    def draw(self, rng: np.random.Generator, values: Mapping[str, ArrayLike]) -> Array | None:
        """Errors (n_series, n_times) from the law."""
        return self.unwhiten(rng.standard_normal((self.on.n_series, self.on.n_times)), values)
