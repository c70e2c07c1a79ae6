"""The workflows of GitHub, by the shell lines that stand in them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from test_op import small_study
from zoo.blood.study import save_study

ROOT = Path(__file__).parent.parent
WORKFLOWS = ROOT / ".github" / "workflows"
COMMAND = """#!{python}
import sys
from zoo.cli import app
from zoo.cli.options import SamplingOptions

settings = SamplingOptions.settings
SamplingOptions.settings = lambda self: {{**settings(self), "cores": 0}}
sys.argv += "{options}".split()
app()
"""
"""`zoo` with its chains in one process, which draw the same: each process of their own imports all again."""


def steps(workflow: str) -> list[dict[str, Any]]:
    """Steps of the only job of a workflow."""
    [job] = yaml.safe_load((WORKFLOWS / workflow).read_text(encoding="utf-8"))["jobs"].values()
    return list(job["steps"])


def shell(text: str, folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """A step's lines by the shell and the options that GitHub takes for them."""
    command = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", text]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def environment_value(text: str, given: dict[str, str]) -> str:
    """Of ``${{ inputs.NAME || 'DEFAULT' }}``."""
    found = re.fullmatch(r"\$\{\{ inputs\.(\w+) \|\| '([^']*)' \}\}", text)
    assert found, text
    return given.get(found[1]) or found[2]


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


@pytest.mark.slow
def test_the_comparison_of_models_is_red_on_a_worse_prior_and_green_again(tmp_path: Path) -> None:
    """The lines of model-comparison.yml for a repository that calls it, each push in a fresh checkout."""
    workflow = yaml.safe_load((WORKFLOWS / "model-comparison.yml").read_text(encoding="utf-8"))
    given = {"study": "study", "models": "A"}
    variables = {name: environment_value(text, given) for name, text in workflow["env"].items()}
    assert variables == {"STUDY": "study", "MODELS": "A", "GATES": "converged=no; waic > baseline + 2 se"}
    assert environment_value(workflow["env"]["STUDY"], {}) == "demo"
    assert given.keys() <= workflow[True]["workflow_call"]["inputs"].keys()  # YAML 1.1 reads `on` as true
    study, kept, summary = tmp_path / "study", tmp_path / "kept", tmp_path / "summary"
    save_study(replace(small_study(), priors={}), study)
    told = (study / "study.toml").read_text(encoding="utf-8")
    environment = os.environ | variables | {"GITHUB_STEP_SUMMARY": str(summary)}

    def push(name: str, priors: str = "", options: str = "") -> tuple[bool, str]:
        """Whether a push is green, and what its steps printed; what is kept passes from push to push."""
        here = tmp_path / name
        shutil.copytree(study, here / "study")
        (here / "study" / "study.toml").write_text(told + priors, encoding="utf-8")
        (here / ".venv" / "bin").mkdir(parents=True)  # in the place of `make setup`
        zoo = here / ".venv" / "bin" / "zoo"
        zoo.write_text(COMMAND.format(python=sys.executable, options=f"--seed 1 {options}"), encoding="utf-8")
        zoo.chmod(0o755)
        good, printed = True, ""
        for step in steps("model-comparison.yml"):
            uses, condition = step.get("uses", ""), step.get("if", "success()")
            if not good and condition != "always()":
                continue
            if "cache/restore" in uses and kept.is_dir():
                shutil.copytree(kept, here / step["with"]["path"])
            elif "cache/save" in uses:
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(here / step["with"]["path"], kept)
            elif "upload-artifact" in uses:
                assert all((here / path).is_file() for path in step["with"]["path"].split())
            elif "run" in step and "make setup" not in step["run"]:
                done = shell(step["run"], here, environment)
                good, printed = good and done.returncode == 0, printed + done.stdout + done.stderr
        return good, printed

    good, printed = push("first")
    assert good, printed
    assert "model A: sampled" in printed
    assert "No last good run is kept" in printed
    assert "No last good run is kept" in summary.read_text(encoding="utf-8")
    worse = "\n[priors]\nc = { uniform = [3.0, 4.0] }\n"
    good, printed = push(
        "worse", worse, "--draws 60 --tune 150"
    )  # too few, which only adds a gate that fails
    assert not good
    assert "error: small, model A: waic > baseline + 2 se" in printed
    good, printed = push("again")
    assert good, printed
    assert "model A: posterior of last-good/A.nc" in printed
    assert "gates that failed: 0 of 2" in summary.read_text(encoding="utf-8")
