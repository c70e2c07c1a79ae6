"""Laws of the wall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zoo.blood.blind.causes.cause import PATTERNS, bump, cause, phases, picked
from zoo.blood.case import Case, with_physics


@cause(
    "patchy-stiffening",
    "wall",
    "1",
    (0.05, 1.5),
    equation="chi -> chi exp(a) in a third of the vessels",
    pattern=(0.0, PATTERNS),
)
def patchy_stiffening(case: Case, size: float, *, pattern: float) -> Case:
    """A third of the vessels is stiffer than the others."""
    n = len(case.network.ids)
    some = picked(np.arange(n), max(2, round(n / 3)), pattern)
    factor = np.ones(n)
    factor[some] = np.exp(size)
    return replace(case, stiffness=case.stiffness * factor)


@cause(
    "pulsing-tone",
    "wall",
    "1",
    (0.03, 1.0),
    equation="chi -> chi (1 + a b(t)), b a bump of height 1",
    at=(0.05, 0.95),
    width=(0.05, 0.12),
)
def pulsing_tone(case: Case, size: float, *, at: float, width: float) -> Case:
    """Muscle in the wall contracts once in every beat."""
    return with_physics(case, stiffness_wave=1 + size * bump(phases(256), at, width))


CAUSES = (patchy_stiffening, pulsing_tone)
