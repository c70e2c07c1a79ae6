"""Records that nature made, with a cause that is known from outside and rivals that were written down first.

python -m benchmarks.nature --lists               SHA-256 of every list of rivals
python -m benchmarks.nature [--cases NAME ...]    diagnoses all, or these, and what is known beside it
python -m benchmarks.nature --balls NAME ...      these of the falling balls
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from pathlib import Path
from typing import Any

CASES: dict[str, dict[str, Any]] = tomllib.loads((Path(__file__).parent / "cases.toml").read_text("utf-8"))


def list_digest(case: str) -> str:
    """SHA-256 of a case's rivals, of which the order does not count."""
    rivals = CASES[case]["rivals"]
    names = sorted(rivals) if isinstance(rivals, list) else rivals
    return hashlib.sha256(json.dumps(names).encode()).hexdigest()
