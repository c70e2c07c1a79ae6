"""Lines of svOneDSolver's files by their first word, and their tables."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NoReturn

from zoo.blood.importing.imported import ImportedFileError
from zoo.blood.study.reading import read_text
from zoo.core.words import short

LEFT_OUT = {"NODE": "places of nodes", "OUTPUT": "OUTPUT"}
_KNOWN = {"MODEL", "JOINT", "JOINTINLET", "JOINTOUTLET", "SEGMENT", "MATERIAL", "SOLVEROPTIONS", *LEFT_OUT}


class Deck:
    """The lines of a file by their first word, with their rows, and its tables."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.cards: dict[str, list[tuple[int, list[str]]]] = {}
        self.tables: dict[str, list[tuple[float, float]]] = {}
        name = None
        for row, line in enumerate(read_text(path).split("\n"), 1):
            words = line.partition("#")[0].split()
            if not words:
                continue
            if name is not None and words[0] != "ENDDATATABLE":
                if len(words) != 2:
                    self.fail(row, f"{len(words)} numbers in table {name}: must be two, time and value")
                self.tables[name].append((self.number(row, words[0]), self.number(row, words[1])))
            elif words[0] == "DATATABLE" and len(words) > 1:
                name = words[1]
                self.tables[name] = []
            elif words[0] == "ENDDATATABLE":
                name = None
            elif words[0] in _KNOWN:
                self.cards.setdefault(words[0], []).append((row, words[1:]))
            else:
                self.fail(row, f"{short(words[0])}: not known in a file of svOneDSolver; remove that row")

    def fail(self, row: int, reason: str) -> NoReturn:
        """Refuse the file, naming it and the row."""
        raise ImportedFileError(f"{self.path}, row {row}: {reason}")

    def number(self, row: int, text: str) -> float:
        """A finite number, refused with its row if it is none."""
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not abs(value) <= 1e30:
            self.fail(row, f"{short(text)}: must be a number; correct it")
        return value

    def of(self, card: str, least: int) -> list[tuple[int, list[str]]]:
        """All lines of a kind, each with at least so many words."""
        if card not in self.cards:
            raise ImportedFileError(f"{self.path}: {card}: is missing; is this a file of svOneDSolver?")
        short = [(row, words) for row, words in self.cards[card] if len(words) < least]
        for row, words in short:
            self.fail(row, f"{card} has {len(words)} words after it: must have {least}; add them")
        return self.cards[card]

    def table(self, row: int, name: str, *lengths: int) -> list[tuple[float, float]]:
        """A table, of one of these lengths if any are given."""
        found = self.tables.get(name)
        if found is None or (lengths and len(found) not in lengths):
            rows = "no such table" if found is None else f"{len(found)} rows, not {lengths[-1]}"
            self.fail(row, f"DATATABLE {name}: {rows}; correct it")
        return found
