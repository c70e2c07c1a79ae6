"""The field's benchmark networks, imported: distance from finite-volume waveforms, and speed.

Usage, in the project's folder: python -m benchmarks.published_networks      (needs the folder benchmarks of
ZOO_DATA_DIR; half a minute)

References
----------
Boileau et al. 2015, doi 10.1002/cnm.2732; Matthys et al. 2007, doi 10.1016/j.jbiomech.2007.05.027.
"""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from zoo.blood.importing.openbf import import_openbf
from zoo.blood.network import Network
from zoo.blood.solver import Solution, Solver, SolverOptions
from zoo.blood.study import Study

# radius and thickness (cm) at the diastolic pressure (Pa), by which the finite-volume waveforms were made
PUBLISHED = {
    "cca": {"common_carotid_artery": (0.30, 0.030, 10933.0)},
    "ibif": {"parent": (0.86, 0.1032, 9500.0), "d1": (0.60, 0.072, 9500.0), "d2": (0.60, 0.072, 9500.0)},
}
WAVEFORMS = (("cca", 1, "cca_mid_fv"), ("ibif", 1, "ibif_aorta_mid_fv"), ("ibif", 2, "ibif_iliac_mid_fv"))
NETWORKS = ("uta", "adan56", "invitro_model")
CELL_CM = 1.0


def with_published_walls(study: Study) -> Study:
    """The study with radii and thicknesses at diastolic pressure instead of the file's at rest."""
    vessels = []
    for v in study.vessels:
        radius, wall, pressure = PUBLISHED[study.name][v.name]
        at = pressure * 10 / study.conventions.mmhg
        vessels.append(
            replace(
                v, radius_cm=radius, radius_out_cm=radius, wall_thickness_cm=wall, radius_pressure_mmHg=at
            )
        )
    return replace(study, vessels=tuple(vessels))


def solver(study: Study, places: list[tuple[int, float]], times: np.ndarray, dx_cm: float) -> Solver:
    """Of the linear wall, on cells of at most `dx_cm`."""
    return Solver.for_study(study, "linear", series=places, times_s=times, options=SolverOptions(dx_cm=dx_cm))


def solve(study: Study, places: list[tuple[int, float]], times: np.ndarray, dx_cm: float) -> Solution:
    """With the stiffness of the study's walls."""
    return solver(study, places, times, dx_cm).solve(Network.from_study(study).stiffness_in)


def distance(study: Study, vessel: int, file: Path, dx_cm: float = 0.1) -> tuple[float, float]:
    """RMS over a beat at mid-vessel: pressure relative to the reference, flow to its maximum."""
    data = np.genfromtxt(file, delimiter=",", names=True)
    found = solve(study, [(vessel, 0.5)], data["time_s"], dx_cm)
    kpa = found.pressure_mmHg[0] * study.conventions.mmhg / 1e4
    p = np.sqrt(np.mean((kpa / data["pressure_kPa"] - 1) ** 2))
    q = np.sqrt(np.mean((found.flow_ml_s[0] - data["flow_ml_s"]) ** 2)) / np.abs(data["flow_ml_s"]).max()
    return float(p), float(q)


def refinement(study: Study, dx_cm: float) -> tuple[float, float, float]:
    """Largest RMS of any vessel's middle against cells a quarter as long, and solves a second."""
    times = np.arange(256) * study.period_s / 256
    places = [(v.id, 0.5) for v in study.vessels]
    coarse = solver(study, places, times, dx_cm)
    stiffness = Network.from_study(study).stiffness_in
    coarse.solve(stiffness)
    began = time.perf_counter()
    for _ in range(3):
        found = coarse.solve(stiffness)
    rate = 3 / (time.perf_counter() - began)
    fine = solve(study, places, times, dx_cm / 4)
    p = np.sqrt(np.mean((found.pressure_mmHg / fine.pressure_mmHg - 1) ** 2, axis=1)).max()
    largest = np.abs(fine.flow_ml_s).max(axis=1, keepdims=True)
    q = np.sqrt(np.mean(((found.flow_ml_s - fine.flow_ml_s) / largest) ** 2, axis=1)).max()
    return float(p), float(q), rate


def main() -> None:
    """Print both tables."""
    folder = Path(os.environ["ZOO_DATA_DIR"]) / "benchmarks"
    print("RMS from the finite-volume waveforms     pressure      flow")
    for name, vessel, file in WAVEFORMS:
        study = import_openbf(folder / "openbf" / f"{name}.yaml").study
        for words, used in (("file's walls", study), ("published walls", with_published_walls(study))):
            p, q = distance(used, vessel, folder / f"{file}.csv")
            print(f"{file:20s} {words:16s}  {100 * p:9.3f} % {100 * q:8.3f} %")
    print(f"\ncells of {CELL_CM:g} cm       vessels   pressure      flow   solves/s")
    for name in NETWORKS:
        study = import_openbf(folder / "openbf" / f"{name}.yaml").study
        p, q, rate = refinement(study, CELL_CM)
        print(f"{name:20s} {len(study.vessels):7d} {100 * p:8.3f} % {100 * q:7.3f} % {rate:10.1f}")


if __name__ == "__main__":
    main()
