"""Fits of many synthetic data sets of known truth: errors, densities of the truth, coverage of intervals.

Sections 6.1.1 and 6.6 of Paun et al. 2020 (Tables 3 and 5, figures 3 and 10).
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from zoo.blood.prior_tables import PAPER_SET
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.core.inference.convergence import verdict
from zoo.core.inference.progress import bar
from zoo.core.inference.record import versions
from zoo.core.inference.workers import each
from zoo.core.outputs import write_file
from zoo.core.posterior.files import belongs, checkpoint_of, load_for, sample_to
from zoo.core.posterior.storage import save
from zoo.models import get_model
from zoo.paper.pool import POOL_DOF, POOL_WIDTH, Pool, fill_pool, score_pool
from zoo.paper.synthetic import Truth, synthetic_study
from zoo.paper.truth import PAPER_TRUTH, SCALES, THETA, kernel_density, marginal_density, relative_sse

Array = NDArray[np.float64]


IDENTIFIABLE = ("f3", "psi1", "psi2", "c")
LEVELS = (0.5, 0.8, 0.95)


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
        replace(base, priors={"set": PAPER_SET}, noise_sd={}),
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
    write_file(folder / "scores.csv", scores.to_csv(index=False))
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
        stored = BytesIO()
        np.savez(stored, **{name: getattr(pool, name) for name in fields})
        write_file(file, stored.getvalue())
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
