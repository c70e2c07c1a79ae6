"""
Can I trust the diagnosis?
==========================

Draw records of your simulator with a known cause or none, hide the cause, and see what the stated
probabilities are worth. Here are 24 records of a pendulum, whose simulator lacks drag or a rope that gives
way, or nothing.
"""

import matplotlib.pyplot as plt
import numpy as np

import zoo

times = np.linspace(0.0, 20.0, 101)


def pendulum(c, t):
    """Angle in rad; with drag the swing decays as 1/t instead of exponentially."""
    decay = np.exp(-c["loss"] * t) / (1.0 + c.get("drag", 0.0) * t)
    return c["start"] * decay * np.cos((2.0 + c.get("stretch", 0.0) * t) * t)


@zoo.effect("drag", unit="1/s", size=0.1, low=0.0)
def drag(c, size):
    """Air resists by the square of the velocity."""
    return {**c, "drag": size}


@zoo.effect("stretch", unit="rad/s2", size=0.001)
def stretch(c, size):
    """The rope gives way, and the frequency drifts."""
    return {**c, "stretch": size}


parameters = (
    zoo.Parameter("loss", zoo.LogUniform(0.005, 0.1), "1/s"),
    zoo.Parameter("start", zoo.Normal(0.1, 0.01), "rad"),
)
model = zoo.FunctionModel(pendulum, parameters, zoo.Outputs(("angle",), times))


def draw(cause, rng):
    effects = {"drag": [drag.at()], "stretch": [stretch.at()]}.get(cause, [])
    truth = zoo.with_effects(model, effects)
    series = truth.solve(truth.configure(zoo.draw_prior(truth.parameters, rng)))
    noisy = series + 0.002 * rng.standard_normal(series.shape)
    return zoo.DrawnCase(zoo.Data(times, noisy, labels=["angle"], units=["rad"]))


def diagnosed(data):
    return zoo.diagnose(data, model, [drag, stretch], cores=1, progress=False)


cases = {"drag": 8, "stretch": 8, "no-gap": 8}
score = zoo.blind_check(draw, diagnosed, cases, listed=["drag", "stretch"])
print(score)

# %%
# Everything that was stated of a cause, by whether it is so. Sizes are drawn from their priors, and some
# are too small to be seen: low probabilities of true causes are no fault, high ones of false causes are.

rng = np.random.default_rng(7)
stated = [event for case in score.cases for event in case["events"]["components"]]
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for x, true in enumerate((True, False)):
    p = [event.p for event in stated if event.true == true]
    axes.scatter(x + rng.uniform(-0.2, 0.2, len(p)), p, alpha=0.6)
axes.set(
    xticks=[0, 1], xticklabels=["true", "not true"], ylabel="probability that was stated", xlim=(-0.5, 1.5)
)
plt.show()
