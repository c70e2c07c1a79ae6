"""Synthetic studies: the inflow, the covariance of the errors, the order of pressures, the embedded study."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks.paun2020.synthetic import (
    GAP_NOISE_MMHG,
    GAP_TRUTH,
    Truth,
    correlated_errors,
    demo_gap_study,
    demo_study,
    falls_towards_periphery,
    synthetic_study,
    whitened,
)

from zoo.blood.baseline import get_baseline
from zoo.blood.conventions import get_conventions
from zoo.blood.effects import CATALOGUE
from zoo.blood.ejection import ejection
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import load_study, save_study
from zoo.blood.study_diagnosis import diagnose
from zoo.core.effects import with_effects
from zoo.core.errors.gaussian_process import neural_network_kernel


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


def test_the_study_for_the_diagnosis_is_what_the_command_makes():
    made, embedded = demo_gap_study(), load_study("demo-gap")
    np.testing.assert_allclose(made.values, embedded.values, atol=2e-4)
    assert embedded.vessels == load_study("demo").vessels
    flow = get_baseline("linear-constant").forward(embedded, options=SolverOptions(refine=2))
    theta = [GAP_TRUTH[p.name] for p in flow.parameters]
    elastic = embedded.values - flow.solve(flow.configure(np.array(theta)))
    assert np.sqrt(np.mean(elastic**2)) > 3 * GAP_NOISE_MMHG  # what a model without the effect misses
    model = with_effects(flow, [CATALOGUE["viscoelastic-wall"].at()])
    left = embedded.values - model.solve(model.configure(np.array([*theta, 0.004])))
    assert np.sqrt(np.mean(left**2)) == pytest.approx(GAP_NOISE_MMHG, rel=0.1)


@pytest.mark.slow
def test_the_diagnosis_names_its_cause():
    found = diagnose(load_study("demo-gap"))
    assert found.cause == ["viscoelastic-wall"]
    assert found.causes[0].estimates[0].mean == pytest.approx(0.004, rel=0.1)


def test_embedded_study_is_what_the_command_makes(tmp_path: Path):
    made, embedded = demo_study(), load_study("demo")
    save_study(made, tmp_path)
    again = load_study(tmp_path)
    np.testing.assert_allclose(again.values, embedded.values, atol=2e-4)
    np.testing.assert_array_equal(again.inflow_ml_s, embedded.inflow_ml_s)
    assert again.vessels == embedded.vessels
    assert embedded.conventions.name == "printed"
    vessels = [s.vessel for s in embedded.series]
    assert vessels == [1, 2, 3]
    assert falls_towards_periphery(Network.from_study(embedded), vessels, embedded.values)
    assert not falls_towards_periphery(Network.from_study(embedded), vessels, embedded.values[::-1])


def test_errors_that_always_break_the_order_are_refused():
    base = load_study("demo")
    sites = [(v.id, 0.5) for v in base.vessels]
    with pytest.raises(RuntimeError, match="fewer vessels"):
        synthetic_study(base, name="x", sites=sites, n_times=64, seed=5, truth=Truth(b=1000.0))


def test_another_seed_makes_other_errors_around_the_same_truth():
    base = load_study("demo")
    one, two = (synthetic_study(base, name="x", truth=Truth(), n_times=64, seed=s) for s in (1, 2))
    difference = one.values - two.values
    assert 0.01 < np.abs(difference).max() < 6.0


def test_errors_are_all_that_separates_data_from_their_truth():
    """With every convention of the published code, the lag of the samples too."""
    base, truth = load_study("demo", get_conventions("published-code")), Truth(f1=1e5)
    made = synthetic_study(
        base, name="x", truth=truth, sites=[(v, 0.5) for v in (1, 2, 3, 9)], seed=2, ordered=False
    )
    unit = made.conventions.stiffness_radius_unit_cm
    stiffness = stiffness_profile(Network.from_study(made).radius_in_cm, truth.f1, truth.f2, truth.f3, unit)
    solver = Solver.for_study(made, options=SolverOptions(refine=4, tolerance_mmHg=1e-6))
    clean = solver.solve(stiffness, psi1=truth.psi1, psi2=truth.psi2, c=truth.c).pressure_mmHg
    z = whitened(made.values - clean, made.time_s, truth)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.1)
