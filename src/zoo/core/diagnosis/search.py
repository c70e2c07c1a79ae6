"""The search for one hypothesis' mode: damped Gauss-Newton steps, few solves."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

Array = NDArray[np.float64]

CHANGE = 2.0
"""Change of the series by the step of a difference, in units of the noise: of each sample, or, if it is fine,
of all together."""
FIRST_STEP, LEAST_STEP, LEAST_FINE_STEP, LARGEST_STEP = 0.05, 0.01, 1e-4, 0.3
"""Steps of differences in units of the search: where nothing is known, at least, at least of fine ones, at
most."""
TURNED, TURNS = 0.4, 3
"""Part of a step that failed which is tried the other way, and how many steps are tried."""
REACH = 8.0
"""Units of the search that one step moves at most: the linearisation is not trusted further."""
EPSILON = 1e-15
"""Least eigenvalue of a step's equations, in parts of the largest."""
GAIN = 0.02
"""Gain of the log posterior below which a descent ends."""
SETTLED = 0.1
"""Gain below which a search with fresh differences ends."""
ITERATIONS = 6
"""Steps after each fresh differences, where no other number is given."""
DAMPING, NO_DAMPING = 1.0, 1e-9
"""Damping of a search at first, as of a prior one unit wide around where it stands, and none."""
LESS, MORE, MUCH_MORE = 0.2, 8.0, 10.0
"""Factors of the damping after a step that gained, one that did not, and one that could not be solved."""


class Searched(Protocol):
    """What a search needs of a hypothesis: coefficients and prior as functions of its coordinates."""

    low: Array
    high: Array
    units: Array
    last_failure: str

    def __call__(self, u: Array) -> Array | None:
        """Flat coefficients at coordinates; None where the solve failed."""

    def log_prior(self, u: Array) -> float:
        """Log density of the coordinates beforehand."""

    def prior(self, u: Array) -> tuple[Array, Array]:
        """Its precision and pull, as `SearchModel.prior` gives them."""


F = TypeVar("F", bound=Searched)


@dataclass
class Point:
    """Where a search stands."""

    u: Array
    computed: Array  # flat coefficients
    jacobian: Array  # (n, d)
    cost: float = math.inf
    damping: float = DAMPING  # of the next step


class SearchError(RuntimeError):
    """A search that found no point where the solver succeeds."""


class Search(Generic[F]):
    """Gauss-Newton search of one hypothesis' mode, for given errors, with Broyden's updates of the Jacobian.

    Parameters
    ----------
    forward : Searched
    data : array (n,)
        Flat coefficients of the measured series.
    S : array (n,)
        Variances.
    """

    def __init__(self, forward: F, data: Array, S: Array) -> None:
        self.forward, self.data, self.S = forward, data, S

    def cost(self, u: Array, computed: Array) -> float:
        """-log posterior, without constants."""
        r = self.data - computed
        return 0.5 * float(np.sum(r * r / self.S)) - self.forward.log_prior(u)

    def at(self, u: Array, jacobian: Array | None = None) -> Point:
        """A point, with finite differences for its Jacobian unless one is given."""
        computed = self.forward(u)
        if computed is None:
            raise SearchError(self.forward.last_failure)
        point = Point(u, computed, np.zeros((len(computed), len(u))), self.cost(u, computed))
        point.jacobian = self.differences(point, None) if jacobian is None else jacobian
        return point

    def resume(self, point: Point) -> Point:
        """A point of another search, with its cost in this one and the damping of a first step."""
        return replace(point, cost=self.cost(point.u, point.computed), damping=DAMPING)

    def differences(self, point: Point, guess: Array | None, *, fine: bool = False) -> Array:
        """Jacobian by one-sided differences, of steps that change the series by about twice their noise.

        Fine steps change the log-likelihood by about 2: where there are many samples, the posterior is much
        narrower than the noise of one.
        """
        forward, wanted = self.forward, CHANGE if fine else CHANGE * math.sqrt(float(len(self.S)))
        least = LEAST_FINE_STEP if fine else LEAST_STEP
        columns = []
        for i, unit in enumerate(forward.units):
            step = FIRST_STEP * unit
            if guess is not None:
                size = math.sqrt(float(np.sum(guess[:, i] ** 2 / self.S)))
                most = LARGEST_STEP * unit
                step = float(np.clip(wanted / size, least * unit, most)) if size > 0 else most
            room = (forward.low[i] - point.u[i], forward.high[i] - point.u[i])
            if step > room[1]:
                step = max(-step, room[0])
            moved = None
            for _ in range(TURNS):
                u = point.u.copy()
                u[i] += step
                if (moved := forward(u)) is not None:
                    break
                turned = float(np.clip(-TURNED * step, *room))
                step = turned if turned else TURNED * step
            if moved is None:
                columns.append(np.zeros_like(point.computed) if guess is None else guess[:, i])
            else:
                columns.append((moved - point.computed) / step)
        return np.stack(columns, axis=1)

    def step(self, point: Point, damping: float) -> Array:
        """A step that ends inside the bounds, damped in units of the search.

        How far a linearisation holds depends on how far the parameters move, not on how well the data tell
        them: Levenberg's damping follows a curved valley in which Marquardt's, in parts of the information,
        stops.
        """
        forward = self.forward
        precision, pull = forward.prior(point.u)
        scaled = point.jacobian / self.S[:, None]
        H = point.jacobian.T @ scaled + as_matrix(precision)
        b = scaled.T @ (self.data - point.computed) - pull
        H += np.diag((damping + NO_DAMPING) / forward.units**2)
        step, free, units = np.zeros(len(b)), forward.low < forward.high, forward.units
        low, high = ((end - point.u)[free] / units[free] for end in (forward.low, forward.high))
        values, vectors = np.linalg.eigh((H * np.outer(units, units))[np.ix_(free, free)])
        size = np.sqrt(np.maximum(values, EPSILON * values.max(initial=0.0)))
        right = vectors.T @ (b * units)[free] / size
        found = vectors @ (right / size)
        if np.any((found < low) | (found > high)):
            found = np.clip(
                lsq_linear(size[:, None] * vectors.T, right, (low, high), method="bvls").x, low, high
            )
        step[free] = found * units[free]
        # the linearisation is not trusted far away
        reach = float(np.max(np.abs(step) / forward.units))
        return step * min(1.0, REACH / reach) if reach > 0 else step

    def promised(self, point: Point) -> float:
        """Gain of the log posterior that the Jacobian still promises."""
        step = self.step(point, NO_DAMPING)
        return point.cost - self.cost(point.u + step, point.computed + point.jacobian @ step)

    def descend(self, point: Point, iterations: int, gain: float = GAIN) -> Point:
        """Damped steps with Broyden's updates until one without damping promises less than `gain`.

        One that gains nothing is bent along the valley by what the solve changed beyond its linear part: the
        geodesic acceleration of Transtrum and Sethna (2012, arXiv 1201.5885).
        """
        for _ in range(iterations):
            while True:  # damped too much to gain anything is not yet the end
                step = self.step(point, point.damping)
                u, linear = point.u + step, point.computed + point.jacobian @ step
                hoped = point.cost - self.cost(u, linear)
                if hoped >= gain or point.damping < NO_DAMPING:
                    break
                point = replace(point, damping=LESS * point.damping)
            if hoped < gain:
                break
            computed = self.forward(u)
            if computed is None:
                point = replace(point, damping=max(MUCH_MORE * point.damping, DAMPING))
                continue
            cost = self.cost(u, computed)
            if cost > point.cost:  # once more, with what it changed beyond the linear part
                bent = self.step(replace(point, computed=point.computed + computed - linear), point.damping)
                if (there := self.forward(point.u + bent)) is not None:
                    step, u, computed, cost = bent, point.u + bent, there, self.cost(point.u + bent, there)
                    linear = point.computed + point.jacobian @ step
            if cost - point.cost > hoped:  # so far from linear that a secant would mislead
                point = replace(point, damping=max(MORE * point.damping, DAMPING))
                continue
            t = step / self.forward.units
            jacobian = point.jacobian + np.outer(computed - linear, t / self.forward.units) / float(t @ t)
            if cost < point.cost:
                point = Point(u, computed, jacobian, cost, LESS * point.damping)
            else:
                point = replace(point, jacobian=jacobian, damping=max(MORE * point.damping, DAMPING))
        return point

    def refine(self, point: Point, rounds: int, iterations: int = ITERATIONS, *, fine: bool = False) -> Point:
        """Fresh Jacobians and descents until one gains nothing; if `fine`, by fine steps after the first.

        It ends with derivatives made where it ends, or within what gained nothing from there: secants of the
        smallest steps follow the noise of a grid that is chosen anew for each solve.
        """
        for i in range(rounds):
            finer = fine and i > 0
            jacobian = self.differences(point, point.jacobian, fine=finer)
            moved = self.descend(replace(point, jacobian=jacobian), iterations)
            settled = point.cost - moved.cost < SETTLED
            point = replace(moved, jacobian=jacobian) if settled else moved
            if settled and finer == fine:
                return point
        return replace(point, jacobian=self.differences(point, point.jacobian, fine=fine))


def as_matrix(precision: Array) -> Array:
    """A precision (d, d) from its diagonal (d,), or as it is."""
    return np.diag(precision) if precision.ndim == 1 else precision
