"""Blood flow as functions that numba compiles: from theta to C and back, without Python in between.

They make the C structs as arrays of 64-bit words at the places that cffi knows, and call the library by
address. So they belong to the process that made them.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import numba  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Place
from zoo.blood.case_changes import NEAR
from zoo.blood.solver import SHAPES, STATUS_NAMES, TANGENT_TOLERANCE, Solver, ffi, lib
from zoo.core.arrays import Array
from zoo.core.derivatives import scales_at, widths_of
from zoo.core.forward import InNumba, Outputs
from zoo.core.in_numba import add, exchange
from zoo.core.parameters import Parameter

WORD = 8
FAILURES = (*(STATUS_NAMES[status] for status in range(1, len(STATUS_NAMES))), "not-finite")
"""Kinds of failed solves, by their status from 1 on."""
NOT_FINITE = len(FAILURES)
WAVES = ("pressure_mmHg", "flow_ml_s", "area_cm2")
"""In the order in which C gives them."""

njit = numba.njit(error_model="numpy")
_scales_at = njit(scales_at)


class Law(NamedTuple):
    """How a solve's parameters follow from theta, for numba.

    Parameters
    ----------
    pick : array (n_rows, n_vessels)
        For each parameter of the stiffness, each shape, psi1, psi2 and c, and each vessel the element of
        theta that it is, or -1.
    constant : array (n_rows, n_vessels)
        What it is elsewhere.
    n_stiffness : int
        Parameters x of the stiffness: x_0, or of three of them x_0 exp(x_1 `radius`) + x_2, times `scale`.
    scale, radius : array (n_vessels,)
    """

    pick: NDArray[np.int64]
    constant: Array
    n_stiffness: int
    scale: Array
    radius: Array

    @classmethod
    def of(
        cls,
        parameters: tuple[Parameter, ...],
        fixed: Mapping[str, Array],
        wall: str,
        stiffness: tuple[str, ...],
        scale: Array,
        radius: Array,
    ) -> Law | None:
        """By the names of the stiffness' parameters; None if one is missing, unknown or of another size."""
        starts: dict[str, Any] = {}
        at = 0
        for p in parameters:
            starts[p.name] = at + np.arange(p.size) if p.dims else at
            at += p.size
        shapes = SHAPES[wall]
        names = (*stiffness, *(shapes if len(shapes) > 1 else ("gamma",)), "psi1", "psi2", "c")
        constants: dict[str, Any] = {
            **dict.fromkeys((*shapes, "psi1", "psi2", "c"), 1.0),
            "gamma": 2.0,
            **fixed,
        }
        if not {p.name for p in parameters if not p.hyper} <= set(names):
            return None
        pick = np.full((len(names), len(scale)), -1)
        constant = np.zeros(pick.shape)
        for row, name in enumerate(names):
            if name not in starts and name not in constants:
                return None
            try:
                if name in starts:
                    pick[row] = starts[name]
                else:
                    constant[row] = constants[name]
            except ValueError:
                return None
        return cls(pick, constant, len(stiffness), scale, radius)


class View(NamedTuple):
    """Which of C's samples (3, n_places, n_times), in the order of time, are the series.

    Parameters
    ----------
    wave, place : array (n_series,)
        0, 1, 2 for pressure, flow, area; and where.
    order : array (n_times,)
        Where C's times are among the series'.
    shift, mmhg : float
        p = (p_cgs + shift)/mmhg.
    """

    wave: NDArray[np.int64]
    place: NDArray[np.int64]
    order: NDArray[np.int64]
    shift: float
    mmhg: float

    @classmethod
    def of(cls, outputs: Outputs, solver: Solver) -> View:
        """Of a solver at the places of the series."""
        series = cast("tuple[Place, ...]", outputs.series)
        places = {place: i for i, place in enumerate(solver.series)}
        wave = np.array([WAVES.index(quantity) for _, _, quantity in series])
        place = np.array([places[vessel, position] for vessel, position, _ in series])
        return cls(wave, place, solver._order, solver._shift, solver.conventions.mmhg)


def blood_flow(
    solver: Solver, outputs: Outputs, parameters: tuple[Parameter, ...], law: Law
) -> InNumba | None:
    """Series of a solver and their derivatives, as functions that numba compiles.

    They give what `zoo.blood.blood_flow.BloodFlow` gives with its `solve` and `solve_derivatives`.

    Parameters
    ----------
    solver : Solver
        At the places of the series, each once, and their times.
    outputs : Outputs
    parameters : tuple of Parameter
    law : Law

    Returns
    -------
    InNumba or None
        None where pointers are not of 64 bits.
    """
    if ffi.sizeof("void *") != WORD:
        return None
    n_rows, n_vessels = 1 + len(law.pick) - law.n_stiffness, law.pick.shape[1]
    shapes = (n_rows, n_vessels), (3, len(solver.series), len(solver.times_s)), outputs.shape
    rooms = Rooms()
    run = int(ffi.cast("intptr_t", solver._problem)), solver.workspace_bytes(), rooms.places, *shapes
    view = View.of(outputs, solver)
    width, about_zero, read = widths_of(parameters)

    # what these call is compiled once for all models: numbers in tuples are not taken for types of their own
    @njit
    def solve(theta):  # type: ignore[no-untyped-def]
        return _solve(theta, run, law, view)

    @njit
    def differentiate(theta):  # type: ignore[no-untyped-def]
        scales = _scales_at(theta, width, about_zero, read)
        return _differentiate(theta, scales, run, law, view)

    return InNumba(solve, differentiate, FAILURES, (solver, rooms))


def _place(struct: str, field: str, size: int = 8) -> int:
    """Of a field in a struct that is an array of numbers of this size."""
    return int(ffi.offsetof(struct, field)) // size


def _words(struct: str) -> int:
    return -(-int(ffi.sizeof(struct)) // WORD)


def _entry(name: str) -> Any:
    """An entry point of the library, which takes pointers as numbers."""
    kinds: dict[str, Any] = {"double": ctypes.c_double, "int32_t": ctypes.c_int32, "int64_t": ctypes.c_int64}
    function = ffi.typeof(getattr(lib, name))
    given = [ctypes.c_ssize_t if a.kind == "pointer" else kinds[a.cname] for a in function.args]
    address = int(ffi.cast("intptr_t", ffi.addressof(lib, name)))
    return ctypes.CFUNCTYPE(kinds[function.result.cname], *given)(address)


_malloc, _free = ctypes.CDLL(None).malloc, ctypes.CDLL(None).free
_malloc.argtypes, _malloc.restype = [ctypes.c_size_t], ctypes.c_ssize_t
_free.argtypes, _free.restype = [ctypes.c_ssize_t], None
_zoo_solve, _zoo_jacobian = _entry("zoo_solve"), _entry("zoo_jacobian")
STIFFNESS, SHAPE, PSI1, PSI2, C = (
    _place("zoo_parameters", name) for name in ("stiffness", "shape", "psi1", "psi2", "c")
)
PROBLEMS, SETS, WEIGHTS = (_place("zoo_direction", name) for name in ("problem", "parameters", "weight"))
N_POINTS = _place("zoo_direction", "n_points", 4)
ROOM = _place("zoo_tangent_report", "room")
STATUS, TANGENT_STATUS = _place("zoo_report", "status", 4), _place("zoo_tangent_report", "status", 4)
PARAMETERS, DIRECTION = _words("zoo_parameters"), _words("zoo_direction")
REPORT, TANGENT_REPORT = _words("zoo_report"), _words("zoo_tangent_report")


@njit
def _rows_at(theta, law, rows):  # type: ignore[no-untyped-def]
    """Write a solve's parameters (n_rows, n_vessels): stiffness, shapes, loads."""
    x = np.empty(len(law.pick))
    for vessel in range(rows.shape[1]):
        for i in range(len(x)):
            at = law.pick[i, vessel]
            x[i] = theta[at] if at >= 0 else law.constant[i, vessel]
        chi = x[0] * np.exp(x[1] * law.radius[vessel]) + x[2] if law.n_stiffness == 3 else x[0]
        rows[0, vessel] = chi * law.scale[vessel]
        rows[1:, vessel] = x[law.n_stiffness :]


@njit
def _seen(waves, view, is_slope, series):  # type: ignore[no-untyped-def]
    """Write series (n_series, n_times)."""
    for k in range(series.shape[0]):
        for j in range(series.shape[1]):
            x = waves[view.wave[k], view.place[k], j]
            if view.wave[k] == 0:
                x = (x if is_slope else x + view.shift) / view.mmhg
            series[k, view.order[j]] = x


# numba frees an array after the last line that names it, which must not be before C has used its address: the
# arrays belong to the functions that call those which take addresses


@njit
def _address_rows(rows, parameters):  # type: ignore[no-untyped-def]
    """Write a struct zoo_parameters (n_words,) whose arrays are rows (n_rows, n_vessels)."""
    step = WORD * rows.shape[1]
    first, loads = rows.ctypes.data, rows.ctypes.data + (rows.shape[0] - 3) * step
    parameters[STIFFNESS], parameters[SHAPE] = first, first + step
    parameters[PSI1], parameters[PSI2], parameters[C] = loads, loads + step, loads + 2 * step


@njit
def _run(problem, rows, parameters, workspace, waves, report):  # type: ignore[no-untyped-def]
    _address_rows(rows, parameters)
    code = _zoo_solve(
        problem, parameters.ctypes.data, workspace.ctypes.data, len(workspace),
        waves[0].ctypes.data, waves[1].ctypes.data, waves[2].ctypes.data, 0, report.ctypes.data,
    )  # fmt: skip
    return code if code != 0 else report.view(np.int32)[STATUS]


@njit
def _solve(theta, run, law, view):  # type: ignore[no-untyped-def]
    problem, room, _, of_rows, of_waves, of_series = run
    rows, parameters = np.empty(of_rows), np.empty(PARAMETERS, np.int64)
    workspace, report = np.empty(room, np.uint8), np.zeros(REPORT, np.int64)
    waves, series = np.empty(of_waves), np.empty(of_series)
    _rows_at(theta, law, rows)
    status = _run(problem, rows, parameters, workspace, waves, report)
    _seen(waves, view, False, series)
    return (NOT_FINITE if status == 0 and not np.all(np.isfinite(series)) else status), series


class Rooms:
    """Memory that calls leave to later ones, of any thread: fresh memory costs a third of a solve.

    Each begins with its size. Places hold addresses, or 0, and are emptied and filled at once.
    """

    def __init__(self) -> None:
        self.addresses = np.zeros(os.cpu_count() or 1, np.int64)
        self.places = int(self.addresses.ctypes.data), len(self.addresses)

    def __del__(self, free: Any = _free) -> None:
        for address in self.addresses.tolist():
            free(address)


@njit
def _taken(rooms):  # type: ignore[no-untyped-def]
    places, n = rooms
    for i in range(n):
        room = exchange(places + WORD * i, 0)
        if room != 0:
            return room
    return 0


@njit
def _give_back(rooms, room):  # type: ignore[no-untyped-def]
    places, n = rooms
    for i in range(n):
        if room != 0:
            room = exchange(places + WORD * i, room)
    _free(room)


@njit
def _run_directions(  # type: ignore[no-untyped-def]
    problem, rooms, at, points, parameters, sets, weights, directions, waves, slopes, report, tangent
):
    n = len(directions)
    _address_rows(at, parameters[2 * n])
    for i in range(n):
        for side in range(2):
            _address_rows(points[i, side], parameters[2 * i + side])
            sets[i, side] = parameters[2 * i + side].ctypes.data
        directions[i].view(np.int32)[N_POINTS] = 2
        directions[i, PROBLEMS], directions[i, SETS] = 0, sets[i].ctypes.data
        directions[i, WEIGHTS] = weights[i].ctypes.data
    room = _taken(rooms)
    size = add(room, 0) if room != 0 else 0
    code = _zoo_jacobian(
        problem, parameters[2 * n].ctypes.data, n, directions.ctypes.data, TANGENT_TOLERANCE,
        room + WORD, size,
        waves[0].ctypes.data, waves[1].ctypes.data, waves[2].ctypes.data, 0,
        slopes[0].ctypes.data, slopes[1].ctypes.data, slopes[2].ctypes.data,
        report.ctypes.data, tangent.ctypes.data,
    )  # fmt: skip
    if tangent[ROOM] > size:
        _free(room)
        size = tangent[ROOM]
        room = _malloc(WORD + size)
        if room != 0:
            exchange(room, size)
    _give_back(rooms, room)
    if code != 0:
        return code
    status = report.view(np.int32)[STATUS]
    return status if status != 0 else tangent.view(np.int32)[TANGENT_STATUS]


@njit
def _differentiate(theta, scales, run, law, view):  # type: ignore[no-untyped-def]
    """Along the elements of theta whose scale is not zero, by central differences of the parameters."""
    problem, _, rooms, of_rows, of_waves, of_series = run
    read = np.flatnonzero(scales)
    n = len(read)
    at, points = np.empty(of_rows), np.empty((n, 2, of_rows[0], of_rows[1]))
    parameters, sets = np.empty((2 * n + 1, PARAMETERS), np.int64), np.empty((n, 2), np.int64)
    weights, directions = np.empty((n, 2)), np.zeros((n, DIRECTION), np.int64)
    waves, slopes = np.empty(of_waves), np.empty((3, n, of_waves[1], of_waves[2]))
    report, tangent = np.zeros(REPORT, np.int64), np.zeros(TANGENT_REPORT, np.int64)
    _rows_at(theta, law, at)
    for i in range(n):
        moved = theta.copy()
        for side, step in enumerate((NEAR * scales[read[i]], -NEAR * scales[read[i]])):
            moved[read[i]] = theta[read[i]] + step
            _rows_at(moved, law, points[i, side])
            weights[i, side] = 0.5 / step
    status = _run_directions(
        problem, rooms, at, points, parameters, sets, weights, directions, waves, slopes, report, tangent
    )
    series, by_theta = np.empty(of_series), np.zeros((len(theta), of_series[0], of_series[1]))
    _seen(waves, view, False, series)
    for i in range(n):
        _seen(slopes[:, i], view, True, by_theta[read[i]])
    if status == 0 and not (np.all(np.isfinite(series)) and np.all(np.isfinite(by_theta))):
        status = NOT_FINITE
    return status, series, by_theta
