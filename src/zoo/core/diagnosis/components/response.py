"""What free functions of a simulator's components do to its series: derivatives at the baseline's mode."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from zoo.core.components import FreeFunction
from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.hypothesis import HypothesisModel
from zoo.core.diagnosis.screening import Screening
from zoo.core.diagnosis.search import Point, Search
from zoo.core.errors.spectral import GroupErrors, Spectral
from zoo.core.forward import SolveError, pinned

Array = NDArray[np.float64]

RESOLVED = 1e-4
"""Part of the largest variance of a function's shortest length below which a direction is not differenced."""
DIFFERENCE = 0.05
"""First step of a difference along a direction, in its prior sd where the function has its `size`."""
SHORTEST, LONGEST = 1e-3, 0.3
"""Steps of differences at least and at most, in the same unit."""
HEARD, LOUD = 0.5, 4.0
"""Rms change of the coefficients by a step, in units of the noise, within which the step is kept."""
STRAIGHT = 0.1
"""Difference between a response and that of the opposite step, in parts of it, that is taken for linear."""
RETREAT = (1.0, -1.0, 0.2, -0.2)
"""Parts of a step that are tried one after the other where the solve fails."""


@dataclass(frozen=True, eq=False)
class Block:
    """The responses of the series to one free function.

    `columns` (n, n_points) are derivatives of the flat coefficients by the function's values; `bent` is by
    how much, in parts, the response to one prior standard deviation of its strongest direction differs from
    that to the opposite; `failed` counts the directions along which nothing could be solved, whose
    derivatives are 0.
    """

    function: FreeFunction
    columns: Array = field(repr=False)
    bent: float = 0.0
    failed: int = 0

    @property
    def name(self) -> str:
        """Of the function."""
        return self.function.name


@dataclass(frozen=True, eq=False)
class Linearised:
    """The baseline beside free functions, linear around the baseline's mode.

    residual = J d + sum X_b v_b + e, all flat coefficients; the prior density of d is
    exp(-d'P d/2 - pull'd).

    Parameters
    ----------
    residual : array (n,)
        Measured minus computed.
    jacobian : array (n, d)
        By the search's coordinates of the baseline.
    precision : array (d,) or (d, d)
        P.
    pull : array (d,)
    errors : Spectral
        Bound to the data.
    noise : mapping of group to GroupErrors
        In whose units steps of differences were chosen.
    blocks : tuple of Block
    """

    residual: Array = field(repr=False)
    jacobian: Array = field(repr=False)
    precision: Array = field(repr=False)
    pull: Array = field(repr=False)
    errors: Spectral
    noise: Mapping[str, GroupErrors]
    blocks: tuple[Block, ...]

    @property
    def components(self) -> dict[str, tuple[Block, ...]]:
        """Blocks of each component, in the order in which they were given."""
        names = dict.fromkeys(b.function.component for b in self.blocks)
        return {name: tuple(b for b in self.blocks if b.function.component == name) for name in names}

    def block(self, name: str) -> Block:
        """That of a function by name."""
        return next(b for b in self.blocks if b.name == name)


def on_a_grid(screening: Screening, fit: Fit) -> HypothesisModel:
    """The hypothesis of a fit at the discretisation that its solve takes, so that it is one smooth function.

    Parameters
    ----------
    screening : Screening
    fit : Fit

    Returns
    -------
    HypothesisModel

    Raises
    ------
    SolveError
        If it cannot be solved there.
    """
    grid = pinned(screening.baseline, fit.forward.model.configure(fit.values))
    forward = HypothesisModel(grid, fit.hypothesis, screening.errors)
    screening.forwards.append(forward)
    return forward


class _Differences:
    """Solves of one function around a baseline, and steps whose changes are seen beside the noise."""

    def __init__(self, forward: HypothesisModel, at: Array, base: Array, S: Array) -> None:
        self.forward, self.at, self.base, self.S = forward, at, base, S

    def __call__(self, function: FreeFunction, values: Array) -> Array | None:
        """Change of the coefficients (n,) by the function's values, or None where the solve failed."""
        forward, model = self.forward, self.forward.model
        forward.solves += 1
        try:
            configuration = model.configure(forward.theta(self.at))
            series = model.solve(function.apply(configuration, values))
        except SolveError:
            forward.failures += 1
            return None
        return np.asarray(forward.errors.flat(series) - self.base)

    def heard(self, change: Array) -> float:
        """Rms of a change in units of the noise."""
        return math.sqrt(float(np.mean(change**2 / self.S)))

    def along(self, function: FreeFunction, direction: Array) -> tuple[Array, float] | None:
        """Derivative along a direction of one prior sd, and the step it was taken with."""
        step, found = DIFFERENCE, None
        for part in RETREAT:
            change = self(function, part * step * direction)
            if change is not None:
                step, found = part * step, change
                break
        if found is None:
            return None
        heard = self.heard(found)
        if not HEARD <= heard <= LOUD:
            wanted = math.copysign(float(np.clip(abs(step) / max(heard, 1e-12), SHORTEST, LONGEST)), step)
            if (again := self(function, wanted * direction)) is not None:
                step, found = wanted, again
        return found / step, step

    def opposite(self, function: FreeFunction, direction: Array, step: float) -> Array | None:
        """Derivative along a direction with the opposite step."""
        change = self(function, -step * direction)
        return None if change is None else change / -step


def _directions(function: FreeFunction) -> Array:
    """Directions (n_points, m) of one prior sd each, of the function's shortest length."""
    root = function.root(min(function.lengths) if function.lengths else None)
    size = np.sum(root**2, axis=0)
    return np.asarray(function.size * root[:, size > RESOLVED * size.max()])


def linearise(
    screening: Screening,
    fit: Fit,
    functions: Sequence[FreeFunction],
    noise: Mapping[str, GroupErrors],
    *,
    cores: int = 2,
    tick: Callable[[str, float], None] | None = None,
    forward: HypothesisModel | None = None,
) -> Linearised:
    """Derivatives of the series by the values of free functions, at a fit of the baseline.

    They are differences along the directions that the prior of each function allows at its shortest length,
    of solves whose discretisation is kept, one-sided where the response of the strongest direction is
    straight, else central.

    Parameters
    ----------
    screening : Screening
    fit : Fit
        The baseline at its mode.
    functions : sequence of FreeFunction
    noise : mapping of group to GroupErrors
        Steps change the series by about as much.
    cores : int
        Threads.
    tick : callable, optional
        Called with a text and the share done.
    forward : HypothesisModel, optional
        As of `on_a_grid`, which makes it if absent.

    Returns
    -------
    Linearised

    Raises
    ------
    SolveError
        If the baseline cannot be solved at the fit.
    """
    forward = forward or on_a_grid(screening, fit)
    base = forward(fit.u)
    if base is None:
        raise SolveError(forward.last_failure)
    solve = _Differences(forward, fit.u, base, screening.beside(noise, screening.numerics()))
    jobs = [(f, direction) for f in functions for direction in _directions(f).T]

    def one(job: tuple[FreeFunction, Array]) -> tuple[Array, float] | None:
        return solve.along(*job)

    def other(job: tuple[FreeFunction, Array, float]) -> Array | None:
        return solve.opposite(*job)

    found: list[tuple[Array, float] | None] = []
    with ThreadPoolExecutor(max(1, cores)) as pool:
        for done, (job, result) in enumerate(zip(jobs, pool.map(one, jobs), strict=True), 1):
            if tick is not None:
                tick(job[0].component, done / len(jobs))
            found.append(result)
        blocks = []
        for f in functions:
            part = [(d, r) for (g, d), r in zip(jobs, found, strict=True) if g is f]
            solved = [(d, *r) for d, r in part if r is not None]
            bent = 0.0
            derivatives = [x for _, x, _ in solved]
            if solved:
                strongest = max(range(len(solved)), key=lambda i: solve.heard(solved[i][1]))
                direction, forwards, step = solved[strongest]
                backwards = solve.opposite(f, direction, step)
                size = float(np.linalg.norm(forwards)) or 1.0
                apart = math.inf if backwards is None else float(np.linalg.norm(forwards - backwards)) / size
                bent = apart / abs(step)
                if apart > STRAIGHT:
                    both = pool.map(other, [(f, d, step) for d, _, step in solved])
                    derivatives = [
                        x if y is None else 0.5 * (x + y) for x, y in zip(derivatives, both, strict=True)
                    ]
            columns = np.zeros((len(base), len(f.at)))
            if solved:  # derivatives along directions that are orthogonal to each other
                D = np.stack([d for d, _, _ in solved], axis=1)
                columns = np.stack(derivatives, axis=1) @ np.linalg.pinv(D)
            blocks.append(Block(f, columns, bent, len(part) - len(solved)))
    _, precision, pull = fit.forward.prior(fit.u)
    return Linearised(
        screening.coefficients - fit.computed,
        _jacobian(forward, fit, base, solve.S),
        precision,
        pull,
        screening.errors,
        dict(noise),
        tuple(blocks),
    )


def _jacobian(forward: HypothesisModel, fit: Fit, base: Array, S: Array) -> Array:
    """The fit's own, by differences on the grid that is kept."""
    return Search(forward, base, S).differences(Point(fit.u, base, fit.jacobian), fit.jacobian)
