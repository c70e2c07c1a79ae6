"""Derivatives of blood flow by its parameters, and gradients of the operations made of them."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytensor
import pytensor.tensor as pt
import pytest
from pytensor.gradient import verify_grad

from made import SEARCH, THETA, baseline_of
from test_op import POINT, at, flow
from zoo.blood.baseline import get_baseline
from zoo.blood.case import Case, same_run, with_physics
from zoo.blood.directions import Derivatives, Point
from zoo.blood.effects import CATALOGUE
from zoo.blood.effects.given import added_effects
from zoo.blood.solve_errors import NoDerivativeError, SolverArgumentError
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Study, load_study
from zoo.core.derivatives import jacobian
from zoo.core.effects import EVERYWHERE, Effect, EffectParameter, Location, with_effects
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.op import ForwardOp, MissingGradientError, observed_series
from zoo.core.parameters import Parameter, Uniform, pack

EXACT = SolverOptions(dx_cm=0.05, steps_per_beat=2048, tolerance_mmHg=1e-10, max_beats=300)
"""Fixed steps, and so near the periodic state that differences are of the discrete solution's rounding."""


def differences(solve: Any, theta: np.ndarray, i: int, h: float) -> np.ndarray:
    """By element i, of fourth order."""

    def f(step: float) -> np.ndarray:
        moved = theta.copy()
        moved[i] += step
        return np.asarray(solve(moved))

    return (8 * (f(h) - f(-h)) - (f(2 * h) - f(-2 * h))) / (12 * h)


@pytest.mark.parametrize("wall", ["linear", "tangent", "olufsen"])
def test_parameters(study: Study, wall: str) -> None:
    model = flow(study, wall, options=EXACT)
    theta = at((9e4, 4.0, *POINT[2:]))
    found = jacobian(model, theta)
    assert found is not None
    np.testing.assert_allclose(found.values, model.solve(model.configure(theta)), rtol=1e-12)
    for i in range(len(theta)):
        expected = differences(lambda x: model.solve(model.configure(x)), theta, i, 1e-3 * theta[i])
        most = np.abs(expected).max(axis=1, keepdims=True)
        assert np.all(np.abs(found.slopes[i] - expected) <= 1e-6 * most)


@pytest.mark.parametrize(
    "effects",
    [
        {"viscoelastic-wall": 0.002, "minor-losses": 1.0},
        {"vessel-length@2": 0.1, "hydrostatic": 0.1},
        {"local-stiffness@2": 0.2, "stenosis@3": 0.3},
    ],
)
def test_effects(study: Study, effects: dict[str, float]) -> None:
    base = get_baseline("B").forward(study, options=EXACT)
    model = with_effects(base, added_effects(list(effects), base))
    theta = np.concatenate([[5e4, 0.3, 0.9, 1.2], list(effects.values())])
    found = jacobian(model, theta)
    assert found is not None
    for i in range(len(theta)):
        step = 1e-3 * abs(theta[i])
        expected = differences(lambda x: model.solve(model.configure(x)), theta, i, step)
        most = np.abs(expected).max(axis=1, keepdims=True)
        assert np.all(np.abs(found.slopes[i] - expected) <= 2e-6 * most), model.parameters[i].name


def test_inflow_samples_and_geometry(study: Study) -> None:
    base = Solver.for_study(study, options=EXACT)

    def changed(inflow: float = 0.0, radius: float = 0.0) -> Solver:
        flow_ml_s = base.inflow_ml_s.copy()
        flow_ml_s[20] += inflow
        network = replace(base.network, radius_in_cm=base.network.radius_in_cm * (1 + radius))
        return Solver(
            network, base.inflow_time_s, flow_ml_s, series=base.series, times_s=base.times_s, options=EXACT
        )

    arguments = dict(zip(("stiffness", "gamma", "psi1", "psi2", "c"), POINT, strict=True))
    ways = [("inflow", 1e-3), ("radius", 1e-3)]
    directions = [
        [Point(side / 2e-5, **arguments, solver=changed(**{way: side * 1e-5})) for side in (1, -1)]
        for way, h in ways
    ]
    found = base.jacobian(**arguments, directions=directions)
    assert found.ok
    assert found.residual <= 1e-8
    assert found.stepped == 2  # the points of the radius
    for i, (way, h) in enumerate(ways):
        expected = differences(
            lambda x, way=way: changed(**{way: float(x[0])}).solve(**arguments).pressure_mmHg,
            np.zeros(1),
            0,
            h,
        )
        assert np.abs(found.pressure_mmHg[i] - expected).max() <= 1e-6 * np.abs(expected).max()


def test_memory_between_calls(study: Study) -> None:
    """What a solver keeps from one call for the next changes nothing, nor in threads or a copy."""
    solver, h = Solver.for_study(study), 1.0
    stiffer = [Point(0.5 / h, 5e4 + h), Point(-0.5 / h, 5e4 - h)]

    def run(given: Solver) -> Derivatives:
        return given.jacobian(5e4, directions=[stiffer])

    first = run(solver)
    assert first.along
    assert first.beats > 1
    with ThreadPoolExecutor(4) as pool:
        again = list(pool.map(run, [solver] * 12 + [pickle.loads(pickle.dumps(solver))]))
    for other in again:
        np.testing.assert_array_equal(other.pressure_mmHg, first.pressure_mmHg)
        np.testing.assert_array_equal(other.solution.pressure_mmHg, solver.solve(5e4).pressure_mmHg)


def test_what_has_no_derivative(study: Study) -> None:
    base = Solver.for_study(study)
    other = Solver.for_study(study, options=SolverOptions(dx_cm=0.06))
    direction = [Point(1.0, 5e4, solver=other), Point(-1.0, 5e4)]
    with pytest.raises(NoDerivativeError, match="in direction 0"):
        base.jacobian(5e4, directions=[direction])
    unchecked = base.jacobian(5e4, directions=[direction], check=False)
    assert unchecked.solution.ok
    assert not unchecked.ok
    assert np.all(np.isnan(unchecked.pressure_mmHg))
    with pytest.raises(SolverArgumentError, match="directions: there is none"):
        base.jacobian(5e4, directions=[])
    line = FunctionModel(
        lambda c, t: c["a"] * t, (Parameter("a", Uniform(0, 1)),), Outputs(("y",), np.arange(3.0))
    )
    assert jacobian(line, [0.5]) is None
    with pytest.raises(MissingGradientError):
        ForwardOp(line).slopes(np.array([0.5]))


def scalar_mean(study: Study) -> Any:
    model = flow(study, options=EXACT)

    def mean(stiffness: Any, psi2: Any, c: Any) -> Any:
        values = (stiffness * 1e5, 2.0, 0.3, psi2, c)
        return observed_series(
            model, dict(zip(("chi", "gamma", "psi1", "psi2", "c"), values, strict=True))
        ).mean

    return mean


def test_vector_jacobian_product(study: Study) -> None:
    point = [np.array(x) for x in (0.5, 0.9, 1.2)]
    verify_grad(scalar_mean(study), point, rng=np.random.default_rng(0), eps=1e-5, rel_tol=1e-5, abs_tol=1e-4)


def test_jacobian_vector_product(study: Study) -> None:
    inputs = [pt.dscalar() for _ in range(3)]
    mean = scalar_mean(study)(*inputs)
    change = [np.array(x) for x in (0.3, -0.2, 0.1)]
    push = getattr(pytensor.gradient, "pushforward", None) or pytensor.gradient.Rop  # its former name
    pushed = push(mean, inputs, [pt.constant(x) for x in change])
    run = pytensor.function(inputs, [mean, pushed])
    point, h = np.array([0.5, 0.9, 1.2]), 1e-4
    up, down = (run(*(point + side * h * np.array(change)))[0] for side in (1, -1))
    expected = (up - down) / (2 * h)
    assert np.abs(run(*point)[1] - expected).max() <= 1e-5 * np.abs(expected).max()


def test_one_run_gives_value_and_gradient_and_a_failed_one_zero(study: Study) -> None:
    op = ForwardOp(flow(study))
    first, second = at(POINT), at((6e4, *POINT[1:]))
    op.evaluate(first)
    op.slopes(first)
    op.evaluate(second)  # slopes were asked at the last point
    slopes = op.slopes(second)
    assert (op.counts["solves"], op._state.counts["gradients"]) == (3, 2)
    assert slopes.shape == (7, *op.shape)
    assert np.all(slopes[3] == 0)  # gamma, which the linear wall does not read
    failed = at((1e-3, *POINT[1:]))
    assert not op.evaluate(failed)[1]
    assert np.all(op.slopes(failed) == 0)


NONE_AT_ZERO = ("tangent-wall", "velocity-profile")
"""Effects that have no derivative at size zero, and say so."""


@pytest.mark.parametrize(
    "name", [n for n, e in CATALOGUE.items() if e.apply is not None and n not in NONE_AT_ZERO]
)
def test_an_effect_has_its_derivative_where_it_begins(name: str) -> None:
    """At size zero many are absent from the run, whose state may then be another; samplers begin there."""
    base = baseline_of(load_study("demo"))
    effect = CATALOGUE[name].of(base)
    model = with_effects(base, [effect.at(effect.locations(base)[0])])
    theta, shape = pack(base.parameters, THETA), [p.centre for p in effect.parameters[1:]]

    def solve(size: float) -> np.ndarray:
        return np.asarray(model.solve(model.configure(np.concatenate([theta, [size], shape]))))

    found = jacobian(model, np.concatenate([theta, [0.0], shape]))
    assert found is not None
    np.testing.assert_allclose(found.values, solve(0.0), atol=1e-5)
    h = 0.01 * effect.parameters[0].scale
    expected = (4 * solve(h) - solve(2 * h) - 3 * solve(0.0)) / (2 * h)
    slope = found.slopes[len(theta)]
    if name == "beat-jitter":  # it averages over beats: the same to either side of zero
        assert np.abs(slope).max() < 0.1 * np.abs(found.slopes).max()
        return
    assert np.any(slope != 0)
    assert np.linalg.norm(slope - expected) < 0.03 * np.linalg.norm(expected)


@pytest.mark.parametrize("name", NONE_AT_ZERO)
def test_an_effect_without_a_derivative_where_it_begins_says_so(name: str) -> None:
    base = baseline_of(load_study("demo"))
    model = with_effects(base, [CATALOGUE[name].at(EVERYWHERE)])
    with pytest.raises(NoDerivativeError, match="no derivative"):
        jacobian(model, np.append(pack(base.parameters, THETA), 0.0))


def test_an_effect_of_some_vessels_has_its_derivative_where_it_begins() -> None:
    """Beside another vessel where the same term is at work already, and beside one where it begins too."""
    exact = replace(SEARCH, tolerance_mmHg=1e-7)
    base = get_baseline("linear-constant").forward(load_study("demo"), options=exact)

    def change(case: Case, values: tuple[float, ...], location: Location) -> Case:
        tree = case.network
        i = tree.index(int(str(location.part)))
        added = np.zeros(len(tree.ids))
        added[i] = tree.density * values[0] / (np.pi * tree.radius_out_cm[i] ** 2)
        return with_physics(case, inertance=added + (0.0 if (old := case.physics.inertance) is None else old))

    tree = base.network
    length = EffectParameter("length", "cm", 0.5, 0.0, 2.0, (0.1,))
    own = Effect("inertance-here", (length,), change)
    model = with_effects(base, [own.at(Location(int(tree.ids[i]))) for i in tree.terminals[:2]])
    n = len(pack(base.parameters, THETA))

    def at(*sizes: float) -> np.ndarray:
        return np.concatenate([pack(base.parameters, THETA), sizes])

    def solve(*sizes: float) -> np.ndarray:
        return np.asarray(model.solve(model.configure(at(*sizes))))

    h = 1e-3
    for first in (0.1, 0.0):
        found = jacobian(model, at(first, 0.0))
        assert found is not None
        expected = (4 * solve(first, h) - solve(first, 2 * h) - 3 * solve(first, 0.0)) / (2 * h)
        assert np.linalg.norm(found.slopes[n + 1] - expected) < 0.03 * np.linalg.norm(expected)


def test_lengths_that_are_truncated_have_derivatives_where_they_change() -> None:
    study = load_study("demo")
    truncated = study.conventions.replace(truncate_lengths=True)
    base = get_baseline("linear-constant").forward(study, options=SEARCH, conventions=truncated)
    model = with_effects(base, [CATALOGUE["vessel-length"].at(Location(int(base.network.ids[0])))])
    theta = pack(base.parameters, THETA)
    slopes = [jacobian(model, np.append(theta, size)).slopes[-1] for size in (0.0, 1e-4)]  # type: ignore[union-attr]
    np.testing.assert_allclose(slopes[0], slopes[1], atol=0.01 * np.abs(slopes[1]).max())


def test_runs_with_and_without_a_term_are_two() -> None:
    base = baseline_of(load_study("demo"))
    model = with_effects(base, [CATALOGUE["viscoelastic-wall"].at(EVERYWHERE)])
    theta = pack(base.parameters, THETA)
    without, with_it = (model.configure(np.append(theta, size)) for size in (0.0, 1e-3))
    assert not same_run(without, with_it)
    stiffer = model.configure(np.append(1.1 * theta, 0.0))
    assert same_run(without, stiffer)
