"""Words and paths that are typed, read and checked."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from zoo.cli.command import UsageError

if TYPE_CHECKING:
    from zoo.blood.study import Study


def numbers(option: str, text: str, study: Study) -> list[float]:
    """One value, or one for each vessel in the order of the study's network file."""
    values = []
    for part in text.split(","):
        try:
            values.append(float(part))
        except ValueError:
            raise UsageError(
                f"{option} {text}: {part.strip()!r} is not a number; write 5.17e4 or 4e4,5e4"
            ) from None
        if not math.isfinite(values[-1]):
            raise UsageError(f"{option} {text}: {part.strip()!r} is not finite; give a finite number")
    n = len(study.vessels)
    if len(values) not in (1, n):
        raise UsageError(
            f"{option}: {len(values)} values; give one for all vessels, or one for each of the {n} vessels "
            f"of {study.name}, with commas between them"
        )
    return values


def model_name(name: str) -> str:
    """Name of a model: its letter, or that of a file of one's own, and after each "+" an effect."""
    from zoo.blood.plugins import known_name
    from zoo.core.effects import EffectError

    try:
        return known_name(name)
    except EffectError as error:
        raise UsageError(str(error)) from None


def names(text: str | None) -> list[str]:
    """Names that are given with commas."""
    return [part.strip() for part in (text or "").split(",") if part.strip()]


def some_names(option: str, text: str | None) -> list[str] | None:
    """At least one name, each once; None where the option is not given."""
    found = list(dict.fromkeys(names(text)))
    if text is not None and not found:
        raise UsageError(f"{option}: no names; give some with commas, or leave it out")
    return found or None


def model_names(text: str) -> list[str]:
    """Names of models, given with commas."""
    return [model_name(name) for name in names(text)]


def different_models(text: str) -> list[str]:
    """Names of models, each once."""
    names = model_names(text)
    if not names:
        raise UsageError(f"--models {text!r}: no names; give some with commas, such as --models A,B")
    if len(set(names)) < len(names):
        raise UsageError(f"--models {text}: give each model once, such as --models A,B")
    return names


def at_least(option: str, value: int, least: int) -> None:
    """Refuse a number that is too small."""
    if value < least:
        raise UsageError(f"{option} {value}: give at least {least}")
