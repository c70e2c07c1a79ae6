"""Records that nature made, with a cause that is known from outside and rivals that were written down first.

python -m benchmarks.nature --lists               SHA-256 of every list of rivals
python -m benchmarks.nature [--cases NAME ...]    diagnoses all, or these, and what is known beside it
python -m benchmarks.nature --balls NAME ...      these of the falling balls

`benchmarks.nature.scoring.score(method)` scores another method on those of which the cause is known.
"""

from __future__ import annotations

import hashlib
import json
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import zoo

Parameters = Mapping[str, Any]

GROUPS = {"drag": ("linear-drag", "quadratic-drag"), "timing": ("flow-timing", "pressure-timing"), "none": ()}
"""Rivals of which any is right: a drop tells no law of drag, and one series not which clock is late."""

CASES: dict[str, dict[str, Any]] = tomllib.loads((Path(__file__).parent / "cases.toml").read_text("utf-8"))


class DataError(ValueError):
    """A record that is not there, or is another one."""


def list_digest(case: str) -> str:
    """SHA-256 of a case's rivals, of which the order does not count."""
    rivals = CASES[case]["rivals"]
    names = sorted(rivals) if isinstance(rivals, list) else rivals
    return hashlib.sha256(json.dumps(names).encode()).hexdigest()


def data_file(case: str) -> Path:
    """Path of a case's data.

    Raises
    ------
    DataError
        If it is not in ZOO_DATA_DIR, or is not the file that the list names.
    """
    known = CASES[case]
    path = Path(os.environ.get("ZOO_DATA_DIR", ".")) / known["data"]
    if not path.exists():
        raise DataError(f"{path} is not there: set ZOO_DATA_DIR to the folder that has {known['data']}")
    if hashlib.sha256(path.read_bytes()).hexdigest() != known["sha256"]:
        raise DataError(f"{path} is not the file of {known['source']}: its SHA-256 is another")
    return path


def rival(
    name: str, key: str, unit: str, size: float, low: float | None = None, high: float | None = None
) -> Any:
    """An effect that sets one parameter of a simulator."""

    @zoo.effect(name, unit=unit, size=size, low=low, high=high)
    def change(c: Parameters, value: float) -> dict[str, Any]:
        return {**c, key: value}

    return change
