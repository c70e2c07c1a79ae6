"""The frozen cases of the blind check, and the answers of commit c4fb767 to them.

python -m benchmarks.blind.frozen                    the table of the frozen answers
python -m benchmarks.blind.frozen --unpack FOLDER    the cases as folders of studies
python -m benchmarks.blind.frozen --run OUT          and today's table: diagnoses the cases into OUT, and
                                                     goes on where it was interrupted
"""

from __future__ import annotations

import argparse
import json
import lzma
import os
import tarfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.blind.other_keys import other_keys

from zoo.blood.blind import diagnose_cases
from zoo.core.blindcheck import Answer, CaseKey, Score, score_answers, score_table
from zoo.core.blindcheck.folders import read_answers

HERE = Path(__file__).parent
ELSEWHERE = ("blind", "blind2")
"""Sets by an independent simulator, whose cases and keys are not here."""


def sets() -> list[str]:
    """Names of the frozen sets: a kind, and whether its cases have many series, one or two."""
    return sorted(path.name.removesuffix(".tar.xz") for path in (HERE / "cases").glob("*.tar.xz"))


def frozen_keys() -> list[CaseKey]:
    """What is true in the frozen cases; a case is called by its set and its name."""
    text = lzma.decompress((HERE / "keys.jsonl.xz").read_bytes()).decode()
    return [CaseKey.model_validate_json(line) for line in text.splitlines()]


def frozen_lines() -> dict[str, dict[str, Any]]:
    """Case -> all that is stored of the answer to it."""
    lines = map(json.loads, (HERE / "answers.jsonl").read_text(encoding="utf-8").splitlines())
    return {line["case"]: line for line in lines}


def frozen_answers() -> dict[str, Answer | None]:
    """Case -> the frozen answer, None where the diagnosis failed."""
    return {
        case: Answer.model_validate(line["answer"]) if "answer" in line else None
        for case, line in frozen_lines().items()
    }


def unpack(folder: Path, chosen: Sequence[str]) -> None:
    """Write the folders of studies, by set."""
    for name in chosen:
        with tarfile.open(HERE / "cases" / f"{name}.tar.xz") as archive:
            archive.extractall(folder / name, filter="data")


def keys_elsewhere(folder: Path) -> list[CaseKey]:
    """Keys of the independent simulator's cases, where they are laid beside the data."""
    found = []
    for name in ELSEWHERE:
        for key in other_keys(folder / name / "key", f"{name}/") if (folder / name / "key").is_dir() else []:
            tags = {**key.tags, "set": name, "set, series": f"{name}, {key.tags['series']}"}
            found.append(key.model_copy(update={"tags": tags}))
    return found


def score_of(keys: Sequence[CaseKey], answers: dict[str, Answer | None]) -> Score:
    """The score of what is answered, by set and number of series."""
    return score_answers([k for k in keys if k.case in answers], answers, by=("set", "set, series"))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sets", nargs="+", choices=sets(), default=sets(), metavar="SET")
    parser.add_argument("--unpack", type=Path, metavar="FOLDER")
    parser.add_argument("--run", type=Path, metavar="OUT")
    parser.add_argument("--cores", type=int, default=2)
    beside = os.environ.get("ZOO_DATA_DIR")
    parser.add_argument(
        "--elsewhere",
        type=Path,
        default=Path(beside).parent if beside else None,
        help="folder with blind/key and blind2/key; beside ZOO_DATA_DIR if absent",
    )
    args = parser.parse_args()
    if args.unpack:
        unpack(args.unpack, args.sets)
        return
    keys = [k for k in frozen_keys() if k.case.split("/")[0] in args.sets]
    then, lines = frozen_answers(), frozen_lines()
    seconds = sorted(lines[k.case]["seconds"]["wall_s"] for k in keys if lines.get(k.case, {}).get("seconds"))
    print(f"## Frozen answers of commit c4fb767, {len(then)} in all\n\n{score_table(score_of(keys, then))}")
    if seconds:
        print(f"Seconds of a diagnosis: median {seconds[len(seconds) // 2]:.0f}, most {seconds[-1]:.0f}.\n")
    if args.elsewhere and (others := keys_elsewhere(args.elsewhere)):
        found = score_of(others, then)
        if found.cases:
            print(f"## Frozen answers to an independent simulator's cases\n\n{score_table(found)}")
    if args.run:
        unpack(args.run / "cases", args.sets)
        today: dict[str, Answer | None] = {}
        for name in args.sets:
            print(f"{name} ...", flush=True)
            diagnose_cases(args.run / "cases" / name, args.run / "answers" / name, cores=args.cores)
            mine = [k for k in keys if k.case.startswith(f"{name}/")]
            of_set = [k.model_copy(update={"case": k.case.removeprefix(f"{name}/")}) for k in mine]
            answers, _ = read_answers(args.run / "answers" / name, of_set)
            today |= {f"{name}/{case}": answer for case, answer in answers.items()}
        print(f"\n## The program of today\n\n{score_table(score_of(keys, today))}")


if __name__ == "__main__":
    main()
