"""The posterior over sets of causes of a simulator: responses, then the leading sets at their modes.

Responses of listed effects are secants to where each fits best by itself, those of free functions are
derivatives at the baseline's fit. The sets that hold the mass are taken to their mode with the simulator and
weighed there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from zoo.core.causes.evidence import SetEvidence, SetModel, SizePriors, without
from zoo.core.causes.family import ErrorFamily
from zoo.core.causes.posterior import CausePosterior, SetRow
from zoo.core.causes.problem import Cause, Problem, without_doubles
from zoo.core.causes.sets import ODDS, CausePriors
from zoo.core.causes.weigh import weigh_causes
from zoo.core.components import FreeFunction
from zoo.core.diagnosis.components.response import Linearised, linearise, on_a_grid
from zoo.core.diagnosis.components.subsets import signatures_of
from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.file import unit_suffix
from zoo.core.diagnosis.hooks import Hooks
from zoo.core.diagnosis.hypothesis import Hypothesis, HypothesisModel
from zoo.core.diagnosis.screening import PROMISED, Screened
from zoo.core.diagnosis.search import Point, Search, SearchError
from zoo.core.effects import AddedEffect
from zoo.core.forward import ForwardModel

Array = NDArray[np.float64]
Which = tuple[int, ...]

MASS, MOST_SOLVED = 0.97, 10
"""Probability that the sets which are solved hold together, and how many are at most."""
STEPS, ROUNDS = 6, 4
"""Steps of a descent, and descents with fresh derivatives."""
NEARER = (1.0, 0.5, 0.2)
"""Parts of the linear model's step from which a descent begins."""
SIZE_PRIORS = SizePriors()
NEAR = 15.0
"""Log evidence behind the best solved set within which solves tell the linear model's error."""
VISIBLE = 3.0
"""Log evidence of one more cause from which on a smaller set is sought again where the larger one ended."""
WAVES = 4
"""Times that new leading sets are solved."""


@dataclass(frozen=True, eq=False)
class Origin:
    """What a cause is in the simulator: a listed effect with its parameters, or a function of some length."""

    added: AddedEffect | None = None
    values: Array | None = None
    function: FreeFunction | None = None
    length: float | None = None

    def effect(self) -> AddedEffect:
        """As an effect, a function by standard normal weights."""
        if self.added is not None:
            return self.added
        assert self.function is not None
        return self.function.effect(self.function.size, self.length)


@dataclass(frozen=True, eq=False)
class Solved:
    """A set at its mode: the fit, its evidence there, and what the linear model had promised."""

    fit: Fit = field(repr=False)
    evidence: SetEvidence = field(repr=False)
    promised: float
    order: Which

    @property
    def gained(self) -> float:
        """Log evidence by the solve over that of the linear model."""
        return self.evidence.total(SIZE_PRIORS) - self.promised


@dataclass(frozen=True, eq=False)
class CauseSets:
    """The posterior over sets of causes of a simulator, with the sets that were solved.

    Parameters
    ----------
    posterior : CausePosterior
    solved : mapping of indices to Solved
    linear_error : float
        Rms error of the log evidence of sets that were not solved, by those that were.
    """

    posterior: CausePosterior
    solved: Mapping[Which, Solved] = field(repr=False)
    linear_error: float
    search: CauseSearch = field(repr=False)

    def __repr__(self) -> str:
        first, p = next(iter(self.posterior.probability.items()))
        return f"<CauseSets: {self.name(first)} {p:.0%}; {len(self.solved)} sets solved>"

    def name(self, which: Which) -> str:
        """The causes of a set."""
        return " + ".join(self.posterior.causes[i].label for i in which) or "nothing"

    @property
    def missed(self) -> float:
        """Probability that causes which were not solved may have, two errors of the linear model up."""
        p = self.posterior.probability
        others = sum(x for w, x in p.items() if w and w not in self.solved)
        return float(expit(logit(others) + 2.0 * self.linear_error)) if 0.0 < others < 1.0 else others

    def gap_after(self, which: Which) -> Array | None:
        """Rms (n_groups,) of what a solved set leaves beyond the noise, in the groups' units."""
        if which not in self.solved:
            return None
        one = self.solved[which]
        family, errors = self.search.family, self.search.screening.errors
        at = one.evidence.best(SIZE_PRIORS)
        noise, _, _ = family.kinds
        kept = noise[one.evidence.kinds[at]] * np.exp(2.0 * one.evidence.log_noise[at])[family.member]
        left = [np.mean(errors.part(one.fit.residual**2 - kept, g)) for g in family.groups]
        return np.sqrt(np.maximum(left, 0.0))

    def table(self, least: float = 1e-3) -> Any:
        """Sets with at least some probability, as a pandas table: prior, evidence and what each leaves.

        Parameters
        ----------
        least : float

        Returns
        -------
        pandas.DataFrame
        """
        import pandas as pd

        found, rows = self.posterior, []
        units = [self.search.screening.data.unit(g) for g in self.search.family.groups]
        for which, p in found.probability.items():
            if p < least:
                break
            log_prior = found.priors.log_prior(which)
            left = self.gap_after(which)
            rows.append(
                {
                    "causes": self.name(which),
                    "components": " + ".join(found.causes[i].component for i in which),
                    "probability": p,
                    "log_prior": log_prior,
                    "log_evidence": found.log_joint[which] - log_prior,
                    "solved": which in self.solved,
                }
                | {
                    f"gap_after{unit_suffix(unit)}": None if left is None else float(left[i])
                    for i, unit in enumerate(units)
                }
            )
        return pd.DataFrame(rows)

    def sensitivity(self) -> Any:
        """Probability of each component under other priors, as a pandas table; nothing is solved again.

        Returns
        -------
        pandas.DataFrame
            A row for each prior: odds of causes, size and odds of the unexplained, error of what causes do.
        """
        import pandas as pd

        found, sizes = self.posterior, SIZE_PRIORS
        priors = {
            "as stated": found,
            "odds of causes halved": found.under(odds=0.5 * ODDS),
            "odds of causes doubled": found.under(odds=2.0 * ODDS),
            "unexplained half as large": found.under(replace(sizes, unexplained=0.5 * sizes.unexplained)),
            "unexplained twice as large": found.under(replace(sizes, unexplained=2.0 * sizes.unexplained)),
            "odds of the unexplained 1": found.under(replace(sizes, odds=1.0)),
            "no error of what causes do": found.under(replace(sizes, caricature=0.0)),
            "that error doubled": found.under(replace(sizes, caricature=2.0 * sizes.caricature)),
        }
        rows = {name: one.components | {"nothing": one.probability[()]} for name, one in priors.items()}
        return pd.DataFrame.from_dict(rows, orient="index")


@dataclass(eq=False)
class CauseSearch:
    """Causes of one screening, linear and then solved.

    Parameters
    ----------
    screened : Screened
    functions : sequence of FreeFunction
    hooks : Hooks
    cores : int
    """

    screened: Screened
    functions: Sequence[FreeFunction]
    hooks: Hooks
    cores: int = 2

    def __post_init__(self) -> None:
        screening = self.screened.screening
        self.screening, self.base = screening, screening.base.fit
        self.family = ErrorFamily(screening.errors, screening.range, dict(screening.errors.known))
        self.grid = on_a_grid(screening, self.base)
        self.linear: Linearised = linearise(
            screening, self.base, self.functions, self.screened.noise, cores=self.cores, forward=self.grid
        )
        computed = self.grid(self.base.u)
        assert computed is not None
        self.shift = self.base.computed - computed
        self.problem = self._problem(self.base.forward, self.base.u, self.base.residual, self.linear.jacobian)
        origins = dict([*self._listed(), *self._free()])
        self.causes, _ = without_doubles(list(origins))
        self.origins = [origins[one] for one in self.causes]
        self.solved: dict[Which, Solved] = {}

    @staticmethod
    def _problem(forward: HypothesisModel, u: Array, residual: Array, jacobian: Array) -> Problem:
        log_prior, precision, pull = forward.prior(u)
        return Problem(residual, jacobian, precision, pull, log_prior, forward.low - u, forward.high - u)

    def _listed(self) -> list[tuple[Cause, Origin]]:
        found = []
        fits = {h.added[-1]: fit for h, fit in self.screened.fits.items()}
        belongs = {n: self.hooks.component_of(e) or n for n, e in self.screening.effects.items()}
        seen: set[AddedEffect] = set()
        for one in signatures_of(self.screened):
            if one.added in seen:  # where it fits best comes first, then where a search of it began
                continue
            seen.add(one.added)
            first, *others = one.added.effect.parameters
            fit = fits.get(one.added)
            columns, mean = [one.change * first.scale], [0.0]
            if fit is not None:
                for i, p in enumerate(others):
                    at = fit.forward.asked + 1 + i
                    columns.append(fit.jacobian[:, at] * p.scale)
                    mean.append((p.centre - fit.u[at]) / p.scale)
            start = (
                fit.u[fit.forward.asked :] if fit is not None else np.array([first.starts[0], *one.others])
            )
            cause = Cause(
                one.name, belongs[one.name], np.stack(columns, axis=1), place=one.added.location.suffix,
                low=first.low / first.scale, high=first.high / first.scale, mean=np.array(mean),
            )  # fmt: skip
            found.append((cause, Origin(added=one.added, values=np.asarray(start))))
        return found

    def _free(self) -> list[tuple[Cause, Origin]]:
        found = []
        for block in self.linear.blocks:
            f = block.function
            for length in f.lengths or (None,):
                columns = block.columns @ (f.size * f.root(length))
                place = "" if length is None else f"({length:.3g} {f.argument_unit})"
                found.append(
                    (
                        Cause(f.name, f.component, columns, free=True, place=place),
                        Origin(function=f, length=length),
                    )
                )
        return found

    def run(self, tick: Callable[[str, float], None] | None = None) -> CauseSets:
        """The posterior, its leading sets solved."""
        found = weigh_causes(
            self.problem,
            self.causes,
            self.family,
            priors=CausePriors(self.causes),
            cores=self.cores,
            tick=tick,
        )
        linear = {row.which: row for row in found.rows}
        tried, retried = set[Which](), set[Which]()
        for wave in range(WAVES):
            due = self._due(found, tried)
            if not due:
                break
            tried |= set(due)
            if tick is not None:
                tick(f"solving {len(due)} sets of causes", wave / WAVES)
            for size in sorted({len(w) for w in due}):  # what fewer causes found, more begin with
                self._solve([w for w in due if len(w) == size], linear)
            again = [w for w in self.solved if w not in retried and self._outdone(w)]
            retried |= set(again)
            self._solve(again, linear)
            found = self._corrected(found, linear)
        return CauseSets(found, self.solved, self.linear_error, self)

    def _solve(self, sets: Sequence[Which], linear: Mapping[Which, SetRow]) -> None:
        """Take sets to their modes at once, and keep the better one of those that were solved before."""
        with ThreadPoolExecutor(max(1, self.cores)) as pool, threadpool_limits(1, user_api="blas"):
            results = list(pool.map(lambda which: self.solve(which, linear[which].evidence), sets))
        for which, one in zip(sets, results, strict=True):
            if one is None or (which in self.solved and one.fit.log_z <= self.solved[which].fit.log_z):
                continue
            self.solved[which] = one

    def _outdone(self, which: Which) -> bool:
        """Whether a larger set was solved with visibly more evidence, as where a mode was missed."""
        more = [one.fit.log_z for w, one in self.solved.items() if set(w) > set(which)]
        return max(more, default=-np.inf) > self.solved[which].fit.log_z + VISIBLE

    def _corrected(self, found: CausePosterior, linear: Mapping[Which, SetRow]) -> CausePosterior:
        """With what was solved; others are shifted as the solved set that is most like them."""
        others = [w for w in linear if w not in self.solved]
        shifts = dict(zip(others, self.shortfall(others), strict=True))
        rows = [
            replace(row, shift=shifts[w])
            if w in shifts
            else replace(row, evidence=self.solved[w].evidence, solved=True)
            for w, row in linear.items()
        ]
        guesses = self.shortfall(list(found.guessed))
        return replace(found, rows=tuple(rows), shifts=dict(zip(found.guessed, guesses, strict=True)))

    def shortfall(self, sets: Sequence[Which], *, others: bool = False) -> Array:
        """What a solve adds to the log evidence of sets (n,), by the solved set most like each.

        0 of a set that no solved one is like; with `others`, by one that is not the very same.
        """
        known = list(self.solved)
        if not known or not sets:
            return np.zeros(len(sets))
        asked, there = (self._members(x) for x in (sets, known))
        both = asked @ there.T
        like = both / np.maximum(asked.sum(axis=1)[:, None] + there.sum(axis=1) - both, 1.0)
        if others:
            like[like == 1.0] = 0.0
        nearest = np.argmax(like, axis=1)
        gained = np.array([self.solved[w].gained for w in known])
        return np.where(like[np.arange(len(sets)), nearest] > 0.0, gained[nearest], 0.0)

    def _members(self, sets: Sequence[Which]) -> Array:
        found = np.zeros((len(sets), len(self.causes)))
        for row, which in zip(found, sets, strict=True):
            row[list(which)] = 1.0
        return found

    @property
    def linear_error(self) -> float:
        """Rms error of the log evidence of sets that were not solved, by the leading ones that were."""
        best = max((one.fit.log_z for one in self.solved.values()), default=0.0)
        near = [w for w, one in self.solved.items() if one.fit.log_z > best - NEAR]
        errors = np.array([self.solved[w].gained for w in near]) - self.shortfall(near, others=True)
        return float(np.sqrt(np.mean(errors**2))) if len(errors) else 0.0

    def _due(self, found: CausePosterior, tried: set[Which]) -> list[Which]:
        """Leading sets that were not tried yet; at first the best alone of each component among them."""
        weighed = {row.which for row in found.rows if row.which}
        due: list[Which] = []
        total, best = 0.0, dict[str, Which]()
        for which, p in found.probability.items():
            if which in weighed and which not in tried and total < MASS and len(due) < MOST_SOLVED:
                due.append(which)
            total += p
            if which in weighed and len(which) == 1:
                best.setdefault(self.causes[which[0]].component, which)
        return due if tried else due + [w for w in best.values() if w not in due]

    # -- one set with the simulator ----------------------------------------------------------------

    def solve(self, which: Which, linear: SetEvidence) -> Solved | None:
        """A set at its mode; None where nothing can be solved on the way."""
        order = sorted(which, key=lambda i: self.origins[i].added is None)  # listed effects first
        added = tuple(self.origins[i].effect() for i in order)
        # a listed effect may need another grid than the baseline; a function is a smooth change of it
        listed = any(self.origins[i].added is not None for i in which)
        baseline = self.screening.baseline if listed else self.grid.baseline
        shift = np.zeros_like(self.shift) if listed else self.shift
        forward = HypothesisModel(baseline, Hypothesis(added), self.screening.errors)
        self.screening.forwards.append(forward)
        data = self.screening.coefficients - shift
        best = linear.best(SIZE_PRIORS)
        search = Search(forward, data, linear.variances(best))
        point: Point | None = None
        for u, jacobian in self._starts(which, order, linear.mean[best]):
            try:
                tried = search.at(np.clip(u, forward.low, forward.high), jacobian)
            except SearchError:
                continue
            if point is None or tried.cost < point.cost:
                point = tried
        if point is None:
            return None
        point = search.descend(point, STEPS)
        kept: tuple[Point, SetEvidence] | None = None
        reference = linear
        # beside a discrepancy a lesser mode costs little: the noise alone says first where the mode is
        for alone in (True, False):
            search = Search(forward, data, reference.variances(reference.best(SIZE_PRIORS), alone=alone))
            point = search.refine(search.resume(point), ROUNDS, STEPS)
            found = self._around(order, baseline, shift, point, linear)
            found = self._delivered(found, forward, data, point, self._n_free(order))
            if kept is None or found.total(SIZE_PRIORS) > kept[1].total(SIZE_PRIORS):
                kept = point, found
            reference = found
        assert kept is not None
        point, found = kept
        computed = point.computed + shift
        fit = Fit(
            forward.hypothesis, forward, point.u, computed, point.jacobian, data - point.computed,
            {}, {}, found.total(SIZE_PRIORS), point.u, np.zeros((len(point.u), len(point.u))),
        )  # fmt: skip
        return Solved(fit, found, linear.total(SIZE_PRIORS), tuple(order))

    def _delivered(
        self, found: SetEvidence, forward: HypothesisModel, data: Array, point: Point, n_free: int
    ) -> SetEvidence:
        """The evidence without what the linear model promises around the point and no solve delivers."""
        best = found.best(SIZE_PRIORS)
        k = len(point.u) - n_free
        seen = np.concatenate(
            [np.zeros(k), point.u[k:]]
        )  # weights are seen from 0, parameters from the point
        step = np.clip(found.mean[best] + point.u - seen, forward.low, forward.high) - point.u
        search = Search(forward, data, found.variances(best))
        here = search.cost(point.u, point.computed)
        promised = here - search.cost(point.u + step, point.computed + point.jacobian @ step)
        if promised < PROMISED:
            return found
        computed = forward(point.u + step)
        gained = 0.0 if computed is None else max(0.0, here - search.cost(point.u + step, computed))
        return replace(found, log_z=found.log_z - max(0.0, promised - gained))

    def _starts(self, which: Which, order: Sequence[int], mean: Array) -> list[tuple[Array, Array]]:
        """Where a search may begin, with derivatives: parts of the linear step, and ends of sets nearby."""
        origin, start, jacobian = self._start(which, order, mean)
        found = [(origin + part * (start - origin), jacobian) for part in NEARER]
        k = len(self.base.u)
        sizes = {i: len(self.origins[i].effect().effect.parameters) for i in order}
        at = dict(zip(order, np.cumsum([k, *sizes.values()]), strict=False))
        for one in self._near(which):
            of, u, J = k, origin.copy(), jacobian.copy()
            u[:k], J[:, :k] = one.fit.u[:k], one.fit.jacobian[:, :k]
            for i in one.order:
                size = len(self.origins[i].effect().effect.parameters)
                if i in at:
                    to = slice(at[i], at[i] + size)
                    u[to], J[:, to] = one.fit.u[of : of + size], one.fit.jacobian[:, of : of + size]
                of += size
            found.append((u, J))
        return found

    def _n_free(self, order: Sequence[int]) -> int:
        return sum(self.causes[i].columns.shape[1] for i in order if self.origins[i].added is None)

    def _near(self, which: Which) -> list[Solved]:
        """The best solved set inside of a set, and the best around it."""
        inside = [one for w, one in self.solved.items() if set(w) < set(which)]
        around = [one for w, one in self.solved.items() if set(w) > set(which)]
        return [max(part, key=lambda one: one.fit.log_z) for part in (inside, around) if part]

    def _start(self, which: Which, order: Sequence[int], mean: Array) -> tuple[Array, Array, Array]:
        """Coordinates without and with causes, and derivatives, of the linear model."""
        k = len(self.base.u)
        sizes = [self.causes[i].columns.shape[1] for i in which]
        weights = dict(zip(which, np.split(mean[k:], np.cumsum(sizes)[:-1]), strict=True)) if which else {}
        origins, starts, columns = [self.base.u], [self.base.u + mean[:k]], [self.linear.jacobian]
        for i in order:
            own, R, w = self.origins[i], self.causes[i].columns, weights[i]
            if own.added is None:
                origins.append(np.zeros(len(w)))
                starts.append(w)
                columns.append(R)
                continue
            parameters = own.added.effect.parameters
            scales = np.array([p.scale for p in parameters])
            at = np.array(own.values, dtype=float)
            origins.append(np.concatenate([[0.0], at[1:]]))
            at[: len(w)] = np.concatenate([[0.0], at[1 : len(w)]]) + w * scales[: len(w)]
            starts.append(at)
            block = np.zeros((len(R), len(parameters)))
            block[:, : len(w)] = R / scales[: len(w)]
            columns.append(block)
        return np.concatenate(origins), np.concatenate(starts), np.concatenate(columns, axis=1)

    def _around(
        self, order: Sequence[int], baseline: ForwardModel, shift: Array, point: Point, linear: SetEvidence
    ) -> SetEvidence:
        """Evidence of a set around a point: listed effects among the parameters, functions seen from 0."""
        listed = [i for i in order if self.origins[i].added is not None]
        hypothesis = Hypothesis(tuple(self.origins[i].effect() for i in listed))
        forward = HypothesisModel(baseline, hypothesis, self.screening.errors)
        k = len(forward.low)
        residual = self.screening.coefficients - shift - point.computed
        causes, at = [], k
        for i in order[len(listed) :]:
            after = at + self.causes[i].columns.shape[1]
            Z = point.jacobian[:, at:after]
            residual = residual + Z @ point.u[at:after]
            causes.append(replace(self.causes[i], columns=Z))
            at = after
        problem = self._problem(forward, point.u[:k], residual, point.jacobian[:, :k])
        start = linear.log_noise[linear.best(SIZE_PRIORS)]
        found = SetModel(problem, causes, self.family).evidence(linear.kinds, start)
        V = found.variances(found.best(SIZE_PRIORS))
        change = point.computed + shift - self.base.computed
        return replace(found, signal=self.family.relative(without(self.linear.jacobian, change, V)))


def cause_sets(
    screened: Screened,
    hooks: Hooks,
    *,
    cores: int = 2,
    tick: Callable[[str, float], None] | None = None,
) -> CauseSets:
    """The posterior over sets of causes of a screening's baseline.

    Parameters
    ----------
    screened : Screened
        Gives the data, the baseline's fit, and where each listed effect fits best by itself.
    hooks : Hooks
        Gives the free functions, and the component of each effect.
    cores : int
        Threads.
    tick : callable, optional
        Called with a text and the share done.

    Returns
    -------
    CauseSets

    Raises
    ------
    SolveError
        If the baseline cannot be solved on a grid that is kept.
    """
    screening = screened.screening
    functions = (
        hooks.components(screening.baseline, screened.base.values, screening.data) if hooks.components else ()
    )
    return CauseSearch(screened, functions, hooks, cores).run(tick)
