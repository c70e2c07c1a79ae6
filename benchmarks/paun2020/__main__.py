"""The paper's tables again, and the calibration of its models; a killed command goes on where it was."""

from __future__ import annotations

import argparse
from pathlib import Path

import pandas as pd
from benchmarks.paun2020 import coverage
from benchmarks.paun2020.calibration import calibrate
from benchmarks.paun2020.reproduce import reproduce

from zoo import load_study
from zoo.core.inference.cluster import connect
from zoo.core.outputs import write_file
from zoo.models import PAPER

SAMPLING = {"draws": 500, "until_ess": 400.0}


def table4(given: argparse.Namespace) -> None:
    """Sample the nine models on the measured mouse, and set them beside Table 4."""
    settings = {**SAMPLING, "method": "auto", "seed": given.seed, "cores": given.cores}
    print(reproduce(load_study(given.study), given.output, given.models, figures=given.figures, **settings))


def synthetic(given: argparse.Namespace) -> None:
    """Fit synthetic data sets, and set what they say of the truth beside Tables 3 and 5."""
    folder = given.output / "synthetic"
    counts = {"data_sets": given.data_sets, "points": given.points, "cores": given.cores}
    scores = coverage.run(load_study(given.study), folder, **counts, **SAMPLING, max_draws=13_000)
    found, covered = coverage.tables(scores), coverage.coverage(scores)
    write_file(folder / "tables-3-and-5.csv", found.to_csv())
    write_file(folder / "coverage.csv", covered.to_csv(index=False))
    print("medians over the data sets, and the published ones")
    print(found.T.to_string(float_format=lambda x: f"{x:.2g}"))
    print("\nhow often central intervals hold the truth; x: outside the central 95 % of the binomial")
    covered["text"] = covered["covered"].astype(str) + covered["within"].map({True: "", False: " x"})
    print(covered.pivot_table("text", ["scenario", "parameter"], "level", "first", sort=False).to_string())


def calibration(given: argparse.Namespace) -> None:
    """Draw truths from priors, and rank them among draws of their posteriors."""
    with connect(given.dask) as executor:
        for name in given.models.split(","):
            how = {"surrogate": given.surrogate, "seed": given.seed, "cores": given.cores}
            folder = given.output / "calibration"
            print(calibrate(name, given.replicates, folder, executor=executor, **how), flush=True)


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paun2020", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("paun2020"), help="folder; goes on there")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--study", default="mouse-c6")
    chosen = parser.add_subparsers(required=True)
    made = {}
    for function in (table4, synthetic, calibration):
        made[function] = chosen.add_parser(function.__name__, help=function.__doc__)
        made[function].set_defaults(run=function)
    made[table4].add_argument("--models", type=list, default=list(PAPER), help="letters, such as AB")
    made[table4].add_argument("--no-figures", dest="figures", action="store_false")
    made[synthetic].add_argument("--data-sets", type=int, default=20)
    made[synthetic].add_argument("--points", type=int, default=12_000, help="solves of a pool")
    made[calibration].add_argument("--models", default="A,B", help="letters, or C+effects")
    made[calibration].add_argument("--replicates", type=int, default=200)
    made[calibration].add_argument("--surrogate", action="store_true", help="sample on surrogates")
    made[calibration].add_argument("--dask", metavar="ADDRESS", help="of a scheduler, for the replicates")
    given = parser.parse_args()
    pd.set_option("display.width", 160)
    given.run(given)


if __name__ == "__main__":
    main()
