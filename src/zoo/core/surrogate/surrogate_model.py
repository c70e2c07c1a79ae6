"""A PyMC model with a surrogate where the forward model was, and a gradient."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from numpy.typing import ArrayLike
from pytensor.graph.traversal import applys_between

from zoo.core.arrays import Array
from zoo.core.errors.variables import ErrorTermsOp
from zoo.core.model import ModelRecord
from zoo.core.op import MissingGradientError
from zoo.core.parameters import random_variables
from zoo.core.surrogate.likelihood import Table
from zoo.core.surrogate.waveform import Surrogate


def log_likelihood(record: ModelRecord, series: Array, errors: Mapping[str, ArrayLike]) -> Array:
    """Log-likelihood (n,) of a model's data at series (n, n_series, n_times), -inf where these are NaN."""
    draws = {name: np.asarray(errors[name]) for name in record.errors.parameter_names}
    return record.errors.pointwise(series, draws, ["joint"])["joint"]


def surrogate_model(
    original: pm.Model, record: ModelRecord, surrogate: Surrogate, points: Array, power: float = 1.0
) -> pm.Model:
    """The model with its series from a surrogate: prior times likelihood to a power.

    Parameters
    ----------
    original : pm.Model
        Whose dimensions are taken.
    record : ModelRecord
        Of it.
    surrogate : Surrogate
    points : array (n, n_values)
        Of the posterior, where a table of the errors is tried.
    power : float
        Below 1 the posterior is wider than the exact one, so that draws reach all of that.

    Raises
    ------
    SurrogateError
        If the errors are not written in PyTensor and have no table.
    """
    bound = record.errors
    table = None if errors_in_graph(record) else Table.of(surrogate, bound, points)
    with pm.Model(coords=dict(original.coords)) as model:
        variables = random_variables(record.forward.parameters)
        of_errors = random_variables(bound.parameters)
        pm.Potential("inside", -surrogate.symbolic_fence(variables))
        if table is None:
            bound.observe("y", surrogate.symbolic_series(variables), pt.constant(np.int8(1)), of_errors)
            pm.Potential("wider", (power - 1.0) * model.observedlogp)
        else:
            a = surrogate.symbolic_coefficients(variables)
            pm.Potential("likelihood", power * table.symbolic(a, of_errors))
    return model


def errors_in_graph(record: ModelRecord) -> bool:
    """Whether the log-density of the errors is written in PyTensor, which is quick and has a gradient."""
    bound = record.errors
    with pm.Model(coords={"series": list(bound.on.labels), "time": bound.on.times}) as trial:
        shift = pm.Normal("shift")
        mean, ok = pt.constant(bound.on.values) + shift, pt.constant(np.int8(1))
        bound.observe("y", mean, ok, random_variables(bound.parameters))
    if any(isinstance(node.op, ErrorTermsOp) for node in applys_between([], [trial.logp()])):
        return False
    try:
        trial.dlogp()
    except (MissingGradientError, NotImplementedError):
        return False
    return True
