"""The folder that a run is written to and goes on from, and the check that it is the same run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import pymc as pm

from zoo.core import digests
from zoo.core.inference.logposterior import LogPosterior, model_name
from zoo.core.inference.starts import Start
from zoo.core.inference.states import REMEDY, CheckpointError, of_chain, read_state, write_state
from zoo.core.outputs import OutputFileError, write_file

CHECKPOINT_FORMAT = 3
FILES = ("run.json", "start.*", "chain-*.*", "solves.state", ".zoo-*.part", "lock")
"""Patterns of the files that a checkpoint folder holds, or held in earlier formats."""


class CheckpointInUseError(CheckpointError):
    """Another run holds the checkpoint folder."""


class Folder:
    """A checkpoint folder: run.json (what is being run), start.state, chain-K.state; locked while in use.

    All of them are data, of which nothing is run, and hold a digest; states also that of what is being run.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.mkdir(parents=True, exist_ok=True)
            _refuse_links(path)
            self._lock: IO[str] = open(path / "lock", "w")  # noqa: SIM115 (closed by close)
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
            left.unlink(missing_ok=True)

    def close(self) -> None:
        """Give the folder free."""
        self._lock.close()

    def chain(self, chain: int) -> Path:
        """File of one chain."""
        return self.path / f"chain-{chain}.state"

    def check_chains(self, run: str, chains: int) -> None:
        """Read the states of a run's chains, so that a damaged one is refused before any work.

        Raises
        ------
        CheckpointError
            Naming the first file that cannot be used.
        """
        for chain in range(chains):
            if self.chain(chain).exists():
                read_state(self.chain(chain), of_chain(run, chain))

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
            assert isinstance(content["identity"], dict)
        except (OSError, ValueError, KeyError, TypeError, AssertionError, RecursionError):
            raise CheckpointError(f"{file}: cannot be read; {REMEDY}") from None
        written = content["identity"].get("format")
        if written != CHECKPOINT_FORMAT:
            version = "a later" if isinstance(written, int) and written > CHECKPOINT_FORMAT else "an earlier"
            raise CheckpointError(
                f"{self.path}: this checkpoint was written by {version} version of zoo (format {written}, "
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

    def start(self, run: str) -> Start | None:
        """Stored mode and starts of a run, or None."""
        file = self.path / "start.state"
        if not file.exists():
            return None
        found = read_state(file, {"run": run, "part": "start"}).get("start")
        if not isinstance(found, Start):
            raise CheckpointError(f"{file}: is no start; {REMEDY}")
        return found

    def write_start(self, run: str, start: Start) -> None:
        """Store mode and starts of a run."""
        write_state(self.path / "start.state", {"run": run, "part": "start"}, {"start": start})


def _refuse_links(folder: Path) -> None:
    """What is written through a link that came with a checkpoint would replace a file somewhere else."""
    for file in sorted(folder.iterdir()):
        if any(map(file.match, FILES)) and (file.is_symlink() or not file.is_file()):
            raise OutputFileError(
                f"{file}: is a link, or no file; a checkpoint holds nothing but files: remove it"
            )


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
    for name, mine in identity.items():
        theirs = stored.get(name)
        if name == "log-posterior at three points" and isinstance(theirs, list) and len(theirs) == len(mine):
            same = bool(np.allclose(theirs, mine, rtol=1e-9, atol=1e-7))
        else:
            same = theirs == mine or (name == "priors" and theirs is None)  # checkpoints of before have none
        if not same:
            if isinstance(theirs, dict) and isinstance(mine, dict):
                name, theirs, mine = _first_difference(name, theirs, mine)
            raise CheckpointError(
                f"{path}: checkpoint of another run: {name} is {_short(theirs)} there and {_short(mine)} "
                "here; use the same settings, another folder, or remove this one"
            )


def _first_difference(name: str, theirs: dict[str, Any], mine: dict[str, Any]) -> tuple[str, Any, Any]:
    """The first entry in which two tables differ, one that is a text if there is one."""
    missing = object()
    different = [
        key for key in dict.fromkeys([*mine, *theirs]) if theirs.get(key, missing) != mine.get(key, missing)
    ]
    key = min(different, key=lambda k: not isinstance(mine.get(k), str))
    return f"{key} of the {name}", theirs.get(key, "absent"), mine.get(key, "absent")


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 120 else text[:117] + "..."
