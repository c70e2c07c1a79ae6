"""Solves a second of any study at the cells and steps that follow from an accuracy, against the yardsticks.

    python -m benchmarks.resolution [STUDY FOLDERS] [--accuracy 0.1] [--stiffness 4e5]

Without folders: the tree of a human's size in `tests/data/human`. Studies of openBF's networks come from
`zoo import`; their stiffness is their own. Keeps `resolution_NAME` in `benchmarks/latest.json` for each.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from benchmarks.measured import LATEST, keep, processor_times, yardsticks

from zoo.blood.network import Network
from zoo.blood.resolution import resolve_solver
from zoo.blood.solver import Solver
from zoo.blood.study import load_study

HUMAN = LATEST.parents[1] / "tests" / "data" / "human"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="*", default=[str(HUMAN)])
    parser.add_argument("--accuracy", type=float, default=0.03)
    parser.add_argument("--stiffness", type=float, default=4e5)
    parser.add_argument("--output", type=Path, default=LATEST)
    given = parser.parse_args()
    gflop = yardsticks()["matrix_product_gflop_per_s"]
    found = {}
    for name in given.studies:
        study = replace(load_study(name), numerics={"accuracy_percent": given.accuracy})
        network = Network.from_study(study)
        one = np.ones(len(network.ids))
        own = given.stiffness * one if network.stiffness_in is None else network.stiffness_in
        at = {"stiffness": own, "gamma": 2 * one, "psi1": one, "psi2": one, "c": one}
        chosen = resolve_solver(study, Solver.for_study(study), **at)
        solver = Solver.for_study(study, options=chosen.options)
        solution = solver.solve(**at)
        rate = 1 / processor_times([partial(solver.solve, **at)], 7)[0]  # type: ignore[arg-type]
        print(f"{study.name}: {chosen.text}; {solution.beats} beats; {rate:.3g} solves/s")
        found[f"resolution_{study.name}"] = {
            "accuracy_percent": given.accuracy,
            "error_percent": chosen.error_percent,
            "cells": sum(chosen.cells),
            "steps_per_beat": solution.steps_per_beat,
            "beats": solution.beats,
            "solves_per_s": rate,
            "solves_per_gflop_of_a_matrix_product": rate / gflop,
        }
    keep(found, given.output)


if __name__ == "__main__":
    main()
