"""PyMC's NUTS in a model with a gradient, from given points and with a given metric."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from zoo.core.arrays import Array
from zoo.core.arviz_lines import dataset
from zoo.core.inference.gradient_step import TARGET_ACCEPT, dense_metric
from zoo.core.inference.messages import without_messages

Draws = dict[str, Array]


def nuts(
    model: Any,
    names: Sequence[str],
    covariance: Array,
    starts: Array,
    values: Draws,
    *,
    draws: int,
    tune: int,
    cores: int,
    seed: int,
) -> Draws:
    """NUTS in a model with a gradient, a chain from each start.

    Parameters
    ----------
    model : pm.Model
    names : sequence of str
        Of the variables whose draws are wanted.
    covariance : array (n_dim, n_dim)
        Of the posterior, about: the metric begins with it.
    starts : array (n_chains, n_dim)
        In the unconstrained space.
    values : dict
        The same points, each variable in its own unit.
    draws, tune, cores, seed : int

    Returns
    -------
    dict
        Variable -> (n_chains, n_draws, ...).

    References
    ----------
    Hoffman, Gelman (2014), Journal of Machine Learning Research 15.
    """
    import pymc as pm

    with without_messages("pymc", logging.ERROR), warnings.catch_warnings(), model:
        warnings.filterwarnings("ignore", "PyTensor could not link to a BLAS", UserWarning)
        step = pm.NUTS(
            potential=dense_metric(np.mean(starts, axis=0), covariance), target_accept=TARGET_ACCEPT
        )
        found = pm.sample(
            draws=draws,
            tune=tune,
            chains=len(starts),
            cores=max(1, min(cores, len(starts))),
            step=step,
            initvals=[{name: column[i] for name, column in values.items()} for i in range(len(starts))],
            random_seed=seed,
            progressbar=False,
            compute_convergence_checks=False,
        )
    posterior = dataset(found)
    return {name: posterior[name].transpose("chain", "draw", ...).to_numpy() for name in names}
