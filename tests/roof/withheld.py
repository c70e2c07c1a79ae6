"""A study whose effect is known, and diagnoses as if they had gone on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from rich.console import Console

from zoo import cli
from zoo.blood.baseline import get_baseline
from zoo.blood.effects import CATALOGUE
from zoo.blood.ejection import ejection
from zoo.blood.study import Blood, Series, Study, Vessel, Windkessel
from zoo.blood.study_diagnosis import StudyDiagnosis
from zoo.core.diagnosis import DiagnosisFile
from zoo.core.effects import with_effects
from zoo.core.forward import Outputs
from zoo.core.parameters import pack, start_of

TAU_S = 0.004

NOISE = {"pressure_mmHg": 0.05, "flow_ml_s": 0.003}

TRIED = ("viscoelastic-wall", "inflow-shift", "vessel-radius")


def made(*series: tuple[int, float, str], period: float = 0.11, more: float = 1.0, seed: int = 3) -> Study:
    """A tree of five vessels whose wall is viscoelastic, with white noise; another beat is another state."""
    flow_time, flow = ejection(256)
    flow_time, flow = flow_time * (period / 0.11), more * flow
    ends = [Windkessel(6e4, 1.8e5, 8e-7), Windkessel(7e4, 2e5, 7e-7), Windkessel(4e4, 1.1e5, 1.2e-6)]
    vessels = (
        Vessel(1, "trunk", 0.4, 0.047, 0.047, None, None),
        Vessel(2, "left", 0.35, 0.035, 0.035, 1, None),
        Vessel(3, "right", 0.3, 0.035, 0.03, 1, ends[2]),
        Vessel(4, "upper", 0.2, 0.025, 0.025, 2, ends[0]),
        Vessel(5, "lower", 0.25, 0.022, 0.022, 2, ends[1]),
    )
    times = np.arange(64) * period / 64
    study = Study(
        "soft" if period == 0.11 else "faster",
        period,
        Blood(1.055, 0.049),
        vessels,
        flow_time,
        flow,
        times,
        (),
    )
    flow = get_baseline("linear-constant").forward(study)
    model = with_effects(flow, [CATALOGUE["viscoelastic-wall"].at()])
    theta = np.append(pack(flow.parameters, start_of(flow.parameters)), TAU_S)
    waves = model.solve(model.configure(theta), Outputs(series, times))
    rng = np.random.default_rng(seed)
    noisy = [w + NOISE[s[2]] * rng.standard_normal(64) for s, w in zip(series, waves, strict=True)]
    return replace(study, series=tuple(Series(*s, w) for s, w in zip(series, noisy, strict=True)))


FIGURES = ["gap", "causes", "sensitivity", "where", "impedance", "diagnosis"]
FILES = ["diagnosis.json", "report.html", *(f"{name}.png" for name in FIGURES)]

POSTERIORS = {
    name: {
        "converged": name == "nothing",
        "verdict": "not converged: R-hat of tau is 1.2",
        "log_marginal_likelihood": value,
        "log_marginal_likelihood_se": 0.1,
        "elpd_waic": value + 5,
        "elpd_waic_difference": 0.0 if value > 0 else 160.0,
        "elpd_waic_difference_se": None,
        "elpd_loo": None,
        "parameters": {"f3": {"mean": 4.3e4, "sd": 300.0}},
    }
    for name, value in (("nothing", -100.0), ("viscoelastic-wall", 60.0))
}


def as_if_sampled(d: StudyDiagnosis) -> StudyDiagnosis:
    """As if the leading sets of effects had been sampled."""
    return d.with_file(posteriors=POSTERIORS)


def screen_of(file: DiagnosisFile) -> str:
    """What `zoo diagnose` says of a diagnosis."""
    console = Console(width=200, markup=False)
    with console.capture() as captured:
        for line in cli.diagnose.diagnosis_screen(file):
            console.print(line)
    return captured.get()
