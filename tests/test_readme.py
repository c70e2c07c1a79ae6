"""The commands and snippets of README.md, run as they stand; five minutes together on two cores."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from pathlib import Path

import pytest

from snippets import ROOT, Block, blocks, missing, run_command, run_python

SECONDS = 300.0
"""All blocks together, on two cores; as time of the processor, so that a busy machine makes no difference."""
BLOCKS = [b for b in blocks(ROOT / "README.md") if b.language == "python" or b.commands]
spent: dict[str, float] = {}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An empty folder, in which a reader would follow the README from its beginning to its end."""
    made = tmp_path_factory.mktemp("readme")
    yield made
    print("\n" + "".join(f"{seconds:6.1f} s of processor time  {name}\n" for name, seconds in spent.items()))


def processor_seconds() -> float:
    """Of all commands that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def test_make_commands_of_the_readme_are_targets() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    lines = [line for b in blocks(ROOT / "README.md") for line in b.text.splitlines()]
    targets = {line.split()[1] for line in lines if line.startswith("make ")}
    assert targets
    for target in targets:
        assert f"\n{target}: " in makefile


@pytest.mark.parametrize("block", BLOCKS, ids=str)
def test_what_the_readme_shows_is_what_comes_out(block: Block, folder: Path) -> None:
    assert not block.not_run, f"{block}: every block of the README is run; longer ones stand in docs/"
    start = processor_seconds()
    if block.language == "python":
        printed = run_python(block.text, folder)
        lost = missing(block.shown.splitlines(), printed)
        assert not lost, f"{block}: shows {lost!r}, printed was\n{printed}"
    for command, shown in block.commands:
        printed = run_command(command, folder)
        lost = missing(shown, printed)
        assert not lost, f"{block}: `{command}` shows {lost!r}, printed was\n{printed}"
        assert "not converged" not in printed, printed
    spent[str(block)] = processor_seconds() - start


def test_the_readme_takes_five_minutes() -> None:
    if set(spent) != {str(b) for b in BLOCKS}:
        pytest.skip("not all blocks were run")
    assert sum(spent.values()) < 2 * SECONDS, spent
