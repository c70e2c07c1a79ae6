"""Distributions that PyMC does not have.

They are classes of this module (a ``pm.CustomDist`` makes its class on the fly), so that a model unpickled in
another process still finds its log-density and its start.
"""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from pymc.distributions.continuous import TruncatedNormalRV
from pytensor.tensor.random.basic import InvGammaRV
from pytensor.tensor.random.op import RandomVariable
from scipy.stats import truncnorm

from zoo.core.arrays import Array
from zoo.core.draws import inverse_gamma_draws
from zoo.core.in_numba import called_as_python

# PyTensor 3 says that it draws these in Python, which costs nothing beside a solve
warnings.filterwarnings(
    "ignore", "Numba will use object mode to run (truncated_normal|interpolated)_rv", UserWarning
)


@called_as_python
class LogUniformRV(RandomVariable):
    """Draws of `LogUniform`."""

    name = "log_uniform"
    signature = "(),()->()"
    dtype = "floatX"
    _print_name = ("LogUniform", "\\operatorname{LogUniform}")

    @classmethod
    def rng_fn(cls, rng: np.random.Generator, lower: Array, upper: Array, size: Any = None) -> Array:
        """The exponential of a uniform draw."""
        return np.asarray(np.exp(rng.uniform(np.log(lower), np.log(upper), size=size)))


class LogUniform(pm.Continuous):
    """Distribution whose logarithm is uniform: p(x) = 1/(x log(upper/lower)), lower < x < upper."""

    rv_op = LogUniformRV()

    @classmethod
    def dist(cls, lower: Any, upper: Any, **kwargs: Any) -> Any:
        """Positive bounds."""
        return super().dist([lower, upper], **kwargs)

    def support_point(rv, size, lower, upper):  # type: ignore[no-untyped-def]
        """Geometric mean of the bounds."""
        return pt.zeros_like(rv) + pt.sqrt(lower * upper)

    def logp(value, lower, upper):  # type: ignore[no-untyped-def]
        """Log-density, minus infinity outside the bounds."""
        inside = pt.and_(pt.ge(value, lower), pt.le(value, upper))
        return pt.switch(inside, -pt.log(value) - pt.log(pt.log(upper / lower)), -np.inf)


@called_as_python
class InverseGammaRV(InvGammaRV):
    """Draws of `InverseGamma`."""

    @classmethod
    def rng_fn(cls, rng: np.random.Generator, shape: Array, scale: Array, size: Any = None) -> Array:
        """Of `zoo.core.draws.inverse_gamma_draws`."""
        return inverse_gamma_draws(rng, shape, scale, size)


class InverseGamma(pm.InverseGamma):
    """``pm.InverseGamma`` whose draws are finite also where a gamma draw is below the smallest double."""

    rv_op = InverseGammaRV()


@called_as_python
class PositiveNormalRV(TruncatedNormalRV):
    """Draws of `PositiveNormal`."""


class PositiveNormal(pm.TruncatedNormal):
    """``pm.TruncatedNormal`` above zero that starts at its mean."""

    rv_type = PositiveNormalRV
    rv_op = PositiveNormalRV()

    def support_point(rv, size, mu, sigma, lower, upper):  # type: ignore[no-untyped-def]
        """The mean of the untruncated law, or its sd where that is not positive."""
        return pt.zeros_like(rv) + pt.switch(mu > 0, mu, sigma)


@called_as_python
class TruncatedLogNormalRV(RandomVariable):
    """Draws of `TruncatedLogNormal`."""

    name = "truncated_log_normal"
    signature = "(),(),(),()->()"
    dtype = "floatX"
    _print_name = ("TruncatedLogNormal", "\\operatorname{TruncatedLogNormal}")

    @classmethod
    def rng_fn(
        cls, rng: np.random.Generator, mu: Array, sigma: Array, low: Array, high: Array, size: Any = None
    ) -> Array:
        """The exponential of a truncated normal draw."""
        limits = (low - mu) / sigma, (high - mu) / sigma
        return np.asarray(np.exp(truncnorm.rvs(*limits, mu, sigma, size, random_state=rng)))


class TruncatedLogNormal(pm.Continuous):
    """Distribution whose logarithm is a truncated normal one; starts at its untruncated mean, or inside."""

    rv_op = TruncatedLogNormalRV()

    @classmethod
    def dist(cls, mu: Any, sigma: Any, low: Any, high: Any, **kwargs: Any) -> Any:
        """Mean and standard deviation of the logarithm, and its bounds, which may be infinite."""
        return super().dist([mu, sigma, low, high], **kwargs)

    def support_point(rv, size, mu, sigma, low, high):  # type: ignore[no-untyped-def]
        """Mean of the untruncated law, moved inside the bounds."""
        margin = 0.5 * pt.minimum(sigma, high - low)
        return pt.zeros_like(rv) + pt.exp(pt.clip(mu + 0.5 * sigma**2, low + margin, high - margin))

    def logp(value, mu, sigma, low, high):  # type: ignore[no-untyped-def]
        """Log-density of the logarithm's law, with the Jacobian of the logarithm."""
        of_logarithm = pm.TruncatedNormal.dist(mu, sigma, lower=low, upper=high)
        return pm.logp(of_logarithm, pt.log(value)) - pt.log(value)
