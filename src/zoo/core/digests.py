"""Digests of contents: a file that was damaged or changed is not read as if it were whole."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

FIELD = "sha256"
"""Where a file's content holds its own digest."""


def of_bytes(content: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def of_json(content: Mapping[str, Any]) -> str:
    """SHA-256 of a JSON object as compact text in ASCII with sorted keys, without its own digest."""
    rest = {name: value for name, value in content.items() if name != FIELD}
    return of_bytes(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode())


def stamped(content: Mapping[str, Any]) -> dict[str, Any]:
    """A JSON object with its digest.

    Parameters
    ----------
    content : mapping
        As `json.loads` gives it: with names that are texts, and lists instead of tuples.

    Returns
    -------
    dict

    Examples
    --------
    >>> found = stamped({"a": 1.5})
    >>> fits(found), fits({**found, "a": 1.25}), fits({"a": 1.5})
    (True, False, None)
    """
    return {**content, FIELD: of_json(content)}


def to_text(content: Mapping[str, Any], indent: int | None = 1) -> str:
    """A JSON object with its digest, as the text of a file."""
    return json.dumps(stamped(content), indent=indent) + "\n"


def from_text(text: str | bytes, *, required: bool = False) -> dict[str, Any]:
    """A JSON object without its digest, which it must fit if it holds one.

    Parameters
    ----------
    text : str or bytes
    required : bool
        Whether it must hold one.

    Raises
    ------
    ValueError
        If it is no JSON object, holds a name twice, does not fit its digest, or lacks one that is required.
    """
    try:
        found = json.loads(text, object_pairs_hook=_unique)
    except RecursionError:
        raise ValueError("nested too deeply") from None
    if not isinstance(found, dict):
        raise ValueError("not a JSON object")
    if fits(found) is False:
        raise ValueError("damaged, its content does not fit its digest")
    if required and FIELD not in found:
        raise ValueError("no digest")
    return {name: value for name, value in found.items() if name != FIELD}


def _unique(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """An object, none of whose names occurs twice: of two values one would be lost without a word."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a name occurs twice")
    return found


def fits(content: Mapping[str, Any]) -> bool | None:
    """Whether a JSON object is what its digest says; None if it holds no digest."""
    return None if FIELD not in content else content[FIELD] == of_json(content)
