"""What a costly function gave at vectors, by the vectors' bytes: a run that begins again takes it from there.

A file has a line for each evaluation, which is JSON after a digest. Lines are only ever added, so that a kill
leaves at most the last one unfinished, which is dropped. Nothing of a file is ever run.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
from base64 import b64decode, b64encode
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from zoo.core.arrays import Array
from zoo.core.inference.messages import SamplingError
from zoo.core.outputs import OutputFileError, leads_elsewhere

REMEDY = "remove the folder to start afresh"
_DIGITS = 24
_BEGUN = re.compile(rb"[0-9a-f]{0,24}|[0-9a-f]{24} (\[.*)?")
"""A line that was cut short."""


class CheckpointError(SamplingError):
    """A checkpoint folder belongs to another run, is in use, or cannot be read."""


@dataclass(frozen=True)
class Found:
    """What a function gave, how many solves that took, and how many of them failed, by kind."""

    values: tuple[np.ndarray, ...]
    solves: int = 1
    failures: Mapping[str, int] = field(default_factory=dict)


def to_line(owner: str, key: bytes, found: Found) -> bytes:
    """A line of a memo that belongs to `owner`."""
    values = [[v.dtype.str, v.shape, b64encode(v.tobytes()).decode()] for v in found.values]
    text = json.dumps([b64encode(key).decode(), values, found.solves, dict(found.failures)]).encode()
    return _digest(owner, text) + b" " + text + b"\n"


def read_lines(owner: str, raw: bytes, name: str) -> dict[bytes, Found]:
    """What whole lines say.

    Raises
    ------
    CheckpointError
        Naming the file and the first line that is damaged, or belongs to something else.
    """
    known = {}
    for number, line in enumerate(raw.split(b"\n")[:-1], 1):
        digest, _, text = line.partition(b" ")
        if digest != _digest(owner, text):
            raise CheckpointError(f"{name}: line {number} is damaged, or of another run or chain; {REMEDY}")
        try:
            key, values, solves, failures = json.loads(text)
            arrays = tuple(
                np.frombuffer(b64decode(data), dtype=dtype).reshape(shape) for dtype, shape, data in values
            )
            known[b64decode(key)] = Found(arrays, solves, failures)
        except (ValueError, TypeError, RecursionError) as error:  # the digest fits: someone wrote it so
            raise CheckpointError(f"{name}: line {number} cannot be read ({error}); {REMEDY}") from None
    return known


def _digest(owner: str, text: bytes) -> bytes:
    return blake2b(owner.encode() + b"\n" + text).hexdigest()[:_DIGITS].encode()


class Memo:
    """Lines of a memo, in a file or without one.

    Parameters
    ----------
    path : Path or None
    owner : str
        What the lines belong to: run and part of it.

    Attributes
    ----------
    lines : bytearray
    known : dict
        What was there, by the bytes of the vector.

    Raises
    ------
    CheckpointError
        If the file cannot be read, is damaged, or belongs to something else.
    """

    def __init__(self, path: Path | None, owner: str) -> None:
        self.owner, self.path = owner, path
        self.lines = bytearray()
        self.known: dict[bytes, Found] = {}
        self._file: Any = None
        if path is None:
            return
        if os.path.lexists(path) and leads_elsewhere(path):
            raise CheckpointError(f"{path}: is a link, or no file; {REMEDY}")
        try:
            self._file = open(path, "a+b")  # noqa: SIM115 (closed by close)
            self._file.seek(0)
            raw = self._file.read()
        except OSError as error:
            raise CheckpointError(f"{path}: cannot be read ({error.strerror}); {REMEDY}") from None
        self.lines += raw[: raw.rfind(b"\n") + 1]
        try:
            self.known = read_lines(owner, bytes(self.lines), str(path))
        except CheckpointError:
            self._file.close()
            raise
        if rest := raw[len(self.lines) :]:
            if not _BEGUN.fullmatch(rest):
                self._file.close()
                raise CheckpointError(f"{path}: ends in what zoo did not write; {REMEDY}")
            self._file.truncate(len(self.lines))

    def add(self, lines: bytes) -> None:
        """Add lines at the end.

        Raises
        ------
        zoo.core.outputs.OutputFileError
            If they cannot be written; a line that is not whole is dropped by the next sitting.
        """
        self.lines += lines
        if self._file is None:
            return
        try:
            self._file.write(lines)
            self._file.flush()
        except OSError as error:
            raise OutputFileError(
                f"{self._file.name}: cannot be written ({error.strerror}); make room, and give the same again"
            ) from None

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            with contextlib.suppress(OSError):  # of what was told by add
                self._file.close()


class Remembering:
    """A compiled function of a vector, which is not called where it is known what it gives.

    Parameters
    ----------
    function : callable
        Of a vector (n_dim,).
    known : mapping
        What it gave, by the bytes of a vector.
    told : callable
        Is called with the bytes of each other vector, and what it gave there.
    kind : bytes
        Distinguishes the function from others that `known` is of.
    ops : list, optional
        Operations of the function that count solves; found out if absent.
    alone : bool
        Whether the function gives a number.

    Attributes
    ----------
    counts : dict
        Solves and failed solves by kind, as of the operations of a function: those that are known of earlier
        count as if they had been made now. Where nothing counts solves, each call is one.
    """

    def __init__(
        self,
        function: Callable[[Array], Any],
        known: Mapping[bytes, Found],
        told: Callable[[bytes, Found], None],
        kind: bytes = b"",
        ops: list[Any] | None = None,
        *,
        alone: bool = True,
    ) -> None:
        from zoo.core.inference.logposterior import count, counting_ops

        self._count = count
        self._function, self._known, self._told, self._kind = function, known, told, kind
        self._alone = alone
        self._ops = counting_ops(function) if ops is None else ops
        self._solves = 0
        self._failures: Counter[str] = Counter()

    @property
    def counts(self) -> dict[str, Any]:
        """Solves made, and failures by their kind."""
        return {"solves": self._solves, "failures": self._failures}

    def __call__(self, q: Array) -> Any:
        """What the function gives at a point, computed once."""
        key = self._kind + q.tobytes()
        found = self._known.get(key)
        if found is None:
            solves, failed = self._count(self._ops)
            given = self._function(q)
            after, failed_after = self._count(self._ops)
            values = tuple(np.array(one) for one in (given if isinstance(given, list | tuple) else [given]))
            found = Found(values, after - solves if self._ops else 1, failed_after - failed)
            self._told(key, found)
        self._solves += found.solves
        self._failures.update(found.failures)
        return found.values[0] if self._alone else list(found.values)
