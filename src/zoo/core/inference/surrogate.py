"""Posteriors by NUTS on a surrogate of the forward model, made exact by the forward model itself."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.inference.convergence import check_convergence, ess_to_count
from zoo.core.inference.correction import (
    HamiltonianMoves,
    Weights,
    along_chains,
    delayed_acceptance,
    pareto_weights,
)
from zoo.core.inference.logposterior import LogPosterior, SamplingError, model_name, outputs
from zoo.core.inference.mode import Mode, has_many, search_mode
from zoo.core.inference.newton import GRADIENT, gauss_newton
from zoo.core.inference.nuts import Draws, nuts
from zoo.core.inference.record import RunRecord
from zoo.core.inference.record_of_run import attach_record, inference_data
from zoo.core.inference.sampling import sample as sample_exact
from zoo.core.model import ModelRecord, record_of
from zoo.core.parameters import variable_name
from zoo.core.surrogate.coordinates import Coordinates
from zoo.core.surrogate.library import Library
from zoo.core.surrogate.model import SurrogateModel, errors_in_graph, log_likelihood, surrogate_model
from zoo.core.surrogate.polynomial import term_count
from zoo.core.surrogate.waveform import Surrogate, SurrogateError

if TYPE_CHECKING:
    import arviz as az

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
FINAL_TUNE = 600
PILOT, PILOTED = 4, 400
"""One draw in so many of a posterior is solved first, and tells whether the others are worth it; all at once
where there are fewer than so many."""
REFITS = 2
"""How often draws whose weights are not trusted join the surrogate's design, before delayed acceptance."""
THIN = 8
"""Draws of NUTS for each one that is solved and stored."""
JUMP_TUNE, JUMP_THIN = 60000, 60
"""Steps of a chain of differential evolution on the surrogate of a bent posterior: thrown away, and for each
stored draw."""
JUMPS = 100
"""Effective sample size of such chains below which NUTS is tried too: one jumps, the other follows a bend."""
FLATTEST = 0.05
"""Least power of a surrogate's posterior that delayed acceptance moves in."""
MOST_DRAWS = 8
"""Limit of the stored draws of each chain, in those of the first check."""


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


def theta_of(record: ModelRecord, draws: Mapping[str, Array]) -> Array:
    """Forward parameters (n, n_values) of draws, variable -> (n_chains, n_draws, ...) or (n, ...)."""
    parts = []
    for p in record.forward.parameters:
        parts.append(np.asarray(draws[variable_name(p.name)], dtype=np.float64).reshape(-1, p.size))
    return np.concatenate(parts, axis=1)


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
        if self.explored is None:
            return self.design(*near, n)
        theta = theta_of(self.record, draws)
        some: Array = theta[np.unique(np.linspace(0, len(theta) - 1, n).astype(int))]
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
            draws = _flat(self.explored)
            vectors = self.logp.from_draws(draws)
            q, covariance = vectors.mean(0), np.cov(vectors.T) + 1e-9 * np.eye(vectors.shape[1])
            weighed = _medians(errors_of(self.record, draws))
        x = self.coordinates.of(theta_of(self.record, draws))
        near = x.mean(0), np.cov(x.T).reshape(d, d)
        share = FIRST_POINTS if self.explored is None else OF_DRAWS
        self.solve(self.points(draws, near, max(LEAST_POINTS, int(share * term_count(d, 2)))))
        starts = (
            self._starts(q, covariance) if self.explored is None else vectors[:: -(len(vectors) // 4)][:4]
        )
        log: list[dict[str, Any]] = []
        best, idle, enough = None, 0, ENOUGH if self.explored is None else ENOUGH_EXPLORED
        for turn in range(1, ROUNDS + 1):
            surrogate = self._fit(weighed, near)
            made = self._model(surrogate, theta_of(self.record, draws)[:100])
            draws, gradients = self._draws(made, covariance, starts)
            self.gradients += gradients
            flat = _flat(draws)
            theta = theta_of(self.record, flat)
            some = np.unique(np.linspace(0, len(theta) - 1, CHECKED).astype(int))
            log_weights, lacks = self.compared(made, {n: v[some] for n, v in flat.items()}, keep=True)
            weights = pareto_weights(log_weights[None])
            missed = self.missed(made, flat, lacks)
            x = self.coordinates.of(theta)
            log.append(_told(surrogate, theta, weights, missed))
            self.say(
                f"surrogate {turn}: {surrogate.map.text} for each of {len(surrogate.basis)} components, "
                f"expected error {log[-1]['error']:.2g} of the noise; of its draws "
                f"{100 * weights.effective:.0f} % are effective, k-hat {weights.k_hat:.2f}" + _words(missed)
            )
            vectors = self.logp.from_draws({n: v[::2] for n, v in flat.items()})
            covariance = np.cov(vectors.T).reshape(len(q), len(q)) + 1e-9 * np.eye(len(q))
            starts = vectors[self.rng.choice(len(vectors), len(starts), replace=False)]
            built = Built(made, draws, weights, turn, covariance, starts, missed, log)
            if weights.effective >= enough and self.sound(weights) and not _misses_much(missed):
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
            if self.explored is None:
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
            kriging=self.explored is None,  # whose chains on it take very many steps
        )

    def sound(self, weights: Weights) -> bool:
        """Whether no more solves are needed for better weights."""
        return weights.trusted if self.explored is not None else weights.k_hat <= TAIL

    def _model(self, surrogate: Surrogate, points: Array) -> SurrogateModel:
        """With its likelihood to a power, by which a normal posterior of n dimensions is wider.

        Of draws of density p^a, a p^(1 - a) weighs each, and (a (2 - a))^(n/2) of them are effective.
        """
        power = 1.0
        if self.explored is None:
            n = len(self.logp.template.data)
            power = 1.0 - float(np.sqrt(1.0 - DEFENSIVE ** (2.0 / n)))
        return surrogate_model(self.logp.model, self.record, surrogate, points, power)

    def _draws(self, made: SurrogateModel, covariance: Array, starts: Array) -> tuple[Draws, int]:
        """Draws of a surrogate's posterior to look at, and gradients that they took."""
        seed = int(self.rng.integers(1 << 31))
        if self.explored is not None:
            steps = JUMP_TUNE // 10, JUMP_THIN // 4
            return _jumping(
                made.model, self.names, covariance, starts, ROUND_DRAWS, *steps, self.cores, seed
            ), 0
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

    def again(self, built: Built, draws: Draws, weights: Weights, missed: float | None) -> Built:
        """A surrogate of all that was solved since, with points beyond the draws of the last one."""
        flat = _flat(draws)
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
        if self.explored is not None:
            return None
        vectors = self.logp.from_draws(draws)
        total, n = vectors.shape
        c = SEEN ** (-2.0 / n)
        further = float(np.sqrt(c + np.sqrt(c * c - c)))
        some = vectors[np.unique(np.linspace(0, total - 1, BEYOND).astype(int))]
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


def _misses_much(missed: float | None) -> bool:
    return missed is not None and missed > MISSED


def _words(missed: float | None) -> str:
    return "" if missed is None else f"; it misses at least {100 * missed:.0f} % of the posterior"


def _flat(draws: Draws) -> Draws:
    """Draws of all chains, variable -> (n_chains n_draws, ...)."""
    return {name: value.reshape(-1, *value.shape[2:]) for name, value in draws.items()}


def _some(draws: Draws, which: Array) -> Draws:
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


def sample_surrogate(
    model: Any,
    *,
    draws: int = 1000,
    tune: int | None = None,
    chains: int = 4,
    cores: int = 2,
    seed: int | None = None,
    progress: bool = True,
    until_ess: float | None = None,
    max_draws: int | None = None,
    start: Mapping[str, Any] | None = None,
    library: Library | None = None,
) -> az.InferenceData:
    """Sample a posterior by NUTS on a surrogate of the forward model, and make its draws exact.

    A surrogate is built around the posterior (`Builder`). Every stored draw of NUTS is then solved with the
    forward model itself, and weighed by the exact likelihood over the surrogate's to a power. With k-hat up
    to 0.7 the draws are resampled by their smoothed weights, along each chain; else chains of delayed
    acceptance are made, in which every step is accepted by the forward model. Effective sample sizes and
    R-hat are those of the draws after that.

    Parameters
    ----------
    model : pm.Model
        With a record (`zoo.core.model.bayesian_model`).
    draws, tune, chains, cores, seed, progress, until_ess, max_draws
        As of `zoo.core.inference.sampling.sample`; `max_draws` is 8 `draws` if absent.
    start : mapping, optional
        Values where the search for the posterior begins.
    library : Library, optional
        Solves of the same forward model that are there already; those of this run are added to it.

    Returns
    -------
    arviz.InferenceData
        As of `sample`; sample_stats also has log_weight of each stored draw. The run record's settings tell
        how many solves the building and the correction took, k-hat, the effective share and each round.

    Raises
    ------
    SamplingError
        If the posterior cannot be found.
    zoo.core.surrogate.waveform.SurrogateError
        If the error model or the forward model does not allow a surrogate, or it misses a part of the
        posterior.

    References
    ----------
    Vehtari et al. (2024), Journal of Machine Learning Research 25(72); Christen, Fox (2005), doi
    10.1198/106186005X76983.
    """
    from zoo.core.inference.progress import Display

    began, used = time.monotonic(), time.process_time()
    started = datetime.now(UTC).isoformat(timespec="seconds")
    record = record_of(model)
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else int(seed)
    logp = LogPosterior(model)
    library = Library(record.forward) if library is None else library
    if library.model.key != record.forward.key:
        raise SamplingError(
            f"library: is of {library.model.name} with other settings; give one of this model"
        )
    bent = has_many(logp) and errors_in_graph(record)  # such a posterior has lesser modes too
    before, goal = library.solves, ess_to_count(until_ess)
    tune = FINAL_TUNE if tune is None else tune
    with Display(progress, tune=tune, thin=THIN, cores=cores, ess=until_ess) as show:
        show.say(
            f"model {model_name(model)}: {len(logp.template.data)} dimensions, {chains} chains of "
            f"{'differential evolution' if bent else 'NUTS'} on a surrogate of {record.forward.name}, "
            f"seed {seed}"
        )
        builder = Builder(logp, library, seed=seed, cores=cores, say=show.say)
        exploring = 0
        if bent:
            with show.during("chains look for the posterior", lambda: f"{logp.evaluations} evaluations"):
                exploring = builder.explore(start, chains)
        built = builder.build(start)
        building = library.solves - before
        limit = max_draws or MOST_DRAWS * draws
        kept, again, missed = draws, 0, None
        drawn: Draws = {}
        log_weights = np.empty((chains, 0))
        while True:
            have = log_weights.shape[1]
            more = _drawn(builder, built, kept - have, tune, chains, cores)
            flat, solved = _flat(more), np.empty(chains * (kept - have))
            first = np.arange(len(solved)) % PILOT == 0  # where these are bad, no others are solved
            first |= len(solved) < PILOTED
            solved[first], lacks = builder.compared(built.made, _some(flat, first), keep=True)
            weights = pareto_weights(solved[first][None])
            if not have:
                missed = builder.missed(built.made, flat, lacks)
            bad = not have and (not builder.sound(weights) or _misses_much(missed))
            if not bad or (again == REFITS and not _misses_much(missed)):
                solved[~first], _ = builder.compared(built.made, _some(flat, ~first), keep=True)
                drawn = {n: np.concatenate([drawn[n], v], axis=1) if have else v for n, v in more.items()}
                log_weights = np.concatenate([log_weights, solved.reshape(chains, -1)], axis=1)
                weights = pareto_weights(log_weights)
                bad = not weights.trusted or _misses_much(missed)
            if bad and again < REFITS:
                again += 1
                show.say(
                    f"k-hat {weights.k_hat:.2f} of {weights.smoothed.size} draws of the surrogate"
                    f"{_words(missed)}: they join its design"
                )
                built = builder.again(built, drawn if have else more, weights, missed)
                log_weights = np.empty((chains, 0))
                continue
            if _misses_much(missed):
                raise SurrogateError(
                    f"model {model_name(model)}: the surrogate misses at least {100 * (missed or 0.0):.0f} % "
                    "of the posterior, which no weights of its draws can mend; sample with method exact"
                )
            result = _corrected(builder, built, drawn, log_weights, weights)
            verdict = check_convergence(result.draws, ess=goal)
            if until_ess is None or verdict.passes or kept >= limit:
                break
            least = max(verdict.min_ess, 1.0)
            kept = min(limit, int(np.ceil(kept * float(np.clip(1.2 * goal / least, 1.3, 3.0)))))
            show.say(f"effective sample size {least:.0f} of {goal:.0f}: {kept} draws of each chain")
        show.say(result.words)
        if builder.mode is not None:
            show.say(
                f"these draws are of one mode, of log-posterior {builder.mode.logp:.1f}: the posterior of so "
                "many parameters may have others; start={name: value} begins at another"
            )
        shape = result.log_weights.shape
        stats = {
            "log_weight": result.log_weights,
            "accepted": np.ones(shape) if result.accepted is None else result.accepted.astype(float),
            "solves": np.ones(shape, dtype=np.int64),
        }
        idata = inference_data(model, result.draws, stats)
        solves = exploring + library.solves - before
        wall = time.monotonic() - began
        settings = {
            "method": "surrogate",
            "step": "demetropolisz" if bent else "nuts",
            "tune": JUMP_TUNE if bent else tune,
            "thin": JUMP_THIN if bent else THIN,
            "chains": chains,
            "draws": kept,
            "first check": draws,
            "until_ess": until_ess,
            "cores": cores,
            "surrogate": {
                "mode": None if builder.mode is None else builder.mode.logp,
                "exploring solves": exploring,
                "building solves": building,
                "correction solves": solves - exploring - building,
                "correction": result.correction,
                "power": built.made.power,
                "k_hat": result.weights.k_hat,
                "effective share": result.weights.effective,
                "missed share": missed,
                "gradients of the surrogate": builder.gradients,
                "processor seconds": time.process_time() - used,
                "rounds": built.log,
            },
        }
        attach_record(
            idata,
            model,
            logp,
            settings,
            seed=seed,
            solves=solves,
            steps=chains * kept,
            mode_evaluations=logp.evaluations,
            failures=dict(library.failures),
            wall_seconds=wall,
            started=started,
            say=show.say,
        )
    return idata


@dataclass(frozen=True)
class _Corrected:
    """Draws that count: variable -> (n_chains, n_draws, ...), their weights before, and what was done."""

    draws: Draws
    log_weights: Array
    weights: Weights
    correction: str
    words: str
    accepted: Array | None = None


def _drawn(builder: Builder, built: Built, kept: int, tune: int, chains: int, cores: int) -> Draws:
    """Chains on the surrogate."""
    seed = int(builder.rng.integers(1 << 31))
    starts = built.starts[np.arange(chains) % len(built.starts)]
    draws, least = None, 0.0
    if builder.explored is not None:
        draws = _jumping(
            built.made.model, builder.names, built.covariance, starts, kept, JUMP_TUNE, JUMP_THIN, cores, seed
        )
        least = check_convergence(draws).min_ess
    if draws is None or not least >= JUMPS:
        long, gradients = nuts(
            built.made.model,
            builder.names,
            built.covariance,
            starts,
            builder.values(starts),
            draws=kept * THIN,
            tune=tune,
            cores=cores,
            seed=seed,
        )
        builder.gradients += gradients
        thinned = {name: value[:, ::THIN] for name, value in long.items()}
        if draws is None or check_convergence(thinned).min_ess > least:
            draws = thinned
    return draws


def _jumping(
    model: Any,
    names: Sequence[str],
    covariance: Array,
    starts: Array,
    draws: int,
    tune: int,
    thin: int,
    cores: int,
    seed: int,
) -> Draws:
    """Chains of differential evolution on a surrogate, which jump between lesser modes where NUTS stays.

    Only between those that are in reach of where the forward model's own chains have been: elsewhere the
    surrogate has no density.
    """
    logp = LogPosterior(model)
    mode = Mode(starts[0], logp.to_values(starts[0]), logp(starts[0]), covariance, 0)
    idata = sample_exact(
        model, draws=draws, tune=tune, thin=thin, chains=len(starts), cores=0 if cores == 1 else cores,
        seed=seed, progress=False, start=mode,
    )  # fmt: skip
    return {name: np.asarray(idata["posterior"][name]) for name in names}


def _corrected(
    builder: Builder, built: Built, draws: Draws, log_weights: Array, weights: Weights
) -> _Corrected:
    """Weighed draws resampled along their chains, or where k-hat says no chains of delayed acceptance."""
    if not weights.trusted:
        return _by_delayed_acceptance(builder, built, draws, log_weights, weights)
    index = along_chains(weights.smoothed, builder.rng)
    chain = np.arange(len(index))[:, None]
    return _Corrected(
        {name: value[chain, index] for name, value in draws.items()},
        log_weights[chain, index],
        weights,
        "importance resampling",
        f"corrected by importance resampling: k-hat {weights.k_hat:.2f}, "
        f"{100 * weights.effective:.0f} % of {log_weights.size} draws effective",
    )


def _by_delayed_acceptance(
    builder: Builder, built: Built, draws: Draws, log_weights: Array, weights: Weights
) -> _Corrected:
    """Chains that begin at resampled draws, each step a move of the surrogate that a solve accepts.

    Moves are made in the surrogate's posterior to the power by which the exact one falls with it, so that a
    surrogate that is too narrow still goes where the exact posterior is.
    """
    chains, kept = log_weights.shape
    logp, rng = builder.logp, builder.rng
    flat = _flat(draws)
    function = built.made.model.logp_dlogp_function(ravel_inputs=True)
    function.set_extra_values({})

    def surrogate(q: Array) -> tuple[float, Array]:
        value, gradient = function._pytensor_function(q)
        return float(value), np.asarray(gradient)

    some = np.flatnonzero(np.isfinite(log_weights.ravel()))[:: max(1, log_weights.size // 400)]
    vectors = logp.from_draws({n: v[some] for n, v in flat.items()})
    heights = np.array([surrogate(q)[0] for q in vectors])
    share = 1.0 + float(np.polyfit(heights, log_weights.ravel()[some], 1)[0])
    share = float(np.clip(share, FLATTEST, 1.0))

    def slopes(q: Array) -> tuple[float, Array]:
        value, gradient = surrogate(q)
        return share * value, share * gradient

    def weigh(q: Array) -> float:
        weight = float(builder.compared(built.made, builder.values(q[None]))[0][0])
        return weight + (1.0 - share) * surrogate(q)[0]

    d = vectors.shape[1]
    lower = np.linalg.cholesky((np.cov(vectors.T).reshape(d, d) + 1e-9 * np.eye(d)) / share)
    moves = HamiltonianMoves(slopes, np.asarray(lower, dtype=np.float64))
    begin = rng.choice(log_weights.size, chains, p=weights.smoothed.ravel())
    first = logp.from_draws({n: v[begin] for n, v in flat.items()})
    found = [delayed_acceptance(moves, weigh, q, kept, rng) for q in first]
    made = [builder.values(each[0]) for each in found]
    accepted = np.array([each[2] for each in found])
    return _Corrected(
        {name: np.array([one[name] for one in made]) for name in builder.names},
        np.array([each[1] for each in found]),
        weights,
        "delayed acceptance",
        f"corrected by delayed acceptance, for k-hat is {weights.k_hat:.2f}: {100 * accepted.mean():.0f} % "
        "of the steps accepted",
        accepted,
    )
