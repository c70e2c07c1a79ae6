"""Measured data that this package may not contain: found in ZOO_DATA_DIR, or downloaded once per user.

Every file is checked against its SHA-256 digest, wherever it comes from.
"""

from __future__ import annotations

import logging
import os
from pathlib import Path

from zoo.core.words import OneLineError, meant

DATA_DIR_VARIABLE = "ZOO_DATA_DIR"
TIMEOUT_S = 30


class FetchError(OneLineError, RuntimeError):
    """A data file that cannot be had, or is not what it should be: one line with the remedy."""


_GITHUB = "https://raw.githubusercontent.com/"
_CFD = _GITHUB + "msolufse/CDG_NCSU/a700810b8514494a81975f82f6ee70aa7534681c/1D_CFD_Windkessel/"
_VASODILATION = _GITHUB + "mjcolebank/1D_Vasodilation/d971758aa5ea28bce6f02bfff9a96775d2df7f67/"
_TANKS = (
    _GITHUB + "forgi86/sysid-neural-continuous/956aa7ecd73061b0321c6f6098d74c9e4a7ce67a/examples/CTS/data/"
)

FILES = {
    # Main pulmonary artery of a control mouse: inflow (ml/s, 8192 steps of one beat and its first value
    # again) and pressure (mmHg, 1024 samples of one beat, and the 512 that were fitted by Paun et al. 2020).
    # Qureshi et al. 2018, doi 10.1007/s10237-018-1078-8.
    "mouse-c6/qC6_8192.dat": (_CFD, "30584fce8d54af56e733bc78894c54e4686ac46ca12cb4a78b3d0b43c23f0020"),
    "mouse-c6/pC6_1024.dat": (_CFD, "a6e7878d32390ff4fd62356507754b91ea18fd28922b6489903caf9b42056d94"),
    "mouse-c6/pC6_512.dat": (
        _VASODILATION,
        "d77222438c9353ed043067aa8ecc389518026a455697ea8e70c80b9a0807db72",
    ),
    # The same of a hypoxic mouse, with pulmonary hypertension. Qureshi et al. 2018.
    "mouse-h1/qH1_8192.dat": (
        _VASODILATION,
        "a87ffcd71ffddeba8a68831a175146bda672cfb60fc517900a39d15b1e207b23",
    ),
    "mouse-h1/pH1_1024.dat": (
        _VASODILATION,
        "63b3533d95fc2dcba8e5b37ebe003bcc31bc0099626dc1eefb97e34e8151e8d2",
    ),
    # Cascaded tanks: pump voltage and water level (V, every 4 s), an estimation and a test record of 1024
    # samples. Schoukens, Mattsson, Wigren and Noël 2016, doi 10.4121/12960104.
    "cascaded-tanks/dataBenchmark.csv": (
        _TANKS,
        "ef2388ed822f3aef4aa80d6b0f2b466dd80b361786b3eafc7a2957c31ea323a7",
    ),
}
"""Data set and file -> address of its folder, and SHA-256 digest."""


def fetch_file(name: str) -> Path:
    """Path of one data file, from ZOO_DATA_DIR, this user's cache, or its public source, in that order.

    Parameters
    ----------
    name : str
        "DATA SET/FILE", such as "mouse-c6/pC6_1024.dat".

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

    if name not in FILES:
        raise FetchError(f"{name}: unknown; {meant(name, list(FILES), 0.6)}there is {', '.join(FILES)}")
    address, digest = FILES[name]
    dataset, _, file = name.partition("/")
    folder = os.environ.get(DATA_DIR_VARIABLE)
    for path in (Path(folder) / name, Path(folder) / file) if folder else ():
        if path.is_file():
            if (found := pooch.file_hash(str(path), alg="sha256")) == digest:
                return path
            raise FetchError(
                f"{path}: sha256 = {found}: expected {digest}, so this is another or a damaged file; "
                f"replace it, or unset {DATA_DIR_VARIABLE} to have it downloaded"
            )
    pooch.get_logger().setLevel(logging.WARNING)
    cache, download = pooch.os_cache("zoo") / dataset, pooch.HTTPDownloader(timeout=TIMEOUT_S)
    try:
        return Path(pooch.retrieve(address + file, f"sha256:{digest}", file, cache, downloader=download))
    except (OSError, ValueError) as error:  # requests' errors are OSErrors, a wrong digest is a ValueError
        reason = "what came has another sha256" if isinstance(error, ValueError) else type(error).__name__
        state = f"{folder} does not hold it" if folder else "it is not set"
        raise FetchError(
            f"{name}: cannot be downloaded from {address}{file} ({reason}); set {DATA_DIR_VARIABLE} to a "
            f"folder that holds {name} ({state}), or try again when online"
        ) from error


def fetch_dataset(name: str) -> tuple[Path, ...]:
    """Paths of all files of a data set, downloaded where they are missing.

    Parameters
    ----------
    name : str
        Data set, such as "mouse-c6".

    Returns
    -------
    tuple of Path
        One for each file.

    Raises
    ------
    FetchError
        As `fetch_file`, or if there is no such data set.
    """
    known = list(dict.fromkeys(file.partition("/")[0] for file in FILES))
    if name not in known:
        raise FetchError(f"data set {name!r}: unknown; {meant(name, known, 0.6)}there is {', '.join(known)}")
    return tuple(fetch_file(file) for file in FILES if file.startswith(f"{name}/"))
