"""Files of a study, which may come from anyone: which of them are read, how large they may be, as what."""

from __future__ import annotations

import csv
import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PureWindowsPath
from typing import Any

from zoo.blood.study.parts import StudyError
from zoo.core.words import choices, short

MOST_TOML_BYTES = 5_000_000
MOST_CSV_BYTES = 500_000_000
LONGEST_LINE = 4096
"""Characters of a line of TOML: a name of many parts, or many tables in each other, takes the parser long."""


def inside(folder: Path, name: str) -> str | None:
    """What is wrong with a file's name in a study, which must be a file of its folder; None if nothing is.

    Examples
    --------
    >>> inside(Path("."), "../secret.csv")
    "leaves the study's folder; put the file into it, and give its name"
    """
    parts = PureWindowsPath(name)  # knows both kinds of separators, and drives
    if parts.is_absolute() or parts.drive or parts.root or ".." in parts.parts:
        return "leaves the study's folder; put the file into it, and give its name"
    path = folder / name
    try:
        there = path.is_file()
    except OSError as error:
        return f"cannot be read ({error.strerror}); give a shorter name"
    if not there:
        return f"no such file in {folder}; add it or correct the name"
    if Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        return None
    return "is a link that leaves the study's folder; put the file into it"


def read_text(path: Path, most_bytes: int = MOST_CSV_BYTES) -> str:
    """The text of a UTF-8 file that is not too large."""
    try:
        size = path.stat().st_size
        if size > most_bytes:
            raise StudyError(
                f"{path}: {size / 1e6:.0f} MB: must be at most {most_bytes / 1e6:.0f} MB; give the right file"
            )
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise StudyError(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8") from None
    except OSError as error:
        raise StudyError(f"{path}: cannot be read ({error.strerror}); correct that") from None


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """Tables of a TOML file, and its text."""
    text = read_text(path, MOST_TOML_BYTES)
    for row, line in enumerate(text.split("\n"), 1):
        if len(line) > LONGEST_LINE:
            raise StudyError(
                f"{path}, row {row}: {len(line)} characters: must be at most {LONGEST_LINE}; break the line"
            )
    try:
        return tomllib.loads(text), text
    except tomllib.TOMLDecodeError as error:
        raise StudyError(f"{path}: not valid TOML: {error}; correct that line") from None
    except RecursionError:
        raise StudyError(f"{path}: not valid TOML: nested too deeply; write it flat") from None
    except ValueError:  # int() of so many digits
        raise StudyError(f"{path}: not valid TOML: a number of thousands of digits; correct it") from None


@dataclass(frozen=True)
class CsvTable:
    """Cells of a CSV file by column, and the row of the file that each came from."""

    rows: list[int]
    columns: dict[str, list[str]]

    def cells(self, i: int) -> dict[str, str]:
        """Those of the i-th row that is not blank, by column."""
        return {name: column[i] for name, column in self.columns.items()}


def read_csv(
    path: Path, columns: Sequence[str], optional: Sequence[str] = (), orders: Sequence[Sequence[str]] = ()
) -> CsvTable:
    """Cells by column; row 1 is the header, blank rows are left out.

    Where its cells are all numbers there is none, and the columns are those of `orders` of that length.
    """
    reader = csv.reader(read_text(path).splitlines(), strict=True)
    try:
        lines = [(reader.line_num, cells) for row in reader if any(cells := [c.strip() for c in row])]
    except csv.Error as error:
        raise StudyError(f"{path}, row {reader.line_num}: {error}; correct that row") from None
    if not lines:
        raise StudyError(f"{path}: the file is empty; its first row is {','.join(columns)}")
    if orders and all(re.fullmatch(r"[-+.\deE]*", cell) for cell in lines[0][1]):
        taken = next((list(one) for one in orders if len(one) == len(lines[0][1])), None)
        if taken is None:
            said = "; ".join(",".join(one) for one in orders)
            raise StudyError(
                f"{path}, row {lines[0][0]}: no header, and {len(lines[0][1])} columns: without one they are "
                f"{said}; add a header"
            )
        lines.insert(0, (0, taken))
    row, header = lines[0]
    for sign, words in ((";", "semicolons"), ("\t", "tabs")):
        if any(sign in cell for cell in header):
            raise StudyError(
                f"{path}, row {row}: the columns are separated by {words}: must be by commas, with points in "
                "numbers; save the file as comma-separated values"
            )
    known = [*columns, *optional]
    for name in header:
        if name not in known:
            raise StudyError(f"{path}, row {row}: {short(name)}: unknown column; {choices(name, known)}")
        if header.count(name) > 1:
            raise StudyError(f"{path}, row {row}: {name!r}: the column occurs twice; keep one")
    for name in columns:
        if name not in header:
            raise StudyError(f"{path}, row {row}: {name}: column missing; add it to {','.join(header)}")
    for row, cells in islice(lines, 1, None):
        if len(cells) != len(header):
            raise StudyError(
                f"{path}, row {row}: {len(cells)} cells where the header has {len(header)}; "
                f"give {','.join(header)}"
            )
    turned = list(zip(*(cells for _, cells in islice(lines, 1, None)), strict=True)) or [()] * len(header)
    by_name = {name: list(column) for name, column in zip(header, turned, strict=True)}
    return CsvTable([row for row, _ in islice(lines, 1, None)], by_name)
