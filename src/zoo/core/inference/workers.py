"""Independent tasks in processes, or on any executor, that outlive the death of a worker."""

from __future__ import annotations

import contextlib
import multiprocessing as mp
import os
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from typing import NoReturn, TypeVar

from zoo.core.words import OneLineError

J = TypeVar("J")
R = TypeVar("R")
_SAFE_PATH = "PYTHONSAFEPATH"
TRIES = 3
"""How often a task is run whose worker dies."""
_turn = threading.RLock()


class LostTaskError(OneLineError, RuntimeError):
    """A task whose worker died each time that it was run, or whose executor is gone; the text names it."""


def each(
    work: Callable[[J], R],
    jobs: Sequence[J],
    cores: int = 1,
    *,
    executor: Executor | None = None,
    name: Callable[[J], str] = str,
) -> Iterator[tuple[J, R]]:
    """Jobs and what they gave, as they finish.

    The tasks of one process take turns, with one thread for linear algebra each: the same digits come out
    wherever they run. A task whose worker dies is run again, at most `TRIES` times in all.

    Parameters
    ----------
    work : callable
        Of a job; importable by name, like the jobs' and results' types.
    jobs : sequence
        Specifications: what a worker needs to make its result, and nothing that is compiled.
    cores : int
        Processes of a pool of our own; with 1 the jobs are done in this process, in their order.
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
    if executor is not None:
        yield from _on_executor(work, jobs, executor, name)
    elif cores == 1:
        for job in jobs:
            yield job, _in_turn(work, job)
    else:
        yield from _in_pools(work, jobs, cores, name)


def _in_turn(work: Callable[[J], R], job: J) -> R:
    """The work of a job. PyTensor's compilation and the filters of warnings are not safe in threads."""
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with _turn, threadpool_limits(1):
        return work(job)


def _in_pools(
    work: Callable[[J], R], jobs: Sequence[J], cores: int, name: Callable[[J], str]
) -> Iterator[tuple[J, R]]:
    """In processes of our own; those that a death interrupts run alone next, so that who dies is known."""
    waiting, suspects, died = deque(range(len(jobs))), deque[int](), Counter[int]()
    while waiting or suspects:
        alone = bool(suspects)
        queue = deque([suspects.popleft()]) if alone else waiting
        with _pool(1 if alone else min(cores, len(queue))) as (pool, width):
            running: dict[Future[R], int] = {}
            broken = False
            while running or (queue and not broken):
                while queue and len(running) < width and not broken:
                    i = queue.popleft()
                    try:
                        running[pool.submit(_in_turn, work, jobs[i])] = i
                    except BrokenExecutor:
                        queue.appendleft(i)
                        broken = True
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    i = running.pop(future)
                    try:
                        result = future.result()
                    except BrokenExecutor:
                        broken = True
                        died[i] += 1
                        if died[i] == TRIES:
                            _lost(name(jobs[i]), f"its process died {TRIES} times")
                        suspects.append(i)
                        continue
                    yield jobs[i], result
            if alone and queue:  # the pool was broken before it took the task
                suspects.extend(queue)


def _on_executor(
    work: Callable[[J], R], jobs: Sequence[J], executor: Executor, name: Callable[[J], str]
) -> Iterator[tuple[J, R]]:
    """On somebody's executor, which starts its own workers anew; what it gives up is given to it again."""
    died = Counter[int]()
    running: dict[Future[R], int] = {}

    def start(i: int) -> None:
        try:
            running[executor.submit(_in_turn, work, jobs[i])] = i
        except BrokenExecutor:
            _lost(name(jobs[i]), "the executor is broken")

    try:
        for i in range(len(jobs)):
            start(i)
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                i = running.pop(future)
                try:
                    result = future.result()
                except (CancelledError, BrokenExecutor) as error:
                    _lost(name(jobs[i]), f"the executor ended before it ({type(error).__name__})")
                except Exception as error:
                    if not _worker_died(error):
                        raise
                    died[i] += 1
                    if died[i] == TRIES:
                        _lost(
                            name(jobs[i]), f"the scheduler gave it up {TRIES} times, since its workers died"
                        )
                    start(i)
                    continue
                yield jobs[i], result
    finally:
        for future in running:
            future.cancel()


def _worker_died(error: Exception) -> bool:
    """Whether dask.distributed gave a task up because the workers that had it died."""
    return type(error).__name__ == "KilledWorker" and type(error).__module__.startswith("distributed.")


def _lost(task: str, why: str) -> NoReturn:
    raise LostTaskError(f"{task}: {why}; what is finished is kept, the same command goes on with the rest")


@contextlib.contextmanager
def _pool(width: int) -> Iterator[tuple[ProcessPoolExecutor, int]]:
    with _safe_path():  # the pool starts its processes with its first tasks, and a helper before
        pool = ProcessPoolExecutor(width, mp_context=mp.get_context("spawn"), initializer=_begin)
        try:
            yield pool, width
        finally:
            pool.shutdown(cancel_futures=True)


@contextlib.contextmanager
def _safe_path() -> Iterator[None]:
    """Processes that start meanwhile do not search the working folder for modules, only the parent's path."""
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_SAFE_PATH]
        else:
            os.environ[_SAFE_PATH] = before


def _begin() -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A pool's process waits for its next job for ever when its parent is killed."""
    parent = mp.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def shard_of(jobs: Sequence[J], shard: tuple[int, int] | None) -> list[J]:
    """Part i of n of the jobs, i from 1: every n-th, so that the n parts are disjoint and complete.

    Parameters
    ----------
    jobs : sequence
    shard : (i, n), optional
        All of them without.

    Raises
    ------
    ValueError
        If i is not between 1 and n.

    Examples
    --------
    >>> [shard_of("abcde", (i, 2)) for i in (1, 2)]
    [['a', 'c', 'e'], ['b', 'd']]
    """
    if shard is None:
        return list(jobs)
    part, parts = shard
    if not 1 <= part <= parts:
        raise ValueError(f"shard {part}/{parts}: must be i/n with i from 1 to n")
    return list(jobs[part - 1 :: parts])
