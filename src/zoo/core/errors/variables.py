"""Error models as PyMC variables.

The random variables are classes of this module (a ``pm.CustomDist`` makes its class on the fly), so that a
model unpickled in another process still finds its log-density.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NoReturn, cast

import numpy as np
import pytensor
import pytensor.tensor as pt
from pymc.distributions.distribution import Continuous
from pymc.logprob.abstract import _logprob
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op
from pytensor.graph.traversal import ancestors
from pytensor.link.numba.dispatch.basic import numba_njit
from pytensor.tensor.random.op import RandomVariable

from zoo.core.arrays import Array
from zoo.core.errors.base import ErrorModel, TermsInNumba
from zoo.core.in_numba import called_as_python, compiled_by, joined, own, without_python
from zoo.core.op import mark_without_gradient, missing_gradient

_LOG_2PI = math.log(2.0 * math.pi)


@called_as_python
class IidErrorsRV(RandomVariable):
    """Draws of `IidErrors`."""

    name = "iid_errors"
    signature = "(),(),()->()"
    dtype = "float64"
    _print_name = ("IidErrors", "\\operatorname{IidErrors}")

    @classmethod
    def rng_fn(cls, rng: np.random.Generator, mean: Array, ok: Any, sigma2: Array, size: Any = None) -> Array:
        """NaN where the solve failed."""
        draw = rng.normal(mean, np.sqrt(sigma2), size=size)
        return np.where(ok, draw, np.nan)


class IidErrors(Continuous):
    """Independent normal errors of variance sigma2 around computed series; density 0 where ok is 0.

    An observed value that is infinite was not measured, and has no part in the density.
    """

    rv_op = IidErrorsRV()

    @classmethod
    def dist(cls, mean: Any, ok: Any, sigma2: Any, **kwargs: Any) -> Any:
        """Mean (n_series, n_times), scalars ok and sigma2."""
        mark_without_gradient([sigma2])
        return super().dist([mean, ok, sigma2], **kwargs)

    def support_point(rv, size, mean, ok, sigma2):  # type: ignore[no-untyped-def]
        """The mean."""
        return mean

    def logp(value, mean, ok, sigma2):  # type: ignore[no-untyped-def]
        """Log-density of each sample; 0 where none was measured, minus infinity where the solve failed."""
        terms = -0.5 * (_LOG_2PI + pt.log(sigma2) + (value - mean) ** 2 / sigma2)
        return pt.switch(ok, pt.switch(pt.isinf(value), 0.0, terms), -np.inf)


def _values(errors: ErrorModel, parameters: Sequence[Any]) -> dict[str, Any]:
    return dict(zip(errors.parameter_names, parameters, strict=True))


@called_as_python
class ErrorTermsOp(Op):
    """Sequential terms of an error model: residual (n_series, n_times), parameters.

    It has a gradient where the error model gives one (`ErrorModel.gradient`).

    Parameters
    ----------
    errors : ErrorModel
        Bound to data.
    """

    __props__ = ("errors",)

    def __init__(self, errors: ErrorModel) -> None:
        self.errors = errors

    def make_node(self, *inputs: Any) -> Apply:
        """A matrix, and a scalar or vector for each parameter in; a matrix out."""
        tensors = [pt.as_tensor_variable(x, dtype="float64") for x in inputs]
        ndims = [x.ndim for x in tensors]
        wanted = [2, *(1 if p.dims else 0 for p in self.errors.parameters)]
        if ndims != wanted:
            names = ", ".join(("residual", *self.errors.parameter_names))
            raise ValueError(f"dimensions {ndims} of {names}: must be {', '.join(map(str, wanted))}")
        return Apply(self, tensors, [tensors[0].type()])

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[Any]]) -> None:
        """Evaluate."""
        residual, *parameters = inputs
        terms = self.errors.terms(residual, _values(self.errors, parameters))
        output_storage[0][0] = np.asarray(terms, dtype=np.float64)

    def infer_shape(self, *graph_node_shapes: Any) -> list[Any]:
        """That of the residual; PyTensor 3 does not give the graph."""
        return [graph_node_shapes[-1][0]]

    def L_op(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], output_grads: Sequence[Variable]
    ) -> list[Variable]:
        """Vector-Jacobian product of the terms.

        Raises
        ------
        MissingGradientError
            If the error model gives no gradient.
        """
        if not self.errors.differentiable:
            raise missing_gradient(f"the log-likelihood of the error model {self.errors.name}")
        return cast(
            "list[Variable]", ErrorGradientOp(self.errors)(*inputs, output_grads[0], return_list=True)
        )

    pullback = L_op  # its name in PyTensor 3


@called_as_python
class ErrorGradientOp(Op):
    """Gradient of sum_i g_i term_i of an error model, by the residual and by each parameter.

    Takes the inputs of `ErrorTermsOp` and g (n_series, n_times); gives one output for each of the former.

    Parameters
    ----------
    errors : ErrorModel
        Bound to data, with a gradient.
    """

    __props__ = ("errors",)

    def __init__(self, errors: ErrorModel) -> None:
        self.errors = errors

    def make_node(self, *inputs: Any) -> Apply:
        """As many gradients out as there are inputs but for the last."""
        tensors = [pt.as_tensor_variable(x, dtype="float64") for x in inputs]
        return Apply(self, tensors, [pt.tensor(dtype="float64", shape=x.type.shape) for x in tensors[:-1]])

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[Any]]) -> None:
        """Evaluate."""
        residual, *parameters, weight = inputs
        by_residual, found = self.errors.gradient(residual, _values(self.errors, parameters), weight)
        gradients = [by_residual, *(found[name] for name in self.errors.parameter_names)]
        for storage, gradient in zip(output_storage, gradients, strict=True):
            storage[0] = np.asarray(gradient, dtype=np.float64)

    def L_op(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], output_grads: Sequence[Variable]
    ) -> NoReturn:
        """Raise MissingGradientError: there are no second derivatives."""
        raise missing_gradient(f"the gradient of the error model {self.errors.name}")

    pullback = L_op


@compiled_by
class TermsOp(Op):
    """What takes the place of `ErrorTermsOp` and `ErrorGradientOp` where numba compiles: no Python.

    Takes residual, the parameters' values (n_values,) and, with a gradient, weight; returns the terms and
    then the gradient by residual and by values.

    Parameters
    ----------
    errors : ErrorModel
        Bound to data, with functions for numba.
    gradient : bool
    """

    __props__ = ("errors", "gradient")

    def __init__(self, errors: ErrorModel, gradient: bool) -> None:
        self.errors, self.gradient = errors, gradient

    def make_node(self, *inputs: Any) -> Apply:
        """One output, or three."""
        return Apply(
            self, list(inputs), [x.type() for x in (inputs[0], *(inputs[:2] if self.gradient else ()))]
        )

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[Any]]) -> None:
        """Evaluate with Python what numba would compile."""
        found = self.function().py_func(*inputs)
        for storage, value in zip(output_storage, found if self.gradient else (found,), strict=True):
            storage[0] = value

    def function(self) -> Any:
        """What numba compiles."""
        functions: TermsInNumba | None = own("in_numba", self.errors)
        assert functions is not None
        terms, gradient = functions

        @numba_njit
        def alone(residual, values):  # type: ignore[no-untyped-def]
            return terms(residual, values)

        @numba_njit
        def both(residual, values, weight):  # type: ignore[no-untyped-def]
            return gradient(residual, values, weight)

        return both if self.gradient else alone


@without_python(ErrorTermsOp, ErrorGradientOp)
def terms_without_python(fgraph: Any, node: Apply) -> dict[Variable, Variable] | None:
    """The terms and their gradient, where that is asked for, of one factorisation."""
    errors = cast("ErrorTermsOp | ErrorGradientOp", node.op).errors
    if own("in_numba", errors) is None:
        return None
    inputs = node.inputs[: 1 + len(errors.parameters)]
    beside = [one for one, _ in fgraph.clients[inputs[0]] if one.inputs[: len(inputs)] == inputs]
    terms = [one for one in beside if one.op == ErrorTermsOp(errors)]
    gradients = [one for one in beside if one.op == ErrorGradientOp(errors)]
    replaced: list[Variable] = [one.outputs[0] for one in terms]
    given = inputs[0], joined(inputs[1:])
    if not gradients:
        return dict.fromkeys(replaced, cast(Variable, TermsOp(errors, False)(*given)))
    one = node if node in gradients else gradients[0]
    if set(replaced) & set(ancestors([one.inputs[-1]])):
        return None  # terms that are weighted by what follows from them
    found: list[Any] = TermsOp(errors, True)(*given, one.inputs[-1], return_list=True)  # type: ignore[assignment]
    at, by_parameter = 0, []
    for p in errors.parameters:
        by_parameter.append(found[2][at : at + p.size] if p.dims else found[2][at])
        at += p.size
    return dict.fromkeys(replaced, found[0]) | dict(zip(one.outputs, (found[1], *by_parameter), strict=True))


@called_as_python
class ErrorsRV(RandomVariable):
    """Draws of `Errors`.

    Parameters
    ----------
    errors : ErrorModel
        Bound to data.
    """

    name = "errors"
    dtype = "float64"
    _print_name = ("Errors", "\\operatorname{Errors}")
    __props__ = ("errors", "inplace")  # type: ignore[assignment]

    def __init__(self, errors: ErrorModel, inplace: bool = False) -> None:
        self.errors = errors
        parameters = [f"(p{i})" if p.dims else "()" for i, p in enumerate(errors.parameters)]
        signature = ",".join(["(s,t)", "()", *parameters]) + "->(s,t)"
        super().__init__(signature=signature, inplace=inplace)

    def rng_fn(self, rng: np.random.Generator, *arguments: Any, **settings: Any) -> Array:
        """NaN where the solve failed or there is no law."""
        *inputs, size = (*arguments, settings["size"]) if "size" in settings else arguments
        mean = np.asarray(inputs[0])
        if size is not None:
            mean = np.broadcast_to(mean, (*size, *mean.shape[-2:]))

        def draw(mean: Array, ok: Any, *parameters: Any) -> Array:
            z = rng.standard_normal(mean.shape)
            drawn = self.errors.unwhiten(z, _values(self.errors, parameters)) if ok else None
            return np.full(mean.shape, np.nan) if drawn is None else mean + drawn

        return np.asarray(np.vectorize(draw, signature=self.signature)(mean, *inputs[1:]))


class Errors(Continuous):
    """Any error model around computed series, its density 0 where ok is 0.

    The log-density is left as its sequential terms, (n_series, n_times).
    """

    rv_type = ErrorsRV

    @classmethod
    def rv_op(cls, *inputs: Any, errors: ErrorModel, size: Any = None, rng: Any = None) -> Any:
        """Variable of mean, ok and the errors' parameters."""
        rng = pytensor.shared(np.random.default_rng()) if rng is None else rng
        return ErrorsRV(errors).make_node(rng, size, *inputs).default_output()

    @classmethod
    def dist(cls, mean: Any, ok: Any, *parameters: Any, errors: ErrorModel, **kwargs: Any) -> Any:
        """Mean (n_series, n_times), scalar ok, and the errors' parameters in their order."""
        mark_without_gradient(parameters)
        return super().dist([mean, ok, *parameters], errors=errors, **kwargs)

    def support_point(rv, size, mean, ok, *parameters):  # type: ignore[no-untyped-def]
        """The mean."""
        return mean


@_logprob.register(ErrorsRV)
def _log_terms(op: ErrorsRV, values: Sequence[Any], *inputs: Any, **settings: Any) -> Any:
    _, _, mean, ok, *parameters = inputs
    return pt.switch(ok, ErrorTermsOp(op.errors)(values[0] - mean, *parameters), -np.inf)
