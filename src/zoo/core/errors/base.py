"""What an error model is: one object for the PyMC model, evidence, WAIC and prediction."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.arrays import Array
from zoo.core.data import Data
from zoo.core.parameters import Parameter, Prior

DIMS = ("series", "time")
"""Names of the dimensions of data in a PyMC model of one subject."""
DECOMPOSITIONS = ("sequential", "leave-one-out", "joint")


class TermsInNumba(NamedTuple):
    """The sequential terms of an error model as functions that numba compiles, which call no Python.

    Parameters
    ----------
    terms : function
        From residual (n_series, n_times) and the parameters' values (n_values,) to terms (n_series,
        n_times).
    gradient : function
        From residual, values and weight to terms, and the gradient of sum_i g_i term_i by residual and
        values.
    """

    terms: Callable[[Array, Array], Array]
    gradient: Callable[[Array, Array, Array], tuple[Array, Array, Array]]


class ErrorModelError(ValueError):
    """An error model that does not fit the data; its text says what to change."""


@dataclass(frozen=True)
class ErrorModel(ABC):
    """The law of measured minus computed series.

    An error model is a value: made without data it is a statement for any, and `bind` gives it the data that
    its other methods need. Residuals are arrays (..., n_series, n_times) in the series' own units.

    A subclass is a frozen dataclass whose fields can be hashed (tuples, not arrays). It gives `name`,
    `parameters`, `variance`, `whiten`, `unwhiten` and `terms`; the PyMC variable, the draws and the terms of
    posterior draws follow from these.

    Attributes
    ----------
    data : Data or None
        What it is bound to; given by keyword.
    """

    data: Data | None = field(default=None, kw_only=True, repr=False)

    gaps: ClassVar[bool] = False
    """Whether some series may lack samples at some times: NaN in their residuals, terms 0, whitened 0."""

    @property
    @abstractmethod
    def name(self) -> str:
        """As run records store it, such as "iid" or "gp"."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Its free parameters."""

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
            Of the parameters, each a scalar or a vector of its size.
        decomposition : {"sequential", "leave-one-out"}
            ``log p(y_i | y_<i)``, which add up to the joint log-density, or ``log p(y_i | y_-i)``, y the
            data's coefficients, which are the data themselves unless there is a `transform`.
        """

    def left_out(self, residual: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """Each of the data's coefficients as a standard normal number given all others; None if no law.

        Here what `whiten` gives, as it is where they are independent given the parameters; a law with
        correlations has its own.
        """
        return self.whiten(residual, values)

    def gradient(
        self, residual: Array, values: Mapping[str, ArrayLike], weight: Array
    ) -> tuple[Array, Mapping[str, ArrayLike]]:
        """Gradient of sum_i g_i term_i of the sequential terms, for an error model that gives it.

        A law whose `observe` is written in PyTensor needs none. With it NUTS and other methods that follow a
        gradient take a law whose terms are computed in NumPy.

        Parameters
        ----------
        residual, weight : array (n_series, n_times)
            Of one point, and g.
        values : mapping of name to number
            Of the parameters, each a scalar or a vector of its size.

        Returns
        -------
        by_residual : array (n_series, n_times)
        by_parameter : mapping of name to number
            For each parameter what has its shape; zeros, all of it, where there is no law.

        Raises
        ------
        ErrorModelError
            If the law has no gradient.
        """
        raise ErrorModelError(f"error model {self.name}: has no gradient; sample with method exact")

    @property
    def differentiable(self) -> bool:
        """Whether it gives a `gradient`."""
        return type(self).gradient is not ErrorModel.gradient

    def in_numba(self) -> TermsInNumba | None:
        """Terms and gradient as functions that numba compiles, of an error model that gives them; else None.

        It is asked of an error model of the very class that has it.
        """
        return None

    def bind(self, data: Data) -> Self:
        """The same for given data.

        Raises
        ------
        ErrorModelError
            If it cannot hold for them, such as one variance for two quantities.
        """
        if not (data.whole or self.gaps):
            raise ErrorModelError(
                f"{data.source or data.name}: error model {self.name} needs all series at the same times, "
                "and some lack samples that others have; GroupNoise(), GroupProcess() and Independent() do "
                "not need it, nor does a diagnosis"
            )
        return replace(self, data=data)

    @property
    def least_squares_first(self) -> bool:
        """Whether a search begins with least squares, as errors of any size can take the signal for error."""
        return False

    def with_priors(self, priors: Mapping[str, Prior]) -> Self:
        """The same with other priors of some of its parameters.

        Parameters
        ----------
        priors : mapping of str to Prior
            By the names of parameters, which here are the fields of the class that hold their priors.

        Raises
        ------
        ErrorModelError
            If there is no such field.
        """
        named = [f.name for f in fields(self) if isinstance(getattr(self, f.name), Prior)]
        for name in priors:
            if name not in named:
                raise ErrorModelError(
                    f"error model {self.name}: no prior {name!r}; use one of {', '.join(named) or 'none'}"
                )
        given: dict[str, Any] = dict(priors)
        return replace(self, **given)

    def elsewhere(self, group: str, times: Array) -> Self:
        """The law of one more series of a group, at other times, where nothing is measured.

        Parameters
        ----------
        group : str
        times : array (n_times,)
            Uniform, in the data's unit of time.
        """
        first = self.on.rows[group][0]
        blank = Data(
            times,
            np.zeros((1, len(times))),
            labels=[self.on.labels[first]],
            units=[self.on.units[first]],
            groups=[group],
            period=self.on.period,
            time_unit=self.on.time_unit,
        )
        return replace(self, data=blank)

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
    def parameter_names(self) -> tuple[str, ...]:
        """Names of its free parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def fixed(self) -> dict[str, str]:
        """What is given instead of inferred, such as a known noise: name -> words, for a run's record."""
        return {}

    def transform(self, series: Array) -> Array:
        """Series to the coefficients in which the errors are described; here the series themselves."""
        return series

    def inverse(self, coefficients: Array) -> Array:
        """Coefficients to series: the inverse of `transform`."""
        return coefficients

    def log_density(self, residual: Array, values: Mapping[str, ArrayLike]) -> float:
        """Joint log-density of one residual (n_series, n_times): the sum of the sequential terms."""
        return float(np.sum(self.terms(residual, values)))

    def draw(self, rng: np.random.Generator, values: Mapping[str, ArrayLike]) -> Array | None:
        """Errors (n_series, n_times) from the law; None if there is none."""
        return self.unwhiten(rng.standard_normal((self.on.n_series, self.on.n_times)), values)

    def pointwise(
        self,
        series: Array,
        draws: Mapping[str, ArrayLike],
        decompositions: Sequence[str] = DECOMPOSITIONS,
    ) -> dict[str, Array]:
        """Log-likelihood terms of the data at many posterior draws, in several decompositions.

        Parameters
        ----------
        series : array (n_draws, n_series, n_times)
            Computed at each draw, in the series' own units; NaN where a solve failed.
        draws : mapping of name to array (n_draws, ...)
            Of the parameters.
        decompositions : sequence of str
            Of "sequential", ``log p(y_i | y_<i)``; "leave-one-out", ``log p(y_i | y_-i)``; "joint", log p(y),
            the log-density of all observations together.

        Returns
        -------
        dict
            Decomposition -> array (n_draws, n_series, n_times), (n_draws,) for "joint"; -inf where a solve
            failed.

        Raises
        ------
        ValueError
            If a decomposition is unknown.

        References
        ----------
        Buerkner, Gabry and Vehtari 2021, doi 10.1007/s00180-020-01045-4.
        """
        for name in decompositions:
            if name not in DECOMPOSITIONS:
                raise ValueError(f"decomposition = {name!r}: must be one of {', '.join(DECOMPOSITIONS)}")
        columns = {name: np.asarray(draws[name], dtype=np.float64) for name in self.parameter_names}
        residuals = self.on.values - series
        found = {
            name: np.full(series.shape[:1] if name == "joint" else series.shape, -np.inf)
            for name in decompositions
        }
        for i in np.flatnonzero((np.isfinite(residuals) | ~self.on.measured).all(axis=(1, 2))):
            values = {name: column[i] for name, column in columns.items()}
            for name, terms in found.items():  # what one draw has cost may be kept from one to the next
                if name == "joint":
                    terms[i] = self.log_density(residuals[i], values)
                else:
                    terms[i] = self.terms(residuals[i], values, name)
        return found

    def observe(
        self, name: str, mean: Any, ok: Any, variables: Mapping[str, Any], dims: Sequence[str] = DIMS
    ) -> Any:
        """Add the observed variable to the PyMC model in whose context it is called.

        Its log-density is made of the sequential `terms`, (n_series, n_times), and its draws of `unwhiten`.

        Parameters
        ----------
        name : str
            Of the variable, such as "y"; density 0 where ok is 0.
        mean : TensorVariable (n_series, n_times)
        ok : TensorVariable, int8 scalar
        variables : mapping
            PyMC variables of `parameters`.
        dims : sequence of str
            Names of the observed variable's dimensions in that model.

        Returns
        -------
        TensorVariable (n_series, n_times)
        """
        from zoo.core.errors.variables import Errors

        parameters = [variables[p] for p in self.parameter_names]
        data = self.on
        observed = data.filled(data.values, np.inf)
        return Errors(name, mean, ok, *parameters, errors=self, observed=observed, dims=tuple(dims))
