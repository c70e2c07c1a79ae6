"""Full posteriors of a diagnosis' leading explanations, in PyMC, and what they are worth."""

from __future__ import annotations

import math
import warnings
from collections import Counter, OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, cast

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from numpy.typing import NDArray
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op
from scipy.special import logsumexp

from zoo.blood.effects import get_base
from zoo.blood.study import Study
from zoo.core.diagnosis.discrepancy import CORRELATED_RATIO, LENGTH_BEATS, MEMORY_BEATS, Harmonics
from zoo.core.diagnosis.screening import DOUBT, NO_GAP, Fit, Forward, Hypothesis, Scored, Screened
from zoo.core.errors.variables import IidErrors
from zoo.core.inference.convergence import verdict
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.inference.sampling import sample
from zoo.core.op import MissingGradientError
from zoo.core.posterior.comparison import thin
from zoo.core.posterior.files import sample_to

Array = NDArray[np.float64]

LEADING = 2
"""Explanations that are sampled besides the base."""
WEIGHED = 600
"""Solves spent on a marginal likelihood."""
SCORED_DRAWS = 500
KEPT = 8


class HarmonicsOp(Op):
    """A hypothesis' series as harmonics, without a gradient: (d,) in, coefficients (n,) and ok out.

    Parameters
    ----------
    study : Study
    base : str
    hypothesis : Hypothesis
    conventions : Conventions or None
    """

    __props__ = ("key",)

    def __init__(self, study: Study, base: str, hypothesis: Hypothesis, conventions: Any = None) -> None:
        self.arguments = (study, base, hypothesis, conventions)
        self.key = (study.checksum, base, repr(hypothesis), repr(conventions))
        self._build()

    def _build(self) -> None:
        study, base, hypothesis, conventions = self.arguments
        self.harmonics = Harmonics(study)
        self.forward = Forward(study, get_base(base), hypothesis, self.harmonics, conventions=conventions)
        self._kept: OrderedDict[bytes, tuple[Array, bool]] = OrderedDict()
        self._failures: Counter[str] = Counter()

    def __getstate__(self) -> dict[str, Any]:
        return {"arguments": self.arguments, "key": self.key}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._build()

    @property
    def counts(self) -> dict[str, Any]:
        """Solves and failed solves in this process."""
        return {"solves": self.forward.solves, "failures": dict(self._failures)}

    def evaluate(self, u: Array) -> tuple[Array, bool]:
        """Coefficients and whether the solve succeeded; the last few points are kept."""
        key = u.tobytes()
        if key not in self._kept:
            found = self.forward(u) if np.all(np.isfinite(u)) else None
            if found is None:
                self._failures["failed"] += 1
            self._kept[key] = (np.zeros(self.harmonics.size) if found is None else found, found is not None)
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        return self._kept[key]

    def make_node(self, *inputs: Any) -> Apply:
        """One vector in; coefficients and ok out."""
        (u,) = inputs
        outputs = [
            pt.tensor("harmonics", dtype="float64", shape=(self.harmonics.size,)),
            pt.scalar("ok", dtype="int8"),
        ]
        return Apply(self, [pt.as_tensor_variable(u, dtype="float64")], outputs)

    def perform(self, node: Apply, inputs: Sequence[Any], output_storage: list[list[Any]]) -> None:
        """Evaluate."""
        computed, ok = self.evaluate(np.asarray(inputs[0]))
        output_storage[0][0] = computed.copy()
        output_storage[1][0] = np.asarray(ok, dtype=np.int8)

    def infer_shape(self, fgraph: Any, node: Apply, input_shapes: list[Any]) -> list[Any]:
        """Known before any solve."""
        return [(self.harmonics.size,), ()]

    def L_op(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], output_grads: Sequence[Variable]
    ) -> NoReturn:
        """Raise MissingGradientError."""
        raise MissingGradientError("the blood-flow solver")

    pullback = L_op


def effect_model(screened: Screened, fit: Fit) -> pm.Model:
    """A base with its effects as a PyMC model, its errors in the harmonics.

    z_k ~ N(z_k(theta, amplitudes), S_k), S as in `zoo.core.diagnosis.discrepancy.Errors`; base parameters
    uniform, amplitudes with their truncated normal priors, noise and allowance as in the screening.

    Parameters
    ----------
    screened : Screened
        Gives data and scales.
    fit : Fit
        Gives the hypothesis and where a search for the mode may start.

    Returns
    -------
    pm.Model
        The observed variable is "z", (n_series * n_times,).
    """
    screening = screened.screening
    study, H = screening.study, screening.harmonics
    T = study.period_s
    start = dict(zip((p.name for p in fit.forward.parameters), (float(v) for v in fit.values), strict=True))
    with pm.Model() as model:
        u = []
        for p in fit.forward.parameters:
            if p.scale:
                x = pm.TruncatedNormal(p.name, p.centre, p.scale, lower=p.low, upper=p.high)
            else:
                x = pm.Uniform(p.name, p.low, p.high)
            span = 1e-3 * (p.high - p.low)
            start[p.name] = float(np.clip(start[p.name], p.low + span, p.high - span))
            u.append(pt.log(x) if p.log else x)
        op = HarmonicsOp(study, screening.base.name, fit.hypothesis, screening.conventions)
        computed, ok = cast("list[Any]", op(pt.stack(u), return_list=True))
        S = pt.zeros((len(study.series), H.n))
        for q, rows in H.rows.items():
            short = q.split("_")[0]
            e = fit.errors[q]
            sigma = pm.LogNormal(f"sigma_{short}", math.log(screened.noise[q].sigma), 1.0)
            ratio = pm.TruncatedNormal(
                f"ratio_{short}", 0.0, CORRELATED_RATIO, lower=0.0, upper=CORRELATED_RATIO
            )
            median, spread, top = MEMORY_BEATS
            tau = pm.Truncated(
                f"tau_{short}", pm.LogNormal.dist(math.log(median * T), spread), lower=1e-3 * T, upper=top * T
            )
            delta = pm.HalfNormal(f"delta_{short}", fit.allowances[q])
            start |= {
                f"sigma_{short}": e.sigma,
                f"ratio_{short}": min(max(e.ratio, 0.05), 0.95 * CORRELATED_RATIO),
                f"tau_{short}": min(e.tau, 0.95 * top * T),
                f"delta_{short}": max(e.delta, 0.1 * fit.allowances[q]),
            }
            row = sigma**2 * (1.0 + ratio**2 * H.rough(tau)) + delta**2 * H.smooth(LENGTH_BEATS[0] * T)
            S = pt.set_subtensor(S[rows], row[None, :])
        IidErrors("z", computed, ok, S.reshape((H.size,)), observed=screening.data)
    model.zoo_start = start
    return model


@dataclass(frozen=True, eq=False)
class Confirmed:
    """One explanation's posterior."""

    name: str
    fit: Fit
    idata: Any
    log_marginal: float
    log_marginal_se: float
    text: str
    passed: bool


@dataclass(frozen=True, eq=False)
class Confirmation:
    """Posteriors of the base and the leading explanations, and their comparison."""

    found: Mapping[str, Confirmed]
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
    proposal = multivariate_t(loc=q.mean(axis=0), shape=1.2 * np.cov(q.T), df=5, seed=seed)
    points = proposal.rvs(draws)
    log_w = np.array([logp(x) for x in points]) - proposal.logpdf(points)
    log_w[~np.isfinite(log_w)] = -np.inf
    log_z = float(logsumexp(log_w)) - math.log(draws)
    w = np.exp(log_w - log_w.max())
    se = float(np.std(w) / np.mean(w) / math.sqrt(draws))
    return log_z, se


def pointwise(model: pm.Model, idata: Any) -> Any:
    """A thinned posterior with the log-likelihood of each harmonic, independent given the parameters."""
    import arviz as az

    kept = az.InferenceData(posterior=thin(idata, SCORED_DRAWS))
    with model:
        return pm.compute_log_likelihood(kept, progressbar=False)


def confirm(
    scored: Scored,
    *,
    cores: int = 2,
    seed: int = 1,
    folder: str | Path | None = None,
    draws: int = 1000,
    max_draws: int = 6000,
    progress: bool = False,
    tick: Callable[[str, float], None] | None = None,
) -> Confirmation:
    """Sample the base and the leading listed explanations, and compare WAIC, LOO and marginal likelihood.

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
    Confirmation
    """
    import arviz as az

    screened = scored.screened
    listed = [n for n in scored.names if n in scored.places and n not in scored.invisible]
    # a rival that the screening has ruled out needs no posterior
    rivals = [
        n for n in listed[1:] if scored.probability[n] > DOUBT or scored.group[n] == scored.group[listed[0]]
    ]
    chosen = {NO_GAP: screened.base} | {n: scored.best[n] for n in [*listed[:1], *rivals][:LEADING]}
    found: dict[str, Confirmed] = {}
    scores: dict[str, Any] = {}
    for done, (name, fit) in enumerate(chosen.items()):
        if tick is not None:
            tick(f"posterior of {name}", (done + 0.01) / len(chosen))
        model = effect_model(screened, fit)
        settings = {
            "draws": draws, "max_draws": max_draws, "until_ess": 400, "cores": cores, "seed": seed,
            "start": model.zoo_start, "progress": progress,
        }  # fmt: skip
        if folder is None:
            idata = sample(model, **settings)
        else:
            idata = sample_to(Path(folder) / f"{name}.nc", model, **settings)
        v = verdict(idata)
        log_z, se = log_marginal_likelihood(model, idata, seed=seed)
        found[name] = Confirmed(name, fit, idata, log_z, se, v.text, v.passes)
        scores[name] = pointwise(model, idata)
    with warnings.catch_warnings():  # they come back as a column of the comparison
        warnings.simplefilter("ignore")
        waic = az.compare(scores, ic="waic", method="pseudo-BMA")
        loo = az.compare(scores, ic="loo", method="pseudo-BMA")
    return Confirmation(found, waic, loo)
