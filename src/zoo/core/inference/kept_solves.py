"""The solves of a surrogate's run, kept in its checkpoint folder, so that none is made twice."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.draws import seed_or_drawn
from zoo.core.inference.checkpoint import Folder, check_identity, identity_of
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.inference.states import REMEDY, CheckpointError, read_state, write_state
from zoo.core.surrogate.library import Library, Solved

Array = NDArray[np.float64]

OWNER = {"run": "of a surrogate", "part": "solves"}
"""What such a file says that it is; of which run, its content tells."""


class KeptSolves:
    """Solves of a run in a checkpoint folder: the same run asks for the same points again, and has them.

    Parameters
    ----------
    folder : Path
    library : Library
        Which takes solves from there, and tells of others, within the `with` block.
    logp : LogPosterior
        Of the model that is sampled.
    settings : mapping
        What must not change when the run is taken up again, but for the seed.
    seed : int, optional
        Drawn if absent, or that of the run which is there.
    every_s : float
        Seconds between writes, at least.

    Attributes
    ----------
    seed : int
    known : dict
        Points, as bytes, and what the forward model gives there: series, or the kind of a failure.
    sittings : int
        Runs that took part, with this one.
    text : str
    seconds : float

    Raises
    ------
    CheckpointError
        If the folder is in use, or holds another run or something else.
    """

    def __init__(
        self,
        folder: Path,
        library: Library,
        logp: LogPosterior,
        settings: Mapping[str, Any],
        seed: int | None,
        every_s: float = 30.0,
    ) -> None:
        self.every_s, self._library = every_s, library
        self._folder = Folder(folder)
        self._began = time.monotonic()
        self._points: list[Array] = []
        self._found: list[Solved] = []
        self.known: dict[bytes, Solved] = {}
        self.sittings, self.earlier_s = 1, 0.0
        try:
            self._identity = identity_of(logp, settings)
            stored = read_state(self.path, OWNER) if self.path.exists() else None
            if stored is not None:
                seed = self._take(stored, seed)
            self.seed = seed_or_drawn(seed)
            self.write()
        except BaseException:
            self._folder.close()
            raise

    @property
    def path(self) -> Path:
        """The file."""
        return self._folder.path / "solves.state"

    def _take(self, stored: Mapping[str, Any], seed: int | None) -> int:
        try:
            check_identity(self.path, stored["identity"], self._identity)
            theirs, points, series = int(stored["seed"]), stored["theta"], stored["series"]
            self.sittings, self.earlier_s = int(stored["sittings"]) + 1, float(stored["seconds"])
            found = [kind or one for kind, one in zip(stored["failed"], series, strict=True)]
            for theta, one in zip(points, found, strict=True):
                self._keep(np.asarray(theta, dtype=np.float64), one)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise CheckpointError(f"{self.path}: is no state of a run ({error}); {REMEDY}") from None
        if seed is not None and seed != theirs:
            raise CheckpointError(
                f"{self.path}: checkpoint of another run: seed is {theirs} there and {seed} here; use the "
                "same seed, another folder, or remove this one"
            )
        return theirs

    def _keep(self, theta: Array, found: Solved) -> None:
        self._points.append(theta)
        self._found.append(found)
        self.known[theta.tobytes()] = found

    @property
    def text(self) -> str:
        """How it goes on, for the first line of progress."""
        return (
            "" if self.sittings == 1 else f", resumed with {len(self.known)} solves (sitting {self.sittings})"
        )

    def __enter__(self) -> KeptSolves:
        self._library.known, self._library.told = self.known, self._note
        return self

    def _note(self, theta: Array, found: Solved) -> None:
        self._keep(theta, found)
        if time.monotonic() - self._written > self.every_s:
            self.write()

    def write(self) -> None:
        """Write the file; a kill at any moment leaves the old one or the new one."""
        good = [one for one in self._found if not isinstance(one, str)]
        blank = np.full(good[0].shape, np.nan) if good else np.empty(0)
        content = {
            "identity": self._identity,
            "seed": self.seed,
            "sittings": self.sittings,
            "seconds": self.seconds,
            "theta": np.array(self._points),
            "series": np.array([blank if isinstance(one, str) else one for one in self._found]),
            "failed": [one if isinstance(one, str) else "" for one in self._found],
        }
        self._written = write_state(self.path, OWNER, content)

    @property
    def seconds(self) -> float:
        """Wall time of all sittings so far."""
        return self.earlier_s + time.monotonic() - self._began

    def __exit__(self, *_: object) -> None:
        """Write all, leave the library alone and give the folder free."""
        self._library.known, self._library.told = {}, None
        try:
            self.write()
        finally:
            self._folder.close()
