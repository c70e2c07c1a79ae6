"""What the tests of figures, pages and commands share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from commands import TRUE
from drawn import TIMES
from withheld import POSTERIORS, TRIED, made

from zoo.blood.ejection import ejection
from zoo.blood.solver import Solver
from zoo.blood.study import Blood, Series, Study, Vessel, Windkessel, save_study
from zoo.blood.study_diagnosis import StudyDiagnosis, diagnose
from zoo.cli.options import SamplingOptions
from zoo.core.arviz_lines import InferenceData, of_draws


@pytest.fixture(autouse=True)
def no_figures_of_others() -> None:
    """A test that counts open figures begins with none."""
    plt.close("all")


@pytest.fixture(scope="module", autouse=True)
def chains_in_this_process() -> Iterator[None]:
    """What commands sample, whose draws do not depend on it: a process for a chain imports all again."""
    settings = SamplingOptions.settings
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SamplingOptions, "settings", lambda self: settings(self) | {"cores": 0})
        yield


@pytest.fixture
def tube() -> Study:
    vessels = (Vessel(1, "trunk", 0.4, 0.047, 0.047, None, Windkessel(3e4, 9e4, 1.5e-6)),)
    flow_time = np.arange(32) * 0.11 / 32
    series = (
        Series(1, 0.0, "pressure_mmHg", 15 + np.sin(TIMES * 57)),
        Series(1, 1.0, "flow_ml_s", 0.2 + 0.1 * np.sin(TIMES * 57)),
    )
    return Study("tube", 0.11, Blood(1.055, 0.049), vessels, flow_time, np.ones(32), TIMES, series)


@pytest.fixture
def idata() -> InferenceData:
    rng = np.random.default_rng(0)
    draws = {
        "f3": 5e4 + 1e3 * rng.normal(size=(4, 200)),
        "c": rng.normal(size=(4, 200)),
        "mean": rng.normal(size=(4, 200, 40)),
    }
    return of_draws({"posterior": draws}, dims={"mean": ["time"]})


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of three vessels whose pressure was made by the solver, with white noise."""
    flow_time, flow = ejection(256)
    outlets = (Windkessel(3e4, 9e4, 1.5e-6), Windkessel(4e4, 1.1e5, 1.2e-6))
    vessels = (
        Vessel(1, "trunk", 0.4, 0.047, 0.047, None, None),
        Vessel(2, "left", 0.35, 0.03, 0.03, 1, outlets[0]),
        Vessel(3, "right", 0.3, 0.035, 0.03, 1, outlets[1]),
    )
    times = np.arange(64) * 0.11 / 64
    empty = Study("tiny", 0.11, Blood(1.055, 0.049), vessels, flow_time, flow, times, ())
    clean = Solver.for_study(empty, series=[(1, 0.0)], times_s=times).solve(**TRUE).pressure_mmHg[0]
    noisy = clean + 0.1 * np.random.default_rng(0).standard_normal(64)
    folder = tmp_path_factory.mktemp("studies") / "tiny"
    save_study(replace(empty, series=(Series(1, 0.0, "pressure_mmHg", noisy),)), folder)
    return folder


@pytest.fixture(scope="session")
def three(made_once: Callable[[str, Callable[[], Any]], Any]) -> StudyDiagnosis:
    """Two pressures and a flow."""
    study = made((1, 0.0, "pressure_mmHg"), (4, 0.5, "pressure_mmHg"), (3, 0.5, "flow_ml_s"))
    return made_once("three", lambda: diagnose(study, effects=TRIED, component_sizes=0.0))


@pytest.fixture(scope="session")
def one(made_once: Callable[[str, Callable[[], Any]], Any]) -> StudyDiagnosis:
    """One pressure."""
    study = made((1, 0.0, "pressure_mmHg"))
    return made_once("one", lambda: diagnose(study, effects=TRIED[:2], component_sizes=0.0))


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("studies") / "soft"
    save_study(made((1, 0.0, "pressure_mmHg")), path)
    return path


@pytest.fixture
def sampled(one: StudyDiagnosis, monkeypatch: pytest.MonkeyPatch) -> StudyDiagnosis:
    """What `with_posteriors` makes of a diagnosis when the posteriors cost no time."""

    def given(*_: object, **__: object) -> SimpleNamespace:
        return SimpleNamespace(summary=lambda: POSTERIORS)

    monkeypatch.setattr("zoo.core.diagnosis.posteriors.sample_explanations", given)
    return one.with_posteriors()
