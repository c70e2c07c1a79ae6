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
ANSWER = ROOT / "benchmarks" / "blind" / "independent" / "answers" / "case-101"
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
    from zoo.core.posterior.storage import load

    found = load(folder / "A.nc")
    return {
        group: (
            {
                name: (values.dims, plain(np.asarray(values.values)), repr(sorted(values.attrs.items())))
                for name, values in found[group].variables.items()
            },
            repr(sorted(found[group].attrs.items())),
        )
        for group in found.groups()
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


def read_facts(folder: Path) -> Any:
    """What an answer says of its case, and the series that it fitted."""
    from zoo.blood.blind.run import read_case_facts, read_fitted

    facts = read_case_facts(folder)
    return [facts[name] for name in ("checksum", "parents", "series")], plain(read_fitted(folder, "ab12"))


def read_key(folder: Path) -> Any:
    """Entries of a key, checked by the digest beside the answers."""
    from zoo.core.blindcheck.sealing import read_sealed

    return read_sealed(folder / "key.json", folder)


def read_unfinished(folder: Path) -> Any:
    """Cases that an interrupted call made."""
    from zoo.core.blindcheck.sealing import read_head, read_made

    key = folder / "made.json"
    made = {name: (dict(one.entry), dict(one.files)) for name, one in read_made(key).items()}
    return {"": read_head(key)} | made if made else {}


def all_kinds() -> dict[str, Kind]:
    """Kinds of files that zoo writes and reads again."""
    from zoo.core.blindcheck.sealing import BlindError
    from zoo.core.diagnosis import DiagnosisError
    from zoo.core.inference.checkpoint import CheckpointError
    from zoo.core.inference.record import ResultsError

    return {
        "posterior": Kind(read_posterior, (ResultsError,), ["A.nc"]),
        "checkpoint": Kind(read_checkpoint, (CheckpointError,), ["A.checkpoint"], parts=True),
        "answer": Kind(read_answer, (DiagnosisError,), ["diagnosis.json"]),
        "facts": Kind(read_facts, (BlindError,), ["case.json", "fitted.json"]),
        "key": Kind(read_key, (BlindError,), ["key.json", "KEY.sha256"]),
        "unfinished": Kind(read_unfinished, (BlindError,), ["made.json"], parts=True),
    }


def make(folder: Path) -> None:
    """Write undamaged files of each kind."""
    import arviz as az

    from zoo.blood.blind.run import write_fitted
    from zoo.core import digests
    from zoo.core.blindcheck.answers import Fitted
    from zoo.core.blindcheck.sealing import MadeCase, line_of, seal, unfinished
    from zoo.core.diagnosis import Diagnosis, read_diagnosis
    from zoo.core.outputs import write_file
    from zoo.core.posterior.storage import save

    sys.path.insert(0, str(ROOT / "tests"))
    from gaussian import a_record

    for name in ("posterior", "checkpoint", "answer", "facts", "key", "unfinished"):
        (folder / name).mkdir(parents=True)
    rng = np.random.default_rng(SEED)
    idata = az.from_dict(
        posterior={"chi": rng.normal(size=(2, 40, 3)), "c": rng.normal(size=(2, 40))},
        sample_stats={"accepted": rng.random((2, 40)) < 0.3},
        observed_data={"y": rng.normal(size=9)},
        coords={"vessel": ["trunk", "left", "right"]},
        dims={"chi": ["vessel"]},
    )
    a_record().attach(idata)
    save(idata, folder / "posterior" / "A.nc")
    for seed, where in ((1, folder / "checkpoint" / "A.checkpoint"), (2, folder / "another")):
        make_checkpoint(where, seed)
    content = types.SimpleNamespace(file=read_diagnosis(ANSWER / "diagnosis.json"))
    Diagnosis.save(content, folder / "answer")  # type: ignore[arg-type]
    facts = {"checksum": "ab12", "parents": {"1": None, "2": 1, "3": 1}, "series": ["v1@0 pressure_mmHg"]}
    write_file(folder / "facts" / "case.json", digests.to_text(facts))
    series = rng.normal(size=(2, 3, 8)).round(4)
    write_fitted(folder / "facts", Fitted(series[0], series[1], (0, 2)), "ab12")
    made = [MadeCase({"case": f"case-{i:03d}", "noise": 0.1 + i, "label": "leak"}, {}) for i in range(4)]
    lines = [{"secret": "2f"}, *({"entry": dict(one.entry), "files": {"a": "1\n"}} for one in made)]
    unfinished(folder / "unfinished" / "made.json").write_text("".join(map(line_of, lines)))
    seal(folder / "key", folder / "key" / "key.json", {"seed": 7}, made)


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
