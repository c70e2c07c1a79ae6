"""Makes and diagnoses the frozen cases with the program of commit c4fb767, in which it is to be run.

python freeze.py FOLDER [--elsewhere SHARED]    goes on where it was interrupted; then
python -m benchmarks.blind.frozen.pack FOLDER   of the present program packs what is there
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path

from zoo.blood.blind import draw, make_cases
from zoo.blood.blind.run import CaseDiagnosis
from zoo.core.blindcheck.running import run_folders

LAYOUTS = {"many": ("MPA+daughters", "MPA+distal", "MPA+flows"), "one": ("MPA",), "two": ("MPA+flow",)}
COUNTS = {
    "catalogue": (25, 17, 8),
    "component": (20, 13, 7),
    "pair": (15, 10, 5),
    "small": (7, 5, 3),
    "coloured": (5, 3, 2),
    "none": (8, 5, 2),
}
"""Kind -> cases of three or more series, of one and of two."""
SHARES = draw.NONE_SHARE, draw.OUTSIDE_SHARE
"""Of cases without an effect, and with one outside the catalogue."""


@dataclass(frozen=True)
class Timed(CaseDiagnosis):
    """A diagnosis that tells how long it took."""

    def diagnose(self, case: Path, answer: Path) -> None:
        """Diagnose the case; seconds.json is written last."""
        wall, used = time.perf_counter(), time.process_time()
        super().diagnose(case, answer)
        seconds = {"wall_s": time.perf_counter() - wall, "processor_s": time.process_time() - used}
        (answer / "seconds.json").write_text(json.dumps({k: round(v, 2) for k, v in seconds.items()}))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="with secrets.json: set -> secret")
    parser.add_argument("--elsewhere", type=Path, help="holds blind/cases and blind2/cases")
    given = parser.parse_args()
    secrets = json.loads((given.folder / "secrets.json").read_text())
    for name, secret in secrets.items():
        kind, layout = name.rsplit("-", 1)
        draw.NONE_SHARE, draw.OUTSIDE_SHARE = (1.0, 0.0) if kind == "none" else SHARES
        make_cases(
            given.folder / "cases" / name,
            COUNTS[kind][list(LAYOUTS).index(layout)],
            given.folder / "keys" / f"{name}.json",
            kind="catalogue" if kind == "none" else kind,
            secret=secret,
            layouts=LAYOUTS[layout],
        )
    waiting = {name: given.folder / "cases" / name for name in secrets}
    if given.elsewhere is not None:
        waiting |= {name: given.elsewhere / name / "cases" for name in ("blind2", "blind")}
    for name, cases in waiting.items():
        answers = given.folder / "answers" / name
        run_folders(cases, answers, Timed("linear-constant", False, 3, 1), cores=2)


if __name__ == "__main__":
    main()
