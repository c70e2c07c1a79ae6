"""The search for one hypothesis' mode: damped Gauss-Newton steps, few solves."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Searched(Protocol):
    """What a search needs of a hypothesis: coefficients and prior as functions of its coordinates."""

    low: Array
    high: Array
    units: Array
    last_failure: str

    def __call__(self, u: Array) -> Array | None: ...

    def prior(self, u: Array) -> tuple[float, Array, Array]: ...


F = TypeVar("F", bound=Searched)


class Solved(Protocol):
    """A point that was solved with its Jacobian, such as a fit."""

    @property
    def u(self) -> Array: ...

    @property
    def computed(self) -> Array: ...

    @property
    def jacobian(self) -> Array: ...


@dataclass
class Point:
    """Where a search stands."""

    u: Array
    computed: Array  # flat coefficients
    jacobian: Array  # (n, d)
    cost: float = math.inf


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
        return 0.5 * float(np.sum(r * r / self.S)) - self.forward.prior(u)[0]

    def at(self, u: Array, jacobian: Array | None = None) -> Point:
        """A point, with finite differences for its Jacobian unless one is given."""
        computed = self.forward(u)
        if computed is None:
            raise SearchError(self.forward.last_failure)
        point = Point(u, computed, np.zeros((len(computed), len(u))), self.cost(u, computed))
        point.jacobian = self.differences(point, None) if jacobian is None else jacobian
        return point

    def resume(self, point: Solved) -> Point:
        """A point (or a fit) of another search, with its cost in this one."""
        return Point(point.u, point.computed, point.jacobian, self.cost(point.u, point.computed))

    def differences(self, point: Point, guess: Array | None, *, fine: bool = False) -> Array:
        """Jacobian by one-sided differences, of steps that change the series by about twice their noise.

        Fine steps change the log-likelihood by about 2: where there are many samples, the posterior is much
        narrower than the noise of one.
        """
        forward, wanted = self.forward, 2.0 if fine else 2.0 * math.sqrt(float(len(self.S)))
        least = 1e-4 if fine else 0.01
        columns = []
        for i, unit in enumerate(forward.units):
            step = 0.05 * unit
            if guess is not None:
                size = math.sqrt(float(np.sum(guess[:, i] ** 2 / self.S)))
                step = float(np.clip(wanted / size, least * unit, 0.3 * unit)) if size > 0 else 0.3 * unit
            room = (forward.low[i] - point.u[i], forward.high[i] - point.u[i])
            if step > room[1]:
                step = max(-step, room[0])
            moved = None
            for _ in range(3):
                u = point.u.copy()
                u[i] += step
                if (moved := forward(u)) is not None:
                    break
                turned = float(np.clip(-0.4 * step, *room))
                step = turned if turned else 0.4 * step
            if moved is None:
                columns.append(np.zeros_like(point.computed) if guess is None else guess[:, i])
            else:
                columns.append((moved - point.computed) / step)
        return np.stack(columns, axis=1)

    def _step(self, point: Point, damping: float) -> Array:
        """A damped step that ends inside the bounds."""
        forward = self.forward
        _, precision, pull = forward.prior(point.u)
        scaled = point.jacobian / self.S[:, None]
        H = point.jacobian.T @ scaled + as_matrix(precision)
        b = scaled.T @ (self.data - point.computed) - pull
        H += np.diag(damping * np.diag(H) + 1e-9 / forward.units**2)
        fixed = np.zeros(len(b), bool)
        step = np.zeros(len(b))
        for _ in range(len(b) + 1):
            free = ~fixed
            if not free.any():
                break
            step[free] = np.linalg.solve(
                H[np.ix_(free, free)], b[free] - H[np.ix_(free, fixed)] @ step[fixed]
            )
            aim = point.u + step
            out = free & ((aim < forward.low) | (aim > forward.high))
            if not out.any():
                break
            step[out] = np.clip(aim, forward.low, forward.high)[out] - point.u[out]
            fixed |= out
        # the linearisation is not trusted far away
        reach = float(np.max(np.abs(step) / forward.units))
        return step * min(1.0, 8.0 / reach) if reach > 0 else step

    def descend(self, point: Point, iterations: int, gain: float = 0.02, damping: float = 1e-3) -> Point:
        """Damped steps with Broyden's updates until one gains less than `gain`."""
        for _ in range(iterations):
            step = self._step(point, damping)
            if float(np.max(np.abs(step) / self.forward.units)) < 1e-5:
                break
            u = point.u + step
            computed = self.forward(u)
            if computed is None:
                damping = max(10.0 * damping, 0.01)
                continue
            cost = self.cost(u, computed)
            linear = point.computed + point.jacobian @ step
            hoped = point.cost - self.cost(u, linear)
            if cost - point.cost > hoped:  # so far from linear that a secant would mislead
                damping = max(8.0 * damping, 1e-3)
                continue
            t = step / self.forward.units
            jacobian = point.jacobian + np.outer(computed - linear, t / self.forward.units) / float(t @ t)
            if cost < point.cost:
                small = point.cost - cost < gain
                point = Point(u, computed, jacobian, cost)
                damping *= 0.2
                if small:
                    break
            else:
                point = replace(point, jacobian=jacobian)
                if hoped < gain:
                    break
                damping = max(8.0 * damping, 1e-3)
                if damping > 1e4:
                    break
        return point

    def refine(self, point: Point, rounds: int = 3, iterations: int = 6, *, fine: bool = False) -> Point:
        """Fresh Jacobians and descents until one gains nothing; then, if `fine`, the same with fine steps."""
        for _ in range(rounds):
            before = point.cost
            point = replace(point, jacobian=self.differences(point, point.jacobian))
            point = self.descend(point, iterations, damping=1e-9)  # damping would stop it on a ridge
            if before - point.cost < 0.1:
                break
        for _ in range(rounds if fine else 0):
            jacobian = self.differences(point, point.jacobian, fine=True)
            moved = self.descend(replace(point, jacobian=jacobian), iterations, damping=1e-9)
            if point.cost - moved.cost < 0.1:
                break
            point = moved
        return point


def as_matrix(precision: Array) -> Array:
    """A precision (d, d) from its diagonal (d,), or as it is."""
    return np.diag(precision) if precision.ndim == 1 else precision
