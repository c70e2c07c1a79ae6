"""What long work shows while it lasts: on a terminal a bar, elsewhere a line now and again."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from zoo.core.inference.chain import Report

EVERY_S = 30.0
"""Seconds between lines where there is no terminal."""
REFRESH_S = 0.5
"""Those between looks at a text that is a function, on a terminal."""


class Display:
    """Says on standard error what is being done, how far it is, and for how long.

    Parameters
    ----------
    wanted : bool
        False says nothing.
    every_s : float
        Seconds between lines where there is no terminal.
    """

    def __init__(self, wanted: bool, *, every_s: float = EVERY_S) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self.console = Console(stderr=True)
        self.wanted, self.every_s = wanted, every_s
        self.terminal = self.console.is_terminal
        columns = TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn()
        self._bar = Progress(*columns, console=self.console, disable=not (wanted and self.terminal))
        self._task = self._bar.add_task("", total=1.0)
        self._text: str | Callable[[], str] = ""
        self.share: float | None = None
        self._done = threading.Event()
        self._began = time.monotonic()
        self._thread = threading.Thread(target=self._refresh, daemon=True)

    def __enter__(self) -> Display:
        self._began = time.monotonic()
        self._bar.start()
        if self.wanted:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        if self._thread.is_alive():
            self._thread.join()
        self._bar.stop()

    def __call__(self, text: str | Callable[[], str], share: float | None = None) -> None:
        """What is being done, as a text or a function that gives it, and the share that is done."""
        self._text, self.share = text, share

    def say(self, text: str) -> None:
        """A line of its own, which stays."""
        if self.wanted:
            self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    @contextlib.contextmanager
    def during(self, text: str, state: Callable[[], str]) -> Iterator[None]:
        """Say that work of unknown length goes on, and how far it is."""
        self(lambda: f"{text}: {state()}")
        try:
            yield
        finally:
            self("")

    def _refresh(self) -> None:
        while not self._done.wait(REFRESH_S if self.terminal else self.every_s):
            text = self._text if isinstance(self._text, str) else self._text()
            if self.terminal:
                total = None if self.share is None else 1.0
                self._bar.update(self._task, description=text, total=total, completed=self.share or 0.0)
            elif text:
                done = "" if self.share is None else f"{100 * self.share:.0f} %, "
                self.say(f"{text}, {done}{_duration(time.monotonic() - self._began)} so far")


@dataclass
class ChainState:
    """State of one chain as the parent knows it."""

    chain: int
    steps: int = 0
    kept: int = 0
    seconds: float = 0.0
    solves: int = 0
    accepted: float = 0.0
    failures: dict[str, int] = field(default_factory=dict)
    draws: dict[str, list[np.ndarray]] = field(default_factory=dict)
    stats: dict[str, list[np.ndarray]] = field(default_factory=dict)

    def update(self, report: Report) -> None:
        """Add what a chain reports to what is known of it."""
        for name in ("steps", "kept", "seconds", "solves", "accepted", "failures"):
            setattr(self, name, getattr(report, name))
        for store, new in ((self.draws, report.draws), (self.stats, report.stats)):
            for name, rows in new.items():
                if len(rows):
                    store.setdefault(name, []).append(rows)

    def values(self, draws: int, *, stats: bool = False) -> dict[str, np.ndarray]:
        """The first `draws` stored draws of each variable, or of each statistic."""
        found = {}
        for name, rows in (self.stats if stats else self.draws).items():
            if len(rows) > 1:
                rows[:] = [np.concatenate(rows)]
            found[name] = rows[0][:draws]
        return found


def of_chains(states: Sequence[ChainState], until: int) -> str:
    """One line on chains: draws, acceptance, solves."""
    steps, solves = sum(s.steps for s in states), sum(s.solves for s in states)
    accepted = sum(s.accepted for s in states) / max(1, steps)
    rate = solves / max(sum(s.seconds for s in states), 1e-9)
    failed = sum(sum(s.failures.values()) for s in states)
    return (
        f"draws {' '.join(str(s.kept) for s in states)} of {until}, accepted {accepted:.0%}, {solves} solves "
        f"({rate:.0f}/s a core), {failed} failed"
    )


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
