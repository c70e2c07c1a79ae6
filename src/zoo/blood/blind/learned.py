"""The values that a learned function should have, from the tables of a key."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zoo.core.blindcheck.answers import StatedFunction

Array = NDArray[np.float64]
Table = Mapping[str, Any]
LEAST_HARMONIC = 1e-3
"""Harmonics of a wave below this part of its largest say nothing of a filter's gain."""
OF_VESSELS = {
    "stiffness-scatter": "log-stiffness",
    "radius-scatter": "log-radius",
    "length-scatter": "log-length",
    "outlet-resistance": "log-resistance",
    "outlet-first-resistance": "log-first-resistance",
    "outlet-compliance": "log-compliance",
}
"""Learned functions of single vessels -> tables."""
FREE_CONSTANT = {
    "stiffness-scatter": "the stiffness of all vessels",
    "stiffness-by-radius": "the stiffness of all vessels",
    "wall-in-time": "the stiffness of all vessels",
    "wall-law": "the stiffness of all vessels",
    "outlet-resistance": "psi1 and psi2",
    "outlet-first-resistance": "psi1",
    "outlet-compliance": "c",
    "sensor-curve": "psi2, which moves the mean pressure",
}
"""Learned functions to which a parameter of the baseline may add a constant: they are compared without it."""
BY_RADIUS = {
    "stiffness-by-radius": "log-stiffness",
    "radius-by-size": "log-radius",
    "viscosity-by-radius": "log-viscosity",
}
"""Learned curves over the log radius -> tables of vessels; the table must be such a curve."""
ROUGH_CAUSES = ("misread-radii", "patchy-stiffening", "blocked-outlets")
"""Causes in single vessels, which are no curve over the radius."""
LINEAR_SENSORS = ("bubbly-catheter", "catheter-echo")
"""Causes that are filters."""
STILL = 0.05
"""Part of the largest speed below which a loss over the dynamic pressure is not compared."""


@dataclass(frozen=True)
class Truth:
    """The true functions of a case.

    Parameters
    ----------
    tables : sequence of mapping
        As `zoo.blood.blind.truths.true_functions` makes them.
    causes : tuple of str
        Names of the causes.
    density_g_cm3 : float
    """

    tables: Sequence[Table]
    causes: tuple[str, ...] = ()
    density_g_cm3: float = 1.055

    def __call__(self, component: str, stated: StatedFunction) -> Array | None:
        """True values at a learned function's points, or None where the truth is no such function.

        Of those in `FREE_CONSTANT` with the mean of the learned one: what is divided between a function and a
        parameter of the baseline is projected off.
        """
        true = self._plain(component, stated)
        if true is None or stated.name not in FREE_CONSTANT or not np.any(np.isfinite(true)):
            return true
        return true + float(np.nanmean(stated.mean - true))

    def _plain(self, component: str, stated: StatedFunction) -> Array | None:
        mine = {t["name"]: t for t in self.tables if t["component"] == component}
        if (table := mine.get(OF_VESSELS.get(stated.name, ""))) is not None:
            known = {str(label): x for label, x in zip(table["labels"], table["values"], strict=True)}
            return np.array([known.get(label.split()[-1], math.nan) for label in stated.labels])
        if (table := mine.get(BY_RADIUS.get(stated.name, ""))) is not None:
            if not set(self.causes).isdisjoint(ROUGH_CAUSES) or "radius_cm" not in table:
                return None
            return _curve(np.log(table["radius_cm"]), table["values"], stated.at)
        read = _READERS.get(stated.name)
        if read is None:
            return None
        name, how = read
        found = mine.get(name)
        if found is not None and stated.name == "outlet-impedance" and "loads" in found:
            found = _over_stated_base(found, stated.beside)
        return None if found is None else how(self, found, stated.at)


def _curve(x: ArrayLike, y: ArrayLike, at: Array) -> Array:
    """Values of a table at points, NaN outside it."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    order = np.argsort(x)
    slack = 1e-9 * (1 + float(np.ptp(x)))
    inside = (at >= x.min() - slack) & (at <= x.max() + slack)
    return np.asarray(np.where(inside, np.interp(at, x[order], y[order]), math.nan))


def _period(table: Table) -> float:
    """Of uniform samples from 0."""
    at = table["at"]
    return float(at[-1] + at[1] - at[0])


def _as_is(truth: Truth, table: Table, at: Array) -> Array:
    return _curve(table["at"], table["values"], at)


def _periodic(truth: Truth, table: Table, at: Array) -> Array:
    return np.asarray(np.interp(at, table["at"], table["values"], period=_period(table)))


def _log_of_periodic(truth: Truth, table: Table, at: Array) -> Array:
    return np.log1p(_periodic(truth, table, at))


def _log_slope(truth: Truth, table: Table, at: Array) -> Array:
    """log(1 + delta'(s)): by how much the law is steeper than the linear one, whose slope is 1."""
    slope = np.gradient(np.asarray(table["values"]), np.asarray(table["at"]))
    return _curve(table["at"], np.log(np.maximum(1 + slope, 1e-9)), at)


def _over_dynamic(truth: Truth, table: Table, at: Array) -> Array:
    """k in D = k (u/U) rho U^2/2, U the largest speed among the points; NaN where nothing flows."""
    largest = float(np.abs(at).max())
    flows = np.abs(at) > STILL * largest
    unit = np.where(flows, at * largest, 1.0) * 0.5 * truth.density_g_cm3
    return np.asarray(np.where(flows, _as_is(truth, table, at) / unit, math.nan))


def _log_friction(truth: Truth, table: Table, at: Array) -> Array:
    return np.log1p(_as_is(truth, table, at))


def _log_impedance(truth: Truth, table: Table, at: Array) -> Array | None:
    """Log modulus at log frequencies (Hz), where it is the same at all outlets; NaN for steady flow."""
    values = np.atleast_2d(table["values"])
    if np.ptp(values, axis=0).max() > 0.05 * max(1e-12, float(np.abs(values).max())):
        return None
    omega = np.asarray(table["at"])[1:]
    return _curve(np.log(omega / (2 * math.pi)), values.mean(axis=0)[1:], at)


def _over_stated_base(table: Table, beside: Mapping[str, float]) -> Table | None:
    """The table with what the outlets have more than the stated Windkessels; None where these are not told.

    A Windkessel's parameters stand in for part of any change of the impedance, so that only both together,
    the total impedance, can be compared.
    """
    if not {"psi1", "psi2", "c"} <= set(beside):
        return None
    R1, R2, C = (
        np.asarray(table["loads"][name])[:, None] * beside[psi]
        for name, psi in (("R1", "psi1"), ("R2", "psi2"), ("C", "c"))
    )
    stated = R1 + R2 / (1 + 1j * np.asarray(table["at"]) * R2 * C)
    return {**table, "values": np.asarray(table["log_modulus"]) - np.log(np.abs(stated))}


def _gain(truth: Truth, table: Table, at: Array) -> Array | None:
    """Log gain of the first pressure's harmonics at log frequencies (Hz); of linear sensors alone."""
    if not set(truth.causes) & set(LINEAR_SENSORS):
        return None
    before = np.asarray(table["pressure"])[0]
    a, b = np.fft.rfft(before), np.fft.rfft(before + np.asarray(table["values"])[0])
    held = np.abs(a) > LEAST_HARMONIC * np.abs(a[1:]).max()
    held[0] = False
    x = np.log(np.flatnonzero(held) / _period(table))
    return _curve(x, np.log(np.abs(b[held] / a[held])), at)


def _static(truth: Truth, table: Table, at: Array) -> Array | None:
    """What a reading has too much at pressures (mmHg), of sensors without a memory."""
    if "static_mmHg" in table:
        return _curve(table["static_mmHg"], table["static_values"], at)
    if "soft-saturation" not in truth.causes:
        return None
    pressure, added = (np.asarray(table[name]) for name in ("pressure", "values"))
    each = np.array([_curve(p, x, at) for p, x in zip(pressure, added, strict=True)])
    known = np.isfinite(each)
    total = np.where(known, each, 0.0).sum(axis=0)
    return np.where(known.any(axis=0), total / np.maximum(known.sum(axis=0), 1), math.nan)


_READERS: dict[str, tuple[str, Callable[[Truth, Table, Array], Array | None]]] = {
    "flow-record": ("flow", _periodic),
    "wall-in-time": ("tone", _log_of_periodic),
    "wall-law": ("law", _log_slope),
    "friction-law": ("friction", _log_friction),
    "junction-loss": ("loss", _over_dynamic),
    "outlet-impedance": ("log-impedance", _log_impedance),
    "sensor-filter": ("reading", _gain),
    "sensor-curve": ("reading", _static),
}
"""Learned function -> table, and how its values are read off."""
