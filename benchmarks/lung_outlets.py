"""Outlets that are structured trees of a human lung, diagnosed against Windkessels.

Draws trees as `benchmarks.structured_trees` does behind the two branches of a pulmonary trunk (4.3 cm
of radius 1.35, 2.5 of 0.9 and 5.75 of 1.1), with one stiffness of the branches' walls, 1e5 to 4e5 g/(cm
s2) in the logarithm, and a made-up flow of 85 ml/s in a beat of 0.9 s; solves them with cells of 0.0125
cm; adds white noise of 0.1 mmHg and 1 ml/s to pressures in all three vessels and flows in both
branches, 32 samples each; and diagnoses each record with baseline B, whose outlets are three-element
circuits. Prints the probability of the outlets and of the other components, what leads, and the noise
that was found.

    python -m benchmarks.lung_outlets FOLDER [--n 10] [--seed 1]
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.structured_trees import HIGH, LOW, OUTLETS_CM, PERIOD_S
from scipy.stats import qmc

import zoo
from zoo.blood.ejection import ejection
from zoo.blood.solver import SolverOptions
from zoo.blood.units import MMHG

STUDY = """name = "{name}"
network = "network.toml"
inflow = "inflow.csv"
{observations}period_s = 0.9
"""
BLOOD = """[blood]
density_g_cm3 = 1.057
viscosity_g_cm_s = 0.032
velocity_profile_order = 9
momentum_correction = 1.0
"""
TRUNK = [(1, 4.3, 1.35, ""), (2, 2.5, OUTLETS_CM[0], "parent = 1"), (3, 5.75, OUTLETS_CM[1], "parent = 1")]
SEEN = [(1, "pressure_mmHg"), (2, "pressure_mmHg"), (3, "pressure_mmHg"), (2, "flow_ml_s"), (3, "flow_ml_s")]
NOISE = {"pressure_mmHg": 0.1, "flow_ml_s": 1.0}
MEAN_ML_S, SAMPLES = 85.0, 32
WALLS = (1e5, 4e5)
FINE = SolverOptions(dx_cm=0.0125)


def write_study(folder: Path, outlet: Mapping[str, Any] | float, observations: str = "") -> zoo.Study:
    """A study in a folder, its terminals with one impedance, or each with a Windkessel of its area."""
    folder.mkdir(parents=True, exist_ok=True)
    seen = 'observations = "observations.csv"\n' if observations else ""
    (folder / "study.toml").write_text(STUDY.format(name=folder.name, observations=seen))
    vessels = []
    for number, length, radius, parent in TRUNK:
        rows = ["[[vessel]]", f"id = {number}", f"length_cm = {length}", f"radius_cm = {radius}", parent]
        if number > 1:
            kind = "windkessel" if isinstance(outlet, float) else "impedance"
            of = circuit(outlet, radius) if isinstance(outlet, float) else outlet
            rows.append(f"{kind} = {{ " + ", ".join(f"{k} = {v:.10g}" for k, v in of.items()) + " }")
        vessels.append("\n".join(filter(None, rows)) + "\n")
    (folder / "network.toml").write_text("\n".join([BLOOD, *vessels]))
    flow = ejection(1024)[1]
    times = np.arange(1024) * PERIOD_S / 1024
    rows = [f"{t:.9f},{q:.6f}" for t, q in zip(times, flow * MEAN_ML_S / flow.mean(), strict=True)]
    (folder / "inflow.csv").write_text("time_s,flow_ml_s\n" + "\n".join(rows) + "\n")
    if observations:
        (folder / "observations.csv").write_text(observations)
    return zoo.load_study(folder)


def circuit(total: float, radius: float) -> dict[str, float]:
    """Nominal R1, R2, C of a branch by its area: a tenth of the resistance before C, and R2 C one beat."""
    resistance = total * sum(x**2 for x in OUTLETS_CM) / radius**2
    return {"R1": 0.1 * resistance, "R2": 0.9 * resistance, "C": PERIOD_S / (0.9 * resistance)}


def make_record(folder: Path, row: np.ndarray, rng: np.random.Generator) -> zoo.Study:
    """What sensors see of one draw of a lung's trees, as a study that knows no tree."""
    f1, f2, f3, alpha, beta, length, smallest = row
    tree = {
        **{"alpha": alpha, "beta": beta, "length_ratio": length, "smallest_radius_cm": smallest},
        **{"f1": np.exp(f1), "f2": f2, "f3": np.exp(f3)},
    }
    truth = write_study(folder / "truth", tree)
    times = np.arange(SAMPLES) * PERIOD_S / SAMPLES
    places = [(number, 0.5) for number, *_ in TRUNK]
    stiffness = np.exp(rng.uniform(*np.log(WALLS)))
    found = zoo.Solver.for_study(truth, series=places, times_s=times, options=FINE).solve(stiffness)
    waves = {"pressure_mmHg": found.pressure_mmHg, "flow_ml_s": found.flow_ml_s}
    lines = ["vessel,position,quantity,time_s,value"]
    for number, quantity in SEEN:
        values = waves[quantity][number - 1] + NOISE[quantity] * rng.standard_normal(SAMPLES)
        lines += [f"{number},0.5,{quantity},{t:.9f},{x:.6f}" for t, x in zip(times, values, strict=True)]
    total = MMHG * float(np.mean(found.pressure_mmHg[0])) / MEAN_ML_S
    return write_study(folder / "record", total, "\n".join(lines) + "\n")


def main() -> None:
    """Draw, diagnose, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--n", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    draws = qmc.scale(qmc.LatinHypercube(len(LOW), rng=given.seed).random(given.n), LOW, HIGH)
    print("| case | outlets | other components | leading set | mmHg before | after | noise | decided |")
    print("|---|---|---|---|---|---|---|---|")
    for i, row in enumerate(draws):
        case = given.folder / f"case-{i + 1:02d}"
        study = make_record(case, row, np.random.default_rng([given.seed, i]))
        found = zoo.diagnose(study, base="B", progress=False, checkpoint=case / "solves")
        found.save(case / "answer")
        p = {one.name: one.probability for one in found.components}
        others = ", ".join(f"{k} {x:.0%}" for k, x in p.items() if k != "outlets" and x > 0.01) or "–"
        gap = found.file.gap
        print(
            f"| {i + 1} | {p['outlets']:.0%} | {others} | {' + '.join(found.cause) or 'nothing'} | "
            f"{gap.before:.2f} | {gap.after:.3f} | {gap.noise_floor:.3f} | "
            f"{'yes' if found.file.decided else 'no'} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
