"""Measured data that this package may not contain: found in ZOO_DATA_DIR, or downloaded once per user.

Every file is checked against its SHA-256 digest, wherever it comes from.
"""

from __future__ import annotations

import logging
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zoo.core.words import OneLineError, meant

DATA_DIR_VARIABLE = "ZOO_DATA_DIR"
TIMEOUT_S = 30


class FetchError(OneLineError, RuntimeError):
    """A data file that cannot be had, or is not what it should be: one line with the remedy."""


@dataclass(frozen=True)
class Dataset:
    """Files of public sources.

    Parameters
    ----------
    url : str
        Address of the folder, ending in a slash.
    sha256 : dict of str to str
        File name -> digest.
    elsewhere : dict of str to str
        File name -> address of its folder, where that is another.
    """

    url: str
    sha256: dict[str, str]
    elsewhere: dict[str, str] = field(default_factory=dict)

    def folder_of(self, file: str) -> str:
        """Address of the folder that holds a file."""
        return self.elsewhere.get(file, self.url)


_VASODILATION = (
    "https://raw.githubusercontent.com/mjcolebank/1D_Vasodilation/d971758aa5ea28bce6f02bfff9a96775d2df7f67/"
)


DATASETS = {
    # Main pulmonary artery of a control mouse: inflow (ml/s, 8192 steps of one beat and its first value
    # again) and pressure (mmHg, 1024 samples of one beat, and the 512 that were fitted by Paun et al. 2020).
    # Qureshi et al. 2018, doi 10.1007/s10237-018-1078-8.
    "mouse-c6": Dataset(
        url=(
            "https://raw.githubusercontent.com/msolufse/CDG_NCSU/"
            "a700810b8514494a81975f82f6ee70aa7534681c/1D_CFD_Windkessel/"
        ),
        sha256={
            "qC6_8192.dat": "30584fce8d54af56e733bc78894c54e4686ac46ca12cb4a78b3d0b43c23f0020",
            "pC6_1024.dat": "a6e7878d32390ff4fd62356507754b91ea18fd28922b6489903caf9b42056d94",
            "pC6_512.dat": "d77222438c9353ed043067aa8ecc389518026a455697ea8e70c80b9a0807db72",
        },
        elsewhere={"pC6_512.dat": _VASODILATION},
    ),
    # The same of a hypoxic mouse, with pulmonary hypertension. Qureshi et al. 2018.
    "mouse-h1": Dataset(
        url=_VASODILATION,
        sha256={
            "qH1_8192.dat": "a87ffcd71ffddeba8a68831a175146bda672cfb60fc517900a39d15b1e207b23",
            "pH1_1024.dat": "63b3533d95fc2dcba8e5b37ebe003bcc31bc0099626dc1eefb97e34e8151e8d2",
        },
    ),
    # Cascaded tanks: pump voltage and water level (V, every 4 s), an estimation and a test record of 1024
    # samples. Schoukens, Mattsson, Wigren and Noël 2016, doi 10.4121/12960104.
    "cascaded-tanks": Dataset(
        url=(
            "https://raw.githubusercontent.com/forgi86/sysid-neural-continuous/"
            "956aa7ecd73061b0321c6f6098d74c9e4a7ce67a/examples/CTS/data/"
        ),
        sha256={"dataBenchmark.csv": "ef2388ed822f3aef4aa80d6b0f2b466dd80b361786b3eafc7a2957c31ea323a7"},
    ),
}


def _dataset(name: str) -> Dataset:
    if name in DATASETS:
        return DATASETS[name]
    raise FetchError(
        f"data set {name!r}: unknown; {meant(name, list(DATASETS), 0.6)}there is {', '.join(DATASETS)}"
    )


def _local(dataset: str, file: str, expected: str) -> Path | None:
    """The file in ZOO_DATA_DIR, checked, or None when it is not there."""
    import pooch

    folder = os.environ.get(DATA_DIR_VARIABLE)
    if not folder:
        return None
    for path in (Path(folder) / dataset / file, Path(folder) / file):
        if not path.is_file():
            continue
        found = pooch.file_hash(str(path), alg="sha256")
        if found != expected:
            raise FetchError(
                f"{path}: sha256 = {found}: expected {expected}, so this is another or a damaged file; "
                f"replace it, or unset {DATA_DIR_VARIABLE} to have it downloaded"
            )
        return path
    return None


class _Bar:
    """A rich progress bar that pooch can drive: a `total`, `update`, `reset` and `close`."""

    def __init__(self, label: str) -> None:
        from rich.console import Console
        from rich.progress import Progress

        self._progress = Progress(console=Console(stderr=True))
        self._task = self._progress.add_task(label, total=None)
        self._progress.start()

    @property
    def total(self) -> float | None:
        return self._progress.tasks[0].total

    @total.setter
    def total(self, total: float) -> None:
        self._progress.update(self._task, total=total)

    def update(self, amount: float) -> None:
        self._progress.advance(self._task, amount)

    def reset(self) -> None:
        self._progress.update(self._task, completed=0)

    def close(self) -> None:
        self._progress.stop()


def fetch_file(name: str, *, progress: bool | None = None) -> Path:
    """Path of one data file, from ZOO_DATA_DIR, this user's cache, or its public source, in that order.

    Parameters
    ----------
    name : str
        "DATA SET/FILE", such as "mouse-c6/pC6_1024.dat".
    progress : bool
        Show a bar while downloading; when absent, only if the standard error is a terminal.

    Returns
    -------
    Path
        A file with the expected SHA-256 digest.

    Raises
    ------
    FetchError
        If the name is unknown, the file in ZOO_DATA_DIR has another digest, or the download fails.
    """
    import pooch

    dataset, _, file = name.partition("/")
    source = _dataset(dataset)
    if file not in source.sha256:
        raise FetchError(f"{name}: unknown file; data set {dataset!r} has {', '.join(source.sha256)}")
    path = _local(dataset, file, source.sha256[file])
    if path is not None:
        return path

    def download(url: str, output_file: Any, known: Any) -> None:
        shown = sys.stderr.isatty() if progress is None else progress
        bar = _Bar(file) if shown else None
        try:
            pooch.HTTPDownloader(timeout=TIMEOUT_S, progressbar=bar or False)(url, output_file, known)
        finally:
            if bar is not None:
                bar.close()

    pooch.get_logger().setLevel(logging.WARNING)
    registry = {known: f"sha256:{digest}" for known, digest in source.sha256.items()}
    urls = {known: f"{folder}{known}" for known, folder in source.elsewhere.items()}
    cache = pooch.create(Path(pooch.os_cache("zoo")) / dataset, source.url, registry=registry, urls=urls)
    try:
        return Path(cache.fetch(file, downloader=download))
    except (OSError, ValueError) as error:  # requests' errors are OSErrors, a wrong digest is a ValueError
        reason = "what came has another sha256" if isinstance(error, ValueError) else type(error).__name__
        folder = os.environ.get(DATA_DIR_VARIABLE)
        state = f"{folder} does not hold it" if folder else "it is not set"
        raise FetchError(
            f"{name}: cannot be downloaded from {source.folder_of(file)}{file} ({reason}); set "
            f"{DATA_DIR_VARIABLE} to a folder that holds {name} ({state}), or try again when online"
        ) from error


def fetch_dataset(name: str, *, progress: bool | None = None) -> tuple[Path, ...]:
    """Paths of all files of a data set, downloaded where they are missing.

    Parameters
    ----------
    name : str
        Data set, such as "mouse-c6".
    progress : bool
        Show a bar while downloading; when absent, only if the standard error is a terminal.

    Returns
    -------
    tuple of Path
        One for each file.

    Raises
    ------
    FetchError
        As `fetch_file`.
    """
    return tuple(fetch_file(f"{name}/{file}", progress=progress) for file in _dataset(name).sha256)
