"""How a solve and its derivatives grow with vessels, by processor time in the same run.

`python -m benchmarks.growth` prints a row for random trees of 21, 113 and 1001 vessels (Murray's law, lengths
of 5 to 15 radii, cells of the mouse's size), and keeps `growth_vessels` in `benchmarks/latest.json`. Times
are also given for a cell and a time step of one vessel's scheme, which is what ought not to grow.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from benchmarks.gradient import direction
from benchmarks.measured import keep, options, processor_times

from zoo.blood.blind.networks import inflow, loaded, tree
from zoo.blood.solver import Solver, SolverOptions
from zoo.blood.study import Blood, Study
from zoo.blood.units import mmhg_to_cgs

VESSELS = (21, 113, 1001)
MEAN_MMHG = 15.0
DX_CM = 0.038


def study_of(n_vessels: int, seed: int = 1) -> Study:
    """A random tree with an ejection for inflow and Windkessels for a mean pressure of about 15 mmHg."""
    rng = np.random.default_rng(seed)
    rows = tree(rng, n_vessels)
    period, time, flow = inflow(rng)
    resistance = mmhg_to_cgs(MEAN_MMHG) / float(flow.mean())
    vessels = loaded(rows, resistance, 1.5 * period)
    none = np.array([])
    name = f"tree-{n_vessels}"
    return Study(name, period, Blood(1.055, 0.049), vessels, time, flow, none, (), source=name)


def row_of(study: Study, repeats: int) -> dict[str, Any]:
    """Seconds of a solve, its cells and steps, and the cost of five directions."""
    times = np.arange(64) * (study.period_s / 64)
    options = SolverOptions(dx_cm=DX_CM)
    series = [(study.vessels[0].id, 0.0)]
    solver = Solver.for_study(study, "linear", series=series, times_s=times, options=options)
    values = {"stiffness": 5e4, "psi1": 1.0, "psi2": 1.0, "c": 1.0}
    n = len(study.vessels)
    five = [direction(values, name, n) for name in values] + [direction(values, "stiffness", n, 0)]
    found = solver.solve(**values)
    runs = [partial(solver.solve, **values), partial(solver.jacobian, **values, directions=five)]
    primal, both = processor_times(runs, repeats)  # type: ignore[arg-type]
    cells = sum(max(2, round(v.length_cm / DX_CM)) for v in study.vessels)
    steps = int(found.steps_per_beat * found.beats)
    return {
        "vessels": n,
        "cells": cells,
        "steps_per_beat": int(found.steps_per_beat),
        "beats": int(found.beats),
        "solve_s": primal,
        "ns_per_cell_and_step": 1e9 * primal / (cells * steps),
        "gradient_5_over_primal": both / primal,
    }


def main() -> None:
    given = options(__doc__, repeats=7)
    rows = []
    for n in VESSELS:
        row = row_of(study_of(n), given.repeats)
        print(", ".join(f"{k} {v:.4g}" for k, v in row.items()), flush=True)
        rows.append(row)
    keep({"growth_vessels": rows}, given.output)


if __name__ == "__main__":
    main()
