"""What a set of cases is drawn from: which kind and which effect comes when."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from zoo.blood.blind.causes import COMPONENTS, of_component
from zoo.blood.blind.outside import OUTSIDE
from zoo.core.blindcheck.keys import SECOND
from zoo.core.diagnosis.hypothesis import NULL

FORMAT = 2
GAP_OVER_NOISE = (0.5, 20.0)
"""Model discrepancy of the refitted baseline (rms over the pressures, without noise) that a case with an
effect has, over the sd of the pressures' noise. What is drawn outside is drawn again."""
SECRET = re.compile(r"[0-9a-f]{32}")
"""128 bits in hexadecimal digits."""
SMALL_GAPS = (0.3, 3.0)
"""The same of a set of small ones."""
NONE_SHARE, OUTSIDE_SHARE = 1 / 8, 1 / 5
SMALL_NONE, SMALL_LISTED = 1 / 5, 2 / 5
CATALOGUE_SET = "catalogue"
SETS = (CATALOGUE_SET, "component", "pair", "small", "coloured")
"""Kinds of sets: causes of the catalogue (with some outside, or none), of a known component that no catalogue
lists, two of these at once, small ones of both, and none at all but strongly coloured noise."""
PLUS = "+"
"""Between the two components of a pair."""
LAYOUTS = ("MPA", "MPA+daughters", "MPA+distal", "MPA+flow", "MPA+flows")


def default_layouts(kind: str) -> tuple[str, ...]:
    """Layouts of a kind of set: with a flow in one daughter for causes of the catalogue, else in both."""
    left = "MPA+flows" if kind == CATALOGUE_SET else "MPA+flow"
    return tuple(layout for layout in LAYOUTS if layout != left)


NETWORKS = ("mouse", "tree")


@dataclass(frozen=True)
class Draw:
    """What cases are drawn from.

    Parameters
    ----------
    n : int
    secret : str
        128 bits, as `SECRET`; the key alone holds it.
    effects : tuple of str
        Of the catalogue.
    networks : tuple of str
        "mouse", "tree".
    layouts : tuple of str
        Of `LAYOUTS`.
    vessels : (int, int)
        Least and largest number of vessels of a tree.
    kind : str
        Of `SETS`.
    """

    n: int
    secret: str
    effects: tuple[str, ...]
    networks: tuple[str, ...] = NETWORKS
    layouts: tuple[str, ...] = default_layouts(CATALOGUE_SET)
    vessels: tuple[int, int] = (5, 15)
    kind: str = CATALOGUE_SET

    @property
    def limits(self) -> tuple[float, float]:
        """Of the model discrepancy over the sd of the pressures' noise."""
        return SMALL_GAPS if self.kind == "small" else GAP_OVER_NOISE

    @property
    def head(self) -> dict[str, Any]:
        """Everything that shapes the cases, for the key; a set of the catalogue does not tell its kind."""
        told = asdict(self)
        if self.kind == CATALOGUE_SET:
            del told["kind"]
        return {"format": FORMAT, **told, "gap_over_noise": list(self.limits)}

    def rng(self, purpose: str, index: int = 0) -> np.random.Generator:
        """A stream of random numbers for one purpose in one case.

        Its seed is SHA-256 of the secret and both: who guesses one stream from what a case shows, such as
        the radii of its network, learns nothing of another one or of the secret.
        """
        words = [FORMAT, self.secret, self.n, purpose, index]
        words += [] if self.kind == CATALOGUE_SET else [self.kind]
        digest = hashlib.sha256(json.dumps(words).encode()).digest()
        return np.random.default_rng(int.from_bytes(digest))

    def plan(self) -> list[tuple[str, str]]:
        """Kind and effect of each case; the effect is the first to be tried.

        Every effect (component, pair of components) comes once before one comes twice, in an order that the
        secret shuffles. The effect of a component's case is one of its causes; a pair's are joined by "+".
        """
        rng = self.rng("plan")

        def names(known: Sequence[str], wanted: int) -> list[str]:
            rounds = -(-wanted // len(known)) if wanted else 0
            return [str(x) for _ in range(rounds) for x in rng.permutation(known)][:wanted]

        def causes(wanted: int) -> list[str]:
            order = {part: names([c.name for c in of_component(part)], wanted) for part in COMPONENTS}
            return [order[part].pop() for part in names(COMPONENTS, wanted)]

        n = self.n
        if self.kind == "component":
            kinds, found = ["component"] * n, causes(n)
        elif self.kind == "pair":
            both = [PLUS.join(two) for two in itertools.combinations(COMPONENTS, 2)]
            kinds, found = ["pair"] * n, names(both, n)
        elif self.kind == "coloured":
            kinds, found = ["none"] * n, [NULL] * n
        elif self.kind == "small":
            none, listed = round(n * SMALL_NONE), round(n * SMALL_LISTED)
            kinds = ["none"] * none + ["listed"] * listed + ["component"] * (n - none - listed)
            found = [NULL] * none + names(self.effects, listed) + causes(n - none - listed)
        else:
            none, outside = round(n * NONE_SHARE), round(n * OUTSIDE_SHARE)
            kinds = ["none"] * none + ["outside"] * outside + ["listed"] * (n - none - outside)
            found = [NULL] * none + names((*OUTSIDE, SECOND), outside)
            found += names(self.effects, n - none - outside)
        return [(kinds[i], found[i]) for i in rng.permutation(self.n)]
