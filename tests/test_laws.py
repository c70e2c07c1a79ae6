"""The simple law of a learned function, where the law that made the data is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import zoo

TIMES = np.linspace(0.0, 12.0, 200)
SPEED = 3.0 * np.sin(TIMES) + 1.5 * np.sin(2.3 * TIMES)
LAW = zoo.free_function("lack", along="speed", size=4.0, unit="N", along_unit="m/s")


def push(c: Any, times: np.ndarray) -> Any:
    """A force that is read at known speeds: in proportion to them, and what is lacking."""
    speed = np.interp(times, TIMES, SPEED)
    return c["drag"] * speed + c["lack"](speed)


@pytest.mark.parametrize(
    ("name", "law", "shape"),
    [
        ("power", lambda v: 0.4 * np.sign(v) * np.abs(v) ** 2.2, 2.2),
        ("saturation", lambda v: 3.0 * np.tanh(v / 1.5), 1.5),
        ("sine", lambda v: 2.0 * np.sin(2 * np.pi * v / 6.0 + 0.7), 6.0),
        ("threshold", lambda v: 1.5 * np.maximum(v - 1.0, 0.0), 1.0),
    ],
)
def test_the_law_that_made_the_data_is_named(
    name: str, law: Callable[[np.ndarray], np.ndarray], shape: float
) -> None:
    """Beside a parameter of the baseline that takes any part in proportion to the speed away."""
    rng = np.random.default_rng(5)
    exact = push({"drag": 1.0, "lack": lambda v: np.interp(v, AT, law(AT))}, TIMES)
    found = zoo.diagnose(
        TIMES, exact + 0.02 * rng.standard_normal(len(TIMES)), push, {"drag": zoo.Normal(1.0, 1.0)}, [LAW],
        units=["N"], cores=1, progress=False,
    )  # fmt: skip
    [learned] = found.components[0].functions
    best, *others = learned.laws
    assert best.name == name
    assert best.probability > 0.9
    assert math.fsum(one.probability for one in learned.laws) == pytest.approx(1.0)
    low, high = best.interval or (math.nan, math.nan)
    assert low - 0.06 * shape < shape < high + 0.06 * shape  # values between which the shape is tried
    assert high - low < 0.5 * shape
    assert best.left < min(one.left for one in others if one.name != "sine")
    assert f"lack is most like a {name} of the speed" in str(found)


EDGE = 0.05 * np.ptp(SPEED)
AT = np.linspace(SPEED.min() - EDGE, SPEED.max() + EDGE, 9)
"""The function's points, between which it is straight."""


def test_places_and_few_points_have_no_law() -> None:
    from types import SimpleNamespace

    from zoo.core.diagnosis.laws import simple_laws

    for labels, points in ((("here", "there", "beside", "above"), 4), ((), 3)):  # three are any sine's
        function: Any = SimpleNamespace(labels=labels, at=np.arange(points))
        assert simple_laws(function, None, None, 0) == []  # type: ignore[arg-type]
