"""
Is WAIC's difference real?
==========================

Three models of a drug's concentration in blood. The data come from an exponential decay; one model has an
absorption that the data do not need, and one falls in a straight line.
"""

import matplotlib.pyplot as plt
import numpy as np

import zoo

hours = np.linspace(0.5, 12.0, 24)
seen = 8.0 * np.exp(-0.3 * hours) + 0.15 * np.random.default_rng(2).standard_normal(24)
data = zoo.Data(hours, seen, labels=["drug"], units=["mg/l"], groups=["drug"], time_unit="h")
dose = zoo.Parameter("dose", zoo.LogUniform(1.0, 50.0), "mg/l")
rate = zoo.Parameter("rate", zoo.LogUniform(0.01, 2.0), "1/h")
uptake = zoo.Parameter("uptake", zoo.LogUniform(2.0, 200.0), "1/h")


def decay(c, t):
    return c["dose"] * np.exp(-c["rate"] * t)


def absorbed(c, t):
    return decay(c, t) - c["dose"] * np.exp(-c["uptake"] * t)


def linear(c, t):
    return c["dose"] * np.maximum(1.0 - c["rate"] * t / 3.0, 0.0)


models = {}
for function, parameters in ((decay, (dose, rate)), (absorbed, (dose, rate, uptake)), (linear, (dose, rate))):
    forward = zoo.FunctionModel(function, parameters, zoo.Outputs(("drug",), hours))
    models[function.__name__] = zoo.bayesian_model(function.__name__, forward, data, zoo.GroupNoise())
settings = {"seed": 1, "cores": 0, "groups": False, "progress": False}
posteriors = {name: zoo.sample(model, **settings) for name, model in models.items()}
table = zoo.compare(posteriors, models)
print(table[["waic", "difference", "difference_se", "standing"]])

# %%
# A difference is that of a sum over 24 samples, and its standard error comes from how these differ:

figure, axes = plt.subplots(figsize=(5, 2.4), layout="constrained")
axes.errorbar(table["difference"], table.index, xerr=2 * table["difference_se"], fmt="o", capsize=4)
axes.axvline(0.0, color="grey", linewidth=1)
axes.invert_yaxis()
axes.set(xlabel="WAIC beyond the best (± 2 standard errors)")
plt.show()
