"""Workers of a dask.distributed scheduler, as an executor."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any

from zoo.core.words import OneLineError

PATIENCE_S = 20
MOST_WAITING = 64
"""Tasks of a cluster whose results are waited for at once."""


class SchedulerError(OneLineError, RuntimeError):
    """A scheduler that cannot be used; its text says what to install or to change."""


@contextlib.contextmanager
def connect(address: str | None) -> Iterator[Executor | None]:
    """The workers of a scheduler, to be given as `executor`; None without an address.

    What travels are names of functions and specifications, and what comes back are results; dask pickles
    both on their way, so that scheduler and workers have to be trusted as this process is.

    Parameters
    ----------
    address : str, optional
        Such as tcp://host:8786, or tls://host:8786 with dask's own settings.

    Raises
    ------
    SchedulerError
        If dask.distributed is missing, nobody answers at the address, or no worker comes in `PATIENCE_S`.
    """
    if address is None:
        yield None
        return
    client = _client(address)
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError:
            raise SchedulerError(
                f"{address}: the scheduler has no worker; start some: dask worker {address} --nthreads 1"
            ) from None
        workers = _Workers(client)
        try:
            yield workers
        finally:
            workers.shutdown(wait=False, cancel_futures=True)


class _Workers(Executor):
    """A client whose tasks are gathered by threads, so that a value lost with its worker is made again.

    The client's own executor turns such a loss into an unrelated error if it looks at the wrong moment.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._threads = ThreadPoolExecutor(MOST_WAITING)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        task = self._client.submit(fn, *args, pure=False, **kwargs)
        return self._threads.submit(task.result)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._threads.shutdown(wait=wait, cancel_futures=cancel_futures)


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise SchedulerError(
            f"{address}: needs the package distributed; install it with: pip install 'pymc-zoo[cluster]'"
        ) from None
    try:
        return Client(address, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        text = " ".join(str(error).split())[:200]
        raise SchedulerError(
            f"{address}: no scheduler answers ({text}); start one with `dask scheduler`, or give its address"
        ) from None
