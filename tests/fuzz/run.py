"""Fuzz what reads files: studies and files to import, and the files that zoo writes for itself.

Each input is read in a child process, so that a crash of a library is seen; the child takes a batch of them.
A failure is a crash, an exception that is not one of zoo's own, an error longer than a line of 500
characters, a read that takes too long, and damaged data that are read as other data. It prints the counts
of each kind and how to have each failure again, keeps the inputs that failed, and ends with 1
if there is any.

    python tests/fuzz/run.py --seconds 60
    python tests/fuzz/run.py --studies 20000 --files 5000 --seed 7
    python tests/fuzz/run.py --seed 7 --only study:123
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

HERE = Path(__file__).resolve().parent
BATCH = {"study": 250, "file": 500}
"""Inputs that one child reads."""
BATCH_SECONDS = 600


def kinds() -> dict[str, object]:
    """What makes and reads an input of each kind."""
    import damaged
    import studies

    return {"study": studies.case, "file": damaged.case}


def child(kind: str, first: int, count: int, seed: str, work: Path, keep: Path) -> None:
    """Read a batch of inputs; a line for each begun, and for each outcome."""
    case = kinds()[kind]
    for number in range(first, first + count):
        print(json.dumps([number]), flush=True)
        found = case(number, seed, work)  # type: ignore[operator]
        if found.kind == "FAILED":
            kept(work, keep / f"{kind}-{seed}-{number}", found.text)
        print(json.dumps([number, found.kind, found.text]), flush=True)


def kept(work: Path, to: Path, text: str) -> None:
    """Keep an input that failed, and why."""
    shutil.rmtree(to, ignore_errors=True)
    if (work / "case").exists():
        shutil.copytree(work / "case", to, symlinks=True)
    to.mkdir(parents=True, exist_ok=True)
    (to / "FAILURE.txt").write_text(text)


def batch(
    kind: str, first: int, count: int, seed: str, keep: Path, base: Path
) -> tuple[Counter[str], list[str], int]:
    """Counts, failures and the number of inputs that a child has read."""
    counts: Counter[str] = Counter()
    failures = []
    words = [sys.executable, str(HERE / "run.py"), "--seed", seed, "--save", str(keep)]
    with tempfile.TemporaryDirectory(dir=base) as work:
        task = f"{kind}:{first}:{count}"
        try:
            ended = subprocess.run(
                [*words, "--child", task, "--work", work],
                capture_output=True,
                text=True,
                timeout=BATCH_SECONDS,
                check=False,
            )
            code, shown, said = ended.returncode, ended.stdout, ended.stderr
        except subprocess.TimeoutExpired as error:
            code, shown, said = -9, (error.stdout or b"").decode(), "too long"  # type: ignore[union-attr]
        lines = [json.loads(line) for line in shown.splitlines() if line.startswith("[")]
        for line in lines:
            if len(line) == 3:
                counts[line[1]] += 1
                if line[1] == "FAILED":
                    failures.append(f"{kind}:{line[0]}: {line[2].strip().splitlines()[-1]}")
        begun = max((line[0] for line in lines), default=first)
        if code != 0:  # the last that was begun is the one that ended it
            counts["FAILED"] += 1
            text = f"the process ended with {code}: {said[-1500:]}"
            failures.append(f"{kind}:{begun}: {text}")
            kept(Path(work), keep / f"{kind}-{seed}-{begun}", text)
    return counts, failures, begun - first + 1


def fuzz(kind: str, total: int | None, until: float | None, seed: str, keep: Path) -> bool:
    """Read inputs of a kind, so many or until a time; print the counts; whether none failed."""
    began, done = time.monotonic(), 0
    counts: Counter[str] = Counter()
    failures: list[str] = []
    base = Path(tempfile.mkdtemp(prefix="zoo-fuzz-"))
    while (total is None or done < total) and (until is None or time.monotonic() < until):
        left = BATCH[kind] if total is None else min(BATCH[kind], total - done)
        if until is not None and done:  # as many as there is time for
            speed = done / (time.monotonic() - began)
            left = max(1, min(left, int(speed * (until - time.monotonic()))))
        found, failed, read = batch(kind, done, left, seed, keep, base)
        counts += found
        failures += failed
        done += read
    shutil.rmtree(base, ignore_errors=True)
    words = {"study": "studies and files to import", "file": "damaged files"}[kind]
    print(
        f"{done} {words}: {counts['ok']} read as what they are, {counts['refused']} refused in one line, "
        f"{counts['FAILED']} FAILED; {time.monotonic() - began:.0f} s, seed {seed}",
        flush=True,
    )
    for failure in failures[:20]:
        number = failure.split(": ")[0]
        print(f"  {failure[:600]}\n    again: python tests/fuzz/run.py --seed {seed} --only {number}")
    if failures:
        print(f"  inputs are in {keep}")
    return not failures


def main() -> int:
    """Read the options, and fuzz."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, help="for this long, half of it for each kind")
    parser.add_argument("--studies", type=int, help="so many studies")
    parser.add_argument("--files", type=int, help="so many damaged files")
    parser.add_argument("--seed", default="1")
    parser.add_argument("--save", type=Path, default=Path("build/fuzz"), help="folder for inputs that fail")
    parser.add_argument("--only", metavar="KIND:NUMBER", help="one input again, such as study:123")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        kind, first, count = given.child.split(":")
        child(kind, int(first), int(count), given.seed, given.work, given.save)
        return 0
    given.save = given.save.resolve()
    if given.only:
        kind, _, number = given.only.partition(":")
        work = given.save / "again"
        work.mkdir(parents=True, exist_ok=True)
        found = kinds()[kind](int(number), given.seed, work)  # type: ignore[operator]
        print(f"{found.kind}: {found.text}\nthe input is in {work / 'case'}")
        return int(found.kind == "FAILED")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    good = True
    seconds = given.seconds if given.seconds or given.studies or given.files else 60.0
    for kind, total in (("study", given.studies), ("file", given.files)):
        if seconds is not None or total:
            until = None if seconds is None else time.monotonic() + seconds / 2
            good &= fuzz(kind, total, until, given.seed, given.save)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
