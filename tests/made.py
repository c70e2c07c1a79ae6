"""The demo study with data of the solver itself, effects and noise added; for the tests of the diagnosis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zoo import load_study
from zoo.blood.baseline import get_baseline
from zoo.blood.blood_flow import study_data
from zoo.blood.effects import CATALOGUE
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Series, Study
from zoo.core.diagnosis.coordinates import SearchModel
from zoo.core.effects import Location, with_effects
from zoo.core.errors.spectral import Harmonics
from zoo.core.forward import ForwardModel, Outputs
from zoo.core.parameters import pack

SEARCH = SolverOptions(tolerance_mmHg=2e-4)
"""The grid of the published program, at a search's tolerance."""
QUANTITY = "pressure_mmHg"
THETA = {"f3": 4.6e4, "psi1": 0.35, "psi2": 0.9, "c": 1.2}
Added = tuple[str, tuple[float, ...], Location]


def baseline_of(study: Study, name: str = "linear-constant", **settings: object) -> ForwardModel:
    """The forward model of a baseline, with a search's tolerance."""
    return get_baseline(name).forward(study, **{"options": SEARCH, **settings})  # type: ignore[arg-type]


def solved(study: Study, added: list[Added], outputs: Outputs) -> np.ndarray:
    """Series of linear-constant at `THETA` with effects, (n_series, n_times)."""
    model = with_effects(baseline_of(study), [CATALOGUE[name].at(at) for name, _, at in added])
    theta = pack(model.parameters[:4], THETA)
    values = [value for _, values, _ in added for value in values]
    return np.asarray(model.solve(model.configure(np.concatenate([theta, values])), outputs))


def made(
    added: list[Added],
    *,
    series: tuple[int, ...] = (0, 1, 2),
    noise: float = 0.05,
    seed: int = 1,
    n: int = 256,
) -> Study:
    """The demo study with data of the solver: linear-constant, with effects, and white noise in mmHg."""
    demo = load_study("demo")
    chosen = [demo.series[i] for i in series]
    times = np.arange(n) * demo.period_s / n
    outputs = Outputs(tuple((s.vessel, s.position, s.quantity) for s in chosen), times)
    waves = solved(demo, added, outputs)
    waves = waves + noise * np.random.default_rng(seed).standard_normal(waves.shape)
    return replace(
        demo,
        time_s=times,
        series=tuple(Series(s.vessel, s.position, s.quantity, w) for s, w in zip(chosen, waves, strict=True)),
    )


def search_model(
    study: Study, added: tuple[tuple[str, Location], ...] = (), **settings: object
) -> SearchModel:
    """Coefficients of a study by linear-constant with some effects of the catalogue."""
    model = baseline_of(study, **settings)  # type: ignore[arg-type]
    effects = [CATALOGUE[name].of(model).at(location) for name, location in added]
    return SearchModel(model, effects, Harmonics().bind(study_data(study)))
