"""A surrogate of a forward model's series: a basis of the series, and a function for each coefficient."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from scipy import linalg

from zoo.core.arrays import Array
from zoo.core.errors.base import ErrorModel
from zoo.core.surrogate.kriging import FewDirectionsError, Kriging
from zoo.core.surrogate.library import Library
from zoo.core.surrogate.powers import Coordinates

LEFT_OUT = 0.003
"""Mean squared norm of what a basis may leave of the design's series, in units of the noise."""
MOST = 60
"""Most components of a basis."""


class SurrogateError(RuntimeError):
    """A surrogate that cannot be made, or is not good enough; its text says why and what to change."""


@dataclass(frozen=True)
class Surrogate:
    """Series y(x) = middle + sum_k a_k(x) b_k, a_k by kriging and b_k the basis.

    The basis is that of the design's series as the errors weigh them, so that coefficients are in units of
    the noise: b_k = U v_k with U U' the covariance of the errors and v_k the principal components.

    Parameters
    ----------
    coordinates : Coordinates
    middle : array (n_series, n_times)
    basis : array (n_basis, n_series, n_times)
    map : Kriging
    radius : float
        Distance from the centre, in whitened coordinates, within which the design lies.
    """

    coordinates: Coordinates
    middle: Array
    basis: Array
    map: Kriging
    radius: float

    @classmethod
    def fit(
        cls,
        library: Library,
        errors: ErrorModel,
        values: Mapping[str, ArrayLike],
        *,
        near: tuple[Array, Array] | None = None,
        within: float = np.inf,
        coordinates: Coordinates | None = None,
    ) -> Surrogate:
        """From solved points, the errors weighed by their law at given parameters.

        Parameters
        ----------
        library : Library
        errors : ErrorModel
            Bound to data, with a linear `whiten`.
        values : mapping
            The errors' parameters.
        near : (mean (n_x,), covariance (n_x, n_x)), optional
            Of a posterior; that of the points if absent.
        within : float
            Only points at most so far from the mean, in whitened coordinates, count.
        coordinates : Coordinates, optional
            In which the map is written, and `near` is; those of the library's model if absent, which may be
            another one with the same solves.

        Raises
        ------
        SurrogateError
            If there are too few points, or they lie in fewer directions than there are coordinates.
        """
        coordinates = coordinates or Coordinates(library.model.parameters)
        x = coordinates.of(library.theta)
        mean, covariance = near or (x.mean(0), np.cov(x.T).reshape(len(x.T), -1))
        try:
            cholesky = linalg.cholesky(covariance, lower=True)
        except linalg.LinAlgError:
            raise SurrogateError(
                f"{library.model.name}: draws around which a surrogate is made do not spread in all of its "
                f"{coordinates.n} coordinates, as where chains did not move; sample with method exact"
            ) from None
        distance = np.linalg.norm(linalg.solve_triangular(cholesky, (x - mean).T, lower=True), axis=0)
        once = np.sort(np.unique(x, axis=0, return_index=True)[1])
        some = once[distance[once] <= within]
        x, series, radius = x[some], library.series[some], float(distance[some].max(initial=0.0))
        if len(x) < 2 * coordinates.n + 2:
            raise SurrogateError(
                f"{library.model.name}: {len(x)} solved points for {coordinates.n} coordinates: a surrogate "
                f"needs {2 * coordinates.n + 2}; more than {library.solves} solves are needed there"
            )
        middle = series.mean(0)
        z = errors.whiten(series - middle, values)
        if z is None:
            raise SurrogateError(f"error model {errors.name}: no law at {dict(values)}")
        flat = z.reshape(len(z), -1)
        _, size, components = linalg.svd(flat, full_matrices=False)
        rest = np.cumsum((size**2)[::-1])[::-1] / len(flat)
        k = int(np.clip(np.sum(rest > LEFT_OUT), 1, MOST))
        basis = errors.unwhiten(components[:k].reshape(k, *middle.shape), values)
        assert basis is not None
        try:
            return cls(
                coordinates, middle, basis, Kriging.fit(x, flat @ components[:k].T, mean, cholesky), radius
            )
        except FewDirectionsError as error:
            raise SurrogateError(f"{library.model.name}: {error}; sample with method exact") from None

    def coefficients(self, theta: ArrayLike) -> Array:
        """Coefficients (n, n_basis) at parameters (n, n_values)."""
        return self.map(self.coordinates.of(theta))

    def series(self, theta: ArrayLike) -> Array:
        """Series (n, n_series, n_times) at parameters (n, n_values)."""
        return np.asarray(self.middle + np.tensordot(self.coefficients(theta), self.basis, 1))

    def symbolic_coefficients(self, variables: Mapping[str, Any]) -> Any:
        """Coefficients (n_basis,) as a graph of variables by the parameters' names."""
        return self.map.symbolic(self.coordinates.symbolic(variables))

    def symbolic_series(self, variables: Mapping[str, Any]) -> Any:
        """Series (n_series, n_times) as a graph."""
        a = self.symbolic_coefficients(variables)
        flat = self.basis.reshape(len(self.basis), -1)
        return pt.constant(self.middle) + pt.dot(a, flat).reshape(self.middle.shape)

    def symbolic_fence(self, variables: Mapping[str, Any]) -> Any:
        """What is taken from the log-density outside the design, where nothing is known, as a graph."""
        v = self.map.symbolic_variables(self.coordinates.symbolic(variables))
        outside = pt.maximum(pt.sqrt(pt.sum(v**2) + 1e-12) - self.radius, 0.0)
        return 5.0 * outside**2
