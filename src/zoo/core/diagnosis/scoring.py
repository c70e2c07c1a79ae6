"""Probabilities of hypotheses, groups that the data cannot tell apart, and what they cannot show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.hypothesis import CORRELATED, NONPARAMETRIC, NULL
from zoo.core.diagnosis.screening import PRIOR_NONPARAMETRIC, PRIOR_NULL, Screened
from zoo.core.effects import Location

Array = NDArray[np.float64]

VISIBLE = 3.0
"""Expected log-likelihood ratio, e^3 = 20 to 1, below which two hypotheses are the same to these data."""
SHOWN_AT = 2.0
"""Size, in its prior's scale, at which an effect is asked whether the data could show it."""
DOUBT = 0.01
"""Probability above which an explanation outside the leader's group deserves a posterior or a measurement."""
EQUAL_EVIDENCE = 1.0
"""Difference of log evidence below which the data prefer neither: "not worth more than a bare mention" (Kass
and Raftery 1995, doi 10.1080/01621459.1995.10476572)."""
PRIOR_MADE = 0.01
"""A probability nearer to what the prior alone gives among explanations of equal evidence is the prior's."""


@dataclass(frozen=True, eq=False)
class Scored:
    """A screening's hypotheses with their probabilities, best first."""

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

    def members(self, name: str) -> list[str]:
        """What these data cannot tell from it, itself included, most probable first."""
        return [n for n in self.names if self.group[n] == self.group[name]]


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
) -> dict[str, int]:
    """Explanations that these data cannot tell apart have one number; the most probable gives it."""
    group: dict[str, int] = {}
    leaders: list[str] = []
    free = (NONPARAMETRIC, CORRELATED)
    for name in names:
        own = best[name].computed
        moved = name in free or 0.5 * float(np.sum((own - screened.base.computed) ** 2 / S)) > VISIBLE
        for other in leaders if moved and name not in invisible else []:
            if (name in free) != (other in free) or other in invisible or other == NULL:
                continue
            if name in free:
                same = abs(log_z[name] - log_z[other]) < VISIBLE
            else:
                # were the other one true, this one would be fitted to its waves
                fit = best[name]
                same = _projected(fit, best[other].computed - own, S, fit.jacobian.shape[1]) < VISIBLE
            if same:
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


def score(screened: Screened) -> Scored:
    """Probabilities, groups and what the data cannot show."""
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
    visible = [n for n in log_z if n not in invisible]
    listed = [n for n in visible if n not in (NULL, NONPARAMETRIC)]
    prior = {NULL: PRIOR_NULL, NONPARAMETRIC: PRIOR_NONPARAMETRIC}
    prior |= {n: (1.0 - PRIOR_NULL - PRIOR_NONPARAMETRIC) / max(1, len(listed)) for n in listed}
    log_p = {n: math.log(prior[n]) + log_z[n] for n in visible}
    norm = float(logsumexp(list(log_p.values())))
    probability = {n: math.exp(log_p[n] - norm) if n in log_p else 0.0 for n in log_z}
    names = sorted(log_z, key=lambda n: (-probability[n], -log_z[n]))

    group = _groups(screened, names, best, log_z, invisible, S)
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
    )
