"""Keys of cases that an independent simulator made, a file for each case, as those of the blind check."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from zoo.blood.components import component_of
from zoo.blood.effects import CATALOGUE
from zoo.core.blindcheck import NULL, BlindError, CaseKey

OTHER_NAMES = {
    "junction-loss": "minor-losses",
    "catheter-gain": "sensor-gain",
    "catheter-offset": "sensor-offset",
    "nonlinear-wall": "tangent-wall",
}
"""Their names of effects -> those of the catalogue."""
AMPLITUDES: dict[str, Callable[[float], float]] = {
    "distributed-outflow": lambda sections: sections - 1,
    "velocity-profile": lambda zeta: 2 / zeta,
}
"""Their amplitudes -> those of the catalogue; others are the same."""
NO_SIZE = ("correlated-noise", "coarse-grid")
"""Effects whose size depends on more than the effect."""
COUNTS = {1: "one", 2: "two"}


def other_key(entry: Mapping[str, Any], case: str) -> CaseKey:
    """From the content of a file.

    Parameters
    ----------
    entry : mapping
    case : str
        By what it is called here.
    """
    if "components" in entry:
        return _component_key(entry, case)
    name = (entry["effect"] or NULL).replace("_", "-")
    kind = "none" if name == NULL else "listed" if entry["in_library"] else "outside"
    name = OTHER_NAMES.get(name, name) if kind == "listed" else name
    if kind == "listed" and name not in CATALOGUE:
        raise BlindError(f"{case}: effect {entry['effect']!r} is not in the catalogue; add it to OTHER_NAMES")
    part = component_of(CATALOGUE[name]) if kind == "listed" else {"active-tone": "wall"}.get(name, "")
    components = (part,) if part else ()
    white, correlated = (entry["noise"][f"{x}_sd_mmHg"] for x in ("white", "ar1"))
    where = entry.get("extra") or {}
    size = AMPLITUDES.get(name, float)(float(entry["amplitude"]))
    return CaseKey(
        case=case,
        kind=kind,
        label=name,
        accepted=(name,) if kind == "listed" else (),
        components=components,
        place=where.get("vessel"),
        subtree=bool(where.get("subtree")),
        parameter=size if kind == "listed" and name not in NO_SIZE else None,
        noise=math.hypot(white, correlated),
        gap=float(np.sqrt(np.mean(np.square(entry["base_fit"]["rms_noisefree_mmHg"])))),
        tags={"series": COUNTS.get(len(entry["observed"]), "three or more")},
        drawn=_drawn(entry),
    )


def _drawn(entry: Mapping[str, Any]) -> dict[str, Any]:
    """The baseline's parameters by their names here."""
    theta = {"f3" if name == "chi" else name: x for name, x in entry["theta"].items()}
    return {"base_parameters": theta}


def _component_key(entry: Mapping[str, Any], case: str) -> CaseKey:
    """From a key of a cause that is known by its component."""
    names = [e["effect"].replace("_", "-") for e in entry["effects"]]
    components = tuple(entry["components"])
    kind = "none" if not names else "component" if len(components) == 1 else "pair"
    pressures = [i for i, (_, _, q) in enumerate(entry["observed"]) if q == "pressure_mmHg"]
    white, correlated = (entry["noise"][f"{x}_sd"][pressures[0]] for x in ("white", "ar1"))
    return CaseKey(
        case=case,
        kind=kind,
        label="+".join(names) or NULL,
        components=components,
        noise=math.hypot(white, correlated),
        gap=float(np.sqrt(np.mean(np.square([entry["base_fit"]["rms_noisefree"][i] for i in pressures])))),
        truth=tuple(tuple(one["values"]) for one in entry["noise_free"]),
        tags={"series": COUNTS.get(len(entry["observed"]), "three or more")},
        drawn=_drawn(entry),
    )


def other_keys(folder: Path, prefix: str = "") -> list[CaseKey]:
    """All keys of a folder; `prefix` goes before the names of the cases."""
    files = sorted(folder.glob("*.json"))
    if not files:
        raise BlindError(f"{folder}: holds no .json; give a folder with a key for each case")
    try:
        return [other_key(json.loads(path.read_bytes()), prefix + path.stem) for path in files]
    except (KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, BlindError):
            raise
        raise BlindError(f"{folder}: a key cannot be read ({type(error).__name__}: {error})") from None
