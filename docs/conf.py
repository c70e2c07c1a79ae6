"""The site of `make docs`: the documents where they stand, the API by its docstrings, the gallery executed.

The folder of the sources is that of the repository, so that a link between two documents leads to the same
place on the site and on GitHub.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import zoo

ROOT = Path(__file__).resolve().parents[1]
STUB = ROOT / "src" / "zoo" / "__init__.pyi"
GENERATED = ROOT / "docs" / "generated"
NAMES = GENERATED / "names.md"
TABLES: dict[str, str] = {}
"""Of effects and free functions, by the document that has one of them."""
LISTED = "<!-- On the site: a table of them that leads to a page of each. -->"
"""What such a document has in its place on GitHub."""

MENU = {
    "Where to begin": [
        "docs/for-data",
        "docs/for-simulators",
        "docs/for-statisticians",
        "docs/for-developers",
    ],
    "Examples": [
        "docs/generated/gallery/index",
        "notebooks/01-first-look",
        "notebooks/02-nine-models",
        "notebooks/03-diagnosis",
    ],
    "How to": [
        "docs/python",
        "docs/bring-your-own-simulator",
        "docs/importing",
        "docs/report",
        "docs/many-machines",
    ],
    "Reference": [
        "docs/commands",
        "docs/study-format",
        "docs/effects",
        "docs/components",
        "docs/conventions",
        "docs/api",
        "docs/glossary",
    ],
    "How it works": ["docs/statistics", "docs/diagnosis", "docs/numerics", "docs/nominal-windkessel"],
    "How well it works": [
        "docs/blind",
        "benchmarks/blind/frozen/README",
        "docs/nature",
        "docs/calibration",
        "docs/real-data",
        "docs/reproduction",
        "notebooks/posteriors/README",
    ],
    "Change it": [
        "CONTRIBUTING",
        "docs/architecture",
        "docs/extending",
        "docs/testing",
        "docs/versions",
        "CHANGELOG",
        "SECURITY",
    ],
}
"""What the menu shows below the start page, README.md, by caption: each document once."""


def public_names(stub: str) -> dict[str, list[str]]:
    """Names that the package's stub exports, in its order, by the comment that they stand under."""
    sections: dict[str, list[str]] = {}
    for line in stub.splitlines():
        if found := re.match(r"from \S+ import (\w+) as \1$", line):
            sections[next(reversed(sections))].append(found[1])
        elif line.startswith("# ") and not line.startswith("# ruff"):
            sections[line.removeprefix("# ")] = []
    return sections


def names_page(folder: str) -> str:
    """Tables of all public names, from which autosummary makes a page for each in a folder."""
    page = ""
    for title, names in public_names(STUB.read_text(encoding="utf-8")).items():
        entries = "".join(f"   {name}\n" for name in names)
        options = f"   :toctree: {folder}\n   :nosignatures:\n"
        directive = f".. currentmodule:: zoo\n.. autosummary::\n{options}\n{entries}"
        page += f"\n## {title}\n\n```{{eval-rst}}\n{directive}```\n"
    return page


def write_pages(app: Any, config: Any) -> None:
    """Of names, for autosummary, which looks for them before the pages are read; of effects and functions."""
    sys.path.insert(0, str(ROOT))
    from docs.pages import write_pages

    GENERATED.mkdir(exist_ok=True)
    NAMES.write_text(names_page("api"), encoding="utf-8")
    TABLES.update({f"docs/{kind}": table for kind, table in write_pages(GENERATED).items()})


def add_what_github_would_not_show(app: Any, name: str, content: list[str]) -> None:
    """The menu, tables of names, effects and functions, and the pages that scripts of the gallery become."""
    content[0] = re.sub(r"\]\(((?:docs/)?)gallery/(\w+)\.py\)", r"](\1generated/gallery/\2.rst)", content[0])
    if name == root_doc:
        for caption, pages in MENU.items():
            entries = "\n".join(f"/{page}" for page in pages)
            content[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{entries}\n```\n"
    elif name == "docs/api":
        app.env.note_dependency(STUB)
        content[0] += names_page("generated/api")
    elif name in TABLES:
        kind = name.removeprefix("docs/")
        for page in (GENERATED / kind).glob("*.md"):
            app.env.note_dependency(page)
        pages = f"```{{toctree}}\n:hidden:\n:glob:\n\ngenerated/{kind}/*\n```\n"
        content[0] = content[0].replace(LISTED, f"{TABLES[name]}\n{pages}")


def setup(app: Any) -> None:
    """Of Sphinx."""
    app.connect("config-inited", write_pages)
    app.connect("source-read", add_what_github_would_not_show)


project = "zoo"
author = "the zoo developers"
project_copyright = author
version = release = zoo.__version__
root_doc = "README"
include_patterns = [
    "*.md",
    "docs/*.md",
    "docs/generated/api/*.rst",
    "docs/generated/gallery/*.rst",
    "docs/generated/effects/*.md",
    "docs/generated/components/*.md",
    "notebooks/*.ipynb",
    "**/README.md",
]
exclude_patterns = [".*", "build", "demo-output", "runs", "src", "native", "tests"]
extensions = [
    "myst_nb",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]

myst_heading_anchors = 4
nb_execution_mode = "off"  # they are stored with their outputs, which tests run again

autosummary_generate = [str(NAMES)]
templates_path = [str(ROOT / "docs" / "templates")]
default_role = "py:obj"
autodoc_typehints = "none"  # the docstrings have types, with shapes and units
numpydoc_show_class_members = False

sphinx_gallery_conf = {
    "examples_dirs": "docs/gallery",
    "gallery_dirs": "docs/generated/gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,
}

html_theme = "pydata_sphinx_theme"
html_title = "zoo"
html_context = {"default_mode": "auto"}
html_static_path = ["static"]
html_css_files = ["site.css"]
html_sidebars = {"**": ["menu.html"]}
html_show_sourcelink = False
html_copy_source = False
html_additional_pages = {"index": "start.html"}
html_theme_options = {
    "navbar_center": [],
    "navigation_depth": 1,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": [],
    "footer_end": ["sphinx-version"],
}
