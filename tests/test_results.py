"""Records, files and verdicts, against draws whose effective sample size is known."""

from __future__ import annotations

import json

import arviz as az
import numpy as np
import pytest

from zoo.core.inference import results
from zoo.core.inference.results import ResultsError, RunRecord, diagnose, geweke, load, mpsrf, save, verdict


def autoregressive(rng: np.random.Generator, chains: int, draws: int, phi: float) -> np.ndarray:
    """AR(1) draws with unit variance; their effective sample size is n (1 - phi) / (1 + phi)."""
    noise = rng.normal(size=(chains, draws))
    out = np.empty((chains, draws))
    out[:, 0] = noise[:, 0]
    for i in range(1, draws):
        out[:, i] = phi * out[:, i - 1] + np.sqrt(1 - phi**2) * noise[:, i]
    return out


@pytest.fixture
def record() -> RunRecord:
    return RunRecord(
        model="B",
        study="demo",
        study_checksum="abc",
        conventions={"name": "printed", "wall_factor": 1.0},
        solver={"dx_cm": 0.025},
        settings={"step": "demetropolisz", "tune": 1000},
        seed=7,
        solves=4000,
        steps=4000,
        mode_evaluations=120,
        failures={"cfl": 2},
        solves_per_draw=6.0,
        solves_per_step=1.0,
        wall_seconds=12.5,
        sittings=1,
        started="2026-01-01T00:00:00+00:00",
    )


@pytest.fixture
def idata() -> az.InferenceData:
    rng = np.random.default_rng(0)
    return az.from_dict(
        posterior={"c": rng.normal(size=(4, 1000)), "chi": rng.normal(size=(4, 1000, 2))},
        sample_stats={"lp": rng.normal(size=(4, 1000))},
    )


def test_record_survives_the_file(tmp_path, idata, record):
    record.attach(idata)
    path = save(idata, tmp_path / "B.nc")
    again = load(path)
    assert RunRecord.of(again) == record
    np.testing.assert_array_equal(again.posterior.chi, idata.posterior.chi)
    np.testing.assert_array_equal(again.sample_stats.lp, idata.sample_stats.lp)
    assert list(tmp_path.iterdir()) == [path]  # no temporary file left
    path.unlink()  # and the file is not held open


def test_record_holds_the_versions(record):
    import pymc

    assert record.versions["pymc"] == pymc.__version__
    assert record.versions["numpy"] == np.__version__
    assert set(record.versions) == {"python", "zoo", "pymc", "pytensor", "arviz", "numpy"}


def test_record_in_plain_json_from_numpy_values(record):
    from dataclasses import replace

    odd = replace(record, seed=np.int64(3), solver={"dx_cm": np.float64(0.5), "points": np.arange(2)})
    raw = json.loads(odd.to_json())
    assert raw["seed"] == 3
    assert raw["solver"] == {"dx_cm": 0.5, "points": [0, 1]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "run record: not JSON"),
        ("[1]", "not a JSON object"),
        ("{}", "field 'model' is missing"),
    ],
)
def test_broken_record(text, message):
    with pytest.raises(ResultsError, match=message):
        RunRecord.from_json(text)


def test_record_of_a_later_version_drops_what_it_does_not_know(record):
    raw = json.loads(record.to_json())
    raw["weather"] = "fine"
    assert RunRecord.from_json(json.dumps(raw)) == record


def test_no_record(idata):
    with pytest.raises(ResultsError, match="no run record in this InferenceData"):
        RunRecord.of(idata)


def test_save_and_load_say_what_is_wrong(tmp_path, idata):
    with pytest.raises(ResultsError, match=r"folder .*nowhere does not exist; create it"):
        save(idata, tmp_path / "nowhere" / "A.nc")
    with pytest.raises(ResultsError, match=r"A\.nc: no such file; `zoo sample MODEL STUDY -o A\.nc`"):
        load(tmp_path / "A.nc")
    (tmp_path / "text.nc").write_text("not a posterior")
    with pytest.raises(ResultsError, match=r"text\.nc: not a readable NetCDF file"):
        load(tmp_path / "text.nc")
    az.from_dict(prior={"a": np.zeros((1, 3))}).to_netcdf(str(tmp_path / "prior.nc"))
    with pytest.raises(ResultsError, match="no group 'posterior'"):
        load(tmp_path / "prior.nc")


def test_independent_draws_pass(idata):
    found = verdict(idata)
    assert found.passes
    assert [p.name for p in found.parameters] == ["c", "chi[0]", "chi[1]"]
    assert (found.chains, found.draws) == (4, 1000)
    assert found.text.startswith("converged: R-hat at most 1.0")
    assert found["chi[1]"].rhat == pytest.approx(float(az.rhat(idata.posterior).chi[1]))
    assert found.max_rhat <= 1.01
    assert found.min_ess > 3000


def test_correlated_draws_fail_by_their_effective_size():
    rng = np.random.default_rng(1)
    draws = {"slow": autoregressive(rng, 4, 1500, 0.95), "fast": rng.normal(size=(4, 1500))}
    found = diagnose(draws)
    expected = 6000 * 0.05 / 1.95
    assert found["slow"].ess_bulk == pytest.approx(expected, rel=0.35)
    assert not found.passes
    assert found["fast"].passes
    assert "slow: " in found.text
    assert f"bulk ESS {found['slow'].ess_bulk:.0f} < 400" in found.text
    assert "fast" not in found.text
    factor = 400 / min(found["slow"].ess_bulk, found["slow"].ess_tail)
    assert f"about {factor:.1f} times as many" in found.text
    assert diagnose(draws, ess=50)["slow"].ess_bulk > 50


def test_chains_that_have_not_met():
    rng = np.random.default_rng(2)
    draws = rng.normal(size=(4, 1000))
    draws[0] += 5
    found = diagnose({"c": draws})
    assert found["c"].rhat > 1.2
    assert "have not met: tune for longer" in found.text


def test_slow_drift_fails_by_rhat_alone():
    rng = np.random.default_rng(3)
    draws = rng.normal(size=(4, 4000))
    draws[0] += 0.35
    found = diagnose({"c": draws}, ess=20)
    assert found["c"].rhat > 1.01
    assert not found.passes
    assert f"R-hat {found['c'].rhat:.3f} > 1.01" in found.text
    assert "ESS" not in found.text


def test_too_few_chains_or_draws():
    rng = np.random.default_rng(4)
    three = diagnose({"c": rng.normal(size=(3, 2000))})
    assert not three.passes
    assert three["c"].passes
    assert "3 chains: at least 4 are needed" in three.text
    one = diagnose({"c": rng.normal(size=(1, 2000))})
    assert not one["c"].passes
    few = diagnose({"c": rng.normal(size=(4, 3))})
    assert not few.passes
    assert few.max_rhat == np.inf
    assert few.min_ess == 0


def test_constants_are_left_out_but_not_stuck_chains():
    rng = np.random.default_rng(5)
    found = diagnose({"c": rng.normal(size=(4, 1000)), "fixed": np.full((4, 1000), 2.0)})
    assert [p.name for p in found.parameters] == ["c"]
    assert found.passes
    stuck = rng.normal(size=(4, 1000))
    stuck[:] = stuck[:, :1]  # each chain stays where it began
    found = diagnose({"c": stuck})
    assert not found.passes
    nothing = diagnose({"fixed": np.full((4, 100), 2.0)})
    assert not nothing.passes
    assert "no parameter varies" in nothing.text


def test_verdict_on_chosen_variables(idata):
    assert [p.name for p in verdict(idata, var_names=["c"]).parameters] == ["c"]
    with pytest.raises(ResultsError, match="no parameter 'zz' in the posterior; it has c, chi"):
        verdict(idata, var_names=["zz"])
    with pytest.raises(ResultsError, match="no group 'posterior'"):
        verdict(az.InferenceData())
    with pytest.raises(KeyError):
        verdict(idata)["zz"]


def test_version_of_what_is_not_installed():
    assert results._version("no-such-distribution") == "unknown"


def test_geweke_is_uniform_for_stationary_chains_and_small_for_a_drift():
    rng = np.random.default_rng(11)
    p = geweke(autoregressive(rng, 400, 600, 0.5))
    # a part of 60 correlated draws is short: the test is a little too strict, not wrong
    assert 0.03 < np.mean(p < 0.05) < 0.12
    assert 0.4 < np.mean(p < 0.5) < 0.6
    drifting = autoregressive(rng, 20, 600, 0.5) + np.linspace(0, 3, 600)
    assert np.all(geweke(drifting) < 0.02)
    assert np.isnan(geweke(np.ones((1, 50)))[0])
    with pytest.raises(ResultsError, match="too few"):
        geweke(np.zeros((4, 39)))


@pytest.mark.parametrize(("phi", "expected"), [(0.908, 0.09), (0.724, 0.06)])
def test_geweke_with_few_effective_draws_is_below_a_twentieth_more_often(phi: float, expected: float):
    """Effective sizes of 120 and 400 a chain: the numbers in docs/statistics.md."""
    p = geweke(autoregressive(np.random.default_rng(12), 2000, 2500, phi))
    assert np.mean(p < 0.05) == pytest.approx(expected, abs=0.015)


def test_mpsrf_of_one_scalar_is_the_classical_factor_and_bounds_those_of_many():
    rng = np.random.default_rng(12)
    x = rng.normal(size=(4, 200)) + np.array([0.0, 0.1, 0.2, 0.5])[:, None]
    n, m = 200, 4
    within, between = x.var(axis=1, ddof=1).mean(), x.mean(axis=1).var(ddof=1)
    classical = (n - 1) / n + (m + 1) / m * between / within
    assert mpsrf({"x": x}) == pytest.approx(classical)
    assert mpsrf({"x": 1e6 * x + 3}) == pytest.approx(classical)
    y = rng.normal(size=(4, 200, 3))
    both = mpsrf({"x": x, "y": y, "constant": np.ones((4, 200))})
    assert both >= classical
    assert mpsrf({"y": rng.normal(size=(4, 5000, 3))}) == pytest.approx(1, abs=0.01)
    assert np.isnan(mpsrf({"x": x[:1]}))


def test_slim_keeps_parameters_record_and_the_verdict_on_all_draws(tmp_path, record):
    rng = np.random.default_rng(5)
    whole = az.from_dict(
        posterior={
            "c": autoregressive(rng, 4, 1000, 0.5),
            "chi": 5e4 + rng.normal(size=(4, 1000, 3)),
            "waves": rng.normal(size=(4, 1000, 7)),
        },
        sample_stats={"accepted": np.linspace(0.1, 0.4, 4)[:, None].repeat(1000, 1)},
        observed_data={"y": np.arange(7.0)},
        dims={"waves": ["time"], "y": ["time"]},
        coords={"time": np.arange(7.0)},
    )
    record.attach(whole)
    small = load(save(results.slim(whole, 200), tmp_path / "B.nc"))
    assert small.groups() == ["posterior"]
    assert set(small.posterior.data_vars) == {"c", "chi"}
    assert "time" not in small.posterior.coords
    assert small.posterior.sizes == {"chain": 4, "draw": 50, "chi_dim_0": 3}
    kept = small.posterior.draw.to_numpy()
    assert (kept[0], kept[-1]) == (0, 999)
    assert set(np.diff(kept)) <= {20, 21}
    np.testing.assert_allclose(small.posterior.c, whole.posterior.c.isel(draw=kept), rtol=1e-6)
    assert RunRecord.of(small) == record
    found = results.diagnostics(small)
    assert found == results.diagnostics(whole)
    judged = verdict(whole)
    assert found.verdict == judged
    assert found.mpsrf == mpsrf({name: whole.posterior[name].to_numpy() for name in whole.posterior})
    assert found.geweke["c"] == tuple(geweke(whole.posterior.c))
    np.testing.assert_allclose(found.acceptance, np.linspace(0.1, 0.4, 4))
    assert results.diagnostics(results.slim(small, 40)).verdict.draws == 1000  # still of the whole run
    assert verdict(small).draws == 50
    assert whole.posterior.sizes["draw"] == 1000


def test_slim_refuses(idata, record):
    with pytest.raises(ResultsError, match="no run record"):
        results.slim(idata)
    record.attach(idata)
    with pytest.raises(ResultsError, match="n_draws = 0: keep at least one"):
        results.slim(idata, 0)
    idata.attrs["diagnostics_of_the_whole_run"] = "{}"
    with pytest.raises(ResultsError, match="slim the posterior again"):
        results.diagnostics(idata)
