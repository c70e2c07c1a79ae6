"""Cost of derivatives over that of the solve alone, by processor time in the same run.

`python benchmarks/gradient.py --study mouse-c6` prints a table, and sets `gradient_5_over_primal_linear`,
`gradient_5_over_primal_tangent` and `gradient_24_over_primal_linear` of `benchmarks/latest.json`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from zoo.blood.directions import Point
from zoo.blood.solver import Solver
from zoo.blood.study import load_study

HERE = Path(__file__).parent
CASES: dict[str, dict[str, float]] = {
    "linear": {"stiffness": 5.17e4, "psi1": 0.21, "psi2": 0.88, "c": 1.44},
    "tangent": {"stiffness": 9.17e4, "gamma": 5.18, "psi1": 0.37, "psi2": 0.94, "c": 1.60},
}


def processor_times(runs: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Median time of this thread, s, of each run after a warm-up; the time of other processes does not count.

    The runs take turns, so that what else the machine does meets all of them.
    """
    times = np.empty((repeats + 1, len(runs)))
    for row in times:
        for i, run in enumerate(runs):
            start = time.thread_time()
            run()
            row[i] = time.thread_time() - start
    return [float(x) for x in np.median(times[1:], axis=0)]


def direction(values: dict[str, float], name: str, n_vessels: int, vessel: int | None = None) -> list[Point]:
    """Central differences of one parameter, or of the stiffness of one vessel."""
    step = 1e-5 * values[name]
    where = np.ones(n_vessels) if vessel is None else np.eye(n_vessels)[vessel]
    return [
        Point(side / (2 * step), **{**values, name: values[name] + side * step * where}) for side in (1, -1)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--study", default="mouse-c6")
    parser.add_argument("--repeats", type=int, default=25)
    parser.add_argument("--output", type=Path, default=HERE / "latest.json")
    options = parser.parse_args()
    study = load_study(options.study)
    result = json.loads(options.output.read_text(encoding="utf-8")) | {"gradient_study": study.name}
    for wall, values in CASES.items():
        solver = Solver.for_study(study, wall, series=[(study.vessels[0].id, 0.0)])
        n = len(study.vessels)
        shared = [direction(values, name, n) for name in values]
        one = [direction(values, "stiffness", n, vessel) for vessel in range(n)]
        chosen = {size: (shared + one)[:size] for size in (5, 24)}
        runs: list[Callable[[], object]] = [partial(solver.solve, **values)]  # type: ignore[arg-type]
        for each in chosen.values():
            runs.append(partial(solver.jacobian, **values, directions=each))  # type: ignore[arg-type]
        primal, *both = processor_times(runs, options.repeats)
        for (size, each), cost in zip(chosen.items(), both, strict=True):
            found = solver.jacobian(**values, directions=each)  # type: ignore[arg-type]
            if size == 5 or wall == "linear":
                result[f"gradient_{size}_over_primal_{wall}"] = cost / primal
            shared = ", one of them the same" if found.along else ""
            beats = f"{found.beats} linearised beats and the solve's {found.solution.beats}{shared}"
            print(f"{wall}, {len(each)} directions: {cost / primal:.2f} times {1e3 * primal:.1f} ms, {beats}")
    options.output.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
