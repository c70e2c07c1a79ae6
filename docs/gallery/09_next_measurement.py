"""
Which measurement next?
=======================

The study ``demo-gap`` with the pressure of its trunk alone. A diagnosis names the series in which the
leading causes and their nearest rival differ most, among pressures and flows of all vessels.
"""

from dataclasses import replace

import matplotlib.pyplot as plt

import zoo

study = zoo.load_study("demo-gap")
trunk = replace(study, name="trunk", series=study.series[:1])
offered = ["viscoelastic-wall", "inflow-bandwidth", "taper", "structured-tree"]
found = zoo.diagnose(trunk, base="B", effects=offered, component_sizes=0, cores=1, progress=False)
print(found)

# %%
# What is predicted there, with a 95 % band over all sets of causes:

advised = found.file.next_measurement
where = (advised.vessel, advised.position, advised.quantity)
band = found.predict(zoo.Outputs((where,), study.time_s))
figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
axes.fill_between(1e3 * study.time_s, band["low"], band["high"], alpha=0.4)
axes.plot(1e3 * study.time_s, band["mean"])
axes.set(xlabel="time (ms)", ylabel="mmHg", title=advised.text)
plt.show()
