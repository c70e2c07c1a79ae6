"""Bayesian models of pulmonary blood flow: one beat of measured flow and pressure to a comparison of models.

Everything listed in ``__all__`` is loaded when it is first used, so that importing this package, a model
or ``load_study`` takes a moment and not the seconds that PyMC needs.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from zoo.models import MODELS

__version__ = "0.1.0"

_HOME = {
    "Conventions": "blood.conventions",
    "PRINTED": "blood.conventions",
    "PUBLISHED_CODE": "blood.conventions",
    "get_conventions": "blood.conventions",
    "FetchError": "blood.fetch",
    "fetch_dataset": "blood.fetch",
    "Series": "blood.study",
    "Study": "blood.study",
    "StudyError": "blood.study",
    "UnitWarning": "blood.study",
    "Vessel": "blood.study",
    "list_studies": "blood.study",
    "load_study": "blood.study",
    "save_study": "blood.study",
    "suspect_units": "blood.study",
    "ImportedFileError": "blood.importing.imported",
    "import_openbf": "blood.importing.openbf",
    "import_table": "blood.importing.table",
    "Network": "blood.network",
    "Solver": "blood.solver",
    "SolverError": "blood.solver",
    "SolverOptions": "blood.solver",
    "Effect": "core.effects",
    "EffectParameter": "core.effects",
    "Location": "core.effects",
    "effect": "blood.effects",
    "sample": "core.posterior.groups",
    "add_groups": "core.posterior.groups",
    "find_mode": "core.inference.mode",
    "step": "core.inference.pymc_step",
    "compare": "core.posterior.comparison",
    "diagnose": "front",
    "read_diagnosis": "core.diagnosis",
}

__all__ = ["__version__", *_HOME, *(f"model_{letter}" for letter in MODELS)]


def _model(letter: str) -> Any:
    """Function that builds a model; PyMC is imported when it is called."""
    module, name = f"zoo.models.model_{letter.lower()}", f"model_{letter}"

    def build(study: Any, **settings: Any) -> Any:
        return getattr(import_module(module), name)(study, **settings)

    build.__name__ = build.__qualname__ = name
    build.__module__ = __name__
    build.__doc__ = f"Model {letter} of a study, a ``pm.Model``; its priors and settings are in {module}."
    return build


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(f"zoo.{_HOME[name]}"), name)
    elif name in __all__:
        value = _model(name.removeprefix("model_"))
    else:
        raise AttributeError(f"module 'zoo' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
