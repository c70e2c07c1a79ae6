"""The folder that a run is written to and goes on from, and the check that it is the same run."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

import numpy as np
import pymc as pm

from zoo.core import digests
from zoo.core.draws import seed_or_drawn
from zoo.core.inference.logposterior import LogPosterior, model_name
from zoo.core.inference.memo import REMEDY, CheckpointError
from zoo.core.outputs import OutputFileError, leads_elsewhere, write_file
from zoo.core.words import one_line

CHECKPOINT_FORMAT = 4
FILES = re.compile(r"run\.json|chain-\d+\.memo|solves\.memo|\.zoo-[0-9a-f]{16}\.part|lock")
"""Names of the files that a checkpoint folder holds."""


class CheckpointInUseError(CheckpointError):
    """Another run holds the checkpoint folder."""


class Folder:
    """A checkpoint folder, locked while in use: run.json (what is being run, where it begins), and memos.

    All of them are data with digests, of which nothing is run.

    Raises
    ------
    CheckpointError
        If it cannot be used, or another run uses it.
    zoo.core.outputs.OutputFileError
        If it, or one of its files, is a link or no file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if path.is_symlink():
                raise OutputFileError(f"{path}: is a link; give the folder itself as checkpoint folder")
            path.mkdir(parents=True, exist_ok=True)
            _refuse_links(path)
            self._lock: IO[str] = open(path / "lock", "a")  # noqa: SIM115 (closed by close)
        except OSError as error:
            raise CheckpointError(
                f"{path}: cannot be used as checkpoint folder ({error.strerror}); choose another"
            ) from None
        try:
            import fcntl

            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:  # no such locks on this system
            pass
        except OSError:
            self._lock.close()
            raise CheckpointInUseError(
                f"{path}: another run is using this checkpoint folder; wait for it or choose another"
            ) from None

        for left in path.glob(".zoo-*.part"):  # of a run that was killed while it wrote
            if FILES.fullmatch(left.name):
                left.unlink(missing_ok=True)

    def close(self) -> None:
        """Give the folder free."""
        self._lock.close()

    def chain(self, chain: int) -> Path:
        """File of one chain."""
        return self.path / f"chain-{chain}.memo"

    def run(self) -> dict[str, Any] | None:
        """What is stored in run.json, or None.

        Raises
        ------
        CheckpointError
            If it cannot be read, or was written in another format than this version's.
        """
        file = self.path / "run.json"
        if not file.exists():
            return None
        try:
            content = json.loads(file.read_bytes())
            written = content["identity"].get("format")
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise CheckpointError(f"{file}: cannot be read; {REMEDY}") from None
        if written != CHECKPOINT_FORMAT:
            raise CheckpointError(
                f"{self.path}: this checkpoint was written by another version of zoo (format {written}, "
                f"this one goes on from format {CHECKPOINT_FORMAT}); remove it to start afresh, or use "
                "another"
            )
        if not digests.fits(content):
            raise CheckpointError(f"{file}: damaged, its content does not fit its digest; {REMEDY}")
        return dict(content)

    def write_run(self, content: Mapping[str, Any]) -> None:
        """Store run.json."""
        plain = json.loads(json.dumps(content, default=str))
        write_file(self.path / "run.json", json.dumps(digests.stamped(plain), indent=1, sort_keys=True))

    def remove(self) -> None:
        """Delete the folder, and give it free.

        Raises
        ------
        zoo.core.outputs.OutputFileError
            If anything else than a checkpoint's files is there; then all stays as it is.
        """
        try:
            if (foreign := foreign_in(self.path)) is not None:
                raise OutputFileError(
                    f"{self.path}: holds files that are not a checkpoint's; move {foreign} away"
                )
            # run.json last: without it nobody knows whose the others are
            for file in sorted(self.path.iterdir(), key=lambda file: file.name == "run.json"):
                file.unlink()
        finally:
            self.close()
        self.path.rmdir()


def foreign_in(folder: Path) -> str | None:
    """Name of a file that is no checkpoint's, so that its folder cannot be removed; None if all are."""
    try:
        content = json.loads((folder / "run.json").read_bytes())
        begun = {"identity", digests.FIELD} <= content.keys() and "format" in content["identity"]
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        begun = False  # whose files these are is not known
    for file in sorted(folder.iterdir()):
        empty = file.name == "lock" and file.stat().st_size == 0
        if not FILES.fullmatch(file.name) or not (begun or empty):
            return file.name
    return None


def _refuse_links(folder: Path) -> None:
    """What is written through a link that came with a checkpoint would replace a file somewhere else."""
    for file in sorted(folder.iterdir()):
        added_to = file.suffix == ".memo"  # others are replaced
        wrong = leads_elsewhere(file) if added_to else file.is_symlink() or not file.is_file()
        if FILES.fullmatch(file.name) and wrong:
            remedy = "put a copy in its place" if file.is_file() and not file.is_symlink() else "remove it"
            raise OutputFileError(
                f"{file}: is a link, or no file; a checkpoint holds nothing but files: {remedy}"
            )


class Run:
    """A run, in a checkpoint folder or without one: what it is, its seed, and for how long it has gone on.

    Parameters
    ----------
    checkpoint : path or None
        If the folder holds a run it must be the same, which then goes on.
    logp : LogPosterior
        Of the model that is sampled.
    settings : mapping
        What must not change when the run is taken up again, but for the seed.
    seed : int, optional
        Drawn if absent, or that of the run which is there.

    Attributes
    ----------
    folder : Folder or None
    seed : int
    identity : dict
    owner : str
        Digest of the identity, which what is stored of a run belongs to.
    sittings : int
        Runs that took part, with this one.
    started : str
    beginning : dict or None
        Where the chains begin, as it was stored.

    Raises
    ------
    CheckpointError
        If the folder is in use, or holds another run or something else.
    """

    def __init__(
        self, checkpoint: str | Path | None, logp: LogPosterior, settings: Mapping[str, Any], seed: int | None
    ) -> None:
        self._began = time.monotonic()
        self.started = datetime.now(UTC).isoformat(timespec="seconds")
        self.sittings, self._earlier_s = 1, 0.0
        self.beginning: dict[str, Any] | None = None
        self.folder = None if checkpoint is None else Folder(Path(checkpoint))
        try:
            stored = None if self.folder is None else self.folder.run()
            ownerless = sorted(self.folder.path.glob("*.memo")) if self.folder and stored is None else []
            if ownerless:
                raise CheckpointError(f"{ownerless[0]}: is of no run, for there is no run.json; move it away")
            if seed is None and stored is not None:
                seed = int(stored["identity"]["seed"])
            self.seed = seed_or_drawn(seed)
            self.identity = identity_of(logp, {**settings, "seed": self.seed})
            if self.folder is not None and stored is not None:
                check_identity(self.folder.path, stored["identity"], self.identity)
                self.identity = stored["identity"]
                self.sittings, self._earlier_s = int(stored["sittings"]) + 1, float(stored["wall_seconds"])
                self.started, self.beginning = stored["started"], stored["beginning"]
            self.owner = digests.of_json(self.identity)
            self.write()
        except BaseException:
            self.close(write=False)
            raise

    @property
    def seconds(self) -> float:
        """Wall time of all sittings so far."""
        return self._earlier_s + time.monotonic() - self._began

    @property
    def resumed(self) -> str:
        """How it goes on, for the first line of progress."""
        return "" if self.sittings == 1 else f", resumed (sitting {self.sittings})"

    def write(self) -> None:
        """Write run.json, where there is a folder."""
        if self.folder is not None:
            self.folder.write_run(
                {
                    "identity": self.identity,
                    "started": self.started,
                    "sittings": self.sittings,
                    "wall_seconds": self.seconds,
                    "beginning": self.beginning,
                }
            )

    def close(self, *, write: bool = True) -> None:
        """Write how long it took, and give the folder free."""
        if self.folder is not None:
            try:
                if write:
                    self.write()
            finally:
                self.folder.close()
            self.folder = None


def identity_of(logp: LogPosterior, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What must not change when a run is resumed; the log-posterior at three points stands for all data."""
    record = getattr(logp.model, "zoo", None)
    source = getattr(record, "study", None) or getattr(record, "data", None)
    made_with = getattr(record, "settings", None) or {}
    q = logp.vector(logp.initial)
    rng = np.random.default_rng(20200886)
    probes = [q, q + 0.05 * rng.standard_normal(len(q)), q + 0.1 * rng.standard_normal(len(q))]
    identity = {
        "format": CHECKPOINT_FORMAT,
        "pymc": pm.__version__,
        "model": model_name(logp.model),
        "variables": {v.name: list(np.shape(logp.initial[v.name])) for v in logp.variables},
        "study": str(getattr(source, "name", "")),
        "study checksum": str(getattr(source, "checksum", "")),
        "conventions": dict(made_with.get("conventions", {})),
        "solver options": dict(made_with.get("solver options", {})),
        "priors": getattr(record, "priors", None),
        "log-posterior at three points": [logp(probe) for probe in probes],
        **settings,
    }
    return dict(json.loads(json.dumps(identity, default=str)))


def check_identity(path: Path, stored: Mapping[str, Any], identity: Mapping[str, Any]) -> None:
    """Refuse to go on with a run of another model, study or setting, and say which differs."""
    for name, mine in identity.items():
        theirs = stored.get(name)
        if name == "log-posterior at three points" and isinstance(theirs, list) and len(theirs) == len(mine):
            same = bool(np.allclose(theirs, mine, rtol=1e-9, atol=1e-7))
        else:
            same = theirs == mine
        if not same:
            if isinstance(theirs, dict) and isinstance(mine, dict):
                name, theirs, mine = _first_difference(name, theirs, mine)
            there, here = (one_line(str(value), 120) for value in (theirs, mine))
            raise CheckpointError(
                f"{path}: checkpoint of another run: {name} is {there} there and {here} here; use the "
                "same settings, another folder, or remove this one"
            )


def _first_difference(name: str, theirs: dict[str, Any], mine: dict[str, Any]) -> tuple[str, Any, Any]:
    """The first entry in which two tables differ, one that is a text if there is one."""
    missing = object()
    different = [
        key for key in dict.fromkeys([*mine, *theirs]) if theirs.get(key, missing) != mine.get(key, missing)
    ]
    key = min(different, key=lambda k: not isinstance(mine.get(k), str))
    return f"{key} of the {name}", theirs.get(key, "absent"), mine.get(key, "absent")
