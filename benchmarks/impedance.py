"""Input impedance of drawn vessels and forks beside transmission-line theory, at the default accuracy.

python -m benchmarks.impedance [--cases 30] [--seed 5]

The flow is small, so that the equations are linear around rest: each vessel is a lossy line of inertance
rho / A, a compliance from the wall and the friction of the Stokes layer, each end a three-element Windkessel.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from zoo import Study, get_baseline
from zoo.blood.case import Case, simulate, wall_slope
from zoo.blood.impedance import modelled_impedance
from zoo.blood.network import Vessel, Windkessel
from zoo.blood.study import Blood
from zoo.blood.units import MMHG
from zoo.core.parameters import pack

HARMONICS = (1, 2, 5)
DENSITY, VISCOSITY = 1.055, 0.049


def drawn(rng: np.random.Generator, fork: bool) -> Case:
    """A vessel, or a fork, of an animal between a mouse and a human, with five small harmonics of flow."""
    period = float(rng.choice([0.1, 0.2, 0.5, 1.0]))
    radius = 0.05 * (10.0 * period) ** rng.uniform(0.8, 1.2)
    length = 8.0 * radius * rng.uniform(0.5, 3.0)

    def end(r: float) -> Windkessel:
        wave = DENSITY * 250.0 / (math.pi * r**2)
        far = wave * rng.uniform(5.0, 15.0)
        return Windkessel(wave * rng.uniform(0.5, 1.5), far, rng.uniform(0.05, 0.2) * period / wave)

    if fork:
        small = radius * rng.uniform(0.5, 0.9, 2)
        vessels = [Vessel(1, "trunk", length, radius, radius)]
        vessels += [
            Vessel(i + 2, "branch", length * rng.uniform(0.5, 1.5), float(r), float(r), 1, end(float(r)))
            for i, r in enumerate(small)
        ]
    else:
        vessels = [Vessel(1, "vessel", length, radius, radius, None, end(radius))]
    n, mean = 1024, 0.05 * math.pi * radius**2
    times = np.arange(n) * period / n
    flow = np.full(n, mean)
    for k in range(1, max(HARMONICS) + 1):
        flow += 0.02 * mean * np.cos(2.0 * np.pi * k * times / period + k)
    study = Study("drawn", period, Blood(DENSITY, VISCOSITY), tuple(vessels), times, flow, np.array([]), ())
    forward = get_baseline("linear-constant").forward(study)
    stiffness = float(10.0 ** rng.uniform(4.6, 5.3))
    case: Case = forward.configure(
        pack(forward.parameters, {"f3": stiffness, "psi1": 1.0, "psi2": 1.0, "c": 1.0})
    )
    return case


def theory(case: Case, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Z (n,) in mmHg s/ml at the root: Z0 (ZL + Z0 tanh(g l)) / (Z0 + ZL tanh(g l)), vessel by vessel."""
    net, slope = case.network, wall_slope(case)
    layer = math.sqrt(net.viscosity / net.density * net.period_s / (2.0 * math.pi))

    def entering(j: int) -> NDArray[np.complex128]:
        place = [(int(net.ids[j]), 0.5, "area_cm2")]
        area = float(np.mean(simulate(case, place, case.inflow_time_s)))
        rest = math.pi * net.radius_in_cm[j] ** 2
        compliance = math.sqrt(area * rest) / float(slope[j])
        friction = 2.0 * math.pi * net.viscosity / net.density * math.sqrt(area / math.pi) / layer / area
        series, shunt = net.density / area * (1j * omega + friction), 1j * omega * compliance
        daughters = [k for k in range(len(net.ids)) if int(net.parent[k]) == j]
        if daughters:
            load = 1.0 / sum(1.0 / entering(k) for k in daughters)
        else:
            load = net.R1[j] + net.R2[j] / (1.0 + 1j * omega * net.R2[j] * net.C[j])
        own, along = np.sqrt(series / shunt), np.tanh(np.sqrt(series * shunt) * net.length_cm[j])
        return np.asarray(own * (load + own * along) / (own + load * along))

    return entering(0) / MMHG


def errors(cases: int, seed: int) -> Iterator[tuple[bool, NDArray[np.float64]]]:
    """Whether it is a fork, and the relative errors at `HARMONICS`, of each drawn case."""
    rng = np.random.default_rng(seed)
    for i in range(cases):
        case = drawn(rng, fork := i % 2 == 1)
        found = modelled_impedance(case, harmonics=max(HARMONICS))
        expected = theory(case, 2.0 * np.pi * found.frequency_Hz[1:])
        off = np.abs(found.value[1:] - expected) / np.abs(expected)
        yield fork, off[np.array(HARMONICS) - 1]


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--seed", type=int, default=5)
    args = parser.parse_args()
    rows = np.array([off for _, off in errors(args.cases, args.seed)])
    for k, off in zip(HARMONICS, rows.T, strict=True):
        print(
            f"harmonic {k}: worst {100 * off.max():.2f} %, median {100 * np.median(off):.2f} %, "
            f"{np.sum(off < 0.005)} of {len(off)} within 0.5 %"
        )


if __name__ == "__main__":
    main()
