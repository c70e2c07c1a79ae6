"""Files and folders that results are written to: checked before the work, replaced in one go after it.

While a command runs, no file is lost that it did not make itself: see `Run`.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import stat
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zoo.core.words import OneLineError, short

RECORD = ".zoo-outputs"
"""File beside outputs with a line for each that was written: its name, its SHA-256, the run."""
OURS = re.compile(rf"{re.escape(RECORD)}|\.zoo-[0-9a-f]{{16}}\.part")
"""Names of what zoo keeps beside outputs: the record, and what a kill left of a file half written."""


class OutputFileError(OneLineError, ValueError):
    """A file or folder that cannot be written to: one line with its path and what to change."""


@dataclass
class Run:
    """A command at work, as a context manager: its outputs are new, or its own of the same run.

    What `output_file` and `output_folder` are given with an option is an output: it is checked at once, and
    again and recorded when it is written.

    Parameters
    ----------
    identity : mapping
        What makes this run, as JSON has it.
    inputs : iterable of Path
        What is read: files, none of which is replaced, and folders, into which nothing is written.
    fresh : bool
        Replace what zoo wrote in other runs too; never what it did not write, or not as it is.
    """

    identity: Mapping[str, Any]
    inputs: Iterable[Path] = ()
    fresh: bool = False
    _outputs: set[Path] = field(default_factory=set)

    def __enter__(self) -> Run:
        _running.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        _running.remove(self)

    def add(self, path: Path, named: str) -> None:
        """Take a file or folder as an output, if nothing is lost by that."""
        self._outputs |= {Path(os.path.realpath(path)), Path(os.path.abspath(path))}
        self.check(path, named)

    def check(self, path: Path, named: str, content: bytes | memoryview | None = None) -> None:
        """Refuse an output by which something would be lost; record one that is about to be written.

        A path is known by its name and by what it leads to: links may be changed while a command works.
        """
        real, name = Path(os.path.realpath(path)), Path(os.path.abspath(path))
        if not {real, real.parent, name, name.parent} & self._outputs:
            return
        self.refuse_read(path, named)
        record = real.with_name(RECORD)
        if os.path.lexists(record) and leads_elsewhere(record):
            raise OutputFileError(f"{record}: is a link, or no file; put a copy of it in its place")
        if real.is_file():
            self._check_made(record, real, named)
        elif real.exists() and not real.is_dir():
            raise OutputFileError(f"{named}: is {_kind(real.stat().st_mode)}; choose another path")
        if content is not None:
            line = {"file": real.name, "sha256": hashlib.sha256(content).hexdigest(), "run": self.identity}
            with record.open("a", encoding="utf-8") as file:
                file.write("\n" + json.dumps(line))  # on its own also after one that was cut short

    def refuse_read(self, path: Path, named: str) -> None:
        """Refuse a file or folder that is read, or lies in a folder that is read."""
        real = Path(os.path.realpath(path))
        for read in self.inputs:
            if real.exists() and read.exists() and real.samefile(read):
                raise OutputFileError(f"{named}: is read here; choose another path")
            if read.is_dir() and real.is_relative_to(os.path.realpath(read)):
                raise OutputFileError(f"{named}: lies in {read}, which is read here; choose a path outside")

    def _check_made(self, record: Path, real: Path, named: str) -> None:
        text = record.read_text(encoding="utf-8", errors="replace") if record.exists() else ""
        mark = json.dumps({"file": real.name, "sha256": hashlib.sha256(real.read_bytes()).hexdigest()})[:-1]
        runs = [json.loads(line)["run"] for line in text.splitlines() if _is_record(line, mark)]
        if not runs:
            raise OutputFileError(
                f"{named}: is there, and not as zoo wrote it; choose another path, or move it away"
            )
        own, told = _told(self.identity), [_told(run) for run in runs]
        if not self.fresh and own not in told:
            there = told[-1]
            what = next(n for n in (*own, *there) if own.get(n) != there.get(n))
            raise OutputFileError(
                f"{named}: is of another run: {what} was {short(there.get(what))}, here it is "
                f"{short(own.get(what))}; add --fresh to replace it, or choose another path"
            )


_running: list[Run] = []


def _told(identity: Mapping[str, Any]) -> dict[str, Any]:
    """What makes a run without options that are not given, which other versions may not know."""
    return {name: value for name, value in identity.items() if value is not None and value is not False}


def leads_elsewhere(path: Path) -> bool:
    """Whether what is added to a file in its place comes to another one too, or to no file."""
    return path.is_symlink() or not path.is_file() or path.stat().st_nlink > 1


def refuse_read(path: Path, option: str) -> None:
    """Refuse a folder that is worked in, if it is read by a command that runs, or lies in what is read."""
    for run in _running:
        run.refuse_read(path, f"{option} {path}")


def _is_record(line: str, mark: str) -> bool:
    """Whether a line begins with a mark and was written to its end."""
    try:
        return line.startswith(mark) and isinstance(json.loads(line)["run"], dict)
    except (ValueError, KeyError, RecursionError):
        return False


def output_file(path: str | Path, option: str = "") -> Path:
    """Check before any work that a file can be written.

    The target may be new, or a regular file that may be replaced; its folder is there. A link is followed:
    what it points to is replaced, the link stays.

    Parameters
    ----------
    path : str or Path
    option : str
        Of the command line, which the error names before the path.

    Returns
    -------
    Path
        As given.

    Raises
    ------
    OutputFileError
        If it cannot be written, or a command that runs would lose something by it.
    """
    _checked(Path(path), option)
    return Path(path)


def output_folder(
    path: str | Path, files: Iterable[str] = (), option: str = "", *, deep: bool = False
) -> Path:
    """Check before any work that files can be written into a folder, which need not be there yet.

    Parameters
    ----------
    path : str or Path
    files : iterable of str
        Names of files that will be written into it; each is checked if it is there.
    option : str
        Of the command line, which the error names before the path.
    deep : bool
        The folders that it lies in may be missing too.

    Returns
    -------
    Path
        As given.

    Raises
    ------
    OutputFileError
        If it is no folder, cannot be made or written to, or one of the files cannot be replaced.
    """
    path = Path(path)
    _checked(path, option, folder=True, deep=deep)
    for name in files if path.is_dir() else ():
        _checked(path / name, option)
    return path


def write_file(path: str | Path, content: str | bytes | memoryview, *, private: bool = False) -> Path:
    """Write a file whole or not at all: beside its target under another name, to the disk, then renamed.

    Parameters
    ----------
    path : str or Path
        As `output_file` allows.
    content : str or bytes
        Text is written as UTF-8.
    private : bool
        A new file is for its owner alone to read.

    Returns
    -------
    Path
        As given.

    Raises
    ------
    OutputFileError
        If it cannot be written; what was there before is as it was, and nothing else is left.
    """
    path = Path(path)
    real = _checked(path)
    raw = content.encode() if isinstance(content, str) else content
    try:
        temporary = real.with_name(f".zoo-{secrets.token_hex(8)}.part")
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
        file = os.open(temporary, flags, 0o600 if private else 0o666)
        try:
            with open(file, "wb") as opened:
                opened.write(raw)
                opened.flush()
                os.fsync(opened.fileno())
            new = not real.exists()
            if not new:
                temporary.chmod(stat.S_IMODE(real.stat().st_mode))
            for run in _running:
                run.check(path, str(path), raw)
            _put(temporary, real, new=new)
        finally:
            temporary.unlink(missing_ok=True)
    except FileExistsError:
        raise OutputFileError(
            f"{path}: came while this worked; move it away, and give the same again"
        ) from None
    except OSError as error:
        raise _unwritable(str(path), error) from None
    return path


def _put(temporary: Path, real: Path, *, new: bool) -> None:
    """Give a file its name; one that is new takes the place of none that came meanwhile."""
    if new:
        try:
            os.link(temporary, real)
            return
        except OSError:  # a file came, or there are no hard links on this file system
            if os.path.lexists(real):
                raise
    os.replace(temporary, real)


def _checked(path: Path, option: str = "", *, folder: bool = False, deep: bool = False) -> Path:
    """What a path leads to past its links, if it can be written as a file or folder without a loss."""
    named = f"{option} {path}".strip()
    mode, real = _mode(path, named), Path(os.path.realpath(path))
    if RECORD in (path.name, real.name):
        raise OutputFileError(f"{named}: is the name of the record of outputs; choose another path")
    if mode is None and folder and path.is_symlink():
        raise OutputFileError(f"{named}: is a link to nothing; give a folder")
    if mode is not None and folder and not stat.S_ISDIR(mode):
        raise OutputFileError(f"{named}: is {_kind(mode)}; give a folder")
    if mode is not None and not folder and not stat.S_ISREG(mode):
        other = f"give a file in it, such as {path / 'A.nc'}" if stat.S_ISDIR(mode) else "choose another path"
        raise OutputFileError(f"{named}: is {_kind(mode)}; {other}")
    if mode is not None and not folder and not os.access(real, os.W_OK):
        raise OutputFileError(f"{named}: cannot be written (it is read-only); choose another path")
    there = real if folder and mode is not None else real.parent
    while deep and _mode(there, named) is None:
        there = there.parent
    if not there.is_dir():
        wrong = "is a file" if there.exists() else "does not exist"
        shown = there if deep else path.parent
        raise OutputFileError(f"{named}: folder {shown} {wrong}; create it or choose another path")
    if not os.access(there, os.W_OK | os.X_OK):
        raise OutputFileError(f"{named}: cannot be written (Permission denied); choose another path")
    for run in _running:
        (run.add if option else run.check)(path, named)
    return real


def _mode(path: Path, named: str) -> int | None:
    """Type and permissions of what a path leads to; None if there is nothing."""
    try:
        return path.stat().st_mode
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _unwritable(named, error) from None
    except ValueError:
        raise OutputFileError(f"{named}: holds a zero byte; choose another path") from None


def _kind(mode: int) -> str:
    if stat.S_ISDIR(mode) or stat.S_ISREG(mode):
        return "a folder" if stat.S_ISDIR(mode) else "a file"
    return "a pipe" if stat.S_ISFIFO(mode) else "a device or a socket"


def _unwritable(named: str, error: OSError) -> OutputFileError:
    reason = error.strerror or type(error).__name__
    return OutputFileError(f"{named}: cannot be written ({reason}); make room, or choose another path")
