"""Simulation-based calibration: does the posterior hold the truth as often as it says?

Parameters are drawn from the model's prior and data from the model at them; the truth's rank among draws of
the posterior is uniform if model, likelihood and sampler belong together (docs/calibration.md).
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from zoo.blood.ejection import PERIOD_S, ejection
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Blood, Series, Study, Vessel, Windkessel
from zoo.core.inference.logposterior import LogPosterior, model_name
from zoo.core.inference.mode import Mode
from zoo.core.inference.newton import newton
from zoo.core.inference.progress import bar
from zoo.core.inference.sampling import DEMETROPOLISZ
from zoo.core.inference.spaces import Archive
from zoo.core.inference.starts import Start, disperse
from zoo.core.inference.steps import DEMetropolisZ
from zoo.core.inference.workers import each

if TYPE_CHECKING:
    import pymc as pm

Array = NDArray[np.float64]
Builder = Callable[[Study], Any]

LEVELS = (0.5, 0.8, 0.95)
LOG_POSTERIOR = "log_posterior"
"""Name of the ranked quantity beside the parameters: the log-posterior density, which sees all of them."""
CHEAP_STEPS = {"linear": 256, "tangent": 1024}
FORMER_OPTIONS = {"own_units": "constrained"}
"""Options of the steps that files of replicates have by a former name; the draws are the same."""
MAX_TRIES = 1000
BLOCK = 8192


class CalibrationError(ValueError):
    """A calibration that cannot start or go on; its text says why and what to change."""


# -------------------------------------------------------------------------------------------------
# a study that is solved in a fraction of a millisecond


def cheap_study(n_times: int = 32, sites: Sequence[tuple[int, float]] = ((1, 0.0),)) -> Study:
    """A trunk (vessel 1) with two branches (2, 3), our own inflow, and pressures of 0 mmHg, to be replaced.

    Parameters
    ----------
    n_times : int
        Samples in the beat of 0.11 s.
    sites : sequence of (vessel, position)
        Where pressure is observed.
    """
    time_s, flow_ml_s = ejection(64)
    vessels = (
        Vessel(1, "trunk", 0.40, 0.047, 0.045),
        Vessel(2, "left", 0.40, 0.034, 0.034, 1, Windkessel(3.3e4, 1.43e5, 5.9e-7)),
        Vessel(3, "right", 0.35, 0.037, 0.037, 1, Windkessel(2.7e4, 1.17e5, 7.2e-7)),
    )
    series = tuple(Series(vessel, x, "pressure_mmHg", np.zeros(n_times)) for vessel, x in sites)
    observed_s = np.arange(n_times) * PERIOD_S / n_times
    return Study("cheap", PERIOD_S, Blood(1.055, 0.049), vessels, time_s, flow_ml_s, observed_s, series)


def cheap_options(wall: str = "linear") -> SolverOptions:
    """Coarse settings for `cheap_study`: two cells a vessel, and a fixed time step.

    The number of steps is fixed because one that followed the parameters would make the waves jump by more
    than the Gaussian process' noise of 0.0019 mmHg.

    Parameters
    ----------
    wall : {"linear", "tangent"}
    """
    if wall not in CHEAP_STEPS:
        raise CalibrationError(f"wall = {wall!r}: must be one of {', '.join(CHEAP_STEPS)}")
    return SolverOptions(dx_cm=0.2, steps_per_beat=CHEAP_STEPS[wall], tolerance_mmHg=1e-4)


# -------------------------------------------------------------------------------------------------
# one replicate


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
    """

    ranked: int = 79
    chains: int = 2
    tune: int = 400
    steps: int = 800
    max_steps: int = 12_800
    min_ess: float = 160.0

    def __post_init__(self) -> None:
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
    """Posterior draws of a replicate, unconstrained (n_chains, n_steps, n_dim), and what they cost."""

    draws: Array
    log_posterior: Array
    mode: Mode
    ess: dict[str, float]
    rhat: float
    accepted: float


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

        self.limits = dict(limits or {})
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
        q, value, covariance = newton(self.logp, q, value, passes=8)
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
        return Fit(draws, log_posterior, mode, ess, rhat, accepted)

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
        fit = self.fit(simulated.values, fit_seed, settings)
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
        )


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


@dataclass(frozen=True)
class Replicate:
    """One truth, its ranks, and how its posterior was sampled.

    `truth` and `sd` (of the ranked draws) are in the parameters' own units; `rank` is the number of the
    ranked draws below the truth, `ess` the bulk effective sample size of all draws, `steps` those of each
    chain that count; `redrawn` counts draws of the prior in vain, by reason.
    """

    number: int
    truth: dict[str, float]
    rank: dict[str, int]
    sd: dict[str, float]
    ess: dict[str, float]
    rhat: float
    accepted: float
    steps: int
    redrawn: dict[str, int]
    seconds: float


# -------------------------------------------------------------------------------------------------
# many replicates


def simulate_and_rank(
    model_builder: Builder,
    study: Study,
    n_replicates: int,
    *,
    seed: int = 0,
    settings: Settings | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
    truth: Builder | None = None,
    path: str | Path | None = None,
    cores: int = 1,
    progress: bool = False,
) -> RankTest:
    """Rank many truths from the prior among draws of their posteriors.

    Parameters
    ----------
    model_builder : callable
        ``model_builder(study) -> pm.Model``; with `cores` above 1 it has to be picklable.
    study : Study
        Network, inflow, times and places of the observations.
    n_replicates : int
        Truths.
    seed : int
        Replicate k depends on `seed` and k only.
    settings : Settings, optional
        Of the sampling.
    limits : mapping of name to (lower, upper), optional
        As in `Replicator`.
    truth : callable, optional
        As in `Replicator`.
    path : path, optional
        File of finished replicates, one JSON object a line; what it holds already is not done again.
    cores : int
        Processes, each with its own compiled model; 1 works in this process.
    progress : bool
        A bar on standard error.

    Returns
    -------
    RankTest

    Raises
    ------
    CalibrationError
        For a setting out of range, or a file of another calibration.

    References
    ----------
    Talts et al. 2018, arXiv:1804.06788.
    """
    settings = settings or Settings()
    if n_replicates < 1 or cores < 1:
        raise CalibrationError(f"n_replicates = {n_replicates}, cores = {cores}: must be at least 1")
    arguments = (model_builder, study, dict(limits or {}), truth)
    header = {
        "model": _builder_name(model_builder),
        "truth": _builder_name(truth or model_builder),
        "study": study.checksum,
        "seed": seed,
        "steps": dict(DEMETROPOLISZ),
        "limits": {name: list(map(float, pair)) for name, pair in (limits or {}).items()},
        "settings": asdict(settings),
    }
    store = _Store(None if path is None else Path(path), header)
    waiting = [k for k in range(n_replicates) if k not in store.found]
    with bar(progress) as show:
        task = show.add_task("replicates", total=n_replicates, completed=n_replicates - len(waiting))
        jobs = [(seed, number, settings) for number in waiting]
        for _, replicate in each(_replicate, jobs, cores, prepare=_begin, arguments=arguments):
            store.add(replicate)
            show.advance(task)
    return RankTest.of([store.found[k] for k in range(n_replicates)], settings.ranked)


_worker: dict[str, Replicator] = {}


def _begin(builder: Builder, study: Study, limits: Any, truth: Builder | None) -> None:
    _worker["replicator"] = Replicator(builder, study, limits=limits, truth=truth)


def _replicate(job: tuple[int, int, Settings]) -> Replicate:
    return _worker["replicator"].replicate(*job)


def _builder_name(builder: Any) -> str:
    """Name of a builder, with what functools.partial adds to it."""
    inner = getattr(builder, "func", builder)
    extra = getattr(builder, "keywords", None) or {}
    name = f"{inner.__module__}.{inner.__qualname__}"
    return name + "".join(f", {key}={value!r}" for key, value in sorted(extra.items()))


class _Store:
    """Finished replicates by number, and the file that they are kept in."""

    def __init__(self, path: Path | None, header: Mapping[str, Any]) -> None:
        self.path = path
        self.found: dict[int, Replicate] = {}
        if path is None:
            return
        whole = b""
        if path.exists():
            content = path.read_bytes()
            whole = content[: content.rfind(b"\n") + 1]  # the last line may have been cut by a kill
            if len(whole) < len(content):
                path.write_bytes(whole)
        if not whole:
            path.write_text(json.dumps(dict(header)) + "\n", encoding="utf-8")
            return
        self._read(path, whole.decode().splitlines(), header)

    def _read(self, path: Path, lines: Sequence[str], header: Mapping[str, Any]) -> None:
        try:
            stored = json.loads(lines[0])
            rows = [Replicate(**json.loads(line)) for line in lines[1:]]
        except (json.JSONDecodeError, TypeError) as error:
            raise CalibrationError(f"{path}: no file of replicates ({error}); choose another") from None
        if isinstance(stored, dict) and isinstance(stored.get("steps"), dict):
            stored["steps"] = {FORMER_OPTIONS.get(key, key): value for key, value in stored["steps"].items()}
        mine = json.loads(json.dumps(dict(header)))
        for name, value in mine.items():
            theirs = stored.get(name) if isinstance(stored, dict) else None
            if theirs != value:
                raise CalibrationError(
                    f"{path}: replicates of another calibration: {name} is {theirs} there and {value} here; "
                    "choose another file"
                )
        self.found = {row.number: row for row in rows}

    def add(self, replicate: Replicate) -> None:
        self.found[replicate.number] = replicate
        if self.path is not None:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(replicate)) + "\n")


# -------------------------------------------------------------------------------------------------
# are the ranks uniform?


@dataclass(frozen=True)
class RankTest:
    """Ranks of truths among posterior draws, and tests of their being uniform on 0, ..., L.

    Parameters
    ----------
    names : tuple of str
        Ranked quantities.
    ranks : int array (n_replicates, n_names)
    ranked : int
        L, draws that each truth is ranked among.
    replicates : tuple of Replicate
        Where the ranks come from; may be empty.

    Raises
    ------
    CalibrationError
        If the shapes do not fit, or a rank is not in 0, ..., L.
    """

    names: tuple[str, ...]
    ranks: NDArray[np.int64]
    ranked: int
    replicates: tuple[Replicate, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        ranks = np.asarray(self.ranks, dtype=np.int64)
        if ranks.ndim != 2 or ranks.shape[1] != len(self.names) or len(ranks) == 0:
            raise CalibrationError(f"ranks of shape {ranks.shape}: must be (n, {len(self.names)}), n > 0")
        if ranks.min() < 0 or ranks.max() > self.ranked:
            raise CalibrationError(f"ranks {ranks.min()} to {ranks.max()}: must be in 0 to {self.ranked}")
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "ranks", ranks)

    @classmethod
    def of(cls, replicates: Sequence[Replicate], ranked: int) -> RankTest:
        """From finished replicates."""
        names = tuple(replicates[0].rank)
        ranks = np.array([[r.rank[name] for name in names] for r in replicates])
        return cls(names, ranks, ranked, tuple(replicates))

    @property
    def n(self) -> int:
        """Replicates."""
        return len(self.ranks)

    @property
    def points(self) -> Array:
        """Where the ECDFs are evaluated, (L,): the probabilities (k + 1)/(L + 1) of a rank of at most k."""
        return np.arange(1, self.ranked + 1) / (self.ranked + 1)

    def histogram(self, bins: int | None = None) -> NDArray[np.int64]:
        """Counts of ranks in equal bins, (bins, n_names).

        Parameters
        ----------
        bins : int, optional
            A divisor of L + 1; if absent the largest, up to 20, with at least five expected in each.

        Raises
        ------
        CalibrationError
            If `bins` does not divide L + 1.
        """
        total = self.ranked + 1
        if bins is None:
            fitting = [k for k in range(2, 21) if total % k == 0 and self.n / k >= 5]
            bins = max(fitting, default=1)
        if bins < 1 or total % bins:
            raise CalibrationError(f"bins = {bins}: must divide the {total} possible ranks")
        width = total // bins
        return np.stack([np.bincount(column // width, minlength=bins) for column in self.ranks.T], axis=1)

    def chi_square(self, bins: int | None = None) -> Array:
        """p-values of Pearson's test that the bins are equally likely, (n_names,)."""
        from scipy.stats import chisquare

        return np.asarray(chisquare(self.histogram(bins), axis=0).pvalue)

    def ecdf_difference(self) -> Array:
        """Share of ranks of at most k minus (k + 1)/(L + 1), k = 0, ..., L - 1, (L, n_names)."""
        return self._counts() / self.n - self.points[:, None]

    def _counts(self) -> NDArray[np.int64]:
        counts = np.stack([np.bincount(column, minlength=self.ranked + 1) for column in self.ranks.T], axis=1)
        return np.asarray(np.cumsum(counts, axis=0)[:-1])

    def band(self, prob: float = 0.95) -> tuple[Array, Array]:
        """Limits, (L,) each, that the ECDF difference keeps everywhere with probability `prob`.

        References
        ----------
        Säilynoja, Bürkner, Vehtari 2022, doi 10.1007/s11222-022-10090-6.
        """
        from arviz.stats.ecdf_utils import ecdf_confidence_band

        low, high = ecdf_confidence_band(self.n, self.points, self.points, prob=prob, method="optimized")
        return low - self.points, high - self.points

    def ecdf_p(self, trials: int = 4000, seed: int = 0) -> Array:
        """p-values of the simultaneous ECDF test, (n_names,), by simulation of uniform ranks.

        The statistic is gamma = 2 min_k min(P(X <= R_k), P(X >= R_k)), X ~ Binomial(n, (k + 1)/(L + 1)), R_k
        the ranks of at most k.

        Parameters
        ----------
        trials : int
            Simulated sets of ranks; 1/(trials + 1) is the smallest p-value.
        seed : int
            Of the simulation.

        References
        ----------
        Säilynoja, Bürkner, Vehtari 2022, doi 10.1007/s11222-022-10090-6.
        """
        total = self.ranked + 1
        rng = np.random.default_rng(seed)
        uniform = rng.multinomial(self.n, np.full(total, 1 / total), size=trials)
        null = np.sort(self._gamma(np.cumsum(uniform, axis=1)[:, :-1]))
        found = self._gamma(self._counts().T)
        return (1 + np.searchsorted(null, found * (1 + 1e-9), side="right")) / (trials + 1)

    def _gamma(self, counts: NDArray[np.int64]) -> Array:
        from scipy.stats import binom

        table = binom.cdf(np.arange(-1, self.n + 1)[:, None], self.n, self.points)  # P(X <= r), r from -1
        column = np.arange(self.ranked)
        below, above = table[counts + 1, column], 1 - table[counts, column]
        return np.asarray(2 * np.minimum(below, above).min(axis=1))

    def coverage(self, levels: Sequence[float] = LEVELS) -> pd.DataFrame:
        """How often central intervals hold the truth, with the range that chance allows.

        Returns
        -------
        DataFrame
            Columns parameter, level, expected (of the ranks that count as inside, near the level), share,
            error (binomial standard error), low, high (central 95 % of the binomial), within.
        """
        from scipy.stats import binom

        total = self.ranked + 1
        rows = []
        for level in levels:
            inside = np.abs((np.arange(total) + 0.5) / total - 0.5) <= level / 2 + 1e-12
            expected = float(inside.mean())
            low, high = (float(x) / self.n for x in binom.interval(0.95, self.n, expected))
            error = float(np.sqrt(expected * (1 - expected) / self.n))
            for name, column in zip(self.names, self.ranks.T, strict=True):
                share = float(inside[column].mean())
                rows.append((name, level, expected, share, error, low, high, low <= share <= high))
        columns = ["parameter", "level", "expected", "share", "error", "low", "high", "within"]
        return pd.DataFrame(rows, columns=columns)

    def narrowing(self) -> dict[str, float]:
        """Median posterior standard deviation over that of the truths; near 1 the data say nothing."""
        found = {}
        for name in self.replicates[0].sd if self.replicates else ():
            spread = float(np.std([r.truth[name] for r in self.replicates], ddof=1))
            found[name] = float(np.median([r.sd[name] for r in self.replicates])) / spread
        return found

    def table(self) -> pd.DataFrame:
        """One row for each quantity.

        Returns
        -------
        DataFrame
            Index parameter: chi2_p, ecdf_p, in_band (95 %), cover_50, cover_80, cover_95, narrowing.
        """
        low, high = self.band()
        difference = self.ecdf_difference()
        slack = 1e-9
        table = pd.DataFrame(
            {
                "chi2_p": self.chi_square(),
                "ecdf_p": self.ecdf_p(),
                "in_band": [bool(np.all((d >= low - slack) & (d <= high + slack))) for d in difference.T],
            },
            index=pd.Index(self.names, name="parameter"),
        )
        for level, rows in self.coverage().groupby("level"):
            table[f"cover_{100 * float(str(level)):.0f}"] = rows.set_index("parameter")["share"]
        table["narrowing"] = pd.Series(self.narrowing(), dtype=float)
        return table

    def passes(self, alpha: float = 0.01) -> bool:
        """Whether no ECDF test is below `alpha` divided by the number of quantities (Bonferroni)."""
        return bool(self.ecdf_p().min() >= alpha / len(self.names))
