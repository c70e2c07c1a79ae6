"""A study made of other files, with what is told about it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from zoo.blood.study import STUDY_FILES, Study, StudyError, load_study, save_study
from zoo.core.outputs import output_folder
from zoo.core.words import OneLineError


class ImportedFileError(OneLineError, ValueError):
    """A file that cannot be imported: one line with the file, row, field, value and remedy."""


@dataclass(frozen=True)
class Imported:
    """A study that was read from files of another form.

    Parameters
    ----------
    study : Study
    read : tuple of str
        What was read, a line each: vessels, outlets, physics.
    converted : tuple of str
        Units and readings that were changed.
    left_out : tuple of str
        What the files hold that a study does not.
    """

    study: Study
    read: tuple[str, ...]
    converted: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def save(self, folder: str | Path) -> Study:
        """Write the study as a folder, and load it from there.

        Parameters
        ----------
        folder : str or Path
            Made when absent; it must not hold a study.

        Returns
        -------
        Study
            As `zoo.load_study` reads it.

        Raises
        ------
        ImportedFileError
            If there is a study in the folder already, or the files make no study; of that nothing is left.
        zoo.core.outputs.OutputFileError
            If the folder or a file cannot be written.
        """
        folder = output_folder(folder, STUDY_FILES, deep=True)
        if (folder / "study.toml").exists():
            raise ImportedFileError(f"{folder}: holds a study already; give another folder, or remove it")
        made = not folder.exists()
        save_study(self.study, folder)
        try:
            return load_study(folder)
        except StudyError as error:
            for name in STUDY_FILES:
                (folder / name).unlink(missing_ok=True)
            if made:
                folder.rmdir()
            raise ImportedFileError(f"{self.study.source}: makes no study: {error}") from None
