"""The order of the modules: each imports only from those before it."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import zoo
import zoo.models

ORDER = (
    "units conventions fetch study network _native solver effects op likelihood models results steps "
    "mode progress workers chains sampling posteriors comparison synthetic calibration coverage predictive "
    "discrepancy screening confirm diagnosis blind plots reproduce report cli"
).split()
ONLY = {"matplotlib": {"plots"}, "zoo._native": {"solver"}, "zoo.cli": set()}
SOURCES = {p.stem: p for p in Path(zoo.__file__).parent.glob("*.py") if p.stem != "__init__"}
SOURCES |= {f"models/{p.stem}": p for p in Path(zoo.models.__file__).parent.glob("*.py")}


def imports(path: Path) -> set[str]:
    """Dotted names of what a file imports anywhere, also inside functions and for type checking."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: import by the full name"
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= inner if node.module in ("zoo", "zoo.models") else {str(node.module)}
    return found


def test_the_import_reader_sees_every_form(tmp_path: Path) -> None:
    path = tmp_path / "x.py"
    path.write_text("import zoo.cli\nfrom zoo import op\ndef f():\n    from zoo.blood.study import Study\n")
    assert imports(path) == {"zoo.cli", "zoo.blood.op", "zoo.blood.study"}


@pytest.mark.parametrize("name", sorted(SOURCES))
def test_imports_only_from_modules_before_it(name: str) -> None:
    own = name.split("/")[0]
    assert own in ORDER, f"{own} has no place in the order yet"
    for module in imports(SOURCES[name]):
        top, _, rest = module.partition(".")
        if top == "zoo" and rest:
            used = rest.split(".")[0]
            inside = own == used == "models"
            assert inside or ORDER.index(used) < ORDER.index(own), f"{name} imports {module}"
        for guarded, allowed in ONLY.items():
            assert own in allowed or not (module + ".").startswith(guarded + "."), f"{name} imports {module}"


def test_import_is_cheap() -> None:
    """A model and load_study, without what makes importing slow."""
    code = (
        "import sys; from zoo import load_study, model_A\n"
        "heavy = {'pymc', 'pytensor', 'arviz', 'matplotlib', 'scipy', 'pandas', 'xarray', 'pooch'}\n"
        "print(sorted(heavy & set(sys.modules)), model_A.__name__, load_study.__module__)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[] model_A zoo.blood.study"


def test_every_export_exists() -> None:
    for name in zoo.__all__:
        assert getattr(zoo, name) is not None
        assert name in dir(zoo)
    with pytest.raises(AttributeError, match="no attribute 'model_Z'"):
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
