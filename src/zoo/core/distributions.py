"""Distributions that PyMC does not have."""

from __future__ import annotations

from typing import Any

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from numpy.typing import NDArray
from pymc.distributions import transforms
from pymc.distributions.continuous import BoundedContinuous, TruncatedNormalRV
from pymc.distributions.distribution import _support_point
from pymc.distributions.truncated import TruncatedRV, truncated_support_point
from pytensor.graph.op import Op
from pytensor.tensor.random.basic import InvGammaRV
from pytensor.tensor.random.op import RandomVariable

from zoo.core.draws import inverse_gamma_draws

Array = NDArray[np.float64]


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


class LogUniform(BoundedContinuous):
    """Distribution whose logarithm is uniform: p(x) = 1/(x log(upper/lower)), lower < x < upper."""

    rv_op = LogUniformRV()

    @classmethod
    def dist(cls, lower: Any, upper: Any, **kwargs: Any) -> Any:
        """Positive bounds."""
        return super().dist([lower, upper], **kwargs)

    def support_point(rv, size, lower, upper):  # type: ignore[no-untyped-def]
        return pt.zeros_like(rv) + pt.sqrt(lower * upper)

    def logp(value, lower, upper):  # type: ignore[no-untyped-def]
        inside = pt.and_(pt.ge(value, lower), pt.le(value, upper))
        return pt.switch(inside, -pt.log(value) - pt.log(pt.log(upper / lower)), -np.inf)


def _log_bounds(*inputs: Any) -> tuple[Any, Any]:
    return pt.log(inputs[-2]), pt.log(inputs[-1])


@transforms._default_transform.register(LogUniformRV)
def _log_uniform_transform(op: Op, rv: Any) -> Any:
    return transforms.Chain([transforms.log, transforms.Interval(bounds_fn=_log_bounds)])


class InverseGammaRV(InvGammaRV):
    """Draws of `InverseGamma`."""

    @classmethod
    def rng_fn(cls, rng: np.random.Generator, shape: Array, scale: Array, size: Any = None) -> Array:
        """Of `zoo.core.draws.inverse_gamma_draws`."""
        return inverse_gamma_draws(rng, shape, scale, size)


class InverseGamma(pm.InverseGamma):
    """``pm.InverseGamma`` whose draws are finite also where a gamma draw is below the smallest double."""

    rv_op = InverseGammaRV()


class PositiveNormalRV(TruncatedNormalRV):
    """Draws of `PositiveNormal`."""


class PositiveNormal(pm.TruncatedNormal):
    """``pm.TruncatedNormal`` above zero that is sampled as its logarithm and starts at its mean."""

    rv_type = PositiveNormalRV
    rv_op = PositiveNormalRV()

    def support_point(rv, size, mu, sigma, lower, upper):  # type: ignore[no-untyped-def]
        return pt.zeros_like(rv) + pt.switch(mu > 0, mu, sigma)


@transforms._default_transform.register(PositiveNormalRV)
def _log(op: Op, rv: Any) -> Any:
    return transforms.log


class BetweenRV(TruncatedRV):
    """Draws of `Between`."""

    @classmethod
    def rv_op(cls, *arguments: Any, **settings: Any) -> Any:
        """That of ``pm.Truncated``, with an operation of this class."""
        made = TruncatedRV.rv_op(*arguments, **settings).owner
        return cls(
            base_rv_op=made.op.base_rv_op,
            max_n_steps=made.op.max_n_steps,
            inputs=made.op.inner_inputs,
            outputs=made.op.inner_outputs,
            ndim_supp=0,
        )(*made.inputs)


class Between(pm.Truncated):
    """``pm.Truncated`` of a distribution that PyMC has no truncated form of; starts inside its bounds."""

    rv_type = BetweenRV
    rv_op = BetweenRV.rv_op


@_support_point.register(BetweenRV)
def _inside(op: Op, rv: Any, *inputs: Any) -> Any:
    """PyMC's own point, half the width where the mean lies outside, and the middle where that does too."""
    *_, low, high = inputs
    own = truncated_support_point(op, rv, *inputs)
    return pt.switch(pt.and_(own > low, own < high), own, 0.5 * (low + high))
