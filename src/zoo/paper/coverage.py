"""Fits of many synthetic data sets of known truth: errors, densities of the truth, coverage of intervals.

Sections 6.1.1 and 6.6 of Paun et al. 2020 (Tables 3 and 5, figures 3 and 10).
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Study
from zoo.core.errors.gaussian_process import NOISE, gp_sequential, neural_network_kernel
from zoo.core.inference.convergence import ESS_TARGET, verdict
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.inference.progress import bar
from zoo.core.inference.record import versions
from zoo.core.inference.workers import each
from zoo.core.posterior.files import belongs, checkpoint_of, load_for, sample_to
from zoo.core.posterior.storage import save
from zoo.models import get_model, model_e
from zoo.paper.synthetic import Truth, synthetic_study, whitened

if TYPE_CHECKING:
    import arviz as az

Array = NDArray[np.float64]

THETA = ("f1", "f2", "f3", "psi1", "psi2", "c")
"""The parameters that the paper compares with the truth, in its order."""
IDENTIFIABLE = ("f3", "psi1", "psi2", "c")
SCALES = {"f1": 1e6, "f2": 100.0, "f3": 1e4, "psi1": 1.0, "psi2": 1.0, "c": 1.0}
"""Units of the joint density, which make all parameters of order one (those of the paper are not told)."""
LEVELS = (0.5, 0.8, 0.95)
NARROWER = 0.7
"""Factor on the covariance of the Gaussian in `marginal_density`."""
PAPER_TRUTH = Truth(f1=51.1e5, f2=-171.0, f3=4.32e4, psi1=0.29, psi2=0.87, c=1.34, w=5.39e4, b=138.0)
"""Published medians of model E: "parameter values consistent with the physiological data"."""


@dataclass(frozen=True)
class Scenario:
    """One way to fit the data sets: a model, and the vessels whose pressures it sees.

    Posteriors of model E are weighted draws of one pool of solves for all data sets, `fit_pooled`; those of
    other models come from chains of their own.
    """

    name: str
    model: str
    vessels: int


SCENARIOS = (
    Scenario("no mismatch, 1 vessel", "D", 1),
    Scenario("mismatch, 1 vessel", "E", 1),
    Scenario("mismatch, 3 vessels", "E", 3),
    Scenario("mismatch, 21 vessels", "E", 21),
)


def data_set(
    base: Study, number: int, vessels: int, *, truth: Truth = PAPER_TRUTH, n_times: int = 256
) -> Study:
    """One synthetic data set: the inlet of the root, and the middle of the vessels next to it.

    Made on the grid that the models use, as in the paper: with 21 vessels the difference to a fine grid moves
    f3 by about a posterior standard deviation (``benchmarks/synthetic_grid.py``), which is no question of
    statistics. Errors are not selected so that pressures fall towards the periphery: selected ones look like
    a larger pressure drop and are no draws of the law that the models assume.

    Parameters
    ----------
    base : Study
        Vessels, inflow and conventions.
    number : int
        From 0; the seed of its errors is 1000 + number.
    vessels : int
        How many vessels are seen, in the order of the study's file.
    truth : Truth
    n_times : int
        Samples in the beat.
    """
    sites = [(v.id, 0.0 if i == 0 else 0.5) for i, v in enumerate(base.vessels[:vessels])]
    return synthetic_study(
        base,
        name=f"{base.name}-synthetic-{vessels}-{number:02d}",
        truth=truth,
        sites=sites,
        n_times=n_times,
        seed=1000 + number,
        options=SolverOptions(),
        ordered=False,
    )


# -------------------------------------------------------------------------------------------------
# fits


@dataclass(frozen=True)
class Job:
    """A fit, sent to a process."""

    path: Path
    model: str
    study: Study
    settings: dict[str, Any]


def _fit(job: Job) -> None:
    sample_to(job.path, get_model(job.model)(job.study), cores=0, progress=False, **job.settings)
    shutil.rmtree(checkpoint_of(job.path), ignore_errors=True)


def fit_all(
    jobs: Sequence[Job], *, cores: int = 2, done: Callable[[Path], None] = lambda path: None
) -> list[Path]:
    """Sample every job that is not done yet, each in one process with its chains in turns.

    A job is done if its file holds a posterior of its model and study. An interrupted one goes on from its
    checkpoint.

    Parameters
    ----------
    jobs : sequence of Job
    cores : int
        Processes.
    done : callable
        Told the path of each finished job.

    Returns
    -------
    list of Path
        Files, in the order of the jobs.
    """
    waiting = []
    for job in jobs:
        if job.path.is_file() and belongs(job.path, get_model(job.model)(job.study)):
            done(job.path)
        else:
            job.path.parent.mkdir(parents=True, exist_ok=True)
            waiting.append(job)
    for job, _ in each(_fit, waiting, cores):
        done(job.path)
    return [job.path for job in jobs]


# -------------------------------------------------------------------------------------------------
# many data sets from one pool of solves

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
    solved: Callable[[], None] = lambda: None,
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
    n : int
        Points.
    seed : int
    cores : int
        Threads.
    solved : callable
        Called after each point.

    Returns
    -------
    Pool
    """
    from concurrent.futures import ThreadPoolExecutor

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
    wave_law = _around(np.log(true[2:]), POOL_WIDTH * _wave_covariance(waves, true, times, truth))
    error_law = _around(
        np.log([truth.w, truth.b]), POOL_WIDTH * _error_parameter_covariance(times, truth, len(study.series))
    )
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
        for i, (at_point, at_true) in enumerate(threads.map(one, range(n))):
            here[i], there[i] = at_point, at_true
            solved()
    return Pool(theta, eta, log_theta, log_eta, here, there)


def _around(centre: Array, covariance: Array) -> Any:
    from scipy.stats import multivariate_t

    return multivariate_t(centre, covariance, df=POOL_DOF)


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


def score_pool(
    pool: Pool, truth: Mapping[str, float], data_set: int, *, n_draws: int = 2000, seed: int = 0
) -> tuple[dict[str, Any], dict[str, Array]]:
    """What one data set says about the truth, by Pareto-smoothed importance sampling.

    Parameters
    ----------
    pool : Pool
    truth : mapping
    data_set : int
    n_draws : int
        Draws that are picked from the pool with their weights.
    seed : int

    Returns
    -------
    row : dict
        As `score_fit`, with pareto_k; joint_direct is p(theta*|y) as the ratio of the two integrals of the
        likelihood, over eta at the truth and over all.
    draws : dict of array (n_draws,)
        Of each parameter.

    References
    ----------
    Vehtari, Simpson, Gelman, Yao and Gabry 2024, Pareto smoothed importance sampling, JMLR 25(72).
    """
    import arviz as az
    from scipy.special import logsumexp

    log_weights = pool.log_likelihood[:, data_set] + pool.log_theta + pool.log_eta
    possible = np.isfinite(log_weights)
    smooth, k = az.psislw(log_weights[possible].copy())
    weights = np.exp(np.asarray(smooth))
    weights /= weights.sum()
    theta = pool.theta[possible]
    scales = np.array([SCALES[name] for name in THETA])
    at = np.array([truth[name] for name in THETA])
    log_box = -sum(np.log(BOUNDS[name][1] - BOUNDS[name][0]) for name in THETA)
    over_eta = pool.log_likelihood_at_truth[:, data_set] + pool.log_eta
    log_joint = log_box + float(logsumexp(over_eta) - logsumexp(log_weights))
    ess = 1.0 / float(np.sum(weights**2))
    row: dict[str, Any] = {
        "joint_kde": kernel_density((theta / scales).T, at / scales, weights),
        "joint_direct": float(np.exp(log_joint) * scales.prod()),
        "converged": bool(k <= K_LIMIT and ess >= ESS_TARGET),
        "ess_min": ess,
        "pareto_k": float(k),
    }
    medians = {}
    for i, name in enumerate(THETA):
        order = np.argsort(theta[:, i])
        medians[name] = float(np.interp(0.5, np.cumsum(weights[order]), theta[order, i]))
        row[f"median_{name}"] = medians[name]
        row[f"density_{name}"] = kernel_density(theta[:, i], truth[name], weights)
        row[f"rank_{name}"] = float(weights[theta[:, i] < truth[name]].sum())
    row["relative_sse"] = relative_sse(medians, {name: truth[name] for name in THETA})
    picked = np.random.default_rng(seed).choice(len(weights), size=n_draws, p=weights)
    draws = {name: theta[picked, i] for i, name in enumerate(THETA)}
    draws |= {name: np.exp(pool.eta[possible][picked, i]) for i, name in enumerate(("w", "b"))}
    return row, draws


# -------------------------------------------------------------------------------------------------
# what a fit says about the truth


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
    kept = np.unique(np.linspace(0, total - 1, min(n_draws, total)).round().astype(int))
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


def score_fit(
    path: Path, job: Job, truth: Mapping[str, float], *, names: Sequence[str] = THETA
) -> dict[str, Any]:
    """What one posterior says about the truth.

    Returns
    -------
    dict
        relative_sse of the medians; density_NAME, marginal kernel density in the parameter's own unit;
        joint_kde and joint_direct (`marginal_density`) in units of `SCALES`; rank_NAME, share of draws below
        the truth; median_NAME; converged, rhat_max, ess_min.
    """
    model = get_model(job.model)(job.study)
    idata = load_for(path, model)
    posterior = idata["posterior"]
    draws = {name: posterior[name].to_numpy().ravel() for name in names}
    found = verdict(idata)
    scaled = np.array([draws[name] / SCALES.get(name, 1.0) for name in names])
    at = np.array([truth[name] / SCALES.get(name, 1.0) for name in names])
    scale = float(np.prod([SCALES.get(name, 1.0) for name in names]))
    wanted = {name: truth[name] for name in names}
    row: dict[str, Any] = {
        "relative_sse": relative_sse({n: float(np.median(draws[n])) for n in names}, wanted),
        "joint_kde": kernel_density(scaled, at),
        "joint_direct": marginal_density(idata, model, wanted) * scale,
        "converged": found.passes,
        "rhat_max": found.max_rhat,
        "ess_min": found.min_ess,
    }
    for name in names:
        row[f"median_{name}"] = float(np.median(draws[name]))
        row[f"density_{name}"] = kernel_density(draws[name], truth[name])
        row[f"rank_{name}"] = float(np.mean(draws[name] < truth[name]))
    return row


def summarise(scores: pd.DataFrame, names: Sequence[str] = THETA) -> pd.DataFrame:
    """Medians over the data sets, as Tables 3 and 5 have them.

    Parameters
    ----------
    scores : DataFrame
        Rows of `score_fit` with a column scenario.

    Returns
    -------
    DataFrame
        Index scenario: data_sets, converged, relative_sse, density_NAME, joint_kde, joint_direct.
    """
    columns = ["relative_sse", *(f"density_{name}" for name in names), "joint_kde", "joint_direct"]
    grouped = scores.groupby("scenario", sort=False)
    table = grouped[columns].median()
    table.insert(0, "data_sets", grouped.size())
    table.insert(1, "converged", grouped["converged"].sum())
    return table


def coverage(
    scores: pd.DataFrame, names: Sequence[str] = IDENTIFIABLE, levels: Sequence[float] = LEVELS
) -> pd.DataFrame:
    """How often central intervals hold the truth, with the range that chance allows.

    Parameters
    ----------
    scores : DataFrame
        Rows of `score_fit` with a column scenario.
    names : sequence of str
        Parameters.
    levels : sequence of float
        Of the intervals.

    Returns
    -------
    DataFrame
        Columns scenario, parameter, level, covered, data_sets, share, low, high (central 95 % of the binomial
        with `level`), within.
    """
    from scipy.stats import binom

    rows = []
    for scenario, group in scores.groupby("scenario", sort=False):
        n = len(group)
        for name in names:
            rank = group[f"rank_{name}"].to_numpy()
            for level in levels:
                covered = int(np.sum(np.abs(rank - 0.5) <= level / 2))
                low, high = (float(x) / n for x in binom.interval(0.95, n, level))
                share = covered / n
                rows.append(
                    {
                        "scenario": scenario,
                        "parameter": name,
                        "level": level,
                        "covered": covered,
                        "data_sets": n,
                        "share": share,
                        "low": low,
                        "high": high,
                        "within": bool(low <= share <= high),
                    }
                )
    return pd.DataFrame(rows)


def run(
    base: Study,
    folder: Path,
    *,
    data_sets: int = 20,
    scenarios: Sequence[Scenario] = SCENARIOS,
    truth: Truth = PAPER_TRUTH,
    n_times: int = 256,
    points: int = 16_000,
    names: Sequence[str] = THETA,
    cores: int = 2,
    progress: bool = True,
    **settings: Any,
) -> pd.DataFrame:
    """Make the data sets, fit each in every scenario, and score the fits.

    Parameters
    ----------
    base : Study
        Vessels, inflow and conventions.
    folder : Path
        For posteriors (kept, so that an interrupted run goes on) and scores.csv.
    data_sets : int
    scenarios : sequence of Scenario
    truth : Truth
    n_times : int
        Samples of each series.
    points : int
        Of each pool.
    names : sequence of str
        Parameters to score where chains are run.
    cores : int
        Processes, or threads.
    progress : bool
        Bars on standard error.
    **settings
        Of `zoo.sample`, for the chains.

    Returns
    -------
    DataFrame
        One row a fit: scenario, data_set, file, and the columns of `score_fit`.
    """
    scenarios = [s for s in scenarios if s.vessels <= len(base.vessels)]
    values = asdict(truth)
    studies: dict[int, list[Study]] = {}
    for vessels in dict.fromkeys(s.vessels for s in scenarios):
        studies[vessels] = [
            data_set(base, i, vessels, truth=truth, n_times=n_times) for i in range(data_sets)
        ]
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    with bar(progress) as show:
        for scenario in scenarios:
            pooled = scenario.model == "E"
            what = "solves" if pooled else "posteriors"
            task = show.add_task(f"{scenario.name}: {what}", total=points if pooled else data_sets)
            advance = partial(show.advance, task)
            made = studies[scenario.vessels]
            if pooled:
                found = _pooled(scenario, made, truth, folder, points, cores, advance)
            else:
                found = _sampled(scenario, made, values, folder, cores, names, settings, advance)
            rows += [{"scenario": scenario.name, "data_set": i, **row} for i, row in enumerate(found)]
    scores = pd.DataFrame(rows)
    scores.to_csv(folder / "scores.csv", index=False)
    return scores


def _sampled(
    scenario: Scenario,
    studies: Sequence[Study],
    values: Mapping[str, float],
    folder: Path,
    cores: int,
    names: Sequence[str],
    settings: Mapping[str, Any],
    done: Callable[[], None],
) -> list[dict[str, Any]]:
    """Chains for each data set."""
    jobs = [
        Job(
            folder / f"{scenario.model}-{scenario.vessels}-{i:02d}.nc",
            scenario.model,
            study,
            {"seed": 1 + i, **settings},
        )
        for i, study in enumerate(studies)
    ]
    fit_all(jobs, cores=cores, done=lambda path: done())
    return [{"file": job.path.name, **score_fit(job.path, job, values, names=names)} for job in jobs]


def _pooled(
    scenario: Scenario,
    studies: Sequence[Study],
    truth: Truth,
    folder: Path,
    points: int,
    cores: int,
    solved: Callable[[], None],
) -> list[dict[str, Any]]:
    """Weighted draws of one pool for all data sets; a pool that is there is not solved again."""
    import hashlib

    made_from = repr((truth, points, [study.checksum for study in studies], POOL_WIDTH, POOL_DOF))
    stamp = hashlib.sha256(made_from.encode()).hexdigest()[:12]
    file = folder / f"pool-{scenario.vessels}-{stamp}.npz"
    fields = list(Pool.__dataclass_fields__)
    if file.is_file():
        with np.load(file) as stored:
            pool = Pool(*(stored[name] for name in fields))
        for _ in range(points):
            solved()
    else:
        pool = fill_pool(studies, truth, points, cores=cores, solved=solved)
        np.savez(file, **{name: getattr(pool, name) for name in fields})
    rows = []
    for i, study in enumerate(studies):
        row, draws = score_pool(pool, asdict(truth), i)
        name = f"{scenario.model}-{scenario.vessels}-{i:02d}.nc"
        _save_draws(folder / name, draws, study, row)
        rows.append({"file": name, **row})
    return rows


def _save_draws(path: Path, draws: Mapping[str, Array], study: Study, row: Mapping[str, Any]) -> None:
    import arviz as az

    posterior = {name: values[None, :] for name, values in draws.items()}
    attrs = {
        "study": study.name,
        "study_checksum": study.checksum,
        "method": "Pareto-smoothed importance sampling from a pool around the truth",
        "effective_sample_size": row["ess_min"],
        "pareto_k": row["pareto_k"],
        **{f"{name}_version": version for name, version in versions().items()},
    }
    idata = az.from_dict(posterior=posterior)
    idata.attrs.update(attrs)
    save(idata, path)
