"""Each model finds known parameters again, from data with fresh errors of its own law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.paun2020.calibration import cheap_options, cheap_study
from benchmarks.paun2020.synthetic import correlated_errors

from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Series, Study
from zoo.core.inference.sampling import sample
from zoo.models import PAPER, get_model

OUTLETS = {"psi1": 0.45, "psi2": 0.75, "c": 1.20}
IID = {"sigma2": 0.02}
GP = {"w": 4.0e4, "b": 110.0}
# on the ridge of f1 and f2, where the uniform priors put most of their mass
RADIUS = {"f1": 5.0e6, "f2": -125.0, "f3": 4.5e4}
POPULATION = {"m_chi": 6.0e4, "v_chi": 2.0, "chi": (6.85e4, 4.87e4, 7.27e4)}
TRUTH: dict[str, dict[str, Any]] = {
    "A": {"f3": 6.3e4, **OUTLETS, **IID},
    "B": {"f3": 6.3e4, **OUTLETS, **GP},
    "D": {**RADIUS, **OUTLETS, **IID},
    "E": {**RADIUS, **OUTLETS, **GP},
    "F": {**POPULATION, **OUTLETS, **IID},
    "G": {**POPULATION, **OUTLETS, **GP},
    "H": {"f3": 1.4e5, "gamma": 4.0, **OUTLETS, **GP},
    "I": {"f1": 4.0e4, "f2": -40.0, "f3": 1.3e5, "gamma": 4.0, **OUTLETS, **GP},
}
SITES = ((1, 0.0), (2, 0.5), (3, 0.5))
# standard deviations of uniform priors that the data must beat by far
PRIOR_SD = dict.fromkeys(OUTLETS, 2.45 / 12**0.5)
STIFFNESS_PRIOR_SD = {"A": 8e4 / 12**0.5, "B": 8e4 / 12**0.5}
SEED = 11


def data(name: str, seed: int, values: Mapping[str, Any]) -> tuple[Study, SolverOptions]:
    """Study whose series come from the solver at known parameters, and errors from NumPy."""
    wall = "tangent" if name in "HI" else "linear"
    options = cheap_options(wall)
    study = cheap_study(sites=SITES)
    if "f1" in values:
        stiffness = stiffness_profile(
            Network.from_study(study).radius_in_cm, values["f1"], values["f2"], values["f3"]
        )
    elif "m_chi" in values:
        stiffness = np.array(values["chi"])
    else:
        stiffness = values["f3"]
    solution = Solver.for_study(study, wall, options=options).solve(
        stiffness, values.get("gamma", 2.0), values["psi1"], values["psi2"], values["c"]
    )
    rng = np.random.default_rng(seed)
    clean = solution.pressure_mmHg
    if "sigma2" in values:
        noisy = clean + values["sigma2"] ** 0.5 * rng.standard_normal(clean.shape)
    else:
        noisy = clean + correlated_errors(rng, study.time_s, values["w"], values["b"], len(clean))
    series = tuple(Series(v, x, "pressure_mmHg", row) for (v, x), row in zip(SITES, noisy, strict=True))
    return replace(study, series=series), options


def recover(
    name: str, seed: int = SEED, wrong: Mapping[str, float] | None = None
) -> dict[str, tuple[np.ndarray, float]]:
    """Draws of every scalar parameter with its known value; the data have the `wrong` ones if given."""
    study, options = data(name, seed, {**TRUTH[name], **(wrong or {})})
    model = get_model(name)(study, options=options)
    idata = sample(model, draws=400, tune=500, chains=2, cores=0, seed=seed, progress=False)
    found = {}
    for parameter, value in TRUTH[name].items():
        draws = idata["posterior"][parameter].to_numpy().reshape(800, -1)
        for i, true in enumerate(np.atleast_1d(value)):
            found[f"{parameter}[{i}]" if np.ndim(value) else parameter] = draws[:, i], float(true)
    return found


@pytest.mark.parametrize(
    "name",
    [
        # each stiffness, wall and error is in another one too
        pytest.param(name, marks=[pytest.mark.nightly] if name in "DFI" else [])
        for name in PAPER
        if name != "C"  # which is B
    ],
)
def test_recovery(name: str) -> None:
    found = recover(name)
    for parameter, (draws, true) in found.items():
        low, high = np.quantile(draws, (0.005, 0.995))
        assert low <= true <= high, f"{parameter}: {true} not in ({low}, {high})"
    for parameter, prior_sd in PRIOR_SD.items():
        assert found[parameter][0].std() < 0.2 * prior_sd, parameter
    if name in STIFFNESS_PRIOR_SD:
        assert found["f3"][0].std() < 0.2 * STIFFNESS_PRIOR_SD[name]


def test_recovery_can_fail() -> None:
    """Data of another compliance: the truth that is asked for is far outside."""
    draws, true = recover("A", wrong={"c": 1.5})["c"]
    assert not np.quantile(draws, 0.005) <= true <= np.quantile(draws, 0.995)
