"""The search for the mode against posteriors whose mode is known, and the starts around it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest
from benchmarks.paun2020.calibration import cheap_options, cheap_study

from gaussian import (
    MIXING,
    Doubling,
    failing_model,
    gaussian_model,
    gaussian_posterior,
)
from zoo import model_F
from zoo.blood.solver import Solver
from zoo.blood.study import Series
from zoo.core.inference import mode as mode_module
from zoo.core.inference.logposterior import LogPosterior, SamplingError
from zoo.core.inference.mode import find_mode
from zoo.core.inference.newton import gauss_newton, newton
from zoo.core.inference.starts import disperse


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
    q, _, found, _ = newton(logp, start, logp(start), passes=8)
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
    logp = LogPosterior(model_F(study, options=cheap_options()))
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
    found, value, frame = gauss_newton(logp, q, logp(q), limit=600)
    assert logp(found) == value
    _, best, *_ = newton(logp, found, value, passes=2, frame=frame)
    assert value > best - 1.0
    values = logp.to_values(found)
    np.testing.assert_allclose(values["chi"][0], 4.0e4, rtol=0.05)
    np.testing.assert_allclose(values["sigma2"], 0.01, rtol=0.4)


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

    def climb(logp, q, value, *, limit, model):
        """To the peak whose hill the point is on."""
        limits.append(limit)
        peak = max(peaks, key=lambda peak: peaks[peak] - float(np.sum((q - peak) ** 2)))
        return np.array(peak), peaks[peak], np.eye(3)

    monkeypatch.setattr(mode_module, "gauss_newton", climb)
    monkeypatch.setattr(mode_module, "Residuals", lambda logp: None)
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


def test_starts_are_overdispersed_and_solvable():
    logp = LogPosterior(failing_model())
    mode = mode_module.search_mode(logp)
    start = disperse(logp, mode, 40, seed=1)
    assert all(np.isfinite(logp(q)) for q in start.starts)
    gaussian = LogPosterior(gaussian_model())
    mode = mode_module.search_mode(gaussian)
    spread = disperse(gaussian, mode, 60, seed=1).starts.std(0)
    assert np.all(spread > 1.2 * np.sqrt(np.diag(gaussian_posterior()[1])))
    fewer = disperse(gaussian, mode, 3, seed=1).starts
    np.testing.assert_array_equal(fewer, disperse(gaussian, mode, 60, seed=1).starts[:3])
