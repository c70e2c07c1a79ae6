"""What a run shows while it lasts: draws, acceptance, solves, convergence, time to the target."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from zoo.core.inference.convergence import ESS_TARGET, Verdict, check_convergence

EVERY_S = 30.0
"""Seconds between lines where there is no terminal."""


@dataclass
class ChainState:
    """State of one chain as the parent knows it."""

    chain: int
    steps: int = 0
    kept: int = 0
    tuning: bool = True
    phase: str = "waiting"
    seconds: float = 0.0
    solves: int = 0
    accepted: float = 0.0
    failures: dict[str, int] = field(default_factory=dict)
    draws: dict[str, list[np.ndarray]] = field(default_factory=dict)
    stats: dict[str, list[np.ndarray]] = field(default_factory=dict)

    def update(self, message: Mapping[str, Any]) -> None:
        for name in ("steps", "kept", "tuning", "seconds", "solves", "accepted", "failures"):
            setattr(self, name, message[name])
        for store, new in ((self.draws, message["draws"]), (self.stats, message["stats"])):
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


class Display:
    """Shows progress on standard error: a live table on a terminal, a line every half minute elsewhere."""

    def __init__(self, wanted: bool, *, tune: int, thin: int, cores: int, ess: float | None) -> None:
        from rich.console import Console

        self.wanted = wanted
        self.tune, self.thin, self.cores, self.ess = tune, thin, cores, ess
        self.console = Console(stderr=True)
        self.began = time.monotonic()
        self.live: Any = None
        self._verdict: Verdict | None = None
        self._judged_at = -np.inf
        self._judging = 0.0
        self._shown_at = self.began
        self._first_steps: dict[int, int] = {}

    def __enter__(self) -> Display:
        if self.wanted and self.console.is_terminal:
            from rich.live import Live

            self.live = Live(console=self.console, refresh_per_second=4, transient=False)
            self.live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.live is not None:
            self.live.stop()

    def say(self, text: str) -> None:
        """One line, above the table."""
        if self.wanted:
            self.console.print(text, highlight=False, soft_wrap=True)

    @contextlib.contextmanager
    def during(self, text: str, state: Callable[[], str], every_s: float = EVERY_S) -> Iterator[None]:
        """Say that work of unknown length goes on, and how far it is: now and again while it lasts."""
        over = threading.Event()

        def lines() -> None:
            while not over.wait(every_s):
                self.say(f"{text}: {state()}, {_duration(time.monotonic() - self.began)} so far")

        thread = threading.Thread(target=lines, daemon=True)
        if self.wanted:
            thread.start()
        try:
            yield
        finally:
            over.set()
            if thread.ident is not None:
                thread.join()

    def update(self, states: Sequence[ChainState], until: int) -> None:
        """Show the present state."""
        if not self.wanted:
            return
        now = time.monotonic()
        for state in states:
            if state.seconds > 0:
                self._first_steps.setdefault(state.chain, state.steps)
        if self.live is not None:
            self._judge(states, now)
            self.live.update(self.table(states, until))
        elif now - self._shown_at >= EVERY_S:
            self._shown_at = now
            self._judge(states, now)
            self.console.print(self.line(states, until), highlight=False, soft_wrap=True)

    def _judge(self, states: Sequence[ChainState], now: float) -> None:
        kept = min(state.kept for state in states)
        if kept < 20 or now - self._judged_at < max(5.0, 50 * self._judging):
            return
        each = [state.values(kept) for state in states]
        self._verdict = check_convergence(
            {name: np.stack([v[name] for v in each]) for name in each[0]}, ess=self.ess or ESS_TARGET
        )
        self._judging = time.monotonic() - now
        self._judged_at = now

    def remaining(self, states: Sequence[ChainState], until: int) -> float:
        """Seconds to the target: `until` draws, or the effective sample size asked for; NaN if unknown."""
        rates = [state.steps / state.seconds for state in states if state.seconds > 0]
        if not rates:
            return float("nan")
        goal = float(until)
        if self.ess is not None:
            if self._verdict is None:
                return float("nan")
            kept = min(state.kept for state in states)
            goal = kept * max(1.0, self.ess / max(self._verdict.min_ess, 1.0))
        steps = sum(max(0.0, self.tune + goal * self.thin - state.steps) for state in states)
        return steps / float(np.mean(rates)) / min(max(1, self.cores), len(states))

    def summary(self, states: Sequence[ChainState], until: int) -> str:
        """One line on convergence and time."""
        parts = []
        if self._verdict is not None and self._verdict.parameters:
            worst = max(self._verdict.parameters, key=lambda p: p.rhat if np.isfinite(p.rhat) else np.inf)
            least = min(self._verdict.parameters, key=lambda p: np.nan_to_num(min(p.ess_bulk, p.ess_tail)))
            goal = f" of {self.ess:.0f}" if self.ess is not None else ""
            parts.append(f"R-hat {worst.rhat:.3f} ({worst.name})")
            parts.append(f"ESS {self._verdict.min_ess:.0f}{goal} ({least.name})")
        parts.append(f"{_duration(time.monotonic() - self.began)} so far")
        left = self.remaining(states, until)
        if np.isfinite(left):
            what = f"ESS {self.ess:.0f}" if self.ess is not None else f"{until} draws"
            parts.append(f"about {_duration(left)} to {what}")
        return ", ".join(parts)

    def line(self, states: Sequence[ChainState], until: int) -> str:
        """Everything in one line, for a log file."""
        steps = sum(s.steps for s in states)
        accepted = sum(s.accepted for s in states) / max(1, steps)
        solves, seconds = sum(s.solves for s in states), sum(s.seconds for s in states)
        failed = sum(sum(s.failures.values()) for s in states)
        draws = " ".join(str(s.kept) for s in states)
        return (
            f"draws {draws} of {until}, accepted {accepted:.0%}, {solves} solves "
            f"({solves / max(seconds, 1e-9):.0f}/s a core), {failed} failed; {self.summary(states, until)}"
        )

    def table(self, states: Sequence[ChainState], until: int) -> Any:
        """Rich table of the chains."""
        from rich.table import Table

        table = Table(caption=self.summary(states, until), caption_justify="left", pad_edge=False)
        table.add_column("chain", justify="right")
        table.add_column("phase", min_width=9)
        for name in ("steps", f"draws of {until}", "accepted", "solves", "solves/s", "failed"):
            table.add_column(name, justify="right")
        for s in states:
            failed = ", ".join(f"{n} {name}" for name, n in sorted(s.failures.items())) or "0"
            rate = f"{s.solves / s.seconds:.0f}" if s.seconds > 0 else "-"
            accepted = f"{s.accepted / s.steps:.0%}" if s.steps else "-"
            row = (s.chain, s.phase, s.steps, s.kept, accepted, s.solves, rate, failed)
            table.add_row(*(str(item) for item in row))
        return table


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"


def bar(wanted: bool) -> Any:
    """A progress bar on standard error with counts and the time that remains, for many tasks of one kind."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not wanted,
    )
