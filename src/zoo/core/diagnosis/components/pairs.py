"""Two components at once: beside the best function of one, the functions of all others are weighed.

The weights z of the first function, of its most probable size and length, are coordinates like those of the
baseline, so that what is weighed beside them is weighed as beside the baseline, with

    log Z(a, b) = log Z(b beside a) + min(0, log Z(a) - log Z(nothing beside a)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from zoo.core.components import FreeFunction
from zoo.core.diagnosis.components.refining import (
    Component,
    Explained,
    Kind,
    Refining,
    around_mode,
    best_of_each,
)
from zoo.core.diagnosis.components.response import Block, Linearised
from zoo.core.diagnosis.components.weighing import Weighed, allowance, weigh
from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.screening import PRIOR_NONPARAMETRIC, Screened
from zoo.core.diagnosis.search import as_matrix
from zoo.core.forward import SolveError

FIRST = 4
"""Components beside whose function the others are linearised again."""
WORTH = 1.0
"""Log evidence that another function must add, by the linear model, for its pair to be looked at."""
SERIES = 2
"""Series that are needed at least: any two flexible functions draw a single one."""
REFINED = 3
"""Components beside one of these whose best function is taken to its mode."""


@dataclass(frozen=True, eq=False)
class Pair:
    """Functions of two components together as an explanation.

    Parameters
    ----------
    names : tuple of str
        Both components, the one with more evidence by itself first.
    first, second : Kind
        A function of one, and the best function of the other beside it, at the mode of both; the fit of the
        second is of both.
    log_prior : float
        Of both functions among those of their components.
    nothing : Weighed
        Nothing beside the first one's function, of its most probable size and length.
    linearised : Linearised
        Around the first one's mode.
    """

    names: tuple[str, str]
    first: Kind
    second: Kind
    log_prior: float
    nothing: Weighed
    linearised: Linearised = field(repr=False)

    @property
    def _more(self) -> float:
        """What integrating over the first one's sizes and lengths takes off, and the prior of both functions.

        Where another size than that of its fit explains more, nothing is added for it: the second one makes
        up for what the fit leaves.
        """
        return min(0.0, self.first.weighed.log_z - self.nothing.log_z) + self.log_prior

    @property
    def log_z(self) -> float:
        """Log evidence of both."""
        return self.second.weighed.log_z + self._more

    @property
    def log_more(self) -> float:
        """The same with something else beside them."""
        return self.second.more.log_z + self._more if self.second.more else -math.inf

    @property
    def log_evidence(self) -> float:
        """Alone or with something else, by the prior of that."""
        return float(np.logaddexp(self.log_z, self.log_more + math.log(PRIOR_NONPARAMETRIC)))

    @property
    def functions(self) -> tuple[str, str]:
        """Names of their best functions, in the order of `names`."""
        found = {k.function.component: k.function.name for k in (self.first, self.second)}
        one, other = self.names
        return found[one], found[other]

    @property
    def fit(self) -> Fit:
        """Of both."""
        return self.second.fit

    @property
    def around(self) -> Linearised:
        """The linear model around the first one's mode, with its function among the others, seen from 0."""
        kind = self.first
        weighed, fit, n = kind.weighed, kind.fit, kind.fit.forward.asked
        block, drawn = around_mode(weighed.block, kind.root, fit.jacobian[:, n:], fit.u[n:])
        return replace(
            self.linearised,
            residual=fit.residual + drawn,
            jacobian=self.linearised.jacobian[:, :n],
            precision=as_matrix(self.linearised.precision)[:n, :n],
            pull=self.linearised.pull[:n],
            blocks=(*self.linearised.blocks, block),
        )


def _beside(fit: Fit, linearised: Linearised, blocks: Sequence[Block]) -> Linearised:
    """The linear model around a function's mode, with responses to others as they are at the baseline's."""
    _, precision, pull = fit.forward.prior(fit.u)
    return replace(
        linearised, residual=fit.residual, jacobian=fit.jacobian, precision=precision, pull=pull,
        blocks=tuple(blocks),
    )  # fmt: skip


def _nothing(block: Block) -> Block:
    return replace(block, columns=np.zeros_like(block.columns))


def _promise(screened: Screened, kind: Kind, linearised: Linearised) -> float:
    """Log evidence that the best function of another component adds, by responses at the baseline."""
    options = allowance(screened.allowances)
    blocks = [b for b in linearised.blocks if b.function.component != kind.function.component]
    linear = _beside(kind.fit, linearised, blocks)

    def evidence(block: Block) -> float:
        return weigh(linear, block, kind.fit.forward, kind.fit.u, kind.weighed.noise, options, 1).log_z

    if not blocks:
        return -math.inf
    return max(map(evidence, blocks)) - evidence(_nothing(blocks[0]))


def pairs_of(
    screened: Screened,
    explained: Explained,
    functions: Sequence[FreeFunction],
    *,
    cores: int = 2,
    tick: Callable[[str, float], None] | None = None,
) -> list[Pair]:
    """Pairs of components, of those whose functions promise most together.

    Parameters
    ----------
    screened : Screened
    explained : Explained
        The components one by one.
    functions : sequence of FreeFunction
    cores : int
        Threads.
    tick : callable, optional
        Called with a text and the share done.

    Returns
    -------
    list of Pair
        Each pair once, the most probable first; none of a single series.
    """
    if screened.screening.data.n_series < SERIES:
        return []
    ready = [kind for c in explained.components.values() if (kind := _alone(c))]
    with ThreadPoolExecutor(max(1, cores)) as pool, threadpool_limits(1, user_api="blas"):
        more = list(pool.map(lambda kind: _promise(screened, kind, explained.linearised), ready))
    order = sorted(range(len(ready)), key=lambda i: -ready[i].weighed.log_z - more[i])[:FIRST]
    found: dict[frozenset[str], Pair] = {}
    for i in order:
        if more[i] < WORTH:
            continue
        try:
            pairs = _with_each(screened, explained, ready[i], functions, cores, tick)
        except SolveError:
            continue  # at its own mode, on the grid of the baseline's
        for pair in pairs:
            key = frozenset(pair.names)
            if key not in found or pair.log_evidence > found[key].log_evidence:
                found[key] = pair
    return sorted(found.values(), key=lambda pair: -pair.log_evidence)


def _alone(component: Component) -> Kind | None:
    """The refined function of a component that explains most with nothing else beside it."""
    return max((k for k in component.kinds if k.refined), key=lambda k: k.weighed.log_z, default=None)


def _with_each(
    screened: Screened,
    explained: Explained,
    first: Kind,
    functions: Sequence[FreeFunction],
    cores: int,
    tick: Callable[[str, float], None] | None,
) -> list[Pair]:
    """A function with every other component beside it."""
    component = first.function.component
    others = [f for f in functions if f.component != component]
    refining = Refining(screened, others, base=first.fit, cores=cores, tick=tick)
    linear = refining.linearised
    # from the noise that its own evidence has: where much is left, that is far from the baseline's
    nothing = weigh(
        linear, _nothing(linear.blocks[0]), first.fit.forward, first.fit.u, first.weighed.noise,
        allowance(screened.allowances),
    )  # fmt: skip
    with ThreadPoolExecutor(max(1, cores)) as pool, threadpool_limits(1, user_api="blas"):
        kinds = list(pool.map(refining.kind, linear.blocks))
        leading = sorted(best_of_each(kinds).values(), key=lambda i: -kinds[i].log_z)[:REFINED]

        def refined(i: int) -> Kind:
            return refining.refine(refining.with_more(kinds[i]))

        for i, kind in zip(leading, pool.map(refined, leading), strict=True):
            kinds[i] = kind
    evidence = {name: c.log_evidence for name, c in explained.components.items()}
    number = {name: len(c.kinds) for name, c in explained.components.items()}
    found = []
    for second in kinds:
        name = second.function.component
        if second.refined:  # far from its mode the linear model tells little
            one, other = sorted((component, name), key=lambda n: -evidence[n])
            log_prior = -math.log(number[component] * number[name])
            found.append(Pair((one, other), first, second, log_prior, nothing, linear))
    return found
