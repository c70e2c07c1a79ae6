"""The solves of a surrogate's run, kept in its checkpoint folder, so that none is made twice."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.inference.checkpoint import Run
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.inference.memo import Found, Memo, to_line
from zoo.core.surrogate.library import Library, Solved

Array = NDArray[np.float64]


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

    Attributes
    ----------
    seed : int
    known : dict
        Points, as bytes, and what the forward model gives there: series, or the kind of a failure.
    sittings : int
        Runs that took part, with this one.
    text : str
        How it goes on, for the first line of progress.

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
    ) -> None:
        self._library = library
        self._run = Run(folder, logp, settings, seed)
        try:
            self._memo = Memo(folder / "solves.memo", self._run.owner)
        except BaseException:
            self._run.close(write=False)
            raise
        self.seed, self.sittings, self.text = self._run.seed, self._run.sittings, self._run.resumed
        self.known: dict[bytes, Solved] = {
            key: next(iter(found.failures), None) or found.values[0]
            for key, found in self._memo.known.items()
        }

    def __enter__(self) -> KeptSolves:
        self._library.known, self._library.told = self.known, self._note
        return self

    def _note(self, theta: Array, found: Solved) -> None:
        self.known[theta.tobytes()] = found
        one = Found((), failures={found: 1}) if isinstance(found, str) else Found((found,))
        self._memo.add(to_line(self._run.owner, theta.tobytes(), one))

    @property
    def seconds(self) -> float:
        """Wall time of all sittings so far."""
        return self._run.seconds

    def __exit__(self, *_: object) -> None:
        """Leave the library alone and give the folder free."""
        self._library.known, self._library.told = {}, None
        self._memo.close()
        self._run.close()
