"""Python files of a user's own: run on request, and sent to other processes by value."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any


def run_file(path: Path, name: str) -> ModuleType:
    """Run a Python file as a module, whose functions travel to other processes by value.

    The file, and those beside it that it imports, may import modules that stand beside it. Nothing else may,
    and modules that are installed come first: a json.py in that folder is never run.

    Parameters
    ----------
    path : Path
    name : str
        Of the module.

    Returns
    -------
    module
    """
    folder = str(path.resolve().parent)
    if not any(isinstance(finder, _Beside) and finder.folder == folder for finder in sys.meta_path):
        sys.meta_path.append(_Beside(folder))
    spec = importlib.util.spec_from_file_location(name, path, loader=_ByValue(name, str(path.resolve())))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


class _ByValue(SourceFileLoader):
    """Other processes cannot import these modules: what refers to them takes their code along."""

    def get_code(self, fullname: str) -> CodeType:
        """From the text that the user can read, not from a __pycache__ beside it."""
        return self.source_to_code(self.get_data(self.path), self.path)

    def exec_module(self, module: ModuleType) -> None:
        import cloudpickle  # type: ignore[import-untyped]

        super().exec_module(module)
        cloudpickle.register_pickle_by_value(module)


class _Beside:
    """Finds modules of a folder for the files of that folder, when nothing else has found them."""

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: Any = None
    ) -> ModuleSpec | None:
        if path is not None or name in sys.stdlib_module_names or not self._asked_from_here():
            return None
        spec = PathFinder.find_spec(name, [self.folder])
        if spec is not None and isinstance(spec.loader, SourceFileLoader) and spec.origin is not None:
            spec.loader = _ByValue(name, spec.origin)
        return spec

    def _asked_from_here(self) -> bool:
        frame = sys._getframe(2)
        while frame.f_back is not None and "importlib" in frame.f_code.co_filename:
            frame = frame.f_back
        return Path(frame.f_globals.get("__file__") or "").parent == Path(self.folder)


def unfit(function: Callable[..., Any], arguments: int) -> str:
    """Why a function cannot be called with so many arguments; empty if it can, or if that is not known.

    Parameters
    ----------
    function : callable
    arguments : int

    Returns
    -------
    str

    Examples
    --------
    >>> unfit(lambda c: c, 2), unfit(lambda c, t: t, 2)
    ('too many positional arguments', '')
    """
    try:
        inspect.signature(function).bind(*range(arguments))
    except TypeError as error:
        return str(error)
    except ValueError:  # some that are built in have no signature
        pass
    return ""
