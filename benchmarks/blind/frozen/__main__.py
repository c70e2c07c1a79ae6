"""The frozen cases of the blind check: the answers of commit c4fb767 to them, and those of today.

python -m benchmarks.blind.frozen                     the table of the frozen answers
python -m benchmarks.blind.frozen --unpack FOLDER     the cases as folders of studies
python -m benchmarks.blind.frozen --run OUT           diagnoses cases, going on where it was interrupted, and
                                                      prints both answers beside each other
python -m benchmarks.blind.frozen --read OUT          the same of what is there, without a diagnosis
python -m benchmarks.blind.frozen --others OUT        the score of answers of `zoo blind run` to the cases of
                                                      the independent simulator

With --each N so many cases of each kind, by a --seed, of which OUT has one.
"""

from __future__ import annotations

import argparse
import json
import lzma
import os
import tarfile
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.blind.other_keys import other_keys

from zoo.blood.blind import diagnose_cases
from zoo.core.blindcheck import Answer, CaseKey, Group, Score, paired_table, score_answers, score_table
from zoo.core.blindcheck.cases import NOISE, UNLISTED
from zoo.core.blindcheck.folders import ANSWER, FAILED, read_answers

HERE = Path(__file__).parent
ELSEWHERE = ("blind", "blind2")
"""Sets by an independent simulator, whose cases and keys are not here."""
REST = (*NOISE, UNLISTED)
"""What former answers give probability to besides effects and components."""
NUMERICS = "coarse-grid"
"""A listed effect in no component, which today is a component of its own."""


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


def former(answer: Mapping[str, Any]) -> Answer:
    """A frozen answer, one list of rival explanations, as inclusion probabilities.

    A component has what its free functions have and the listed effects that belong to it; noise, white or
    correlated, is no cause. A group has all that the answer could not tell from its effects, noise apart.
    """
    parts = {one["name"]: one["probability"] for one in answer["components"]}
    listed = [e for e in answer["explanations"] if e["name"] not in (*parts, *REST)]
    p = {one["name"]: one["probability"] for one in answer["explanations"]}
    groups = []
    for group in dict.fromkeys(e["group"] for e in listed):
        total = sum(
            e["probability"] for e in answer["explanations"] if e["group"] == group and e["name"] not in REST
        )
        groups.append(Group(names=[e["name"] for e in listed if e["group"] == group], probability=total))
    rest = {name: answer[name] for name in ("gap", "left", "seconds") if name in answer}
    return Answer(
        components=parts | {NUMERICS: p.get(NUMERICS, 0.0)},
        nothing=sum(p.get(name, 0.0) for name in NOISE),
        effects={e["name"]: e["probability"] for e in listed},
        groups=groups,
        sizes={e["name"]: e["parameter"] for e in listed if "parameter" in e},
        **rest,
    )


def frozen_answers() -> dict[str, Answer | None]:
    """Case -> the frozen answer, None where the diagnosis failed."""
    return {
        case: former(line["answer"]) if "answer" in line else None for case, line in frozen_lines().items()
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


def score_of(keys: Sequence[CaseKey], answers: Mapping[str, Answer | None]) -> Score:
    """The score of what is answered, by set and number of series."""
    return score_answers([k for k in keys if k.case in answers], answers, by=("set", "set, series"))


def chosen_keys(keys: Sequence[CaseKey], each: int | None, seed: int) -> dict[str, CaseKey]:
    """Some cases of each kind in an order of the seed, by names that begin with their number in it.

    Those of fewer cases are among those of more.
    """
    found = {}
    for kind in sorted({key.tags["set"] for key in keys}):
        own = [key for key in keys if key.tags["set"] == kind]
        order = np.random.default_rng([seed, *kind.encode()]).permutation(len(own))
        for i, at in enumerate(order[:each]):
            found[f"{i:03d}-{own[at].case.replace('/', '-')}"] = own[at]
    return found


def run(keys: Mapping[str, CaseKey], out: Path, cores: int, *, fresh: bool = False) -> None:
    """Diagnose cases by their names of `chosen_keys`, each in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        unpack(Path(folder) / "all", sorted({key.case.split("/")[0] for key in keys.values()}))
        (Path(folder) / "cases").mkdir()
        for name, key in keys.items():
            (Path(folder) / "all" / key.case).rename(Path(folder) / "cases" / name)
        diagnose_cases(
            Path(folder) / "cases", out, cores=cores, fresh=fresh, done=lambda case: print(case, flush=True)
        )


def read(keys: Mapping[str, CaseKey], out: Path) -> dict[str, Answer | None]:
    """The answers of today that are there, by the names of their cases."""
    there = {path.parent.name for name in (ANSWER, FAILED) for path in out.glob(f"*/{name}")}
    here = {name: key for name, key in keys.items() if name in there}
    if not here:
        return {}
    found, _ = read_answers(out, [key.model_copy(update={"case": name}) for name, key in here.items()])
    return {keys[name].case: answer for name, answer in found.items()}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    kinds = sorted({name.split("-")[0] for name in sets()})
    parser.add_argument("--kinds", nargs="+", choices=kinds, default=kinds, help="all if absent")
    parser.add_argument("--each", type=int, help="cases of each kind; all if absent")
    parser.add_argument("--seed", type=int, default=1, help="of which cases")
    parser.add_argument("--unpack", type=Path, metavar="FOLDER")
    parser.add_argument("--run", type=Path, metavar="OUT")
    parser.add_argument("--read", type=Path, metavar="OUT")
    parser.add_argument("--fresh", action="store_true", help="replace answers of another program")
    parser.add_argument("--cores", type=int, default=2, help="cases at a time, a process each")
    beside = os.environ.get("ZOO_DATA_DIR")
    parser.add_argument(
        "--elsewhere",
        type=Path,
        default=Path(beside).parent if beside else None,
        help="folder with blind/key and blind2/key; beside ZOO_DATA_DIR if absent",
    )
    parser.add_argument("--others", type=Path, metavar="OUT", help="answers of `zoo blind run` to its cases")
    args = parser.parse_args()
    if args.others:
        others = {key.case.split("/")[1]: key for key in keys_elsewhere(args.elsewhere)}
        today = read(others, args.others)
        print(score_table(score_of([key for key in others.values() if key.case in today], today)))
        return
    if args.unpack:
        unpack(args.unpack, [name for name in sets() if name.split("-")[0] in args.kinds])
        return
    keys = chosen_keys([k for k in frozen_keys() if k.tags["set"] in args.kinds], args.each, args.seed)
    then = frozen_answers()
    if out := args.run or args.read:
        if args.run:
            run(keys, out, args.cores, fresh=args.fresh)
        today = read(keys, out)
        mine = [key for key in keys.values() if key.case in today]
        now, before = score_of(mine, today), score_of(mine, then)
        print(f"## Today and commit c4fb767\n\n{paired_table(now, before, 'set')}")
        print(f"## Today\n\n{score_table(now)}")
        print(f"## Commit c4fb767\n\n{score_table(before)}")
        return
    print(f"## Frozen answers of commit c4fb767\n\n{score_table(score_of(list(keys.values()), then))}")
    if args.elsewhere and (others := keys_elsewhere(args.elsewhere)):
        found = score_of(others, then)
        if found.cases:
            print(f"## Frozen answers to an independent simulator's cases\n\n{score_table(found)}")


if __name__ == "__main__":
    main()
