"""What was learned in one state, in another one of the same system, where the answer is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from toys import FUNCTIONS, KNOTS, MODEL, NOISE, TIMES, data_of, hooks
from zoo.core.data import Data
from zoo.core.diagnosis import DiagnosisError, OtherState, diagnose, read_diagnosis
from zoo.core.diagnosis.states import seen_at_sensor, state_warning
from zoo.core.forward import FunctionModel, Outputs, SolveError
from zoo.core.parameters import Normal, Parameter, Uniform

PERIOD = 0.7
LATER = np.arange(80) * (PERIOD / 80)
LAW = {"law": 0.15 * KNOTS**2}
BUMP = 0.2 * np.exp(-0.5 * ((TIMES - 0.6) / 0.06) ** 2)


def faster(configuration, times):  # type: ignore[no-untyped-def]
    """The same system at another period, its drive of another shape."""
    part = times / PERIOD

    def sensor(x):  # type: ignore[no-untyped-def]
        return x + np.interp(x, KNOTS, configuration.get("law", np.zeros(len(KNOTS))))

    drive = 0.9 * (np.sin(2 * np.pi * part) + 0.4 * np.cos(4 * np.pi * part))
    x = configuration["level"] * drive + configuration.get("push", 0.0)
    return np.stack([sensor(x), sensor(0.6 * np.roll(x, 6)) + configuration.get("own", 0.0)])


FASTER = FunctionModel(faster, MODEL.parameters, Outputs(("y1", "y2"), LATER), "toy")


def in_state_two(configuration, seed: int = 2) -> OtherState:  # type: ignore[no-untyped-def]
    exact = faster({"level": 1.05, **configuration}, LATER)
    noisy = exact + NOISE * np.random.default_rng(seed).standard_normal(exact.shape)
    data = Data(LATER, noisy, ["y1", "y2"], ["K", "K"], ["y", "y"], PERIOD, name="faster")
    return OtherState(data, FASTER)


def known(model, theta, data):  # type: ignore[no-untyped-def]
    """The toy's functions; those of the time at the times of the data."""
    return [f if f.period is None else replace(f, at=data.times, period=data.duration) for f in FUNCTIONS]


def found_in(first, second):  # type: ignore[no-untyped-def]
    found = diagnose(data_of(first), MODEL, [], hooks=replace(hooks([]), components=known), states=[second])
    [state] = found.states
    return found, state, {tuple(c.names): c for c in state.file.carried}


@pytest.fixture(scope="module")
def of_the_law():  # type: ignore[no-untyped-def]
    return found_in(LAW, in_state_two(LAW))


def test_a_law_of_the_system_holds_in_another_state(of_the_law) -> None:  # type: ignore[no-untyped-def]
    found, state, carried = of_the_law
    assert found.sets.components(found.sets.leader) == ("wall",)
    assert carried[("wall",)].holds
    assert carried[("wall",)].better == 1.0
    exact = faster({"level": 1.05, **LAW}, LATER)
    left = exact - state.computed["wall"]
    assert np.sqrt(np.mean(left**2)) < 0.5 * NOISE < 0.2 * state.file.baseline.mean
    assert state.file.baseline.mean < 1.5 * state.file.sensor.mean
    assert not carried[("inflow",)].holds
    assert not any("does not hold" in w for w in found.file.warnings)


def test_the_baseline_is_fitted_again_by_least_squares(of_the_law) -> None:  # type: ignore[no-untyped-def]
    """Against a scan of its only parameter."""
    _, state, _ = of_the_law
    levels = np.linspace(0.5, 2.0, 3001)
    S = [np.sum((state.data.values - faster({"level": x}, LATER)) ** 2) for x in levels]
    best = faster({"level": levels[int(np.argmin(S))]}, LATER)
    assert np.abs(best - state.computed["baseline"]).max() < 0.01
    rms = np.sqrt(max(min(S) / state.data.values.size - state.file.noise**2, 0.0))
    assert state.file.baseline.mean == pytest.approx(rms, rel=1e-3)
    assert state.file.noise == pytest.approx(NOISE, rel=0.25)


def test_an_error_of_one_record_does_not_hold_in_another_state() -> None:
    found, state, carried = found_in({"push": BUMP}, in_state_two({}))
    assert found.sets.components(found.sets.leader) == ("inflow",)
    assert not carried[("inflow",)].holds
    assert state.file.baseline.mean < 0.5 * NOISE < carried[("inflow",)].error.mean
    [warning] = [w for w in found.file.warnings if "does not hold in faster" in w]
    assert "inflow" in warning


def test_what_comes_at_the_same_part_of_every_beat_is_moved_to_the_other_period() -> None:
    again = np.interp(LATER / PERIOD, TIMES, BUMP, period=1.0)
    _, state, carried = found_in({"push": BUMP}, in_state_two({"push": again}))
    assert carried[("inflow",)].error.mean < min(NOISE, 0.3 * state.file.baseline.mean)
    assert not carried[("inflow",)].holds  # a discrepancy at the same part of the beat does as well


def test_a_discrepancy_that_belongs_to_the_sensor_is_told_from_a_function() -> None:
    own = 0.3 * np.sin(6 * np.pi * TIMES)
    there = in_state_two({"own": np.interp(LATER / PERIOD, TIMES, own, period=1.0)})
    found, state, carried = found_in({"own": own}, there)
    drawn = seen_at_sensor(found.sets)
    assert np.sqrt(np.mean((drawn - [0 * own, own]) ** 2)) < NOISE
    assert state.file.sensor.mean < 0.2 * state.file.baseline.mean
    assert carried[("sensor",)].holds
    assert len(carried) > 1
    assert all("sensor" in names for names, one in carried.items() if one.holds)


def test_what_was_not_visited_is_told() -> None:
    def made(model, theta, data):  # type: ignore[no-untyped-def]
        wide = np.linspace(-4.0, 4.0, 9) if data.name == "faster" else KNOTS
        return [replace(f, at=wide) for f in known(model, theta, data) if f.period is None]

    found = diagnose(
        data_of(LAW), MODEL, [], hooks=replace(hooks([]), components=made), states=[in_state_two(LAW)]
    )
    [state] = found.file.states
    [wall] = [c for c in state.carried if c.names == ["wall"]]
    assert wall.beyond == pytest.approx(0.5)


def test_states_are_in_the_file(of_the_law, tmp_path) -> None:  # type: ignore[no-untyped-def]
    found, state, _ = of_the_law
    file = read_diagnosis(found.save(tmp_path))
    assert file.states[0].state == "faster"
    assert file.states[0].baseline.mean == pytest.approx(state.file.baseline.mean)
    assert file.states[0].carried[0].holds
    assert '"baseline_K"' in (tmp_path / "diagnosis.json").read_text()


def no_work(text, share) -> None:  # type: ignore[no-untyped-def]
    raise AssertionError(f"{text}: refused only after work")


STATE = in_state_two({})
DATA = data_of(LAW)
TALLER = replace(FASTER, parameters=(Parameter("height", Normal(1.0, 0.3)),))
MANY = replace(FASTER, parameters=(Parameter("level", Normal(1.0, 0.3), dims="part", size=2),))
NEARLY = replace(DATA, values=DATA.values * (1 + 1e-12), groups=("left", "right"))
MILLI = replace(STATE.data, units=("mK", "K"), groups=("one", "two"))


@pytest.mark.parametrize(
    ("states", "words"),
    [
        ([replace(STATE, model=TALLER)], "other parameters"),
        ([replace(STATE, model=MANY)], "other parameters"),
        ([OtherState(DATA, MODEL)], "same series as"),
        ([OtherState(NEARLY, MODEL)], "same series as"),
        ([STATE, STATE], "given twice"),
        ([replace(STATE, model=MODEL)], "ask the forward model for the data's series"),
        # what was seen at a sensor is taken off as it is
        ([replace(STATE, data=MILLI)], r"series y1 is in mK, in .* in K: give both in one unit"),
    ],
)
def test_what_is_no_other_state_is_refused_before_the_work(states: list[OtherState], words: str) -> None:
    with pytest.raises(DiagnosisError, match=words):
        diagnose(DATA, MODEL, [], hooks=hooks(FUNCTIONS), states=states, tick=no_work)


def test_a_leader_that_cannot_be_tried_is_told(of_the_law) -> None:  # type: ignore[no-untyped-def]
    found, _, _ = of_the_law
    state = found.file.states[0]
    left = [c for c in state.carried if c.names != ["wall"]]
    untried = state.model_copy(update={"carried": left, "failed": ["wall"]})
    assert state_warning(untried, ["wall"]) == (
        "what was learned of wall cannot be tried in faster: no solve succeeds"
    )
    assert state_warning(untried, ["inflow"]) != ""
    assert state_warning(state, ["wall"]) == ""


def never(configuration, times):  # type: ignore[no-untyped-def]
    raise SolveError("the drive is too large")


def test_a_state_that_cannot_be_solved_costs_nothing_but_itself() -> None:
    broken = replace(in_state_two({}), model=replace(FASTER, function=never))
    found = diagnose(
        data_of(LAW),
        MODEL,
        [],
        hooks=replace(hooks([]), components=known),
        states=[broken, in_state_two(LAW)],
    )
    assert found.sets.components(found.sets.leader) == ("wall",)
    assert [one.state for one in found.file.states] == ["faster"]
    [warning] = [w for w in found.file.warnings if "cannot be solved" in w]
    assert "in faster the baseline cannot be solved" in warning
    assert "the drive is too large" in warning


def test_a_bound_at_which_the_baseline_stands_in_another_state_is_told(of_the_law) -> None:  # type: ignore[no-untyped-def]
    narrow = replace(FASTER, parameters=(Parameter("level", Uniform(0.5, 0.9)),))
    _, state, _ = found_in(LAW, replace(in_state_two(LAW), model=narrow))
    [warning] = state.warnings
    assert "in faster" in warning
    assert "level" in warning
    assert "0.9" in warning
    found, state, _ = of_the_law
    assert not state.warnings
    assert not any("bound" in w for w in found.file.warnings)
