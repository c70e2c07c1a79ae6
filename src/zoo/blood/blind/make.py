"""Making a set of cases whose effect is withheld, and their key."""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from zoo.blood.blind.bench import BASELINE
from zoo.blood.blind.case import CaseDraw, draw_case
from zoo.blood.blind.draw import CATALOGUE_SET, LAYOUTS, NETWORKS, SECRET, SETS, Draw, default_layouts
from zoo.blood.diagnosis import effects_for
from zoo.core.blindcheck.making import write_cases
from zoo.core.blindcheck.sealing import BlindError, read_head
from zoo.core.words import nearest


def make_cases(
    folder: str | Path,
    n: int = 40,
    key: str | Path = "key.json",
    *,
    kind: str = CATALOGUE_SET,
    secret: str | None = None,
    effects: Sequence[str] | None = None,
    networks: Sequence[str] = NETWORKS,
    layouts: Sequence[str] | None = None,
    vessels: tuple[int, int] = (5, 15),
    cores: int = 2,
    done: Callable[[str], None] = lambda case: None,
) -> Path:
    """Write studies with a withheld effect each, and the key apart.

    All that is random comes from a secret of 128 bits, which the key holds and nothing else: nobody finds the
    plan by trying numbers. The cases are written together when all are made; until then they lie beside the
    key with the secret, and a call that was interrupted goes on with both.

    Parameters
    ----------
    folder : path
        For the cases, and the key's SHA-256.
    n : int
        Cases.
    key : path
        JSON file outside the folder.
    kind : str
        Of `zoo.blood.blind.draw.SETS`: "catalogue" has an eighth of the cases without an effect and a fifth
        with one that the catalogue does not hold; "component" a cause that no catalogue lists in a known
        component, "pair" two of these, "small" small ones of all these, "coloured" none but strongly
        coloured noise.
    secret : str, optional
        That of an older key, 32 hexadecimal digits, to make its cases again with the same `n` and settings; a
        new one is drawn if absent.
    effects : sequence of str, optional
        Of the catalogue; all that fit the baseline if absent.
    networks : sequence of str
        "mouse", "tree".
    layouts : sequence of str
        Of `LAYOUTS`; those of the kind if absent.
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
    if n < 1 or n > 999 or cores < 1:
        raise BlindError(f"n = {n}, cores = {cores}: give n from 1 to 999, cores >= 1")
    if secret is not None and not SECRET.fullmatch(secret):
        raise BlindError('secret: give the 32 hexadecimal digits of a key\'s "secret", or leave it out')
    if kind not in SETS:
        raise BlindError(f"kind = {kind!r}: {nearest(kind, SETS)}")
    layouts = default_layouts(kind) if layouts is None else layouts
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
    secret = secret or (read_head(key) or {}).get("secret") or secrets.token_hex(16)
    draw = Draw(n, secret, names, tuple(networks), tuple(layouts), (vessels[0], vessels[1]), kind)
    jobs = [CaseDraw(draw, i, *one) for i, one in enumerate(draw.plan())]
    write_cases(folder, key, jobs, draw_case, head=draw.head, totals=_redrawn, cores=cores, done=done)
    return key


def _redrawn(entries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Effect -> how many of its draws were kept, and drawn again for which reason, over all cases."""
    total: dict[str, Counter[str]] = {}
    for entry in entries:
        for name, counts in entry["redrawn"].items():
            total.setdefault(name, Counter()).update(counts)
    return {"redrawn": {name: dict(total[name]) for name in sorted(total)}}
