"""Pages to read and to print: what models say of studies, how far to trust it, and how it was made."""

from zoo.report.chapter import Chapter, sampling_command
from zoo.report.chapters import BANNER, gather, stored, write_chapters, write_report
from zoo.report.diagnosis import (
    diagnosis_files,
    diagnosis_summary,
    next_measurement_words,
    total_seconds,
    write_diagnosis,
)
from zoo.report.page import ReportError
from zoo.report.sentences import summary

__all__ = [
    "BANNER",
    "Chapter",
    "ReportError",
    "diagnosis_files",
    "diagnosis_summary",
    "gather",
    "next_measurement_words",
    "sampling_command",
    "stored",
    "summary",
    "total_seconds",
    "write_chapters",
    "write_diagnosis",
    "write_report",
]
