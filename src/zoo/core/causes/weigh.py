"""From causes to the posterior over their sets."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from zoo.core.causes.evidence import SIZE_PRIORS, SetEvidence, SetModel
from zoo.core.causes.family import ErrorFamily
from zoo.core.causes.posterior import CausePosterior, SetRow
from zoo.core.causes.problem import Cause, CauseError, Problem
from zoo.core.causes.reference import Reference
from zoo.core.causes.set_priors import CausePriors
from zoo.core.threads import threads

Array = NDArray[np.float64]
Which = tuple[int, ...]

MISSED = 0.02
"""Probability that sets which are only guessed hold together at most, where guesses are right."""
SHAPES_WITHIN = 5.0
"""Log evidence behind the best spectrum within which a spectrum is kept."""
BEAM = (40, 24, 10)
"""Sets of one, two and three causes to which every further cause is added."""
ROUNDS = 3
"""Times that sets are sought given the error model of the best set so far."""
FIRST_WEIGHED, MOST_WEIGHED = 12, 32
"""Sets that are weighed given all error models at most, in each round and at the end."""
MOST_SHAPES = 12
"""Spectra that are kept at most."""


@dataclass(eq=False)
class _Search:
    """Sets that were found: their evidence given all error models, or an estimate of it."""

    problem: Problem
    causes: Sequence[Cause]
    family: ErrorFamily
    priors: CausePriors
    cores: int
    always: Which = ()
    weighed: dict[Which, SetEvidence] = field(default_factory=dict)
    guessed: dict[Which, float] = field(default_factory=dict)

    def total(self, which: Which) -> float:
        """Log prior plus log evidence of a set, or plus an estimate of it."""
        log = self.weighed[which].total(SIZE_PRIORS) if which in self.weighed else self.guessed[which]
        return log + self.priors.log_prior(which)

    def start(self) -> None:
        """The smallest set given all error models, whose spectra are then fewer."""
        model = SetModel(self.problem, [self.causes[i] for i in self.always], self.family)
        everything = np.arange(self.family.n_kinds)
        self.weighed[self.always] = model.evidence(everything, self.family.noise_start)
        self.kinds = everything

    def weigh(self, sets: Sequence[Which]) -> None:
        """These sets given the error models that are kept."""
        known = self.weighed[max(self.weighed, key=self.total)]
        start = known.log_noise[np.searchsorted(known.kinds, self.kinds)]

        def one(which: Which) -> SetEvidence:
            model = SetModel(self.problem, [self.causes[i] for i in which], self.family)
            return model.evidence(self.kinds, start)

        with threads(self.cores) as pool:
            self.weighed.update(zip(sets, pool.map(one, sets), strict=True))

    def weigh_more(self, most: int) -> None:
        """The most probable sets that were not weighed yet."""
        self.weigh(leading({w: self.total(w) for w in [*self.guessed, *self.weighed]}, self.weighed, most))

    def seek(self, parent: Which) -> None:
        """Guess the evidence of sets, given the error model that is most probable with one of them."""
        found = self.weighed[parent]
        reference = Reference(self.problem, self.causes, found.likely_variances(SIZE_PRIORS))
        scales: tuple[float, ...] = ()
        gain = 0.0
        for i in range(len(self.always)):
            gained, best = reference.further(self.always[:i], scales)
            gain += float(gained[self.always[i]])
            scales = (*scales, float(best[self.always[i]]))
        conditional: dict[Which, float] = {self.always: gain}
        sizes: dict[Which, tuple[float, ...]] = {self.always: scales}
        level: list[Which] = [self.always]
        most = min(self.priors.most, len(self.priors.names))
        for width in (*BEAM, 0)[: most - len(self.always)]:
            new: set[Which] = set()
            for which in level:
                gained, best = reference.further(which, sizes[which])
                taken = {self.causes[i].component for i in which}
                for j, (more, scale) in enumerate(zip(gained, best, strict=True)):
                    if self.causes[j].component in taken:
                        continue
                    both = sorted(zip((*which, j), (*sizes[which], float(scale)), strict=True))
                    key = tuple(i for i, _ in both)
                    value = conditional[which] + float(more)
                    if value > conditional.get(key, -np.inf):
                        conditional[key], sizes[key] = value, tuple(s for _, s in both)
                    new.add(key)
            level = sorted(new, key=lambda w: -(conditional[w] + self.priors.log_prior(w)))[:width]
        if parent not in conditional:  # the beam went past it
            return
        shift = found.total(SIZE_PRIORS) - conditional[parent]
        for key, value in conditional.items():
            self.guessed[key] = max(self.guessed.get(key, -np.inf), value + shift)


def leading(
    totals: Mapping[Which, float], weighed: Container[Which], most: int = MOST_WEIGHED
) -> list[Which]:
    """The most probable sets that were not weighed yet, but for those that hold `MISSED` together.

    Parameters
    ----------
    totals : mapping of sets to float
        Log prior plus log evidence.
    weighed : container of sets
    most : int

    Returns
    -------
    list of sets
    """
    missed = logsumexp(list(totals.values())) + math.log(MISSED)
    due = sorted((w for w in totals if w not in weighed), key=lambda w: totals[w])
    behind = np.logaddexp.accumulate([totals[w] for w in due])
    return due[::-1][: min(most, int(np.sum(behind > missed)))]


def weigh_causes(
    problem: Problem,
    causes: Sequence[Cause],
    family: ErrorFamily,
    *,
    priors: CausePriors | None = None,
    always: Which = (),
    cores: int = 2,
    tick: Callable[[str, float], None] | None = None,
) -> CausePosterior:
    """The posterior over sets of causes of a linear problem.

    Sets are sought given the error model that is most probable with the best set so far; the most
    probable are then weighed given all error models, where all sets have some causes only the best of each
    search. What was only guessed keeps its guess, and is told.

    Parameters
    ----------
    problem : Problem
    causes : sequence of Cause
    family : ErrorFamily
    priors : CausePriors, optional
    always : tuple of int
        Causes that all sets have.
    cores : int
        Threads.
    tick : callable, optional
        Called with a text and the share done.

    Returns
    -------
    CausePosterior

    Raises
    ------
    CauseError
        If the responses do not fit the data.
    """
    n = len(problem.residual)
    for one in causes:
        if len(one.columns) != n:
            raise CauseError(f"{one.label}: columns: {len(one.columns)} coefficients, the data have {n}")
    say = tick or (lambda text, share: None)
    priors = priors or CausePriors(causes)
    search = _Search(problem, causes, family, priors, cores, always)
    with threadpool_limits(1, user_api="blas"):  # the matrices are small
        _find_sets(search, say)
    rows = [SetRow(w, search.priors.log_prior(w), e) for w, e in search.weighed.items()]
    guessed = {w: g + priors.log_prior(w) for w, g in search.guessed.items() if w not in search.weighed}
    return CausePosterior(tuple(causes), priors, SIZE_PRIORS, tuple(rows), guessed)


def _find_sets(search: _Search, say: Callable[[str, float], None]) -> None:
    say("baseline given all error models", 0.0)
    search.start()
    if search.causes:
        parent = search.always
        seen: set[Which] = set()
        for round_ in range(ROUNDS):
            say("seeking sets of causes", 0.2 + 0.2 * round_)
            seen.add(parent)
            search.seek(parent)
            if round_ == 0:  # spectra that matter given nothing or the best cause of each component
                _fewer_kinds(search)
            search.weigh_more(1 if search.always else FIRST_WEIGHED)
            ranked = sorted(search.weighed, key=lambda w: -search.total(w))
            if ranked[0] in seen:
                break
            parent = ranked[0]
        if not search.always:
            search.weigh_more(MOST_WEIGHED)


def _fewer_kinds(search: _Search) -> None:
    """Keep the spectra that are likely given the smallest set, or with the best cause of some component."""
    best: dict[str, Which] = {}
    for which in sorted(search.guessed, key=lambda w: -search.total(w)):
        if len(which) == 1 and not search.always:
            best.setdefault(search.causes[which[0]].component, which)
    search.weigh(list(best.values()))
    behind = np.full(len(search.family.shapes), np.inf)
    for which in [search.always, *best.values()]:
        log_colours, smooth = search.weighed[which].terms(SIZE_PRIORS)
        each = np.logaddexp.reduce(smooth[: len(behind)], axis=1)
        top = max(float(smooth.max()), float(each.max()), float(log_colours.max()))
        behind = np.minimum(behind, top - each)
    order = np.argsort(behind, kind="stable")[:MOST_SHAPES]
    kept = order[(behind[order] < SHAPES_WITHIN) | (behind[order] == behind[order[0]])]
    search.kinds = search.family.kinds_of(np.sort(kept))
    search.weighed = {which: one.only(search.kinds) for which, one in search.weighed.items()}
