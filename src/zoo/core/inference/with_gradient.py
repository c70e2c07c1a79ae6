"""NUTS with a forward model's own derivatives, for models whose every part has a gradient."""

from __future__ import annotations

import time
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from zoo.core.inference.convergence import check_convergence, ess_to_count
from zoo.core.inference.logposterior import LogPosterior, SamplingError, count, model_name
from zoo.core.inference.mode import Mode, search_mode
from zoo.core.inference.nuts import nuts
from zoo.core.inference.record_of_run import attach_record, inference_data
from zoo.core.model import ModelError
from zoo.core.op import MissingGradientError

if TYPE_CHECKING:
    import arviz as az

TUNE = 500


def has_gradient(model: Any) -> bool:
    """Whether the log-posterior of a model can be differentiated."""
    try:
        model.dlogp()
    except (MissingGradientError, NotImplementedError, ModelError):
        return False
    return True


def sample_nuts(
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
    start: Mapping[str, Any] | Mode | None = None,
) -> az.InferenceData:
    """Sample a posterior by NUTS with the model's own gradient; the metric begins at the mode's covariance.

    Parameters
    ----------
    model : pm.Model
    draws, tune, chains, cores, seed, progress, until_ess, max_draws, start
        As of `zoo.core.inference.sampling.sample`; a run that has not `until_ess` is made again with more.

    Returns
    -------
    arviz.InferenceData

    Raises
    ------
    SamplingError
        If the model has no gradient.
    """
    from zoo.core.inference.progress import Display

    if not has_gradient(model):
        raise SamplingError(f"model {model_name(model)}: has no gradient; use method surrogate or exact")
    began, started = time.monotonic(), datetime.now(UTC).isoformat(timespec="seconds")
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else int(seed)
    tune, goal, limit = TUNE if tune is None else tune, ess_to_count(until_ess), max_draws or 8 * draws
    logp = LogPosterior(model)
    with Display(progress, tune=tune, thin=1, cores=cores, ess=until_ess) as show:
        mode = start if isinstance(start, Mode) else search_mode(logp, start, seed=seed)
        rng = np.random.default_rng(seed)
        lower = np.linalg.cholesky(mode.covariance)
        starts = mode.vector + 0.7 * rng.standard_normal((chains, len(mode.vector))) @ lower.T
        names = [rv.name for rv in model.free_RVs]
        values = [logp.to_values(q) for q in starts]
        columns = {name: np.array([each[name] for each in values]) for name in names}
        gradients, kept = 0, draws
        before, _ = count(logp.ops)
        while True:
            made, more = nuts(
                model, names, mode.covariance, starts, columns, draws=kept, tune=tune, cores=1, seed=seed
            )
            gradients += more
            verdict = check_convergence(made, ess=goal)
            if until_ess is None or verdict.passes or kept >= limit:
                break
            kept = min(limit, int(np.ceil(kept * np.clip(1.2 * goal / max(verdict.min_ess, 1.0), 1.3, 3.0))))
        solves, failures = count(logp.ops)
        idata = inference_data(model, made, {})
        settings = {"method": "nuts", "step": "nuts", "tune": tune, "thin": 1, "chains": chains}
        settings |= {"draws": kept, "first check": draws, "until_ess": until_ess, "cores": 1}
        attach_record(
            idata,
            model,
            logp,
            settings | {"gradients": gradients},
            seed=seed,
            solves=solves - before,
            steps=chains * (kept + tune),
            mode_evaluations=mode.evaluations,
            failures=failures,
            wall_seconds=time.monotonic() - began,
            started=started,
            say=show.say,
        )
    return idata
