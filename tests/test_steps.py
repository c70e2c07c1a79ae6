"""Step methods against PyMC's, and against laws that are known."""

from __future__ import annotations

import pickle
from types import SimpleNamespace

import arviz as az
import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from pymc.blocking import RaveledVars
from pymc.step_methods import CompoundStep
from scipy import stats

from gaussian import Doubling, gaussian_model, gaussian_posterior
from zoo.core.arviz_lines import effective
from zoo.core.inference.spaces import ConstrainedSpace, Gaussian
from zoo.core.inference.steps import DEMetropolisZ

QUIET = {"progressbar": False, "compute_convergence_checks": False}


def steps_of(step, point, n, seed=3, tune=0):
    """Draws of a step method in PyMC's own order of calls, and its statistics."""
    step.rng = np.random.default_rng(seed)
    step.tune = tune > 0
    step.reset_tuning()
    rows, records = [], []
    for i in range(n):
        if i == tune:
            step.stop_tuning()
        point, [record] = step.step(point)
        rows.append(np.concatenate([np.ravel(point[v.name]) for v in step.vars]))
        records.append(record)
    return np.array(rows), records


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (lambda m: DEMetropolisZ(model=m), lambda m: pm.DEMetropolisZ(model=m)),
        (
            lambda m: DEMetropolisZ(model=m, tune="lambda", scaling=0.1),
            lambda m: pm.DEMetropolisZ(model=m, tune="lambda", scaling=0.1),
        ),
    ],
)
def test_draws_equal_pymc(ours, theirs):
    model = gaussian_model()
    start = model.initial_point()
    mine, records = steps_of(ours(model), start, 900, tune=450)
    reference, their_records = steps_of(theirs(model), start, 900, tune=450)
    assert len(np.unique(reference[:, 0])) > 50
    np.testing.assert_array_equal(mine, reference)
    for name in ("accept", "scaling", "accepted"):
        np.testing.assert_allclose([r[name] for r in records], [r[name] for r in their_records], rtol=1e-9)


def test_a_log_posterior_that_is_no_number_is_refused_and_counts_so():
    with pm.Model() as model:
        a = pm.Normal("a", 0.5, 1.0)
        pm.Potential("half", pt.switch(a > 0.0, 0.0, np.nan))
    step = DEMetropolisZ(model=model, crank_nicolson=0.9, reference=Gaussian(np.zeros(1), np.eye(1)))
    draws, records = steps_of(step, {"a": np.array(0.5)}, 400, tune=200)
    assert np.all(draws > 0.0)
    sure = [r["accepted"] for r in records if r["accept"] >= 1.0]
    assert len(sure) > 50
    assert all(sure)


def test_demetropolisz_solves_once_a_step_and_reports_the_log_posterior():
    model = gaussian_model()
    step = DEMetropolisZ(model=model, scaling=0.1)
    draws, records = steps_of(step, model.initial_point(), 60)
    assert [r["solves"] for r in records] == [2] + [1] * 59
    logp = model.compile_logp()
    expected = [logp({"a": np.array(q[0]), "bc": q[1:]}) for q in draws]
    np.testing.assert_allclose([r["model_logp"] for r in records], expected, rtol=1e-12)


def test_memory_knows_the_variables_of_other_steps():
    with pm.Model() as model:
        a = pm.Normal("a")
        b = pm.Normal("b", a, 1.0)
        pm.Normal("y", b, 1.0, observed=1.0)
        step = CompoundStep([DEMetropolisZ([a], scaling=0.5), DEMetropolisZ([b], scaling=0.5)])
        idata = pm.sample(300, tune=300, step=step, chains=1, cores=1, random_seed=1, **QUIET)
    logp = model.compile_logp()
    assert float(idata.posterior.a.std()) > 0 < float(idata.posterior.b.std())
    for draw in (0, 17, 299):  # PyMC keeps the log-posterior of the step that comes last
        p = idata.posterior.isel(draw=draw, chain=0)
        value = logp({"a": p.a.to_numpy(), "b": p.b.to_numpy()})
        assert float(idata.sample_stats.lp[0, draw].to_numpy()[-1]) == pytest.approx(float(value), rel=1e-12)


def test_pm_sample_takes_the_step_in_several_processes():
    with gaussian_model():
        step = DEMetropolisZ(crank_nicolson=0.4, archive=np.random.default_rng(0).normal(size=(30, 3)))
        settings = {"tune": 1000, "chains": 2, "cores": 2, "mp_ctx": "spawn", "random_seed": 5}
        idata = pm.sample(1000, step=step, **settings, **QUIET)
    assert idata.sample_stats.solves.to_numpy()[:, 1:].max() == 1
    assert idata.sample_stats.solver_failures.to_numpy().sum() == 0
    mean, covariance = gaussian_posterior()
    got = idata.posterior.a.to_numpy()
    assert abs(got.mean() - mean[0]) < 5 * np.sqrt(covariance[0, 0] / float(az.ess(got)))


def test_sampling_state_continues_identically():
    model = gaussian_model()
    reference = Gaussian(*gaussian_posterior())

    def make():
        return DEMetropolisZ(model=model, crank_nicolson=0.5, reference=reference)

    step = make()
    step.rng = np.random.default_rng(1)
    point = model.initial_point()
    for _ in range(350):
        point, _ = step.step(point)
    state = pickle.loads(pickle.dumps(step.sampling_state))
    expected, again, other = [], [], make()
    other.sampling_state = state
    for s, rows in ((step, expected), (other, again)):
        p = point
        for i in range(350):
            if i == 200:
                s.stop_tuning()
            p, [record] = s.step(p)
            rows.append([p["a"], *p["bc"], record["solves"]])
    np.testing.assert_array_equal(expected, again)


def test_crank_nicolson_leaves_a_skewed_heavy_tailed_target_invariant():
    """With a wrong reference, the quantiles of a Gumbel and of a t with 3 degrees come out right."""
    with pm.Model() as model:
        pm.Gumbel("g", 0.0, 1.0)
        pm.StudentT("t", nu=3, mu=1.0, sigma=2.0)
    reference = Gaussian(np.array([0.5, 0.0]), np.array([[1.5, 0.5], [0.5, 4.0]]))
    step = DEMetropolisZ(model=model, crank_nicolson=0.9, reference=reference, archive=np.zeros((2, 2)))
    step._first_archive = list(reference.colour(np.random.default_rng(0).standard_normal((60, 2))))
    draws, records = steps_of(step, model.initial_point(), 30_000, seed=8, tune=2000)
    draws = draws[2000:]
    for i, law in enumerate((stats.gumbel_r(0, 1), stats.t(3, 1.0, 2.0))):
        for p in (0.05, 0.25, 0.5, 0.75, 0.95):
            below = (draws[:, i] <= law.ppf(p)).astype(float)
            error = np.sqrt(p * (1 - p) / float(az.ess(below[None])))
            assert abs(below.mean() - p) < 4 * error, (i, p)
    assert {r["beta"] for r in records[2000:]} == {records[-1]["beta"]}  # fixed after tuning


@pytest.mark.parametrize("name", ["crank_nicolson", "constrained"])
def test_shares_are_checked(name):
    with pytest.raises(ValueError, match=name + r" = 1\.0: must be in \[0, 1\)"):
        DEMetropolisZ(model=gaussian_model(), **{name: 1.0})


def leaning_model() -> pm.Model:
    """A ridge that ends at a bound: f on (0, 2) with density 2 exp(2 f)/(e^4 - 1), g[0] | f ~ N(2 f, 0.1)."""
    with pm.Model() as model:
        f = pm.Uniform("f", 0.0, 2.0)
        g = pm.Uniform("g", [-1.0, -1.0], [5.0, 7.0])
        doubled, _ = Doubling()(pt.stack([f]))
        pm.Potential("lean", doubled[0])
        pm.Potential("ridge", pm.logp(pm.Normal.dist(2.0 * f, 0.1), g[0]))
    return model


def test_constrained_space_is_that_of_pymc():
    """Of variables between two constants only; the volume is that of PyMC's transformation."""
    with leaning_model() as model:
        pm.HalfNormal("positive")
        pm.Uniform("moving", 0.0, model["f"])
        pm.Normal("free")
    values = model.value_vars
    space = ConstrainedSpace.of(model, values, model.initial_point())
    np.testing.assert_array_equal(space.index, [0, 1, 2])
    q = np.array([0.3, -1.0, 2.5, 0.1, 0.2, 0.3])
    point = {"f_interval__": q[0], "g_interval__": q[1:3], "positive_log__": q[3], "moving_interval__": q[4]}
    point["free"] = q[5]
    variables = [model["f"], model["g"]]
    graphs = [
        model.rvs_to_transforms[rv].backward(model.rvs_to_values[rv], *rv.owner.inputs) for rv in variables
    ]
    f, g = model.compile_fn(graphs, inputs=values, on_unused_input="ignore")(point)
    np.testing.assert_allclose(space.values(q), [f, *g, *q[3:]], rtol=1e-12)
    np.testing.assert_allclose(space.vector(space.values(q)), q, rtol=1e-12)
    logps = [model.logp(variables, jacobian=jacobian) for jacobian in (True, False)]
    with_and_without = model.compile_fn(logps, inputs=values, on_unused_input="ignore")(point)
    assert space.log_volume(q) == pytest.approx(float(np.subtract(*with_and_without)), rel=1e-7)
    h = 1e-5
    differences = (space.values(q + h) - space.values(q - h))[:3] / (2 * h)
    np.testing.assert_allclose(space.slopes(q), differences, rtol=1e-8)
    assert not np.isfinite(space.vector(np.array([2.1, 0.0, 0.0, 0.0, 0.0, 0.0]))[0])


@pytest.mark.parametrize(("crank_nicolson", "constrained"), [(0.0, 0.7), (0.5, 0.0), (0.9, 0.99)])
def test_moves_in_the_constrained_space_leave_the_posterior_as_it_is(crank_nicolson, constrained):
    """Quantiles of a law that leans against its bound, of the ridge on it, and of what only has bounds."""
    model = leaning_model()
    reference = Gaussian(np.array([1.5, 0.7, 0.3]), np.diag([2.0, 0.5, 1.0]))
    step = DEMetropolisZ(
        model=model, crank_nicolson=crank_nicolson, constrained=constrained, reference=reference,
        archive=reference.colour(np.random.default_rng(0).standard_normal((60, 3))),
    )  # fmt: skip
    q, records = steps_of(step, model.initial_point(), 40_000, seed=9, tune=4000)
    draws = ConstrainedSpace.of(model, model.value_vars, model.initial_point()).values(q[4000:])
    lean = SimpleNamespace(ppf=lambda p: 0.5 * np.log1p(p * np.expm1(4.0)))
    shown = {
        "f": (draws[:, 0], lean),
        "ridge": (draws[:, 1] - 2.0 * draws[:, 0], stats.norm(0.0, 0.1)),
        "bounds": (draws[:, 2], stats.uniform(-1.0, 8.0)),
    }
    for name, (values, law) in shown.items():
        for p in (0.02, 0.25, 0.5, 0.75, 0.98):
            below = (values <= law.ppf(p)).astype(float)
            error = np.sqrt(p * (1 - p) / float(az.ess(below[None])))
            assert abs(below.mean() - p) < 4 * error, (name, p)
            assert error < 0.05
    beyond = sum(r["accept"] == 0 for r in records)
    assert (beyond > 1000) == (constrained > 0)
    assert sum(r["solves"] for r in records) <= len(records) + 1 - 0.9 * beyond * (constrained > 0)


def test_a_jump_is_along_the_difference_of_two_past_points(monkeypatch):
    """2.38/sqrt(2 d) of it (ter Braak and Vrugt 2008), here in the values of the constrained variables."""
    past = np.array([[0.3, -0.2, 0.1], [0.1, 0.4, -0.3]])
    step = DEMetropolisZ(model=leaning_model(), constrained=0.999, archive=past)
    step.rng = np.random.default_rng(3)
    space, here, jumps = step._spaces[1], np.array([0.2, 0.1, -0.5]), []

    def take(q0, q, space, log_proposals):
        jumps.append(space.values(q) - space.values(q0.data))
        return q0, [{}]

    monkeypatch.setattr(step, "_select", take)
    for _ in range(20):
        step.astep(RaveledVars(here, ()))
    wanted = 2.38 / np.sqrt(6) * (space.values(past[0]) - space.values(past[1]))
    signs = [float(np.sign(jump @ wanted)) for jump in jumps]
    assert set(signs) == {1.0, -1.0}
    np.testing.assert_allclose(jumps, np.outer(signs, wanted), rtol=1e-9)


def test_a_ridge_at_a_bound_mixes_better_in_the_constrained_space():
    """Effective sizes for the same number of steps, of the ends of the ridge."""
    model, sizes = leaning_model(), {}
    space = ConstrainedSpace.of(model, model.value_vars, model.initial_point())
    for share in (0.0, 0.5):
        step = DEMetropolisZ(model=model, crank_nicolson=0.5, constrained=share)
        q, _ = steps_of(step, model.initial_point(), 20_000, seed=3, tune=4000)
        sizes[share] = effective(space.values(q[4000:])[None, :, 0], "tail")
    assert sizes[0.5] > 1.5 * sizes[0.0]


def test_refit_moves_from_the_first_guess_to_the_moments():
    rng = np.random.default_rng(0)
    truth = np.array([[2.0, 0.5], [0.5, 1.0]])
    points = rng.multivariate_normal([3.0, -1.0], truth, 40_000)
    fitted = Gaussian(np.zeros(2), np.eye(2) * 9).refit(points)
    np.testing.assert_allclose(fitted.covariance, truth, rtol=0.05, atol=0.03)
    np.testing.assert_allclose(fitted.mean, [3.0, -1.0], atol=0.03)
    few = Gaussian(np.zeros(2), np.eye(2) * 9).refit(points[:16])
    assert few.covariance[0, 0] > 3.0  # sixteen correlated draws count as two: the first guess still weighs
