"""Model A on a human's systemic arteries: ADAN56, imported, with drawn observations.

Makes a study of openBF's adan56.yaml whose observations are its own waves (stiffness of each vessel as in the
file, psi1 0.9, psi2 1.15, c 1.2) with noise: pressures of the ascending aorta and a femoral artery (1 mmHg),
flow of a radial artery (0.3 ml/s), 64 samples each. Model A has one stiffness for all vessels, so that it is
not the model that made them. Samples it on a surrogate, and by chains of the solver, and prints medians and
ends of 95 % intervals with their difference in combined Monte Carlo standard errors.

Usage, in the project's folder: python -m benchmarks.human_tree [--folder runs/adan56] [--seed 1]
       [--exact 2470]                (needs the folder benchmarks of ZOO_DATA_DIR; 5 minutes, and an hour for
                                      2470 exact draws of each chain; --exact 0 leaves them out)

References
----------
Boileau et al. 2015, doi 10.1002/cnm.2732.
"""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from benchmarks.figure11 import differences

from zoo import load_study, sample
from zoo.blood.importing.openbf import import_openbf
from zoo.blood.network import Network
from zoo.blood.solver import Solver
from zoo.blood.study import Series, save_study
from zoo.core.inference.convergence import verdict
from zoo.core.inference.record import RunRecord
from zoo.core.posterior.storage import save_posterior
from zoo.models import get_model

OBSERVED = ((1, 0.0, "pressure_mmHg", 1.0), (10, 0.5, "flow_ml_s", 0.3), (60, 0.5, "pressure_mmHg", 1.0))
SAMPLES = 64


def make(folder: Path) -> None:
    """The study, with observations."""
    source = Path(os.environ["ZOO_DATA_DIR"]) / "benchmarks" / "openbf" / "adan56.yaml"
    study = import_openbf(source).save(folder)
    n = len(study.vessels)
    times = np.arange(SAMPLES) * study.period_s / SAMPLES
    places = [(vessel, position) for vessel, position, _, _ in OBSERVED]
    solver = Solver.for_study(study, "linear", series=places, times_s=times)
    stiffness = Network.from_study(study).stiffness_in
    factors = {name: np.full(n, value) for name, value in {"psi1": 0.9, "psi2": 1.15, "c": 1.2}.items()}
    found = solver.solve(stiffness, **factors)
    rng = np.random.default_rng(3)
    series = []
    for i, (vessel, position, quantity, noise) in enumerate(OBSERVED):
        values = getattr(found, quantity)[i] + noise * rng.standard_normal(SAMPLES)
        series.append(Series(vessel, position, quantity, values))
    save_study(replace(study, time_s=times, series=tuple(series)), folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path("runs/adan56"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--exact", type=int, default=2470)
    given = parser.parse_args()
    if not (given.folder / "observations.csv").exists():
        make(given.folder)
    model = get_model("A")(load_study(given.folder))
    runs = [("surrogate", {"draws": 500, "until_ess": 400.0})]
    runs += [("exact", {"draws": given.exact})] if given.exact else []
    both = []
    for method, settings in runs:
        path = given.folder / f"A-{method}.nc"
        checkpoint = path.with_suffix(".checkpoint")
        idata = sample(model, method=method, seed=given.seed, groups=False, checkpoint=checkpoint, **settings)
        save_posterior(idata, path)
        record = RunRecord.of(idata)
        print(f"{method}: {record.solves} solves, {record.wall_seconds / 60:.1f} min; {verdict(idata).text}")
        both.append(idata)
    if len(both) == 2:
        print(differences(*both).to_string(index=False, float_format=lambda x: f"{x:.4g}"))


if __name__ == "__main__":
    main()
