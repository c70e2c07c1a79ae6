"""
A slow simulator
================

A surrogate needs a part of the solves that chains need, and each of its draws is corrected with the
simulator itself. The simulator here is quick, so that both can be seen; what counts is how often it is
solved.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import odeint

import zoo

days = np.linspace(0.0, 60.0, 61)


def epidemic(c, t):
    """Infected in a thousand: susceptible become infected, and these recover."""

    def slope(state, now):
        caught = c["contact"] * state[0] * state[1] / 1000.0
        return [-caught, caught - c["recovery"] * state[1]]

    return odeint(slope, [1000.0 - c["first"], c["first"]], t)[:, 1]


truth = epidemic({"contact": 0.5, "recovery": 0.2, "first": 2.0}, days)
seen = truth + 5.0 * np.random.default_rng(3).standard_normal(61)
data = zoo.Data(days, seen, labels=["infected"], units=["1"], groups=["infected"], time_unit="d")
parameters = (
    zoo.Parameter("contact", zoo.LogUniform(0.1, 2.0), "1/d"),
    zoo.Parameter("recovery", zoo.LogUniform(0.05, 1.0), "1/d"),
    zoo.Parameter("first", zoo.LogUniform(0.1, 20.0)),
)
forward = zoo.FunctionModel(epidemic, parameters, zoo.Outputs(("infected",), days))
model = zoo.bayesian_model("epidemic", forward, data, zoo.GroupNoise())

runs = {}
for method in ("exact", "surrogate"):
    runs[method] = zoo.sample(model, method=method, seed=1, cores=0, groups=False, progress=False)
    record, checks = zoo.RunRecord.of(runs[method]), zoo.diagnostics(runs[method])
    print(f"{method}: {record.solves} solves, {checks.verdict.text}")

# %%
# Both have the same posterior:

figure, axes = plt.subplots(figsize=(5, 3), layout="constrained")
for method, idata in runs.items():
    solves = zoo.RunRecord.of(idata).solves
    draws = idata.posterior["contact"].values.ravel()
    axes.hist(draws, bins=40, density=True, histtype="step", label=f"{method}, {solves} solves")
axes.set(xlabel="contacts a day", yticks=[])
axes.legend()
plt.show()
