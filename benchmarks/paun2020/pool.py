"""Posteriors of many data sets of one truth from one pool of solves, by importance sampling."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from benchmarks.paun2020.synthetic import Truth, whitened
from benchmarks.paun2020.truth import SCALES, THETA, score
from numpy.typing import NDArray
from rich.progress import track
from scipy.special import logsumexp
from scipy.stats import multivariate_t

from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import Solver
from zoo.blood.study import Study
from zoo.core.arviz_lines import smoothed
from zoo.core.errors.gaussian_process import NOISE, gp_sequential, neural_network_kernel
from zoo.core.inference.convergence import ESS_TARGET
from zoo.models import model_e

Array = NDArray[np.float64]


BOUNDS = {p.name: p.prior.support for p in (*model_e.BASELINE.parameters, *model_e.ERRORS.parameters)}
"""The box of model E's priors (Table 2); w and b are uniform in their logarithms."""
POOL_DOF = 8.0
POOL_WIDTH = 3.0
"""Covariance of the pool over that of a posterior: truth to centre, and centre to draw, and room."""
K_LIMIT = 0.7
"""Largest Pareto k of importance weights that can be trusted (Vehtari et al. 2024)."""


@dataclass(frozen=True)
class Pool:
    """Points drawn around the truth, and what every data set says about each of them.

    Parameters
    ----------
    theta : array (n, 6)
        f1, f2, f3, psi1, psi2, c.
    eta : array (n, 2)
        log w, log b.
    log_theta, log_eta : array (n,)
        Log-prior minus log-proposal of theta and of eta; -inf outside the priors.
    log_likelihood : array (n, n_data_sets)
        Of each data set at (theta, eta); -inf where the solve failed.
    log_likelihood_at_truth : array (n, n_data_sets)
        The same at (true theta, eta).
    """

    theta: Array
    eta: Array
    log_theta: Array
    log_eta: Array
    log_likelihood: Array
    log_likelihood_at_truth: Array


def fill_pool(
    studies: Sequence[Study],
    truth: Truth,
    n: int,
    *,
    seed: int = 0,
    cores: int = 2,
    progress: bool = False,
) -> Pool:
    """Solve at points around the truth, once for all data sets.

    The logarithms of f3, psi1, psi2, c and those of w, b are drawn from t distributions around the truth with
    three times the covariance that their Fisher information gives, f1 and f2, which the data hardly move,
    from their priors.

    Parameters
    ----------
    studies : sequence of Study
        Data sets of one truth: the same sites, times, vessels and inflow.
    truth : Truth
    n, seed, cores : int
        Points, of the draws, threads.
    progress : bool
        A bar.
    """
    study = studies[0]
    network, unit = Network.from_study(study), study.conventions.stiffness_radius_unit_cm
    solver = Solver.for_study(study)
    times = study.time_s
    data = np.stack([s.values for s in studies])

    def waves(theta: Array) -> Array | None:
        f1, f2, f3, psi1, psi2, c = (float(x) for x in theta)
        chi = stiffness_profile(network.radius_in_cm, f1, f2, f3, unit)
        solution = solver.solve(chi, psi1=psi1, psi2=psi2, c=c, check=False)
        return solution.pressure_mmHg if solution.ok else None

    def terms(means: Array, w: float, b: float) -> Array:
        """Log-likelihood of every data set, (n_data_sets,)."""
        found = gp_sequential((data - means).reshape(-1, len(times)), times, w, b)
        return np.asarray(found.reshape(len(studies), -1).sum(axis=1))

    true = np.array([getattr(truth, name) for name in THETA])
    at_truth = waves(true)
    if at_truth is None:
        raise RuntimeError("the truth does not solve: choose another one")
    rng = np.random.default_rng(seed)
    wave_scale = POOL_WIDTH * _wave_covariance(waves, true, times, truth)
    wave_law = multivariate_t(np.log(true[2:]), wave_scale, df=POOL_DOF)
    error_scale = POOL_WIDTH * _error_parameter_covariance(times, truth, len(study.series))
    error_law = multivariate_t(np.log([truth.w, truth.b]), error_scale, df=POOL_DOF)
    low, high = np.array([BOUNDS[name] for name in THETA]).T
    flat = rng.uniform(low[:2], high[:2], (n, 2))
    logs = wave_law.rvs(n, random_state=rng)
    theta = np.hstack([flat, np.exp(logs)])
    eta = error_law.rvs(n, random_state=rng)
    log_box = -np.log(high[2:] - low[2:]).sum()  # f1 and f2 are drawn from their priors
    inside = np.all((theta > low) & (theta < high), axis=1)
    log_theta = np.where(inside, log_box + logs.sum(axis=1) - wave_law.logpdf(logs), -np.inf)
    eta_low, eta_high = np.log(np.array([BOUNDS["w"], BOUNDS["b"]])).T
    eta_inside = np.all((eta > eta_low) & (eta < eta_high), axis=1)
    log_eta = np.where(eta_inside, -np.log(eta_high - eta_low).sum() - error_law.logpdf(eta), -np.inf)

    def one(i: int) -> tuple[Array, Array]:
        nothing = np.full(len(studies), -np.inf)
        if not eta_inside[i]:
            return nothing, nothing
        w, b = np.exp(eta[i])
        means = waves(theta[i]) if inside[i] else None
        return (nothing if means is None else terms(means, w, b)), terms(at_truth, w, b)

    here, there = np.empty((n, len(studies))), np.empty((n, len(studies)))
    with ThreadPoolExecutor(cores) as threads:
        solved = threads.map(one, range(n))
        for i, found in enumerate(track(solved, "solves", total=n, disable=not progress)):
            here[i], there[i] = found
    return Pool(theta, eta, log_theta, log_eta, here, there)


def _wave_covariance(
    waves: Callable[[Array], Array | None], true: Array, times: Array, truth: Truth
) -> Array:
    """Inverse Fisher information of the logarithms of f3, psi1, psi2, c at the truth: (J' K^-1 J)^-1."""
    columns = []
    for k in range(2, len(true)):
        h, axis = 0.01, np.eye(len(true))[k]
        up, down = (waves(true * np.exp(sign * h * axis)) for sign in (1, -1))
        if up is None or down is None:
            raise RuntimeError(f"{THETA[k]} cannot be moved from the truth: choose another one")
        columns.append(whitened((up - down) / (2 * h), times, truth).ravel())
    jacobian = np.array(columns).T
    return np.asarray(np.linalg.inv(jacobian.T @ jacobian))


def _error_parameter_covariance(times: Array, truth: Truth, n_series: int) -> Array:
    """Inverse Fisher information of log w, log b: I_ij = n/2 tr(K^-1 dK_i K^-1 dK_j)."""
    noise = NOISE * np.eye(len(times))
    inverse = np.linalg.inv(neural_network_kernel(times, truth.w, truth.b) + noise)
    h, moved = 1e-3, []
    for factor in ((np.exp(h), 1.0), (1.0, np.exp(h))):
        up = neural_network_kernel(times, truth.w * factor[0], truth.b * factor[1])
        down = neural_network_kernel(times, truth.w / factor[0], truth.b / factor[1])
        moved.append(inverse @ (up - down) / (2 * h))
    information = [[0.5 * n_series * np.sum(a * b.T) for b in moved] for a in moved]
    return np.asarray(np.linalg.inv(np.array(information)))


def weighted(pool: Pool, data_set: int) -> tuple[dict[str, Array], Array, float]:
    """Draws of the posterior of one data set by parameter, their weights, and the weights' Pareto k.

    References
    ----------
    Vehtari, Simpson, Gelman, Yao and Gabry 2024, Pareto smoothed importance sampling, JMLR 25(72).
    """
    log_weights = pool.log_likelihood[:, data_set] + pool.log_theta + pool.log_eta
    possible = np.isfinite(log_weights)
    smooth, k = smoothed(log_weights[possible])
    weights = np.exp(smooth)
    draws = dict(zip(THETA, pool.theta[possible].T, strict=True))
    draws |= dict(zip(("w", "b"), np.exp(pool.eta[possible].T), strict=True))
    return draws, weights / weights.sum(), k


def score_pool(pool: Pool, truth: Truth, data_set: int) -> dict[str, Any]:
    """What one data set says about the truth, by Pareto-smoothed importance sampling.

    Returns
    -------
    dict
        That of `score`, with converged, ess_min, pareto_k, and joint_direct: p(theta*|y) as the ratio of the
        two integrals of the likelihood, over eta at the truth and over all.
    """
    draws, weights, k = weighted(pool, data_set)
    log_box = sum(np.log(SCALES[name] / (BOUNDS[name][1] - BOUNDS[name][0])) for name in THETA)
    over_eta = logsumexp(pool.log_likelihood_at_truth[:, data_set] + pool.log_eta)
    over_all = logsumexp(pool.log_likelihood[:, data_set] + pool.log_theta + pool.log_eta)
    ess = 1.0 / float(np.sum(weights**2))
    return {
        **score(draws, truth, weights),
        "joint_direct": float(np.exp(log_box + over_eta - over_all)),
        "converged": bool(k <= K_LIMIT and ess >= ESS_TARGET),
        "ess_min": ess,
        "pareto_k": k,
    }
