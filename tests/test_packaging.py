"""The wheel is tagged for what it is: one extension for every Python from the oldest that is allowed."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TAG_OF = """
import sys
from distutils.core import run_setup
sys.argv = ["setup.py"]
import setuptools
distribution = run_setup("setup.py", stop_after="init")
command = distribution.get_command_obj("bdist_wheel")
command.ensure_finalized()
print("-".join(command.get_tag()[:2]))
"""


@pytest.mark.skipif(".abi3.so" not in EXTENSION_SUFFIXES, reason="no stable interface on this platform")
def test_the_wheel_is_tagged_for_the_stable_interface_of_the_oldest_python() -> None:
    oldest = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "requires-python"
    ]
    wanted = "cp" + oldest.removeprefix(">=").replace(".", "") + "-abi3"
    command = [sys.executable, "-W", "ignore", "-c", TAG_OF]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == wanted
