"""Files that zoo writes for itself, damaged: they are read as what they were, or refused in one line."""

from __future__ import annotations

import dataclasses
import functools
import os
import random
import shutil
import sys
import types
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mutate import BYTES, VALUES, mutated
from outcome import Outcome, judged

ROOT = Path(__file__).resolve().parents[2]
ANSWER = ROOT / "tests" / "data" / "diagnosis.json"
SEED = 11


class Kind(NamedTuple):
    """Files in a folder: how they are read, which errors refuse them, and what these name."""

    read: Callable[[Path], Any]
    refused: tuple[type[Exception], ...]
    names: list[str]
    parts: bool = False
    """Whether what is whole of a damaged file may be read, without the rest."""


def plain(value: Any) -> Any:
    """A value as texts, numbers and tables of them, that can be compared."""
    if dataclasses.is_dataclass(value) or hasattr(value, "__dict__"):
        return type(value).__name__, plain(vars(value))
    if isinstance(value, dict):
        return {str(name): plain(inner) for name, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return str(value.dtype), np.shape(value), value.tobytes() if value.dtype != object else value.tolist()
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    return value


def read_posterior(folder: Path) -> Any:
    """Groups, variables and attributes."""
    from zoo.core.arviz_lines import datasets
    from zoo.core.posterior.storage import load

    found = load(folder / "A.nc")
    return {
        group: (
            {
                name: (values.dims, plain(np.asarray(values.values)), repr(sorted(values.attrs.items())))
                for name, values in content.variables.items()
            },
            repr(sorted(content.attrs.items())),
        )
        for group, content in datasets(found).items()
    } | {"": repr(sorted(found.attrs.items()))}


def read_checkpoint(folder: Path) -> Any:
    """What is being run, where it begins, and the memos of its chains, as a resumed run reads them."""
    from zoo.core import digests
    from zoo.core.inference.checkpoint import Folder
    from zoo.core.inference.memo import Memo

    opened = Folder(folder / "A.checkpoint")
    try:
        stored = opened.run()
        if stored is None:
            return None
        run = digests.of_json(stored["identity"])
        found = {"": plain(stored)}
        for i in range(2):
            memo = Memo(opened.chain(i), f"{run}, chain {i}")
            memo.close()
            found |= {f"{i} {key!r}": plain(one) for key, one in memo.known.items()}
        return found
    finally:
        opened.close()


def read_answer(folder: Path) -> Any:
    """The content of diagnosis.json."""
    from zoo.core.diagnosis import read_diagnosis

    return read_diagnosis(folder / "diagnosis.json").model_dump()


def read_blind_answer(folder: Path) -> Any:
    """An answer of a blind check, with what it is about."""
    from zoo.core.blindcheck.folders import stored_answer

    about, answer = stored_answer(folder)
    return about["case"], about["asked"], answer.model_dump()


def read_key(folder: Path) -> Any:
    """Entries of a key, checked by the digest beside the answers."""
    from zoo.core.blindcheck.folders import read_sealed

    return [one.model_dump() for one in read_sealed(folder / "key.json", folder)]


def all_kinds() -> dict[str, Kind]:
    """Kinds of files that zoo writes and reads again."""
    from zoo.core.blindcheck import BlindError
    from zoo.core.diagnosis import DiagnosisError
    from zoo.core.inference.checkpoint import CheckpointError
    from zoo.core.inference.record import ResultsError

    return {
        "posterior": Kind(read_posterior, (ResultsError,), ["A.nc"]),
        "checkpoint": Kind(read_checkpoint, (CheckpointError,), ["A.checkpoint"], parts=True),
        "answer": Kind(read_answer, (DiagnosisError,), ["diagnosis.json"]),
        "blind answer": Kind(read_blind_answer, (BlindError,), ["answer.json"]),
        "key": Kind(read_key, (BlindError,), ["key.json", "KEY.sha256"]),
    }


def make(folder: Path) -> None:
    """Write undamaged files of each kind."""
    from zoo.core.arviz_lines import of_draws
    from zoo.core.blindcheck import CaseKey
    from zoo.core.blindcheck.folders import run_cases, write_cases
    from zoo.core.diagnosis import Diagnosis, read_diagnosis
    from zoo.core.posterior.storage import save_posterior

    sys.path.insert(0, str(ROOT / "tests"))
    from gaussian import a_record

    for name in ("posterior", "checkpoint", "answer", "key"):
        (folder / name).mkdir(parents=True)
    rng = np.random.default_rng(SEED)
    draws = {"chi": rng.normal(size=(2, 40, 3)), "c": rng.normal(size=(2, 40))}
    stats = {"accepted": rng.random((2, 40)) < 0.3}
    idata = of_draws(
        {"posterior": draws, "sample_stats": stats, "observed_data": {"y": rng.normal(size=9)}},
        coords={"vessel": ["trunk", "left", "right"]},
        dims={"chi": ["vessel"]},
    )
    a_record().attach(idata)
    save_posterior(idata, folder / "posterior" / "A.nc")
    for seed, where in ((1, folder / "checkpoint" / "A.checkpoint"), (2, folder / "another")):
        make_checkpoint(where, seed)
    content = types.SimpleNamespace(file=read_diagnosis(ANSWER))
    Diagnosis.save(content, folder / "answer")  # type: ignore[arg-type]
    key = CaseKey(case="case-001", kind="none", label="no-gap", noise=0.1)
    write_cases(folder / "cases", folder / "key.json", [key], one_case, head={"seed": 7})
    run_cases(folder / "cases", folder / "answers", Guess())
    for name in ("key.json", "cases/KEY.sha256"):
        shutil.copy(folder / name, folder / "key")
    shutil.copytree(folder / "answers" / "case-001", folder / "blind answer")


def one_case(key: Any) -> Any:
    """A case with a file."""
    from zoo.core.blindcheck.folders import MadeCase

    return MadeCase(key, {"a.txt": "1\n"})


@dataclasses.dataclass(frozen=True)
class Guess:
    """A diagnosis that always says the same."""

    marker: str = "a.txt"

    def identity(self) -> dict[str, Any]:
        """Nothing is asked."""
        return {"seed": 1}

    def __call__(self, case: Path, answer: Path) -> Any:
        """The answer, with a file beside it."""
        from zoo.core.blindcheck import Answer

        (answer / "notes.txt").write_text("read\n")
        return Answer.ranked({"no-gap": 0.75, "drift": 0.25})


def make_checkpoint(folder: Path, seed: int) -> None:
    """What a run of two chains leaves, with few evaluations."""
    from zoo.core import digests
    from zoo.core.inference.checkpoint import CHECKPOINT_FORMAT, Folder
    from zoo.core.inference.memo import Found, Memo, to_line

    rng = np.random.default_rng(seed)
    opened = Folder(folder)
    identity = {"format": CHECKPOINT_FORMAT, "model": "gaussian", "seed": seed, "study": "demo"}
    run = digests.of_json(identity)
    beginning = {"starts": rng.normal(size=(2, 2)).tolist(), "logp": -3.25}
    opened.write_run(
        {"identity": identity, "sittings": 1, "wall_seconds": 1.5, "started": "2020-01-01"}
        | {"beginning": beginning}
    )
    for chain in range(2):
        memo = Memo(opened.chain(chain), f"{run}, chain {chain}")
        for point in rng.normal(size=(12, 2)):
            found = Found((np.array(point.sum()), point), 2, {"cfl": 1})
            memo.add(to_line(memo.owner, point.tobytes(), found))
        memo.close()
    opened.close()


@functools.cache
def originals(folder: Path) -> dict[str, Any]:
    """Undamaged files, made once for a process, and what is read of them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not folder.exists():
            half = folder.with_name(f"{folder.name}-{os.getpid()}")
            make(half)
            half.rename(folder)
        return {name: kind.read(folder / name) for name, kind in all_kinds().items()}


def damage(rng: random.Random, folder: Path, others: list[Path]) -> None:
    """Change one file of a folder: its bytes, its values if it is text, or what another file holds."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.stat().st_size)
    path = rng.choice(files)
    raw = path.read_bytes()
    if rng.random() < 0.1:
        like = [other for other in (*files, *others) if other.suffix == path.suffix and other != path]
        new = rng.choice(like).read_bytes() if like else raw[: len(raw) // 2]
    else:
        text = path.suffix in (".json", ".sha256") and rng.random() < 0.6
        new = mutated(rng, raw, VALUES if text else BYTES)
    path.write_bytes(new)


def case(number: int, seed: str, work: Path) -> Outcome:
    """One damaged file."""
    rng = random.Random(f"{seed}/file/{number}")
    made = work.parent / "originals"  # those of all batches
    whole = originals(made)
    name = rng.choice(sorted(whole))
    kind = all_kinds()[name]
    folder = work / "case"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(made / name, folder)
    damage(rng, folder, sorted((made / "another").iterdir()))

    def read() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = kind.read(folder)
        if kind.parts:
            found = {**whole[name], **found}
        assert repr(found) == repr(whole[name]), "other data were read, and nothing was said"

    return judged(read, kind.refused, folder, kind.names)
