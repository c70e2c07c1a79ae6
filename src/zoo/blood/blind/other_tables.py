"""True functions of keys that were made elsewhere, as the tables of one's own keys."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from zoo.blood.blind.truths import table
from zoo.blood.units import MMHG


def other_tables(entry: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Tables of an entry, of those kinds of function that are known.

    Parameters
    ----------
    entry : mapping
        With "effects", each with a "component" and "tables".

    Returns
    -------
    list of dict
        As of `zoo.blood.blind.truths.true_functions`; a function of another kind is left out.
    """
    found = []
    for effect in entry["effects"]:
        make = _TABLES.get(effect["component"])
        if make is not None and (made := make(effect.get("tables") or {}, entry)) is not None:
            found.append(made)
    return found


def _inflow(t: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any] | None:
    if "recorded_minus_true_ml_s" not in t:
        return None
    added = -np.asarray(t["recorded_minus_true_ml_s"])
    return table("inflow", "flow", "time", "s", "ml/s", t["time_s"], added)


def _wall(t: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any] | None:
    """A law of the area, where the pressure is visited, as what is added to the linear one."""
    if "p_true_mmHg" not in t:
        return None
    pressure = np.asarray(t["p_true_mmHg"])
    low, high = t.get("pressure_range_mmHg", (pressure.min(), pressure.max()))
    stretch = np.sqrt(np.asarray(t["A_over_A0"]))
    # one more point on either side, so that the range is inside
    first = max(int(np.searchsorted(pressure, low)) - 1, 0)
    last = min(int(np.searchsorted(pressure, high)) + 1, len(pressure))
    visited = slice(first, last)
    law = pressure * MMHG / (4 / 3 * t["chi_true"]) - (stretch - 1)
    return table("wall", "law", "stretch", "1", "K", stretch[visited], law[visited])


def _fluid(t: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any] | None:
    if "dpdx_added" not in t:
        return None
    added = np.asarray(t["dpdx_added"]) / np.asarray(t["dpdx_base"])
    return table("fluid", "friction", "velocity", "cm/s", "1", t["u_cm_s"], added)


def _outlets(t: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any] | None:
    """Of all outlets; the nominal impedance is that of the refitted baseline."""
    true, base = (t.get(f"impedance_{x}_by_terminal") for x in ("true", "refitted_base"))
    if not true or not base:
        return None

    def modulus(of: Mapping[str, Any]) -> Any:
        return np.array([np.hypot(of[i]["real"], of[i]["imag"]) for i in sorted(of, key=int)])

    ratio = np.log(modulus(true) / modulus(base))
    omega = 2 * math.pi / entry["period_s"] * np.arange(ratio.shape[1])
    labels = sorted(true, key=int)
    return table("outlets", "log-impedance", "angular frequency", "rad/s", "1", omega, ratio, labels=labels)


def _sensor(t: Mapping[str, Any], entry: Mapping[str, Any]) -> dict[str, Any] | None:
    """What each reading has too much; of a sensor without a memory, by its pressure about the mean too."""
    if "reading_minus_pressure_mmHg" not in t:
        return None
    added = np.asarray(t["reading_minus_pressure_mmHg"])
    reading = np.array([one["values"] for one in entry["noise_free"]])[: len(added)]
    pressure = reading - added
    made = table("sensor", "reading", "time", "s", "mmHg", t["time_s"], added, pressure=pressure.tolist())
    if "p_minus_mean_mmHg" in t:
        x = pressure.ravel()
        order = np.argsort(x)
        made |= {"static_mmHg": x[order].tolist(), "static_values": added.ravel()[order].tolist()}
    return made


_TABLES = {"inflow": _inflow, "wall": _wall, "fluid": _fluid, "outlets": _outlets, "sensor": _sensor}
