"""What stands beside components in an answer: sets of effects, shares of the gap, data held out."""

from __future__ import annotations

import numpy as np

from test_component_weighing import EFFECTS, FUNCTIONS, KNOTS, MODEL, TIMES, data_of, hooks, of
from zoo.core.diagnosis import diagnose


def test_two_effects_that_explain_together_are_told() -> None:
    both = data_of({"kick": 0.3, "law": 0.15 * KNOTS**2})
    found = diagnose(both, MODEL, EFFECTS, hooks=hooks(FUNCTIONS))
    assert set(found.file.several.names) == {"kick", "bulge"}
    assert found.file.several.log_odds > 3.0
    assert any("kick and bulge" in w or "bulge and kick" in w for w in found.file.warnings)
    one = diagnose(data_of({"kick": 0.3}), MODEL, EFFECTS, hooks=hooks(FUNCTIONS), max_effects=1)
    assert not any("together" in w for w in one.file.warnings)


def test_shares_and_held_out_data_stand_beside_the_components() -> None:
    push = 0.15 * np.exp(-0.5 * ((TIMES - 0.6) / 0.06) ** 2)
    found = diagnose(data_of({"push": push}), MODEL, [], hooks=hooks(FUNCTIONS))
    assert found.cause == ["inflow"]
    assert of(found, "inflow").share.mean > 0.6
    assert of(found, "inflow").share.mean == max(c.share.mean for c in found.file.components)
    held = of(found, "inflow").held_out
    assert held.component.mean < held.sensor.mean
    assert of(found, "inflow").gap_after < 0.3 * found.file.gap.before
    assert found.file.next_measurement is None  # no candidates are known
