"""What PyMC tells of its own work, kept from those who did not call it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_messages(logger: str, below: int) -> Iterator[None]:
    """Messages of a logger below a level are not shown.

    Parameters
    ----------
    logger : str
        Such as "pymc".
    below : int
        A level of `logging`.
    """
    found = logging.getLogger(logger)
    before = found.level
    found.setLevel(below)
    try:
        yield
    finally:
        found.setLevel(before)


class SamplingError(RuntimeError):
    """Sampling cannot start or go on; its text says why and what to change."""
