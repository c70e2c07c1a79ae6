"""The table of free functions, `functions.toml`, and a function made of its line."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.components import FreeFunction

TABLE: dict[str, dict[str, Any]] = tomllib.loads(
    Path(__file__).with_name("functions.toml").read_text(encoding="utf-8")
)
"""By the functions' names."""


def free_function(
    name: str,
    at: NDArray[np.float64],
    apply: Callable[..., Any],
    *,
    size_of: float = 1.0,
    lengths_of: float = 1.0,
    **given: Any,
) -> FreeFunction:
    """A function of the table.

    Parameters
    ----------
    name, at, apply
        As `FreeFunction` takes them.
    size_of, lengths_of : float
        What the table's size and lengths are parts of; a function of one value has no lengths.
    **given
        Period or labels.
    """
    said = {key: value for key, value in TABLE[name].items() if key != "limit"}
    size, parts = said.pop("size") * size_of, said.pop("lengths", ())
    lengths = tuple(part * lengths_of for part in parts) if len(at) > 1 else ()
    return FreeFunction(name, at=at, apply=apply, size=size, lengths=lengths, **said, **given)
