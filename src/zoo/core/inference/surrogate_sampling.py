"""Posteriors by NUTS on a surrogate of the forward model, made exact by the forward model itself."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from zoo.core.arrays import Array
from zoo.core.arviz_lines import InferenceData
from zoo.core.inference.building import Builder, Weighed
from zoo.core.inference.checkpoint import Run
from zoo.core.inference.convergence import check_convergence, ess_to_count
from zoo.core.inference.correction import along_chains
from zoo.core.inference.kept_solves import kept
from zoo.core.inference.logposterior import LogPosterior, SamplingError, model_name
from zoo.core.inference.nuts import Draws
from zoo.core.inference.progress import Display
from zoo.core.inference.record_of_run import attach_record, inference_data
from zoo.core.inference.starts import start_settings
from zoo.core.model import record_of
from zoo.core.surrogate.library import Library
from zoo.core.surrogate.waveform import SurrogateError

ROUNDS = 8
"""Surrogates that are made at most."""
ROUND_DRAWS, ROUND_TUNE, ROUND_THIN = 40, 400, 4
"""Draws of each chain that are solved to see what a surrogate is worth, steps of NUTS before and for each."""
ENOUGH, TAIL = 0.6, 0.5
"""Effective share of those draws, and their k-hat, with which a surrogate is sampled: few draws make both
uncertain, and another round costs less than draws whose weights are not trusted."""
FINAL_TUNE = 600
"""Steps of NUTS on the last surrogate to adapt, thrown away."""
THIN = 8
"""Draws of NUTS for each one that is solved and stored."""
MOST_DRAWS = 8
"""Limit of the stored draws of each chain, in those of the first check."""
PILOT, PILOTED = 4, 400
"""One draw in so many of a posterior is solved first, and tells whether the others are worth it; all at once
where there are fewer than so many."""


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
    checkpoint: str | Path | None = None,
) -> InferenceData:
    """Sample a posterior by NUTS on a surrogate of the forward model, and make its draws exact.

    A surrogate is built around the posterior (`Builder`). Every stored draw of NUTS is then solved with the
    forward model itself, and weighed by the exact likelihood over the surrogate's to a power. With k-hat up
    to 0.7 the draws are resampled by their smoothed weights, along each chain; else they join the solves that
    the next surrogate is made of. Effective sample sizes and R-hat are those of the draws after that.

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
    checkpoint : path, optional
        Folder for the solves of the run: if it holds some, the run begins again with them, and none is made
        twice. Steps that look for the posterior before the first design are made again.

    Returns
    -------
    InferenceData
        As of `sample`; sample_stats also has log_weight of each stored draw. The run record's settings tell
        how many solves there were, k-hat, the effective and the missed share and each round.

    Raises
    ------
    SamplingError
        If the posterior cannot be found.
    zoo.core.surrogate.waveform.SurrogateError
        If the error model or the forward model does not allow a surrogate, or none was found that its draws
        can be weighed of.

    References
    ----------
    Vehtari et al. (2024), Journal of Machine Learning Research 25(72).
    """
    record = record_of(model)
    logp = LogPosterior(model)
    library = Library(record.forward) if library is None else library
    if library.model.key != record.forward.key:
        raise SamplingError(
            f"library: is of {library.model.name} with other settings; give one of this model"
        )
    tune = FINAL_TUNE if tune is None else tune
    limit = max_draws or MOST_DRAWS * draws
    fixed = {"step": "surrogate", "tune": tune, "chains": chains, "start": start_settings(start)}
    run = Run(checkpoint, logp, fixed, seed)
    before, probed = library.solves, logp.evaluations
    with (
        contextlib.closing(run),
        kept(run, library),
        Display(progress) as show,
        warnings.catch_warnings(),
    ):
        # of PyMC 6, of a surrogate with many terms, which is computed all the same
        warnings.filterwarnings("ignore", "Loop fusion failed", UserWarning)
        show.say(
            f"model {model_name(model)}: {len(logp.template.data)} dimensions, {chains} chains of NUTS on a "
            f"surrogate of {record.forward.name}, seed {run.seed}{run.resumed}"
        )
        builder = Builder(logp, library, start, seed=run.seed, chains=chains, cores=cores)
        rounds: list[dict[str, Any]] = []
        for turn in range(1, ROUNDS + 1):
            surrogate, made = builder.surrogate()
            weighed = builder.look(made, ROUND_DRAWS, ROUND_TUNE, ROUND_THIN)
            error = float(np.sqrt(surrogate.map.left_out))
            figures = {"points": len(surrogate.map.points), "basis": len(surrogate.basis), "error": error}
            rounds.append(figures | _figures(weighed))
            show.say(
                f"surrogate {turn}: {len(surrogate.map.points)} solves, {len(surrogate.basis)} components, "
                f"error {error:.2g} of the noise; {weighed.text}"
            )
            weights = weighed.weights
            enough = weighed.trusted and weights.effective >= ENOUGH and weights.k_hat <= TAIL
            if not enough and turn < ROUNDS:
                builder.solve(builder.theta[ROUND_THIN // 2 :: ROUND_THIN])
                continue
            weighed = _sampled(builder, made, draws, tune, until_ess, limit, show.say)
            show.say(weighed.text)
            if weighed.trusted:
                break
        else:
            raise SurrogateError(
                f"model {model_name(model)}: no weights make the draws of a surrogate exact: {weighed.text}; "
                "sample with method exact"
            )
        corrected, log_weights = _resampled(weighed, builder.seed)
        stats = {"log_weight": log_weights, "solves": np.ones(log_weights.shape, dtype=np.int64)}
        idata = inference_data(model, corrected, stats)
        solves = library.solves - before
        settings = {
            "method": "surrogate",
            "step": "nuts",
            "tune": tune,
            "thin": THIN,
            "chains": chains,
            "draws": log_weights.shape[1],
            "first check": draws,
            "until_ess": until_ess,
            "cores": cores,
            "surrogate": {
                "building solves": solves - log_weights.size,
                "correction solves": log_weights.size,
                "correction": "importance resampling",
                "power": builder.power,
                "rounds": rounds,
            }
            | _figures(weighed),
        }
        attach_record(
            idata,
            logp,
            run,
            settings,
            solves=solves,
            steps=log_weights.size,
            mode_evaluations=logp.evaluations - probed,
            failures=library.failures,
            say=show.say,
        )
    return idata


def _figures(weighed: Weighed) -> dict[str, float]:
    """What draws say of their surrogate, for the record."""
    weights = weighed.weights
    return {"k_hat": weights.k_hat, "effective share": weights.effective, "missed share": weighed.missed}


def _sampled(
    builder: Builder,
    made: Any,
    draws: int,
    tune: int,
    until_ess: float | None,
    limit: int,
    say: Callable[[str], None],
) -> Weighed:
    """As many draws of each chain as are wanted, or fewer if these cannot be made exact."""
    first = draws if draws * builder.chains < PILOTED else max(1, draws // PILOT)
    weighed = builder.look(made, first, tune, THIN)
    goal, wanted = ess_to_count(until_ess), draws
    while weighed.trusted:
        have = weighed.log_weights.shape[1]
        if have >= wanted:
            verdict = check_convergence(_resampled(weighed, builder.seed)[0], ess=goal)
            if until_ess is None or verdict.passes or have >= limit:
                break
            least = max(verdict.min_ess, 1.0)
            wanted = min(limit, int(np.ceil(have * float(np.clip(1.2 * goal / least, 1.3, 3.0)))))
            say(f"effective sample size {least:.0f} of {goal:.0f}: {wanted} draws of each chain")
        weighed = weighed.more(builder.look(made, wanted - have, tune, THIN, beyond=False))
    return weighed


def _resampled(weighed: Weighed, seed: int) -> tuple[Draws, Array]:
    """Weighed draws resampled along their chains, and their log weights (n_chains, n_draws) before."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(6,)))
    index = along_chains(weighed.weights.smoothed, rng)
    chain = np.arange(len(index))[:, None]
    draws = {name: value[chain, index] for name, value in weighed.draws.items()}
    return draws, weighed.log_weights[chain, index]
