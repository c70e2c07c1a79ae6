"""Cost of derivatives over that of the solve alone, by processor time in the same run.

`python benchmarks/gradient.py --study mouse-c6` prints a table, and sets `gradient_5_over_primal_linear`,
`gradient_5_over_primal_tangent` and `gradient_24_over_primal_linear` of `benchmarks/latest.json`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
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


def processor_time(run: Callable[[], object], repeats: int) -> float:
    """Median time of this thread, s, after one warm-up; other processes count less than in wall time."""
    run()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        run()
        times.append(time.thread_time() - start)
    return float(np.median(times))


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
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--output", type=Path, default=HERE / "latest.json")
    options = parser.parse_args()
    study = load_study(options.study)
    result = json.loads(options.output.read_text(encoding="utf-8")) | {"gradient_study": study.name}
    for wall, values in CASES.items():
        solver = Solver.for_study(study, wall, series=[(study.vessels[0].id, 0.0)])
        n = len(study.vessels)
        shared = [direction(values, name, n) for name in values]
        one = [direction(values, "stiffness", n, vessel) for vessel in range(n)]
        primal = processor_time(lambda s=solver, v=values: s.solve(**v), options.repeats)  # type: ignore[misc]
        for size in (5, 24):
            chosen = (shared + one)[:size]
            found = solver.jacobian(**values, directions=chosen)  # type: ignore[arg-type]
            both = processor_time(
                lambda s=solver, v=values, d=chosen: s.jacobian(**v, directions=d),  # type: ignore
                options.repeats,
            )
            if size == 5 or wall == "linear":
                result[f"gradient_{size}_over_primal_{wall}"] = both / primal
            beats = f"{found.beats} linearised beats beside the solve's {found.solution.beats}"
            print(
                f"{wall}, {len(chosen)} directions: {both / primal:.2f} times {1e3 * primal:.1f} ms, {beats}"
            )
    options.output.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
