"""NUTS in chains of ours: analytic posteriors, draws that no interruption changes, warnings."""

from __future__ import annotations

import arviz as az
import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest

from gaussian import DATA, MIXING, NOISE, PRIOR_SD, Doubling, gaussian_model, gaussian_posterior
from zoo.core.inference import sampling
from zoo.core.inference.chain import Chain, Task
from zoo.core.inference.logposterior import SamplingError
from zoo.core.inference.memo import read_lines
from zoo.core.inference.methods import sample
from zoo.core.inference.record import RunRecord
from zoo.core.inference.spaces import Gaussian

SETTINGS = {"draws": 150, "tune": 120, "chains": 2, "seed": 11, "progress": False}


class SmoothDoubling(Doubling):
    """The same with a gradient."""

    def L_op(self, inputs, outputs, output_grads):
        return [2.0 * output_grads[0]]

    pullback = L_op  # its name in PyTensor 3


def smooth_model(limit: float = -np.inf, seconds: float = 0.0) -> pm.Model:
    """`gaussian_model` with a gradient."""
    with pm.Model() as model:
        a = pm.Normal("a", 0.0, PRIOR_SD[0])
        bc = pm.Normal("bc", 0.0, PRIOR_SD[1:], shape=2)
        x, ok = SmoothDoubling(limit, seconds)(pt.concatenate([a[None], bc]))
        pm.Normal("y", pt.dot(MIXING, x / 2.0), NOISE, observed=DATA)
        pm.Potential("solved", pt.switch(pt.eq(ok, 1), 0.0, -np.inf))
    return model


def funnel() -> pm.Model:
    with pm.Model() as model:
        scale = pm.Normal("scale", 0.0, 3.0)
        pm.Normal("x", 0.0, pt.exp(scale / 2.0), shape=8)
    return model


@pytest.fixture(scope="module")
def uninterrupted():
    return sample(smooth_model(), method="nuts", cores=2, **SETTINGS)


def test_the_posterior_is_the_analytic_one():
    idata = sample(smooth_model(), method="nuts", cores=0, **{**SETTINGS, "draws": 500, "chains": 4})
    mean, covariance = gaussian_posterior()
    p = idata.posterior
    for i, draws in enumerate([p.a.to_numpy(), p.bc.to_numpy()[..., 0], p.bc.to_numpy()[..., 1]]):
        ess = float(az.ess(draws))
        assert ess > 800
        sd = np.sqrt(covariance[i, i])
        assert abs(draws.mean() - mean[i]) < 4.0 * sd / np.sqrt(ess)
        assert draws.std() == pytest.approx(sd, rel=0.1)
    assert not idata.sample_stats["diverging"].any()


def test_statistics_and_record(uninterrupted):
    s, record = uninterrupted.sample_stats, RunRecord.of(uninterrupted)
    assert dict(s.sizes) == {"chain": 2, "draw": 150}
    assert record.settings["step"] == "nuts"
    assert record.settings["tune"] == 120
    assert record.steps == 2 * (120 + 150)
    # a solve for each gradient, of a trajectory or where it begins
    np.testing.assert_array_equal(s["solves"], s["gradients"])
    assert record.solves >= int(s["solves"].sum()) + 2 * 120 * 2
    assert 0.75 < float(s["accept"].mean()) < 0.97
    assert float(s["accepted"].mean()) > 0.8
    logp = smooth_model().compile_logp()
    p = uninterrupted.posterior.isel(chain=1, draw=7)
    expected = logp({"a": p.a.to_numpy(), "bc": p.bc.to_numpy()})
    assert float(s["lp"][1, 7]) == pytest.approx(float(expected), rel=1e-9)


def test_a_chain_that_begins_again_with_a_part_of_its_memo_draws_the_same():
    around = Gaussian(np.zeros(3), np.eye(3))
    task = Task(smooth_model(), 0, 5, np.zeros(3), around, np.zeros((0, 3)), "nuts", {}, 120, 1)
    whole = Chain(task, {})
    whole.run(60)
    lines = whole.report(0).lines.splitlines(keepends=True)
    again = Chain(task, read_lines("", b"".join(lines[: len(lines) // 2]), "memo"))
    again.run(60)
    np.testing.assert_array_equal(again.draws["a"], whole.draws["a"])
    assert again.stats == whole.stats
    assert again.report(0).solves == whole.report(0).solves
    assert len(again.report(0).lines) == 0
    solved = Chain(task, read_lines("", b"".join(lines), "memo"))
    solved.run(60)
    assert solved.lines == []


def test_failed_solves_are_counted_and_their_points_not_taken():
    """The posterior is cut where the solver fails."""
    idata = sample(smooth_model(limit=-1.0), method="nuts", cores=0, **SETTINGS)
    draws = np.concatenate([idata.posterior.a.to_numpy()[..., None], idata.posterior.bc.to_numpy()], axis=-1)
    assert draws.min() >= -1.0
    assert RunRecord.of(idata).failures["collapse"] > 0


def test_trajectories_that_diverge_are_told(capsys):
    sample(funnel(), method="nuts", cores=0, **{**SETTINGS, "draws": 100, "tune": 30, "progress": True})
    assert "trajectories diverged: a part of the posterior may be out of reach" in capsys.readouterr().err
    sample(smooth_model(), method="nuts", cores=0, **{**SETTINGS, "progress": True})
    shown = capsys.readouterr().err
    assert "2 chains of nuts, tune 120, thin 1, seed 11" in shown
    assert "diverged" not in shown


def test_a_model_without_a_gradient_is_refused():
    with pytest.raises(SamplingError, match="has no gradient"):
        sampling.sample(gaussian_model(), nuts=True, progress=False)
