"""ArviZ 0.23, which goes with PyMC 5, and ArviZ 1, with PyMC 6, as one. Nothing else asks which it is.

A posterior is an InferenceData with the former, and an `xarray.DataTree` with the latter.
"""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import version
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from zoo.core.arrays import Array

InferenceData: TypeAlias = Any
"""What the ArviZ that is installed takes: an InferenceData, or a DataTree."""

ARVIZ_1 = not version("arviz").startswith("0.")
_VARIANCE = 0.4
"""Of a term over the posterior, from which on WAIC may fail (Vehtari et al. 2017)."""


def _arviz(part: str = "arviz") -> Any:
    """ArviZ or one of its parts: loaded when it is asked for, and of either line for whoever checks types."""
    return import_module(part)


def made(groups: Mapping[str, xr.Dataset], attrs: Mapping[str, Any] | None = None) -> InferenceData:
    """An InferenceData or a DataTree of groups."""
    if ARVIZ_1:
        return xr.DataTree.from_dict({"/": xr.Dataset(attrs=attrs), **groups})
    return _arviz().InferenceData(attrs=None if attrs is None else dict(attrs), **groups)


def of_draws(
    groups: Mapping[str, Mapping[str, Any]],
    coords: Mapping[str, Any] | None = None,
    dims: Mapping[str, Sequence[str]] | None = None,
) -> InferenceData:
    """The same of arrays: group -> variable -> values, draws as (n_chains, n_draws, ...)."""
    filled = {group: dict(content) for group, content in groups.items() if content}
    settings = {
        "coords": {name: np.asarray(values) for name, values in (coords or {}).items() if values is not None},
        "dims": {name: list(names) for name, names in (dims or {}).items()},
    }
    return _arviz().from_dict(filled, **settings) if ARVIZ_1 else _arviz().from_dict(**filled, **settings)


def datasets(idata: InferenceData) -> dict[str, xr.Dataset]:
    """Every group, by its name."""
    if isinstance(idata, xr.DataTree):
        return {name: node.to_dataset() for name, node in idata.children.items()}
    return {name: idata[name] for name in idata.groups()}


def dataset(idata: InferenceData, group: str = "posterior") -> xr.Dataset:
    """One group."""
    found = idata[group]
    return found.to_dataset() if isinstance(found, xr.DataTree) else found


def read(source: io.BytesIO) -> InferenceData:
    """What a NetCDF file of either line holds, in memory."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with xr.open_datatree(source, engine="h5netcdf") as opened:
            tree = opened.load()
    return made(datasets(tree), {str(name): value for name, value in tree.attrs.items()})


def netcdf_bytes(idata: InferenceData) -> memoryview:
    """The NetCDF file, compressed as ArviZ does it, for the ``arviz.from_netcdf`` of both lines to read."""
    groups = {f"/{name}": group for name, group in datasets(idata).items()}
    packed = {
        place: {
            name: {"zlib": True} for name, values in group.variables.items() if values.dtype.kind in "biufc"
        }
        for place, group in groups.items()
    }
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs=idata.attrs), **groups})
    return tree.to_netcdf(engine="h5netcdf", encoding=packed)


def split_rhat(draws: Array) -> float:
    """Rank-normalised split R-hat of draws (n_chains, n_draws)."""
    with np.errstate(divide="ignore", invalid="ignore"):  # of chains that stay where they are
        return float(_arviz().rhat(draws))


def effective(draws: Array, method: str = "bulk") -> float:
    """Effective sample size of draws (n_chains, n_draws): "bulk", or "tail", of quantiles 0.05 and 0.95."""
    prob = {"prob": (0.05, 0.95)} if method == "tail" else {}
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(_arviz().ess(draws, method=method, **prob))


def smoothed(log_weights: Array, efficiency: float = 1.0) -> tuple[Array, float]:
    """Pareto-smoothed logarithms of importance weights (n,), normalised, and their k-hat.

    The efficiency is the effective share of the draws. With too few weights for a tail, or a tail of equal
    ones, they are left as they are, and k-hat is infinite.
    """
    if not ARVIZ_1:
        weights, k = _arviz().psislw(log_weights.copy(), efficiency)
        return np.asarray(weights), float(k)
    try:  # of log-likelihoods, which are less the logarithms of the weights
        weights, k = _arviz("arviz_stats.base").array_stats.psislw(-log_weights, efficiency)
    except ValueError:
        weights, k = log_weights - logsumexp(log_weights), math.inf
    return np.asarray(weights), float(k)


@dataclass(frozen=True)
class Score:
    """Expected log predictive density of a model, by WAIC or PSIS-LOO.

    Attributes
    ----------
    elpd, se, p : float
        The sum of the terms, its standard error, and the effective number of parameters.
    terms : array (n,)
        Of the observations.
    draws : int
    warning : bool
        Whether the variance of a term exceeds 0.4, or a Pareto k its limit `good_k`.
    pareto_k : array (n,)
        NaN with WAIC.
    """

    elpd: float
    se: float
    p: float
    terms: Array
    draws: int
    warning: bool
    pareto_k: Array
    good_k: float = math.nan


def _score(terms: Array, lppd: Array, draws: int, **rest: Any) -> Score:
    """A score whose effective number of parameters is what the terms are below log mean p(y_i | s)."""
    elpd = float(np.sum(terms))
    se = math.sqrt(len(terms) * float(np.var(terms)))
    return Score(elpd=elpd, se=se, p=float(np.sum(lppd - terms)), terms=terms, draws=draws, **rest)


def _draws_of_terms(log_likelihood: ArrayLike) -> tuple[Array, Array]:
    """(n_chains, n_draws, ...) as (n, n_observations), and log mean p(y_i | s) of each observation."""
    values = np.asarray(log_likelihood, dtype=np.float64)
    values = values.reshape(values.shape[0] * values.shape[1], -1)
    values = values[:, ~np.isnan(values).all(axis=0)]  # where nothing was measured
    return values, logsumexp(values, axis=0) - math.log(len(values))


def waic(log_likelihood: ArrayLike) -> Score:
    """WAIC of the log-likelihood of each observation: sum_i (log mean_s p(y_i | s) - var_s log p(y_i | s)).

    Parameters
    ----------
    log_likelihood : array (n_chains, n_draws, ...)

    References
    ----------
    Watanabe 2010; Vehtari, Gelman and Gabry 2017, doi 10.1007/s11222-016-9696-4.
    """
    values, lppd = _draws_of_terms(log_likelihood)
    variances = np.var(values, axis=0)
    none = np.full(len(lppd), np.nan)
    doubtful = bool(np.any(variances > _VARIANCE))
    return _score(lppd - variances, lppd, len(values), warning=doubtful, pareto_k=none)


def weights_without(posterior: xr.Dataset, terms: Array) -> tuple[Array, Array]:
    """Logarithms of each draw's weight in the posterior without an observation, and the k-hat of each.

    Both of the terms (n, n_observations) given all other observations; the draws' efficiency is the
    posterior's.
    """
    efficiency = 1.0
    if posterior.sizes["chain"] > 1:
        sizes = _arviz().ess(posterior, method="mean")
        found = np.concatenate([np.ravel(size) for size in sizes.data_vars.values()])
        efficiency = float(found.mean()) / len(terms)
    weights, k = zip(*(smoothed(-column, efficiency) for column in terms.T), strict=True)
    return np.column_stack(weights), np.array(k)


def psis_loo(posterior: xr.Dataset, log_likelihood: ArrayLike) -> Score:
    """PSIS-LOO of the log-likelihood of each observation; the posterior tells what its draws are worth.

    Parameters
    ----------
    posterior : Dataset
    log_likelihood : array (n_chains, n_draws, ...)

    References
    ----------
    Vehtari, Simpson, Gelman, Yao, Gabry (2024), Journal of Machine Learning Research 25(72).
    """
    values, lppd = _draws_of_terms(log_likelihood)
    n = len(values)
    weights, k = weights_without(posterior, values)
    terms, good_k = logsumexp(weights + values, axis=0), min(1 - 1 / math.log10(n), 0.7)
    return _score(terms, lppd, n, warning=bool(np.any(k > good_k)), pareto_k=k, good_k=good_k)


def power_sensitivity(posterior: xr.Dataset, log_prior: ArrayLike) -> dict[str, float]:
    """How far each parameter's posterior moves with the power of the prior, elements together.

    The cumulative Jensen-Shannon distance by which it moves when the prior is taken to a power near 1, over
    the change of the power's logarithm to base 2; by importance weights of the draws.

    Parameters
    ----------
    posterior : Dataset
    log_prior : array (n_chains, n_draws)

    Returns
    -------
    dict
        Parameter -> the largest of its elements.

    References
    ----------
    Kallioinen, Paananen, Buerkner and Vehtari 2024, doi 10.1007/s11222-023-10366-5.
    """
    values = np.asarray(log_prior, dtype=np.float64)
    if np.ptp(values) == 0.0:  # flat: ArviZ 1 finds no tail in its weights
        return dict.fromkeys(map(str, posterior.data_vars), 0.0)
    prior = xr.Dataset({"prior": (("chain", "draw"), values)}).assign_coords(posterior.coords)
    both = made({"posterior": posterior, "log_prior": prior})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = _arviz("arviz_stats").psense(both) if ARVIZ_1 else _arviz().psens(both)
    found = found if isinstance(found, xr.Dataset) else dataset(found)
    return {str(name): float(np.max(found[name])) for name in posterior.data_vars}


def ranked(scores: Mapping[str, Score], method: str) -> pd.DataFrame:
    """Models by their score, the best first, by ``arviz.compare``, on the log scale.

    Parameters
    ----------
    scores : mapping of model to Score
    method : str
        Of the weights: "stacking", "pseudo-BMA" or "BB-pseudo-BMA".

    Returns
    -------
    DataFrame
        rank, elpd, p, se, warning; elpd_diff, how far below the best, and dse, its error; weight.
    """
    # only differences of terms count: without the best of each, exp(terms) underflows in the weights
    best = np.max([score.terms for score in scores.values()], axis=0)
    given = {name: _elpd(score, score.terms - best) for name, score in scores.items()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the scores warn of already
        if ARVIZ_1:
            table: pd.DataFrame = _arviz().compare(given, method=method, round_to="none")
        else:
            table = _arviz().compare(given, ic="waic", method=method, scale="log")
            table = table.rename(columns={"elpd_waic": "elpd", "p_waic": "p"})
    table["elpd_diff"] = table["elpd_diff"].abs()
    table["warning"] = [scores[str(name)].warning for name in table.index]
    return table[["rank", "elpd", "p", "elpd_diff", "weight", "se", "dse", "warning"]].astype({"rank": int})


def _elpd(score: Score, terms: Array) -> Any:
    """A score as ArviZ's ELPDData, with other terms."""
    given: dict[str, Any] = {
        "se": score.se,
        "n_samples": score.draws,
        "n_data_points": len(terms),
        "warning": score.warning,
    }
    given |= {"scale": "log", "good_k": score.good_k}
    own = xr.DataArray(terms, dims="observation")
    if ARVIZ_1:
        return _arviz("arviz_stats.utils").ELPDData(elpd=score.elpd, p=score.p, elpd_i=own, **given)
    given = {"elpd_waic": score.elpd, "p_waic": score.p, "waic_i": own, **given}
    return _arviz("arviz.stats.stats_utils").ELPDData(data=list(given.values()), index=list(given))


def for_plot_compare(table: pd.DataFrame, ic: str) -> dict[str, Any]:
    """The columns of `ranked` that ``plot_compare`` reads: as deviances that of ArviZ 0.23."""
    factor, elpd, scale = (1, "elpd", "log") if ARVIZ_1 else (-2, f"elpd_{ic}", "deviance")
    return {
        elpd: factor * table["elpd"],
        "elpd_diff": -factor * table["elpd_diff"],
        "se": abs(factor) * table["se"],
        "dse": abs(factor) * table["dse"],
        "warning": table["warning"],
        "scale": scale,
    }
