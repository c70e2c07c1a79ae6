"""The free functions of a study's components as a table in Markdown."""

from __future__ import annotations

from collections.abc import Iterable

from zoo.blood.components.plausibility import LIMITS, amount
from zoo.core.components import FreeFunction


def component_table(functions: Iterable[FreeFunction]) -> str:
    """A row for each function: its equation, argument, prior size and source, and what is believed.

    Parameters
    ----------
    functions : iterable of FreeFunction
        Such as ``components(model, theta, data)``.

    Returns
    -------
    str
    """
    lines = [
        "| component | function | equation | argument | values | prior size | lengths | why this size "
        "| believed up to |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    component = ""
    for one in functions:
        unit = "" if one.argument_unit == "1" else f", {one.argument_unit}"
        where = f"each {one.argument}" if one.labels else f"{one.argument}{unit}"
        lengths = ", ".join(f"{length:.2g}" for length in one.lengths) or "none: independent"
        cells = (
            one.component if one.component != component else "",
            f"`{one.name}`",
            f"`{one.equation}`".replace("|", "\\|"),
            where,
            f"{len(one.at)}, {one.unit}",
            f"{one.size:.2g} ({amount(one.size, one.unit)})"
            if one.unit.startswith("log ")
            else amount(one.size, one.unit),
            lengths,
            one.why.replace("|", "\\|"),
            amount(LIMITS[one.name].sizes * one.size, one.unit),
        )
        component = one.component
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
