"""What each switch of the conventions does, and which reading of the equations Table 4 was made with.

Usage, in the project's folder: python -m benchmarks.conventions      (needs the measured data)
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from benchmarks.convergence import MEDIANS, everywhere, published_waveforms
from numpy.typing import NDArray
from scipy.optimize import least_squares

from zoo.blood.conventions import PRINTED, PUBLISHED_CODE, Conventions
from zoo.blood.network import Network, stiffness_profile
from zoo.blood.solver import STATUS_NAMES, Solver
from zoo.blood.study import Study, load_study
from zoo.core.errors.gaussian_process import gp_sequential

Array = NDArray[np.float64]

SWITCHES = (
    "wall_factor",
    "stiffness_radius_unit_cm",
    "friction",
    "truncate_lengths",
    "mmhg",
    "sample_lag_beats",
)
# posterior medians of Table 4 of Paun et al. 2020, doi 10.1098/rsif.2020.0886; F and G print no stiffness
TABLE_4: dict[str, dict[str, Any]] = {
    "A": {"f3": 5.17e4, "psi1": 0.21, "psi2": 0.88, "c": 1.44, "sse": 66},
    "B": {"f3": 4.31e4, "psi1": 0.28, "psi2": 0.87, "c": 1.35, "w": 5.36e4, "b": 137, "sse": 551},
    "C": {"f3": 4.31e4, "psi1": 0.29, "psi2": 0.87, "c": 1.34, "w": 5.41e4, "b": 138, "sse": 571},
    "D": {"f1": 52.6e5, "f2": -162, "f3": 5.17e4, "psi1": 0.21, "psi2": 0.89, "c": 1.45, "sse": 64},
    "E": {"f1": 51.1e5, "f2": -171, "f3": 4.32e4, "psi1": 0.29, "psi2": 0.87, "c": 1.34}
    | {"w": 5.39e4, "b": 138, "sse": 552},
    "H": {"f3": 9.17e4, "gamma": 5.18, "psi1": 0.37, "psi2": 0.94, "c": 1.60}
    | {"w": 4.91e4, "b": 178, "sse": 384},
    "I": {"f1": 0.58e5, "f2": -6.00, "f3": 2.00e4, "gamma": 5.09, "psi1": 0.34, "psi2": 0.97, "c": 1.58}
    | {"w": 4.45e4, "b": 196, "sse": 417},
}
WAIC = {"B": -4515, "C": -4515, "E": -4515, "H": -4522, "I": -4530}


def pressure(study: Study, model: str, conventions: Conventions) -> Array | str:
    """MPA pressure at the study's samples (mmHg) at a model's published medians, or why there is none."""
    values = TABLE_4[model]
    radius = Network.from_study(study).radius_in_cm
    f1, f2, f3 = (float(values.get(name, 0.0)) for name in ("f1", "f2", "f3"))
    stiffness = stiffness_profile(radius, f1, f2, f3, conventions.stiffness_radius_unit_cm)
    wall = "tangent" if "gamma" in values else "linear"
    given = {name: values[name] for name in ("gamma", "psi1", "psi2", "c") if name in values}
    s = Solver.for_study(study, wall, conventions=conventions).solve(stiffness, **given, check=False)
    return s.pressure_mmHg[0] if s.ok else STATUS_NAMES[s.status]


def difference(a: Array | str, b: Array | str) -> str:
    """Maximum and root mean square of a difference."""
    if isinstance(a, str) or isinstance(b, str):
        return f"{a if isinstance(a, str) else b}"
    d = a - b
    if not np.any(d):
        return "none"
    return f"{np.abs(d).max():.3f} / {np.sqrt(np.mean(d**2)):.3f}"


def each_switch_alone(study: Study) -> None:
    """One switch of a bundle set to the other bundle's value, at the medians of four models."""
    models = ("A", "E", "H", "I")
    for base, other in ((PUBLISHED_CODE, PRINTED), (PRINTED, PUBLISHED_CODE)):
        print(
            f"== {base.name} with one switch as in {other.name}: change of the MPA pressure, mmHg, max / RMS"
        )
        print(f"{'switch':25} " + " ".join(f"{'model ' + m:>15}" for m in models))
        before = {m: pressure(study, m, base) for m in models}
        for switch in SWITCHES:
            changed = base.replace(**{switch: getattr(other, switch)})
            cells = [difference(pressure(study, m, changed), before[m]) for m in models]
            print(f"{switch:25} " + " ".join(f"{cell:>15}" for cell in cells))
        cells = [difference(pressure(study, m, other), before[m]) for m in models]
        print(f"{'all of them':25} " + " ".join(f"{cell:>15}" for cell in cells))
        print()


def against_the_published_waves(study: Study) -> None:
    """The published solver's waves against ours with its conventions and with one switch as printed."""
    given = published_waveforms(study)
    if given is None:
        print("== against the published waveforms: not in ZOO_DATA_DIR, left out\n")
        return
    times, waves, flow = given

    def compare(name: str, conventions: Conventions, shift_s: float = 0.0) -> None:
        solver = Solver.for_study(
            study, "linear", series=everywhere(study), times_s=times + shift_s, conventions=conventions
        )
        d = solver.solve(**MEDIANS["linear"]).pressure_mmHg - waves
        rms = np.sqrt(np.mean(d**2, axis=1))
        print(f"{name:50} {rms[0]:8.4f} {np.abs(d[0]).max():8.4f} {rms.max():9.4f} {np.abs(d).max():8.4f}")

    print("== against the published solver's waveforms at model A's medians, mmHg")
    print(f"{'conventions':50} {'MPA RMS':>8} {'max':>8} {'all RMS':>9} {'max':>8}")
    compare("published-code", PUBLISHED_CODE)
    for switch in ("friction", "truncate_lengths", "mmhg"):
        changed = PUBLISHED_CODE.replace(**{switch: getattr(PRINTED, switch)})
        compare(f"published-code with {switch} as printed", changed)
    compare("published-code, row k read as k/512 beats", PUBLISHED_CODE, -study.period_s / 512)
    compare("printed", PRINTED)
    print()
    print("== time of the rows: inlet flow of the published file's row k against inflow sample 16 (k + s)")
    for shift in (0, 1, 2):
        sample = study.inflow_ml_s[16 * (np.arange(512) + shift) % 8192]
        print(f"s = {shift}: largest difference {np.abs(flow[0] - sample).max():.1e} ml/s")
    print()


READINGS = {
    "published-code": PUBLISHED_CODE,
    "r0 in cm": PUBLISHED_CODE.replace(stiffness_radius_unit_cm=1.0),
    "no 1/pi": PUBLISHED_CODE.replace(wall_factor=1.0),
    "r0 in cm, no 1/pi": PUBLISHED_CODE.replace(stiffness_radius_unit_cm=1.0, wall_factor=1.0),
    "printed": PRINTED,
}


def table_4(study: Study) -> None:
    """Sums of squared errors and -2 log-likelihoods at the published medians under five readings."""
    waves = {(m, r): pressure(study, m, c) for m in TABLE_4 for r, c in READINGS.items()}
    data = study.values[0]

    def show(title: str, value: Any, published: dict[str, Any]) -> None:
        print(f"== {title}")
        print(f"{'model':6} {'published':>10} " + " ".join(f"{name:>18}" for name in READINGS))
        for m, text in published.items():
            cells = []
            for r in READINGS:
                found = waves[m, r]
                cells.append(found if isinstance(found, str) else f"{value(m, found):.1f}")
            print(f"{m:6} {text!s:>10} " + " ".join(f"{cell:>18}" for cell in cells))
        print()

    def joint(m: str, p: Array) -> float:
        terms = gp_sequential(data - p, study.time_s, TABLE_4[m]["w"], TABLE_4[m]["b"])
        return -2.0 * float(terms.sum())

    show(
        'sum of squared errors at the published medians (published: "Euclidean distance")',
        lambda m, p: np.sum((data - p) ** 2),
        {m: v["sse"] for m, v in TABLE_4.items()},
    )
    show("-2 log-likelihood there (published: WAIC, of other samples; compare differences)", joint, WAIC)
    print("== range of the MPA pressure at the published medians, mmHg")
    print(f"{'measured':32} {data.min():5.1f} to {data.max():4.1f}")
    for m, r in (("H", "published-code"), ("H", "no 1/pi"), ("I", "no 1/pi"), ("I", "r0 in cm")):
        p = waves[m, r]
        text = p if isinstance(p, str) else f"{p.min():5.1f} to {p.max():4.1f}"
        print(f"model {m}, {r:23} {text}")
    print()


def best_fit(study: Study, conventions: Conventions) -> str:
    """Least squares of model A with normal 95 % intervals: its posterior under flat priors, nearly."""
    solver = Solver.for_study(study, "linear", conventions=conventions)
    names = ("f3", "psi1", "psi2", "c")
    start = np.log([float(TABLE_4["A"][name]) for name in names])

    def residual(x: Array) -> Array:
        f3, psi1, psi2, c = np.exp(x)
        s = solver.solve(f3, psi1=psi1, psi2=psi2, c=c)
        return np.asarray(s.pressure_mmHg[0] - study.values[0])

    fit = least_squares(residual, start, diff_step=1e-3)
    sse, n = 2.0 * fit.cost, len(fit.fun)
    scatter = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)) * sse / (n - len(names)))
    cells = []
    for x, s in zip(fit.x, scatter, strict=True):
        low, middle, high = np.exp([x - 1.96 * s, x, x + 1.96 * s])
        cells.append(f"{middle:.4g} ({low:.4g}, {high:.4g})".replace("e+0", "e"))
    return f"{sse:6.2f}  " + "  ".join(f"{cell:>23}" for cell in cells)


def lag(study: Study) -> None:
    """What the time of the samples does to model A."""
    print("== best fit of model A: sum of squared errors, least squares, normal 95 % intervals")
    print(f"{'conventions':29} {'SSE':>6}  " + "  ".join(f"{n:>23}" for n in ("f3", "psi1", "psi2", "c")))
    published = ("5.17e4 (5.09e4, 5.25e4)", "0.21 (0.19, 0.23)", "0.88 (0.88, 0.89)", "1.44 (1.39, 1.49)")
    print(f"{'Table 4, at its medians':29} {66:6.2f}  " + "  ".join(f"{p:>23}" for p in published))
    no_lag = PUBLISHED_CODE.replace(sample_lag_beats=0.0)
    print(f"{'published-code':29} {best_fit(study, PUBLISHED_CODE)}")
    print(f"{'without the lag':29} {best_fit(study, no_lag)}")
    true_times = np.arange(512) * (1023 / 511 * study.period_s / 1024)
    print(f"{'at the true times':29} {best_fit(replace(study, time_s=true_times), no_lag)}")
    print(f"{'printed':29} {best_fit(study, PRINTED)}")
    print()


def main() -> None:
    """Print the tables that docs/conventions.md quotes."""
    study = load_study("mouse-c6")
    each_switch_alone(study)
    against_the_published_waves(study)
    table_4(study)
    lag(study)


if __name__ == "__main__":
    main()
