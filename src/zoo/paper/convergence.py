"""The tests of convergence that Paun et al. 2020 report: Geweke, and one scale reduction factor for all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.core.inference.elements import scalars
from zoo.core.inference.record import ResultsError

Array = NDArray[np.float64]

MIN_DRAWS = 40
"""Draws of a chain from which Geweke's test has two parts to compare."""


def geweke(values: ArrayLike) -> Array:
    """P-values of Geweke's test: do the first 10 % and the last 50 % of a chain have one mean?

    z = (mean_a - mean_b)/sqrt(var_a/ess_a + var_b/ess_b), p = 2 (1 - Phi(|z|)).

    Parameters
    ----------
    values : array (n_chains, n_draws)
        Draws of one scalar, at least 40 of each chain.

    Returns
    -------
    array (n_chains,)
        NaN for a chain that does not vary.

    Raises
    ------
    ResultsError
        If there are too few draws.

    References
    ----------
    Geweke 1992, in Bayesian Statistics 4, pp. 169-193; the paper asks for p > 0.05.
    """
    import arviz as az
    from scipy.stats import norm

    draws = np.asarray(values, dtype=np.float64)
    n = draws.shape[1]
    if n < MIN_DRAWS:
        raise ResultsError(f"{n} draws are too few for Geweke's test; it needs {MIN_DRAWS}")
    p = np.full(len(draws), np.nan)
    for i, chain in enumerate(draws):
        if np.ptp(chain) == 0:
            continue
        parts = chain[: n // 10], chain[n - n // 2 :]
        variance = sum(part.var(ddof=1) / float(az.ess(part[None], method="mean")) for part in parts)
        p[i] = 2 * norm.sf(abs(parts[0].mean() - parts[1].mean()) / np.sqrt(variance))
    return p


def mpsrf(draws: Mapping[str, np.ndarray]) -> float:
    """Multivariate potential scale reduction factor of Brooks and Gelman.

    (n - 1)/n + (m + 1)/m lambda, lambda the largest eigenvalue of W^-1 B/n, with W the covariance within
    and B/n the covariance between m chains of n draws. It is on the scale of variances.

    Parameters
    ----------
    draws : mapping
        Variable -> array (n_chains, n_draws, ...). Elements that never vary are left out.

    Returns
    -------
    float
        1 when the chains agree; NaN for a single chain.

    References
    ----------
    Brooks and Gelman 1998, eq. (4.1), doi 10.1080/10618600.1998.10474787; the paper asks for <= 1.1.
    """
    from scipy.linalg import eigh

    columns = [v for _, v in scalars(draws) if v.size and np.ptp(v) > 0]
    if not columns or len(columns[0]) < 2:
        return float("nan")
    x = np.stack(columns, axis=-1).astype(np.float64)
    x /= x.std(axis=(0, 1))
    m, n, d = x.shape
    within = np.mean([np.cov(chain.T).reshape(d, d) for chain in x], axis=0)
    between = np.cov(x.mean(axis=1).T).reshape(d, d)
    if np.linalg.matrix_rank(within) < d:  # chains that hardly moved
        return np.inf
    return float((n - 1) / n + (m + 1) / m * eigh(between, within, eigvals_only=True)[-1])


def paper_tests(draws: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Both tests of a posterior, as `zoo.core.posterior.storage.slim` keeps them and `zoo report` shows them.

    Parameters
    ----------
    draws : mapping
        Variable -> array (n_chains, n_draws, ...).

    Returns
    -------
    dict
        mpsrf: see `mpsrf`; geweke: scalar that varies -> p-values of the chains, none with fewer than 40
        draws.
    """
    p_values = {
        name: geweke(values).tolist()
        for name, values in scalars(draws)
        if values.shape[1] >= MIN_DRAWS and np.ptp(values) > 0
    }
    return {"mpsrf": mpsrf(draws), "geweke": p_values}
