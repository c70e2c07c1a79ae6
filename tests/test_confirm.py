"""Posteriors of explanations in PyMC, against the screening's own evidence."""

import pickle

import numpy as np
import pymc as pm
import pytest

from test_screening import made
from zoo.blood.effects import Place
from zoo.core.diagnosis.confirm import HarmonicsOp, confirm, effect_model
from zoo.core.diagnosis.discrepancy import log_density
from zoo.core.diagnosis.screening import NO_GAP, Scored, Screening, score
from zoo.core.inference.logposterior import LogPosterior


@pytest.fixture(scope="module")
def scored() -> Scored:
    study = made([("sensor-gain", (0.2,), Place())], series=(0,), n=128)
    return score(Screening(study, effects=["sensor-gain", "inflow-shift"]).run())


def test_the_operation_survives_a_pickle(scored: Scored) -> None:
    fit = scored.best["sensor-gain"]
    op = HarmonicsOp(scored.screened.screening.study, "linear-constant", fit.hypothesis)
    again = pickle.loads(pickle.dumps(op))
    assert again == op
    a, b = op.evaluate(fit.u)[0], again.evaluate(fit.u)[0]
    np.testing.assert_array_equal(a, b)
    assert again.counts["solves"] == 1
    again.evaluate(fit.u)
    assert again.counts["solves"] == 1  # the last points are kept


def test_log_density_of_the_model_is_that_of_the_screening(scored: Scored) -> None:
    fit = scored.best["sensor-gain"]
    model = effect_model(scored.screened, fit)
    H = scored.screened.screening.harmonics
    ip = model.initial_point()
    logp = model.compile_logp(vars=model.observed_RVs, sum=True)
    values = {rv.name: rv for rv in model.free_RVs}
    from dataclasses import replace as change

    point = dict(ip)
    start = model.zoo_start
    full = LogPosterior(model)
    q = full.from_values({n: np.asarray(start[n]) for n in values})
    point = full.point(q)
    e = fit.errors["pressure_mmHg"]
    used = change(
        e,
        sigma=start["sigma_pressure"],
        ratio=start["ratio_pressure"],
        tau=start["tau_pressure"],
        delta=start["delta_pressure"],
    )
    u = np.array([np.log(start[p.name]) if p.log else start[p.name] for p in fit.forward.parameters])
    computed = fit.forward(u)
    assert computed is not None
    wanted = log_density(scored.screened.screening.data - computed, H.variances({"pressure_mmHg": used}))
    assert float(logp(point)) == pytest.approx(wanted, rel=1e-8)


def test_confirmation_agrees_with_the_screening(scored: Scored) -> None:
    """Posterior mean within its error, and the same explanation ahead by a like margin."""
    found = confirm(scored, cores=2, seed=1, draws=250, max_draws=250)
    assert set(found.found) == {NO_GAP, "sensor-gain"}  # the other one is ruled out
    best = found.found["sensor-gain"]
    mean, sd = scored.best["sensor-gain"].amplitude()
    posterior = best.idata.posterior["gain"]
    assert abs(float(posterior.mean()) - mean) < sd
    assert float(posterior.std()) == pytest.approx(sd, rel=0.4)
    ahead = best.log_marginal - found.found[NO_GAP].log_marginal
    screened = scored.log_z["sensor-gain"] - scored.log_z[NO_GAP]
    assert ahead == pytest.approx(screened, rel=0.15)
    assert found.waic.index[0] == "sensor-gain"
    assert found.loo.index[0] == "sensor-gain"
    summary = found.summary()
    assert summary["sensor-gain"]["elpd_waic_difference"] == 0.0
    assert isinstance(best.idata.posterior.sizes["draw"], int)
    assert pm.__version__ in str(best.idata.attrs)
