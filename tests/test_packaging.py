"""The wheel is tagged for what it is: one extension for every Python from the oldest that is allowed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
from importlib.machinery import EXTENSION_SUFFIXES
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import zoo
from zoo.core.arviz_lines import ARVIZ_1

ROOT = Path(__file__).parent.parent
SHORT = ("--method", "exact", "--draws", "8", "--tune", "8", "--chains", "2")
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


@pytest.mark.parametrize(
    ("lock", "python"), [("requirements.lock", "3.11"), ("requirements-py313.lock", "3.13")]
)
def test_a_lock_file_has_a_version_of_all_that_a_line_needs_and_may_have(lock: str, python: str) -> None:
    lines = (ROOT / lock).read_text(encoding="utf-8").splitlines()
    pinned = (line.split("==") for line in lines if not line.startswith("#"))
    locked = {canonicalize_name(name): version for name, version in pinned}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for text in chain(project["dependencies"], *project["optional-dependencies"].values()):
        needed = Requirement(text)
        asked = needed.marker is None or needed.marker.evaluate({"python_version": python})
        if asked and needed.name != project["name"]:
            assert needed.specifier.contains(locked[canonicalize_name(needed.name)]), needed


@pytest.mark.skipif(".abi3.so" not in EXTENSION_SUFFIXES, reason="no stable interface on this platform")
def test_the_wheel_is_tagged_for_the_stable_interface_of_the_oldest_python() -> None:
    oldest = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
        "requires-python"
    ]
    wanted = "cp" + oldest.removeprefix(">=").replace(".", "") + "-abi3"
    command = [sys.executable, "-W", "ignore", "-c", TAG_OF]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == wanted


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the source distribution and the wheel of it; `.ci/run` has one for both lines."""
    folder = Path(os.environ.get("ZOO_DIST") or tmp_path_factory.mktemp("dist"))
    if any(folder.glob("*.whl")):
        return folder
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), "."]
    subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return folder


def test_the_source_distribution_has_the_models_as_files_and_what_a_build_needs(built: Path) -> None:
    """`src/zoo/models` is a link here, which an archive of links alone would leave pointing at nothing."""
    [archive] = built.glob("pymc_zoo-*.tar.gz")
    with tarfile.open(archive) as found:
        members = {one.name.partition("/")[2]: one for one in found.getmembers()}
    needed = ("src/zoo/models/model_g.py", "models/model_g.py", "native/build_ffi.py", "native/src/solve.c")
    named = ("LICENSE", "CHANGELOG.md", "CITATION.cff", "Makefile", "requirements.lock", "examples/tanks.py")
    for name in (*needed, *named):
        assert members[name].isreg(), name


def test_a_wheel_works_without_the_checkout(built: Path, tmp_path: Path) -> None:
    """In an environment of its own; the libraries are those that are here."""
    [wheel] = built.glob("pymc_zoo-*-abi3-*.whl")
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    install = [python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", wheel]
    environment = os.environ | {"PYTHONPATH": sysconfig.get_path("purelib")}  # .pth files are not read there

    def output(*command: str | Path) -> str:
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, env=environment, check=False
        )
        assert done.returncode == 0, done.stderr
        assert "warn" not in done.stderr.lower()
        return done.stdout

    output(*install)
    assert output(python, "-c", "import zoo; print(zoo.__file__)").startswith(str(tmp_path))
    environment["PATH"] = str(python.parent)  # where no compiler is
    waves = output(python.parent / "zoo", "simulate", "demo", "--stiffness", "5.17e4")
    assert "systolic 23.07, diastolic 11.02" in waves
    output(python, "-W", "error", "-c", "from zoo import load_study, model_G; model_G(load_study('demo'))")
    output(python.parent / "zoo", "sample", "A", "demo", *SHORT)


def test_what_is_said_of_the_package_is_of_one_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    described = json.loads((ROOT / "codemeta.json").read_text(encoding="utf-8"))
    cited = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert described["version"] == zoo.__version__
    assert f"version: {zoo.__version__}" in cited
    assert described["datePublished"] in cited
    assert described["license"].endswith(project["license"])


def _where_arviz_was_never_imported(folder: Path, *command: str) -> str:
    """What a command prints where ArviZ has yet to say its words of the day; it has to end well."""
    environment = os.environ | {"XDG_CACHE_HOME": str(folder)}
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="where a cache is found elsewhere is not looked into")
def test_the_tests_and_the_command_run_on_a_machine_that_never_imported_arviz(tmp_path: Path) -> None:
    """It warns of ArviZ 1 on its first import of a day, and the tests take such a warning for an error."""
    tests = ("-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider", "tests/test_groups.py")
    first = tmp_path / "tests"
    _where_arviz_was_never_imported(first, *tests)
    assert ARVIZ_1 or (first / "arviz" / "daily_warning").is_file()
    second = tmp_path / "command"
    said = _where_arviz_was_never_imported(second, "-m", "zoo", "priors", "demo")
    assert ARVIZ_1 or (second / "arviz" / "daily_warning").is_file()
    assert "ArviZ" not in said
