"""Screening: the evidence for each effect, from a search and a linearisation.

Each hypothesis (the baseline with an effect somewhere) is taken to its mode by Gauss-Newton steps with
Broyden's updates; the marginal likelihood around the mode is that of the linearised model, which is exact
for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.data import Data
from zoo.core.diagnosis import effort
from zoo.core.diagnosis.discrepancy import model_discrepancy, possible_noise
from zoo.core.diagnosis.evidence import Fit, marginal
from zoo.core.diagnosis.file import DiagnosisError
from zoo.core.diagnosis.free import free_discrepancies
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, Hypothesis, HypothesisModel, ranges
from zoo.core.diagnosis.search import SETTLED, Point, Search, SearchError
from zoo.core.effects import EVERYWHERE, AddedEffect, Effect, EffectParameter
from zoo.core.errors.spectral import LARGEST_DELTA, GroupErrors, Spectral
from zoo.core.forward import ForwardModel

Array = NDArray[np.float64]

ALLOWANCE = 0.1
"""Part of the discrepancy that a listed effect may leave (sd): an effect is a caricature of its cause."""
NUMERICS_PART = 1e-3
"""Error of the simulator's numerics, for which no effect is blamed, in parts of a series' range."""
PRIOR_NULL, PRIOR_NONPARAMETRIC = 0.5, 0.1
"""Prior probabilities; the rest is shared equally by the effects that the data can show."""
DELTA_GRID = LARGEST_DELTA * np.array([0.0, 0.125, 0.25, 0.5, 0.75, 1.0])
"""Sizes of the allowance that are integrated over, in units of its sd."""
SEARCHED_LOCATIONS = 8
"""Locations of an effect that are searched: those where the linearised evidence is largest."""
MORE, MORE_ROUNDS = 8, 2
"""The best effects that are weighed with something else beside them too, and turns of their fit and noise."""
BATCH = 128
"""Errors beside which evidence is computed at once."""
MULTISTARTED = 4
"""How many of the best explanations are searched again beside the noise alone, with all that have a shape;
where nothing listed leads, every effect is, at its best location."""
PROMISED = 1.0
"""Gain of the log posterior that a linearisation may promise unchecked; above it, a solve is what counts."""


def _silent(text: str, share: float) -> None:
    """Says nothing."""


@dataclass(frozen=True, eq=False)
class BaseFits:
    """The baseline beside the noise, and what it is compared with: discrepancies of no listed cause.

    `alone` is the baseline with all that it leaves taken for noise, about its least squares.
    """

    fit: Fit
    alone: Fit
    unlisted: Fit
    correlated: Fit

    @property
    def noise(self) -> Mapping[str, GroupErrors]:
        """What the better of the two discrepancies leaves."""
        return max((self.unlisted, self.correlated), key=lambda f: f.log_z).errors


class Screening:
    """All hypotheses about one record, one baseline and the effects that were added to it already.

    Parameters
    ----------
    data : Data
    baseline : ForwardModel
        Solved with the tolerance that a search needs; its outputs are the data's.
    effects : sequence of Effect
        Those that can be added to the baseline and act on a solve are tried.
    errors : Spectral
        Harmonics for periodic data, cosines for others.
    added : sequence of AddedEffect
        Effects that every hypothesis has.
    start : array, optional
        Search coordinates of the baseline and those effects where a search begins, such as what an earlier
        screening found; their own start if absent.
    smooth : bool
        Whether fits end with fine differences, as in `Hooks`.
    kinks : bool
        Whether solutions have kinks in the parameters, as in `Hooks`.
    cores : int
        Threads that solve.
    tick : callable, optional
        Called with a text and the share done.
    """

    def __init__(
        self,
        data: Data,
        baseline: ForwardModel,
        effects: Sequence[Effect],
        *,
        errors: Spectral,
        added: Sequence[AddedEffect] = (),
        start: Array | None = None,
        smooth: bool = True,
        kinks: bool = False,
        cores: int = 2,
        tick: Callable[[str, float], None] | None = None,
    ) -> None:
        self.data, self.baseline = data, baseline
        self._given = errors, tuple(effects), tick
        self.errors = errors.bind(data)
        self.coefficients = self.errors.flat(data.values)
        self.added = tuple(added)
        self.start, self.smooth, self.kinks = start, smooth, kinks
        self.cores = cores
        self._tick = tick or _silent
        self.forwards: list[HypothesisModel] = []
        self._secants: dict[tuple[Hypothesis, bytes], Point] = {}
        everywhere = {one.name for one in self.added if one.location == EVERYWHERE}
        self.effects = {e.name: e for e in effects if e.apply is not None and e.offered(baseline.name)}
        self.hypotheses = {
            name: [Hypothesis((*self.added, one)) for one in new]
            for name, e in self.effects.items()
            if name not in everywhere
            and (new := [one for one in map(e.at, e.locations(baseline)) if one not in self.added])
        }
        self.range = ranges(data)

    def tick(self, text: str, share: float) -> None:
        """Say what is being tried, and the share of this screening that is done."""
        beside = f" (beside {len(self.added)} added)" if self.added else ""
        self._tick("weighing" if share >= 1.0 else text + beside, share)

    def forward(self, hypothesis: Hypothesis) -> HypothesisModel:
        """Its series as functions of the search's coordinates."""
        forward = HypothesisModel(self.baseline, hypothesis, self.errors)
        self.forwards.append(forward)
        return forward

    @property
    def solves(self) -> int:
        """So far."""
        return sum(f.solves for f in self.forwards)

    @property
    def failures(self) -> int:
        """Solves that failed so far."""
        return sum(f.failures for f in self.forwards)

    @property
    def secants(self) -> Mapping[tuple[Hypothesis, bytes], Point]:
        """Starts that were solved; each has the secant from the baseline as its first derivative."""
        return self._secants

    # -- errors ----------------------------------------------------------------------------------

    def _noise(self, residual: Array, allowances: Mapping[str, float]) -> dict[str, GroupErrors]:
        """Noise and allowance that fit a residual."""
        start = GroupErrors(1.0, delta=0.0, length=self.errors.typical_length)
        return {
            q: self.errors.fit_noise(residual, q, start, free_delta=scale > 0, scale=scale)
            for q, scale in allowances.items()
        }

    def numerics(self) -> dict[str, float]:
        """Allowance for the solver's own error, by quantity."""
        return {q: NUMERICS_PART * size for q, size in self.range.items()}

    def beside(self, noise: Mapping[str, GroupErrors], allowances: Mapping[str, float]) -> Array:
        """Variances (n,) of that noise with an allowance, whatever discrepancy it was found beside."""
        at = {
            q: replace(e, delta=allowances[q], length=self.errors.typical_length, shared=0.0, rough=False)
            for q, e in noise.items()
        }
        return self.errors.variances(at)

    def evidence(self, forward: HypothesisModel, point: Point, allowances: Mapping[str, float]) -> Fit:
        """Marginal likelihood around a point, in closed form; over the allowance on a grid."""
        residual = self.coefficients - point.computed
        errors = self._noise(residual, allowances)
        log_prior, precision, pull = forward.prior(point.u)
        log_prior += sum(self.errors.noise_log_prior(e) for e in errors.values())
        weights = np.exp(-0.5 * DELTA_GRID**2)
        weights /= weights.sum()
        terms, bests = [], []
        for factor, weight in zip(DELTA_GRID, weights, strict=True):
            at = {q: replace(e, delta=factor * allowances[q]) for q, e in errors.items()}
            log_z, step, C = marginal(residual, point.jacobian, self.errors.variances(at), precision, pull)
            mean = point.u + step
            terms.append(math.log(weight) + log_z + forward.log_mass(mean, C))
            bests.append((mean, C, at))
        best = int(np.argmax(terms))
        return Fit(
            forward.hypothesis,
            forward,
            point.u,
            point.computed,
            point.jacobian,
            residual,
            bests[best][2],
            dict(allowances),
            float(logsumexp(terms)) + log_prior,
            bests[best][0],
            bests[best][1],
        )

    # -- the baseline ----------------------------------------------------------------------------

    def with_baseline(self, baseline: ForwardModel, start: Array) -> Screening:
        """The same with another baseline, whose search begins elsewhere."""
        errors, effects, tick = self._given
        return Screening(
            self.data,
            baseline,
            effects,
            errors=errors,
            added=self.added,
            start=start,
            smooth=self.smooth,
            kinks=self.kinks,
            cores=self.cores,
            tick=tick,
        )

    @cached_property
    def base(self) -> BaseFits:
        """The baseline with what was added to it, fitted beside the noise that a free discrepancy leaves.

        Raises
        ------
        SearchError
            If it cannot be solved.
        DiagnosisError
            If the series do not tell its parameters.
        """
        try:
            base = self.fit_base()
            unlisted = self.fit_free(base, NONPARAMETRIC)
            correlated = self.fit_free(base, CORRELATED)
            found = BaseFits(base, base, unlisted, correlated)
            return replace(found, fit=self.refit_base(base, found.noise))
        except np.linalg.LinAlgError:
            raise DiagnosisError(self._singular()) from None

    def _singular(self) -> str:
        """Which parameters the series do not tell, where a search begins."""
        forward = self.forwards[0]
        start = forward.start if self.start is None else self.start
        search = Search(forward, self.coefficients, np.ones(len(self.coefficients)))
        J = search.at(start).jacobian * forward.units
        names = [p.name for p in forward.parameters]
        unused = [name for name, size in zip(names, np.abs(J).max(axis=0), strict=True) if size == 0.0]
        if unused:
            return (
                f"{self.baseline.name}: its series do not depend on {', '.join(unused)}: leave "
                f"{'it' if len(unused) == 1 else 'them'} out of the model's parameters, or correct the model"
            )
        weak = np.linalg.svd(J / np.linalg.norm(J, axis=0))[2][-1]
        alike = [name for name, part in zip(names, weak, strict=True) if abs(part) > effort.ALIKE]
        return (
            f"{self.baseline.name}: its series do not tell {' from '.join(alike)}: fix one of them, or give "
            "it a normal prior"
        )

    def fit_base(self) -> Fit:
        """The baseline (with what was added) at its mode, under noise alone."""
        self.tick("baseline", 0.0)
        forward = self.forward(Hypothesis(self.added))
        # loose errors first: far from the mode a tenth of the range is what the linearisation is good for
        S = self.errors.variances({q: GroupErrors(effort.FAR * size) for q, size in self.range.items()})
        search = Search(forward, self.coefficients, S)
        start = search.at(forward.start if self.start is None else self.start)
        far = search.refine(search.descend(start, effort.FAR_STEPS, effort.FAR_GAIN), effort.FAR_ROUNDS)
        # what an earlier screening found is not to be lost on the way
        starts = [far, start] if self.kinks and self.start is not None else [far]
        return max((self._turned(forward, point) for point in starts), key=lambda fit: fit.log_z)

    def _turned(self, forward: HypothesisModel, point: Point) -> Fit:
        """The baseline and its noise, fitted in turns from a point on."""
        for _ in range(effort.BASE_TURNS):
            errors = self._noise(self.coefficients - point.computed, self.numerics())
            search = Search(forward, self.coefficients, self.errors.variances(errors))
            point = search.resume(point)
            before = point.cost
            point = search.refine(point, 2, fine=self.smooth)
            if before - point.cost < SETTLED:
                break
        return self.evidence(forward, point, self.numerics())

    def refit_base(self, base: Fit, noise: Mapping[str, GroupErrors]) -> Fit:
        """The baseline's best fit beside the noise that a nonparametric discrepancy leaves."""
        search = Search(base.forward, self.coefficients, self.beside(noise, self.numerics()))
        return self.evidence(
            base.forward,
            search.refine(search.descend(search.resume(base), effort.BASE_STEPS), 2, fine=self.smooth),
            self.numerics(),
        )

    def _integrated(
        self,
        forward: HypothesisModel,
        point: Point,
        residual: Array,
        options: Sequence[Mapping[str, GroupErrors]],
        precision: Array,
        pull: Array,
    ) -> tuple[Array, Array, Array]:
        """Log evidence (n,), steps (n, d) and covariances (n, d, d) beside each of n errors."""
        found = []
        for i in range(0, len(options), BATCH):
            S = np.stack([self.errors.variances(at) for at in options[i : i + BATCH]])
            log_z, step, C = marginal(residual, point.jacobian, S, precision, pull)
            found.append((log_z + forward.log_mass(point.u + step, C), step, C))
        log_z, steps, spreads = (np.concatenate(x) for x in zip(*found, strict=True))
        return log_z, steps, spreads

    def fit_free(self, base: Fit, name: str, rounds: int = effort.FREE_ROUNDS) -> Fit:
        """A fit with a discrepancy: smooth and shared by the series, or noise of its own in each."""
        noise = {q: replace(e, delta=0.0, rough=False) for q, e in base.errors.items()}
        point = Point(base.u, base.computed, base.jacobian)
        found: Fit | None = None
        for round_ in range(rounds):
            residual = self.coefficients - point.computed
            log_prior, precision, pull = base.forward.prior(point.u)
            options, weights, kind_of = free_discrepancies(self.errors, noise, correlated=name == CORRELATED)
            each, steps, spreads = self._integrated(base.forward, point, residual, options, precision, pull)
            best = int(np.argmax(weights + each))
            best_at, best_step, best_C = options[best], steps[best], spreads[best]
            each = each + weights
            log_z = float(logsumexp(each))
            # where the data say little, the linearised mode may lie far outside the bounds
            best_step = np.clip(point.u + best_step, base.forward.low, base.forward.high) - point.u
            # the noise beside this discrepancy
            part = residual - point.jacobian @ best_step
            refit = {q: self.errors.fit_noise(part, q, best_at[q]) for q in self.errors.groups}
            noise = {q: replace(e, delta=0.0) for q, e in refit.items()}
            log_noise = sum(self.errors.noise_log_prior(e) for e in noise.values())
            parts = [[i for i, one in enumerate(kind_of) if one == kind] for kind in dict.fromkeys(kind_of)]
            shares = [float(logsumexp(weights[part])) for part in parts]
            tops = [float(logsumexp(each[part])) + log_prior + log_noise for part in parts]
            found = Fit(
                base.hypothesis, base.forward, point.u, point.computed, point.jacobian, residual,
                {q: replace(best_at[q], sigma=e.sigma, ratio=e.ratio, tau=e.tau) for q, e in refit.items()},
                {q: best_at[q].delta for q in best_at}, log_z + log_prior + log_noise,
                point.u + best_step, best_C,
                tuple((w, top - w) for w, top in zip(shares, tops, strict=True)),
            )  # fmt: skip
            if round_ == rounds - 1:
                break
            search = Search(base.forward, self.coefficients, self.errors.variances(found.errors))
            point.cost = search.cost(point.u, point.computed)
            point = search.descend(point, effort.FREE_STEPS)
        assert found is not None
        return found

    def and_more(self, fits: Sequence[Fit]) -> list[float]:
        """Log evidence of effects with something else, a free discrepancy, beside them."""
        with ThreadPoolExecutor(max(1, self.cores)) as pool:
            found = pool.map(lambda fit: self.fit_free(fit, NONPARAMETRIC, MORE_ROUNDS).log_z, fits)
            return list(found)

    # -- the effects -----------------------------------------------------------------------------

    def fit_effect(
        self,
        hypothesis: Hypothesis,
        base: Fit,
        S: Array,
        allowances: Mapping[str, float],
    ) -> Fit | None:
        """A hypothesis at the best mode that its starts lead to; None where the solver fails at all."""
        forward = self.forward(hypothesis)
        search = Search(forward, self.coefficients, S)
        parameters = hypothesis.effect.parameters
        best: Point | None = None
        starts = list(parameters[0].starts)
        if min(starts) < 0.0 < max(starts):  # the linearisation says which side to look at
            try:
                aim = self._aim(search, self._secant(search, base, self._start(parameters, starts[0])))[1]
                starts = [x for x in starts if (x > 0.0) == (aim > 0.0)]
            except SearchError:
                pass
        for first in starts:
            try:
                point = search.descend(
                    self._secant(search, base, self._start(parameters, first)), effort.START_STEPS
                )
            except SearchError:
                continue
            best = point if best is None or point.cost < best.cost else best
        if best is None:
            return None
        return self.evidence(forward, best, allowances)

    def multistart(
        self, fit: Fit, base: Fit, noise: Mapping[str, GroupErrors], allowances: Mapping[str, float]
    ) -> Fit:
        """A fit searched again beside the noise alone, from all starts and several shapes.

        With the full allowance, what is smooth costs so little that a lesser mode may look as good, and that
        the mode stands where something is left to explain.
        """
        search = Search(fit.forward, self.coefficients, self.beside(noise, self.numerics()))
        best = search.resume(fit)
        parameters = fit.hypothesis.effect.parameters
        shapes = [
            [float(np.clip(a.centre + move * a.scale, a.low, a.high)) for a in parameters[1:]]
            for move in (effort.SHAPES if len(parameters) > 1 else effort.SHAPES[:1])
        ]
        for first, shape in product(parameters[0].starts, shapes):
            try:
                point = search.descend(
                    self._secant(search, base, np.array([first, *shape])), effort.AGAIN_STEPS
                )
            except SearchError:
                continue
            if point.cost < best.cost:
                best = point
        return self.settled(fit, best, noise, allowances, self.delivered(fit))

    def elsewhere(
        self, fit: Fit, other: Fit, noise: Mapping[str, GroupErrors], allowances: Mapping[str, float]
    ) -> Fit:
        """A fit searched again from where another explanation has the parameters that both share.

        Where the solution has kinks, two searches from one start may end in different modes, and rounding
        decides which; what one explanation found, its rivals try.
        """
        search = Search(fit.forward, self.coefficients, self.beside(noise, self.numerics()))
        n = fit.forward.asked
        own = search.resume(fit)
        u = np.concatenate([other.u[:n], fit.u[n:]])
        jacobian = np.hstack([other.jacobian[:, :n], fit.jacobian[:, n:]])
        try:
            start = search.at(u, jacobian)
        except SearchError:
            return fit
        best = search.refine(start, effort.AGAIN_ROUNDS, effort.AGAIN_STEPS)
        if own.cost - best.cost < SETTLED:
            return fit
        return self.settled(fit, best, noise, allowances, fit.log_z)  # which is what was delivered

    def settled(
        self,
        fit: Fit,
        best: Point,
        noise: Mapping[str, GroupErrors],
        allowances: Mapping[str, float],
        least: float,
    ) -> Fit:
        """The evidence at a point, after turns of its search and its noise, and at least what the fit had."""
        search = Search(fit.forward, self.coefficients, self.beside(noise, self.numerics()))
        found = self.evidence(
            fit.forward,
            search.refine(best, effort.AGAIN_ROUNDS, effort.AGAIN_STEPS, fine=self.smooth),
            allowances,
        )
        for _ in range(effort.AGAIN_TURNS):  # a free discrepancy leaves other noise than a cause
            search = Search(fit.forward, self.coefficients, self.beside(found.errors, self.numerics()))
            best = search.resume(found)
            before = best.cost
            if found.log_z - self.delivered(found) > PROMISED:  # at a kink derivatives mislead
                best = search.polish(best, found.sd, effort.POLISHED)
            best = search.refine(best, effort.AGAIN_ROUNDS, effort.AGAIN_STEPS, fine=self.smooth)
            found = self.evidence(fit.forward, best, allowances)
            if before - best.cost < SETTLED:
                break
        # both linearise one posterior, and what lies off the mode may promise more than is there
        return replace(found, log_z=max(self.delivered(found), least))

    def delivered(self, fit: Fit) -> float:
        """Log evidence of a fit whose linearised model gains no more, at its mode, than a solve there does.

        log Z - max(0, G' - max(0, G)), G the log posterior gained from the fit's point to the mode that its
        linearisation sees, G' what the linearisation says of it. At a kink a difference to one side promises
        what is not there; where no kinks are expected, log Z.
        """
        if not self.kinks:
            return fit.log_z
        search = Search(fit.forward, self.coefficients, self.errors.variances(fit.errors))
        here = search.cost(fit.u, fit.computed)
        aim = np.clip(fit.mean, fit.forward.low, fit.forward.high)
        promised = here - search.cost(aim, fit.computed + fit.jacobian @ (aim - fit.u))
        if promised < PROMISED:
            return fit.log_z
        computed = fit.forward(aim)
        gained = 0.0 if computed is None else max(0.0, here - search.cost(aim, computed))
        return fit.log_z - max(0.0, promised - gained)

    @staticmethod
    def _start(parameters: Sequence[EffectParameter], first: float) -> Array:
        return np.array([first, *(a.centre for a in parameters[1:])])

    def _secant(self, search: Search, base: Fit, start: Array) -> Point:
        """A start with the baseline's own Jacobian, and secants for the effect's; solved once."""
        key = (search.forward.hypothesis, start.tobytes())
        if key in self._secants:
            known = self._secants[key]
            return replace(known, cost=search.cost(known.u, known.computed))
        u = np.concatenate([base.u, start])
        computed = search.forward(u)
        if computed is None:
            u = np.concatenate([base.u, effort.RETREAT * start])
            computed = search.forward(u)
        if computed is None:
            raise SearchError(search.forward.last_failure)
        n = len(base.u)
        jacobian = np.zeros((len(computed), len(u)))
        jacobian[:, :n] = base.jacobian
        jacobian[:, n] = (computed - base.computed) / u[n]
        point = Point(u, computed, jacobian, search.cost(u, computed))
        for i in range(n + 1, len(u)):  # a shape parameter has no signature at its first parameter's 0
            moved = u.copy()
            step = effort.RETREAT * search.forward.units[i]
            moved[i] += step if u[i] + step <= search.forward.high[i] else -step
            other = search.forward(moved)
            if other is not None:
                jacobian[:, i] = (other - computed) / (moved[i] - u[i])
        self._secants[key] = point
        return point

    def _aim(self, search: Search, point: Point) -> tuple[float, float]:
        """Evidence of the linearised model, and where its mode has the first parameter."""
        _, precision, pull = search.forward.prior(point.u)
        log_z, step, _ = marginal(
            self.coefficients - point.computed, point.jacobian, search.S, precision, pull
        )
        n = search.forward.asked
        return log_z, float(point.u[n] + step[n])

    def _promising(
        self, hypotheses: Sequence[Hypothesis], base: Fit, S: Array, pool: Any
    ) -> list[Hypothesis]:
        """The locations of an effect that are worth a search: the best by the linearised evidence."""
        if len(hypotheses) <= SEARCHED_LOCATIONS:
            return list(hypotheses)
        parameters = hypotheses[0].effect.parameters

        def linear(h: Hypothesis) -> float:
            search = Search(self.forward(h), self.coefficients, S)
            try:
                start = self._start(parameters, parameters[0].starts[0])
                return self._aim(search, self._secant(search, base, start))[0]
            except SearchError:
                return -math.inf

        ranked = sorted(zip(pool.map(linear, hypotheses), range(len(hypotheses)), strict=True), reverse=True)
        return [hypotheses[i] for _, i in ranked[:SEARCHED_LOCATIONS]]

    def run(self, *, stop_at_noise: bool = False) -> Screened:
        """Fit everything.

        Parameters
        ----------
        stop_at_noise : bool
            Try no effects where noise alone is more probable than a free discrepancy.

        Returns
        -------
        Screened
        """
        base, unlisted, correlated = self.base.fit, self.base.unlisted, self.base.correlated
        noise = self.base.noise
        gap = {q: self.discrepancy_size(base, noise, q) for q in self.errors.groups}
        allowances = {q: math.hypot(ALLOWANCE * gap[q], own) for q, own in self.numerics().items()}
        S = self.beside(noise, allowances)
        odds = base.log_z - max(unlisted.log_z, correlated.log_z) + math.log(PRIOR_NULL / PRIOR_NONPARAMETRIC)
        if stop_at_noise and odds > 0.0:
            self.hypotheses = {}
        fits: dict[Hypothesis, Fit] = {}
        rivals: list[Hypothesis] = []
        ended: dict[Hypothesis, Fit] = {}

        def one(h: Hypothesis) -> tuple[Hypothesis, Fit | None]:
            return h, self.fit_effect(h, base, S, allowances)

        def again(h: Hypothesis) -> tuple[Hypothesis, Fit]:
            fit = fits[h]
            search = Search(fit.forward, self.coefficients, S)
            return h, self.evidence(fit.forward, search.refine(search.resume(fit)), allowances)

        def from_all_starts(h: Hypothesis) -> tuple[Hypothesis, Fit]:
            return h, self.multistart(fits[h], base, noise, allowances)

        def from_the_best_rival(h: Hypothesis) -> tuple[Hypothesis, Fit]:
            others = [ended[one] for one in rivals if one.name != h.name]
            return h, self.elsewhere(ended[h], others[0], noise, allowances) if others else ended[h]

        with ThreadPoolExecutor(max(1, self.cores)) as pool:
            jobs = []
            for done, locations in enumerate(self.hypotheses.values(), 1):
                self.tick(locations[0].name, 0.2 * done / len(self.hypotheses))
                jobs += self._promising(locations, base, S, pool)
            for done, (h, fit) in enumerate(pool.map(one, jobs), 1):
                self.tick(h.name, 0.2 + 0.5 * done / len(jobs))
                if fit is not None:
                    fits[h] = fit
            leading = []
            for locations in self.hypotheses.values():
                ranked = sorted((h for h in locations if h in fits), key=lambda h: -fits[h].log_z)
                leading += ranked[: effort.REFINED]
            for done, (h, fit) in enumerate(pool.map(again, leading), 1):
                self.tick(h.name, 0.7 + 0.25 * done / len(leading))
                fits[h] = fit
            ranked = sorted(fits, key=lambda h: -fits[h].log_z)
            best_of = {h.name: h for h in reversed(ranked)}
            # where nothing listed leads, what each effect leaves is the answer, and has to be comparable
            leads = ranked and fits[ranked[0]].log_z > max(unlisted.log_z, correlated.log_z)
            everyone = not leads and not self.added
            shaped = [h for h in best_of.values() if everyone or len(h.effect.parameters) > 1]
            again_from_all = list(dict.fromkeys([*ranked[:MULTISTARTED], *shaped]))
            for done, (h, fit) in enumerate(pool.map(from_all_starts, again_from_all), 1):
                self.tick(h.name, 0.95 + 0.03 * done / len(again_from_all))
                fits[h] = fit
            if self.kinks:
                rivals = sorted(again_from_all, key=lambda h: -fits[h].log_z)[:MULTISTARTED]
                ended = dict(fits)  # each starts from what all had ended with, in whatever order they come
            for done, (h, fit) in enumerate(pool.map(from_the_best_rival, rivals), 1):
                self.tick(h.name, 0.98 + 0.02 * done / len(rivals))
                fits[h] = fit
        # the best explanation of all leaves the noise: a free discrepancy takes some of it along
        best = max((unlisted, correlated, *fits.values()), key=lambda f: f.log_z)
        # beside its noise the baseline has its best fit too: the discrepancy is what that leaves
        refitted = self.refit_base(base, best.errors)
        base = replace(refitted, log_z=max(base.log_z, refitted.log_z))
        possible = possible_noise(best)
        # with the noise of another explanation a few harmonics may count for all: the best fit misses least
        least = min((refitted, self.base.fit, self.base.alone), key=self.missed)
        twice = frozenset(again_from_all)
        return Screened(
            self, base, least, unlisted, correlated, fits, best.errors, possible, gap, allowances, twice
        )

    def missed(self, fit: Fit) -> float:
        """Mean square residual, in parts of each group's range."""
        parts = (self.errors.part(fit.residual, q) / size for q, size in self.range.items())
        return float(np.sum([np.sum(part**2) for part in parts]))

    def discrepancy_size(self, fit: Fit, noise: Mapping[str, GroupErrors], group: str) -> float:
        """Rms of truth minus fit, in the group's unit."""
        known = {g: [(0.0, e)] for g, e in noise.items()}
        left = model_discrepancy(fit, known, np.random.default_rng(0), effort.SIZE_DRAWS)
        return math.sqrt(float(np.mean(self.errors.part(left.draws, group) ** 2)))


@dataclass(frozen=True, eq=False)
class Screened:
    """What a screening found.

    `base` is the baseline beside the noise of the best explanation, as all of them are fitted; `least` is the
    fit of the baseline that leaves the smallest residual; `twice` are the hypotheses that were searched again
    from all starts beside the noise alone, so that what they leave is the least that was found.
    """

    screening: Screening
    base: Fit
    least: Fit
    nonparametric: Fit
    correlated: Fit
    fits: Mapping[Hypothesis, Fit]
    noise: Mapping[str, GroupErrors]
    possible_noise: Mapping[str, Sequence[tuple[float, GroupErrors]]]
    gap: Mapping[str, float]
    allowances: Mapping[str, float]
    twice: frozenset[Hypothesis] = frozenset()
