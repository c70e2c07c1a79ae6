"""Runs that are killed at random moments, again and again, end with the draws of one that never was."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from gaussian import gaussian_model
from zoo.core.inference.record import RunRecord
from zoo.core.inference.sampling import sample

pytestmark = [
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc"),
    pytest.mark.filterwarnings("ignore:PyTensor could not link to a BLAS:UserWarning"),
]
SETTINGS = {"draws": 3000, "tune": 1200, "chains": 2, "thin": 2, "seed": 31, "progress": False}
KILLS = {"run": 16, "chain": 2, "group": 2, "parent": 2}
"""Of a run that draws all chains in its own process, of a chain's process, of all together, of the parent."""

# One process imports everything and forks each run: to import it all again takes longer than the runs.
DRIVER = """
import os, sys
sys.path.insert(0, {tests!r})
from gaussian import gaussian_model
from test_kills import SETTINGS
from zoo.core.inference.sampling import sample
model = gaussian_model(seconds=0.0005)
for line in sys.stdin:  # a number of cores asks for a run
    child = os.fork()
    if child == 0:
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        status = 0
        try:
            sample(model, cores=int(line), checkpoint={folder!r}, checkpoint_seconds=0.02, **SETTINGS)
        except BaseException as error:
            print(type(error).__name__, error, file=sys.stderr)
            status = 7
        os._exit(status)
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


def alive(group: int) -> set[int]:
    """Processes of a group that are alive."""
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, _, of_group = (folder / "stat").read_text().rpartition(")")[2].split()[:3]
            if int(of_group) == group and state != "Z":
                found.add(int(folder.name))
    return found


def written(folder: Path) -> dict[str, int]:
    """When each chain's checkpoint was written."""
    found = {}
    for file in folder.glob("chain-*.state"):
        with contextlib.suppress(FileNotFoundError):
            found[file.name] = file.stat().st_mtime_ns
    return found


def wait_for(condition, seconds: float = 300.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.005)


def kill(how: str, run: int, rng: random.Random) -> None:
    if how == "group":
        os.killpg(run, signal.SIGKILL)
    elif how == "chain":
        os.kill(rng.choice(sorted(alive(run) - {run})), signal.SIGKILL)
    else:
        os.kill(run, signal.SIGKILL)


def test_killed_again_and_again_the_draws_are_the_same(tmp_path: Path) -> None:
    """One kill in five comes before the run has written anything, most of the others up to 0.15 s after."""
    folder, rng = tmp_path / "checkpoint", random.Random(20)
    code = DRIVER.format(tests=str(Path(__file__).parent), folder=str(folder))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    ways = [how for how, n in KILLS.items() for _ in range(n)]
    rng.shuffle(ways)
    survived: Counter[str] = Counter()
    errors = tmp_path / "errors"
    with (
        open(errors, "w") as sink,
        subprocess.Popen(
            [sys.executable, "-P", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=sink, env=environment, text=True,
        ) as driver,
    ):  # fmt: skip
        assert driver.stdin is not None
        assert driver.stdout is not None
        for how in ways:
            before = written(folder)
            print(0 if how == "run" else 2, file=driver.stdin, flush=True)
            run = int(driver.stdout.readline())
            if how == "chain" or rng.random() < 0.8:
                wait_for(lambda before=before: written(folder) != before)
            time.sleep(rng.uniform(0.0, 0.15))
            kill(how, run, rng)
            status = int(driver.stdout.readline())
            assert status == (7 if how == "chain" else -signal.SIGKILL), errors.read_text()
            wait_for(lambda run=run: not alive(run))  # also chains whose parent is gone
            survived[how] += 1
        driver.stdin.close()
    assert survived == KILLS
    assert survived.total() >= 20
    assert errors.read_text().count("its process ended unexpectedly (signal 9") == KILLS["chain"]
    assert "CheckpointError" not in errors.read_text()
    resumed = sample(gaussian_model(), cores=0, checkpoint=folder, **SETTINGS)
    whole = sample(gaussian_model(), cores=0, **SETTINGS)
    assert RunRecord.of(resumed).sittings > 20
    for group in ("posterior", "sample_stats"):
        for name in whole[group].data_vars:
            np.testing.assert_array_equal(resumed[group][name], whole[group][name])
    assert not list(folder.glob("*.part"))
