"""What figures and pages ask a diagnosis for: its data, the study if there is one, locations in words."""

from __future__ import annotations

from typing import Any

from zoo.core.diagnosis import DiagnosisFile
from zoo.core.diagnosis.file import HypothesisResult
from zoo.core.effects import Location


def study_of(d: Any) -> Any:
    """The study that a diagnosis is of; None for other data."""
    return getattr(d, "study", None)


def location_of(file: DiagnosisFile, part: int | str | None, subtree: bool) -> str:
    """Such as "vessel 2 and below", with the simulator's word for a part."""
    shares = [*file.where.place, *(share for h in file.hypotheses for share in h.places)]
    noun = next((share.noun for share in shares if share.noun), "vessel")
    return str(Location(part, subtree, noun))


def at_most(h: HypothesisResult) -> str:
    """What stands before the discrepancy that an explanation leaves: "≤" where it was searched once."""
    return "" if h.searched_twice else "≤"


def unit_words(unit: str) -> str:
    """A unit after a number: " mmHg"; nothing for a pure number."""
    return "" if unit == "1" else f" {unit}"
