"""Posteriors as NetCDF files, and as files small enough to keep beside the code."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from zoo.core.inference.convergence import DIAGNOSTICS_ATTR, FurtherTests, diagnostics
from zoo.core.inference.record import ResultsError, RunRecord


def save(idata: Any, path: str | Path) -> Path:
    """Write an InferenceData as one NetCDF file, through a temporary file so that a kill leaves no half file.

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
    ResultsError
        If the folder does not exist or cannot be written to.
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise ResultsError(f"{path}: folder {path.parent} does not exist; create it or choose another path")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        idata.to_netcdf(str(temporary), engine="h5netcdf")
        os.replace(temporary, path)
    except PermissionError:
        raise ResultsError(f"{path}: not writable; choose another path") from None
    finally:
        temporary.unlink(missing_ok=True)
    return path


def load(path: str | Path) -> Any:
    """Read an InferenceData from a NetCDF file into memory.

    Parameters
    ----------
    path : str or Path
        A file written by `save` or by `arviz.InferenceData.to_netcdf`.

    Returns
    -------
    arviz.InferenceData
        With a posterior group; the file is closed.

    Raises
    ------
    ResultsError
        If the file is missing, is not NetCDF, or has no posterior.
    """
    import arviz as az

    path = Path(path)
    if not path.is_file():
        raise ResultsError(f"{path}: no such file; `zoo sample MODEL STUDY -o {path.name}` writes one")
    try:
        with az.rc_context({"data.load": "eager"}):
            idata = az.from_netcdf(str(path), engine="h5netcdf")
    except (OSError, ValueError, KeyError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ResultsError(f"{path}: not a readable NetCDF file ({reason}); sample again") from None
    if "posterior" not in idata.groups():
        raise ResultsError(
            f"{path}: no group 'posterior'; `zoo sample MODEL STUDY -o {path.name}` writes one"
        )
    return idata


def slim(idata: Any, n_draws: int = 1000, *, further: FurtherTests | None = None) -> Any:
    """A posterior small enough to keep beside the code: evenly spaced draws in single precision.

    Only parameters, their coordinates, the run record and the diagnostics of the whole run stay. Observed
    data, sample statistics and waveforms (variables over time) do not.

    Parameters
    ----------
    idata : arviz.InferenceData
        From `zoo.core.inference.sampling.sample`; left as it is.
    n_draws : int
        Draws of all chains together, rounded up to the same number in each.
    further : callable, optional
        Further tests of all draws, whose results are kept; `zoo report` shows those of
        `zoo.paper.convergence.paper_tests`.

    Returns
    -------
    arviz.InferenceData
        With the group posterior.

    Raises
    ------
    ResultsError
        If there is no posterior, no run record, or fewer than one draw is asked for.
    """
    import arviz as az

    if n_draws < 1:
        raise ResultsError(f"n_draws = {n_draws}: keep at least one draw")
    found, record = diagnostics(idata, further), RunRecord.of(idata)
    posterior = idata.posterior
    available = posterior.sizes["draw"]
    wanted = min(available, -(-n_draws // posterior.sizes["chain"]))
    kept = np.linspace(0, available - 1, wanted).round().astype(int)
    names = [name for name in posterior.data_vars if "time" not in posterior[name].dims]
    few = posterior[names].isel(draw=kept).drop_vars("time", errors="ignore").astype(np.float32)
    created = posterior.attrs.get("created_at")
    few.attrs = {} if created is None else {"created_at": created}
    small = az.InferenceData(posterior=few, attrs={DIAGNOSTICS_ATTR: found.to_json()})
    record.attach(small)
    return small
