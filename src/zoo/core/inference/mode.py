"""The mode of a posterior without gradients, and the Gaussian around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pymc as pm
from numpy.typing import ArrayLike

from zoo.core.arrays import Array
from zoo.core.inference.logposterior import LogPosterior, SamplingError, model_name
from zoo.core.inference.newton import Residuals, gauss_newton, least_squares, newton
from zoo.core.model import ModelRecord

LARGE = 100.0
"""Size of an unconstrained coordinate from which it is scaled for the search."""
MANY = 12
"""Dimensions, at most two of the errors, above which a search uses the structure of zoo's models."""
STARTS = 16
"""Prior draws that the search starts from with many parameters; lesser modes are common there."""
FOLLOWED = 4
"""Different modes that are followed to their end."""
NARROW = 0.005
"""Step of differences, in standard deviations of the prior, where data leave far less than the prior."""
KICK = -2.3
"""What is added to one element of a vector in the unconstrained space to leave a lesser mode: a tenth."""


@dataclass(frozen=True)
class Mode:
    """Mode of a posterior in the unconstrained space, with the Gaussian that fits around it.

    Parameters
    ----------
    vector : array (n_dim,)
        The mode, unconstrained; the density includes the Jacobian of the transformations.
    values : dict
        The same point, each free variable in its own unit.
    logp : float
        Log-posterior density there.
    covariance : array (n_dim, n_dim)
        Inverse of the negative second derivatives, from differences over one to two standard deviations.
    evaluations : int
        Evaluations of the log-posterior that the search took.
    """

    vector: Array
    values: dict[str, np.ndarray]
    logp: float
    covariance: Array
    evaluations: int


def find_mode(
    model: Any,
    *,
    start: Mapping[str, ArrayLike] | None = None,
    seed: int = 0,
) -> Mode:
    """Find the mode of a model's posterior without gradients, and the Gaussian around it.

    A derivative-free trust-region search (COBYQA) from the best of the model's initial point and its
    suggested values; if a model of zoo's has more than 12 parameters, at most two of the errors counted,
    then Gauss-Newton steps from there and from 16 draws of the prior, since such posteriors have lesser
    modes, the best 4 followed to their end, and from these ends with each element of a vector lowered in
    turn. Then Newton steps on a quadratic fitted over steps wide enough to lower the log-posterior by about
    one, so that rounding and the tolerance of a solver do not matter. Where these do not settle, as on the
    narrow ridge that a small noise leaves, Gauss-Newton steps go on, and Newton steps once more. With
    errors of any size (`GroupNoise`, `GroupProcess`) all that begins with least squares from the best of 16
    draws of the prior: a process could take the whole signal for error.

    Parameters
    ----------
    model : pymc.Model
        With continuous free variables only.
    start : mapping, optional
        Free variable -> value in its own unit, instead of the suggested values.
    seed : int
        Of the random points that are tried if neither start has a finite log-posterior.

    Returns
    -------
    Mode

    Raises
    ------
    SamplingError
        If no point with a finite log-posterior is found, or `start` names an unknown variable.

    References
    ----------
    Ragonneau, Zhang: COBYQA, https://www.cobyqa.com (doi 10.5281/zenodo.10048050).
    """
    return search_mode(LogPosterior(model), start, seed)


def has_many(logp: LogPosterior) -> bool:
    """Whether there are so many parameters that lesser modes are common; those of errors make few."""
    d, record = len(logp.template.data), getattr(logp.model, "zoo", None)
    if not isinstance(record, ModelRecord):
        return d > MANY
    own = sum(p.size for p in record.errors.parameters)
    return d - own + min(own, 2) > MANY


def search_mode(
    logp: LogPosterior,
    start: Mapping[str, ArrayLike] | None = None,
    seed: int = 0,
) -> Mode:
    """The mode as `find_mode` finds it, of a log-posterior that is there already."""
    from scipy.optimize import minimize

    before = logp.evaluations
    q, best = first_point(logp, start, seed)
    d = len(q)
    worst = [best]

    def cost(x: Array) -> float:
        value = logp(x)
        if not np.isfinite(value):
            return -worst[0] + 10.0 * (
                1.0 + abs(worst[0])
            )  # a wall, finite for the sake of the quadratic model
        worst[0] = min(worst[0], value)
        nonlocal q, best
        if value > best:
            q, best = np.array(x), value
        return -value

    limit = 300 + 60 * d
    frame = None
    structured = isinstance(getattr(logp.model, "zoo", None), ModelRecord)
    many = has_many(logp)
    wide = structured and logp.model.zoo.errors.least_squares_first
    if wide and start is None and not many:
        begin = _prior_points(logp, logp.from_values(_suggested(logp.model)), seed)
        without = least_squares(logp, [point for point, _ in begin])
        if np.isfinite(value := logp(without)):
            q, best, worst = without, value, [value]
    if many and structured:
        begin = [(q, best)] if start is not None else _prior_points(logp, q, seed)
        q, best, frame = _highest(logp, begin, limit)
    else:
        # variables without bounds are not transformed
        scale = np.where(np.abs(q) > LARGE, np.abs(q), 1.0)
        options = {"initial_tr_radius": 0.5, "final_tr_radius": 0.02, "maxfev": limit}
        minimize(lambda x: cost(x * scale), q / scale, method="COBYQA", options=options)
    q, best, covariance, settled = newton(logp, q, best, passes=3 if many else 8, frame=frame)
    if structured and not settled and not many:  # far narrower than the search's steps
        q, best, frame = gauss_newton(logp, q, best, limit=limit, step=NARROW)
        q, best, covariance, _ = newton(logp, q, best, passes=8, frame=frame)
    return Mode(q, logp.to_values(q), best, covariance, logp.evaluations - before)


def first_point(logp: LogPosterior, start: Mapping[str, ArrayLike] | None, seed: int) -> tuple[Array, float]:
    """Where a search begins, (n_dim,), and its log-posterior: of what is given or suggested, or at random."""
    candidates = [logp.vector(logp.initial)]
    if start is not None:
        candidates = [logp.from_values(start)]
    else:
        suggested = _suggested(logp.model)
        if suggested:
            candidates.append(logp.from_values(suggested))
    values = [logp(q) for q in candidates]
    rng = np.random.default_rng(seed)
    tries = 0
    while not np.isfinite(max(values)):
        if tries == 300:
            raise SamplingError(
                f"model {model_name(logp.model)}: no point with a finite log-posterior among {len(values)} "
                "around the initial point; pass start={name: value} with values that the solver can solve"
            )
        tries += 1
        base = candidates[0]
        candidates.append(base + rng.uniform(-1, 1, len(base)) * (0.2 + 2.0 * tries / 300))
        values.append(logp(candidates[-1]))
    index = int(np.argmax(values))
    return candidates[index], values[index]


def _prior_points(logp: LogPosterior, q: Array, seed: int) -> list[tuple[Array, float]]:
    """q (n_dim,) and `STARTS` prior draws with its error parameters, each with its log-posterior."""
    model = logp.model
    values = logp.to_values(q)
    drawn = [rv for rv in model.free_RVs if rv.name not in model.zoo.error_parameters]
    n = 8 * STARTS
    draws = {name: np.broadcast_to(value, (n, *np.shape(value))) for name, value in values.items()}
    for rv, column in zip(drawn, pm.draw(drawn, draws=n, random_seed=seed), strict=True):
        draws[rv.name] = np.reshape(column, draws[rv.name].shape)
    found = [(q, logp(q))]
    with np.errstate(invalid="ignore"):
        points = logp.from_draws(draws)
    for point in points[np.isfinite(points).all(1)]:
        if len(found) > STARTS:
            break
        value = logp(point)
        if np.isfinite(value):
            found.append((point, value))
    return found


def _highest(
    logp: LogPosterior, begin: Sequence[tuple[Array, float]], limit: int
) -> tuple[Array, float, Array]:
    """The highest end of Gauss-Newton searches from several points, and from changes of their ends.

    All searches are begun; the best that lead to different modes are finished. Then each element of the
    vectors, such as a vessel's stiffness, is lowered to a tenth, and the search goes on from there; that is
    repeated at the highest end while it leads higher.
    """
    residuals = Residuals(logp)
    if len(begin) == 1:
        [(q, value)] = begin
        return gauss_newton(logp, q, value, limit=limit, model=residuals)
    short = [gauss_newton(logp, q, value, limit=limit // 3, model=residuals)[:2] for q, value in begin]
    ends = _different(logp, residuals, short, limit, FOLLOWED)
    elements = np.flatnonzero(
        np.concatenate(
            [
                np.full(np.size(logp.initial[v.name]), np.ndim(logp.initial[v.name]) > 0)
                for v in logp.variables
            ]
        )
    )
    best, changed = ends[0], ends
    while changed:
        lower = []
        for q, *_ in changed:
            for k in elements:
                moved = q.copy()
                moved[k] += KICK
                if np.isfinite(value := logp(moved)):
                    lower.append(gauss_newton(logp, moved, value, limit=limit // 8, model=residuals)[:2])
        found = _different(logp, residuals, lower, limit, 2) if lower else []
        changed = [end for end in found if end[1] > best[1] + 1.0][:1]
        best = max(best, *found, key=lambda end: end[1])
    return best


def _different(
    logp: LogPosterior, residuals: Residuals, short: Sequence[tuple[Array, float]], limit: int, most: int
) -> list[tuple[Array, float, Array]]:
    """Ends of the best searches that lead to different modes, highest first."""
    ends: list[tuple[Array, float, Array]] = []
    for q, value in sorted(short, key=lambda end: -end[1])[: 2 * most]:
        end = gauss_newton(logp, q, value, limit=limit, model=residuals)
        if all(abs(end[1] - other[1]) > 1.0 for other in ends):
            ends.append(end)
        if len(ends) == most:
            break
    return sorted(ends, key=lambda end: -end[1])


def _suggested(model: Any) -> dict[str, Any]:
    """Suggested values that belong to free variables of the model."""
    record = getattr(model, "zoo", None)
    values = getattr(record, "suggested", None) or {}
    free = {rv.name for rv in model.free_RVs}
    return {name: value for name, value in dict(values).items() if name in free}
