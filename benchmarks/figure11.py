"""Figure 11 of the paper: a posterior on a surrogate beside that of chains of the solver.

The first model is sampled on a surrogate, corrected with the solver, and the second by chains of the solver
itself until every effective sample size is large. Both are of the same equations: B and C as in the paper, or
one model twice (`--models H --seed 2`, `--models G --ess 700`). Prints medians and ends of 95 % intervals
with the difference in combined Monte Carlo standard errors, and the largest difference of the predicted
pressures; `--figures` draws both.

Usage: python -m benchmarks.figure11 [--models BC] [--study mouse-c6] [--ess 4000] [--cores 2] [--seed 1]
       [--folder runs/figure11] [--figures docs/figures]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import arviz as az
import numpy as np
import pandas as pd
from benchmarks.paun2020.figures import posteriors_figure, uncertainty_figure

from zoo import load_study, sample
from zoo.blood import predictive
from zoo.core.arviz_lines import InferenceData
from zoo.core.inference.convergence import verdict
from zoo.core.inference.elements import arrays, scalars
from zoo.core.inference.record import RunRecord
from zoo.core.posterior.storage import load, save_posterior
from zoo.models import get_model
from zoo.plots import save_figure

if TYPE_CHECKING:
    from zoo.blood.study import Study

ENDS = (0.025, 0.5, 0.975)


def posterior(name: str, study: Study, method: str, path: Path, given: argparse.Namespace) -> InferenceData:
    """Of one model, stored as it was made."""
    if path.exists():
        return load(path)
    ess = given.ess if method == "exact" else 400.0
    idata = sample(
        get_model(name)(study), method=method, draws=1000, until_ess=ess, max_draws=40_000, cores=given.cores,
        seed=given.seed, checkpoint=path.with_suffix(".checkpoint"),
    )  # fmt: skip
    save_posterior(idata, path)
    return idata


def differences(one: InferenceData, other: InferenceData) -> pd.DataFrame:
    """Quantiles of all scalars that both have, and differences in combined Monte Carlo standard errors."""
    rows = []
    first, second = (dict(scalars(arrays(idata))) for idata in (one, other))
    for name in first.keys() & second.keys():
        for p in ENDS:
            both = first[name], second[name]
            values = [float(np.quantile(draws, p)) for draws in both]
            errors = [float(az.mcse(draws, method="quantile", prob=p)) for draws in both]
            z = (values[0] - values[1]) / np.hypot(*errors)
            rows.append(
                {"parameter": name, "quantile": p, "surrogate": values[0], "exact": values[1], "z": z}
            )
    return pd.DataFrame(rows).sort_values(["parameter", "quantile"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--models", default="BC")
    parser.add_argument("--study", default="mouse-c6")
    parser.add_argument("--ess", type=float, default=4000.0)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=Path("runs/figure11"))
    parser.add_argument("--figures", type=Path)
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    study = load_study(given.study)
    names = [given.models[0], given.models[-1]]
    labels = [f"{names[0]} (surrogate)", f"{names[1]} (solver)"]
    both = []
    for name, method in zip(names, ("surrogate", "exact"), strict=True):
        idata = posterior(name, study, method, given.folder / f"{name}-{method}.nc", given)
        record = RunRecord.of(idata)
        print(f"{name} {method}: {record.solves} solves; {verdict(idata).text}", flush=True)
        both.append(idata)
    table = differences(*both)
    print(table.to_string(index=False, float_format=lambda x: f"{x:.4g}"))
    print(
        f"{len(table)} medians and interval ends: largest difference {table['z'].abs().max():.2f} combined "
        f"standard errors, root mean square {np.sqrt((table['z'] ** 2).mean()):.2f}"
    )
    bands = {}
    for label, name, idata in zip(labels, names, both, strict=True):
        waves = predictive.vessel_waves(get_model(name)(study), idata, n_draws=400)
        bands[label] = predictive.bands(predictive.one_place(waves), "pressure_mmHg", (0.95,), errors=True)
    one, other = bands.values()
    for what in ("median", "low", "high"):
        print(f"pressures, {what}: differ by at most {float(abs(one[what] - other[what]).max()):.3f} mmHg")
    if given.figures:
        pair = dict(zip(labels, both, strict=True))
        stem = f"figure11-{''.join(dict.fromkeys(names))}"
        save_figure(posteriors_figure(pair), given.figures / f"{stem}-parameters.png")
        save_figure(uncertainty_figure(bands, study), given.figures / f"{stem}-pressure.png")


if __name__ == "__main__":
    main()
