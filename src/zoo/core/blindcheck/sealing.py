"""A key and its cases on disk: kept apart, tied by a digest, and told by no time stamp."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

KEY_DIGEST = "KEY.sha256"
_TIME = 1577836800
"""Time stamp of every file of a case: when one was made tells how long its solves took."""


class BlindError(ValueError):
    """Cases, answers or a key that cannot be used; the text says why and what to change."""


def replace_file(path: Path, text: str) -> None:
    """Write a file so that a kill leaves the old one or the new one."""
    new = path.with_name(path.name + ".new")
    new.write_text(text, encoding="utf-8")
    new.replace(path)


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


def read_entries(key: Path) -> list[dict[str, Any]]:
    """Entries of a key, none if there is no such file yet.

    Raises
    ------
    BlindError
        If the file is no key.
    """
    if not key.exists():
        return []
    try:
        found = json.loads(key.read_text(encoding="utf-8"))
        if not isinstance(found, list) or not all(isinstance(e, dict) and "case" in e for e in found):
            raise ValueError
    except (OSError, ValueError):
        raise BlindError(f"{key}: is there and is no key; give another --key") from None
    return found


def read_lines(part: Path) -> list[dict[str, Any]]:
    """Entries of an unfinished key; a last line that was cut off is left out."""
    found = []
    for line in part.read_text(encoding="utf-8").splitlines() if part.exists() else []:
        try:
            found.append(json.loads(line))
        except ValueError:
            break
    return found


def seal(folder: Path, key: Path, entries: Sequence[dict[str, Any]]) -> None:
    """Write the key, put its SHA-256 beside the cases, and give all their files one time stamp.

    Parameters
    ----------
    folder : Path
        With a folder for each case, named by the entry's "case".
    key : Path
    entries : sequence of dict
        In the order of the cases' names, in which they are stamped too.
    """
    text = json.dumps(list(entries), indent=1) + "\n"
    replace_file(key, text)
    replace_file(folder / KEY_DIGEST, f"{hashlib.sha256(text.encode()).hexdigest()}  key.json\n")
    for entry in entries:
        case = folder / entry["case"]
        for path in (*sorted(case.iterdir()), case):
            os.utime(path, (_TIME, _TIME))
    for path in (folder / KEY_DIGEST, folder):
        os.utime(path, (_TIME, _TIME))


def copy_digest(cases: Path, answers: Path) -> None:
    """Put the digest that lies beside the cases beside their answers."""
    if (cases / KEY_DIGEST).is_file():
        replace_file(answers / KEY_DIGEST, (cases / KEY_DIGEST).read_text(encoding="utf-8"))


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
    wanted = digest.read_text(encoding="utf-8").split()[:1]
    if [hashlib.sha256(content).hexdigest()] != wanted:
        raise BlindError(
            f"{key}: is not the key of these cases, or was changed: its SHA-256 is not that in {digest}; "
            "give the file that `zoo blind make` wrote with them"
        )
    return list(json.loads(content))
