"""
My model misses something: what?
================================

The study ``demo-gap`` is synthetic: its pressures come from a wall that is viscoelastic, and the baseline's
wall is elastic. Five causes are offered here; without ``effects=`` all of the catalogue is.
"""

import matplotlib.pyplot as plt

import zoo

offered = ["viscoelastic-wall", "taper", "minor-losses", "structured-tree", "inflow-bandwidth"]
found = zoo.diagnose("demo-gap", base="B", effects=offered, component_sizes=0, cores=1, progress=False)
print(found)

# %%
# What the baseline leaves, and what it leaves with the cause that was found, at the sensor in the trunk:

times, measured = 1e3 * found.data.times, found.data.values[0]
baseline, with_cause = found.computed
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
axes.plot(times, measured - baseline[0], label="baseline")
axes.plot(times, measured - with_cause[0], label="with " + " and ".join(found.cause))
axes.set(xlabel="time (ms)", ylabel="measured − computed (mmHg)")
axes.legend()
plt.show()
