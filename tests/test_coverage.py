"""Densities of the truth against analytic ones, coverage against known ranks, a small study in full."""

from __future__ import annotations

from dataclasses import asdict, replace

import arviz as az
import numpy as np
import pandas as pd
import pymc as pm
import pytest
from scipy import stats

from zoo import load_study, model_E, sample
from zoo.core.inference.logposterior import LogPosterior
from zoo.paper.cheap import cheap_study
from zoo.paper.coverage import IDENTIFIABLE, LEVELS, Scenario, coverage, data_set, run, summarise
from zoo.paper.pool import K_LIMIT, fill_pool, score_pool
from zoo.paper.synthetic import Truth
from zoo.paper.table4 import published_table4
from zoo.paper.truth import PAPER_TRUTH, SCALES, THETA, kernel_density, marginal_density, relative_sse


def test_truth_is_the_published_row_of_model_e():
    row = published_table4()["E"].parameters
    assert {name: row[name].median for name in (*THETA, "w", "b")} == {
        name: getattr(PAPER_TRUTH, name) for name in (*THETA, "w", "b")
    }


def test_relative_sse():
    assert relative_sse({"a": 1.1, "b": 3.0}, {"a": 1.0, "b": 4.0}) == pytest.approx(0.01 + 0.0625)


def test_kernel_density_of_a_normal():
    draws = np.random.default_rng(1).standard_normal((2, 20_000))
    assert kernel_density(draws[0], 0.3) == pytest.approx(stats.norm.pdf(0.3), rel=0.04)
    expected = stats.norm.pdf(0.3) * stats.norm.pdf(-0.5)
    assert kernel_density(draws, [0.3, -0.5]) == pytest.approx(expected, rel=0.08)


def test_marginal_density_with_the_rest_integrated_out():
    """A bounded parameter and a normal one, the variance integrated out: against integration on a grid."""
    y = 1.5 + 0.4 * stats.norm.ppf((np.arange(40) + 0.5) / 40)
    with pm.Model() as model:
        a = pm.Uniform("a", 0.0, 4.0)
        b = pm.Normal("b", 0.0, 1.0)
        s = pm.HalfNormal("s", 1.0)
        pm.Normal("y", a + 0.5 * b, s, observed=y)
    logp = LogPosterior(model)
    one = {"a": 1.3, "b": 0.4, "s": 0.5}
    np.testing.assert_allclose(logp.from_draws({n: [v] for n, v in one.items()})[0], logp.from_values(one))

    ga, gb, gs = np.linspace(0.005, 3.995, 120), np.linspace(-4, 4, 120), np.linspace(0.25, 0.7, 60)
    a, b, s = np.meshgrid(ga, gb, gs, indexing="ij")
    m = a + 0.5 * b
    squares = ((y - y.mean()) ** 2).sum() + len(y) * (y.mean() - m) ** 2
    log_density = -len(y) * np.log(s) - squares / (2 * s**2) - b**2 / 2 - s**2 / 2
    density = np.exp(log_density - log_density.max())
    share = density / density.sum()
    rng = np.random.default_rng(7)
    which = rng.choice(share.size, size=800, p=share.ravel())
    cell = [g[1] - g[0] for g in (ga, gb, gs)]
    draws = {
        name: (grid.ravel()[which] + width * rng.uniform(-0.5, 0.5, 800)).reshape(2, 400)
        for name, grid, width in zip("abs", (a, b, s), cell, strict=True)
    }
    lp = [logp(q) for q in logp.from_draws({n: draws[n].ravel() for n in "abs"})]
    idata = az.from_dict(posterior=draws, sample_stats={"lp": np.reshape(lp, (2, 400))})

    i, j = 39, 66
    expected = share[i, j].sum() / (cell[0] * cell[1])
    truth = {"a": float(ga[i]), "b": float(gb[j])}
    assert expected > 0.1
    assert marginal_density(idata, model, truth, n_draws=800) == pytest.approx(expected, rel=0.15)


def scores(ranks: dict[str, np.ndarray]) -> pd.DataFrame:
    rows = []
    for scenario, values in ranks.items():
        for rank in values:
            rows.append({"scenario": scenario, **{f"rank_{name}": rank for name in IDENTIFIABLE}})
    return pd.DataFrame(rows)


def test_coverage_tells_calibrated_from_overconfident():
    uniform = (np.arange(40) + 0.5) / 40
    extreme = np.where(uniform < 0.5, 0.001, 0.999)
    table = coverage(scores({"good": uniform, "bad": extreme}))
    good, bad = (table[table["scenario"] == name] for name in ("good", "bad"))
    assert good["within"].all()
    assert list(good["share"].unique()) == [0.5, 0.8, 0.95]
    assert not bad["within"].any()
    assert (bad["covered"] == 0).all()
    assert len(good) == len(IDENTIFIABLE) * len(LEVELS)


def test_data_sets_share_the_truth_and_have_errors_of_their_own():
    base = load_study("demo")
    one, again, other = (data_set(base, number, 3, n_times=32) for number in (0, 0, 1))
    np.testing.assert_array_equal(one.values, again.values)
    assert np.abs(one.values - other.values).max() > 0.1
    assert [(s.vessel, s.position) for s in one.series] == [(1, 0.0), (2, 0.5), (3, 0.5)]


@pytest.fixture(scope="module")
def cheap():
    """The cheap tree with the cells of the pool, and an error process that leaves wide posteriors."""
    base = replace(cheap_study(64), numerics={"dx_cm": 0.025})
    return base, Truth(f1=2e6, f2=-200.0, f3=4.3e4, psi1=0.6, psi2=0.9, c=1.2, w=4e4, b=60.0)


def test_pool_agrees_with_chains(cheap, tmp_path):
    """Weighted draws of a pool and a chain's draws are of one posterior."""
    base, truth = cheap
    study = data_set(base, 0, 1, truth=truth, n_times=64)
    pool = fill_pool([study], truth, 16_000, seed=1)
    row, draws = score_pool(pool, asdict(truth), 0, n_draws=4000)
    assert row["pareto_k"] < K_LIMIT
    assert row["ess_min"] > 100
    idata = sample(model_E(study), draws=600, tune=400, thin=2, chains=4, cores=0, seed=2, progress=False)
    for name in IDENTIFIABLE:
        chain = idata["posterior"][name].to_numpy().ravel()
        ours, theirs = (np.quantile(x, (0.1, 0.5, 0.9)) for x in (draws[name], chain))
        assert np.all(np.abs(ours - theirs) < np.array([0.6, 0.35, 0.6]) * chain.std()), name
    density = marginal_density(idata, model_E(study), {n: asdict(truth)[n] for n in THETA}, n_draws=1000)
    scale = np.prod([SCALES[name] for name in THETA])
    assert row["joint_direct"] == pytest.approx(density * scale, rel=0.35)


def test_pool_says_when_its_weights_cannot_be_trusted(cheap):
    """A pool around another truth."""
    base, truth = cheap
    study = data_set(base, 0, 1, truth=truth, n_times=64)
    pool = fill_pool([study], replace(truth, psi2=1.6, f3=5.5e4), 1000, seed=1)
    row, _ = score_pool(pool, asdict(truth), 0)
    assert not row["converged"]


@pytest.mark.slow
def test_a_small_study_from_end_to_end(cheap, tmp_path):
    """Chains and a pool; what is done is not done again."""
    base, truth = cheap
    scenarios = (Scenario("without", "A", 1), Scenario("with", "E", 1))
    settings = {"draws": 40, "tune": 60, "n_times": 64, "data_sets": 2, "scenarios": scenarios}
    settings |= {"points": 1500, "truth": truth, "progress": False, "names": IDENTIFIABLE, "cores": 1}
    found = run(base, tmp_path, **settings)
    assert list(found["scenario"]) == ["without", "without", "with", "with"]
    assert (found["joint_kde"] >= 0).all()
    table = summarise(found, IDENTIFIABLE)
    assert list(table["data_sets"]) == [2, 2]
    stamps = {p.name: p.stat().st_mtime_ns for p in tmp_path.glob("[Ap]*.n[cp]*")}
    assert len(stamps) == 3
    again = run(base, tmp_path, **settings)
    assert {p.name: p.stat().st_mtime_ns for p in tmp_path.glob("[Ap]*.n[cp]*")} == stamps
    pd.testing.assert_frame_equal(found, again)
    assert not list(tmp_path.glob("*.checkpoint"))
