"""Blood flow as a forward model: the solver bit for bit, outputs, kept solvers, failures, data; baselines."""

from __future__ import annotations

import pickle
import types
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from test_op import POINT, at, flow, small_study
from zoo.blood import blood_flow as module
from zoo.blood.baseline import get_baseline
from zoo.blood.blood_flow import (
    FAMILIES,
    BloodFlow,
    constant_stiffness,
    radius_dependent_stiffness,
    study_data,
)
from zoo.blood.case import OutputError
from zoo.blood.conventions import PRINTED, PUBLISHED_CODE
from zoo.blood.effects import CATALOGUE, at_vessel
from zoo.blood.network import Network
from zoo.blood.solver import Solver, SolverArgumentError, SolverOptions
from zoo.blood.study import Study, StudyError, load_study
from zoo.core.effects import EffectError, WithEffects
from zoo.core.forward import ForwardModel, FunctionModel, Outputs, SolveError
from zoo.core.op import ForwardOp
from zoo.core.parameters import Parameter, ParameterError, Uniform, draw_prior, pack, start_of
from zoo.models import MODELS, PAPER, get_model

QUANTITIES = ("pressure_mmHg", "flow_ml_s", "area_cm2")


@pytest.mark.parametrize("wall", ["linear", "tangent"])
@pytest.mark.parametrize("conventions", [PRINTED, PUBLISHED_CODE])
@pytest.mark.parametrize("options", [None, SolverOptions(dx_cm=0.05, steps_per_beat=2048)])
def test_without_effects_it_is_the_solver_bit_for_bit(
    wall: str, conventions: Any, options: SolverOptions | None
) -> None:
    study = small_study(quantities=("flow_ml_s", "area_cm2"))
    model = flow(study, wall, conventions=conventions, options=options)
    exact = Solver.for_study(study, wall, options=options, conventions=conventions).solve(*POINT)
    expected = [exact.flow_ml_s[0], exact.area_cm2[1]]
    for _ in range(2):  # with a new solver, and with the kept one
        np.testing.assert_array_equal(model.solve(model.configure(at(POINT))), expected)


def test_other_outputs_are_those_of_the_solver_at_the_samples_own_times(study: Study) -> None:
    """Times are told by the samples' clock: the conventions' lag is the model's business."""
    model = flow(study, conventions=PUBLISHED_CODE)
    places = [(v, x) for v in (1, 2, 3) for x in (0.0, 0.5)]
    outputs = Outputs(tuple((v, x, q) for v, x in places for q in QUANTITIES), study.time_s[::4])
    lag = PUBLISHED_CODE.sample_lag_beats * study.period_s
    assert lag > 0
    times = study.time_s[::4] + lag
    exact = Solver.for_study(study, conventions=PUBLISHED_CODE, series=places, times_s=times).solve(*POINT)
    expected = [getattr(exact, q)[i] for i in range(len(places)) for q in QUANTITIES]
    np.testing.assert_array_equal(model.solve(model.configure(at(POINT)), outputs), expected)


def test_a_solver_is_made_once_while_only_parameters_change(
    study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Any] = []
    original = module.solver_of

    def counted(*args: Any) -> Solver:
        made.append(args)
        return original(*args)

    monkeypatch.setattr(module, "solver_of", counted)
    model = flow(study, name="linear-constant")
    local = WithEffects(model, [CATALOGUE["local-stiffness"].at(at_vessel(2))])
    for k in range(4):
        model.solve(model.configure(at((5e4 + k, *POINT[1:]))))
        local.solve(local.configure([*at(POINT), 0.1 * k]))
    assert len(made) == 1
    viscous = WithEffects(model, [CATALOGUE["viscoelastic-wall"].at()])
    solved = [viscous.solve(viscous.configure([*at(POINT), tau])) for tau in (0.0, 1e-3, 2e-3, 1e-3)]
    assert len(made) == 4  # each wall's own, and none for a wall that has nothing added
    np.testing.assert_array_equal(solved[0], model.solve(model.configure(at(POINT))))
    np.testing.assert_array_equal(solved[1], solved[3])
    assert np.abs(solved[2] - solved[1]).max() > 1e-3
    other = Outputs(model.outputs.series, model.outputs.times + 1e-3)
    assert np.any(model.solve(model.configure(at(POINT)), other) != solved[0])


def test_failures_have_the_names_of_the_solver(study: Study) -> None:
    cases = [
        (flow(study), (1e10, *POINT[1:]), "cfl", "time step"),
        (flow(study, "tangent"), (100.0, 0.1, *POINT[2:]), "wall-limit", "gamma"),
        (flow(study), (-1.0, *POINT[1:]), "bad-argument", "positive"),
        (flow(study), (np.nan, *POINT[1:]), "bad-argument", "finite"),
        (flow(study, options=SolverOptions(max_beats=1)), POINT, "not-periodic", "max_beats"),
    ]
    for model, point, kind, words in cases:
        with pytest.raises(SolveError, match=words) as failed:
            model.solve(model.configure(at(point)))
        assert failed.value.kind == kind
    copy = pickle.loads(pickle.dumps(failed.value))
    assert (type(copy), str(copy), copy.kind) == (type(failed.value), str(failed.value), "not-periodic")


def test_what_does_not_exist_is_refused_when_the_model_is_made(study: Study) -> None:
    at_1 = study.time_s
    with pytest.raises(StudyError, match="vessel = 9: not in the network"):
        flow(study, outputs=Outputs(((9, 0.0, "pressure_mmHg"),), at_1))
    with pytest.raises(OutputError, match="quantity = 'pressure': unknown; did you mean 'pressure_mmHg'"):
        flow(study, outputs=Outputs(((1, 0.0, "pressure"),), at_1))
    with pytest.raises(OutputError, match=r"position = 1.5 of vessel 1: must be in \[0, 1\]"):
        flow(study, outputs=Outputs(((1, 1.5, "pressure_mmHg"),), at_1))
    with pytest.raises(SolverArgumentError, match="wall = 'steel': must be one of linear, tangent"):
        flow(study, "steel")
    with pytest.raises(ParameterError, match=r"2 values for 7: give chi \(3\), gamma"):
        flow(study).configure([1.0, 2.0])


@pytest.mark.parametrize("conventions", [PRINTED, PUBLISHED_CODE])
def test_radius_dependent_stiffness_is_equation_3_5(study: Study, conventions: Any) -> None:
    parameters = [Parameter(name, Uniform(-1e7, 1e7)) for name in ("f1", "f2", "f3")]
    model = BloodFlow(study, "linear", radius_dependent_stiffness, parameters, conventions=conventions)
    chi = model.configure([2e5, -30.0, 4e4]).stiffness
    radius = Network.from_study(study).radius_in_cm / conventions.stiffness_radius_unit_cm
    np.testing.assert_allclose(chi, 2e5 * np.exp(-30.0 * radius) + 4e4, rtol=1e-13)


def test_loads_may_differ_by_vessel_and_be_of_known_value(study: Study) -> None:
    n = len(study.vessels)
    parameters = [Parameter("f3", Uniform(0, 1e6)), Parameter("psi2", Uniform(0, 3), dims="vessel", size=n)]
    fixed = {"psi1": 0.3, "c": 1.2}
    model = BloodFlow(study, "linear", constant_stiffness, parameters, fixed=fixed)
    exact = Solver.for_study(study).solve(5e4, 2.0, 0.3, np.array([1.0, 0.8, 0.9]), 1.2)
    found = model.solve(model.configure([5e4, 1.0, 0.8, 0.9]))
    np.testing.assert_array_equal(found, exact.pressure_mmHg)


def test_study_data() -> None:
    study = small_study(quantities=("pressure_mmHg", "flow_ml_s"))
    data = study_data(study)
    np.testing.assert_array_equal(data.values, study.values)
    assert (data.units, data.groups) == (("mmHg", "ml/s"), ("pressure_mmHg", "flow_ml_s"))
    assert data.labels == tuple(series.label for series in study.series)
    assert (data.period, data.name) == (study.period_s, "small")
    assert data.outputs == flow(study).outputs.series
    with pytest.raises(ValueError, match=r"study 'small' has no observations: add observations.csv"):
        study_data(replace(study, series=()))


# ---------------------------------------------------------------------------------------------------
# Baselines


def test_baselines_by_name_and_letter() -> None:
    names = dict(zip("ABCDEFGHI", ["linear-constant"] * 3 + ["linear-radius"] * 2, strict=False))
    names |= {"F": "linear-vessels", "G": "linear-vessels", "H": "tangent-constant", "I": "tangent-radius"}
    assert set(names) == set(PAPER)
    for letter, name in names.items():
        baseline = get_baseline(letter)
        assert baseline.name == name
        assert get_baseline(letter.lower()) is baseline
        assert get_baseline(name) is baseline
    with pytest.raises(EffectError, match="baseline 'linear-constnt': unknown; did you mean"):
        get_baseline("linear-constnt")


@pytest.mark.parametrize("letter", MODELS)
def test_a_baseline_has_the_parameters_and_starts_of_its_models(letter: str, study: Study) -> None:
    forward, model = get_baseline(letter).forward(study), get_model(letter)(study)
    own = model.zoo.forward
    assert [(p.name, p.prior, p.unit, p.size) for p in forward.parameters] == [
        (p.name, p.prior, p.unit, p.size) for p in own.parameters
    ]
    assert forward.key == own.key
    start = start_of(forward.parameters)
    for p in forward.parameters:
        low, high = p.prior.support
        assert np.all((low < start[p.name]) & (start[p.name] < high))
        assert not p.log or np.all(start[p.name] > 0)
        assert start[p.name].shape == ((3,) if p.dims else ())
    solved = forward.solve(forward.configure(pack(forward.parameters, start)))
    assert solved.shape == study.values.shape


def test_draws_from_a_baselines_prior_have_a_population(study: Study) -> None:
    forward = get_baseline("G").forward(study)
    theta = draw_prior(forward.parameters, np.random.default_rng(2))
    assert theta.shape == (8,)
    np.testing.assert_array_equal(forward.configure(theta).stiffness, theta[2:5])


def test_conventions_of_a_baseline() -> None:
    study = load_study("demo")
    published = study.conventions.replace(wall_factor=0.5)
    other = replace(study, conventions=published)
    assert [get_baseline(x).forward(other).conventions.wall_factor for x in "BHI"] == [0.5, 0.5, 1.0]
    assert get_baseline("I").forward(other, conventions=published).conventions.wall_factor == 0.5


def test_the_key_sees_what_a_stiffness_law_refers_to() -> None:
    """A closure, a default and a constant of its module; laws alike in all have one key in every process."""
    study = small_study()

    def closed(factor: float):  # type: ignore[no-untyped-def]
        def law(values, network, conventions):  # type: ignore[no-untyped-def]
            return np.full(len(network.ids), factor * float(values["f3"]))

        return law

    def key_of(law) -> str:  # type: ignore[no-untyped-def]
        return BloodFlow(study, "linear", law, (Parameter("f3", Uniform(2e4, 1e5)),)).key

    assert key_of(closed(1.0)) == key_of(closed(1.0)) != key_of(closed(1.5))
    source = (
        "import numpy as np\nFACTOR = {}\ndef law(v, n, c): return np.full(len(n.ids), FACTOR * v['f3'])\n"
    )
    laws = []
    for factor in (1.0, 1.5):
        module = types.ModuleType("laws")
        exec(source.format(factor), module.__dict__)
        laws.append(module.law)
    assert key_of(laws[0]) != key_of(laws[1])


def test_operations_of_one_key_do_not_share_solutions() -> None:
    """What the key cannot see, such as an array that is changed in place, is solved again."""
    slope = np.array([1.0])
    model = FunctionModel(
        lambda c, t: slope[0] * c["a"] * t, (Parameter("a", Uniform(0, 2)),), Outputs(("y",), np.arange(3.0))
    )
    first = ForwardOp(model)
    assert first.evaluate(np.array([1.0]))[0][0, 1] == 1.0
    slope[0] = 3.0
    assert ForwardOp(model).evaluate(np.array([1.0]))[0][0, 1] == 3.0


def test_it_is_a_forward_model(study: Study) -> None:
    model = flow(study)
    assert isinstance(model, ForwardModel)
    assert isinstance(WithEffects(model, [CATALOGUE["taper"].at()]), ForwardModel)
    assert model.families == FAMILIES
    assert model.outputs.series == ((1, 0.0, "pressure_mmHg"), (2, 0.5, "pressure_mmHg"))
