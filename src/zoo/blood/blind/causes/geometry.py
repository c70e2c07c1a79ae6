"""Errors of a measured tree: radii and lengths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zoo.blood.blind.causes.cause import PATTERNS, cause, picked
from zoo.blood.case import Case, with_network, with_true_lengths

Array = NDArray[np.float64]


def _radii(case: Case, factor: Array) -> Case:
    net = case.network
    return with_network(
        case, radius_in_cm=net.radius_in_cm * factor, radius_out_cm=net.radius_out_cm * factor
    )


@cause(
    "shrunk-small-vessels",
    "geometry",
    "1",
    (0.03, 0.7),
    equation="r_true = r (1 + a/(1 + (r/r_c)^4)), r_c a part of the root's radius",
    corner=(0.35, 0.8),
)
def shrunk_small_vessels(case: Case, size: float, *, corner: float) -> Case:
    """Vessels narrower than some radius were wider in life than in the image."""
    radius = case.network.radius_in_cm
    return _radii(case, 1 + size / (1 + (radius / (corner * radius.max())) ** 4))


@cause(
    "misread-radii",
    "geometry",
    "1",
    (0.03, 0.6),
    equation="r_true = r exp(+-a w) in two to four vessels, w from 1/2 to 1; the others as they are",
    vessels=(2.0, 4.999),
    pattern=(0.0, PATTERNS),
)
def misread_radii(case: Case, size: float, *, vessels: float, pattern: float) -> Case:
    """A handful of vessels was measured badly."""
    n = len(case.network.ids)
    some = picked(np.arange(n), int(vessels), pattern)
    rng = np.random.default_rng([int(pattern), 1])
    factor = np.ones(n)
    weights = rng.choice([-1.0, 1.0], len(some)) * rng.uniform(0.5, 1.0, len(some))
    factor[some] = np.exp(size * weights)
    return _radii(case, factor)


@cause(
    "tortuous-vessels",
    "geometry",
    "1",
    (0.2, 3.0),
    equation="L_true = L (1 + a (1 - r/r_root)^m): the narrower, the more tortuous",
    power=(0.3, 1.5),
)
def tortuous_vessels(case: Case, size: float, *, power: float) -> Case:
    """Lengths are those of straight lines; vessels wind, the narrow ones more."""
    case = with_true_lengths(case)
    radius = case.network.radius_in_cm
    factor = 1 + size * (1 - radius / radius.max() + 1e-12) ** power
    return with_network(case, length_cm=case.network.length_cm * factor)


CAUSES = (shrunk_small_vessels, misread_radii, tortuous_vessels)
