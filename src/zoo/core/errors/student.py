"""Robust errors: Student's t, whose tails make little of a few samples that are far off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import digamma, gammaln, ndtr, ndtri, stdtr, stdtrit

from zoo.core.arrays import Array
from zoo.core.errors.base import DIMS, ErrorModel
from zoo.core.errors.groups import GroupNoise
from zoo.core.parameters import LogUniform, Parameter

FREEDOM = (2.0, 100.0)
"""Prior of the degrees of freedom, log-uniform: from a variance that is just finite to a normal law."""


@dataclass(frozen=True)
class GroupStudent(GroupNoise):
    """Independent Student-t errors for each group of series: y_i = mean_i + s t_i, t_i with nu degrees.

    Each group has a scale s, "noise_G", which is what `known` gives, and "nu_G": the standard deviation is
    s sqrt(nu/(nu - 2)). With many degrees the law is that of `GroupNoise`.

    Parameters
    ----------
    known : mapping of str to float
        Scales that are given, as in `GroupNoise`.
    priors : mapping of str to Prior
        Of parameters by name, instead of those that follow from the data.

    References
    ----------
    Lange, Little, Taylor (1989), doi 10.1080/01621459.1989.10478852.

    Examples
    --------
    >>> from zoo.core.data import Data
    >>> errors = GroupStudent().bind(Data(np.arange(3.0), np.array([[0.0, 8.0, 2.0]]), labels=["p"]))
    >>> [p.name for p in errors.parameters]
    ['noise_p', 'nu_p']
    >>> errors.terms(np.array([[0.0, 1.0, 9.0]]), {"noise_p": 1.0, "nu_p": 3.0}).round(3)
    array([[-1.001, -1.576, -7.665]])
    """

    @property
    def name(self) -> str:
        """Its name, "student-t"."""
        return "student-t"

    def _group_parameters(self, group: str, unit: str, size: float) -> Iterator[Parameter]:
        yield from super()._group_parameters(group, unit, size)
        about = f"degrees of freedom of the errors, {group}"
        yield Parameter(f"nu_{group}", LogUniform(*FREEDOM), "1", 10.0, about, log=True)

    def _nu(self, values: Mapping[str, ArrayLike]) -> Array:
        """Degrees of freedom of each series, (n_series, 1)."""
        return np.array([float(np.asarray(values[f"nu_{group}"])) for group in self.on.groups])[:, None]

    def variance(self, values: Mapping[str, ArrayLike]) -> Array:
        """s^2 nu/(nu - 2) at each time, (n_series, n_times)."""
        nu = self._nu(values)
        return np.asarray(super().variance(values) * nu / (nu - 2.0))

    def whiten(self, residuals: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """The normal numbers of the same probability."""
        z = self.on.filled(residuals) / self._noise(values)
        return self.on.filled(-np.sign(z) * ndtri(stdtr(self._nu(values), -np.abs(z))))

    def unwhiten(self, z: Array, values: Mapping[str, ArrayLike]) -> Array | None:
        """The t-distributed numbers of the same probability, times the scale."""
        t = -np.sign(z) * stdtrit(self._nu(values), ndtr(-np.abs(z)))
        return np.asarray(t * self._noise(values))

    def terms(
        self, residual: Array, values: Mapping[str, ArrayLike], decomposition: str = "sequential"
    ) -> Array:
        """Terms log p(y_i), (n_series, n_times), the same in every decomposition."""
        s, nu = self._noise(values), self._nu(values)
        height = gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu) - 0.5 * np.log(nu * np.pi) - np.log(s)
        return self.on.filled(height - 0.5 * (nu + 1.0) * np.log1p((self.on.filled(residual) / s) ** 2 / nu))

    def gradient(
        self, residual: Array, values: Mapping[str, ArrayLike], weight: Array
    ) -> tuple[Array, Mapping[str, ArrayLike]]:
        """Gradient of sum_i g_i term_i, by the residual and by each scale and number of degrees."""
        s, nu = self._noise(values), self._nu(values)
        z = self.on.filled(residual) / s
        pull = (nu + 1.0) * z / (nu + z * z)
        by_scale = self.on.filled((z * pull - 1.0) / s * weight).sum(axis=1)
        by_nu = (
            digamma(0.5 * (nu + 1.0)) - digamma(0.5 * nu) - 1.0 / nu - np.log1p(z * z / nu) + z * pull / nu
        )
        by_nu = self.on.filled(0.5 * by_nu * weight).sum(axis=1)
        inferred = np.array([sd is None for sd in self._given])
        found = {}
        for group, rows in self.on.rows.items():
            found[f"noise_{group}"] = float(np.sum(by_scale[rows] * inferred[rows]))
            found[f"nu_{group}"] = float(np.sum(by_nu[rows]))
        return self.on.filled(-pull / s * weight), {name: found[name] for name in self.parameter_names}

    def observe(
        self, name: str, mean: Any, ok: Any, variables: Mapping[str, Any], dims: Sequence[str] = DIMS
    ) -> Any:
        """Add the observed variable, of the terms and their gradient."""
        return ErrorModel.observe(self, name, mean, ok, variables, dims)
