"""Probabilities of hypotheses, groups that the data cannot tell apart, and what they cannot show."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.diagnosis.components.likeness import left_of
from zoo.core.diagnosis.components.pairs import SERIES, Pair
from zoo.core.diagnosis.components.refining import Component, Explained
from zoo.core.diagnosis.components.subsets import Several
from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.file import DiagnosisError
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, NULL
from zoo.core.diagnosis.screening import PRIOR_NONPARAMETRIC, PRIOR_NULL, Screened
from zoo.core.effects import Location

Array = NDArray[np.float64]

VISIBLE = 3.0
"""Expected log-likelihood ratio, e^3 = 20 to 1, below which two hypotheses are the same to these data."""
MOSTLY = 0.5
"""Part of the discrepancy that an explanation with something else beside it may leave and be a cause."""
LEFT_BY_TWO = 1.0
"""Energy, in that of the noise, that two components may leave and be the cause together."""
TOO_FAR = 6.0
"""Difference of log evidence above which a component, which may draw any signal, is in no other's group."""
SHOWN_AT = 2.0
"""Size, in its prior's scale, at which an effect is asked whether the data could show it."""
DOUBT = 0.01
"""Probability above which an explanation outside the leader's group deserves a posterior or a measurement."""
EQUAL_EVIDENCE = 1.0
"""Difference of log evidence below which the data prefer neither: "not worth more than a bare mention" (Kass
and Raftery 1995, doi 10.1080/01621459.1995.10476572)."""
PRIOR_MADE = 0.01
"""A probability nearer to what the prior alone gives among explanations of equal evidence is the prior's."""


SENSOR = "sensor"
"""Component that a free discrepancy belongs to."""
COMPONENTS_SHARE = 0.5
"""Part that the free functions of components have of what is left beforehand for listed causes."""


@dataclass(frozen=True, eq=False)
class Scored:
    """A screening's hypotheses with their probabilities, best first.

    `more` are the probabilities of listed effects with something else beside them, which are no part of their
    own `probability`; `explained` are the components, whose free functions are hypotheses by the component's
    name; `pairs` are two of them together with their probability, which counts for the one with more
    evidence by itself; `untold` is the probability of two components of which the data cannot say which;
    `belongs` is the component of each listed effect; `several` are sets of listed effects together.
    """

    screened: Screened
    names: tuple[str, ...]
    log_z: Mapping[str, float]
    probability: Mapping[str, float]
    best: Mapping[str, Fit]
    locations: Mapping[str, list[tuple[Location, float]]]
    group: Mapping[str, int]
    invisible: tuple[str, ...]
    failed: tuple[str, ...]
    prior_share: Mapping[str, float | None]
    more: Mapping[str, float] = field(default_factory=dict)
    explained: Explained | None = None
    belongs: Mapping[str, str] = field(default_factory=dict)
    several: Several | None = None
    pairs: tuple[tuple[Pair, float], ...] = ()
    untold: float = 0.0

    @property
    def components(self) -> Mapping[str, Component]:
        """Those whose free functions were weighed."""
        return self.explained.components if self.explained else {}

    def standing(self, name: str) -> float:
        """Probability of an explanation, alone, with something else or with another component beside it."""
        together = sum(p for pair, p in self.pairs if pair.names[0] == name)
        return self.probability[name] + self.more.get(name, 0.0) + together

    @property
    def pair(self) -> Pair | None:
        """Two components together, where the leader's fit is that of both."""
        fit = self.best[self.leader]
        return next((pair for pair, _ in self.pairs if pair.fit is fit), None)

    def is_cause(self, name: str) -> bool:
        """Whether it is a listed effect or a component, which a simulator can be mended by."""
        return name in self.locations or name in self.components

    @property
    def of_component(self) -> dict[str, float]:
        """Probability of each component: of its free functions, and of listed effects that belong to it.

        That of two components of which the data cannot say which counts for all alike.
        """
        each = self.untold / max(1, len(self.components))
        found = {name: self.standing(name) + each for name in self.components}
        for name, component in self.belongs.items():
            if name in self.probability:
                found[component] = found.get(component, 0.0) + self.standing(name)
        return found

    @property
    def leader(self) -> str:
        """The most probable explanation."""
        return self.names[0]

    def prior_made(self, name: str) -> bool:
        """Whether its probability is what the prior alone gives it beside others of the same evidence."""
        share, p = self.prior_share[name], self.probability[name]
        return share is not None and p >= DOUBT and abs(p - share) <= PRIOR_MADE

    def tied(self, name: str) -> list[str]:
        """Others that are as probable as the prior alone makes them beside it."""
        return [n for n in self.names if n != name and self.prior_made(n)] if self.prior_made(name) else []

    def own(self, name: str) -> tuple[str, ...]:
        """It, or both components where it leads and is more probable with the other beside it."""
        return self.pair.names if self.pair and name == self.leader else (name,)

    def twins(self, name: str) -> list[str]:
        """Others that these data cannot tell from it, most probable first."""
        own = self.own(name)
        return [n for n in self.names if self.group[n] == self.group[name] and n not in own]

    def members(self, name: str) -> list[str]:
        """It and what is beside it, then what these data cannot tell from it."""
        return [*self.own(name), *self.twins(name)]


def _projected(fit: Fit, signature: Array, S: Array, n_columns: int | None = None) -> float:
    """Half the squared size, in units of the noise, of what parameters cannot absorb of a signature.

    These are all but the parameters of the effect asked about, or the first `n_columns`.
    """
    J = fit.jacobian[:, : fit.forward.asked if n_columns is None else n_columns] / np.sqrt(S)[:, None]
    z = signature / np.sqrt(S)
    coefficients, *_ = np.linalg.lstsq(J, z, rcond=None)
    return 0.5 * float(np.sum((z - J @ coefficients) ** 2))


def _groups(
    screened: Screened,
    names: Sequence[str],
    best: Mapping[str, Fit],
    log_z: Mapping[str, float],
    invisible: Sequence[str],
    S: Array,
    explained: Explained | None = None,
    belongs: Mapping[str, str] | None = None,
) -> dict[str, int]:
    """Explanations that these data cannot tell apart have one number; the most probable gives it.

    A component and the listed effects that belong to it are no rivals.
    """
    components = explained.components if explained else {}
    group: dict[str, int] = {}
    leaders: list[str] = []
    free = (NONPARAMETRIC, CORRELATED)

    def alike(name: str, other: str) -> bool:
        if (name in free) != (other in free) or other in invisible or other == NULL:
            return False
        if name in free:
            return abs(log_z[name] - log_z[other]) < VISIBLE
        drawn = name in components or other in components
        family = {(belongs or {}).get(n, n) for n in (name, other)}
        if drawn and (len(family) == 1 or abs(log_z[name] - log_z[other]) > TOO_FAR):
            return False
        # were the other one true, this one would be fitted to its waves
        fit, signal = best[name], best[other].computed
        if explained and name in components:
            signal = signal - screened.base.computed
            return left_of(signal, components[name], explained.linearised, S) < VISIBLE
        return _projected(fit, signal - fit.computed, S, fit.jacobian.shape[1]) < VISIBLE

    for name in names:
        own = best[name].computed
        moved = name in free or 0.5 * float(np.sum((own - screened.base.computed) ** 2 / S)) > VISIBLE
        for other in leaders if moved and name not in invisible else []:
            if alike(name, other):
                group[name] = group[other]
                break
        else:
            group[name] = len(leaders)
            leaders.append(name)
    return group


def prior_shares(
    prior: Mapping[str, float], kinds: Mapping[str, Sequence[tuple[float, float]]]
) -> dict[str, float | None]:
    """What the prior alone gives each explanation beside others of the same evidence.

    share_i = p_i w_i / sum_j p_j w_j, p the prior probabilities of the explanations and w_j the prior weight
    of those kinds of j (locations of an effect, kinds of a free discrepancy) whose log evidence is within
    `EQUAL_EVIDENCE` of the largest one of i.

    Parameters
    ----------
    prior : mapping of name to float
        Prior probabilities.
    kinds : mapping of name to sequence of (float, float)
        Logarithms of the prior weight and of the evidence of each kind.

    Returns
    -------
    dict of name to float or None
        None where no other explanation has such evidence: there the data have told it from all others.
    """
    found: dict[str, float | None] = {}
    for name in prior:
        top = max(z for _, z in kinds[name])
        shares = {
            other: prior[other] * sum(math.exp(w) for w, z in kinds[other] if abs(z - top) < EQUAL_EVIDENCE)
            for other in prior
        }
        others = sum(share for other, share in shares.items() if other != name)
        found[name] = shares[name] / (shares[name] + others) if others > 0.0 else None
    return found


def _priors(listed: Sequence[str], components: Sequence[str]) -> dict[str, float]:
    """Prior probabilities: half of what is left for listed causes is that of components, if there are any."""
    left = (1.0 - PRIOR_NULL - PRIOR_NONPARAMETRIC) / max(1, len(listed))
    part = (1.0 - COMPONENTS_SHARE) if components else 1.0
    prior = {NULL: PRIOR_NULL, NONPARAMETRIC: PRIOR_NONPARAMETRIC, CORRELATED: left}
    effects = [n for n in listed if n != CORRELATED]
    prior |= dict.fromkeys(effects, part * left)
    if components and not effects:  # correlated noise has its part, components the other
        prior[CORRELATED] *= 1.0 - COMPONENTS_SHARE
    rest = 1.0 - sum(prior.values())
    return prior | {n: rest / len(components) for n in components}


def log_prior_of_a_pair(prior: Mapping[str, float], components: Collection[str]) -> float:
    """Two components have, beside one alone, the prior of something else beside it; all pairs alike."""
    n = len(components)
    return math.log(PRIOR_NONPARAMETRIC * sum(prior[name] for name in components) / (n * (n - 1) / 2))


def _log_untold(prior: Mapping[str, float], components: Mapping[str, Component]) -> float:
    """Log probability, not normalised, of any two components where their pairs cannot be weighed.

    Two draw a single series at least as well as the better of them does alone.
    """
    return log_prior_of_a_pair(prior, components) + float(
        logsumexp([max(a.log_z, b.log_z) for a, b in combinations(components.values(), 2)])
    )


def score(
    screened: Screened,
    explained: Explained | None = None,
    more: Mapping[str, float] | None = None,
    belongs: Mapping[str, str] | None = None,
    pairs: Sequence[Pair] = (),
) -> Scored:
    """Probabilities, groups and what the data cannot show.

    Parameters
    ----------
    screened : Screened
    explained : Explained, optional
        Components whose free functions are weighed too.
    more : mapping of name to float, optional
        Log evidence of listed effects with something else beside them.
    belongs : mapping of name to str, optional
        Component of each listed effect, and of the free discrepancy.
    pairs : sequence of Pair
        Two components together.

    Returns
    -------
    Scored

    Raises
    ------
    DiagnosisError
        If a component has the name of an effect.
    """
    screening = screened.screening
    S = screening.beside(screened.noise, screening.numerics())
    log_z = {
        NULL: screened.base.log_z,
        NONPARAMETRIC: screened.nonparametric.log_z,
        CORRELATED: screened.correlated.log_z,
    }
    best = {NULL: screened.base, NONPARAMETRIC: screened.nonparametric, CORRELATED: screened.correlated}
    kinds: dict[str, Sequence[tuple[float, float]]] = {
        name: fit.kinds or ((0.0, fit.log_z),) for name, fit in best.items()
    }
    locations: dict[str, list[tuple[Location, float]]] = {}
    invisible, failed = [], []
    for name, hypotheses in screening.hypotheses.items():
        fits = {h: screened.fits[h] for h in hypotheses if h in screened.fits}
        if not fits:
            failed.append(name)
            continue
        total = np.array([f.log_z for f in fits.values()])
        log_z[name] = float(logsumexp(total)) - math.log(len(hypotheses))
        kinds[name] = [(-math.log(len(hypotheses)), float(z)) for z in total]
        leader = max(fits.values(), key=lambda f: f.log_z)
        best[name] = leader
        weight = np.exp(total - logsumexp(total))
        locations[name] = sorted(
            ((h.location, float(w)) for h, w in zip(fits, weight, strict=True)), key=lambda x: -x[1]
        )
        first = screening.effects[name].parameters[0]
        shown = 0.0
        for fit in fits.values():
            reach = min(SHOWN_AT * first.scale, max(abs(first.high), abs(first.low)))
            shown = max(shown, _projected(fit, fit.jacobian[:, fit.forward.asked] * reach, S))
            if fit.log_z - screened.base.log_z > VISIBLE:
                shown = math.inf
        if shown < VISIBLE:
            invisible.append(name)
    components = explained.components if explained else {}
    for name, component in components.items():
        if name in log_z:
            raise DiagnosisError(f"component {name}: is the name of an effect too; give another")
        log_z[name], best[name] = component.log_evidence, component.best.fit
        kinds[name] = [(-math.log(len(component.kinds)), k.weighed.log_z) for k in component.kinds]
    visible = [n for n in log_z if n not in invisible]
    prior = _priors([n for n in visible if n not in (NULL, NONPARAMETRIC, *components)], list(components))
    alone = log_z | {n: c.log_z for n, c in components.items()}
    log_p = {n: math.log(prior[n]) + alone[n] for n in visible}
    with_more = {n: z for n, z in (more or {}).items() if n in log_p}
    with_more |= {n: c.log_more for n, c in components.items() if math.isfinite(c.log_more)}
    floor = sum(
        screening.errors.part(screened.base.residual, q).size * (e.noise / screening.range[q]) ** 2
        for q, e in screened.noise.items()
    )
    # what leaves most of the discrepancy to something else is no cause of it: that is unlisted
    most = MOSTLY**2 * max(0.0, screening.missed(screened.least) - floor)
    log_more = {
        n: math.log(prior[n] * PRIOR_NONPARAMETRIC) + z
        for n, z in with_more.items()
        if screening.missed(best[n]) - floor < most
    }
    # nor are two functions, which may draw a great deal, the cause where they leave more than noise
    little = min(most, LEFT_BY_TWO * floor)
    pairs = [pair for pair in pairs if screening.missed(pair.fit) - floor < little]
    log_pairs = [log_prior_of_a_pair(prior, components) + pair.log_evidence for pair in pairs]
    single = screening.data.n_series < SERIES and len(components) > 1
    log_untold = _log_untold(prior, components) if single else -math.inf
    norm = float(logsumexp([*log_p.values(), *log_more.values(), *log_pairs, log_untold]))
    probability = {n: math.exp(log_p[n] - norm) if n in log_p else 0.0 for n in log_z}
    and_more = {n: math.exp(z - norm) for n, z in log_more.items()}
    together = tuple((pair, math.exp(z - norm)) for pair, z in zip(pairs, log_pairs, strict=True))
    standing = {n: probability[n] + and_more.get(n, 0.0) for n in log_z}
    for pair, p in sorted(together, key=lambda one: one[1]):  # of two with the same name the more probable
        name = pair.names[0]
        if p > max(probability[name], and_more.get(name, 0.0)):
            best[name] = pair.fit
        standing[name] += p
    names = sorted(log_z, key=lambda n: (-standing[n], -log_z[n]))
    group = _groups(screened, names, best, log_z, invisible, S, explained, belongs)
    return Scored(
        screened,
        tuple(names),
        log_z,
        probability,
        best,
        locations,
        group,
        tuple(sorted(invisible)),
        tuple(sorted(failed)),
        dict.fromkeys(names) | prior_shares(prior, kinds),
        and_more,
        explained,
        dict(belongs or {}),
        pairs=together,
        untold=math.exp(log_untold - norm),
    )
