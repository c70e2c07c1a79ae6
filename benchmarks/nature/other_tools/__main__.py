"""The command of this folder; see `benchmarks.nature.other_tools`."""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.nature import CASES, DataError
from benchmarks.nature.other_tools import RECORDS, SEED, Record, __doc__, rms

RESULTS = Path(__file__).parent / "results.json"
TOOLS = {
    "zoo": "zoo",
    "gaussian_process": "PyMC, Gaussian process",
    "residual_sindy": "PySINDy",
    "misspecification": "sbi",
}


def run(record: Record, module: Any) -> dict[str, Any]:
    """What a tool, or zoo where it is None, says of a record, its held-out error, versions and seconds."""
    began = time.perf_counter()
    if module is None:
        packages, says, held_out = ("pymc",), "", record.by_zoo()
    else:
        found = module.answer(record)
        packages, says, held_out = module.PACKAGES, found.says, found.held_out
    return {
        "held_out": rms(record.held_out.measured - held_out),
        "says": says,
        "seconds": time.perf_counter() - began,
        "versions": {"python": platform.python_version()} | {name: version(name) for name in packages},
    }


def tables(results: dict[str, Any]) -> str:
    """Held-out errors, and what was said, as in docs/nature.md."""
    errors = [
        f"| record | forecast | base | {' | '.join(TOOLS.values())} |",
        f"|---|---|---|{'---|' * len(TOOLS)}",
    ]
    others = [name for name in TOOLS if name != "zoo"]
    said = [
        f"| record | {' | '.join(f'{TOOLS[name]} | s' for name in others)} |",
        f"|---|{'---|---|' * len(others)}",
    ]
    for name, row in results["records"].items():
        tools, numbers = row["tools"], [row["forecast"], row["base"]]
        numbers += [tools[tool]["held_out"] if tool in tools else np.nan for tool in TOOLS]
        best = np.nanmin(numbers)
        shown = [f"**{x:.3g}**" if x == best else "" if np.isnan(x) else f"{x:.3g}" for x in numbers]
        errors.append(f"| {name}, {row['unit']} | {' | '.join(shown)} |")
        cells = [f"{tools[t]['says']} | {tools[t]['seconds']:.0f}" if t in tools else " | " for t in others]
        said.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join([*errors, "", *said])


def main(arguments: Sequence[str] | None = None) -> None:
    """Run what is asked for, keep it and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--tools", nargs="+", default=list(TOOLS), choices=list(TOOLS), help="these only")
    parser.add_argument("--cases", nargs="+", default=list(RECORDS), choices=list(RECORDS), help="these only")
    asked = parser.parse_args(arguments)
    results = json.loads(RESULTS.read_text("utf-8")) if RESULTS.exists() else {"records": {}}
    results["seed"] = SEED
    try:
        here = "benchmarks.nature.other_tools"
        modules = {one: None if one == "zoo" else import_module(f"{here}.{one}") for one in asked.tools}
        for case in asked.cases:
            for record in RECORDS[case]():
                row = results["records"].setdefault(record.name, {"tools": {}})
                row |= {"case": case, "sha256": CASES[case]["sha256"], "unit": record.unit}
                row["forecast"] = rms(record.held_out.measured - record.forecast)
                row["base"] = rms(record.held_out.measured - record.predict(record.base, np.zeros_like))
                for tool, module in modules.items():
                    row["tools"][tool] = run(record, module)
                    RESULTS.write_text(json.dumps(results, indent=1) + "\n", "utf-8")
                    print(record.name, tool, row["tools"][tool], file=sys.stderr, flush=True)
    except DataError as error:
        sys.exit(str(error))
    except ModuleNotFoundError as error:
        needed = "pip install -c requirements.lock -r benchmarks/nature/other_tools/requirements.txt"
        sys.exit(f"{error.name} is not installed, which a tool needs: {needed}, or leave it out of --tools")
    print(tables(results))


if __name__ == "__main__":
    main()
