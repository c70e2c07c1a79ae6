"""
The flow record is late
=======================

Flow and pressure come from two devices, and their clocks need not agree. Here pressures are computed with a
flow that comes 2.2 ms (a fiftieth of a beat) after its record, noise is added, and the diagnosis is not
told.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import zoo

study = zoo.load_study("demo-gap")
elastic = zoo.get_baseline("B").forward(study)
late = zoo.with_effects(elastic, zoo.added_effects(["inflow-shift"], elastic))
stiffness, psi1, psi2, c, shift_s = 5e4, 0.4, 0.7, 1.5, 2.2e-3
pressures = late.solve(late.configure(np.array([stiffness, psi1, psi2, c, shift_s])))
pressures += 0.1 * np.random.default_rng(1).standard_normal(pressures.shape)
series = tuple(replace(one, value=row) for one, row in zip(study.series, pressures, strict=True))
study = replace(study, name="late", series=series)

offered = ["inflow-shift", "inflow-bandwidth", "viscoelastic-wall", "taper", "catheter-resonance"]
found = zoo.diagnose(study, base="B", effects=offered, component_sizes=0, cores=1, progress=False)
print(found)

# %%
# The probability of each cause that was offered:

figure, axes = plt.subplots(figsize=(5, 2.6), layout="constrained")
causes = found.causes[::-1]
axes.barh([one.name for one in causes], [one.probability for one in causes])
axes.set(xlabel="probability", xlim=(0, 1))
plt.show()
