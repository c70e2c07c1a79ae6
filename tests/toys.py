"""Two sensors of a drive that may be pushed, through a law that may be bent; components and effects of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zoo.core.components import FreeFunction
from zoo.core.data import Data
from zoo.core.diagnosis import Hooks
from zoo.core.effects import EffectParameter, effect
from zoo.core.forward import FunctionModel, Outputs
from zoo.core.parameters import Normal, Parameter

N, NOISE = 64, 0.02
TIMES = np.arange(N) / N
KNOTS = np.linspace(-2.0, 2.0, 9)


def pulse(times):
    return np.exp(np.cos(2 * np.pi * (times - 0.3))) - 1.3


def solve(configuration, times):
    """Two sensors, y1 = x + law(x) of a drive x that may be pushed, y2 the same of 0.6 x a little later."""

    def sensor(x):
        return x + np.interp(x, KNOTS, configuration.get("law", np.zeros(len(KNOTS))))

    x = configuration["level"] * pulse(times) + configuration.get("push", 0.0)
    x = x + configuration.get("kick", 0.0) * np.sin(6 * np.pi * times)
    return np.stack([sensor(x), sensor(0.6 * np.roll(x, 5)) + configuration.get("own", 0.0)])


MODEL = FunctionModel(solve, (Parameter("level", Normal(1.0, 0.3)),), Outputs(("y1", "y2"), TIMES), "toy")
FIRST = FunctionModel(lambda c, t: solve(c, t)[:1], MODEL.parameters, Outputs(("y1",), TIMES), "toy")
LAW = FreeFunction("law", "wall", KNOTS, 0.2, lambda c, v: {**c, "law": v}, "x", "K", "K", lengths=(1.0, 2.0))
PUSH = FreeFunction(
    "push", "inflow", TIMES, 0.2, lambda c, v: {**c, "push": v}, "t", "s", "K",
    "records are good to 0.2 K", lengths=(0.06, 0.12), period=1.0,
)  # fmt: skip
TWIN = replace(PUSH, name="twin", component="outlets")
OWN = replace(PUSH, name="own", component="sensor", apply=lambda c, v: {**c, "own": v})
FUNCTIONS = [LAW, PUSH, OWN]


@effect("kick", "inflow", parameters=[EffectParameter("size", "K", 0.3, -2.0, 2.0, (0.1, -0.1))])
def kick(configuration, values, location):
    """The third harmonic of the drive."""
    return {**configuration, "kick": values[0]}


@effect("bulge", "wall", parameters=[EffectParameter("size", "1", 0.3, 0.0, 2.0, (0.1,))])
def bulge(configuration, values, location):
    """The law is bent upwards."""
    return {**configuration, "law": values[0] * KNOTS**2}


EFFECTS = [kick, bulge]


def data_of(configuration, noise: float = NOISE, seed: int = 1) -> Data:
    series = solve({"level": 1.1, **configuration}, TIMES)
    noisy = series + noise * np.random.default_rng(seed).standard_normal(series.shape)
    return Data(
        TIMES, noisy, labels=["y1", "y2"], units=["K", "K"], groups=["y", "y"], period=1.0, name="toy"
    )


def first_of(data: Data) -> Data:
    """The first of both sensors, for `FIRST`."""
    return Data(TIMES, data.values[:1], ["y1"], ["K"], ["y"], period=1.0, name="toy")


def hooks(functions) -> Hooks:
    return Hooks(components=lambda model, theta, data: functions)


def of(found, name: str):
    return next(c for c in found.file.components if c.name == name)
