"""The snippets of docs/ that are cheap, run as they stand; the others carry a mark with the reason."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

import pytest
from typer.main import get_command

from snippets import ROOT, blocks, missing, run_command, run_python
from zoo.cli import app

DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
ELSEWHERE = {"bring-your-own-simulator.md", "extending.md"}
"""Pages that a test of another file runs."""
RUN = [
    p
    for p in sorted(ROOT.glob("docs/*.md"))
    if p.name not in ELSEWHERE and any(b.language == "python" or b.commands for b in blocks(p))
]


def command_lines(path: Path) -> list[str]:
    """Every `zoo ...` line of a document's code blocks, without its comment."""
    lines = [line.removeprefix("$ ") for b in blocks(path) for line in b.text.splitlines()]
    return [line for line in lines if line.startswith("zoo ")]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda p: p.name)
def test_commands_of_the_documents_have_their_options(path: Path) -> None:
    for line in command_lines(path):
        for part in line.partition("#")[0].split("&&"):
            command, words = get_command(app), shlex.split(part)[1:]
            while words and hasattr(command, "commands"):
                assert words[0] in command.commands, f"{path.name}: {line}"
                command = command.commands[words.pop(0)]
            known = {name for p in command.params for name in (*p.opts, *p.secondary_opts)} | {"--help"}
            for word in words:
                assert not word.startswith("--") or word.partition("=")[0] in known, f"{path.name}: {line}"


@pytest.mark.parametrize("path", RUN, ids=lambda p: p.name)
def test_cheap_snippets_of_a_document_run(path: Path, tmp_path: Path) -> None:
    """Snippets of Python of one document follow each other in one script, as they are read."""
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    measured = bool(os.environ.get("ZOO_DATA_DIR"))
    code, shown = "", []
    for block in blocks(path):
        if block.not_run:
            print(f"not run: {block}: {block.not_run}")
        elif "mouse-" in block.text and not measured:
            print(f"not run: {block}: ZOO_DATA_DIR is not set")
        elif block.language == "python":
            code += block.text
            shown += [*block.shown.splitlines(), "..."]
        for command, output in [] if block.not_run else block.commands:
            printed = run_command(command, tmp_path)
            lost = missing(output, printed)
            assert not lost, f"{block}: `{command}` shows {lost!r}, printed was\n{printed}"
    if code:
        printed = run_python(code, tmp_path)
        lost = missing(["...", *shown], printed)
        assert not lost, f"{path.name}: shows {lost!r}, printed was\n{printed}"
