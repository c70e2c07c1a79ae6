"""Tables 3 and 5 again: fits of many synthetic data sets of one known truth (sections 6.1.1 and 6.6)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from benchmarks.paun2020.pool import POOL_DOF, POOL_WIDTH, Pool, fill_pool, score_pool
from benchmarks.paun2020.synthetic import Truth, synthetic_study
from benchmarks.paun2020.table4 import numbers
from benchmarks.paun2020.truth import PAPER_TRUTH, THETA, score
from scipy.stats import binom

from zoo.blood.prior_tables import PAPER_SET
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Study
from zoo.core.arviz_lines import dataset
from zoo.core.inference.convergence import verdict
from zoo.core.inference.workers import each
from zoo.core.outputs import write_file
from zoo.core.posterior.files import matching, sample_to
from zoo.models import get_model

IDENTIFIABLE = ("f3", "psi1", "psi2", "c")
LEVELS = (0.5, 0.8, 0.95)


@dataclass(frozen=True)
class Scenario:
    """One way to fit the data sets: a model, and the vessels whose pressures it sees.

    Posteriors of model E are weighted draws of one pool of solves for all data sets, those of other models
    come from chains of their own.
    """

    name: str
    model: str
    vessels: int


FIRST = Scenario("mismatch, 1 vessel", "E", 1)
"""The scenario that ratios of joint densities are taken to."""
SCENARIOS = (
    Scenario("no mismatch, 1 vessel", "D", 1),
    FIRST,
    Scenario("mismatch, 3 vessels", "E", 3),
    Scenario("mismatch, 21 vessels", "E", 21),
)


def data_set(
    base: Study, number: int, vessels: int, *, truth: Truth = PAPER_TRUTH, n_times: int = 256
) -> Study:
    """One synthetic data set: the inlet of the root, and the middle of the vessels next to it.

    Made on the grid that the models use, as in the paper: with 21 vessels the difference to a fine grid moves
    f3 by about a posterior standard deviation (docs/reproduction.md), which is no question of statistics.
    Errors are not selected so that pressures fall towards the periphery: selected ones look like a larger
    pressure drop and are no draws of the law that the models assume.

    Parameters
    ----------
    base : Study
        Vessels, inflow and conventions.
    number : int
        From 0; the seed of its errors is 1000 + number.
    vessels, n_times : int
        How many vessels are seen, in the order of the study's file, and samples in the beat.
    truth : Truth
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


def run(
    base: Study,
    folder: Path,
    *,
    data_sets: int = 20,
    scenarios: Sequence[Scenario] = SCENARIOS,
    truth: Truth = PAPER_TRUTH,
    n_times: int = 256,
    points: int = 12_000,
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
        For posteriors of chains and pools (kept, so that an interrupted run goes on) and scores.csv.
    data_sets, n_times, points, cores : int
        How many, samples of each series, solves of each pool, processes or threads.
    scenarios : sequence of Scenario
        Those of more vessels than `base` has are left out.
    truth : Truth
    progress : bool
        A bar for each pool.
    **settings
        Of `zoo.sample`, for the chains.

    Returns
    -------
    DataFrame
        One row a fit: scenario, data_set, joint_direct (NaN of chains), converged, ess_min, and the
        columns of `score`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for scenario in scenarios:
        if scenario.vessels > len(base.vessels):
            continue
        studies = [
            data_set(base, i, scenario.vessels, truth=truth, n_times=n_times) for i in range(data_sets)
        ]
        if scenario.model == "E":
            pool = _stored_pool(studies, truth, points, folder, cores, progress)
            found = [score_pool(pool, truth, i) for i in range(data_sets)]
        else:
            work = partial(_sampled, folder, scenario.model, truth, settings)
            done = {i: row for (i, _), row in each(work, list(enumerate(studies)), cores)}
            found = [done[i] for i in range(data_sets)]
        rows += [{"scenario": scenario.name, "data_set": i, **row} for i, row in enumerate(found)]
    scores = pd.DataFrame(rows)
    write_file(folder / "scores.csv", scores.to_csv(index=False))
    return scores


def _sampled(
    folder: Path, name: str, truth: Truth, settings: dict[str, Any], job: tuple[int, Study]
) -> dict[str, Any]:
    """The score of a fit by chains of its own, to a data set and its number."""
    number, study = job
    model = get_model(name)(study)
    path = folder / f"{name}-{len(study.series)}-{number:02d}.nc"
    idata = matching(path, model)
    if idata is None:
        idata = sample_to(path, model, cores=0, progress=False, seed=1 + number, **settings)
    found, posterior = verdict(idata), dataset(idata)
    draws = {name: posterior[name].to_numpy().ravel() for name in THETA if name in posterior}
    judged = {"converged": found.passes, "ess_min": found.min_ess}
    return {**score(draws, truth), "joint_direct": np.nan, **judged}


def _stored_pool(
    studies: Sequence[Study], truth: Truth, points: int, folder: Path, cores: int, progress: bool
) -> Pool:
    """The pool of these data sets: that of the folder, or one that is solved and kept there."""
    made_from = repr((truth, points, [study.checksum for study in studies], POOL_WIDTH, POOL_DOF))
    stamp = hashlib.sha256(made_from.encode()).hexdigest()[:12]
    file = folder / f"pool-{len(studies[0].series)}-{stamp}.npz"
    names = [field.name for field in fields(Pool)]
    if file.is_file():
        with np.load(file) as stored:
            return Pool(*(stored[name] for name in names))
    pool = fill_pool(studies, truth, points, cores=cores, progress=progress)
    content = BytesIO()
    np.savez(content, **{name: getattr(pool, name) for name in names})
    write_file(file, content.getvalue())
    return pool


def tables(scores: pd.DataFrame) -> pd.DataFrame:
    """Tables 3 and 5 beside the published ones: medians over the data sets.

    Joint densities depend on the units of the parameters, which the paper does not tell: only their ratios
    to the first scenario with mismatch can be compared.

    Parameters
    ----------
    scores : DataFrame
        From `run`.

    Returns
    -------
    DataFrame
        Index scenario: data_sets, converged, relative_sse, density_NAME, joint_kde, joint_direct and
        joint_ratio, with published_relative_sse, published_density_NAME and published_joint_ratio.
    """
    densities = [name for name in scores if name.startswith("density_")]
    grouped = scores.groupby("scenario", sort=False)
    table = grouped[["relative_sse", *densities, "joint_kde", "joint_direct"]].median()
    table.insert(0, "data_sets", grouped.size())
    table.insert(1, "converged", grouped["converged"].sum())
    printed = numbers()
    published = {
        SCENARIOS[0].name: printed["table3"]["no"],
        FIRST.name: printed["table3"]["yes"] | {"joint": printed["table5"]["1"]["joint"]},
        SCENARIOS[2].name: printed["table5"]["3"],
        SCENARIOS[3].name: printed["table5"]["21"],
    }
    rows = {}
    for scenario in table.index:
        theirs = published.get(scenario, {})
        marginal = theirs.get("marginal", [np.nan] * len(THETA))
        rows[scenario] = {
            "published_relative_sse": theirs.get("relative_sse", np.nan),
            **{f"published_density_{name}": d for name, d in zip(THETA, marginal, strict=True)},
            "published_joint_ratio": np.max(theirs.get("joint", np.nan)) / published[FIRST.name]["joint"],
        }
    table = table.join(pd.DataFrame.from_dict(rows, orient="index"))
    table["joint_ratio"] = table["joint_direct"] / table["joint_direct"].get(FIRST.name, np.nan)
    return table


def coverage(scores: pd.DataFrame) -> pd.DataFrame:
    """How often central intervals hold the truth, with the range that chance allows.

    Parameters
    ----------
    scores : DataFrame
        A row for each fit: scenario, and rank_NAME, the share of draws below the truth.

    Returns
    -------
    DataFrame
        Columns scenario, parameter, level, covered, data_sets, low, high (central 95 % of the binomial with
        `level`), within.
    """
    rows = []
    for scenario, group in scores.groupby("scenario", sort=False):
        n = len(group)
        for name in IDENTIFIABLE:
            away = np.abs(group[f"rank_{name}"].to_numpy() - 0.5)
            for level in LEVELS:
                covered = int(np.sum(away <= level / 2))
                low, high = (int(x) for x in binom.interval(0.95, n, level))
                rows.append((scenario, name, level, covered, n, low, high, low <= covered <= high))
    columns = ["scenario", "parameter", "level", "covered", "data_sets", "low", "high", "within"]
    return pd.DataFrame(rows, columns=columns)
