"""Diagnosing the folders of cases, in processes, with resume, and reading the answers back."""

from __future__ import annotations

import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from zoo.core.blindcheck.answers import Answer
from zoo.core.blindcheck.keys import CaseKey
from zoo.core.blindcheck.sealing import BlindError, copy_digest, refuse_key_among
from zoo.core.inference.workers import each
from zoo.core.outputs import output_folder, write_file

FAILED = "failed.txt"


class FolderDiagnosis(Protocol):
    """A diagnosis of cases that are folders; an object that travels to other processes.

    Attributes
    ----------
    marker : str
        File by which the folder of a case is known.
    result : str
        File that a finished diagnosis leaves.
    """

    @property
    def marker(self) -> str: ...

    @property
    def result(self) -> str: ...

    def answered(self, case: Path, answer: Path) -> bool:
        """Whether the folder of the answer holds a diagnosis of this case by this program."""

    def diagnose(self, case: Path, answer: Path) -> None:
        """Diagnose the case and write into the folder of the answer, the result's file last."""


@dataclass(frozen=True)
class Ran:
    """What `run_folders` did: cases that are diagnosed (before or now), and those that failed.


    Parameters
    ----------
    diagnosed : tuple of str
    kept : tuple of str
        Those of them that were diagnosed before.
    failed : mapping
        Name -> reason.
    """

    diagnosed: tuple[str, ...]
    kept: tuple[str, ...]
    failed: Mapping[str, str]


@dataclass(frozen=True)
class _Task:
    diagnosis: FolderDiagnosis
    case: Path
    answer: Path


def _diagnose(task: _Task) -> str:
    """Diagnose a case; an empty text, or why it failed."""
    failed = task.answer / FAILED
    task.answer.mkdir(parents=True, exist_ok=True)
    failed.unlink(missing_ok=True)
    try:
        task.diagnosis.diagnose(task.case, task.answer)
    except Exception as error:
        (task.answer / task.diagnosis.result).unlink(missing_ok=True)
        reason = " ".join(str(error).split()) or type(error).__name__
        write_file(failed, f"{reason}\n\n{traceback.format_exc()}")
        return reason
    return ""


@dataclass(frozen=True)
class _Parcel:
    """A case as it travels to a worker that may not see our folders: its files, and how it is diagnosed."""

    diagnosis: FolderDiagnosis
    name: str
    files: Mapping[str, bytes]


def _diagnose_elsewhere(parcel: _Parcel) -> tuple[str, dict[str, bytes]]:
    """Diagnose a case in a folder of the worker; why it failed, and the files of the answer."""
    with tempfile.TemporaryDirectory(prefix="zoo-") as folder:
        case, answer = Path(folder, "case", parcel.name), Path(folder, "answer", parcel.name)
        _write_files(case, parcel.files)
        reason = _diagnose(_Task(parcel.diagnosis, case, answer))
        return reason, _read_files(answer)


def _read_files(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def _write_files(folder: Path, files: Mapping[str, bytes], last: str = "") -> None:
    for name in sorted(files, key=lambda name: (name == last, name)):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, files[name])


def _run(waiting: Sequence[_Task], cores: int, executor: Executor | None) -> Iterator[tuple[_Task, str]]:
    """Tasks with why they failed, or with an empty text; their answers are written."""
    if executor is None:
        yield from each(_diagnose, waiting, cores, name=lambda task: task.case.name)
        return
    task_of = {task.case.name: task for task in waiting}
    parcels = [_Parcel(task.diagnosis, name, _read_files(task.case)) for name, task in task_of.items()]
    for parcel, (reason, files) in each(
        _diagnose_elsewhere, parcels, executor=executor, name=lambda parcel: parcel.name
    ):
        task = task_of[parcel.name]
        for old in (FAILED, task.diagnosis.result):
            (task.answer / old).unlink(missing_ok=True)
        _write_files(task.answer, files, last=task.diagnosis.result)
        if not reason and not task.diagnosis.answered(task.case, task.answer):
            raise BlindError(
                f"{parcel.name}: was diagnosed by a worker with other versions than this program's, see "
                f"{task.answer}; install the same on all machines, and start the workers again"
            )
        yield task, reason


def run_folders(
    cases: Path,
    answers: Path,
    diagnosis: FolderDiagnosis,
    *,
    cores: int = 1,
    executor: Executor | None = None,
    done: Callable[[str], None] = lambda case: None,
) -> Ran:
    """Diagnose every case of a folder, each in a process of its own; no key is read or looked for.

    An answer that is already there is left as it is, so that an interrupted run goes on. A case that fails
    has failed.txt instead.

    Parameters
    ----------
    cases : Path
        With a folder for each case.
    answers : Path
        Gets a folder for each case, and the digest of the key.
    diagnosis : FolderDiagnosis
    cores : int
        Processes.
    executor : concurrent.futures.Executor, optional
        Diagnoses the cases instead, on machines that need not see these folders: a task is the case's files,
        and what comes back are the answer's.
    done : callable
        Told the name of each case that is finished.

    Returns
    -------
    Ran

    Raises
    ------
    BlindError
        If the folder holds a key or no case, or answers and cases are one folder; if a worker has other
        versions than this program.
    zoo.core.inference.workers.LostTaskError
        If the worker of a case died as often as it may.
    """
    if not cases.is_dir():
        raise BlindError(f"{cases}: no such folder; give one of `zoo blind make`")
    if cores < 1:
        raise BlindError(f"cores = {cores}: must be at least 1")
    refuse_key_among(cases)
    if cases.resolve() in (answers.resolve(), *answers.resolve().parents):
        raise BlindError(f"{answers}: lies inside {cases}, the cases; give another folder for the answers")
    output_folder(answers, deep=True)
    found = sorted(p for p in cases.iterdir() if (p / diagnosis.marker).is_file())
    if not found:
        raise BlindError(f"{cases}: holds no folder with a {diagnosis.marker}; give one of `zoo blind make`")
    answers.mkdir(parents=True, exist_ok=True)
    copy_digest(cases, answers)
    kept, waiting = [], []
    for case in found:
        if diagnosis.answered(case, answers / case.name):
            kept.append(case.name)
            done(case.name)
        else:
            waiting.append(_Task(diagnosis, case, answers / case.name))
    failed = {}
    for task, reason in _run(waiting, cores, executor):
        if reason:
            failed[task.case.name] = reason
        done(task.case.name)
    diagnosed = tuple(case.name for case in found if case.name not in failed)
    return Ran(diagnosed, tuple(kept), dict(sorted(failed.items())))


def read_answers(
    answers: Path, keys: Sequence[CaseKey], read: Callable[[Path], Answer], *, result: str
) -> tuple[dict[str, Answer | None], int]:
    """Read the answers to the cases of a key.

    Parameters
    ----------
    answers : Path
        From `run_folders`.
    keys : sequence of CaseKey
    read : callable
        Reads the answer in a folder.
    result : str
        File that a finished diagnosis leaves.

    Returns
    -------
    dict
        Case -> answer, None where the diagnosis failed.
    int
        Answers without a key.

    Raises
    ------
    BlindError
        If a case has neither been diagnosed nor failed, or an answer is about other data.
    """
    there = {p.name for p in answers.iterdir() if p.is_dir()}
    known = {key.case for key in keys}
    if not there & known:
        raise BlindError(f"{answers}: holds no answer to a case of the key; give the answers to these cases")
    found: dict[str, Answer | None] = {}
    for key in keys:
        folder = answers / key.case
        if (folder / result).is_file():
            answer = found[key.case] = read(folder)
            if key.digest and answer.checksum != key.digest:
                raise BlindError(f"{folder}: {result} is about other data than the case; run it again")
        elif (folder / FAILED).is_file():
            found[key.case] = None
        else:
            raise BlindError(f"{folder}: neither {result} nor {FAILED}; finish `zoo blind run` first")
    return found, len(there - known)
