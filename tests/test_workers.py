"""Jobs in processes: results, errors, and what happens when the parent is killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from zoo.core.inference.workers import each


def square(x: int) -> int:
    return x * x


def fail(x: int) -> int:
    raise ValueError(f"job {x}")


def sleep(folder: str) -> None:
    Path(folder, str(os.getpid())).touch()
    time.sleep(600)


@pytest.mark.parametrize("cores", [1, 2])
def test_every_job_is_done_once(cores: int) -> None:
    assert sorted(each(square, [3, 1, 2], cores)) == [(1, 1), (2, 4), (3, 9)]
    assert list(each(square, [], cores)) == []


@pytest.mark.parametrize("cores", [1, 2])
def test_an_error_reaches_the_caller(cores: int) -> None:
    with pytest.raises(ValueError, match="job 1"):
        list(each(fail, [1], cores))


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{pid}/stat")
    return not (status.exists() and status.read_text().rpartition(")")[2].split()[0] == "Z")


def wait_for(condition, seconds: float = 60.0) -> bool:  # type: ignore[no-untyped-def]
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return bool(condition())


def test_processes_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "from test_workers import each, sleep\n"
        "if __name__ == '__main__':\n"
        f"    list(each(sleep, [{str(tmp_path)!r}] * 4, 2))\n"
    )
    script = tmp_path.parent / f"{tmp_path.name}.py"
    script.write_text(code)
    parent = subprocess.Popen([sys.executable, str(script)])
    try:
        assert wait_for(lambda: len(list(tmp_path.iterdir())) == 2)
    finally:
        parent.send_signal(signal.SIGKILL)
        parent.wait()
    workers = [int(p.name) for p in tmp_path.iterdir()]
    assert wait_for(lambda: not any(alive(pid) for pid in workers), 10.0)


def test_a_process_whose_answer_nobody_waits_for_ends_without_a_word() -> None:
    code = """
import multiprocessing, cloudpickle
from zoo.core.inference.workers import _serve
ours, theirs = multiprocessing.Pipe()
ours.send_bytes(cloudpickle.dumps((abs, (-1,), {})))
ours.close()
_serve(theirs)
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
