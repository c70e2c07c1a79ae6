"""A strict reader of the part of YAML that network files are written in; it runs nothing.

Mappings and lists by indentation, inline lists of scalars, quoted and plain text, numbers, true, false, null.
Anchors, tags, inline mappings and texts over several lines are refused with their row.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from zoo.blood.importing.imported import ImportedFileError

MAX_BYTES = 10_000_000
MAX_DEPTH = 8
LONGEST_LINE = 2000

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")
_WHOLE = re.compile(r"[+-]?(0|[1-9]\d{0,17})")
_WORDS = {"": None, "~": None, "null": None, "true": True, "false": False}
_REFUSED = {
    "&": "an anchor",
    "*": "an alias",
    "!": "a tag",
    "{": "an inline mapping",
    "|": "a text over several lines",
    ">": "a text over several lines",
    "?": "a complex key",
    "%": "a directive",
    "@": "a reserved sign",
    "`": "a reserved sign",
}


class Table(dict[str, Any]):
    """A mapping that knows the rows of its keys."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: dict[str, int] = {}


class _Line(NamedTuple):
    row: int
    indent: int
    text: str


def _without_comment(text: str) -> str:
    """The text before a "#" that begins it or follows a space, outside quotes."""
    quote = ""
    for i, sign in enumerate(text):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "\"'" and (i == 0 or text[i - 1] in " [,-"):
            quote = sign
        elif sign == "#" and (i == 0 or text[i - 1] in " \t"):
            return text[:i].rstrip()
    return text.rstrip()


class _Reader:
    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        self.lines: list[_Line] = []
        self.at = 0
        for row, line in enumerate(text.splitlines(), 1):
            if len(line) > LONGEST_LINE:
                self.fail(row, f"{len(line)} characters: must be at most {LONGEST_LINE}; break the line")
            body = _without_comment(line)
            if not body.strip() or (body == "---" and not self.lines):
                continue
            if "\t" in body[: len(body) - len(body.lstrip())]:
                self.fail(row, "is indented by a tab; use spaces")
            self.lines.append(_Line(row, len(body) - len(body.lstrip(" ")), body.strip()))

    def fail(self, row: int, reason: str) -> NoReturn:
        raise ImportedFileError(f"{self.path}, row {row}: {reason}")

    def scalar(self, text: str, row: int) -> Any:
        text = text.strip()
        if text[:1] in ("'", '"'):
            if len(text) < 2 or text[-1] != text[0] or text[0] in text[1:-1]:
                self.fail(row, f"{text[:60]}: a quote too many or too few; close the text with {text[0]}")
            if "\\" in text and text[0] == '"':
                self.fail(row, f"{text[:60]}: escapes with a backslash are not read; write the text plainly")
            return text[1:-1]
        if text.startswith("["):
            if not text.endswith("]") or "[" in text[1:]:
                self.fail(row, f"{text[:60]}: only lists of plain values in one row are read; write [a, b]")
            inside = text[1:-1].strip()
            return [self.scalar(part, row) for part in inside.split(",")] if inside else []
        if text[:1] in _REFUSED:
            self.fail(row, f"{text[:60]}: {_REFUSED[text[0]]} is not read; write the value itself")
        if text.lower() in _WORDS:
            return _WORDS[text.lower()]
        if _WHOLE.fullmatch(text):
            return int(text)
        return float(text) if _NUMBER.fullmatch(text) else text

    def key(self, text: str) -> tuple[str, str] | None:
        """Key and the rest of "key: rest"; None where there is no key."""
        found = re.match(r"(\"[^\"]*\"|'[^']*'|[^\"'\[\]{}&*!|>?%@`#:,-][^:]*?)\s*:(?:\s+(.*)|$)", text)
        return (found[1].strip("\"'"), (found[2] or "").strip()) if found else None

    def block(self, indent: int, depth: int) -> Any:
        """The mapping or list that begins at the present line."""
        first = self.lines[self.at]
        if depth > MAX_DEPTH:
            self.fail(first.row, f"is nested more than {MAX_DEPTH} deep; a network file is not")
        is_list = first.text == "-" or first.text.startswith("- ")
        return self.sequence(indent, depth) if is_list else self.mapping(indent, depth)

    def below(self, row: int, indent: int, depth: int, *, lists_beside: bool) -> Any:
        """What stands indented below a key or dash; None when nothing does."""
        if self.at == len(self.lines):
            return None
        line = self.lines[self.at]
        beside = lists_beside and line.indent == indent and (line.text == "-" or line.text.startswith("- "))
        return self.block(line.indent, depth + 1) if line.indent > indent or beside else None

    def mapping(self, indent: int, depth: int) -> Table:
        table = Table()
        while self.at < len(self.lines) and self.lines[self.at].indent == indent:
            line = self.lines[self.at]
            found = self.key(line.text)
            if found is None:
                if line.text.startswith("-"):
                    break
                self.fail(line.row, f"{line.text[:60]!r}: not read as YAML; write key: value")
            name, rest = found
            if name in table:
                self.fail(line.row, f"{name}: the key occurs twice; keep one")
            self.at += 1
            table.rows[name] = line.row
            table[name] = (
                self.scalar(rest, line.row)
                if rest
                else self.below(line.row, indent, depth, lists_beside=True)
            )
        self.close(indent)
        return table

    def sequence(self, indent: int, depth: int) -> list[Any]:
        values: list[Any] = []
        while self.at < len(self.lines) and self.lines[self.at].indent == indent:
            line = self.lines[self.at]
            if not (line.text == "-" or line.text.startswith("- ")):
                break
            rest = line.text[1:].lstrip()
            if not rest:
                self.at += 1
                values.append(self.below(line.row, indent, depth, lists_beside=False))
            elif self.key(rest) or rest.startswith("- ") or rest == "-":
                inner = indent + len(line.text) - len(rest)
                self.lines[self.at] = _Line(line.row, inner, rest)
                values.append(self.block(inner, depth + 1))
            else:
                self.at += 1
                values.append(self.scalar(rest, line.row))
        self.close(indent)
        return values

    def close(self, indent: int) -> None:
        """Refuse a line that is indented deeper than the block that has ended."""
        if self.at < len(self.lines) and self.lines[self.at].indent > indent:
            line = self.lines[self.at]
            self.fail(line.row, f"{line.text[:60]!r}: indented deeper than what it belongs to; align it")


def read_yaml(path: Path) -> Any:
    """What a YAML file holds: tables, lists, texts, numbers, true, false and None.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Table, list or scalar

    Raises
    ------
    ImportedFileError
        If the file cannot be read, is too large or nested too deeply, or holds what is not read.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ImportedFileError(
                f"{path}: {path.stat().st_size / 1e6:.0f} MB: a network file is smaller than "
                f"{MAX_BYTES / 1e6:.0f} MB; give the right file"
            )
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ImportedFileError(f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8") from None
    except OSError as error:
        raise ImportedFileError(f"{path}: cannot be read ({error.strerror}); correct the path") from None
    reader = _Reader(path, text)
    if not reader.lines:
        raise ImportedFileError(f"{path}: the file is empty; give a network file")
    value = reader.block(reader.lines[0].indent, 1)
    if reader.at < len(reader.lines):
        line = reader.lines[reader.at]
        reader.fail(line.row, f"{line.text[:60]!r}: does not belong to anything above it; align it")
    return value
