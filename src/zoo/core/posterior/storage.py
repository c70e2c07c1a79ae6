"""Posteriors as NetCDF files, and as files small enough to keep beside the code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from zoo.core.inference.convergence import DIAGNOSTICS_ATTR, FurtherTests, diagnostics
from zoo.core.inference.record import ResultsError, RunRecord
from zoo.core.outputs import output_file, write_file


def save(idata: Any, path: str | Path) -> Path:
    """Write an InferenceData as one NetCDF file, whole or not at all.

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
    return write_file(path, netcdf_bytes(idata))


def netcdf_bytes(idata: Any) -> memoryview:
    """The NetCDF file of an InferenceData, compressed as ArviZ does it, for `arviz.from_netcdf` to read."""
    import xarray as xr

    groups = {f"/{name}": idata[name] for name in idata.groups()}
    packed = {
        place: {
            name: {"zlib": True} for name, values in group.variables.items() if values.dtype.kind in "biufc"
        }
        for place, group in groups.items()
    }
    tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs=idata.attrs), **groups})
    return tree.to_netcdf(engine="h5netcdf", encoding=packed)


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
