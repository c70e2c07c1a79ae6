"""Where a baseline model misses the data, and which effect explains it."""

from zoo.core.diagnosis.diagnosis import Diagnosis, diagnose
from zoo.core.diagnosis.file import DiagnosisError, DiagnosisFile, read_diagnosis
from zoo.core.diagnosis.hooks import Candidate, Hooks
from zoo.core.diagnosis.states import OtherState

__all__ = [
    "Candidate",
    "Diagnosis",
    "DiagnosisError",
    "DiagnosisFile",
    "Hooks",
    "OtherState",
    "diagnose",
    "read_diagnosis",
]
