"""
Two records, one law
====================

What is missing in a simulator is missing in every record of the system; what is wrong with one record is
not. A law is learned from a cart that is pushed fast, held fixed, and checked on the same cart, pushed
slowly.
"""

import matplotlib.pyplot as plt
import numpy as np

import zoo

times = np.arange(0.0, 20.0, 0.05)
rng = np.random.default_rng(1)


def pushed(frequency):
    """A simulator of the velocity in m/s, by Euler's method, pushed to and fro at a frequency in rad/s."""

    def cart(c, times):
        v, series, step, friction = 0.0, [], times[1] - times[0], c["friction"]
        for now in times:
            series.append(v)
            v += step * (20 * np.sin(frequency * now) - c["b"] * v - friction(v)) / 5.0
        return np.array(series)

    return cart


truth = {"b": 2.0, "friction": lambda v: 2.0 * np.tanh(v / 0.5)}
fast, slow = (pushed(f)(truth, times) + 0.05 * rng.standard_normal(len(times)) for f in (1.1, 0.4))
law = zoo.free_function("friction", along="velocity", size=3.0, unit="N", along_unit="m/s")
found = zoo.diagnose(
    times,
    fast,
    pushed(1.1),
    {"b": zoo.Normal(2.0, 0.3)},
    [law],
    units=["m/s"],
    held_out={"slow": (times, slow, pushed(0.4))},
    cores=1,
    progress=False,
)
print(found)

# %%
# What each leaves of the slow record, after its own parameter was fitted there again:

[there] = found.states
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for name, computed in there.computed.items():
    if name in ("baseline", "friction"):
        axes.plot(times, slow - computed[0], label={"friction": "with what was learned"}.get(name, name))
axes.set(xlabel="time (s)", ylabel="measured − computed (m/s)")
axes.legend()
plt.show()
