"""Any forward model as a PyTensor operation: its parameters in, the observed series out."""

from __future__ import annotations

import os
import threading
import uuid
import weakref
from collections import Counter, OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, NoReturn, cast

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import DisconnectedType
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op
from pytensor.graph.traversal import ancestors
from pytensor.link.numba.dispatch.basic import numba_njit
from pytensor.tensor.variable import TensorVariable

from zoo.core.arrays import Array, real_array
from zoo.core.derivatives import has_jacobian, jacobian
from zoo.core.forward import ForwardModel, InNumba, SolveError, content_key
from zoo.core.in_numba import add, called_as_python, compiled_by, joined, own, without_python
from zoo.core.parameters import n_values

CACHE_SIZE = 8
COUNTED = 64
"""Kinds of failures that are counted without Python, at most."""


class MissingGradientError(AttributeError):
    """A gradient was asked of an operation that has none."""

    def __init__(self, op: str) -> None:
        super().__init__(
            f"{op} has no gradient: sample with `zoo.sample(model)` or `pm.sample(step=zoo.step(model))`, "
            "and find the mode with `zoo.find_mode(model)`"
        )


class OtherStepError(MissingGradientError, NotImplementedError):
    """The same, when PyMC knows a step method for it: a NotImplementedError makes it look for one."""


def missing_gradient(op: str) -> MissingGradientError:
    """What an operation without a gradient raises.

    PyMC takes a NotImplementedError as "use another step method". It would choose Slice, which solves 18
    times a step without a word, so it only gets one when `zoo.core.inference.pymc_step` is among its methods.
    """
    from pymc.step_methods import STEP_METHODS

    known = any(getattr(method, "for_forward_models", False) for method in STEP_METHODS)
    return (OtherStepError if known else MissingGradientError)(op)


def mark_without_gradient(variables: Iterable[Any]) -> None:
    """Note on variables, and on all they are made of, that what follows from them has no gradient."""
    for variable in ancestors([pt.as_tensor_variable(variable) for variable in variables]):
        variable.tag.without_gradient = True


def without_gradient(variable: Any) -> bool:
    """Whether `mark_without_gradient` was called for a variable."""
    return bool(getattr(variable.tag, "without_gradient", False))


class _State:
    """What the copies of one operation share in a process: solved points and counts."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.cache: OrderedDict[bytes, tuple[Array, bool]] = OrderedDict()
        self.slopes: OrderedDict[bytes, Array] = OrderedDict()
        self.asked = False  # whether slopes were asked at the last point that was solved
        self.counts: Counter[str] = Counter()
        self.failures: Counter[str] = Counter()
        self.without_python = np.zeros(COUNTED, dtype=np.int64)  # solves, and failed ones by status from 1 on

    def clear(self) -> None:
        self.lock = threading.Lock()
        self.cache.clear()
        self.slopes.clear()
        self.asked = False
        self.counts.clear()
        self.failures.clear()
        self.without_python[:] = 0


_states: weakref.WeakValueDictionary[str, _State] = weakref.WeakValueDictionary()


def _clear_states() -> None:
    for state in list(_states.values()):
        state.clear()


# a forked process counts its own solves, and must not inherit a lock that another thread held
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_clear_states)


@called_as_python
class ForwardOp(Op):
    """A forward model's observed series as a PyTensor operation.

    It has a gradient where the forward model gives derivatives (`zoo.core.derivatives`): vector-Jacobian
    products (`L_op`), of which PyTensor makes Jacobian-vector products too. Zero where a solve fails.

    Takes one float64 input for each parameter, a scalar or a vector of its size, in the model's order.
    Returns `mean`, float64 (n_series, n_times), each series in its own unit, and `ok`, an int8 scalar: 1, or
    0 when the solve failed and `mean` is zero.

    The last few points are kept, so PyMC's repeated evaluations of a point cost one solve, and a change of
    hyperparameters none. Copies of an operation (in compiled functions, after unpickling) share these points
    and the counts; another operation never does, even of a forward model with the same key.

    Parameters
    ----------
    model : ForwardModel
        With at least one parameter and one observed series.

    Raises
    ------
    ValueError
        If there is no parameter or no series.
    """

    __props__ = ("key", "token")

    def __init__(self, model: ForwardModel) -> None:
        if not model.parameters or not model.outputs.series:
            raise ValueError(
                f"{model.name}: {len(model.parameters)} parameters and {len(model.outputs.series)} series: a "
                "forward model needs at least one of each"
            )
        self.model = model
        self.key = content_key(model.key, model.outputs)
        self.token = uuid.uuid4().hex
        self._read = np.concatenate([np.full(p.size, not p.hyper) for p in model.parameters])
        self._attach()

    def _attach(self) -> None:
        self._state = _states.setdefault(self.token, _State())

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_state", "in_numba")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._attach()

    @property
    def shape(self) -> tuple[int, int]:
        """(n_series, n_times)."""
        return self.model.outputs.shape

    @property
    def counts(self) -> dict[str, Any]:
        """Evaluations, solves, and failed solves by kind, in this process."""
        state = self._state
        solves, *failed = state.without_python.tolist()
        kinds = self.in_numba.failures if self.in_numba is not None and any(failed) else ()
        failures = state.failures + Counter(dict(zip(kinds, failed, strict=False)))
        return {
            "evaluations": state.counts["evaluations"] + solves,
            "solves": state.counts["solves"] + solves,
            "failures": dict(failures),
        }

    @cached_property
    def in_numba(self) -> InNumba | None:
        """The forward model as functions that numba compiles, if it has them."""
        found: InNumba | None = own("in_numba", self.model)
        return found if found is None or len(found.failures) < COUNTED else None

    def evaluate(self, theta: Array) -> tuple[Array, bool]:
        """Mean and ok at one point, from the kept points or by a solve.

        Parameters
        ----------
        theta : array (n_values,)
            Parameters in the model's order.

        Returns
        -------
        mean : array (n_series, n_times)
            Read-only; zeros when the solve failed.
        ok : bool

        Raises
        ------
        ValueError
            If theta has another length, or is not made of real numbers.
        """
        theta = real_array(f"{self.model.name}: theta", theta)
        if theta.shape != (n_values(self.model.parameters),):
            names = ", ".join(p.name for p in self.model.parameters)
            raise ValueError(f"{theta.size} values for {n_values(self.model.parameters)}: give {names}")
        point = theta[self._read].tobytes()
        state = self._state
        with state.lock:
            state.counts["evaluations"] += 1
            if point in state.cache:
                state.cache.move_to_end(point)
                return state.cache[point]
            # where slopes were asked at the last point they will be here: then one run gives both
            both, state.asked = state.asked and self.differentiable, False
        mean, ok, _ = self._solve(theta, point, slopes=both)
        return mean, ok

    def _solve(self, theta: Array, point: bytes, *, slopes: bool) -> tuple[Array, bool, Array | None]:
        """Solve and keep; slopes (n_values, n_series, n_times), zero where the solve failed, or None."""
        failure, found = None, None
        mean = np.zeros(self.shape)
        try:
            if slopes:
                both = jacobian(self.model, theta)
                assert both is not None
                mean, found = np.array(both.values), np.array(both.slopes)
            else:
                mean = np.array(self.model.solve(self.model.configure(theta)), dtype=np.float64)
            if mean.shape != self.shape:
                raise ValueError(f"{self.model.name}: series of shape {mean.shape}, wanted {self.shape}")
            if not np.all(np.isfinite(mean)):
                failure = "not-finite"
        except SolveError as error:
            failure = error.kind
            if slopes and failure == "no-derivative":
                raise
        if failure:
            mean = np.zeros(self.shape)
            found = np.zeros((len(theta), *self.shape)) if slopes else None
        mean.flags.writeable = False
        state = self._state
        with state.lock:
            state.counts["solves"] += 1
            if failure:
                state.failures[failure] += 1
            state.cache[point] = mean, failure is None
            if found is not None:
                found.flags.writeable = False
                state.counts["gradients"] += 1
                state.slopes[point] = found
            every: tuple[OrderedDict[bytes, Any], ...] = state.cache, state.slopes
            for kept in every:
                while len(kept) > CACHE_SIZE:
                    kept.popitem(last=False)
        return mean, failure is None, found

    @property
    def differentiable(self) -> bool:
        """Whether the forward model gives derivatives."""
        return has_jacobian(self.model)

    def slopes(self, theta: Array) -> Array:
        """Derivatives of the mean by each element of theta, from the kept points or by a solve.

        Parameters
        ----------
        theta : array (n_values,)

        Returns
        -------
        array (n_values, n_series, n_times)
            Read-only; zeros when the solve failed.

        Raises
        ------
        MissingGradientError
            If the forward model gives no derivatives.
        SolveError
            Of the kind "no-derivative", if this point has none.
        """
        if not self.differentiable:
            raise missing_gradient(f"the forward model {self.model.name}")
        theta = np.asarray(theta, dtype=np.float64)
        point = theta[self._read].tobytes()
        with self._state.lock:
            self._state.asked = True
            if point in self._state.slopes:
                self._state.slopes.move_to_end(point)
                return self._state.slopes[point]
        found = self._solve(theta, point, slopes=True)[2]
        self._state.asked = True
        assert found is not None
        return found

    def make_node(self, *inputs: Any) -> Apply:
        """One input for each parameter; mean and ok out."""
        parameters = self.model.parameters
        if len(inputs) != len(parameters):
            raise ValueError(f"{len(inputs)} inputs: must be {', '.join(p.name for p in parameters)}")
        tensors = []
        for p, value in zip(parameters, inputs, strict=True):
            tensor = pt.as_tensor_variable(value, dtype="float64")
            wanted = 1 if p.dims else 0
            if tensor.ndim != wanted or (wanted and tensor.type.shape[0] not in (None, p.size)):
                shape = f"a vector of length {p.size}" if wanted else "a scalar"
                raise ValueError(f"{p.name} has shape {tensor.type.shape}: must be {shape}")
            tensors.append(tensor)
        outputs = [pt.tensor("mean", dtype="float64", shape=self.shape), pt.scalar("ok", dtype="int8")]
        return Apply(self, tensors, outputs)

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[Any]]) -> None:
        """Evaluate; the copy is there because PyTensor may work in place on an output."""
        mean, ok = self.evaluate(np.concatenate([np.ravel(x) for x in inputs]))
        output_storage[0][0] = mean.copy()
        output_storage[1][0] = np.asarray(ok, dtype=np.int8)

    def connection_pattern(self, node: Apply) -> list[list[bool]]:
        """Every parameter moves the mean; none moves ok."""
        return [[True, False] for _ in node.inputs]

    def L_op(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], output_grads: Sequence[Variable]
    ) -> list[Variable]:
        """Vector-Jacobian product: the derivative of what depends on the mean, by each parameter.

        Raises
        ------
        MissingGradientError
            If the forward model gives no derivatives.
        """
        if isinstance(output_grads[0].type, DisconnectedType):
            return [DisconnectedType()() for _ in inputs]
        if not self.differentiable:
            raise missing_gradient(f"the forward model {self.model.name}")
        by_value = pt.tensordot(SlopesOp(self)(*inputs), output_grads[0], axes=[[1, 2], [0, 1]])
        at, gradients = 0, []
        for p in self.model.parameters:
            gradients.append(by_value[at : at + p.size] if p.dims else by_value[at])
            at += p.size
        return gradients

    pullback = L_op  # its name in PyTensor 3


@called_as_python
class SlopesOp(Op):
    """Derivatives of a forward model's series, (n_values, n_series, n_times), zero where a solve fails.

    Parameters
    ----------
    forward : ForwardOp
    """

    __props__ = ("forward",)

    def __init__(self, forward: ForwardOp) -> None:
        self.forward = forward

    @property
    def shape(self) -> tuple[int, ...]:
        """(n_values, n_series, n_times)."""
        return (n_values(self.forward.model.parameters), *self.forward.shape)

    def make_node(self, *inputs: Any) -> Apply:
        """The inputs of the forward operation."""
        tensors = self.forward.make_node(*inputs).inputs
        return Apply(self, tensors, [pt.tensor("slopes", dtype="float64", shape=self.shape)])

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[Any]]) -> None:
        """Evaluate."""
        output_storage[0][0] = self.forward.slopes(np.concatenate([np.ravel(x) for x in inputs])).copy()

    def L_op(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], output_grads: Sequence[Variable]
    ) -> NoReturn:
        """Raise MissingGradientError: there are no second derivatives."""
        raise missing_gradient(f"the derivative of the forward model {self.forward.model.name}")

    pullback = L_op


@compiled_by
class SolveOp(Op):
    """What takes the place of `ForwardOp` and `SlopesOp` where numba compiles: no Python, no memory.

    Takes theta (n_values,); returns mean, ok and, if they are asked for, slopes.

    Parameters
    ----------
    forward : ForwardOp
        Of a forward model that has functions for numba.
    slopes : bool
    """

    __props__ = ("forward", "slopes")

    def __init__(self, forward: ForwardOp, slopes: bool) -> None:
        self.forward, self.slopes, self.key = forward, slopes, forward.key

    @property
    def counts(self) -> dict[str, Any]:
        """Those of the operation that it stands for."""
        return self.forward.counts

    def make_node(self, *inputs: Any) -> Apply:
        """A vector in; mean, ok and slopes out."""
        forward = self.forward
        outputs = [pt.tensor(dtype="float64", shape=forward.shape), pt.scalar(dtype="int8")]
        if self.slopes:
            outputs.append(pt.tensor(dtype="float64", shape=SlopesOp(forward).shape))
        return Apply(self, list(inputs), outputs)

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[Any]]) -> None:
        """Evaluate with Python."""
        mean, ok = self.forward.evaluate(inputs[0])
        slopes = [self.forward.slopes(inputs[0])] if self.slopes else []
        for storage, value in zip(output_storage, (mean, np.int8(ok), *slopes), strict=True):
            storage[0] = np.array(value)

    def function(self) -> Any:
        """What numba compiles."""
        compiled = self.forward.in_numba
        assert compiled is not None
        solve, differentiate = compiled.solve, compiled.differentiate
        counts = self.forward._state.without_python.ctypes.data

        @numba_njit
        def noted(status):  # type: ignore[no-untyped-def]
            add(counts, 1)
            if status != 0:
                add(counts + 8 * status, 1)
            return np.asarray(np.int8(status == 0))

        @numba_njit
        def mean_and_ok(theta):  # type: ignore[no-untyped-def]
            status, mean = solve(np.ascontiguousarray(theta))
            if status != 0:
                mean[:] = 0.0
            return mean, noted(status)

        @numba_njit
        def with_slopes(theta):  # type: ignore[no-untyped-def]
            status, mean, slopes = differentiate(np.ascontiguousarray(theta))
            if status != 0:
                mean[:] = 0.0
                slopes[:] = 0.0
            return mean, noted(status), slopes

        return with_slopes if self.slopes else mean_and_ok


@without_python(ForwardOp, SlopesOp)
def solve_without_python(fgraph: Any, node: Apply) -> dict[Variable, Variable] | None:
    """One solve for the series and the slopes at a point.

    A function that solves at several points, as those of PyMC's step methods without a gradient do at the
    chain's point and the proposed one, keeps the operation whose memory has the former.
    """
    forward = node.op if isinstance(node.op, ForwardOp) else cast("SlopesOp", node.op).forward
    nodes = [one for one in fgraph.apply_nodes if one.op in (forward, SlopesOp(forward))]
    if forward.in_numba is None or any(one.inputs != node.inputs for one in nodes):
        return None
    solve = SolveOp(forward, slopes=any(one.op != forward for one in nodes))
    mean, ok, *slopes = cast("list[Variable]", solve(joined(node.inputs), return_list=True))
    found: dict[Variable, Variable] = {}
    for one in nodes:
        found |= dict(zip(one.outputs, (mean, ok) if one.op == forward else slopes, strict=True))
    return found


class Series(NamedTuple):
    """Symbolic outputs of a forward model."""

    mean: TensorVariable  # (n_series, n_times), in the series' own units
    ok: TensorVariable  # int8 scalar, 0 when the solve failed


def observed_series(model: ForwardModel, values: Mapping[str, Any]) -> Series:
    """Symbolic series of a forward model at symbolic parameters.

    Parameters
    ----------
    model : ForwardModel
    values : mapping of name to variable
        For each of its parameters a scalar, or a vector of its size; a scalar stands for all elements.

    Returns
    -------
    Series
        mean (n_series, n_times), zero when the solve failed, and ok.

    Raises
    ------
    ValueError
        If a parameter is missing.
    """
    inputs = []
    for p in model.parameters:
        if p.name not in values:
            raise ValueError(f"{model.name}: parameter {p.name} is missing; give {', '.join(values)} and it")
        value = pt.as_tensor_variable(values[p.name], dtype="float64")
        inputs.append(pt.alloc(value, p.size) if p.dims and value.ndim == 0 else value)
    mark_without_gradient(inputs)
    mean, ok = cast("list[TensorVariable]", ForwardOp(model)(*inputs, return_list=True))
    return Series(mean, ok)
