"""Posteriors as files: sampled into one beside its checkpoint, found for a study, refused for another."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from zoo.core.arviz_lines import InferenceData
from zoo.core.inference.record import ResultsError, RunRecord
from zoo.core.outputs import OutputFileError, output_file
from zoo.core.posterior.arviz_groups import sample
from zoo.core.posterior.belonging import mismatch
from zoo.core.posterior.storage import load, save_posterior
from zoo.core.words import OneLineError


class PosteriorError(OneLineError, ValueError):
    """A stored posterior that does not belong; its text says to what, and what to change."""


def sample_to(
    path: str | Path, model: Any, *, groups: bool = False, method: str = "exact", **settings: Any
) -> InferenceData:
    """Sample a model into a NetCDF file, with the checkpoint in a folder beside it.

    Parameters
    ----------
    path : path
        ``X.nc``; the checkpoint is ``X.checkpoint``, and ``X.1.checkpoint`` of ``X.1``.
    model : pymc.Model
        With a record.
    groups : bool
        Store ArviZ's groups too, see `zoo.core.posterior.arviz_groups.add_groups`.
    method : str
        Of `zoo.sample`, as are the other settings.

    Returns
    -------
    InferenceData
        What the file holds.

    Raises
    ------
    zoo.core.inference.checkpoint.CheckpointError
        If the checkpoint is in use, or of another run.
    zoo.core.outputs.OutputFileError
        If the file cannot be written, before the sampling; or after it, when the checkpoint holds the draws.
    """
    path = output_file(path)
    checkpoint = checkpoint_of(path)
    idata = sample(model, groups=groups, method=method, checkpoint=checkpoint, **settings)
    try:
        save_posterior(idata, path)
    except OutputFileError as error:
        raise OutputFileError(
            f"{error}; the draws are in {checkpoint}, from where the same call goes on"
        ) from None
    return idata


def checkpoint_of(path: Path) -> Path:
    """Folder of the checkpoint that belongs to a posterior's file."""
    name = path.stem if path.suffix in (".nc", ".checkpoint") else path.name
    return path.with_name(f"{name}.checkpoint")


def load_posterior(path: str | Path, model: Any = None) -> InferenceData:
    """Read a stored posterior.

    Parameters
    ----------
    path : path
        NetCDF file.
    model : pm.Model, optional
        That it must belong to, by its study and conventions.

    Returns
    -------
    InferenceData

    Raises
    ------
    PosteriorError
        If it was drawn from another model.
    zoo.core.inference.record.ResultsError
        If the file is no posterior.
    """
    idata: InferenceData = load(path)
    if model is not None and (wrong := mismatch(idata, model)):
        raise PosteriorError(f"{path}: {wrong}; sample again, or give those that belong")
    return idata


def matching(path: Path, model: Any) -> InferenceData | None:
    """A stored posterior if it is there and of this model, study and conventions, else None."""
    try:
        idata: InferenceData | None = load(path) if path.is_file() else None
    except ResultsError:
        return None
    return idata if idata is not None and mismatch(idata, model) is None else None


def find(
    given: Iterable[Path],
    names: Sequence[str],
    study: Any,
    *,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Path]:
    """Posteriors of models on a study among files and folders, by their run records.

    Parameters
    ----------
    given : iterable of Path
        Files, which must be of one of the models and of the study, or folders, in which others are passed
        over and named.
    names : sequence of str
        Models.
    study : Study, or anything with its name and checksum
        Whose posteriors count.
    say : callable
        Told which files in folders are passed over, and why: a line for each reason.

    Returns
    -------
    dict
        Model -> file; of several the last.

    Raises
    ------
    PosteriorError
        If there is no such file, or one that was named is of another model or study.
    zoo.core.inference.record.ResultsError
        If a file that was named is no posterior.
    """
    found: dict[str, Path] = {}
    for path in given:
        if not path.exists():
            raise PosteriorError(f"{path}: no such file or folder of posteriors; `zoo sample` writes them")
        passed: dict[str, list[str]] = {}
        for file in sorted(path.glob("*.nc")) if path.is_dir() else [path]:
            try:
                record = RunRecord.of(load(file))
                wrong = _elsewhere(record, names, study)
            except ResultsError as error:
                if not path.is_dir():
                    raise
                wrong = f"is no posterior: {str(error).removeprefix(f'{file}: ')}"
            if not wrong:
                if record.model in found:
                    passed.setdefault("is of a model of which a later one is taken", []).append(
                        str(found[record.model])
                    )
                found[record.model] = file
            elif path.is_dir():
                passed.setdefault(wrong, []).append(str(file))
            else:
                raise PosteriorError(f"{file}: {wrong}")
        for why, files in passed.items():
            say(f"passed over: {', '.join(files)}: {why}")
    return found


def _elsewhere(record: RunRecord, names: Sequence[str], study: Any) -> str | None:
    """Why a posterior is none of these models on this study, or None."""
    if record.study != study.name:
        return f"is of model {record.model} on {record.study}, not on {study.name}"
    if record.study_checksum != study.checksum:
        return f"is of model {record.model} on other data named {study.name}; sample again"
    if record.model not in names:
        return f"is of model {record.model}, not of {', '.join(names)}"
    return None
