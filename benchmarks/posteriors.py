"""What a posterior costs by each method: solves, effective samples for each, minutes.

Prints a line for each model and method. With `--output` it writes minutes of wall clock into a file such as
`benchmarks/latest.json`: g_minutes, f_minutes, and, when all nine were sampled, nine_posteriors_minutes. A
machine with other work gives other minutes; processor time and solves stand beside them.

Usage: python benchmarks/posteriors.py [--models GHI] [--methods surrogate,exact] [--study mouse-c6]
       python benchmarks/posteriors.py --models ABCDEFGHI --methods auto --output benchmarks/latest.json
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

from zoo import load_study, sample
from zoo.core.inference.convergence import verdict
from zoo.core.inference.record import RunRecord
from zoo.core.surrogate.library import Library
from zoo.core.surrogate.waveform import SurrogateError
from zoo.models import PAPER, get_model
from zoo.paper.modes_of_f import start_of


def processor_seconds() -> float:
    """Of this process and those that it has waited for."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--models", default="GHI")
    parser.add_argument("--methods", default="surrogate,exact")
    parser.add_argument("--study", default="mouse-c6")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    study = load_study(given.study)
    minutes: dict[str, float] = {}
    for method in given.methods.split(","):
        libraries: dict[str, Library] = {}
        for name in given.models:
            model = get_model(name)(study)
            forward = model.zoo.forward
            begin = start_of(name, study)  # F's highest mode, which no search from the prior finds
            more: dict[str, Any] = {} if begin is None else {"start": begin}
            began, used = time.monotonic(), processor_seconds()
            try:
                idata = sample(
                    model,
                    method=method,
                    groups=False,
                    draws=500,
                    until_ess=400.0,
                    seed=given.seed,
                    cores=given.cores,
                    progress=False,
                    library=libraries.setdefault(forward.key, Library(forward)),
                    **more,
                )
            except SurrogateError as error:
                print(f"{name} {method}: {error}", flush=True)
                continue
            wall, busy = time.monotonic() - began, processor_seconds() - used
            record, found = RunRecord.of(idata), verdict(idata)
            solves = record.solves + record.mode_evaluations
            minutes[name] = wall / 60.0
            extra = record.settings.get("surrogate", {})
            shown = f", k-hat {extra['k_hat']:.2f}, {extra['correction']}" if extra else ""
            rate = 1e3 * found.min_ess / solves
            print(
                f"{name} {method}: {solves} solves, least ESS {found.min_ess:.0f}, {rate:.2f} "
                f"effective samples in 1000 solves, {'' if found.passes else 'not '}converged{shown}; "
                f"{wall / 60:.1f} minutes, {busy:.0f} s of processors",
                flush=True,
            )
    if given.output is not None:
        kept = json.loads(given.output.read_text()) if given.output.exists() else {}
        kept |= {f"{name.lower()}_minutes": minutes[name] for name in "GF" if name in minutes}
        if set(PAPER) <= set(minutes):
            kept["nine_posteriors_minutes"] = sum(minutes.values())
        given.output.write_text(json.dumps(kept, indent=2) + "\n")


if __name__ == "__main__":
    main()
