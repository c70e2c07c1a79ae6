"""The package as others get it: built in isolation, installed with its dependencies, and no compiler there.

Three minutes of a processor, most of them pip's, and an index of packages is needed: run by `make installed`
and, on both lines of PyMC, by `make nightly`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
LOCK = ROOT / ("requirements-py313.lock" if sys.version_info >= (3, 12) else "requirements.lock")
SHORT = ("--method", "exact", "--draws", "8", "--tune", "8", "--chains", "2")


def output(*command: str | Path, cwd: Path, path: str | None = None) -> str:
    """What a command prints where nothing of this checkout is found; it has to end well."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= {"PIP_CONSTRAINT": str(LOCK)} | ({} if path is None else {"PATH": path})
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the source distribution and the wheel of it, each built in an environment of its own."""
    folder = tmp_path_factory.mktemp("dist")
    output(sys.executable, "-m", "build", "--outdir", folder, ".", cwd=ROOT)
    return folder


def test_a_wheel_and_its_dependencies_work_in_an_empty_environment(built: Path, tmp_path: Path) -> None:
    [wheel] = built.glob("pymc_zoo-*.whl")
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    output(python, "-m", "pip", "install", "--quiet", "--only-binary", ":all:", wheel, cwd=tmp_path)
    output(python, "-m", "pip", "check", cwd=tmp_path)

    def zoo(*words: str) -> str:
        """Where no compiler is found."""
        return output(python.parent / "zoo", *words, cwd=tmp_path, path=str(python.parent))

    assert '"cxx_compiler": null' in zoo("doctor", "--json")
    assert "systolic 23.07, diastolic 11.02" in zoo("simulate", "demo", "--stiffness", "5.17e4")
    zoo("sample", "A", "demo", *SHORT)
    found = output(python, "-c", "import zoo; print(zoo.__file__)", cwd=tmp_path)
    assert found.startswith(str(tmp_path))


def test_what_is_built_in_isolation_has_the_compiled_code(built: Path) -> None:
    """The wheel is made of the source distribution, so that all of the C code is in that."""
    [archive] = built.glob("pymc_zoo-*.tar.gz")
    with tarfile.open(archive) as found:
        names = {name.partition("/")[2] for name in found.getnames()}
    assert {f"native/src/{file.name}" for file in (ROOT / "native" / "src").glob("*.c")} <= names
