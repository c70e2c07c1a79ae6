"""Noise that is stated wrongly, shared by copies, or not there at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from toys import MODEL, NOISE, OWN, PUSH, TIMES, data_of, hooks
from zoo.core.diagnosis import diagnose
from zoo.core.errors.spectral import Harmonics


@pytest.mark.parametrize(("factor", "warned"), [(0.1, True), (1.0, False), (10.0, True)])
def test_a_stated_noise_that_the_series_do_not_have_is_told(factor: float, warned: bool) -> None:
    errors = Harmonics(known={"y": factor * NOISE})
    found = diagnose(data_of({}), MODEL, [], errors=errors, hooks=hooks([]))
    told = [text for text in found.file.warnings if "noise_sd of y is" in text]
    assert bool(told) == warned
    if warned:
        assert "scatter by 0.0" in told[0]


def test_copies_of_a_series_are_told() -> None:
    data = data_of({})
    values = np.stack([data.values[0], data.values[0]])
    for given, warned in ((data, False), (replace(data, values=values), True)):
        found = diagnose(given, MODEL, [], hooks=hooks([]))
        assert any("y1 and y2 have the same noise" in text for text in found.file.warnings) == warned


@pytest.mark.parametrize("noise", [0.0, 1e-9])
def test_data_without_noise_are_diagnosed(noise: float) -> None:
    """As simulations have them; no noise below a hundred-thousandth of the range is fitted."""
    pushed = 0.15 * np.sin(4 * np.pi * TIMES + 0.5)
    data = data_of({"push": pushed}, noise=noise)
    found = diagnose(data, MODEL, [], hooks=hooks([PUSH, OWN]))
    assert found.sets.components(found.sets.leader) == ("inflow",)
    assert found.file.gap.after < 0.1 * found.file.gap.before
    none = diagnose(data_of({}, noise=noise), MODEL, [], hooks=hooks([PUSH, OWN]))
    assert none.cause == []
