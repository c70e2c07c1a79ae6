"""Surrogates of the forward model around a posterior: built, looked at, and built on where they lack."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

from zoo.core.arrays import Array
from zoo.core.draws import evenly
from zoo.core.inference.correction import Weights, pareto_weights
from zoo.core.inference.logposterior import LogPosterior, outputs
from zoo.core.inference.mode import first_point
from zoo.core.inference.newton import GRADIENT, gauss_newton
from zoo.core.inference.nuts import Draws, nuts
from zoo.core.model import ModelRecord, record_of, theta_of
from zoo.core.parameters import variable_name
from zoo.core.surrogate.library import Library
from zoo.core.surrogate.powers import Coordinates
from zoo.core.surrogate.surrogate_model import log_likelihood, surrogate_model
from zoo.core.surrogate.waveform import Surrogate

LEAST_POINTS = 150
"""Fewest points of the first design; as many as a quadratic has terms, if that is more."""
WIDER = 1.3
"""Standard deviations of a design, in those of the posterior that is known of."""
DEFENSIVE = 0.85
"""Effective share of the draws of a perfect surrogate, whose likelihood is taken to a power below 1: so draws
reach beyond the posterior, where a surrogate errs most."""
BEYOND = 240
"""Draws that are moved away from their mean and solved there, to see what a surrogate misses."""
SEEN = 0.3
"""Effective share of draws of a normal density that are moved so far; of the posterior, which is narrower by
the power of the likelihood, it is about half of that."""
TOO_LOW = 2.0
"""Log weight above the median of the draws', and above all of them, from which on a surrogate is too low."""
MISSED = 0.05
"""Largest share of the exact posterior that may lie where the surrogate is too low to be drawn from."""


@dataclass(frozen=True)
class Weighed:
    """Draws of a surrogate's posterior that were solved, and what the forward model says of them.

    Parameters
    ----------
    draws : dict
        Variable -> (n_chains, n_draws, ...).
    log_weights : array (n_chains, n_draws)
        Of the exact posterior over the surrogate's.
    missed : float
        What part of the posterior the surrogate misses at least.
    """

    draws: Draws
    log_weights: Array
    missed: float = 0.0

    @property
    def weights(self) -> Weights:
        """Of the draws."""
        return pareto_weights(self.log_weights)

    @property
    def trusted(self) -> bool:
        """Whether weights can make the draws exact."""
        return self.weights.trusted and self.missed <= MISSED

    @property
    def text(self) -> str:
        """What it is, for a line of progress."""
        weights = self.weights
        return (
            f"of {self.log_weights.size} draws {100 * weights.effective:.0f} % are effective, k-hat "
            f"{weights.k_hat:.2f}; it misses at least {100 * self.missed:.0f} % of the posterior"
        )

    def more(self, other: Weighed) -> Weighed:
        """With more draws of the same surrogate."""
        draws = {n: np.concatenate([value, other.draws[n]], axis=1) for n, value in self.draws.items()}
        return Weighed(draws, np.concatenate([self.log_weights, other.log_weights], axis=1), self.missed)


class Builder:
    """Builds a surrogate around a model's posterior, of all that was solved there.

    Parameters
    ----------
    logp : LogPosterior
        Of the model with the forward model.
    library : Library
        Solves that are there already, of any model with the same forward model.
    start : mapping, optional
        Values where the search for the posterior begins.
    seed, chains, cores : int
    """

    def __init__(
        self,
        logp: LogPosterior,
        library: Library,
        start: Mapping[str, Any] | None = None,
        *,
        seed: int,
        chains: int = 4,
        cores: int,
    ) -> None:
        self.logp, self.library = logp, library
        self.seed, self.chains, self.cores = seed, chains, cores
        self.record = record_of(logp.model)
        self.coordinates = Coordinates(self.record.forward.parameters)
        self.rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(5,)))
        self.names, self._values = outputs(logp.model, [rv.name for rv in logp.model.free_RVs])
        self._log_prior = logp.model.compile_logp(vars=logp.model.free_RVs)
        # of draws of density p^a, a p^(1 - a) weighs each, and (a (2 - a))^(n/2) of them are effective
        n = len(logp.template.data)
        self.power = 1.0 - float(np.sqrt(1.0 - DEFENSIVE ** (2.0 / n)))
        mean, covariance = self.begin(start)
        terms = (self.coordinates.n + 1) * (self.coordinates.n + 2) / 2
        size = 1 << int(np.ceil(np.log2(max(LEAST_POINTS, terms))))
        normal = qmc.MultivariateNormalQMC(np.zeros(n), seed=self.rng).random(size)
        steps = normal @ np.linalg.cholesky(covariance).T
        self.learn(self.values(mean + steps))
        self.solve(theta_of(self.record, self.values(mean + WIDER * steps)))

    def values(self, vectors: Array) -> Draws:
        """Free variables in their own units, (n, ...), of vectors (n, n_dim)."""
        rows = [self._values(self.logp.point(q)) for q in vectors]
        return {
            name: np.array(column) for name, column in zip(self.names, zip(*rows, strict=True), strict=True)
        }

    def begin(self, start: Mapping[str, Any] | None = None) -> tuple[Array, Array]:
        """Where the posterior is, about: a point (n_dim,) and a covariance, by Gauss-Newton steps."""
        q, value = first_point(self.logp, start, self.seed)
        step = 2 + max(len(q), GRADIENT)  # solves, with derivatives by differences or by the solver
        q, _, frame = gauss_newton(self.logp, q, value, limit=6 * step)
        return q, frame @ frame.T

    def learn(self, draws: Draws) -> None:
        """Take draws (n, ...) for what is known of the posterior, where the next surrogate is made."""
        self.draws, self.theta = draws, theta_of(self.record, draws)
        self.vectors = self.logp.from_draws(draws)
        self.covariance = np.cov(self.vectors.T) + 1e-9 * np.eye(self.vectors.shape[1])
        x = self.coordinates.of(self.theta)
        self.near = x.mean(0), np.cov(x.T).reshape(self.coordinates.n, -1)

    def solve(self, theta: Array) -> Array:
        """Series at points (n, n_values), which join the library."""
        series = self.library.solve(theta, self.cores)
        self.library.add(theta, series)
        return series

    def surrogate(self) -> tuple[Surrogate, Any]:
        """A surrogate of the solves near the posterior, in this model's coordinates, and its PyMC model."""
        surrogate = Surrogate.fit(
            self.library,
            self.record.errors,
            {name: np.median(value, axis=0) for name, value in errors_of(self.record, self.draws).items()},
            near=self.near,
            within=3.0 * np.sqrt(self.coordinates.n) + 3.0,
            coordinates=self.coordinates,
        )
        points = self.theta[evenly(len(self.theta), 100)]
        return surrogate, surrogate_model(self.logp.model, self.record, surrogate, points, self.power)

    def look(self, made: Any, draws: int, tune: int, thin: int, *, beyond: bool = True) -> Weighed:
        """Draws of each chain of NUTS on a surrogate, solved; with `beyond` also what it misses."""
        starts = self.vectors[self.rng.choice(len(self.vectors), self.chains, replace=False)]
        long = nuts(
            made,
            self.names,
            self.covariance,
            starts,
            self.values(starts),
            draws=draws * thin,
            tune=tune,
            cores=self.cores,
            seed=int(self.rng.integers(1 << 31)),
        )
        self.learn(_flat(long))
        kept = {name: value[:, ::thin] for name, value in long.items()}
        log_weights, lacks = self.compared(made, _flat(kept))
        missed = self.missed(made, lacks) if beyond else 0.0
        return Weighed(kept, log_weights.reshape(self.chains, draws), missed)

    def compared(self, made: Any, draws: Draws) -> tuple[Array, Array]:
        """Draws (n, ...) solved: log weights, and by how much the surrogate's log-likelihood is too low."""
        own, vectors = LogPosterior(made), self.logp.from_draws(draws)
        beside = np.array([float(self._log_prior(self.logp.point(q))) - own(q) for q in vectors])
        series = self.solve(theta_of(self.record, draws))
        exact = log_likelihood(self.record, series, errors_of(self.record, draws))
        with np.errstate(invalid="ignore"):
            found = exact + beside, self.power * exact + beside
        weights, lacks = (np.where(np.isnan(one), -np.inf, one) for one in found)
        return weights, lacks

    def missed(self, made: Any, lacks: Array) -> float:
        """What part of the exact posterior lies where the surrogate is too low to be drawn from, at least.

        Draws cannot tell what they never reach. So some of those that were learnt last, q of n dimensions,
        are moved away from their mean m, to q' = m + s (q - m), whose density is that of q over s^n, and are
        weighed with the exact posterior over that. What lies further out than these is not seen; with many
        dimensions s is near 1.

        Parameters
        ----------
        made : pm.Model
            Of the surrogate.
        lacks : array
            By how much the surrogate's log-likelihood is too low at draws of its own.
        """
        total, n = self.vectors.shape
        c = SEEN ** (-2.0 / n)
        further = float(np.sqrt(c + np.sqrt(c * c - c)))
        some, mean = self.vectors[evenly(total, BEYOND)], self.vectors.mean(0)
        moved, height = mean + further * (some - mean), LogPosterior(made)
        change = np.array([height(there) - height(here) for there, here in zip(moved, some, strict=True)])
        found, low = self.compared(made, self.values(moved))
        log_mass, known = found + change, lacks[np.isfinite(lacks)]
        possible = np.isfinite(log_mass)
        if not known.size or not possible.any():
            return 1.0
        mass = np.exp(np.where(possible, log_mass, -np.inf) - log_mass[possible].max())
        too_low = low > max(float(np.median(known)) + TOO_LOW, float(known.max()))
        return float(mass[too_low].sum() / mass.sum())


def errors_of(record: ModelRecord, draws: Mapping[str, Array]) -> dict[str, Array]:
    """Parameters of the errors, name -> (n, ...)."""
    found = {}
    for p in record.errors.parameters:
        values = np.asarray(draws[variable_name(p.name)], dtype=np.float64)
        found[p.name] = values.reshape(-1, p.size) if p.dims else values.ravel()
    return found


def _flat(draws: Draws) -> Draws:
    """Draws of all chains, variable -> (n_chains n_draws, ...)."""
    return {name: value.reshape(-1, *value.shape[2:]) for name, value in draws.items()}
