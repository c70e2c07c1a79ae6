"""PyMC's NUTS as a step method of our chains: its metric begins with a Gaussian, and it counts solves."""

from __future__ import annotations

import warnings
from typing import Any

import pymc as pm
from pymc.blocking import RaveledVars
from pymc.step_methods.hmc.quadpotential import QuadPotentialFullAdapt

from zoo.core.arrays import Array
from zoo.core.in_numba import with_memory
from zoo.core.inference.logposterior import Point, count, counting_ops
from zoo.core.inference.spaces import Gaussian
from zoo.core.inference.steps import StepResult

TARGET_ACCEPT = 0.85
"""Mean acceptance along a trajectory that steps are adapted to: a little smaller steps than PyMC's."""
WEIGHT, WINDOW = 10.0, 50
"""Draws that a first metric counts for, and those of the first window after which it is forgotten."""


def dense_metric(mean: Array, covariance: Array) -> QuadPotentialFullAdapt:
    """A dense metric that begins with a covariance (n_dim, n_dim) and is adapted to the draws."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "QuadPotentialFullAdapt is", UserWarning)
        return QuadPotentialFullAdapt(len(mean), mean, covariance, WEIGHT, adaptation_window=WINDOW)


class Nuts(pm.NUTS):
    """NUTS with a model's own gradient.

    Statistics are those of `zoo.core.inference.steps.DEMetropolisZ`, where accept is the mean over the
    trajectory and accepted whether the chain moved; and diverging, and the gradients of each step.

    Parameters
    ----------
    model : pm.Model
    initial_point : dict
    reference : Gaussian
        Of the posterior, about: the metric begins with its covariance.
    **kwargs
        As `pm.NUTS`: target_accept, max_treedepth, rng.

    References
    ----------
    Hoffman, Gelman (2014), Journal of Machine Learning Research 15.
    """

    def __init__(self, *, model: Any, initial_point: Point, reference: Gaussian, **kwargs: Any) -> None:
        super().__init__(
            model=model,
            initial_point=initial_point,
            potential=dense_metric(reference.mean, reference.covariance),
            **{"target_accept": TARGET_ACCEPT, "mode": with_memory(), **kwargs},
        )
        self.potential.set_rng(self.rng.spawn(1)[0])
        self.replace_logp(self._logp_dlogp_func._pytensor_function)

    def replace_logp(self, function: Any) -> None:
        """Let a function of a vector (n_dim,) give the log-posterior and its gradient."""
        self._logp = function
        self._ops = counting_ops(function)
        self.integrator._logp_dlogp_func = lambda q, _: function(q)

    def astep(self, q0: RaveledVars) -> StepResult:
        """One step from q0; returns the new point and its statistics."""
        before, failed_before = count(self._ops)
        q, [stats] = super().astep(q0)
        after, failed_after = count(self._ops)
        return q, [
            {
                "accept": float(stats["mean_tree_accept"]),
                "accepted": stats["index_in_trajectory"] != 0,
                "solves": after - before,
                "solver_failures": sum((failed_after - failed_before).values()),
                "model_logp": float(stats["model_logp"]),
                "diverging": float(stats["diverging"]),
                "gradients": int(stats["tree_size"]) + 1,  # and that where it began
            }
        ]
