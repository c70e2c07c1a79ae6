"""Simulation-based calibration: does the posterior hold the truth as often as it says?

Parameters are drawn from the model's prior and data from the model at them; the truth's rank among draws of
the posterior is uniform if model, likelihood and sampler belong together (docs/calibration.md).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from zoo.blood.solver import library_digest
from zoo.blood.study import Study
from zoo.core import digests
from zoo.core.inference.progress import bar
from zoo.core.inference.record import versions
from zoo.core.inference.sampling import DEMETROPOLISZ
from zoo.core.inference.workers import each
from zoo.core.posterior.ranks import CalibrationError, RankTest, Replicate
from zoo.paper.replicator import Builder, Replicator, Settings

FORMER_OPTIONS = {"own_units": "constrained"}
"""Options of the steps that files of replicates have by a former name; the draws are the same."""


def simulate_and_rank(
    model_builder: Builder,
    study: Study,
    n_replicates: int,
    *,
    seed: int = 0,
    settings: Settings | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
    truth: Builder | None = None,
    path: str | Path | None = None,
    cores: int = 1,
    executor: Executor | None = None,
    progress: bool = False,
) -> RankTest:
    """Rank many truths from the prior among draws of their posteriors.

    Parameters
    ----------
    model_builder : callable
        ``model_builder(study) -> pm.Model``; for other processes it is importable by name.
    study : Study
        Network, inflow, times and places of the observations.
    n_replicates : int
        Truths.
    seed : int
        Replicate k depends on `seed` and k only.
    settings : Settings, optional
        Of the sampling.
    limits : mapping of name to (lower, upper), optional
        As in `Replicator`.
    truth : callable, optional
        As in `Replicator`.
    path : path, optional
        File of finished replicates, one JSON object a line; what it holds already is not done again.
    cores : int
        Processes, each with its own compiled model; 1 works in this process.
    executor : concurrent.futures.Executor, optional
        Does the replicates instead, as in `zoo.core.inference.workers.each`.
    progress : bool
        A bar on standard error.

    Returns
    -------
    RankTest

    Raises
    ------
    CalibrationError
        For a setting out of range, or a file of another calibration.
    zoo.core.inference.workers.LostTaskError
        If the worker of a replicate died as often as it may.

    References
    ----------
    Talts et al. 2018, arXiv:1804.06788.
    """
    settings = settings or Settings()
    if n_replicates < 1 or cores < 1:
        raise CalibrationError(f"n_replicates = {n_replicates}, cores = {cores}: must be at least 1")
    mine = range(n_replicates)
    asked = _Calibration(model_builder, study, tuple(sorted((limits or {}).items())), truth)
    header = {
        "model": _builder_name(model_builder),
        "truth": _builder_name(truth or model_builder),
        "study": study.checksum,
        "seed": seed,
        "steps": dict(DEMETROPOLISZ),
        "limits": {name: list(map(float, pair)) for name, pair in (limits or {}).items()},
        "settings": asdict(settings),
        "program": {**versions(), "solver": library_digest()},
    }
    store = _Store(None if path is None else Path(path), header)
    waiting = [k for k in mine if k not in store.found]
    with bar(progress) as show:
        task = show.add_task("replicates", total=len(mine), completed=len(mine) - len(waiting))
        jobs = [(asked, seed, number, settings) for number in waiting]
        for _, replicate in each(_replicate, jobs, cores, executor=executor, name=_replicate_name):
            store.add(replicate)
            show.advance(task)
    return RankTest.of([store.found[k] for k in range(n_replicates)], settings.ranked)


@dataclass(frozen=True)
class _Calibration:
    """What a worker makes its model from: names of functions, and a study; compiled in the worker, once."""

    builder: Builder
    study: Study
    limits: tuple[tuple[str, tuple[float, float]], ...]
    truth: Builder | None

    @property
    def key(self) -> tuple[Any, ...]:
        """What tells it from another."""
        return _builder_name(self.builder), self.study, self.limits, self.truth and _builder_name(self.truth)


_Job = tuple[_Calibration, int, int, Settings]
_compiled: list[tuple[tuple[Any, ...], Replicator]] = []  # the last one of this process


def _replicate(job: _Job) -> Replicate:
    asked, seed, number, settings = job
    if not _compiled or _compiled[0][0] != asked.key:
        model = Replicator(asked.builder, asked.study, limits=dict(asked.limits), truth=asked.truth)
        _compiled[:] = [(asked.key, model)]
    return _compiled[0][1].replicate(seed, number, settings)


def _replicate_name(job: _Job) -> str:
    return f"replicate {job[2]} of seed {job[1]}"


def _builder_name(builder: Any) -> str:
    """Name of a builder, with what functools.partial adds to it."""
    inner = getattr(builder, "func", builder)
    extra = getattr(builder, "keywords", None) or {}
    name = f"{inner.__module__}.{inner.__qualname__}"
    return name + "".join(f", {key}={value!r}" for key, value in sorted(extra.items()))


class _Store:
    """Finished replicates by number, and the file that they are kept in."""

    def __init__(self, path: Path | None, header: Mapping[str, Any]) -> None:
        self.path = path
        self.found: dict[int, Replicate] = {}
        if path is None:
            return
        self._begin(path, header)

    def _begin(self, path: Path, header: Mapping[str, Any]) -> None:
        whole = self._whole(path) if path.exists() else b""
        if whole and len(whole) < path.stat().st_size:
            path.write_bytes(whole)
        if not whole:
            path.write_text(json.dumps(dict(header)) + "\n", encoding="utf-8")
            return
        self._read(path, whole.decode().splitlines(), header)

    @staticmethod
    def _whole(path: Path) -> bytes:
        """The lines of a file, without a last one that a kill has cut, or that is being written."""
        content = path.read_bytes()
        return content[: content.rfind(b"\n") + 1]

    def _read(self, path: Path, lines: Sequence[str], header: Mapping[str, Any]) -> None:
        if not lines:  # just begun by another process
            return
        try:
            stored = json.loads(lines[0])
            rows = [Replicate(**digests.from_text(line)) for line in lines[1:]]
        except (ValueError, TypeError) as error:
            raise CalibrationError(f"{path}: no file of replicates ({error}); choose another") from None
        if isinstance(stored, dict) and isinstance(stored.get("steps"), dict):
            stored["steps"] = {FORMER_OPTIONS.get(key, key): value for key, value in stored["steps"].items()}
        mine = json.loads(json.dumps(dict(header)))
        for name, value in mine.items():
            theirs = stored.get(name) if isinstance(stored, dict) else None
            if theirs != value:
                raise CalibrationError(
                    f"{path}: replicates of another calibration: {name} is {theirs} there and {value} here; "
                    "choose another file"
                )
        self.found |= {row.number: row for row in rows}

    def add(self, replicate: Replicate) -> None:
        self.found[replicate.number] = replicate
        if self.path is not None:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(digests.to_text(json.loads(json.dumps(asdict(replicate))), indent=None))
