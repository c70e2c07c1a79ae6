"""Step methods against PyMC's, chains against analytic posteriors, resumed runs against whole ones."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import arviz as az
import cloudpickle
import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from pytensor.graph.basic import Apply
from pytensor.graph.op import Op
from scipy import stats

from zoo import model_F
from zoo.blood.solver import Solver
from zoo.blood.study import Series
from zoo.core.inference import mode as mode_module
from zoo.core.inference import sampling
from zoo.core.inference.progress import ChainState, Display
from zoo.core.inference.results import RunRecord
from zoo.core.inference.sampling import (
    CheckpointError,
    DEMetropolisZ,
    Metropolis,
    SamplingError,
    find_mode,
    sample,
)
from zoo.core.inference.steps import Archive, Gaussian, OwnUnits
from zoo.paper.calibration import cheap_options, cheap_study

pytestmark = pytest.mark.filterwarnings("ignore:PyTensor could not link to a BLAS:UserWarning")


class Doubling(Op):
    """A gradient-free operation that doubles its input, counts its solves and fails below a limit."""

    __props__ = ("limit",)

    def __init__(self, limit: float = -np.inf, seconds: float = 0.0) -> None:
        self.limit = limit
        self.seconds = seconds
        self.n: Counter[str] = Counter()

    @property
    def counts(self):
        failures = {"collapse": self.n["collapse"]} if self.n["collapse"] else {}
        return {"solves": self.n["solves"], "evaluations": self.n["solves"], "failures": failures}

    def make_node(self, x):
        x = pt.as_tensor_variable(x)
        return Apply(self, [x], [pt.vector(dtype="float64"), pt.scalar(dtype="int8")])

    def perform(self, node, inputs, output_storage):
        self.n["solves"] += 1
        ok = bool(inputs[0].min() >= self.limit)
        self.n["collapse"] += not ok
        if self.seconds:
            time.sleep(self.seconds)
        output_storage[0][0] = inputs[0] * 2.0
        output_storage[1][0] = np.asarray(ok, dtype=np.int8)

    def infer_shape(self, fgraph, node, shapes):
        return [shapes[0], ()]


PRIOR_SD = np.array([1.0, 2.0, 0.5])
MIXING = np.array([[1.0, 0.9, 0.0], [0.0, 1.0, 0.5], [0.4, 0.0, 1.0]])
NOISE = np.array([0.5, 0.2, 1.0])
DATA = np.array([1.0, -2.0, 0.5])


def gaussian_model(seconds: float = 0.0, data=DATA, name: str = "gaussian") -> pm.Model:
    """Three correlated Gaussian parameters with an analytic posterior."""
    with pm.Model(name="") as model:
        a = pm.Normal("a", 0.0, PRIOR_SD[0])
        bc = pm.Normal("bc", 0.0, PRIOR_SD[1:], shape=2)
        x, _ = Doubling(seconds=seconds)(pt.concatenate([a[None], bc]))
        pm.Normal("y", pt.dot(MIXING, x / 2.0), NOISE, observed=data)
    model.zoo = type("Record", (), {"name": name, "study": None, "options": None})()
    return model


def gaussian_posterior() -> tuple[np.ndarray, np.ndarray]:
    precision = np.diag(PRIOR_SD**-2) + MIXING.T @ np.diag(NOISE**-2) @ MIXING
    covariance = np.linalg.inv(precision)
    return covariance @ MIXING.T @ (DATA / NOISE**2), covariance


SETTINGS = {"draws": 150, "tune": 200, "chains": 2, "thin": 2, "seed": 11, "progress": False}


@pytest.fixture(scope="module")
def uninterrupted():
    return sample(gaussian_model(), cores=2, **SETTINGS)


def steps_of(step, point, n, seed=3, tune=0):
    """Draws of a step method in PyMC's own order of calls, and its statistics."""
    step.set_rng(np.random.default_rng(seed))
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


# step methods


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (lambda m: DEMetropolisZ(model=m), lambda m: pm.DEMetropolisZ(model=m)),
        (
            lambda m: DEMetropolisZ(model=m, tune="lambda", scaling=0.1),
            lambda m: pm.DEMetropolisZ(model=m, tune="lambda", scaling=0.1),
        ),
        (lambda m: Metropolis(model=m, joint=False), lambda m: pm.Metropolis(model=m, blocked=True)),
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


@pytest.mark.parametrize(("joint", "evaluations"), [(True, 1), (False, 3)])
def test_metropolis_solves_once_a_proposal(joint, evaluations):
    model = gaussian_model()
    step = Metropolis(model=model, joint=joint, scaling=0.1)
    _, records = steps_of(step, model.initial_point(), 50)
    assert [r["solves"] for r in records] == [evaluations + 1] + [evaluations] * 49


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
        step = pm.CompoundStep([DEMetropolisZ([a], scaling=0.5), DEMetropolisZ([b], scaling=0.5)])
        idata = pm.sample(
            300,
            tune=300,
            step=step,
            chains=1,
            cores=1,
            random_seed=1,
            progressbar=False,
            compute_convergence_checks=False,
        )
    logp = model.compile_logp()
    assert float(idata.posterior.a.std()) > 0 < float(idata.posterior.b.std())
    for draw in (0, 17, 299):  # PyMC keeps the log-posterior of the step that comes last
        p = idata.posterior.isel(draw=draw, chain=0)
        value = logp({"a": p.a.to_numpy(), "b": p.b.to_numpy()})
        assert float(idata.sample_stats.lp[0, draw].to_numpy()[-1]) == pytest.approx(float(value), rel=1e-12)


def test_pm_sample_takes_the_step_in_several_processes():
    with gaussian_model():
        idata = pm.sample(
            1000,
            tune=1000,
            step=DEMetropolisZ(crank_nicolson=0.4, archive=np.random.default_rng(0).normal(size=(30, 3))),
            chains=2,
            cores=2,
            mp_ctx="spawn",
            random_seed=5,
            progressbar=False,
            compute_convergence_checks=False,
        )
    assert idata.sample_stats.solves.to_numpy()[:, 1:].max() == 1
    assert idata.sample_stats.solver_failures.to_numpy().sum() == 0
    mean, covariance = gaussian_posterior()
    got = idata.posterior.a.to_numpy()
    assert abs(got.mean() - mean[0]) < 5 * np.sqrt(covariance[0, 0] / float(az.ess(got)))


@pytest.mark.parametrize("kind", ["demetropolisz", "metropolis"])
def test_sampling_state_continues_identically(kind):
    model = gaussian_model()
    reference = Gaussian(*gaussian_posterior())

    def make():
        if kind == "demetropolisz":
            return DEMetropolisZ(model=model, crank_nicolson=0.5, reference=reference)
        return Metropolis(model=model, reference=reference, adapt=True)

    step = make()
    step.set_rng(np.random.default_rng(1))
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


def test_step_pickles():
    model = gaussian_model()
    step = DEMetropolisZ(model=model, archive=np.eye(3))
    other = cloudpickle.loads(cloudpickle.dumps(step))
    a, _ = steps_of(step, model.initial_point(), 100)
    b, _ = steps_of(other, model.initial_point(), 100)
    np.testing.assert_array_equal(a, b)


def test_crank_nicolson_leaves_a_skewed_heavy_tailed_target_invariant():
    """With a wrong reference, the quantiles of a Gumbel and of a t with 3 degrees come out right."""
    with pm.Model() as model:
        pm.Gumbel("g", 0.0, 1.0)
        pm.StudentT("t", nu=3, mu=1.0, sigma=2.0)
    reference = Gaussian(np.array([0.5, 0.0]), np.array([[1.5, 0.5], [0.5, 4.0]]))
    step = DEMetropolisZ(model=model, crank_nicolson=0.9, reference=reference, archive=np.zeros((2, 2)))
    step._first_archive = Archive(reference.colour(np.random.default_rng(0).standard_normal((60, 2))))
    draws, records = steps_of(step, model.initial_point(), 30_000, seed=8, tune=2000)
    draws = draws[2000:]
    for i, law in enumerate((stats.gumbel_r(0, 1), stats.t(3, 1.0, 2.0))):
        for p in (0.05, 0.25, 0.5, 0.75, 0.95):
            below = (draws[:, i] <= law.ppf(p)).astype(float)
            error = np.sqrt(p * (1 - p) / float(az.ess(below[None])))
            assert abs(below.mean() - p) < 4 * error, (i, p)
    assert {r["beta"] for r in records[2000:]} == {records[-1]["beta"]}  # fixed after tuning


@pytest.mark.parametrize("name", ["crank_nicolson", "own_units"])
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


def test_own_units_are_those_of_pymc():
    """Of variables between two constants only; the volume is that of PyMC's transformation."""
    with leaning_model() as model:
        pm.HalfNormal("positive")
        pm.Uniform("moving", 0.0, model["f"])
        pm.Normal("free")
    values = model.value_vars
    units = OwnUnits.of(model, values, model.initial_point())
    np.testing.assert_array_equal(units.index, [0, 1, 2])
    q = np.array([0.3, -1.0, 2.5, 0.1, 0.2, 0.3])
    point = {"f_interval__": q[0], "g_interval__": q[1:3], "positive_log__": q[3], "moving_interval__": q[4]}
    point["free"] = q[5]
    variables = [model["f"], model["g"]]
    graphs = [
        model.rvs_to_transforms[rv].backward(model.rvs_to_values[rv], *rv.owner.inputs) for rv in variables
    ]
    f, g = model.compile_fn(graphs, inputs=values, on_unused_input="ignore")(point)
    np.testing.assert_allclose(units.values(q), [f, *g, *q[3:]], rtol=1e-12)
    np.testing.assert_allclose(units.vector(units.values(q)), q, rtol=1e-12)
    logps = [model.logp(variables, jacobian=jacobian) for jacobian in (True, False)]
    with_and_without = model.compile_fn(logps, inputs=values, on_unused_input="ignore")(point)
    assert units.log_volume(q) == pytest.approx(float(np.subtract(*with_and_without)), rel=1e-7)
    h = 1e-5
    differences = (units.values(q + h) - units.values(q - h))[:3] / (2 * h)
    np.testing.assert_allclose(units.slopes(q), differences, rtol=1e-8)
    assert not np.isfinite(units.vector(np.array([2.1, 0.0, 0.0, 0.0, 0.0, 0.0]))[0])


@pytest.mark.parametrize(("crank_nicolson", "own_units"), [(0.0, 0.7), (0.5, 0.0), (0.5, 0.7), (0.9, 0.99)])
def test_moves_in_own_units_leave_the_posterior_as_it_is(crank_nicolson, own_units):
    """Quantiles of a law that leans against its bound, of the ridge on it, and of what only has bounds."""
    model = leaning_model()
    reference = Gaussian(np.array([1.5, 0.7, 0.3]), np.diag([2.0, 0.5, 1.0]))
    step = DEMetropolisZ(
        model=model, crank_nicolson=crank_nicolson, own_units=own_units, reference=reference,
        archive=reference.colour(np.random.default_rng(0).standard_normal((60, 3))),
    )  # fmt: skip
    q, records = steps_of(step, model.initial_point(), 40_000, seed=9, tune=4000)
    draws = OwnUnits.of(model, model.value_vars, model.initial_point()).values(q[4000:])
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
    assert (beyond > 1000) == (own_units > 0)
    assert sum(r["solves"] for r in records) <= len(records) + 1 - 0.9 * beyond * (own_units > 0)


def test_a_ridge_at_a_bound_mixes_better_in_own_units():
    """Effective sizes for the same number of steps, of the ends of the ridge."""
    model, sizes = leaning_model(), {}
    units = OwnUnits.of(model, model.value_vars, model.initial_point())
    for share in (0.0, 0.5):
        step = DEMetropolisZ(model=model, crank_nicolson=0.5, own_units=share)
        q, _ = steps_of(step, model.initial_point(), 20_000, seed=3, tune=4000)
        sizes[share] = float(az.ess(units.values(q[4000:])[None, :, 0], method="tail"))
    assert sizes[0.5] > 1.5 * sizes[0.0]


def test_archive_behaves_as_a_list_of_rows():
    archive = Archive()
    rows = np.random.default_rng(0).normal(size=(700, 2))
    for row in rows:
        archive.append(row)
    assert len(archive) == 700
    np.testing.assert_array_equal(archive[3], rows[3])
    np.testing.assert_array_equal(archive[650:].points, rows[650:])
    copied = pickle.loads(pickle.dumps(archive))
    copied.append(np.zeros(2))
    assert (len(archive), len(copied)) == (700, 701)


def test_refit_moves_from_the_first_guess_to_the_moments():
    rng = np.random.default_rng(0)
    truth = np.array([[2.0, 0.5], [0.5, 1.0]])
    points = rng.multivariate_normal([3.0, -1.0], truth, 40_000)
    fitted = Gaussian(np.zeros(2), np.eye(2) * 9).refit(points)
    np.testing.assert_allclose(fitted.covariance, truth, rtol=0.05, atol=0.03)
    np.testing.assert_allclose(fitted.mean, [3.0, -1.0], atol=0.03)
    few = Gaussian(np.zeros(2), np.eye(2) * 9).refit(points[:16])
    assert few.covariance[0, 0] > 3.0  # sixteen correlated draws count as two: the first guess still weighs


# the mode


def test_mode_of_a_gaussian_with_scales_far_apart():
    scale = np.array([1e4, 50.0, 1e3])
    with pm.Model() as model:
        x = pm.Normal("x", [5e4, 130.0, 4e3], 20 * scale, shape=3)
        y, _ = Doubling()(x / scale)
        pm.Normal("y", pt.dot(MIXING, y), [0.1, 0.2, 0.3], observed=[9.0, 5.0, 11.0])
    mode = find_mode(model)
    jacobian = 2 * MIXING / scale
    precision = np.diag((20 * scale) ** -2) + jacobian.T @ np.diag([100.0, 25.0, 1 / 0.09]) @ jacobian
    covariance = np.linalg.inv(precision)
    prior = np.array([5e4, 130.0, 4e3]) / (20 * scale) ** 2
    mean = covariance @ (prior + jacobian.T @ (np.array([9.0, 5.0, 11.0]) * [100.0, 25.0, 1 / 0.09]))
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((mode.vector - mean) / sd, 0.0, atol=0.05)
    np.testing.assert_allclose(mode.covariance / np.outer(sd, sd), covariance / np.outer(sd, sd), atol=0.02)
    np.testing.assert_array_equal(mode.values["x"], mode.vector)


def test_mode_survives_noise_and_failed_solves():
    """Rounding-like noise in the log-posterior, and a wall of failures two standard deviations off."""
    mean, covariance = gaussian_posterior()
    precision = np.linalg.inv(covariance)
    rng = np.random.default_rng(2)

    def logp(q):
        if q[0] < mean[0] - 2.0 * np.sqrt(covariance[0, 0]):
            return -np.inf
        return -0.5 * (q - mean) @ precision @ (q - mean) + 0.03 * rng.uniform()

    start = mean + np.array([0.3, -0.4, 0.2])
    q, _, found = mode_module.newton(logp, start, logp(start), passes=8)
    sd = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((q - mean) / sd, 0.0, atol=0.4)
    ratio = np.linalg.eigvals(np.linalg.solve(covariance, found)).real
    assert ratio.min() > 0.5
    assert ratio.max() < 2.0


def test_mode_in_the_unconstrained_space_and_values_in_units():
    with pm.Model() as model:
        pm.Uniform("f3", 1e4, 9e4)
        pm.LogNormal("c", 0.5, 0.1)
    mode = find_mode(model, start={"f3": 2e4})
    assert mode.values["f3"] == pytest.approx(
        5e4, rel=0.01
    )  # the logit of a uniform variable peaks in the middle
    assert mode.values["c"] == pytest.approx(np.exp(0.5), rel=0.01)
    assert mode.covariance[1, 1] == pytest.approx(0.01, rel=0.02)


def test_gauss_newton_reaches_the_mode_of_a_hierarchical_model():
    """From a far start: as high as wide Newton steps can go after it, at the truth's stiffness."""
    study = three_vessels(np.array([4.0e4, 5.0e4, 6.0e4]), psi1=0.4, psi2=0.7, c=1.2)
    logp = mode_module.LogPosterior(model_F(study, options=cheap_options()))
    start = {
        "m_chi": 7e4,
        "v_chi": 3.0,
        "chi": np.full(3, 7e4),
        "psi1": 1.0,
        "psi2": 0.4,
        "c": 0.5,
        "sigma2": 1.0,
    }
    q = logp.from_values(start)
    found, value, frame = mode_module.gauss_newton(logp, q, logp(q), limit=600)
    assert logp(found) == value
    _, best, _ = mode_module.newton(logp, found, value, passes=2, frame=frame)
    assert value > best - 1.0
    values = logp.to_values(found)
    np.testing.assert_allclose(values["chi"][0], 4.0e4, rtol=0.05)
    np.testing.assert_allclose(values["sigma2"], 0.01, rtol=0.4)


def test_search_of_many_parameters_starts_from_the_prior():
    """And from the point given, with its error parameters; each start can be solved."""
    study = three_vessels(np.array([4.0e4, 5.0e4, 6.0e4]), psi1=0.4, psi2=0.7, c=1.2)
    logp = mode_module.LogPosterior(model_F(study, options=cheap_options()))
    q = logp.from_values({"sigma2": 0.3})
    points = mode_module._prior_points(logp, q, seed=1)
    assert len(points) == mode_module.STARTS + 1
    np.testing.assert_array_equal(points[0][0], q)
    for point, value in points:
        assert value == logp(point)
        assert np.isfinite(value)
        assert float(logp.to_values(point)["sigma2"]) == pytest.approx(0.3)  # errors are fitted to each
    stiffness = np.array([logp.to_values(point)["chi"] for point, _ in points[1:]])
    assert 1e4 < stiffness.std() < 5e4  # of the prior: 2.4e4


def test_search_of_many_parameters_keeps_the_highest_end(monkeypatch):
    """A scalar and a vector of two; the highest mode is only seen from where the vector is low."""
    initial = {"scalar": np.zeros(()), "vector": np.zeros(2)}
    peaks = {(0.0, 0.0, 0.0): 0.0, (3.0, 0.0, 0.0): 2.0, (1.0, 0.0, -2.0): 1.0, (5.0, -2.0, -2.0): 7.0}

    class Surface:
        def __init__(self):
            self.variables, self.initial = [SimpleNamespace(name=name) for name in initial], initial

        def __call__(self, q):
            return max(height - float(np.sum((q - peak) ** 2)) for peak, height in peaks.items())

    limits = []

    def climb(logp, q, value, *, limit):
        """To the peak whose hill the point is on."""
        limits.append(limit)
        peak = max(peaks, key=lambda peak: peaks[peak] - float(np.sum((q - peak) ** 2)))
        return np.array(peak), peaks[peak], np.eye(3)

    monkeypatch.setattr(mode_module, "gauss_newton", climb)
    logp = Surface()
    begin = [(np.array([x, 0.0, 0.0]), logp(np.array([x, 0.0, 0.0]))) for x in (0.2, -1.0, 2.9, 0.1, 2.0)]
    found, value, _ = mode_module._highest(logp, begin, limit=80)
    assert value == 7.0  # the starts lead to 0 and 2
    np.testing.assert_array_equal(found, (5.0, -2.0, -2.0))
    assert limits[:5] == [80 // 3] * 5
    assert limits.count(80) >= 3
    only, _, _ = mode_module._highest(logp, begin[:1], limit=80)
    np.testing.assert_array_equal(only, (0.0, 0.0, 0.0))


def three_vessels(stiffness, **parameters):
    """The cheap tree with pressures of known stiffness and white errors of 0.1 mmHg."""
    base = cheap_study(48)
    solver = Solver.for_study(base, options=cheap_options())
    clean = solver.solve(stiffness, **parameters).pressure_mmHg
    noise = 0.1 * np.random.default_rng(3).standard_normal(clean.shape)
    return replace(base, series=(Series(1, 0.0, "pressure_mmHg", (clean + noise)[0]),))


def test_mode_says_what_is_wrong():
    with pm.Model() as impossible:
        pm.Normal("a")
        pm.Potential("never", pt.as_tensor(-np.inf))
    with pytest.raises(SamplingError, match="no point with a finite log-posterior"):
        find_mode(impossible)
    with pytest.raises(SamplingError, match="no variable 'zz' in the model; it has a, bc"):
        find_mode(gaussian_model(), start={"zz": 1.0})
    with pm.Model() as discrete:
        pm.Poisson("n", 3.0)
        pm.Normal("a")
    with pytest.raises(SamplingError, match="variable 'n' is discrete"):
        find_mode(discrete)


# whole runs


def test_posterior_is_the_analytic_one(uninterrupted):
    idata = sample(gaussian_model(), cores=2, draws=700, tune=600, chains=2, seed=4, progress=False)
    mean, covariance = gaussian_posterior()
    p = idata.posterior
    columns = [p.a.to_numpy(), p.bc.to_numpy()[..., 0], p.bc.to_numpy()[..., 1]]
    for i, draws in enumerate(columns):
        ess = float(az.ess(draws))
        assert ess > 150
        assert abs(draws.mean() - mean[i]) < 4.5 * np.sqrt(covariance[i, i] / ess)
        assert draws.std() == pytest.approx(np.sqrt(covariance[i, i]), rel=0.2)


def test_statistics_and_record(uninterrupted):
    s = uninterrupted.sample_stats
    assert dict(s.sizes) == {"chain": 2, "draw": 150}
    assert {"lp", "accept", "accepted", "solves", "solver_failures"} <= set(s.data_vars)
    assert set(np.unique(s.solves)) == {2}  # thin = 2 steps for each stored draw, one solve each
    assert 0 < float(s.accept.mean()) < 1
    logp = gaussian_model().compile_logp()
    p = uninterrupted.posterior.isel(chain=1, draw=7)
    expected = logp({"a": p.a.to_numpy(), "bc": p.bc.to_numpy()})
    assert float(s.lp[1, 7]) == pytest.approx(float(expected), rel=1e-12)
    record = RunRecord.of(uninterrupted)
    assert (record.model, record.seed, record.sittings, record.failures) == ("gaussian", 11, 1, {})
    assert record.steps == 2 * (200 + 2 * 150)
    assert record.solves_per_step == pytest.approx(1.0, abs=0.01)
    assert record.settings["tune"] == 200
    assert uninterrupted.observed_data.y.to_numpy() == pytest.approx(DATA)


SCRIPT = """
    import sys
    sys.path.insert(0, {tests!r})
    from test_sampling import SETTINGS, gaussian_model
    from zoo.core.inference.sampling import sample
    sample(gaussian_model(seconds=0.004), cores=1, checkpoint={folder!r}, checkpoint_seconds=0.05, **SETTINGS)
"""


def launch(tmp_path: Path, folder: Path) -> subprocess.Popen:
    """Run the settings of this file slowly, in a process group of its own; no guard for `__main__`."""
    script = tmp_path / "run.py"
    script.write_text(textwrap.dedent(SCRIPT.format(tests=str(Path(__file__).parent), folder=str(folder))))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    return subprocess.Popen([sys.executable, str(script)], start_new_session=True, env=environment)


def wait_for(condition, seconds=60.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.02)


def steps_in(file: Path) -> int:
    return pickle.loads(file.read_bytes())["steps"] if file.exists() else 0


def group_is_gone(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_killed_run_resumes_with_identical_draws(tmp_path, uninterrupted):
    """Kill every process in the middle of the first chain, then finish with another number of cores."""
    folder = tmp_path / "checkpoint"
    first = folder / "chain-0.pkl"
    run = launch(tmp_path, folder)
    wait_for(lambda: steps_in(first) > 100)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    assert 100 < steps_in(first) < 500
    idata = sample(gaussian_model(), cores=2, checkpoint=folder, **SETTINGS)
    for name in ("a", "bc"):
        np.testing.assert_array_equal(idata.posterior[name], uninterrupted.posterior[name])
    for name in uninterrupted.sample_stats.data_vars:
        np.testing.assert_array_equal(idata.sample_stats[name], uninterrupted.sample_stats[name])
    record = RunRecord.of(idata)
    assert record.sittings == 2
    assert record.solves == RunRecord.of(uninterrupted).solves


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_chains_write_and_end_when_the_parent_goes(tmp_path, how):
    folder = tmp_path / "checkpoint"
    first = folder / "chain-0.pkl"
    run = launch(tmp_path, folder)
    wait_for(lambda: steps_in(first) > 60)
    os.kill(run.pid, how)
    run.wait()
    wait_for(lambda: group_is_gone(run.pid), 20.0)
    assert 60 < steps_in(first) < 600
    sampling.Folder(folder).close()  # no longer in use


@pytest.fixture(scope="module")
def short_checkpoint(tmp_path_factory):
    folder = tmp_path_factory.mktemp("short") / "checkpoint"
    sample(gaussian_model(), cores=2, checkpoint=folder, **{**SETTINGS, "draws": 40})
    return folder


def test_finished_run_goes_on_to_more_draws(short_checkpoint, uninterrupted):
    idata = sample(gaussian_model(), cores=1, checkpoint=short_checkpoint, **{**SETTINGS, "seed": None})
    np.testing.assert_array_equal(idata.posterior.bc, uninterrupted.posterior.bc)
    assert RunRecord.of(idata).seed == 11


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tune": 300}, "tune is 200 there and 300 here"),
        ({"seed": 12}, "seed is 11 there and 12 here"),
        ({"step": "metropolis"}, "step is demetropolisz there and metropolis here"),
        ({"step_options": {"crank_nicolson": 0.1}}, "step options is"),
    ],
)
def test_checkpoint_of_other_settings_is_refused(short_checkpoint, change, message):
    with pytest.raises(CheckpointError, match=f"checkpoint of another run: {message}"):
        sample(gaussian_model(), checkpoint=short_checkpoint, **{**SETTINGS, **change})


def test_checkpoint_of_another_model_or_data_is_refused(short_checkpoint):
    with pytest.raises(CheckpointError, match="model is gaussian there and other here"):
        sample(gaussian_model(name="other"), checkpoint=short_checkpoint, **SETTINGS)
    with pytest.raises(CheckpointError, match="log-posterior at three points"):
        sample(gaussian_model(data=DATA + 1e-3), checkpoint=short_checkpoint, **SETTINGS)


def test_checkpoint_in_use_or_broken_is_refused(short_checkpoint, tmp_path):
    holder = sampling.Folder(short_checkpoint)
    try:
        with pytest.raises(CheckpointError, match="another run is using this checkpoint folder"):
            sample(gaussian_model(), checkpoint=short_checkpoint, **SETTINGS)
    finally:
        holder.close()
    folder = tmp_path / "broken"
    folder.mkdir()
    (folder / "run.json").write_text("{")
    with pytest.raises(CheckpointError, match=r"run\.json: cannot be read; remove the folder"):
        sample(gaussian_model(), checkpoint=folder, **SETTINGS)
    (tmp_path / "file").write_text("")
    with pytest.raises(CheckpointError, match="cannot be used as checkpoint folder"):
        sample(gaussian_model(), checkpoint=tmp_path / "file", **SETTINGS)


def failing_model() -> pm.Model:
    """The solver fails in half of the prior; the likelihood is zero there."""
    with pm.Model() as model:
        a = pm.Normal("a", 0.3, 1.0)
        x, ok = Doubling(limit=0.0)(a[None])
        pm.Potential("solved", pt.switch(pt.eq(ok, 1), 0.0, -np.inf))
        pm.Deterministic("twice", x[0])
    return model


def test_failed_solves_are_counted_and_never_accepted():
    idata = sample(failing_model(), draws=200, tune=300, chains=1, thin=1, cores=1, seed=3, progress=False)
    s = idata.sample_stats
    failed = s.solver_failures.to_numpy()
    assert failed.sum() > 10
    assert float(idata.posterior.a.min()) >= 0.0
    np.testing.assert_array_equal(idata.posterior.twice, 2 * idata.posterior.a)
    np.testing.assert_array_equal(failed[failed > 0], 1)
    assert not s.accepted.to_numpy()[failed > 0].any()
    assert RunRecord.of(idata).failures["collapse"] >= failed.sum()


def test_chain_error_reaches_the_caller():
    def explode(value):
        raise FloatingPointError("the bath ran over")

    class Exploding(Doubling):
        def perform(self, node, inputs, output_storage):
            super().perform(node, inputs, output_storage)
            if self.n["solves"] > 400:
                explode(inputs)

    with pm.Model() as model:
        a = pm.Normal("a")
        x, _ = Exploding()(a[None])
        pm.Normal("y", x[0], 1.0, observed=0.0)
    with pytest.raises(SamplingError, match="chain 0: FloatingPointError: the bath ran over") as caught:
        sample(model, draws=2000, tune=0, chains=1, thin=1, cores=1, seed=1, progress=False)
    assert any("Traceback" in note for note in caught.value.__notes__)


def test_chains_in_turns_draw_what_processes_draw(tmp_path, uninterrupted):
    """In this process, interrupted by a checkpoint halfway: the draws of the run in processes."""
    settings = {**SETTINGS, "cores": 0}
    first = sample(
        gaussian_model(), checkpoint=tmp_path / "c", **{**settings, "draws": SETTINGS["draws"] // 2}
    )
    again = sample(gaussian_model(), checkpoint=tmp_path / "c", **settings)
    for name in ("a", "bc"):
        whole = uninterrupted.posterior[name].to_numpy()
        np.testing.assert_array_equal(again.posterior[name].to_numpy(), whole)
        half = first.posterior[name].to_numpy()
        np.testing.assert_array_equal(half, whole[:, : half.shape[1]])


def test_until_ess_goes_on_and_stops_at_the_limit(capsys):
    few = {"tune": 200, "chains": 2, "thin": 1, "cores": 2, "seed": 2}
    idata = sample(gaussian_model(), draws=100, until_ess=150, progress=True, **few)
    n = idata.posterior.sizes["draw"]
    assert n > 100
    for method in ("bulk", "tail"):
        assert min(float(v.min()) for v in az.ess(idata.posterior, method=method).values()) >= 150
    assert RunRecord.of(idata).settings["first check"] == 100
    err = capsys.readouterr().err
    assert "3 dimensions, 2 chains of demetropolisz, tune 200" in err
    assert "converged" in err
    short = sample(gaussian_model(), draws=50, until_ess=4000, max_draws=70, progress=False, **few)
    assert short.posterior.sizes["draw"] == 70


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"draws": 0}, "draws = 0: must be a whole number of at least 1"),
        ({"tune": -1}, "tune = -1: must be a whole number of at least 0"),
        ({"chains": 0}, "chains = 0"),
        ({"cores": -1}, "cores = -1"),
        ({"thin": 0}, "thin = 0"),
        ({"max_draws": 10}, "max_draws = 10: must be a whole number of at least 1000"),
        ({"step": "nuts"}, "step = 'nuts': must be one of demetropolisz, metropolis"),
        ({"until_ess": float("nan")}, "until_ess = nan"),
        ({"until_ess": 400, "chains": 1}, "chains = 1: until_ess needs R-hat"),
        ({"seed": -1}, "seed = -1"),
    ],
)
def test_settings_are_checked(settings, message):
    with pytest.raises(SamplingError, match=message):
        sample(gaussian_model(), progress=False, **settings)


def test_starts_are_overdispersed_and_solvable():
    logp = mode_module.LogPosterior(failing_model())
    mode = mode_module.search_mode(logp)
    start = mode_module.disperse(logp, mode, 40, seed=1)
    assert all(np.isfinite(logp(q)) for q in start.starts)
    gaussian = mode_module.LogPosterior(gaussian_model())
    mode = mode_module.search_mode(gaussian)
    spread = mode_module.disperse(gaussian, mode, 60, seed=1).starts.std(0)
    assert np.all(spread > 1.2 * np.sqrt(np.diag(gaussian_posterior()[1])))
    fewer = mode_module.disperse(gaussian, mode, 3, seed=1).starts
    np.testing.assert_array_equal(fewer, mode_module.disperse(gaussian, mode, 60, seed=1).starts[:3])


def test_display_line_and_table():
    show = Display(False, tune=100, thin=2, cores=2, ess=400.0)
    states = [ChainState(chain) for chain in range(2)]
    rng = np.random.default_rng(0)
    for state in states:
        draws = {"a": rng.normal(size=200)}
        message = {"steps": 500, "kept": 200, "tuning": False, "seconds": 5.0, "solves": 500}
        message |= {"accepted": 150.0, "failures": {"cfl": 3}, "draws": draws, "stats": {}}
        state.update(message)
    show._judge(states, time.monotonic())
    line = show.line(states, 400)
    assert "draws 200 200 of 400, accepted 30%, 1000 solves (100/s a core), 6 failed; R-hat 1.0" in line
    ess = show._verdict.min_ess
    # two cores at 100 steps/s: (goal * thin - steps done after tuning) / 100
    assert show.remaining(states, 400) == pytest.approx(max(0.0, 200 * 400 / ess * 2 - 400) / 100, abs=0.02)
    assert show.table(states, 400).row_count == 2
