"""Runs that are killed at random moments, again and again, end with the draws of one that never was."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dying import wait_for
from gaussian import gaussian_model
from test_kept_solves import Slow, model_of
from test_nuts import smooth_model
from zoo.core.inference import pool
from zoo.core.inference.methods import sample
from zoo.core.inference.record import RunRecord

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc"),
    pytest.mark.filterwarnings("ignore:PyTensor could not link to a BLAS:UserWarning"),
]
CHAINS: dict[str, Any] = {"tune": 600, "chains": 2, "seed": 31, "progress": False}
KILLS = {"inline": 2, "processes": 2, "nuts": 2}
"""How often a run is killed: with all chains in its process, with a process each, by other methods."""

# One process imports everything and forks each run: to import it all again takes longer than the runs.
DRIVER = """
import os, sys
sys.path.insert(0, {tests!r})
from test_kills import run
for line in sys.stdin:  # a kind asks for a run
    child = os.fork()
    if child == 0:
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        status = 0
        try:
            run(line.strip(), {folder!r} + line.strip(), slow=True)
        except BaseException as error:
            print(type(error).__name__, error, file=sys.stderr)
            status = 7
        os._exit(status)
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


def run(kind: str, folder: str | None, slow: bool = False) -> Any:
    """A run of a kind; a slow one leaves time to be killed, and tells often how far it is."""
    checkpoint: dict[str, Any] = {} if folder is None else {"checkpoint": folder}
    if slow:
        pool.SLICE_S = 0.05
    if kind == "surrogate":
        few = {"draws": 100, "tune": 100, "seed": 3, "cores": 1, "progress": False}
        return sample(model_of(Slow(0.002 * slow)), method="surrogate", **few, **checkpoint)
    if kind == "nuts":
        return sample(
            smooth_model(seconds=0.0003 * slow), method="nuts", draws=250, cores=0, **CHAINS, **checkpoint
        )
    cores = 2 if slow and kind == "processes" else 0
    return sample(gaussian_model(0.0005 * slow), draws=1500, thin=2, cores=cores, **CHAINS, **checkpoint)


def alive(group: int) -> set[int]:
    """Processes of a group that are alive."""
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, _, of_group = (folder / "stat").read_text().rpartition(")")[2].split()[:3]
            if int(of_group) == group and state != "Z":
                found.add(int(folder.name))
    return found


def written(folder: Path) -> int:
    """Bytes of all memos."""
    return sum(file.stat().st_size for file in folder.glob("*.memo"))


@pytest.mark.parametrize(
    "kills",
    [
        KILLS,
        pytest.param({"surrogate": 1}, marks=pytest.mark.nightly),  # in test_kept_solves.py too
    ],
    ids=["chains", "surrogate"],
)
def test_killed_again_and_again_the_draws_are_the_same(kills: dict[str, int], tmp_path: Path) -> None:
    """Killed up to 0.3 s after more was written; one in two with a line that is not whole."""
    rng = random.Random(20)
    code = DRIVER.format(tests=str(Path(__file__).parent), folder=str(tmp_path / "c-"))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    ways = [kind for kind, n in kills.items() for _ in range(n)]
    rng.shuffle(ways)
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
        for i, kind in enumerate(ways):
            folder = tmp_path / f"c-{kind}"
            before = written(folder)
            print(kind, file=driver.stdin, flush=True)
            child = int(driver.stdout.readline())
            wait_for(lambda folder=folder, before=before: written(folder) > before)
            time.sleep(rng.uniform(0.0, 0.3))
            os.kill(child, signal.SIGKILL)
            assert int(driver.stdout.readline()) == -signal.SIGKILL, errors.read_text()
            wait_for(lambda child=child: not alive(child))  # also chains whose parent is gone
            if i % 2:
                file = max(folder.glob("*.memo"))
                file.write_bytes(file.read_bytes()[:-7])
        driver.stdin.close()
    assert "Error" not in errors.read_text()
    whole_runs = {kind: run(kind, None) for kind in kills if kind != "processes"}
    for kind, n in kills.items():
        folder = tmp_path / f"c-{kind}"
        resumed, whole = run(kind, str(folder)), whole_runs["inline" if kind == "processes" else kind]
        assert RunRecord.of(resumed).sittings == n + 1
        for group in ("posterior", "sample_stats"):
            for name in whole[group].data_vars:
                np.testing.assert_array_equal(resumed[group][name], whole[group][name])
        assert not list(folder.glob("*.part"))
