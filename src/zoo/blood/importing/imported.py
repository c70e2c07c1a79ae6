"""A study made of other files, with what is told about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

import numpy as np

from zoo.blood.study import STUDY_FILES, Blood, Study, StudyError, Vessel, load_study, save_study
from zoo.blood.study.resampling import denser, even_samples
from zoo.core.arrays import Array
from zoo.core.outputs import output_folder
from zoo.core.words import OneLineError


class ImportedFileError(OneLineError, ValueError):
    """A file that cannot be imported: one line with the file, row, field, value and remedy."""


LEAST = 1e-30
"""Of numbers that are positive, which are at most the inverse."""


def check_positive(where: object, **numbers: float) -> None:
    """Refuse an argument, by what it is called, that is not positive and finite."""
    for word, value in numbers.items():
        if not LEAST <= value <= 1 / LEAST:
            raise ImportedFileError(
                f"{where}: {word.replace('_', ' ')} = {value!r}: must be positive and finite, from "
                f"{LEAST:g} to {1 / LEAST:g}; correct it"
            )


def check_flow(where: object, flow: Array) -> None:
    """Refuse an inflow (n_times,) that flows out in the mean."""
    if not flow.mean() > 0:
        raise ImportedFileError(
            f"{where}: mean flow_ml_s = {flow.mean():.6g}: must be positive; count what flows in as positive"
        )


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

    files: ClassVar[tuple[str, ...]] = STUDY_FILES
    study: Study
    read: tuple[str, ...]
    converted: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def save(self, folder: str | Path, *, replace: bool = False) -> Study:
        """Write the study as a folder, and load it from there.

        Parameters
        ----------
        folder : str or Path
            Made when absent.
        replace : bool
            The files of a study that are in the folder.

        Returns
        -------
        Study
            As `zoo.load_study` reads it.

        Raises
        ------
        ImportedFileError
            If a file of a study is in the folder already, or the files make no study: then none is written.
        zoo.core.outputs.OutputFileError
            If the folder or a file cannot be written.
        """
        folder = output_folder(folder, self.files, deep=True)
        there = [] if replace else [name for name in self.files if (folder / name).exists()]
        if there:
            raise ImportedFileError(f"{folder / there[0]}: is there already; give another folder")
        with TemporaryDirectory() as tried:
            save_study(self.study, tried)
            try:
                load_study(tried)
            except StudyError as error:
                text = str(error).replace(tried, str(folder))
                raise ImportedFileError(f"{self.study.source}: makes no study: {text}") from None
        save_study(self.study, folder)
        return load_study(folder)


def study_of(
    path: Path,
    vessels: Sequence[Vessel],
    blood: Blood,
    curve: Array,
    period: float,
    radius_pressure_mmHg: float = 0.0,
) -> tuple[Study, float]:
    """A study without observations, and by how much its inflow is off rows of time and flow, in ml/s."""
    even, distance = even_samples(curve[:, 0], curve[:, 1], period)
    flow = denser(even)
    study = Study(
        name=path.stem,
        period_s=period,
        blood=blood,
        vessels=tuple(vessels),
        inflow_time_s=np.asarray(np.arange(len(flow)) * (period / len(flow)), dtype=np.float64),
        inflow_ml_s=flow,
        time_s=np.empty(0),
        series=(),
        source=path,
        radius_pressure_mmHg=radius_pressure_mmHg,
    )
    return study, distance
