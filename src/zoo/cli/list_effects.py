"""`zoo effects`: what a model may lack."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from zoo.cli.command import Role, Without, argument, command
from zoo.cli.options import JSON, PluginOptions
from zoo.cli.screen import plain_table, say, say_json

if TYPE_CHECKING:
    from zoo.blood.effects import Effect

LOCATION_WORDS = {
    "everywhere": "everywhere",
    "each_vessel": "each vessel",
    "vessels_and_subtrees": "each vessel, each subtree",
    "sides_and_terminals": "each side, each terminal",
}
"""Function that lists the locations of an effect -> what these are."""


@command
def effects(
    name: str | None = argument(
        "[NAME]", "One effect, such as viscoelastic-wall.", Role.EFFECTS, default=None
    ),
    as_json: bool = JSON,
    *,
    plugins: Annotated[PluginOptions, Without("models_from")],
) -> None:
    """List the effects that a baseline may lack; with a name, all that is known about one."""
    from zoo.blood.effects import CATALOGUE

    plugins.load()
    chosen = list(CATALOGUE.values()) if name is None else [CATALOGUE[name]]
    if as_json:
        say_json([described(effect) for effect in chosen])
    elif name is None:
        say(_effects_table(chosen))
    else:
        say(*_effect_lines(chosen[0]))


def _locations(effect: Effect) -> str:
    """Where an effect can act, in words."""
    from zoo.core.effects import EverywhereIf

    function = getattr(effect.locations, "__name__", "")
    if isinstance(effect.locations, EverywhereIf):
        return LOCATION_WORDS["everywhere"]
    return LOCATION_WORDS.get(function, function.replace("_", " ") or "some locations")


def described(effect: Effect) -> dict[str, Any]:
    """All that is known about an effect."""
    names = ("name", "family", "statement", "equation", "signature", "source")
    parameters = [{"name": p.name, "unit": p.unit, "prior": p.text, "why": p.why} for p in effect.parameters]
    return {name: getattr(effect, name) for name in names} | {
        "parameters": parameters, "locations": _locations(effect), "baselines": list(effect.baselines)
    }  # fmt: skip


def _effects_table(chosen: Sequence[Effect]) -> Any:
    """An effect a row, by family, with all but the name in one column."""
    from rich.text import Text

    from zoo.blood.effects import FAMILIES

    table = plain_table("effect", "parameter, prior, locations, what it does to a beat")
    for family in FAMILIES:
        members = [effect for effect in chosen if effect.family == family]
        if members:
            table.add_row(Text(family, style="bold"))
        for effect in members:
            lines = [
                f"{p.name} ({p.unit}) ~ {p.text if p.measure else p.prior.text}" for p in effect.parameters
            ]
            table.add_row(f"  {effect.name}", "\n".join((*lines, _locations(effect), effect.signature)))
    return table


def _effect_lines(effect: Effect) -> list[Any]:
    from rich.text import Text

    table = plain_table("", "", heads=False)
    rows = [(n, str(getattr(effect, n))) for n in ("family", "statement", "equation", "signature")]
    for parameter in effect.parameters:
        words = [f"{parameter.name} ({parameter.unit}) ~ {parameter.text}", parameter.why]
        words.append("0 is the baseline" if parameter.zero_is_base else "a shape, which no baseline has")
        rows.append(("parameter", "; ".join(word for word in words if word)))
    rows += [("locations", _locations(effect)), ("baselines", ", ".join(effect.baselines) or "all")]
    rows.append(("source", effect.source))
    for what, text in rows:
        table.add_row(Text(what, style="bold"), Text(text))
    return [Text(effect.name, style="bold"), table]
