"""Speed of the solver against yardsticks measured in the same run: `make bench`.

Prints a table and writes `benchmarks/latest.json`.  Times are medians; since machines are noisy, read the
ratios to the yardsticks (this core's matrix product, and its square roots and divisions) before the seconds.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import load_study

HERE = Path(__file__).parent
CASES: dict[str, dict[str, Any]] = {
    "linear": {"stiffness": 5.17e4, "psi1": 0.21, "psi2": 0.88, "c": 1.44},
    "tangent": {"stiffness": 9.17e4, "gamma": 5.18, "psi1": 0.37, "psi2": 0.94, "c": 1.60},
}
# the published solver on one core of a Zen 4 at 3.65 GHz, 12 beats of 8192 steps: 6.3-6.7 s and 15.3-15.9 s
PUBLISHED_PER_S = {"linear": 0.15, "tangent": 0.065}
# additions and multiplications per node and step, counted in native/src/scheme.h; square roots; divisions
FLOPS = {"linear": 55, "tangent": 99}
ROOTS = {"linear": 2, "tangent": 2}
DIVISIONS = {"linear": 2, "tangent": 4}
BATCH = 64


def median_time(run: Callable[[], object], repeats: int) -> float:
    """Median wall time of `run`, after one warm-up."""
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def yardsticks() -> dict[str, float]:
    """Matrix-product flop rate of one core, and its rate of square roots and of divisions in cache."""
    a = np.random.default_rng(0).random((512, 512))
    x = np.random.default_rng(1).random(1024) + 0.5
    out = np.empty_like(x)

    def repeat(function: Callable[[], object]) -> float:
        def many() -> None:
            for _ in range(2000):
                function()

        return median_time(many, 7) / 2000

    return {
        "matrix_product_gflop_per_s": 2 * 512**3 / median_time(lambda: a @ a, 15) / 1e9,
        "square_roots_per_s": 1024 / repeat(lambda: np.sqrt(x, out=out)),
        "divisions_per_s": 1024 / repeat(lambda: np.divide(1.0, x, out=out)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--study", default="demo")
    parser.add_argument("--repeats", type=int, default=31)
    parser.add_argument("--output", type=Path, default=HERE / "latest.json")
    options = parser.parse_args()
    study = load_study(options.study)
    with threadpool_limits(1):
        result: dict[str, object] = {"study": study.name, "machine": platform.machine(), **yardsticks()}
    table = Table(title=f"one core, study {study.name}, default accuracy")
    for column in (
        "wall",
        "single /s",
        f"batch of {BATCH} /s",
        "x published",
        "beats",
        "steps/beat",
        "error mmHg",
        "of peak",
        "double roots and divides",
    ):
        table.add_column(column, justify="right")
    for wall, values in CASES.items():
        series, times = [(1, 0.0)], study.time_s
        solver = Solver.for_study(study, wall, series=series, times_s=times)
        fine = Solver.for_study(
            study,
            wall,
            series=series,
            times_s=times,
            options=SolverOptions(refine=4, tolerance_mmHg=1e-9, max_beats=200),
        )
        sets = {k: np.full((BATCH, 1), v) for k, v in values.items()}
        single = 1 / median_time(lambda s=solver, v=values: s.solve(**v), options.repeats)  # type: ignore[misc]
        batch = BATCH / median_time(lambda s=solver, v=sets: s.solve_batch(**v), max(3, options.repeats // 4))  # type: ignore[misc]
        solution, reference = solver.solve(**values), fine.solve(**values)
        error = float(np.abs(solution.pressure_mmHg - reference.pressure_mmHg).max())
        cells, _ = solver.grid()
        node_steps = int((cells + 1).sum()) * solution.total_steps
        gflop = FLOPS[wall] * node_steps * single / 1e9
        # what the roots and divisions alone would take in double precision; the solver starts them in single
        limit = node_steps * (
            ROOTS[wall] / float(result["square_roots_per_s"])  # type: ignore[arg-type]
            + DIVISIONS[wall] / float(result["divisions_per_s"])  # type: ignore[arg-type]
        )
        of_peak = gflop / float(result["matrix_product_gflop_per_s"])  # type: ignore[arg-type]
        result |= {
            f"solve_{wall}_per_s": single,
            f"batch_{wall}_per_s": batch,
            f"error_{wall}_mmHg": error,
            f"beats_{wall}": solution.beats,
            f"beats_reference_{wall}": reference.beats,
            f"steps_per_beat_{wall}": solution.steps_per_beat,
            f"fraction_of_matrix_product_{wall}": of_peak,
            f"double_roots_and_divides_over_time_{wall}": limit * single,
            f"ratio_to_published_{wall}": single / PUBLISHED_PER_S[wall],
        }
        table.add_row(
            wall,
            f"{single:.0f}",
            f"{batch:.0f}",
            f"{single / PUBLISHED_PER_S[wall]:.0f}",
            str(solution.beats),
            str(solution.steps_per_beat),
            f"{error:.4f}",
            f"{of_peak:.0%}",
            f"{limit * single:.0%}",
        )
    options.output.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    console = Console(width=130)
    console.print(table)
    console.print(
        f"yardsticks of this core: {result['matrix_product_gflop_per_s']:.1f} Gflop/s in a matrix product, "
        f"{float(result['square_roots_per_s']) / 1e9:.2f} G square roots/s, "  # type: ignore[arg-type]
        f"{float(result['divisions_per_s']) / 1e9:.2f} G divisions/s; written to {options.output}"  # type: ignore[arg-type]
    )


if __name__ == "__main__":
    main()
