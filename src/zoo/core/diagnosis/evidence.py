"""The marginal likelihood of a linearised model with normal errors, and a hypothesis at its mode."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.diagnosis.hypothesis import Hypothesis, HypothesisModel
from zoo.core.diagnosis.search import as_matrix
from zoo.core.errors.spectral import GroupErrors, log_density

Array = NDArray[np.float64]


def marginal(
    residual: Array,
    jacobian: Array,
    S: Array,
    precision: Array,
    pull: Array,
) -> tuple[Any, Array, Array]:
    """Log marginal likelihood of a linear model with normal errors, and its parameters' posterior.

    r = J d + e, e ~ N(0, diag S), prior density exp(-d'P d/2 - pull'd) without its constant:
    log Z = log N(r; 0, S) + b'H^-1 b/2 - log|H/2 pi|/2, H = J'J/S + P, b = J'r/S - pull.

    Parameters
    ----------
    residual : array (n,)
        At the point of linearisation.
    jacobian : array (n, d)
    S : array (..., n)
        Any number of variances at once.
    precision : array (d,) or (d, d)
        P, a diagonal or a matrix; 0 for a flat prior.
    pull : array (d,)

    Returns
    -------
    log_z : array (...,)
    step : array (..., d)
        H^-1 b, the mode seen from the point of linearisation.
    covariance : array (..., d, d)
        H^-1.
    """
    d = jacobian.shape[1]
    products = (jacobian[:, :, None] * jacobian[:, None, :]).reshape(len(jacobian), d * d)
    H = ((1.0 / S) @ products).reshape(*S.shape[:-1], d, d) + as_matrix(precision)
    b = (1.0 / S) @ (jacobian * residual[:, None]) - pull
    size = np.sqrt(np.maximum(np.einsum("...dd->...d", H), 1e-300))
    scale = size[..., :, None] * size[..., None, :]
    C = np.linalg.inv(H / scale) / scale
    step = np.einsum("...de,...e->...d", C, b)
    _, logdet = np.linalg.slogdet(H / scale)
    logdet += 2.0 * np.log(size).sum(axis=-1)
    log_z = log_density(residual, S) + 0.5 * np.sum(b * step, axis=-1)
    return log_z + 0.5 * (d * math.log(2.0 * math.pi) - logdet), step, C


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its mode.

    `values` are in the parameters' own units; `computed` and `residual` are flat coefficients; `mean` and
    `sd` are those of the parameters' posterior, in search coordinates; `log_z` is the log marginal
    likelihood, and `kinds` what it is made of where the hypothesis has several kinds: the logarithms of their
    prior weights and of their marginal likelihoods.
    """

    hypothesis: Hypothesis
    forward: HypothesisModel = field(repr=False)
    u: Array
    computed: Array = field(repr=False)
    jacobian: Array = field(repr=False)
    residual: Array = field(repr=False)
    errors: Mapping[str, GroupErrors]
    allowances: Mapping[str, float]
    log_z: float
    mean: Array
    covariance: Array = field(repr=False)
    kinds: tuple[tuple[float, float], ...] = ()

    @property
    def values(self) -> Array:
        """Parameters at the mode."""
        return self.forward.theta(self.u)

    @property
    def sd(self) -> Array:
        """Of the search coordinates."""
        return np.sqrt(np.diag(self.covariance))
