"""Frozen cases as they would be measured on clocks that differ and with gaps: is the leading cause the same?

python -m benchmarks.blind.thinned OUT --n 20     20 cases with several series, whole and thinned, and a table

Every other series has only three of each four samples, and each lacks 5 % of what is left: no series has the
times of another, and none has even ones. What is answered already in OUT is kept.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from benchmarks.blind.frozen.__main__ import frozen_keys, unpack

from zoo.blood.blind import diagnose_cases
from zoo.blood.study import Study, load_study, save_study
from zoo.core.blindcheck.folders import FAILED
from zoo.core.diagnosis import read_diagnosis

MISSING = 0.05
"""Part of the samples that each series lacks."""
WAYS = ("whole", "thinned")


def thinned(study: Study, rng: np.random.Generator) -> Study:
    """The study with samples left out."""
    series = []
    for i, one in enumerate(study.series):
        gone = rng.random(len(one.value)) < MISSING
        if i % 2:
            gone |= np.arange(len(one.value)) % 4 == 3
        series.append(replace(one, value=np.where(gone, np.nan, one.value)))
    return replace(study, series=tuple(series))


def make(out: Path, n: int, seed: int) -> list[str]:
    """Write some cases whole and thinned; their names."""
    several = [key.case for key in frozen_keys() if not key.case.split("/")[0].endswith("-one")]
    chosen = [several[i] for i in np.random.default_rng(seed).permutation(len(several))[:n]]
    names = [f"{i:02d}-{case.replace('/', '-')}" for i, case in enumerate(chosen)]
    with tempfile.TemporaryDirectory() as folder:
        unpack(Path(folder), sorted({case.split("/")[0] for case in chosen}))
        for i, (name, case) in enumerate(zip(names, chosen, strict=True)):
            whole, less = (out / "cases" / f"{name}-{way}" for way in WAYS)
            if not whole.exists():
                shutil.copytree(Path(folder) / case, whole)
            if not less.exists():
                save_study(thinned(load_study(whole), np.random.default_rng([seed, i])), less)
    return names


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--n", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1, help="of which cases, and which samples")
    parser.add_argument("--cores", type=int, default=2, help="cases at a time, a process each")
    args = parser.parse_args()
    (args.out / "cases").mkdir(parents=True, exist_ok=True)
    names = make(args.out, args.n, args.seed)
    answers = args.out / "answers"
    diagnose_cases(args.out / "cases", answers, cores=args.cores, done=lambda case: print(case, flush=True))
    same = 0
    print(
        "\n| case | whole | thinned | same | log evidence over nothing | of the thinned |\n"
        + "|---" * 6
        + "|"
    )
    for name in names:
        folders = [answers / f"{name}-{way}" for way in WAYS]
        if any((folder / FAILED).exists() for folder in folders):
            print(f"| {name} | | failed | | | |")
            continue
        files = [read_diagnosis(folder) for folder in folders]
        led = [sorted(one.name for one in file.causes if _leads(one.name, file.cause)) for file in files]
        leads = []
        for file in files:
            log = {tuple(row.causes): row.log_evidence for row in file.sets}
            leads.append(log[tuple(file.cause)] - log[()])
        same += led[0] == led[1]
        words = " | ".join(" + ".join(one) or "nothing" for one in led)
        print(f"| {name} | {words} | {led[0] == led[1]} | {leads[0]:.1f} | {leads[1]:.1f} |")
    print(f"\nsame leading causes: {same} of {len(names)}")


def _leads(name: str, cause: list[str]) -> bool:
    return any(label == name or label.startswith(f"{name} ") for label in cause)


if __name__ == "__main__":
    main()
