"""All chains of a run as their parent sees them, each at work on an executor."""

from __future__ import annotations

import uuid
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from pathlib import Path
from types import TracebackType
from typing import Any

import cloudpickle  # type: ignore[import-untyped]
import numpy as np

from zoo.core.inference.chain import Order, Report, Task, forget, run_chain
from zoo.core.inference.logposterior import SamplingError
from zoo.core.inference.memo import Memo
from zoo.core.inference.progress import ChainState, Display, of_chains
from zoo.core.inference.workers import Inline, LostTaskError, Processes, as_finished, in_turn

SLICE_S = 1.0
"""How long a chain is at work before it tells how far it is, where that costs nothing."""


class Chains:
    """Chains that are brought on together: in processes of our own, in this one, or on somebody's executor.

    Each goes on where its worker has it. A worker that has not (the one before died, or an executor chose
    another) makes the chain's steps again with what its memo knows, and goes on then. In processes of our own
    and in this one that is by slices of `SLICE_S`; on somebody's executor it is in one go.

    Parameters
    ----------
    tasks : sequence of Task
    cores : int
        Processes; 0 for this one.
    show : Display
    executor : Executor, optional
        Used instead; `cores` is not read.
    files : callable, optional
        Path of each chain's memo.
    run : str
        What the memos belong to.
    """

    def __init__(
        self,
        tasks: Sequence[Task],
        cores: int,
        show: Display,
        executor: Executor | None = None,
        files: Callable[[int], Path] | None = None,
        run: str = "",
    ) -> None:
        self.show = show
        self.states = [ChainState(task.chain) for task in tasks]
        self._tune, self._thin = tasks[0].tune, tasks[0].thin
        self._token = uuid.uuid4().hex
        self._slice = SLICE_S if executor is None else None
        self._own = [Processes(1) for _ in range(min(cores, len(tasks)))] if executor is None else []
        self._on: Sequence[Executor] = [executor] if executor is not None else self._own or [Inline()]
        here = executor is None and not cores
        self._tasks: bytes | Sequence[Task] = tasks if here else cloudpickle.dumps(tasks)
        self._memos: list[Memo] = []
        self._unknown = set(range(len(tasks)))
        try:
            for k in range(len(tasks)):
                self._memos.append(Memo(None if files is None else files(k), f"{run}, chain {k}"))
                self._memos[k].known.clear()  # the workers have use for it
        except BaseException:
            self.close()
            raise

    def advance(self, until: int) -> None:
        """Bring every chain to `until` stored draws.

        Raises
        ------
        SamplingError
            If a chain fails, or its worker dies as often as it may.
        """
        waiting = deque(state.chain for state in self.states if state.kept < until)
        found = as_finished(lambda k: self._hand_in(k, until), waiting, lambda k: f"chain {k}")
        try:
            for k, report in found:
                if report is None:
                    self._unknown.add(k)
                else:
                    self._memos[k].add(report.lines)
                    self.states[k].update(report)
                if self.states[k].kept < until:
                    waiting.append(k)
                self._show(until)
        except LostTaskError as error:
            raise SamplingError(str(error)) from None

    def _show(self, until: int) -> None:
        steps = sum(state.steps for state in self.states)
        all_of_them = len(self.states) * (self._tune + self._thin * until)
        self.show(of_chains(self.states, until), min(1.0, steps / all_of_them))

    def _hand_in(self, k: int, until: int) -> Future[Report | None]:
        state, memo = self.states[k], self._memos[k]
        order: dict[str, Any] = {"until": until, "seconds": self._slice}
        if k in self._unknown:
            order |= {"owner": memo.owner, "tasks": self._tasks, "lines": bytes(memo.lines)}
            self._unknown.discard(k)
        on = self._on[k % len(self._on)]
        return on.submit(in_turn, run_chain, Order(self._token, k, state.steps, state.kept, **order))

    def draws(self, kept: int) -> dict[str, np.ndarray]:
        """First `kept` draws, name -> (n_chains, kept, ...)."""
        return _stacked([state.values(kept) for state in self.states])

    def stats(self, kept: int) -> dict[str, np.ndarray]:
        """Statistics of the first `kept` draws, name -> (n_chains, kept)."""
        return _stacked([state.values(kept, stats=True) for state in self.states])

    def close(self) -> None:
        """End all work at once; what the chains told until then is in their memos."""
        for process in self._own:
            process.shutdown()
        forget(self._token)
        for memo in self._memos:
            memo.close()

    def __enter__(self) -> Chains:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: Any, trace: TracebackType | None) -> None:
        self.close()


def _stacked(each: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.stack([values[name] for values in each]) for name in each[0]}
