"""Components as explanations: the best of their functions, taken to its mode with the simulator itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from zoo.core.components import FreeFunction
from zoo.core.diagnosis.components.response import Block, Linearised, linearise, on_a_grid
from zoo.core.diagnosis.components.weighing import Weighed, allowance, something_else, weigh
from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.hypothesis import Hypothesis, HypothesisModel
from zoo.core.diagnosis.screening import PRIOR_NONPARAMETRIC, Screened
from zoo.core.diagnosis.search import Search, SearchError, as_matrix

Array = NDArray[np.float64]

LEADING = 10.0
"""Log evidence behind the best explanation within which a function is taken to its mode."""
WITH_MORE, MORE_TURNS = 2, 2
"""Functions of a component that are weighed with something else beside them, and turns of their noise."""
MOST_REFINED = 6
"""Functions that are at most, besides the best one of each component."""
STEPS_LINEAR, STEPS_FRESH = 6, 5
"""Steps of a descent with the baseline's derivatives, and of one with fresh ones."""
NEARER = (1.0, 0.5, 0.2)
"""Parts of the linear model's step from which a descent begins."""


@dataclass(frozen=True, eq=False)
class Kind:
    """One free function as an explanation: its evidence, and the fit at its best size and length.

    `weighed` is the function beside the allowance, `more` beside something else, a free discrepancy; `fit` is
    of the first, which leaves as little as it can. Its last coordinates are standard normal, and `root` makes
    the function's values of them: of the size and length from which the fit began.
    """

    weighed: Weighed
    fit: Fit
    root: Array = field(repr=False)
    more: Weighed | None = None
    refined: bool = False

    @property
    def log_z(self) -> float:
        """Log evidence of the function alone or with something else, weighed by the prior of that."""
        return max(self.weighed.log_z, _beside(self.more))

    @property
    def learned(self) -> Weighed:
        """What was learned of the function: alone, or beside something else where that is more probable."""
        return self.more if self.more and _beside(self.more) > self.weighed.log_z else self.weighed

    @property
    def function(self) -> FreeFunction:
        """What is free."""
        return self.weighed.function


def _root(weighed: Weighed) -> Array:
    """From standard normal weights to values, of the most probable size and length."""
    return weighed.best.sd * weighed.function.root(weighed.best.length)


def around_mode(block: Block, root: Array, jacobian: Array, z: Array) -> tuple[Block, Array]:
    """Responses around a function's mode z (n_z,), and what its values v, seen from 0, give there, (n,).

    Where the root spans v they are those of the fit's `jacobian` (n, n_z), elsewhere as they were.
    """
    known, v = np.linalg.pinv(root), root @ z
    columns = jacobian @ known + block.columns @ (np.eye(len(v)) - root @ known)
    return replace(block, columns=columns), columns @ v


def best_of_each(kinds: Sequence[Kind]) -> dict[str, int]:
    """Where the function with the largest evidence of each component is, by the component's name."""
    found: dict[str, int] = {}
    for i, kind in enumerate(kinds):
        name = kind.function.component
        if name not in found or kind.log_z > kinds[found[name]].log_z:
            found[name] = i
    return found


def _beside(more: Weighed | None) -> float:
    return -math.inf if more is None else more.log_z + math.log(PRIOR_NONPARAMETRIC)


@dataclass(frozen=True, eq=False)
class Component:
    """A component of the simulator as an explanation; its functions are equally likely beforehand."""

    name: str
    kinds: tuple[Kind, ...]

    @property
    def log_z(self) -> float:
        """Log evidence, the mean over its functions."""
        return float(logsumexp([k.weighed.log_z for k in self.kinds])) - math.log(len(self.kinds))

    @property
    def log_more(self) -> float:
        """The same with something else beside it."""
        found = [k.more.log_z for k in self.kinds if k.more]
        return float(logsumexp(found)) - math.log(len(self.kinds)) if found else -math.inf

    @property
    def log_evidence(self) -> float:
        """Both, weighed by the prior of something else."""
        both = np.array([self.log_z, self.log_more + math.log(PRIOR_NONPARAMETRIC)])
        return float(logsumexp(both)) - math.log(1.0 + PRIOR_NONPARAMETRIC)

    @property
    def best(self) -> Kind:
        """The function with the largest evidence."""
        return max(self.kinds, key=lambda k: k.log_z)


@dataclass(frozen=True, eq=False)
class Explained:
    """All components beside one screening, and the linear model of the simulator that they share."""

    linearised: Linearised
    components: Mapping[str, Component]


class Refining:
    """Free functions beside one baseline fit, weighed linearly and then with the simulator.

    Parameters
    ----------
    screened : Screened
    functions : sequence of FreeFunction
    cores : int
    base : Fit, optional
        What they stand beside: the fit of another function on a grid that is kept; the baseline's if absent.
    tick : callable, optional
        Called with a text and the share done.
    """

    def __init__(
        self,
        screened: Screened,
        functions: Sequence[FreeFunction],
        *,
        cores: int = 2,
        base: Fit | None = None,
        tick: Callable[[str, float], None] | None = None,
    ) -> None:
        self.screened, self.screening = screened, screened.screening
        self.base = base or screened.base
        self.grid = base.forward if base else on_a_grid(self.screening, self.base)
        self.linearised = linearise(
            self.screening, self.base, functions, screened.noise, cores=cores, tick=tick, forward=self.grid
        )
        computed = self.grid(self.base.u)
        assert computed is not None
        self.shift = self.base.computed - computed
        """What the series of the fit's own discretisation have more than those of the kept one."""

    def kind(self, block: Block) -> Kind:
        """One function by the linear model."""
        s = self.screened
        alone = allowance(s.allowances)
        weighed = weigh(self.linearised, block, self.base.forward, self.base.u, s.noise, alone)
        return Kind(weighed, self.fit(weighed), _root(weighed))

    def with_more(self, kind: Kind) -> Kind:
        """The same with something else beside it weighed too."""
        linear, noise = self.linearised, kind.weighed.noise
        options = something_else(self.screening.errors)
        more = weigh(linear, kind.weighed.block, self.base.forward, self.base.u, noise, options, MORE_TURNS)
        return replace(kind, more=more)

    def fit(self, weighed: Weighed) -> Fit:
        """A function's best size and length as a fit of the linear model."""
        cell, block, linear, base = weighed.best, weighed.block, self.linearised, self.base
        effect = weighed.function.effect(cell.sd, cell.length)
        root = _root(weighed)
        forward = HypothesisModel(
            self.grid.baseline, Hypothesis((*self.base.hypothesis.added, effect)), self.screening.errors
        )
        z = np.linalg.pinv(root) @ cell.mean
        u = np.clip(np.concatenate([base.u + cell.step, z]), forward.low, forward.high)
        jacobian = np.concatenate([linear.jacobian, block.columns @ root], axis=1)
        computed = base.computed + jacobian @ (u - np.concatenate([base.u, np.zeros(len(z))]))
        return self._as_fit(forward, u, computed, jacobian, weighed)

    def _as_fit(
        self, forward: HypothesisModel, u: Array, computed: Array, jacobian: Array, weighed: Weighed
    ) -> Fit:
        residual = self.screening.coefficients - computed
        S = self.screening.errors.variances(weighed.noise)
        H = jacobian.T @ (jacobian / S[:, None]) + as_matrix(forward.prior(u)[1])
        size = np.sqrt(np.diag(H))
        covariance = np.linalg.inv(H / np.outer(size, size)) / np.outer(size, size)
        return Fit(
            forward.hypothesis, forward, u, computed, jacobian, residual, weighed.noise,
            dict(self.screened.allowances), weighed.log_z, u, covariance,
        )  # fmt: skip

    def refine(self, kind: Kind) -> Kind:
        """A function taken to its mode by Gauss-Newton steps of the simulator, and weighed again there.

        Where nothing can be solved on the way, the linear model stands, and the kind is as it was.
        """
        fit, weighed = kind.fit, kind.weighed
        forward = fit.forward
        self.screening.forwards.append(forward)
        S = self.screening.errors.variances(weighed.noise)
        search = Search(forward, self.screening.coefficients - self.shift, S)
        origin = np.concatenate([self.base.u, np.zeros(len(fit.u) - len(self.base.u))])
        best = None
        for part in NEARER:
            try:
                point = search.at(origin + part * (fit.u - origin), fit.jacobian)
            except SearchError:
                continue
            if best is None or point.cost < best.cost:
                best = point
        if best is None:
            return replace(kind, refined=True)
        point = search.descend(best, STEPS_LINEAR)
        point = replace(point, jacobian=search.differences(point, point.jacobian))
        point = search.descend(point, STEPS_FRESH)
        # around the mode the series are linear again, with v seen from 0
        n = len(self.base.u)
        block, drawn = around_mode(weighed.block, kind.root, point.jacobian[:, n:], point.u[n:])
        computed = point.computed + self.shift
        _, precision, pull = self.base.forward.prior(point.u[:n])
        linear = replace(
            self.linearised,
            residual=self.screening.coefficients - computed + drawn,
            jacobian=point.jacobian[:, :n],
            precision=precision,
            pull=pull,
        )
        baseline = self.base.forward
        options = allowance(self.screened.allowances)
        alone = weigh(linear, block, baseline, point.u[:n], kind.weighed.noise, options)
        more = kind.more and weigh(
            linear, block, baseline, point.u[:n], kind.more.noise, something_else(self.screening.errors),
            MORE_TURNS,
        )  # fmt: skip
        found = replace(kind, weighed=alone, more=more, refined=True)
        return replace(found, fit=self._as_fit(forward, point.u, computed, point.jacobian, alone))


def explain(
    screened: Screened,
    functions: Sequence[FreeFunction],
    *,
    cores: int = 2,
    tick: Callable[[str, float], None] | None = None,
) -> Explained:
    """Evidence of every component by its free functions, the leading ones with the simulator itself.

    Parameters
    ----------
    screened : Screened
        Whose baseline, noise and allowances are taken.
    functions : sequence of FreeFunction
    cores : int
    tick : callable, optional
        Called with a text and the share done.

    Returns
    -------
    Explained

    Raises
    ------
    SolveError
        If the baseline cannot be solved on a grid that is kept.
    """
    refining = Refining(screened, functions, cores=cores, tick=tick)
    # threads of BLAS cost more than such small matrices gain
    with ThreadPoolExecutor(max(1, cores)) as pool, threadpool_limits(1, user_api="blas"):
        found = list(pool.map(refining.kind, refining.linearised.blocks))
        names = dict.fromkeys(k.function.component for k in found)
        for name in names:
            ranked = sorted(range(len(found)), key=lambda i: -found[i].log_z)
            best = [i for i in ranked if found[i].function.component == name][:WITH_MORE]
            for i, kind in zip(best, pool.map(refining.with_more, [found[i] for i in best]), strict=True):
                found[i] = kind
        others = [screened.nonparametric.log_z, screened.correlated.log_z, screened.base.log_z]
        others += [fit.log_z for fit in screened.fits.values()]
        # a linear model tells little of what bends: the best function of each component is taken to its mode
        first = [i for i in best_of_each(found).values() if found[i].log_z > screened.base.log_z + LEADING]
        for i, kind in zip(first, pool.map(refining.refine, [found[i] for i in first]), strict=True):
            found[i] = kind
        done = 0
        while done < MOST_REFINED:
            top = max([*others, *(k.log_z for k in found)])
            ranked = sorted(range(len(found)), key=lambda i: -found[i].log_z)
            due = [i for i in ranked if not found[i].refined and found[i].log_z > top - LEADING]
            due = due[: min(max(1, cores), MOST_REFINED - done)]
            if not due:
                break
            for i, kind in zip(due, pool.map(refining.refine, [found[i] for i in due]), strict=True):
                found[i] = kind
            done += len(due)
    return Explained(
        refining.linearised,
        {name: Component(name, tuple(k for k in found if k.function.component == name)) for name in names},
    )
