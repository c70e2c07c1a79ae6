"""Writing the folders of cases and their key, in processes, with resume."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, Protocol, TypeVar

from zoo.core.blindcheck.sealing import KEY_DIGEST, BlindError, read_entries, read_lines, seal
from zoo.core.inference.workers import each


class CaseJob(Protocol):
    """A case to be made."""

    @property
    def name(self) -> str:
        """Of its folder."""


J = TypeVar("J")
C = TypeVar("C", bound=CaseJob)
R = TypeVar("R")


def in_processes(work: Callable[[J], R], jobs: Sequence[J], cores: int) -> Iterable[tuple[J, R]]:
    """Jobs and what they gave, as they finish.

    Raises
    ------
    BlindError
        If a process is killed.
    """
    try:
        yield from each(work, jobs, cores)
    except BrokenProcessPool:
        raise BlindError(
            "a process ended before its case was done; the same command goes on with the rest"
        ) from None


def refuse_key_inside(folder: Path, key: Path) -> None:
    """Refuse a key that would lie with the cases, and paths that cannot be written.

    Raises
    ------
    BlindError
    """
    if folder.resolve() in key.resolve().parents:
        raise BlindError(f"{key}: lies inside {folder}, where the cases are; put the key elsewhere")
    if not key.resolve().parent.is_dir():
        raise BlindError(f"{key}: folder {key.parent} does not exist; create it or choose another path")
    if folder.exists() and not folder.is_dir():
        raise BlindError(f"{folder}: is a file; give a folder")


def write_cases(
    folder: Path,
    key: Path,
    jobs: Sequence[C],
    write: Callable[[C], dict[str, Any]],
    *,
    draw: str,
    there: Callable[[Path, dict[str, Any]], bool],
    cores: int = 1,
    done: Callable[[str], None] = lambda case: None,
) -> None:
    """Write the folders of cases, and the key apart; cases that an interrupted call wrote are kept.

    Parameters
    ----------
    folder, key : Path
        The key lies outside the folder.
    jobs : sequence of CaseJob
    write : callable
        Writes the folder of a job and returns its entry of the key, which says at least "case" (the name) and
        "draw". Importable by name if cores > 1.
    draw : str
        Digest of all that shapes the cases.
    there : callable
        Whether a folder holds the case that an entry tells of.
    cores : int
    done : callable
        Told the name of each finished case.

    Raises
    ------
    BlindError
        If folder and key hold another draw, or cannot be written to.
    """
    refuse_key_inside(folder, key)
    part = key.with_name(key.name + ".part")
    entries = {entry["case"]: entry for entry in (*read_entries(key), *read_lines(part))}
    if any(entry.get("draw") != draw for entry in entries.values()):
        raise BlindError(f"{key}: is the key of another draw; give another --key, or remove it")
    if folder.is_dir():
        known = {job.name for job in jobs} | {KEY_DIGEST}
        rest = sorted(p.name for p in folder.iterdir() if p.name not in known)
        if rest:
            raise BlindError(f"{folder}: holds {rest[0]}, which is none of these cases; give an empty folder")
    if (folder / KEY_DIGEST).is_file() and not entries:
        raise BlindError(
            f"{folder}: holds cases whose key is not {key}; give an empty folder, or the key that is theirs"
        )
    folder.mkdir(parents=True, exist_ok=True)
    waiting = []
    for job in jobs:
        if job.name in entries and there(folder / job.name, entries[job.name]):
            done(job.name)
        else:
            waiting.append(job)
    with part.open("a", encoding="utf-8") as record:
        for _, entry in in_processes(write, waiting, cores):
            entries[entry["case"]] = entry
            record.write(json.dumps(entry) + "\n")
            record.flush()
            done(entry["case"])
    seal(folder, key, [entries[job.name] for job in jobs])
    part.unlink()
