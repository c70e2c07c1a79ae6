"""Posterior sampling of a diagnosis' leading explanations in PyMC, and what they are worth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pymc as pm
from numpy.typing import NDArray
from pymc.stats import compute_log_likelihood
from scipy.special import logsumexp

from zoo.core.arviz_lines import Score, dataset, made, psis_loo, ranked, waic
from zoo.core.causes.evidence import SIZE_PRIORS
from zoo.core.diagnosis.sets import CauseSets
from zoo.core.diagnosis.solved import Which
from zoo.core.errors.spectral import GroupErrors, GroupPriors
from zoo.core.inference.convergence import verdict
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.inference.sampling import sample
from zoo.core.model import bayesian_model
from zoo.core.parameters import LogNormal, Normal, unpack, variable_name
from zoo.core.posterior.comparison import thin
from zoo.core.posterior.files import sample_to

Array = NDArray[np.float64]

LEADING = 2
"""Sets of listed effects that are sampled besides the baseline."""
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


def explanation_model(found: CauseSets, which: Which) -> tuple[pm.Model, dict[str, Any]]:
    """A baseline with listed effects as a PyMC model, its errors in the coefficients of a diagnosis.

    z_k ~ N(z_k(theta, effect parameters), S_k), S as in `zoo.core.errors.spectral.GroupErrors`: noise around
    what was found, and a discrepancy of the size that these causes may leave.

    Parameters
    ----------
    found : CauseSets
    which : tuple of int
        A solved set of listed effects.

    Returns
    -------
    pm.Model
        The observed variable is "y", the data's coefficients (n_series, n_times).
    dict
        Values that a search for the mode may start from.
    """
    one, fitting = found.solved[which], found.search.fitting
    scales, _ = SIZE_PRIORS.scales(one.evidence.signal)
    part = max(scales, key=scales.__getitem__)
    priors = {
        group: GroupPriors(
            LogNormal(found.noise[group], 1.0), Normal(0.0, part * found.search.family.ranges[group], 0.0)
        )
        for group in fitting.errors.groups
    }
    errors = replace(fitting.errors, priors=priors)
    forward = one.forward.model
    model = bayesian_model(found.name(which), forward, fitting.data, errors)
    values = one.forward.theta(one.point.u)
    for i, p in enumerate(one.forward.parameters):
        if math.isfinite(p.low) and math.isfinite(p.high):
            span = INSIDE * (p.high - p.low)
            values[i] = np.clip(values[i], p.low + span, p.high - span)
    start = {variable_name(name): value for name, value in unpack(forward.parameters, values).items()}
    noise = {
        group: GroupErrors(found.noise[group], delta=0.0, length=errors.typical_length)
        for group in errors.groups
    }
    return model, start | errors.suggested(noise)


@dataclass(frozen=True, eq=False)
class SampledExplanation:
    """One explanation's posterior, its marginal likelihood, and whether it counts."""

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
            posterior = dataset(c.idata)
            rows[name] = {
                "converged": c.passed,
                "verdict": c.text,
                "log_marginal_likelihood": c.log_marginal,
                "log_marginal_likelihood_se": c.log_marginal_se,
                "elpd_waic": float(self.waic.loc[name, "elpd"]),
                "elpd_waic_difference": float(self.waic.loc[name, "elpd_diff"]),
                "elpd_waic_difference_se": float(self.waic.loc[name, "dse"]),
                "elpd_loo": float(self.loo.loc[name, "elpd"]),
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
    posterior = dataset(idata)
    names = [str(name) for name in posterior.data_vars]
    stacked = posterior.stack(sample=("chain", "draw"))
    q = logp.from_draws({n: np.moveaxis(stacked[n].values, -1, 0) for n in names})
    proposal = multivariate_t(loc=q.mean(axis=0), shape=WIDER * np.cov(q.T), df=DEGREES, seed=seed)
    points = proposal.rvs(draws)
    log_w = np.array([logp(x) for x in points]) - proposal.logpdf(points)
    log_w[~np.isfinite(log_w)] = -np.inf
    log_z = float(logsumexp(log_w)) - math.log(draws)
    w = np.exp(log_w - log_w.max())
    se = float(np.std(w) / np.mean(w) / math.sqrt(draws))
    return log_z, se


def scores_of(model: pm.Model, idata: Any) -> tuple[Score, Score]:
    """WAIC and PSIS-LOO of a thinned posterior by each coefficient, independent given the parameters."""
    kept = thin(idata, SCORED_DRAWS)
    with model:
        scored = compute_log_likelihood(made({"posterior": kept}), progressbar=False)
    terms = dataset(scored, "log_likelihood")["y"]
    return waic(terms), psis_loo(kept, terms)


def sample_explanations(
    sets: CauseSets,
    *,
    cores: int = 2,
    seed: int = 1,
    folder: str | Path | None = None,
    tick: Callable[[str, float], None] | None = None,
) -> SampledExplanations:
    """Sample the baseline and the leading sets of listed effects, and compare them by WAIC, LOO and evidence.

    Parameters
    ----------
    sets : CauseSets
    cores : int
    seed : int
    folder : path, optional
        Where posteriors and checkpoints are stored; a killed run goes on there.
    tick : callable, optional
        Called with a text and the share done.

    Returns
    -------
    SampledExplanations
    """
    listed = [
        which
        for which in sets.posterior.probability
        if which and which in sets.solved and all(sets.search.origins[i].added for i in which)
    ]
    chosen: dict[str, Which] = {"baseline": ()} | {sets.name(which): which for which in listed[:LEADING]}
    found: dict[str, SampledExplanation] = {}
    scores: dict[str, tuple[Score, Score]] = {}
    for done, (name, which) in enumerate(chosen.items()):
        if tick is not None:
            tick(f"posterior of {name}", (done + 0.01) / len(chosen))
        model, start = explanation_model(sets, which)
        settings: dict[str, Any] = {
            "draws": SAMPLED[0], "max_draws": SAMPLED[1], "until_ess": ENOUGH, "cores": cores, "seed": seed,
            "start": start, "progress": False,
        }  # fmt: skip
        if folder is None:
            idata = sample(model, **settings)
        else:
            idata = sample_to(Path(folder) / f"{name}.nc", model, **settings)
        v = verdict(idata)
        log_z, se = log_marginal_likelihood(model, idata, seed=seed)
        found[name] = SampledExplanation(idata, log_z, se, v.text, v.passes)
        scores[name] = scores_of(model, idata)
    by_waic, by_loo = (ranked({name: both[i] for name, both in scores.items()}, "pseudo-BMA") for i in (0, 1))
    return SampledExplanations(found, by_waic, by_loo)
