"""Verdicts against draws whose effective sample size is known."""

from __future__ import annotations

import arviz as az
import numpy as np
import pytest

from gaussian import autoregressive, independent_draws
from zoo.core.arviz_lines import InferenceData, dataset, made
from zoo.core.inference.convergence import check_convergence, verdict
from zoo.core.inference.record import ResultsError


@pytest.fixture
def idata() -> InferenceData:
    return independent_draws()


def test_independent_draws_pass(idata):
    found = verdict(idata)
    assert found.passes
    assert [p.name for p in found.parameters] == ["c", "chi[0]", "chi[1]"]
    assert (found.chains, found.draws) == (4, 1000)
    assert found.text.startswith("converged: R-hat at most 1.0")
    assert found["chi[1]"].rhat == pytest.approx(float(az.rhat(dataset(idata)).chi[1]))
    assert found.max_rhat <= 1.01
    assert found.min_ess > 3000


def test_correlated_draws_fail_by_their_effective_size():
    rng = np.random.default_rng(1)
    draws = {"slow": autoregressive(rng, 4, 1500, 0.95), "fast": rng.normal(size=(4, 1500))}
    found = check_convergence(draws)
    expected = 6000 * 0.05 / 1.95
    assert found["slow"].ess_bulk == pytest.approx(expected, rel=0.35)
    assert not found.passes
    assert found["fast"].passes
    assert "slow: " in found.text
    assert f"bulk ESS {found['slow'].ess_bulk:.0f} < 400" in found.text
    assert "fast" not in found.text
    factor = 400 / min(found["slow"].ess_bulk, found["slow"].ess_tail)
    assert f"about {factor:.1f} times as many" in found.text
    assert check_convergence(draws, ess=50)["slow"].ess_bulk > 50


def test_chains_that_have_not_met():
    rng = np.random.default_rng(2)
    draws = rng.normal(size=(4, 1000))
    draws[0] += 5
    found = check_convergence({"c": draws})
    assert found["c"].rhat > 1.2
    assert "have not met: tune for longer" in found.text


def test_slow_drift_fails_by_rhat_alone():
    rng = np.random.default_rng(3)
    draws = rng.normal(size=(4, 4000))
    draws[0] += 0.35
    found = check_convergence({"c": draws}, ess=20)
    assert found["c"].rhat > 1.01
    assert not found.passes
    assert f"R-hat {found['c'].rhat:.3f} > 1.01" in found.text
    assert "ESS" not in found.text


def test_too_few_chains_or_draws():
    rng = np.random.default_rng(4)
    three = check_convergence({"c": rng.normal(size=(3, 2000))})
    assert not three.passes
    assert three["c"].passes
    assert "3 chains: at least 4 are needed" in three.text
    one = check_convergence({"c": rng.normal(size=(1, 2000))})
    assert not one["c"].passes
    few = check_convergence({"c": rng.normal(size=(4, 3))})
    assert not few.passes
    assert few.max_rhat == np.inf
    assert few.min_ess == 0


def test_constants_are_left_out_but_not_stuck_chains():
    rng = np.random.default_rng(5)
    found = check_convergence({"c": rng.normal(size=(4, 1000)), "fixed": np.full((4, 1000), 2.0)})
    assert [p.name for p in found.parameters] == ["c"]
    assert found.passes
    stuck = rng.normal(size=(4, 1000))
    stuck[:] = stuck[:, :1]  # each chain stays where it began
    found = check_convergence({"c": stuck})
    assert not found.passes
    nothing = check_convergence({"fixed": np.full((4, 100), 2.0)})
    assert not nothing.passes
    assert "no parameter varies" in nothing.text


def test_verdict_on_chosen_variables(idata):
    assert [p.name for p in verdict(idata, var_names=["c"]).parameters] == ["c"]
    with pytest.raises(ResultsError, match="no parameter 'zz' in the posterior; it has c, chi"):
        verdict(idata, var_names=["zz"])
    with pytest.raises(ResultsError, match="no group 'posterior'"):
        verdict(made({}))
    with pytest.raises(KeyError):
        verdict(idata)["zz"]
