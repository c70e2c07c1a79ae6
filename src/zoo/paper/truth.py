"""What estimates and draws say about the truth that data were made from: errors and densities."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from zoo.core.draws import evenly
from zoo.core.inference.logposterior import LogPosterior
from zoo.paper.synthetic import Truth

if TYPE_CHECKING:
    import arviz as az

THETA = ("f1", "f2", "f3", "psi1", "psi2", "c")
"""The parameters that the paper compares with the truth, in its order."""
SCALES = {"f1": 1e6, "f2": 100.0, "f3": 1e4, "psi1": 1.0, "psi2": 1.0, "c": 1.0}
"""Units of the joint density, which make all parameters of order one (those of the paper are not told)."""
NARROWER = 0.7
"""Factor on the covariance of the Gaussian in `marginal_density`."""
PAPER_TRUTH = Truth(f1=51.1e5, f2=-171.0, f3=4.32e4, psi1=0.29, psi2=0.87, c=1.34, w=5.39e4, b=138.0)
"""Published medians of model E: "parameter values consistent with the physiological data"."""


def relative_sse(estimate: Mapping[str, float], truth: Mapping[str, float]) -> float:
    """Relative sum of squared errors: sum of ((theta_i - estimate_i)/theta_i)^2, eq. (6.1) of the paper."""
    return float(sum(((value - estimate[name]) / value) ** 2 for name, value in truth.items()))


def kernel_density(draws: ArrayLike, point: ArrayLike, weights: ArrayLike | None = None) -> float:
    """Gaussian kernel density at a point, bandwidth by Silverman's rule.

    Parameters
    ----------
    draws : array (n_dim, n_draws)
    point : array (n_dim,)
    weights : array (n_draws,), optional
        Equal if absent.

    References
    ----------
    Silverman 1986, Density Estimation for Statistics and Data Analysis.
    """
    from scipy.stats import gaussian_kde

    rows = np.atleast_2d(draws)
    if np.any(np.ptp(rows, axis=1) == 0):
        return 0.0
    return float(gaussian_kde(rows, bw_method="silverman", weights=weights)(np.atleast_1d(point))[0])


def marginal_density(
    idata: az.InferenceData, model: Any, truth: Mapping[str, float], *, n_draws: int = 400
) -> float:
    """Joint posterior density of some parameters at a point, all others integrated out.

    The importance-weighted estimator: p(theta*|y) is the mean over draws of
    g(theta_i|eta_i) p(theta*, eta_i|y)/p(theta_i, eta_i|y), g the conditional of a Gaussian fitted to the
    draws in the unconstrained space. It needs one solve, since theta* is the same in all terms.

    Parameters
    ----------
    idata : InferenceData
        Posterior with the log-posterior of each draw (``sample_stats.lp``).
    model : pymc.Model
        What it was drawn from.
    truth : mapping
        theta*: parameter -> value in its unit; all of them scalar.
    n_draws : int
        Evenly spaced draws that are used.

    Returns
    -------
    float
        Per product of the parameters' units.

    References
    ----------
    Chen 1994, doi 10.1080/01621459.1994.10476815.
    """
    from scipy.special import logsumexp
    from scipy.stats import multivariate_normal

    logp = LogPosterior(model)
    names = [rv.name for rv in model.free_RVs]
    posterior = idata["posterior"]
    columns = {name: posterior[name].to_numpy().ravel() for name in names}
    total = len(next(iter(columns.values())))
    kept = evenly(total, n_draws)
    every = logp.from_draws({name: column[kept] for name, column in columns.items()})
    log_density = idata["sample_stats"]["lp"].to_numpy().ravel()[kept]

    inside = np.array([name in truth for name in names])
    theta, eta = np.flatnonzero(inside), np.flatnonzero(~inside)
    shifts = np.array([0.0, 1e-6, -1e-6])
    star = {name: np.full(3, columns[name][0]) for name in names}
    star |= {name: value * (1 + shifts) for name, value in truth.items()}
    at, up, down = logp.from_draws(star)[:, theta]

    mean, covariance = every.mean(axis=0), np.cov(every.T)
    gain = covariance[np.ix_(theta, eta)] @ np.linalg.inv(covariance[np.ix_(eta, eta)])
    rest = covariance[np.ix_(theta, theta)] - gain @ covariance[np.ix_(eta, theta)]
    rest = NARROWER * rest  # where g had the wider tails, the variance would have no bound
    terms = np.empty(len(every))
    for i, point in enumerate(every):
        centre = mean[theta] + gain @ (point[eta] - mean[eta])
        moved = point.copy()
        moved[theta] = at
        guess = multivariate_normal.logpdf(point[theta], centre, rest)
        terms[i] = guess + logp(moved) - log_density[i]
    log_unconstrained = float(logsumexp(terms)) - np.log(len(terms))
    # of the unconstrained coordinates in the parameters' own units, at theta*: each depends on its own alone
    widths = np.array([2e-6 * truth[name] for name in names if name in truth])
    log_jacobian = float(np.log(np.abs((up - down) / widths)).sum())
    return float(np.exp(log_unconstrained + log_jacobian))
