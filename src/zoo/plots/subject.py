"""What figures and pages ask a diagnosis for: its study, locations, sets and numbers in words."""

from __future__ import annotations

from typing import Any

from zoo.core.diagnosis import DiagnosisFile
from zoo.core.diagnosis.file import LocationShare, SetResult
from zoo.core.effects import Location

TOLD = 0.01
"""Least probability or share that is told."""


def study_of(d: Any) -> Any:
    """The study that a diagnosis is of; None for other data."""
    return getattr(d, "study", None)


def location_of(share: LocationShare) -> str:
    """Such as "vessel 2 and below", with the simulator's word for a part."""
    return str(Location(share.part, share.subtree, share.noun))


def leading_sets(file: DiagnosisFile, most: int) -> list[SetResult]:
    """The most probable sets of causes, at most so many, and that of none."""
    told = [row for row in file.sets if row.probability >= TOLD][:most]
    return told + [row for row in file.sets if not row.causes and row not in told]


def set_name(row: SetResult) -> str:
    """Its causes, or that there is none."""
    return " + ".join(row.causes) or "no cause"
