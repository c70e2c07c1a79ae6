"""How far structured trees of small arteries are from the nearest three-element circuit, in prior sizes.

Draws trees of a human lung from the ranges of Colebank 2025: f1 of 1e6 to 1e8 and f3 of 1e5 to 8e5 g/(cm s2)
in the logarithm, f2 of -30 to -10 /cm, daughters of 0.75 to 0.88 and 0.60 to 0.72 of a radius, lengths of 15
to 60 radii, down to 0.01 to 0.1 mm; behind outlets of 0.9 and 1.1 cm, in a beat of 0.9 s, with the viscosity
by radius of Pries et al. 1994. Others are those of the listed effect behind the outlets of `demo`. Prints
quantiles of the most probable size of v = log|Z| - log|Z of the circuit| at the knots of the free function
`outlet-impedance`: the root mean square of L^-1 v, where L L' is the correlation of a length, for the circuit
that has the least of it. A length of 0 stands for independent values: the root mean square of v itself.

Then how well outlets draw the trees of a lung: the largest error of the pressure that the flow of `demo`
makes, in its pulse, by the nearest Windkessel with a response (`zoo.blood.outlet_tables`); and the least real
part of that between harmonics, in R1.

    python -m benchmarks.structured_trees [--trees 100] [--seed 1]

References
----------
Colebank 2025, doi 10.1371/journal.pcbi.1013553; Olufsen et al. 2000, doi 10.1114/1.1326031; Pries et al.
1994, doi 10.1161/01.RES.75.5.904.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares
from scipy.special import jve
from scipy.stats import qmc

from zoo.blood.baseline import get_baseline
from zoo.blood.case import Case, total_resistance
from zoo.blood.components.outlet_functions import IMPEDANCE_KNOTS, LOWEST_HARMONIC
from zoo.blood.components.setting import MOST_HARMONICS
from zoo.blood.conventions import PRINTED
from zoo.blood.effects.structured_tree import tree_impedance
from zoo.blood.ejection import ejection
from zoo.blood.loads import outlet_impedance
from zoo.blood.network import Network
from zoo.blood.outlet_tables import HARMONICS, StructuredTree
from zoo.blood.physics import NO_PHYSICS
from zoo.blood.solver import SolverOptions
from zoo.blood.study import Blood, Vessel, load_study
from zoo.core.parameters import pack, start_of

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

LOW = (math.log(1e6), -30.0, math.log(1e5), 0.75, 0.60, 15.0, 0.001)
HIGH = (math.log(1e8), -10.0, math.log(8e5), 0.88, 0.72, 60.0, 0.01)
DENSITY, PERIOD_S, OUTLETS_CM = 1.057, 0.9, (0.9, 1.1)
LENGTHS = (0.0, 0.15, 0.2, 0.25)


def viscosity(radius_cm: float) -> float:
    """Of blood in living tissue at a haematocrit of 0.45, g/(cm s)."""
    d = 2e4 * radius_cm
    wall = (d / (d - 1.1)) ** 2
    relative = 6 * math.exp(-0.085 * d) + 3.2 - 2.44 * math.exp(-0.06 * d**0.645)
    return 0.032 / 3.2 * (1 + (relative - 1) * wall) * wall


def tree(
    root_cm: float,
    omega: Array,
    *,
    daughters: tuple[float, float],
    length: float,
    smallest_cm: float,
    slope: Callable[[float], float],
    density: float = DENSITY,
    viscosity: Callable[[float], float] = viscosity,
) -> Complex:
    """Input impedance of a tree whose vessels below the smallest radius end at pressure 0, dyn s/cm5.

    Parameters
    ----------
    root_cm : float
        Radius of its first vessel.
    omega : array (m,)
        rad/s, positive; 0 stands for steady flow.
    daughters : (float, float)
        Their radii over their parent's.
    length : float
        Of a vessel, in its radii.
    smallest_cm : float
    slope, viscosity : function
        dp/d(A/A0) in dyn/cm2 and g/(cm s), of a radius in cm.
    density : float

    Returns
    -------
    complex array (m,)
    """
    known: dict[tuple[int, int], Complex] = {}

    def impedance(i: int, j: int) -> Complex:
        if (i, j) not in known:
            r = root_cm * daughters[0] ** i * daughters[1] ** j
            end: Complex = np.zeros(len(omega), dtype=np.complex128)
            if r >= smallest_cm * (1 - 1e-9):
                end = 1 / (1 / impedance(i + 1, j) + 1 / impedance(i, j + 1))
            w = np.where(omega > 0, omega, 1.0)
            x = 1j**1.5 * r * np.sqrt(w * density / viscosity(r))
            inertial = 1 - 2 * jve(1, x) / (x * jve(0, x))
            speed = np.sqrt(slope(r) * inertial / density)
            g = speed * math.pi * r**2 / slope(r)
            turn = np.tan(w * length * r / speed)
            wave = (1j / g * turn + end) / (1 + 1j * g * end * turn)
            known[i, j] = np.where(omega > 0, wave, 8 * viscosity(r) * length / (math.pi * r**3) + end)
        return known[i, j]

    return impedance(0, 0)


def knots() -> Array:
    """Of the free function, logarithms of harmonics."""
    return np.linspace(math.log(LOWEST_HARMONIC), math.log(MOST_HARMONICS), IMPEDANCE_KNOTS)


def size_beside_circuit(impedance: Complex, period_s: float, length: float) -> float:
    """The most probable size of what the nearest three-element circuit lacks, at the knots.

    Parameters
    ----------
    impedance : complex array (n,)
        At the knots.
    period_s : float
    length : float
        Of the correlation; 0 for independent values.
    """
    at = knots()
    omega = 2 * math.pi / period_s * np.exp(at)
    apart = (at[:, None] - at) / max(length, 1e-3)
    root = np.linalg.cholesky(np.exp(-0.5 * apart**2) + 1e-6 * np.eye(len(at)))

    def lacks(parameters: Array) -> Array:
        first, second, tau = np.exp(parameters)
        circuit = first + second / (1 + 1j * omega * tau)
        v = np.log(np.abs(impedance / circuit))
        return np.asarray(solve_triangular(root, v, lower=True) / math.sqrt(len(at)))

    steady = abs(impedance[0])
    starts = [(a * steady, (1 - a) * steady, b * period_s) for a in (0.05, 0.3) for b in (0.1, 1.0)]
    found = [least_squares(lacks, np.log(start), max_nfev=200).cost for start in starts]
    return math.sqrt(2 * min(found))


def of_a_lung(row: Array) -> list[Complex]:
    """Impedances at the knots, behind both outlets, of one draw of the parameters."""
    f1, f2, f3, alpha, beta, length, smallest = row
    omega = 2 * math.pi / PERIOD_S * np.exp(knots())

    def slope(radius: float) -> float:
        return 2 / 3 * (math.exp(f1 + f2 * radius) + math.exp(f3))

    return [
        tree(root, omega, daughters=(alpha, beta), length=length, smallest_cm=smallest, slope=slope)
        for root in OUTLETS_CM
    ]


def of_outlets(row: Array) -> list[list[float]]:
    """Errors of both outlets' pressures, in the pulse, and the least real part of the impedance over R1."""
    f1, f2, f3, alpha, beta, length, smallest = row
    tree = StructuredTree(alpha, beta, length, smallest, math.exp(f1), f2, math.exp(f3))
    flow = ejection(1024)[1]
    Q = np.fft.rfft(flow) / len(flow)
    omega = 2 * math.pi / PERIOD_S * np.arange(61)
    found = []
    for radius in OUTLETS_CM:
        full = tree.impedance(radius, DENSITY, 0.032, omega)

        def pressure(Z: Complex) -> Array:
            return np.asarray(np.fft.irfft(np.pad(Z * Q[:61], (0, 452)), 1024) * 1024)

        wanted = pressure(full)
        pairs_of = tuple((z.real, z.imag) for z in full[: HARMONICS + 1])
        end = Vessel(1, "end", 1.0, radius, radius, impedance=pairs_of, stiffness_g_cm_s2=1e5)
        net = Network.from_vessels([end], Blood(DENSITY, 0.032), PERIOD_S)
        none, one = np.empty(0), np.ones((5, 1))
        table = Case(net, none, none, PRINTED, "linear", SolverOptions(), NO_PHYSICS, *one)
        off = np.abs(pressure(outlet_impedance(table, omega)[0]) - wanted).max()
        between = outlet_impedance(table, np.linspace(0, 60, 4801) * omega[1])[0].real.min() / net.R1[0]
        found.append([off / np.ptp(wanted), between])
    return found


def of_the_effect() -> tuple[list[Complex], float]:
    """Those of the effect structured-tree behind the outlets of `demo`, and its beat."""
    model = get_baseline("linear-constant").forward(load_study("demo"))
    case = model.configure(pack(model.parameters, start_of(model.parameters)))
    net, at = case.network, case.network.terminals
    omega = np.append(0.0, 2 * math.pi / net.period_s * np.exp(knots()))
    resistance, compliance = total_resistance(case)[at], (case.c * net.C)[at]
    found = tree_impedance(net.radius_out_cm[at], resistance, compliance, net.density, net.viscosity, omega)
    return list(found[:, 1:]), net.period_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trees", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    draws = qmc.scale(qmc.LatinHypercube(len(LOW), rng=given.seed).random(given.trees), LOW, HIGH)
    kinds = {
        f"{given.trees} trees of a human lung": ([z for row in draws for z in of_a_lung(row)], PERIOD_S),
        "structured-tree behind demo's outlets": of_the_effect(),
    }
    for name, (trees, period) in kinds.items():
        print(name)
        for length in LENGTHS:
            sizes = [size_beside_circuit(z, period, length) for z in trees]
            rms = math.sqrt(float(np.mean(np.square(sizes))))
            median, most = np.quantile(sizes, (0.5, 0.95))
            print(f"  length {length:4.2f}: median {median:.2f}, rms {rms:.2f}, 95 % up to {most:.2f}")
    outlets = np.array([one for row in draws for one in of_outlets(row)])
    errors, least = outlets.T
    median, most, worst = 100 * np.quantile(errors, (0.5, 0.95, 1))
    print(f"a response: {median:.3g} % of the pulse in the median, 95 % up to {most:.3g}, worst {worst:.3g}")
    print(
        f"least real part between harmonics: {least.min():.2f} R1; "
        f"below 0 in {100 * np.mean(least < 0):.0f} %"
    )


if __name__ == "__main__":
    main()
