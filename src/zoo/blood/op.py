"""The solver as a PyTensor operation: parameters of every vessel in, the observed series out."""

from __future__ import annotations

import hashlib
import os
import threading
import weakref
from collections import Counter, OrderedDict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, cast

import numpy as np
import pytensor.tensor as pt
from numpy.typing import NDArray
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op
from pytensor.tensor.variable import TensorVariable

from zoo.blood.network import Network
from zoo.blood.solver import STATUS_NAMES, BatchSolution, Solution, Solver, SolverOptions

if TYPE_CHECKING:
    from zoo.blood.conventions import Conventions
    from zoo.blood.study import Study

Array = NDArray[np.float64]

PARAMETERS = ("stiffness", "gamma", "psi1", "psi2", "c")
QUANTITIES = ("pressure_mmHg", "flow_ml_s", "area_cm2")
CACHE_SIZE = 8


# Not a NotImplementedError: PyMC takes that as "use Slice", which solves 18 times a step without a word.
# As an AttributeError it stops pm.sample, while pm.find_MAP goes on without gradients.
class MissingGradientError(AttributeError):
    """A gradient was asked of an operation that has none."""

    def __init__(self, op: str) -> None:
        super().__init__(
            f"{op} has no gradient, so PyMC cannot choose NUTS: "
            "pass a step method without gradients, pm.sample(step=pm.DEMetropolisZ())"
        )


class _State:
    """What the copies of one operation share in a process: solved points and counts."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.cache: OrderedDict[bytes, tuple[Array, bool]] = OrderedDict()
        self.counts: Counter[str] = Counter()
        self.failures: Counter[str] = Counter()

    def clear(self) -> None:
        self.lock = threading.Lock()
        self.cache.clear()
        self.counts.clear()
        self.failures.clear()


_states: weakref.WeakValueDictionary[str, _State] = weakref.WeakValueDictionary()


def _clear_states() -> None:
    for state in list(_states.values()):
        state.clear()


# a forked process counts its own solves, and must not inherit a lock that another thread held
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_clear_states)


class BloodFlowOp(Op):
    """Observed series at the periodic state, as a PyTensor operation without a gradient.

    Takes five float64 vectors of shape (n_vessels,), in the order of ``solver.network``: stiffness
    (g cm-1 s-2), gamma, psi1, psi2, c. Returns `mean`, float64 (n_series, n_times), each series in the
    unit of its quantity, and `ok`, an int8 scalar: 1, or 0 when the solve failed and `mean` is zero.

    The last few points are kept, so PyMC's repeated evaluations of a point cost one solve. Copies of
    an operation (in compiled functions, after unpickling) share these points and the counts.

    Parameters
    ----------
    solver : Solver
        Sampled at the observed series and times.
    quantities : sequence of str
        For each series ``pressure_mmHg``, ``flow_ml_s`` or ``area_cm2``.

    Raises
    ------
    ValueError
        If there is no series, or `quantities` does not fit the solver's series.
    """

    __props__ = ("key",)

    def __init__(self, solver: Solver, quantities: Sequence[str]) -> None:
        if len(quantities) != len(solver.series) or not quantities:
            raise ValueError(
                f"quantities: {len(quantities)} for {len(solver.series)} series: give one each, at least one"
            )
        for quantity in quantities:
            if quantity not in QUANTITIES:
                raise ValueError(f"quantity = {quantity!r}: must be one of {', '.join(QUANTITIES)}")
        self.solver = solver
        self.quantities = tuple(quantities)
        self.key = _key(solver, self.quantities)
        self._attach()

    def _attach(self) -> None:
        self._state = _states.setdefault(self.key, _State())

    def __getstate__(self) -> dict[str, Any]:
        state = self.__dict__.copy()
        del state["_state"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._attach()

    @property
    def n_vessels(self) -> int:
        """Length of each input."""
        return len(self.solver.network.ids)

    @property
    def shape(self) -> tuple[int, int]:
        """(n_series, n_times)."""
        return len(self.quantities), len(self.solver.times_s)

    @property
    def counts(self) -> dict[str, Any]:
        """Evaluations, solves, and failed solves by status, in this process or since `reset_counts`."""
        state = self._state
        return {
            "evaluations": state.counts["evaluations"],
            "solves": state.counts["solves"],
            "failures": dict(state.failures),
        }

    def reset_counts(self) -> None:
        """Set the counts of this process to zero; the kept points stay."""
        self._state.counts.clear()
        self._state.failures.clear()

    def clear_cache(self) -> None:
        """Forget the solved points, so that the next evaluation solves."""
        with self._state.lock:
            self._state.cache.clear()

    def observed(self, solution: Solution | BatchSolution) -> Array:
        """Each series' own quantity from a solution: (n_series, n_times), or (n_sets, n_series, n_times)."""
        rows = [getattr(solution, quantity)[..., i, :] for i, quantity in enumerate(self.quantities)]
        return np.stack(rows, axis=-2)

    def evaluate(self, *inputs: Array) -> tuple[Array, bool]:
        """Mean and ok at one point, from the kept points or by a solve.

        Parameters
        ----------
        *inputs : array (n_vessels,)
            Stiffness (g cm-1 s-2), gamma, psi1, psi2, c.

        Returns
        -------
        mean : array (n_series, n_times)
            Read-only; zeros when the solve failed.
        ok : bool

        Raises
        ------
        ValueError
            If an input has another length.
        """
        for name, value in zip(PARAMETERS, inputs, strict=True):
            if value.shape != (self.n_vessels,):
                raise ValueError(f"{name} has shape {value.shape}: must be a scalar or ({self.n_vessels},)")
        point = b"".join(value.tobytes() for value in inputs)
        state = self._state
        with state.lock:
            state.counts["evaluations"] += 1
            if point in state.cache:
                state.cache.move_to_end(point)
                return state.cache[point]
        solution = self.solver.solve(*inputs, check=False)
        mean = self.observed(solution)
        failure = None if solution.ok else STATUS_NAMES[solution.status]
        if solution.ok and not np.all(np.isfinite(mean)):
            failure = "not-finite"
        if failure:
            mean = np.zeros(self.shape)
        mean.flags.writeable = False
        with state.lock:
            state.counts["solves"] += 1
            if failure:
                state.failures[failure] += 1
            state.cache[point] = mean, failure is None
            while len(state.cache) > CACHE_SIZE:
                state.cache.popitem(last=False)
        return mean, failure is None

    def make_node(self, *inputs: Any) -> Apply:
        """Five float64 vectors of length n_vessels in, mean and ok out."""
        if len(inputs) != len(PARAMETERS):
            raise ValueError(f"{len(inputs)} inputs: must be {', '.join(PARAMETERS)}")
        vectors = []
        for name, value in zip(PARAMETERS, inputs, strict=True):
            vector = pt.as_tensor_variable(value, dtype="float64")
            if vector.ndim != 1 or vector.type.shape[0] not in (None, self.n_vessels):
                raise ValueError(
                    f"{name} has shape {vector.type.shape}: must be a vector of length {self.n_vessels}"
                )
            vectors.append(vector)
        outputs = [pt.tensor("mean", dtype="float64", shape=self.shape), pt.scalar("ok", dtype="int8")]
        return Apply(self, vectors, outputs)

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[Any]]) -> None:
        """Evaluate; the copy is there because PyTensor may work in place on an output."""
        mean, ok = self.evaluate(*inputs)
        output_storage[0][0] = mean.copy()
        output_storage[1][0] = np.asarray(ok, dtype=np.int8)

    def infer_shape(
        self, fgraph: Any, node: Apply, input_shapes: list[tuple[Variable, ...]]
    ) -> list[tuple[Any, ...]]:
        """Known before any solve."""
        return [self.shape, ()]

    def L_op(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], output_grads: Sequence[Variable]
    ) -> NoReturn:
        """Raise MissingGradientError."""
        raise MissingGradientError("the blood-flow solver")

    pullback = L_op  # its name in PyTensor 3


def _key(solver: Solver, quantities: tuple[str, ...]) -> str:
    """Digest of everything that the output depends on, apart from the inputs."""
    net = solver.network
    digest = hashlib.sha256()
    settings = (solver.wall, solver.conventions, solver.options, solver.series, quantities)
    digest.update(repr((settings, net.density, net.viscosity, net.period_s)).encode())
    added = solver.physics.settings()
    if added:
        digest.update(repr(sorted(added.items())).encode())
    lengths_and_outlets = (net.length_cm, net.radius_in_cm, net.radius_out_cm, net.R1, net.R2, net.C)
    times_and_flow = (solver.inflow_time_s, solver.inflow_ml_s, solver.times_s)
    for array in (net.ids, net.parent, *lengths_and_outlets, *times_and_flow):
        data = np.ascontiguousarray(array)
        digest.update(f"{data.dtype}{data.shape}".encode() + data.tobytes())
    return digest.hexdigest()


class BloodFlow(NamedTuple):
    """Symbolic outputs of the solver."""

    mean: TensorVariable  # (n_series, n_times), in the series' own units
    ok: TensorVariable  # int8 scalar, 0 when the solve failed


def blood_flow(
    study: Study,
    wall: str,
    stiffness: Any,
    psi1: Any,
    psi2: Any,
    c: Any,
    gamma: Any = 2.0,
    *,
    options: SolverOptions | None = None,
    conventions: Conventions | None = None,
) -> BloodFlow:
    """Symbolic solution of a study's tree at its observed series and times.

    Parameters
    ----------
    study : Study
        With at least one observed series.
    wall : {"linear", "tangent"}
        Eq. (3.3) or (3.4).
    stiffness : scalar or (n_vessels,)
        chi, g cm-1 s-2; vectors are in the order of ``Network.from_study(study)``.
    psi1, psi2, c : scalar or (n_vessels,)
        Factors on the nominal R1, R2, C of the terminal vessels.
    gamma : scalar or (n_vessels,)
        Of the tangent wall; the linear wall does not use it.
    options : SolverOptions
        Numerical settings.
    conventions : Conventions
        Instead of the study's own.

    Returns
    -------
    mean : TensorVariable (n_series, n_times)
        In the series' own units, zero when the solve failed.
    ok : TensorVariable, int8 scalar
        1, or 0 when the solve failed.

    Raises
    ------
    ValueError
        If the study has no observations.

    References
    ----------
    Paun et al. 2020, doi 10.1098/rsif.2020.0886.
    """
    if not study.series:
        raise ValueError(
            f"{study.source}: study {study.name!r} has no observations: add observations.csv, "
            "a model needs something to be compared with"
        )
    solver = Solver.for_study(study, wall=wall, options=options, conventions=conventions)
    op = BloodFlowOp(solver, [series.quantity for series in study.series])
    inputs = []
    for value in (stiffness, gamma, psi1, psi2, c):
        value = pt.as_tensor_variable(value, dtype="float64")
        inputs.append(pt.alloc(value, op.n_vessels) if value.ndim == 0 else value)
    mean, ok = cast("list[TensorVariable]", op(*inputs, return_list=True))
    return BloodFlow(mean, ok)


def radius_dependent_stiffness(
    study: Study, f1: Any, f2: Any, f3: Any, *, conventions: Conventions | None = None
) -> TensorVariable:
    """Stiffness of every vessel from its inlet radius, chi = f1 exp(f2 r0 / u) + f3 (eq. 3.5).

    The unit u is ``stiffness_radius_unit_cm`` of the conventions: 1 cm as printed, 0.1 cm in the
    published code.

    Parameters
    ----------
    study : Study
        Gives the radii.
    f1, f3 : scalar
        g cm-1 s-2.
    f2 : scalar
        Per u.
    conventions : Conventions
        Instead of the study's own.

    Returns
    -------
    TensorVariable (n_vessels,)
        chi, g cm-1 s-2, in the order of ``Network.from_study(study)``.

    References
    ----------
    Paun et al. 2020, doi 10.1098/rsif.2020.0886.
    """
    unit = (conventions or study.conventions).stiffness_radius_unit_cm
    radius = Network.from_study(study).radius_in_cm / unit
    return cast(TensorVariable, f1 * pt.exp(f2 * radius) + f3)
