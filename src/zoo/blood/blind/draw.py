"""What a set of cases is drawn from: which kind and which effect comes when."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from zoo.blood.blind.outside import OUTSIDE
from zoo.core.blindcheck.keys import SECOND
from zoo.core.diagnosis.hypothesis import NULL

FORMAT = 1
NONE_SHARE, OUTSIDE_SHARE = 1 / 8, 1 / 5
LAYOUTS = ("MPA", "MPA+daughters", "MPA+distal", "MPA+flow")
NETWORKS = ("mouse", "tree")


@dataclass(frozen=True)
class Draw:
    """What cases are drawn from.

    Parameters
    ----------
    n, seed : int
    effects : tuple of str
        Of the catalogue.
    networks : tuple of str
        "mouse", "tree".
    layouts : tuple of str
        Of `LAYOUTS`.
    vessels : (int, int)
        Least and largest number of vessels of a tree.
    """

    n: int
    seed: int
    effects: tuple[str, ...]
    networks: tuple[str, ...] = NETWORKS
    layouts: tuple[str, ...] = LAYOUTS
    vessels: tuple[int, int] = (5, 15)

    @property
    def digest(self) -> str:
        """Of everything that shapes the cases."""
        content = json.dumps([FORMAT, asdict(self)], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:16]

    def plan(self) -> list[tuple[str, str]]:
        """Kind and effect of each case; the effect is the first to be tried.

        Every effect comes once before one comes twice, in an order that the seed shuffles.
        """
        rng = np.random.default_rng([self.seed, self.n])
        none, outside = round(self.n * NONE_SHARE), round(self.n * OUTSIDE_SHARE)
        kinds = ["none"] * none + ["outside"] * outside + ["listed"] * (self.n - none - outside)

        def names(known: Sequence[str], wanted: int) -> list[str]:
            rounds = -(-wanted // len(known)) if wanted else 0
            return [str(x) for _ in range(rounds) for x in rng.permutation(known)][:wanted]

        found = [NULL] * none + names((*OUTSIDE, SECOND), outside)
        found += names(self.effects, self.n - none - outside)
        return [(kinds[i], found[i]) for i in rng.permutation(self.n)]
