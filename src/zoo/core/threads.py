"""Threads beside which linear algebra has one of its own."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]


@contextmanager
def threads(cores: int) -> Iterator[ThreadPoolExecutor]:
    """A pool of as many threads; the matrices that they work on are small."""
    with ThreadPoolExecutor(max(1, cores)) as pool, threadpool_limits(1, user_api="blas"):
        yield pool
