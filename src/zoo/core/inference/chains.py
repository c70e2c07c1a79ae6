"""Chains in processes of their own, which write checkpoints and go on from them with the same draws."""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import cloudpickle  # type: ignore[import-untyped]
import numpy as np
from pymc.blocking import DictToArrayBijection, RaveledVars
from pymc.pytensorf import floatX

from zoo.core.inference.mode import SamplingError, outputs
from zoo.core.inference.progress import ChainState, Display
from zoo.core.inference.steps import Array, DEMetropolisZ, Gaussian, Metropolis, Point, count, counting_ops


class CheckpointError(SamplingError):
    """A checkpoint folder belongs to another run, is in use, or cannot be read."""


@dataclass(frozen=True)
class Task:
    """Everything a chain needs, sent to its process."""

    model: Any
    chain: int
    seed: int
    start: Array
    reference: Gaussian
    archive: Array
    step: str
    options: dict[str, Any]
    tune: int
    thin: int
    checkpoint: Path | None
    checkpoint_seconds: float


_SUMS = ("accept", "accepted", "solves", "solver_failures")
_LASTS = {"model_logp": "lp", "scaling": "scaling", "lambda": "lambda", "beta": "beta"}


class Chain:
    """One chain: its step method, its draws so far, and its checkpoint.

    A stored draw stands for `thin` steps: values and log-posterior are those after the last of them, solves
    and failures are sums over them, accept and accepted are means.
    """

    def __init__(self, task: Task) -> None:
        self.task = task
        model = task.model
        posterior = model.initial_point()
        self.step = _make_step(task, posterior)
        template = DictToArrayBijection.map({v.name: np.asarray(posterior[v.name]) for v in self.step.vars})
        self.point: Point = dict(
            DictToArrayBijection.rmap(RaveledVars(floatX(task.start), template.point_map_info))
        )
        names = [v.name for v in model.unobserved_value_vars]
        wanted = [v.name for v in (*model.free_RVs, *model.deterministics)]
        self.names, self._values = outputs(model, [name for name in names if name in set(wanted)])
        self._ops = counting_ops(self.step._logp)
        self._each_accepted = bool(counting_ops(self._values.f))  # while the solve is still remembered
        self._current: list[np.ndarray] | None = None
        self.steps = 0
        self.draws: dict[str, list[np.ndarray]] = {name: [] for name in self.names}
        self.stats: dict[str, list[float]] = {}
        self._sums = dict.fromkeys(_SUMS, 0.0)
        self.solves = 0
        self.accepted = 0.0
        self.failures: Counter[str] = Counter()
        self.seconds = 0.0
        self._saved_at = time.monotonic()
        step_seed = np.random.SeedSequence(task.seed, spawn_key=(task.chain, 1))
        self.step.set_rng(np.random.default_rng(step_seed))
        self.step.tune = task.tune > 0
        if task.tune == 0:
            self.step.stop_tuning()
        if task.checkpoint is not None and task.checkpoint.exists():
            self._restore(task.checkpoint)

    @property
    def kept(self) -> int:
        """Stored draws so far."""
        return len(self.draws[self.names[0]])

    @property
    def tuning(self) -> bool:
        """Whether the tuning phase is still on."""
        return self.steps < self.task.tune

    def run(
        self,
        until: int,
        seconds: float | None,
        tick: Callable[[], None] = lambda: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Step until `until` draws are stored, `seconds` have passed or `stop` says so.

        How the steps are cut into calls has no influence on the draws.
        """
        began = time.monotonic()
        while self.kept < until and not stop():
            before = time.monotonic()
            self._one()
            now = time.monotonic()
            self.seconds += now - before
            tick()
            if self.task.checkpoint is not None and now - self._saved_at >= self.task.checkpoint_seconds:
                self.save()
            if seconds is not None and now - began >= seconds:
                break

    def _one(self) -> None:
        before, failed_before = count(self._ops)
        if self.task.tune and self.steps == self.task.tune:
            self.step.stop_tuning()
        self.point, [stats] = self.step.step(self.point)
        self.steps += 1
        if not self._ops:
            stats["solves"] = 1  # nothing counts: each step evaluates the log-posterior once
        accepted = float(stats["accepted"])
        if self._each_accepted and (accepted or self._current is None):
            self._current = self._values(self.point)
        after, failed_after = count(self._ops)
        self.solves += after - before if self._ops else 1
        self.failures.update(failed_after - failed_before)
        self.accepted += accepted
        if self.steps <= self.task.tune:
            return
        accept = float(stats["accept"])
        self._sums["accept"] += min(1.0, accept) if accept > 0 else 0.0
        self._sums["accepted"] += accepted
        self._sums["solves"] += float(stats["solves"])
        self._sums["solver_failures"] += float(stats["solver_failures"])
        if (self.steps - self.task.tune) % self.task.thin == 0:
            self._keep(stats)

    def _keep(self, stats: Mapping[str, Any]) -> None:
        values = self._current if self._current is not None else self._values(self.point)
        for name, value in zip(self.names, values, strict=True):
            self.draws[name].append(np.array(value))
        for name in _SUMS:
            total = self._sums[name]
            mean = name in ("accept", "accepted")
            self.stats.setdefault(name, []).append(total / self.task.thin if mean else total)
        for source, name in _LASTS.items():
            if source in stats:
                self.stats.setdefault(name, []).append(float(stats[source]))
        self._sums = dict.fromkeys(_SUMS, 0.0)

    def since(self, first: int) -> dict[str, Any]:
        """Progress, and the draws from number `first` on, as one message to the parent."""
        return {
            "chain": self.task.chain,
            "steps": self.steps,
            "kept": self.kept,
            "tuning": self.tuning,
            "seconds": self.seconds,
            "solves": self.solves,
            "accepted": self.accepted,
            "failures": dict(self.failures),
            "draws": {name: np.array(rows[first:]) for name, rows in self.draws.items()},
            "stats": {name: np.array(rows[first:]) for name, rows in self.stats.items()},
        }

    def save(self) -> None:
        """Write the checkpoint; a kill at any moment leaves the old one or the new one."""
        path = self.task.checkpoint
        if path is None:
            return
        content = {
            "steps": self.steps,
            "point": self.point,
            "sampling_state": self.step.sampling_state,
            "draws": {name: np.array(rows) for name, rows in self.draws.items()},
            "stats": {name: np.array(rows) for name, rows in self.stats.items()},
            "sums": self._sums,
            "current": self._current,
            "solves": self.solves,
            "accepted": self.accepted,
            "failures": self.failures,
            "seconds": self.seconds,
        }
        began = time.monotonic()
        write(path, pickle.dumps(content, protocol=5))
        took = time.monotonic() - began
        self._saved_at = time.monotonic() + 20 * took  # never more than a twentieth of the time

    def _restore(self, path: Path) -> None:
        content = unpickle(path)
        self.steps = content["steps"]
        self.point = content["point"]
        self.step.sampling_state = content["sampling_state"]
        self.draws = {name: list(rows) for name, rows in content["draws"].items()}
        self.stats = {name: list(rows) for name, rows in content["stats"].items()}
        self._sums = content["sums"]
        self._current = content["current"]
        self.solves = content["solves"]
        self.accepted = content["accepted"]
        self.failures = content["failures"]
        self.seconds = content["seconds"]


def _make_step(task: Task, point: Point) -> Any:
    kwargs: dict[str, Any] = {"model": task.model, "initial_point": point, "reference": task.reference}
    if task.step == "demetropolisz":
        return DEMetropolisZ(archive=task.archive, **kwargs, **task.options)
    return Metropolis(vars=list(task.model.continuous_value_vars), **kwargs, **task.options)


def write(path: Path, content: bytes) -> None:
    """Replace a file in one go."""
    temporary = path.with_name(path.name + f".{os.getpid()}.part")
    with open(temporary, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def unpickle(path: Path) -> Any:
    try:
        return pickle.loads(path.read_bytes())
    except (pickle.UnpicklingError, EOFError, AttributeError, ImportError, IndexError) as error:
        raise CheckpointError(
            f"{path}: cannot be read ({type(error).__name__}: {error}); remove the folder to start afresh"
        ) from None


_ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "NUMEXPR_NUM_THREADS",
    ),
    "1",
)
# Not multiprocessing: its spawn and forkserver import the caller's script again, which a script that samples
# without `if __name__ == "__main__"` does not survive.
_BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from zoo.core.inference.chains import worker_main; worker_main()"
)


def worker_main() -> None:
    """Main function of a chain's process: task and commands come on stdin, progress goes out on stdout."""
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interrupt means
    source = os.fdopen(os.dup(0), "rb")
    sink = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever prints must not mix with the messages
    status = 0
    try:
        _serve(source, sink)
    except (BrokenPipeError, EOFError):
        status = 1  # the parent is gone, and the checkpoint is written
    finally:
        sys.stderr.flush()
        os._exit(status)  # the reading thread may be blocked: no orderly shutdown


def _serve(source: IO[bytes], sink: IO[bytes]) -> None:
    def send(kind: str, content: Any) -> None:
        pickle.dump((kind, content), sink, protocol=5)
        sink.flush()

    commands: queue.Queue[tuple[int, float | None] | None] = queue.Queue()
    stop = threading.Event()

    def read() -> None:
        with contextlib.suppress(EOFError, OSError, pickle.UnpicklingError):
            while True:
                commands.put(pickle.load(source))
        stop.set()  # the parent closed the pipe, or died
        commands.put(None)

    chain: Chain | None = None
    try:
        task = pickle.load(source)
        threading.Thread(target=read, daemon=True).start()
        chain = Chain(task)
        sent = 0
        told = 0.0

        def tick() -> None:
            nonlocal sent, told
            now = time.monotonic()
            if now - told >= 1.0:
                report("running")
                told = now

        def report(kind: str) -> None:
            nonlocal sent
            content = chain.since(sent)
            sent = chain.kept
            send(kind, content)

        report("ready")
        while (command := commands.get()) is not None:
            chain.run(*command, tick, stop.is_set)
            if not stop.is_set():
                report("paused")
        chain.save()
        send("stopped", None)
    except BrokenPipeError:
        if chain is not None:
            chain.save()
        raise
    except Exception as error:
        text = traceback.format_exc()
        with contextlib.suppress(BrokenPipeError):
            send("failed", (f"{type(error).__name__}: {error}", text))


class Worker:
    """Parent's side of a chain's process."""

    def __init__(self, chain: int, payload: bytes, inbox: queue.Queue[Any]) -> None:
        self.chain = chain
        self.inbox = inbox
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115 (closed by wait)
        self.process = subprocess.Popen(
            [sys.executable, "-c", _BOOT, json.dumps(sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            env={**os.environ, **_ONE_THREAD},
        )
        threading.Thread(target=self._read, args=(payload,), daemon=True).start()

    def _send(self, message: bytes) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # its end is reported by the reading thread
            self.process.stdin.write(message)
            self.process.stdin.flush()

    def _read(self, payload: bytes) -> None:
        assert self.process.stdout is not None
        self._send(payload)  # here, because it takes until the process has imported PyMC
        try:
            while True:
                kind, content = pickle.load(self.process.stdout)
                self.inbox.put((self.chain, kind, content))
        except (EOFError, pickle.UnpicklingError, OSError, ValueError):
            self.inbox.put((self.chain, "ended", None))

    def run(self, until: int, seconds: float | None) -> None:
        """Ask for more draws."""
        self._send(pickle.dumps((until, seconds)))

    def close(self) -> None:
        """Ask the process to write its checkpoint and end."""
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError, OSError):
            self.process.stdin.close()

    def wait(self, seconds: float) -> None:
        """Wait for the end; kill after that."""
        try:
            self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.errors.close()

    def last_words(self) -> str:
        """Last line that the process wrote to its standard error."""
        self.errors.seek(0)
        lines = self.errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""


class Fleet:
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


class Chains(Fleet):
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


class InlineChains(Fleet):
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
