"""What a set of cases is drawn from: which kind and which effect comes when."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from zoo.blood.blind.outside import OUTSIDE
from zoo.core.blindcheck.keys import SECOND
from zoo.core.diagnosis.hypothesis import NULL

FORMAT = 2
GAP_OVER_NOISE = (0.5, 20.0)
"""Model discrepancy of the refitted baseline (rms over the pressures, without noise) that a case with an
effect has, over the sd of the pressures' noise. What is drawn outside is drawn again."""
SECRET = re.compile(r"[0-9a-f]{32}")
"""128 bits in hexadecimal digits."""
NONE_SHARE, OUTSIDE_SHARE = 1 / 8, 1 / 5
LAYOUTS = ("MPA", "MPA+daughters", "MPA+distal", "MPA+flow")
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
    """

    n: int
    secret: str
    effects: tuple[str, ...]
    networks: tuple[str, ...] = NETWORKS
    layouts: tuple[str, ...] = LAYOUTS
    vessels: tuple[int, int] = (5, 15)

    @property
    def head(self) -> dict[str, Any]:
        """Everything that shapes the cases, for the key."""
        return {"format": FORMAT, **asdict(self), "gap_over_noise": list(GAP_OVER_NOISE)}

    def rng(self, purpose: str, index: int = 0) -> np.random.Generator:
        """A stream of random numbers for one purpose in one case.

        Its seed is SHA-256 of the secret and both: who guesses one stream from what a case shows, such as
        the radii of its network, learns nothing of another one or of the secret.
        """
        digest = hashlib.sha256(json.dumps([FORMAT, self.secret, self.n, purpose, index]).encode()).digest()
        return np.random.default_rng(int.from_bytes(digest))

    def plan(self) -> list[tuple[str, str]]:
        """Kind and effect of each case; the effect is the first to be tried.

        Every effect comes once before one comes twice, in an order that the secret shuffles.
        """
        rng = self.rng("plan")
        none, outside = round(self.n * NONE_SHARE), round(self.n * OUTSIDE_SHARE)
        kinds = ["none"] * none + ["outside"] * outside + ["listed"] * (self.n - none - outside)

        def names(known: Sequence[str], wanted: int) -> list[str]:
            rounds = -(-wanted // len(known)) if wanted else 0
            return [str(x) for _ in range(rounds) for x in rng.permutation(known)][:wanted]

        found = [NULL] * none + names((*OUTSIDE, SECOND), outside)
        found += names(self.effects, self.n - none - outside)
        return [(kinds[i], found[i]) for i in rng.permutation(self.n)]
