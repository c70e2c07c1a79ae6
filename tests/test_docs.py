"""The documents: links lead somewhere, the example study works, printed errors are real ones."""

from __future__ import annotations

import ast
import importlib
import re
import shutil
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from pydantic import BaseModel

from zoo.blood.conventions import SWITCHES
from zoo.blood.solver import STATUS_NAMES, Solver, SolverOptions
from zoo.blood.study import StudyError, load_study
from zoo.core.diagnosis import DiagnosisFile

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
EXAMPLE = ROOT / "docs" / "example-study"
DIAGNOSIS = ROOT / "docs" / "diagnosis.md"


def anchors(path: Path) -> set[str]:
    """Anchors of a document's headings, as GitHub makes them."""
    heads = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda p: p.name)
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", path.read_text(encoding="utf-8")):
        if target.startswith("http"):
            continue
        file, _, anchor = target.partition("#")
        other = (path.parent / file).resolve() if file else path
        assert other.exists(), f"{path.name}: {target}"
        if anchor:
            assert anchor in anchors(other), f"{path.name}: {target}"


def test_the_example_study_solves_and_is_what_the_study_format_shows() -> None:
    study = load_study(EXAMPLE)
    solution = Solver.for_study(study).solve(6e4, psi1=0.6, psi2=0.95, c=1.1)
    sse = ((solution.pressure_mmHg - study.values) ** 2).sum()
    assert sse == pytest.approx(1.89, abs=0.01)
    text = (ROOT / "docs" / "study-format.md").read_text(encoding="utf-8")
    shown = rf"squared errors against the {study.values.size} observed values of pressure: ([\d.]+) mmHg2"
    assert float(re.search(shown, text)[1]) == pytest.approx(sse, rel=1e-3)
    for name in ("study.toml", "network.toml"):
        for line in (EXAMPLE / name).read_text(encoding="utf-8").splitlines():
            assert line.startswith("#") or line in text, f"{name}: {line}"


def test_the_simulator_of_the_readme_gives_what_the_readme_prints(capsys: pytest.CaptureFixture[str]) -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= 120
    [(code, shown)] = re.findall(r"```python\n(import numpy.*?)```\n\n```text\n(.*?)```", readme, flags=re.S)
    lines = [line for line in code.splitlines() if line]
    assert [line for line in lines if "import" in line] == ["import numpy as np", "import zoo"]
    assert len(lines) - 2 <= 15
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})
    assert capsys.readouterr().out == shown


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda p: p.name)
def test_what_the_documents_import_exists(path: Path) -> None:
    """Snippets of Python parse, and what they import from the package is there."""
    text = path.read_text(encoding="utf-8")
    for code in re.findall(r"^```python\n(.*?)^```", text, flags=re.S | re.M):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "zoo":
                module = importlib.import_module(str(node.module))
                for alias in node.names:
                    assert alias.name == "*" or hasattr(module, alias.name), f"{node.module}.{alias.name}"


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda p: p.name)
def test_modules_and_names_in_the_documents_exist(path: Path) -> None:
    """Such as `zoo.core.op.ForwardOp`."""
    for name in set(re.findall(r"`(zoo(?!\.h\b)(?:\.\w+)+)", path.read_text(encoding="utf-8"))):
        parts = name.split(".")
        if parts[-1] in ("effects",) and len(parts) == 2:  # the group of entry points
            continue
        found: object = importlib.import_module("zoo")
        for i, part in enumerate(parts[1:], 2):
            if not hasattr(found, part):
                importlib.import_module(".".join(parts[:i]))
            found = getattr(found, part)


# file, what is replaced, and by what; the errors stand in docs/study-format.md
FAULTS = [
    ("network.toml", "radius_cm = 0.032", "radius_cm = -0.032"),
    ("network.toml", "length_cm = 0.44", "lenght_cm = 0.44"),
    ("network.toml", "parent = 1", "parent = 7"),
    ("inflow.csv", "flow_ml_s", "flow"),
    ("study.toml", "period_s = 0.11", "period_s = 0.12"),
    ("study.toml", "inflow.csv", "flow.csv"),
    ("study.toml", '"printed"', '"publishd-code"'),
    ("study.toml", 'observations = "observations.csv"\n', ""),
    ("observations.csv", ",12.1", ",nan"),
    ("observations.csv", "1,0,pressure_mmHg,0.005", "9,0,pressure_mmHg,0.005"),
    ("observations.csv", "pressure_mmHg", "pressure_mmhg"),
    ("observations.csv", ",0.105,", ",0.115,"),
]


@pytest.mark.parametrize(("file", "old", "new"), FAULTS)
def test_the_errors_in_the_documents_are_real(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str, old: str, new: str
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(EXAMPLE, "my-study")
    path = Path("my-study", file)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(StudyError) as error:
        load_study("my-study")
    assert str(error.value) in (ROOT / "docs" / "study-format.md").read_text(encoding="utf-8").splitlines()


@pytest.mark.parametrize("tree", ["core", "blood"])
def test_the_architecture_has_a_place_for_every_room(tree: str) -> None:
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    [row] = [line for line in text.splitlines() if line.startswith(f"| `zoo.{tree}` |")]
    rooms = {path.stem for path in (ROOT / "src" / "zoo" / tree).iterdir() if not path.name.startswith("_")}
    assert rooms == set(re.findall(r"`(\w+)`", row))


def test_documents_know_every_switch_and_status() -> None:
    conventions = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    study_format = (ROOT / "docs" / "study-format.md").read_text(encoding="utf-8")
    numerics = (ROOT / "docs" / "numerics.md").read_text(encoding="utf-8")
    for switch in SWITCHES:
        assert f"| `{switch}`" in conventions
        assert f"| `{switch}`" in study_format
    for code, name in STATUS_NAMES.items():
        assert f"| {code} | `{name}` |" in numerics


def test_the_network_with_all_of_the_physics_solves(tmp_path: Path) -> None:
    """What docs/study-format.md shows as complete: tables and fields of walls, outlets and pressures."""
    text = (ROOT / "docs" / "study-format.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", text, flags=re.S)
    [network] = [code for code in blocks if "[surroundings]" in code]
    (tmp_path / "network.toml").write_text(network, encoding="utf-8")
    (tmp_path / "study.toml").write_text(
        'name = "x"\nnetwork = "network.toml"\ninflow = "inflow.csv"\nperiod_s = 1.0\n', encoding="utf-8"
    )
    rows = [f"{m / 20},{20 if 2 <= m <= 6 else 4}" for m in range(20)]
    (tmp_path / "inflow.csv").write_text("\n".join(["time_s,flow_ml_s", *rows]), encoding="utf-8")
    study = load_study(tmp_path)
    assert study.physics.keys() == {"junction_pressure", "outflow_pressure_mmHg", "radius_pressure_mmHg"}
    solver = Solver.for_study(
        study, series=[(1, 0.0), (3, 1.0)], times_s=[0.0], options=SolverOptions(dx_cm=0.2)
    )
    solution = solver.solve(solver.network.stiffness_in)
    pressure, flow = solution.pressure_mmHg[1, 0], solution.flow_ml_s[1, 0]
    assert pressure == pytest.approx(8 + 31700 * flow / 1333.22, rel=1e-6)


# ---------------------------------------------------------------------------------------------------
# docs/diagnosis.md


def fields(model: type[BaseModel]) -> set[str]:
    """Names of a model's fields and of those inside it, as the file of a study with pressures has them."""
    found = set()
    for name, field in model.model_fields.items():
        if field.exclude:
            continue
        found.add("vessel" if name == "part" else name + "_mmHg" * (name in getattr(model, "amounts", ())))
        kinds = [field.annotation]
        while kinds:
            kind = kinds.pop()
            kinds += get_args(kind)
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                found |= fields(kind)
    return found


def test_every_field_of_a_diagnosis_is_documented() -> None:
    words = set(re.findall(r"`([\w.]+)`", DIAGNOSIS.read_text(encoding="utf-8")))
    words |= {
        word.removesuffix("_mmHg") for word in words
    }  # amounts of one series have no unit in their name
    assert fields(DiagnosisFile) <= words


def stated(value: object) -> str:
    """A constant as the document has it."""
    if isinstance(value, np.ndarray) and np.allclose(value, np.geomspace(value[0], value[-1], len(value))):
        return f"{value[0]:g} to {value[-1]:g} in {len(value)} steps of the logarithm"
    return ", ".join(f"{x:g}" for x in (value if isinstance(value, tuple) else (value,)))


def constants(path: Path) -> dict[tuple[str, str], str]:
    """(Module, name) of every number that a module names, as the document has it."""
    module = importlib.import_module(".".join(path.relative_to(ROOT / "src").with_suffix("").parts))
    found = {}
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or "range(5)" in ast.unparse(node):
            continue
        for one in ast.walk(node.targets[0] if isinstance(node, ast.Assign) else node.target):
            name = getattr(one, "id", "")
            value = getattr(module, name, None)
            numbers = value if isinstance(value, tuple | np.ndarray) else (value,)
            if name.isupper() and name != "FORMAT" and all(isinstance(x, int | float) for x in numbers):
                of = "causes." * (path.parent.name == "causes") + path.stem
                found[of, name] = stated(value)
    return found


def test_every_constant_of_a_diagnosis_is_documented_with_its_value() -> None:
    told = {}
    name = r"`[A-Z_]+`(?:, `[A-Z_]+`)*"
    for line in DIAGNOSIS.read_text(encoding="utf-8").splitlines():
        row = re.fullmatch(
            rf"\| `(?P<module>[\w.]+)` \| (?P<names>{name}) \| (?P<values>[^|]+) \| .{{10,}} \|", line
        ) or re.fullmatch(
            rf"\| (?P<names>{name}) \| (?P<values>[^|]+) \| `(?P<module>[\w.]+)` \| .{{10,}} \|", line
        )
        if row:
            names = row["names"].split(", ")
            values = row["values"].split("; ") if len(names) > 1 else [row["values"]]
            told |= {(row["module"], n.strip("`")): v for n, v in zip(names, values, strict=True)}
    rooms = [sorted((ROOT / "src" / "zoo" / "core" / room).glob("*.py")) for room in ("causes", "diagnosis")]
    sources = [*rooms[0], *rooms[1], ROOT / "src" / "zoo" / "blood" / "study_diagnosis.py"]
    assert told == {key: value for path in sources for key, value in constants(path).items()}
