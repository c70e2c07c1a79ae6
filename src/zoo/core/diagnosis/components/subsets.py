"""Several listed effects at once: every subset weighed in the linear model, the best ones searched.

Effects that are added one after the other have to explain something each on its own. Two whose signatures
cancel where the data have nothing do so only together, and are found only by weighing pairs. In the model
that is linear in the first parameter of each effect, with the signatures that a screening has solved already,
the evidence for a subset is closed-form and takes microseconds.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import combinations, islice

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.diagnosis import effort
from zoo.core.diagnosis.evidence import Fit, marginal
from zoo.core.diagnosis.hypothesis import Hypothesis
from zoo.core.diagnosis.screening import (
    DELTA_GRID,
    PRIOR_NONPARAMETRIC,
    PRIOR_NULL,
    Screened,
)
from zoo.core.diagnosis.search import Search, SearchError
from zoo.core.effects import AddedEffect
from zoo.core.priors import log_normal_mass

Array = NDArray[np.float64]
Indices = NDArray[np.int_]

LARGEST_SUBSET = 4
"""Most effects of a subset."""
SIGNATURES = (1000, 400, 70, 30)
"""Signatures that take part in subsets of one to four: those of the best smaller subsets."""
KEPT = 20
"""Sets of effects that are told, besides each effect alone."""
AT_ONCE = 20000
"""Subsets that are weighed at once."""
SMALLEST_SECANT = 0.05
"""Size of a fitted first parameter, in its prior's scale, below which its derivative is its signature."""
SEARCHED_SUBSETS, SEARCHED_ROUNDS = 2, 2
"""Subsets of several effects that are searched with the solver, where they are more probable than one effect
alone; rounds of fresh differences."""
OTHER_SIGN = 3.0
"""Log-likelihood ratio, 20 to 1, by which the sign that an effect cannot have must explain more."""


@dataclass(frozen=True, eq=False)
class Signature:
    """What an effect at a location does to the series, by its first parameter.

    `change` (n,) is of the flat coefficients, for one unit of it; `others` are the effect's other parameters
    at which it was found.
    """

    added: AddedEffect
    change: Array = field(repr=False)
    others: Array = field(repr=False)

    @property
    def name(self) -> str:
        """Of the effect."""
        return self.added.name


@dataclass(frozen=True, eq=False)
class Subset:
    """Some effects, each at a location.

    `log_z` is the log evidence over the baseline alone, of the linear model; `log_odds` that with the prior
    odds; `amplitudes` are the posterior means of the first parameters, within their bounds, and `step` that
    of the baseline's parameters, both where the allowance is the most probable one.
    """

    signatures: tuple[Signature, ...]
    log_z: float
    log_odds: float
    amplitudes: Array
    step: Array = field(repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the effects, in alphabetical order."""
        return tuple(sorted(one.name for one in self.signatures))


@dataclass(frozen=True, eq=False)
class Subsets:
    """All subsets of the listed effects, weighed.

    Parameters
    ----------
    best : tuple of Subset
        The most probable ones of different sets of effects, and each effect alone, most probable first.
    probability : mapping of names to float
        Of each set of effects (the empty one is the baseline alone), over all locations.
    inclusion : mapping of name to float
        Probability of each effect that it is there, alone or among others.
    opposite : mapping of name to float
        Of effects whose first parameter has one sign only: log-likelihood that the other would gain over it.
    weighed : int
        Number of subsets.
    """

    best: tuple[Subset, ...] = field(repr=False)
    probability: Mapping[tuple[str, ...], float] = field(repr=False)
    inclusion: Mapping[str, float]
    opposite: Mapping[str, float]
    weighed: int

    @property
    def leader(self) -> tuple[str, ...]:
        """The most probable set of effects."""
        return max(self.probability, key=lambda names: self.probability[names])

    @property
    def over_single(self) -> float:
        """Log evidence of the best subset of several effects over the best effect alone; -inf without any."""
        alone = max((s.log_z for s in self.best if len(s.signatures) == 1), default=-math.inf)
        several = max((s.log_z for s in self.best if len(s.signatures) > 1), default=-math.inf)
        return several - alone if several > -math.inf else several

    def opposite_sign(self, name: str) -> bool:
        """Whether the sign that an effect's amplitude cannot have would explain more than the one it has."""
        return self.opposite.get(name, 0.0) > OTHER_SIGN


def signatures_of(screened: Screened) -> list[Signature]:
    """What the effects of a screening do to the series: secants from the baseline to starts and to modes."""
    screening = screened.screening
    base = screening.base.fit
    n = len(base.u)
    fitted: list[Signature] = []
    for hypothesis, fit in screened.fits.items():
        first = hypothesis.effect.parameters[0]
        if abs(fit.u[n]) < SMALLEST_SECANT * first.scale:
            change = fit.jacobian[:, n]
        else:
            moved = base.jacobian @ (fit.u[:n] - base.u)
            change = (fit.computed - base.computed - moved) / fit.u[n]
        fitted.append(Signature(hypothesis.added[-1], change, fit.u[n + 1 :]))
    known = {s.added for s in fitted if not len(s.others)}
    started: dict[AddedEffect, Signature] = {}
    for (hypothesis, _), point in screening.secants.items():
        one = hypothesis.added[-1]
        if one not in known:  # another shape, or another place, than what explains most alone
            started.setdefault(one, Signature(one, point.jacobian[:, n], point.u[n + 1 :]))
    return [*fitted, *started.values()]


class _Linear:
    """The baseline with all signatures, linear, beside each allowance of the grid."""

    def __init__(self, screened: Screened, signatures: Sequence[Signature]) -> None:
        screening, self.signatures = screened.screening, signatures
        base = screening.base.fit
        _, precision, pull = base.forward.prior(base.u)
        first = [s.added.effect.parameters[0] for s in signatures]
        self.scale = np.array([p.scale for p in first])
        self.low, self.high = (np.array([getattr(p, x) for p in first]) for x in ("low", "high"))
        self.prior_mass = log_normal_mass(self.low / self.scale, self.high / self.scale)
        G = np.stack([s.change for s in signatures], axis=1) * self.scale
        weights = np.exp(-0.5 * DELTA_GRID**2)
        self.log_weights = np.log(weights / weights.sum())
        self.A, self.q, self.log_z0, self.steps, self.moves = [], [], [], [], []
        for factor in DELTA_GRID:
            S = screening.beside(screened.noise, {q: factor * x for q, x in screened.allowances.items()})
            log_z, step, C = marginal(base.residual, base.jacobian, S, precision, pull)
            scaled = G / S[:, None]
            cross = base.jacobian.T @ scaled
            self.A.append(G.T @ scaled - cross.T @ C @ cross)
            self.q.append(scaled.T @ base.residual - cross.T @ step)
            self.log_z0.append(float(log_z))
            self.steps.append(step)
            self.moves.append(C @ cross)
        self.nothing = float(logsumexp(self.log_weights + np.array(self.log_z0)))

    def _posterior(self, i: int, subsets: Indices) -> tuple[Array, Array, Array]:
        """Beside one allowance: log evidence (m,); means and covariances of amplitudes over their scales."""
        k = subsets.shape[1]
        A = self.A[i][subsets[:, :, None], subsets[:, None, :]] + np.eye(k)
        q = self.q[i][subsets]
        C = np.linalg.inv(A)
        mean = np.einsum("mij,mj->mi", C, q)
        log_z = self.log_z0[i] + 0.5 * np.sum(q * mean, axis=1) - 0.5 * np.linalg.slogdet(A)[1]
        sd = np.sqrt(np.maximum(np.einsum("mii->mi", C), 1e-300))
        scale, low, high = self.scale[subsets], self.low[subsets], self.high[subsets]
        log_z += np.sum(
            log_normal_mass((low / scale - mean) / sd, (high / scale - mean) / sd) - self.prior_mass[subsets],
            axis=1,
        )
        return log_z, mean, C

    def log_z(self, subsets: Indices) -> Array:
        """Log evidence (m,) of subsets (m, k) over that of the baseline alone."""
        each = [w + self._posterior(i, subsets)[0] for i, w in enumerate(self.log_weights)]
        return np.asarray(logsumexp(each, axis=0) - self.nothing)

    def at(self, subset: Sequence[int]) -> tuple[Array, Array]:
        """Amplitudes, and the step of the baseline's parameters, beside the most probable allowance."""
        index = np.array([subset])
        found = [self._posterior(i, index) for i in range(len(DELTA_GRID))]
        i = int(np.argmax([w + x[0][0] for w, x in zip(self.log_weights, found, strict=True)]))
        scale, low, high = (x[index[0]] for x in (self.scale, self.low, self.high))
        amplitudes = np.clip(found[i][1][0] * scale, low, high)
        return amplitudes, self.steps[i] - self.moves[i][:, index[0]] @ (amplitudes / scale)

    def gains(self) -> tuple[Array, Array]:
        """Of each alone, beside the full allowance: amplitude over its scale, log-likelihood gained."""
        i = int(np.argmin(np.abs(DELTA_GRID - 1.0)))
        size = np.maximum(np.diag(self.A[i]), 1e-300)
        return self.q[i] / size, 0.5 * self.q[i] ** 2 / size


def _chunks(names: Sequence[str], among: Sequence[int], k: int) -> Iterator[Indices]:
    """Subsets of k of the signatures, each of another effect."""
    every = (c for c in combinations(among, k) if len({names[i] for i in c}) == k)
    while part := list(islice(every, AT_ONCE)):
        yield np.array(part)


def weigh_subsets(
    screened: Screened, *, largest: int = LARGEST_SUBSET, price: float | None = None
) -> Subsets:
    """Evidence for every subset of a screening's listed effects, in the linear model.

    log Z = log Z_0 - log|I + D A D|/2 + q'D (I + D A D)^-1 D q/2 + log mass, D the prior scales, A and q the
    products of the signatures with each other and with the residual, without what the baseline's parameters
    can absorb, over the grid of the allowance; the mass is that of the amplitudes' normal posterior inside
    their bounds over that of the prior.

    Parameters
    ----------
    screened : Screened
    largest : int
        Most effects of a subset.
    price : float, optional
        Prior odds of one more effect over none. As a round of the screening has it if absent: an equal part
        of what `no-gap` and `unlisted` leave, over what `no-gap` has.

    Returns
    -------
    Subsets
    """
    signatures = signatures_of(screened)
    if not signatures:
        return Subsets((), {(): 1.0}, {}, {}, 0)
    names = [s.name for s in signatures]
    effects = list(dict.fromkeys(names))
    if price is None:
        price = (1.0 - PRIOR_NULL - PRIOR_NONPARAMETRIC) / (len(effects) + 1) / PRIOR_NULL
    linear = _Linear(screened, signatures)
    each = np.array([math.log(price / names.count(name)) for name in names])
    odds: dict[tuple[str, ...], list[float]] = {(): [0.0]}
    best: dict[tuple[str, ...], tuple[float, float, tuple[int, ...]]] = {}
    among, weighed = list(range(len(names))), 0
    for k in range(1, min(largest, LARGEST_SUBSET, len(effects)) + 1):
        top = np.full(len(names), -math.inf)
        for part in _chunks(names, among[: SIGNATURES[k - 1]], k):
            log_z = linear.log_z(part)
            log_odds = log_z + each[part].sum(axis=1)
            weighed += len(part)
            for column in part.T:
                np.maximum.at(top, column, log_odds)
            for i in np.argsort(-log_odds):
                key = tuple(sorted(names[j] for j in part[i]))
                odds.setdefault(key, []).append(float(log_odds[i]))
                if key not in best or log_odds[i] > best[key][1]:
                    best[key] = float(log_z[i]), float(log_odds[i]), tuple(int(j) for j in part[i])
        among = sorted(among, key=lambda j: -top[j])
    highest = max(max(x) for x in odds.values())
    parts = {key: sum(math.exp(one - highest) for one in x) for key, x in odds.items()}
    total = sum(parts.values())
    probability = {key: part / total for key, part in parts.items()}
    found = []
    ranked = sorted(best.values(), key=lambda x: -x[1])
    for z, with_odds, subset in [x for i, x in enumerate(ranked) if i < KEPT or len(x[2]) == 1]:
        amplitudes, step = linear.at(subset)
        found.append(Subset(tuple(signatures[j] for j in subset), z, with_odds, amplitudes, step))
    inclusion = dict.fromkeys(effects, 0.0)
    for key, p in probability.items():
        for name in key:
            inclusion[name] += p
    return Subsets(tuple(found), probability, inclusion, _opposite(linear, names), weighed)


def _opposite(linear: _Linear, names: Sequence[str]) -> dict[str, float]:
    """What the sign that an effect's first parameter cannot have would gain over the one that it has."""
    size, gain = linear.gains()
    found: dict[str, float] = {}
    for name in dict.fromkeys(names):
        own = [i for i, other in enumerate(names) if other == name]
        one_sided = [i for i in own if linear.low[i] >= 0.0 or linear.high[i] <= 0.0]
        if len(one_sided) < len(own):
            continue
        allowed = [(size[i] > 0.0) == (linear.low[i] >= 0.0) for i in own]
        other = max((gain[i] for i, yes in zip(own, allowed, strict=True) if not yes), default=0.0)
        has = max((gain[i] for i, yes in zip(own, allowed, strict=True) if yes), default=0.0)
        found[name] = float(other - has)
    return found


def search_subset(screened: Screened, subset: Subset) -> Fit | None:
    """A subset of effects at its mode, from where the linear model has it; None where it cannot be solved.

    Its evidence is comparable with that of the fits of the screening, which are of one effect each.
    """
    screening = screened.screening
    base = screening.base.fit
    forward = screening.forward(Hypothesis((*screening.added, *(s.added for s in subset.signatures))))
    parts, columns = [base.u + subset.step], [base.jacobian]
    for one, amplitude in zip(subset.signatures, subset.amplitudes, strict=True):
        parts += [np.array([amplitude]), one.others]
        columns += [one.change[:, None], np.zeros((len(one.change), len(one.others)))]
    start = np.clip(np.concatenate(parts), forward.low, forward.high)
    S = screening.beside(screened.noise, screened.allowances)
    search = Search(forward, screening.coefficients, S)
    try:
        point = search.at(start, np.concatenate(columns, axis=1))
    except SearchError:
        return None
    point = search.refine(point)
    search = Search(forward, screening.coefficients, screening.beside(screened.noise, screening.numerics()))
    point = search.refine(
        search.resume(point), effort.AGAIN_ROUNDS, effort.AGAIN_STEPS, fine=screening.smooth
    )
    return screening.evidence(forward, point, screened.allowances)


@dataclass(frozen=True, eq=False)
class Several:
    """Sets of effects that were searched with the solver, most probable first, beside one effect alone.

    `gain` is the log posterior odds of the first over the best single effect (0 where none was searched, or
    could be solved): log evidence, and the prior odds of the effects more.
    """

    subsets: Subsets
    fits: tuple[Fit, ...] = field(repr=False)
    gain: float
    log_bayes_factor: float

    @property
    def names(self) -> tuple[str, ...]:
        """The leading set, if it is more probable than any single effect; else none."""
        return tuple(one.name for one in self.fits[0].hypothesis.added) if self.gain > 0.0 else ()


def several_effects(
    screened: Screened,
    *,
    largest: int = LARGEST_SUBSET,
    price: float | None = None,
    searched: int = SEARCHED_SUBSETS,
) -> Several:
    """Weigh every subset of the listed effects, and search the best ones of several with the solver.

    Parameters
    ----------
    screened : Screened
    largest : int
    price : float, optional
        As of `weigh_subsets`.
    searched : int
        Subsets of several effects that are searched.

    Returns
    -------
    Several
    """
    subsets = weigh_subsets(screened, largest=largest, price=price)
    best = max(screened.fits.values(), key=lambda f: f.log_z, default=None)
    if best is None:
        return Several(subsets, (), 0.0, -math.inf)
    singles = [s for s in subsets.best if len(s.signatures) == 1]
    own = next(s for s in singles if s.names == (best.hypothesis.name,))
    to_beat = max(s.log_odds for s in singles)
    candidates = [s for s in subsets.best if len(s.signatures) > 1 and s.log_odds > to_beat][:searched]
    single, alone = best.log_z, own.log_odds - own.log_z
    with ThreadPoolExecutor(max(1, screened.screening.cores)) as pool:
        fits = list(pool.map(lambda one: search_subset(screened, one), candidates))
    ranked: list[tuple[float, float, Fit]] = []
    for one, fit in zip(candidates, fits, strict=True):
        if fit is not None:
            ranked.append((fit.log_z + one.log_odds - one.log_z - single - alone, fit.log_z - single, fit))
    ranked.sort(key=lambda x: -x[0])
    if not ranked:
        return Several(subsets, (), 0.0, -math.inf)
    return Several(subsets, tuple(fit for *_, fit in ranked), *ranked[0][:2])
