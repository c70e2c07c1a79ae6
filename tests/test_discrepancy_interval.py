"""The interval of a stated discrepancy: from what a fit without noise would leave to what this fit leaves."""

from __future__ import annotations

import numpy as np
import pytest

from zoo.core.diagnosis.answer import FitDiscrepancy


def discrepancy(rms: float, unabsorbed: float, seed: int = 1) -> FitDiscrepancy:
    rng = np.random.default_rng(seed)
    draws = (x * (1 + 0.02 * rng.standard_normal((400, 2))) for x in (rms, unabsorbed))
    return FitDiscrepancy(np.zeros((2, 3)), np.zeros((2, 3)), *draws, np.zeros((2, 3)))


@pytest.mark.parametrize("unabsorbed", [0.1, 0.3, 0.4])
def test_an_interval_holds_its_estimate(unabsorbed: float) -> None:
    """Also where a fit without noise, weighted by correlated noise, leaves more than this one."""
    found = discrepancy(0.3, unabsorbed)
    size = found.interval([0, 1])
    assert size.low < size.mean < size.high
    assert size.low == pytest.approx(min(0.3, unabsorbed), rel=0.05)
    assert size.high == pytest.approx(0.3, rel=0.05)
    removed = found.removed([0, 1], discrepancy(1.0, 1.0, seed=2))
    assert removed.low < removed.mean < removed.high
