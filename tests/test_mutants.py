"""The list of mutants is alive: each text stands once in its file, and the tests that must notice exist."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from pathlib import Path

import pytest

from mutants.run import NATIVE, ROOT, Mutant, read

MUTANTS = read()


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda m: m.name)
def test_the_text_stands_once_and_the_change_can_be_read(mutant: Mutant) -> None:
    changed = mutant.text(ROOT)
    assert changed != (ROOT / mutant.file).read_text(encoding="utf-8")
    if mutant.file.endswith(".py"):
        ast.parse(changed)


def test_tests_exist() -> None:
    for test in {test for m in MUTANTS for test in m.tests}:
        if test.startswith(NATIVE):
            assert (ROOT / "native" / "tests" / f"{test.removeprefix(NATIVE)}.c").exists(), test
            continue
        path, _, name = test.partition("::")
        text = (ROOT / path).read_text(encoding="utf-8")
        assert re.search(rf"^def {name.partition('[')[0]}\b", text, re.M) if name else text, test


def test_names_are_unique_and_few_are_said_to_be_equivalent() -> None:
    assert len({m.name for m in MUTANTS}) == len(MUTANTS)
    assert sum(bool(m.equivalent) for m in MUTANTS) <= len(MUTANTS) / 10


def test_a_text_that_is_gone_or_stands_twice_is_refused(tmp_path: Path) -> None:
    one = replace(MUTANTS[0], file="file.py", old="x = 1", new="x = 2")
    for text, n in (("y = 1", 0), ("x = 1\nx = 1", 2)):
        (tmp_path / "file.py").write_text(text)
        with pytest.raises(SystemExit, match=f"{one.name}: the old text occurs {n} times"):
            one.text(tmp_path)
    (tmp_path / "file.py").write_text("x = 1\n")
    assert one.text(tmp_path) == "x = 2\n"
