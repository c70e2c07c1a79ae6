"""A model that draws its own data and is fitted to them: one replicate of a calibration after the other."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.blood.study import Study
from zoo.core.inference.logposterior import LogPosterior, model_name
from zoo.core.inference.mode import Mode
from zoo.core.inference.newton import newton
from zoo.core.inference.record import RunRecord
from zoo.core.inference.sampling import DEMETROPOLISZ
from zoo.core.inference.spaces import Archive
from zoo.core.inference.starts import Start, disperse
from zoo.core.inference.steps import DEMetropolisZ
from zoo.core.inference.surrogate import sample_surrogate
from zoo.core.posterior.ranks import LOG_POSTERIOR, CalibrationError, Replicate
from zoo.core.surrogate.waveform import SurrogateError

if TYPE_CHECKING:
    import pymc as pm

Array = NDArray[np.float64]
Builder = Callable[[Study], Any]

METHODS = ("exact", "surrogate")
MAX_TRIES = 1000
BLOCK = 8192


@dataclass(frozen=True)
class Settings:
    """How each posterior is sampled.

    Parameters
    ----------
    ranked : int
        L, draws that the truth is ranked among: evenly spaced over all chains.
    chains : int
    tune : int
        Steps of each chain that are thrown away.
    steps : int
        Steps of each chain that count; more are made until every bulk effective sample size is at least
        `min_ess`.
    max_steps : int
        Limit of that.
    min_ess : float
        Twice `ranked` or more makes the ranked draws nearly independent.
    method : {"exact", "surrogate"}
        Chains of the forward model itself, or as `zoo.core.inference.surrogate.sample_surrogate` does: chains
        on a surrogate, each draw corrected with the forward model. Then `steps` are stored draws, and `tune`
        is not asked.
    """

    ranked: int = 79
    chains: int = 2
    tune: int = 400
    steps: int = 800
    max_steps: int = 12_800
    min_ess: float = 160.0
    method: str = "exact"

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise CalibrationError(f"method = {self.method!r}: must be one of {', '.join(METHODS)}")
        least = {"ranked": 1, "chains": 1, "tune": 0, "steps": 8, "max_steps": self.steps, "min_ess": 0}
        for name, limit in least.items():
            if getattr(self, name) < limit:
                raise CalibrationError(f"{name} = {getattr(self, name)}: must be at least {limit}")
        if self.ranked > self.chains * self.steps:
            raise CalibrationError(
                f"ranked = {self.ranked}: more than the {self.chains} x {self.steps} steps; raise steps"
            )


class Simulated(NamedTuple):
    """Parameters from the prior, data from the model at them, and how often both were drawn in vain."""

    values: dict[str, Array]
    data: Array
    redrawn: dict[str, int]


class Fit(NamedTuple):
    """Posterior draws of a replicate, unconstrained (n_chains, n_steps, n_dim), and what they cost.

    `correction` and `k_hat` are those of a surrogate's draws, `accepted` its share of effective ones.
    """

    draws: Array
    log_posterior: Array
    ess: dict[str, float]
    rhat: float
    accepted: float
    correction: str = ""
    k_hat: float | None = None


class Replicator:
    """A model compiled once, that draws its own data and is fitted to any.

    Parameters
    ----------
    builder : callable
        ``builder(study) -> pm.Model``, such as `zoo.models.get_model("A")`; settings of the solver through
        `functools.partial`.
    study : Study
        Network, inflow, times and places of the observations; the observed values are not used, save by
        nominal Windkessels that are derived from them.
    limits : mapping of name to (lower, upper), optional
        Restrict the prior of scalar parameters to a range, in what is drawn and in the posterior alike.
    truth : callable, optional
        Builder of the model that parameters and data are drawn from, if it is not the one that is fitted:
        a control that must fail. It needs the same free parameters.

    Raises
    ------
    CalibrationError
        If the model that data are drawn from has no record, or `limits` names no scalar parameter.
    """

    def __init__(
        self,
        builder: Builder,
        study: Study,
        *,
        limits: Mapping[str, tuple[float, float]] | None = None,
        truth: Builder | None = None,
    ) -> None:
        import pytensor

        self.limits, self.study, self._builder = dict(limits or {}), study, builder
        self.model = self._restricted(builder(study))
        source = self.model if truth is None else self._restricted(truth(study))
        self._compile_source(source)
        self._data = pytensor.shared(np.array(study.values), name="y_data")
        self._observe(self.model)
        self.logp = LogPosterior(self.model)
        self._compile_transforms()
        self._steps: list[_Step] = []

    def _restricted(self, model: pm.Model) -> pm.Model:
        import pymc as pm
        import pytensor.tensor as pt
        from pytensor.graph.traversal import ancestors

        if len(model.observed_RVs) != 1:
            raise CalibrationError(
                f"model {model_name(model)}: {len(model.observed_RVs)} observed variables, must be one"
            )
        scalars = {rv.name: rv for rv in model.free_RVs if rv.ndim == 0}
        with model:
            for name, (lower, upper) in self.limits.items():
                if name not in scalars:
                    raise CalibrationError(
                        f"limits: {name!r} is no scalar parameter; it has {', '.join(scalars)}"
                    )
                if set(ancestors([scalars[name]])) & (set(model.free_RVs) - {scalars[name]}):
                    raise CalibrationError(f"limits: the prior of {name!r} depends on others; limit those")
                inside = pt.and_(pt.ge(scalars[name], lower), pt.le(scalars[name], upper))
                pm.Potential(f"limits_{name}", pt.switch(inside, 0.0, -np.inf))
        return model

    def _compile_source(self, source: pm.Model) -> None:
        from pymc.pytensorf import compile as compile_function
        from pymc.pytensorf import find_rng_nodes

        names = [rv.name for rv in source.free_RVs]
        mine = [rv.name for rv in self.model.free_RVs]
        if names != mine:
            raise CalibrationError(f"truth: its parameters are {', '.join(names)}, not {', '.join(mine)}")
        if getattr(source, "zoo", None) is None:
            raise CalibrationError(
                f"model {model_name(source)}: has no record; make it with zoo.core.model.bayesian_model"
            )
        y = source.observed_RVs[0]
        self._bounded = [rv for rv in source.free_RVs if rv.name in self.limits]
        self._others = [rv for rv in source.free_RVs if rv.name not in self.limits]
        many = [rv.owner.op(*rv.owner.op.dist_params(rv.owner), size=(BLOCK,)) for rv in self._bounded]
        slow = {"mode": "FAST_COMPILE", "on_unused_input": "ignore"}
        self._draw_bounded = compile_function([], many, **slow)
        self._draw_others = compile_function(self._bounded, self._others, **slow)
        self._draw_data = compile_function(source.free_RVs, [y, source.zoo.ok], **slow)
        self._rngs = find_rng_nodes([*many, *source.free_RVs, y])

    def _prior(self) -> dict[str, Array]:
        """Draw of the free parameters, those with limits within them."""
        bounded: list[Array] = []
        if self._bounded:
            with np.errstate(divide="ignore", over="ignore"):
                blocks = self._draw_bounded()
            for rv, block in zip(self._bounded, blocks, strict=True):
                low, high = self.limits[rv.name]
                inside = block[(block >= low) & (block <= high)]
                if not len(inside):
                    raise CalibrationError(
                        f"limits of {rv.name!r}: none of {BLOCK} draws of the prior in ({low}, {high}); widen"
                    )
                bounded.append(inside[0])
        others = self._draw_others(*bounded)
        found = dict(zip((rv.name for rv in self._others), others, strict=True))
        found |= dict(zip((rv.name for rv in self._bounded), bounded, strict=True))
        return {rv.name: np.array(found[rv.name]) for rv in self.model.free_RVs}

    def _observe(self, model: pm.Model) -> None:
        """Put a shared variable in the place of the observed values, so that new data need no compilation."""
        y = model.observed_RVs[0]
        del model.values_to_rvs[model.rvs_to_values[y]]
        model.rvs_to_values[y] = self._data
        model.values_to_rvs[self._data] = y

    def _compile_transforms(self) -> None:
        import pytensor

        rvs = self.model.free_RVs
        graphs = []
        for rv in rvs:
            transform = self.model.rvs_to_transforms[rv]
            graphs.append(rv if transform is None else transform.forward(rv, *rv.owner.inputs))
        self._forward = pytensor.function(rvs, graphs, mode="FAST_COMPILE", on_unused_input="ignore")
        values = {v.name: v for v in self.model.unobserved_value_vars}
        self._backward = self.model.compile_fn([values[rv.name] for rv in rvs], on_unused_input="ignore")

    @property
    def names(self) -> list[str]:
        """Scalars that are ranked: the parameters, elements of vectors as name[i], and the log-posterior."""
        found = []
        for rv in self.model.free_RVs:
            shape = tuple(np.shape(self.logp.initial[self.model.rvs_to_values[rv].name]))
            found += [rv.name + "".join(f"[{i}]" for i in index) for index in np.ndindex(shape)]
        return [*found, LOG_POSTERIOR]

    def vector(self, values: Mapping[str, ArrayLike]) -> Array:
        """Free parameters in their own units -> unconstrained vector (n_dim,)."""
        given = [np.asarray(values[rv.name], dtype=float) for rv in self.model.free_RVs]
        point = zip((v.name for v in self.logp.variables), self._forward(*given), strict=True)
        return self.logp.vector(dict(point))

    def values(self, q: ArrayLike) -> Array:
        """Unconstrained vector (n_dim,) -> parameters in their own units, (n_dim,), as in `names`."""
        point = self.logp.point(np.asarray(q, dtype=float))
        return np.concatenate([np.ravel(value) for value in self._backward(point)])

    def observe(self, data: ArrayLike) -> None:
        """Set the data (n_series, n_times), in the units of the series."""
        data = np.array(data, dtype=float)
        if data.shape != self._data.get_value(borrow=True).shape:
            raise CalibrationError(
                f"data of shape {data.shape}: must be {self._data.get_value(borrow=True).shape}"
            )
        self._data.set_value(data)

    def simulate(
        self, seed: np.random.SeedSequence, values: Mapping[str, ArrayLike] | None = None
    ) -> Simulated:
        """Draw parameters from the prior and data at them.

        Parameters whose solve fails are drawn again. The posterior is zero there too, as it is outside the
        limits, so prior and posterior are conditioned alike and ranks stay uniform.

        Parameters
        ----------
        seed : numpy.random.SeedSequence
        values : mapping, optional
            Free parameters in their own units, instead of the prior.

        Raises
        ------
        CalibrationError
            If no data can be drawn.
        """
        from pymc.pytensorf import reseed_rngs

        reseed_rngs(self._rngs, int(seed.generate_state(1, np.uint64)[0]))
        redrawn: Counter[str] = Counter()
        for _ in range(MAX_TRIES if values is None else 1):
            drawn = self._prior() if values is None else {n: np.asarray(v, float) for n, v in values.items()}
            data, ok = self._draw_data(*(drawn[rv.name] for rv in self.model.free_RVs))
            if ok and np.all(np.isfinite(data)):
                return Simulated(drawn, np.array(data), dict(redrawn))
            redrawn["errors not finite" if ok else "failed solve"] += 1
        raise CalibrationError(
            f"model {model_name(self.model)}: no data at any of the {redrawn.total()} parameters tried "
            f"({dict(redrawn)}); give others, or set limits"
        )

    def fit(self, start: Mapping[str, ArrayLike], seed: int, settings: Settings | None = None) -> Fit:
        """Sample the posterior of the present data as `zoo.sample` does, its mode searched from `start`.

        Newton steps find the mode, chains start from a t distribution twice as wide as the Gaussian there,
        and `zoo.core.inference.steps.DEMetropolisZ` makes the steps, with the options that `zoo.sample` gives
        it.
        """
        settings = settings or Settings()
        before = self.logp.evaluations
        q = self.vector(start)
        value = self.logp(q)
        if not np.isfinite(value):
            raise CalibrationError("start: the log-posterior is not finite there; start elsewhere")
        q, value, covariance, _ = newton(self.logp, q, value, passes=8)
        mode = Mode(q, {}, value, covariance, self.logp.evaluations - before)
        beginning = disperse(self.logp, mode, settings.chains, seed)
        chains = []
        for chain in range(settings.chains):
            if chain == len(self._steps):
                self._steps.append(_Step(model=self.model, **DEMETROPOLISZ))
            step = self._steps[chain]
            step.begin_again(beginning)
            step.set_rng(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(chain, 1))))
            chains.append(_Chain(step, self.logp, beginning.starts[chain], settings.tune))
        names, steps = self.names, settings.steps
        while True:
            for one in chains:
                one.run(steps)
            draws = np.array([c.draws for c in chains])
            log_posterior = np.array([c.log_posterior for c in chains])
            ess, rhat = _diagnose(draws, log_posterior, names)
            if min(ess.values()) >= settings.min_ess or steps >= settings.max_steps:
                break
            factor = 1.1 * settings.min_ess / max(1.0, min(ess.values()))
            steps = min(int(steps * np.clip(factor, 1.25, 2.0)), settings.max_steps)
        accepted = float(np.mean([c.accepted / (settings.tune + steps) for c in chains]))
        return Fit(draws, log_posterior, ess, rhat, accepted)

    def fit_on_surrogate(
        self, start: Mapping[str, ArrayLike], seed: int, settings: Settings | None = None
    ) -> Fit:
        """Sample the posterior of the present data on a surrogate that is built around it from `start`.

        Raises
        ------
        CalibrationError
            If the prior has limits, of which a surrogate knows nothing, or the observed values enter the
            forward model.
        """
        settings = settings or Settings()
        if self.limits:
            raise CalibrationError(
                f"limits of {', '.join(self.limits)}: a surrogate samples the prior as it is; leave them out"
            )
        rows = zip(self.study.series, self._data.get_value(), strict=True)
        series = tuple(replace(one, value=np.array(row)) for one, row in rows)
        model = self._builder(replace(self.study, series=series))
        if _priors(model) != _priors(self.model):
            raise CalibrationError(
                f"model {model_name(model)}: its loads or priors follow from the observed values; give every "
                "outlet of the study a load, and priors such as the set paun2020"
            )
        idata = sample_surrogate(
            model,
            draws=settings.steps,
            chains=settings.chains,
            cores=1,
            seed=seed,
            progress=False,
            start={name: np.asarray(value, dtype=float) for name, value in start.items()},
            until_ess=settings.min_ess,
            max_draws=settings.max_steps,
        )
        found = idata["posterior"]
        shape = (found.sizes["chain"], found.sizes["draw"])
        flat = {rv.name: found[rv.name].to_numpy() for rv in self.model.free_RVs}
        vectors = self.logp.from_draws({n: v.reshape(-1, *v.shape[2:]) for n, v in flat.items()})
        draws = vectors.reshape(*shape, -1)
        log_posterior = np.array([self.logp(q) for q in vectors]).reshape(shape)
        ess, rhat = _diagnose(draws, log_posterior, self.names)
        made = RunRecord.of(idata).settings["surrogate"]
        return Fit(
            draws, log_posterior, ess, rhat, made["effective share"], made["correction"], made["k_hat"]
        )

    def _fit(self, start: Mapping[str, ArrayLike], seed: int, settings: Settings) -> Fit:
        """By the method asked for; where there is no surrogate exactly, lest truths are chosen among."""
        if settings.method == "exact":
            return self.fit(start, seed, settings)
        try:
            return self.fit_on_surrogate(start, seed, settings)
        except SurrogateError as error:
            least = Settings()  # of a surrogate steps are stored draws, of chains they are steps
            steps, most = max(settings.steps, least.steps), max(settings.max_steps, least.max_steps)
            longer = replace(settings, steps=steps, max_steps=most)
            return self.fit(start, seed, longer)._replace(correction=f"exact chains: {error}")

    def replicate(self, seed: int, number: int, settings: Settings | None = None) -> Replicate:
        """Replicate `number` of a calibration: simulate, fit, rank.

        Ranks are taken in the unconstrained space; every transformation is monotone, so they are those of
        the parameters.
        """
        settings = settings or Settings()
        began = time.monotonic()
        simulated = self.simulate(np.random.SeedSequence(seed, spawn_key=(number, 0)))
        self.observe(simulated.data)
        fit_seed = int(np.random.SeedSequence(seed, spawn_key=(number, 1)).generate_state(1)[0])
        fit = self._fit(simulated.values, fit_seed, settings)
        truth = self.vector(simulated.values)
        every = np.concatenate([fit.draws, fit.log_posterior[..., None]], axis=2)
        every = every.reshape(-1, every.shape[2])
        at = np.append(truth, self.logp(truth))
        kept = np.linspace(0, len(every) - 1, settings.ranked).round().astype(int)
        ranks = np.sum(every[kept] < at, axis=0)
        own = np.array([self.values(q) for q in every[kept, :-1]])
        names = self.names
        return Replicate(
            number=number,
            truth=dict(zip(names, self.values(truth).tolist(), strict=False)),
            rank=dict(zip(names, ranks.tolist(), strict=True)),
            sd=dict(zip(names, own.std(axis=0, ddof=1).tolist(), strict=False)),
            ess=fit.ess,
            rhat=fit.rhat,
            accepted=fit.accepted,
            steps=fit.draws.shape[1],
            redrawn=simulated.redrawn,
            seconds=time.monotonic() - began,
            correction=fit.correction,
            k_hat=fit.k_hat,
        )


def _priors(model: Any) -> tuple[str, list[tuple[str, str]]]:
    """Of a model: its forward model, and the priors of that and of its errors."""
    record = model.zoo
    parameters = (*record.forward.parameters, *record.errors.parameters)
    return record.forward.key, [(p.name, p.prior.text) for p in parameters]


class _Step(DEMetropolisZ):
    """The step method for one posterior after another, since making one takes longer than a short chain."""

    def begin_again(self, beginning: Start) -> None:
        self._first_archive = Archive(beginning.archive)
        self._first_reference = beginning.reference
        self._memory.clear()
        self.reset_tuning()


class _Chain:
    def __init__(self, step: DEMetropolisZ, logp: LogPosterior, start: Array, tune: int) -> None:
        from pymc.blocking import RaveledVars

        self.step = step
        self.at = RaveledVars(np.array(start), logp.template.point_map_info)
        self.draws: list[Array] = []
        self.log_posterior: list[float] = []
        self.accepted = 0.0
        step.tune = tune > 0
        for _ in range(tune):
            self._one()
        step.stop_tuning()

    def _one(self) -> float:
        self.at, [stats] = self.step.astep(self.at)
        self.accepted += float(stats["accepted"])
        return float(stats["model_logp"])

    def run(self, until: int) -> None:
        while len(self.draws) < until:
            self.log_posterior.append(self._one())
            self.draws.append(np.array(self.at.data))


def _diagnose(draws: Array, log_posterior: Array, names: Sequence[str]) -> tuple[dict[str, float], float]:
    """Bulk effective sample size of each quantity, and the largest R-hat (NaN with one chain)."""
    import arviz as az

    every = np.concatenate([draws, log_posterior[..., None]], axis=2)
    ess = {name: _finite(az.ess(every[..., i], method="bulk")) for i, name in enumerate(names)}
    if len(every) == 1:
        return ess, float("nan")
    return ess, max(float(az.rhat(every[..., i])) for i in range(every.shape[2]))


def _finite(value: Any) -> float:
    return float(np.nan_to_num(float(value)))
