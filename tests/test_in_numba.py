"""Models in functions that numba compiles: without Python, as by Python, in threads and other processes."""

from __future__ import annotations

import ctypes
import multiprocessing
import pickle
import resource
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import cloudpickle
import numba
import numpy as np
import nutpie
import pytensor
import pytensor.tensor as pt
import pytest

import zoo
from lines import IN_NUMBA, compiled_by_numba
from test_errors import CASES, some_errors
from test_op import NAMES, POINT, at, flow
from zoo.blood.blood_flow import BloodFlow, constant_stiffness
from zoo.blood.effects import CATALOGUE
from zoo.core.arviz_lines import dataset
from zoo.core.data import Data
from zoo.core.errors.groups import GroupProcess
from zoo.core.errors.independent import Independent
from zoo.core.errors.variables import ErrorTermsOp, TermsOp
from zoo.core.forward import FunctionModel
from zoo.core.in_numba import own
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.model import bayesian_model
from zoo.core.op import ForwardOp, SlopesOp, SolveOp, observed_series
from zoo.core.parameters import InverseGamma, Parameter, Uniform, pack, start_of


@pytest.fixture
def calls_of_python(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Files of the blocks of Python in what numba compiles from here on."""
    found: list[str] = []
    kind = type(numba.objmode)
    compiled = kind.mutate_with_body

    def noted(self: Any, func_ir: Any, *given: Any, **named: Any) -> Any:
        found.append(func_ir.loc.filename)
        return compiled(self, func_ir, *given, **named)

    monkeypatch.setattr(kind, "mutate_with_body", noted)
    return found


def operations(function: Any) -> set[type]:
    return {type(node.op) for node in function.maker.fgraph.apply_nodes}


def compiled(op: ForwardOp, slopes: bool = False) -> Any:
    """Mean and ok, and on request slopes, at theta by numba."""
    inputs = [pt.dvector(), *(pt.dscalar() for _ in range(4))]
    outputs = [*op(*inputs), *([SlopesOp(op)(*inputs)] if slopes else [])]
    function = pytensor.function(inputs, outputs, mode="NUMBA")
    assert operations(function) & {ForwardOp, SlopesOp, SolveOp} == {SolveOp}
    return lambda theta: function(theta[:-4], *theta[-4:])


# as by Python


@pytest.mark.parametrize("letter", "ABCDEFGHI")
def test_series_and_slopes_are_those_by_python(letter: str) -> None:
    """Of each kind of wall and of stiffness, away from where the models begin."""
    record = getattr(zoo, f"model_{letter}")(zoo.load_study("demo")).zoo
    forward = record.forward
    theta = pack(forward.parameters, start_of(forward.parameters))
    theta *= np.random.default_rng(1).uniform(0.9, 1.1, theta.shape)
    status, mean, slopes = record.op.in_numba.differentiate(theta)
    assert status == 0
    expected = record.op.slopes(theta)
    np.testing.assert_allclose(mean, record.op.evaluate(theta)[0], rtol=1e-12)
    # rounding of a thing over a step of 1e-5 of it
    np.testing.assert_allclose(slopes, expected, rtol=0, atol=1e-10 * np.abs(expected).max())
    alone = record.op.in_numba.solve(theta)
    assert alone[0] == 0
    np.testing.assert_array_equal(alone[1], mean)


@pytest.mark.parametrize(
    "kind",
    [pytest.param("gaussian process", marks=IN_NUMBA), "process", "process of known noise"],
)
def test_terms_and_gradient_are_those_by_python(kind: str) -> None:
    """For weights as those of a log-density, and any; and where there is no law."""
    known = kind == "process of known noise"
    errors, given = CASES["process" if known else kind]
    if known:
        errors = GroupProcess(known={errors.on.labels[1]: 0.4}).bind(errors.on)
    values = {p: np.asarray(given[p], dtype=float) for p in errors.parameter_names}
    residual, vector = some_errors(errors, values), np.array(list(values.values()))
    functions, rng = own("in_numba", errors), np.random.default_rng(3)
    for weight in (
        np.full((3, 14), 1.7),
        rng.standard_normal((3, 1)) + np.zeros(14),
        rng.normal(size=(3, 14)),
    ):
        terms, by_residual, by_values = functions.gradient(residual, vector, weight)
        np.testing.assert_allclose(terms, errors.terms(residual, values), rtol=1e-9)
        np.testing.assert_allclose(functions.terms(residual, vector), terms, rtol=1e-12)
        wanted, by_name = errors.gradient(residual, values, weight)
        np.testing.assert_allclose(by_residual, wanted, rtol=1e-9)
        np.testing.assert_allclose(by_values, [by_name[p] for p in values], rtol=1e-8)
    for w in (0.0, np.inf, np.nan):
        vector[[name.startswith("w") for name in values]] = w
        terms, *gradient = functions.gradient(residual, vector, weight)
        assert np.all(terms == -np.inf)
        assert not any(np.any(part) for part in gradient)


def test_series_of_several_quantities_at_unordered_times(study: Any) -> None:
    """Pressure and flow at one place and another, with the study's lag: where each of C's samples goes."""
    series = (
        (2, 0.5, "flow_ml_s"),
        (1, 0.0, "pressure_mmHg"),
        (2, 0.5, "area_cm2"),
        (2, 0.5, "pressure_mmHg"),
    )
    outputs = zoo.Outputs(series, np.array([0.08, 0.01, 0.105, 0.0, 0.03]))
    model = flow(
        study, "tangent", outputs=outputs, conventions=replace(study.conventions, sample_lag_beats=0.2)
    )
    point = at((6e4, 4.0, *POINT[2:]))
    found = compiled(ForwardOp(model), slopes=True)(point)
    np.testing.assert_array_equal(found[0], model.solve(model.configure(point)))
    slopes = ForwardOp(model).slopes(point)
    np.testing.assert_allclose(found[2], slopes, rtol=0, atol=1e-12 * np.abs(slopes).max())


# without Python


# the functions of each wall are compared above, and A and G are compiled by test_lines.py too
@pytest.mark.parametrize(
    "letter",
    [
        pytest.param("B", marks=IN_NUMBA),
        *(pytest.param(letter, marks=pytest.mark.nightly) for letter in "ACDEFGHI"),
    ],
)
def test_a_model_runs_without_python_and_without_a_warning(letter: str, calls_of_python: list[str]) -> None:
    model = getattr(zoo, f"model_{letter}")(zoo.load_study("demo"))
    point = {k: x + 0.05 for k, x in model.initial_point().items()}
    graph = [model.logp(), model.dlogp()]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        function = model.compile_fn(graph, mode="NUMBA")
        logp, gradient = function(point)
    assert not calls_of_python
    there = operations(function.f) & {ForwardOp, SlopesOp, ErrorTermsOp, SolveOp, TermsOp}
    independent = letter in "ADF"  # noise without correlation has no operation
    assert there == ({SolveOp} if independent else {SolveOp, TermsOp})
    assert model.zoo.op.counts == {"evaluations": 1, "solves": 1, "failures": {}}
    by_python = model.compile_fn(graph, mode="FAST_COMPILE")(point)
    np.testing.assert_allclose(logp, by_python[0], rtol=1e-12)
    np.testing.assert_allclose(gradient, by_python[1], rtol=0, atol=1e-12 * np.abs(by_python[1]).max())


def test_a_simulator_in_python_is_called_without_a_warning(calls_of_python: list[str]) -> None:
    times = np.linspace(0.0, 1.0, 5)
    line = FunctionModel(
        lambda given, t: given["a"] * t, (Parameter("a", Uniform(0.0, 9.0)),), zoo.Outputs(("y",), times)
    )
    model = bayesian_model("line", line, zoo.Data(times, times[None]), Independent(InverseGamma(3.0, 1.0)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        logp = model.compile_logp(mode="NUMBA")
        assert np.isfinite(logp(model.initial_point()))
    assert len(calls_of_python) == 1


class Doubled(BloodFlow):
    """Another solve with a method of the same name."""

    def configure(self, theta: Any) -> Any:
        return super().configure(2.0 * np.asarray(theta))


def test_what_changes_the_solve_or_is_unknown_stays_with_python(study: Any) -> None:
    parameters = [Parameter("f3", Uniform(1e4, 1e6))]
    plain = BloodFlow(study, "linear", constant_stiffness, parameters)
    assert ForwardOp(plain).in_numba is not None
    assert ForwardOp(Doubled(study, "linear", constant_stiffness, parameters)).in_numba is None
    own_law = BloodFlow(
        study, "linear", lambda values, network, _: np.full(3, float(values["f3"])), parameters
    )
    assert ForwardOp(own_law).in_numba is None
    longer = [*parameters, Parameter("tree_length", Uniform(0.5, 2.0))]  # changes the outlets
    assert ForwardOp(BloodFlow(study, "linear", constant_stiffness, longer)).in_numba is None
    leaking = zoo.model_A(study, effects=[CATALOGUE["venous-pressure"]])
    assert leaking.zoo.op.in_numba is None


def test_terms_of_series_with_gaps_stay_with_python() -> None:
    values = np.sin(np.arange(40.0))[None]
    data = Data(np.arange(40) / 40.0, values, ["y"], ["mmHg"], period=1.0)
    assert GroupProcess().bind(data).in_numba() is not None
    values[0, 3] = np.nan
    twice = np.vstack([values, np.cos(np.arange(40.0))])
    gap = Data(np.arange(40) / 40.0, twice, ["y", "z"], ["mmHg", "mmHg"], period=1.0)
    assert GroupProcess().bind(gap).in_numba() is None


def test_our_own_functions_keep_what_they_have_solved(study: Any) -> None:
    """Also where PyTensor compiles with numba by default."""
    model = zoo.model_A(study)
    solves = model.zoo.op.counts["solves"]
    logp = LogPosterior(model)
    q = logp.vector(model.initial_point())
    for _ in range(3):
        logp(q)
    assert model.zoo.op.counts["solves"] == solves + 1


def test_memory_of_a_solve_with_slopes_is_kept_for_the_next() -> None:
    """By the pages that the system gives to a third call, beside those that it takes."""
    op = zoo.model_B(zoo.load_study("demo")).zoo.op
    theta = pack(op.model.parameters, start_of(op.model.parameters))
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        op.in_numba.differentiate(theta)
        given = (resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) * resource.getpagesize()
    [address] = [x for x in op.in_numba.keeps[1].addresses.tolist() if x]
    assert given < ctypes.c_int64.from_address(address).value / 4


# failures


def test_a_failed_solve_has_no_density_and_is_counted_by_kind(study: Any) -> None:
    op = ForwardOp(flow(study, "tangent"))
    function = compiled(op, slopes=True)
    cases = [(1e10, *POINT[1:]), (100.0, 0.1, *POINT[2:]), (-1.0, *POINT[1:]), (np.nan, *POINT[1:])]
    for point in cases:
        mean, ok, slopes = function(at(point))
        assert ok == 0
        assert ok.dtype == np.int8
        assert not mean.any()
        assert not slopes.any()
    assert function(at(POINT))[1] == 1
    assert op.counts == {
        "evaluations": 5,
        "solves": 5,
        "failures": {"cfl": 1, "wall-limit": 1, "bad-argument": 2},
    }
    inputs = {name: pt.dscalar(name) for name in NAMES}
    series = observed_series(op.model, inputs)
    terms = pt.switch(series.ok, -0.5 * (study.values - series.mean) ** 2, -np.inf).sum()
    logp = pytensor.function(
        list(inputs.values()), [terms, *pytensor.grad(terms, list(inputs.values()))], mode="NUMBA"
    )
    found = logp(*cases[0])
    assert found[0] == -np.inf
    assert np.all(np.isfinite(logp(*POINT)[0]))


# threads and processes


def test_two_threads_at_once_give_what_one_gives(study: Any) -> None:
    op = ForwardOp(flow(study))
    solve = SolveOp(op, slopes=True).function()
    points = [at((5e4 + 500.0 * i, *POINT[1:])) for i in range(24)]

    @numba.njit(nogil=True)
    def many(points: Any) -> Any:
        total = np.zeros((len(points), 2))
        for i in range(len(points)):
            mean, _, slopes = solve(points[i])
            total[i] = np.sum(mean), np.sum(slopes)
        return total

    alone = many(np.array(points))
    with ThreadPoolExecutor(2) as pool:
        both = list(pool.map(many, [np.array(points), np.array(points[::-1])]))
    np.testing.assert_array_equal(both[0], alone)
    np.testing.assert_array_equal(both[1], alone[::-1])
    assert op.counts["solves"] == 72


def _in_child(pickled: bytes, point: np.ndarray) -> Any:
    op, function = pickle.loads(pickled)
    found = function(point[:-4], *point[-4:])
    return found, op.counts


@compiled_by_numba
def test_a_pickled_function_is_compiled_anew(study: Any) -> None:
    op = ForwardOp(flow(study))
    inputs = [pt.dvector(), *(pt.dscalar() for _ in range(4))]
    function = pytensor.function(inputs, op(*inputs), mode="NUMBA")
    point = at(POINT)
    here = function(point[:-4], *point[-4:])
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        there, counts = pool.apply(_in_child, (cloudpickle.dumps((op, function)), point))
    np.testing.assert_allclose(there[0], here[0], rtol=1e-13)
    assert counts == {"evaluations": 1, "solves": 1, "failures": {}}
    assert op.counts["solves"] == 1


# samplers


@compiled_by_numba
def test_nutpie_samples_a_model(study: Any) -> None:
    model = zoo.model_A(study)
    compiled = nutpie.compile_pymc_model(model)
    found = nutpie.sample(
        compiled, tune=10, draws=5, chains=2, cores=2, seed=1, maxdepth=4, progress_bar=False
    )
    posterior = dataset(found)
    assert posterior["f3"].shape == (2, 5)
    for name in ("f3", "psi1", "psi2", "c"):
        assert np.all(np.isfinite(posterior[name]))
        assert np.ptp(posterior[name].to_numpy()) > 0
    assert model.zoo.op.counts["solves"] > 30
