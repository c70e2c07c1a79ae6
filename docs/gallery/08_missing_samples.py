"""
Samples are missing, times are uneven
=====================================

A river's flow after a storm, measured in unequal steps, with four hours in which the gauge did not work.
The simulator has one reservoir that runs out; a slower one beside it and a gauge whose zero is off are
offered.
"""

import matplotlib.pyplot as plt
import numpy as np

import zoo

rng = np.random.default_rng(6)
hours = np.sort(rng.uniform(0.0, 24.0, 80))


def river(c, t):
    """Flow in m3/s of a reservoir, of a slower one beside it, and the gauge's zero."""
    return c["peak"] * np.exp(-t / c["fast"]) + c.get("slow", 0.0) * np.exp(-t / 30.0) + c.get("zero", 0.0)


@zoo.effect("groundwater", unit="m3/s", size=2.0, low=0.0)
def groundwater(c, size):
    """A second reservoir feeds the river."""
    return {**c, "slow": size}


@zoo.effect("gauge-zero", unit="m3/s", size=0.5)
def gauge_zero(c, size):
    """The gauge shows something where nothing flows."""
    return {**c, "zero": size}


flow = river({"peak": 10.0, "fast": 4.0, "slow": 1.5}, hours) + 0.1 * rng.standard_normal(80)
flow[(hours > 4.0) & (hours < 8.0)] = np.nan
priors = {"peak": zoo.LogUniform(1.0, 100.0), "fast": zoo.LogUniform(0.5, 50.0)}
effects = [groundwater, gauge_zero]
found = zoo.diagnose(hours, flow, river, priors, effects, units=["m3/s"], cores=1, progress=False)
print(found)

# %%
# The true flow, with a 95 % band over all sets of causes, also where nothing was measured:

later = np.linspace(0.0, 24.0, 97)
band = found.predict(zoo.Outputs(found.data.outputs, later))
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
axes.fill_between(later, band["low"], band["high"], alpha=0.4, label="predicted")
axes.plot(hours, flow, "k.", markersize=4, label="measured")
axes.set(xlabel="time (h)", ylabel="flow (m³/s)", yscale="log")
axes.legend()
plt.show()
