"""Writing the folders of cases and their key, in processes, with resume."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from zoo.core import digests
from zoo.core.blindcheck.sealing import (
    KEY_DIGEST,
    BlindError,
    MadeCase,
    line_of,
    read_head,
    read_key_file,
    read_made,
    seal,
    unfinished,
)
from zoo.core.inference.workers import each
from zoo.core.outputs import output_file, output_folder, write_file


class CaseJob(Protocol):
    """A case to be made."""

    @property
    def name(self) -> str:
        """Of its folder."""


C = TypeVar("C", bound=CaseJob)


def refuse_key_inside(folder: Path, key: Path) -> None:
    """Refuse a key that would lie with the cases, and paths that cannot be written.

    Raises
    ------
    BlindError
    zoo.core.outputs.OutputFileError
    """
    if folder.resolve() in key.resolve().parents:
        raise BlindError(f"{key}: lies inside {folder}, where the cases are; put the key elsewhere")
    output_file(key)
    output_folder(folder, deep=True)


def write_cases(
    folder: Path,
    key: Path,
    jobs: Sequence[C],
    make: Callable[[C], MadeCase],
    *,
    head: Mapping[str, Any],
    totals: Callable[[Sequence[Mapping[str, Any]]], Mapping[str, Any]] = lambda entries: {},
    cores: int = 1,
    done: Callable[[str], None] = lambda case: None,
) -> None:
    """Make cases, then write all of them in one pass, and the key apart.

    What an interrupted call made is kept beside the key and used again.

    Parameters
    ----------
    folder, key : Path
        The key lies outside the folder.
    jobs : sequence of CaseJob
    make : callable
        Makes the case of a job. Importable by name if cores > 1.
    head : mapping
        All that shapes the cases, in JSON's types; the key begins with it.
    totals : callable
        What else the key says of all cases, from their entries.
    cores : int
    done : callable
        Told the name of each finished case.

    Raises
    ------
    BlindError
        If folder and key hold another draw, or cannot be written to.
    """
    refuse_key_inside(folder, key)
    known = read_head(key)
    head = json.loads(json.dumps(head))
    if known is not None and any(known.get(name) != value for name, value in head.items()):
        raise BlindError(f"{key}: is the key of another draw; give another --key, or remove it")
    if folder.is_dir():
        names = {job.name for job in jobs} | {KEY_DIGEST}
        rest = sorted(p.name for p in folder.iterdir() if p.name not in names)
        if rest:
            raise BlindError(f"{folder}: holds {rest[0]}, which is none of these cases; give an empty folder")
        if known is None and any(folder.iterdir()):
            raise BlindError(
                f"{folder}: holds cases whose key is not {key}; give an empty folder, or their key"
            )
    if key.exists() and all(_written(folder, entry) for entry in read_key_file(key)["cases"]):
        for job in jobs:
            done(job.name)
        return
    made = read_made(key)
    for name in made:
        done(name)
    part = unfinished(key)
    lines = [head, *(vars(one) for one in made.values())]  # without a line that was cut off
    write_file(part, "".join(map(line_of, lines)), private=True)
    with part.open("a", encoding="utf-8") as record:
        left = [job for job in jobs if job.name not in made]
        for _, case in each(make, left, cores, name=lambda job: job.name):
            name = case.entry["case"]
            made[name] = MadeCase({**case.entry, "files": _digest(case.files)}, case.files)
            record.write(line_of(vars(made[name])))
            record.flush()
            done(name)
    cases = [made[job.name] for job in jobs]
    seal(folder, key, {**head, **totals([case.entry for case in cases])}, cases)
    part.unlink()


def _digest(files: Mapping[str, str]) -> str:
    """SHA-256 of the names and contents of files."""
    return digests.of_bytes(json.dumps(dict(sorted(files.items()))).encode())


def _written(folder: Path, entry: Mapping[str, Any]) -> bool:
    """Whether the case of an entry was written in full."""
    try:
        files = {p.name: p.read_text(encoding="utf-8") for p in (folder / entry["case"]).iterdir()}
    except (OSError, UnicodeDecodeError):
        return False
    return _digest(files) == entry.get("files")
