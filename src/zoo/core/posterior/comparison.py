"""Which model predicts the measured series best: WAIC, PSIS-LOO, sums of squared errors, in one table."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
import pymc as pm
import xarray as xr
from numpy.typing import ArrayLike
from pymc.stats import compute_log_prior
from scipy.special import logsumexp, ndtr

from zoo.core.arrays import Array
from zoo.core.arviz_lines import (
    InferenceData,
    Score,
    dataset,
    for_plot_compare,
    made,
    power_sensitivity,
    psis_loo,
    ranked,
    waic,
    weights_without,
)
from zoo.core.data import squared
from zoo.core.draws import evenly
from zoo.core.forward import SolveError
from zoo.core.inference.convergence import Verdict, diagnostics
from zoo.core.inference.record import ResultsError
from zoo.core.model import ModelRecord, record_of
from zoo.core.parameters import variable_name
from zoo.core.posterior.belonging import mismatch
from zoo.core.surrogate.library import Library

Progress = Callable[[int, int], None]

N_DRAWS = 1000  # as in the paper
CRITERIA = ("waic", "loo")
SENSITIVE = 0.05
"""Prior sensitivity from which on it is told (Kallioinen et al. 2024, doi 10.1007/s11222-023-10366-5)."""
_DEVIANCE = -2.0


class ComparisonError(ValueError):
    """Models that cannot be compared; its text says why and what to change."""


class OneObservation(NamedTuple):
    """WAIC of a whole series taken as one observation, on the deviance scale."""

    waic: float
    p_waic: float


def waic_one_observation(joint: ArrayLike) -> OneObservation:
    """WAIC with all measured values as a single observation.

    -2 (log mean exp l_s - var l_s), l_s the joint log-likelihood at draw s: one term, so there is no
    standard error.

    Parameters
    ----------
    joint : array (n_draws,)
        Joint log-likelihood at each posterior draw.

    Returns
    -------
    waic : float
        Deviance scale: lower is better.
    p_waic : float
        Effective number of parameters, the variance.

    References
    ----------
    Watanabe 2010; Gelman, Hwang and Vehtari 2014, eq. 12, doi 10.1007/s11222-013-9416-2.
    """
    values = np.asarray(joint, dtype=np.float64).ravel()
    lppd = float(logsumexp(values)) - math.log(len(values))
    p = float(np.var(values, ddof=1))
    return OneObservation(_DEVIANCE * (lppd - p), p)


def thin(idata: InferenceData, n_draws: int | None = N_DRAWS) -> xr.Dataset:
    """Evenly spaced draws of the posterior, as many from each chain.

    Parameters
    ----------
    idata : InferenceData
        With a posterior.
    n_draws : int or None
        Draws of all chains together, rounded up to the same number in each; None takes all.

    Returns
    -------
    Dataset
        Dimensions chain, draw, ...
    """
    posterior = dataset(idata)
    available = posterior.sizes["draw"]
    wanted = available if n_draws is None else math.ceil(n_draws / posterior.sizes["chain"])
    return posterior.isel(draw=evenly(available, wanted))


def _flat(posterior: xr.Dataset, name: str, record: ModelRecord) -> Array:
    """Draws of one parameter, (n_chains n_draws, ...)."""
    if name not in posterior:
        raise ComparisonError(
            f"model {record.name}: no {name!r} in the posterior, which has {', '.join(map(str, posterior))}: "
            "give the draws of this model"
        )
    values = posterior[name].transpose("chain", "draw", ...).to_numpy()
    return np.asarray(values.reshape(-1, *values.shape[2:]), dtype=np.float64)


def error_parameters(posterior: xr.Dataset, record: ModelRecord) -> dict[str, Array]:
    """Draws of the parameters of a model's errors, name -> (n_chains n_draws, ...)."""
    return {name: _flat(posterior, variable_name(name), record) for name in record.errors.parameter_names}


def forward_points(model: pm.Model, posterior: xr.Dataset) -> Array:
    """Parameters of the forward model at each posterior draw.

    Parameters
    ----------
    model : pm.Model
        With a record.
    posterior : Dataset
        Draws of every parameter of the forward model, dimensions chain, draw, ...

    Returns
    -------
    array (n_chains n_draws, n_values)
        For `ForwardModel.configure`; the draws of the first chain stand first.

    Raises
    ------
    ComparisonError
        If a parameter is missing.
    """
    record = record_of(model)
    draws = [_flat(posterior, name, record) for name in record.forward_parameters]
    return np.concatenate([values.reshape(len(values), -1) for values in draws], axis=1)


def posterior_means(
    model: pm.Model,
    posterior: xr.Dataset,
    *,
    progress: Progress | None = None,
    library: Library | None = None,
) -> Array:
    """Series of the forward model at each posterior draw, each distinct draw solved once.

    Parameters
    ----------
    model : pm.Model
        With a record.
    posterior : Dataset
        Draws, dimensions chain, draw, ...
    progress : callable
        Called with the number of solves done and to do.
    library : Library, optional
        Solves of the same forward model that are there already.

    Returns
    -------
    array (n_chains n_draws, n_series, n_times)
        In the series' own units; NaN where a solve failed.
    """
    forward = record_of(model).forward
    points, which = np.unique(forward_points(model, posterior), axis=0, return_inverse=True)
    there = {} if library is None else {theta.tobytes(): i for i, theta in enumerate(library.theta)}

    def solve(point: Array) -> Array:
        if library is not None and (i := there.get(point.tobytes())) is not None:
            return np.asarray(library.series[i])
        try:
            return forward.solve(forward.configure(point))
        except SolveError:
            return np.full(forward.outputs.shape, np.nan)

    means = np.empty((len(points), *forward.outputs.shape))
    with ThreadPoolExecutor(os.cpu_count() if getattr(forward, "threads", False) else 1) as pool:
        for i, mean in enumerate(pool.map(solve, points)):
            means[i] = mean
            if progress is not None:
                progress(i + 1, len(points))
    return np.asarray(means[which.ravel()])


def _solved(
    idata: InferenceData, model: pm.Model, n_draws: int | None
) -> tuple[xr.Dataset, Array, dict[str, Array]]:
    """Thinned draws, `posterior_means` of them, which all solve or it is an error, and `error_parameters`."""
    record, posterior = record_of(model), thin(idata, n_draws)
    means = posterior_means(model, posterior)
    if not np.all(np.isfinite(means)):
        failed = int(np.sum(~np.isfinite(means).all(axis=(1, 2))))
        raise ComparisonError(
            f"model {record.name}: {failed} of {len(means)} posterior draws do not solve: compare "
            "with the data and settings that the draws were made with"
        )
    return posterior, means, error_parameters(posterior, record)


def log_likelihoods(
    idata: InferenceData,
    model: pm.Model,
    *,
    n_draws: int | None = N_DRAWS,
) -> xr.Dataset:
    """Log-likelihood at posterior draws in three decompositions, from one solve a draw.

    Parameters
    ----------
    idata : InferenceData
        Posterior of `model`.
    model : pm.Model
        With a record.
    n_draws : int or None
        See `thin`.

    Returns
    -------
    Dataset
        "sequential", log p(y_i | y_<i), and "leave-one-out", log p(y_i | y_-i), each (chain, draw, series,
        time), NaN where not measured; "joint", log p(y), (chain, draw).

    Raises
    ------
    ComparisonError
        If a solve failed.

    References
    ----------
    Buerkner, Gabry and Vehtari 2021, doi 10.1007/s00180-020-01045-4.
    """
    record = record_of(model)
    posterior, means, errors = _solved(idata, model, n_draws)
    coords: dict[str, Any] = {
        "chain": posterior["chain"].to_numpy(),
        "draw": posterior["draw"].to_numpy(),
        "series": list(record.data.labels),
        "time": np.asarray(record.data.times),
    }
    n_chains, n_kept = posterior.sizes["chain"], posterior.sizes["draw"]
    terms = {}
    for decomposition, values in record.errors.pointwise(means, errors).items():
        if values.ndim > 1:
            values = record.data.filled(values, np.nan)
        dims = ("chain", "draw", "series", "time")[: values.ndim + 1]
        terms[decomposition] = (dims, values.reshape(n_chains, n_kept, *values.shape[1:]))
    return xr.Dataset(terms, coords=coords)


def loo_pit(idata: InferenceData, model: pm.Model, *, n_draws: int | None = N_DRAWS) -> xr.DataArray:
    """Probability that each sample, predicted from all others, stays below what was measured.

    ``PIT_i = P(y <= y_i | y_-i)``, over the draws of the posterior with the Pareto-smoothed weights that it
    has without this sample: even between 0 and 1 for a model that states its errors rightly, gathered in the
    middle where it overstates them, at the ends where it understates them. Of the data's coefficients where
    the errors are described by these.

    Parameters
    ----------
    idata : InferenceData
        Posterior of `model`.
    model : pm.Model
        With a record.
    n_draws : int or None
        See `thin`.

    Returns
    -------
    DataArray (series, time)
        NaN where nothing was measured. Neighbours are correlated, so that bands for independent numbers are
        a little too narrow or too wide.

    Raises
    ------
    ComparisonError
        If a solve failed.

    References
    ----------
    Saeilynoja, Buerkner and Vehtari 2022, doi 10.1007/s11222-022-10090-6; Buerkner, Gabry and Vehtari 2021,
    doi 10.1007/s00180-020-01045-4.
    """
    record = record_of(model)
    posterior, means, errors = _solved(idata, model, n_draws)
    terms = record.errors.pointwise(means, errors, ["leave-one-out"])["leave-one-out"]
    below = np.empty(means.shape)
    for i, mean in enumerate(means):
        values = {name: draws[i] for name, draws in errors.items()}
        z = record.errors.left_out(record.data.values - mean, values)
        if z is None:
            raise ComparisonError(f"model {record.name}: its errors have no law at a draw of the posterior")
        below[i] = ndtr(z)
    kept = posterior[list(record.parameters)]
    weights, _ = weights_without(kept, terms.reshape(len(terms), -1))
    pit = np.sum(np.exp(weights) * below.reshape(len(terms), -1), axis=0)
    coords = {"series": list(record.data.labels), "time": np.asarray(record.data.times)}
    pit = record.data.filled(pit.reshape(means.shape[1:]), np.nan)
    return xr.DataArray(pit, coords, ("series", "time"), name="loo_pit")


class SumOfSquares(NamedTuple):
    """Sum of squared errors at the posterior medians, and its Monte Carlo standard error."""

    value: float
    mcse: float


def sse_at_median(idata: InferenceData, model: pm.Model) -> dict[str, SumOfSquares]:
    """Sum of squared errors of each group of series, with every parameter at its posterior median.

    The paper's "Euclidean distance": the sum over series and times of (y - mean(median))^2. Its error is the
    standard deviation of the sums at the medians of each chain alone, over the root of their number. Groups
    are quantities of different units, so their sums are not added.

    Parameters
    ----------
    idata : InferenceData
        Posterior of `model`.
    model : pm.Model
        With a record.

    Returns
    -------
    dict of group to SumOfSquares
        In the squared unit of the series; NaN when a solve fails, and the error with one chain.
    """
    draws = dataset(idata)
    whole = draws.median(("chain", "draw")).expand_dims(("chain", "draw")).assign_coords(chain=[-1], draw=[0])
    alone = draws.median("draw").expand_dims("draw", axis=1).assign_coords(draw=[0])
    means = posterior_means(model, xr.concat([whole, alone], "chain"))
    data = record_of(model).data
    found = {}
    for group, rows in data.rows.items():
        whole_sum, *sums = (data.filled(data.values - means)[:, rows] ** 2).sum(axis=(1, 2))
        found[group] = SumOfSquares(float(whole_sum), _error_of_mean(sums))
    return found


def _error_of_mean(values: Sequence[float]) -> float:
    """Standard error of the mean of what each chain gives; NaN with one chain."""
    n = len(values)
    return float(np.std(values, ddof=1)) / math.sqrt(n) if n > 1 else math.nan


def compare(
    idatas: Mapping[str, InferenceData],
    models: Mapping[str, pm.Model],
    *,
    ic: Literal["waic", "loo"] = "waic",
    n_draws: int | None = N_DRAWS,
    verdicts: Mapping[str, Verdict] | None = None,
) -> pd.DataFrame:
    """Rank models by how well they predict the measured series, on the deviance scale (lower is better).

    WAIC comes from the sequential terms log p(y_i | y_<i), whose sum is the joint log-likelihood; beside
    it stand WAIC from the leave-one-out terms, WAIC with the whole series as one observation, and PSIS-LOO
    (from the leave-one-out terms, the only ones whose importance weights leave a point out).

    Parameters
    ----------
    idatas : mapping of name to InferenceData
        Posteriors.
    models : mapping of name to pm.Model
        The models they were drawn from, all of one study.
    ic : {"waic", "loo"}
        What ranks, and what differences and weights belong to.
    n_draws : int or None
        Draws of each posterior, see `thin`.
    verdicts : mapping of name to Verdict
        On convergence; made from the whole posteriors when absent.

    Returns
    -------
    DataFrame
        One row a model, the best first. `difference` and `difference_se` are to the best; `standing` says
        what they mean. `waic_warning`: a term's variance exceeds 0.4. `pareto_k_bad`: points where
        PSIS-LOO is not to be trusted, k > min(1 - 1/log10(draws), 0.7). For each group G of series `sse_G` is
        the sum of squared errors at the posterior medians, in the square of the group's unit, and
        `sse_G_mcse` its Monte Carlo standard error; `waic_mcse`, `loo_mcse` and `one_observation_mcse` are
        those of the criteria. All are taken from the values of each chain alone. `at_bounds` warns of
        priors' bounds that the posterior leans on, `uninformed` names parameters whose posterior is like
        their prior, `prior_sensitive` those that move with the power of the priors, and how far
        (`prior_sensitivity`). Beside these stand the columns that ``az.plot_compare`` reads: elpd_diff, se,
        dse, warning, scale, and elpd_waic (or elpd_loo: those of `ic`) on the deviance scale; with ArviZ 1
        elpd, and all of them on the log scale.

    Raises
    ------
    ComparisonError
        If a model is missing, models belong to different studies, a posterior was drawn from another model,
        study, data, conventions or priors than those of the model it is given for, or draws do not solve.

    References
    ----------
    Vehtari, Gelman and Gabry 2017, doi 10.1007/s11222-016-9696-4.
    """
    if ic not in CRITERIA:
        raise ComparisonError(f"ic = {ic!r}: must be one of {', '.join(CRITERIA)}")
    _check_comparable(idatas, models)
    rows: dict[str, dict[str, Any]] = {}
    scores: dict[str, Score] = {}
    for name, idata in idatas.items():
        model = models[name]
        terms = log_likelihoods(idata, model, n_draws=n_draws)
        posterior = thin(idata, n_draws)[list(record_of(model).parameters)]
        sequential = waic(terms["sequential"])
        loo = psis_loo(posterior, terms["leave-one-out"])
        joint = terms["joint"].to_numpy()
        one = waic_one_observation(joint)
        one_of_each = [waic_one_observation(chain).waic for chain in joint]
        chains = [terms.isel(chain=[i]) for i in range(terms.sizes["chain"])]
        waic_of_each = [_DEVIANCE * waic(chain["sequential"]).elpd for chain in chains]
        loo_of_each = [
            _DEVIANCE * psis_loo(posterior.isel(chain=[i]), chain["leave-one-out"]).elpd
            for i, chain in enumerate(chains)
        ]
        squares = sse_at_median(idata, model)
        found = (verdicts or {}).get(name)
        if found is None:
            own = list(record_of(model).parameters)
            found = diagnostics(idata, var_names=own, model=model).verdict
        scores[name] = sequential if ic == "waic" else loo
        rows[name] = {
            "waic": _DEVIANCE * sequential.elpd,
            "waic_se": 2 * sequential.se,
            "waic_mcse": _error_of_mean(waic_of_each),
            "p_waic": sequential.p,
            "waic_warning": sequential.warning,
            "waic_leave_one_out": _DEVIANCE * waic(terms["leave-one-out"]).elpd,
            "waic_one_observation": one.waic,
            "one_observation_mcse": _error_of_mean(one_of_each),
            "p_one_observation": one.p_waic,
            "loo": _DEVIANCE * loo.elpd,
            "loo_se": 2 * loo.se,
            "loo_mcse": _error_of_mean(loo_of_each),
            "p_loo": loo.p,
            "pareto_k_max": float(np.max(loo.pareto_k)),
            "pareto_k_bad": int(np.sum(loo.pareto_k > loo.good_k)),
            **{f"sse_{group}": sums.value for group, sums in squares.items()},
            **{f"sse_{group}_mcse": sums.mcse for group, sums in squares.items()},
            "draws": terms.sizes["chain"] * terms.sizes["draw"],
            "converged": found.passes,
            "rhat_max": found.max_rhat,
            "ess_min": found.min_ess,
            "convergence": found.text,
            "at_bounds": "; ".join(found.bounds),
            "uninformed": ", ".join(found.uninformed),
            "prior_sensitive": _sensitive(posterior, model),
        }
    order = ranked(scores, "stacking")
    table: pd.DataFrame = pd.DataFrame.from_dict(rows, orient="index").loc[order.index]
    table.insert(0, "rank", order["rank"])
    table.insert(1, "difference", 2 * order["elpd_diff"])
    table.insert(2, "difference_se", 2 * order["dse"])
    table.insert(3, "weight", order["weight"])
    standing = [
        "best" if rank == 0 else describe_difference(difference, se)
        for rank, difference, se in zip(
            table["rank"], table["difference"], table["difference_se"], strict=True
        )
    ]
    table.insert(4, "standing", standing)
    table = table.assign(**for_plot_compare(order, ic))
    table.index.name = "model"
    data = record_of(models[next(iter(idatas))]).data
    table.attrs["checksum"] = data.checksum
    table.attrs["terms"] = {name: score.terms.tolist() for name, score in scores.items()}
    sums = {f"sse_{group}": squared(data.unit(group)) for group in data.rows}
    table.attrs.update({"ic": ic, "scale": "deviance", "sums_of_squares": sums})
    return table


def prior_sensitivity(posterior: xr.Dataset, model: pm.Model) -> dict[str, float]:
    """How far each parameter's posterior moves with the power of all priors; above 0.05 it does visibly.

    Parameters
    ----------
    posterior : Dataset
        Draws of every parameter, dimensions chain, draw, ...
    model : pm.Model

    Returns
    -------
    dict
        Parameter -> `zoo.core.arviz_lines.power_sensitivity`.
    """
    with model:
        found = compute_log_prior(
            made({"posterior": posterior}),
            extend_inferencedata=False,
            progressbar=False,
            compile_kwargs={"mode": "FAST_COMPILE"},  # compiled code would take longer to load than this
        )
    each = found.data_vars.values()
    log_prior = sum(x.sum([d for d in x.dims if d not in ("chain", "draw")]) for x in each)
    return power_sensitivity(posterior, log_prior.transpose("chain", "draw").to_numpy())


def describe_difference(difference: float, se: float) -> str:
    """What a difference to the best model means, given its standard error.

    Parameters
    ----------
    difference : float
        Deviance scale, not negative.
    se : float
        Its standard error.

    Returns
    -------
    str
        "within its SE of the best", or by how many standard errors it is behind.
    """
    if difference <= se:
        return "within its SE of the best"
    if se == 0:
        return "behind the best"
    return f"{difference / se:.1f} SE behind the best"


def _sensitive(posterior: xr.Dataset, model: pm.Model) -> str:
    moved = prior_sensitivity(posterior, model)
    return ", ".join(f"{name} ({x:.2f})" for name, x in moved.items() if x > SENSITIVE)


def _wrong(idata: InferenceData, model: pm.Model) -> str | None:
    """What a posterior has otherwise than its model; draws of others than `zoo.sample` have no record."""
    try:
        return mismatch(idata, model)
    except ResultsError:
        return None


def _check_comparable(idatas: Mapping[str, InferenceData], models: Mapping[str, pm.Model]) -> None:
    if not idatas:
        raise ComparisonError("no posteriors: give at least one")
    first: ModelRecord | None = None
    for name in idatas:
        if name not in models:
            raise ComparisonError(f"posterior {name!r}: no model of that name among {', '.join(models)}")
        record = record_of(models[name])
        first = first or record
        if wrong := _wrong(idatas[name], models[name]):
            raise ComparisonError(f"posterior {name!r}: {wrong}; sample again, or give the one that belongs")
        if not np.array_equal(record.data.values, first.data.values, equal_nan=True):
            raise ComparisonError(
                f"model {name}: was fitted to {record.data.name!r}, the first to "
                f"{first.data.name!r} with other values: compare models of the same observations"
            )
