"""Independent jobs in processes of one thread each, which end with the process that started them."""

from __future__ import annotations

import contextlib
import multiprocessing as mp
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, TypeVar

J = TypeVar("J")
R = TypeVar("R")
_SAFE_PATH = "PYTHONSAFEPATH"


def each(
    work: Callable[[J], R],
    jobs: Sequence[J],
    cores: int,
    *,
    prepare: Callable[..., None] | None = None,
    arguments: tuple[Any, ...] = (),
) -> Iterator[tuple[J, R]]:
    """Jobs and what they gave, as they finish.

    Parameters
    ----------
    work : callable
        Of a job; importable by name, like the jobs' and results' types.
    jobs : sequence
    cores : int
        Processes; with 1 the jobs are done in this one, in their order.
    prepare : callable, optional
        Called with `arguments` once in each process before its first job.
    arguments : tuple

    Yields
    ------
    job, result

    Raises
    ------
    concurrent.futures.process.BrokenProcessPool
        If a process is killed.
    """
    if not jobs:
        return
    if cores == 1:
        from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

        with threadpool_limits(1):
            if prepare is not None:
                prepare(*arguments)
            for job in jobs:
                yield job, work(job)
        return
    with contextlib.ExitStack() as opened:
        with _safe_path():  # the pool starts its processes with the first jobs, and a helper before
            pool = ProcessPoolExecutor(
                min(cores, len(jobs)),
                mp_context=mp.get_context("spawn"),
                initializer=_begin,
                initargs=(prepare, arguments),
            )
            opened.callback(pool.shutdown, cancel_futures=True)
            futures = {pool.submit(work, job): job for job in jobs}
        for future in as_completed(futures):
            yield futures[future], future.result()


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


def _begin(prepare: Callable[..., None] | None, arguments: tuple[Any, ...]) -> None:
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare(*arguments)


def _end_with_parent() -> None:
    """A pool's process waits for its next job for ever when its parent is killed."""
    parent = mp.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
