"""Markov chain Monte Carlo for models with a costly, gradient-free solver.

The mode is found first, chains run in processes of their own, and a killed run resumes with the same draws.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.arviz_lines import InferenceData, dataset
from zoo.core.inference.chain import Task
from zoo.core.inference.checkpoint import Run
from zoo.core.inference.convergence import ESS_TARGET, check_convergence
from zoo.core.inference.logposterior import LogPosterior, SamplingError, model_name
from zoo.core.inference.mode import Mode, has_many, search_mode
from zoo.core.inference.pool import Chains
from zoo.core.inference.prior_check import exactness_at, model_check, modes_at_bounds, priors_of
from zoo.core.inference.progress import Display
from zoo.core.inference.record_of_run import attach_record, inference_data
from zoo.core.inference.starts import Start, disperse, start_settings
from zoo.core.inference.steps import DEMETROPOLISZ
from zoo.core.model import ModelError
from zoo.core.op import MissingGradientError

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
    executor: Executor | None = None,
    nuts: bool = False,
    thin: int | None = None,
    seed: int | None = None,
    checkpoint: str | Path | None = None,
    progress: bool = True,
    until_ess: float | None = None,
    max_draws: int | None = None,
    start: Mapping[str, ArrayLike] | Mode | None = None,
    step_options: Mapping[str, Any] | None = None,
    preface: str = "",
) -> InferenceData:
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
        dimension, at least 600; of NUTS 500.
    chains : int
        Chains; fewer than four cannot pass the verdict.
    cores : int
        Processes at work at a time, with one thread each; 0 runs the chains in this process, in turns, which
        starts sooner and suits many short runs.
    executor : concurrent.futures.Executor, optional
        Runs the chains instead, each as a task: threads, processes, or ``Client.get_executor()`` of
        dask.distributed. `cores` is not read.
    nuts : bool
        Steps of NUTS with the model's own gradient, whose metric begins at the mode's covariance, instead of
        `DEMetropolisZ`, which needs none.
    thin : int, optional
        Steps for each stored draw; a quarter of the number of dimensions if absent, of NUTS 1.
    seed : int, optional
        Drawn and recorded if absent; a resumed run takes that of its checkpoint.
    checkpoint : path, optional
        Folder for the log-posteriors of the run; if it holds some, the run makes its steps again with them,
        and goes on. A finished run can be taken up again with more `draws` or another `until_ess`. On an
        `executor` they come back when a chain has its draws; else every second.
    progress : bool
        Show progress on standard error.
    until_ess : float, optional
        Keep going until every parameter has R-hat <= 1.01 and bulk and tail effective sample sizes of this
        much, or `max_draws` are reached; the first check is after `draws`.
    max_draws : int, optional
        Limit of the stored draws of each chain; 40 `draws` if absent, of NUTS 8.
    start : mapping or Mode, optional
        Values to search the mode from, or the result of `find_mode`.
    step_options : mapping, optional
        Arguments of the step method instead of the defaults, such as `crank_nicolson=0`.
    preface : str
        A line that is shown first, once nothing speaks against the run.

    Returns
    -------
    InferenceData
        posterior; sample_stats (for each stored draw: lp, accept, accepted, solves, solver_failures, and of
        NUTS gradients and whether its trajectory diverged);
        observed_data; attributes with the run record (`zoo.core.inference.record.RunRecord.of`).

    Raises
    ------
    SamplingError
        For a setting out of range, a model that cannot be sampled, or a chain that fails.
    CheckpointError
        If the checkpoint belongs to another model, study or settings, or is in use.

    References
    ----------
    ter Braak, Vrugt (2008), doi 10.1007/s11222-008-9104-9; Hoffman, Gelman (2014), Journal of Machine
    Learning Research 15; Vehtari et al. (2021), doi 10.1214/20-BA1221.
    """
    _check_model(model)
    check_settings(draws, tune, chains, cores, thin, seed, until_ess, max_draws)
    if nuts and not has_gradient(model):
        raise SamplingError(f"model {model_name(model)}: has no gradient; use method surrogate or exact")
    logp = LogPosterior(model)
    d = len(logp.template.data)
    step = "nuts" if nuts else "demetropolisz"
    options = {**({} if nuts else DEMETROPOLISZ), **dict(step_options or {})}
    if tune is None:
        tune = NUTS_TUNE if nuts else 100 * max(d, 6)
    if thin is None:
        thin = 1 if nuts else max(1, d // 4)
    if max_draws is None:
        max_draws = (8 if nuts else 40) * draws
    settings: dict[str, Any] = {
        "step": step,
        "step options": options,
        "tune": tune,
        "thin": thin,
        "chains": chains,
        "start": start_settings(start),
    }
    run = Run(checkpoint, logp, settings, seed)
    try:
        with Display(progress) as show:
            if preface:
                show.say(preface)
            show.say(_opening(model, logp, settings, run))
            if "grid" in run.identity["solver options"]:
                show.say(run.identity["solver options"]["grid"])
            begin = _Beginning(logp, chains, cores, executor, run.seed, step, options, show)
            if run.beginning is None:
                beginning = begin.find(start)
                run.beginning = beginning.stored()
                run.write()
            else:
                beginning = Start.of_stored(run.beginning, logp, run.seed)
            mode = beginning.mode
            show.say(f"mode: log-posterior {mode.logp:.2f} after {mode.evaluations} evaluations")
            parameters, effects = priors_of(model)
            at_mode = modes_at_bounds(parameters, mode.values, effects=effects)
            for found in at_mode:
                show.say(f"warning: {found.text}")
            if numerical := exactness_at(model, mode.values):
                show.say(f"warning: {numerical}")
            files = None if run.folder is None else run.folder.chain
            tasks = begin.tasks(beginning, run.seed, tune, thin)
            with Chains(tasks, cores, show, executor, files, run.owner) as pool:
                kept = _run(model, pool, draws, until_ess, max_draws)
            idata = inference_data(model, pool.draws(kept), pool.stats(kept))
            if diverged := int(dataset(idata, "sample_stats").get("diverging", np.zeros(1)).sum()):
                show.say(
                    f"warning: {diverged} of {chains * kept} trajectories diverged: a part of the posterior "
                    "may be out of reach of NUTS; compare with method exact"
                )
            shown = {"draws": kept, "first check": draws, "until_ess": until_ess, "cores": cores}
            attach_record(
                idata,
                logp,
                run,
                settings | shown,
                solves=sum(state.solves for state in pool.states),
                steps=sum(state.steps for state in pool.states),
                mode_evaluations=mode.evaluations,
                failures=sum((Counter(state.failures) for state in pool.states), Counter()),
                at_mode=at_mode,
                numerical=numerical,
                say=show.say,
            )
        return idata
    finally:
        run.close()


def has_gradient(model: Any) -> bool:
    """Whether the log-posterior of a model can be differentiated."""
    try:
        model.dlogp()
    except (MissingGradientError, NotImplementedError, ModelError):
        return False
    return True


@dataclass(frozen=True)
class _Beginning:
    """Where the chains of a run begin, and what they follow from."""

    logp: LogPosterior
    chains: int
    cores: int
    executor: Executor | None
    seed: int
    step: str
    options: dict[str, Any]
    show: Display

    def find(self, start: Mapping[str, ArrayLike] | Mode | None) -> Start:
        """From around the mode, which is looked for unless it is given."""
        with self.show.during("finding the mode", lambda: f"{self.logp.evaluations} evaluations"):
            mode = start if isinstance(start, Mode) else search_mode(self.logp, start, seed=self.seed)
            beginning = disperse(self.logp, mode, self.chains, self.seed)
        if has_many(self.logp) and not isinstance(start, Mode):
            beginning = self._improve(beginning)
        return beginning

    def _improve(self, beginning: Start) -> Start:
        """Short chains that look for a higher mode; where they find one, the search starts again from there.

        With many parameters the highest point need not lie where the search ends, and chains that were tuned
        elsewhere take long to get there.
        """
        d = len(self.logp.template.data)
        pilot = self
        if self.step == "nuts":
            pilot = replace(self, step="demetropolisz", options={**DEMETROPOLISZ})
        for attempt in range(1, PILOTS + 1):
            trial = int(np.random.SeedSequence(self.seed, spawn_key=(attempt, 2)).generate_state(1)[0])
            kept = 20 * d
            with Chains(
                pilot.tasks(beginning, trial, 100 * d, 1), self.cores, self.show, self.executor
            ) as pool:
                pool.advance(kept)
            draws, lp = pool.draws(kept), pool.stats(kept)["lp"]
            chain, draw = np.unravel_index(int(np.argmax(lp)), lp.shape)
            best = {rv.name: draws[rv.name][chain, draw] for rv in self.logp.model.free_RVs}
            mode = beginning.mode
            if lp[chain, draw] < mode.logp + 2.0:
                break
            found = search_mode(self.logp, best, seed=self.seed)
            self.show.say(
                f"trial chains {attempt}: from log-posterior {mode.logp:.2f} to {lp[chain, draw]:.2f}, "
                f"mode there {found.logp:.2f}"
            )
            evaluations = mode.evaluations + found.evaluations + sum(state.solves for state in pool.states)
            beginning = disperse(self.logp, replace(found, evaluations=evaluations), self.chains, self.seed)
        return beginning

    def tasks(self, beginning: Start, seed: int, tune: int, thin: int) -> list[Task]:
        """Of all chains."""
        return [
            Task(
                model=self.logp.model,
                chain=chain,
                seed=seed,
                start=start,
                reference=beginning.reference,
                archive=beginning.archive,
                step=self.step,
                options=self.options,
                tune=tune,
                thin=thin,
            )
            for chain, start in enumerate(beginning.starts)
        ]


def _check_model(model: Any) -> None:
    import pymc as pm

    if not isinstance(model, pm.Model):
        raise SamplingError(f"model = {model!r:.80}: give a PyMC model, such as that of zoo.bayesian_model")


def check_settings(
    draws: int = 1,
    tune: int | None = None,
    chains: int = 4,
    cores: int = 1,
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
    if until_ess is not None and not (np.isfinite(until_ess) and until_ess > 0):
        raise SamplingError(f"until_ess = {until_ess}: must be a positive number, such as {ESS_TARGET:.0f}")
    if until_ess is not None and chains < 2:
        raise SamplingError(f"chains = {chains}: until_ess needs R-hat, which needs at least 2 chains; use 4")


def _opening(model: Any, logp: LogPosterior, settings: Mapping[str, Any], run: Run) -> str:
    study = getattr(getattr(model, "zoo", None), "study", None)
    on = f" on {study.name}" if study is not None else ""
    return (
        f"model {model_name(model)}{on}: {len(logp.template.data)} dimensions, {settings['chains']} chains "
        f"of {settings['step']}, tune {settings['tune']}, thin {settings['thin']}, seed {run.seed}"
        f"{run.resumed}"
    )


def _run(model: Any, pool: Chains, draws: int, until_ess: float | None, limit: int) -> int:
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
            checked = model_check(model, made)
            failing -= set(checked.uninformed if checked else ())
        if not failing:
            break
        least = min(min(verdict[name].ess_bulk, verdict[name].ess_tail) for name in failing)
        factor = 1.1 * until_ess / max(np.nan_to_num(least), 1.0)
        kept = min(limit, int(np.ceil(kept * float(np.clip(factor, 1.25, 2.0)))))
        pool.show.say(f"effective sample size {least:.0f} of {until_ess:.0f}: {kept} draws of each chain")
        pool.advance(kept)
    return kept
