"""Rank tests against known laws; short calibrations of A and B, and controls that they must flag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import pymc as pm
import pytest
from benchmarks.paun2020 import calibration
from benchmarks.paun2020.calibration import (
    LOG_POSTERIOR,
    SIGMA2,
    Calibration,
    CalibrationError,
    Replicate,
    calibrated_model,
    cheap_options,
    drawn,
    passes,
    rank_table,
    ranks_of,
    simulate_and_rank,
    uniform,
)
from scipy import stats

from zoo.blood.baseline import get_baseline, study_model
from zoo.blood.solver import Solver
from zoo.blood.study import Study
from zoo.core.errors.independent import Independent
from zoo.core.errors.variables import IidErrors
from zoo.core.inference.steps import DEMetropolisZ

QUICK = {"method": "exact", "chains": 1, "tune": 100, "draws": 60, "thin": 4}


def quick(name: str, **changed: Any) -> Calibration:
    builder, study = calibrated_model(name)
    return replace(Calibration(builder, study, 5, 15, QUICK), **changed)


# -------------------------------------------------------------------------------------------------
# tests of ranks, without a model


def conjugate(n: int, ranked: int, scale: float) -> list[Replicate]:
    """y ~ N(theta, 1), theta ~ N(0, 1), and posterior draws `scale` times as wide as they should be."""
    rng = np.random.default_rng(3)
    theta = rng.standard_normal(n)
    y = theta + rng.standard_normal(n)
    draws = y[:, None] / 2 + scale * np.sqrt(0.5) * rng.standard_normal((n, ranked))
    ranks, sd = np.sum(draws < theta[:, None], axis=1), draws.std(axis=1)
    return [
        Replicate({"theta": t}, {"theta": int(r)}, {"theta": s}, 200.0, 1.0, "")
        for t, r, s in zip(theta, ranks, sd, strict=True)
    ]


def test_a_conjugate_posterior_passes_and_one_of_half_the_variance_does_not() -> None:
    right, wrong = conjugate(400, 79, 1.0), conjugate(400, 79, np.sqrt(0.5))
    assert passes(ranks_of(right), 79)
    assert not passes(ranks_of(wrong), 79)
    assert rank_table(right, 79).loc["theta", "in_band"]
    assert rank_table(right, 79).loc["theta", "narrowing"] == pytest.approx(np.sqrt(0.5), rel=0.1)
    # the truth is N(0, 1/2) around the mean, the interval is that of N(0, 1/4)
    expected = 2 * stats.norm.cdf(stats.norm.ppf(0.9) * np.sqrt(0.5)) - 1
    share = rank_table(wrong, 79).loc["theta", "cover_80"]
    assert share == pytest.approx(expected, abs=3 * np.sqrt(expected * (1 - expected) / 400))


def test_the_band_holds_uniform_ranks_as_often_as_it_says() -> None:
    ranks = pd.DataFrame(np.random.default_rng(1).integers(0, 20, size=(50, 400)))
    for prob in (0.9, 0.95):
        outside = 400 - int(uniform(ranks, 19, prob).sum())
        assert stats.binom.cdf(outside, 400, 1 - prob) > 1e-3
        assert stats.binom.sf(outside - 1, 400, 1 - prob) > 1e-3


def test_coverage_of_known_ranks() -> None:
    def shares(ranks: Any) -> list[float]:
        rows = [Replicate({"q": 0.0}, {"q": int(r)}, {"q": 1.0}, 1.0, 1.0, "") for r in ranks]
        return rank_table(rows, 19).loc["q", ["cover_50", "cover_80"]].tolist()

    assert shares(np.arange(20).repeat(5)) == [0.5, 0.8]
    assert shares([10] * 30) == [1.0, 1.0]
    assert shares([0] * 30) == [0.0, 0.0]


# -------------------------------------------------------------------------------------------------
# calibrations


def test_truths_have_the_prior_and_data_the_errors() -> None:
    """f3 uniform, the logarithm of sigma2 uniform, y - m normal of variance sigma2."""
    builder, study = calibrated_model("A")
    assert study.priors["sigma2"] == SIGMA2
    made = [drawn(builder, study, np.random.default_rng([9, k])) for k in range(150)]
    f3, sigma2 = (np.array([float(truth[name]) for _, truth in made]) for name in ("f3", "sigma2"))
    assert stats.kstest(f3, stats.uniform(2e4, 8e4).cdf).pvalue > 1e-3
    assert stats.kstest(np.log(sigma2), stats.uniform(np.log(1e-3), np.log(1e3)).cdf).pvalue > 1e-3
    solver = Solver.for_study(study, options=cheap_options())
    z = []
    for data, truth in made[:20]:
        outlets = {name: float(truth[name]) for name in ("psi1", "psi2", "c")}
        mean = solver.solve(float(truth["f3"]), **outlets).pressure_mmHg
        z.append((data.values - mean) / np.sqrt(truth["sigma2"]))
    assert stats.kstest(np.ravel(z), stats.norm.cdf).pvalue > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("name", "n"), [("A", 12), pytest.param("B", 32, marks=pytest.mark.nightly)])
def test_short_calibration(name: str, n: int) -> None:
    replicates = simulate_and_rank(quick(name), n)
    table = rank_table(replicates, 15)
    assert passes(ranks_of(replicates), 15), table.to_string()
    assert table.loc[["f3", "psi1", "psi2", "c"], "narrowing"].max() < 0.3


@pytest.mark.nightly  # a likelihood that is wrong is flagged below
def test_a_sampler_of_a_tempered_posterior_is_flagged(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tenth of the log-posterior: draws three times as wide."""
    right = DEMetropolisZ.delta_logp

    def tempered(self: Any, q: np.ndarray, q0: np.ndarray) -> float:
        return 0.1 * float(right(self, q, q0))

    monkeypatch.setattr(DEMetropolisZ, "delta_logp", tempered)
    ranks = ranks_of(simulate_and_rank(quick("A"), 6))
    assert not passes(ranks, 15), ranks.to_string()
    assert not uniform(ranks[[LOG_POSTERIOR]], 15, 0.999).any()


@dataclass(frozen=True)
class Halved(Independent):
    """Half of the variance that its parameter says."""

    def observe(self, name: str, mean: Any, ok: Any, variables: Mapping[str, Any]) -> Any:
        """With sigma2/2."""
        return IidErrors(name, mean, ok, variables["sigma2"] / 2, observed=self.on.values)


def half_variance(study: Study) -> pm.Model:
    """Model A, with errors of half the variance."""
    return study_model("half", get_baseline("A"), Halved())(study, options=cheap_options())


@pytest.mark.slow
def test_a_likelihood_of_half_the_variance_is_flagged() -> None:
    asked = quick("A")
    ranks = ranks_of(simulate_and_rank(replace(asked, builder=half_variance, truth=asked.builder), 6))
    assert not passes(ranks, 15), ranks.to_string()
    assert not uniform(ranks[["sigma2"]], 15, 0.999).any()


def test_finished_replicates_are_kept(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A killed run goes on, a replicate depends on its seed and number only, and others are refused."""
    asked = quick("A", settings={**QUICK, "tune": 20, "draws": 20})
    [first, second] = simulate_and_rank(asked, 2, tmp_path)
    assert set(first.rank) == {"f3", "psi1", "psi2", "c", "sigma2", LOG_POSTERIOR}
    (tmp_path / "0000.json").unlink()
    before = (tmp_path / "0001.json").stat().st_mtime_ns
    again = simulate_and_rank(asked, 2, tmp_path)
    assert [one.rank for one in again] == [first.rank, second.rank]
    assert (tmp_path / "0001.json").stat().st_mtime_ns == before
    monkeypatch.setattr(calibration, "replicate", None)
    assert simulate_and_rank(asked, 2, tmp_path) == again
    with pytest.raises(CalibrationError, match=r"0000\.json: a replicate of another calibration"):
        simulate_and_rank(replace(asked, seed=6), 2, tmp_path)


@pytest.mark.slow
def test_draws_of_a_surrogate_are_made_exact_and_converge() -> None:
    [made] = simulate_and_rank(quick("B", settings={"method": "surrogate", "chains": 2, "draws": 250}), 1)
    assert made.correction == ""
    assert made.ess > 160
