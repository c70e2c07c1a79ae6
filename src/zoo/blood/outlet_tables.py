"""Outlets that are given by their impedance: tables by harmonic, and trees of small arteries."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.core.arrays import Array

Complex = NDArray[np.complex128]

HARMONICS = 20
"""Of the beat, up to which an outlet meets its tree's impedance."""
MEMORY_BEATS = 0.5
"""Time in which the part of an outlet's response falls by e that its nearest circuit does not have."""
TREE_FACTORS = {
    "tree_daughters": ("alpha", "beta"),
    "tree_length": ("length_ratio",),
    "tree_smallest_radius": ("smallest_radius_cm",),
    "tree_stiffness": ("f1", "f3"),
}
"""Parameters of models that are factors of fields of all trees, 1 as the study has them."""
_SMALLEST_SHARE = 5e-4
"""Of a terminal's radius, in a tree."""
_SMALLEST_CM = 1e-4
"""Radius of a vessel through which blood cells still pass one by one."""
_MOST_DAUGHTER = 0.98
_LEAST_TURN = 0.1
"""omega R2 C of the nearest circuit in the first harmonic, at least."""


@dataclass(frozen=True)
class StructuredTree:
    """An asymmetric tree of small arteries that hangs on a terminal, by its rules.

    A vessel of radius r has the length `length_ratio` r and daughters of radius `alpha` r and `beta` r; one
    whose radius is below `smallest_radius_cm` has none, and the pressure at its end is that behind the
    outlet. The first vessel has the radius of the terminal's end. Walls: p = (4/3) chi (sqrt(A/A0) - 1) with
    chi = f1 exp(f2 r) + f3.

    Parameters
    ----------
    alpha, beta : float
        Radii of the two daughters over their parent's, below 1.
    length_ratio : float
        Length of a vessel over its radius.
    smallest_radius_cm : float
        cm.
    f1, f2, f3 : float
        g/(cm s2), 1/cm, g/(cm s2).
    viscosity_by_radius : bool
        Whether the blood's viscosity changes with the radius as in living tissue, at a haematocrit of 0.45,
        from its own in the largest vessels.

    References
    ----------
    Olufsen 1999, doi 10.1152/ajpheart.1999.276.1.H257; Olufsen et al. 2000, doi 10.1114/1.1326031; Pries et
    al. 1994, doi 10.1161/01.RES.75.5.904.
    """

    alpha: float
    beta: float
    length_ratio: float
    smallest_radius_cm: float
    f1: float
    f2: float
    f3: float
    viscosity_by_radius: bool = True

    def scaled(self, factors: Mapping[str, float]) -> StructuredTree:
        """The same with fields times factors, by the names of `TREE_FACTORS`."""
        changes = {
            field: float(factors[name]) * getattr(self, field)
            for name, fields in TREE_FACTORS.items()
            if name in factors
            for field in fields
        }
        return replace(self, **changes)

    def fault(self, radius_cm: float) -> str | None:
        """What is wrong with a tree that hangs on an end of this radius; None if nothing is."""
        for name in ("alpha", "beta"):
            if not 0 < getattr(self, name) <= _MOST_DAUGHTER:
                value = getattr(self, name)
                return f"{name} = {value!r}: must be positive and at most {_MOST_DAUGHTER:g}; lower it"
        if not self.smallest_radius_cm >= _SMALLEST_SHARE * radius_cm:
            return (
                f"smallest_radius_cm = {self.smallest_radius_cm:.6g}: must be at least {_SMALLEST_SHARE:g} "
                f"of the vessel's radius at its end, {radius_cm:g}; raise it"
            )
        last = self.smallest_radius_cm * min(self.alpha, self.beta)
        if self.viscosity_by_radius and last < _SMALLEST_CM:
            return (
                f"smallest_radius_cm = {self.smallest_radius_cm:.6g}: vessels of {last:.3g} cm have no "
                f"viscosity by radius, which begins at {_SMALLEST_CM:g}; raise it, or say "
                "viscosity_by_radius = false"
            )
        if not 0 < self.length_ratio < math.inf:
            return f"length_ratio = {self.length_ratio!r}: must be positive and finite; correct it"
        if not 0 < self.f1 + self.f3 < math.inf:
            return f"f1 = {self.f1!r} and f3 = {self.f3!r} are no stiffness; give a positive one"
        return None

    def impedance(self, radius_cm: float, density: float, viscosity: float, omega: ArrayLike) -> Complex:
        """Of the tree behind a terminal, pressure above that behind the outlet over flow.

        In a vessel, with w = i^1.5 r sqrt(omega/nu) and F = 2 J1(w)/(w J0(w)),

            Z(0) = (i/g tan(omega l/c) + Z(l))/(1 + i g Z(l) tan(omega l/c)),
            c^2 = slope (1 - F)/rho, g = c A0/slope, slope = dp/d(A/A0) = (2/3) chi,

        and 8 mu l/(pi r^4) + Z(l) in steady flow.

        Parameters
        ----------
        radius_cm : float
            Of the terminal's end.
        density, viscosity : float
            g/cm3 and g/(cm s).
        omega : array (m,)
            rad/s, 0 or positive.

        Returns
        -------
        complex array (m,)
            dyn s/cm5.
        """
        from scipy.special import jve

        at = np.asarray(omega, dtype=np.float64)
        nodes = self._nodes(radius_cm)
        r = radius_cm * np.array([self.alpha**i * self.beta**j for i, j in nodes])[:, None]
        mu = viscosity * (_relative_viscosity(r) if self.viscosity_by_radius else 1.0) + 0 * r
        slope = 2 / 3 * (self.f1 * np.exp(self.f2 * r) + self.f3)
        w = np.where(at > 0, at, 1.0)
        x = 1j**1.5 * r * np.sqrt(w * density / mu)
        speed = np.sqrt(slope * (1 - 2 * jve(1, x) / (x * jve(0, x))) / density)
        turn, g = np.tan(w * self.length_ratio * r / speed), speed * math.pi * r**2 / slope
        steady = 8 * mu * self.length_ratio / (math.pi * r**3)
        known: dict[tuple[int, int], Complex] = {}
        for n in range(len(nodes) - 1, -1, -1):  # daughters stand after their parents
            i, j = nodes[n]
            end: Complex = np.zeros(len(at), dtype=np.complex128)
            if (i + 1, j) in known and self._bears(float(r[n, 0])):
                end = 1 / (1 / known[i + 1, j] + 1 / known[i, j + 1])
            wave = (1j / g[n] * turn[n] + end) / (1 + 1j * g[n] * end * turn[n])
            known[i, j] = np.where(at > 0, wave, steady[n] + end)
        return known[0, 0]

    def _bears(self, radius_cm: float) -> bool:
        return radius_cm >= self.smallest_radius_cm * (1 - 1e-9)

    def _nodes(self, radius_cm: float) -> list[tuple[int, int]]:
        """Powers of alpha and beta of the vessels, by generation; the same twice stands once."""
        nodes, last = [(0, 0)], [(0, 0)]
        while last:
            bearing = [(i, j) for i, j in last if self._bears(radius_cm * self.alpha**i * self.beta**j)]
            last = list(dict.fromkeys(one for i, j in bearing for one in ((i + 1, j), (i, j + 1))))
            nodes += last
        return nodes


def _relative_viscosity(radius_cm: Array) -> Array:
    """Viscosity of blood at a haematocrit of 0.45 over that in large vessels, by radius."""
    d = 2e4 * radius_cm  # micrometres
    wall = (d / (d - 1.1)) ** 2
    relative = 6 * np.exp(-0.085 * d) + 3.2 - 2.44 * np.exp(-0.06 * d**0.645)
    return np.asarray((1 + (relative - 1) * wall) * wall / 3.2)


@functools.lru_cache(maxsize=256)
def tree_table(
    tree: StructuredTree, radius_cm: float, density: float, viscosity: float, period_s: float
) -> Complex:
    """Impedance of a tree at the harmonics 0 to `HARMONICS` of a beat, read-only; see `StructuredTree`."""
    omega = 2 * math.pi / period_s * np.arange(HARMONICS + 1)
    table = tree.impedance(radius_cm, density, viscosity, omega)
    table.flags.writeable = False
    return table


def response_impedance(cosine: Array, sine: Array, period_s: float, omega: ArrayLike) -> Complex:
    """Impedance of responses exp(-t/tau) sum_m (a_m cos(m w t) + b_m sin(m w t)), w = 2 pi/T.

    Parameters
    ----------
    cosine, sine : array (..., m)
        a and b, dyn/cm5.
    period_s : float
    omega : array (n,)
        rad/s.

    Returns
    -------
    complex array (..., n)
        sum_m (a_m s + b_m m w)/(s^2 + (m w)^2), s = 1/tau + i omega; dyn s/cm5.
    """
    turns = 2 * math.pi / period_s * np.arange(cosine.shape[-1])[:, None]
    fall = 1 / (MEMORY_BEATS * period_s) + 1j * np.asarray(omega, dtype=np.float64)
    return np.asarray(cosine @ (fall / (fall**2 + turns**2)) + sine @ (turns / (fall**2 + turns**2)))


def least_real_part(loads: Array, cosine: Array, sine: Array, period_s: float) -> tuple[float, float]:
    """Where an outlet takes least energy: frequency (Hz) and the real part of its impedance there.

    Looked at sixteen times between harmonics, up to twice the last; beyond, it goes to R1.

    Parameters
    ----------
    loads : array (3,)
        R1, R2 and C.
    cosine, sine : array (m,)
        As `circuit_of` gives them.
    period_s : float
    """
    R1, R2, C = loads
    frequency = np.arange(32 * len(cosine) + 1) / (16 * period_s)
    omega = 2 * math.pi * frequency
    real = R1 + (R2 / (1 + 1j * omega * R2 * C) + response_impedance(cosine, sine, period_s, omega)).real
    least = int(np.argmin(real))
    return float(frequency[least]), float(real[least])


def circuit_of(impedance: ArrayLike, period_s: float) -> tuple[Array, Array, Array]:
    """The nearest Windkessel of an impedance at the harmonics of the beat, and what its response lacks.

    R1 is the mean real part of the upper half of the harmonics, R1 + R2 the steady resistance, and C such
    that R2/(1 + i omega R2 C) has the size of the first harmonic's Z - R1. What is left is met at every
    harmonic by a response.

    Parameters
    ----------
    impedance : complex array (n + 1,)
        At the harmonics 0 to n, dyn s/cm5.
    period_s : float

    Returns
    -------
    array (3,)
        R1, R2 and C, cgs; R2 and C are 0 where no circuit behind R1 is needed.
    array (n + 1,), array (n + 1,)
        a and b, dyn/cm5, of `response_of`.
    """
    Z = np.asarray(impedance, dtype=np.complex128)
    n, omega = len(Z) - 1, 2 * math.pi / period_s
    R1 = float(Z[n // 2 + (n > 0) :].real.mean())
    R2, tau = float(Z[0].real) - R1, 0.0
    if n == 0 or R2 <= 1e-9 * R1:
        R2 = 0.0
    else:
        apart = abs(Z[1] - R1)
        ratio = R2 / apart if apart > 1e-9 * R2 else 1e9
        tau = math.sqrt(max(ratio**2 - 1, _LEAST_TURN**2)) / omega
    left = Z - R1 - R2 / (1 + 1j * omega * tau * np.arange(n + 1))
    return np.array([R1, R2, tau / R2 if R2 else 0.0]), *response_of(left, period_s)


def response_of(impedance: ArrayLike, period_s: float) -> tuple[Array, Array]:
    """Responses that have impedances at the harmonics of the beat, exactly.

        exp(-t/tau) sum_m (a_m cos(m omega t) + b_m sin(m omega t)),   tau = `MEMORY_BEATS` beats,

    whose a and b are those of complex r_m, m = -n to n, with sum_m r_m/(1/tau + i (k - m) omega) = Z_k: a
    system whose matrix has a condition below exp(1/`MEMORY_BEATS`).

    Parameters
    ----------
    impedance : complex array (..., n + 1)
        At the harmonics 0 to n, dyn s/cm5.
    period_s : float

    Returns
    -------
    array (..., n + 1), array (..., n + 1)
        a and b, dyn/cm5.
    """
    Z = np.asarray(impedance, dtype=np.complex128)
    n, omega = Z.shape[-1] - 1, 2 * math.pi / period_s
    m = np.arange(-n, n + 1)
    matrix = 1 / (1 / (MEMORY_BEATS * period_s) + 1j * omega * (m[:, None] - m))
    both = np.concatenate([np.conj(Z[..., :0:-1]), Z], axis=-1)
    r = np.linalg.solve(matrix, both[..., None])[..., n:, 0]
    twice = np.where(np.arange(n + 1) > 0, 2.0, 1.0)
    return twice * r.real, -twice * r.imag
