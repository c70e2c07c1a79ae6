"""Workers of a dask.distributed scheduler, as an executor."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from concurrent.futures import Executor
from typing import Any

from zoo.core.words import OneLineError

PATIENCE_S = 20


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
        If dask.distributed is missing, nobody answers at the address, or no worker is there.
    """
    if address is None:
        yield None
        return
    client = _client(address)
    with client:
        if not client.scheduler_info()["workers"]:
            raise SchedulerError(
                f"{address}: the scheduler has no worker; start some: dask worker {address} --nthreads 1"
            )
        yield client.get_executor(pure=False)


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise SchedulerError(
            f"{address}: needs the package distributed; install it with: pip install 'zoo[cluster]'"
        ) from None
    try:
        return Client(address, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        text = " ".join(str(error).split())[:200]
        raise SchedulerError(
            f"{address}: no scheduler answers ({text}); start one with `dask scheduler`, or give its address"
        ) from None
