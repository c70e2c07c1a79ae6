"""Where tests find data that this repository does not hold, what its absence means, what workers share."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cloudpickle
import pytest
from filelock import FileLock

pytest_plugins = ("tiers",)
ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"

if "ZOO_DATA_DIR" not in os.environ and (SHARED / "data").is_dir():
    os.environ["ZOO_DATA_DIR"] = str(SHARED / "data")
# workers are as many as cores, and the threads of each would wait for one another
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# what PyMC imports would be gone through again and again while PyTensor compiles: a quarter of its time
gc.set_threshold(100_000, 50, 50)


def _missing() -> str | None:
    folder = os.environ.get("ZOO_DATA_DIR")
    if not folder:
        return "ZOO_DATA_DIR is not set"
    files = "mouse-c6/qC6_8192.dat", "mouse-c6/pC6_1024.dat", "cascaded-tanks/dataBenchmark.csv"
    for needed in (*files, "network", "reference"):
        if not (Path(folder) / needed).exists():
            return f"ZOO_DATA_DIR = {folder} does not hold {needed}"
    return None


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("needs_data") is not None and (missing := _missing()):
        pytest.skip(f"{missing}: point it at the folder with the measured data")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """Under CI a test that is skipped has failed."""
    report: Any = yield
    if report.skipped and not hasattr(report, "wasxfail") and os.environ.get("CI"):
        report.outcome, report.longrepr = "failed", f"{report.longrepr[-1]}; under CI no test may be skipped"
    return report


@pytest.fixture(autouse=True)
def own_effects_and_models_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects and models that a test adds are gone after it, so that tests may run in any order."""
    from zoo.blood import plugins
    from zoo.blood.effects import CATALOGUE

    monkeypatch.setattr(CATALOGUE, "_effects", dict(CATALOGUE))
    monkeypatch.setattr(plugins, "USER_MODELS", dict(plugins.USER_MODELS))


@pytest.fixture(scope="session")
def study() -> Any:
    """The study of three vessels of `test_op`, unless a file has one of its own."""
    from test_op import small_study

    return small_study()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder with the measured data and the published solver's waveforms; for tests marked needs_data."""
    return Path(os.environ["ZOO_DATA_DIR"])


@pytest.fixture(scope="session")
def blind_cases(data_dir: Path) -> list[Path]:
    """Folders of the independent simulator's cases, beside the data; for tests marked needs_data."""
    folder = data_dir.parent / "blind" / "cases"
    if not folder.is_dir():
        pytest.skip(f"{folder} does not exist")
    return sorted(folder.iterdir())


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[], Any]], Any]:
    """What a function makes, for a name that is its own: made by one worker, and read by the others."""
    folder = tmp_path_factory.getbasetemp()
    folder = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder

    def made(name: str, make: Callable[[], Any]) -> Any:
        path = folder / f"{name}.pickle"
        with FileLock(f"{path}.lock"):
            if not path.exists():
                path.write_bytes(cloudpickle.dumps(make()))
        return cloudpickle.loads(path.read_bytes())

    return made
