"""Functions inside the solver that are given by their values: of stretch, velocity, pressure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from zoo.blood.solve_errors import SolverArgumentError
from zoo.core.arrays import Array, finite_array, real_number, refuse_where

FEWEST_KNOTS, MOST_KNOTS = 4, 4096
LEAST_STRETCH = 1e-3
_MOST = 1e30
_NARROWEST = 1e-9


@dataclass(frozen=True)
class KnotFunction:
    """A cubic spline through values at evenly spaced knots, with a continuous second derivative.

    Its slopes at both ends are those of the cubics through the four values there, so that it misses a smooth
    function by O(h^4), h the distance of the knots, and a cubic not at all.

    Parameters
    ----------
    low, high : float
        First and last knot.
    values : array (n_knots,)
        At least 4; kept as a tuple.

    Raises
    ------
    SolverArgumentError
        If a value is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> bend = WallFunction(0.9, 1.4, 0.1 * (np.linspace(0.9, 1.4, 12) - 1) ** 2)
    >>> round(float(bend(1.25)), 6)
    0.00625
    """

    low: float
    high: float
    values: Sequence[float] | Array

    least_low: ClassVar[float] = -_MOST
    least: ClassVar[float] = -_MOST
    most: ClassVar[float] = _MOST
    nothing_is: ClassVar[float] = 0.0
    goes_on: ClassVar[str] = "straight"
    """Beyond the knots: "straight", "constant", or below them straight "in the area", the square of x."""

    def __post_init__(self) -> None:
        name, error = type(self).__name__, SolverArgumentError
        low = real_number(f"{name}: low", self.low, error=error)
        high = real_number(f"{name}: high", self.high, error=error)
        values = finite_array(f"{name}: values", np.asarray(self.values), error=error)
        if not self.least_low <= low <= _MOST:
            words = f"between {self.least_low:g} and {_MOST:g}"
            raise error(f"{name}: low = {low}: must be {words}; correct it")
        if not (high - low > max(_NARROWEST * (abs(low) + abs(high)), 1 / _MOST) and high <= _MOST):
            raise error(f"{name}: high = {high}: must be above low = {low}, at most {_MOST:g}; correct it")
        if not FEWEST_KNOTS <= len(values) <= MOST_KNOTS:
            raise error(
                f"{name}: {len(values)} values: must be {FEWEST_KNOTS} to {MOST_KNOTS}, one for each knot; "
                "give others"
            )
        words = f"between {self.least:g} and {self.most:g}"
        outside = (values < self.least) | (values > self.most)
        refuse_where(f"{name}: values", values, outside, words, error=error)
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)
        object.__setattr__(self, "values", tuple(values.tolist()))

    @property
    def knots(self) -> Array:
        """Where the values are, (n_knots,)."""
        return np.linspace(self.low, self.high, len(self.values))

    @property
    def changes(self) -> bool:
        """Whether a solve with it differs from one without."""
        return any(value != self.nothing_is for value in self.values)

    def beside(self, old: Self | None, knots: int) -> Self:
        """The sum of this function and another, if there is one, at so many knots of both ranges."""
        if old is None or not old.changes:
            return self
        at = np.linspace(min(old.low, self.low), max(old.high, self.high), knots)
        return type(self)(float(at[0]), float(at[-1]), tuple(old(at) + self(at)))

    def __call__(self, x: ArrayLike) -> Array:
        """Value at x, of the shape of x; beyond the knots as the solver continues it."""
        return self._evaluated(np.asarray(x, dtype=np.float64), 0)

    def slope(self, x: ArrayLike) -> Array:
        """Derivative at x, of the shape of x."""
        return self._evaluated(np.asarray(x, dtype=np.float64), 1)

    def _evaluated(self, x: Array, order: int) -> Array:
        from scipy.interpolate import CubicSpline

        v, h = np.array(self.values), (self.high - self.low) / (len(self.values) - 1)
        ends = np.array([-11.0, 18.0, -9.0, 2.0]) / (6 * h)
        first, last = float(ends @ v[:4]), float(-(ends @ v[:-5:-1]))
        spline = CubicSpline(self.knots, v, bc_type=((1, first), (1, last)))
        inner = np.clip(x, self.low, self.high)
        found, beyond = np.asarray(spline(inner, order)), x != inner
        slope = np.where(x < inner, first, last) * (self.goes_on != "constant")
        step, turn = x - inner, np.ones_like(x)
        if self.goes_on == "in the area":
            step = np.where(x < inner, (x**2 - inner**2) / (2 * inner), step)
            turn = np.where(x < inner, x / inner, turn)
        return np.where(beyond, slope * turn if order else found + slope * step, found)


@dataclass(frozen=True)
class WallFunction(KnotFunction):
    """What is added to the law of every wall, as a function of the stretch.

        p = K (law(a) + delta(s)),   s = sqrt(a),   a = A/A0,

    K the law's scale of each vessel's stiffness: (4/3) chi of the linear wall, k chi of the tangent wall. The
    function goes on below its knots linearly in a, above them linearly in s: a law that rises with the area
    between them does beyond.

    Parameters
    ----------
    low, high : float
        First and last knot, stretch; `low` at least 0.001.
    values : array (n_knots,)
        delta, dimensionless. With them every vessel's pressure must rise with its area, by a hundredth of
        what it does without them or more; otherwise a solve fails with `zoo.blood.solver.WallFallsError`.

    Raises
    ------
    SolverArgumentError
        If a value is out of range.
    """

    least_low: ClassVar[float] = LEAST_STRETCH
    goes_on: ClassVar[str] = "in the area"


@dataclass(frozen=True)
class FrictionFunction(KnotFunction):
    """Factor of the friction in all vessels, as a function of the blood's speed.

        -f q/A becomes -phi(abs(u)) f q/A,   u = q/A,   f = 2 pi nu r/delta + k pi nu,

    constant beyond the knots.

    Parameters
    ----------
    low, high : float
        First and last knot, cm/s; `low`, mostly 0, not negative.
    values : array (n_knots,)
        phi, dimensionless, not negative.

    Raises
    ------
    SolverArgumentError
        If a value is out of range.
    """

    least_low: ClassVar[float] = 0.0
    least: ClassVar[float] = 0.0
    nothing_is: ClassVar[float] = 1.0
    goes_on: ClassVar[str] = "constant"


@dataclass(frozen=True)
class JunctionFunction(KnotFunction):
    """Pressure that is lost at every junction, as a function of the velocity there.

    Each daughter's inlet has D(u) less pressure than the parent's end, u = q/A the velocity of the parent's
    end; straight on beyond the knots.

    Parameters
    ----------
    low, high : float
        First and last knot, cm/s; `low` is negative where blood may flow back.
    values : array (n_knots,)
        D, dyn/cm2, of either sign.

    Raises
    ------
    SolverArgumentError
        If a value is out of range.
    """


@dataclass(frozen=True)
class OutletFunction(KnotFunction):
    """Change of all outlets' resistances, or compliances, with the pressure behind R1.

        R2 becomes R2 exp(f(v)),   or C becomes C exp(f(v)),   C dv/dt = q - (v - p_out)/R2,

    v the pressure (behind outlets of several sections that of all together); constant beyond the knots.

    Parameters
    ----------
    low, high : float
        First and last knot, dyn/cm2.
    values : array (n_knots,)
        f, the logarithm of a factor, between -30 and 30.

    Raises
    ------
    SolverArgumentError
        If a value is out of range.
    """

    least: ClassVar[float] = -30.0
    most: ClassVar[float] = 30.0
    goes_on: ClassVar[str] = "constant"
