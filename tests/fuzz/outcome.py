"""What became of one input, and whether that may be."""

from __future__ import annotations

import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

SECONDS = 20
"""Longest that an input may take."""
LONGEST = 500
"""Characters of an error's text."""


@dataclass(frozen=True)
class Outcome:
    """ "ok", "refused" or "FAILED", and why it failed."""

    kind: str
    text: str = ""


class TooLongError(BaseException):
    """An input takes longer than it may."""


def _stop(signum: int, frame: FrameType | None) -> NoReturn:
    raise TooLongError


def judged(
    work: Callable[[], Any], refused: tuple[type[Exception], ...], folder: Path, names: list[str]
) -> Outcome:
    """Run a reader: it returns, or raises one of its own errors in one line that names one of some files.

    Parameters
    ----------
    work : callable
    refused : tuple of exceptions
        Errors that say what is wrong with a file.
    folder : Path
        Where the input is.
    names : list of str
        Of files, one of which the error must name; none if empty.
    """
    signal.signal(signal.SIGALRM, _stop)
    signal.setitimer(signal.ITIMER_REAL, 3 * SECONDS)
    began = time.process_time()
    try:
        work()
    except refused as error:
        text = str(error)
        if len(text) > LONGEST or not text.isprintable() or not text.strip():
            return Outcome("FAILED", f"not one line of {LONGEST} characters: {text[:2000]!r}")
        if names and not any(name in text for name in names):
            return Outcome("FAILED", f"names none of {', '.join(names)}: {text}")
        if time.process_time() - began > SECONDS:
            return Outcome("FAILED", f"{time.process_time() - began:.0f} s until it was refused")
        return Outcome("refused", text)
    except TooLongError:
        return Outcome("FAILED", f"longer than {3 * SECONDS} s")
    except Exception:
        return Outcome("FAILED", traceback.format_exc())
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
    if time.process_time() - began > SECONDS:
        return Outcome("FAILED", f"{time.process_time() - began:.0f} s")
    return Outcome("ok")
