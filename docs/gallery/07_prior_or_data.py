"""
Prior or data?
==============

A capacitor discharges through a resistor. From the voltage alone only the product of the two can be
learned; what the posterior says of each by itself comes from the prior. ``zoo.compare`` says so, and the
pair of the draws shows it.
"""

import matplotlib.pyplot as plt
import numpy as np

import zoo

ms = np.linspace(0.0, 5.0, 51)


def discharge(c, t):
    return c["V"] * np.exp(-t / (c["R"] * c["C"]))


volts = discharge({"V": 5.0, "R": 2.0, "C": 0.7}, ms) + 0.03 * np.random.default_rng(4).standard_normal(51)
data = zoo.Data(ms, volts, labels=["voltage"], units=["V"], groups=["voltage"], time_unit="ms")
parameters = (
    zoo.Parameter("V", zoo.LogUniform(1.0, 20.0), "V"),
    zoo.Parameter("R", zoo.LogNormal(2.0, 0.2), "kOhm"),
    zoo.Parameter("C", zoo.LogNormal(0.8, 0.2), "uF"),
)
forward = zoo.FunctionModel(discharge, parameters, zoo.Outputs(("voltage",), ms))
model = zoo.bayesian_model("discharge", forward, data, zoo.GroupNoise())
idata = zoo.sample(model, seed=1, cores=0, groups=False, progress=False)
print(zoo.compare({"discharge": idata}, {"discharge": model}).iloc[0][["uninformed", "prior_sensitive"]])

# %%
# Draws of the prior and of the posterior:

rng = np.random.default_rng(5)
prior = np.array([zoo.draw_prior(parameters, rng) for _ in range(600)])
figure, axes = plt.subplots(figsize=(4.4, 3.4), layout="constrained")
axes.scatter(prior[:, 1], prior[:, 2], s=6, alpha=0.4, label="prior")
R, C = (idata.posterior[name].values.ravel()[::3] for name in ("R", "C"))
axes.scatter(R, C, s=6, alpha=0.4, label="posterior")
axes.set(xlabel="R (kΩ)", ylabel="C (µF)", xscale="log", yscale="log")
axes.legend()
plt.show()
