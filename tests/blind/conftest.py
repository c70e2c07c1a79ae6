"""A small set of cases that the tests of the blind check share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from zoo.blood.blind import make_cases

CHEAP = ("sensor-offset", "inflow-shift", "inflow-bandwidth", "beat-jitter")
TINY: dict[str, Any] = {"networks": ("tree",), "layouts": ("MPA",), "vessels": (3, 3), "cores": 1}
SECRET = "5" * 32


@pytest.fixture(scope="session")
def tiny() -> dict[str, Any]:
    """Settings of `make_cases` whose cases are solved in a second."""
    return {"secret": SECRET, "effects": CHEAP, **TINY}


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Three cases, and their key."""
    folder = tmp_path_factory.mktemp("blind")
    key = make_cases(folder / "cases", 3, folder / "key.json", secret=SECRET, effects=CHEAP, **TINY)
    return folder / "cases", key
