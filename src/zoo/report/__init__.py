"""Pages to read and to print: what models say of studies, how far to trust it, and how it was made."""

from zoo.report.chapter import Chapter
from zoo.report.chapters import gather, write_chapters, write_report
from zoo.report.diagnosis_page import diagnosis_files, write_diagnosis
from zoo.report.page import ReportError
