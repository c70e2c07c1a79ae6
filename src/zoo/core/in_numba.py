"""Operations of ours in functions that PyTensor compiles with numba.

Where what they compute is there as functions that numba compiles, other operations take their place, which
call no Python. Else they are called as Python, without a warning; so they are in `with_memory`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numba  # type: ignore[import-untyped]
import numpy as np
import pytensor.tensor as pt
from numba.extending import intrinsic  # type: ignore[import-untyped]
from pytensor.compile.mode import Mode, get_default_mode, optdb
from pytensor.graph.rewriting.basic import dfs_rewriter, node_rewriter
from pytensor.link.numba.dispatch.basic import get_numba_type, numba_funcify, numba_njit
from pytensor.link.numba.dispatch.random import numba_core_rv_funcify
from pytensor.tensor.random.op import RandomVariable

OpClass = TypeVar("OpClass", bound=type)
WITHOUT_PYTHON = "zoo_without_python"
"""Tag of the rewrites that put operations without Python in the place of others."""


def with_memory() -> Mode:
    """PyTensor's default mode, but with operations that call Python and keep the points they have seen."""
    mode: Mode = get_default_mode().excluding(WITHOUT_PYTHON)
    return mode


def without_python(*op_classes: type) -> Callable[[Any], Any]:
    """Let a function of a graph and a node of these operations replace them in what numba compiles.

    It returns a mapping of variables, or None. It comes last but for work in place, when equal nodes are one.
    """

    def register(replaced: Any) -> Any:
        rewriter = dfs_rewriter(node_rewriter(list(op_classes))(replaced))
        optdb.register(replaced.__name__, rewriter, "numba", WITHOUT_PYTHON, position=49.1)
        return replaced

    return register


def joined(variables: Sequence[Any]) -> Any:
    """Scalars and vectors as one vector."""
    return pt.concatenate([x if x.ndim else x[None] for x in variables])


def compiled_by(op_class: OpClass) -> OpClass:
    """Let an operation's `function()` be what numba compiles, made anew in each process and not stored."""
    numba_funcify.register(op_class)(lambda op, node, **_: op.function())
    return op_class


def own(method: str, given: Any) -> Any:
    """What an object's method returns, if the method is of its very class, else None.

    A subclass, or what is around another object and passes on what it lacks, may compute something else.
    """
    return getattr(given, method)() if method in vars(type(given)) else None


def _atomic(operation: str) -> Any:
    """A function of an address and n, which gives what stands there and adds n, or puts n in its place."""

    @intrinsic
    def change(typingctx, address, number):  # type: ignore[no-untyped-def]
        def code(context, builder, signature, args):  # type: ignore[no-untyped-def]
            address, number = args
            at = builder.inttoptr(address, address.type.as_pointer())
            return builder.atomic_rmw(operation, at, number, "seq_cst")

        return numba.types.int64(numba.types.int64, numba.types.int64), code

    return change


add, exchange = _atomic("add"), _atomic("xchg")
"""With the 64-bit number at an address, whatever other threads do."""


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
