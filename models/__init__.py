"""The models of Paun et al. 2020 and those beside them, one short file each; installed as ``zoo.models``."""

from __future__ import annotations

import pkgutil
import re
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    import pymc as pm

if __name__ != "zoo.models":
    raise ImportError(
        f"the models were imported as {__name__!r}: use `from zoo import model_A` or `import zoo.models`; "
        "a second copy under another name would not be the one that the package uses"
    )

PAPER = ("A", "B", "C", "D", "E", "F", "G", "H", "I")
"""The models of Table 2."""
MODELS = tuple(
    sorted(m[-1].upper() for _, m, _ in pkgutil.iter_modules(__path__) if re.fullmatch("model_[a-z]", m))
)
"""The letters of all models: each file ``model_x.py`` here is one."""


def _module(name: str) -> tuple[Any, str]:
    letter = name.upper()
    if letter not in MODELS:
        raise ValueError(f"model {name!r}: must be one of {', '.join(MODELS)}")
    return import_module(f"zoo.models.model_{letter.lower()}"), letter


def get_model(name: str) -> Callable[..., pm.Model]:
    """The function that builds a model from a study.

    Parameters
    ----------
    name : str
        Its letter, upper or lower case.

    Returns
    -------
    callable
        ``model_X(study, *, effects=(), options=None, conventions=None, priors=None) -> pm.Model``.

    Raises
    ------
    ValueError
        If there is no such model.
    """
    module, letter = _module(name)
    model: Callable[..., pm.Model] = getattr(module, f"model_{letter}")
    return model


def suggested(name: str) -> dict[str, float]:
    """Values of every free parameter of a model, near the published posterior medians.

    Parameters
    ----------
    name : str
        Its letter, upper or lower case.

    Returns
    -------
    dict
        In the units of the model's file.

    Raises
    ------
    ValueError
        If there is no such model.
    """
    module, _ = _module(name)
    parameters = (*module.BASELINE.parameters, *module.ERRORS.parameters)
    return {p.name: p.first for p in parameters}
