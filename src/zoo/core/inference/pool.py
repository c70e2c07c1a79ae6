"""All chains of a run as their parent sees them: in processes of their own, or in turns in this one."""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Iterator, Sequence
from typing import Any

import cloudpickle  # type: ignore[import-untyped]
import numpy as np

from zoo.core.inference.chain import Chain, Task
from zoo.core.inference.logposterior import SamplingError
from zoo.core.inference.processes import Worker
from zoo.core.inference.progress import ChainState, Display


class ChainPool:
    """All chains of a run, as their parent sees them."""

    def __init__(self, tasks: Sequence[Task], show: Display) -> None:
        self.tasks = list(tasks)
        self.show = show
        self.states = [ChainState(task.chain) for task in tasks]

    def advance(self, until: int) -> None:
        """Bring every chain to `until` stored draws."""
        raise NotImplementedError

    def close(self) -> None:
        """End all work; each chain writes its checkpoint first."""
        raise NotImplementedError

    def draws(self, kept: int) -> dict[str, np.ndarray]:
        """First `kept` draws, name -> (n_chains, kept, ...)."""
        each = [state.values(kept) for state in self.states]
        return {name: np.stack([values[name] for values in each]) for name in each[0]}

    def stats(self, kept: int) -> dict[str, np.ndarray]:
        """Statistics of the first `kept` draws, name -> (n_chains, kept)."""
        each = [state.values(kept, stats=True) for state in self.states]
        return {name: np.stack([values[name] for values in each]) for name in each[0]}


class ProcessChainPool(ChainPool):
    """Runs the chains' processes, `cores` at a time, and collects their draws."""

    def __init__(self, tasks: Sequence[Task], cores: int, show: Display) -> None:
        super().__init__(tasks, show)
        self.cores = cores
        self.inbox: queue.Queue[Any] = queue.Queue()
        self.workers: dict[int, Worker] = {}
        self.slice = None if cores >= len(self.tasks) else 5.0

    def advance(self, until: int) -> None:
        """Bring every chain to `until` stored draws."""
        waiting = [s.chain for s in self.states if s.kept < until or s.chain not in self.workers]
        running: set[int] = set()
        while waiting or running:
            while waiting and len(running) < self.cores:
                chain = min(waiting, key=lambda c: (self.states[c].steps, c))
                waiting.remove(chain)
                running.add(chain)
                if chain in self.workers:
                    self.workers[chain].run(until, self.slice)
                else:
                    self.states[chain].phase = "compiling"
                    self.workers[chain] = Worker(chain, cloudpickle.dumps(self.tasks[chain]), self.inbox)
            for chain, kind, content in self._messages():
                state = self.states[chain]
                if kind in ("ready", "running", "paused"):
                    state.update(content)
                    state.phase = "tuning" if state.tuning else "sampling"
                if kind == "ready":
                    self.workers[chain].run(until, self.slice)
                elif kind == "paused":
                    running.discard(chain)
                    if state.kept < until:
                        waiting.append(chain)
                        state.phase = "waiting"
                    else:
                        state.phase = "at target"
                elif kind == "failed":
                    error = SamplingError(f"chain {chain}: {content[0]}")
                    error.add_note(content[1])
                    raise error
                elif kind == "ended":
                    self._raise_ended(chain)
            self.show.update(self.states, until)

    def _messages(self) -> Iterator[tuple[int, str, Any]]:
        with contextlib.suppress(queue.Empty):
            yield self.inbox.get(timeout=0.25)
            while True:
                yield self.inbox.get_nowait()

    def _raise_ended(self, chain: int) -> None:
        worker = self.workers[chain]
        code = worker.process.wait()
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        words = worker.last_words()
        resume = (
            "run again with the same checkpoint folder to resume"
            if self.tasks[chain].checkpoint
            else "pass checkpoint=folder to be able to resume"
        )
        raise SamplingError(
            f"chain {chain}: its process ended unexpectedly ({how}{'; ' + words if words else ''}); {resume}"
        )

    def close(self) -> None:
        """End all processes; each writes its checkpoint first."""
        for worker in self.workers.values():
            worker.close()
        for worker in self.workers.values():
            worker.wait(60.0)


class InlineChainPool(ChainPool):
    """Runs the chains in this process, taking turns: no process to start, compiled functions shared."""

    turn = 2.0  # s

    def __init__(self, tasks: Sequence[Task], show: Display) -> None:
        super().__init__(tasks, show)
        self.chains: list[Chain] = []
        self._sent = [0] * len(self.tasks)

    def advance(self, until: int) -> None:
        """Bring every chain to `until` stored draws."""
        self.chains += [Chain(task) for task in self.tasks[len(self.chains) :]]
        while behind := [i for i, chain in enumerate(self.chains) if chain.kept < until]:
            for i in behind:
                self.chains[i].run(until, self.turn)
                self._update(i)
            self.show.update(self.states, until)
        for i in range(len(self.chains)):  # chains that a checkpoint had brought further
            self._update(i)

    def _update(self, i: int) -> None:
        state, chain = self.states[i], self.chains[i]
        state.update(chain.since(self._sent[i]))
        self._sent[i] = chain.kept
        state.phase = "tuning" if state.tuning else "sampling"

    def close(self) -> None:
        """Write the checkpoints."""
        for chain in self.chains:
            chain.save()
