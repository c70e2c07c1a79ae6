"""What users import from `zoo`: known to type checkers, like the commands, and enough for the documents."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

import zoo
from zoo.cli import app

ROOT = Path(__file__).resolve().parents[1]

SCRIPT = """
from typing import Any
import numpy as np
import zoo

t = np.arange(0.0, 60.0, 0.5)
bounds, bell, decades = zoo.Uniform(0, 1), zoo.Normal(0, 1, low=-2), zoo.LogUniform(0.1, 10)
positive, heavy = zoo.LogNormal(centre=1, spread=0.5), zoo.InverseGamma(3, 2)
priors: list[zoo.Prior] = [bell, decades, positive, heavy, zoo.Population("m", "v")]
k = zoo.Parameter("k", bounds, "1/s", log=True)

def simulate(parameters: dict[str, Any], times: Any) -> Any:
    if parameters["k"] < 0:
        raise zoo.SolveError("k is below 0", kind="sign")
    return np.exp(-parameters["k"] * times) + parameters["lag"](times)

@zoo.effect(name="leak", unit="1/s", size=0.1, low=0, locations=lambda model: (zoo.Location("lid"),))
def leak(parameters: dict[str, Any], size: float, location: zoo.Location) -> dict[str, Any]:
    return {**parameters, "k": parameters["k"] + size}

slow = zoo.Effect("slow", (zoo.EffectParameter("a", "1", 1.0, 0.0, 2.0, starts=(1.0,)),), None)
lag = zoo.free_function("lag", along="time", size=0.1, along_unit="s")
held = {"again": (t, np.cos(t), simulate)}
found = zoo.diagnose(t, np.sin(t), simulate, {"k": k}, [leak, slow, lag], period=60.0, held_out=held)
print(found.file.verdict, zoo.diagnose({**held, "b": held["again"]}, {"k": k}, [leak], share=["k"]))
data = zoo.Data(t, np.sin(t), labels=["y"], units=["V"])
model = zoo.FunctionModel(simulate, (k,), zoo.Outputs(("y",), t))
print(zoo.diagnose(data, model, [leak], errors=zoo.Cosines(), seed=2), zoo.from_pints(object(), t, [k]))
def draw(cause: str, rng: np.random.Generator) -> zoo.DrawnCase:
    return zoo.DrawnCase(data, {"size": 1.0})
print(zoo.blind_check(draw, lambda data: zoo.diagnose(data, model, [leak]), {"leak": 3}, listed=["leak"]))
print(zoo.fetch_dataset("mouse-c6"), zoo.list_studies(), zoo.LogPopulation("m", "v"))
study = zoo.import_table("vessels.csv", "inflow.csv", 0.8, name="own").study
zoo.save_study(zoo.import_openbf("tree.yaml").study, "copy")
waves = zoo.Solver.for_study(zoo.load_study("copy"), "linear").solve(stiffness=1e5, psi1=0.5)
first, *others = zoo.model_A, zoo.model_B, zoo.model_C, zoo.model_D, zoo.model_E, zoo.model_F, zoo.model_G
models = {str(i): make(study, effects=["taper"]) for i, make in enumerate([zoo.model_H, zoo.model_I])}
posteriors = {name: zoo.sample(model, draws=10, seed=1) for name, model in models.items()}
print(zoo.compare(posteriors, models, ic="loo")["loo"], zoo.find_mode(first(study)).values, waves.ok)
zoo.diagnose(study, base="B", effects=["taper"], cores=1).plot().savefig("gap.png")
print(zoo.diagnose([study, "demo"], base="B", share=["c"]).causes[0].probability)
print(zoo.diagnose("demo").study.name, zoo.read_diagnosis("gap").verdict, zoo.step(models["0"]), others)
"""
NAMES = """
Data Parameter Uniform Normal LogUniform LogNormal InverseGamma Population LogPopulation Prior FunctionModel
from_pints SolveError Effect EffectParameter effect free_function Location diagnose read_diagnosis blind_check
sample step find_mode compare load_study save_study list_studies import_openbf import_table fetch_dataset
Solver model_A model_B model_C model_D model_E model_F model_G model_H model_I
""".split()
MISSPELT = """
import zoo

study = zoo.load_study("demo")
model = zoo.model_G(study, efects=["taper"])
zoo.sample(model, drws=100)
zoo.Parameter("k", zoo.Uniform(0, 1), units="1/s")
zoo.diagnose(study, bse="B")
zoo.diagnose(study).plot().savefg("gap.png")
zoo.diagnose([study, study], shared=["c"])
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], list[str]]:
    """What mypy says of each of three files in a folder of a user's own."""
    folder = tmp_path_factory.mktemp("user")
    kinds = "import zoo\n" + "".join(f"reveal_type(zoo.{name})\n" for name in zoo.__all__)
    files = {"script": SCRIPT, "misspelt": MISSPELT, "kinds": kinds}
    for name, text in files.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--no-incremental", "."]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    lines = done.stdout.splitlines()
    assert len(lines) > len(zoo.__all__), done.stdout + done.stderr
    return lambda name: [line for line in lines if line.startswith(f"{name}.py:")]


def test_a_script_of_every_public_name_is_typed(said: Callable[[str], list[str]]) -> None:
    assert len([line for line in SCRIPT.splitlines() if line]) <= 45
    assert set(NAMES) <= set(re.findall(r"zoo\.(\w+)", SCRIPT))
    assert set(NAMES) <= set(zoo.__all__)
    assert said("script") == []


def test_misspelt_keywords_are_errors_of_types(said: Callable[[str], list[str]]) -> None:
    told = "\n".join(said("misspelt"))
    for line, name in ((5, "efects"), (6, "drws"), (7, "units")):
        assert re.search(rf'misspelt.py:{line}: error: Unexpected keyword argument "{name}"', told), told
    assert 'misspelt.py:9: error: "Figure" has no attribute "savefg"' in told
    for line in (8, 10):
        assert f'misspelt.py:{line}: error: No overload variant of "diagnose" matches' in told


def test_no_public_name_is_of_unknown_type(said: Callable[[str], list[str]]) -> None:
    """A name that mypy cannot find would be Any, and any keyword of it right."""
    shown = [line for line in said("kinds") if "Revealed type" in line]
    assert len(shown) == len(zoo.__all__)
    assert [line for line in shown if line.endswith('is "Any"')] == []


def test_the_help_of_a_model_tells_what_can_be_given() -> None:
    told = inspect.getdoc(zoo.model_G) or ""
    assert told.startswith("Model G: linear wall")
    for name in inspect.signature(zoo.model_G).parameters:
        assert re.search(rf"^{name} : ", told, flags=re.M), name


def test_the_help_of_a_diagnosis_tells_what_can_be_given() -> None:
    shown = inspect.signature(zoo.diagnose).parameters
    assert list(shown)[:5] == ["times", "measured", "simulate", "priors", "effects"]
    told = inspect.getdoc(zoo.diagnose) or ""
    for name in shown:
        assert re.search(rf"^({name}|\w+, {name})\b.* : ", told, flags=re.M), name


def test_what_is_printed_of_a_public_object_is_short() -> None:
    study = zoo.load_study("demo")
    flow, solver = zoo.get_baseline("B").forward(study), zoo.Solver.for_study(study)
    case = flow.configure(zoo.pack(flow.parameters, zoo.start_of(flow.parameters)))
    data = zoo.Data(study.time_s, study.values)
    objects = [study, study.series[0], study.vessels[0], study.conventions, solver, flow, flow.network, case]
    objects += [
        data,
        flow.outputs,
        solver.solve(stiffness=1e5),
        zoo.model_A(study),
        zoo.Hooks(),
        zoo.Cosines(),
    ]
    assert repr(solver).startswith(
        "Solver(21 vessels, 177 cells, linear wall, conventions printed, period 0.11 s"
    )
    for one in objects:
        shown = repr(one)
        assert len(shown) <= 1500, shown
        assert len(shown.splitlines()) <= 20, shown


DOCUMENTED = [name for name in zoo.__all__ if callable(getattr(zoo, name)) and name != "Any"]


@pytest.mark.parametrize("name", DOCUMENTED)
def test_a_public_docstring_begins_with_one_sentence(name: str) -> None:
    first, *rest = (inspect.getdoc(getattr(zoo, name)) or "").splitlines()
    assert re.match(r"[A-Z\-].*[.:]$", first), first
    assert not rest or not rest[0], first


# ---------------------------------------------------------------------------------------------------
# Python and the commands

SAME: dict[str, tuple[Any, dict[str, str]]] = {
    "sample": (zoo.sample, {}),
    "diagnose": (zoo.diagnose, {}),
    "compare": (zoo.compare, {"criterion": "ic"}),
}
"""The function of each command, and options that it calls otherwise."""
APART = {
    # the command has a file beside its checkpoint, and reads names where Python has objects
    "sample": {"model", "output", "fresh"},
    "diagnose": {"study", "output"},
    "compare": {"models"},
}
"""Parameters of one name that are not one thing."""


@pytest.mark.parametrize("name", SAME)
def test_python_and_the_command_have_the_same_defaults(name: str) -> None:
    from zoo.blood.study_diagnosis import diagnose

    function, called = SAME[name]
    parameters = inspect.signature(diagnose if name == "diagnose" else function).parameters
    options = {p.name: p for p in get_command(app).commands[name].params}  # type: ignore[attr-defined]
    shared = {o: parameters[called.get(o, o)] for o in options if called.get(o, o) in parameters}
    shared = {o: p for o, p in shared.items() if o not in APART[name]}
    assert len(shared) >= 2, shared
    for option, parameter in shared.items():
        ours, theirs = parameter.default, options[option].default
        assert (ours or None) == (theirs or None), f"{name}: {option}: {theirs!r} in the command, {ours!r}"


def test_sampling_without_a_number_of_draws_is_that_of_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    from zoo.cli.options import SamplingOptions
    from zoo.core.posterior import arviz_groups

    got: dict[str, Any] = {}
    monkeypatch.setattr(arviz_groups.methods, "sample", lambda model, **settings: got.update(settings))
    zoo.sample(None)
    command = SamplingOptions().settings()
    assert {name: got[name] for name in command} == command
    zoo.sample(None, draws=20)
    command = SamplingOptions(draws=20).settings()
    assert {name: got[name] for name in command} == command


# ---------------------------------------------------------------------------------------------------
# The documents

DEVELOPERS = {"CONTRIBUTING.md", "architecture.md", "extending.md", "testing.md"}
"""Documents that describe the rooms of the code."""
USERS = [
    path
    for pattern in ("*.md", "docs/*.md", "examples/*.py", "notebooks/*.ipynb", "notebooks/posteriors/*.md")
    for path in sorted(ROOT.glob(pattern))
    if path.name not in DEVELOPERS
]


@pytest.mark.parametrize("path", USERS, ids=lambda p: p.name)
def test_documents_of_users_name_no_room(path: Path) -> None:
    found = re.findall(r"zoo\.(?:core|blood)\b[\w.]*", path.read_text(encoding="utf-8"))
    assert not found


def test_the_stub_is_what_is_loaded() -> None:
    tree = ast.parse((ROOT / "src" / "zoo" / "__init__.pyi").read_text(encoding="utf-8"))
    names = [alias for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names]
    assert all(alias.asname == alias.name for alias in names)
    assert sorted(alias.name for alias in names) == sorted(zoo.__all__)
