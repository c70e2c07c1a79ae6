"""Rank tests against known laws; a short calibration of A and B, and controls that it must flag."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pymc as pm
import pytest
from scipy import stats

from zoo.blood.baseline import blood_model, get_baseline
from zoo.blood.solver import Solver
from zoo.blood.study import Series, Study
from zoo.core.errors.independent import Independent
from zoo.core.errors.variables import IidErrors
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.posterior.ranks import LOG_POSTERIOR, CalibrationError, RankTest
from zoo.models import get_model
from zoo.paper import calibration, replicator
from zoo.paper.calibration import simulate_and_rank
from zoo.paper.cheap import cheap_options, cheap_study
from zoo.paper.replicator import Replicator, Settings

QUICK = Settings(ranked=15, chains=1, tune=100, steps=120, max_steps=480, min_ess=15)
LIMITS = {"A": {"sigma2": (1e-3, 1.0)}, "B": {}}


def builder(name: str) -> Any:
    return partial(get_model(name), options=cheap_options())


@pytest.fixture(scope="module")
def replicators() -> dict[str, Replicator]:
    return {name: Replicator(builder(name), cheap_study(), limits=LIMITS[name]) for name in "AB"}


def ranks_of(replicator: Replicator, n: int, seed: int = 5) -> RankTest:
    return RankTest.of([replicator.replicate(seed, k, QUICK) for k in range(n)], QUICK.ranked)


# -------------------------------------------------------------------------------------------------
# tests of ranks, without a model


def conjugate(n: int, ranked: int, scale: float, seed: int = 3) -> RankTest:
    """y ~ N(theta, 1), theta ~ N(0, 1), and posterior draws `scale` times as wide as they should be."""
    rng = np.random.default_rng(seed)
    theta = rng.standard_normal(n)
    y = theta + rng.standard_normal(n)
    draws = y[:, None] / 2 + scale * np.sqrt(0.5) * rng.standard_normal((n, ranked))
    return RankTest(("theta",), np.sum(draws < theta[:, None], axis=1)[:, None], ranked)


def test_a_conjugate_posterior_passes_and_one_of_half_the_variance_does_not() -> None:
    right, wrong = conjugate(400, 79, 1.0), conjugate(400, 79, np.sqrt(0.5))
    assert right.passes()
    assert not wrong.passes()
    assert wrong.chi_square()[0] < 1e-3
    assert right.table().loc["theta", "in_band"]
    assert not wrong.table().loc["theta", "in_band"]
    # the truth is N(0, 1/2) around the mean, the interval is that of N(0, 1/4)
    expected = 2 * stats.norm.cdf(stats.norm.ppf(0.9) * np.sqrt(0.5)) - 1
    share = wrong.coverage([0.8])["share"].item()
    assert share == pytest.approx(expected, abs=3 * np.sqrt(expected * (1 - expected) / 400))


def test_p_values_of_uniform_ranks_are_uniform() -> None:
    ranks = np.random.default_rng(1).integers(0, 20, size=(50, 400))
    test = RankTest(tuple(f"q{i}" for i in range(400)), ranks, 19)
    for p in (test.ecdf_p(), test.chi_square(10)):
        rejected = int(np.sum(p < 0.1))
        assert stats.binom.cdf(rejected, 400, 0.1) > 1e-3
        assert stats.binom.sf(rejected - 1, 400, 0.1) > 1e-3


def test_the_band_holds_what_the_p_value_says() -> None:
    """Against ArviZ' band: outside of the 95 % band is, but for near ties, a p-value below 0.05."""
    ranks = np.random.default_rng(2).integers(0, 20, size=(80, 500))
    test = RankTest(tuple(f"q{i}" for i in range(500)), ranks, 19)
    low, high = test.band()
    difference = test.ecdf_difference()
    outside = np.any((difference < low[:, None] - 1e-9) | (difference > high[:, None] + 1e-9), axis=0)
    assert 5 <= outside.sum() <= 50
    p = test.ecdf_p()
    assert np.all(p[outside] < 0.08)
    assert np.all(p[~outside] > 0.02)


def test_histogram_and_coverage_of_known_ranks() -> None:
    test = RankTest(("q",), np.arange(20)[:, None].repeat(5, axis=0), 19)
    assert test.histogram(4)[:, 0].tolist() == [25, 25, 25, 25]
    assert np.allclose(test.ecdf_difference(), 0)
    assert test.chi_square(4)[0] == 1.0
    table = test.coverage([0.5, 0.8])
    assert table["share"].tolist() == table["expected"].tolist() == [0.5, 0.8]
    assert RankTest(("q",), np.full((30, 1), 10), 19).coverage([0.5])["share"].item() == 1.0
    assert RankTest(("q",), np.zeros((30, 1)), 19).coverage([0.8])["share"].item() == 0.0
    with pytest.raises(CalibrationError, match="bins = 3"):
        test.histogram(3)
    with pytest.raises(CalibrationError, match="0 to 19"):
        RankTest(("q",), np.array([[20]]), 19)


# -------------------------------------------------------------------------------------------------
# one replicate


@pytest.mark.parametrize("name", ["A", "B"])
def test_exchanged_data_give_the_posterior_of_a_model_made_with_them(
    replicators: dict[str, Replicator], name: str
) -> None:
    replicator = replicators[name]
    study = cheap_study()
    for seed in (1, 2):
        simulated = replicator.simulate(np.random.SeedSequence(seed))
        replicator.observe(simulated.data)
        [row] = simulated.data
        fresh = replace(study, series=(Series(1, 0.0, "pressure_mmHg", row),))
        logp = LogPosterior(builder(name)(fresh))
        q = logp.from_values(simulated.values)
        np.testing.assert_allclose(replicator.vector(simulated.values), q, rtol=1e-10)
        assert replicator.logp(q) == pytest.approx(logp(q), rel=1e-10)
        np.testing.assert_allclose(replicator.values(q), list(simulated.values.values()), rtol=1e-8)


def test_truths_have_the_prior_and_data_the_errors(replicators: dict[str, Replicator]) -> None:
    """f3 uniform, sigma2 inverse gamma between its limits, y - m normal of variance sigma2."""
    replicator = replicators["A"]
    drawn = [replicator.simulate(np.random.SeedSequence(9, spawn_key=(k,))) for k in range(150)]
    f3 = np.array([d.values["f3"] for d in drawn])
    sigma2 = np.array([d.values["sigma2"] for d in drawn])
    assert stats.kstest(f3, stats.uniform(2e4, 8e4).cdf).pvalue > 1e-3
    gamma = stats.gamma(0.001, scale=1 / 0.001)  # of 1/sigma2
    low, high = gamma.sf(1 / 1e-3), gamma.sf(1 / 1.0)
    assert stats.kstest(sigma2, lambda x: (gamma.sf(1 / x) - low) / (high - low)).pvalue > 1e-3
    solver = Solver.for_study(cheap_study(), options=cheap_options())
    z = []
    for d in drawn[:20]:
        outlets = {name: d.values[name] for name in ("psi1", "psi2", "c")}
        mean = solver.solve(d.values["f3"], **outlets).pressure_mmHg
        z.append((d.data - mean) / np.sqrt(d.values["sigma2"]))
    assert stats.kstest(np.ravel(z), stats.norm.cdf).pvalue > 1e-3


def test_a_replicate_depends_on_its_seed_and_number_only(replicators: dict[str, Replicator]) -> None:
    replicator = replicators["A"]
    first = replicator.replicate(5, 2, QUICK)
    replicator.replicate(5, 3, QUICK)
    again = replicator.replicate(5, 2, QUICK)
    assert replace(first, seconds=0.0, rhat=0.0) == replace(again, seconds=0.0, rhat=0.0)  # NaN of one chain
    assert set(first.rank) == {"f3", "psi1", "psi2", "c", "sigma2", LOG_POSTERIOR}
    assert min(first.ess.values()) >= QUICK.min_ess or first.steps == QUICK.max_steps


# -------------------------------------------------------------------------------------------------
# calibration


@pytest.mark.parametrize(("name", "n"), [("A", 20), ("B", 16)])
def test_short_calibration(replicators: dict[str, Replicator], name: str, n: int) -> None:
    test = ranks_of(replicators[name], n)
    assert test.passes(), test.table().to_string()
    narrowing = test.narrowing()
    assert max(narrowing[p] for p in ("f3", "psi1", "psi2", "c")) < 0.3


def test_a_sampler_of_a_tempered_posterior_is_flagged(
    replicators: dict[str, Replicator], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tenth of the log-posterior: draws three times as wide."""
    right = replicator._Step.delta_logp

    def tempered(self: Any, q: np.ndarray, q0: np.ndarray) -> float:
        return 0.1 * float(right(self, q, q0))

    monkeypatch.setattr(replicator._Step, "delta_logp", tempered)
    test = ranks_of(replicators["A"], 10)
    assert not test.passes(), test.table().to_string()
    assert test.ecdf_p()[test.names.index(LOG_POSTERIOR)] < 1e-3


@dataclass(frozen=True)
class Halved(Independent):
    """Half of the variance that its parameter says."""

    def observe(self, name: str, mean: Any, ok: Any, variables: Mapping[str, Any]) -> Any:
        """With sigma2/2."""
        return IidErrors(name, mean, ok, variables["sigma2"] / 2, observed=self.on.values)


def half_variance(study: Study) -> pm.Model:
    """Model A, with errors of half the variance."""
    return blood_model("half", study, get_baseline("A"), Halved(), options=cheap_options())


def test_a_likelihood_of_half_the_variance_is_flagged() -> None:
    limits = {"sigma2": (1e-3, 1.0)}
    test = simulate_and_rank(
        half_variance, cheap_study(), 8, limits=limits, truth=builder("A"), settings=QUICK, seed=5
    )
    assert not test.passes(), test.table().to_string()
    assert test.ecdf_p()[test.names.index("sigma2")] < 1e-3


def test_finished_replicates_are_kept(
    tmp_path: Path, replicators: dict[str, Replicator], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file cut in its last line goes on from there, and gives what one sitting gives."""
    path = tmp_path / "A.jsonl"
    run = partial(
        simulate_and_rank, builder("A"), cheap_study(), limits=LIMITS["A"], settings=QUICK, seed=5, path=path
    )
    run(2)
    content = path.read_text()
    path.write_text(content[:-40])
    test = run(3)
    expected = [replicators["A"].replicate(5, k, QUICK) for k in range(3)]
    assert [r.rank for r in test.replicates] == [r.rank for r in expected]
    assert len(path.read_text().splitlines()) == 4
    before = path.stat().st_mtime_ns
    assert np.array_equal(run(3).ranks, test.ranks)
    assert path.stat().st_mtime_ns == before
    with pytest.raises(CalibrationError, match="another calibration: seed is 5 there and 6 here"):
        run(3, seed=6)
    with monkeypatch.context() as other:
        other.setattr(calibration, "DEMETROPOLISZ", {**calibration.DEMETROPOLISZ, "constrained": 0.0})
        with pytest.raises(CalibrationError, match="another calibration: steps is"):
            run(3)
    path.write_text(path.read_text().replace('"constrained"', '"own_units"'))  # as former versions wrote it
    assert np.array_equal(run(3).ranks, test.ranks)
    path.write_text(json.dumps({"a": 1})[:-1] + "\n")
    with pytest.raises(CalibrationError, match="no file of replicates"):
        run(3)


@pytest.mark.slow
def test_processes_change_nothing(replicators: dict[str, Replicator]) -> None:
    test = simulate_and_rank(
        builder("A"), cheap_study(), 2, limits=LIMITS["A"], settings=QUICK, seed=5, cores=2
    )
    assert [r.rank for r in test.replicates] == [replicators["A"].replicate(5, k, QUICK).rank for k in (0, 1)]


def test_a_surrogate_samples_the_posterior_that_exact_chains_do(replicators: dict[str, Replicator]) -> None:
    """The same data of B by both: means and widths within Monte Carlo errors, and how it was made exact."""
    b = replicators["B"]
    simulated = b.simulate(np.random.SeedSequence(5, spawn_key=(0, 0)))
    b.observe(simulated.data)
    settings = Settings(ranked=79, chains=4, steps=250, max_steps=1000, method="surrogate")
    made = b.fit_on_surrogate(simulated.values, 1, settings)
    exact = b.fit(simulated.values, 1, Settings(chains=4, min_ess=800))
    assert made.correction in ("importance resampling", "delayed acceptance")
    assert made.k_hat is not None
    assert made.draws.shape[0] == 4
    assert min(made.ess.values()) > 100
    shape = (-1, made.draws.shape[2])
    one, two = made.draws.reshape(shape), exact.draws.reshape(shape)
    ess = [1 / made.ess[name] + 1 / exact.ess[name] for name in b.names[:-1]]
    assert np.all(np.abs(one.mean(0) - two.mean(0)) < 4 * two.std(0) * np.sqrt(ess))
    np.testing.assert_allclose(one.std(0), two.std(0), rtol=0.25)
    assert made.log_posterior[2, 7] == b.logp(made.draws[2, 7])


def test_errors_say_what_to_change(replicators: dict[str, Replicator]) -> None:
    with pytest.raises(CalibrationError, match="'chi' is no scalar parameter; it has f3, psi1"):
        Replicator(builder("A"), cheap_study(), limits={"chi": (0, 1)})
    with pytest.raises(CalibrationError, match="truth: its parameters are f3, psi1, psi2, c, w, b, not"):
        Replicator(builder("A"), cheap_study(), truth=builder("B"))
    with pytest.raises(CalibrationError, match="ranked = 99: more than the 1 x 60 steps"):
        Settings(ranked=99, chains=1, steps=60)
    with pytest.raises(CalibrationError, match="method = 'emulator': must be one of exact, surrogate"):
        Settings(method="emulator")
    with pytest.raises(CalibrationError, match="limits of sigma2: a surrogate samples the prior as it is"):
        replicators["A"].replicate(5, 0, Settings(method="surrogate"))
    with pytest.raises(CalibrationError, match=r"data of shape \(2, 3\)"):
        replicators["A"].observe(np.zeros((2, 3)))
    with pytest.raises(CalibrationError, match="failed solve"):
        replicators["A"].simulate(
            np.random.SeedSequence(1), {"f3": 9e5, "psi1": 1.0, "psi2": 1.0, "c": 1.0, "sigma2": 0.1}
        )
    with pytest.raises(CalibrationError, match="wall = 'stiff'"):
        cheap_options("stiff")
