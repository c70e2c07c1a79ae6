"""Solves a second of any study at the cells and steps that follow from an accuracy, against the yardsticks.

    .venv/bin/python -m benchmarks.resolution [STUDY FOLDERS] [--accuracy 0.1] [--stiffness 4e5]

Without folders: the tree of a human's size in `tests/data/human`. Studies of openBF's networks come from
`zoo import`; their stiffness is their own. Writes into `benchmarks/latest.json`, under "resolution".
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from benchmarks.bench_solver import HERE, median_time, yardsticks
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from zoo.blood.network import Network
from zoo.blood.resolution import resolve_solver
from zoo.blood.solver import Solver
from zoo.blood.study import load_study

HUMAN = HERE.parent / "tests" / "data" / "human"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("studies", nargs="*", default=[str(HUMAN)])
    parser.add_argument("--accuracy", type=float, default=0.03)
    parser.add_argument("--stiffness", type=float, default=4e5)
    parser.add_argument("--output", type=Path, default=HERE / "latest.json")
    given = parser.parse_args()
    with threadpool_limits(1):
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
        rate = 1 / median_time(lambda s=solver, v=at: s.solve(**v), 7)  # type: ignore[misc]
        print(f"{study.name}: {chosen.text}; {solution.beats} beats; {rate:.3g} solves/s")
        found[study.name] = {
            "accuracy_percent": given.accuracy,
            "error_percent": chosen.error_percent,
            "cells": sum(chosen.cells),
            "steps_per_beat": solution.steps_per_beat,
            "beats": solution.beats,
            "solves_per_s": rate,
            "solves_per_gflop_of_a_matrix_product": rate / gflop,
        }
    result = json.loads(given.output.read_text(encoding="utf-8"))
    result["resolution"] = result.get("resolution", {}) | found
    given.output.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
