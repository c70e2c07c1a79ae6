"""What estimates and draws say about the truth that data were made from: errors and densities."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np
from benchmarks.paun2020.synthetic import Truth
from numpy.typing import ArrayLike
from scipy.stats import gaussian_kde

THETA = ("f1", "f2", "f3", "psi1", "psi2", "c")
"""The parameters that the paper compares with the truth, in its order."""
SCALES = {"f1": 1e6, "f2": 100.0, "f3": 1e4, "psi1": 1.0, "psi2": 1.0, "c": 1.0}
"""Units of the joint density, which make all parameters of order one (those of the paper are not told)."""
PAPER_TRUTH = Truth(f1=51.1e5, f2=-171.0, f3=4.32e4, psi1=0.29, psi2=0.87, c=1.34, w=5.39e4, b=138.0)
"""Published medians of model E: "parameter values consistent with the physiological data"."""


def kernel_density(draws: ArrayLike, point: ArrayLike, weights: ArrayLike | None = None) -> float:
    """Gaussian kernel density at a point, bandwidth by Silverman's rule.

    Parameters
    ----------
    draws : array (n_dim, n_draws)
    point : array (n_dim,)
    weights : array (n_draws,), optional

    References
    ----------
    Silverman 1986, Density Estimation for Statistics and Data Analysis.
    """
    rows = np.atleast_2d(draws)
    if np.any(np.ptp(rows, axis=1) == 0):
        return 0.0
    return float(gaussian_kde(rows, bw_method="silverman", weights=weights)(np.atleast_1d(point))[0])


def score(draws: Mapping[str, ArrayLike], truth: Truth, weights: ArrayLike | None = None) -> dict[str, float]:
    """What the posterior draws of one data set say about the truth that it was made from.

    Parameters
    ----------
    draws : mapping of name to array (n_draws,)
        Of the parameters; those of `THETA` that are there are scored.
    truth : Truth
    weights : array (n_draws,), optional

    Returns
    -------
    dict
        relative_sse of the medians (eq. 6.1); joint_kde, kernel density in units of `SCALES`; median_NAME;
        density_NAME, kernel density in the parameter's own unit; rank_NAME, share of draws below the truth.
    """
    columns = {name: np.asarray(draws[name], dtype=float) for name in THETA if name in draws}
    at = {name: value for name, value in asdict(truth).items() if name in columns}
    medians = {
        name: float(np.quantile(column, 0.5, weights=weights, method="inverted_cdf"))
        for name, column in columns.items()
    }
    scaled = np.array([columns[name] / SCALES[name] for name in columns])
    row = {
        "relative_sse": sum(((at[name] - medians[name]) / at[name]) ** 2 for name in at),  # eq. (6.1)
        "joint_kde": kernel_density(scaled, [at[name] / SCALES[name] for name in columns], weights),
    }
    for name, column in columns.items():
        row[f"median_{name}"] = medians[name]
        row[f"density_{name}"] = kernel_density(column, at[name], weights)
        row[f"rank_{name}"] = float(np.average(column < at[name], weights=weights))
    return row
