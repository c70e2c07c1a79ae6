"""Operations of ours in functions that PyTensor compiles with numba: called as Python, without a warning."""

from __future__ import annotations

from typing import Any, TypeVar

import numba  # type: ignore[import-untyped]
import numpy as np
from pytensor.link.numba.dispatch.basic import get_numba_type, numba_funcify, numba_njit
from pytensor.link.numba.dispatch.random import numba_core_rv_funcify
from pytensor.tensor.random.op import RandomVariable

OpClass = TypeVar("OpClass", bound=type)


def called_as_python(op_class: OpClass) -> OpClass:
    """Let numba call the `perform` of an operation, or the `rng_fn` of a random variable.

    Without it PyTensor does so for an operation too, but warns of it at each compilation.
    """
    if issubclass(op_class, RandomVariable):
        numba_core_rv_funcify.register(op_class)(_draw)
    else:
        numba_funcify.register(op_class)(_perform)
    return op_class


def _perform(op: Any, node: Any, **_: Any) -> Any:
    types = [get_numba_type(output.type) for output in node.outputs]

    def values(inputs: Any) -> Any:
        storage: list[list[Any]] = [[None] for _ in types]
        op.perform(node, inputs, storage)
        found = tuple(value for (value,) in storage)
        return found if len(types) > 1 else found[0]

    return _in_object_mode(values, numba.types.Tuple(types) if len(types) > 1 else types[0])


def _draw(op: Any, node: Any) -> Any:
    """Of one draw: PyTensor loops over what it is to be repeated for. None: not to be stored on disk."""
    dtype = np.dtype(node.outputs[1].type.dtype)
    scalar = numba.from_dtype(dtype)

    def values(inputs: Any) -> Any:
        rng, *parameters = inputs
        drawn = np.ascontiguousarray(op.rng_fn(rng, *map(np.asarray, parameters), size=None), dtype=dtype)
        return drawn if op.ndim_supp else drawn.item()

    kind = numba.types.Array(scalar, op.ndim_supp, "C") if op.ndim_supp else scalar
    return _in_object_mode(values, kind), None


def _in_object_mode(values: Any, kind: Any) -> Any:
    """A function that numba can compile a call of, whose result has the given type of numba."""

    @numba_njit
    def called(*inputs):  # type: ignore[no-untyped-def]
        with numba.objmode(result=kind):
            result = values(inputs)
        return result

    return called
