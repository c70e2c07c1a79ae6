"""Simulation-based calibration: does the posterior hold the truth as often as it says?

Parameters are drawn from the model's prior and data from the model at them; the truth's rank among draws of
the posterior is uniform if model, likelihood and sampler belong together (docs/calibration.md).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from zoo.blood.study import Study
from zoo.core.inference.progress import bar
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
    progress: bool = False,
) -> RankTest:
    """Rank many truths from the prior among draws of their posteriors.

    Parameters
    ----------
    model_builder : callable
        ``model_builder(study) -> pm.Model``; with `cores` above 1 it has to be picklable.
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
    progress : bool
        A bar on standard error.

    Returns
    -------
    RankTest

    Raises
    ------
    CalibrationError
        For a setting out of range, or a file of another calibration.

    References
    ----------
    Talts et al. 2018, arXiv:1804.06788.
    """
    settings = settings or Settings()
    if n_replicates < 1 or cores < 1:
        raise CalibrationError(f"n_replicates = {n_replicates}, cores = {cores}: must be at least 1")
    arguments = (model_builder, study, dict(limits or {}), truth)
    header = {
        "model": _builder_name(model_builder),
        "truth": _builder_name(truth or model_builder),
        "study": study.checksum,
        "seed": seed,
        "steps": dict(DEMETROPOLISZ),
        "limits": {name: list(map(float, pair)) for name, pair in (limits or {}).items()},
        "settings": asdict(settings),
    }
    store = _Store(None if path is None else Path(path), header)
    waiting = [k for k in range(n_replicates) if k not in store.found]
    with bar(progress) as show:
        task = show.add_task("replicates", total=n_replicates, completed=n_replicates - len(waiting))
        jobs = [(seed, number, settings) for number in waiting]
        for _, replicate in each(_replicate, jobs, cores, prepare=_begin, arguments=arguments):
            store.add(replicate)
            show.advance(task)
    return RankTest.of([store.found[k] for k in range(n_replicates)], settings.ranked)


_worker: dict[str, Replicator] = {}


def _begin(builder: Builder, study: Study, limits: Any, truth: Builder | None) -> None:
    _worker["replicator"] = Replicator(builder, study, limits=limits, truth=truth)


def _replicate(job: tuple[int, int, Settings]) -> Replicate:
    return _worker["replicator"].replicate(*job)


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
        whole = b""
        if path.exists():
            content = path.read_bytes()
            whole = content[: content.rfind(b"\n") + 1]  # the last line may have been cut by a kill
            if len(whole) < len(content):
                path.write_bytes(whole)
        if not whole:
            path.write_text(json.dumps(dict(header)) + "\n", encoding="utf-8")
            return
        self._read(path, whole.decode().splitlines(), header)

    def _read(self, path: Path, lines: Sequence[str], header: Mapping[str, Any]) -> None:
        try:
            stored = json.loads(lines[0])
            rows = [Replicate(**json.loads(line)) for line in lines[1:]]
        except (json.JSONDecodeError, TypeError) as error:
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
        self.found = {row.number: row for row in rows}

    def add(self, replicate: Replicate) -> None:
        self.found[replicate.number] = replicate
        if self.path is not None:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(replicate)) + "\n")
