"""
My simulator has time steps
===========================

A simulator with steps or cells has an error of its own, and where the noise is small a cause is found that
makes up for it. Here nothing is missing but accuracy. ``finer=`` gives the same simulator with half the
step.
"""

import matplotlib.pyplot as plt
import numpy as np

import zoo

times = np.linspace(0.0, 10.0, 101)


def oscillator(step):
    """A pendulum's angle by the midpoint rule, of second order in the step (s)."""

    def simulate(c, t):
        angle, speed, found = c["start"], 0.0, []

        def turn(a, v):
            return v, -c["w2"] * np.sin(a) - c.get("drag", 0.0) * v * abs(v)

        for _ in t:
            found.append(angle)
            for _ in range(round((t[1] - t[0]) / step)):
                a1, v1 = turn(angle, speed)
                a2, v2 = turn(angle + step / 2 * a1, speed + step / 2 * v1)
                angle, speed = angle + step * a2, speed + step * v2
        return np.array(found)

    return simulate


@zoo.effect("drag", unit="1", size=0.02, starts=(0.002, -0.002))
def drag(c, size):
    """The air resists, by the square of the speed; below 0 something pushes."""
    return {**c, "drag": size}


exact = oscillator(0.005)({"start": 0.5, "w2": 4.0}, times)
data = zoo.Data(
    times,
    exact + 0.002 * np.random.default_rng(8).standard_normal(101),
    labels=["angle"],
    units=["rad"],
)
parameters = (
    zoo.Parameter("start", zoo.Normal(0.5, 0.1), "rad"),
    zoo.Parameter("w2", zoo.LogUniform(1.0, 10.0), "1/s2"),
)
answers = {}
for name, finer in (("as it is", None), ("with finer=", oscillator(0.05))):
    outputs = zoo.Outputs(data.outputs, times)
    model = zoo.FunctionModel(oscillator(0.1), parameters, outputs, "pendulum", finer=finer)
    answers[name] = zoo.diagnose(data, model, [drag], cores=1, progress=False)
    print(name, answers[name], "", sep="\n")

# %%
# The probability that drag is missing:

figure, axes = plt.subplots(figsize=(5, 1.8), layout="constrained")
axes.barh(list(answers), [found.causes[0].probability for found in answers.values()])
axes.set(xlabel="probability of drag", xlim=(0, 1))
plt.show()
