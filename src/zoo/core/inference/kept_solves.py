"""The solves of a surrogate's run, kept in its checkpoint folder, so that none is made twice."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from zoo.core.arrays import Array
from zoo.core.inference.checkpoint import Run
from zoo.core.inference.memo import Found, Memo, to_line
from zoo.core.surrogate.library import Library, Solved


@contextlib.contextmanager
def kept(run: Run, library: Library) -> Iterator[None]:
    """Keep a library's solves in the folder of a run, which asks for the same points again, and has them.

    Parameters
    ----------
    run : Run
        Without a folder nothing is kept.
    library : Library
        Which takes solves from there, and tells of others, within the `with` block.

    Raises
    ------
    CheckpointError
        If the file of the solves is damaged, or belongs to something else.
    """
    if run.folder is None:
        yield
        return
    memo = Memo(run.folder.path / "solves.memo", run.owner)

    def note(theta: Array, found: Solved) -> None:
        library.known[theta.tobytes()] = found
        one = Found((), failures={found: 1}) if isinstance(found, str) else Found((found,))
        memo.add(to_line(run.owner, theta.tobytes(), one))

    library.known = {
        key: next(iter(found.failures), None) or found.values[0] for key, found in memo.known.items()
    }
    library.told = note
    try:
        yield
    finally:
        library.known, library.told = {}, None
        memo.close()
