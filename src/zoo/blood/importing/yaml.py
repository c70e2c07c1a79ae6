"""YAML with the rows of its keys; nothing in it is run, and nothing grows.

PyYAML reads the file, and numbers are those of YAML 1.2: 1e-13 is one, and 010 is ten.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import yaml

from zoo.blood.importing.imported import ImportedFileError
from zoo.blood.study.reading import MOST_TOML_BYTES, read_text

MAX_DEPTH = 8

_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")
_WHOLE = re.compile(r"[+-]?(0|[1-9]\d{0,17})")
_WORDS = {"": None, "~": None, "null": None, "true": True, "false": False}


class Table(dict[str, Any]):
    """A mapping that knows the rows of its keys."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: dict[str, int] = {}


def _scalar(event: yaml.ScalarEvent) -> Any:
    text: str = event.value
    if event.style:  # quoted
        return text
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    if _WHOLE.fullmatch(text):
        return int(text)
    return float(text) if _NUMBER.fullmatch(text) else text


class _Reader:
    """Values from the events of a file."""

    def __init__(self, path: Path, events: Iterator[yaml.Event]) -> None:
        self.path, self.events = path, events

    def fail(self, event: yaml.Event, reason: str) -> NoReturn:
        raise ImportedFileError(f"{self.path}, row {event.start_mark.line + 1}: {reason}")

    def value(self, event: yaml.Event, depth: int = 1) -> Any:
        """What begins with this event."""
        if getattr(event, "anchor", None) or getattr(event, "tag", None):
            self.fail(event, "an anchor, an alias or a tag is not read; write the value itself")
        if isinstance(event, yaml.ScalarEvent):
            return _scalar(event)
        if depth > MAX_DEPTH:
            self.fail(event, f"is nested more than {MAX_DEPTH} deep; a network file is not")
        if isinstance(event, yaml.SequenceStartEvent):
            return [self.value(inner, depth + 1) for inner in self.until(yaml.SequenceEndEvent)]
        table = Table()
        for key in self.until(yaml.MappingEndEvent):
            if not isinstance(key, yaml.ScalarEvent):
                self.fail(key, "a key that is no text is not read; write key: value")
            if key.value in table:
                self.fail(key, f"{key.value}: the key occurs twice; keep one")
            table.rows[key.value] = key.start_mark.line + 1
            table[key.value] = self.value(next(self.events), depth + 1)
        return table

    def until(self, end: type[yaml.Event]) -> Iterator[yaml.Event]:
        """The events before the one that ends a list or a mapping."""
        while not isinstance(event := next(self.events), end):
            yield event


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
    zoo.blood.study.StudyError
        If the file cannot be read or is too large.
    ImportedFileError
        If it is no YAML, is nested too deeply, or holds what is not read: anchors, aliases, tags.
    """
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # as PyYAML was built
    events = yaml.parse(read_text(path, MOST_TOML_BYTES), Loader=loader)
    kinds = yaml.StreamStartEvent, yaml.DocumentStartEvent, yaml.DocumentEndEvent
    reader = _Reader(path, (event for event in events if not isinstance(event, kinds)))
    try:
        found = [reader.value(event) for event in reader.until(yaml.StreamEndEvent)]
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        row = f", row {mark.line + 1}" if mark else ""
        what = getattr(error, "problem", None) or error
        raise ImportedFileError(f"{path}{row}: not read as YAML: {what}; correct that row") from None
    if len(found) != 1:
        raise ImportedFileError(f"{path}: holds {len(found)} documents; give a network file, which holds one")
    return found[0]
