"""What stands beside components in an answer: sets of effects, shares of the gap, data held out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from toys import EFFECTS, FIRST, FUNCTIONS, KNOTS, MODEL, TIMES, data_of, first_of, hooks, of
from zoo.core.diagnosis import diagnose
from zoo.core.diagnosis.answer import FitDiscrepancy, _no_more, _two
from zoo.core.forward import FunctionModel
from zoo.core.parameters import Parameter, Uniform

PUSHED = data_of({"push": 0.15 * np.exp(-0.5 * ((TIMES - 0.6) / 0.06) ** 2)})


@pytest.fixture(scope="module")
def pushed():  # type: ignore[no-untyped-def]
    return diagnose(PUSHED, MODEL, [], hooks=hooks(FUNCTIONS))


def test_two_effects_that_explain_together_are_told() -> None:
    both = data_of({"kick": 0.3, "law": 0.15 * KNOTS**2})
    found = diagnose(both, MODEL, EFFECTS, hooks=hooks(FUNCTIONS))
    assert set(found.file.several.names) == {"kick", "bulge"}
    assert found.file.several.log_odds > 3.0
    assert any("kick and bulge" in w or "bulge and kick" in w for w in found.file.warnings)


def test_shares_and_held_out_data_stand_beside_the_components(pushed) -> None:  # type: ignore[no-untyped-def]
    found = pushed
    assert found.cause == ["inflow"]
    assert of(found, "inflow").share.mean > 0.6
    assert of(found, "inflow").share.mean == max(c.share.mean for c in found.file.components)
    held = of(found, "inflow").held_out
    assert held.component.mean < held.sensor.mean
    assert of(found, "inflow").gap_after < 0.3 * found.file.gap.before
    assert found.file.next_measurement is None  # no candidates are known


def test_one_series_does_not_tell_two_causes_and_the_answer_says_so(pushed) -> None:  # type: ignore[no-untyped-def]
    found = diagnose(first_of(PUSHED), FIRST, [], hooks=hooks(FUNCTIONS))
    assert found.cause[0] == "inflow"
    [warned] = [w for w in found.file.warnings if "two causes at once cannot be told from one" in w]
    assert f"components are wrong, {found.rounds[0].untold:.0%}, is shared equally by all" in warned
    assert not any("two causes at once" in w for w in pushed.file.warnings)


def test_a_probability_that_rounds_to_nothing_is_not_said_to_be_shared() -> None:
    assert "shared equally" in _two(0.006)
    assert (
        _two(0.004) == "each probability is that of a component that is wrong, alone or beside something else"
    )


def test_a_leader_that_can_hardly_be_is_told(pushed) -> None:  # type: ignore[no-untyped-def]
    """By the field's own judgement where it has one, else by the size that the prior expects."""
    judged = replace(
        hooks(FUNCTIONS), plausible=lambda f, v: (False, f"{f.name} is off by {np.abs(v).max():.1f}")
    )
    found = diagnose(PUSHED, MODEL, [], hooks=judged)
    [told] = [w for w in found.file.warnings if "can hardly be" in w]
    assert told == "inflow: what was learned can hardly be: push is off by 0.1"
    assert not any("can hardly be" in w for w in pushed.file.warnings)


def test_a_bound_at_which_the_baseline_stands_only_with_the_leader_is_told() -> None:
    """With the law learned the level falls to its bound; the baseline alone stands off it."""
    bounded = FunctionModel(MODEL.function, (Parameter("level", Uniform(1.03, 2.0)),), MODEL.outputs, "toy")
    found = diagnose(data_of({"level": 1.0, "law": 0.15 * KNOTS**2}), bounded, [], hooks=hooks(FUNCTIONS))
    assert found.cause == ["wall"]
    assert found.file.base_parameters["base"]["level"] > 1.04
    [told] = [w for w in found.file.warnings if "level" in w]
    assert told.startswith("with wall, the mode of level stands at the lower bound of its prior, 1.03")


def test_no_cause_leaves_more_than_the_baseline() -> None:
    def of_size(rms: float) -> FitDiscrepancy:
        draws = np.full((4, 2), rms)
        return FitDiscrepancy(np.zeros((2, 3)), np.zeros((2, 3)), draws, draws, np.zeros((2, 3)))

    small, large = of_size(0.1), of_size(0.3)
    assert _no_more(large, small, [0, 1]) is small
    assert _no_more(small, large, [0, 1]) is small
