"""Laws of the wall."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.causes.cause import PATTERNS, bump, cause, phases, picked, ramp
from zoo.blood.case import Case, with_physics
from zoo.blood.functions import WallFunction

Array = NDArray[np.float64]
STRETCH, KNOTS = (0.7, 1.55), 256
"""Range of sqrt(A/A0) and knots of a table of a law."""


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


def _with_law(case: Case, law: Callable[[Array], Array]) -> Case:
    """The linear wall with another law of the stretch s, in units of (4/3) chi; s - 1 is the linear one."""
    stretch = np.linspace(*STRETCH, KNOTS)
    return with_physics(case, wall_function=WallFunction(*STRETCH, tuple(law(stretch) - (stretch - 1))))


@cause(
    "fung-wall",
    "wall",
    "1",
    (0.5, 20.0),
    equation="p = (4/3) chi e exp(a e^2), e = sqrt(A/A0) - 1",
    source="Fung et al. 1979, doi 10.1152/ajpheart.1979.237.5.H620 (exponential in the strain squared)",
)
def fung_wall(case: Case, size: float) -> Case:
    """The wall stiffens exponentially with the square of its strain."""
    return _with_law(case, lambda s: (s - 1) * np.exp(size * (s - 1) ** 2))


@cause(
    "arctangent-wall",
    "wall",
    "share",
    (0.4, 1.3),
    equation="A/A_m = 1/2 + arctan((p - p_0)/p_1)/pi, with slope and pressure at rest as the linear wall",
    source="Langewouters et al. 1984, doi 10.1016/0021-9290(84)90034-4",
    largest=(2.55, 3.5),
)
def arctangent_wall(case: Case, size: float, *, largest: float) -> Case:
    """The area goes to a largest one by an arctangent: soft at middling pressures, stiff at high ones."""
    rest, slope = np.pi * (1 / largest - 0.5), np.pi / largest / np.cos(np.pi * (1 / largest - 0.5)) ** 2

    def law(s: Array) -> Array:
        tangent = np.tan(np.pi * (s**2 / largest - 0.5)) - np.tan(rest)
        return np.asarray((1 - size) * (s - 1) + size * tangent / (2 * slope))

    return _with_law(case, law)


@cause(
    "collagen-wall",
    "wall",
    "1",
    (0.1, 6.0),
    equation="p = (4/3) chi (s - 1 + a w log(1 + exp((s - s_c)/w))), s = sqrt(A/A0)",
    source="Roach and Burton 1957, doi 10.1139/o57-080 (collagen takes over beyond a stretch)",
    engaged=(1.12, 1.32),
    width=(0.01, 0.04),
)
def collagen_wall(case: Case, size: float, *, engaged: float, width: float) -> Case:
    """Collagen is recruited around a stretch: from there on the wall is stiffer."""
    return _with_law(case, lambda s: s - 1 + size * width * ramp((s - engaged) / width))


CAUSES = (patchy_stiffening, pulsing_tone, fung_wall, arctangent_wall, collagen_wall)
