"""Examples in docstrings run and print what they say."""

import doctest
import importlib
import pkgutil

import pytest

import zoo

WALKED = pkgutil.walk_packages(zoo.__path__, "zoo.")
MODULES = [m.name for m in WALKED if m.name != "zoo._native" and not m.name.endswith("__main__")]


@pytest.mark.parametrize("name", MODULES)
def test_examples_of_docstrings(name: str) -> None:
    found = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert found.failed == 0
