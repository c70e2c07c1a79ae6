"""What a posterior predicts: waves in every vessel, and their bands."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from scipy.optimize import elementwise
from scipy.special import ndtr, ndtri

from zoo.blood.case import UNITS
from zoo.blood.network import Network
from zoo.core.arrays import Array
from zoo.core.arviz_lines import InferenceData, dataset, made
from zoo.core.data import squared
from zoo.core.errors.base import ErrorModel
from zoo.core.forward import ForwardModel, Outputs, SolveError
from zoo.core.inference.record import versions
from zoo.core.posterior.comparison import Progress, forward_points, posterior_means, record_of, thin

if TYPE_CHECKING:
    import pymc as pm


PROBABILITIES = (0.5, 0.8, 0.95)


class PredictiveError(ValueError):
    """A prediction that cannot be made; its text says why and what to change."""


# -------------------------------------------------------------------------------------------------
# at the observed series


def predictive_draws(
    model: pm.Model, idata: InferenceData, *, n_draws: int | None = 200
) -> tuple[Array, Array]:
    """Waveforms of posterior draws at the observed series, without and with the model's errors.

    A predicted value is y(t) = m(t) + e(t), with e(t) from the model's own marginal law at each draw: normal
    with the error model's variance.

    Parameters
    ----------
    model : pymc.Model
        With a record (`model.zoo`).
    idata : InferenceData
        Its posterior.
    n_draws : int or None
        Draws of all chains together; None takes all.

    Returns
    -------
    means : array (n_draws, n_series, n_times)
        In the series' own units; draws whose solve fails are left out.
    predictions : array (10 n_draws, n_series, n_times)
        Ten draws of the errors for each.
    """
    record = record_of(model)
    posterior = thin(idata, n_draws)
    means = posterior_means(model, posterior)
    errors = {
        name: posterior[name].transpose("chain", "draw", ...).to_numpy().ravel()
        for name in record.error_parameters
    }
    variance = _variances(record.errors, errors, len(means))
    good = np.isfinite(means).all(axis=(1, 2))
    means, variance = means[good], variance[good]
    noise = np.random.default_rng(0).standard_normal((10, *means.shape))
    predictions = means + np.sqrt(variance) * noise
    return means, predictions.reshape(-1, *means.shape[1:])


def _variances(errors: ErrorModel, parameters: Mapping[str, Array], n_draws: int) -> Array:
    """Marginal variance of the errors at each draw of their parameters, (n_draws, n_series, n_times)."""
    draws = [{name: column[i] for name, column in parameters.items()} for i in range(n_draws)]
    return np.array([errors.variance(values) for values in draws])


# -------------------------------------------------------------------------------------------------
# in every vessel


def vessel_waves(
    model: pm.Model,
    idata: InferenceData,
    *,
    n_draws: int = 200,
    n_times: int = 256,
    positions: Sequence[float] = (0.0, 0.5),
    seed: int = 0,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Pressure, flow and area in every vessel at posterior draws.

    Solved by the forward model of the model's record, with its effects, one by one. As in the paper, the
    root is to be looked at at position 0, where it is observed, and the other vessels midway: `one_place`
    picks these. Times are those of the study's samples, so the convention `sample_lag_beats` is in.

    Parameters
    ----------
    model : pymc.Model
        With a record (`model.zoo`).
    idata : InferenceData
        Its posterior.
    n_draws : int
        Draws of all chains together, evenly spaced; all if there are fewer.
    n_times : int
        Times in the beat, uniform from 0.
    positions : sequence of float
        Along each vessel, 0 inlet to 1 outlet.
    seed : int
        Chooses the first draw.
    progress : callable
        Called with the number of solves done and to do.

    Returns
    -------
    Dataset
        pressure_mmHg, flow_ml_s, area_cm2 (draw, vessel, position, time in s), 32-bit; the parameters of the
        errors (draw), and for each observed quantity Q their variance error_variance_Q (draw, time).
        Coordinates radius_cm and name of each vessel, chain and posterior_draw of each draw. Draws whose
        solve failed are left out; the attribute draws_failed counts them.

    Raises
    ------
    PredictiveError
        If a number is out of range, or no draw solves.
    """
    if n_draws < 1 or n_times < 2:
        raise PredictiveError(f"n_draws = {n_draws}, n_times = {n_times}: give at least 1 draw and 2 times")
    bad = [p for p in positions if not 0 <= p <= 1]
    if bad or not positions:
        raise PredictiveError(f"positions = {tuple(positions)}: give numbers from 0 (inlet) to 1 (outlet)")
    record = record_of(model)
    forward, network = record.forward, _network(record.forward)
    time_s = np.arange(n_times) * network.period_s / n_times
    shape = (len(network.ids), len(positions), len(UNITS), n_times)
    series = tuple((int(v), float(p), q) for v in network.ids for p in positions for q in UNITS)
    picked = _pick(idata, n_draws, seed)
    points, which = np.unique(forward_points(model, picked), axis=0, return_inverse=True)
    waves = np.full((len(points), *shape), np.nan, dtype=np.float32)
    solved = np.zeros(len(points), dtype=bool)
    for i, values in enumerate(_solve_each(forward, points, Outputs(series, time_s))):
        if not isinstance(values, SolveError):
            solved[i], waves[i] = True, values.reshape(shape)
        if progress is not None:
            progress(i + 1, len(points))
    which = which.ravel()
    good = solved[which]
    if not good.any():
        raise PredictiveError(
            f"model {record.name}: none of {len(good)} posterior draws solves: predict with the study and "
            "conventions that the draws were made with"
        )
    dims = ("draw", "vessel", "position", "time")
    kept: dict[str, Any] = {
        name: (dims, waves[which[good], :, :, k], {"units": unit})
        for k, (name, unit) in enumerate(UNITS.items())
    }
    for parameter in record.errors.parameters:
        draws = picked[parameter.name].to_numpy().ravel()[good]
        kept[parameter.name] = ("draw", draws, {"units": parameter.unit})
    drawn = {name: kept[name][1] for name in record.error_parameters}
    for quantity in record.data.rows:
        variances = _variances(record.errors.elsewhere(quantity, time_s), drawn, int(good.sum()))[:, 0]
        name, unit = f"error_variance_{quantity}", squared(UNITS[quantity])
        kept[name] = (("draw", "time"), variances, {"units": unit})
    names = {vessel.id: vessel.name or f"v{vessel.id}" for vessel in record.study.vessels}
    coords: dict[str, Any] = {
        "draw": np.arange(int(good.sum())),
        "chain": ("draw", picked["chain_of"].to_numpy().ravel()[good]),
        "posterior_draw": ("draw", picked["draw_of"].to_numpy().ravel()[good]),
        "vessel": np.asarray(network.ids, dtype=np.int64),
        "radius_cm": ("vessel", np.asarray(network.radius_in_cm), {"units": "cm"}),
        "name": ("vessel", [names[int(v)] for v in network.ids]),
        "position": ("position", np.asarray(positions, dtype=float), {"units": "1"}),
        "time": ("time", time_s, {"units": "s", "long_name": "time in the beat"}),
    }
    attributes = {
        "model": record.name,
        "study": record.study.name,
        "study_checksum": record.study.checksum,
        "error": record.errors.name,
        "root": int(network.ids[int(np.argmin(network.parent))]),
        "seed": seed,
        "draws_failed": int((~good).sum()),
        "solver": json.dumps(dict(record.settings), sort_keys=True),
        "versions": json.dumps(versions(), sort_keys=True),
    }
    return xr.Dataset(kept, coords=coords, attrs=attributes)


def _pick(idata: InferenceData, n_draws: int, seed: int) -> xr.Dataset:
    """Evenly spaced draws of the joined chains from a random first one, as a single chain."""
    posterior = dataset(idata)
    total = posterior.sizes["chain"] * posterior.sizes["draw"]
    n = min(n_draws, total)
    start = np.random.default_rng(seed).random()
    kept = np.floor((np.arange(n) + start) * total / n).astype(int)
    stacked = posterior.stack(joined=("chain", "draw")).isel(joined=kept)
    origin = {f"{name}_of": ("draw", stacked[name].to_numpy()) for name in ("chain", "draw")}
    single = stacked.drop_vars(["joined", "chain", "draw"]).rename(joined="draw").assign(origin)
    return single.expand_dims("chain").transpose("chain", "draw", ...)


def _network(forward: ForwardModel) -> Network:
    """The vessel tree of a model of blood flow, with effects or without."""
    network = getattr(forward, "network", None)
    if not isinstance(network, Network):
        raise PredictiveError(f"{forward.name}: has no vessels; predict with posterior_means")
    return network


def _solve_each(forward: ForwardModel, points: Array, outputs: Outputs) -> Iterator[Array | SolveError]:
    """Series at points (n_points, n_values), or why there are none; in their order, on all cores."""

    def solve(point: Array) -> Array | SolveError:
        try:
            return forward.solve(forward.configure(point), outputs)
        except SolveError as error:
            return error

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        yield from pool.map(solve, points)


def one_place(waves: xr.Dataset) -> xr.Dataset:
    """One position for each vessel: the root's inlet, where it is observed, and midway in the others.

    Parameters
    ----------
    waves : Dataset
        From `vessel_waves` or `bands`, with positions 0 and 0.5.

    Returns
    -------
    Dataset
        Without the dimension position; the coordinate position says which it is for each vessel.

    Raises
    ------
    PredictiveError
        If one of the positions is missing.
    """
    if "position" not in waves.dims:
        return waves
    for wanted in (0.0, 0.5):
        if wanted not in waves["position"]:
            raise PredictiveError(f"waves have no position {wanted}: make them with positions=(0.0, 0.5)")
    vessels = waves["vessel"]
    position = xr.where(vessels == waves.attrs["root"], 0.0, 0.5)
    return waves.sel(position=position)


def median_waves(waves: xr.Dataset) -> xr.Dataset:
    """Posterior median of pressure, flow and area at each time, one place a vessel.

    Parameters
    ----------
    waves : Dataset
        From `vessel_waves`.

    Returns
    -------
    Dataset
        pressure_mmHg, flow_ml_s, area_cm2 (vessel, time).
    """
    found: xr.Dataset = one_place(waves)[list(UNITS)].median("draw", keep_attrs=True)
    return found


def waves_at_medians(model: pm.Model, idata: InferenceData, *, n_times: int = 256) -> xr.Dataset:
    """Pressure, flow and area with every parameter at its posterior median, one place a vessel.

    Unlike pointwise medians these are one solve: pressure and area belong together (figure 9).

    Parameters
    ----------
    model : pymc.Model
        With a record (`model.zoo`).
    idata : InferenceData
        Its posterior.
    n_times : int
        Times in the beat, uniform from 0.

    Returns
    -------
    Dataset
        pressure_mmHg, flow_ml_s, area_cm2 (vessel, time).

    Raises
    ------
    PredictiveError
        If it does not solve.
    """
    median = dataset(idata).median(("chain", "draw")).expand_dims(("chain", "draw"))
    at = median.assign_coords(chain=[0], draw=[0])
    waves = vessel_waves(model, made({"posterior": at}), n_draws=1, n_times=n_times)
    return one_place(waves)[list(UNITS)].isel(draw=0, drop=True)


def bands(
    waves: xr.Dataset, quantity: str, probs: Sequence[float] = PROBABILITIES, *, errors: bool = False
) -> xr.Dataset:
    """Pointwise credible intervals of a quantity, and prediction intervals if asked.

    A credible interval has the quantiles of m_s(t) over the draws s; a prediction interval those of the
    mixture F(y) = mean_s Phi((y - m_s(t))/sd_s(t)), with sd_s(t)^2 the marginal variance of the errors. In
    vessels and at positions without data that
    assumes that their errors would follow the law of the observed ones.

    Parameters
    ----------
    waves : Dataset
        From `vessel_waves` or `one_place`.
    quantity : str
        pressure_mmHg, flow_ml_s or area_cm2.
    probs : sequence of float
        Probabilities of the central intervals, between 0 and 1.
    errors : bool
        Give prediction intervals too; only for a quantity that the study observes.

    Returns
    -------
    Dataset
        median (vessel, position, time); low, high (prob, ...); with errors prediction_low and
        prediction_high (prob, ...).

    Raises
    ------
    PredictiveError
        If the quantity or a probability is unknown, or there are no errors for the quantity.
    """
    if quantity not in UNITS:
        raise PredictiveError(f"quantity = {quantity!r}: must be one of {', '.join(UNITS)}")
    if not probs or not all(0 < p < 1 for p in probs):
        raise PredictiveError(f"probs = {tuple(probs)}: give probabilities between 0 and 1, such as 0.95")
    if errors and f"error_variance_{quantity}" not in waves:
        observed = [str(name).partition("variance_")[2] for name in waves if "variance_" in str(name)]
        raise PredictiveError(
            f"errors of {quantity}: the model has errors of {' and '.join(observed)} only; "
            "ask for errors=False"
        )
    values = waves[quantity].transpose("draw", ..., "time").astype(float)
    inner, shape = values.dims[1:], values.shape[1:]
    tails = np.array([[(1 - p) / 2, (1 + p) / 2] for p in probs])
    low, high = np.moveaxis(np.quantile(values, tails, axis=0), 1, 0)
    found: dict[str, Any] = {
        "median": (inner, np.median(values, axis=0)),
        "low": (("prob", *inner), low),
        "high": (("prob", *inner), high),
    }
    if errors:
        variance = waves[f"error_variance_{quantity}"].to_numpy()
        flat = values.to_numpy().reshape(len(values), -1)
        sd = np.tile(np.sqrt(variance), (1, flat.shape[1] // variance.shape[1]))
        edges = np.array([[_mixture_quantile(flat, sd, p) for p in pair] for pair in tails])
        for name, edge in zip(("prediction_low", "prediction_high"), np.moveaxis(edges, 1, 0), strict=True):
            found[name] = (("prob", *inner), edge.reshape(len(probs), *shape))
    coords = {name: c for name, c in values.coords.items() if "draw" not in c.dims}
    attributes = {**waves.attrs, "quantity": quantity, "units": UNITS[quantity], "draws": len(values)}
    return xr.Dataset(found, coords={**coords, "prob": list(probs)}, attrs=attributes)


def _mixture_quantile(means: Array, sd: Array, p: float) -> Array:
    """Quantile of equal mixtures of normals, means and sd (n_draws, n_points): (n_points,)."""

    def excess(y: Array, i: Array) -> Array:
        return np.asarray(ndtr((y - means[:, i]) / sd[:, i]).mean(axis=0) - p)

    each = means + sd * ndtri(p)  # the mixture's quantile lies between those of its parts
    width = 1e-9 + np.ptp(each, axis=0)
    bracket = (each.min(axis=0) - 1e-3 * width, each.max(axis=0) + 1e-3 * width)
    tolerances = {"xatol": 1e-6, "xrtol": 1e-8, "fatol": 1e-7}
    found = elementwise.find_root(excess, bracket, args=(np.arange(means.shape[1]),), tolerances=tolerances)
    return np.asarray(found.x)
