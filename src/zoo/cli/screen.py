"""What the commands print: lines, tables without frames, errors in red."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from zoo.core.words import one_line

if TYPE_CHECKING:
    from rich.table import Table


FOLDED = 16
"""Least width of a column whose texts may be folded."""


def say(*lines: Any) -> None:
    """Print texts, whose long lines are left to the terminal, and tables, in blocks where they are too wide.

    Texts are printed as they are: names may hold what rich would read as markup.
    The width is that of the terminal, of the variable COLUMNS, or in a pipe 80.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console(markup=False, emoji=False)
    for line in lines:
        for part in in_blocks(line, console.width) if isinstance(line, Table) else [line]:
            console.print(part, highlight=False, soft_wrap=isinstance(line, str | Text))


def in_blocks(table: Table, width: int) -> list[Table]:
    """A table as tables of columns that fit a width, each with the first column again.

    Columns of texts may be folded, down to `FOLDED` cells; numbers and columns without wrapping never are.
    """
    from rich.table import Table

    gap = 2 if table.box is None else 3
    heads = [str(column.header) if table.show_header else "" for column in table.columns]
    rigid = [bool(column.no_wrap) or column.justify == "right" for column in table.columns]
    cells = [[_plain(cell) for cell in column.cells] for column in table.columns]
    needed = [_longest([head, *each]) for head, each in zip(heads, cells, strict=True)]
    if sum(needed) + gap * (len(needed) - 1) <= width:
        return [table]
    needed = [n if firm else min(n, FOLDED) for n, firm in zip(needed, rigid, strict=True)]
    blocks: list[list[int]] = []
    for i in range(1, len(needed)):
        if not blocks or sum(needed[j] + gap for j in (0, *blocks[-1])) + needed[i] > width:
            blocks.append([])
        blocks[-1].append(i)
    found: list[Table] = []
    for block in blocks:
        part = Table(
            title=None if found else table.title, title_justify=table.title_justify, box=table.box,
            pad_edge=table.pad_edge, show_header=table.show_header,
        )  # fmt: skip
        chosen = [table.columns[i] for i in (0, *block)]
        for column in chosen:
            rigid_one = column.no_wrap or column.justify == "right"
            part.add_column(column.header, justify=column.justify, no_wrap=rigid_one)
        for k, row in enumerate(table.rows):
            part.add_row(*(list(column.cells)[k] for column in chosen), style=row.style)
        found.append(part)
    return found or [table]


def _plain(cell: Any) -> str:
    from rich.text import Text

    return cell.plain if isinstance(cell, Text) else str(cell)


def _longest(texts: Sequence[str]) -> int:
    """Cells that the longest line takes."""
    from rich.cells import cell_len

    return max((cell_len(line) for text in texts for line in text.split("\n")), default=0)


def complain(text: str) -> None:
    """Print an error as one red line on standard error."""
    _aside(f"error: {one_line(text)}", "red")


def warn(text: str) -> None:
    """Print a warning as one yellow line on standard error."""
    _aside(f"warning: {one_line(text, 1000)}", "yellow")


def _aside(line: str, colour: str) -> None:
    from rich.console import Console
    from rich.text import Text

    Console(stderr=True).print(Text(line, style=colour), soft_wrap=True)


def plain_table(*headings: str, title: str | None = None, heads: bool = True) -> Table:
    """A table without a frame, readable in a pipe too; columns may be added."""
    from rich.table import Table

    return Table(*headings, title=title, title_justify="left", box=None, pad_edge=False, show_header=heads)


def text_table(headings: Sequence[str], rows: Sequence[Sequence[str]], title: str) -> Table:
    """A table of texts: two columns of names, the others of numbers; a last cell = or x colours its row."""
    table = plain_table(title=title)
    for i, heading in enumerate(headings):
        table.add_column(heading, no_wrap=True, justify="left" if i < 2 else "right")
    for row in rows:
        table.add_row(*row, style={"=": "green", "x": "yellow"}.get(row[-1]))
    return table
