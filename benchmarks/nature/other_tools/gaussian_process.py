"""Kennedy and O'Hagan's discrepancy in PyMC: y = simulator(theta) + delta(inputs) + noise, fitted jointly.

delta is a Gaussian process of the record's inputs with a length for each, exact, not approximated. Theta, the
process's size and lengths and the noise are at their joint mode (pm.find_MAP). In the held-out record delta
is its conditional mean. References: Kennedy and O'Hagan 2001, doi 10.1111/1467-9868.00294.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pymc as pm
from benchmarks.nature.other_tools import FARTHEST, Answer, Array, Record, central, rms

from zoo import FunctionModel, Normal, Outputs, Parameter
from zoo.core.op import observed_series
from zoo.core.parameters import random_variables

PACKAGES = ("pymc",)


class Differenced(FunctionModel):
    """A function with derivatives by central differences."""

    def solve_derivatives(self, configure, theta, scales, outputs=None):  # type: ignore[no-untyped-def]
        """Series and their slopes along each parameter."""
        solve = lambda u: self.solve(configure(u))  # noqa: E731
        return solve(theta), central(solve, theta)


class Series(pm.gp.mean.Mean):
    """A mean function that is the simulator's series."""

    def __init__(self, series: Any) -> None:
        self.series = series

    def __call__(self, X: Any) -> Any:
        """The series, whatever the inputs."""
        return self.series


def fit_jointly(record: Record) -> tuple[dict[str, Any], Callable[[Array], Array]]:
    """The joint mode, and the discrepancy's conditional mean (n,) from a base's series."""
    part, base = record.fitted, record.compute(record.fitted, record.base)
    middle, spread = part.inputs(base).mean(axis=0), part.inputs(base).std(axis=0)
    X, size = (part.inputs(base) - middle) / spread, rms(part.measured - base)
    simulate = lambda c, t: part.simulate(record.parameters(list(c.values())), t)  # noqa: E731
    own = tuple(Parameter(name, Normal(0.0, 1.0, -FARTHEST, FARTHEST)) for name in record.priors)
    with pm.Model() as model:
        forward = Differenced(simulate, own, Outputs(("y",), part.times))
        series = observed_series(forward, random_variables(own)).mean[0]
        delta, noise = pm.HalfNormal("delta", 2.0 * size), pm.HalfNormal("noise", size)
        covariance = delta**2 * pm.gp.cov.Matern52(
            X.shape[1], ls=pm.LogNormal("lengths", 0.0, 1.0, shape=X.shape[1])
        )
        both = pm.gp.Marginal(mean_func=Series(series), cov_func=covariance)
        both.marginal_likelihood("y", X, part.measured, noise)
        start = dict(zip(record.priors, record.base, strict=True))
        mode = pm.find_MAP(start=start | {"delta": size, "noise": 0.3 * size}, progressbar=False)
    alone = pm.gp.Marginal(cov_func=covariance)
    given = {"gp": alone, "X": X, "y": part.measured - series, "sigma": noise}

    def conditional(base: Array, part: Any = record.held_out) -> Array:
        at = (part.inputs(base) - middle) / spread
        with model:
            return np.asarray(alone.predict(at, mode, diag=True, given=given)[0])

    return mode, conditional


def answer(record: Record) -> Answer:
    """Fit jointly, and carry the discrepancy over to the record that is held out."""
    mode, conditional = fit_jointly(record)
    nearest = record.inputs[int(np.argmin(mode["lengths"]))]
    says = f"nothing; size {mode['delta']:.2g} {record.unit}, changes most with {nearest}"
    u = np.array([float(mode[name]) for name in record.priors])
    return Answer(says, record.predict(u, conditional))
