"""What the speed benchmarks share: cases, times, yardsticks of this core, and where results are kept."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

LATEST = Path(__file__).parent / "latest.json"
CASES: dict[str, dict[str, float]] = {
    "linear": {"stiffness": 5.17e4, "psi1": 0.21, "psi2": 0.88, "c": 1.44},
    "tangent": {"stiffness": 9.17e4, "gamma": 5.18, "psi1": 0.37, "psi2": 0.94, "c": 1.60},
}
"""The published medians of A and H."""


def options(text: str | None, **defaults: Any) -> argparse.Namespace:
    """What the command line gives for these options, and for `output`."""
    parser = argparse.ArgumentParser(description=text)
    for name, value in defaults.items():
        parser.add_argument(f"--{name}", type=type(value), default=value)
    parser.add_argument("--output", type=Path, default=LATEST)
    return parser.parse_args()


def processor_times(runs: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Median time of this thread, s, of each run after a warm-up; the time of other processes does not count.

    The runs take turns, so that what else the machine does meets all of them.
    """
    times = np.empty((repeats + 1, len(runs)))
    for row in times:
        for i, run in enumerate(runs):
            start = time.thread_time()
            run()
            row[i] = time.thread_time() - start
    return [float(x) for x in np.median(times[1:], axis=0)]


def yardsticks() -> dict[str, float]:
    """Matrix-product flop rate of one core, and its rate of square roots and of divisions in cache."""
    a = np.random.default_rng(0).random((512, 512))
    x = np.random.default_rng(1).random(1024) + 0.5
    out = np.empty_like(x)

    def many(function: Callable[[], object]) -> Callable[[], object]:
        return lambda: [function() for _ in range(2000)]

    runs = [lambda: a @ a, many(lambda: np.sqrt(x, out=out)), many(lambda: np.divide(1.0, x, out=out))]
    with threadpool_limits(1):
        product, roots, divisions = processor_times(runs, 15)
    return {
        "matrix_product_gflop_per_s": 2 * 512**3 / product / 1e9,
        "square_roots_per_s": 2000 * 1024 / roots,
        "divisions_per_s": 2000 * 1024 / divisions,
    }


def keep(rows: dict[str, Any], path: Path) -> None:
    """Put a benchmark's own rows into the file of results; the rows of others stay."""
    there = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    path.write_text(json.dumps(there | rows, indent=2) + "\n", encoding="utf-8")
