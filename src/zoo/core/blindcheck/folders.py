"""Cases that are folders: written with a sealed key, diagnosed with resume, and read back to be scored."""

from __future__ import annotations

import json
import os
import random
import tempfile
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

from pydantic import ValidationError

from zoo.core import digests
from zoo.core.blindcheck.cases import Answer, BlindError, CaseKey
from zoo.core.inference.workers import each
from zoo.core.outputs import OURS, output_file, output_folder, write_file

KEY_DIGEST = "KEY.sha256"
ANSWER, FAILED = "answer.json", "failed.txt"
_TIME = 1577836800
"""Time stamp of every file of a case: when one was made tells how long its solves took."""
J = TypeVar("J")


class MadeCase(NamedTuple):
    """A case that is made and not yet written: its entry of the key, and its files by name."""

    key: CaseKey
    files: Mapping[str, str]


def digest_of(files: Mapping[str, bytes]) -> str:
    """SHA-256 of the names and contents of files."""
    return digests.of_json({name: digests.of_bytes(content) for name, content in files.items()})


def write_cases(
    folder: Path,
    key: Path,
    jobs: Sequence[J],
    make: Callable[[J], MadeCase],
    *,
    head: Mapping[str, Any],
    cores: int = 1,
    done: Callable[[str], None] = lambda case: None,
) -> None:
    """Make cases, then write all of them in one pass, the key apart, and the key's SHA-256 beside the cases.

    Nothing is computed between two files, and the cases are written in an order that nobody knows: neither
    times of birth nor the numbers that the file system gives tell how long a case took or when it came. The
    times that can be set are one.

    Parameters
    ----------
    folder, key : Path
        New, or an empty folder; the key's file is new and not inside it.
    jobs : sequence
        One for each case, in the order of the key.
    make : callable
        Makes the case of a job. Importable by name if cores > 1.
    head : mapping
        All that shapes the cases, in JSON's types; the key begins with it.
    cores : int
    done : callable
        Told the name of each finished case.

    Raises
    ------
    BlindError
    zoo.core.outputs.OutputFileError
        If the folder or the key cannot be written, or something would be lost.
    """
    if folder.resolve() in (key.resolve(), *key.resolve().parents):
        raise BlindError(f"{key}: lies inside {folder}, where the cases are; put the key elsewhere")
    if key.exists():
        raise BlindError(f"{key}: is there already; give another --key, or remove it with its cases")
    output_file(key)
    output_folder(folder, deep=True)
    if folder.is_dir() and (rest := sorted(p.name for p in folder.iterdir())):
        raise BlindError(f"{folder}: holds {rest[0]}; give a new or empty folder")
    made = []
    with closing(each(make, jobs, cores)) as found:
        for _, one in found:
            files = {name: text.encode() for name, text in one.files.items()}
            made.append((one.key.model_copy(update={"files": digest_of(files)}), files))
            done(one.key.case)
    made.sort(key=lambda one: one[0].case)
    contents = [(folder / own.case / name, content) for own, files in made for name, content in files.items()]
    random.SystemRandom().shuffle(contents)
    if key.exists():  # of another run that was made meanwhile
        raise BlindError(f"{key}: is there by now; give another --key")
    folder.mkdir(parents=True, exist_ok=True)
    for path in dict.fromkeys(path.parent for path, _ in contents):
        path.mkdir()
    for path, content in contents:
        path.write_bytes(content)
    entries = [own.model_dump(mode="json", exclude_defaults=True) for own, _ in made]
    text = json.dumps({**head, "cases": entries}) + "\n"
    write_file(key, text, private=True)
    write_file(folder / KEY_DIGEST, f"{digests.of_bytes(text.encode())}  key.json\n")
    for path in (*folder.rglob("*"), folder):
        os.utime(path, (_TIME, _TIME))


class CaseDiagnosis(Protocol):
    """A diagnosis of cases that are folders; an object that travels to other processes.

    Attributes
    ----------
    marker : str
        File by which the folder of a case is known.
    """

    @property
    def marker(self) -> str:
        """File by which the folder of a case is known, such as study.toml."""

    def identity(self) -> Mapping[str, Any]:
        """What is asked, and of which program, in JSON's types: an answer of another one is not kept."""

    def __call__(self, case: Path, answer: Path) -> Answer:
        """Diagnose the case; what it writes into the folder `answer` is kept beside its answer."""


def _diagnose(
    diagnosis: CaseDiagnosis, parcel: tuple[str, Mapping[str, bytes]]
) -> tuple[dict[str, Any], Mapping[str, bytes]]:
    """Diagnose a case in a folder of the worker, which sees nothing but the case's own files.

    What answer.json will hold comes back, or with `failed` why there is no answer, and the files beside it.
    """
    name, files = parcel
    about = {"case": digest_of(files), "asked": dict(diagnosis.identity())}
    with tempfile.TemporaryDirectory(prefix="zoo-") as folder:
        case, out = Path(folder, "case", name), Path(folder, "answer", name)
        for place in (case, out):
            place.mkdir(parents=True)
        for one, content in files.items():
            (case / one).write_bytes(content)
        try:
            answer = json.loads(diagnosis(case, out).model_dump_json(exclude_defaults=True))
        except Exception as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            return {**about, "failed": f"{reason}\n\n{traceback.format_exc()}"}, {}
        beside = {p.name: p.read_bytes() for p in sorted(out.iterdir()) if p.is_file()}
    written = {one: digests.of_bytes(content) for one, content in beside.items()}
    return {**about, "written": written, "answer": answer}, beside


@dataclass(frozen=True)
class Ran:
    """What `run_cases` did: cases that are diagnosed (before or now), and those that failed.

    `kept` are those of them that were diagnosed before; `failed` has each one's reason.
    """

    diagnosed: tuple[str, ...]
    kept: tuple[str, ...]
    failed: Mapping[str, str]


def case_files(case: Path) -> dict[str, bytes]:
    """The files of a case, none of which may be a link or a folder: nothing outside of it is read.

    Raises
    ------
    BlindError
    """
    found = {}
    for path in (case, *sorted(case.iterdir())):
        if path.is_symlink() or not (path.is_file() or path == case):
            raise BlindError(f"{path}: is a link or no file; put the file itself there")
        if path != case:
            found[path.name] = path.read_bytes()
    return found


def run_cases(
    cases: Path,
    answers: Path,
    diagnosis: CaseDiagnosis,
    *,
    cores: int = 1,
    executor: Executor | None = None,
    fresh: bool = False,
    done: Callable[[str], None] = lambda case: None,
) -> Ran:
    """Diagnose every case of a folder, each by a worker that gets its files; no key is read or looked for.

    An answer to the same files, question and program is left as it is, so that an interrupted run goes on. A
    case that fails has failed.txt instead.

    Parameters
    ----------
    cases : Path
        With a folder for each case.
    answers : Path
        Gets a folder for each case, and the digest of the key.
    diagnosis : CaseDiagnosis
    cores : int
        Processes.
    executor : concurrent.futures.Executor, optional
        Diagnoses the cases instead, on machines that need not see these folders.
    fresh : bool
        Replace answers to other data or questions, or of another program.
    done : callable
        Told the name of each case that is finished.

    Returns
    -------
    Ran

    Raises
    ------
    BlindError
        If the folder holds a key or no case, or answers and cases are one folder; if an answer would be
        replaced; if a worker has other versions than this program.
    zoo.core.inference.workers.LostTaskError
        If the worker of a case died as often as it may.
    """
    if not cases.is_dir():
        raise BlindError(f"{cases}: no such folder; give one of `zoo blind make`")
    if cores < 1:
        raise BlindError(f"cores = {cores}: must be at least 1")
    _refuse_key_among(cases)
    if cases.resolve() in (answers.resolve(), *answers.resolve().parents):
        raise BlindError(f"{answers}: lies inside {cases}, the cases; give another folder for the answers")
    output_folder(answers, deep=True)
    found = sorted(p for p in cases.iterdir() if (p / diagnosis.marker).is_file())
    if (cases / KEY_DIGEST).is_symlink():
        raise BlindError(f"{cases / KEY_DIGEST}: is a link; put the file itself there")
    if not found:
        raise BlindError(f"{cases}: holds no folder with a {diagnosis.marker}; give one of `zoo blind make`")
    identity = json.loads(json.dumps(diagnosis.identity()))
    kept, waiting, failed = [], [], {}
    for case in found:
        try:
            files = case_files(case)
        except BlindError as error:
            failed[case.name] = str(error)
            done(case.name)
            continue
        if _is_answered(answers / case.name, digest_of(files), identity, fresh=fresh):
            kept.append(case.name)
            done(case.name)
        else:
            folder = answers / case.name
            there = sorted(p.name for p in folder.iterdir()) if folder.is_dir() else []
            output_folder(folder, [name for name in there if not OURS.fullmatch(name)], "answer", deep=True)
            waiting.append((case.name, files))
    answers.mkdir(parents=True, exist_ok=True)
    if (cases / KEY_DIGEST).is_file():
        write_file(answers / KEY_DIGEST, (cases / KEY_DIGEST).read_bytes())
    work = partial(_diagnose, diagnosis)
    with closing(each(work, waiting, cores, executor=executor, name=lambda parcel: parcel[0])) as results:
        for (name, _), (stored, beside) in results:
            if stored["asked"] != identity:
                raise BlindError(
                    f"{name}: was diagnosed by a worker with other versions than this program's; "
                    "install the same on all machines, and start the workers again"
                )
            _write_answer(answers / name, stored, beside)
            if "failed" in stored:
                failed[name] = stored["failed"].splitlines()[0]
            done(name)
    diagnosed = tuple(case.name for case in found if case.name not in failed)
    return Ran(diagnosed, tuple(kept), dict(sorted(failed.items())))


def _refuse_key_among(cases: Path) -> None:
    """Refuse a folder that holds a key, beside the cases or inside one; nowhere else is looked."""
    for place in (cases, *sorted(p for p in cases.iterdir() if p.is_dir() and not p.is_symlink())):
        for path in sorted(place.iterdir()):
            if "key" in path.name.lower() and path.suffix.lower() == ".json":
                raise BlindError(
                    f"{path}: a key lies with the cases; move it elsewhere, a diagnosis must not see it"
                )


def _is_answered(folder: Path, files: str, identity: Mapping[str, Any], *, fresh: bool) -> bool:
    """Whether the answer is there; refuses what this run did not write, and may not replace."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise BlindError(f"{folder}: is a link or no folder; give another folder for the answers")
    there = [p for p in folder.iterdir() if not OURS.fullmatch(p.name)] if folder.exists() else []
    for path in there:
        if path.is_symlink() or not path.is_file():
            raise BlindError(f"{path}: is a link or no file; give another folder for the answers")
    if not there or (folder / FAILED).is_file():
        return False
    if not (folder / ANSWER).is_file():
        raise BlindError(f"{folder}: holds other files than an answer's; give another folder")
    try:
        stored, _ = stored_answer(folder)
        if (stored["case"], stored["asked"]) == (files, identity):
            return True
    except BlindError:
        pass
    if not fresh:
        raise BlindError(
            f"{folder}: holds an answer to other data or settings, of another version, or a damaged one; "
            "give another folder, or --fresh to replace it"
        )
    return False


def _write_answer(folder: Path, stored: Mapping[str, Any], beside: Mapping[str, bytes]) -> None:
    """Write what came back; until the answer is whole, failed.txt says that it is not."""
    folder.mkdir(parents=True, exist_ok=True)
    write_file(folder / FAILED, stored.get("failed", "interrupted\n"))
    output_file(folder / ANSWER).unlink(missing_ok=True)
    if "failed" in stored:
        return
    for name, content in beside.items():
        write_file(folder / name, content)
    write_file(folder / ANSWER, digests.to_text(stored, indent=None))
    (folder / FAILED).unlink()


def stored_answer(folder: Path) -> tuple[dict[str, Any], Answer]:
    """An answer with what it is about, checked by its digest and those of the files beside it."""
    path = folder / ANSWER
    try:
        found = digests.from_text(path.read_bytes(), required=True)
        for name, digest in found["written"].items():
            if digests.of_bytes((folder / name).read_bytes()) != digest:
                raise ValueError
        if not isinstance(found["case"], str) or not isinstance(found["asked"], dict):
            raise ValueError
        return found, Answer.model_validate(found["answer"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise BlindError(
            f"{path}: is missing or broken, or a file beside it was changed; make it again with "
            "`zoo blind run --fresh`"
        ) from None


def read_key(key: Path) -> tuple[dict[str, Any], list[CaseKey]]:
    """What a key says of all cases, and of each.

    Raises
    ------
    BlindError
        If it cannot be read, or is no key.
    """
    try:
        found = json.loads(key.read_bytes())
        return found, [CaseKey.model_validate(entry) for entry in found.pop("cases")]
    except OSError as error:
        reason = f"cannot be read ({error.strerror})"
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, ValidationError):
        reason = "is no key of this version"
    raise BlindError(f"{key}: {reason}; give the key of `zoo blind make`")


def read_sealed(key: Path, answers: Path) -> list[CaseKey]:
    """A key that is the one the cases came with, by the digest beside the answers.

    Raises
    ------
    BlindError
        If it cannot be read or checked, or was changed.
    """
    _, found = read_key(key)
    digest = answers / KEY_DIGEST
    if not digest.is_file():
        raise BlindError(f"{digest}: is missing, the key cannot be checked; make it with `zoo blind run`")
    if [digests.of_bytes(key.read_bytes()).encode()] != digest.read_bytes().split()[:1]:
        raise BlindError(
            f"{key}: is not the key of these cases, or was changed: its SHA-256 is not that in {digest}; "
            "give the file that `zoo blind make` wrote with them"
        )
    return found


def read_answers(answers: Path, keys: Sequence[CaseKey]) -> tuple[dict[str, Answer | None], int]:
    """Answers of `run_cases` to the cases of a key.

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
    if not answers.is_dir():
        raise BlindError(f"{answers}: no such folder; give the answers of `zoo blind run`")
    there = {p.name for p in answers.iterdir() if p.is_dir()}
    known = {key.case for key in keys}
    if not there & known:
        raise BlindError(f"{answers}: holds no answer to a case of the key; give the answers to these cases")
    found: dict[str, Answer | None] = {}
    for key in keys:
        folder = answers / key.case
        if (folder / FAILED).is_file():
            found[key.case] = None
        elif (folder / ANSWER).is_file():
            stored, found[key.case] = stored_answer(folder)
            if key.files and stored["case"] != key.files:
                raise BlindError(f"{folder}: {ANSWER} is about other data than the case; run it again")
        else:
            raise BlindError(f"{folder}: neither {ANSWER} nor {FAILED}; finish `zoo blind run` first")
    return found, len(there - known)
