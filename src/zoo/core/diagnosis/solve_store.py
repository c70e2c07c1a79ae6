"""Solves kept by content: none is made twice, and an interrupted diagnosis goes on from a file."""

from __future__ import annotations

import functools
import pickle
import threading
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.diagnosis.coordinates import FAILURES
from zoo.core.forward import Around, ForwardModel, Outputs, SolveError, content_key, pinned, refined
from zoo.core.inference.memo import CheckpointError, Found, Memo, to_line
from zoo.core.outputs import output_folder

Array = NDArray[np.float64]
FILE = "solves.memo"


class SolveStore:
    """Solves by a digest of simulator, configuration and outputs, in memory and in a file of a folder.

    In a file the digest is of this package's code too: what another version solved is not taken.

    Parameters
    ----------
    folder : path, optional
        Made if it is missing; its solves are taken up. Without one they are kept in memory only.

    Attributes
    ----------
    made, failed : int
        Solves that were not known, and those of them that failed.

    Raises
    ------
    zoo.core.inference.memo.CheckpointError
        If the file cannot be read, or is damaged.
    """

    def __init__(self, folder: str | Path | None) -> None:
        path, self.program = None, ""
        if folder is not None:
            self.program = _program()
            path = output_folder(Path(folder).expanduser(), deep=True) / FILE
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                text = f"{folder}: cannot be used as checkpoint folder ({error.strerror}); choose another"
                raise CheckpointError(text) from None
        self._memo: Memo | None = Memo(path, FILE)
        self._lock = threading.Lock()
        self.known, self.made, self.failed = self._memo.known, 0, 0

    def add(self, key: bytes, found: Found) -> None:
        """Keep what was solved."""
        with self._lock:
            self.made += 1
            self.failed += bool(found.failures)
            self.known[key] = found
            if self._memo is not None and self._memo.path is not None:
                self._memo.add(to_line(FILE, key, found))

    def close(self) -> None:
        """Close the file; further solves are kept in memory only."""
        if self._memo is not None:
            self._memo.close()
        self._memo = None


class StoredModel(Around):
    """A forward model that solves nothing twice; itself a forward model.

    Parameters
    ----------
    model : ForwardModel
    store : SolveStore
    """

    def __init__(self, model: ForwardModel, store: SolveStore) -> None:
        super().__init__(model)
        self._store, self._key = store, content_key(store.program, model.key)

    def __reduce__(self) -> Any:
        return _plain, (self.model,)  # another process has a memory of its own

    def pinned(self, configuration: Any) -> ForwardModel:
        """Fix the discretisation at that of a solve."""
        return StoredModel(pinned(self.model, configuration), self._store)

    def refined(self) -> ForwardModel | None:
        """The finer model, whose solves are kept too."""
        finer = refined(self.model)
        return None if finer is None else StoredModel(finer, self._store)

    def solve(self, configuration: Any, outputs: Outputs | None = None) -> Array:
        """Take the series from the store, or solve and keep them."""
        try:
            text = pickle.dumps(configuration, protocol=5)
        except (pickle.PicklingError, AttributeError, TypeError):  # a function that was defined in another
            return self.model.solve(configuration, outputs)
        what = content_key(self._key, outputs or self.outputs, text)
        key = blake2b(what.encode(), digest_size=16).digest()
        if (found := self._store.known.get(key)) is not None:
            if found.failures:
                raise SolveError(next(iter(found.failures)))
            return np.array(found.values[0])
        try:
            values = self.model.solve(configuration, outputs)
        except FAILURES as error:
            told = str(error) or getattr(error, "kind", "")
            reason = told if isinstance(error, SolveError) else f"{type(error).__name__}: {told}"
            self._store.add(key, Found((), failures={reason: 1}))
            raise
        self._store.add(key, Found((np.asarray(values),)))
        return values


@functools.cache
def _program() -> str:
    """Digest of this package's code, compiled code too."""
    files = sorted(
        path for path in Path(__file__).parents[2].rglob("*") if path.suffix in (".py", ".so", ".pyd")
    )
    return content_key(*(path.read_bytes() for path in files))


def _plain(model: ForwardModel) -> ForwardModel:
    return model
