"""Where a baseline model misses the data, and which effect explains it."""

from zoo.core.diag2.diagnosis import Diagnosis, diagnose
from zoo.core.diag2.file import DiagnosisError, DiagnosisFile, read_diagnosis
from zoo.core.diag2.hooks import Candidate, Hooks

__all__ = ["Candidate", "Diagnosis", "DiagnosisError", "DiagnosisFile", "Hooks", "diagnose", "read_diagnosis"]
