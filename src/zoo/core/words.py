"""Words for names that are not known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


def meant(word: object, known: Sequence[str], alike: float = 0.5, what: str = "") -> str:
    """A question for the known name that is nearest, with a blank at its end; empty if none is near."""
    close = difflib.get_close_matches(str(word), known, 1, alike)
    return f"did you mean {what}{close[0]!r}? " if close else ""


def choices(word: object, known: Sequence[str]) -> str:
    """The nearest known name, and all."""
    return f"{meant(word, known)}use one of {', '.join(known)}"


def nearest(word: object, known: Sequence[str]) -> str:
    """Words for an unknown name: the nearest known one, and all."""
    return f"unknown; {choices(word, known)}"


def refuse_unknown(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse settings that a function does not have.

    Parameters
    ----------
    what : str
        The function's name, for the error.
    given, known : iterable of str
        Names of settings.

    Raises
    ------
    TypeError
        Naming the first unknown setting and the known one that is nearest.

    Examples
    --------
    >>> refuse_unknown("sample", ["drws"], ["draws", "tune"])
    Traceback (most recent call last):
        ...
    TypeError: sample: setting 'drws': unknown; did you mean 'draws'? use one of draws, tune
    """
    names = list(known)
    for name in given:
        if name not in names:
            raise TypeError(f"{what}: setting {name!r}: {nearest(name, names)}")
