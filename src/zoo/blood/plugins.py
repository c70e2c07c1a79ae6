"""Models and effects of a user's own, and models by names with effects, such as "G+viscoelastic-wall"."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from zoo.blood.effects import CATALOGUE
from zoo.core.effects import Effect, EffectError, effects_in, load_module
from zoo.core.words import nearest

if TYPE_CHECKING:
    import pymc as pm

Builder = Callable[..., "pm.Model"]
USER_MODELS: dict[str, Builder] = {}
"""Models that `load_models` has read, by name."""


def load_models(path: str | Path) -> dict[str, Builder]:
    """The models that a Python file defines: its functions ``model_NAME(study, **settings)``, by NAME.

    This executes the file: give only one that you trust. The models can then be named in `get_model`, and
    effects that the file defines in `effects`.

    Parameters
    ----------
    path : path
        Of a file like those of `zoo.models`.

    Returns
    -------
    dict

    Raises
    ------
    EffectError
        If the file cannot be run, defines no model, or one with the letter of a model of the package.
    """
    from zoo.models import MODELS

    module = load_module(path)
    found: dict[str, Builder] = {
        name.removeprefix("model_"): function
        for name, function in vars(module).items()
        if name.startswith("model_") and callable(function) and function.__module__ == module.__name__
    }
    if not found:
        raise EffectError(f"{path}: defines no model; write a function model_NAME(study, **settings)")
    for name in found:
        if name.upper() in MODELS:
            raise EffectError(f"{path}: model_{name}: {name.upper()} is a model of the package; rename it")
    for made in effects_in(module):
        CATALOGUE.add(made)
    USER_MODELS.update(found)
    return found


def add_effects(path: str | Path) -> list[Effect]:
    """Put the effects that a Python file defines into the catalogue, so that they can be named.

    This executes the file: give only one that you trust.

    Returns
    -------
    list of Effect

    Raises
    ------
    EffectError
        If the file cannot be run, or defines none.
    """
    from zoo.core.effects import load_effects

    return [CATALOGUE.add(made) for made in load_effects(path)]


def get_model(name: str) -> Builder:
    """The function that builds a model, from the name that its record has.

    Parameters
    ----------
    name : str
        A letter, or the name of a model of one's own, and after each "+" an effect: "B",
        "G+viscoelastic-wall", "C+local-stiffness@8++taper" (at vessel 8 and all below, and a taper).

    Returns
    -------
    callable
        ``build(study, *, options=None, conventions=None) -> pm.Model``.

    Raises
    ------
    EffectError
        If there is no such model or effect.
    """
    from zoo.models import MODELS
    from zoo.models import get_model as of_package

    bare, *effects = split_name(known_name(name))
    build: Builder = of_package(bare) if bare in MODELS else USER_MODELS[bare]
    if effects and not _takes(build, "effects"):
        raise EffectError(
            f"model {bare}: its function takes no effects; make it by "
            f"model_{bare} = zoo.study_model(...), or let it take effects=()"
        )
    return partial(build, effects=effects) if effects else build


def _takes(build: Builder, setting: str) -> bool:
    parameters = inspect.signature(build).parameters
    return setting in parameters or any(p.kind is p.VAR_KEYWORD for p in parameters.values())


def known_name(name: str) -> str:
    """A model's name, its letter in upper case, when the model and its effects exist.

    Raises
    ------
    EffectError
        If one does not.
    """
    from zoo.models import MODELS

    bare, *effects = split_name(name)
    if bare not in MODELS and bare not in USER_MODELS:
        raise EffectError(f"model {bare!r}: {nearest(bare, [*MODELS, *USER_MODELS])}")
    for effect in effects:
        CATALOGUE[effect.partition("@")[0]]
    return "+".join([bare, *effects])


def split_name(name: str) -> list[str]:
    """A model's name as its own and those of its effects, the letter in upper case.

    Examples
    --------
    >>> split_name("g+local-stiffness@8++taper")
    ['G', 'local-stiffness@8+', 'taper']
    """
    bare, *effects = re.split(r"\+(?=[^\W\d])", name.strip())
    return [bare.upper() if len(bare) == 1 else bare, *(effect.strip() for effect in effects)]
