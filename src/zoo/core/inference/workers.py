"""Independent tasks on executors: processes of our own, whose deaths tasks outlive, or anybody's."""

from __future__ import annotations

import contextlib
import multiprocessing as mp
import os
import pickle
import queue
import signal
import sys
import threading
import traceback
import types
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from multiprocessing.connection import Connection
from typing import Any, NoReturn, TypeVar

import cloudpickle  # type: ignore[import-untyped]

from zoo.core.words import OneLineError

J = TypeVar("J")
R = TypeVar("R")
TRIES = 3
"""How often a task is run whose worker dies."""
_turn = threading.RLock()
_starting = threading.Lock()
_SAFE_PATH = "PYTHONSAFEPATH"


class LostTaskError(OneLineError, RuntimeError):
    """A task whose worker died each time that it was run, or whose executor is gone; the text names it."""


def each(
    work: Callable[[J], R],
    jobs: Sequence[J],
    cores: int = 1,
    *,
    executor: Executor | None = None,
    name: Callable[[J], str] = str,
) -> Generator[tuple[J, R], None, None]:
    """Jobs and what they gave, as they finish; to be closed where what is done with them may fail.

    The tasks of one process take turns, with one thread for linear algebra each: the same digits come out
    wherever they run. A task whose worker dies is run again, at most `TRIES` times in all.

    Parameters
    ----------
    work : callable
        Of a job; importable by name, like the jobs' and results' types.
    jobs : sequence
        Specifications: what a worker needs to make its result, and nothing that is compiled.
    cores : int
        Processes of our own; with 1 the jobs are done in this process, in their order.
    executor : concurrent.futures.Executor, optional
        Runs the tasks instead, and is left open: threads, processes, or ``Client.get_executor()`` of
        dask.distributed (`zoo.core.inference.cluster.connect`). `cores` is not read.
    name : callable
        Names a job in an error.

    Yields
    ------
    job, result

    Raises
    ------
    LostTaskError
        If the worker of a task dies as often as it may, or the executor ends before the task.
    """
    if executor is None and cores == 1:
        for job in jobs:
            yield job, in_turn(work, job)
        return
    with contextlib.ExitStack() as stack:
        if executor is None:
            executor = stack.enter_context(Processes(min(cores, max(1, len(jobs)))))
        on = executor
        waiting = deque(range(len(jobs)))
        for i, result in as_finished(
            lambda i: on.submit(in_turn, work, jobs[i]), waiting, lambda i: name(jobs[i])
        ):
            yield jobs[i], result


def in_turn(work: Callable[[J], R], job: J) -> R:
    """The work of a job. PyTensor's compilation and the filters of warnings are not safe in threads."""
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with _turn, threadpool_limits(1):
        return work(job)


def as_finished(
    start: Callable[[J], Future[R]], waiting: deque[J], name: Callable[[J], str]
) -> Iterator[tuple[J, R]]:
    """Tasks and their results as they finish; those that an executor gives up are started again.

    Parameters
    ----------
    start : callable
        Hands a task in.
    waiting : deque
        Tasks to hand in; it is emptied, and more may be put in meanwhile.
    name : callable
        Names a task in an error.

    Raises
    ------
    LostTaskError
        As of `each`.
    """
    died = Counter[J]()
    running: dict[Future[R], J] = {}
    try:
        while waiting or running:
            while waiting:
                task = waiting.popleft()
                try:
                    running[start(task)] = task
                except BrokenExecutor:
                    _lost(name(task), "the executor is broken")
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                task = running.pop(future)
                try:
                    result = future.result()
                except (CancelledError, BrokenExecutor) as error:
                    _lost(name(task), f"the executor ended before it ({type(error).__name__})")
                except _DiedError:
                    _lost(name(task), f"its process died {TRIES} times")
                except Exception as error:
                    if not _given_up(error):
                        raise
                    died[task] += 1
                    if died[task] == TRIES:
                        _lost(name(task), f"the scheduler gave it up {TRIES} times, since its workers died")
                    waiting.append(task)
                else:
                    yield task, result
    finally:
        for future in running:
            future.cancel()


def _given_up(error: Exception) -> bool:
    """Whether dask.distributed gave a task up because the workers that had it died."""
    return type(error).__name__ == "KilledWorker" and type(error).__module__.startswith("distributed.")


def _lost(task: str, why: str) -> NoReturn:
    raise LostTaskError(f"{task}: {why}; what is finished is kept, the same command goes on with the rest")


class Inline(Executor):
    """Runs each task in this process as soon as it is handed in."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """The result is there when this returns; an interrupt is not caught."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class _DiedError(Exception):
    """A task's process died each time."""


class Processes(Executor):
    """Processes of our own; one that dies is replaced, and its task is run again.

    They end at once when the `with` block does, whatever they are at, and when this process dies.

    Parameters
    ----------
    n : int
        Processes; they start with the first tasks.
    """

    def __init__(self, n: int) -> None:
        self._threads = ThreadPoolExecutor(n)
        self._all = [_Process() for _ in range(n)]
        self._free: queue.SimpleQueue[_Process] = queue.SimpleQueue()
        for process in self._all:
            self._free.put(process)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Hand a task in; its function may be one of the caller's script."""
        return self._threads.submit(self._run, cloudpickle.dumps((fn, args, kwargs)))

    def _run(self, task: bytes) -> Any:
        process = self._free.get()
        try:
            return process.run(task)
        finally:
            self._free.put(process)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End the processes, whatever they are at."""
        for process in self._all:
            process.end()
        self._threads.shutdown(wait=wait, cancel_futures=True)


class _Process:
    """A process that does one task after the other."""

    def __init__(self) -> None:
        self._process: Any = None
        self._pipe: Any = None
        self._ended = False

    def run(self, task: bytes) -> Any:
        """The result of a task; it is run again if the process dies."""
        for _ in range(TRIES):
            self._start()
            try:
                self._pipe.send_bytes(task)
                done, found = self._pipe.recv()
            except (EOFError, OSError):
                if self._ended:
                    raise CancelledError from None
                self._stop()
                continue
            if done:
                return found
            raise found
        raise _DiedError

    def _start(self) -> None:
        with _starting:
            if self._ended:
                raise CancelledError
            if self._process is None:
                context = mp.get_context("spawn")
                ours, theirs = context.Pipe()
                process = context.Process(target=_serve, args=(theirs,))
                with _as_for_workers():
                    process.start()
                theirs.close()
                self._process, self._pipe = process, ours

    def _stop(self) -> None:
        with _starting:
            if self._process is not None:
                self._process.kill()
                self._process.join()
                self._pipe.close()
                self._process = None

    def end(self) -> None:
        """Kill the process, which no further task starts again."""
        with _starting:
            self._ended = True
            if self._process is not None:
                self._process.kill()
                self._process.join()


@contextlib.contextmanager
def _as_for_workers() -> Iterator[None]:
    """Processes that start meanwhile do not search the working folder for modules, nor run the script again.

    A json.py beside the data would be run, and a script without a guard for ``__main__`` would not survive.
    """
    before = os.environ.get(_SAFE_PATH)
    script = sys.modules["__main__"]
    os.environ[_SAFE_PATH] = "1"
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script
        if before is None:
            del os.environ[_SAFE_PATH]
        else:
            os.environ[_SAFE_PATH] = before


def _serve(pipe: Connection) -> None:
    """Main function of a process: tasks come through the pipe, and results go back."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interrupt means
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.dup2(2, 1)  # whatever prints must not mix with what a command prints
    while True:
        try:
            task = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        answer: tuple[bool, Any]
        try:
            work, args, kwargs = cloudpickle.loads(task)
            answer = True, work(*args, **kwargs)
        except Exception as error:
            error.add_note(traceback.format_exc())
            answer = False, error
        try:
            message = pickle.dumps(answer)
            pickle.loads(message)
        except Exception as error:
            message = pickle.dumps((False, RuntimeError(f"{answer[1]!s:.500} cannot be sent: {error}")))
        try:
            pipe.send_bytes(message)
        except OSError:  # nobody waits for it: the parent was killed meanwhile
            return


def _end_with_parent() -> None:
    """A process that is at work does not see that its parent was killed."""
    parent = mp.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
