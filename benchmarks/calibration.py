"""Simulation-based calibration of models on a cheap network: are the truth's ranks uniform?

Prints the tables that docs/calibration.md quotes and draws its figures. Finished replicates are kept in a
file for each model, so an interrupted run goes on.

Usage: python benchmarks/calibration.py [--models A,B] [--method exact] [--replicates 200]
       [--folder runs/calibration] [--figures docs/figures] [--cores 1] [--seed 1]
       [--dask tcp://HOST:8786]
"""

from __future__ import annotations

import argparse
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np

from zoo.core.inference.cluster import connect
from zoo.core.posterior.ranks import RankTest
from zoo.models import get_model
from zoo.paper.calibration import simulate_and_rank
from zoo.paper.cheap import cheap_options, cheap_study
from zoo.paper.replicator import METHODS, Settings
from zoo.plots import calibration_figure, save_figure

FIGURES = Path(__file__).parents[1] / "docs" / "figures"
SIGMA2 = (1e-3, 1.0)  # mmHg2; InverseGamma(0.001, 0.001) has half of its mass above 1e300

SETTINGS = {
    "exact": Settings(),
    "surrogate": Settings(method="surrogate", chains=4, steps=250, max_steps=2000),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--models", default="A,B")
    parser.add_argument("--method", choices=METHODS, default="exact", help="surrogate: of B, C, E, G, H or I")
    parser.add_argument("--replicates", type=int, default=200)
    parser.add_argument("--folder", type=Path, default=Path("runs/calibration"))
    parser.add_argument("--figures", type=Path, default=FIGURES)
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--dask", help="scheduler whose workers do the replicates")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    study = cheap_study()
    for name in args.models.split(","):
        wall = "tangent" if name in ("H", "I") else "linear"
        independent = name in ("A", "D", "F")
        with connect(args.dask) as executor:
            test = simulate_and_rank(
                partial(get_model(name), options=cheap_options(wall)),
                study,
                args.replicates,
                seed=args.seed,
                settings=SETTINGS[args.method],
                limits={"sigma2": SIGMA2} if independent else None,
                path=args.folder / f"{name}{'' if args.method == 'exact' else '-surrogate'}.jsonl",
                cores=args.cores,
                executor=executor,
                progress=True,
            )
        report(name, test)
        save_figure(calibration_figure(test, title=f"model {name}"), args.figures / f"calibration-{name}.svg")


def report(name: str, test: RankTest) -> None:
    """Print what the document quotes."""
    replicates = test.replicates
    print(f"\nmodel {name}: {test.n} replicates, {test.ranked + 1} possible ranks")
    print(test.table().to_string(float_format=lambda x: f"{x:.3f}"))
    print(test.coverage().to_string(index=False, float_format=lambda x: f"{x:.3f}"))
    ess = np.array([min(r.ess.values()) for r in replicates])
    rhat = np.array([r.rhat for r in replicates])
    steps = np.array([r.steps for r in replicates])
    redrawn = sum(sum(r.redrawn.values()) for r in replicates)
    by = Counter(r.correction.partition(":")[0] for r in replicates if r.correction)
    if by:
        print("made exact by " + ", ".join(f"{what} {n}" for what, n in by.items()))
    if surrogate := [r for r in replicates if r.k_hat is not None]:
        k_hats, shares = ([getattr(r, name) for r in surrogate] for name in ("k_hat", "accepted"))
        print(f"k-hat: median {np.median(k_hats):.2f}, most {max(k_hats):.2f}")
        print(f"effective share of the draws: median {np.median(shares):.2f}, least {min(shares):.2f}")
    print(f"smallest ESS of a replicate: least {ess.min():.0f}, median {np.median(ess):.0f}")
    print(f"largest R-hat of a replicate: median {np.median(rhat):.3f}, most {rhat.max():.3f}")
    print(f"steps of a chain: median {np.median(steps):.0f}, most {steps.max()}")
    print(f"draws of the prior whose solve failed: {redrawn}")
    print(f"{sum(r.seconds for r in replicates):.0f} s; {'passes' if test.passes() else 'FAILS'}")


if __name__ == "__main__":
    main()
