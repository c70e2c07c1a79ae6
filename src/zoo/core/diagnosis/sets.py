"""The posterior over sets of causes of a simulator: responses, then the leading sets at their modes.

Responses of listed effects are secants to where each fits best by itself, those of free functions are
derivatives at the baseline's fit. The sets that hold the mass are taken to their mode with the simulator and
weighed there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from zoo.core.causes.evidence import SetEvidence, SetModel, SizePriors, without
from zoo.core.causes.posterior import CausePosterior, SetRow
from zoo.core.causes.problem import Cause, Problem, without_doubles
from zoo.core.causes.sets import CausePriors
from zoo.core.causes.weigh import weigh_causes
from zoo.core.diagnosis.coordinates import SearchModel
from zoo.core.diagnosis.fitting import Fitting
from zoo.core.diagnosis.hooks import Hooks
from zoo.core.diagnosis.responses import Origin, free_causes, listed_causes
from zoo.core.diagnosis.search import Point, Search, SearchError
from zoo.core.effects import Effect
from zoo.core.forward import SolveError, pinned

Array = NDArray[np.float64]
Which = tuple[int, ...]

MASS, MOST_SOLVED = 0.97, 10
"""Probability that the sets which are solved hold together, and how many are at most."""
STEPS, ROUNDS = 6, 3
"""Steps of a descent, and descents with fresh derivatives."""
NEARER = (1.0, 0.5, 0.2)
"""Parts of the linear model's step from which a descent begins."""
SIZE_PRIORS = SizePriors()
NEAR = 15.0
"""Log evidence behind the best solved set within which solves tell the linear model's error."""
PROMISED = 1.0
"""Gain of the log posterior that a linearisation may promise unchecked; above it, a solve is what counts."""
LEFT = 0.1
"""Part of the baseline's residual that a listed effect may leave where its size is sought."""
VISIBLE = 3.0
"""Log evidence of one more cause from which on a smaller set is sought again where the larger one ended."""
WAVES = 4
"""Times that new leading sets are solved."""


@dataclass(frozen=True, eq=False)
class SolvedSet:
    """A set of causes at its mode: the point, its evidence there, and what the linear model had promised.

    Parameters
    ----------
    order : tuple of int
        Its causes as the forward model has them, listed effects before functions.
    forward : SearchModel
    point : Point
        `computed` includes what the baseline's own discretisation adds.
    evidence : SetEvidence
        Of listed effects by steps from the point, of functions by their weights, in the order of `order`.
    n_listed : int
        Coordinates before those of functions.
    promised : float
        Log evidence of the linear model.
    """

    order: Which
    forward: SearchModel = field(repr=False)
    point: Point = field(repr=False)
    evidence: SetEvidence = field(repr=False)
    n_listed: int
    promised: float

    @cached_property
    def log_z(self) -> float:
        """Log evidence."""
        return self.evidence.total(SIZE_PRIORS)

    @property
    def gained(self) -> float:
        """Log evidence by the solve over that of the linear model."""
        return self.log_z - self.promised

    def series(self, x: Array) -> Array:
        """Linear predictions (..., n) at steps and weights (..., p), as `SetEvidence.mean` has them."""
        return np.asarray(self.point.computed + (x - self.seen) @ self.point.jacobian.T)

    @property
    def seen(self) -> Array:
        """The point itself as steps and weights, (p,)."""
        found = self.point.u.copy()
        found[: self.n_listed] = 0.0
        return found

    def places(self, causes: Sequence[Cause], origins: Sequence[Origin]) -> dict[int, slice]:
        """Coordinates of each cause by its index."""
        found, at = {}, self.forward.n_base
        for i in self.order:
            size = len(origins[i].effect().effect.parameters)
            found[i] = slice(at, at + size)
            at += size
        return found


@dataclass(eq=False)
class CauseSearch:
    """Causes of one record and baseline, linear and then solved.

    Parameters
    ----------
    fitting : Fitting
    effects : sequence of Effect
    hooks : Hooks
    tick : callable
        Called with a text and the share done.

    Raises
    ------
    SolveError
        If the baseline cannot be solved on a grid that is kept.
    """

    fitting: Fitting
    effects: Sequence[Effect]
    hooks: Hooks
    tick: Callable[[str, float], None]

    def __post_init__(self) -> None:
        f = self.fitting
        self.family, self.data = f.family, f.coefficients
        self.tick("baseline", 0.0)
        nothing = self._nothing()
        self.solved: dict[Which, SolvedSet] = {(): nothing}
        self.base = nothing.point
        again = f.forward(self.base.u)
        self.unsteady = 0.0 if again is None else self.family.relative(again - self.base.computed)
        best = nothing.evidence.best(SIZE_PRIORS)
        noise = nothing.evidence.variances(best, alone=True)
        residual = self.data - self.base.computed
        spectrum = np.exp(self.family.log_shapes) @ self.family.discrepancies
        near = noise + (LEFT * self.family.relative(residual)) ** 2 * spectrum
        configuration = f.forward.model.configure(f.forward.theta(self.base.u))
        self.grid = f.model(baseline=pinned(f.baseline, configuration))
        computed = self.grid(self.base.u)
        if computed is None:
            raise SolveError(self.grid.last_failure)
        self.shift = self.base.computed - computed
        pinned_base = replace(self.base, computed=computed)
        self.jacobian = Search(self.grid, computed, near).differences(pinned_base, self.base.jacobian)
        self.problem = self._problem(f.forward, self.base.u, residual, self.jacobian)
        listed, self.failed, self.idle = listed_causes(
            f, self.base, self.effects, self.problem, near, self.hooks.component_of,
            lambda name, part: self.tick(name, 0.05 + 0.25 * part),
        )  # fmt: skip
        theta = f.forward.theta(self.base.u)
        functions = self.hooks.components(f.baseline, theta, f.data) if self.hooks.components else ()
        free = free_causes(
            f, self.grid, pinned_base, functions, near, lambda name, part: self.tick(name, 0.3 + 0.15 * part)
        )
        origins = dict([*listed, *free])
        self.causes, _ = without_doubles(list(origins))
        self.origins = [origins[one] for one in self.causes]

    @staticmethod
    def _problem(forward: SearchModel, u: Array, residual: Array, jacobian: Array) -> Problem:
        log_prior, precision, pull = forward.prior(u)
        return Problem(residual, jacobian, precision, pull, log_prior, forward.low - u, forward.high - u)

    def _nothing(self) -> SolvedSet:
        """The baseline at its best fit, with no cause."""
        f, point = self.fitting, self.fitting.start
        problem = self._problem(f.forward, point.u, self.data - point.computed, point.jacobian)
        found = SetModel(problem, (), self.family).evidence(
            np.arange(self.family.n_kinds), self.family.noise_start
        )
        return SolvedSet((), f.forward, point, found, len(point.u), found.total(SIZE_PRIORS))

    def run(self) -> CauseSets:
        """The posterior, its leading sets solved."""
        found = weigh_causes(
            self.problem,
            self.causes,
            self.family,
            priors=CausePriors(self.causes),
            cores=self.fitting.cores,
            tick=lambda text, share: self.tick(text, 0.45 + 0.15 * share),
        )
        linear = {row.which: row for row in found.rows}
        tried: set[Which] = {()}
        retried: set[Which] = set()
        for wave in range(WAVES):
            due = self._due(found, tried)
            if not due:
                break
            linear |= self._weighed([w for w in due if w not in linear], found)
            tried |= set(due)
            self.tick(f"solving {len(due)} sets of causes", 0.6 + 0.4 * wave / WAVES)
            for size in sorted({len(w) for w in due}):  # what fewer causes found, more begin with
                self._solve([w for w in due if len(w) == size], linear)
            again = [w for w in self.solved if w and w not in retried and self._outdone(w)]
            retried |= set(again)
            self._solve(again, linear)
            found = self._corrected(found, linear)
        return CauseSets(found, self)

    def _solve(self, sets: Sequence[Which], linear: Mapping[Which, SetRow]) -> None:
        """Take sets to their modes at once, and keep the better one of those that were solved before."""
        with ThreadPoolExecutor(max(1, self.fitting.cores)) as pool, threadpool_limits(1, user_api="blas"):
            results = list(pool.map(lambda which: self.solve(which, linear[which].evidence), sets))
        for which, one in zip(sets, results, strict=True):
            if one is None or (which in self.solved and one.log_z <= self.solved[which].log_z):
                continue
            self.solved[which] = one

    def _weighed(self, sets: Sequence[Which], found: CausePosterior) -> dict[Which, SetRow]:
        """Sets of which only a guess was known, by the linear model."""
        like = found.rows[-1].evidence
        start = like.log_noise[like.best(SIZE_PRIORS)]

        def one(which: Which) -> SetRow:
            model = SetModel(self.problem, [self.causes[i] for i in which], self.family)
            return SetRow(which, found.priors.log_prior(which), model.evidence(like.kinds, start))

        return {which: one(which) for which in sets}

    def _outdone(self, which: Which) -> bool:
        """Whether a larger set was solved with visibly more evidence, as where a mode was missed."""
        more = [one.log_z for w, one in self.solved.items() if set(w) > set(which)]
        return max(more, default=-np.inf) > self.solved[which].log_z + VISIBLE

    def _corrected(self, found: CausePosterior, linear: Mapping[Which, SetRow]) -> CausePosterior:
        """With what was solved; others are shifted as the solved set that is most like them."""
        others = [w for w in linear if w not in self.solved]
        shifts = dict(zip(others, self.shortfall(others), strict=True))
        rows = [
            replace(row, shift=shifts[w])
            if w in shifts
            else replace(row, evidence=self.solved[w].evidence if w else row.evidence, solved=True)
            for w, row in linear.items()
        ]
        guessed = {w: x for w, x in found.guessed.items() if w not in linear}
        shifts = dict(zip(guessed, self.shortfall(list(guessed)), strict=True))
        return replace(found, rows=tuple(rows), guessed=guessed, shifts=shifts)

    def shortfall(self, sets: Sequence[Which], *, others: bool = False) -> Array:
        """What a solve adds to the log evidence of sets (n,), by the solved set most like each.

        0 of a set that no solved one is like; with `others`, by one that is not the very same.
        """
        known = [w for w in self.solved if w]
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
        best = max(one.log_z for one in self.solved.values())
        near = [w for w, one in self.solved.items() if w and one.log_z > best - NEAR]
        errors = np.array([self.solved[w].gained for w in near]) - self.shortfall(near, others=True)
        return float(np.sqrt(np.mean(errors**2))) if len(errors) else 0.0

    def _due(self, found: CausePosterior, tried: set[Which]) -> list[Which]:
        """Leading sets that were not tried yet, and the leader without each of its causes.

        At first the best alone of each component is among them.
        """
        leader = max(self.solved, key=lambda which: found.log_joint[which])
        parts = [tuple(i for i in leader if i != left) for left in leader]
        due = [which for which in parts if which not in tried]
        total, best = 0.0, dict[str, Which]()
        for which, p in found.probability.items():
            if which not in tried and which not in due and total < MASS and len(due) < MOST_SOLVED:
                due.append(which)
            total += p
            if len(which) == 1:
                best.setdefault(self.causes[which[0]].component, which)
        return due if len(tried) > 1 else due + [w for w in best.values() if w not in due]

    # -- one set with the simulator ----------------------------------------------------------------

    def solve(self, which: Which, linear: SetEvidence) -> SolvedSet | None:
        """A set at its mode; None where nothing can be solved on the way."""
        order = tuple(sorted(which, key=lambda i: self.origins[i].added is None))  # listed effects first
        # a listed effect may need another grid than the baseline; a function is a smooth change of it
        listed = any(self.origins[i].added is not None for i in which)
        baseline = self.fitting.baseline if listed else self.grid.model
        shift = np.zeros_like(self.shift) if listed else self.shift
        forward = self.fitting.model(tuple(self.origins[i].effect() for i in order), baseline)
        best = linear.best(SIZE_PRIORS)
        search = Search(forward, self.data - shift, linear.variances(best))
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
        return self._to_mode(order, forward, shift, search.descend(point, STEPS), linear)

    def _to_mode(
        self, order: Which, forward: SearchModel, shift: Array, point: Point, linear: SetEvidence
    ) -> SolvedSet:
        """A set from a point near its mode, in turns of a search and of the errors beside it."""
        data, kept, reference = self.data - shift, None, linear
        # beside a discrepancy a lesser mode costs little: noise alone says first where the mode is
        for alone in (True, False):
            search = Search(forward, data, reference.variances(reference.best(SIZE_PRIORS), alone=alone))
            point = search.resume(point)
            if kept is None:
                point = search.refine(point, ROUNDS, STEPS, fine=self.fitting.smooth)
            else:  # the derivatives are fresh
                moved = search.descend(point, STEPS)
                point = search.refine(moved, 1, STEPS) if point.cost - moved.cost > PROMISED else point
            found, n_listed = self._around(order, forward, data, point, linear)
            reference = self._delivered(found, forward, data, point, n_listed)
            if kept is None or reference.total(SIZE_PRIORS) > kept.log_z:
                whole = replace(point, computed=point.computed + shift)
                promised = linear.total(SIZE_PRIORS)
                kept = SolvedSet(order, forward, whole, reference, n_listed, promised)
        assert kept is not None
        return kept

    def _delivered(
        self, found: SetEvidence, forward: SearchModel, data: Array, point: Point, n_listed: int
    ) -> SetEvidence:
        """The evidence without what the linear model promises around the point and no solve delivers."""
        best = found.best(SIZE_PRIORS)
        seen = point.u.copy()
        seen[:n_listed] = 0.0  # weights are seen from 0, parameters from the point
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
            u, J = origin.copy(), jacobian.copy()
            u[:k], J[:, :k] = one.point.u[:k], one.point.jacobian[:, :k]
            for i, of in one.places(self.causes, self.origins).items():
                if i in at:
                    to = slice(at[i], at[i] + sizes[i])
                    u[to], J[:, to] = one.point.u[of], one.point.jacobian[:, of]
            found.append((u, J))
        return found

    def _near(self, which: Which) -> list[SolvedSet]:
        """The best solved set inside of a set, and the best around it."""
        inside = [one for w, one in self.solved.items() if w and set(w) < set(which)]
        around = [one for w, one in self.solved.items() if set(w) > set(which)]
        return [max(part, key=lambda one: one.log_z) for part in (inside, around) if part]

    def _start(self, which: Which, order: Sequence[int], mean: Array) -> tuple[Array, Array, Array]:
        """Coordinates without and with causes, and derivatives, of the linear model."""
        k = len(self.base.u)
        sizes = [self.causes[i].columns.shape[1] for i in which]
        weights = dict(zip(which, np.split(mean[k:], np.cumsum(sizes)[:-1]), strict=True)) if which else {}
        origins, starts, columns = [self.base.u], [self.base.u + mean[:k]], [self.jacobian]
        for i in order:
            own, R, w = self.origins[i], self.causes[i].columns, weights[i]
            if own.added is None:
                origins.append(np.zeros(len(w)))
                starts.append(w)
                columns.append(R)
                continue
            scales = np.array([p.scale for p in own.added.effect.parameters])
            values = np.asarray(own.values)
            origins.append(np.concatenate([[0.0], values[1:]]))
            starts.append(origins[-1] + w * scales)
            columns.append(R / scales)
        return np.concatenate(origins), np.concatenate(starts), np.concatenate(columns, axis=1)

    def _around(
        self, order: Which, forward: SearchModel, data: Array, point: Point, linear: SetEvidence
    ) -> tuple[SetEvidence, int]:
        """Evidence of a set around a point: listed effects among the parameters, functions seen from 0."""
        sizes = [len(self.origins[i].effect().effect.parameters) for i in order] if order else []
        free = [i for i in order if self.origins[i].added is None]
        n_listed = len(point.u) - sum(sizes[len(order) - len(free) :])
        own = self.fitting.model(forward.added[: len(order) - len(free)]) if free else forward
        residual, causes, at = data - point.computed, [], n_listed
        for i in free:
            after = at + self.causes[i].columns.shape[1]
            Z = point.jacobian[:, at:after]
            residual = residual + Z @ point.u[at:after]
            causes.append(replace(self.causes[i], columns=Z))
            at = after
        problem = self._problem(own, point.u[:n_listed], residual, point.jacobian[:, :n_listed])
        firsts = np.cumsum([forward.n_base, *sizes])[: len(order) - len(free)]
        problem = replace(problem, amplitudes=tuple(int(i) for i in firsts))
        start = linear.log_noise[linear.best(SIZE_PRIORS)]
        found = SetModel(problem, causes, self.family).evidence(linear.kinds, start)
        if not order:
            return found, n_listed
        V = found.variances(found.best(SIZE_PRIORS))
        change = point.computed + (self.data - data) - self.base.computed
        signal = self.family.relative(without(self.jacobian, change, V))
        return replace(found, signal=signal), n_listed


@dataclass(frozen=True, eq=False)
class CauseSets:
    """The posterior over sets of causes of a simulator, with the sets that were solved.

    Parameters
    ----------
    posterior : CausePosterior
    search : CauseSearch
    """

    posterior: CausePosterior
    search: CauseSearch = field(repr=False)

    def __repr__(self) -> str:
        first, p = next(iter(self.posterior.probability.items()))
        return f"<CauseSets: {self.name(first)} {p:.0%}; {len(self.solved)} sets solved>"

    @property
    def solved(self) -> Mapping[Which, SolvedSet]:
        """Sets at their modes; the empty one is the baseline."""
        return self.search.solved

    @cached_property
    def linear_error(self) -> float:
        """Rms error of the log evidence of sets that were not solved, by those that were."""
        return self.search.linear_error

    @cached_property
    def leader(self) -> Which:
        """The most probable set of those that were solved."""
        return max(self.solved, key=lambda which: self.posterior.log_joint[which])

    def name(self, which: Which) -> str:
        """The causes of a set."""
        return " + ".join(self.posterior.causes[i].label for i in which) or "nothing"

    def components(self, which: Which) -> tuple[str, ...]:
        """The components of a set."""
        return tuple(self.posterior.causes[i].component for i in which)

    @property
    def missed(self) -> float:
        """Probability that causes which were not solved may have, two errors of the linear model up."""
        p = self.posterior.probability
        others = sum(x for w, x in p.items() if w not in self.solved)
        return float(expit(logit(others) + 2.0 * self.linear_error)) if 0.0 < others < 1.0 else others

    @cached_property
    def noise(self) -> dict[str, float]:
        """Rms noise of each group given the leading set, in the group's unit."""
        family = self.search.family
        parts = {g: family.errors.part(self._noise_variances, g) for g in family.groups}
        return {g: float(np.sqrt(np.mean(part))) for g, part in parts.items()}

    @cached_property
    def _noise_variances(self) -> Array:
        """Of the noise given the leading set, (n,)."""
        leader = self.solved[self.leader].evidence
        return leader.variances(leader.best(SIZE_PRIORS), alone=True)

    def gap_after(self, which: Which) -> Array:
        """Rms (n_groups,) of what a solved set leaves beyond the leader's noise, in the groups' units."""
        family = self.search.family
        residual = self.search.data - self.solved[which].point.computed
        beyond = residual**2 - self._noise_variances
        left = [np.mean(family.errors.part(beyond, g)) for g in family.groups]
        return np.sqrt(np.maximum(left, 0.0))
