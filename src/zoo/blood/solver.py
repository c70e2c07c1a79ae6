"""The NumPy face of the compiled solver."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from itertools import count, takewhile
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo import _native
from zoo._native import ffi, lib
from zoo.blood.conventions import PRINTED, Conventions
from zoo.blood.directions import Derivatives, Direction
from zoo.blood.network import Network
from zoo.blood.outlet_tables import MEMORY_BEATS
from zoo.blood.physics import NO_PHYSICS as NO_PHYSICS
from zoo.blood.physics import Physics, study_physics
from zoo.blood.solve_errors import (
    CFLError,
    CollapseError,
    InletAreaError,
    NoDerivativeError,
    NotPeriodicError,
    RootError,
    SolverArgumentError,
    SolverError,
    WallFallsError,
    WallLimitError,
)
from zoo.blood.solver_input import TOLERANCE_SHARE, checked_inflow, checked_inlet_pressure, checked_places
from zoo.blood.solver_input import SolverOptions as SolverOptions
from zoo.blood.units import cgs_to_mmhg, mmhg_to_cgs
from zoo.core import digests
from zoo.core.arrays import (
    MOST_COUNT,
    Array,
    Brief,
    finite_array,
    real_array,
    real_number,
    shown,
)

if TYPE_CHECKING:
    from zoo.blood.study import Study


ABI = 12
if getattr(lib, "ZOO_ABI", 1) != ABI:
    raise ImportError(
        f"zoo: the compiled solver has interface {getattr(lib, 'ZOO_ABI', 1)}, this version needs {ABI}; "
        "run `make setup` to build it again"
    )


@cache
def library_digest() -> str:
    """SHA-256 of the compiled library, which stored results are kept by."""
    return digests.of_bytes(Path(_native.__file__).read_bytes())


def _names(name_of: Callable[[int], Any]) -> tuple[str, ...]:
    """Names that the library has for the numbers 0, 1, ..., up to the first that it does not know."""
    names = takewhile(lambda name: name != ffi.NULL, map(name_of, count()))
    return tuple(ffi.string(name).decode() for name in names)


WALLS: dict[str, int] = {name: number for number, name in enumerate(_names(lib.zoo_wall_name))}
SHAPES: dict[str, tuple[str, ...]] = {
    wall: _names(partial(lib.zoo_wall_shape_name, number)) for wall, number in WALLS.items()
}
CHI_WALLS = ("linear", "olufsen")
"""Walls of the scale K = (4/3) chi and the slope dp/d(A/A0) = K/2 at rest."""
INLETS: dict[str, int] = {name: number for number, name in enumerate(_names(lib.zoo_inlet_name))}
OUTLETS: dict[str, int] = {name: number for number, name in enumerate(_names(lib.zoo_outlet_name))}
FRICTIONS = {
    "current": lib.ZOO_FRICTION_CURRENT,
    "rest": lib.ZOO_FRICTION_REST,
    "fixed": lib.ZOO_FRICTION_FIXED,
}
PARAMETERS = ("stiffness", "gamma", "psi1", "psi2", "c")
PUBLISHED_CELLS_PER_CM = 40
TANGENT_TOLERANCE = 1e-7
"""Accepted error of the linear equations of derivatives, over each direction's largest one."""
THROAT_LENGTH_CM = 0.15
THROAT_CELLS = 6
"""Cells along a throat, at least, where cells are given for each vessel."""


_ERRORS: dict[int, tuple[type[SolverError], str]] = {
    lib.ZOO_BAD_ARGUMENT: (
        SolverArgumentError,
        "stiffness, gamma, psi1, psi2 and c must be positive and finite",
    ),
    lib.ZOO_CFL: (CFLError, "give longer cells, or a softer wall"),
    lib.ZOO_COLLAPSE: (
        CollapseError,
        "raise its stiffness or radius, lower what flows through it, or lower psi1 and psi2",
    ),
    lib.ZOO_WALL_LIMIT: (WallLimitError, "raise the stiffness, lower gamma, or lower psi1 and psi2"),
    lib.ZOO_NO_ROOT: (RootError, "check the stiffness and the Windkessel values around that vessel"),
    lib.ZOO_NOT_PERIODIC: (
        NotPeriodicError,
        "raise max_beats or tolerance_mmHg, or shorten the decay: lower psi2 or c, or raise the stiffness",
    ),
    lib.ZOO_WALL_FALLS: (WallFallsError, "lower the slope of wall_function where it falls"),
    lib.ZOO_NO_DERIVATIVE: (NoDerivativeError, "sample without gradients, or leave that parameter fixed"),
    lib.ZOO_INLET_AREA: (InletAreaError, "raise the stiffness"),
}
STATUS_NAMES: dict[int, str] = {lib.ZOO_OK: "ok", lib.ZOO_WORKSPACE: "workspace"} | {
    status: error.status for status, (error, _) in _ERRORS.items()
}


@dataclass(frozen=True, repr=False)
class Solution(Brief):
    """A solve at one set of parameters.

    `pressure_mmHg`, `flow_ml_s` and `area_cm2` have shape (n_series, n_times) and are NaN when it failed.
    `distance_mmHg` is the estimated distance from the periodic state; `inflow_ml` and `outflow_ml` are
    volumes over the last beat, `junction_defect_ml_s` the largest flow that a junction lost or made.
    `fastest_cm_s`, (n_vessels,), is the largest abs(u) + c of each vessel in the last beat.
    """

    pressure_mmHg: Array
    flow_ml_s: Array
    area_cm2: Array
    status: int
    reason: str
    vessel: int | None
    time_s: float
    beats: int
    steps_per_beat: int
    total_steps: int
    distance_mmHg: float
    max_cfl: float
    inflow_ml: float
    outflow_ml: float
    junction_defect_ml_s: float
    fastest_cm_s: Array

    @property
    def ok(self) -> bool:
        """Whether the solve reached the periodic state."""
        return bool(self.status == lib.ZOO_OK)


_TERMS = {
    "fluid": ("momentum_correction", "stokes_friction", "viscous_friction", "viscosity_factor", "leak"),
    "wall": ("stiffness_ratio", "stiffness_exponent", "viscoelastic_time", "relaxation_time"),
    "junction": ("total_pressure",),
    "outlet": ("inertance", "section_resistance", "section_compliance"),
}
"""Terms of `Physics` that have the same name in the native structs, by struct."""
_LOCK = threading.Lock()
_ARRAYS: weakref.WeakValueDictionary[tuple[str, bytes], NDArray[Any]] = weakref.WeakValueDictionary()
"""Arrays that were handed over, by content: derivatives take those at one place for the same."""
if hasattr(os, "register_at_fork"):  # no process may be born while another thread holds the lock
    os.register_at_fork(before=_LOCK.acquire, after_in_parent=_LOCK.release, after_in_child=_LOCK.release)


def _parameters(rows: dict[str, Array]) -> Any:
    """The native struct of parameters, whose arrays must be kept alive."""
    parameters = ffi.new("zoo_parameters *")
    for name, row in rows.items():
        setattr(parameters, "shape" if name == "gamma" else name, ffi.from_buffer("double[]", row))
    return parameters


class Solver:
    """Pressure, flow and area in a vessel tree at the periodic state (eq. 3.1 to 3.7 of Paun et al. 2020).

    Parameters
    ----------
    network : Network
        Vessels, blood and nominal Windkessels.
    inflow_time_s, inflow_ml_s : array (n,)
        Flow into the root over one period, uniform in time from 0, without the repeated last sample: sample m
        at m period/n, to a hundredth of a step. Empty where the pressure is given.
    wall : {"linear", "tangent", "olufsen"}
        Eq. (3.3), (3.4), or p = (4/3) chi (1 - sqrt(A0/A)).
    conventions : Conventions
        How the equations are read (wall factor, friction radius, lengths, mmHg).
    series : sequence of (vessel id, position)
        Where the solution is wanted; position 0 is the inlet, 1 the outlet.
    times_s : array (n_times,)
        When, from the start of the beat; times beyond the period are taken modulo it.
    options : SolverOptions
        Numerical settings.
    physics : Physics
        What is added to the equations.
    inlet_pressure_mmHg : array (m,)
        Pressure at the root's inlet at times m period/n, linear between, mmHg, absolute as an observed one,
        instead of the flow there.

    Raises
    ------
    SolverArgumentError
        If an argument is out of range, or the inlet has both a flow and a pressure, or neither.

    References
    ----------
    Paun et al. 2020, doi 10.1098/rsif.2020.0886; Olufsen 1999, doi 10.1152/ajpheart.1999.276.1.H257.
    """

    def __init__(
        self,
        network: Network,
        inflow_time_s: ArrayLike = (),
        inflow_ml_s: ArrayLike = (),
        *,
        wall: str = "linear",
        conventions: Conventions = PRINTED,
        series: Sequence[tuple[int, float]] = (),
        times_s: ArrayLike = (),
        options: SolverOptions | None = None,
        physics: Physics | None = None,
        inlet_pressure_mmHg: ArrayLike = (),
    ) -> None:
        if wall not in WALLS:
            raise SolverArgumentError(f"wall = {wall!r}: must be one of {', '.join(WALLS)}")
        if not isinstance(network, Network):
            raise SolverArgumentError(
                f"network = {shown(network)}: must be a Network; see Network.from_study"
            )
        self.network = network
        self.inlet_pressure_mmHg: Array = np.empty(0)
        if np.size(inlet_pressure_mmHg):
            if np.size(inflow_ml_s) or np.size(inflow_time_s):
                raise SolverArgumentError(
                    "inlet_pressure_mmHg: is given beside inflow_ml_s, which follows from it; leave one out"
                )
            self.inflow_time_s = self.inflow_ml_s = np.empty(0)
            self.inlet_pressure_mmHg = checked_inlet_pressure(inlet_pressure_mmHg)
        else:
            self.inflow_time_s, self.inflow_ml_s = checked_inflow(
                inflow_time_s, inflow_ml_s, network.period_s
            )
        self.wall = wall
        self.conventions = conventions
        self.series = checked_places(series)
        self.times_s = finite_array("times_s", times_s, error=SolverArgumentError).copy()
        self.options = options or SolverOptions()
        self.physics = physics or NO_PHYSICS
        for array in (self.inflow_time_s, self.inflow_ml_s, self.times_s):
            array.setflags(write=False)
        self._build()

    # C was told the sizes of these; with others it would write past the end of what it is given
    def __setattr__(self, name: str, value: Any) -> None:
        if not name.startswith("_") and "_problem" in self.__dict__:
            raise AttributeError(f"Solver: {name} cannot be changed; make another Solver with it")
        super().__setattr__(name, value)

    def __repr__(self) -> str:
        cells, places = int(self.grid()[0].sum()), ", ".join(f"v{v}@{x:g}" for v, x in self.series)
        return (
            f"Solver({len(self.network.ids)} vessels, {cells} cells, {self.wall} wall, conventions "
            f"{self.conventions.name}, period {self.network.period_s:g} s, {len(self.times_s)} times at "
            f"{shorten(places, 80, placeholder=' ...') or 'no place'})"
        )

    @classmethod
    def for_study(
        cls,
        study: Study,
        wall: str | None = None,
        *,
        series: Sequence[tuple[int, float]] | None = None,
        times_s: ArrayLike | None = None,
        options: SolverOptions | None = None,
        conventions: Conventions | None = None,
        physics: Physics | None = None,
    ) -> Solver:
        """Make the solver of a study, at the study's own series and times unless others are given.

        Without `wall` it is the study's own. Without `physics` it is the study's own, too,
        `zoo.blood.physics.study_physics`; then `solve` takes the stiffness at the vessels' inlets, which
        changes along them as the study says.

        Those of a study without observations are the inlet of every vessel at 512 times of the beat.

        At the study's own times the conventions' ``sample_lag_beats`` is added; times that are given are
        taken as they are.
        """
        conventions = conventions or study.conventions
        if series is None:
            series = [(s.vessel, s.position) for s in study.series] or [(v.id, 0.0) for v in study.vessels]
        if times_s is None and not study.series:
            times_s = np.arange(512) * study.period_s / 512
        elif times_s is None:
            times_s = study.time_s + conventions.sample_lag_beats * study.period_s
        network = Network.from_study(study)
        if physics is None:
            physics = study_physics(study, network, mmhg=conventions.mmhg)
        return cls(
            network,
            study.inflow_time_s,
            study.inflow_ml_s,
            wall=study.wall if wall is None else wall,
            conventions=conventions,
            series=series,
            times_s=times_s,
            options=options,
            physics=physics,
            inlet_pressure_mmHg=study.inlet_pressure_mmHg,
        )

    # the native structs hold pointers, so a pickle keeps the arguments and builds them again
    def __getstate__(self) -> dict[str, Any]:
        state = self.__dict__.copy()
        del state["_problem"], state["_kept"], state["_workspaces"], state["_rooms"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._build()

    def grid(self) -> tuple[NDArray[np.int32], Array]:
        """Cells and length (cm) of each vessel on the grid, each of shape (n_vessels,)."""
        length = self.network.length_cm
        if self.conventions.truncate_lengths:
            cells = np.floor(PUBLISHED_CELLS_PER_CM * length + 1e-9)
            if np.any(cells < 1):
                vessel = self.network.ids[int(np.argmin(cells))]
                raise SolverArgumentError(
                    f"vessel {vessel}: shorter than one cell of 1/{PUBLISHED_CELLS_PER_CM} cm, "
                    "which truncated lengths cannot hold; use true lengths"
                )
            length = cells / PUBLISHED_CELLS_PER_CM
            cells = np.maximum(2, cells)
        elif self.options.cells:
            cells = self._given_cells()
        else:
            with np.errstate(over="ignore"):
                cells = np.maximum(2, np.rint(length / self.options.dx_cm))
        added = self.physics
        if added.loss_length is not None and not self.conventions.truncate_lengths:
            loses = np.zeros(len(cells), dtype=bool)
            for loss in (added.loss_quadratic, added.loss_linear):
                loses |= False if loss is None else loss > 0
            cells = self._finer(cells, loses, added.loss_length)
        cells = cells * float(self.options.refine)
        if cells.sum() > MOST_COUNT:
            vessel = int(np.argmax(cells))
            raise SolverArgumentError(
                f"cells: {cells[vessel]:.4g} in vessel {self.network.ids[vessel]}, {cells.sum():.4g} in all: "
                f"must be at most {MOST_COUNT}; raise dx_cm, or give fewer"
            )
        return cells.astype(np.int32), np.asarray(length, dtype=np.float64)

    def _given_cells(self) -> Array:
        """The options' cells, with more where a throat is shorter than they show."""
        cells = np.array(self.options.cells, dtype=np.float64)
        if cells.shape != self.network.ids.shape:
            raise SolverArgumentError(
                f"cells: {len(cells)} values for {len(self.network.ids)} vessels; give one for each vessel"
            )
        if self.physics.throat_severity is None:
            return cells
        throat = self.physics.throat_length
        narrow = self.physics.throat_severity > 0
        return self._finer(cells, narrow, THROAT_LENGTH_CM if throat is None else throat)

    def _finer(self, cells: Array, where: NDArray[np.bool_], length_cm: Array | float) -> Array:
        """Cells with at least `THROAT_CELLS` along stretches of this length in some vessels."""
        with np.errstate(over="ignore"):
            fine = np.ceil(THROAT_CELLS * self.network.length_cm / length_cm)
        return np.where(where, np.maximum(cells, fine), cells)

    def _build(self) -> None:
        net, options, conventions = self.network, self.options, self.conventions
        self._kept: list[Any] = []
        # memory for a solve, and for its derivatives, between two of them; taken out while in use, so that
        # two threads never share it
        self._workspaces: list[NDArray[np.uint8]] = []
        self._rooms: list[NDArray[np.uint8]] = []
        problem = ffi.new("zoo_problem *")

        n_vessels = len(net.ids)

        # C trusts these sizes: an array is of the length that is told, or it is not handed over
        def kept(ctype: str, field: str, data: NDArray[Any], size: int) -> Any:
            if data.size != size:
                raise SolverArgumentError(f"{field} has shape {data.shape}: needs {size} values; correct it")
            with _LOCK:
                data = _ARRAYS.setdefault((ctype, data.tobytes()), data)
            self._kept.append(data)
            return ffi.from_buffer(ctype, data)

        def reals(values: ArrayLike, field: str = "network", size: int = n_vessels) -> Any:
            return kept("double[]", field, np.ascontiguousarray(values, dtype=np.float64), size)

        def ints(values: ArrayLike, field: str = "network", size: int = n_vessels) -> Any:
            return kept("int32_t[]", field, np.ascontiguousarray(values, dtype=np.int32), size)

        cells, length = self.grid()
        n = problem.network
        n.n_vessels = n_vessels
        n.parent, n.n_cells, n.length = ints(net.parent), ints(cells), reals(length)
        n.radius_in, n.radius_out = reals(net.radius_in_cm), reals(net.radius_out_cm)

        problem.fluid.density, problem.fluid.viscosity = net.density, net.viscosity
        problem.wall.law, problem.wall.factor = WALLS[self.wall], conventions.wall_factor
        problem.outlet.R1, problem.outlet.R2, problem.outlet.C = reals(net.R1), reals(net.R2), reals(net.C)
        problem.fluid.friction = FRICTIONS[conventions.friction]
        problem.fluid.friction_radius = conventions.friction_radius_cm
        self._shift = 0.0
        self._set_physics(problem, reals)

        curve, kind = self.inflow_ml_s, "flow"
        if self.inlet_pressure_mmHg.size:  # less that outside, as all pressures in C
            curve = mmhg_to_cgs(self.inlet_pressure_mmHg, conventions.mmhg) - self._shift
            kind = "pressure"
        problem.inlet.kind, problem.inlet.period = INLETS[kind], net.period_s
        problem.inlet.n_samples, problem.inlet.curve = len(curve), reals(curve, "the inlet", len(curve))

        known = {int(v) for v in net.ids}
        for vessel, position in self.series:
            if vessel not in known:
                raise SolverArgumentError(
                    f"series: vessel {vessel} is not in the network; it has {sorted(known)}"
                )
            if not 0 <= position <= 1:
                raise SolverArgumentError(f"series: position {position} of vessel {vessel} is not in [0, 1]")
        times = np.mod(self.times_s, net.period_s)
        times[self.times_s == net.period_s] = net.period_s
        self._order = np.argsort(times, kind="stable")
        out = problem.outputs
        out.n_series, out.n_times = len(self.series), len(times)
        out.vessel = ints([net.index(vessel) for vessel, _ in self.series], "series", len(self.series))
        out.position = reals([position for _, position in self.series], "series", len(self.series))
        out.times = reals(times[self._order], "times_s", len(times))

        num = problem.numerics
        num.cfl = options.cfl
        num.steps_per_beat = options.steps_per_beat * options.refine
        num.least_steps = options.least_steps * options.refine
        num.max_steps, num.max_beats = options.max_steps, options.max_beats
        given = options.tolerance_mmHg
        num.tolerance = conventions.mmhg if given is None else given * conventions.mmhg
        num.relative = TOLERANCE_SHARE if given is None else 0.0
        num.accelerate = options.accelerate
        self._problem = problem

    def _set_physics(self, problem: Any, reals: Callable[..., Any]) -> None:
        """Hand the physics to the native structs; an array that is None stays a null pointer."""
        added = self.physics
        added.fit(self.network)
        wall, throat, outlet = problem.wall, problem.throat, problem.outlet
        zero = np.zeros(len(self.network.ids))

        def give(struct: Any, field: str, values: Array | float | None) -> None:
            if isinstance(values, np.ndarray):
                size = values.size // len(values) * len(zero)
                setattr(struct, field, reals(values, f"physics: {field}", size))
            elif values is not None:
                setattr(struct, field, values)

        for part, names in _TERMS.items():
            for name in names:
                give(getattr(problem, part), name, getattr(added, name))

        def filled(values: Array | None, value: float = 0.0) -> Array:
            return zero + value if values is None else values

        behind = added.outflow_pressure
        if added.offset_in is not None or added.offset_out is not None:
            offset = filled(added.offset_in), filled(added.offset_out)
            if np.ptp(offset) == 0 and added.leak is None:
                # the same pressure outside everywhere: as if it were taken off behind all outlets, which is
                # faster
                self._shift = float(offset[0][0])
                behind = filled(behind) - self._shift if self._shift else behind
            else:
                wall.offset_in, wall.offset_out = reals(offset[0]), reals(offset[1])
        give(outlet, "pressure", behind)
        if added.outflow_wave is not None:
            outlet.n_wave = added.outflow_wave.shape[1]
            give(outlet, "wave", added.outflow_wave)
        if added.stiffness_wave is not None:
            wall.n_wave = len(added.stiffness_wave)
            wall.stiffness_wave = reals(added.stiffness_wave, "physics: stiffness_wave", wall.n_wave)

        if added.throat_severity is not None:
            throat.severity = reals(added.throat_severity)
            throat.position = reals(filled(added.throat_position, 0.5))
            throat.length = reals(filled(added.throat_length, THROAT_LENGTH_CM))
        for name in ("quadratic", "linear", "position", "length"):
            give(problem.loss, name, getattr(added, f"loss_{name}"))
        throat.loss, problem.junction.loss = added.throat_loss, added.junction_loss

        # a pressure is told less that outside, where that is the same everywhere
        for struct, function, less in (
            (wall.function, added.wall_function, 0.0),
            (problem.fluid.friction_function, added.friction_function, 0.0),
            (problem.junction.function, added.junction_function, 0.0),
            (outlet.resistance_function, added.outlet_resistance_function, self._shift),
            (outlet.compliance_function, added.outlet_compliance_function, self._shift),
        ):
            if function is not None and function.changes:
                struct.n_knots, struct.low, struct.high = (
                    len(function.values),
                    function.low - less,
                    function.high - less,
                )
                # at a place of its own: points of a direction that have functions are stepped one by one
                self._kept.append(np.array(function.values, dtype=np.float64))
                struct.values = ffi.from_buffer("double[]", self._kept[-1])

        net, responds = self.network, self.network.response_cosine is not None
        if net.response_cosine is not None and net.response_sine is not None:
            outlet.n_modes, n_values = net.response_cosine.shape[1], net.response_cosine.size
            turns = 2 * np.pi / net.period_s * np.arange(outlet.n_modes)
            outlet.mode_rate = 1 / (MEMORY_BEATS * net.period_s)
            outlet.mode_frequency = reals(turns, "network: response_cosine", len(turns))
            outlet.mode_cosine = reals(net.response_cosine, "network: response_cosine", n_values)
            outlet.mode_sine = reals(net.response_sine, "network: response_sine", n_values)
        circuit = responds or added.inertance is not None or added.section_resistance is not None
        outlet.kind = OUTLETS["circuit" if circuit else "windkessel"]
        if added.section_resistance is not None:
            outlet.n_sections = added.section_resistance.shape[1]

    def _broadcast(
        self, values: Sequence[ArrayLike], known: dict[tuple[str, int], Array] | None = None
    ) -> dict[str, Array]:
        """Parameters in their order as (n_vessels,), several shape parameters as (n_shapes, n_vessels).

        `known` has the rows of objects that came before, which must be alive, and gets those of new ones.
        """
        n_vessels, n_shapes = len(self.network.ids), len(SHAPES[self.wall])
        known = {} if known is None else known
        rows = {}
        for name, value in zip(PARAMETERS, values, strict=True):
            if (name, id(value)) not in known:
                data = real_array(name, value, error=SolverArgumentError)
                several = (n_shapes,) if name == "gamma" and n_shapes > 1 else ()
                try:
                    row = np.ascontiguousarray(np.broadcast_to(data, (*several, n_vessels)))
                except ValueError:
                    raise SolverArgumentError(
                        f"{name}: shape {data.shape} fits neither one value nor one per vessel ({n_vessels})"
                    ) from None
                known[name, id(value)] = row
            rows[name] = known[name, id(value)]
        return rows

    def _workspace(self) -> NDArray[np.uint8]:
        """Memory for one solve."""
        try:
            return self._workspaces.pop()
        except IndexError:  # there is none yet, or another thread has it
            pass
        size = self.workspace_bytes()
        try:
            return np.empty(size, dtype=np.uint8)
        except (MemoryError, ValueError):
            raise SolverArgumentError(
                f"a solve needs {size / 2**30:.3g} GB, more than there are: lower max_steps, the "
                "cells, or the series and times"
            ) from None

    def workspace_bytes(self) -> int:
        """Bytes of memory that one solve takes.

        Raises
        ------
        SolverArgumentError
            If there is not so much, or the network, the inflow or the options are out of range.
        """
        size = ffi.new("int64_t *")
        code = lib.zoo_workspace_size(self._problem, size)
        if code == lib.ZOO_WORKSPACE:
            raise SolverArgumentError(
                "memory is lacking for a network of this size; give fewer vessels or cells"
            )
        if code != lib.ZOO_OK:
            raise SolverArgumentError("the network, the inflow or the options are out of range")
        return int(size[0])

    def _reason(self, report: Any, values: dict[str, Array]) -> str:
        """Why a solve failed, in words; `values` are its parameters."""
        text: str = ffi.string(lib.zoo_status_text(report.status)).decode()
        if report.status == lib.ZOO_OK:
            return text
        where = f" in vessel {self.network.ids[report.vessel]}" if report.vessel >= 0 else ""
        if report.status == lib.ZOO_BAD_ARGUMENT and report.vessel >= 0:
            given = {name: value[..., report.vessel].ravel() for name, value in values.items()}
            wrong = [(n, x) for n, v in given.items() for x in v.tolist() if not 0 < x < np.inf]
            shares = self.physics.section_resistance
            if not wrong and shares is not None and np.any(shares[report.vessel] < 0):
                return (
                    f"section_resistance = {shares[report.vessel].tolist()}{where}: the negative sections, "
                    "times psi2 R2, must together be smaller than psi1 R1; lower them"
                )
            name, value = wrong[0] if wrong else ("stiffness", given["stiffness"][0])
            words = "must be positive and finite" if wrong else "is far out of range"
            return f"{name} = {value}{where}: {words}; correct it"
        when = f" at {report.time:.4g} s of the beat" if report.time > 0 else ""
        if report.status == lib.ZOO_NOT_PERIODIC:
            when = (
                f" of {self.options.max_beats} beats (last change "
                f"{cgs_to_mmhg(report.change, self.conventions.mmhg):.3g} mmHg)"
            )
        change = _ERRORS[report.status][1]
        if report.status in (lib.ZOO_CFL, lib.ZOO_COLLAPSE) and report.vessel >= 0:
            speed = self._speed_at_rest(report.vessel, values)
            where += f", whose waves run at {speed / 100:.3g} m/s at rest,"
        if report.status == lib.ZOO_CFL:
            when = f" with {report.steps_per_beat} steps in a beat"
            if report.max_cfl > 1:
                when += f": (|u| + c) dt/dx must stay below 1 and stood at {report.max_cfl:.2f}"
            if self.options.steps_per_beat:
                change = "raise steps_per_beat, or set it to 0 to have it chosen"
            else:
                chi = float(values["stiffness"][report.vessel])
                softer = chi * min(1.0, (0.5 / max(report.max_cfl, 1.0)) ** 2)
                change = (
                    "give it longer cells (dx_cm, accuracy_percent), or, where its wall is nearly rigid, a "
                    f"softer one, as stiffness = {softer:.1g} in place of {chi:.3g}"
                )
        if self.inlet_pressure_mmHg.size and report.vessel == 0:
            change += ", or correct inlet_pressure_mmHg (the file inlet_pressure of study.toml)"
        return f"{text}{where}{when}; {change}"

    def _speed_at_rest(self, vessel: int, values: dict[str, Array]) -> float:
        """Wave speed of a vessel (an index) at its inlet at rest, cm/s, without what is added to its wall."""
        shape = np.ascontiguousarray(values["gamma"][..., vessel]).reshape(-1)
        rest = np.pi * float(self.network.radius_in_cm[vessel]) ** 2
        found = lib.zoo_wave_speed(
            WALLS[self.wall],
            self.conventions.wall_factor,
            float(values["stiffness"][vessel]),
            ffi.from_buffer("double[]", shape),
            rest,
            rest,
            self.network.density,
        )
        return float(found)

    def solve(
        self,
        stiffness: ArrayLike,
        gamma: ArrayLike = 2.0,
        psi1: ArrayLike = 1.0,
        psi2: ArrayLike = 1.0,
        c: ArrayLike = 1.0,
        *,
        check: bool = True,
    ) -> Solution:
        """Solve to the periodic state at one set of parameters.

        Parameters
        ----------
        stiffness : float or array (n_vessels,)
            chi, g/(cm s^2).
        gamma : float or array (n_vessels,)
            Scaling parameter of the tangent wall; the linear wall does not read it. A wall with several shape
            parameters, ``SHAPES[wall]``, takes an array (n_shapes, n_vessels) or (n_shapes, 1).
        psi1, psi2, c : float or array (n_vessels,)
            Factors of the nominal R1, R2 and C; values at vessels that are not terminals are not read.
        check : bool
            Raise when the solve fails; otherwise the status says so.

        Returns
        -------
        Solution

        Raises
        ------
        SolverError
            One of its subclasses, when the solve fails and `check` is true.
        """
        rows = self._broadcast((stiffness, gamma, psi1, psi2, c))
        workspace = self._workspace()
        waves = [np.empty((len(self.series), len(self.times_s))) for _ in range(3)]
        fastest = np.empty(len(self.network.ids))
        report = ffi.new("zoo_report *")
        code = lib.zoo_solve(
            self._problem,
            _parameters(rows),
            ffi.from_buffer("char[]", workspace),
            workspace.nbytes,
            *(ffi.from_buffer("double[]", array) for array in (*waves, fastest)),
            report,
        )
        self._workspaces[:] = [workspace]
        if code != lib.ZOO_OK:
            raise SolverArgumentError(ffi.string(lib.zoo_status_text(code)).decode())
        if check and report.status != lib.ZOO_OK:
            raise _ERRORS[report.status][0](self._reason(report, rows))
        return self._solution(waves, fastest, report, rows)

    def _solution(self, waves: list[Array], fastest: Array, report: Any, rows: dict[str, Array]) -> Solution:
        waves = [self._at_times(wave) for wave in waves]
        mmhg = self.conventions.mmhg
        return Solution(
            pressure_mmHg=cgs_to_mmhg(waves[0] + self._shift, mmhg),
            flow_ml_s=waves[1],
            area_cm2=waves[2],
            status=report.status,
            reason=self._reason(report, rows),
            vessel=int(self.network.ids[report.vessel]) if report.vessel >= 0 else None,
            time_s=report.time,
            beats=report.beats,
            steps_per_beat=report.steps_per_beat,
            total_steps=report.total_steps,
            distance_mmHg=cgs_to_mmhg(report.distance, mmhg),
            max_cfl=report.max_cfl,
            inflow_ml=report.inflow,
            outflow_ml=report.outflow,
            junction_defect_ml_s=report.junction_defect,
            fastest_cm_s=fastest,
        )

    def jacobian(
        self,
        stiffness: ArrayLike,
        gamma: ArrayLike = 2.0,
        psi1: ArrayLike = 1.0,
        psi2: ArrayLike = 1.0,
        c: ArrayLike = 1.0,
        *,
        directions: Sequence[Direction],
        tolerance: float = TANGENT_TOLERANCE,
        check: bool = True,
    ) -> Derivatives:
        """Solve to the periodic state, and differentiate it in several directions.

        The derivatives are those of the discrete solution at the time steps that the solve chose: the time
        loop is linearised, and dx = J dx + b is solved for the state at the start of the beat, where J is the
        derivative of one beat's end by its start.

        Parameters
        ----------
        stiffness, gamma, psi1, psi2, c
            As in `solve`.
        directions : sequence of sequences of Point
            In each, how all arguments change, as differences between points near the solve's.
        tolerance : float
            Accepted error of the linear equations, over each direction's largest derivative of the pressure.
        check : bool
            Raise when the solve or its derivatives fail; otherwise the status says so.

        Returns
        -------
        Derivatives

        Raises
        ------
        SolverError
            One of its subclasses, when `check` is true.

        Examples
        --------
        >>> from zoo import load_study
        >>> from zoo.blood.directions import Point
        >>> solver = Solver.for_study(load_study("demo"))
        >>> h = 1.0
        >>> stiffer = [Point(1 / (2 * h), 5e4 + h), Point(-1 / (2 * h), 5e4 - h)]
        >>> solver.jacobian(5e4, directions=[stiffer]).pressure_mmHg.shape[0]
        1
        """
        known: dict[tuple[str, int], Array] = {}
        rows = self._broadcast((stiffness, gamma, psi1, psi2, c), known)
        n, shape = len(directions), (len(self.series), len(self.times_s))
        if n == 0:
            raise SolverArgumentError("directions: there is none; give at least one")
        tolerance = real_number("tolerance", tolerance, above=0.0, error=SolverArgumentError)
        kept: list[Any] = []
        built = ffi.new("zoo_direction[]", n)
        shift = np.zeros(n)
        for i, points in enumerate(directions):
            problems = ffi.new("zoo_problem *[]", len(points))
            sets = ffi.new("zoo_parameters *[]", len(points))
            weights = ffi.new("double[]", [float(point.weight) for point in points])
            for m, point in enumerate(points):
                solver = point.solver or self
                if not np.array_equal(solver.network.parent, self.network.parent):
                    raise SolverArgumentError(f"directions[{i}][{m}]: its solver has another tree")
                if solver.wall != self.wall:
                    raise SolverArgumentError(f"directions[{i}][{m}]: its solver has another wall")
                near = (point.stiffness, point.gamma, point.psi1, point.psi2, point.c)
                kept.append(_parameters(self._broadcast(near, known)))  # `known` keeps the rows
                sets[m] = kept[-1]
                if point.solver is not None:
                    problems[m] = solver._problem
                    kept.append(solver)
                    shift[i] += point.weight * (solver._shift - self._shift)
            built[i].n_points, built[i].problem = len(points), problems
            built[i].parameters, built[i].weight = sets, weights
            kept.extend((problems, sets, weights))
        waves = [np.empty(shape) for _ in range(3)]
        slopes = [np.empty((n, *shape)) for _ in range(3)]
        fastest = np.empty(len(self.network.ids))
        report, tangent = ffi.new("zoo_report *"), ffi.new("zoo_tangent_report *")
        try:
            room = self._rooms.pop()
        except IndexError:
            room = np.empty(0, dtype=np.uint8)
        code = lib.zoo_jacobian(
            self._problem,
            _parameters(rows),
            n,
            built,
            tolerance,
            ffi.from_buffer("char[]", room),
            room.nbytes,
            *(ffi.from_buffer("double[]", array) for array in (*waves, fastest, *slopes)),
            report,
            tangent,
        )
        self._rooms[:] = [room if tangent.room <= room.nbytes else np.empty(tangent.room, dtype=np.uint8)]
        if code != lib.ZOO_OK:
            where = f"directions[{tangent.direction}]: " if tangent.direction >= 0 else ""
            raise SolverArgumentError(where + ffi.string(lib.zoo_status_text(code)).decode())
        text = ffi.string(lib.zoo_status_text(tangent.status)).decode()
        if tangent.status != lib.ZOO_OK:
            where = f" in direction {tangent.direction}" if tangent.direction >= 0 else ""
            text = f"{text}{where}; {_ERRORS.get(tangent.status, (None, 'give fewer directions'))[1]}"
        if check and report.status != lib.ZOO_OK:
            raise _ERRORS[report.status][0](self._reason(report, rows))
        if check and tangent.status != lib.ZOO_OK:
            raise _ERRORS.get(tangent.status, (SolverArgumentError, ""))[0](text)
        slopes = [self._at_times(x) for x in slopes]
        slopes[0] = cgs_to_mmhg(slopes[0] + shift[:, None, None], self.conventions.mmhg)
        return Derivatives(
            solution=self._solution(waves, fastest, report, rows),
            pressure_mmHg=slopes[0],
            flow_ml_s=slopes[1],
            area_cm2=slopes[2],
            status=tangent.status,
            reason=text,
            beats=tangent.beats,
            along=bool(tangent.along),
            vectors=tangent.vectors,
            stepped=tangent.stepped,
            residual=tangent.residual,
        )

    def _at_times(self, wave: Array) -> Array:
        """From the order of time, in which C has them, to that of `times_s`."""
        back = np.empty_like(wave)
        back[..., self._order] = wave
        return back

    def settings(self) -> dict[str, Any]:
        """Wall, conventions, numerical options and what is added, for a run's record."""
        return {
            "wall": self.wall,
            "conventions": asdict(self.conventions),
            "options": asdict(self.options),
            "physics": self.physics.settings(),
        }
