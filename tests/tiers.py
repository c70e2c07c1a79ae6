"""The two tiers of the tests and their order, from the durations in durations.json.

A test is slow that takes more than `SLOW_SECONDS` of a processor by itself, the fixtures included that it
shares with others, or that is marked so, or stands in one of `SLOW_FILES`; `-m "not slow"` leaves it out.
One that is marked `nightly` repeats at length what a test of the two tiers measures once, and is in neither.
Files that take longest come first, so that none of them is left to one core at the end.
`pytest --durations-file` (`make durations`: of all) writes the durations of the tests that it runs.
"""

from __future__ import annotations

import json
import os
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

FILE = Path(__file__).with_name("durations.json")
SLOW_SECONDS = 5.0
SLOW_FILES = (
    "calibration",
    "contributing",
    "documents_run",
    "kills",
    "notebooks",
    "recovery",
)
"""Of calibration, kills of running chains, documents, notebooks, samples of whole posteriors."""
LEAST = 1.0
"""Tests that take less are not in the file, and are fast."""


def processor_seconds() -> float:
    """Of this process and of its children that have ended: what others do on the machine does not count."""
    return sum(os.times()[:4])


def file_of(test: str) -> str:
    return test.partition("::")[0]


def read() -> dict[str, dict[str, float]]:
    return json.loads(FILE.read_text(encoding="utf-8")) if FILE.exists() else {"files": {}, "tests": {}}


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--durations-file", action="store_true", help="write tests/durations.json anew")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--durations-file"):
        config.pluginmanager.register(Clock(config), "clock")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    durations = read()
    slow = {f"test_{name}.py" for name in SLOW_FILES}
    for item in items:
        long = durations["tests"].get(item.nodeid, 0.0) > SLOW_SECONDS
        if long or item.path.name in slow or item.get_closest_marker("nightly"):
            item.add_marker("slow")
    items.sort(key=lambda item: -durations["files"].get(file_of(item.nodeid), 0.0))


class Clock:
    """Measures tests and fixtures where they run, and writes the file where all reports arrive."""

    def __init__(self, config: pytest.Config) -> None:
        self.writes = not hasattr(config, "workerinput")
        self.shared: dict[tuple[str, str], float] = {}
        self.began = self.of_fixtures = 0.0
        self.own: dict[str, float] = {}
        self.uses: dict[str, list[str]] = {}
        self.fixtures: dict[str, float] = defaultdict(float)

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Iterator[None]:
        began = processor_seconds()
        try:
            return (yield)
        finally:
            if fixturedef.scope != "function":
                seconds = processor_seconds() - began
                self.shared[fixturedef.baseid, fixturedef.argname] = seconds
                self.of_fixtures += seconds

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self) -> Iterator[None]:
        self.began, self.of_fixtures = processor_seconds(), 0.0
        return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(self, item: Any) -> Iterator[None]:
        try:
            return (yield)
        finally:
            used = {(f[-1].baseid, name) for name, f in item._fixtureinfo.name2fixturedefs.items()}
            shared = {"::".join(key): self.shared[key] for key in used & self.shared.keys()}
            own = processor_seconds() - self.began - self.of_fixtures
            item.user_properties.append(("seconds", [own, shared]))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        for name, value in report.user_properties if report.when == "teardown" else ():
            if name == "seconds":
                own, shared = value
                self.own[report.nodeid], self.uses[report.nodeid] = own, list(shared)
                for fixture, seconds in shared.items():
                    self.fixtures[fixture] = max(self.fixtures[fixture], seconds)

    def pytest_sessionfinish(self) -> None:
        if not (self.writes and self.own):
            return
        ran = {file_of(test) for test in self.own}
        kept = {
            kind: {k: v for k, v in known.items() if file_of(k) not in ran and Path(file_of(k)).exists()}
            for kind, known in read().items()
        }
        files: Counter[str] = Counter()
        for test, own in self.own.items():
            files[file_of(test)] += own
            if (alone := own + sum(self.fixtures[f] for f in self.uses[test])) > LEAST:
                kept["tests"][test] = round(alone, 1)
        for file in ran:
            of_it = {f for test, used in self.uses.items() if file_of(test) == file for f in used}
            kept["files"][file] = round(files[file] + sum(self.fixtures[f] for f in of_it), 1)
        text = json.dumps({kind: dict(sorted(kept[kind].items())) for kind in kept}, indent=0)
        FILE.write_text(text + "\n", encoding="utf-8")
