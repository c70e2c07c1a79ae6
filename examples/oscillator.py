"""A driven, damped oscillator: which effect does its equation lack? A blind check on drawn cases.

    python examples/oscillator.py

draws 40 records of known causes, diagnoses each without being told, and prints how often the cause was found.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

import zoo
from zoo import Data, LogUniform, Normal, Parameter

Array = NDArray[np.float64]

# ---------------------------------------------------------------------------------------------------
# The forward model:  x'' + 2 z w x' + w^2 x = g f(t),  from rest

TIMES = np.linspace(0.0, 60.0, 241)


def force(t: Array) -> Array:
    """The known drive, N/kg: three tones whose strength comes and goes."""
    return np.asarray((np.sin(1.3 * t) + np.sin(2.1 * t + 1.0) + np.sin(2.9 * t + 2.0)) * np.sin(0.07 * t))


def oscillate(c: dict[str, Any], times: Array) -> Array:
    """Displacement (n,) in m, by the classical Runge-Kutta scheme, two steps in a sample."""
    w2, damping = float(c["w"]) ** 2, 2.0 * float(c["z"]) * float(c["w"])
    cubic, drag = float(c.get("cubic", 0.0)), float(c.get("drag", 0.0))
    h = (times[1] - times[0]) / 2
    at = times[0] + 0.5 * h * np.arange(4 * len(times) - 3)
    f = (float(c["g"]) * force(at - c.get("delay", 0.0))).tolist()

    def a(x: float, v: float, f: float) -> float:
        return f - (damping + drag * abs(v)) * v - w2 * (1.0 + cubic * x * x) * x

    x, v, found = 0.0, 0.0, [0.0]
    for i in range(2, 4 * len(times) - 3, 2):
        v1, a1 = v, a(x, v, f[i - 2])
        v2, a2 = v + 0.5 * h * a1, a(x + 0.5 * h * v1, v + 0.5 * h * a1, f[i - 1])
        v3, a3 = v + 0.5 * h * a2, a(x + 0.5 * h * v2, v + 0.5 * h * a2, f[i - 1])
        v4, a4 = v + h * a3, a(x + h * v3, v + h * a3, f[i])
        x, v = x + h * (v1 + 2 * v2 + 2 * v3 + v4) / 6, v + h * (a1 + 2 * a2 + 2 * a3 + a4) / 6
        found.append(x)
    return np.asarray(found[::2])


MODEL = zoo.FunctionModel(
    oscillate,
    (
        Parameter("w", Normal(2.0, 0.2, 1.0, 3.0), "rad/s"),
        Parameter("z", LogUniform(0.01, 0.2), log=True),
        Parameter("g", Normal(1.0, 0.1, 0.5, 1.5)),
    ),
    zoo.Outputs(("displacement",), TIMES),
    "oscillator",
)

# ---------------------------------------------------------------------------------------------------
# What it may lack


@zoo.effect(
    "cubic-stiffness", unit="1/m2", size=0.1, low=0.0, high=0.5, starts=(0.03, 0.1),
    why="a spring 10 % stiffer at 1 m", equation="w^2 x (1 + b x^2) for w^2 x",
)  # fmt: skip
def cubic_stiffness(c: dict[str, Any], size: float) -> dict[str, Any]:
    """The spring hardens."""
    return {**c, "cubic": size}


@zoo.effect(
    "quadratic-drag", unit="1/m", size=0.1, low=0.0, high=0.5, starts=(0.02, 0.1),
    why="as large as the linear damping at 1 m/s", equation="(2 z w + d |x'|) x' for 2 z w x'",
)  # fmt: skip
def quadratic_drag(c: dict[str, Any], size: float) -> dict[str, Any]:
    """The air resists by the square of the velocity."""
    return {**c, "drag": size}


EFFECTS = (cubic_stiffness, quadratic_drag)


@zoo.effect("delayed-drive", unit="s", size=0.2, low=0.0, high=1.0)
def delayed_drive(c: dict[str, Any], size: float) -> dict[str, Any]:
    """The force arrives late; no diagnosis is offered this one."""
    return {**c, "delay": size}


# ---------------------------------------------------------------------------------------------------
# Drawn cases

SEED = 20160401
NOISE_M = 0.02
VISIBLE = 0.5
"""Parameters are drawn again until the rms of what the refitted equation leaves of the noise-free record is
at least this many sds of the noise."""
COUNTS = {"cubic-stiffness": 15, "quadratic-drag": 15, "no-gap": 5, "delayed-drive": 5}


def draw_case(cause: str, rng: np.random.Generator) -> zoo.DrawnCase:
    """A record with a cause, or none; its parameters and the amplitude come from their priors."""
    known = {e.name: e for e in (*EFFECTS, delayed_drive)}
    truth = zoo.with_effects(MODEL, [known[cause].at()] if cause in known else [])
    gap = -1.0
    while gap < (VISIBLE * NOISE_M if cause in known else 0.0):
        theta = zoo.draw_prior(truth.parameters, rng)
        series = truth.solve(truth.configure(theta))
        gap = visible_gap(theta[: len(MODEL.parameters)], series[0])
    noisy = series + NOISE_M * rng.standard_normal(series.shape)
    data = Data(TIMES, noisy, labels=("displacement",), units=("m",), name="oscillator")
    size = float(theta[-1]) if cause in known else None
    return zoo.DrawnCase(data, {"parameter": size, "noise": NOISE_M, "gap": gap})


def visible_gap(theta: Array, series: Array) -> float:
    """Rms of a series without noise minus the best fit of the model, which starts at theta."""
    low, high = np.array([p.prior.support for p in MODEL.parameters]).T
    fit = least_squares(
        lambda x: MODEL.solve(MODEL.configure(x))[0] - series, theta, bounds=(low, high), x_scale=(1, 0.1, 1)
    )
    return float(np.sqrt(np.mean(fit.fun**2)))


def diagnosed(data: Data) -> Any:
    """The diagnosis of one record, which is told nothing of its cause."""
    return zoo.diagnose(data, MODEL, EFFECTS, errors=zoo.Cosines(), progress=False)


def main(counts: dict[str, int], seed: int = SEED) -> zoo.Score:
    """The blind check."""
    return zoo.blind_check(draw_case, diagnosed, counts, listed=[e.name for e in EFFECTS], seed=seed)


if __name__ == "__main__":
    print(main(COUNTS))
