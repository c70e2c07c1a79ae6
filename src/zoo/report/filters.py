"""Numbers, intervals and lists as the pages write them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from zoo.core.words import span


def with_error(value: float | None, error: float | None) -> str:
    """A number with its standard error; either may be missing, as JSON has no NaN."""
    if value is None:
        return "–"
    return f"{value:.1f}" if error is None else f"{value:.1f} ± {error:.1f}"


def spanned(x: Any) -> str:
    """The same of what has a mean, a low and a high end."""
    return span(x.mean, (x.low, x.high))


def number(value: float) -> str:
    """Four significant digits, in full up to 1e6."""
    return f"{float(f'{value:.4g}'):.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:#.4g}"


def capital(sentence: str) -> str:
    """The same with a capital at its beginning."""
    return sentence[:1].upper() + sentence[1:]


def settings_text(values: Mapping[str, Any]) -> str:
    """Settings and their values, after the name of the set if it has one."""
    named = [f"{name} {value_text(value)}" for name, value in values.items() if name != "name"]
    return ", ".join([str(values["name"]), *named] if "name" in values else named)


def value_text(value: Any) -> str:
    """A setting's value."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


FILTERS = {function.__name__: function for function in (with_error, number, capital)}
"""What the templates write them with."""
