"""The log-posterior of a model as a function of one unconstrained vector, and the count of its solves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike
from pymc.blocking import DictToArrayBijection, RaveledVars
from pymc.pytensorf import compile as compile_function
from pymc.pytensorf import floatX, join_nonshared_inputs

from zoo.core.arrays import Array
from zoo.core.in_numba import with_memory
from zoo.core.inference.messages import SamplingError as SamplingError

Point = dict[str, np.ndarray]


class LogPosterior:
    """Log-posterior of a model as a function of one unconstrained vector."""

    def __init__(self, model: Any) -> None:
        self.model = model
        self.variables = list(model.continuous_value_vars)
        if not self.variables:
            raise SamplingError(f"model {model_name(model)} has no continuous free variable to sample")
        if len(self.variables) != len(model.value_vars):
            names = [v.name for v in model.value_vars if v not in self.variables]
            raise SamplingError(f"variable {names[0]!r} is discrete: only continuous ones can be sampled")
        self.initial = model.initial_point()
        self.template = self._ravel(self.initial)
        self._function = compile_logp(model, self.variables, self.initial, {})
        self.ops = counting_ops(self._function)
        self.evaluations = 0

    def _ravel(self, point: Mapping[str, Any]) -> RaveledVars:
        return DictToArrayBijection.map({v.name: np.asarray(point[v.name]) for v in self.variables})

    def __call__(self, q: Array) -> float:
        """Log-posterior at a point (n_dim,); minus infinity where it is not finite."""
        self.evaluations += 1
        value = float(self._function(np.ascontiguousarray(q, dtype=self.template.data.dtype)))
        return value if np.isfinite(value) else -np.inf

    def vector(self, point: Mapping[str, Any]) -> Array:
        """Point of the model -> vector (n_dim,)."""
        return np.asarray(self._ravel(point).data, dtype=float)

    def point(self, q: Array) -> Point:
        """Vector (n_dim,) -> point of the model."""
        return dict(DictToArrayBijection.rmap(RaveledVars(floatX(q), self.template.point_map_info)))

    def from_values(self, values: Mapping[str, ArrayLike]) -> Array:
        """Values of free variables in their own units -> vector; others keep the initial value."""
        from pymc.initial_point import make_initial_point_fn

        known = {rv.name: rv for rv in self.model.free_RVs}
        for name in values:
            if name not in known:
                raise SamplingError(f"start: no variable {name!r} in the model; it has {', '.join(known)}")
        overrides = {}
        for name, value in values.items():
            array, rv = np.asarray(value, dtype=float), known[name]
            if array.ndim == 0 and rv.ndim > 0:  # one value for all elements
                array = np.full(rv.shape.eval(), float(array))
            overrides[rv] = array
        return self.vector(make_initial_point_fn(model=self.model, overrides=overrides)(0))

    def from_draws(self, draws: Mapping[str, ArrayLike]) -> Array:
        """Draws of every free variable in its own unit, name -> (n, ...), to vectors (n, n_dim)."""
        import pytensor

        inputs, outputs = [], []
        for rv in self.model.free_RVs:
            value = rv.type()
            transform = self.model.rvs_to_transforms[rv]
            inputs.append(value)
            outputs.append(value if transform is None else transform.forward(value, *rv.owner.inputs))
        function = pytensor.function(inputs, outputs)
        values = [self.model.rvs_to_values[rv].name for rv in self.model.free_RVs]
        columns = [np.asarray(draws[rv.name], dtype=float) for rv in self.model.free_RVs]
        rows = [
            self.vector(dict(zip(values, function(*row), strict=True))) for row in zip(*columns, strict=True)
        ]
        return np.array(rows)

    def to_values(self, q: Array) -> dict[str, np.ndarray]:
        """Vector (n_dim,) -> free variables in their own units."""
        names, function = outputs(self.model, [rv.name for rv in self.model.free_RVs])
        return dict(zip(names, function(self.point(q)), strict=True))


def outputs(model: Any, names: Sequence[str]) -> tuple[list[str], Any]:
    """Names and a function of a point: free variables in their own units, and deterministic ones."""
    graphs = {v.name: v for v in model.unobserved_value_vars}
    return list(names), model.compile_fn([graphs[name] for name in names], on_unused_input="ignore")


def model_name(model: Any) -> str:
    """A model's name in messages."""
    record = getattr(model, "zoo", None)
    return str(getattr(record, "name", "") or model.name or "without a name")


def counting_ops(function: Any) -> list[Any]:
    """Operations with `counts` in a compiled function, each once (copies of one share its counts)."""
    if hasattr(function, "counts"):  # it counts itself
        return [function]
    found: dict[Any, Any] = {}

    def visit(graph: Any) -> None:
        for node in graph.apply_nodes:
            if isinstance(getattr(node.op, "counts", None), Mapping):
                found.setdefault(getattr(node.op, "key", id(node.op)), node.op)
            inner = getattr(node.op, "fgraph", None)
            if inner is not None and inner is not graph:
                visit(inner)

    visit(function.maker.fgraph)
    return list(found.values())


def count(ops: Sequence[Any]) -> tuple[int, Counter[str]]:
    """Solves so far in this process, and failed ones by status."""
    solves = 0
    failures: Counter[str] = Counter()
    for op in ops:
        counts = op.counts
        solves += int(counts["solves"])
        failures.update(counts.get("failures", {}))
    return solves, failures


def compile_logp(
    model: Any,
    variables: Sequence[Any],
    point: Point,
    shared: Mapping[Any, Any],
    compile_kwargs: Mapping[str, Any] | None = None,
) -> Any:
    """Log-posterior as a function of one vector; kept with the model if nothing else enters."""
    alone = not shared and not compile_kwargs
    kept = _compiled.setdefault(model, {})
    key = tuple(v.name for v in model.value_vars), tuple(v.name for v in variables)
    if alone and key in kept:
        return kept[key]
    [logp], joined = join_nonshared_inputs(
        point=point, outputs=[model.logp()], inputs=list(variables), shared_inputs=dict(shared)
    )
    function = compile_function([joined], logp, **{"mode": with_memory(), **dict(compile_kwargs or {})})
    function.trust_input = True
    if alone:
        kept[key] = function
    return function


_compiled: WeakKeyDictionary[Any, dict[Any, Any]] = WeakKeyDictionary()
