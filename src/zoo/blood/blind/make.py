"""Making a set of cases whose effect is withheld, and their key."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from zoo.blood.blind.bench import BASELINE
from zoo.blood.blind.case import CaseDraw, draw_case
from zoo.blood.blind.draw import LAYOUTS, NETWORKS, Draw
from zoo.blood.diagnosis import effects_for
from zoo.blood.study import StudyError, load_study
from zoo.core.blindcheck.making import write_cases
from zoo.core.blindcheck.sealing import BlindError


def make_cases(
    folder: str | Path,
    n: int = 40,
    seed: int = 1,
    key: str | Path = "key.json",
    *,
    effects: Sequence[str] | None = None,
    networks: Sequence[str] = NETWORKS,
    layouts: Sequence[str] = LAYOUTS,
    vessels: tuple[int, int] = (5, 15),
    cores: int = 2,
    done: Callable[[str], None] = lambda case: None,
) -> Path:
    """Write studies with a withheld effect each, and the key apart.

    A draw depends only on the arguments up to `vessels`. Cases that an interrupted call wrote are kept.

    Parameters
    ----------
    folder : path
        For the cases, and the key's SHA-256.
    n : int
        Cases: an eighth without an effect, a fifth with one that the catalogue does not hold.
    seed : int
    key : path
        JSON file outside the folder.
    effects : sequence of str, optional
        Of the catalogue; all that fit the baseline if absent.
    networks : sequence of str
        "mouse", "tree".
    layouts : sequence of str
        Of `LAYOUTS`.
    vessels : (int, int)
        Least and largest number of vessels of a generated tree.
    cores : int
        Processes.
    done : callable
        Told the name of each finished case.

    Returns
    -------
    Path
        The key's.

    Raises
    ------
    BlindError
        If an argument is out of range, or folder and key hold another draw.
    """
    folder, key = Path(folder), Path(key)
    if n < 1 or n > 999 or cores < 1 or seed < 0:
        raise BlindError(
            f"n = {n}, seed = {seed}, cores = {cores}: give n from 1 to 999, seed >= 0, cores >= 1"
        )
    for what, given, some in (("networks", networks, NETWORKS), ("layouts", layouts, LAYOUTS)):
        if not given or set(given) - set(some):
            raise BlindError(f"{what} = {', '.join(given)}: give some of {', '.join(some)}")
    names = tuple(one.name for one in effects_for(BASELINE, effects))
    if len(names) < 2:
        raise BlindError(f"effects = {', '.join(names)}: give two or more, or what is withheld is known")
    if not 3 <= vessels[0] <= vessels[1] or (vessels[0] == vessels[1] and vessels[0] % 2 == 0):
        raise BlindError(
            f"vessels = {vessels[0]}, {vessels[1]}: give limits of at least 3 with an odd number between them"
        )
    draw = Draw(n, seed, names, tuple(networks), tuple(layouts), (vessels[0], vessels[1]))
    jobs = [CaseDraw(draw, i, *kind, folder) for i, kind in enumerate(draw.plan())]
    write_cases(folder, key, jobs, draw_case, draw=draw.digest, there=_there, cores=cores, done=done)
    return key


def _there(folder: Path, entry: dict[str, Any]) -> bool:
    """Whether the case of an entry was written in full."""
    try:
        return bool(load_study(folder).checksum == entry["digest"])
    except StudyError:
        return False
