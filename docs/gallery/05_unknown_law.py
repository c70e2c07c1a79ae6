"""
A law that I do not know
========================

A cart is pushed to and fro; its simulator has friction in proportion to the velocity. Where no effect can
be named, the missing part is learned as a function of what it depends on.
"""

import matplotlib.pyplot as plt
import numpy as np

import zoo

times = np.arange(0.0, 20.0, 0.05)


def cart(c, times):
    """Velocity in m/s, by Euler's method."""
    v, series, step, friction = 0.0, [], times[1] - times[0], c["friction"]
    for now in times:
        series.append(v)
        v += step * (20 * np.sin(1.1 * now) - c["b"] * v - friction(v)) / 5.0
    return np.array(series)


noise = 0.05 * np.random.default_rng(1).standard_normal(len(times))
velocity = cart({"b": 2.0, "friction": lambda v: 2.0 * np.tanh(v / 0.5)}, times) + noise
missing = zoo.free_function("friction", along="velocity", size=3.0, unit="N", along_unit="m/s")
priors = {"b": zoo.Normal(2.0, 0.3)}
found = zoo.diagnose(times, velocity, cart, priors, [missing], units=["m/s"], cores=1, progress=False)
print(found)

# %%
# What was learned, with its 95 % band, and the law that made the data: dry friction. A part in proportion
# to the velocity can be that of b as well, so that the band is wider far from 0:

learned = found.components[0].functions[0]
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
axes.fill_between(learned.values, learned.low, learned.high, alpha=0.3)
axes.plot(learned.values, learned.mean, label="learned")
v = np.array(learned.values)
axes.plot(v, 2.0 * np.tanh(v / 0.5), "k--", label="that made the data")
axes.set(xlabel="velocity (m/s)", ylabel="friction that is missing (N)")
axes.legend()
plt.show()
