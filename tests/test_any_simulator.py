"""A diagnosis of a simulator that has nothing to do with blood."""

import numpy as np
import pytest

from zoo.core.data import Data
from zoo.core.diagnosis import Candidate, DiagnosisError, Hooks, diagnose
from zoo.core.effects import EffectParameter, Location, effect
from zoo.core.errors.independent import Independent
from zoo.core.forward import FunctionModel, Outputs, SolveError
from zoo.core.parameters import LogUniform, Parameter, Uniform

TIMES = np.linspace(0.0, 6.0, 120)


def cooling(configuration, times):  # type: ignore[no-untyped-def]
    """Two bodies that cool towards a room's temperature, in kelvin above it."""
    rates = np.array([configuration["a"], configuration["b"]])
    rates = rates * (1.0 + configuration.get("wind", np.zeros(2)))
    if np.any(rates < 0):
        raise SolveError("a rate below zero", "rate")
    return 10.0 * np.exp(-rates[:, None] * times) + configuration.get("drift", 0.0) * times


MODEL = FunctionModel(
    cooling,
    (
        Parameter("a", Uniform(0.05, 2.0), "1/min", start=0.4, log=True),
        Parameter("b", Uniform(0.05, 2.0), "1/min", 0.4),
    ),
    Outputs(("one", "two"), TIMES),
    "cooling",
)


@effect("drift", parameters=[EffectParameter("slope", "K/min", 0.2, -1.0, 1.0, (0.1, -0.1))])
def drift(configuration, values, location):  # type: ignore[no-untyped-def]
    """The room warms."""
    return {**configuration, "drift": values[0]}


@effect(
    "wind",
    parameters=[EffectParameter("gust", "1", 0.3, 0.0, 2.0, (0.2,))],
    locations=lambda model: (Location("one", noun="body"), Location("two", noun="body")),
)
def wind(configuration, values, location):  # type: ignore[no-untyped-def]
    """One body is in a draught: it cannot be told from its own rate."""
    return {
        **configuration,
        "wind": np.array([values[0] * (location.part == name) for name in ("one", "two")]),
    }


def measured(slope: float, noise: float = 0.02, seed: int = 1) -> Data:
    series = MODEL.solve({"a": 0.5, "b": 0.8, "drift": slope})
    series = series + noise * np.random.default_rng(seed).standard_normal(series.shape)
    return Data(
        TIMES,
        series,
        labels=["one", "two"],
        units=["K", "K"],
        groups=["T", "T"],
        time_unit="min",
        name="cups",
    )


def test_the_cause_is_found_and_the_unit_is_the_datas() -> None:
    found = diagnose(measured(0.15), MODEL, [drift, wind])
    assert found.cause == ["drift"]
    assert found.file.gap.unit == "K"
    assert abs(found.causes[0].estimates[0].mean - 0.15) < 0.01
    assert found.file.verdict.startswith("Most likely missing: drift, slope = 0.15")
    assert set(found.where.phase) == {"first quarter", "second quarter", "third quarter", "fourth quarter"}
    assert '"before_K"' in found.file.model_dump_json()
    assert {one.name: one.probability for one in found.causes}["wind"] < 0.2


def test_noise_alone_is_no_gap() -> None:
    found = diagnose(measured(0.0), MODEL, [drift, wind])
    assert found.cause == []
    assert found.file.no_gap > 0.5


def test_hooks_name_phases_and_the_next_measurement() -> None:
    def phases(data, rows):  # type: ignore[no-untyped-def]
        return ("early", "late"), (data.times > 3.0).astype(int)

    hooks = Hooks(phases=phases, candidates=lambda data, model: [Candidate("one", {"body": "one"}, "T")])
    found = diagnose(measured(0.15), MODEL, [drift, wind], hooks=hooks)
    assert set(found.where.phase) == {"early", "late"}
    assert found.file.next_measurement is None  # nothing rivals the leader


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"data": np.zeros(3)}, "give a zoo.Data"),
        ({"model": 3}, "has not all of name, parameters"),
        ({"effects": ["drift"]}, "give a list of effects"),
        ({"errors": Independent()}, "give Harmonics"),
    ],
)
def test_wrong_arguments_are_named(settings: dict[str, object], text: str) -> None:
    given = {"data": measured(0.1), "model": MODEL, "effects": [drift]} | settings
    with pytest.raises(DiagnosisError, match=text):
        diagnose(given.pop("data"), given.pop("model"), given.pop("effects"), **given)  # type: ignore[arg-type]


def test_a_log_uniform_prior_is_searched_in_its_logarithm() -> None:
    """Its density is not log-concave in the parameter itself."""
    parameters = tuple(Parameter(name, LogUniform(0.05, 2.0), "1/min") for name in "ab")
    model = FunctionModel(cooling, parameters, MODEL.outputs, "cooling")
    found = diagnose(measured(0.15), model, [drift])
    assert found.cause == ["drift"]
    assert abs(found.file.base_parameters["over all sets"]["a"].mean - 0.5) < 0.02
