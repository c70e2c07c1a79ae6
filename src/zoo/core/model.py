"""A forward model, its priors and an error model as a PyMC model."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

import numpy as np
import pymc as pm
from numpy.typing import NDArray
from pytensor.tensor.variable import TensorVariable

from zoo.core.data import Data
from zoo.core.derivatives import has_jacobian
from zoo.core.errors.base import ErrorModel
from zoo.core.forward import ForwardModel
from zoo.core.op import ForwardOp, observed_series
from zoo.core.parameters import random_variables, start_of, variable_name

Constants = Mapping[str, tuple[tuple[str, ...], Any, str]]


class ModelError(ValueError):
    """A PyMC model that cannot be made or used; its text says what to change."""


class ForwardPyMCModel(pm.Model):
    """A PyMC model which says to ``pm.find_MAP`` where its forward model gives no derivatives.

    Without them PyMC minimizes each variable in turn, and may end far from the mode without a warning.
    """

    def dlogp(self, vars: Any = None, jacobian: bool = True) -> Any:
        """As any model's, or raise ModelError."""
        if has_jacobian(record_of(self).forward):
            return super().dlogp(vars, jacobian)
        raise ModelError(
            f"model {record_of(self).name}: has no gradient, and pm.find_MAP without one may end far from "
            "the mode; use zoo.find_mode(model)"
        )

    def to_graphviz(self, **options: Any) -> Any:
        """As any model's, or raise ModelError where the package graphviz is missing; warn where `dot` is."""
        for missing, remedy in missing_for_graphs().items():
            if missing == PACKAGE:
                raise ModelError(f"no {missing}: {remedy}")
            warnings.warn(f"no {missing}, which draws the graph: {remedy}", stacklevel=2)
        return super().to_graphviz(**options)


PACKAGE = "Python package graphviz"


def missing_for_graphs() -> dict[str, str]:
    """What a graph of a model needs and is not there, with its remedy."""
    found = {}
    if find_spec("graphviz") is None:
        found[PACKAGE] = "pip install 'pymc-zoo[graphviz]'"
    if shutil.which("dot") is None:
        found["program dot"] = "install Graphviz itself, such as by `apt install graphviz`"
    return found


@dataclass(frozen=True, eq=False)
class ModelRecord:
    """What a PyMC model is made of, as ``model.zoo``.

    Attributes
    ----------
    name : str
        "A" to "I", with "+effect" for each effect, or a user's.
    forward : ForwardModel
    data : Data
    errors : ErrorModel
        Bound to the data.
    mean, ok : TensorVariable
        The forward model's symbolic outputs.
    study : object
        Where the data come from, such as a `zoo.Study`; None for plain data.
    settings : mapping
        What else the model was made with, for the record of a run.
    constants : mapping
        Name -> (dimensions, values, unit) of what is known beside the data, for the group constant_data.
    places : mapping
        Name -> values, one for each series, by which `zoo.by_place` tells series apart, such as the vessel.
    """

    name: str
    forward: ForwardModel
    data: Data
    errors: ErrorModel
    mean: TensorVariable
    ok: TensorVariable
    study: Any = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    constants: Constants = field(default_factory=dict)
    places: Mapping[str, Sequence[Any]] = field(default_factory=dict)

    @property
    def op(self) -> ForwardOp:
        """The operation that solves."""
        op = self.mean.owner.op
        assert isinstance(op, ForwardOp)
        return op

    @property
    def forward_parameters(self) -> tuple[str, ...]:
        """Names of the variables that the forward model takes, those of effects last."""
        return tuple(variable_name(p.name) for p in self.forward.parameters)

    @property
    def error_parameters(self) -> tuple[str, ...]:
        """Names of the variables of the errors."""
        return tuple(variable_name(name) for name in self.errors.parameter_names)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of all free variables, those of the errors last."""
        return self.forward_parameters + self.error_parameters

    @property
    def priors(self) -> dict[str, str]:
        """Prior of each variable in words, and what is known of the errors, or held, instead."""
        both = (*self.forward.parameters, *self.errors.parameters)
        held = {name: f"held at {value:.10g}" for name, value in self.settings.get("held", {}).items()}
        return {variable_name(p.name): p.prior.text for p in both} | self.errors.fixed | held

    @property
    def suggested(self) -> dict[str, Any]:
        """Values of the variables that a search for the mode may start from."""
        both = start_of(self.forward.parameters) | start_of(self.errors.parameters)
        return {variable_name(name): value for name, value in both.items()}


def bayesian_model(
    name: str,
    forward: ForwardModel,
    data: Data,
    errors: ErrorModel,
    *,
    coords: Mapping[str, Any] | None = None,
    study: Any = None,
    settings: Mapping[str, Any] | None = None,
    constants: Constants | None = None,
    places: Mapping[str, Sequence[Any]] | None = None,
) -> pm.Model:
    """A PyMC model of data: priors of all parameters, the forward model, and the errors.

    Parameters
    ----------
    name : str
    forward : ForwardModel
        Its outputs are the data's series and times.
    data : Data
    errors : ErrorModel
    coords : mapping
        Coordinates of the dimensions of vector parameters, such as {"vessel": ids}; 0, 1, ... if absent.
    study : object
        For the record.
    settings : mapping
        For the record.
    constants : mapping
        Name -> (dimensions, values, unit), for the record.
    places : mapping
        Name -> values, one for each series, for the record.

    Returns
    -------
    pm.Model
        With variables for all parameters and the observed "y" (series, time); ``model.zoo`` is its record.

    Raises
    ------
    ModelError
        If the forward model's outputs do not fit the data.
    """
    if forward.outputs.shape != data.values.shape:
        raise ModelError(
            f"{data.source or data.name}: {forward.name} gives series {forward.outputs.shape}, the data are "
            f"{data.values.shape}: ask the forward model for the data's series and times"
        )
    bound = errors.bind(data)
    counted = {p.dims: np.arange(p.size) for p in (*forward.parameters, *bound.parameters) if p.dims}
    own = {"series": list(data.labels), "time": np.asarray(data.times)}
    with ForwardPyMCModel(coords={**counted, **own, **dict(coords or {})}) as model:
        variables = random_variables(forward.parameters)
        mean, ok = observed_series(forward, variables)
        bound.observe("y", mean, ok, random_variables(bound.parameters))
    model.zoo = ModelRecord(
        name,
        forward,
        data,
        bound,
        mean,
        ok,
        study,
        dict(settings or {}),
        dict(constants or {}),
        dict(places or {}),
    )
    return model


def record_of(model: pm.Model) -> ModelRecord:
    """The record of a model made by `bayesian_model`.

    Raises
    ------
    ModelError
        If the model has none.
    """
    record = getattr(model, "zoo", None)
    if not isinstance(record, ModelRecord):
        raise ModelError("this PyMC model has no record: make it with zoo.bayesian_model")
    return record


def theta_of(record: ModelRecord, draws: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Forward parameters (n, n_values) of draws, variable -> (n_chains, n_draws, ...) or (n, ...)."""
    parts = []
    for p in record.forward.parameters:
        parts.append(np.asarray(draws[variable_name(p.name)], dtype=np.float64).reshape(-1, p.size))
    return np.concatenate(parts, axis=1)
