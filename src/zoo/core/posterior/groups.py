"""An InferenceData with the groups that ArviZ knows, and the units of its variables."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
import pymc as pm
import xarray as xr

from zoo.core.arviz_lines import InferenceData, dataset, datasets, made
from zoo.core.errors.base import ErrorModel
from zoo.core.inference import methods, sampling
from zoo.core.inference.messages import without_messages
from zoo.core.inference.progress import Display
from zoo.core.inference.record import RunRecord
from zoo.core.model import ModelRecord, record_of
from zoo.core.parameters import variable_name
from zoo.core.posterior.comparison import error_parameters, posterior_means, thin
from zoo.core.surrogate.library import Library
from zoo.core.words import refuse_unknown

N_TERMS = 1000
"""Posterior draws, of all chains together, in log_likelihood and posterior_predictive."""
N_PRIOR = 200
"""Draws in prior and prior_predictive."""
DIMS = ("series", "time")


def add_groups(
    idata: InferenceData,
    model: pm.Model,
    *,
    n_draws: int | None = N_TERMS,
    n_prior: int = N_PRIOR,
    seed: int | None = None,
    progress: bool = False,
    library: Library | None = None,
) -> InferenceData:
    """Add log_likelihood, posterior_predictive, prior, prior_predictive, data groups and units.

    The log-likelihood is that of the terms log p(y_i | y_<i), whose sum is the joint one. It and the
    predictive draws cost one solve for each of `n_draws` posterior draws, those of the prior one each.

    Parameters
    ----------
    idata : InferenceData
        Posterior of `model`, from `zoo.sample` or ``pm.sample``; left as it is.
    model : pm.Model
        With a record.
    n_draws : int or None
        Posterior draws of all chains together, evenly spaced; None takes all.
    n_prior : int
        Draws of the prior; 0 leaves its groups out.
    seed : int, optional
        Of the errors that are drawn and of the prior; the run's own if absent, else 0.
    progress : bool
        Show a bar on standard error.
    library : Library, optional
        Solves of the model's forward model that are there already.

    Returns
    -------
    InferenceData
        log_likelihood and posterior_predictive have "y" (chain, draw, series, time), float32, with the
        numbers of the posterior draws as coordinate; where a solve fails -inf and NaN. Variables have their
        unit as the attribute "units"; "y" has them as the coordinate "unit" of its series.
    """
    record = record_of(model)
    if seed is None:
        seed = _seed_of(idata)
    kept = thin(idata, n_draws)
    with Display(progress) as shown:
        means = posterior_means(
            model,
            kept,
            progress=lambda done, total: shown("log-likelihood and predictions", done / total),
            library=library,
        )
    values = error_parameters(kept, record)
    terms = record.errors.pointwise(means, values, ("sequential",))["sequential"]
    drawn = _with_errors(record.errors, means, values, np.random.default_rng(seed))
    groups = {name: group.copy() for name, group in datasets(idata).items()}
    groups["log_likelihood"] = _series(terms, kept, record)
    groups["posterior_predictive"] = _series(drawn, kept, record)
    groups["observed_data"] = _described(xr.Dataset({"y": (DIMS, record.data.values)}), record)
    if record.constants:
        used = {d for dims, _, _ in record.constants.values() for d in dims}
        groups["constant_data"] = xr.Dataset(
            {name: (dims, value, {"units": unit}) for name, (dims, value, unit) in record.constants.items()},
            coords={d: np.asarray(c) for d, c in model.coords.items() if d in used and c is not None},
        )
    if n_prior:
        with without_messages("pymc.sampling.forward", logging.WARNING):
            prior = pm.sample_prior_predictive(n_prior, model=model, random_seed=seed)
        groups["prior"] = dataset(prior, "prior")
        groups["prior_predictive"] = _described(dataset(prior, "prior_predictive"), record)
    for name in ("posterior", "prior"):
        if name in groups:
            groups[name] = with_units(groups[name], record)
    return made(groups, idata.attrs)


def with_units(draws: xr.Dataset, record: ModelRecord) -> xr.Dataset:
    """Draws with the unit of each parameter as the attribute "units"."""
    found = draws.copy()
    for p in (*record.forward.parameters, *record.errors.parameters):
        if (name := variable_name(p.name)) in found:
            found[name].attrs["units"] = p.unit
    return found


def _seed_of(idata: InferenceData) -> int:
    try:
        return RunRecord.of(idata).seed
    except ValueError:
        return 0


def _with_errors(
    errors: ErrorModel, means: np.ndarray, values: Mapping[str, np.ndarray], rng: np.random.Generator
) -> np.ndarray:
    """One draw of the errors added to each of the series (n_draws, n_series, n_times); NaN without a law."""
    drawn = np.full(means.shape, np.nan)
    for i, mean in enumerate(means):
        error = errors.draw(rng, {name: column[i] for name, column in values.items()})
        if error is not None:
            drawn[i] = mean + error
    return drawn


def _series(values: np.ndarray, kept: xr.Dataset, record: ModelRecord) -> xr.Dataset:
    """Values (n_chains n_draws, n_series, n_times) as "y" of the posterior draws they belong to."""
    shape = (kept.sizes["chain"], kept.sizes["draw"], *values.shape[1:])
    found = xr.Dataset(
        {"y": (("chain", "draw", *DIMS), values.reshape(shape).astype(np.float32))},
        coords={"chain": kept["chain"], "draw": kept["draw"]},
    )
    return _described(found, record)


def _described(found: xr.Dataset, record: ModelRecord) -> xr.Dataset:
    """A group whose "y" is over series and times: with labels, units and times as coordinates."""
    data = record.data
    found = found.assign_coords(
        series=list(data.labels),
        unit=("series", list(data.units)),
        time=("time", np.asarray(data.times), {"units": data.time_unit}),
    )
    found["y"].attrs["units"] = ", ".join(dict.fromkeys(data.units))
    return found


def sample(model: Any, *, groups: bool = True, progress: bool = True, **settings: Any) -> InferenceData:
    """Sample a model's posterior, as `zoo.core.inference.sampling.sample` does, and add ArviZ's groups.

    Parameters
    ----------
    model : pm.Model
    groups : bool
        Add the groups of `add_groups`; it costs a solve for each of `N_TERMS` draws, but for those that a
        surrogate's correction has solved.
    progress : bool
        Show progress on standard error.
    **settings
        Of `zoo.core.inference.sampling.sample`: draws, tune, chains, cores, step, thin, seed, checkpoint,
        until_ess, max_draws, start and so on. And `method`, "exact" if absent: "nuts", "surrogate" or "auto"
        of `zoo.core.inference.methods.choose`, with `library`, solves that a surrogate may take,
        and `fresh`, to begin anew in a checkpoint folder that holds a run.

    Returns
    -------
    InferenceData
        posterior, sample_stats, observed_data, and those of `add_groups`.

    Raises
    ------
    SamplingError
        For a setting out of range, a model that cannot be sampled, or a chain that fails.
    CheckpointError
        If the checkpoint belongs to another model, study or settings, or is in use.
    TypeError
        For a setting that does not exist.
    """
    own = [*inspect.signature(sampling.sample).parameters, "groups", "method", "library", "fresh"][1:]
    refuse_unknown("sample", settings, own)
    record = getattr(model, "zoo", None)
    if not groups or not isinstance(record, ModelRecord):
        return methods.sample(model, progress=progress, **settings)
    library = settings.pop("library", None)
    if library is None:
        library = Library(record.forward)
    idata = methods.sample(model, progress=progress, library=library, **settings)
    return add_groups(idata, model, progress=progress, library=library)
