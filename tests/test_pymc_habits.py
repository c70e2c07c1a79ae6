"""What somebody who knows PyMC and ArviZ tries first."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pymc as pm
import pytest
from pymc.sampling.mcmc import assign_step_methods

import zoo
from gaussian import gaussian_model
from zoo.core.inference.pymc_step import DEMetropolisZFromMode
from zoo.core.model import ModelError
from zoo.core.op import MissingGradientError

PYMC_6 = "ignore:`find_MAP` will:FutureWarning"


@pytest.fixture(scope="module")
def model_a():
    return zoo.model_A(zoo.load_study("demo"))


@pytest.fixture(scope="module")
def mode_a(model_a):
    return zoo.find_mode(model_a)


@pytest.mark.parametrize("letter", ["A", "B", "F"])
def test_pymc_chooses_our_step_method_for_every_variable(letter):
    model = getattr(zoo, f"model_{letter}")(zoo.load_study("demo"))
    given, chosen = assign_step_methods(model)
    assert given == []
    assert list(chosen) == [DEMetropolisZFromMode]
    assert set(chosen[DEMetropolisZFromMode]) == set(model.value_vars)


def test_other_models_keep_pymcs_choice():
    _, chosen = assign_step_methods(gaussian_model())
    assert DEMetropolisZFromMode not in chosen
    with pm.Model() as plain:
        pm.Normal("x")
    _, chosen = assign_step_methods(plain)
    assert list(chosen) == [pm.NUTS]


def moments_of(model, point, n, step):
    """First point of a chain in PyMC's order of calls, and the draws after its tuning (n, n_dim)."""
    step.tune = True
    step.reset_tuning()
    rows = []
    for i in range(2 * n):
        if i == n:
            step.stop_tuning()
        point, _ = step.step(point)
        rows.append(np.concatenate([np.ravel(point[v.name]) for v in step.vars]))
    return rows[0], np.array(rows[n:])


def test_chains_of_a_known_law_start_apart_and_end_together():
    model = gaussian_model()
    step = zoo.step(model)
    firsts, draws = [], []
    for seed in range(4):
        step.rng = np.random.default_rng(seed)
        first, kept = moments_of(model, model.initial_point(), 1500, step)
        firsts.append(first)
        draws.append(kept)
    assert len({tuple(first) for first in firsts}) == 4
    from gaussian import gaussian_posterior

    mean, covariance = gaussian_posterior()
    found = np.concatenate(draws)
    sd = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(found.mean(0) - mean) < 0.15 * sd)
    np.testing.assert_allclose(found.std(0), sd, rtol=0.15)


def test_starts_that_are_given_are_kept():
    model = gaussian_model()
    step = zoo.step(model, scaling=1e-12, lamb=1e-12, crank_nicolson=0.0)
    start = {name: value + 0.25 for name, value in model.initial_point().items()}
    step.rng = np.random.default_rng(0)
    first, _ = moments_of(model, start, 1, step)
    given = np.concatenate([np.ravel(start[v.name]) for v in step.vars])
    np.testing.assert_allclose(first, given, atol=1e-6)


def test_a_variable_added_to_the_model_gets_pymcs_own_step(mode_a):
    with zoo.model_A(zoo.load_study("demo")) as model:
        pm.Normal("own")
        _, chosen = assign_step_methods(model)
        ours = DEMetropolisZFromMode(chosen[DEMetropolisZFromMode], model=model)
    assert [v.name for v in chosen[pm.NUTS]] == ["own"]
    assert len(ours._around.mean) == 5
    np.testing.assert_allclose(ours._around.mean, mode_a.vector, atol=0.02)


@pytest.mark.filterwarnings(PYMC_6)
def test_find_map_with_the_solvers_gradient_finds_the_mode(model_a, mode_a):
    with model_a:
        best = pm.find_MAP(progressbar=False)
    for name in ("f3", "psi1", "psi2", "c"):
        assert float(best[name]) == pytest.approx(float(mode_a.values[name]), rel=0.05)


@pytest.mark.filterwarnings(PYMC_6)
@pytest.mark.filterwarnings("error::UserWarning", PYMC_6)
def test_find_map_says_what_to_do_without_a_gradient():
    """By an error, or by PyMC's own warning with its words where it goes on without one."""
    times, prior = np.linspace(0.0, 1.0, 5), zoo.Parameter("a", zoo.Normal(0.0, 9.0))
    line = zoo.FunctionModel(lambda given, t: given["a"] * t, (prior,), zoo.Outputs(("y",), times))
    errors = zoo.Independent(zoo.InverseGamma(3.0, 1.0))
    model = zoo.bayesian_model("line", line, zoo.Data(times, times[None]), errors)
    said = (ModelError, MissingGradientError, UserWarning)
    with model, pytest.raises(said, match=r"zoo\.find_mode\(model\)"):
        pm.find_MAP(progressbar=False)


def test_metropolis_of_pymc_takes_the_mode_as_start(model_a, mode_a):
    values = {name: mode_a.values[name] for name in ("f3", "psi1", "psi2", "c", "noise_pressure_mmHg")}
    with model_a, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        idata = pm.sample(
            2, tune=0, chains=1, cores=1, step=pm.Metropolis(), initvals=values, random_seed=1,
            progressbar=False, compute_convergence_checks=False,
        )  # fmt: skip
    assert float(idata.posterior["psi2"][0, 0]) == pytest.approx(float(values["psi2"]), rel=0.5)


def test_a_model_of_ones_own_has_the_step_method_too() -> None:
    """In a process of its own, which has made no model of blood: then `pm.sample()` alone samples it."""
    script = """
import zoo
zoo.bayesian_model
from pymc.step_methods import STEP_METHODS
print([one.__name__ for one in STEP_METHODS])
"""
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "DEMetropolisZFromMode" in ran.stdout
