"""Fits of many synthetic data sets of known truth: errors, densities of the truth, coverage of intervals.

Sections 6.1.1 and 6.6 of Paun et al. 2020 (Tables 3 and 5, figures 3 and 10).
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from zoo.mode import LogPosterior
from zoo.models import get_model
from zoo.posteriors import belongs, checkpoint_of, load_for, sample_to
from zoo.results import verdict
from zoo.study import Study
from zoo.synthetic import Truth, synthetic_study

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
    """One way to fit the data sets: a model, and the vessels whose pressures it sees."""

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


def _fit(job: Job) -> Path:
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    with threadpool_limits(1):
        sample_to(job.path, get_model(job.model)(job.study), cores=0, progress=False, **job.settings)
    shutil.rmtree(checkpoint_of(job.path), ignore_errors=True)
    return job.path


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
    if waiting:
        pool = ProcessPoolExecutor(cores, mp_context=get_context("spawn"))
        try:
            for future in as_completed([pool.submit(_fit, job) for job in waiting]):
                done(future.result())
        finally:
            pool.shutdown(cancel_futures=True)
    return [job.path for job in jobs]


# -------------------------------------------------------------------------------------------------
# what a fit says about the truth


def relative_sse(estimate: Mapping[str, float], truth: Mapping[str, float]) -> float:
    """Relative sum of squared errors: sum of ((theta_i - estimate_i)/theta_i)^2, eq. (6.1) of the paper."""
    return float(sum(((value - estimate[name]) / value) ** 2 for name, value in truth.items()))


def kernel_density(draws: ArrayLike, point: ArrayLike) -> float:
    """Gaussian kernel density at a point, bandwidth by Silverman's rule.

    Parameters
    ----------
    draws : array (n_dim, n_draws)
    point : array (n_dim,)

    References
    ----------
    Silverman 1986, Density Estimation for Statistics and Data Analysis.
    """
    from scipy.stats import gaussian_kde

    return float(gaussian_kde(np.atleast_2d(draws), bw_method="silverman")(np.atleast_1d(point))[0])


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
        joint_kde and joint_chen in units of `SCALES`; rank_NAME, share of draws below the truth; median_NAME;
        converged, rhat_max, ess_min.
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
        "joint_chen": marginal_density(idata, model, wanted) * scale,
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
        Index scenario: data_sets, converged, relative_sse, density_NAME, joint_kde, joint_chen.
    """
    columns = ["relative_sse", *(f"density_{name}" for name in names), "joint_kde", "joint_chen"]
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
    names : sequence of str
        Parameters to score.
    cores : int
        Processes.
    progress : bool
        A bar on standard error.
    **settings
        Of `zoo.sample`.

    Returns
    -------
    DataFrame
        One row a fit: scenario, data_set, file, and the columns of `score_fit`.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    scenarios = [s for s in scenarios if s.vessels <= len(base.vessels)]
    values = asdict(truth)
    studies: dict[tuple[int, int], Study] = {}
    jobs: list[tuple[Scenario, int, Job]] = []
    for number in range(data_sets):
        for scenario in scenarios:
            key = number, scenario.vessels
            if key not in studies:
                studies[key] = data_set(base, *key, truth=truth, n_times=n_times)
            path = folder / f"{scenario.model}-{scenario.vessels}-{number:02d}.nc"
            seeded = {"seed": 1 + number, **settings}
            jobs.append((scenario, number, Job(path, scenario.model, studies[key], seeded)))
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=not progress,
    )
    with bar:
        task = bar.add_task("fits of synthetic data", total=len(jobs))
        fit_all([job for *_, job in jobs], cores=cores, done=lambda path: bar.advance(task))
    rows = [
        {
            "scenario": scenario.name,
            "data_set": number,
            "file": job.path.name,
            **score_fit(job.path, job, values, names=names),
        }
        for scenario, number, job in jobs
    ]
    scores = pd.DataFrame(rows)
    scores["order"] = scores["scenario"].map({s.name: i for i, s in enumerate(scenarios)})
    scores = scores.sort_values(["order", "data_set"]).drop(columns="order").reset_index(drop=True)
    scores.to_csv(folder / "scores.csv", index=False)
    return scores
