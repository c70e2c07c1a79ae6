"""Chains of model F around a mode near the published medians: is the published row consistent with it?

Prints the log-posterior there, medians with 95 % intervals beside the published ones, WAIC and the sum of
squared errors. The posterior has higher modes; the chains are kept at this one by their start alone, which
was chosen by the published psi1 and psi2 and has a c near the published one. They do not converge: what
agrees is consistent with the published row and does not show where it comes from.

Usage: python benchmarks/published_f.py [--draws 3000] [--cores 2]
"""

from __future__ import annotations

import argparse

import arviz as az
import numpy as np

from zoo import load_study, model_F, sample
from zoo.core.inference.convergence import verdict
from zoo.core.inference.sampling import find_mode
from zoo.core.posterior.comparison import add_log_likelihood, sse_at_median
from zoo.paper.table4 import Interval, format_cell, parameter_table, published_table4

NEAR = {
    "m_chi": 59500.0,
    "v_chi": 5.46,
    "chi": [
        50970, 40100, 55470, 23340, 70020, 94460, 71780, 5416, 66520, 81120, 66720, 2998, 67710, 80260, 63340,
        73040, 25590, 81850, 83170, 71760, 72930,
    ],
    "psi1": 2.461,
    "psi2": 0.238,
    "c": 2.102,
    "sigma2": 0.047,
}  # fmt: skip
"""Where a search ended whose psi1 and psi2 were held in the published 95 % intervals; g cm-1 s-2, mmHg2. The
search is not repeated here, and nothing says that another would not end elsewhere."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--draws", type=int, default=3000)
    parser.add_argument("--cores", type=int, default=2)
    args = parser.parse_args()
    model = model_F(load_study("mouse-c6"))
    mode = find_mode(model, start=NEAR)
    print(f"log-posterior at the mode: {mode.logp:.2f}")
    idata = sample(model, start=mode, draws=args.draws, seed=1, cores=args.cores)
    rows = parameter_table({"F": idata}).set_index("parameter")
    theirs = published_table4()["F"]
    for name, cell in rows.iterrows():
        ours = format_cell(str(name), Interval(*cell[["median", "low", "high"]]))
        print(f"{name}: {ours}, published {format_cell(str(name), theirs.parameters[str(name)])}")
    highest = idata["sample_stats"]["lp"].max("draw").to_numpy()
    print("highest log-posterior of each chain:", np.round(highest, 1))
    waic = az.waic(add_log_likelihood(idata, model), scale="deviance")
    print(f"WAIC {waic.elpd_waic:.0f}, published {theirs.waic:.0f}")
    squares = sse_at_median(idata, model)
    print(f"sum of squared errors {squares.value:.0f} ± {squares.mcse:.1f}, published {theirs.sse:.0f}")
    print(verdict(idata).text)


if __name__ == "__main__":
    main()
