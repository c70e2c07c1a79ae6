"""An InferenceData with the groups that ArviZ knows, and the units of its variables."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pymc as pm
import xarray as xr

from zoo.core.arviz_lines import InferenceData, dataset, datasets, made
from zoo.core.errors.base import ErrorModel
from zoo.core.inference import methods
from zoo.core.inference.convergence import ESS_TARGET, FIRST_CHECK
from zoo.core.inference.messages import without_messages
from zoo.core.inference.progress import Display
from zoo.core.inference.record import RunRecord
from zoo.core.inference.record_of_run import attach_record_of_draws
from zoo.core.joint import JointRecord, by_subject
from zoo.core.model import ModelRecord, record_of
from zoo.core.parameters import variable_name
from zoo.core.posterior.comparison import error_parameters, posterior_means, thin
from zoo.core.surrogate.library import Library

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from numpy.typing import ArrayLike

    from zoo.core.inference.mode import Mode

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
    predictive draws cost one solve for each of `n_draws` posterior draws, those of the prior one each. Draws
    of another sampler get a record of their model, so that what is saved goes into `zoo compare` and `zoo
    report`.

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
        unit as the attribute "units"; "y" has them as the coordinate "unit" of its series, beside "quantity"
        and the model's places, by which `by_place` takes the series apart.
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
    del groups["log_likelihood"]["y"].attrs["units"]  # a logarithm has none
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
    found = made(groups, idata.attrs)
    if not RunRecord.there(found):
        attach_record_of_draws(found, model)
    return found


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
    places = {name: ("series", list(values)) for name, values in record.places.items()}
    found = found.assign_coords(places).assign_coords(
        series=list(data.labels),
        unit=("series", list(data.units)),
        quantity=("series", list(data.groups)),
        time=("time", np.asarray(data.times), {"units": data.time_unit}),
    )
    found["y"].attrs["units"] = ", ".join(dict.fromkeys(data.units))
    return found


def by_place(idata: InferenceData, group: str = "posterior_predictive") -> xr.Dataset:
    """A group's series by quantity and place, so that they are selected by these: NaN where there is none.

    Parameters
    ----------
    idata : InferenceData
        With the groups of `add_groups`, as sampled or as read from a file.
    group : str
        One with "y": posterior_predictive, log_likelihood, prior_predictive or observed_data.

    Returns
    -------
    Dataset
        A variable for each quantity, such as pressure_mmHg (chain, draw, vessel, position, time), with its
        unit as the attribute "units"; (..., series, time) of a model whose series have no places.

    Raises
    ------
    ValueError
        If there is no such group, or no series by quantity in it.

    Examples
    --------
    >>> waves = by_place(idata)  # doctest: +SKIP
    >>> waves["pressure_mmHg"].sel(vessel=1, position=0.0).median(("chain", "draw"))  # doctest: +SKIP
    """
    there = datasets(idata)
    if group not in there or "quantity" not in there[group].coords:
        raise ValueError(
            f"group = {group!r}: no such group with series by quantity; the groups are {', '.join(there)}; "
            "add them by zoo.add_groups(idata, model)"
        )
    y = there[group]["y"]
    own = {"series", "unit", "quantity"}
    along = [str(name) for name, c in y.coords.items() if c.dims == ("series",)]
    places = [name for name in along if name not in own]
    found = {}
    for quantity in dict.fromkeys(y["quantity"].values.tolist()):
        rows = y.isel(series=np.flatnonzero(y["quantity"].values == quantity))
        units = {} if group == "log_likelihood" else {"units": str(rows["unit"].values[0])}
        if places:
            index = pd.MultiIndex.from_arrays([rows[name].values for name in places], names=places)
            rows = rows.drop_vars(along).assign_coords(xr.Coordinates.from_pandas_multiindex(index, "series"))
            rows = rows.unstack("series").transpose(..., *places, "time")
        found[quantity] = rows.assign_attrs(units)
    return xr.Dataset(found, attrs=there[group].attrs)


def sample(
    model: Any,
    *,
    draws: int | None = None,
    tune: int | None = None,
    chains: int = 4,
    cores: int | None = None,
    method: str = "auto",
    thin: int | None = None,
    seed: int | None = None,
    until_ess: float | None = None,
    max_draws: int | None = None,
    executor: Executor | None = None,
    checkpoint: str | Path | None = None,
    fresh: bool = False,
    start: Mapping[str, ArrayLike] | Mode | None = None,
    step_options: Mapping[str, Any] | None = None,
    library: Library | None = None,
    groups: bool = True,
    progress: bool = True,
) -> InferenceData:
    """Sample a model's posterior, with a process for each chain, and add ArviZ's groups.

    The draws depend on the model, the seed and the settings, not on `cores`, on interruptions or on how long
    anything took. The defaults are those of the command ``zoo sample``.

    Parameters
    ----------
    model : pm.Model
        With continuous free variables only.
    draws : int, optional
        Stored draws of each chain. If absent they go on until `until_ess`, which is then 400 if absent too,
        with a first check after 500.
    tune : int, optional
        Steps of each chain that are thrown away while the step method adapts; if absent 100 for each
        dimension, at least 600; of NUTS 500.
    chains : int
        Fewer than four cannot pass the verdict.
    cores : int, optional
        Processes at work at a time, with one thread each; those of the machine if absent. 0 runs the chains
        in this process, in turns, which starts sooner and suits many short runs.
    method : {"auto", "exact", "nuts", "surrogate"}
        "exact": chains with the forward model itself, without derivatives; "nuts": with its derivatives;
        "surrogate": NUTS on a surrogate, each stored draw corrected with the forward model; "auto" chooses by
        the model.
    thin : int, optional
        Steps for each stored draw; a quarter of the number of dimensions if absent, of NUTS 1.
    seed : int, optional
        Drawn and recorded if absent; a resumed run takes that of its checkpoint.
    until_ess : float, optional
        Keep going until every parameter has R-hat <= 1.01 and bulk and tail effective sample sizes of this
        much, or `max_draws` are reached; the first check is after `draws`.
    max_draws : int, optional
        Limit of the stored draws of each chain; 40 times the first check if absent, of NUTS 8.
    executor : concurrent.futures.Executor, optional
        Runs the chains instead, each as a task; `cores` is not read.
    checkpoint : path, optional
        Folder of the run, which goes on from there.
    fresh : bool
        Begin anew in a checkpoint folder that holds a run.
    start : mapping or Mode, optional
        Values to search the mode from, or the result of `zoo.find_mode`.
    step_options : mapping, optional
        Arguments of the step method instead of the defaults, such as ``{"crank_nicolson": 0}``.
    library : Library, optional
        Solves that a surrogate may take.
    groups : bool
        Add the groups of `zoo.add_groups`; it costs a solve for each of `N_TERMS` draws, but for those that a
        surrogate's correction has solved.
    progress : bool
        Show progress on standard error.

    Returns
    -------
    InferenceData
        posterior, sample_stats, observed_data, and those of `zoo.add_groups`; of a model of several subjects
        the first three, as `zoo.by_subject` gives them.

    Raises
    ------
    SamplingError
        For a setting out of range, a model that cannot be sampled, or a chain that fails.
    CheckpointError
        If the checkpoint belongs to another model, study or settings, or is in use.

    Examples
    --------
    >>> import zoo
    >>> posterior = zoo.sample(zoo.model_A(zoo.load_study("demo")), seed=1)  # doctest: +SKIP

    References
    ----------
    ter Braak, Vrugt (2008), doi 10.1007/s11222-008-9104-9; Hoffman, Gelman (2014), Journal of Machine
    Learning Research 15; Vehtari et al. (2021), doi 10.1214/20-BA1221.
    """
    if draws is None:
        draws, until_ess = FIRST_CHECK, ESS_TARGET if until_ess is None else until_ess
    record = getattr(model, "zoo", None)
    if groups and library is None and isinstance(record, ModelRecord):
        library = Library(record.forward)
    idata = methods.sample(
        model, method=method, checkpoint=checkpoint, fresh=fresh, draws=draws, tune=tune, chains=chains,
        cores=max(1, min(chains, os.cpu_count() or 1)) if cores is None else cores, thin=thin, seed=seed,
        until_ess=until_ess, max_draws=max_draws, executor=executor, start=start, step_options=step_options,
        library=library, progress=progress,
    )  # fmt: skip
    if isinstance(record, JointRecord):
        return by_subject(idata, model)
    if not isinstance(record, ModelRecord):
        return idata
    if not groups:
        found = {name: group.copy() for name, group in datasets(idata).items()}
        return made(found | {"posterior": with_units(found["posterior"], record)}, idata.attrs)
    return add_groups(idata, model, progress=progress, library=library)
