"""What the commands print: lines, tables without frames, errors in red."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

from zoo.core.words import one_line

if TYPE_CHECKING:
    from rich.table import Table

_aside_of_json = False


@contextmanager
def only_json(wanted: bool) -> Iterator[None]:
    """Leave standard output to JSON: what else is said goes to standard error."""
    global _aside_of_json
    _aside_of_json = wanted
    try:
        yield
    finally:
        _aside_of_json = False


def say(*lines: Any) -> None:
    """Print texts, whose long lines are left to the terminal, and tables.

    Both are printed as they are: names may hold what rich would read as markup. A table has the width of the
    terminal, of the variable COLUMNS, or in a pipe 80, by folding texts; columns of numbers are never folded.
    """
    from rich.cells import cell_len
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table
    from rich.text import Text

    console = Console(markup=False, emoji=False, stderr=_aside_of_json)
    for line in lines:
        if isinstance(line, Table):
            for column in line.columns:
                if column.no_wrap or column.justify == "right":
                    cells = "\n".join(map(str, (column.header, *column.cells))).split("\n")
                    column.min_width = max(map(cell_len, cells))
            least = Measurement.get(console, console.options.update(width=10_000), line).minimum
            console.print(line, width=max(console.width, least), crop=False, highlight=False)
        else:
            console.print(line, highlight=False, soft_wrap=isinstance(line, str | Text))


def say_json(content: Any) -> None:
    """Print a value as JSON; a number that is not finite is null."""
    import json

    print(json.dumps(_finite(content), indent=1, allow_nan=False))


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _finite(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


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


def plain_table(
    *headings: str, numbers: Collection[str] = (), title: str | None = None, heads: bool = True
) -> Table:
    """A table without a frame, readable in a pipe too; the first column and numbers are never folded."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False, show_header=heads)
    for i, heading in enumerate(headings):
        number = heading in numbers
        aligned: Literal["left", "right"] = "right" if number else "left"
        table.add_column(heading, no_wrap=number or i == 0, justify=aligned, overflow="fold")
    return table
