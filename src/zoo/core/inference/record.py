"""The record of how a run was made, which every posterior carries."""

from __future__ import annotations

import json
import platform
import sys
from dataclasses import asdict, dataclass, field, fields
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from zoo.core.words import OneLineError

_RECORD_ATTR = "run_record"
_VERSIONED = ("zoo", "pymc", "pytensor", "arviz", "numpy")


class ResultsError(OneLineError, ValueError):
    """A result file or an InferenceData cannot be used: one line with the file, the fault and the remedy."""


def versions() -> dict[str, str]:
    """Versions of this package, of Python and of the libraries that shape the draws.

    Returns
    -------
    dict
        Name -> version; a package that is not installed as a distribution is "unknown".
    """
    return {"python": platform.python_version()} | {name: _version(name) for name in _VERSIONED}


def _version(name: str) -> str:
    if name == "zoo" and hasattr(sys.modules["zoo"], "__version__"):
        return str(sys.modules["zoo"].__version__)
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "unknown"


@dataclass(frozen=True)
class RunRecord:
    """How a posterior was made: enough to make it again and to know what it cost.

    Parameters
    ----------
    model, study : str
        Names; `study` is empty for a model without a study.
    study_checksum : str
        Checksum of the study's data.
    conventions : dict
        The switches of the equations in force.
    solver : dict
        Options of the solver (dx in cm, tolerance in mmHg, ...).
    settings : dict
        Step method and its options, draws, tune, thin, chains, cores, target.
    seed : int
        Seed of the run; chain k draws from the k-th child of its seed sequence.
    solves, steps : int
        Solves of the flow model and steps of all chains, tuning included, mode search excluded.
    mode_evaluations : int
        Evaluations of the log-posterior spent on the search for the mode.
    failures : dict
        Failed solves by the name of their status.
    solves_per_draw, solves_per_step : float
        Solves over the stored draws of all chains, and over their steps.
    wall_seconds : float
        Duration in s, all sittings of a resumed run together.
    sittings : int
        How many times the run was started (1: never resumed; 0: the draws are of another sampler).
    started : str
        Start of the first sitting, ISO 8601, UTC.
    versions : dict
        Versions of zoo, python, pymc, pytensor, arviz, numpy.
    prior_check : dict or None
        Bounds of the priors that the posterior leans on, and what the data do not inform
        (`zoo.core.inference.prior_check.PriorCheck`); None of older runs and of models without a record.
    priors : dict or None
        Prior of each parameter in words; None as above.
    """

    model: str
    study: str
    study_checksum: str
    conventions: dict[str, Any]
    solver: dict[str, Any]
    settings: dict[str, Any]
    seed: int = 0
    solves: int = 0
    steps: int = 0
    mode_evaluations: int = 0
    failures: dict[str, int] = field(default_factory=dict)
    solves_per_draw: float = 0.0
    solves_per_step: float = 0.0
    wall_seconds: float = 0.0
    sittings: int = 0
    started: str = ""
    versions: dict[str, str] = field(default_factory=versions)
    prior_check: dict[str, Any] | None = None
    priors: dict[str, str] | None = None

    def to_json(self) -> str:
        """The record as one JSON object with sorted keys."""
        return json.dumps(asdict(self), sort_keys=True, default=plain)

    @classmethod
    def from_json(cls, text: str) -> RunRecord:
        """Read a record back from `to_json`; unknown fields of a later version are dropped.

        Raises
        ------
        ResultsError
            If the text is not JSON or a field is missing.
        """
        try:
            raw = json.loads(text)
        except json.JSONDecodeError as error:
            raise ResultsError(f"run record: not JSON ({error}); sample again to get a record") from None
        if not isinstance(raw, dict):
            raise ResultsError("run record: not a JSON object; sample again to get a record")
        names = [f.name for f in fields(cls)]
        for name in ("prior_check", "priors"):  # records of before have none
            raw.setdefault(name, None)
        missing = [name for name in names if name not in raw]
        if missing:
            raise ResultsError(f"run record: field {missing[0]!r} is missing; sample again to get a record")
        return cls(**{name: raw[name] for name in names})

    @classmethod
    def of(cls, idata: Any) -> RunRecord:
        """The record stored in an InferenceData.

        Raises
        ------
        ResultsError
            If there is none.
        """
        text = _text_of(idata)
        if text is None:
            raise ResultsError(
                "no run record in this InferenceData: zoo.sample writes one, and "
                "zoo.add_groups(idata, model) to the draws of another sampler"
            )
        return cls.from_json(str(text))

    @staticmethod
    def there(idata: Any) -> bool:
        """Whether an InferenceData has a record."""
        return _text_of(idata) is not None

    def attach(self, idata: Any) -> None:
        """Store the record in an InferenceData, at the root and in the posterior group."""
        idata.attrs[_RECORD_ATTR] = self.to_json()
        if "posterior" in idata:
            idata.posterior.attrs[_RECORD_ATTR] = self.to_json()


def _text_of(idata: Any) -> Any:
    text = idata.attrs.get(_RECORD_ATTR)
    if text is None and "posterior" in idata:
        text = idata.posterior.attrs.get(_RECORD_ATTR)
    return text


def plain(value: Any) -> Any:
    """A value in JSON's types."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Path):
        return value.name
    return str(value)
