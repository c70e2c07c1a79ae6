"""The posterior over sets of causes of a simulator: responses, then the leading sets at their modes.

Responses of listed effects are secants to where each fits best beside the parameters, those of free
functions are derivatives at the baseline's fit. The sets that hold the mass are taken to their mode with the
simulator and weighed there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.causes.evidence import SIZE_PRIORS, SetEvidence, SetModel, without
from zoo.core.causes.posterior import CausePosterior, SetRow
from zoo.core.causes.problem import Problem, without_doubles
from zoo.core.causes.set_priors import CausePriors, likeness
from zoo.core.causes.weigh import leading, weigh_causes
from zoo.core.diagnosis.coordinates import SearchModel
from zoo.core.diagnosis.fitting import Fitting
from zoo.core.diagnosis.hooks import Hooks
from zoo.core.diagnosis.responses import Origin, Response, free_causes, listed_causes
from zoo.core.diagnosis.search import NO_DAMPING, Point, Search, SearchError
from zoo.core.diagnosis.solved import Linear, SolvedSet, Which, places, tangents
from zoo.core.effects import Effect
from zoo.core.forward import Corrected, SolveError, pinned
from zoo.core.threads import threads

Array = NDArray[np.float64]
T = TypeVar("T")

MASS, MOST_SOLVED = 0.97, 5
"""Probability that the sets which are solved hold together, and how many are at most."""
STEPS = 6
"""Steps of a descent."""
TURNS = 4
"""Times that a mode is sought given errors, and errors given the mode."""
NEARER = (1.0, 0.5, 0.2)
"""Parts of the linear model's step from which a descent begins."""
NEAR = 15.0
"""Log evidence behind the best solved set within which solves tell the linear model's error."""
PROMISED = 1.0
"""Gain of the log posterior that a linearisation may promise unchecked; above it, a solve is what counts,
and a set is sought again."""
LEFT = 0.1
"""Part of the baseline's residual that a listed effect may leave where its size is sought."""
VISIBLE = 3.0
"""Log evidence of one more cause from which on a smaller set is sought again where the larger one ended."""
KNOWN, CHECKED = 0.5, 5
"""Error of the log evidence below which a linear model is right, by how many solved sets at least: then only
the most probable set is still solved."""
WAVES, MOST_WAVES, UNKNOWN = 4, 8, 0.5
"""Times that new leading sets are solved, and that they are while sets that were not solved may hold so much
of the probability."""
SEEKING, SOLVING, SOLVED, LOOKED = 0.3, 0.45, 0.95, 0.3
"""Parts of the work that are done before sets are sought, before they are solved, and after that; of solving
some, when they were looked at."""


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
        f = self.fitting = self.fitting.corrected()
        self.family, self.data = f.family, f.coefficients
        self.span: tuple[float, ...] = 0.0, SEEKING  # of what is being done, in parts of the work
        self._tell("baseline", 0.0)
        self.fitted = nothing = self._nothing()
        self.solved: dict[Which, SolvedSet] = {(): nothing}
        self.base = nothing.point
        theta = f.forward.theta(self.base.u)
        on_grid = pinned(f.baseline, f.forward.model.configure(theta))
        self.grid = f.model(baseline=Corrected(on_grid, on_grid, f.baseline, theta, 1.0))
        computed = self.grid(self.base.u)
        if computed is None:
            raise SolveError(self.grid.last_failure)
        pinned_base = replace(self.base, computed=computed)
        self.jacobian = Search(self.grid, computed, self._heard(nothing)).differences(
            pinned_base, self.base.jacobian
        )
        functions = self.hooks.components(f.baseline, theta, f.data) if self.hooks.components else ()
        every = [Origin(added=one.at(at)) for one in self.effects for at in one.locations(f.baseline)]
        every += [Origin(function=g, length=length) for g in functions for length in g.lengths or (None,)]
        centre = replace(nothing, point=replace(self.base, jacobian=self.jacobian))
        self.solved_at: dict[tuple[Any, ...], Array] = {}  # where responses were solved, by origins' keys
        found = self._responses(centre, every)
        self.solved_at = {key: one.solved_at for key, one in found.items()}
        there = {found[origin.key].cause: origin for origin in every if origin.key in found}
        placed = dict.fromkeys(one.added.name for one in every if one.added is not None)
        solved = {one.name for one in there}
        there = {one: origin for one, origin in there.items() if np.any(one.columns)}
        moved = {one.name for one in there}
        self.failed = {name: self._why(name) for name in placed if name not in solved}
        self.idle = [one.name for one in self.effects if one.name not in self.failed.keys() | moved]
        self.causes = without_doubles(list(there))
        self.origins = [there[one] for one in self.causes]
        responses = [found[origin.key] for origin in self.origins]
        residual = self.data - self.base.computed
        self.problem = self._problem(f.forward, self.base.u, residual, self.jacobian)
        values = tuple(one.values for one in responses)
        self.linears = [Linear((), self.base.u, self.problem, tuple(self.causes), values, nothing.log_z)]
        self._linear_of: dict[Which, Linear] = {}  # what was asked since
        self.fresh: set[Which] = set()  # centres of responses of their own
        self.ends: dict[Which, Point] = {
            (i,): one.end for i, one in enumerate(responses) if one.end is not None
        }
        self.rows: dict[Which, SetRow] = {}
        self.near: set[Which] = set()  # solved where a descent ended, not taken to their mode

    def _why(self, name: str) -> str:
        """Why solves with an effect failed."""
        tried = (one for one in self.fitting.models if any(added.name == name for added in one.added))
        return next((one.last_failure for one in tried if one.last_failure), "")

    def _heard(self, centre: SolvedSet) -> Array:
        """Variances (n,) of the errors in which sizes are sought around a set."""
        noise = centre.evidence.variances(centre.evidence.best(SIZE_PRIORS), alone=True)
        left = LEFT * self.family.relative(self.data - centre.point.computed)
        return np.asarray(noise + left**2 * (np.exp(self.family.log_shapes) @ self.family.discrepancies))

    def _responses(self, centre: SolvedSet, origins: Sequence[Origin]) -> dict[tuple[Any, ...], Response]:
        """What further causes do around a set."""
        f, point, V = self.fitting, centre.point, self._heard(centre)
        others = centre.forward.added
        problem = self._problem(centre.forward, point.u, self.data - point.computed, point.jacobian)
        own = f.model(others)
        computed = own(point.u)
        configuration = own.model.configure(own.theta(point.u))
        grid = f.model(others, pinned(f.baseline, configuration))
        on_grid = grid(point.u)
        if computed is None or on_grid is None:
            raise SolveError(own.last_failure or grid.last_failure)
        added = [one for one in origins if one.added is not None]
        listed = listed_causes(
            f, replace(point, computed=computed), others, tuple(one.effect() for one in added), problem, V,
            self.hooks.component_of, [self.solved_at.get(one.key) for one in added],
            lambda name, part: self._tell(name, 0.7 * part),
        )  # fmt: skip
        found = {one.key: x for one, x in zip(added, listed, strict=True) if x is not None}
        functions = tuple(dict.fromkeys(one.function for one in origins if one.function is not None))
        free = free_causes(
            f, grid, replace(point, computed=on_grid), functions, V,
            lambda name, part: self._tell(name, 0.7 + 0.3 * part),
        )  # fmt: skip
        for one, origin in free:
            none = np.zeros(one.columns.shape[1])
            found[origin.key] = Response(one, values=none, solved_at=none)
        return found

    def _linear(self, centre: SolvedSet, fresh: bool) -> Linear:
        """The simulator around a solved set, with fresh responses of other causes or the baseline's."""
        taken = {self.causes[i].component for i in centre.order}
        there = [o for o, c in zip(self.origins, self.causes, strict=True) if c.component not in taken]
        found = self._responses(centre, there) if fresh else {}
        k, point = self.fitting.forward.n_base, centre.point
        residual, own = tangents(centre, self.data - point.computed, self.causes, self.origins)
        problem = self._problem(self.fitting.forward, point.u[:k], residual, point.jacobian[:, :k])
        pairs = []
        for i, (cause, origin) in enumerate(zip(self.causes, self.origins, strict=True)):
            one, columns = found.get(origin.key), np.zeros_like(cause.columns) if fresh else cause.columns
            other = replace(cause, columns=columns), self.linears[0].values[i]
            pairs.append(own.get(i, (one.cause, one.values) if one else other))
        causes, values = zip(*pairs, strict=True)
        return Linear(tuple(sorted(centre.order)), point.u[:k], problem, causes, values, centre.log_z)

    @staticmethod
    def _problem(forward: SearchModel, u: Array, residual: Array, jacobian: Array) -> Problem:
        bounds = forward.low - u, forward.high - u
        return Problem(residual, jacobian, *forward.prior(u), forward.log_prior(u), *bounds)

    def _nothing(self) -> SolvedSet:
        """The baseline at its best fit, with no cause."""
        f, point = self.fitting, self.fitting.start
        problem = self._problem(f.forward, point.u, self.data - point.computed, point.jacobian)
        found = SetModel(problem, (), self.family).evidence(
            np.arange(self.family.n_kinds), self.family.noise_start
        )
        return SolvedSet((), f.forward, point, found, len(point.u))

    def run(self) -> CauseSets:
        """The posterior, its leading sets solved."""
        self.span = SEEKING, SOLVING
        found = self._weigh(self.linears[0])
        self.rows = {row.which: row for row in found.rows}
        self._weigh_ends()
        found = self._corrected(found)
        tried: set[Which] = {()}
        retried: set[tuple[Which, Which]] = set()
        wave = 0
        while due := self._due(found, tried, self._goes_on(found, wave)):
            self._weigh_more(due)
            tried |= set(due)
            left = (SOLVED - SOLVING) * 0.5**wave  # nobody knows how many waves follow
            begin, end = SOLVED - left, SOLVED - 0.7 * left
            sizes = sorted({len(w) for w in due})
            for i, size in enumerate(sizes):  # what fewer causes found, more begin with
                self.span = tuple(begin + (end - begin) * x / len(sizes) for x in (i, i + 1))
                self._solve({w: None for w in due if len(w) == size})
            again = {w: larger for w in self.solved if (larger := self._outdoing(w))}
            again = {w: larger for w, larger in again.items() if (w, larger) not in retried}
            retried |= set(again.items())
            self._solve(again)
            found = self._corrected(found)
            self.span = end, SOLVED - 0.5 * left
            while self._goes_on(found, wave + 1) and (centre := self._next_centre(found)) is not None:
                found = self._around_another(found, centre)
            wave += 1
        self._weigh_more(leading(found.log_joint, self.rows))
        found = self._corrected(found)
        self.tick("what follows from the sets", SOLVED)
        return CauseSets(found, self)

    def _tell(self, text: str, part: float) -> None:
        """What is being done, and which part of its span is done."""
        begin, end = self.span
        self.tick(text, begin + (end - begin) * part)

    def _weigh(self, linear: Linear) -> CausePosterior:
        return weigh_causes(
            linear.problem,
            linear.causes,
            self.family,
            always=linear.centre,
            cores=self.fitting.cores,
            tick=self._tell,
        )

    def linear_of(self, which: Which) -> Linear:
        """Around which a set is linear: the largest centre that it holds, of several the most evident."""
        found = self._linear_of.get(which)
        if found is None:
            around = (one for one in self.linears if set(one.centre) <= set(which))
            found = self._linear_of[which] = max(around, key=lambda one: one.rank)
        return found

    def _next_centre(self, found: CausePosterior) -> Which | None:
        """The most probable solved set around which more may be missed that is not linear around it yet."""
        missed, leader = self.missed_by_set(found), set(self.leader(found))
        done = self.fresh | {one.centre for one in self.linears if not set(one.centre) <= leader}
        left = [w for w in self.solved if w and w not in self.near | done]
        for centre in sorted(left, key=lambda w: -found.log_joint[w]):
            rank = len(centre), self.solved[centre].log_z
            held = (w for w in missed if set(centre) <= set(w))
            if sum(missed[w] for w in held if self.linear_of(w).rank <= rank) > 1.0 - MASS:
                return centre
        return None

    def _around_another(self, found: CausePosterior, centre: Which) -> CausePosterior:
        """With sets that hold a solved one weighed linear around it."""
        fresh = set(centre) <= set(self.leader(found))
        if fresh:
            self.fresh.add(centre)
        try:
            linear = self._linear(self.solved[centre], fresh)
        except SolveError:
            return found
        self.linears = [one for one in self.linears if one.centre != linear.centre]
        self.span = self.span[1], self.span[1]
        own = self._weigh(linear)
        self.linears.append(linear)
        self._linear_of.clear()
        here = [row for row in own.rows if self.linear_of(row.which) is linear]
        self.rows = {w: row for w, row in self.rows.items() if self.linear_of(w) is not linear}
        self.rows |= {row.which: row for row in here}
        self._weigh_more(list(self.solved))
        guessed = {w: x for w, x in found.guessed.items() if self.linear_of(w) is not linear}
        guessed |= {w: x for w, x in own.guessed.items() if self.linear_of(w) is linear}
        return self._corrected(replace(found, guessed=guessed))

    def _solve(self, sets: Mapping[Which, Which | None]) -> None:
        """Look at sets with the simulator, take those that may matter to their modes, keep what is better.

        Each begins where the linear model says, or where a larger set that outdoes it goes without causes.
        """
        looked = self._each(self._look, sets.items(), (0.0, LOOKED))
        found = {which: one for which, one in zip(sets, looked, strict=True) if one is not None}
        joint = {w: self.rows[w].log_prior + one.log_z for w, one in (self.solved | found).items()}
        best = max(joint.values())
        new = [w for w in found if found[w] is not self.solved.get(w)]
        # derivatives may hide one alone; what is due again would hold much if it were nearer to its mode
        on = [w for w in new if len(w) == 1 or w in self.near or joint[w] > best - NEAR]
        refined = self._each(self._refined, [(found[which],) for which in on], (LOOKED, 1.0))
        for which, one in (found | dict(zip(on, refined, strict=True))).items():
            old = None if which in self.near else self.solved.get(which)
            if old is None or one.log_z > old.log_z:
                self.solved[which] = one
                self.near = self.near - {which} if which in on else self.near | {which}

    def _each(
        self, of: Callable[..., T], every: Iterable[tuple[Any, ...]], part: tuple[float, float]
    ) -> list[T]:
        """Something of each set, at once; `part` is that of the work."""
        found: list[T] = []
        with threads(self.fitting.cores) as pool:
            for one in pool.map(lambda given: of(*given), every := list(every)):
                found.append(one)
                self._tell("solving sets of causes", float(np.interp(len(found) / len(every), (0, 1), part)))
        return found

    def _weigh_more(self, sets: Sequence[Which]) -> None:
        """Sets of which only a guess was known, by the linear model."""
        priors = CausePriors(self.causes)

        def row(which: Which) -> SetRow:
            linear = self.linear_of(which)
            like = self.rows[linear.centre].evidence
            model = SetModel(linear.problem, [linear.causes[i] for i in which], self.family)
            return SetRow(which, priors.log_prior(which), model.evidence(like.kinds, like.log_noise))

        new = [w for w in sets if w not in self.rows]
        with threads(self.fitting.cores) as pool:
            self.rows |= dict(zip(new, pool.map(row, new), strict=True))

    def _weigh_ends(self) -> None:
        """Listed effects alone whose response was found where they fit better than the linear model says."""
        least = min((end.cost for end in self.ends.values()), default=0.0)
        near = [which for which, end in self.ends.items() if end.cost < least + NEAR]
        self._weigh_more(near)
        for which, one in zip(near, self._each(self._at_end, [(w,) for w in near], (1.0, 1.0)), strict=True):
            if one.log_z > self.rows[which].evidence.total(SIZE_PRIORS) + PROMISED:
                self.solved[which] = one
                self.near.add(which)

    def _at_end(self, which: Which) -> SolvedSet:
        forward = self.fitting.model((self.origins[which[0]].effect(),))
        return self._solved_at(which, forward, self.ends[which], self.rows[which].evidence)

    def _outdoing(self, which: Which) -> Which | None:
        """The best larger set, if it was solved with visibly more evidence, as where a mode was missed."""
        larger = [w for w in self.solved if set(w) > set(which)]
        best = max(larger, key=lambda w: self.solved[w].log_z, default=which)
        return best if self.solved[best].log_z > self.solved[which].log_z + VISIBLE else None

    def _corrected(self, found: CausePosterior) -> CausePosterior:
        """With what was solved; others are shifted as the solved set that is most like them."""
        others = [w for w in self.rows if w not in self.solved]
        shifts = dict(zip(others, self.shortfall(others), strict=True))
        rows = [
            replace(row, shift=shifts[w])
            if w in shifts
            else replace(row, evidence=self.solved[w].evidence.only(row.evidence.kinds))
            for w, row in self.rows.items()
        ]
        guessed = {w: x for w, x in found.guessed.items() if w not in self.rows}
        shifts = dict(zip(guessed, self.shortfall(list(guessed)), strict=True))
        return replace(found, rows=tuple(rows), guessed=guessed, shifts=shifts)

    def gained(self, which: Which) -> float:
        """Log evidence of a solved set over that of the linear model."""
        return self.solved[which].log_z - self.rows[which].evidence.total(SIZE_PRIORS)

    def shortfall(self, sets: Sequence[Which], *, others: bool = False) -> Array:
        """What a solve adds to the log evidence of sets (n,), by the solved set most like each.

        It is sought among those that are linear around the same one; 0 of a set that none of them is like.
        With `others`, it is not the set itself.
        """
        known = [w for w in self.solved if w]
        if not known or not sets:
            return np.zeros(len(sets))
        like = likeness(sets, known, self.causes)
        at, of = (np.array([self.linears.index(self.linear_of(w)) for w in x]) for x in (sets, known))
        like[at[:, None] != of] = 0.0
        if others:
            like[like == 1.0] = 0.0
        nearest = np.argmax(like, axis=1)
        gained = np.array([self.gained(w) for w in known])
        return np.where(like[np.arange(len(sets)), nearest] > 0.0, gained[nearest], 0.0)

    @property
    def errors(self) -> dict[Which, float]:
        """Rms error of the log evidence of sets that were not solved, by what they are linear around."""
        found = {}
        for linear in self.linears:
            own = [w for w in self.solved.keys() - self.near if w and self.linear_of(w) is linear]
            best = max((self.solved[w].log_z for w in own), default=0.0)
            near = [w for w in own if self.solved[w].log_z > best - NEAR]
            errors = np.array([self.gained(w) for w in near]) - self.shortfall(near, others=True)
            found[linear.centre] = float(np.sqrt(np.mean(errors**2))) if len(errors) else 0.0
        return found

    @property
    def known(self) -> set[Which]:
        """Centres around which the linear model was seen to be right: solves would tell nothing new."""
        solved = [self.linear_of(w).centre for w in self.solved.keys() - self.near]
        return {w for w, error in self.errors.items() if error < KNOWN and solved.count(w) >= CHECKED}

    def missed_by_set(self, found: CausePosterior) -> dict[Which, float]:
        """Probability that each set may have which was not solved, two errors of the linear model up."""
        errors, known = self.errors, self.solved.keys() - self.near
        log = {
            w: x if w in known else x + 2.0 * errors[self.linear_of(w).centre]
            for w, x in found.log_joint.items()
        }
        total = logsumexp(list(log.values()))
        return {w: math.exp(x - total) for w, x in log.items() if w not in known}

    def _goes_on(self, found: CausePosterior, wave: int) -> bool:
        """Whether leading sets are still solved."""
        if wave < WAVES:
            return True
        return wave < MOST_WAVES and math.fsum(self.missed_by_set(found).values()) > UNKNOWN

    def leader(self, found: CausePosterior) -> Which:
        """The most probable set of those that were solved."""
        return max(self.solved, key=lambda which: found.log_joint[which])

    def _due(self, found: CausePosterior, tried: set[Which], more: bool) -> list[Which]:
        """The leader without each of its causes, and leading sets if more are wanted, if not tried yet.

        Where the linear model is `known` to be right only the most probable one. At first every free function
        alone is among them, which its derivative may hide, and the best listed effect of each component.
        """
        leader = self.leader(found)
        parts = [tuple(i for i in leader if i != left) for left in leader]
        due = [which for which in parts if which not in tried]
        if not more:
            return due
        total, best, known, done = 0.0, dict[str, Which](), self.known, tried - self.near
        for which, p in found.probability.items():
            new = which not in done and which not in due
            right = total > 0.0 and self.linear_of(which).centre in known
            if new and not right and total < MASS and len(due) < MOST_SOLVED:
                due.append(which)
            total += p
            if len(which) == 1:
                cause = self.causes[which[0]]
                best.setdefault(cause.name if cause.free else cause.component, which)
        if not due and math.fsum((missed := self.missed_by_set(found)).values()) > UNKNOWN:
            due = sorted((w for w in missed if w not in done), key=lambda w: -missed[w])[:MOST_SOLVED]
        return due if len(tried) > 1 else list(dict.fromkeys([*best.values(), *due]))

    # -- one set with the simulator ----------------------------------------------------------------

    def _look(self, which: Which, larger: Which | None = None) -> SolvedSet | None:
        """A set where a descent by the linear model's derivatives ends; None where nothing can be solved."""
        order = tuple(sorted(which, key=lambda i: self.origins[i].added is None))  # listed effects first
        # a listed effect may need another grid than the baseline; a function is a smooth change of it
        listed = any(self.origins[i].added is not None for i in which)
        baseline = self.fitting.baseline if listed else self.grid.model
        known = None if which in self.near else self.solved.get(which)
        added = tuple(self.origins[i].effect() for i in order)
        forward = known.forward if known else self.fitting.model(added, baseline)
        linear = self.rows[which].evidence
        search = Search(forward, self.data, linear.likely_variances(SIZE_PRIORS))
        point: Point | None = None
        starts = (
            self._starts(which, order, linear.mean[linear.best(SIZE_PRIORS)])
            if larger is None
            else [self._without(self.solved[larger], order, search)]
        )
        for u, jacobian in starts:
            try:
                tried = search.at(np.clip(u, forward.low, forward.high), jacobian)
            except SearchError:
                continue
            if point is None or tried.cost < point.cost:
                point = tried
        if point is None:
            return None
        if not known and (there := self.fitting.counted(forward.pinned(point.u))) is not forward:
            forward, search = there, Search(there, self.data, search.S)
            computed = forward(point.u)
            if computed is not None:
                point = replace(point, computed=computed, cost=search.cost(point.u, computed))
        point = search.descend(point, STEPS)
        if known and search.resume(known.point).cost < point.cost + PROMISED:
            return known
        return self._solved_at(order, forward, point, linear)

    def _refined(self, looked: SolvedSet) -> SolvedSet:
        """A set at its mode, in turns of fresh differences, a descent, and the errors beside it."""
        kept = looked
        for turn in range(TURNS):
            forward, evidence, fresh = kept.forward, kept.evidence, kept.point.jacobian
            ends = list[SolvedSet]()
            # beside a discrepancy a lesser mode costs little: noise alone says first where the mode is
            for alone in (True, False) if turn == 0 else (False,):
                search = Search(forward, self.data, evidence.likely_variances(SIZE_PRIORS, alone=alone))
                start = search.resume(kept.point)
                if not ends:
                    fresh = search.differences(start, fresh, fine=self.fitting.smooth)
                point = search.descend(replace(start, jacobian=fresh), STEPS)
                ends.append(self._solved_at(kept.order, forward, point, evidence))
            best = max(ends, key=lambda one: one.log_z)
            gained = best.log_z - kept.log_z
            if turn == 0 or gained > -PROMISED:  # the derivatives of the first were of the linear model
                kept = best
            if gained < PROMISED and not (turn == 0 and gained < -PROMISED):
                break
        return kept

    def _solved_at(self, order: Which, forward: SearchModel, point: Point, linear: SetEvidence) -> SolvedSet:
        """A set at a point, less the simulator's discretisation error there."""
        exact = self.fitting.counted(forward.corrected(point.u))
        if exact is not forward and (computed := exact(point.u)) is not None:
            forward, point = exact, replace(point, computed=computed)
        found, n_listed = self._around(order, forward, point, linear)
        return SolvedSet(order, forward, point, self._delivered(found, forward, point, n_listed), n_listed)

    def _delivered(
        self, found: SetEvidence, forward: SearchModel, point: Point, n_listed: int
    ) -> SetEvidence:
        """The evidence without what the linear model promises around the point and no solve delivers."""
        best = found.best(SIZE_PRIORS)
        seen = point.u.copy()
        seen[:n_listed] = 0.0  # weights are seen from 0, parameters from the point
        step = np.clip(found.mean[best] + point.u - seen, forward.low, forward.high) - point.u
        search = Search(forward, self.data, found.variances(best))
        here = search.cost(point.u, point.computed)
        promised = here - search.cost(point.u + step, point.computed + point.jacobian @ step)
        if promised < PROMISED:
            return found
        computed = forward(point.u + step)
        gained = 0.0 if computed is None else max(0.0, here - search.cost(point.u + step, computed))
        return replace(found, log_z=found.log_z - max(0.0, promised - gained))

    def _starts(self, which: Which, order: Which, mean: Array) -> list[tuple[Array, Array]]:
        """Where a search may begin, with derivatives: parts of the linear step, and ends of sets nearby."""
        origin, start, jacobian = self.linear_of(which).start(which, order, mean, self.origins)
        found = [(origin + part * (start - origin), jacobian) for part in NEARER]
        k = len(self.base.u)
        own = places(order, k, self.origins)
        for one in self._near(which):
            u, J = origin.copy(), jacobian.copy()
            u[:k], J[:, :k] = one.point.u[:k], one.point.jacobian[:, :k]
            for i, of in one.places(self.origins).items():
                if i in own:
                    u[own[i]], J[:, own[i]] = one.point.u[of], one.point.jacobian[:, of]
            found.append((u, J))
        return found

    def _without(self, larger: SolvedSet, order: Which, search: Search[SearchModel]) -> tuple[Array, Array]:
        """Where a larger set goes without causes that are not in `order`, by its derivatives; and these."""
        places, point = larger.places(self.origins), larger.point
        k = larger.forward.n_base
        kept = np.concatenate([np.arange(k), *(np.arange(len(point.u))[places[i]] for i in order)])
        step = np.zeros_like(point.u)
        for i in set(larger.order).difference(order):
            gone = places[i] if self.causes[i].free else slice(places[i].start, places[i].start + 1)
            step[gone] = -point.u[gone]
        left = Point(point.u[kept], point.computed + point.jacobian @ step, point.jacobian[:, kept])
        return left.u + search.step(left, NO_DAMPING), left.jacobian

    def _near(self, which: Which) -> list[SolvedSet]:
        """The best solved set inside of a set, and the best around it."""
        inside = [one for w, one in self.solved.items() if w and set(w) < set(which)]
        around = [one for w, one in self.solved.items() if set(w) > set(which)]
        return [max(part, key=lambda one: one.log_z) for part in (inside, around) if part]

    def _around(
        self, order: Which, forward: SearchModel, point: Point, linear: SetEvidence
    ) -> tuple[SetEvidence, int]:
        """Evidence of a set around a point: listed effects among the parameters, functions seen from 0."""
        there = places(order, forward.n_base, self.origins)
        free = [i for i in order if self.origins[i].added is None]
        n_listed = there[free[0]].start if free else len(point.u)
        own = self.fitting.model(forward.added[: len(order) - len(free)]) if free else forward
        residual, causes = self.data - point.computed, []
        for i in free:
            Z = point.jacobian[:, there[i]]
            residual = residual + Z @ point.u[there[i]]
            causes.append(replace(self.causes[i], columns=Z))
        problem = self._problem(own, point.u[:n_listed], residual, point.jacobian[:, :n_listed])
        problem = replace(problem, amplitudes=tuple(there[i].start for i in order if i not in free))
        change = point.computed - self.base.computed
        signal = (lambda V: without(self.jacobian, change, V)) if order else None
        found = SetModel(problem, causes, self.family).evidence(linear.kinds, linear.log_noise, signal)
        return found, n_listed


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
    def leader(self) -> Which:
        """The most probable set of those that were solved."""
        return self.search.leader(self.posterior)

    def name(self, which: Which) -> str:
        """The causes of a set."""
        return " + ".join(self.posterior.causes[i].label for i in which) or "nothing"

    def components(self, which: Which) -> tuple[str, ...]:
        """The components of a set."""
        return tuple(self.posterior.causes[i].component for i in which)

    @cached_property
    def _missed(self) -> dict[Which, float]:
        return self.search.missed_by_set(self.posterior)

    @property
    def missed(self) -> float:
        """Probability that causes which were not solved may have, two errors of the linear model up."""
        return math.fsum(self._missed.values())

    def error(self, which: Which) -> float:
        """Rms error of the log evidence of a set."""
        known = self.search.solved.keys() - self.search.near
        return 0.0 if which in known else self._errors[self.search.linear_of(which).centre]

    @cached_property
    def _errors(self) -> dict[Which, float]:
        return self.search.errors

    @property
    def linear_error(self) -> float:
        """Rms error of the log evidence where most is missed of sets that were not solved."""
        found = dict.fromkeys(self._errors, 0.0)
        for which, mass in self._missed.items():
            found[self.search.linear_of(which).centre] += mass
        return self._errors[max(found, key=lambda centre: found[centre])]

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

    def gap_after(self, which: Which, groups: Sequence[str]) -> float:
        """Rms of what a solved set leaves beyond the leader's noise in groups of one unit."""
        residual = self.search.data - self.solved[which].point.computed
        beyond = residual**2 - self._noise_variances
        return math.sqrt(max(float(np.mean(self.search.family.errors.part(beyond, *groups))), 0.0))
