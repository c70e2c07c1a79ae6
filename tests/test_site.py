"""The site of `make docs`, without building it: nothing that it should show is left out."""

from __future__ import annotations

import ast
import importlib.util
import re
import tomllib
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

import zoo

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = sorted((ROOT / "docs" / "gallery").glob("*.py"))


@pytest.fixture(scope="module")
def conf() -> ModuleType:
    """Of Sphinx, which it does not need to be read."""
    spec = importlib.util.spec_from_file_location("conf", ROOT / "docs" / "conf.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_document_is_in_the_menu_once(conf: ModuleType) -> None:
    found = Counter(page for pages in conf.MENU.values() for page in pages)
    assert not [page for page, times in found.items() if times > 1]
    documents = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("*/**/README.md")]
    ours = {str(path.relative_to(ROOT).with_suffix("")) for path in documents if not ignored(path)}
    made = {"docs/generated/gallery/index"}
    notebooks = {page for page in found if (ROOT / f"{page}.ipynb").exists()}
    assert set(found) == ours - {conf.root_doc} | made | notebooks


def ignored(path: Path) -> bool:
    """Whether it lies in a folder of tools or of what was made, such as .venv and build."""
    made = {"build", "dist", "demo-output", "runs", "generated"}
    return any(part.startswith(".") or part in made for part in path.relative_to(ROOT).parts)


def test_every_public_name_is_in_the_api_reference_once(conf: ModuleType) -> None:
    shown = re.findall(r"^   (\w+)$", conf.names_page("api"), flags=re.M)
    assert sorted(shown) == sorted(zoo.__all__)
    assert all(len(names) > 3 for names in conf.public_names(conf.STUB.read_text(encoding="utf-8")).values())


def test_the_site_adds_what_github_would_not_show(conf: ModuleType) -> None:
    def shown(name: str, text: str) -> str:
        content = [text]
        conf.add_what_github_would_not_show(None, name, content)
        return content[0]

    link = "[a](gallery/01_what_is_missing.py), [b](docs/gallery/03_waic.py), [c](../examples/tanks.py)"
    assert shown("docs/any", link) == (
        "[a](generated/gallery/01_what_is_missing.rst), [b](docs/generated/gallery/03_waic.rst), "
        "[c](../examples/tanks.py)"
    )
    menu = re.findall(r"^/(.*)$", shown(conf.root_doc, "# zoo\n"), flags=re.M)
    assert menu == [page for pages in conf.MENU.values() for page in pages]


@pytest.mark.parametrize("name", ["docs/effects", "docs/components"])
def test_a_document_of_a_table_has_its_place(conf: ModuleType, name: str) -> None:
    assert (ROOT / f"{name}.md").read_text(encoding="utf-8").count(conf.LISTED) == 1


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: p.name)
def test_a_script_of_the_gallery_has_a_question_and_one_picture(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    title, line, *text = (ast.get_docstring(tree) or "").splitlines()
    assert line == "=" * len(title)
    assert len(" ".join(text)) > 50
    assert path.read_text(encoding="utf-8").count("plt.show()") == 1
    used = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "zoo"
    }
    assert used
    assert used <= set(zoo.__all__)


def test_what_the_site_is_built_with_is_pinned() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = {re.split(r"[<>=]", one)[0] for one in project["optional-dependencies"]["docs"]}
    for lock in ("requirements.lock", "requirements-py313.lock"):
        text = (ROOT / lock).read_text(encoding="utf-8").lower()
        assert needed <= set(re.findall(r"^([\w.-]+)==", text, flags=re.M)), lock
