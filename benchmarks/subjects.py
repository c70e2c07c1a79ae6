"""Simulation-based calibration of a population of six made-up subjects, sampled as one posterior.

python -m benchmarks.subjects              # 100 replicates, four seconds each of a free core
python -m benchmarks.subjects --replicates 300 --seed 2

Six subjects' series y = level exp(-rate t) + N(0, 0.1^2), measured at eight times, share the level; the rates
are of one population on the logarithmic scale. The truths are drawn by NumPy, not by the model.

Talts et al. 2018, arXiv:1804.06788.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

import numpy as np
from benchmarks.paun2020.calibration import Replicate, passes, rank_table, ranks_of
from scipy import stats

import zoo
from zoo.core.arviz_lines import dataset
from zoo.core.inference.elements import arrays, scalars

SUBJECTS = 6
TIMES = np.linspace(0.1, 2.0, 8)
SD = 0.1
LEVEL, RATE = zoo.Normal(1.0, 0.3), zoo.LogNormal(1.0, 0.5)
RANKED = 15
"""Draws that a truth is ranked among, eighty steps of the chain apart."""


def decay(values: Mapping[str, Any], times: np.ndarray) -> Any:
    """The simulator."""
    return values["level"] * np.exp(-values["rate"] * times)


def replicate(seed: int, number: int) -> Replicate:
    """One truth and its ranks."""
    rng = np.random.default_rng([seed, number])
    level = 1.0 + 0.3 * rng.standard_normal()
    median = float(np.exp(0.5 * rng.standard_normal()))
    spread = float(abs(0.5 * stats.norm.ppf(0.84) * rng.standard_normal()))
    rates = median * np.exp(spread * rng.standard_normal(SUBJECTS))
    truth = {"level": level, "rate_median": median, "rate_sd": spread}
    truth |= {f"rate[{k}]": float(rate) for k, rate in enumerate(rates)}
    models = {}
    for k, rate in enumerate(rates):
        y = level * np.exp(-rate * TIMES) + SD * rng.standard_normal(len(TIMES))
        parameters = zoo.Parameter("level", LEVEL), zoo.Parameter("rate", RATE)
        forward = zoo.FunctionModel(decay, parameters, zoo.Outputs(("u",), TIMES))
        data = zoo.Data(TIMES, y, labels=["u"])
        models[f"s{k}"] = zoo.bayesian_model("decay", forward, data, zoo.GroupNoise(known={"u": SD}))
    model = zoo.joint_model(models, share=["level"], population=["rate"])
    idata = zoo.sample(
        model, draws=RANKED, tune=600, thin=80, chains=1, cores=0, seed=number, method="exact", progress=False
    )
    draws = {name: values.ravel() for name, values in scalars(arrays(idata)) if name in truth}
    return Replicate(
        truth,
        {name: int(np.sum(draws[name] < value)) for name, value in truth.items()},
        {name: float(draws[name].std()) for name in truth},
        float(dataset(idata).sizes["draw"]),
        1.0,
        "",
    )


def main() -> None:
    """Print the table of ranks, and whether all are uniform, after every twenty replicates."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--replicates", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    found = []
    for number in range(given.replicates):
        found.append(replicate(given.seed, number))
        if len(found) % 20 == 0 or len(found) == given.replicates:
            print(rank_table(found, RANKED).round(2).to_string())
            verdict = "uniform" if passes(ranks_of(found), RANKED) else "NOT uniform"
            print(
                f"{len(found)} replicates, seed {given.seed}: all ranks are {verdict} at level 0.01",
                flush=True,
            )


if __name__ == "__main__":
    main()
