"""Model F around modes of its posterior: the highest that is known, and one with the published medians.

Prints the log-posterior and the log mass of each mode (of the Gaussian around it), and of the one that is
asked for the draws' medians with 95 % intervals beside the published ones, WAIC and the sum of squared
errors. Draws are those of one mode: where they start chooses it; the masses say how much each mode holds.
At a lesser one chains need not converge.

Usage: python benchmarks/published_f.py [--mode highest | published | prior] [--cores 2] [-o F.nc]
"""

from __future__ import annotations

import argparse

import arviz as az
import numpy as np

from zoo import load_study, model_F, sample
from zoo.core.inference.convergence import verdict
from zoo.core.inference.logposterior import LogPosterior
from zoo.core.inference.sampling import find_mode
from zoo.core.posterior.comparison import add_log_likelihood, sse_at_median
from zoo.core.posterior.storage import save
from zoo.paper.modes_of_f import MODES
from zoo.paper.table4 import Interval, format_cell, parameter_table, published_table4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--mode", choices=MODES, default="published")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("-o", "--output", help="NetCDF file of the draws")
    args = parser.parse_args()
    model = model_F(load_study("mouse-c6"))
    d = len(LogPosterior(model).template.data)
    modes = {name: find_mode(model, start=start) for name, start in MODES.items()}
    for name, mode in modes.items():
        mass = mode.logp + 0.5 * (d * np.log(2 * np.pi) + np.linalg.slogdet(mode.covariance)[1])
        print(f"mode {name}: log-posterior {mode.logp:.1f}, log mass {mass:.1f}", flush=True)
    idata = sample(model, method="exact", start=modes[args.mode], draws=3000, seed=1, cores=args.cores)
    rows = parameter_table({"F": idata}).set_index("parameter")
    theirs = published_table4()["F"]
    for name, cell in rows.iterrows():
        ours = format_cell(str(name), Interval(*cell[["median", "low", "high"]]))
        print(f"{name}: {ours}, published {format_cell(str(name), theirs.parameters[str(name)])}")
    waic = az.waic(add_log_likelihood(idata, model), scale="deviance")
    print(f"WAIC {waic.elpd_waic:.0f}, published {theirs.waic:.0f}")
    [squares] = sse_at_median(idata, model).values()
    print(f"sum of squared errors {squares.value:.0f} ± {squares.mcse:.1f}, published {theirs.sse:.0f}")
    print(verdict(idata).text)
    if args.output:
        save(idata, args.output)


if __name__ == "__main__":
    main()
