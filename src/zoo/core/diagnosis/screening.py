"""Screening: the evidence for each effect of the catalogue, from a search and a linearisation.

Each hypothesis (the base with an effect somewhere) is taken to its mode by Gauss-Newton steps with Broyden's
updates; the marginal likelihood around the mode is that of the linearised model, which is exact for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import log_ndtr, logsumexp, ndtri_exp
from scipy.stats import truncnorm

from zoo.blood.conventions import Conventions
from zoo.blood.effects import CATALOGUE, Amplitude, Base, Effect, Place, apply_all, get_base, simulate
from zoo.blood.network import Network
from zoo.blood.solver import SolverArgumentError, SolverOptions
from zoo.blood.study import Study
from zoo.core.diagnosis.discrepancy import (
    CORRELATED_RATIO,
    LARGEST_DELTA,
    LENGTH_BEATS,
    LENGTH_GRID,
    MEMORY_BEATS,
    SHARED_GRID,
    Errors,
    Harmonics,
    fit_noise,
    length_log_prior,
    marginal,
    noise_log_prior,
)

Array = NDArray[np.float64]

NO_GAP, UNLISTED, CORRELATED = "no-gap", "unlisted", "correlated-noise"

ALLOWANCE = 0.1
"""What a listed effect may leave of the gap, as a part of it (sd): an effect is a caricature of its cause."""
NUMERICS_PART = 1e-3
"""Error of the solver's grid, for which none is blamed, in parts of a series' range (docs/numerics)."""
SIZE_PART = 0.05
"""Prior sd of a free discrepancy, as a part of a series' range."""
PRIOR_NO_GAP, PRIOR_UNLISTED = 0.5, 0.1
"""Prior probabilities; the rest is shared equally by the effects that the study can show."""
DELTA_GRID = LARGEST_DELTA * np.array([0.0, 0.125, 0.25, 0.5, 0.75, 1.0])
SIZE_GRID = np.geomspace(2e-3, 20.0, 20)
RATIO_GRID = CORRELATED_RATIO * np.linspace(0.0, 1.0, 7)
MEMORY_GRID = np.linspace(-2.0, 2.0, 5)
"""Of the noise's correlation time: in sds of the logarithm from the median."""
SEARCHED_PLACES = 8
"""Places of an effect that are searched: those where the linearised evidence is largest."""
SETTLED = 4
"""How many of the best explanations are searched again beside the noise alone, with all that have a shape."""
TRIES = 20
"""Draws of the parameters among which one inside the bounds is taken."""
SWEEPS = 20
"""Of Gibbs' sampler, where none is."""
VISIBLE = 3.0
"""Expected log-likelihood ratio, e^3 = 20 to 1, below which two hypotheses are the same to this study."""
DOUBT = 0.01
"""Probability above which an explanation outside the leader's group deserves a posterior or a measurement."""
SEARCH = SolverOptions(tolerance_mmHg=2e-4)


@dataclass(frozen=True)
class Parameter:
    """A free number of a hypothesis; searched on a log scale if `log`."""

    name: str
    unit: str
    low: float
    high: float
    log: bool = False
    centre: float = 0.0
    scale: float = 0.0  # of a normal prior; 0: uniform on (low, high)

    @property
    def unit_step(self) -> float:
        """What one unit of the search stands for."""
        return 0.1 if self.log else self.scale or 0.1 * (self.high - self.low)

    def inside(self, value: Array | float) -> Any:
        """Search coordinate to value."""
        return np.exp(value) if self.log else value

    def outside(self, value: float) -> float:
        """Value to search coordinate."""
        return math.log(value) if self.log else value

    def log_prior(self, u: float) -> float:
        """Of the search coordinate."""
        if self.scale:
            low, high = ((x - self.centre) / self.scale for x in (self.low, self.high))
            z = (u - self.centre) / self.scale
            size = math.log(self.scale * math.sqrt(2.0 * math.pi)) + float(_log_mass(low, high))
            return -0.5 * z * z - size
        return -math.log(self.high - self.low) + (u if self.log else 0.0)


def _log_mass(low: Any, high: Any) -> Any:
    """log(Phi(high) - Phi(low)), also far out in a tail."""
    a, b = _log_tails(low, high)
    return b + np.log1p(-np.exp(np.minimum(a - b, -1e-12)))


def _log_tails(low: Any, high: Any) -> tuple[Any, Any]:
    """log Phi of both ends, right of 0 of their mirror images instead: the left tail has the digits."""
    return log_ndtr(np.where(low > 0, -high, low)), log_ndtr(np.where(low > 0, -low, high))


@dataclass(frozen=True)
class Hypothesis:
    """A base model with effects, the last of which is asked about; without effects it is the base itself."""

    effects: tuple[tuple[str, Place], ...] = ()

    @property
    def name(self) -> str:
        """Of the effect asked about."""
        return self.effects[-1][0] if self.effects else NO_GAP

    @property
    def place(self) -> Place:
        """Where it acts."""
        return self.effects[-1][1] if self.effects else Place()


class Forward:
    """The series of a study under a hypothesis, as harmonics.

    Parameters
    ----------
    study : Study
    base : Base
    hypothesis : Hypothesis
    harmonics : Harmonics
    options : SolverOptions
    conventions : Conventions, optional
        Instead of the study's own.
    """

    def __init__(
        self,
        study: Study,
        base: Base,
        hypothesis: Hypothesis,
        harmonics: Harmonics,
        options: SolverOptions = SEARCH,
        conventions: Conventions | None = None,
    ) -> None:
        self.study, self.base, self.hypothesis, self.harmonics = study, base, hypothesis, harmonics
        self.options = options
        self.conventions = conventions
        parameters = [Parameter(p.name, p.unit, p.low, p.high, p.log) for p in base.parameters]
        self.n_base = len(parameters)
        for i, (name, _) in enumerate(hypothesis.effects):
            for a in CATALOGUE[name].amplitudes:
                label = a.name if i == len(hypothesis.effects) - 1 else f"{name} {a.name}"
                parameters.append(Parameter(label, a.unit, a.low, a.high, False, a.centre, a.scale))
        self.parameters = tuple(parameters)
        self.asked = len(parameters) - (
            len(CATALOGUE[hypothesis.name].amplitudes) if hypothesis.effects else 0
        )
        """Index of the first amplitude of the effect asked about."""
        self.low = np.array([p.outside(p.low) for p in parameters])
        self.high = np.array([p.outside(p.high) for p in parameters])
        self.units = np.array([p.unit_step for p in parameters])
        self.solves = self.failures = 0
        self.last_failure = ""
        self._series = [(s.vessel, s.position, s.quantity) for s in study.series]
        lag = (conventions or study.conventions).sample_lag_beats
        self._times = study.time_s + lag * study.period_s

    def values(self, u: Array) -> Array:
        """Search coordinates to values."""
        return np.array([p.inside(x) for p, x in zip(self.parameters, u, strict=True)])

    def case(self, u: Array) -> Any:
        """The solve at these coordinates."""
        values = self.values(u)
        theta, at = values[: self.n_base], self.n_base
        added: list[tuple[Effect, tuple[float, ...], Place]] = []
        for name, place in self.hypothesis.effects:
            effect = CATALOGUE[name]
            n = len(effect.amplitudes)
            added.append((effect, tuple(float(v) for v in values[at : at + n]), place))
            at += n
        case = self.base.case(self.study, theta, self.options, conventions=self.conventions)
        return apply_all(case, added)

    def waves(self, u: Array, series: Sequence[tuple[int, float, str]] | None = None) -> Array | None:
        """Series (n_series, n_times) in their own units, or None where the solve failed."""
        self.solves += 1
        try:
            waves, reason = simulate(self.case(u), self._series if series is None else series, self._times)
        except SolverArgumentError as error:  # such as a vessel narrowed to nothing
            waves, reason = np.empty(0), str(error)
        if reason is not None or not np.all(np.isfinite(waves)):
            self.failures += 1
            self.last_failure = reason or "not finite"
            return None
        return waves

    def __call__(self, u: Array) -> Array | None:
        """Harmonics, or None where the solve failed."""
        waves = self.waves(u)
        return None if waves is None else self.harmonics(waves)

    def prior(self, u: Array) -> tuple[float, Array, Array]:
        """Log-prior of the coordinates; its precision and pull, as `marginal` wants them."""
        log_prior = sum(p.log_prior(x) for p, x in zip(self.parameters, u, strict=True))
        precision = np.array([1.0 / p.scale**2 if p.scale else 0.0 for p in self.parameters])
        pull = np.array(
            [
                (x - p.centre) / p.scale**2 if p.scale else -1.0 if p.log else 0.0
                for p, x in zip(self.parameters, u, strict=True)
            ]
        )
        return float(log_prior), precision, pull

    def log_mass(self, mean: Array, covariance: Array) -> Any:
        """Log of the part of normal posteriors inside the bounds, as if the parameters were independent.

        Parameters
        ----------
        mean : array (..., n_dim)
        covariance : array (..., n_dim, n_dim)

        Returns
        -------
        array (...,)
        """
        sd = np.sqrt(np.einsum("...dd->...d", covariance))
        return np.sum(_log_mass((self.low - mean) / sd, (self.high - mean) / sd), axis=-1)


@dataclass
class Point:
    """Where a search stands."""

    u: Array
    computed: Array  # harmonics
    jacobian: Array  # (n, d)
    cost: float = math.inf


class SearchError(RuntimeError):
    """A search that found no point where the solver succeeds."""


class Search:
    """Gauss-Newton search of one hypothesis' mode, for given errors.

    Parameters
    ----------
    forward : Forward
    data : array (n,)
        Harmonics of the measured series.
    S : array (n,)
        Variances.
    """

    def __init__(self, forward: Forward, data: Array, S: Array) -> None:
        self.forward, self.data, self.S = forward, data, S

    def cost(self, u: Array, computed: Array) -> float:
        """-log posterior, without constants."""
        r = self.data - computed
        return 0.5 * float(np.sum(r * r / self.S)) - self.forward.prior(u)[0]

    def at(self, u: Array, jacobian: Array | None = None) -> Point:
        """A point, with finite differences for its Jacobian unless one is given."""
        computed = self.forward(u)
        if computed is None:
            raise SearchError(self.forward.last_failure)
        point = Point(u, computed, np.zeros((len(computed), len(u))), self.cost(u, computed))
        point.jacobian = self.differences(point, None) if jacobian is None else jacobian
        return point

    def resume(self, fit: Fit) -> Point:
        """Where a fit stands."""
        return Point(fit.u, fit.computed, fit.jacobian, self.cost(fit.u, fit.computed))

    def differences(self, point: Point, guess: Array | None) -> Array:
        """Jacobian by one-sided differences, of steps that change the series by about twice their noise."""
        forward, wanted = self.forward, 2.0 * math.sqrt(float(len(self.S)))
        columns = []
        for i, unit in enumerate(forward.units):
            step = 0.05 * unit
            if guess is not None:
                size = math.sqrt(float(np.sum(guess[:, i] ** 2 / self.S)))
                step = float(np.clip(wanted / size, 0.01 * unit, 0.3 * unit)) if size > 0 else 0.3 * unit
            room = (forward.low[i] - point.u[i], forward.high[i] - point.u[i])
            if step > room[1]:
                step = max(-step, room[0])
            moved = None
            for _ in range(3):
                u = point.u.copy()
                u[i] += step
                if (moved := forward(u)) is not None:
                    break
                turned = float(np.clip(-0.4 * step, *room))
                step = turned if turned else 0.4 * step
            if moved is None:
                columns.append(np.zeros_like(point.computed) if guess is None else guess[:, i])
            else:
                columns.append((moved - point.computed) / step)
        return np.stack(columns, axis=1)

    def _step(self, point: Point, damping: float) -> Array:
        """A damped step that ends inside the bounds."""
        forward = self.forward
        _, precision, pull = forward.prior(point.u)
        scaled = point.jacobian / self.S[:, None]
        H = point.jacobian.T @ scaled + np.diag(precision)
        b = scaled.T @ (self.data - point.computed) - pull
        H += np.diag(damping * np.diag(H) + 1e-9 / forward.units**2)
        fixed = np.zeros(len(b), bool)
        step = np.zeros(len(b))
        for _ in range(len(b) + 1):
            free = ~fixed
            if not free.any():
                break
            step[free] = np.linalg.solve(
                H[np.ix_(free, free)], b[free] - H[np.ix_(free, fixed)] @ step[fixed]
            )
            aim = point.u + step
            out = free & ((aim < forward.low) | (aim > forward.high))
            if not out.any():
                break
            step[out] = np.clip(aim, forward.low, forward.high)[out] - point.u[out]
            fixed |= out
        # the linearisation is not trusted far away
        reach = float(np.max(np.abs(step) / forward.units))
        return step * min(1.0, 8.0 / reach) if reach > 0 else step

    def descend(self, point: Point, iterations: int, gain: float = 0.02, damping: float = 1e-3) -> Point:
        """Damped steps with Broyden's updates until one gains less than `gain`."""
        for _ in range(iterations):
            step = self._step(point, damping)
            if float(np.max(np.abs(step) / self.forward.units)) < 1e-5:
                break
            u = point.u + step
            computed = self.forward(u)
            if computed is None:
                damping = max(10.0 * damping, 0.01)
                continue
            cost = self.cost(u, computed)
            linear = point.computed + point.jacobian @ step
            hoped = point.cost - self.cost(u, linear)
            if cost - point.cost > hoped:  # so far from linear that a secant would mislead
                damping = max(8.0 * damping, 1e-3)
                continue
            t = step / self.forward.units
            jacobian = point.jacobian + np.outer(computed - linear, t / self.forward.units) / float(t @ t)
            if cost < point.cost:
                small = point.cost - cost < gain
                point = Point(u, computed, jacobian, cost)
                damping *= 0.2
                if small:
                    break
            else:
                point = replace(point, jacobian=jacobian)
                if hoped < gain:
                    break
                damping = max(8.0 * damping, 1e-3)
                if damping > 1e4:
                    break
        return point

    def polish(self, point: Point, rounds: int = 3, iterations: int = 6) -> Point:
        """Fresh Jacobians and descents until one gains nothing."""
        for _ in range(rounds):
            before = point.cost
            point = replace(point, jacobian=self.differences(point, point.jacobian))
            point = self.descend(point, iterations, damping=1e-9)  # damping would stop it on a ridge
            if before - point.cost < 0.1:
                break
        return point


@dataclass(frozen=True, eq=False)
class Fit:
    """A hypothesis at its mode.

    `values` are in the parameters' own units; `computed` and `residual` are harmonics; `mean` and `sd` are
    those of the parameters' posterior, in search coordinates; `log_z` is the log marginal likelihood.
    """

    hypothesis: Hypothesis
    forward: Forward = field(repr=False)
    u: Array
    computed: Array = field(repr=False)
    jacobian: Array = field(repr=False)
    residual: Array = field(repr=False)
    errors: Mapping[str, Errors]
    allowances: Mapping[str, float]
    log_z: float
    mean: Array
    covariance: Array = field(repr=False)

    @property
    def values(self) -> Array:
        """Parameters at the mode."""
        return self.forward.values(self.u)

    @property
    def sd(self) -> Array:
        """Of the search coordinates."""
        return np.sqrt(np.diag(self.covariance))

    def amplitude(self, index: int = 0) -> tuple[float, float]:
        """Mean and sd of an amplitude of the effect asked about, within its bounds."""
        i = self.forward.asked + index
        p, m, s = self.forward.parameters[i], self.mean[i], self.sd[i]
        low, high = (p.low - m) / s, (p.high - m) / s
        if low > 6 or high < -6:  # beyond a bound: all mass stands there
            return (p.low if low > 6 else p.high), float(s / max(abs(low), abs(high)))
        mean, variance = truncnorm.stats(low, high, loc=m, scale=s)
        return float(mean), float(math.sqrt(variance))


def _silent(text: str, share: float) -> None:
    """Says nothing."""


class Screening:
    """All hypotheses about one study, one base and the effects that were added to it already.

    Parameters
    ----------
    study : Study
    base : str
        Name of a base or of a model, such as "linear-constant" or "B".
    added : sequence of (effect, place)
        Effects that every hypothesis has.
    effects : sequence of str, optional
        Of the catalogue; all that fit the base if absent.
    cores : int
        Threads that solve.
    conventions : Conventions, optional
        Instead of the study's own.
    tick : callable, optional
        Called with a text and the share done.
    """

    def __init__(
        self,
        study: Study,
        base: str = "linear-constant",
        *,
        added: Sequence[tuple[str, Place]] = (),
        effects: Sequence[str] | None = None,
        cores: int = 2,
        conventions: Conventions | None = None,
        tick: Callable[[str, float], None] | None = None,
    ) -> None:
        self.study, self.base = study, get_base(base)
        self.harmonics = Harmonics(study)
        self.data = self.harmonics(study.values)
        self.added = tuple(added)
        self.cores = cores
        self.conventions = conventions
        self.network = Network.from_study(study)
        self.tick = tick or _silent
        self.forwards: list[Forward] = []
        self._secants: dict[tuple[Hypothesis, bytes], Point] = {}
        names = [n for n in (effects or CATALOGUE) if CATALOGUE[n].apply is not None and self._offered(n)]
        self.hypotheses = {
            name: [Hypothesis((*self.added, (name, place))) for place in CATALOGUE[name].places(self.network)]
            for name in names
        }
        self.range = {
            q: float(max(np.ptp(study.values[i]) for i in rows)) for q, rows in self.harmonics.rows.items()
        }

    def _offered(self, name: str) -> bool:
        return name not in {n for n, p in self.added if p == Place()} and CATALOGUE[name].offered(
            self.base.name
        )

    def forward(self, hypothesis: Hypothesis) -> Forward:
        """Its waveforms."""
        forward = Forward(self.study, self.base, hypothesis, self.harmonics, conventions=self.conventions)
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

    # -- errors ----------------------------------------------------------------------------------

    def _length(self) -> float:
        return LENGTH_BEATS[0] * self.study.period_s

    def _noise(self, residual: Array, allowances: Mapping[str, float]) -> dict[str, Errors]:
        """Noise and allowance that fit a residual."""
        start = Errors(1.0, delta=0.0, length=self._length())
        return {
            q: fit_noise(
                self.harmonics,
                residual,
                q,
                start,
                free_delta=scale > 0,
                scale=scale,
            )
            for q, scale in allowances.items()
        }

    def numerics(self) -> dict[str, float]:
        """Allowance for the solver's own error, by quantity."""
        return {q: NUMERICS_PART * size for q, size in self.range.items()}

    def beside(self, noise: Mapping[str, Errors], allowances: Mapping[str, float]) -> Array:
        """Variances (n,) of that noise with an allowance, whatever discrepancy it was found beside."""
        at = {
            q: replace(e, delta=allowances[q], length=self._length(), shared=0.0, rough=False)
            for q, e in noise.items()
        }
        return self.harmonics.variances(at)

    def evidence(self, forward: Forward, point: Point, allowances: Mapping[str, float]) -> Fit:
        """Marginal likelihood around a point, in closed form; over the allowance on a grid."""
        residual = self.data - point.computed
        errors = self._noise(residual, allowances)
        log_prior, precision, pull = forward.prior(point.u)
        log_prior += sum(noise_log_prior(e, self.study.period_s) for e in errors.values())
        weights = np.exp(-0.5 * DELTA_GRID**2)
        weights /= weights.sum()
        terms, bests = [], []
        for factor, weight in zip(DELTA_GRID, weights, strict=True):
            at = {q: replace(e, delta=factor * allowances[q]) for q, e in errors.items()}
            log_z, step, C = marginal(residual, point.jacobian, self.harmonics.variances(at), precision, pull)
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

    # -- the base --------------------------------------------------------------------------------

    def fit_base(self) -> Fit:
        """The base (with what was added) at its mode, under noise alone."""
        self.tick("base", 0.0)
        forward = self.forward(Hypothesis(self.added))
        starts = [math.log(p.start) if p.log else p.start for p in self.base.parameters]
        for name, _ in self.added:
            starts += [a.starts[0] if a.zero_is_base else a.centre for a in CATALOGUE[name].amplitudes]
        # loose errors first: far from the mode a tenth of the range is what the linearisation is good for
        S = self.harmonics.variances({q: Errors(0.1 * size) for q, size in self.range.items()})
        search = Search(forward, self.data, S)
        point = search.polish(search.descend(search.at(np.array(starts)), 10, 1e-3), 4)
        for _ in range(3):
            errors = self._noise(self.data - point.computed, self.numerics())
            search = Search(forward, self.data, self.harmonics.variances(errors))
            point = replace(point, cost=search.cost(point.u, point.computed))
            before = point.cost
            point = search.polish(point, 2)
            if before - point.cost < 0.1:
                break
        return self.evidence(forward, point, self.numerics())

    def refit_base(self, base: Fit, noise: Mapping[str, Errors]) -> Fit:
        """The base's best fit beside the noise that a free discrepancy leaves: its residual is the gap."""
        search = Search(base.forward, self.data, self.beside(noise, self.numerics()))
        return self.evidence(
            base.forward, search.polish(search.descend(search.resume(base), 8), 2), self.numerics()
        )

    def fit_free(self, base: Fit, name: str) -> Fit:
        """The base with a free discrepancy: smooth and shared by the series, or noise of its own in each."""
        T = self.study.period_s
        alone = all(len(rows) == 1 for rows in self.harmonics.rows.values())
        shared = np.zeros(1) if alone or name == CORRELATED else SHARED_GRID
        # a discrepancy with a physical cause is smooth; noise may be either
        kinds = (False, True) if name == CORRELATED else (False,)
        scales = {q: SIZE_PART * size for q, size in self.range.items()}
        # what is wrong with the sensors of one quantity does not show in the other
        quantities = tuple(self.harmonics.quantities)
        wheres = [quantities, *([(q,) for q in quantities] if len(quantities) > 1 else [])]
        noise = {q: replace(e, delta=0.0, rough=False) for q, e in base.errors.items()}
        point = Point(base.u, base.computed, base.jacobian)
        found: Fit | None = None
        for round_ in range(3):
            residual = self.data - point.computed
            log_prior, precision, pull = base.forward.prior(point.u)
            best, terms, best_at = -math.inf, [], noise
            for length, size, rho, rough, where in product(LENGTH_GRID * T, SIZE_GRID, shared, kinds, wheres):
                at = {
                    q: replace(
                        e,
                        delta=size * scales[q] if q in where else 0.0,
                        length=length,
                        shared=float(rho),
                        rough=rough,
                    )
                    for q, e in noise.items()
                }
                log_z, step, C = marginal(
                    residual, point.jacobian, self.harmonics.variances(at), precision, pull
                )
                # weights of the grid: log-spaced sizes of a half-normal, a log-normal length
                log_z += base.forward.log_mass(point.u + step, C)
                log_w = math.log(size) - 0.5 * size**2 + length_log_prior(length, T)
                terms.append((log_w, log_z))
                if log_w + log_z > best:
                    best, best_at, best_step, best_C = log_w + log_z, at, step, C
            weights = np.array([w for w, _ in terms])
            weights -= logsumexp(weights)
            log_z = float(logsumexp(weights + np.array([z for _, z in terms])))
            # where the data say little, the linearised mode may lie far outside the bounds
            best_step = np.clip(point.u + best_step, base.forward.low, base.forward.high) - point.u
            # the noise beside this discrepancy
            part = residual - point.jacobian @ best_step
            refit = {q: fit_noise(self.harmonics, part, q, best_at[q]) for q in self.harmonics.quantities}
            noise = {q: replace(e, delta=0.0) for q, e in refit.items()}
            log_noise = sum(noise_log_prior(e, T) for e in noise.values())
            found = Fit(
                Hypothesis(self.added), base.forward, point.u, point.computed, point.jacobian, residual,
                {q: replace(best_at[q], sigma=e.sigma, ratio=e.ratio, tau=e.tau) for q, e in refit.items()},
                {q: best_at[q].delta for q in best_at}, log_z + log_prior + log_noise,
                point.u + best_step, best_C,
            )  # fmt: skip
            if round_ == 2:
                break
            search = Search(base.forward, self.data, self.harmonics.variances(found.errors))
            point.cost = search.cost(point.u, point.computed)
            point = search.descend(point, 4)
        assert found is not None
        return found

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
        search = Search(forward, self.data, S)
        amplitudes = CATALOGUE[hypothesis.name].amplitudes
        best: Point | None = None
        starts = list(amplitudes[0].starts)
        if min(starts) < 0.0 < max(starts):  # the linearisation says which side to look at
            try:
                aim = self._aim(search, self._secant(search, base, self._start(amplitudes, starts[0])))[1]
                starts = [x for x in starts if (x > 0.0) == (aim > 0.0)]
            except SearchError:
                pass
        for first in starts:
            try:
                point = search.descend(self._secant(search, base, self._start(amplitudes, first)), 12)
            except SearchError:
                continue
            best = point if best is None or point.cost < best.cost else best
        if best is None:
            return None
        return self.evidence(forward, best, allowances)

    def settle(
        self, fit: Fit, base: Fit, noise: Mapping[str, Errors], allowances: Mapping[str, float]
    ) -> Fit:
        """A fit searched again beside the noise alone, from all starts and several shapes.

        With the full allowance, what is smooth costs so little that a lesser mode may look as good, and that
        the mode stands where something is left to explain.
        """
        search = Search(fit.forward, self.data, self.beside(noise, self.numerics()))
        best = search.resume(fit)
        amplitudes = CATALOGUE[fit.hypothesis.name].amplitudes
        shapes = [
            [float(np.clip(a.centre + move * a.scale, a.low, a.high)) for a in amplitudes[1:]]
            for move in ((0.0, -0.7, 1.5) if len(amplitudes) > 1 else (0.0,))
        ]
        for first, shape in product(amplitudes[0].starts, shapes):
            try:
                point = search.descend(self._secant(search, base, np.array([first, *shape])), 15)
            except SearchError:
                continue
            if point.cost < best.cost:
                best = point
        found = self.evidence(fit.forward, search.polish(best, 6, 15), allowances)
        for _ in range(3):  # a free discrepancy leaves other noise than a cause
            search = Search(fit.forward, self.data, self.beside(found.errors, self.numerics()))
            best = search.resume(found)
            before = best.cost
            best = search.polish(best, 6, 15)
            found = self.evidence(fit.forward, best, allowances)
            if before - best.cost < 0.1:
                break
        # both linearise one posterior, and what lies off the mode may promise more than is there
        return replace(found, log_z=max(found.log_z, fit.log_z))

    @staticmethod
    def _start(amplitudes: Sequence[Amplitude], first: float) -> Array:
        return np.array([first, *(a.centre for a in amplitudes[1:])])

    def _secant(self, search: Search, base: Fit, start: Array) -> Point:
        """A start with the base's own Jacobian, and secants from the base for the effect's; solved once."""
        key = (search.forward.hypothesis, start.tobytes())
        if key in self._secants:
            known = self._secants[key]
            return replace(known, cost=search.cost(known.u, known.computed))
        u = np.concatenate([base.u, start])
        computed = search.forward(u)
        if computed is None:
            u = np.concatenate([base.u, 0.3 * start])
            computed = search.forward(u)
        if computed is None:
            raise SearchError(search.forward.last_failure)
        n = len(base.u)
        jacobian = np.zeros((len(computed), len(u)))
        jacobian[:, :n] = base.jacobian
        jacobian[:, n] = (computed - base.computed) / u[n]
        point = Point(u, computed, jacobian, search.cost(u, computed))
        for i in range(n + 1, len(u)):  # a shape parameter has no signature at amplitude 0
            moved = u.copy()
            step = 0.3 * search.forward.units[i]
            moved[i] += step if u[i] + step <= search.forward.high[i] else -step
            other = search.forward(moved)
            if other is not None:
                jacobian[:, i] = (other - computed) / (moved[i] - u[i])
        self._secants[key] = point
        return point

    def _aim(self, search: Search, point: Point) -> tuple[float, float]:
        """Evidence of the linearised model, and where its mode has the first amplitude."""
        _, precision, pull = search.forward.prior(point.u)
        log_z, step, _ = marginal(self.data - point.computed, point.jacobian, search.S, precision, pull)
        n = search.forward.asked
        return log_z, float(point.u[n] + step[n])

    def _promising(
        self, hypotheses: Sequence[Hypothesis], base: Fit, S: Array, pool: Any
    ) -> list[Hypothesis]:
        """The places of an effect that are worth a search: the best by the linearised evidence."""
        if len(hypotheses) <= SEARCHED_PLACES:
            return list(hypotheses)
        amplitudes = CATALOGUE[hypotheses[0].name].amplitudes

        def linear(h: Hypothesis) -> float:
            search = Search(self.forward(h), self.data, S)
            try:
                start = self._start(amplitudes, amplitudes[0].starts[0])
                return self._aim(search, self._secant(search, base, start))[0]
            except SearchError:
                return -math.inf

        ranked = sorted(zip(pool.map(linear, hypotheses), range(len(hypotheses)), strict=True), reverse=True)
        return [hypotheses[i] for _, i in ranked[:SEARCHED_PLACES]]

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
        base = self.fit_base()
        unlisted = self.fit_free(base, UNLISTED)
        correlated = self.fit_free(base, CORRELATED)
        noise = max((unlisted, correlated), key=lambda f: f.log_z).errors
        base = self.refit_base(base, noise)
        gap = {q: self.gap_size(base, noise, q) for q in self.harmonics.quantities}
        allowances = {q: math.hypot(ALLOWANCE * gap[q], own) for q, own in self.numerics().items()}
        S = self.beside(noise, allowances)
        odds = base.log_z - max(unlisted.log_z, correlated.log_z) + math.log(PRIOR_NO_GAP / PRIOR_UNLISTED)
        if stop_at_noise and odds > 0.0:
            self.hypotheses = {}
        fits: dict[Hypothesis, Fit] = {}

        def one(h: Hypothesis) -> tuple[Hypothesis, Fit | None]:
            return h, self.fit_effect(h, base, S, allowances)

        def again(h: Hypothesis) -> tuple[Hypothesis, Fit]:
            fit = fits[h]
            search = Search(fit.forward, self.data, S)
            return h, self.evidence(fit.forward, search.polish(search.resume(fit)), allowances)

        def settled(h: Hypothesis) -> tuple[Hypothesis, Fit]:
            return h, self.settle(fits[h], base, noise, allowances)

        with ThreadPoolExecutor(max(1, self.cores)) as pool:
            jobs = []
            for done, places in enumerate(self.hypotheses.values(), 1):
                self.tick(places[0].name, 0.2 * done / len(self.hypotheses))
                jobs += self._promising(places, base, S, pool)
            for done, (h, fit) in enumerate(pool.map(one, jobs), 1):
                self.tick(h.name, 0.2 + 0.5 * done / len(jobs))
                if fit is not None:
                    fits[h] = fit
            leading = []
            for places in self.hypotheses.values():
                ranked = sorted((h for h in places if h in fits), key=lambda h: -fits[h].log_z)
                leading += ranked[:2]
            for done, (h, fit) in enumerate(pool.map(again, leading), 1):
                self.tick(h.name, 0.7 + 0.25 * done / len(leading))
                fits[h] = fit
            ranked = sorted(fits, key=lambda h: -fits[h].log_z)
            shaped = {h.name: h for h in reversed(ranked) if len(CATALOGUE[h.name].amplitudes) > 1}
            again_from_all = list(dict.fromkeys([*ranked[:SETTLED], *shaped.values()]))
            for done, (h, fit) in enumerate(pool.map(settled, again_from_all), 1):
                self.tick(h.name, 0.95 + 0.05 * done / len(again_from_all))
                fits[h] = fit
        # the best explanation of all leaves the noise: a free discrepancy takes some of it along
        best = max((unlisted, correlated, *fits.values()), key=lambda f: f.log_z)
        # beside its noise the base has its best fit too: the gap is what that leaves
        refitted = self.refit_base(base, best.errors)
        base = replace(refitted, log_z=max(base.log_z, refitted.log_z))
        possible = self.possible_noise(best)
        return Screened(self, base, unlisted, correlated, fits, best.errors, possible, gap, allowances)

    # -- what a fit leaves -------------------------------------------------------------------------

    def gap_size(self, fit: Fit, noise: Mapping[str, Errors], quantity: str) -> float:
        """Rms of truth minus fit, in the quantity's unit."""
        known = {q: [(0.0, e)] for q, e in noise.items()}
        left = self.unexplained(fit, known, np.random.default_rng(0), 50)
        return math.sqrt(float(np.mean(self.harmonics.part(left.draws, quantity) ** 2)))

    def possible_noise(self, fit: Fit) -> dict[str, list[tuple[float, Errors]]]:
        """Log-priors and values of the noise on a grid of the correlated noise's size and time.

        The white noise's sd, which the high harmonics determine, is fitted at each point.

        Parameters
        ----------
        fit : Fit
            Whose residual, beside its own discrepancy, is noise.

        Returns
        -------
        dict of quantity to list of (log-prior, Errors)
            Without discrepancy; the most probable first.
        """
        T = self.study.period_s
        median, spread, top = MEMORY_BEATS
        left = fit.residual - fit.jacobian @ (fit.mean - fit.u)
        found: dict[str, list[tuple[float, Errors]]] = {}
        for q, errors in fit.errors.items():
            power = self.harmonics.part(left, q) ** 2
            own = self.harmonics.spectrum(errors, len(power), noise=False)
            ranked: list[tuple[float, float, Errors]] = []
            for ratio, move in product(RATIO_GRID, MEMORY_GRID):
                tau = min(median * math.exp(move * spread), top) * T
                e = replace(errors, sigma=1.0, ratio=float(ratio), tau=tau, delta=0.0)
                unit = self.harmonics.spectrum(e, len(power))

                def cost(x: float, power: Array = power, unit: Array = unit, own: Array = own) -> float:
                    S = math.exp(2.0 * x) * unit + own
                    return 0.5 * float(np.sum(power / S + np.log(S)))

                centre = math.log(errors.sigma)
                best = minimize_scalar(cost, bounds=(centre - 1.0, centre + 0.5), method="bounded")
                log_prior = noise_log_prior(e, T)
                ranked.append((log_prior - best.fun, log_prior, replace(e, sigma=math.exp(best.x))))
            ranked.sort(key=lambda x: -x[0])
            found[q] = [(log_prior, e) for _, log_prior, e in ranked]
        return found

    def unexplained(
        self,
        fit: Fit,
        noise: Mapping[str, Sequence[tuple[float, Errors]]],
        rng: np.random.Generator,
        n_draws: int,
    ) -> Unexplained:
        """Posterior of truth minus fit: r = J d + s + e, of which J d + s is asked.

        d is the error of the fitted parameters, s a smooth discrepancy (none, by an even chance), e noise.
        Given the noise, and the size and length of s, all are normal, within the bounds of d.

        Parameters
        ----------
        fit : Fit
        noise : mapping of quantity to sequence of (log-prior, Errors)
            As of `possible_noise`; of the errors only the noise counts.
        rng : Generator
        n_draws : int

        Returns
        -------
        Unexplained
        """
        H, T = self.harmonics, self.study.period_s
        _, precision, pull = fit.forward.prior(fit.u)
        shape = (len(self.study.series), H.n)
        # no size is preferred: the grid is even in its logarithm
        kinds = [(math.log(0.5), 0.0, LENGTH_BEATS[0] * T)]
        lengths = np.array([length_log_prior(length, T) for length in LENGTH_GRID * T])
        lengths += math.log(0.5 / len(SIZE_GRID)) - logsumexp(lengths)
        for length, log_w in zip(LENGTH_GRID * T, lengths, strict=True):
            kinds += [(float(log_w), float(size), float(length)) for size in SIZE_GRID]
        own = np.zeros((len(kinds), *shape))
        for q, rows in H.rows.items():
            for i, (_, size, length) in enumerate(kinds):
                e = Errors(0.0, delta=size * SIZE_PART * self.range[q], length=length)
                own[i, rows] = H.spectrum(e, len(rows), noise=False)
        options = {
            q: np.array([H.spectrum(replace(e, delta=0.0), len(H.rows[q])) for _, e in choices])
            for q, choices in noise.items()
        }
        likely = np.empty(shape)
        for q, rows in H.rows.items():
            likely[rows] = options[q][0]
        # the noise of one quantity and the kind of discrepancy together, the others' noise the likeliest
        tables = {}
        for q, rows in H.rows.items():
            S = np.repeat((likely + own)[:, None], len(options[q]), axis=1)
            S[:, :, rows] = own[:, None, rows] + options[q]
            log_z, step, C = marginal(
                fit.residual, fit.jacobian, S.reshape(*S.shape[:2], H.size), precision, pull
            )
            # where a large discrepancy leaves the data no say, most parameters lie outside their bounds
            log_z += fit.forward.log_mass(fit.u + step, C)
            log_w = np.array([w for w, _, _ in kinds])[:, None] + np.array([w for w, _ in noise[q]])
            tables[q] = np.exp(log_w + log_z - logsumexp(log_w + log_z))
        first, *rest = tables
        joint = rng.choice(tables[first].size, n_draws, p=tables[first].ravel())
        chosen, picked = np.divmod(joint, tables[first].shape[1])
        together: dict[tuple[int, ...], list[int]] = {}  # draws of one linear model are made at once
        for i, (kind, option) in enumerate(zip(chosen, picked, strict=True)):
            others = [rng.choice(tables[q].shape[1], p=tables[q][kind] / tables[q][kind].sum()) for q in rest]
            together.setdefault((int(kind), int(option), *others), []).append(i)
        mean, draws, lasting = np.zeros(H.size), np.empty((n_draws, H.size)), np.empty((n_draws, H.size))
        scaled = fit.jacobian / likely.reshape(H.size, 1)
        absorbed = np.linalg.solve(fit.jacobian.T @ scaled + np.diag(precision), scaled.T)
        low, high = fit.forward.low - fit.u, fit.forward.high - fit.u
        for (kind, *which), members in together.items():
            smooth = own[kind].reshape(H.size)
            total = own[kind].copy()
            for q, option in zip(tables, which, strict=True):
                total[H.rows[q]] += options[q][option]
            total = total.reshape(H.size)
            _, step, C = marginal(fit.residual, fit.jacobian, total, precision, pull)
            d = step + rng.standard_normal((len(members), TRIES, len(step))) @ np.linalg.cholesky(C).T
            inside = np.all((d >= low) & (d <= high), axis=2)
            d = d[np.arange(len(members)), np.argmax(inside, axis=1)]
            if not (kept := inside.any(axis=1)).all():
                d[~kept] = _truncated(d[~kept], step, C, low, high, rng)
            moved = d @ fit.jacobian.T
            gain = smooth / total
            left = np.sqrt(smooth * (1.0 - gain)) * rng.standard_normal(moved.shape)
            smooth_draws = gain * (fit.residual - moved) + left
            draws[members] = moved + smooth_draws
            lasting[members] = smooth_draws - smooth_draws @ absorbed.T @ fit.jacobian.T
            mean += np.sum(moved + gain * (fit.residual - moved), axis=0) / n_draws
        return Unexplained(mean, draws, lasting)


def _truncated(
    x: Array, mean: Array, covariance: Array, low: Array, high: Array, rng: np.random.Generator
) -> Array:
    """Draws (n, d) of a normal distribution within bounds, by Gibbs' sampler from the points x (n, d)."""
    precision = np.linalg.inv(covariance)
    x = np.clip(x, low, high)
    for i in SWEEPS * list(range(len(mean))):
        sd = 1.0 / math.sqrt(precision[i, i])
        centre = x[:, i] - sd**2 * ((x - mean) @ precision[i])
        a, b = (low[i] - centre) / sd, (high[i] - centre) / sd
        log_a, log_b = _log_tails(a, b)
        u = rng.uniform(size=len(x))
        z = np.where(a > 0, -1.0, 1.0) * ndtri_exp(log_b + np.log(u + (1.0 - u) * np.exp(log_a - log_b)))
        x[:, i] = np.clip(centre + sd * z, low[i], high[i])
    return x


@dataclass(frozen=True, eq=False)
class Unexplained:
    """Posterior of truth minus fit, as harmonics: its mean (n,), and draws (n_draws, n).

    `lasting` is what is left of the draws where the parameters are fitted to data without noise: a
    fit's own error is no part of it, and it is zero where there is no discrepancy.
    """

    mean: Array
    draws: Array
    lasting: Array


@dataclass(frozen=True, eq=False)
class Screened:
    """What a screening found."""

    screening: Screening
    base: Fit
    unlisted: Fit
    correlated: Fit
    fits: Mapping[Hypothesis, Fit]
    noise: Mapping[str, Errors]
    possible_noise: Mapping[str, Sequence[tuple[float, Errors]]]
    gap: Mapping[str, float]
    allowances: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Scored:
    """A screening's hypotheses with their probabilities, best first."""

    screened: Screened
    names: tuple[str, ...]
    log_z: Mapping[str, float]
    probability: Mapping[str, float]
    best: Mapping[str, Fit]
    places: Mapping[str, list[tuple[Place, float]]]
    group: Mapping[str, int]
    invisible: tuple[str, ...]
    failed: tuple[str, ...]

    @property
    def leader(self) -> str:
        """The most probable explanation."""
        return self.names[0]

    def members(self, name: str) -> list[str]:
        """What this study cannot tell from it, itself included, most probable first."""
        return [n for n in self.names if self.group[n] == self.group[name]]


def _projected(fit: Fit, signature: Array, S: Array, n_columns: int | None = None) -> float:
    """Half the squared size, in units of the noise, of what parameters cannot absorb of a signature.

    These are all but the amplitudes of the effect asked about, or the first `n_columns`.
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
    """Explanations that this study cannot tell apart have one number; the most probable gives it."""
    group: dict[str, int] = {}
    leaders: list[str] = []
    free = (UNLISTED, CORRELATED)
    for name in names:
        own = best[name].computed
        moved = name in free or 0.5 * float(np.sum((own - screened.base.computed) ** 2 / S)) > VISIBLE
        for other in leaders if moved and name not in invisible else []:
            if (name in free) != (other in free) or other in invisible or other == NO_GAP:
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


def score(screened: Screened) -> Scored:
    """Probabilities, groups and what the study cannot show."""
    screening = screened.screening
    S = screening.beside(screened.noise, screening.numerics())
    log_z = {
        NO_GAP: screened.base.log_z,
        UNLISTED: screened.unlisted.log_z,
        CORRELATED: screened.correlated.log_z,
    }
    best = {NO_GAP: screened.base, UNLISTED: screened.unlisted, CORRELATED: screened.correlated}
    places: dict[str, list[tuple[Place, float]]] = {}
    invisible, failed = [], []
    for name, hypotheses in screening.hypotheses.items():
        fits = {h: screened.fits[h] for h in hypotheses if h in screened.fits}
        if not fits:
            failed.append(name)
            continue
        total = np.array([f.log_z for f in fits.values()])
        log_z[name] = float(logsumexp(total)) - math.log(len(hypotheses))
        leader = max(fits.values(), key=lambda f: f.log_z)
        best[name] = leader
        weight = np.exp(total - logsumexp(total))
        places[name] = sorted(
            ((h.place, float(w)) for h, w in zip(fits, weight, strict=True)), key=lambda x: -x[1]
        )
        amplitude = CATALOGUE[name].amplitudes[0]
        shown = 0.0
        for fit in fits.values():
            reach = min(2.0 * amplitude.scale, max(abs(amplitude.high), abs(amplitude.low)))
            shown = max(shown, _projected(fit, fit.jacobian[:, fit.forward.asked] * reach, S))
            if fit.hypothesis.name in CATALOGUE and fit.log_z - screened.base.log_z > VISIBLE:
                shown = math.inf
        if shown < VISIBLE:
            invisible.append(name)
    visible = [n for n in log_z if n not in invisible]
    listed = [n for n in visible if n not in (NO_GAP, UNLISTED)]
    prior = {NO_GAP: PRIOR_NO_GAP, UNLISTED: PRIOR_UNLISTED}
    prior |= {n: (1.0 - PRIOR_NO_GAP - PRIOR_UNLISTED) / max(1, len(listed)) for n in listed}
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
        places,
        group,
        tuple(sorted(invisible)),
        tuple(sorted(failed)),
    )
