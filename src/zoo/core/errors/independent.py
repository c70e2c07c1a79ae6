"""Independent normal errors of one variance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.arrays import Array
from zoo.core.data import Data, squared
from zoo.core.errors.base import DIMS, ErrorModel, ErrorModelError
from zoo.core.parameters import InverseGamma, Parameter, Prior

VAGUE = InverseGamma(0.001, 0.001)

_LOG_2PI = math.log(2.0 * math.pi)


@dataclass(frozen=True)
class Independent(ErrorModel):
    """Independent normal errors of one variance for all series: y_i ~ N(mean_i, sigma2).

    Parameters
    ----------
    sigma2 : Prior
        Of the variance, in the squared unit of the series.
    start : float, optional
        Variance that a search begins at.

    References
    ----------
    Paun et al. 2020, eq. (4.5), doi 10.1098/rsif.2020.0886.

    Examples
    --------
    >>> t = np.linspace(0.0, 1.0, 4)
    >>> errors = Independent(InverseGamma(3.0, 1.0)).bind(Data(t, np.zeros((1, 4))))
    >>> errors.terms(np.zeros((1, 4)), {"sigma2": 1.0}).round(3)
    array([[-0.919, -0.919, -0.919, -0.919]])
    """

    gaps: ClassVar[bool] = True
    sigma2: Prior = VAGUE
    start: float | None = None

    @property
    def name(self) -> str:
        """Its name, "iid"."""
        return "iid"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The variance "sigma2"."""
        unit = self.data.units[0] if self.data is not None else "1"
        return (Parameter("sigma2", self.sigma2, squared(unit), self.start, "variance of the errors"),)

    def bind(self, data: Data) -> Self:
        """The same for given data.

        Raises
        ------
        ErrorModelError
            If the series are of different quantities.
        """
        groups = sorted(set(data.groups))
        if len(groups) > 1:
            raise ErrorModelError(
                f"{data.source or 'data'}: {data.name!r} observes {' and '.join(groups)}: one sigma2 cannot "
                "hold for both; keep the series of one quantity, or use zoo.GroupNoise()"
            )
        return super().bind(data)

    def variance(self, values: Mapping[str, ArrayLike]) -> Array:
        """The variance at each time, (n_series, n_times)."""
        return np.full((self.on.n_series, self.on.n_times), float(np.asarray(values["sigma2"])))

    def whiten(self, residuals: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """Residuals over the standard deviation."""
        return self.on.filled(residuals / np.sqrt(float(np.asarray(values["sigma2"]))))

    def unwhiten(self, z: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """Standard normal numbers times the standard deviation."""
        return np.asarray(z * np.sqrt(float(np.asarray(values["sigma2"]))))

    def terms(
        self, residual: Array, values: Mapping[str, ArrayLike], decomposition: str = "sequential"
    ) -> Array:
        """Terms log p(y_i), (n_series, n_times), the same in every decomposition."""
        sigma2 = float(np.asarray(values["sigma2"]))
        return self.on.filled(-0.5 * (_LOG_2PI + math.log(sigma2) + residual * residual / sigma2))

    def observe(
        self, name: str, mean: Any, ok: Any, variables: Mapping[str, Any], dims: Sequence[str] = DIMS
    ) -> Any:
        """Add the observed variable, whose log-density is written in PyTensor."""
        from zoo.core.errors.variables import IidErrors

        observed = {"observed": self.on.filled(self.on.values, np.inf), "dims": tuple(dims)}
        return IidErrors(name, mean, ok, variables["sigma2"], **observed)
