"""Tasks on executors: threads, processes, and a local cluster whose workers are killed."""

from __future__ import annotations

import json
import multiprocessing as mp
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dying import Sum, add, expected, name_of
from gaussian import gaussian_model
from zoo.blood.blind import diagnose_cases, make_cases
from zoo.core.inference.cluster import SchedulerError, connect
from zoo.core.inference.sampling import sample
from zoo.core.inference.workers import TRIES, LostTaskError, each

CHEAP = ("sensor-offset", "inflow-shift", "inflow-bandwidth", "beat-jitter")
CHAINS: dict[str, Any] = {"draws": 40, "tune": 100, "chains": 3, "seed": 11, "progress": False}
SECRET = "5" * 32

pytestmark = [
    # loads and stiffness of a case are drawn, some of them beyond what is usual
    pytest.mark.filterwarnings("ignore::zoo.blood.study.UnitWarning"),
]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A scheduler and two workers, each a process with one thread that its nanny starts again."""
    distributed = pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    patient = {"distributed.deploy.lost-worker-timeout": "10 minutes"}  # a busy machine starts workers slowly
    with pytest.MonkeyPatch.context() as environment, dask.config.set(patient):
        environment.setenv("PYTHONSAFEPATH", "1")
        with distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            worker_dashboard_address=None,
        ) as local:
            yield local


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small cases, one for each worker."""
    folder = tmp_path_factory.mktemp("cluster")
    make_cases(
        folder / "cases", 2, folder / "key.json", secret=SECRET, effects=CHEAP,
        networks=("tree",), layouts=("MPA",), vessels=(3, 3), cores=1,
    )  # fmt: skip
    return folder / "cases"


@pytest.fixture(scope="module")
def alone(cases: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Their answers, one after the other in this process."""
    answers = tmp_path_factory.mktemp("alone") / "answers"
    assert diagnose_cases(cases, answers, effects=CHEAP, cores=1).failed == {}
    return answers


def content(answers: Path) -> dict[str, Any]:
    """All that the answers say, without how long it took."""

    def timeless(value: Any) -> Any:
        if isinstance(value, dict):
            return {
                k: timeless(v)
                for k, v in value.items()
                if k not in ("sha256", "record", "written") and "seconds" not in k
            }
        return [timeless(v) for v in value] if isinstance(value, list) else value

    return {str(p.relative_to(answers)): timeless(json.loads(p.read_text())) for p in answers.rglob("*.json")}


def same(one: Any, other: Any) -> None:
    """All draws and statistics of two posteriors."""
    for group in ("posterior", "sample_stats"):
        for name in other[group].data_vars:
            np.testing.assert_array_equal(one[group][name], other[group][name])


# -- tasks -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_any_executor_gives_what_a_loop_gives(kind: type[Executor], tmp_path: Path) -> None:
    tasks = [Sum(seed, str(tmp_path)) for seed in range(4)]
    settings = {"mp_context": mp.get_context("spawn")} if kind is ProcessPoolExecutor else {}
    with kind(2, **settings) as executor:  # type: ignore[call-arg]
        found = {task.seed: value for task, value in each(add, tasks, executor=executor)}
        assert executor.submit(max, 1, 2).result() == 2  # it is left open
    assert found == {seed: expected(seed) for seed in range(4)}


def test_a_process_that_dies_is_replaced(tmp_path: Path) -> None:
    """Two of six die once: every task has its result, and only those that were running run again."""
    tasks = [Sum(seed, str(tmp_path), deaths=seed in (1, 4)) for seed in range(6)]
    found = [(task.seed, value) for task, value in each(add, tasks, 2)]
    assert sorted(found) == [(seed, expected(seed)) for seed in range(6)]
    assert tasks[4].runs == 2


def test_a_task_that_always_dies_is_named(tmp_path: Path) -> None:
    tasks = [Sum(seed, str(tmp_path), deaths=99 if seed == 1 else 0) for seed in range(4)]
    with pytest.raises(
        LostTaskError, match=f"task 1: its process died {TRIES} times; what is finished is kept"
    ):
        list(each(add, tasks, 2, name=name_of))
    assert tasks[1].runs == TRIES


@pytest.mark.parametrize("kind", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_chains_on_any_executor_draw_what_they_draw_here(kind: type[Executor], tmp_path: Path) -> None:
    settings = {"mp_context": mp.get_context("spawn")} if kind is ProcessPoolExecutor else {}
    with kind(2, **settings) as executor:  # type: ignore[call-arg]
        found = sample(gaussian_model(), executor=executor, checkpoint=tmp_path / "c", until_ess=60, **CHAINS)
    same(found, sample(gaussian_model(), cores=0, until_ess=60, **CHAINS))
    again = sample(gaussian_model(), cores=0, checkpoint=tmp_path / "c", until_ess=60, **CHAINS)
    same(again, found)


# -- a cluster ---------------------------------------------------------------------------------------


def test_tasks_whose_workers_are_killed(cluster: Any, tmp_path: Path) -> None:
    """Three tasks kill their worker once, the scheduler gives them to another: nothing is lost.

    One whose value was still with a worker that another task killed is done again, for each of the two.
    """
    tasks = [Sum(seed, str(tmp_path), deaths=seed in (0, 5, 9)) for seed in range(12)]
    with connect(cluster.scheduler_address) as executor:
        found = [(task.seed, value) for task, value in each(add, tasks, executor=executor, name=name_of)]
    assert sorted(found) == [(seed, expected(seed)) for seed in range(12)]
    assert all(2 <= tasks[seed].runs <= 4 for seed in (0, 5, 9))


def test_chains_on_a_cluster_draw_what_they_draw_here(cluster: Any) -> None:
    with connect(cluster.scheduler_address) as executor:
        found = sample(gaussian_model(), executor=executor, **CHAINS)
    same(found, sample(gaussian_model(), cores=0, **CHAINS))


def test_blind_check_with_a_worker_killed_twice(
    cluster: Any, cases: Path, alone: Path, tmp_path: Path
) -> None:
    """A worker is killed as soon as it works, two times: the same answers to the last digit, none lost."""
    answers = tmp_path / "answers"
    killed: list[int] = []
    done = threading.Event()

    def kill() -> None:
        while len(killed) < 2 and not done.is_set():
            for worker in list(cluster.scheduler.workers.values()):
                pid = next(
                    (n.process.pid for n in cluster.workers.values() if n.worker_address == worker.address), 0
                )
                if worker.processing and pid and pid not in killed:
                    killed.append(pid)
                    os.kill(pid, signal.SIGKILL)
                    break
            time.sleep(0.3)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        with connect(cluster.scheduler_address) as executor:
            found = diagnose_cases(cases, answers, effects=CHEAP, executor=executor)
    finally:
        done.set()
        killer.join()
    assert len(killed) == 2
    assert (len(found.diagnosed), found.kept, found.failed) == (2, (), {})
    assert content(answers) == content(alone)


def test_what_cannot_be_reached_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zoo.core.inference.cluster.PATIENCE_S", 1)
    with pytest.raises(SchedulerError, match="no scheduler answers"), connect("tcp://127.0.0.1:9"):
        pass
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None) as empty:
        address = empty.scheduler_address
        with (
            pytest.raises(SchedulerError, match=rf"{address}: the scheduler has no worker; start some: dask"),
            connect(address),
        ):
            pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(SchedulerError, match=r"install it with: pip install 'pymc-zoo\[cluster\]'"),
        connect("tcp://h:1"),
    ):
        pass
