"""The solver's error on the grids of a diagnosis and of blind cases, and what two ways to extrapolate leave.

    python -m benchmarks.grid_error [STUDIES]

Of `linear-constant` where its search starts and at half that stiffness, in the unit of each series,
root mean square over the samples; beside an eighth of the size, extrapolated to none.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo import get_baseline, load_study
from zoo.blood.blind.study_cases import GENERATOR
from zoo.blood.blood_flow import study_data
from zoo.blood.solver import SolverOptions
from zoo.blood.study_diagnosis import SEARCH_SHARE
from zoo.core.parameters import pack, start_of

Array = NDArray[np.float64]
CONVERGED_MMHG = 1e-5


def errors(study: str, softer: float = 1.0) -> dict[str, Array]:
    """Errors (n_series,) by the way a study is solved."""
    loaded = load_study(study)
    study_data(loaded)  # refuses a study without observations
    flow = get_baseline("linear-constant").forward(loaded, share=SEARCH_SHARE)
    case = flow.configure(pack(flow.parameters, start_of(flow.parameters)))
    case = replace(case, stiffness=softer * case.stiffness)

    def solved(options: SolverOptions, blend: float = 0.0) -> Array:
        return flow.solve(replace(case, options=options, coarse_blend=blend))

    by = {k: solved(replace(flow.options, refine=k, tolerance_mmHg=CONVERGED_MMHG)) for k in (1, 2, 4, 8)}
    true = by[8] + (by[8] - by[4]) / 3
    ways = {
        "as a diagnosis solves": solved(flow.options),
        "cells and steps of half the size": by[2],
        "extrapolated from these two": by[2] + (by[2] - by[1]) / 3,
        "extrapolated from twice the size": solved(flow.options, -1 / 3),
        "as blind cases are made": solved(GENERATOR),
    }
    return {way: np.sqrt(np.mean((series - true) ** 2, axis=1)) for way, series in ways.items()}


def main() -> None:
    for study in sys.argv[1:] or ["mouse-h1", "mouse-c6", "demo-gap"]:
        for softer in (1.0, 0.5):
            print(f"{study}, stiffness x {softer:g}")
            for way, error in errors(study, softer).items():
                print(f"  {way:34s}", *(f"{one:.5f}" for one in error))


if __name__ == "__main__":
    main()
