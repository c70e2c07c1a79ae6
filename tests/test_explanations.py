"""Posteriors of explanations in PyMC, against the screening's own evidence."""

from dataclasses import replace

import numpy as np
import pymc as pm
import pytest

from made import QUANTITY, made, screening_of
from zoo.core.diagnosis.estimates import posteriors_of
from zoo.core.diagnosis.hypothesis import NULL
from zoo.core.diagnosis.posteriors import explanation_model, sample_explanations
from zoo.core.diagnosis.scoring import EQUAL_EVIDENCE, Scored, score
from zoo.core.effects import EVERYWHERE
from zoo.core.errors.spectral import log_density
from zoo.core.inference.logposterior import LogPosterior


@pytest.fixture(scope="module")
def scored() -> Scored:
    study = made([("sensor-gain", (0.2,), EVERYWHERE)], series=(0,), n=128)
    return score(screening_of(study, ["sensor-gain", "inflow-shift"]).run())


def test_log_density_of_the_model_is_that_of_the_screening(scored: Scored) -> None:
    fit = scored.best["sensor-gain"]
    model, start = explanation_model(scored.screened, fit)
    H = scored.screened.screening.errors
    ip = model.initial_point()
    logp = model.compile_logp(vars=model.observed_RVs, sum=True)
    values = {rv.name: rv for rv in model.free_RVs}
    point = dict(ip)
    full = LogPosterior(model)
    q = full.from_values({n: np.asarray(start[n]) for n in values})
    point = full.point(q)
    e = fit.errors[QUANTITY]
    used = replace(
        e,
        sigma=start[f"sigma_{QUANTITY}"],
        ratio=start[f"ratio_{QUANTITY}"],
        tau=start[f"tau_{QUANTITY}"],
        delta=start[f"delta_{QUANTITY}"],
    )
    u = np.array([p.coordinate(float(start[p.name])) for p in fit.forward.parameters])
    computed = fit.forward(u)
    assert computed is not None
    wanted = log_density(scored.screened.screening.coefficients - computed, H.variances({QUANTITY: used}))
    assert float(logp(point)) == pytest.approx(wanted, rel=1e-8)


def test_posteriors_agree_with_the_screening(scored: Scored) -> None:
    """Mean, sd and interval of the scan are those of the draws; the margin is the same, but for 1."""
    found = sample_explanations(scored, cores=2, seed=1, draws=250, max_draws=250)
    assert set(found.found) == {NULL, "sensor-gain"}  # the other one is ruled out
    best = found.found["sensor-gain"]
    size = posteriors_of(scored.screened.screening, scored.best["sensor-gain"])[0]
    posterior = best.idata.posterior["sensor-gain.gain"]
    assert float(posterior.mean()) == pytest.approx(size.mean, abs=0.25 * size.sd)
    assert float(posterior.std()) == pytest.approx(size.sd, rel=0.2)
    ends = [float(posterior.quantile(p)) for p in (0.025, 0.975)]
    assert ends == pytest.approx([size.low, size.high], abs=0.4 * size.sd)
    ahead = best.log_marginal - found.found[NULL].log_marginal
    screened = scored.log_z["sensor-gain"] - scored.log_z[NULL]
    se = np.hypot(best.log_marginal_se, found.found[NULL].log_marginal_se)
    assert ahead == pytest.approx(screened, abs=EQUAL_EVIDENCE + 2 * se)
    assert found.waic.index[0] == "sensor-gain"
    assert found.loo.index[0] == "sensor-gain"
    summary = found.summary()
    assert summary["sensor-gain"]["elpd_waic_difference"] == 0.0
    assert isinstance(best.idata.posterior.sizes["draw"], int)
    assert pm.__version__ in str(best.idata.attrs)
