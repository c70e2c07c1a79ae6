"""Keys of cases of blood flow, made here or by another simulator, as the core's `CaseKey`."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from zoo.blood.blind.causes import CAUSES
from zoo.blood.blind.learned import Truth
from zoo.blood.blind.other_tables import other_tables
from zoo.blood.blind.outside import OUTSIDE
from zoo.blood.components import component_of
from zoo.blood.effects import CATALOGUE
from zoo.core.blindcheck.keys import PAIR, CaseKey, TrueEffect
from zoo.core.blindcheck.sealing import KEY_DIGEST, BlindError, read_sealed
from zoo.core.diagnosis.hypothesis import CORRELATED, NULL
from zoo.core.effects import Location

OTHER_NAMES = {
    "junction-loss": "minor-losses",
    "catheter-gain": "sensor-gain",
    "catheter-offset": "sensor-offset",
    "nonlinear-wall": "tangent-wall",
}
"""Effects of keys that were not made here -> those of the catalogue."""
_AMPLITUDES: dict[str, Callable[[float], float]] = {
    "distributed-outflow": lambda sections: sections - 1,
    "velocity-profile": lambda zeta: 2 / zeta,
}
"""Amplitudes of such keys -> those of the catalogue; others are the same."""


_NO_AMPLITUDE = (CORRELATED, "coarse-grid")
"""The size of correlated errors has no interval; that of a grid's error depends on whose grid it is."""


def _true_effect(
    name: str,
    vessel: int | None,
    subtree: bool,
    amplitude: float,
    prior: Sequence[float] | None = None,
) -> TrueEffect:
    where = Location(vessel, subtree, "vessel")
    if name in _NO_AMPLITUDE:
        return TrueEffect(name, where)
    return TrueEffect(name, where, amplitude, (prior[0], prior[1]) if prior else None)


def own_key(entry: Mapping[str, Any]) -> CaseKey:
    """From an entry of a key of `make_cases`."""
    effects = tuple(
        _true_effect(
            e["effect"],
            e["vessel"],
            e["subtree"],
            next(iter(e["amplitudes"].values())),
            next(iter(e.get("priors_95", {}).values()), None),
        )
        for e in entry["effects"]
    )
    noise = entry["noise"]
    layout = {"layout": entry["layout"], "network": entry["network"]["kind"]}
    return CaseKey(
        entry["case"],
        entry["kind"],
        entry["effect"],
        effects,
        math.hypot(noise["white"].get("mmHg", 0.0), noise["correlated_mmHg"]),
        entry["gap_mmHg"]["before"],
        np.array([[float(x) for x in row.split()] for row in entry["truth"].values()]),
        entry["digest"],
        {**layout, "series": series_words(len(entry["truth"]))},
        tuple(dict.fromkeys(filter(None, (_component(e["effect"]) for e in entry["effects"])))),
        _truth(entry.get("functions"), [e["effect"] for e in entry["effects"]]),
    )


def series_words(many: int) -> str:
    """How many series a case has, for the tables of a score."""
    return {1: "one", 2: "two"}.get(many, "three or more")


def _component(effect: str) -> str:
    """Component of a cause or an effect; empty where it has none."""
    if effect in CAUSES:
        return CAUSES[effect].component
    return component_of(OUTSIDE[effect] if effect in OUTSIDE else CATALOGUE[effect])


def _truth(tables: Sequence[Mapping[str, Any]] | None, causes: Sequence[str]) -> Truth | None:
    return Truth(tables, tuple(causes)) if tables else None


def other_key(entry: Mapping[str, Any]) -> CaseKey:
    """From a key that was made elsewhere: a file for each case, names with underscores."""
    if "components" in entry:
        return _other_component_key(entry)
    name = (entry["effect"] or NULL).replace("_", "-")
    kind = "none" if name == NULL else "listed" if entry["in_library"] else "outside"
    name = OTHER_NAMES.get(name, name) if kind == "listed" else name
    if kind == "listed" and name not in CATALOGUE:
        raise BlindError(
            f"key of {entry['case']}: effect {entry['effect']!r}: is not in the catalogue; "
            "add its name to zoo.blood.blind.keys.OTHER_NAMES"
        )
    effects: tuple[TrueEffect, ...] = ()
    if kind != "none":
        extra = entry.get("extra") or {}
        amplitude = _AMPLITUDES.get(name, float)(float(entry["amplitude"]))
        effects = (_true_effect(name, extra.get("vessel"), bool(extra.get("subtree")), amplitude),)
    noise = math.hypot(entry["noise"]["white_sd_mmHg"], entry["noise"]["ar1_sd_mmHg"])

    def mean_square(values: Sequence[float]) -> float:
        return float(np.mean(np.square(values)))

    before = math.sqrt(mean_square(entry["base_fit"]["rms_noisefree_mmHg"]))
    many = 1 if entry["layout"] == "MPA" else 3
    tags = {"layout": entry["layout"], "network": "mouse", "series": series_words(many)}
    components = (_component(name),) if kind == "listed" and _component(name) else ()
    return CaseKey(entry["case"], kind, name, effects, noise, before, tags=tags, components=components)


def _other_component_key(entry: Mapping[str, Any]) -> CaseKey:
    """From a key made elsewhere of a cause that is known by its component."""
    names = [e["effect"].replace("_", "-") for e in entry["effects"]]
    components = tuple(entry["components"])
    kind = "none" if not names else "component" if len(components) == 1 else PAIR
    pressures = [i for i, (_, _, q) in enumerate(entry["observed"]) if q == "pressure_mmHg"]
    white, correlated = (entry["noise"][name][pressures[0]] for name in ("white_sd", "ar1_sd"))
    rms = [entry["base_fit"]["rms_noisefree"][i] for i in pressures]
    many = series_words(len(entry["observed"]))
    return CaseKey(
        entry["case"],
        kind,
        "+".join(names) or NULL,
        tuple(TrueEffect(name) for name in names),
        math.hypot(white, correlated),
        math.sqrt(float(np.mean(np.square(rms)))),
        np.array([one["values"] for one in entry["noise_free"]]),
        tags={"layout": entry["layout"], "network": entry["tree"]["kind"], "series": many},
        components=components,
        functions=_truth(other_tables(entry), names),
    )


def read_key(key: str | Path, answers: str | Path) -> tuple[list[CaseKey], bool]:
    """Read a key of `make_cases`, checked against the digest beside the answers, or a folder of others.

    Returns
    -------
    list of CaseKey
    bool
        Whether it was checked: a folder of keys that were not made here has no digest.

    Raises
    ------
    BlindError
        If it cannot be read, or is not the one that the cases came with.
    """
    key, answers = Path(key), Path(answers)
    if not key.is_dir():
        return [_entry(own_key, json.dumps(e).encode(), key) for e in read_sealed(key, answers)], True
    if (answers / KEY_DIGEST).is_file():
        raise BlindError(f"{key}: is a folder, but the cases came with a key of one file; give that one")
    files = sorted(key.glob("*.json"))
    if not files:
        raise BlindError(f"{key}: holds no .json; give a key, or a folder with one for each case")
    return [_entry(other_key, path.read_bytes(), path) for path in files], False


def _entry(read: Callable[[Mapping[str, Any]], CaseKey], content: bytes, path: Path) -> CaseKey:
    try:
        return read(json.loads(content))
    except (KeyError, TypeError, ValueError, IndexError) as error:
        if isinstance(error, BlindError):
            raise
        raise BlindError(f"{path}: is no key of cases ({type(error).__name__}: {error})") from None
