"""What the commands print: lines, tables without frames, errors in red."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table


def say(*lines: Any) -> None:
    """Print texts, whose long lines are left to the terminal, and tables."""
    from rich.console import Console
    from rich.text import Text

    for line in lines:
        Console().print(line, highlight=False, soft_wrap=isinstance(line, str | Text))


def complain(text: str) -> None:
    """Print an error as one red line on standard error."""
    from rich.console import Console
    from rich.text import Text

    Console(stderr=True).print(Text(f"error: {text}", style="red"), soft_wrap=True)


def warn(text: str) -> None:
    """Print a warning as one yellow line on standard error."""
    from rich.console import Console
    from rich.text import Text

    Console(stderr=True).print(Text(f"warning: {text}", style="yellow"), soft_wrap=True)


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
