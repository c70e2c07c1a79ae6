"""The model discrepancy: the posterior of truth minus fit, beside noise that is not known exactly."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar
from scipy.special import logsumexp, ndtri_exp

from zoo.core.diagnosis.evidence import Fit, marginal
from zoo.core.diagnosis.hypothesis import ranges
from zoo.core.diagnosis.search import as_matrix
from zoo.core.errors.spectral import GroupErrors
from zoo.core.parameters import log_normal_tails

Array = NDArray[np.float64]

SIZE_PART = 0.05
"""Prior sd of a free discrepancy, as a part of a series' range."""
SIZE_GRID = np.geomspace(2e-3, 20.0, 20)
"""Sizes of a discrepancy that are integrated over, in units of that."""
RATIO_GRID = np.linspace(0.0, 1.0, 7)
"""Sizes of the correlated noise, in parts of the largest."""
CORRELATION_TIME_GRID = np.linspace(-2.0, 2.0, 5)
"""Of the noise's correlation time: in sds of the logarithm from the median."""
SIGMA_RANGE = (-1.0, 0.5)
"""Of the white noise around the fitted one, in the logarithm."""
PRIOR_SMOOTH = 0.5
"""Prior probability that a fit leaves a smooth discrepancy at all."""
TRIES = 20
"""Draws of the parameters among which one inside the bounds is taken."""
SWEEPS = 20
"""Of Gibbs' sampler, where none is."""


@dataclass(frozen=True, eq=False)
class ModelDiscrepancy:
    """Posterior of truth minus fit, as flat coefficients: its mean (n,), and draws (n_draws, n).

    `unabsorbed` is what is left of the draws where the parameters are fitted to data without noise: a
    fit's own error is no part of it, and it is zero where there is no discrepancy.
    """

    mean: Array
    draws: Array
    unabsorbed: Array


def possible_noise(fit: Fit) -> dict[str, list[tuple[float, GroupErrors]]]:
    """Log-priors and values of the noise on a grid of the correlated noise's size and time.

    The white noise's sd, which the high harmonics determine, is fitted at each point where it is not known.

    Parameters
    ----------
    fit : Fit
        Whose residual, beside its own discrepancy, is noise.

    Returns
    -------
    dict of group to list of (log-prior, GroupErrors)
        Without discrepancy; the most probable first.
    """
    H = fit.forward.errors
    T = H.on.duration
    median, spread, top = H.correlation_time
    left = fit.residual - fit.jacobian @ (fit.mean - fit.u)
    found: dict[str, list[tuple[float, GroupErrors]]] = {}
    for q, errors in fit.errors.items():
        power = H.part(left, q) ** 2
        own = H.spectrum(errors, len(power), noise=False)
        ranked: list[tuple[float, float, GroupErrors]] = []
        for ratio, move in product(H.largest_ratio * RATIO_GRID, CORRELATION_TIME_GRID):
            tau = min(median * math.exp(move * spread), top) * T
            e = replace(errors, sigma=1.0, ratio=float(ratio), tau=tau, delta=0.0)
            unit = H.spectrum(e, len(power))

            def cost(x: float, power: Array = power, unit: Array = unit, own: Array = own) -> float:
                S = math.exp(2.0 * x) * unit + own
                return 0.5 * float(np.sum(power / S + np.log(S)))

            centre, log_prior = math.log(errors.sigma), H.noise_log_prior(e)
            if q in H.known:
                ranked.append((log_prior - cost(centre), log_prior, replace(e, sigma=errors.sigma)))
                continue
            best = minimize_scalar(
                cost, bounds=(centre + SIGMA_RANGE[0], centre + SIGMA_RANGE[1]), method="bounded"
            )
            ranked.append((log_prior - best.fun, log_prior, replace(e, sigma=math.exp(best.x))))
        ranked.sort(key=lambda x: -x[0])
        found[q] = [(log_prior, e) for _, log_prior, e in ranked]
    return found


def model_discrepancy(
    fit: Fit,
    noise: Mapping[str, Sequence[tuple[float, GroupErrors]]],
    rng: np.random.Generator,
    n_draws: int,
) -> ModelDiscrepancy:
    """Posterior of truth minus fit: r = J d + s + e, of which J d + s is asked.

    d is the error of the fitted parameters, s a smooth discrepancy (none, by an even chance), e noise.
    Given the noise, and the size and length of s, all are normal, within the bounds of d.

    Parameters
    ----------
    fit : Fit
    noise : mapping of group to sequence of (log-prior, GroupErrors)
        As of `possible_noise`; of the errors only the noise counts.
    rng : Generator
    n_draws : int

    Returns
    -------
    ModelDiscrepancy
    """
    H = fit.forward.errors
    range_of = ranges(H.on)
    _, precision, pull = fit.forward.prior(fit.u)
    shape = (H.on.n_series, H.n)
    # no size is preferred: the grid is even in its logarithm
    kinds = [(math.log(1.0 - PRIOR_SMOOTH), 0.0, H.typical_length)]
    lengths = np.array([H.length_log_prior(length) for length in H.length_grid])
    lengths += math.log(PRIOR_SMOOTH / len(SIZE_GRID)) - logsumexp(lengths)
    for length, log_w in zip(H.length_grid, lengths, strict=True):
        kinds += [(float(log_w), float(size), float(length)) for size in SIZE_GRID]
    own = np.zeros((len(kinds), *shape))
    for q, rows in H.rows.items():
        for i, (_, size, length) in enumerate(kinds):
            e = GroupErrors(0.0, delta=size * SIZE_PART * range_of[q], length=length)
            own[i, rows] = H.spectrum(e, len(rows), noise=False)
    options = {
        q: np.array([H.spectrum(replace(e, delta=0.0), len(H.rows[q])) for _, e in choices])
        for q, choices in noise.items()
    }
    likely = np.empty(shape)
    for q, rows in H.rows.items():
        likely[rows] = options[q][0]
    # the noise of one quantity and the kind of discrepancy together, the others' noise the likeliest
    tables = {}
    for q, rows in H.rows.items():
        S = np.repeat((likely + own)[:, None], len(options[q]), axis=1)
        S[:, :, rows] = own[:, None, rows] + options[q]
        log_z, step, C = marginal(
            fit.residual, fit.jacobian, S.reshape(*S.shape[:2], H.size), precision, pull
        )
        # where a large discrepancy leaves the data no say, most parameters lie outside their bounds
        log_z += fit.forward.log_mass(fit.u + step, C)
        log_w = np.array([w for w, _, _ in kinds])[:, None] + np.array([w for w, _ in noise[q]])
        tables[q] = np.exp(log_w + log_z - logsumexp(log_w + log_z))
    first, *rest = tables
    joint = rng.choice(tables[first].size, n_draws, p=tables[first].ravel())
    chosen, picked = np.divmod(joint, tables[first].shape[1])
    together: dict[tuple[int, ...], list[int]] = {}  # draws of one linear model are made at once
    for i, (kind, option) in enumerate(zip(chosen, picked, strict=True)):
        others = [rng.choice(tables[q].shape[1], p=tables[q][kind] / tables[q][kind].sum()) for q in rest]
        together.setdefault((int(kind), int(option), *others), []).append(i)
    mean, draws, unabsorbed = np.zeros(H.size), np.empty((n_draws, H.size)), np.empty((n_draws, H.size))
    scaled = fit.jacobian / likely.reshape(H.size, 1)
    absorbed = np.linalg.solve(fit.jacobian.T @ scaled + as_matrix(precision), scaled.T)
    low, high = fit.forward.low - fit.u, fit.forward.high - fit.u
    for (kind, *which), members in together.items():
        smooth = own[kind].reshape(H.size)
        total = own[kind].copy()
        for q, option in zip(tables, which, strict=True):
            total[H.rows[q]] += options[q][option]
        total = total.reshape(H.size)
        _, step, C = marginal(fit.residual, fit.jacobian, total, precision, pull)
        d = step + rng.standard_normal((len(members), TRIES, len(step))) @ np.linalg.cholesky(C).T
        inside = np.all((d >= low) & (d <= high), axis=2)
        d = d[np.arange(len(members)), np.argmax(inside, axis=1)]
        if not (kept := inside.any(axis=1)).all():
            d[~kept] = _truncated(d[~kept], step, C, low, high, rng)
        moved = d @ fit.jacobian.T
        gain = smooth / total
        left = np.sqrt(smooth * (1.0 - gain)) * rng.standard_normal(moved.shape)
        smooth_draws = gain * (fit.residual - moved) + left
        draws[members] = moved + smooth_draws
        unabsorbed[members] = smooth_draws - smooth_draws @ absorbed.T @ fit.jacobian.T
        mean += np.sum(moved + gain * (fit.residual - moved), axis=0) / n_draws
    return ModelDiscrepancy(mean, draws, unabsorbed)


def _truncated(
    x: Array, mean: Array, covariance: Array, low: Array, high: Array, rng: np.random.Generator
) -> Array:
    """Draws (n, d) of a normal distribution within bounds, by Gibbs' sampler from the points x (n, d)."""
    precision = np.linalg.inv(covariance)
    x = np.clip(x, low, high)
    for i in SWEEPS * list(range(len(mean))):
        sd = 1.0 / math.sqrt(precision[i, i])
        centre = x[:, i] - sd**2 * ((x - mean) @ precision[i])
        a, b = (low[i] - centre) / sd, (high[i] - centre) / sd
        log_a, log_b = log_normal_tails(a, b)
        u = rng.uniform(size=len(x))
        z = np.where(a > 0, -1.0, 1.0) * ndtri_exp(log_b + np.log(u + (1.0 - u) * np.exp(log_a - log_b)))
        x[:, i] = np.clip(centre + sd * z, low[i], high[i])
    return x


def smooth_part(fit: Fit) -> tuple[Array, Array]:
    """Posterior mean and variance of the discrepancy's coefficients, given the residual: Wiener's filter."""
    H = fit.forward.errors
    total, own = H.variances(fit.errors), H.variances(fit.errors, noise=False)
    gain = own / total
    return gain * fit.residual, own * (1.0 - gain)
