"""The command of this folder; see `benchmarks.nature`."""

from __future__ import annotations

import argparse
import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from benchmarks.nature import CASES, __doc__, list_digest
from benchmarks.nature.falling_balls import diagnose_ball

DRAG = ("linear-drag", "quadratic-drag")


def main(arguments: Sequence[str] | None = None) -> None:
    """Print lists or answers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument(
        "--lists", action="store_true", help="SHA-256 of the lists of rivals, and nothing else"
    )
    parser.add_argument("--balls", nargs="+", help="these only")
    asked = parser.parse_args(arguments)
    if asked.lists:
        for case in CASES:
            print(case, list_digest(case))
        return
    case = CASES["falling-balls"]
    path = Path(os.environ.get("ZOO_DATA_DIR", ".")) / case["data"]
    if not path.exists():
        parser.error(f"{path} is not there: set ZOO_DATA_DIR to the folder that has {case['data']}")
    if hashlib.sha256(path.read_bytes()).hexdigest() != case["sha256"]:
        parser.error(f"{path} is not the file of {case['source']}: its SHA-256 is another")
    table = pd.read_csv(path)
    print("| ball | known | drag | first three | nothing | m before | m after | second drop, m | s |")
    print("|---|---|---|---|---|---|---|---|---|")
    for ball in asked.balls or dict.fromkeys(table["ball"]):
        drops = [
            (part["time_s"].to_numpy(), part["height_m"].to_numpy())
            for _, part in table[table["ball"] == ball].groupby("drop")
        ]
        drops = [(np.linspace(t[0], t[-1], len(t)), h) for t, h in drops]  # times are rounded to 7 digits
        found = diagnose_ball(*drops)
        p = {one.name: one.probability for one in found.causes}
        first = ", ".join(f"{name} {x:.0%}" for name, x in list(p.items())[:3])
        later = [found.file.states[0].baseline, *(one.error for one in found.file.states[0].carried[:1])]
        named = found.sets.posterior.included(lambda one: "drag" if one.name in DRAG else one.name)
        print(
            f"| {ball} | {case['known'].get(ball, 'open')} | {named.get('drag', 0.0):.0%} | {first} | "
            f"{found.file.sets[0].probability if not found.file.sets[0].causes else 0:.0%} | "
            f"{found.file.gap.before:.3f} | {found.file.gap.after:.3f} | "
            f"{' -> '.join(f'{one.mean:.3f}' for one in later)} | "
            f"{found.file.record['seconds']:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
