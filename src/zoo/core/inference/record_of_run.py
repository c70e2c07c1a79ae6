"""The InferenceData and the run record of draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from zoo.core.arviz_lines import InferenceData, dataset, of_draws
from zoo.core.inference.checkpoint import Run
from zoo.core.inference.convergence import check_convergence, ess_to_count
from zoo.core.inference.elements import arrays
from zoo.core.inference.logposterior import LogPosterior, model_name
from zoo.core.inference.prior_check import AtBound, PriorCheck, exactness_at, model_check
from zoo.core.inference.record import RunRecord
from zoo.core.model import record_of

UNKNOWN_SAMPLER = "another sampler"
_WHOLE = {"solves": np.int64, "solver_failures": np.int64, "gradients": np.int64, "diverging": np.bool_}


def inference_data(
    model: Any, draws: Mapping[str, np.ndarray], stats: Mapping[str, np.ndarray]
) -> InferenceData:
    """Draws and statistics (n_chains, n_draws, ...) with the model's dimensions and observed data."""
    from pymc.backends.arviz import find_observations

    groups = {
        "posterior": draws,
        "sample_stats": {n: v.astype(_WHOLE.get(n, v.dtype)) for n, v in stats.items()},
        "observed_data": find_observations(model),
    }
    return of_draws(groups, model.coords, model.named_vars_to_dims)


def attach_record(
    idata: InferenceData,
    logp: LogPosterior,
    run: Run,
    settings: Mapping[str, Any],
    *,
    solves: int,
    steps: int,
    mode_evaluations: int,
    failures: Mapping[str, int],
    at_mode: Sequence[AtBound] = (),
    numerical: str | None = None,
    say: Callable[[str], None],
) -> None:
    """Write the run record into an InferenceData, and tell whether its draws have converged.

    Parameters
    ----------
    idata : InferenceData
        With a posterior.
    logp : LogPosterior
        Of the model.
    run : Run
    settings : mapping
        With "chains", "draws" and "until_ess".
    solves, steps, mode_evaluations, failures
        As of `zoo.core.inference.record.RunRecord`.
    at_mode : sequence of AtBound
        Bounds that the mode lies at.
    numerical : str, optional
        As of `zoo.core.inference.prior_check.exactness_at`; found out in the middle of the draws if absent.
    say : callable
    """
    model, identity, made = logp.model, run.identity, arrays(idata)
    found = model_check(model, made)
    priors = found or PriorCheck()
    leaning = {(one.parameter, one.side) for one in priors.bounds}
    more = tuple(one for one in at_mode if (one.parameter, one.side) not in leaning)
    if numerical is None:
        numerical = exactness_at(model, {name: values.mean((0, 1)) for name, values in made.items()})
    priors = replace(priors, bounds=priors.bounds + more, numerical=numerical)
    RunRecord(
        model=model_name(model),
        study=identity["study"],
        study_checksum=identity["study checksum"],
        conventions=identity["conventions"],
        solver=identity["solver options"],
        settings=dict(settings),
        seed=run.seed,
        solves=solves,
        steps=steps,
        mode_evaluations=mode_evaluations,
        failures=dict(sorted(failures.items())),
        solves_per_draw=solves / (settings["draws"] * settings["chains"]),
        solves_per_step=solves / max(1, steps),
        wall_seconds=run.seconds,
        sittings=run.sittings,
        started=run.started,
        prior_check=priors.as_dict() if found else None,
        priors=identity["priors"],
    ).attach(idata)
    say(check_convergence(made, ess=ess_to_count(settings["until_ess"]), priors=priors).text)


def attach_record_of_draws(idata: InferenceData, model: Any) -> None:
    """Write what is known of draws that another sampler made: the model and its priors, and no run.

    Parameters
    ----------
    idata : InferenceData
        With a posterior.
    model : pm.Model
        With a record.
    """
    ours, draws = record_of(model), dataset(idata)
    source, made = ours.study or ours.data, arrays(idata)
    found = model_check(model, made)
    RunRecord(
        model=ours.name,
        study=source.name if ours.study else "",
        study_checksum=source.checksum,
        conventions=dict(ours.settings.get("conventions", {})),
        solver=dict(ours.settings.get("solver options", {})),
        settings={
            "step": draws.attrs.get("inference_library") or UNKNOWN_SAMPLER,
            "draws": draws.sizes["draw"],
            "chains": draws.sizes["chain"],
        },
        prior_check=found.as_dict() if found else None,
        priors=ours.priors,
    ).attach(idata)
