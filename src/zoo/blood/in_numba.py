"""Blood flow as functions that numba compiles: from theta to C and back, without Python in between.

They make the C structs as arrays of 64-bit words at the places that cffi knows, and call the library by address.
So they belong to the process that made them.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

import numba  # type: ignore[import-untyped]
import numpy as np
from numpy.typing import NDArray

from zoo._native import ffi, lib
from zoo.blood.case import Place
from zoo.blood.derivatives import NEAR
from zoo.blood.solver import SHAPES, STATUS_NAMES, TANGENT_TOLERANCE, Solver
from zoo.core.derivatives import scales_at, widths_of
from zoo.core.forward import InNumba

if TYPE_CHECKING:
    from zoo.blood.forward import BloodFlow

Array = NDArray[np.float64]
Shape = tuple[int, ...]
WORD = 8
FAILURES = (*(STATUS_NAMES[status] for status in range(1, len(STATUS_NAMES))), "not-finite")
"""Kinds of failed solves, by their status from 1 on."""
NOT_FINITE = len(FAILURES)
WAVES = ("pressure_mmHg", "flow_ml_s", "area_cm2")
"""In the order in which C gives them."""
DEFAULTS = {"gamma": 2.0, "psi1": 1.0, "psi2": 1.0, "c": 1.0}

njit = numba.njit(error_model="numpy")
_scales_at = njit(scales_at)


def blood_flow(
    flow: BloodFlow, solver: Solver, law: tuple[str, ...], scale: Array, radius: Array
) -> InNumba | None:
    """Series of blood flow and their derivatives, as `BloodFlow` gives them, in functions that numba compiles.

    Parameters
    ----------
    flow : BloodFlow
    solver : Solver
        At the places of the model's series, each once, and its times.
    law : tuple of str
        Parameters x of the stiffness: x_0, or with three of them x_0 exp(x_1 `radius`) + x_2, times `scale`.
    scale, radius : array (n_vessels,)

    Returns
    -------
    InNumba or None
        None where a parameter is missing or of another size, or pointers are not of 64 bits.
    """
    shapes = SHAPES[flow.wall] if len(SHAPES[flow.wall]) > 1 else ("gamma",)
    found = _rows(flow, (*law, *shapes, "psi1", "psi2", "c"))
    if found is None or ffi.sizeof("void *") != WORD:
        return None
    rows_at = _rows_at(*found, len(law), scale, radius)
    seen, n_places = _seen(flow, solver)
    size = (1 + len(shapes) + 3, len(flow.network.ids)), (3, n_places, len(solver.times_s)), flow.outputs.shape
    solve = _solve(solver, rows_at, seen, *size)
    return InNumba(solve, _differentiate(flow, solver, rows_at, seen, *size), FAILURES, solver)


def _rows(flow: BloodFlow, names: tuple[str, ...]) -> tuple[NDArray[np.int64], Array] | None:
    """For each name and vessel the element of theta that it is, or -1 and a constant: (n_names, n_vessels)."""
    starts: dict[str, Any] = {}
    at = 0
    for p in flow.parameters:
        starts[p.name] = at + np.arange(p.size) if p.dims else at
        at += p.size
    constants = {**DEFAULTS, **dict.fromkeys(SHAPES[flow.wall][1:], 1.0), **flow.fixed}
    pick, constant = np.full((len(names), len(flow.network.ids)), -1), np.zeros((len(names), len(flow.network.ids)))
    for row, name in enumerate(names):
        if name not in starts and name not in constants:
            return None
        try:
            if name in starts:
                pick[row] = starts[name]
            else:
                constant[row] = constants[name]
        except ValueError:  # neither one value nor one for each vessel
            return None
    return pick, constant


def _rows_at(
    pick: NDArray[np.int64], constant: Array, n_law: int, scale: Array, radius: Array
) -> Callable[..., None]:
    """Function that writes a solve's parameters (n_rows, n_vessels) at theta: stiffness, shapes, loads."""

    @njit
    def value(theta, row, vessel):  # type: ignore[no-untyped-def]
        at = pick[row, vessel]
        return theta[at] if at >= 0 else constant[row, vessel]

    @njit
    def rows_at(theta, rows):  # type: ignore[no-untyped-def]
        for vessel in range(rows.shape[1]):
            chi = value(theta, 0, vessel)
            if n_law == 3:
                chi = chi * np.exp(value(theta, 1, vessel) * radius[vessel]) + value(theta, 2, vessel)
            rows[0, vessel] = chi * scale[vessel]
            for row in range(1, rows.shape[0]):
                rows[row, vessel] = value(theta, n_law - 1 + row, vessel)

    return rows_at  # type: ignore[no-any-return]


def _seen(flow: BloodFlow, solver: Solver) -> tuple[Callable[..., None], int]:
    """Function from C's samples (3, n_places, n_times), in the order of time, to series; and how many places."""
    places: dict[tuple[int, float], int] = {}
    series = cast("tuple[Place, ...]", flow.outputs.series)
    at = np.array([places.setdefault((vessel, x), len(places)) for vessel, x, _ in series])
    wave = np.array([WAVES.index(quantity) for _, _, quantity in series])
    order, shift, mmhg = solver._order, solver._shift, solver.conventions.mmhg

    @njit
    def seen(waves, is_slope, series):  # type: ignore[no-untyped-def]
        for k in range(series.shape[0]):
            for j in range(series.shape[1]):
                x = waves[wave[k], at[k], j]
                if wave[k] == 0:
                    x = (x if is_slope else x + shift) / mmhg
                series[k, order[j]] = x

    return seen, len(places)


def _words(struct: str) -> int:
    return -(-int(ffi.sizeof(struct)) // WORD)


def _place(struct: str, field: str, size: int = WORD) -> int:
    """Of a field in a struct that is an array of numbers of this size."""
    return int(ffi.offsetof(struct, field)) // size


def _entry(name: str) -> Any:
    """An entry point of the library, which takes pointers as numbers."""
    kinds = {"double": ctypes.c_double, "int32_t": ctypes.c_int32, "int64_t": ctypes.c_int64}
    function = ffi.typeof(getattr(lib, name))
    given = [ctypes.c_ssize_t if a.kind == "pointer" else kinds[a.cname] for a in function.args]
    address = int(ffi.cast("intptr_t", ffi.addressof(lib, name)))
    return ctypes.CFUNCTYPE(kinds[function.result.cname], *given)(address)


STIFFNESS, SHAPE, PSI1, PSI2, C = (
    _place("zoo_parameters", name) for name in ("stiffness", "shape", "psi1", "psi2", "c")
)
N_POINTS, PROBLEMS, SETS, WEIGHTS = (
    _place("zoo_direction", name, size)
    for name, size in (("n_points", 4), ("problem", WORD), ("parameters", WORD), ("weight", WORD))
)
STATUS = _place("zoo_report", "status", 4)
TANGENT_STATUS = _place("zoo_tangent_report", "status", 4)

# numba frees an array after the last line that names it, which must not be before C has used its address: the
# arrays belong to the functions that call those which take addresses


@njit
def _address_rows(rows, parameters):  # type: ignore[no-untyped-def]
    """Write a struct zoo_parameters (n_words,) whose arrays are rows (n_rows, n_vessels)."""
    step = WORD * rows.shape[1]
    first, loads = rows.ctypes.data, rows.ctypes.data + (rows.shape[0] - 3) * step
    parameters[STIFFNESS], parameters[SHAPE] = first, first + step
    parameters[PSI1], parameters[PSI2], parameters[C] = loads, loads + step, loads + 2 * step


def _solve(
    solver: Solver, rows_at: Any, seen: Any, of_rows: Shape, of_waves: Shape, of_series: Shape
) -> Callable[..., Any]:
    entry, problem = _entry("zoo_solve"), int(ffi.cast("intptr_t", solver._problem))
    room, n_parameters, n_report = solver.workspace_bytes(), _words("zoo_parameters"), _words("zoo_report")

    @njit
    def run(rows, parameters, workspace, p, q, a, report):  # type: ignore[no-untyped-def]
        _address_rows(rows, parameters)
        code = entry(
            problem, parameters.ctypes.data, workspace.ctypes.data, room,
            p.ctypes.data, q.ctypes.data, a.ctypes.data, 0, report.ctypes.data,
        )  # fmt: skip
        return code if code != 0 else report.view(np.int32)[STATUS]

    @njit
    def solve(theta):  # type: ignore[no-untyped-def]
        rows, parameters = np.empty(of_rows), np.empty(n_parameters, np.int64)
        workspace, report = np.empty(room, np.uint8), np.zeros(n_report, np.int64)
        waves, series = np.empty(of_waves), np.empty(of_series)
        rows_at(theta, rows)
        status = run(rows, parameters, workspace, waves[0], waves[1], waves[2], report)
        seen(waves, False, series)
        return (NOT_FINITE if status == 0 and not np.all(np.isfinite(series)) else status), series

    return solve  # type: ignore[no-any-return]


def _differentiate(
    flow: BloodFlow, solver: Solver, rows_at: Any, seen: Any, of_rows: Shape, of_waves: Shape, of_series: Shape
) -> Callable[..., Any]:
    entry, problem = _entry("zoo_jacobian"), int(ffi.cast("intptr_t", solver._problem))
    n_parameters, n_report = _words("zoo_parameters"), _words("zoo_report")
    n_direction, n_tangent = _words("zoo_direction"), _words("zoo_tangent_report")
    width, about_zero, is_read = widths_of(flow.parameters)
    read = np.flatnonzero(is_read)
    n = len(read)

    @njit
    def run(at, points, parameters, sets, weights, directions, waves, slopes, report, tangent):  # type: ignore[no-untyped-def]
        _address_rows(at, parameters[2 * n])
        for i in range(n):
            for side in range(2):
                _address_rows(points[i, side], parameters[2 * i + side])
                sets[i, side] = parameters[2 * i + side].ctypes.data
            directions[i].view(np.int32)[N_POINTS] = 2
            directions[i, PROBLEMS] = 0
            directions[i, SETS] = sets[i].ctypes.data
            directions[i, WEIGHTS] = weights[i].ctypes.data
        code = entry(
            problem, parameters[2 * n].ctypes.data, n, directions.ctypes.data, TANGENT_TOLERANCE, 0, 0,
            waves[0].ctypes.data, waves[1].ctypes.data, waves[2].ctypes.data, 0,
            slopes[0].ctypes.data, slopes[1].ctypes.data, slopes[2].ctypes.data,
            report.ctypes.data, tangent.ctypes.data,
        )  # fmt: skip
        if code != 0:
            return code
        status = report.view(np.int32)[STATUS]
        return status if status != 0 else tangent.view(np.int32)[TANGENT_STATUS]

    @njit
    def differentiate(theta):  # type: ignore[no-untyped-def]
        at, points = np.empty(of_rows), np.empty((n, 2, *of_rows))
        parameters, sets = np.empty((2 * n + 1, n_parameters), np.int64), np.empty((n, 2), np.int64)
        weights, directions = np.empty((n, 2)), np.zeros((n, n_direction), np.int64)
        waves, slopes = np.empty(of_waves), np.empty((3, n, *of_waves[1:]))
        report, tangent = np.zeros(n_report, np.int64), np.zeros(n_tangent, np.int64)
        rows_at(theta, at)
        scales = _scales_at(theta, width, about_zero, is_read)
        for i in range(n):
            h = NEAR * scales[read[i]]
            moved = theta.copy()
            for side, step in enumerate((h, -h)):
                moved[read[i]] = theta[read[i]] + step
                rows_at(moved, points[i, side])
                weights[i, side] = 0.5 / step
        status = run(at, points, parameters, sets, weights, directions, waves, slopes, report, tangent)
        series, by_theta = np.empty(of_series), np.zeros((len(theta), *of_series))
        seen(waves, False, series)
        for i in range(n):
            seen(slopes[:, i], True, by_theta[read[i]])
        if status == 0 and not (np.all(np.isfinite(series)) and np.all(np.isfinite(by_theta))):
            status = NOT_FINITE
        return status, series, by_theta

    return differentiate  # type: ignore[no-any-return]
