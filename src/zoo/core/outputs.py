"""Files and folders that results are written to: checked before the work, replaced in one go after it."""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterable
from pathlib import Path

from zoo.core.words import OneLineError

_KINDS = (
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
)


class OutputFileError(OneLineError, ValueError):
    """A file or folder that cannot be written to: one line with its path and what to change."""


def output_file(path: str | Path, option: str = "", inputs: Iterable[Path] = ()) -> Path:
    """Check before any work that a file can be written.

    The target may be new, or a regular file that may be replaced; its folder is there and takes new files,
    which is tried. A link is followed: what it points to is replaced, the link stays.

    Parameters
    ----------
    path : str or Path
    option : str
        Of the command line, which the error names before the path.
    inputs : iterable of Path
        Files that are read, none of which may be replaced.

    Returns
    -------
    Path
        As given.

    Raises
    ------
    OutputFileError
        If it is a folder, a device, a pipe, a socket, a circle of links or an input, or cannot be written.
    """
    path, named = Path(path), _named(path, option)
    real = _target(path, named)
    if real.exists() and any(one.exists() and real.samefile(one) for one in inputs):
        raise OutputFileError(f"{named}: is a file that is read here; choose another path")
    _try_in(real.parent, named)
    return path


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
    path, named = Path(path), _named(path, option)
    if _mode(path, named) is None:
        if path.is_symlink():
            raise OutputFileError(f"{named}: is a link to nothing; give a folder")
        parent = Path(os.path.realpath(path)).parent
        while deep and _mode(parent, named) is None:
            parent = parent.parent
        if not parent.is_dir():
            wrong = "is a file" if parent.exists() else "does not exist"
            shown = path.parent if not deep else parent
            raise OutputFileError(f"{named}: folder {shown} {wrong}; create it or choose another path")
        _try_in(parent, named)
        return path
    if not path.is_dir():
        raise OutputFileError(f"{named}: is {_kind(path)}; give a folder")
    _try_in(path, named)
    for name in files:
        _target(path / name, _named(path / name, option))
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
    path, named = Path(path), _named(path, "")
    real = _target(path, named)
    raw = content.encode() if isinstance(content, str) else content
    try:
        file, temporary = _open_beside(real, 0o600 if private else 0o666)
        try:
            with open(file, "wb") as opened:
                opened.write(raw)
                opened.flush()
                os.fsync(opened.fileno())
            if real.exists():
                temporary.chmod(stat.S_IMODE(real.stat().st_mode))
            os.replace(temporary, real)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(named, error) from None
    return path


def _named(path: str | Path, option: str) -> str:
    return f"{option} {path}".strip()


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


def _kind(path: Path) -> str:
    mode = path.stat().st_mode
    return next((words for has, words in _KINDS if has(mode)), "a file")


def _target(path: Path, named: str) -> Path:
    """The regular or new file that a path leads to, past its links."""
    mode = _mode(path, named)
    real = Path(os.path.realpath(path))
    if mode is None and not real.parent.is_dir():
        raise OutputFileError(
            f"{named}: folder {path.parent} does not exist; create it or choose another path"
        )
    if mode is not None and stat.S_ISDIR(mode):
        raise OutputFileError(f"{named}: is a folder; give a file in it, such as {path / 'A.nc'}")
    if mode is not None and not stat.S_ISREG(mode):
        raise OutputFileError(f"{named}: is {_kind(path)}, not a file; choose another path")
    if mode is not None and not os.access(real, os.W_OK):
        raise OutputFileError(f"{named}: cannot be written (it is read-only); choose another path")
    return real


def _open_beside(real: Path, mode: int = 0o666) -> tuple[int, Path]:
    """A new file in the folder of another, under a name that nothing has; and its path."""
    temporary = real.with_name(f".zoo-{secrets.token_hex(8)}.part")
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
    return os.open(temporary, flags, mode), temporary


def _try_in(folder: Path, named: str) -> None:
    try:
        file, temporary = _open_beside(folder / "any")
        os.close(file)
        temporary.unlink()
    except OSError as error:
        raise _unwritable(named, error) from None


def _unwritable(named: str, error: OSError) -> OutputFileError:
    reason = error.strerror or type(error).__name__
    return OutputFileError(f"{named}: cannot be written ({reason}); make room, or choose another path")
