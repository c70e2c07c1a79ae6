"""Posterior sampling of a diagnosis' leading explanations in PyMC, and what they are worth."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pymc as pm
from numpy.typing import NDArray
from scipy.special import logsumexp

from zoo.core.diagnosis.evidence import Fit
from zoo.core.diagnosis.hypothesis import NULL
from zoo.core.diagnosis.scoring import DOUBT, Scored
from zoo.core.diagnosis.screening import Screened
from zoo.core.errors.spectral import GroupPriors
from zoo.core.inference.convergence import verdict
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.inference.sampling import sample
from zoo.core.model import bayesian_model
from zoo.core.parameters import LogNormal, Normal, unpack, variable_name
from zoo.core.posterior.comparison import thin
from zoo.core.posterior.files import sample_to

Array = NDArray[np.float64]

LEADING = 2
"""Explanations that are sampled besides the baseline."""
WEIGHED = 600
"""Solves spent on a marginal likelihood."""
SCORED_DRAWS = 500
"""Draws that WAIC and PSIS-LOO are made of."""
SAMPLED, ENOUGH = (1000, 6000), 400
"""Draws of a chain at first and at most, and the effective sample size that is enough."""
WIDER, DEGREES = 1.2, 5
"""Factor of the posterior's covariance, and degrees of freedom, of the t distribution that is drawn from."""
INSIDE = 1e-3
"""How far inside its bounds a start is, in parts of their distance."""


def explanation_model(screened: Screened, fit: Fit) -> tuple[pm.Model, dict[str, Any]]:
    """A baseline with its effects as a PyMC model, its errors in the screening's coefficients.

    z_k ~ N(z_k(theta, effect parameters), S_k), S as in `zoo.core.errors.spectral.GroupErrors`, with noise
    and allowance as in the screening.

    Parameters
    ----------
    screened : Screened
        Gives data and scales.
    fit : Fit
        Gives the hypothesis and where a search for the mode may start.

    Returns
    -------
    pm.Model
        The observed variable is "y", the data's coefficients (n_series, n_times).
    dict
        Values that a search for the mode may start from.
    """
    screening = screened.screening
    priors = {
        group: GroupPriors(
            LogNormal(screened.noise[group].sigma, 1.0), Normal(0.0, fit.allowances[group], 0.0)
        )
        for group in screening.errors.groups
    }
    errors = replace(screening.errors, priors=priors)
    forward = fit.forward.model
    model = bayesian_model(fit.hypothesis.name, forward, screening.data, errors)
    values = fit.values.copy()
    for i, p in enumerate(fit.forward.parameters):
        if math.isfinite(p.low) and math.isfinite(p.high):
            span = INSIDE * (p.high - p.low)
            values[i] = np.clip(values[i], p.low + span, p.high - span)
    start = {variable_name(name): value for name, value in unpack(forward.parameters, values).items()}
    return model, start | errors.suggested(fit.errors)


@dataclass(frozen=True, eq=False)
class SampledExplanation:
    """One explanation's posterior, its marginal likelihood, and whether it counts."""

    name: str
    fit: Fit
    idata: Any
    log_marginal: float
    log_marginal_se: float
    text: str
    passed: bool


@dataclass(frozen=True, eq=False)
class SampledExplanations:
    """Posteriors of the baseline and the leading explanations, and their comparison."""

    found: Mapping[str, SampledExplanation]
    waic: Any
    loo: Any

    def summary(self) -> dict[str, Any]:
        """What diagnosis.json keeps."""
        rows: dict[str, Any] = {}
        for name, c in self.found.items():
            posterior = c.idata.posterior
            rows[name] = {
                "converged": c.passed,
                "verdict": c.text,
                "log_marginal_likelihood": c.log_marginal,
                "log_marginal_likelihood_se": c.log_marginal_se,
                "elpd_waic": float(self.waic.loc[name, "elpd_waic"]),
                "elpd_waic_difference": float(self.waic.loc[name, "elpd_diff"]),
                "elpd_waic_difference_se": float(self.waic.loc[name, "dse"]),
                "elpd_loo": float(self.loo.loc[name, "elpd_loo"]),
                "waic_warning": bool(self.waic.loc[name, "warning"]),
                "loo_warning": bool(self.loo.loc[name, "warning"]),
                "parameters": {
                    str(v): {"mean": float(posterior[v].mean()), "sd": float(posterior[v].std())}
                    for v in posterior.data_vars
                    if posterior[v].ndim == 2
                },
            }
        return rows


def log_marginal_likelihood(
    model: pm.Model, idata: Any, *, draws: int = WEIGHED, seed: int = 1
) -> tuple[float, float]:
    """Log marginal likelihood by importance sampling from a t distribution fitted to the posterior.

    log Z = log mean p(y, q)/g(q), q ~ g = t_5(mean, covariance) of the unconstrained draws.

    Parameters
    ----------
    model : pm.Model
    idata : InferenceData
        Its posterior.
    draws : int
        Solves.
    seed : int

    Returns
    -------
    log_z : float
    se : float
        Standard error of log_z.
    """
    from scipy.stats import multivariate_t

    logp = LogPosterior(model)
    names = list(idata.posterior.data_vars)
    stacked = idata.posterior.stack(sample=("chain", "draw"))
    q = logp.from_draws({n: np.moveaxis(stacked[n].values, -1, 0) for n in names})
    proposal = multivariate_t(loc=q.mean(axis=0), shape=WIDER * np.cov(q.T), df=DEGREES, seed=seed)
    points = proposal.rvs(draws)
    log_w = np.array([logp(x) for x in points]) - proposal.logpdf(points)
    log_w[~np.isfinite(log_w)] = -np.inf
    log_z = float(logsumexp(log_w)) - math.log(draws)
    w = np.exp(log_w - log_w.max())
    se = float(np.std(w) / np.mean(w) / math.sqrt(draws))
    return log_z, se


def pointwise(model: pm.Model, idata: Any) -> Any:
    """A thinned posterior with the log-likelihood of each coefficient, independent given the parameters."""
    import arviz as az

    kept = az.InferenceData(posterior=thin(idata, SCORED_DRAWS))
    with model:
        return pm.compute_log_likelihood(kept, progressbar=False)


def sample_explanations(
    scored: Scored,
    *,
    cores: int = 2,
    seed: int = 1,
    folder: str | Path | None = None,
    draws: int = SAMPLED[0],
    max_draws: int = SAMPLED[1],
    progress: bool = False,
    tick: Callable[[str, float], None] | None = None,
) -> SampledExplanations:
    """Sample the baseline and the leading listed explanations, and compare WAIC, LOO and marginal likelihood.

    Parameters
    ----------
    scored : Scored
        A screening with probabilities.
    cores : int
    seed : int
    folder : path, optional
        Where posteriors and checkpoints are stored; a killed run goes on there.
    draws, max_draws : int
        Stored draws of each of the four chains: first check, and limit.
    progress : bool
        Of each run.
    tick : callable, optional
        Called with a text and the share done.

    Returns
    -------
    SampledExplanations
    """
    import arviz as az

    screened = scored.screened
    listed = [n for n in scored.names if n in scored.locations and n not in scored.invisible]
    # a rival that the screening has ruled out needs no posterior
    rivals = [
        n for n in listed[1:] if scored.probability[n] > DOUBT or scored.group[n] == scored.group[listed[0]]
    ]
    chosen = {NULL: screened.base} | {n: scored.best[n] for n in [*listed[:1], *rivals][:LEADING]}
    found: dict[str, SampledExplanation] = {}
    scores: dict[str, Any] = {}
    for done, (name, fit) in enumerate(chosen.items()):
        if tick is not None:
            tick(f"posterior of {name}", (done + 0.01) / len(chosen))
        model, start = explanation_model(screened, fit)
        settings: dict[str, Any] = {
            "draws": draws, "max_draws": max_draws, "until_ess": ENOUGH, "cores": cores, "seed": seed,
            "start": start, "progress": progress,
        }  # fmt: skip
        if folder is None:
            idata = sample(model, **settings)
        else:
            idata = sample_to(Path(folder) / f"{name}.nc", model, **settings)
        v = verdict(idata)
        log_z, se = log_marginal_likelihood(model, idata, seed=seed)
        found[name] = SampledExplanation(name, fit, idata, log_z, se, v.text, v.passes)
        scores[name] = pointwise(model, idata)
    with warnings.catch_warnings():  # they come back as a column of the comparison
        warnings.simplefilter("ignore")
        waic = az.compare(scores, ic="waic", method="pseudo-BMA")
        loo = az.compare(scores, ic="loo", method="pseudo-BMA")
    return SampledExplanations(found, waic, loo)
