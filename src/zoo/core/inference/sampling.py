"""Markov chain Monte Carlo for models with a costly, gradient-free solver.

The mode is found first, chains run in processes of their own, and a killed run resumes with the same draws.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.digests import of_json
from zoo.core.draws import seed_or_drawn
from zoo.core.inference.chain import Task
from zoo.core.inference.checkpoint import (
    CheckpointError,
    CheckpointInUseError,
    Folder,
    check_identity,
    identity_of,
)
from zoo.core.inference.convergence import ESS_TARGET, check_convergence, ess_to_count
from zoo.core.inference.logposterior import Array, LogPosterior, SamplingError, model_name
from zoo.core.inference.mode import Mode, find_mode, has_many, search_mode
from zoo.core.inference.pool import ChainPool, InlineChainPool, ProcessChainPool
from zoo.core.inference.prior_check import check_priors, exactness_at, modes_at_bounds, priors_of
from zoo.core.inference.progress import Display
from zoo.core.inference.record import RunRecord
from zoo.core.inference.starts import Start, disperse, start_settings
from zoo.core.inference.steps import DEMETROPOLISZ, DEMetropolisZ, Metropolis
from zoo.core.model import ModelError, ModelRecord
from zoo.core.op import MissingGradientError

if TYPE_CHECKING:
    import arviz as az

__all__ = [
    "CheckpointError",
    "CheckpointInUseError",
    "DEMetropolisZ",
    "Metropolis",
    "Mode",
    "SamplingError",
    "find_mode",
    "sample",
    "sample_nuts",
]

STEPS = ("demetropolisz", "metropolis")
NUTS_TUNE = 500
"""Steps of NUTS that are thrown away while its metric and step size adapt."""
PILOTS = 4
"""Most rounds of short chains that look for a higher mode of a model with many parameters."""


def sample(
    model: Any,
    *,
    draws: int = 1000,
    tune: int | None = None,
    chains: int = 4,
    cores: int = 2,
    step: str = "demetropolisz",
    thin: int | None = None,
    seed: int | None = None,
    checkpoint: str | Path | None = None,
    checkpoint_seconds: float = 30.0,
    progress: bool = True,
    until_ess: float | None = None,
    max_draws: int | None = None,
    start: Mapping[str, ArrayLike] | Mode | None = None,
    step_options: Mapping[str, Any] | None = None,
    preface: str = "",
) -> az.InferenceData:
    """Sample a model's posterior, resumably, with a process for each chain.

    The mode is found first; the chains start from a t distribution twice as wide as the Gaussian around it.
    The draws depend on the model, the seed and the settings, not on `cores`, on interruptions or on how long
    anything took.

    Parameters
    ----------
    model : pymc.Model
        With continuous free variables only.
    draws : int
        Stored draws of each chain.
    tune : int, optional
        Steps of each chain that are thrown away while the step method adapts; if absent 100 for each
        dimension, at least 600.
    chains : int
        Chains; fewer than four cannot pass the verdict.
    cores : int
        Processes at work at a time, with one thread each; 0 runs the chains in this process, in turns, which
        starts sooner and suits many short runs.
    step : {"demetropolisz", "metropolis"}
        Step method: all variables move jointly.
    thin : int, optional
        Steps for each stored draw; a quarter of the number of dimensions if absent.
    seed : int, optional
        Drawn and recorded if absent; a resumed run takes that of its checkpoint.
    checkpoint : path, optional
        Folder for the state of the run; if it holds one, the run goes on from there. A finished run can be
        taken up again with more `draws` or another `until_ess`.
    checkpoint_seconds : float
        How often each chain is written, in s.
    progress : bool
        Show progress on standard error.
    until_ess : float, optional
        Keep going until every parameter has R-hat <= 1.01 and bulk and tail effective sample sizes of this
        much, or `max_draws` are reached; the first check is after `draws`.
    max_draws : int, optional
        Limit of the stored draws of each chain; 40 `draws` if absent.
    start : mapping or Mode, optional
        Values to search the mode from, or the result of `find_mode`.
    step_options : mapping, optional
        Arguments of the step method instead of the defaults, such as `crank_nicolson=0`.

    preface : str
        A line that is shown first, once nothing speaks against the run.

    Returns
    -------
    arviz.InferenceData
        posterior; sample_stats (for each stored draw: lp, accept, accepted, solves, solver_failures);
        observed_data; attributes with the run record (`zoo.core.inference.record.RunRecord.of`).

    Raises
    ------
    SamplingError
        For a setting out of range, a model that cannot be sampled, or a chain that fails.
    CheckpointError
        If the checkpoint belongs to another model, study or settings, or is in use.

    References
    ----------
    ter Braak, Vrugt (2008), doi 10.1007/s11222-008-9104-9; Vehtari et al. (2021), doi 10.1214/20-BA1221.
    """
    _check_model(model)
    check_settings(draws, tune, chains, cores, step, thin, seed, until_ess, max_draws)
    d = len(LogPosterior(model).template.data)
    return _sample(
        model,
        step,
        _step_options(step, step_options),
        draws=draws,
        tune=100 * max(d, 6) if tune is None else tune,
        chains=chains,
        cores=cores,
        thin=max(1, d // 4) if thin is None else thin,
        seed=seed,
        checkpoint=checkpoint,
        checkpoint_seconds=checkpoint_seconds,
        progress=progress,
        until_ess=until_ess,
        max_draws=max_draws,
        start=start,
        preface=preface,
    )


def sample_nuts(
    model: Any,
    *,
    draws: int = 1000,
    tune: int | None = None,
    chains: int = 4,
    cores: int = 2,
    seed: int | None = None,
    checkpoint: str | Path | None = None,
    checkpoint_seconds: float = 30.0,
    progress: bool = True,
    until_ess: float | None = None,
    max_draws: int | None = None,
    start: Mapping[str, ArrayLike] | Mode | None = None,
    preface: str = "",
) -> az.InferenceData:
    """Sample a posterior by NUTS with the model's own gradient; the metric begins at the mode's covariance.

    Parameters
    ----------
    model : pymc.Model
        With a gradient.
    draws, chains, cores, seed, checkpoint, checkpoint_seconds, progress, until_ess, start, preface
        As of `sample`.
    tune : int, optional
        500 if absent.
    max_draws : int, optional
        8 `draws` if absent.

    Returns
    -------
    arviz.InferenceData
        As of `sample`; sample_stats also has the gradients of each draw, and whether its trajectory diverged.

    Raises
    ------
    SamplingError
        As of `sample`, and if the model has no gradient.
    CheckpointError
        As of `sample`.

    References
    ----------
    Hoffman, Gelman (2014), Journal of Machine Learning Research 15.
    """
    _check_model(model)
    check_settings(draws, tune, chains, cores, seed=seed, until_ess=until_ess, max_draws=max_draws)
    if not has_gradient(model):
        raise SamplingError(f"model {model_name(model)}: has no gradient; use method surrogate or exact")
    return _sample(
        model,
        "nuts",
        {},
        draws=draws,
        tune=NUTS_TUNE if tune is None else tune,
        chains=chains,
        cores=cores,
        thin=1,
        seed=seed,
        checkpoint=checkpoint,
        checkpoint_seconds=checkpoint_seconds,
        progress=progress,
        until_ess=until_ess,
        max_draws=max_draws or 8 * draws,
        start=start,
        preface=preface,
    )


def has_gradient(model: Any) -> bool:
    """Whether the log-posterior of a model can be differentiated."""
    try:
        model.dlogp()
    except (MissingGradientError, NotImplementedError, ModelError):
        return False
    return True


def _sample(
    model: Any,
    step: str,
    options: dict[str, Any],
    *,
    draws: int,
    tune: int,
    chains: int,
    cores: int,
    thin: int,
    seed: int | None,
    checkpoint: str | Path | None,
    checkpoint_seconds: float,
    progress: bool,
    until_ess: float | None,
    max_draws: int | None,
    start: Mapping[str, ArrayLike] | Mode | None,
    preface: str,
) -> az.InferenceData:
    """Chains of a step method from around the mode, resumably."""
    began = time.monotonic()
    folder = None if checkpoint is None else Folder(Path(checkpoint))
    try:
        logp = LogPosterior(model)
        d = len(logp.template.data)
        stored = None if folder is None else folder.run()
        if seed is None and stored:
            seed = int(stored["identity"]["seed"])
        seed = seed_or_drawn(seed)
        settings: dict[str, Any] = {
            "step": step,
            "step options": options,
            "tune": tune,
            "thin": thin,
            "chains": chains,
            "seed": seed,
            "start": start_settings(start),
        }
        identity = identity_of(logp, settings)
        if stored is None:
            stored = {
                "identity": identity,
                "started": datetime.now(UTC).isoformat(timespec="seconds"),
                "sittings": 0,
            }
            stored["wall_seconds"] = 0.0
        elif folder is not None:
            check_identity(folder.path, stored["identity"], identity)
        run = of_json(stored["identity"])
        if folder is not None:
            folder.check_chains(run, chains)
        stored["sittings"] += 1
        earlier = float(stored["wall_seconds"])
        with Display(progress, tune=tune, thin=thin, cores=cores, ess=until_ess) as show:
            if preface:
                show.say(preface)
            show.say(_opening(model, d, settings, stored))
            if "grid" in identity["solver options"]:
                show.say(identity["solver options"]["grid"])
            if folder is not None:
                folder.write_run(stored)
            beginning = None if folder is None else folder.start(run)
            if beginning is None:
                with show.during("finding the mode", lambda: f"{logp.evaluations} evaluations"):
                    mode = start if isinstance(start, Mode) else search_mode(logp, start, seed=seed)
                    beginning = disperse(logp, mode, chains, seed)
                    if has_many(logp) and not isinstance(start, Mode):
                        of_pilots = (
                            ("demetropolisz", {**DEMETROPOLISZ}) if step == "nuts" else (step, options)
                        )
                        beginning = _improve(logp, beginning, chains, cores, seed, *of_pilots, show)
                        mode = beginning.mode
                if folder is not None:
                    folder.write_start(run, beginning)
                show.say(f"mode: log-posterior {mode.logp:.2f} after {mode.evaluations} evaluations")
            parameters, effects = priors_of(model)
            at_mode = modes_at_bounds(parameters, beginning.mode.values, effects=effects)
            for found in at_mode:
                show.say(f"warning: {found.text}")
            if numerical := exactness_at(model, beginning.mode.values):
                show.say(f"warning: {numerical}")
            pool = _pool(
                model,
                beginning,
                seed,
                step,
                options,
                tune,
                thin,
                cores,
                show,
                checkpoint=None if folder is None else folder.chain,
                checkpoint_seconds=checkpoint_seconds,
                run=run,
            )
            try:
                kept = _run(model, pool, draws, until_ess, max_draws or 40 * draws)
            finally:
                pool.close()
                stored["wall_seconds"] = earlier + time.monotonic() - began
                if folder is not None:
                    folder.write_run(stored)
            made = pool.draws(kept)
            priors = check_priors(parameters, made, effects=effects)
            leaning = {(found.parameter, found.side) for found in priors.bounds}
            more = tuple(found for found in at_mode if (found.parameter, found.side) not in leaning)
            priors = replace(priors, bounds=priors.bounds + more, numerical=numerical)
            idata = _inference_data(model, made, pool.stats(kept))
            record = _record(model, pool, beginning, stored, settings, kept, draws, until_ess, cores)
            if parameters:
                record = replace(record, prior_check=priors.as_dict())
            record.attach(idata)
            if diverged := int(idata["sample_stats"].get("diverging", np.zeros(1)).sum()):
                show.say(
                    f"warning: {diverged} of {chains * kept} trajectories diverged: a part of the posterior "
                    "may be out of reach of NUTS; compare with method exact"
                )
            show.say(check_convergence(made, ess=ess_to_count(until_ess), priors=priors).text)
        return idata
    finally:
        if folder is not None:
            folder.close()


def _pool(
    model: Any,
    beginning: Start,
    seed: int,
    step: str,
    options: Mapping[str, Any],
    tune: int,
    thin: int,
    cores: int,
    show: Display,
    *,
    checkpoint: Callable[[int], Path] | None = None,
    checkpoint_seconds: float = np.inf,
    run: str = "",
) -> ChainPool:
    """Chains from the starts of a beginning: in processes, or in this one if `cores` is 0."""
    tasks = [
        Task(
            model=model,
            chain=chain,
            seed=seed,
            start=start,
            reference=beginning.reference,
            archive=beginning.archive,
            step=step,
            options=dict(options),
            tune=tune,
            thin=thin,
            checkpoint=None if checkpoint is None else checkpoint(chain).resolve(),
            checkpoint_seconds=checkpoint_seconds,
            run=run,
        )
        for chain, start in enumerate(beginning.starts)
    ]
    return ProcessChainPool(tasks, cores, show) if cores else InlineChainPool(tasks, show)


def _improve(
    logp: LogPosterior,
    beginning: Start,
    chains: int,
    cores: int,
    seed: int,
    step: str,
    options: Mapping[str, Any],
    show: Display,
) -> Start:
    """Short chains that look for a higher mode; where they find one, the search starts again from there.

    With many parameters the highest point need not lie where the search ends, and chains that were tuned
    elsewhere take long to get there.
    """
    d = len(logp.template.data)
    for attempt in range(1, PILOTS + 1):
        trial = int(np.random.SeedSequence(seed, spawn_key=(attempt, 2)).generate_state(1)[0])
        pool = _pool(logp.model, beginning, trial, step, options, 100 * d, 1, cores, show)
        kept = 20 * d
        try:
            pool.advance(kept)
            draws, lp = pool.draws(kept), pool.stats(kept)["lp"]
        finally:
            pool.close()
        chain, draw = np.unravel_index(int(np.argmax(lp)), lp.shape)
        best = {rv.name: draws[rv.name][chain, draw] for rv in logp.model.free_RVs}
        mode = beginning.mode
        if lp[chain, draw] < mode.logp + 2.0:
            break
        found = search_mode(logp, best, seed=seed)
        show.say(
            f"trial chains {attempt}: from log-posterior {mode.logp:.2f} to {lp[chain, draw]:.2f}, "
            f"mode there {found.logp:.2f}"
        )
        evaluations = mode.evaluations + found.evaluations + sum(state.solves for state in pool.states)
        beginning = disperse(logp, replace(found, evaluations=evaluations), chains, seed)
    return beginning


def _check_model(model: Any) -> None:
    import pymc as pm

    if not isinstance(model, pm.Model):
        raise SamplingError(
            f"model = {model!r:.80}: give a PyMC model, such as that of zoo.core.model.bayesian_model"
        )


def check_settings(
    draws: int = 1,
    tune: int | None = None,
    chains: int = 4,
    cores: int = 1,
    step: str = STEPS[0],
    thin: int | None = None,
    seed: int | None = None,
    until_ess: float | None = None,
    max_draws: int | None = None,
) -> None:
    """Refuse settings of `sample` that cannot be.

    Raises
    ------
    SamplingError
        That names the setting and its value.
    """
    least = {
        "draws": (draws, 1),
        "tune": (tune, 0),
        "chains": (chains, 1),
        "cores": (cores, 0),
        "thin": (thin, 1),
        "seed": (seed, 0),
    }
    least["max_draws"] = (max_draws, draws)
    for name, (value, limit) in least.items():
        if value is not None and (not isinstance(value, int | np.integer) or value < limit):
            raise SamplingError(f"{name} = {value}: must be a whole number of at least {limit}")
    if step not in STEPS:
        raise SamplingError(f"step = {step!r}: must be one of {', '.join(STEPS)}")
    if until_ess is not None and not (np.isfinite(until_ess) and until_ess > 0):
        raise SamplingError(f"until_ess = {until_ess}: must be a positive number, such as {ESS_TARGET:.0f}")
    if until_ess is not None and chains < 2:
        raise SamplingError(f"chains = {chains}: until_ess needs R-hat, which needs at least 2 chains; use 4")


def _step_options(step: str, given: Mapping[str, Any] | None) -> dict[str, Any]:
    options = dict(DEMETROPOLISZ) if step == "demetropolisz" else {"joint": True, "adapt": True}
    return {**options, **dict(given or {})}


def _opening(model: Any, d: int, settings: Mapping[str, Any], stored: Mapping[str, Any]) -> str:
    study = getattr(getattr(model, "zoo", None), "study", None)
    on = f" on {study.name}" if study is not None else ""
    again = "" if stored["sittings"] == 1 else f", resumed (sitting {stored['sittings']})"
    return (
        f"model {model_name(model)}{on}: {d} dimensions, {settings['chains']} chains of {settings['step']}, "
        f"tune {settings['tune']}, thin {settings['thin']}, seed {settings['seed']}{again}"
    )


def _run(model: Any, pool: ChainPool, draws: int, until_ess: float | None, limit: int) -> int:
    """Advance the chains to the end; returns the number of draws of each chain that count."""
    kept = draws
    pool.advance(kept)
    if until_ess is None:
        return kept
    while kept < limit:
        # only numbers of draws and the draws decide where to look, so a resumed run stops where it would have
        made = pool.draws(kept)
        verdict = check_convergence(made, ess=until_ess)
        failing = {p.name for p in verdict.parameters if not p.passes}
        if failing:  # but for what the data do not inform the run need not go on
            parameters, effects = priors_of(model)
            failing -= set(check_priors(parameters, made, effects=effects).uninformed)
        if not failing:
            break
        least = min(min(verdict[name].ess_bulk, verdict[name].ess_tail) for name in failing)
        factor = 1.1 * until_ess / max(np.nan_to_num(least), 1.0)
        kept = min(limit, int(np.ceil(kept * float(np.clip(factor, 1.25, 2.0)))))
        pool.advance(kept)
    return kept


def _inference_data(model: Any, draws: Mapping[str, Array], stats: Mapping[str, Array]) -> az.InferenceData:
    import arviz as az
    from pymc.backends.arviz import find_observations

    dims = {name: list(names) for name, names in model.named_vars_to_dims.items()}
    coords = {name: np.asarray(values) for name, values in model.coords.items() if values is not None}
    whole = {"solves": np.int64, "solver_failures": np.int64, "gradients": np.int64, "diverging": np.bool_}
    observed = find_observations(model)
    idata: az.InferenceData = az.from_dict(
        posterior=dict(draws),
        sample_stats={n: v.astype(whole.get(n, v.dtype)) for n, v in stats.items()},
        observed_data=observed or None,
        coords=coords,
        dims=dims,
    )
    return idata


def _record(
    model: Any,
    pool: ChainPool,
    beginning: Start,
    stored: Mapping[str, Any],
    settings: Mapping[str, Any],
    kept: int,
    draws: int,
    until_ess: float | None,
    cores: int,
) -> RunRecord:
    identity = stored["identity"]
    solves = sum(state.solves for state in pool.states)
    steps = sum(state.steps for state in pool.states)
    failures: Counter[str] = Counter()
    for state in pool.states:
        failures.update(state.failures)
    shown = {name: value for name, value in settings.items() if name != "seed"}
    shown |= {"draws": kept, "first check": draws, "until_ess": until_ess, "cores": cores}
    return RunRecord(
        model=model_name(model),
        study=identity["study"],
        study_checksum=identity["study checksum"],
        conventions=identity["conventions"],
        solver=identity["solver options"],
        settings=shown,
        seed=int(settings["seed"]),
        solves=solves,
        steps=steps,
        mode_evaluations=beginning.mode.evaluations,
        failures=dict(sorted(failures.items())),
        solves_per_draw=solves / (kept * len(pool.states)),
        solves_per_step=solves / max(1, steps),
        wall_seconds=float(stored["wall_seconds"]),
        sittings=int(stored["sittings"]),
        started=str(stored["started"]),
        priors=model.zoo.priors if isinstance(getattr(model, "zoo", None), ModelRecord) else None,
    )
