"""Blood flow as a PyTensor operation: values, cache, counts, failures, processes, sampling."""

from __future__ import annotations

import multiprocessing
import pickle
from dataclasses import replace
from typing import Any

import cloudpickle
import numpy as np
import pymc as pm
import pytensor
import pytensor.tensor as pt
import pytest
from pymc.step_methods import STEP_METHODS
from pytensor.graph.traversal import ancestors

from zoo.blood.baseline import Baseline
from zoo.blood.blood_flow import (
    BloodFlow,
    constant_stiffness,
    radius_dependent_stiffness,
    stiffness_of_each_vessel,
)
from zoo.blood.conventions import PRINTED, PUBLISHED_CODE
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Blood, Series, Study, Vessel, Windkessel
from zoo.core.forward import Outputs
from zoo.core.in_numba import with_memory
from zoo.core.op import CACHE_SIZE, ForwardOp, MissingGradientError, observed_series
from zoo.core.parameters import LogUniform, Parameter, Uniform

POINT = (5e4, 2.0, 0.3, 0.9, 1.2)  # stiffness, gamma, psi1, psi2, c
STIFF = Baseline(
    "stiff",
    "linear",
    constant_stiffness,
    (Parameter("f3", LogUniform(1e3, 1e12), "g cm-1 s-2"),),
    fixed={"psi1": 0.3, "psi2": 0.9, "c": 1.2},
)
"""A wall that may be so stiff that no time step allowed is short enough."""


def small_study(n_times: int = 32, quantities: tuple[str, ...] = ("pressure_mmHg", "pressure_mmHg")) -> Study:
    """Three vessels with noise of 0.05 in the root and, given two quantities, a daughter; the paper's set."""
    period = 0.11
    vessels = (
        Vessel(1, "root", 0.41, 0.047, 0.047, None, None),
        Vessel(2, "left", 0.44, 0.026, 0.026, 1, Windkessel(5e4, 2e5, 1.6e-7)),
        Vessel(3, "right", 0.37, 0.037, 0.037, 1, Windkessel(3e4, 1.2e5, 2.6e-7)),
    )
    inflow_time = np.arange(256) * period / 256
    time = np.arange(n_times) * period / n_times
    flow = 0.5 * np.maximum(0.0, np.sin(2 * np.pi * inflow_time / period)) ** 2
    places = zip(((1, 0.0), (2, 0.5)), quantities, strict=False)
    blank = tuple(Series(*place, quantity, np.zeros(n_times)) for place, quantity in places)
    study = Study(
        "small", period, Blood(1.055, 0.049), vessels, inflow_time, flow, time, blank, PRINTED,
        source="small", priors={"set": "paun2020"}, numerics={"dx_cm": 0.025}, checksum="small",
    )  # fmt: skip
    solution = Solver.for_study(study).solve(*POINT)
    noise = 0.05 * np.random.default_rng(1).standard_normal((len(blank), n_times))
    series = [replace(s, value=getattr(solution, s.quantity)[i] + noise[i]) for i, s in enumerate(blank)]
    return replace(study, series=tuple(series))


@pytest.fixture
def op(study: Study) -> ForwardOp:
    return ForwardOp(flow(study))


NAMES = ("chi", "gamma", "psi1", "psi2", "c")
QUIET: dict[str, Any] = {"progressbar": False, "compute_convergence_checks": False, "random_seed": 1}
ANY = Uniform(0.0, 1e6)


def flow(study: Study, wall: str = "linear", **settings: Any) -> BloodFlow:
    """A stiffness for each vessel and one value of the others: theta is `at(POINT)`."""
    n = len(study.vessels)
    parameters = [Parameter("chi", ANY, dims="vessel", size=n), *(Parameter(name, ANY) for name in NAMES[1:])]
    return BloodFlow(study, wall, stiffness_of_each_vessel, parameters, **settings)


def at(point: tuple[float, ...], n: int = 3) -> np.ndarray:
    return np.concatenate([np.full(n, point[0]), point[1:]])


def symbolic(op: ForwardOp) -> Any:
    inputs = [pt.dvector(), *(pt.dscalar() for _ in range(4))]
    function = pytensor.function(inputs, op(*inputs), mode=with_memory())
    return lambda theta: function(theta[:-4], *theta[-4:])


# values


def test_mean_is_the_solver_s_and_ok_is_one(study: Study, op: ForwardOp) -> None:
    mean, ok = symbolic(op)(at(POINT))
    np.testing.assert_array_equal(mean, Solver.for_study(study).solve(*POINT).pressure_mmHg)
    assert ok == 1
    assert ok.dtype == np.int8


def test_scalars_and_vectors_of_parameters(study: Study) -> None:
    def values(chi: Any) -> np.ndarray:
        given = {"chi": chi, "gamma": 4.0, "psi1": 0.3, "psi2": 0.9, "c": 1.2}
        return np.asarray(observed_series(flow(study, "tangent"), given).mean.eval())

    np.testing.assert_array_equal(values(5e4), values(np.full(3, 5e4)))
    assert np.abs(values([5e4, 4e4, 5e4]) - values(5e4)).max() > 1e-3


# cache and counts


def test_a_repeated_point_is_solved_once(op: ForwardOp) -> None:
    function = symbolic(op)
    for _ in range(3):
        function(at(POINT))
    assert op.counts == {"evaluations": 3, "solves": 1, "failures": {}}


def test_the_oldest_point_leaves_the_cache_first(op: ForwardOp) -> None:
    points = [at((5e4 + 100 * i, *POINT[1:])) for i in range(CACHE_SIZE + 1)]
    for point in points:
        op.evaluate(point)
    op.evaluate(points[-1])
    op.evaluate(points[1])
    assert op.counts["solves"] == CACHE_SIZE + 1
    op.evaluate(points[0])
    assert op.counts["solves"] == CACHE_SIZE + 2


def test_a_point_differs_by_its_last_bit(op: ForwardOp) -> None:
    op.evaluate(at(POINT))
    near = at(POINT)
    near[1] = np.nextafter(near[1], np.inf)
    op.evaluate(near)
    assert op.counts["solves"] == 2


def test_work_in_place_does_not_reach_the_cache(op: ForwardOp) -> None:
    function = symbolic(op)
    first, _ = function(at(POINT))
    first *= 2.0
    second, _ = function(at(POINT))
    np.testing.assert_array_equal(second, first / 2.0)
    inputs = [pt.dvector(), *(pt.dscalar() for _ in range(4))]
    shifted = pytensor.function(inputs, pt.exp(op(*inputs)[0] * 0.01) - 3.0, mode=with_memory())
    theta = at(POINT)
    np.testing.assert_array_equal(shifted(theta[:3], *theta[3:]), shifted(theta[:3], *theta[3:]))


def test_copies_share_points_and_counts_and_others_do_not(study: Study, op: ForwardOp) -> None:
    op.evaluate(at(POINT))
    twin = pickle.loads(pickle.dumps(op))
    assert twin == op
    assert hash(twin) == hash(op)
    another = ForwardOp(flow(study))  # of an equal forward model, but an operation of its own
    assert another != op
    assert another.key == op.key
    assert another.counts["evaluations"] == 0
    twin.evaluate(at(POINT))
    assert op.counts["evaluations"] == 2
    assert op.counts["solves"] == 1
    times = Outputs(op.model.outputs.series, op.model.outputs.times + 1e-3)
    others = [
        flow(study, wall="tangent"),
        flow(study, options=SolverOptions(refine=2)),
        flow(study, conventions=PUBLISHED_CODE),
        flow(replace(study, inflow_ml_s=2 * study.inflow_ml_s)),
        flow(replace(study, blood=Blood(1.06, 0.049))),
        flow(study, outputs=times),
        flow(small_study(quantities=("pressure_mmHg", "flow_ml_s"))),
        BloodFlow(study, "linear", constant_stiffness, [Parameter("f3", ANY)]),
        BloodFlow(study, "linear", constant_stiffness, [Parameter("f3", ANY)], fixed={"psi1": 2.0}),
        BloodFlow(study, "linear", radius_dependent_stiffness, [Parameter("f3", ANY)]),
    ]
    others = [ForwardOp(other) for other in others]
    assert len({other.key for other in [op, *others]}) == 11
    before = [other.counts for other in others]  # not 0 where another test still holds the same operation
    op.evaluate(at(POINT))
    assert op.counts["evaluations"] == 3
    assert [other.counts for other in others] == before


# failures


def test_a_failed_solve_is_zero_and_counted(study: Study) -> None:
    op = ForwardOp(flow(study, "tangent"))
    function = symbolic(op)
    cases = [
        ((1e10, *POINT[1:]), "cfl"),  # so stiff that no time step allowed is short enough
        ((100.0, 0.1, *POINT[2:]), "wall-limit"),
        ((-1.0, *POINT[1:]), "bad-argument"),
        ((np.nan, *POINT[1:]), "bad-argument"),
    ]
    for point, _ in cases:
        mean, ok = function(at(point))
        assert ok == 0
        assert mean.shape == op.shape
        assert np.all(mean == 0)
    assert op.counts["failures"] == {"cfl": 1, "wall-limit": 1, "bad-argument": 2}
    assert function(at(POINT))[1] == 1


def test_wrong_arguments_raise(study: Study, op: ForwardOp) -> None:
    with pytest.raises(ValueError, match=r"6 values for 7: give chi, gamma, psi1, psi2, c"):
        op.evaluate(at(POINT)[:-1])
    with pytest.raises(ValueError, match=r"chi has shape .*: must be a vector of length 3"):
        op(pt.as_tensor_variable(np.full(4, 5e4)), *POINT[1:])
    with pytest.raises(ValueError, match=r"psi2 has shape .*: must be a scalar"):
        op(np.full(3, 5e4), 2.0, 0.3, np.ones(2), 1.2)
    with pytest.raises(ValueError, match="parameter c is missing"):
        observed_series(op.model, dict(zip(NAMES[:-1], POINT, strict=False)))
    with pytest.raises(ValueError, match="5 parameters and 0 series"):
        ForwardOp(flow(replace(study, series=())))


# PyTensor


def test_shape_is_known_without_a_solve(op: ForwardOp) -> None:
    inputs = [pt.dvector(), *(pt.dscalar() for _ in range(4))]
    mean, ok = op(*inputs)
    assert mean.type.shape == (2, 32)
    assert ok.ndim == 0
    shape = pytensor.function(inputs, mean.shape, on_unused_input="ignore")(at(POINT)[:3], *POINT[1:])
    assert tuple(shape) == (2, 32)
    assert op.counts["evaluations"] == 0


class WithoutDerivatives:
    """A forward model's values alone."""

    families = ()

    def __init__(self, model: BloodFlow) -> None:
        for name in ("parameters", "outputs", "key", "name", "configure", "solve"):
            setattr(self, name, getattr(model, name))


def test_gradient_says_what_to_do(study: Study) -> None:
    stiffness = pt.dscalar()
    model = WithoutDerivatives(flow(study))
    mean, _ = observed_series(model, dict(zip(NAMES, (stiffness, *POINT[1:]), strict=True)))
    with pytest.raises(MissingGradientError, match=r"pm.sample\(step=zoo.step\(model\)\)"):
        pytensor.grad(mean.sum(), stiffness)


def linear_model(study: Study, forward: Any = None) -> pm.Model:
    """Three parameters, errors of known size."""
    with pm.Model() as model:
        f3 = pm.Uniform("f3", 2e4, 1e5)
        psi2 = pm.Uniform("psi2", 0.05, 2.5)
        c = pm.Uniform("c", 0.05, 2.5)
        given = {"chi": f3, "gamma": 2.0, "psi1": 0.3, "psi2": psi2, "c": c}
        mean, _ = observed_series(forward or flow(study), given)
        pm.Normal("y", mean, 0.5, observed=study.values)
    return model


def test_sampling_without_a_step_stops_where_pymc_knows_none_but_slice(study: Study) -> None:
    blind, known = WithoutDerivatives(flow(study)), list(STEP_METHODS)
    STEP_METHODS[:] = [method for method in known if not getattr(method, "for_forward_models", False)]
    try:
        with linear_model(study, blind), pytest.raises(MissingGradientError, match=r"step=zoo\.step"):
            pm.sample(draws=5, tune=5, chains=1, progressbar=False)
    finally:
        STEP_METHODS[:] = known


# processes


def _solve_in_child(op: ForwardOp, point: np.ndarray) -> tuple[np.ndarray, dict]:
    op.evaluate(point)
    mean, _ = op.evaluate(point)
    return mean, op.counts


@pytest.mark.parametrize("method", multiprocessing.get_all_start_methods())
def test_op_in_another_process(op: ForwardOp, method: str) -> None:
    here, _ = op.evaluate(at(POINT))
    with multiprocessing.get_context(method).Pool(1) as pool:
        there, counts = pool.apply(_solve_in_child, (op, at(POINT)))
    np.testing.assert_array_equal(there, here)
    assert counts == {"evaluations": 2, "solves": 1, "failures": {}}  # its own, not the parent's
    assert op.counts == {"evaluations": 1, "solves": 1, "failures": {}}


def test_a_pickled_compiled_function_shares_the_points(op: ForwardOp) -> None:
    inputs = [pt.dvector(), *(pt.dscalar() for _ in range(4))]
    function = pickle.loads(cloudpickle.dumps(pytensor.function(inputs, op(*inputs), mode=with_memory())))
    mean, ok = function(at(POINT)[:3], *POINT[1:])
    np.testing.assert_array_equal(mean, op.evaluate(at(POINT))[0])
    assert ok == 1
    assert op.counts["solves"] == 1


def test_one_solve_a_draw(study: Study) -> None:
    model = linear_model(study)
    [op] = {v.owner.op for v in ancestors([model["y"]]) if v.owner and isinstance(v.owner.op, ForwardOp)}
    op._state.clear()
    with model:
        pm.sample(60, tune=40, chains=1, cores=1, step=pm.DEMetropolisZ(), **QUIET)
    counts = op.counts
    assert counts["evaluations"] >= 2 * 100
    assert 100 <= counts["solves"] <= 103
