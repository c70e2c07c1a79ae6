"""Cost of derivatives over that of the solve alone, by processor time in the same run.

`python -m benchmarks.gradient --study mouse-c6` prints 5, 24 and 100 directions for both walls, and keeps
`gradient_5_over_primal_linear` and so on in `benchmarks/latest.json`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np
from benchmarks.measured import CASES, keep, options, processor_times

from zoo.blood.directions import Point
from zoo.blood.solver import Solver
from zoo.blood.study import load_study

DIRECTIONS = (5, 24, 100)


def direction(values: dict[str, float], name: str, n_vessels: int, vessel: int | None = None) -> list[Point]:
    """Central differences of one parameter, or of the stiffness of one vessel."""
    step = 1e-5 * values[name]
    where = np.ones(n_vessels) if vessel is None else np.eye(n_vessels)[vessel]
    return [
        Point(side / (2 * step), **{**values, name: values[name] + side * step * where}) for side in (1, -1)
    ]


def directions(values: dict[str, float], n_vessels: int) -> list[list[Point]]:
    """The shared parameters, then those of single vessels, then pairs of these."""
    every = [direction(values, name, n_vessels) for name in values]
    single = ("stiffness", "psi1", "psi2", "c")
    every += [direction(values, name, n_vessels, vessel) for name in single for vessel in range(n_vessels)]
    return every + [[*a, *b] for a, b in pairwise(every)]


def main() -> None:
    given = options(__doc__, study="mouse-c6", repeats=25)
    study = load_study(given.study)
    result: dict[str, object] = {"gradient_study": study.name}
    for wall, values in CASES.items():
        solver = Solver.for_study(study, wall, series=[(study.vessels[0].id, 0.0)])
        every = directions(values, len(study.vessels))
        runs: list[Callable[[], object]] = [partial(solver.solve, **values)]  # type: ignore[arg-type]
        runs += [partial(solver.jacobian, **values, directions=every[:n]) for n in DIRECTIONS]  # type: ignore[arg-type]
        primal, *costs = processor_times(runs, given.repeats)
        for n, cost in zip(DIRECTIONS, costs, strict=True):
            found = solver.jacobian(**values, directions=every[:n])  # type: ignore[arg-type]
            result[f"gradient_{n}_over_primal_{wall}"] = cost / primal
            shared = ", one of them the same" if found.along else ""
            beats = f"{found.beats} linearised beats and the solve's {found.solution.beats}{shared}"
            print(f"{wall}, {n} directions: {cost / primal:.2f} times {1e3 * primal:.1f} ms, {beats}")
    keep(result, given.output)


if __name__ == "__main__":
    main()
