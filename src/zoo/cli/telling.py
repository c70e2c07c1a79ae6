"""What a long command says while it works: a bar on a terminal, elsewhere a line every 1.5 s."""

from __future__ import annotations

import threading
import time
from typing import Any

EVERY_S = 1.5
"""Seconds between lines where there is no terminal."""


class Telling:
    """Says on standard error what is being done, how far it is, and for how long.

    Parameters
    ----------
    wanted : bool
        False says nothing.
    terminal : bool, optional
        Whether standard error is one; found out if absent.
    """

    def __init__(self, wanted: bool, terminal: bool | None = None) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

        self.console = Console(stderr=True, markup=False)
        self.terminal = self.console.is_terminal if terminal is None else terminal
        self.wanted = wanted
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
        )
        self.bar = Progress(*columns, console=self.console, disable=not (wanted and self.terminal))
        self.task = self.bar.add_task("", total=100)
        self.text, self.share = "", 0.0
        self._done = threading.Event()
        self._began = time.monotonic()
        self._thread = threading.Thread(target=self._lines, daemon=True)

    def __enter__(self) -> Telling:
        self._began = time.monotonic()
        self.bar.__enter__()
        if self.wanted and not self.terminal:
            self._thread.start()
        return self

    def __exit__(self, *error: Any) -> None:
        self._done.set()
        if self._thread.is_alive():
            self._thread.join()
        self.bar.__exit__(*error)

    def __call__(self, text: str, share: float) -> None:
        """What is being done, and the share of this part of the work that is done."""
        self.text, self.share = text, share
        self.bar.update(self.task, description=text, completed=100 * share)

    def say(self, text: str, share: float | None = None) -> None:
        """A word on what comes before or follows; with lines it is one of its own."""
        self(text, self.share if share is None else share)
        if self.wanted and not self.terminal:
            self._line()

    def _line(self) -> None:
        seconds = time.monotonic() - self._began
        self.console.print(
            f"{seconds:4.0f} s  {100 * self.share:3.0f} %  {self.text}", highlight=False, soft_wrap=True
        )

    def _lines(self) -> None:
        while not self._done.wait(EVERY_S):
            self._line()
