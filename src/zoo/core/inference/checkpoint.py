"""The folder that a run is written to and goes on from, and the check that it is the same run."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
import pymc as pm

from zoo.core.inference.logposterior import LogPosterior, SamplingError, model_name
from zoo.core.inference.starts import Start

CHECKPOINT_FORMAT = 2


class CheckpointError(SamplingError):
    """A checkpoint folder belongs to another run, is in use, or cannot be read."""


class CheckpointInUseError(CheckpointError):
    """Another run holds the checkpoint folder."""


def write(path: Path, content: bytes) -> None:
    """Replace a file in one go."""
    temporary = path.with_name(path.name + f".{os.getpid()}.part")
    with open(temporary, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)


def unpickle(path: Path) -> Any:
    try:
        return pickle.loads(path.read_bytes())
    except (pickle.UnpicklingError, EOFError, AttributeError, ImportError, IndexError) as error:
        raise CheckpointError(
            f"{path}: cannot be read ({type(error).__name__}: {error}); remove the folder to start afresh"
        ) from None


class Folder:
    """A checkpoint folder: run.json (what is being run), start.pkl, chain-K.pkl; locked while in use."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.mkdir(parents=True, exist_ok=True)
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

    def close(self) -> None:
        """Give the folder free."""
        self._lock.close()

    def chain(self, chain: int) -> Path:
        """File of one chain."""
        return self.path / f"chain-{chain}.pkl"

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
            content = json.loads(file.read_text())
            assert isinstance(content["identity"], dict)
        except (json.JSONDecodeError, KeyError, TypeError, AssertionError):
            raise CheckpointError(f"{file}: cannot be read; remove the folder to start afresh") from None
        written = content["identity"].get("format")
        if written != CHECKPOINT_FORMAT:
            version = "a later" if isinstance(written, int) and written > CHECKPOINT_FORMAT else "an earlier"
            raise CheckpointError(
                f"{self.path}: this checkpoint was written by {version} version of zoo (format {written}, "
                f"this one goes on from format {CHECKPOINT_FORMAT}); remove it to start afresh, or use "
                "another"
            )
        return dict(content)

    def write_run(self, content: Mapping[str, Any]) -> None:
        """Store run.json."""
        text = json.dumps(content, indent=1, sort_keys=True, default=str)
        write(self.path / "run.json", text.encode())

    def start(self) -> Start | None:
        """Stored mode and starts, or None."""
        file = self.path / "start.pkl"
        if not file.exists():
            return None
        found = unpickle(file)
        if not isinstance(found, Start):
            raise CheckpointError(f"{file}: not a start; remove the folder to start afresh")
        return found

    def write_start(self, start: Start) -> None:
        """Store mode and starts."""
        write(self.path / "start.pkl", pickle.dumps(start, protocol=5))


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
