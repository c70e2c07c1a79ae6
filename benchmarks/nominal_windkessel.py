"""How near the nominal loads derived from mouse-c6 come to the published ones, and what the rest is made of.

Usage: python benchmarks/nominal_windkessel.py      (needs the measured data, see `zoo fetch mouse-c6`)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from zoo import Solver, Study, Vessel, load_study
from zoo.blood.network import diastolic_tau, nominal_windkessel, poiseuille_split
from zoo.blood.study import Windkessel

GEOMETRY_ROUNDING_CM = 0.0005  # lengths and radii are published with three decimals


def published_flow(vessels: dict[int, Vessel], conductance: dict[int, float], i: int) -> float:
    """Conductance of all terminals behind vessel i, that is its flow per unit of pressure."""
    below = [v.id for v in vessels.values() if v.parent == i]
    return float(sum(published_flow(vessels, conductance, j) for j in below)) if below else conductance[i]


def smallest_shift(wanted: float, left: Vessel, right: Vessel) -> float:
    """Change of the radii and lengths of two siblings, cm, that makes the ratio of their r^4/L `wanted`."""
    sign = math.copysign(
        1, math.log(wanted * (right.radius_cm / left.radius_cm) ** 4 * left.length_cm / right.length_cm)
    )

    def ratio(shift: float) -> float:
        d = sign * shift
        up = (left.radius_cm + d) ** 4 / (left.length_cm - d)
        return float(up / ((right.radius_cm - d) ** 4 / (right.length_cm + d)))

    low, high = 0.0, 0.01
    for _ in range(60):
        middle = (low + high) / 2
        if sign * (math.log(ratio(middle)) - math.log(wanted)) < 0:
            low = middle
        else:
            high = middle
    return high


def window(study: Study, start: float, stop: float) -> float:
    """tau from the logarithm of the measured pressure between two times of the beat, s."""
    t, p = study.time_s, study.values[0]
    part = (t >= start) & (t <= stop)
    return float(-1 / np.polyfit(t[part], np.log(p[part]), 1)[0])


def with_loads(study: Study, loads: dict[int, Windkessel]) -> list[Vessel]:
    """The study's vessels with other loads at their terminals."""
    return [replace(v, windkessel=loads.get(v.id)) for v in study.vessels]


def waves(solver: Solver, point: Sequence[float] | np.ndarray) -> np.ndarray:
    """MPA pressure, mmHg, at stiffness, psi1, psi2 and c."""
    f3, psi1, psi2, c = point
    return np.asarray(solver.solve(f3, psi1=psi1, psi2=psi2, c=c).pressure_mmHg[0])


def main() -> None:
    """Print the comparison."""
    study = load_study("mouse-c6")
    vessels = {v.id: v for v in study.vessels}
    loads = {i: v.windkessel for i, v in vessels.items() if v.windkessel}
    total = {i: load.R1 + load.R2 for i, load in loads.items()}
    mmhg = study.conventions.mmhg
    pressure, flow = float(study.values[0].mean()), float(study.inflow_ml_s.mean())
    tau = diastolic_tau(study.time_s, study.values[0], study.inflow_time_s, study.inflow_ml_s, study.period_s)
    share = poiseuille_split(study.vessels)
    bare = [replace(v, windkessel=None) for v in study.vessels]
    derived = nominal_windkessel(bare, pressure, flow, tau, mmhg=mmhg)

    parallel = 1 / sum(1 / r for r in total.values())
    level = pressure * mmhg / flow / parallel
    print(f"mean pressure {pressure:.4f} mmHg, mean inflow {flow:.6f} ml/s, tau {tau:.4f} s")
    print(f"published: all outlets in parallel times mean inflow {parallel * flow / mmhg:.4f} mmHg")
    print()
    print("derived / published; R1 + R2 = level x split, C = tau / (R1 + R2)")
    print(f"{'vessel':>6} {'R1+R2':>8} {'level':>8} {'split':>8} {'C':>8} {'tau':>8}   published tau, s")
    for i, load in loads.items():
        own, theirs = derived[i].R1 + derived[i].R2, total[i]
        split = parallel / theirs / share[i]
        print(
            f"{i:>6} {own / theirs:8.4f} {level:8.4f} {split:8.4f} {derived[i].C / load.C:8.4f} "
            f"{tau / (theirs * load.C):8.4f}   {theirs * load.C:.4f}"
        )
    ratios = np.array([(derived[i].R1 + derived[i].R2) / total[i] for i in loads])
    compliances = np.array([derived[i].C / load.C for i, load in loads.items()])
    for name, ratio in (("R1 + R2", ratios), ("C", compliances)):
        spread = np.sqrt(np.mean(np.log(ratio) ** 2))
        print(f"{name}: {ratio.min():.4f} to {ratio.max():.4f}, RMS of the logarithm {spread:.4f}")

    print()
    print("first daughter's share at each junction, and the shift of radii and lengths that explains it, um")
    print(
        f"{'vessel':>6} {'daughters':>10} {'derived':>8} {'alone':>8} {'published':>9} {'shift':>6}   "
        "(rounding allows 5)"
    )
    conductance = {i: 1 / r for i, r in total.items()}
    for i in vessels:
        pair = [v for v in vessels.values() if v.parent == i]
        if not pair:
            continue
        flows = [published_flow(vessels, conductance, v.id) for v in pair]
        first, second = (v.radius_cm**4 / v.length_cm for v in pair)
        alone = first / (first + second)
        shift = smallest_shift(flows[0] / flows[1], *pair)
        print(
            f"{i:>6} {pair[0].id:>6}, {pair[1].id:>2} {share[pair[0].id] / share[i]:8.4f} {alone:8.4f} "
            f"{flows[0] / sum(flows):9.4f} {shift * 1e4:6.2f}   "
            f"{'within' if shift < GEOMETRY_ROUNDING_CM else 'beyond'}"
        )

    print()
    print("tau, s, from a line through log(pressure) between two times of the beat")
    starts = (0.052, 0.055, 0.058, 0.060, 0.065, 0.070)
    print(f"{'to':>8} " + " ".join(f"{s:8.3f}" for s in starts) + "   from, s")
    for stop in (0.105, 0.110):
        print(f"{stop:8.3f} " + " ".join(f"{window(study, s, stop):8.4f}" for s in starts))

    print()
    print("model A (published code's conventions), MPA pressure, derived loads against the published ones")
    given, own = (
        Solver.for_study(study),
        Solver.for_study(replace(study, vessels=tuple(with_loads(study, derived)))),
    )
    medians = (5.17e4, 0.21, 0.88, 1.44)
    change = waves(own, medians) - waves(given, medians)
    print(
        f"at the published medians: {np.abs(change).max():.3f} mmHg maximum, "
        f"{np.sqrt((change**2).mean()):.3f} RMS"
    )
    names = ("f3", "psi1", "psi2", "c")
    for what, solver in (("published loads", given), ("derived loads", own)):
        fit = least_squares(
            lambda x, s=solver: waves(s, np.exp(x)) - study.values[0], np.log(medians), diff_step=1e-4
        )
        values = ", ".join(f"{name} {value:.4g}" for name, value in zip(names, np.exp(fit.x), strict=True))
        print(f"best fit with {what}: sum of squares {2 * fit.cost:.2f}, {values}")


if __name__ == "__main__":
    main()
