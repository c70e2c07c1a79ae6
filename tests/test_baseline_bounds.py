"""A baseline whose prior ends before its best fit: said first, and lifted before any effect is weighed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from zoo.core.data import Data
from zoo.core.diagnosis import Diagnosis, DiagnosisError, diagnose, read_diagnosis
from zoo.core.diagnosis.bounds import widened
from zoo.core.effects import EffectError, EffectParameter, effect
from zoo.core.errors.spectral import Cosines
from zoo.core.forward import ForwardModel, FunctionModel, Outputs, WithPriors
from zoo.core.parameters import InverseGamma, LogNormal, LogUniform, Normal, Parameter, Prior, Uniform

TIMES = np.linspace(0.0, 6.0, 80)
NOISE = 0.02


def cooling(configuration, times):  # type: ignore[no-untyped-def]
    """A body that cools towards a room that may warm, in kelvin above what the room was."""
    return (
        configuration["T0"] * np.exp(-configuration["rate"] * times) + configuration.get("drift", 0.0) * times
    )


def model_of(rate: Prior) -> FunctionModel:
    parameters = (Parameter("rate", rate, "1/min", log=True), Parameter("T0", Normal(10.0, 2.0), "K"))
    return FunctionModel(cooling, parameters, Outputs(("one",), TIMES), "cooling")


@effect("drift", parameters=[EffectParameter("slope", "K/min", 0.2, -1.0, 1.0, (0.1, -0.1))])
def drift(configuration, values, location):  # type: ignore[no-untyped-def]
    """The room warms."""
    return {**configuration, "drift": values[0]}


def measured(slope: float = 0.0) -> Data:
    """Of a rate of 1.2 per minute."""
    clean = cooling({"rate": 1.2, "T0": 10.0, "drift": slope}, TIMES)
    noise = NOISE * np.random.default_rng(1).standard_normal(clean.shape)
    return Data(TIMES, (clean + noise)[None], labels=["one"], units=["K"], time_unit="min", name="cup")


def diagnosed(rate: Prior, slope: float = 0.0) -> Diagnosis:
    return diagnose(measured(slope), model_of(rate), [drift], errors=Cosines())


@pytest.mark.parametrize("prior", [Uniform(0.05, 0.6), LogUniform(0.05, 0.6), Normal(0.4, 0.5, 0.05, 0.6)])
def test_what_the_prior_excludes_is_no_gap_and_no_effect(prior: Prior, tmp_path: object) -> None:
    found = diagnosed(prior)
    assert found.cause == []
    assert found.file.gap.before < NOISE
    excluded = found.file.excluded
    assert excluded is not None
    (bound,) = excluded.bounds
    assert (bound.parameter, bound.side, bound.bound, bound.unit) == ("rate", "upper", 0.6, "1/min")
    assert bound.best == pytest.approx(1.2, rel=0.02)
    assert excluded.residual_rms_within > 20 * excluded.residual_rms_free
    assert excluded.residual_rms_free == pytest.approx(NOISE, rel=0.2)
    assert found.file.verdict.startswith(
        f"The baseline's prior excludes its best fit, rate = {bound.best:.3g} (upper bound 0.6). Without "
        "that bound: Nothing is missing"
    )
    assert "--prior rate=..., or priors={'rate': ...}, lifts it" in found.file.warnings[0]
    assert read_diagnosis(found.save(str(tmp_path))).excluded == excluded
    assert '"residual_rms_within_K"' in found.file.model_dump_json()


def test_an_effect_is_weighed_with_the_bound_lifted() -> None:
    found = diagnosed(LogUniform(0.05, 0.6), slope=0.15)
    assert found.file.excluded is not None
    assert found.cause == ["drift"]
    assert found.causes[0].estimates[0].mean == pytest.approx(0.15, abs=0.01)
    assert found.file.base_parameters["over all sets"]["rate"].mean == pytest.approx(1.2, rel=0.02)


def test_a_prior_that_holds_the_best_fit_is_left_alone() -> None:
    found = diagnosed(Uniform(0.05, 2.0))
    assert found.file.excluded is None
    assert found.file.warnings == []
    assert found.file.verdict.startswith("Nothing is missing")


def test_a_bound_that_costs_nothing_is_told_and_not_lifted() -> None:
    """The best fit lies on the bound, within what the noise resolves."""
    at = diagnosed(Uniform(0.05, 2.0)).file.base_parameters["base"]["rate"].mean
    found = diagnosed(Uniform(0.05, at - 1e-5))
    assert found.file.excluded is None
    assert found.file.warnings[0].startswith("the mode of rate stands at the upper bound of its prior")


@pytest.mark.parametrize(
    ("prior", "lower", "upper"),
    [
        (Uniform(1.0, 4.0), (0.1, 4.0), (1.0, 40.0)),
        (Uniform(-1.0, 1.0), (-5.0, 1.0), (-1.0, 5.0)),
        (LogUniform(1.0, 4.0), (0.1, 4.0), (1.0, 40.0)),
        (Normal(2.0, 1.0, 1.0, 4.0), (0.1, 4.0), (1.0, math.inf)),
        (Normal(0.0, 1.0, -1.0, 4.0), (-math.inf, 4.0), (-1.0, math.inf)),
        (LogNormal(2.0, 0.5, 1.0, 4.0), (0.0, 4.0), (1.0, math.inf)),
    ],
)
def test_a_bound_is_moved_at_its_own_end(
    prior: Prior, lower: tuple[float, float], upper: tuple[float, float]
) -> None:
    for side, support in (("lower", lower), ("upper", upper)):
        found = widened(prior, side)
        assert found is not None
        assert type(found) is type(prior)
        assert found.support == pytest.approx(support)
    assert widened(InverseGamma(3.0, 1.0), "lower") is None


def test_other_priors_leave_the_solutions_as_they_are() -> None:
    model = model_of(Uniform(0.05, 0.6))
    other = WithPriors(model, {"rate": Uniform(0.05, 6.0)})
    assert isinstance(other, ForwardModel)
    assert (other.key, other.function) == (model.key, cooling)
    assert [p.prior for p in other.parameters] == [Uniform(0.05, 6.0), Normal(10.0, 2.0)]
    np.testing.assert_array_equal(
        other.solve(other.configure([0.3, 9.0])), model.solve({"rate": 0.3, "T0": 9.0})
    )


# -- what a simulator of one's own may have wrong ---------------------------------------------------


def test_a_parameter_that_the_model_does_not_use_is_named() -> None:
    model = model_of(Uniform(0.05, 2.0))
    idle = replace(model, parameters=(*model.parameters, Parameter("idle", Uniform(0.0, 1.0))))
    with pytest.raises(DiagnosisError, match="cooling: its series do not depend on idle: leave it out"):
        diagnose(measured(), idle, [drift], errors=Cosines())


@pytest.mark.filterwarnings("ignore:effect drift")
def test_parameters_that_do_the_same_are_named() -> None:
    def twice(configuration, times):  # type: ignore[no-untyped-def]
        return cooling({"rate": configuration["a"] + configuration["b"], "T0": 10.0}, times)

    parameters = tuple(Parameter(name, Uniform(0.0, 3.0)) for name in "ab")
    with pytest.raises(DiagnosisError, match="do not tell a from b: fix one of them"):
        diagnose(measured(), FunctionModel(twice, parameters, Outputs(("one",), TIMES), "twice"), [drift])


def test_effects_that_cannot_act_are_named() -> None:
    with pytest.raises(
        EffectError, match=r"effect nothing: size = 0\.0: give a positive size, or parameters"
    ):
        effect("nothing", parameters=[])(lambda configuration, values, location: configuration)
    forgot = effect("forgot", parameters=drift.parameters)(lambda configuration, values, location: None)
    with pytest.raises(EffectError, match="effect forgot: its function returns None"):
        diagnose(measured(0.1), model_of(Uniform(0.05, 2.0)), [forgot])
