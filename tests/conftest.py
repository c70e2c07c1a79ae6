"""Where the tests find data that this repository does not hold, and what its absence means."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"
LONG = (
    "kills",
    "surrogate",
    "working_folder",
    "explanations",
    "other_states",
    "examples",
    "diagnosis",
    "docs",
)
"""Files of tests that take minutes: first, so that none of them is left to one core at the end."""

if "ZOO_DATA_DIR" not in os.environ and (SHARED / "data").is_dir():
    os.environ["ZOO_DATA_DIR"] = str(SHARED / "data")


def _missing() -> str | None:
    folder = os.environ.get("ZOO_DATA_DIR")
    if not folder:
        return "ZOO_DATA_DIR is not set"
    files = "mouse-c6/qC6_8192.dat", "mouse-c6/pC6_1024.dat", "cascaded-tanks/dataBenchmark.csv"
    for needed in (*files, "network", "reference"):
        if not (Path(folder) / needed).exists():
            return f"ZOO_DATA_DIR = {folder} does not hold {needed}"
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    long = {f"test_{name}.py" for name in LONG}
    items.sort(key=lambda item: item.path.name not in long)


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("needs_data") is None:
        return
    missing = _missing()
    if missing and os.environ.get("CI"):
        pytest.fail(f"{missing}, and under CI a test may not be skipped for that", pytrace=False)
    if missing:
        pytest.skip(f"{missing}: point it at the folder with the measured data")


@pytest.fixture(autouse=True)
def own_effects_and_models_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects and models that a test adds are gone after it, so that tests may run in any order."""
    from zoo.blood import plugins
    from zoo.blood.effects import CATALOGUE

    monkeypatch.setattr(CATALOGUE, "_effects", dict(CATALOGUE))
    monkeypatch.setattr(plugins, "USER_MODELS", dict(plugins.USER_MODELS))


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder with the measured data and the published solver's waveforms; for tests marked needs_data."""
    return Path(os.environ["ZOO_DATA_DIR"])


@pytest.fixture(scope="session")
def blind_cases(data_dir: Path) -> list[Path]:
    """Folders of the independent simulator's cases, beside the data; for tests marked needs_data."""
    folder = data_dir.parent / "blind" / "cases"
    if not folder.is_dir():
        message = f"{folder} does not exist"
        pytest.fail(message) if os.environ.get("CI") else pytest.skip(message)
    return sorted(folder.iterdir())
