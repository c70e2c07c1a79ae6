"""Synthetic studies: the inflow, the covariance of the errors, the order of pressures, the embedded study."""

from pathlib import Path

import numpy as np
import pytest

from zoo.likelihood import neural_network_kernel
from zoo.network import Network
from zoo.study import load_study, save_study
from zoo.synthetic import (
    Truth,
    correlated_errors,
    demo_study,
    ejection,
    falls_towards_periphery,
    signal_to_noise,
    synthetic_study,
)


def test_inflow_has_the_facts_of_the_measured_one():
    time, flow = ejection(8192)
    assert flow.max() == pytest.approx(0.55, abs=1e-4)
    assert time[flow.argmax()] == pytest.approx(0.0215, abs=2e-5)
    assert flow.mean() == pytest.approx(0.169, abs=1e-5)
    assert np.all(flow[time > 0.058] == 0)
    assert np.all(flow[(time > 1e-4) & (time < 0.0579)] > 0)


def test_errors_have_the_kernel_as_covariance():
    time = np.linspace(0, 0.11, 12)
    draws = correlated_errors(np.random.default_rng(1), time, 5e4, 140.0, 40_000)
    np.testing.assert_allclose(np.cov(draws.T), neural_network_kernel(time, 5e4, 140.0), atol=0.03)


def test_embedded_study_is_what_the_command_makes(tmp_path: Path):
    made, embedded = demo_study(), load_study("demo")
    save_study(made, tmp_path)
    again = load_study(tmp_path)
    np.testing.assert_allclose(again.values, embedded.values, atol=2e-4)
    np.testing.assert_array_equal(again.inflow_ml_s, embedded.inflow_ml_s)
    assert again.vessels == embedded.vessels
    assert embedded.conventions.name == "printed"
    assert 80 < signal_to_noise(embedded) < 125
    vessels = [s.vessel for s in embedded.series]
    assert vessels == [1, 2, 3]
    assert falls_towards_periphery(Network.from_study(embedded), vessels, embedded.values)
    assert not falls_towards_periphery(Network.from_study(embedded), vessels, embedded.values[::-1])


def test_errors_that_always_break_the_order_are_an_error():
    base = load_study("demo")
    sites = [(v.id, 0.5) for v in base.vessels]
    with pytest.raises(RuntimeError, match="fewer vessels"):
        synthetic_study(base, name="x", sites=sites, n_times=64, max_draws=20)


def test_another_seed_makes_other_errors_around_the_same_truth():
    base = load_study("demo")
    one, two = (synthetic_study(base, name="x", truth=Truth(), n_times=64, seed=s) for s in (1, 2))
    difference = one.values - two.values
    assert 0.01 < np.abs(difference).max() < 6.0
