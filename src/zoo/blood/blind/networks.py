"""Studies before they have data: inflows, vessels with their loads, and where the sensors are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zoo.blood.ejection import PERIOD_S, ejection
from zoo.blood.network import R1_SHARE
from zoo.blood.study import Vessel, Windkessel
from zoo.core.arrays import Array

Row = tuple[int, int | None, float, float]
"""Id, parent, length (cm) and radius (cm) of a vessel."""
Sensor = tuple[int, float, str]
"""Vessel, position and quantity of a series."""

INFLOW_SAMPLES = 1024


def inflow(rng: np.random.Generator) -> tuple[float, Array, Array]:
    """Period, times and flow: the demo's beat with another length, width and peak."""
    period = round(float(rng.uniform(0.09, 0.13)), 4)
    width, peak = rng.uniform(0.9, 1.1), rng.uniform(0.85, 1.15)
    time, flow = ejection(16 * INFLOW_SAMPLES)
    phase = np.arange(INFLOW_SAMPLES) / INFLOW_SAMPLES
    shape = np.interp(phase / width, time / PERIOD_S, flow, right=0.0)
    return period, phase * period, np.round(peak * shape, 6)


def rounded(vessel: Vessel) -> Vessel:
    """The vessel as its file tells it."""
    load = vessel.windkessel
    return replace(
        vessel,
        name=f"v{vessel.id}",
        length_cm=round(vessel.length_cm, 4),
        radius_cm=round(vessel.radius_cm, 5),
        radius_out_cm=round(vessel.radius_out_cm, 5),
        windkessel=load and Windkessel(*(float(f"{x:.8e}") for x in vars(load).values())),
    )


def tree(rng: np.random.Generator, n_vessels: int) -> list[Row]:
    """A random bifurcating tree: id, parent, length (cm) and radius (cm) of each vessel.

    Daughters of radii 1 : a, a in [0.65, 1], and r_p^3 = r_1^3 + r_2^3 (Murray), with 5 % of scatter; lengths
    of 5 to 15 radii.

    Parameters
    ----------
    rng : numpy.random.Generator
    n_vessels : int
        Odd.

    References
    ----------
    Murray 1926, doi 10.1073/pnas.12.3.207.
    """
    found: list[Row] = [(1, None, 0.0, float(rng.uniform(0.042, 0.055)))]
    leaves = [0]
    while len(found) < n_vessels:
        weight = np.array([found[i][3] ** 2 for i in leaves])
        at = leaves.pop(int(rng.choice(len(leaves), p=weight / weight.sum())))
        ratio = rng.uniform(0.65, 1.0)
        first = found[at][3] / (1 + ratio**3) ** (1 / 3)
        for radius in rng.permutation([first, ratio * first]):
            leaves.append(len(found))
            scatter = math.exp(0.05 * rng.standard_normal())
            found.append((len(found) + 1, found[at][0], 0.0, float(radius) * scatter))
    return [
        (i, parent, max(0.05, radius * float(rng.uniform(5, 15))), radius) for i, parent, _, radius in found
    ]


def loaded(rows: Sequence[Row], resistance: float, tau: float) -> tuple[Vessel, ...]:
    """Vessels whose terminals share a total resistance (dyn s/cm5) by their areas; R C = tau (s) in each."""
    feeding = {parent for _, parent, _, _ in rows}
    area = sum(radius**2 for i, _, _, radius in rows if i not in feeding)
    vessels = []
    for i, parent, length, radius in rows:
        total = resistance * area / radius**2
        load = Windkessel(R1_SHARE * total, (1 - R1_SHARE) * total, tau / total)
        vessels.append(
            rounded(Vessel(i, f"v{i}", length, radius, radius, parent, None if i in feeding else load))
        )
    return tuple(vessels)


def sensors(rng: np.random.Generator, vessels: Sequence[Vessel], layout: str) -> list[Sensor]:
    """The sensors of a layout: in the root, its daughters, or terminals below them."""
    pressure = "pressure_mmHg"
    children: dict[int | None, list[int]] = {}
    for v in vessels:
        children.setdefault(v.parent, []).append(v.id)
    root = children[None][0]
    found: list[Sensor] = [(root, 0.0, pressure)]
    daughters = children[root]
    if layout == "MPA+daughters":
        found += [(daughter, 0.5, pressure) for daughter in daughters]
    elif layout == "MPA+distal":
        for daughter in daughters[:2]:
            below, ends = [daughter], []
            while below:
                at = below.pop()
                below += children.get(at, [])
                ends += [] if at in children else [at]
            found.append((int(rng.choice(sorted(ends))), 0.5, pressure))
    elif layout == "MPA+flow":
        found.append((int(rng.choice(daughters)), 0.5, "flow_ml_s"))
    elif layout == "MPA+flows":
        found += [(daughter, 0.5, "flow_ml_s") for daughter in daughters]
    return found
