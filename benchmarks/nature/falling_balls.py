"""Balls dropped from a bridge, height in time: constant gravity as base, and eleven rivals.

Prior sizes are from physics and from what an observer can be off by, and were chosen before any diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from benchmarks.nature import Parameters, rival
from numpy.typing import NDArray
from scipy.optimize import least_squares

import zoo
from zoo.core.diagnosis import Diagnosis

Array = NDArray[np.float64]

GRAVITY = 9.81  # m/s2
STEP = 1.0 / 150.0  # s
TALL = 48.0  # m, to scale what depends on height
AIR_DENSITY = 1.2  # kg/m3
VOLLEYBALL = (270.0, 66.0)  # g, cm: not recorded, in the middle of what the FIVB's rules allow


def fall(c: Parameters, times: Array) -> Array:
    """Height (n_times,) in m of a ball that is let go at a height, speed and time, and may bounce."""
    clock = np.asarray(times) * (1.0 + c.get("fast", 0.0))
    grid = np.arange(0.0, clock[-1] - min(clock[0], c["release"]) + 2 * STEP, STEP)
    y, v, heights = c["height"], c["speed"], np.empty(len(grid))
    for i, t in enumerate(grid):
        heights[i] = y
        k1 = _pull(c, t, v)
        k2 = _pull(c, t + STEP, v + STEP * k1)
        y, v = y + STEP * v + 0.5 * STEP**2 * k1, v + 0.5 * STEP * (k1 + k2)
        if "rebound" in c and y < c.get("ground", 0.0) and v < 0.0:
            v = -c["rebound"] * v
    seen = np.interp(clock - c["release"], grid, heights, left=c["height"])
    if c.get("lag", 0.0) != 0.0:
        seen = seen - c["lag"] * np.gradient(seen, np.asarray(times))
    seen = seen + c.get("tilt", 0.0) * (seen - TALL) * seen / TALL
    return np.asarray(seen * (1.0 + c.get("ruler", 0.0)))


def _pull(c: Parameters, t: float, v: float) -> float:
    """Acceleration upwards in m/s2."""
    a = c.get("mass", 0.0)  # of the displaced air over that of the ball
    pull = -GRAVITY * (1.0 - a) / (1.0 + 0.5 * a)
    if c.get("slow_release", 0.0) > 0.0:
        pull *= 1.0 - np.exp(-t / c["slow_release"])
    if "air" in c:
        pull -= float(c["air"](abs(v))) * np.sign(v)
    pull -= c.get("linear", 0.0) * v + c.get("quadratic", 0.0) * abs(v) * v
    pull += c.get("gust", 0.0) * np.exp(-0.5 * ((t - c.get("gust_at", 1.0)) / 0.2) ** 2)
    return float(pull + c.get("spin", 0.0) * abs(v) * np.sin(2.0 * np.pi * t))


@zoo.effect(
    "wind-gust",
    parameters=[
        zoo.EffectParameter("acceleration", "m/s2", 2.0, -20.0, 20.0, (2.0, -2.0)),
        zoo.EffectParameter("time", "s", 1.0, 0.0, 4.0, (), centre=1.5, zero_is_base=False),
    ],
)
def wind_gust(c: Parameters, values: tuple[float, ...], at: Any) -> dict[str, Any]:
    """A push upwards or downwards for some tenths of a second."""
    return {**c, "gust": values[0], "gust_at": values[1]}


RIVALS = [
    rival("linear-drag", "linear", "1/s", 0.2, 0.0),  # a terminal speed of 50 m/s
    rival("quadratic-drag", "quadratic", "1/m", 0.02, 0.0),  # 22 m/s; a whiffle ball's is some 10
    rival("added-mass", "mass", "1", 0.1, 0.0),  # a basketball's is 0.02
    rival("ruler-scale", "ruler", "1", 0.05),
    rival("frame-rate", "fast", "1", 0.02),
    rival("tilted-camera", "tilt", "1", 0.05),
    rival("late-release", "slow_release", "s", 0.1, 0.0),
    wind_gust,
    rival("spin-lift", "spin", "1/s", 0.1),
    rival("tracker-lag", "lag", "s", 0.07),  # a frame
    rival("bounce", "rebound", "1", 0.5, 0.0),
]
DRAG_BY_MASS = rival("mass-dependent-drag", "drag_coefficient", "1", 0.5, 0.0)  # some 0.5 for a sphere
PRIORS = {
    "height": zoo.Parameter("height", zoo.Normal(47.0, 3.0), "m"),
    "speed": zoo.Parameter("speed", zoo.Normal(0.0, 1.0), "m/s"),
    "release": zoo.Parameter("release", zoo.Normal(0.2, 0.3), "s"),
}


def read_drops(path: Path) -> dict[str, list[tuple[Array, Array]]]:
    """Times in s and heights in m of each ball's drops; the file rounds times to seven digits."""
    drops: dict[str, list[tuple[Array, Array]]] = {}
    for (ball, _), part in pd.read_csv(path).groupby(["ball", "drop"], sort=False):
        t, h = part["time_s"].to_numpy(), part["height_m"].to_numpy()
        drops.setdefault(ball, []).append((np.linspace(t[0], t[-1], len(t)), h))
    return drops


def read_areas_per_mass(path: Path) -> dict[str, float]:
    """Cross section over mass of each ball in m2/kg."""
    table = pd.read_csv(path, index_col="ball")
    table.loc["volleyball"] = VOLLEYBALL
    areas = (1e-2 * table["circumference_cm"]) ** 2 / (4.0 * np.pi) / (1e-3 * table["mass_g"])
    return {str(ball): float(area) for ball, area in areas.items()}


def falling(area_per_mass: float) -> Callable[[Parameters, Array], Array]:
    """`fall` of a ball that air of one drag coefficient slows down by its area over its mass, m2/kg."""

    def simulate(c: Parameters, times: Array) -> Array:
        drag = 0.5 * AIR_DENSITY * area_per_mass * c.get("drag_coefficient", 0.0)
        return fall({**c, "quadratic": c.get("quadratic", 0.0) + drag}, times)

    return simulate


def diagnose_population(
    drops: Mapping[str, tuple[Array, Array]], areas_per_mass: Mapping[str, float]
) -> Diagnosis:
    """A drop of each ball, all together: what is missing is missing in all, with one size."""
    balls = {ball: (*drop, falling(areas_per_mass[ball])) for ball, drop in drops.items()}
    return zoo.diagnose(balls, PRIORS, [*RIVALS, DRAG_BY_MASS], labels=["height"], units=["m"])


def own_coefficient(drop: tuple[Array, Array], area_per_mass: float) -> float:
    """Drag coefficient of one ball by least squares beside its priors, with 0.07 m as noise."""
    simulate, (times, heights) = falling(area_per_mass), drop
    names = [*PRIORS, "drag_coefficient"]
    centre = np.array([p.prior.median for p in PRIORS.values()])
    sd = np.array([p.prior.sd for p in PRIORS.values()])

    def left(x: Array) -> Array:
        seen = simulate(dict(zip(names, x, strict=True)), times)
        return np.concatenate([(seen - heights) / 0.07, (x[:-1] - centre) / sd])

    return float(least_squares(left, [*centre, 0.45], x_scale=[*sd / 3, 0.1], diff_step=1e-4).x[-1])


AIR = zoo.free_function("air", along="speed", size=5.0, unit="m/s2", along_unit="m/s")
"""What the air does, a function of speed alone: half of the weight of a ball near its terminal speed."""


def diagnose_air(first: tuple[Array, Array], second: tuple[Array, Array] | None = None) -> Diagnosis:
    """As `diagnose_ball`, with a free function of speed as the only rival."""
    held_out = None if second is None else {"second drop": (*second, fall)}
    return zoo.diagnose(*first, fall, PRIORS, [AIR], labels=["height"], units=["m"], held_out=held_out)


def diagnose_ball(first: tuple[Array, Array], second: tuple[Array, Array] | None = None) -> Diagnosis:
    """Times in s and heights in m of a drop, and of a second one on which what was learned is tried."""
    held_out = None if second is None else {"second drop": (*second, fall)}
    return zoo.diagnose(*first, fall, PRIORS, RIVALS, labels=["height"], units=["m"], held_out=held_out)
