"""The documents: links lead somewhere, the example study works, printed errors are real ones."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from zoo.blood.conventions import SWITCHES
from zoo.blood.solver import STATUS_NAMES, Solver
from zoo.blood.study import StudyError, load_study

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
EXAMPLE = ROOT / "docs" / "example-study"


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


def test_the_example_study_solves_and_is_what_the_readme_shows() -> None:
    study = load_study(EXAMPLE)
    solution = Solver.for_study(study).solve(6e4, psi1=0.6, psi2=0.95, c=1.1)
    assert ((solution.pressure_mmHg - study.values) ** 2).sum() == pytest.approx(1.89, abs=0.01)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for name in ("study.toml", "network.toml"):
        for line in (EXAMPLE / name).read_text(encoding="utf-8").splitlines():
            assert line.startswith("#") or line in readme, f"{name}: {line}"


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
    ("observations.csv", ",0.010,", ",0.012,"),
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


def test_documents_know_every_switch_and_status() -> None:
    conventions = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    study_format = (ROOT / "docs" / "study-format.md").read_text(encoding="utf-8")
    numerics = (ROOT / "docs" / "numerics.md").read_text(encoding="utf-8")
    for switch in SWITCHES:
        assert f"| `{switch}`" in conventions
        assert f"| `{switch}`" in study_format
    for code, name in STATUS_NAMES.items():
        assert f"| {code} | `{name}` |" in numerics
