"""Examples in docstrings run and print what they say."""

import doctest
import importlib
import pkgutil

import pytest

import zoo

MODULES = [
    m.name for m in pkgutil.walk_packages(zoo.__path__, "zoo.") if not m.name.startswith("zoo._native")
]


@pytest.mark.parametrize("name", MODULES)
def test_examples_of_docstrings(name: str) -> None:
    found = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)
    assert found.failed == 0
