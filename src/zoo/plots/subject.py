"""What figures and pages ask a diagnosis for: its data, the study if there is one, locations in words."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.core.data import Data
from zoo.core.diag2 import Diagnosis, DiagnosisFile, Hooks
from zoo.core.diag2.hooks import QUARTERS
from zoo.core.diagnosis.diagnosis import PHASES, UNITS, phases
from zoo.core.effects import Location


def current(d: Any) -> Any:
    """A diagnosis in the form of `zoo.core.diag2`, also if it is of a study and in the former one.

    Parameters
    ----------
    d : Diagnosis
        Of either form.

    Returns
    -------
    Diagnosis
        Or what has its attributes `data`, `file`, `before`, `after`, `computed`, and `study`.
    """
    if isinstance(d, Diagnosis | SimpleNamespace):
        return d
    study = d.study
    data = Data(
        study.time_s,
        study.values,
        labels=[s.label for s in study.series],
        units=[UNITS[s.quantity] for s in study.series],
        groups=[s.quantity for s in study.series],
        period=study.period_s,
        name=study.name,
    )
    parts = {name: getattr(d, name) for name in ("before", "after", "computed")}
    return SimpleNamespace(data=data, study=study, file=current_file(d.file), **parts)


def current_file(file: Any) -> DiagnosisFile:
    """The content of diagnosis.json in the form of `zoo.core.diag2`."""
    return file if isinstance(file, DiagnosisFile) else DiagnosisFile.model_validate(file.model_dump())


def study_of(d: Any) -> Any:
    """The study that a diagnosis is of; None for other data."""
    return getattr(d, "study", None)


def location_of(file: DiagnosisFile, part: int | str | None, subtree: bool) -> str:
    """Such as "vessel 2 and below", with the simulator's word for a part."""
    shares = [*file.where.place, *(share for h in file.hypotheses for share in h.places)]
    noun = next((share.noun for share in shares if share.noun), "vessel")
    return str(Location(part, subtree, noun))


def unit_words(unit: str) -> str:
    """A unit after a number: " mmHg"; nothing for a pure number."""
    return "" if unit == "1" else f" {unit}"


def phases_of(d: Any) -> tuple[tuple[str, ...], NDArray[np.int_] | None]:
    """Names of the phases of a record, and the phase of each sample where that can be known."""
    data, names = d.data, tuple(d.file.where.phase)
    rows = [i for i, label in enumerate(data.labels) if label in d.file.where.series]
    if study_of(d) is not None:
        return PHASES, phases(data.values[rows[0]], data.duration)
    return Hooks().phases_of(data, rows) if names == QUARTERS else (names, None)
