"""The rooms and what each may know: the contracts of pyproject.toml, and what they cannot see."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import zoo
import zoo.models

ROOT = Path(__file__).parents[1]
LAZY = {"zoo/__init__.py", "zoo/models/__init__.py"}
"""The doors, which load a module when it is asked for."""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the package as it is installed, the models in their place."""
    folder = tmp_path_factory.mktemp("package")
    command = [sys.executable, "setup.py", "-q", "build_py", "--build-lib", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return folder


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    """The contracts on the package in a folder."""
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()"]
    command += ["--config", str(ROOT / "pyproject.toml"), "--no-cache", "--no-logo"]
    environment = os.environ | {"PYTHONPATH": str(folder), "COLUMNS": "200"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


def test_every_contract_is_kept(package: Path) -> None:
    done = lint(package)
    assert done.returncode == 0, done.stdout + done.stderr


BREAKS = [
    ("core/data.py", "import zoo.blood.units", "core-alone"),
    ("core/inference/mode.py", "from zoo.report import page", "core-alone"),
    ("core/inference/record.py", "from zoo.core.posterior import storage", "core-rooms"),
    ("core/weather.py", "", "core-rooms"),  # a module without a place
    ("blood/units.py", "def f():\n    from zoo.blood.solver import Solver", "blood-rooms"),
    ("blood/study/study.py", "from zoo.models import model_a", "models"),
    ("models/model_a.py", "from zoo.report import page", "house"),
    ("models/model_b.py", "from zoo.cli import app", "cli"),
    ("report/page.py", "import matplotlib.pyplot", "matplotlib"),
    ("report/filters.py", "from zoo.report import chapter", "cycles"),
]


def test_contracts_fail_on_a_copy_that_breaks_each(package: Path, tmp_path: Path) -> None:
    shutil.copytree(package / "zoo", tmp_path / "zoo")
    for file, line, _ in BREAKS:
        with (tmp_path / "zoo" / file).open("a", encoding="utf-8") as text:
            text.write(f"\n{line}\n")
    done = lint(tmp_path)
    assert done.returncode == 1, done.stdout + done.stderr
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    told = done.stdout.partition("Broken contracts")[2]
    for contract in contracts:
        _, _, said = told.partition(f"\n{contract['name']}\n---")
        said = re.split(r"\n\n[^\n]+\n-{4,}\n", said)[0]
        modules = [
            file.removesuffix(".py").rpartition("/")[2] for file, _, id in BREAKS if id == contract["id"]
        ]
        assert modules, f"{contract['id']}: nothing breaks it here"
        for module in modules:
            assert module in said, f"{contract['id']}: {said}"


def named_modules(path: Path) -> set[str]:
    """Modules of the package that a file names in a string that is not a docstring."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    strings = (n for n in ast.walk(tree) if isinstance(n, ast.Constant) and id(n) not in prose)
    return {n.value for n in strings if isinstance(n.value, str) and re.match(r"zoo(\.\w+)+[:\w]*$", n.value)}


def native_imports(path: Path) -> list[int]:
    """Lines that import the compiled solver."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: import by the full name"
            names = [f"{node.module}.{alias.name}" for alias in node.names] + [str(node.module)]
        else:
            continue
        found += [node.lineno for name in names if (name + ".").startswith("zoo._native.")]
    return found


def test_readers_see_every_form(tmp_path: Path) -> None:
    path = tmp_path / "x.py"
    lines = [
        "from zoo import _native",
        "import zoo._native as c",
        "from zoo._native import lib",
        "import zoo",
    ]
    lines += [
        '"""zoo.plots"""',
        'import_module("zoo.plots")',
        'HOME = "zoo.blood.effects:ALL"',
        's = "zoo fetch"',
    ]
    path.write_text("\n".join(lines))
    assert sorted(set(native_imports(path))) == [1, 2, 3]
    assert named_modules(path) == {"zoo.plots", "zoo.blood.effects:ALL"}


def test_no_module_is_named_in_a_string(package: Path) -> None:
    """The contracts do not see an import by such a name. A module may name itself and its package."""
    modules = {}
    for path in sorted(package.rglob("*.py")):
        file = path.relative_to(package).as_posix()
        modules[file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")] = file, path
    for own, (file, path) in modules.items():
        named = {name.partition(":")[0] for name in named_modules(path)} & set(modules)
        named = {name for name in named if not (own + ".").startswith(name + ".")}
        assert file in LAZY or not named, f"{file} names {named} in strings: import them"


def test_only_the_solver_imports_the_compiled_core(package: Path) -> None:
    users = {p.relative_to(package).as_posix() for p in package.rglob("*.py") if native_imports(p)}
    assert users == {"zoo/blood/solver.py"}


@pytest.mark.parametrize(
    ("name", "also"),
    [("load_study", {"scipy", "pandas", "xarray", "pooch"}), ("model_A", {"pandas", "xarray"})],
)
def test_import_is_cheap(name: str, also: set[str]) -> None:
    """A name is loaded without what makes importing slow, and importing the package loads no name."""
    code = (
        f"import sys, zoo; modules = set(sys.modules); zoo.{name}\n"
        f"heavy = {{'pymc', 'pytensor', 'arviz', 'matplotlib'}} | {also}\n"
        f"print(sorted(heavy & set(sys.modules)), zoo.{name}.__name__, 'numpy' in modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"[] {name} False"


def test_every_export_exists() -> None:
    for name in zoo.__all__:
        assert getattr(zoo, name) is not None
        assert name in dir(zoo)
    with pytest.raises(AttributeError, match="attribute model_Z"):
        zoo.model_Z  # noqa: B018


def test_models_refuse_a_second_name() -> None:
    """`import models` from the project's root would make a second copy of the package's models."""
    root = Path(zoo.models.__file__).parents[1]
    environment = os.environ | {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", "import models"], capture_output=True, text=True, env=environment
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("ImportError: the models were imported as 'models'")


@pytest.mark.parametrize("path", sorted(Path(zoo.__file__).parent.glob("core/**/*.py")), ids=str)
def test_the_core_does_not_go_through_the_packages_door(path: Path) -> None:
    """`zoo.load_study` or `from zoo import diagnose` would load blood where no contract sees it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            assert "zoo" not in {alias.name for alias in node.names}, f"{path}:{node.lineno}"
        elif isinstance(node, ast.ImportFrom):
            assert node.module != "zoo", f"{path}:{node.lineno}"
