"""What callers hand to the solver: every array, number and setting that does not fit is refused by name."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from zoo.blood.network import Network
from zoo.blood.physics import Physics
from zoo.blood.solve_errors import SolverArgumentError
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import StudyError, load_study
from zoo.core.arrays import real_array, real_number, whole_array, whole_number
from zoo.core.forward import SolveError

ARRAYS = ("parent", "length_cm", "radius_in_cm", "radius_out_cm", "R1", "R2", "C")
NO_ARRAY = ["abc", ["1", "2"], None, [None] * 3, [1 + 2j] * 3, [True] * 3, object(), {}, [[1, 2], [3]]]


@pytest.fixture(scope="module")
def solver() -> Solver:
    return Solver.for_study(load_study("demo"), options=SolverOptions(dx_cm=0.2))


def one_line(caught: pytest.ExceptionInfo[BaseException]) -> str:
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < 400
    return text


@pytest.mark.parametrize("name", ARRAYS)
def test_an_array_of_another_length_names_itself(solver: Solver, name: str) -> None:
    """A short R2 once gave a wave that was wrong by 6.5 mmHg, read from beyond its end."""
    values = getattr(solver.network, name)
    for wrong in (values[:-1], np.append(values, values[-1]), values[:0]):
        with pytest.raises(StudyError, match=rf"network: {name} has {len(wrong)} values") as caught:
            replace(solver.network, **{name: wrong})
        assert not isinstance(caught.value, SolveError)  # sampling must not take it for a failed solve
        one_line(caught)


@pytest.mark.parametrize("name", ["ids", *ARRAYS])
@pytest.mark.parametrize("wrong", [*NO_ARRAY, 3.0, np.ones((2, 3)), [10**400] * 3, [2**80]])
def test_what_is_no_array_of_numbers_names_itself(solver: Solver, name: str, wrong: Any) -> None:
    with pytest.raises(StudyError, match=rf"network: {name}") as caught:
        replace(solver.network, **{name: wrong})
    one_line(caught)


@pytest.mark.parametrize("name", ["length_cm", "radius_in_cm", "radius_out_cm", "R1", "R2", "C"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_a_value_out_of_range_is_a_failed_solve_too(solver: Solver, name: str, value: float) -> None:
    """Effects change these: a draw that goes too far has no solution, which is no reason to stop."""
    last = int(solver.network.terminals[-1])
    values = getattr(solver.network, name).copy()
    values[last] = value
    with pytest.raises(StudyError, match=rf"network: {name}\[{last}\] = {value}: must be positive") as caught:
        replace(solver.network, **{name: values})
    assert isinstance(caught.value, SolverArgumentError)


@pytest.mark.parametrize("name", ["density", "viscosity", "period_s"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0, "1", None, True, 1j, [1.0], 10**400])
def test_a_number_of_a_network_is_one(solver: Solver, name: str, value: Any) -> None:
    with pytest.raises(StudyError, match=f"network: {name} = ") as caught:
        replace(solver.network, **{name: value})
    one_line(caught)


def test_parents_and_ids_are_a_tree(solver: Solver) -> None:
    net = solver.network
    for wrong in (np.full(len(net.ids), -1), np.arange(len(net.ids)), np.arange(len(net.ids)) - 7):
        with pytest.raises(StudyError, match=r"network: parent\[\d+\] = "):
            replace(net, parent=wrong)
    with pytest.raises(StudyError, match="stands twice"):
        replace(net, ids=np.full(len(net.ids), 4))
    with pytest.raises(StudyError, match=r"network: ids\[0\] = 1.5: must be a whole number"):
        replace(net, ids=net.ids + 0.5)
    with pytest.raises(StudyError, match=r"ids\[0\] = 3000000000.0: must be a whole number of 32 bits"):
        replace(net, ids=np.full(len(net.ids), 3e9))
    empty: Any = np.empty(0)
    with pytest.raises(StudyError, match=r"ids = .*: must hold a vessel"):
        Network(empty, empty, empty, empty, empty, empty, empty, empty, 1.0, 1.0, 1.0)


def test_a_network_that_was_changed_behind_its_back_does_not_reach_c(solver: Solver) -> None:
    net = replace(solver.network)
    object.__setattr__(net, "R2", net.R2[:-1])
    with pytest.raises(SolverArgumentError, match=r"has shape \(\d+,\): needs \d+ values"):
        Solver(net, solver.inflow_time_s, solver.inflow_ml_s)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t[::-1], "within a hundredth of a step"),
        (lambda t: 2 * t, "within a hundredth of a step"),
        (lambda t: t + 0.02 * t[1], "within a hundredth of a step"),
        (lambda t: t[:0], "inflow_time_s has 0 values and inflow_ml_s"),
        (lambda t: t[:-1], "inflow_time_s has"),
        (lambda t: np.where(np.arange(len(t)) == 3, np.nan, t), r"inflow_time_s\[3\] = nan: must be finite"),
        (lambda t: t[:, None], "must have one axis"),
        (lambda t: t.astype(str), "must be an array of real numbers"),
        (lambda t: t + 0j, "must be an array of real numbers"),
    ],
)
def test_times_of_the_inflow_are_what_the_solver_takes_them_for(
    solver: Solver, change: Any, words: str
) -> None:
    with pytest.raises(SolverArgumentError, match=words) as caught:
        Solver(solver.network, change(solver.inflow_time_s), solver.inflow_ml_s)
    one_line(caught)


def test_times_may_be_rounded(solver: Solver) -> None:
    Solver(solver.network, np.round(solver.inflow_time_s, 6), solver.inflow_ml_s)


@pytest.mark.parametrize(
    ("flow", "words"),
    [
        ([1.0, np.nan, 1.0, 1.0], r"inflow_ml_s\[1\] = nan: must be finite"),
        ([1e308] * 4, "its mean is inf"),
        ([-1.0] * 4, "its mean is -1"),
        ([1.0] * 3, "needs at least 4"),
        ([[1.0] * 4], "must have one axis"),
        (["1"] * 4, "must be an array of real numbers"),
        ([True] * 4, "must be an array of real numbers"),
        (np.ma.masked_values([1.0, 2.0, 3.0, 4.0], 2.0), "must be an array of real numbers"),
    ],
)
def test_inflow_is_an_array_of_numbers(solver: Solver, flow: Any, words: str) -> None:
    times = np.arange(np.size(flow)) * solver.network.period_s / np.size(flow)
    with pytest.raises(SolverArgumentError, match=words) as caught:
        Solver(solver.network, times, flow)
    one_line(caught)


@pytest.mark.parametrize("vessel", [1.7, "1", None, True, np.nan, np.inf, 2**40, [1], 1j])
def test_a_vessel_is_a_whole_number(solver: Solver, vessel: Any) -> None:
    with pytest.raises(SolverArgumentError, match=r"series\[0\]: vessel = .*: must be a whole number"):
        Solver(solver.network, solver.inflow_time_s, solver.inflow_ml_s, series=[(vessel, 0.0)])
    with pytest.raises(StudyError, match=r"vessel = .*: must be a whole number"):
        solver.network.index(vessel)


@pytest.mark.parametrize(
    ("name", "given"),
    [("series", series) for series in (3, None, [(1,)], [(1, 0.0, 2)], [1], "ab")]
    + [("position", [(1, x)]) for x in ("0", None, np.nan, -0.1, 1.1, True, [0.5])]
    + [("times_s", times) for times in ("now", None, [np.nan], [np.inf], [[0.0]], 0.0, [None], [1j])],
)
def test_series_are_pairs_in_the_vessels_and_times_are_finite(solver: Solver, name: str, given: Any) -> None:
    outputs: dict[str, Any] = {"series": [(1, 0.0)], "times_s" if name == "times_s" else "series": given}
    with pytest.raises(SolverArgumentError, match=name):
        Solver(solver.network, solver.inflow_time_s, solver.inflow_ml_s, **outputs)


def test_a_period_of_denormal_length_is_refused(solver: Solver) -> None:
    """It once crashed: 0/0 as an index."""
    net = replace(solver.network, period_s=5e-324)
    times = np.zeros(len(solver.inflow_ml_s))
    with pytest.raises(SolverArgumentError):
        Solver(net, times, solver.inflow_ml_s).solve(5e4)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (name, value)
        for name in ("refine", "steps_per_beat", "least_steps", "max_steps", "max_beats")
        for value in (1.5, "2", None, -1, 2**31 - 1, 10**400, np.nan, True, [1])
    ]
    + [
        (name, value)
        for name in ("dx_cm", "cfl", "tolerance_mmHg")
        for value in (0.0, -1.0, np.nan, np.inf, "1", None, True)
        if (name, value) != ("tolerance_mmHg", None)
    ]
    + [("cfl", 1.5)],
)
def test_settings_are_numbers_in_their_range(name: str, value: Any) -> None:
    with pytest.raises(SolverArgumentError, match=f"{name} = "):
        SolverOptions(**{name: value})


@pytest.mark.parametrize("options", [{"dx_cm": 1e-300}, {"cells": (2**28,) * 15}, {"refine": 2**28}])
def test_more_cells_than_an_int_holds_are_refused(options: dict[str, Any]) -> None:
    """`n_cells` once overflowed to negative sizes."""
    study = load_study("demo")
    n = len(study.vessels)
    if "cells" in options:
        options = {"cells": options["cells"][:1] * n}
    with pytest.raises(SolverArgumentError, match=r"cells: .* must be at most 268435456"):
        Solver.for_study(study, options=SolverOptions(**options))


def test_memory_that_is_not_there_is_one_line(solver: Solver, monkeypatch: pytest.MonkeyPatch) -> None:
    fresh = Solver(solver.network, solver.inflow_time_s, solver.inflow_ml_s)
    monkeypatch.setattr(np, "empty", lambda *_, **__: np.ones(2**60))
    with pytest.raises(SolverArgumentError, match=r"a solve needs .* GB, more than there are:") as caught:
        fresh.solve(5e4)
    one_line(caught)


@pytest.mark.parametrize("name", ["stiffness", "gamma", "psi1", "psi2", "c"])
@pytest.mark.parametrize("value", ["abc", ["1"], None, 1j, True, [[1.0], [2.0, 3.0]], np.ones((2, 3, 4))])
def test_parameters_are_arrays_of_numbers(solver: Solver, name: str, value: Any) -> None:
    values: dict[str, Any] = {"stiffness": 5e4, name: value}
    with pytest.raises(SolverArgumentError, match=name) as caught:
        solver.solve(**values)
    one_line(caught)


@pytest.mark.parametrize("name", ["stiffness", "psi1", "psi2", "c"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, -1.0])
def test_a_parameter_out_of_range_names_itself(solver: Solver, name: str, value: float) -> None:
    last = int(solver.network.terminals[-1])
    values: dict[str, Any] = {"stiffness": np.full(len(solver.network.ids), 5e4)}
    values[name] = values.get(name, np.ones(len(solver.network.ids))).copy()
    values[name][last] = value
    vessel = solver.network.ids[last]
    with pytest.raises(SolverArgumentError, match=rf"{name} = {value} in vessel {vessel}") as caught:
        solver.solve(**values)
    one_line(caught)


def test_what_c_was_told_the_size_of_cannot_be_changed() -> None:
    made = Solver.for_study(load_study("demo"))
    for name, value in {"series": made.series * 4, "times_s": made.times_s[:3], "wall": "tangent"}.items():
        with pytest.raises(AttributeError, match=f"Solver: {name} cannot be changed"):
            setattr(made, name, value)
    for array in (made.times_s, made.inflow_time_s, made.inflow_ml_s):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = np.nan
    copied = pickle.loads(pickle.dumps(made))
    with pytest.raises(AttributeError, match="Solver: series"):
        copied.series = ()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (name, value)
        for name in ("viscosity_factor", "leak", "inertance", "stiffness_wave", "offset_in")
        for value in ("abc", ["1", "2"], [None], [1j], [True], 1.0, [[1.0]], [np.nan], [10**400])
    ]
    + [
        (name, value)
        for name in ("momentum_correction", "stokes_friction", "relaxation_time", "junction_loss")
        for value in ("1", None, [1.0], True, 1j, np.nan, -1.0, 10**400)
    ],
)
def test_physics_takes_numbers_and_arrays_of_them(name: str, value: Any) -> None:
    with pytest.raises(SolverArgumentError, match=f"physics: {name}") as caught:
        Physics(**{name: value})
    one_line(caught)


def test_an_array_that_fits_is_not_copied_and_keeps_its_bits() -> None:
    values = np.array([1.0, 5e-324, -0.0, np.inf, np.nan])
    assert real_array("x", values) is values or np.shares_memory(real_array("x", values), values)
    assert real_array("x", values).tobytes() == values.tobytes()
    turned = np.arange(6.0).reshape(2, 3).T
    assert real_array("x", turned).flags.c_contiguous
    assert np.array_equal(real_array("x", turned), turned)
    assert real_array("x", np.float32(1.5)).shape == ()
    assert real_array("x", []).shape == (0,)
    assert whole_array("x", [1.0, 2.0]).dtype == np.int32
    assert whole_number("x", np.int64(3)) == 3
    assert real_number("x", np.float32(1.5)) == 1.5
    for wrong in (1.5, "1", True, 2**31):
        with pytest.raises(ValueError, match=re.escape("x = ")):
            whole_number("x", wrong, 0, 2**31 - 1)
