"""The workflows of GitHub, by the shell lines that stand in them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parent.parent
WORKFLOWS = ROOT / ".github" / "workflows"


def steps(workflow: str) -> list[dict[str, Any]]:
    """Steps of the only job of a workflow."""
    [job] = yaml.safe_load((WORKFLOWS / workflow).read_text(encoding="utf-8"))["jobs"].values()
    return list(job["steps"])


def shell(text: str, folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """A step's lines by the shell and the options that GitHub takes for them."""
    command = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", text]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("data", "chosen"), [(None, False), ("/elsewhere/data", True)])
def test_tests_that_need_data_are_chosen_where_the_data_are(
    data: str | None, chosen: bool, tmp_path: Path
) -> None:
    [line] = [step["run"] for step in steps("tests.yml") if "run" in step]
    (tmp_path / ".ci").mkdir()
    file = f"--rootdir {ROOT} {ROOT}/tests/test_fetch.py"
    collect = f"{sys.executable} -m pytest -m 'not slow' --collect-only -q {file}"
    (tmp_path / ".ci" / "run").write_text(collect, encoding="utf-8")
    environment = {name: value for name, value in os.environ.items() if name != "ZOO_DATA_DIR"}
    done = shell(line, tmp_path, environment | ({"ZOO_DATA_DIR": data} if data else {}))
    assert done.returncode == 0, done.stdout + done.stderr
    assert ("test_the_measured_data" in done.stdout) is chosen
    assert "test_downloaded_once" in done.stdout
