"""The models A to I as they are made today, by functions; `Independent` and `GaussianProcess` follow them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pymc as pm
from numpy.typing import ArrayLike, NDArray
from pytensor.tensor.variable import TensorVariable

from zoo.blood.network import Network
from zoo.blood.op import BloodFlowOp
from zoo.blood.solver import SolverOptions
from zoo.core.data import Data
from zoo.core.distributions import LogUniform as LogUniform
from zoo.core.errors.base import DECOMPOSITIONS as DECOMPOSITIONS
from zoo.core.errors.base import ErrorModel
from zoo.core.errors.gaussian_process import JITTER as JITTER
from zoo.core.errors.gaussian_process import NOISE_VARIANCE as NOISE_VARIANCE
from zoo.core.errors.gaussian_process import GaussianProcess
from zoo.core.errors.gaussian_process import gp_leave_one_out as gp_leave_one_out
from zoo.core.errors.gaussian_process import gp_sequential as gp_sequential
from zoo.core.errors.gaussian_process import neural_network_kernel as neural_network_kernel
from zoo.core.errors.independent import Independent
from zoo.core.errors.independent import iid_terms as iid_terms
from zoo.core.errors.variables import IidErrors as IidErrors
from zoo.core.parameters import LogUniform as LogUniformPrior
from zoo.core.parameters import random_variables

if TYPE_CHECKING:
    from zoo.blood.study import Study

Array = NDArray[np.float64]

W_RANGE = (1e4, 9e4)  # weight variance, s-2
B_RANGE = (1.0, 500.0)  # bias variance
INVERSE_GAMMA = (0.001, 0.001)  # shape, and scale in the squared unit of the series

ERROR_PARAMETERS = {"iid": ("sigma2",), "gp": ("w", "b")}
_PRIORS = LogUniformPrior(*W_RANGE), LogUniformPrior(*B_RANGE)


def _data(study: Study) -> Data:
    quantities = [series.quantity for series in study.series]
    return Data(
        study.time_s,
        study.values,
        labels=[series.label for series in study.series],
        units=[quantity.partition("_")[2] for quantity in quantities],
        groups=quantities,
        name=study.name,
        source=str(study.source),
    )


def whiten(
    error: str, residuals: Array, time_s: ArrayLike, parameters: Mapping[str, ArrayLike]
) -> Array | None:
    """`ErrorModel.whiten` of the model called "iid" or "gp", for residuals (..., n_times)."""
    time_s = np.asarray(time_s, dtype=np.float64)
    errors = Independent() if error == "iid" else GaussianProcess(*_PRIORS)
    return errors.bind(Data(time_s, np.zeros((1, len(time_s))))).whiten(residuals, parameters)


# ---------------------------------------------------------------------------------------------------
# What a model file uses


@dataclass(frozen=True)
class ModelRecord:
    """What a model is made of, as ``model.zoo``.

    `name` is "A" to "I" or a user's; `error` is "iid" or "gp"; `parameters` are the names of all free
    parameters, those of the errors last; `mean` and `ok` are the solver's symbolic outputs; `suggested`
    are values of the parameters that a search for the mode may start from.
    """

    name: str
    study: Study
    error: str
    parameters: tuple[str, ...]
    mean: TensorVariable
    ok: TensorVariable
    suggested: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def data(self) -> Data:
        """What is observed."""
        return _data(self.study)

    @cached_property
    def errors(self) -> ErrorModel:
        """Bound to the data."""
        model: ErrorModel = Independent() if self.error == "iid" else GaussianProcess(*_PRIORS, unit="mmHg")
        return model.bind(self.data)

    @property
    def op(self) -> BloodFlowOp:
        """The operation that solves."""
        op = self.mean.owner.op
        assert isinstance(op, BloodFlowOp)
        return op

    @property
    def wall(self) -> str:
        """Either "linear" or "tangent"."""
        return self.op.solver.wall

    @property
    def options(self) -> SolverOptions:
        """Numerical settings."""
        return self.op.solver.options

    @property
    def error_parameters(self) -> tuple[str, ...]:
        """Names of the parameters of the errors."""
        return ERROR_PARAMETERS[self.error]


def study_model(name: str, study: Study, suggested: Mapping[str, float] | None = None) -> pm.Model:
    """Empty PyMC model with the dimensions of a study: vessel (ids), series (labels), time (s).

    Parameters
    ----------
    name : str
        Of the model, for its record ``model.zoo``.
    study : Study
        Vessels and observations.
    suggested : mapping of name to float
        Values of the parameters to start from, for the record.

    Returns
    -------
    pm.Model
    """
    coords = {
        "vessel": [int(i) for i in Network.from_study(study).ids],
        "series": [series.label for series in study.series],
        "time": np.asarray(study.time_s),
    }
    model = pm.Model(coords=coords)
    model.zoo_identity = {"name": name, "suggested": dict(suggested or {})}
    return model


def iid_errors(mean: TensorVariable, ok: TensorVariable, study: Study) -> TensorVariable:
    """Observe the study's series with independent normal errors: adds "sigma2" and "y" to the model.

    y_i ~ N(mean_i, sigma2), sigma2 ~ InverseGamma(0.001, 0.001); density 0 where the solve failed.

    Parameters
    ----------
    mean, ok : TensorVariable
        From ``blood_flow``.
    study : Study
        Measured series, all of one quantity.

    Returns
    -------
    TensorVariable (n_series, n_times)
        "y".

    Raises
    ------
    ValueError
        If the series have different quantities.

    References
    ----------
    Paun et al. 2020, eq. (4.5), doi 10.1098/rsif.2020.0886.
    """
    errors = Independent().bind(_data(study))
    y: TensorVariable = errors.observe("y", mean, ok, random_variables(errors.parameters))
    _record("iid", mean, ok, study)
    return y


def gp_errors(
    mean: TensorVariable,
    ok: TensorVariable,
    study: Study,
    *,
    w_range: tuple[float, float] = W_RANGE,
    b_range: tuple[float, float] = B_RANGE,
) -> TensorVariable:
    """Observe the study's series with a Gaussian process around each: adds "w", "b" and "y" to the model.

    y ~ MVN(mean, K(w, b) + (2.44e-6 + 1e-6 mmHg2) I) with the neural-network kernel, independently for
    each series; w and b log-uniform; density 0 where the solve failed. The log-density of "y" is left
    as its sequential terms log p(y_i | y_<i), (n_series, n_times).

    Parameters
    ----------
    mean, ok : TensorVariable
        From ``blood_flow``.
    study : Study
        Measured pressures, mmHg.
    w_range : (lower, upper)
        Of the variance of the weights, s-2.
    b_range : (lower, upper)
        Of the variance of the bias.

    Returns
    -------
    TensorVariable (n_series, n_times)
        "y".

    Raises
    ------
    ValueError
        If a series is no pressure: the kernel's amplitude and the noise are in mmHg2.

    References
    ----------
    Paun et al. 2020, eq. (4.6), doi 10.1098/rsif.2020.0886.
    """
    priors = LogUniformPrior(*w_range), LogUniformPrior(*b_range)
    errors = GaussianProcess(*priors, unit="mmHg").bind(_data(study))
    y: TensorVariable = errors.observe("y", mean, ok, random_variables(errors.parameters))
    _record("gp", mean, ok, study)
    return y


def _record(error: str, mean: TensorVariable, ok: TensorVariable, study: Study) -> None:
    model = pm.modelcontext(None)
    model.zoo = ModelRecord(
        **getattr(model, "zoo_identity", {"name": "custom"}),
        study=study,
        error=error,
        parameters=tuple(rv.name for rv in model.free_RVs),
        mean=mean,
        ok=ok,
    )
