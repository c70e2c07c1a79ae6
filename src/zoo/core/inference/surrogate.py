"""Posteriors by NUTS on a surrogate of the forward model, made exact by the forward model itself."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.draws import seed_or_drawn
from zoo.core.inference.building import (
    JUMP_THIN,
    JUMP_TUNE,
    Builder,
    Built,
    flat_draws,
    missed_words,
    misses_much,
    some_draws,
)
from zoo.core.inference.convergence import check_convergence, ess_to_count
from zoo.core.inference.correction import (
    HamiltonianMoves,
    Weights,
    along_chains,
    delayed_acceptance,
    pareto_weights,
)
from zoo.core.inference.kept_solves import KeptSolves
from zoo.core.inference.logposterior import LogPosterior, SamplingError, model_name
from zoo.core.inference.mode import has_many
from zoo.core.inference.nuts import Draws, nuts
from zoo.core.inference.record_of_run import attach_record, inference_data
from zoo.core.inference.starts import start_settings
from zoo.core.model import record_of
from zoo.core.surrogate.library import Library
from zoo.core.surrogate.model import errors_in_graph
from zoo.core.surrogate.waveform import SurrogateError

if TYPE_CHECKING:
    import arviz as az

Array = NDArray[np.float64]

FINAL_TUNE = 600
"""Steps of NUTS on the last surrogate to adapt, thrown away."""
THIN = 8
"""Draws of NUTS for each one that is solved and stored."""
MOST_DRAWS = 8
"""Limit of the stored draws of each chain, in those of the first check."""
PILOT, PILOTED = 4, 400
"""One draw in so many of a posterior is solved first, and tells whether the others are worth it; all at once
where there are fewer than so many."""
REFITS = 2
"""How often draws whose weights are not trusted join the surrogate's design, before delayed acceptance."""
JUMPS = 100
"""Effective sample size of chains that jump, below which NUTS is tried too, which follows a bend."""
FLATTEST = 0.05
"""Least power of a surrogate's posterior that delayed acceptance moves in."""


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
    checkpoint : path, optional
        Folder for the solves of the run: if it holds some, the run begins again with them, and none is made
        twice. Steps that look for the posterior before the first design are made again.

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
    logp = LogPosterior(model)
    library = Library(record.forward) if library is None else library
    if library.model.key != record.forward.key:
        raise SamplingError(
            f"library: is of {library.model.name} with other settings; give one of this model"
        )
    bent = has_many(logp) and errors_in_graph(record)  # such a posterior has lesser modes too
    before, goal = library.solves, ess_to_count(until_ess)
    tune = FINAL_TUNE if tune is None else tune
    store: KeptSolves | None = None
    if checkpoint is not None:
        fixed = {"step": "surrogate", "tune": tune, "chains": chains, "start": start_settings(start)}
        store = KeptSolves(Path(checkpoint), library, logp, fixed, seed)
        seed = store.seed
    seed = seed_or_drawn(seed)
    with (
        store or contextlib.nullcontext(),
        Display(progress) as show,
    ):
        show.say(
            f"model {model_name(model)}: {len(logp.template.data)} dimensions, {chains} chains of "
            f"{'differential evolution' if bent else 'NUTS'} on a surrogate of {record.forward.name}, "
            f"seed {seed}{'' if store is None else store.text}"
        )
        builder = Builder(logp, library, seed=seed, cores=cores, say=show.say)
        exploring = 0
        if bent:
            with show.during("chains look for the posterior", lambda: f"{logp.evaluations} evaluations"):
                exploring = builder.explore(start, chains)
        built = builder.build(start)
        building = library.solves - before
        limit = max_draws or MOST_DRAWS * draws
        kept, again = draws, 0
        weighed: _Weighed | None = None
        while True:
            weighed = _draw_and_weigh(builder, built, weighed, kept, tune, chains, last=again == REFITS)
            if weighed.bad and again < REFITS:
                again += 1
                weights = weighed.weights
                show.say(
                    f"k-hat {weights.k_hat:.2f} of {weights.smoothed.size} draws of the surrogate"
                    f"{missed_words(weighed.missed)}: they join its design"
                )
                built = builder.again(built, weighed.draws, weighed.weights, weighed.missed)
                weighed = None
                continue
            if misses_much(weighed.missed):
                share = 100 * (weighed.missed or 0.0)
                raise SurrogateError(
                    f"model {model_name(model)}: the surrogate misses at least {share:.0f} % of the "
                    "posterior, which no weights of its draws can mend; sample with method exact"
                )
            result = _corrected(builder, built, weighed)
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
        wall = time.monotonic() - began if store is None else store.seconds
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
                "missed share": weighed.missed,
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
            sittings=1 if store is None else store.sittings,
            say=show.say,
        )
    return idata


@dataclass(frozen=True)
class _Weighed:
    """Draws of a surrogate, variable -> (n_chains, n_draws, ...), and what the forward model says of them.

    Where the first that are solved say that the surrogate is bad, the others are not, and `log_weights` are
    absent.
    """

    draws: Draws
    log_weights: Array | None
    weights: Weights
    missed: float | None
    bad: bool


@dataclass(frozen=True)
class _Corrected:
    """Draws that count: variable -> (n_chains, n_draws, ...), their weights before, and what was done."""

    draws: Draws
    log_weights: Array
    weights: Weights
    correction: str
    words: str
    accepted: Array | None = None


def _draw_and_weigh(
    builder: Builder,
    built: Built,
    before: _Weighed | None,
    kept: int,
    tune: int,
    chains: int,
    *,
    last: bool,
) -> _Weighed:
    """As many draws of each chain as are wanted, those that were solved before among them.

    `last` says that no better surrogate will be made: draws that have bad weights are solved too.
    """
    have = 0 if before is None or before.log_weights is None else before.log_weights.shape[1]
    draws = _drawn(builder, built, kept - have, tune, chains)
    flat = flat_draws(draws)
    log_weights = np.empty(chains * (kept - have))
    first = np.arange(len(log_weights)) % PILOT == 0
    first |= len(log_weights) < PILOTED
    log_weights[first], lacks = builder.compared(built.made, some_draws(flat, first), keep=True)
    if before is None:
        missed = builder.missed(built.made, flat, lacks)
        weights = pareto_weights(log_weights[first][None])
        if misses_much(missed) or not (last or builder.sound(weights)):
            return _Weighed(draws, None, weights, missed, bad=True)
    else:
        missed = before.missed
    log_weights[~first], _ = builder.compared(built.made, some_draws(flat, ~first), keep=True)
    each = log_weights.reshape(chains, -1)
    if before is not None and before.log_weights is not None:
        draws = {n: np.concatenate([before.draws[n], v], axis=1) for n, v in draws.items()}
        each = np.concatenate([before.log_weights, each], axis=1)
    weights = pareto_weights(each)
    return _Weighed(draws, each, weights, missed, bad=not weights.trusted or misses_much(missed))


def _drawn(builder: Builder, built: Built, kept: int, tune: int, chains: int) -> Draws:
    """Chains on the surrogate."""
    seed = int(builder.rng.integers(1 << 31))
    starts = built.starts[np.arange(chains) % len(built.starts)]
    draws, least = None, 0.0
    if builder.bent:
        draws = builder.jumping(built.made, built.covariance, starts, kept, seed)
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
            cores=builder.cores,
            seed=seed,
        )
        builder.gradients += gradients
        thinned = {name: value[:, ::THIN] for name, value in long.items()}
        if draws is None or check_convergence(thinned).min_ess > least:
            draws = thinned
    return draws


def _corrected(builder: Builder, built: Built, weighed: _Weighed) -> _Corrected:
    """Weighed draws resampled along their chains, or where k-hat says no chains of delayed acceptance."""
    draws, log_weights, weights = weighed.draws, weighed.log_weights, weighed.weights
    assert log_weights is not None
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
    flat = flat_draws(draws)
    function = built.made.model.logp_dlogp_function(ravel_inputs=True)
    function.set_extra_values({})

    def surrogate(q: Array) -> tuple[float, Array]:
        value, gradient = function._pytensor_function(q)
        return float(value), np.asarray(gradient)

    some = np.flatnonzero(np.isfinite(log_weights.ravel()))[:: max(1, log_weights.size // 400)]
    vectors = logp.from_draws(some_draws(flat, some))
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
    begin = np.asarray(rng.choice(log_weights.size, chains, p=weights.smoothed.ravel()))
    first = logp.from_draws(some_draws(flat, begin))
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
