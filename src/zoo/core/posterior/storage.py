"""Posteriors as NetCDF files, and as files small enough to keep beside the code."""

from __future__ import annotations

import hashlib
import io
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from zoo.core.arviz_lines import InferenceData, dataset, datasets, made, netcdf_bytes, read
from zoo.core.digests import FIELD, of_bytes
from zoo.core.draws import evenly
from zoo.core.inference.convergence import DIAGNOSTICS_ATTR, diagnostics
from zoo.core.inference.record import ResultsError, RunRecord
from zoo.core.outputs import output_file, write_file

_MARK = b"zoo-sha256:"
_DIGITS = 64


class NoDigestWarning(UserWarning):
    """A posterior's file that holds no digest, so that damage to it is not seen."""


def save_posterior(idata: InferenceData, path: str | Path) -> Path:
    """Write an InferenceData as one NetCDF file with the digest of its content, whole or not at all.

    The file is made in memory first: HDF5 itself ends the process where a disk is full.

    Parameters
    ----------
    idata : arviz.InferenceData
        Draws, sample statistics, attributes.
    path : str or Path
        Target, by custom ending in `.nc`.

    Returns
    -------
    Path
        The written file.

    Raises
    ------
    zoo.core.outputs.OutputFileError
        If it cannot be written; what was there before stays as it was.
    """
    output_file(path)
    return write_file(path, _with_digest(netcdf_bytes(idata)))


def _with_digest(netcdf: memoryview) -> memoryview:
    """The bytes of a NetCDF file with the digest of what is read back from them, then that of all bytes.

    The first is there for every reader and survives other programs; the second, behind the end of what HDF5
    reads, is checked before HDF5 sees the file: a damaged one may keep it busy for ever.
    """
    import h5py  # type: ignore[import-untyped]

    content = read(io.BytesIO(netcdf))
    file = io.BytesIO(netcdf)
    with h5py.File(file, "r+") as opened:
        opened.attrs[FIELD] = digest_of(content)
    file.seek(0, io.SEEK_END)
    file.write(_MARK + of_bytes(file.getvalue()).encode())
    return file.getbuffer()


def _whole(raw: bytes) -> bool:
    """Whether the bytes of a file are as they were written, if that can be said."""
    end = len(raw) - _DIGITS
    if raw[end - len(_MARK) : end] != _MARK:
        return True
    return raw[end:] == of_bytes(raw[: end - len(_MARK)]).encode()


def digest_of(idata: InferenceData) -> str:
    """SHA-256 of all that an InferenceData holds: groups, dimensions, values, attributes.

    Parameters
    ----------
    idata : arviz.InferenceData
        As read from a file; the digest that it holds itself does not count.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    found = hashlib.sha256()

    def add(*words: Any) -> None:
        found.update(json.dumps(words, sort_keys=True, default=str).encode() + b"\n")

    add({name: _as_json(value) for name, value in idata.attrs.items() if name != FIELD})
    for group, content in sorted(datasets(idata).items()):
        add("group", group, {name: _as_json(value) for name, value in content.attrs.items()})
        for name in sorted(map(str, content.variables)):
            values = content.variables[name]
            raw, text = np.asarray(values.values), values.dtype.kind in "OTUS"
            kind = "text" if text else raw.dtype.newbyteorder("<").str
            attributes = {name: _as_json(value) for name, value in values.attrs.items()}
            add("variable", name, name in content.coords, values.dims, values.shape, kind, attributes)
            if text:
                add(raw.astype(str).tolist())
            else:
                found.update(raw.astype(kind, copy=False).tobytes())
    return found.hexdigest()


def _as_json(attribute: Any) -> Any:
    """The same for an attribute's value whether it is read as a number or as an array of one."""
    values = np.asarray(attribute)
    return values.item() if values.size == 1 else values.tolist()


def load(path: str | Path) -> InferenceData:
    """Read an InferenceData from a NetCDF file into memory.

    Parameters
    ----------
    path : str or Path
        A file written by `save_posterior` or by `arviz.InferenceData.to_netcdf`.

    Returns
    -------
    arviz.InferenceData
        With a posterior group; the file is closed. A file of another program, which holds no digest, gives a
        `NoDigestWarning`.

    Raises
    ------
    ResultsError
        If the file is missing, is not NetCDF, does not fit its digest, or has no posterior.
    """
    path = Path(path)
    if not path.is_file():
        raise ResultsError(f"{path}: no such file; `zoo sample MODEL STUDY -o {path.name}` writes one")
    try:
        raw = path.read_bytes()
        fits, digest = _whole(raw), None
        if fits:
            idata = read(io.BytesIO(raw))
            digest = idata.attrs.pop(FIELD, None)
            fits = digest is None or digest == digest_of(idata)
    except Exception as error:  # of a damaged file, the libraries that read it raise anything
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise ResultsError(f"{path}: not a readable NetCDF file ({reason}); sample again") from None
    if not fits:
        raise ResultsError(f"{path}: damaged, its content does not fit its digest; sample again")
    if "posterior" not in idata:
        raise ResultsError(
            f"{path}: no group 'posterior'; `zoo sample MODEL STUDY -o {path.name}` writes one"
        )
    if digest is None:
        text = f"{path}: holds no digest of its content, so that damage to it would not be seen"
        warnings.warn(text, NoDigestWarning, stacklevel=2)
    return idata


def slim_posterior(idata: InferenceData, n_draws: int = 1000) -> InferenceData:
    """A posterior small enough to keep beside the code: evenly spaced draws in single precision.

    Only parameters, their coordinates, the run record and the diagnostics of the whole run stay. Observed
    data, sample statistics and waveforms (variables over time) do not.

    Parameters
    ----------
    idata : arviz.InferenceData
        From `zoo.core.inference.sampling.sample`; left as it is.
    n_draws : int
        Draws of all chains together, rounded up to the same number in each.

    Returns
    -------
    arviz.InferenceData
        With the group posterior.

    Raises
    ------
    ResultsError
        If there is no posterior, no run record, or fewer than one draw is asked for.
    """
    if n_draws < 1:
        raise ResultsError(f"n_draws = {n_draws}: keep at least one draw")
    found, record = diagnostics(idata), RunRecord.of(idata)
    posterior = dataset(idata)
    available = posterior.sizes["draw"]
    kept = evenly(available, -(-n_draws // posterior.sizes["chain"]))
    names = [name for name in posterior.data_vars if "time" not in posterior[name].dims]
    few = posterior[names].isel(draw=kept).drop_vars("time", errors="ignore").astype(np.float32)
    created = posterior.attrs.get("created_at")
    few.attrs = {} if created is None else {"created_at": created}
    small = made({"posterior": few}, {DIAGNOSTICS_ATTR: found.to_json()})
    record.attach(small)
    return small
