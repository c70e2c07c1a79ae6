"""Speed of the solver against yardsticks measured in the same run: `make bench`.

Prints a table and keeps its rows in `benchmarks/latest.json`. Times are medians of processor time; since
machines are noisy, read the ratios to the yardsticks (this core's matrix product, and its square roots and
divisions) before the seconds.
"""

from __future__ import annotations

import platform
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from benchmarks.measured import CASES, keep, options, processor_times, yardsticks

from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import load_study

# the published solver on one core of a Zen 4 at 3.65 GHz, 12 beats of 8192 steps: 6.3-6.7 s and 15.3-15.9 s
PUBLISHED_PER_S = {"linear": 0.15, "tangent": 0.065}
# additions and multiplications per node and step, counted in native/src/scheme.h; square roots; divisions
FLOPS = {"linear": 55, "tangent": 99}
ROOTS = {"linear": 2, "tangent": 2}
DIVISIONS = {"linear": 2, "tangent": 4}


def main() -> None:
    given = options(__doc__, study="demo", repeats=31)
    study = load_study(given.study)
    core = yardsticks()
    rows: dict[str, dict[str, Any]] = {}
    for wall, values in CASES.items():
        of = partial(Solver.for_study, study, wall, series=[(1, 0.0)], times_s=study.time_s)
        solver = of()
        fine = of(options=SolverOptions(refine=4, tolerance_mmHg=1e-9, max_beats=200))
        rate = 1 / processor_times([partial(solver.solve, **values)], given.repeats)[0]  # type: ignore[arg-type]
        solution, reference = solver.solve(**values), fine.solve(**values)  # type: ignore[arg-type]
        error = float(np.abs(solution.pressure_mmHg - reference.pressure_mmHg).max())
        cells, _ = solver.grid()
        node_steps = int((cells + 1).sum()) * solution.total_steps
        # what the roots and divisions alone would take in double precision; the solver starts them in single
        limit = node_steps * (
            ROOTS[wall] / core["square_roots_per_s"] + DIVISIONS[wall] / core["divisions_per_s"]
        )
        of_peak = FLOPS[wall] * node_steps * rate / 1e9 / core["matrix_product_gflop_per_s"]
        rows[wall] = {
            "solve_{}_per_s": rate,
            "error_{}_mmHg": error,
            "beats_{}": solution.beats,
            "beats_reference_{}": reference.beats,
            "steps_per_beat_{}": solution.steps_per_beat,
            "fraction_of_matrix_product_{}": of_peak,
            "double_roots_and_divides_over_time_{}": limit * rate,
            "ratio_to_published_{}": rate / PUBLISHED_PER_S[wall],
        }
    result = {name.format(wall): value for wall, row in rows.items() for name, value in row.items()}
    keep({"study": study.name, "machine": platform.machine(), **core, **result}, given.output)
    print(f"one core, study {study.name}, default accuracy; in {given.output.name} a wall stands for {{}}")
    print(pd.DataFrame(rows).to_string(float_format="{:.4g}".format))
    print(
        f"yardsticks of this core: {core['matrix_product_gflop_per_s']:.1f} Gflop/s in a matrix product, "
        f"{core['square_roots_per_s'] / 1e9:.2f} G square roots/s, "
        f"{core['divisions_per_s'] / 1e9:.2f} G divisions/s; kept in {given.output}"
    )


if __name__ == "__main__":
    main()
