"""Effects as a user names them: for a model, a command, a script."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from zoo.blood.effects.catalogue import CATALOGUE
from zoo.core.effects import EVERYWHERE, AddedEffect, Effect, EffectError, Location
from zoo.core.forward import ForwardModel

Given = str | Effect | AddedEffect | tuple[Any, ...]


def added_effects(given: Iterable[Given], model: ForwardModel) -> tuple[AddedEffect, ...]:
    """Effects at locations that a forward model has, from what a user gives.

    Parameters
    ----------
    given : iterable
        Each a name, such as "viscoelastic-wall", "local-stiffness@2" (vessel 2) or "local-stiffness@2+" (and
        all below); an `Effect`; a pair of one of these and a vessel's id or a `Location`; or an effect with
        its location, ``effect.at(Location(2))``.
    model : ForwardModel

    Returns
    -------
    tuple of AddedEffect

    Raises
    ------
    EffectError
        If an effect does not exist, or cannot act there.

    Examples
    --------
    ``added_effects(["viscoelastic-wall", ("local-stiffness", 2)], forward)``
    """
    return tuple(_added(one, model) for one in given)


def _added(one: Given, model: ForwardModel) -> AddedEffect:
    if isinstance(one, AddedEffect):
        made, location = one.effect, one.location
    else:
        name, *rest = one if isinstance(one, tuple) else (one,)
        location = _location(rest[0]) if rest else EVERYWHERE
        if isinstance(name, str) and "@" in name and not rest:
            name, _, part = name.partition("@")
            location = _location(part)
        made = CATALOGUE.check(name) if isinstance(name, Effect) else CATALOGUE[name]
    known = {place: place for place in made.locations(model)}
    if not known:
        raise EffectError(f"effect {made.name}: cannot be added to this study, which leaves no room for it")
    if location not in known:
        where = "everywhere" if set(known) == {EVERYWHERE} else f"at {', '.join(map(str, known))}"
        what = "the location is missing" if location == EVERYWHERE else f"cannot act at {location}"
        raise EffectError(f"effect {made.name}: {what}; it acts {where}")
    return made.of(model).at(known[location])


def _location(given: Any) -> Location:
    if isinstance(given, Location):
        return given
    text = str(given)
    part = text.removesuffix("+")
    if not part.isdigit():
        raise EffectError(f"location {text!r}: give a vessel's id, with + for it and all below, such as 2+")
    return Location(int(part), text.endswith("+"), "vessel")
