"""Surrogates of the forward model around a posterior: built, looked at, and built on where they lack."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.draws import evenly
from zoo.core.inference.correction import Weights, pareto_weights
from zoo.core.inference.logposterior import LogPosterior, SamplingError, model_name, outputs
from zoo.core.inference.mode import Mode, search_mode
from zoo.core.inference.newton import GRADIENT, gauss_newton
from zoo.core.inference.nuts import Draws, nuts
from zoo.core.inference.record import RunRecord
from zoo.core.inference.sampling import sample as sample_exact
from zoo.core.model import ModelRecord, record_of, theta_of
from zoo.core.parameters import variable_name
from zoo.core.surrogate.coordinates import Coordinates
from zoo.core.surrogate.library import Library
from zoo.core.surrogate.model import SurrogateModel, log_likelihood, surrogate_model
from zoo.core.surrogate.monomials import term_count
from zoo.core.surrogate.waveform import Surrogate

Array = NDArray[np.float64]

FIRST_POINTS = 1.6
"""Points of the first design for each term of a quadratic."""
LEAST_POINTS = 150
EXPLORED, EXPLORE_TUNE, EXPLORE_THIN = 400, 1500, 4
"""Draws of each chain with the forward model itself that look for a bent posterior."""
OF_DRAWS = 4.5
"""Points for each term of a quadratic, where they are such draws."""
ENOUGH_EXPLORED = 0.3
"""Effective share of the weighted draws with which the building ends there."""
WIDER = 1.3
"""Standard deviations of a design, in those of the posterior that is known of."""
CHECKED = 160
"""Draws of each round that are solved, to see what the surrogate is worth."""
ENOUGH, TAIL = 0.6, 0.5
"""Effective share of the weighted draws, and their k-hat, with which the building ends: few draws make both
uncertain, and another round costs less than draws whose weights are not trusted."""
DEFENSIVE = 0.85
"""Effective share of the draws of a perfect surrogate, whose likelihood is taken to a power below 1: so draws
reach beyond the posterior, where a surrogate errs most."""
BEYOND = 240
"""Draws of each round, and of the last one, that are moved away from their mean and solved there."""
SEEN = 0.3
"""Effective share of draws of a normal density that are moved so far; of the posterior, which is narrower by
the power of the likelihood, it is about half of that."""
TOO_LOW = 2.0
"""Log weight above the median of the draws', and above all of them, from which on a surrogate is too low."""
MISSED = 0.05
"""Largest share of the exact posterior that may lie where the surrogate is too low to be drawn from."""
ROUNDS = 8
IDLE = 2
"""Rounds without a better surrogate after which the building ends."""
ROUND_TUNE, ROUND_DRAWS = 400, 150
JUMP_TUNE, JUMP_THIN = 60000, 60
"""Steps of a chain of differential evolution on the surrogate of a bent posterior: thrown away, and for each
stored draw."""


@dataclass
class Built:
    """A surrogate with its posterior.

    Parameters
    ----------
    made : SurrogateModel
    draws : dict
        Of its posterior, variable -> (n_chains, n_draws, ...).
    weights : Weights
        Of draws that were solved.
    rounds : int
    covariance : array (n_dim, n_dim)
    starts : array (n_chains, n_dim)
    missed : float or None
        What part of the posterior the surrogate misses at least; None where that was not asked.
    log : list of dict
        What each round found: points, degree, error, k-hat, effective and missed share.
    """

    made: SurrogateModel
    draws: Draws
    weights: Weights
    rounds: int
    covariance: Array
    starts: Array
    missed: float | None = None
    log: list[dict[str, Any]] = field(default_factory=list)

    @property
    def worth(self) -> float:
        """Effective share of the draws, of the part of the posterior that they come from."""
        return self.weights.effective * (1.0 - (self.missed or 0.0))


def errors_of(record: ModelRecord, draws: Mapping[str, Array]) -> dict[str, Array]:
    """Parameters of the errors, name -> (n, ...)."""
    found = {}
    for p in record.errors.parameters:
        values = np.asarray(draws[variable_name(p.name)], dtype=np.float64)
        found[p.name] = values.reshape(-1, p.size) if p.dims else values.ravel()
    return found


class Builder:
    """Builds a surrogate around a model's posterior: solves, fits, samples, looks, and solves where it lacks.

    Parameters
    ----------
    logp : LogPosterior
        Of the model with the forward model.
    library : Library
        Solves that are there already, of any model with the same forward model.
    seed, cores : int
    say : callable
        Told what each round finds.
    """

    def __init__(
        self, logp: LogPosterior, library: Library, *, seed: int, cores: int, say: Callable[[str], None]
    ) -> None:
        self.logp, self.library, self.cores, self.say, self.seed = logp, library, cores, say, seed
        self.record = record_of(logp.model)
        self.coordinates = Coordinates(self.record.forward.parameters)
        self.rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(5,)))
        self.gradients = 0
        self.explored: Draws | None = None
        self.mode: Mode | None = None
        self.names, self._values = outputs(logp.model, [rv.name for rv in logp.model.free_RVs])

    @property
    def bent(self) -> bool:
        """Whether chains of the forward model have looked for the posterior, as it is far from normal."""
        return self.explored is not None

    def values(self, vectors: Array) -> Draws:
        """Free variables in their own units, (n, ...), of vectors (n, n_dim)."""
        rows = [self._values(self.logp.point(q)) for q in vectors]
        return {
            name: np.array(column) for name, column in zip(self.names, zip(*rows, strict=True), strict=True)
        }

    def begin(self, start: Mapping[str, Any] | None = None) -> tuple[Array, Array]:
        """Where the posterior is, about: a point (n_dim,) and a covariance, by Gauss-Newton steps."""
        logp, d = self.logp, len(self.logp.template.data)
        points = [logp.vector(logp.initial)]
        if start is not None:
            points = [logp.from_values(start)]
        elif self.record.suggested:
            points.append(logp.from_values(self.record.suggested))
        heights = [logp(q) for q in points]
        best = int(np.argmax(heights))
        if not np.isfinite(heights[best]):
            raise SamplingError(
                f"model {model_name(logp.model)}: neither its initial nor its suggested values can be "
                "solved; pass start={name: value} with values that can"
            )
        step = 2 + max(d, GRADIENT)  # solves, with derivatives by differences or by the solver
        q, _, frame = gauss_newton(logp, points[best], heights[best], limit=6 * step)
        return q, frame @ frame.T

    def design(self, mean: Array, covariance: Array, n: int) -> Array:
        """Points (n, n_values) of a normal design in the coordinates, within the priors' bounds."""
        from scipy.stats import norm, qmc

        d = self.coordinates.n
        sobol = qmc.Sobol(d, seed=int(self.rng.integers(1 << 31)))
        u = norm.ppf(np.clip(sobol.random(1 << int(np.ceil(np.log2(2 * n)))), 1e-6, 1 - 1e-6))
        x = mean + WIDER * u @ np.linalg.cholesky(covariance).T
        low, high = self.coordinates.bounds()
        x = x[np.all((x > low) & (x < high), axis=1)]
        if len(x) < n:  # a posterior that leans on bounds: what lies outside is drawn to them
            more = mean + WIDER * self.rng.standard_normal((n, d)) @ np.linalg.cholesky(covariance).T
            x = np.concatenate([x, np.clip(more, *_inside(low, high, mean))])
        return self.coordinates.theta(x[:n])

    def explore(self, start: Mapping[str, Any] | None, chains: int) -> int:
        """Look for the posterior with chains of the forward model itself; how often they solved it.

        Where many parameters are held only together, and by independent errors closely, the posterior is
        bent, and a normal design around its mode lies beside it.
        """
        mode = self.mode = search_mode(self.logp, start, None, self.seed)
        self.say(f"mode: log-posterior {mode.logp:.1f} after {self.logp.evaluations} evaluations")
        idata = sample_exact(
            self.logp.model, draws=EXPLORED, tune=EXPLORE_TUNE, thin=EXPLORE_THIN, chains=chains,
            cores=self.cores, seed=self.seed, progress=False, start=mode,
        )  # fmt: skip
        found = idata["posterior"]
        self.explored = {name: np.asarray(found[name])[:, EXPLORED // 3 :] for name in self.names}
        return int(RunRecord.of(idata).solves)

    def points(self, draws: Draws, near: tuple[Array, Array], n: int) -> Array:
        """Points (n, n_values) of a design for a posterior of which there are draws (n_draws, ...)."""
        if not self.bent:
            return self.design(*near, n)
        theta = theta_of(self.record, draws)
        some: Array = theta[evenly(len(theta), n)]
        return some

    def solve(self, theta: Array) -> Array:
        series = self.library.solve(theta, self.cores)
        self.library.add(theta, series)
        return series

    def build(self, start: Mapping[str, Any] | None = None) -> Built:
        """The surrogate and its posterior, after as many rounds as it needs."""
        d = self.coordinates.n
        if self.explored is None:
            q, covariance = self.begin(start)
            normal = self.rng.standard_normal((max(400, 20 * d), len(q)))
            draws = self.values(q + normal @ np.linalg.cholesky(covariance).T)
            weighed = _first(errors_of(self.record, self.values(q[None])))
        else:
            draws = flat_draws(self.explored)
            vectors = self.logp.from_draws(draws)
            q, covariance = vectors.mean(0), np.cov(vectors.T) + 1e-9 * np.eye(vectors.shape[1])
            weighed = _medians(errors_of(self.record, draws))
        x = self.coordinates.of(theta_of(self.record, draws))
        near = x.mean(0), np.cov(x.T).reshape(d, d)
        share = FIRST_POINTS if not self.bent else OF_DRAWS
        self.solve(self.points(draws, near, max(LEAST_POINTS, int(share * term_count(d, 2)))))
        starts = self._starts(q, covariance) if not self.bent else vectors[:: -(len(vectors) // 4)][:4]
        log: list[dict[str, Any]] = []
        best, idle, enough = None, 0, ENOUGH if not self.bent else ENOUGH_EXPLORED
        for turn in range(1, ROUNDS + 1):
            surrogate = self._fit(weighed, near)
            made = self._model(surrogate, theta_of(self.record, draws)[:100])
            draws, gradients = self._draws(made, covariance, starts)
            self.gradients += gradients
            flat = flat_draws(draws)
            theta = theta_of(self.record, flat)
            some = evenly(len(theta), CHECKED)
            log_weights, lacks = self.compared(made, some_draws(flat, some), keep=True)
            weights = pareto_weights(log_weights[None])
            missed = self.missed(made, flat, lacks)
            x = self.coordinates.of(theta)
            log.append(_told(surrogate, theta, weights, missed))
            self.say(
                f"surrogate {turn}: {surrogate.map.text} for each of {len(surrogate.basis)} components, "
                f"expected error {log[-1]['error']:.2g} of the noise; of its draws "
                f"{100 * weights.effective:.0f} % are effective, k-hat {weights.k_hat:.2f}"
                + missed_words(missed)
            )
            vectors = self.logp.from_draws(some_draws(flat, np.arange(0, len(theta), 2)))
            covariance = np.cov(vectors.T).reshape(len(q), len(q)) + 1e-9 * np.eye(len(q))
            starts = vectors[self.rng.choice(len(vectors), len(starts), replace=False)]
            built = Built(made, draws, weights, turn, covariance, starts, missed, log)
            if weights.effective >= enough and self.sound(weights) and not misses_much(missed):
                best = built
                break
            if best is None or built.worth > 1.15 * best.worth:
                best, idle = built, 0
            else:
                idle += 1
            if idle > IDLE:
                break
            near = x.mean(0), np.cov(x.T).reshape(d, d)
            n = max(CHECKED, term_count(d, 2) // 2)
            if not self.bent:
                self.solve(theta[surrogate.least_known(theta, n, list(some))])
            else:
                self.solve(self.points(flat, near, n))
            weighed = _medians(errors_of(self.record, flat))
        assert best is not None
        return best

    def _fit(self, weighed: Mapping[str, Any], near: tuple[Array, Array]) -> Surrogate:
        """A surrogate of the solves near a posterior, in this model's coordinates."""
        within = 3.0 * np.sqrt(self.coordinates.n) + 3.0
        return Surrogate.fit(
            self.library,
            self.record.errors,
            weighed,
            near=near,
            within=within,
            coordinates=self.coordinates,
            kriging=not self.bent,  # whose chains on it take very many steps
        )

    def sound(self, weights: Weights) -> bool:
        """Whether no more solves are needed for better weights."""
        return weights.trusted if self.bent else weights.k_hat <= TAIL

    def _model(self, surrogate: Surrogate, points: Array) -> SurrogateModel:
        """With its likelihood to a power, by which a normal posterior of n dimensions is wider.

        Of draws of density p^a, a p^(1 - a) weighs each, and (a (2 - a))^(n/2) of them are effective.
        """
        power = 1.0
        if not self.bent:
            n = len(self.logp.template.data)
            power = 1.0 - float(np.sqrt(1.0 - DEFENSIVE ** (2.0 / n)))
        return surrogate_model(self.logp.model, self.record, surrogate, points, power)

    def _draws(self, made: SurrogateModel, covariance: Array, starts: Array) -> tuple[Draws, int]:
        """Draws of a surrogate's posterior to look at, and gradients that they took."""
        seed = int(self.rng.integers(1 << 31))
        if self.bent:
            steps = JUMP_TUNE // 10, JUMP_THIN // 4
            return self.jumping(made, covariance, starts, ROUND_DRAWS, seed, *steps), 0
        return nuts(
            made.model,
            self.names,
            covariance,
            starts,
            self.values(starts),
            draws=ROUND_DRAWS,
            tune=ROUND_TUNE,
            cores=self.cores,
            seed=seed,
        )

    def jumping(
        self,
        made: SurrogateModel,
        covariance: Array,
        starts: Array,
        draws: int,
        seed: int,
        tune: int | None = None,
        thin: int | None = None,
    ) -> Draws:
        """Chains of differential evolution on a surrogate, which jump between lesser modes where NUTS stays.

        Only between those that are in reach of where the forward model's own chains have been: elsewhere the
        surrogate has no density.
        """
        logp = LogPosterior(made.model)
        mode = Mode(starts[0], logp.to_values(starts[0]), logp(starts[0]), covariance, 0)
        idata = sample_exact(
            made.model,
            draws=draws,
            tune=JUMP_TUNE if tune is None else tune,
            thin=JUMP_THIN if thin is None else thin,
            chains=len(starts),
            cores=0 if self.cores == 1 else self.cores,
            seed=seed,
            progress=False,
            start=mode,
        )
        return {name: np.asarray(idata["posterior"][name]) for name in self.names}

    def again(self, built: Built, draws: Draws, weights: Weights, missed: float | None) -> Built:
        """A surrogate of all that was solved since, with points beyond the draws of the last one."""
        flat = flat_draws(draws)
        d, theta = self.coordinates.n, theta_of(self.record, flat)
        x = self.coordinates.of(theta)
        near = x.mean(0), np.cov(x.T).reshape(d, d)
        self.solve(self.points(flat, near, max(LEAST_POINTS, term_count(d, 2) // 2)))
        medians = _medians(errors_of(self.record, flat))
        surrogate = self._fit(medians, near)
        some = theta[:: max(1, len(theta) // 100)]
        made = self._model(surrogate, some)
        log, rounds = [*built.log, _told(surrogate, some, weights, missed)], built.rounds + 1
        return replace(built, made=made, draws=draws, weights=weights, missed=missed, rounds=rounds, log=log)

    def _starts(self, q: Array, covariance: Array, chains: int = 4) -> Array:
        return q + 0.7 * self.rng.standard_normal((chains, len(q))) @ np.linalg.cholesky(covariance).T

    def missed(self, made: SurrogateModel, draws: Draws, lacks: Array) -> float | None:
        """What part of the exact posterior lies where the surrogate is too low to be drawn from, at least.

        Draws cannot tell what they never reach. So some of them, q of n dimensions, are moved away from their
        mean m, to q' = m + s (q - m), whose density is that of q over s^n, and are weighed with the exact
        posterior over that. What lies further out than these is not seen; with many dimensions s is near 1.

        Parameters
        ----------
        made : SurrogateModel
        draws : dict
            Of its posterior, variable -> (n_draws, ...).
        lacks : array
            By how much the surrogate's log-likelihood is too low at some of them or all, in any order.

        Returns
        -------
        float or None
            None of a posterior that chains of the forward model have looked for, which is not asked.
        """
        if self.bent:
            return None
        vectors = self.logp.from_draws(draws)
        total, n = vectors.shape
        c = SEEN ** (-2.0 / n)
        further = float(np.sqrt(c + np.sqrt(c * c - c)))
        some = vectors[evenly(total, BEYOND)]
        moved = vectors.mean(0) + further * (some - vectors.mean(0))
        height = LogPosterior(made.model)
        here, there = (np.array([height(q) for q in each]) for each in (some, moved))
        found, low = self.compared(made, self.values(moved), keep=True)
        known = lacks[np.isfinite(lacks)]
        log_mass = found + there - here
        possible = np.isfinite(log_mass)
        if not known.size or not possible.any():
            return 1.0
        mass = np.exp(np.where(possible, log_mass, -np.inf) - log_mass[possible].max())
        too_low = low > max(float(np.median(known)) + TOO_LOW, float(known.max()))
        return float(mass[too_low].sum() / mass.sum())

    def compared(
        self, made: SurrogateModel, draws: Mapping[str, Array], keep: bool = False
    ) -> tuple[Array, Array]:
        """Draws (n, ...) solved: log weights, and by how much the surrogate's log-likelihood is too low."""
        theta, errors = theta_of(self.record, draws), errors_of(self.record, draws)
        series = self.library.solve(theta, self.cores)
        if keep:
            self.library.add(theta, series)
        exact = log_likelihood(self.record, series, errors)
        with np.errstate(invalid="ignore"):
            found = [exact - own for own in made.log_likelihood(theta, errors)]
        weights, lacks = (np.where(np.isnan(one), -np.inf, one) for one in found)
        return weights, lacks


def _told(surrogate: Surrogate, theta: Array, weights: Weights, missed: float | None) -> dict[str, Any]:
    """What a round found, with the error expected at parameters (n, n_values)."""
    return {
        "map": type(surrogate.map).__name__.lower(),
        "points": len(surrogate.map.residuals),
        "terms": len(surrogate.map.terms),
        "basis": len(surrogate.basis),
        "error": float(np.median(surrogate.error(theta))),
        "k_hat": weights.k_hat,
        "effective": weights.effective,
        "missed": missed,
    }


def misses_much(missed: float | None) -> bool:
    """Whether weights of draws cannot mend what a surrogate misses."""
    return missed is not None and missed > MISSED


def missed_words(missed: float | None) -> str:
    """That share, for a line of progress."""
    return "" if missed is None else f"; it misses at least {100 * missed:.0f} % of the posterior"


def flat_draws(draws: Draws) -> Draws:
    """Draws of all chains, variable -> (n_chains n_draws, ...)."""
    return {name: value.reshape(-1, *value.shape[2:]) for name, value in draws.items()}


def some_draws(draws: Draws, which: NDArray[Any]) -> Draws:
    """Of draws, variable -> (n_draws, ...), those that are asked for."""
    return {name: value[which] for name, value in draws.items()}


def _medians(values: Mapping[str, Array]) -> dict[str, Any]:
    return {name: np.median(value, axis=0) for name, value in values.items()}


def _first(known: Mapping[str, Array]) -> dict[str, Any]:
    return {name: np.asarray(value)[0] for name, value in known.items()}


def _inside(low: Array, high: Array, mean: Array) -> tuple[Array, Array]:
    """Bounds drawn in a little, so that a density is not zero there."""
    return (
        np.where(np.isfinite(low), low + 1e-3 * (mean - low), low),
        np.where(np.isfinite(high), high - 1e-3 * (high - mean), high),
    )
