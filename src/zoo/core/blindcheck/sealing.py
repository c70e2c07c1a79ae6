"""A key and its cases on disk: kept apart, tied by a digest, and written so that no time tells anything."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zoo.core import digests
from zoo.core.outputs import write_file
from zoo.core.words import OneLineError

KEY_DIGEST = "KEY.sha256"
_TIME = 1577836800
"""Time stamp of every file of a case: when one was made tells how long its solves took."""


class BlindError(OneLineError, ValueError):
    """Cases, answers or a key that cannot be used; the text says why and what to change."""


@dataclass(frozen=True)
class MadeCase:
    """A case that is made and not yet written.

    Parameters
    ----------
    entry : mapping
        What the key says about it, "case" (its name) at least.
    files : mapping of str to str
        Name of each file in the case's folder -> its content.
    """

    entry: Mapping[str, Any]
    files: Mapping[str, str]


def refuse_key_among(cases: Path) -> None:
    """Refuse a folder that holds a key, beside the cases or inside one; nowhere else is looked.

    Raises
    ------
    BlindError
    """
    for place in (cases, *sorted(p for p in cases.iterdir() if p.is_dir())):
        for path in sorted(place.iterdir()):
            if "key" in path.name.lower() and path.suffix.lower() == ".json":
                raise BlindError(
                    f"{path}: a key lies with the cases; move it elsewhere, a diagnosis must not see it"
                )


def read_head(key: Path) -> dict[str, Any] | None:
    """What a key, or what an interrupted call left of it, says of all cases; None if neither is there.

    Raises
    ------
    BlindError
        If the file is no key.
    """
    if key.exists():
        return {name: value for name, value in read_key_file(key).items() if name != "cases"}
    lines = _read_lines(unfinished(key))
    return lines[0] if lines else None


def read_key_file(key: Path) -> dict[str, Any]:
    """Content of a key: what it says of all cases, and "cases", a list with an entry for each.

    Raises
    ------
    BlindError
        If it cannot be read, or is no key.
    """
    try:
        return _parsed(key.read_bytes())
    except OSError as error:
        raise BlindError(
            f"{key}: cannot be read ({error.strerror}); give the key of `zoo blind make`"
        ) from None
    except ValueError:
        raise BlindError(f"{key}: is there and is no key of this version; give another --key") from None


def _parsed(content: bytes) -> dict[str, Any]:
    found = json.loads(content)
    entries = found.get("cases") if isinstance(found, dict) else None
    if not isinstance(entries, list) or not all(isinstance(e, dict) and "case" in e for e in entries):
        raise ValueError("no key")
    return dict(found)


def unfinished(key: Path) -> Path:
    """Where cases are kept until all are made: beside the key, since their order and times tell of solves."""
    return key.with_name(key.name + ".part")


def read_made(key: Path) -> dict[str, MadeCase]:
    """Cases that an interrupted call made, by name."""
    return {e["entry"]["case"]: MadeCase(e["entry"], e["files"]) for e in _read_lines(unfinished(key))[1:]}


def line_of(content: Mapping[str, Any]) -> str:
    """A line of an unfinished key, with its digest."""
    return json.dumps(digests.stamped(content)) + "\n"


def _read_lines(part: Path) -> list[dict[str, Any]]:
    """Lines of an unfinished key up to the first that was cut off or damaged."""
    found = []
    for line in part.read_bytes().split(b"\n")[:-1] if part.exists() else []:
        try:
            content = json.loads(line)
        except (ValueError, RecursionError):
            break
        if not isinstance(content, dict) or not digests.fits(content):
            break
        found.append({name: value for name, value in content.items() if name != digests.FIELD})
    return found


def seal(folder: Path, key: Path, head: Mapping[str, Any], made: Sequence[MadeCase]) -> None:
    """Write all cases in one pass, the key, and the key's SHA-256 beside the cases.

    Nothing is computed between two files, and the cases are written in an order that nobody knows: neither
    times of birth nor the numbers that the file system gives tell how long a case took or when it came.
    The times that can be set are one.

    Parameters
    ----------
    folder, key : Path
    head : mapping
        What the key says of all cases.
    made : sequence of MadeCase
        In the order of the cases' names.
    """
    text = json.dumps({**head, "cases": [dict(one.entry) for one in made]}, indent=1) + "\n"
    contents = [
        (folder / one.entry["case"] / name, content.encode())
        for one in made
        for name, content in one.files.items()
    ]
    random.SystemRandom().shuffle(contents)
    folder.mkdir(parents=True, exist_ok=True)
    for path in dict.fromkeys(path.parent for path, _ in contents):
        path.mkdir(exist_ok=True)
    for path, content in contents:
        path.write_bytes(content)
    write_file(key, text, private=True)
    write_file(folder / KEY_DIGEST, f"{digests.of_bytes(text.encode())}  key.json\n")
    for path in (*(path for path, _ in contents), *{path.parent for path, _ in contents}):
        os.utime(path, (_TIME, _TIME))
    for path in (folder / KEY_DIGEST, folder):
        os.utime(path, (_TIME, _TIME))


def copy_digest(cases: Path, answers: Path) -> None:
    """Put the digest that lies beside the cases beside their answers."""
    if (cases / KEY_DIGEST).is_file():
        write_file(answers / KEY_DIGEST, (cases / KEY_DIGEST).read_bytes())


def read_sealed(key: Path, answers: Path) -> list[dict[str, Any]]:
    """Entries of a key that is the one the cases came with, by the digest beside the answers.

    Raises
    ------
    BlindError
        If it cannot be read or checked, or was changed.
    """
    digest = answers / KEY_DIGEST
    try:
        content = key.read_bytes()
    except OSError as error:
        raise BlindError(
            f"{key}: cannot be read ({error.strerror}); give the key of `zoo blind make`"
        ) from None
    if not digest.is_file():
        raise BlindError(f"{digest}: is missing, the key cannot be checked; make it with `zoo blind run`")
    wanted = digest.read_bytes().split()[:1]
    if [digests.of_bytes(content).encode()] != wanted:
        raise BlindError(
            f"{key}: is not the key of these cases, or was changed: its SHA-256 is not that in {digest}; "
            "give the file that `zoo blind make` wrote with them"
        )
    try:
        return list(_parsed(content)["cases"])
    except ValueError:
        raise BlindError(f"{key}: is no key of this version; make the cases again") from None
