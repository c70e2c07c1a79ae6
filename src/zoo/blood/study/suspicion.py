"""Units that a study seems to be in, by the size of its numbers.

Every quantity of a study stands in one of a few units. For each choice of units the study has a mean
velocity, a wave speed, a mean pressure beside that of flow times load, a radius beside that of its heart rate
and so on, and each of these has a range that holds from mouse to whale. The choice that fits the ranges best,
with a price on every unit that is not the one the format asks for, is what the study seems to be in.

References
----------
West, Brown and Enquist 1997, doi 10.1126/science.276.5309.122: how radii, rates and velocities go with mass.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from zoo.blood.study.parts import Series, Vessel
from zoo.blood.study.study import Study
from zoo.blood.study.tree import sort_vessels
from zoo.core.arrays import Array

PRICE = 4.0
"""Log-odds against a unit that is not the format's: what the fit to the ranges must gain."""
PRICE_OF_NEXT = 1.0
"""The same for a second and further unit of the SI, as files that are in it are so throughout."""
SOFTNESS = 0.25
"""Standard deviation, of a logarithm, of the ends of the ranges."""

TRAVEL = 1e-3, 0.4
"""Part of the beat that a wave takes to the furthest outlet."""
WIDER, LONGER = 3.0, 100.0
"""Radius in that of the vessel before it, and length in radii, that no single vessel has: in mm they would be
ten times as much."""


_MMHG = 1333.22  # dyn/cm2; sizes do not need its last digits
_PRESSURE = {"kPa": 7.50062, "Pa": 7.50062e-3, "dyn/cm2": 7.50062e-4}
_FLOW = {"l/min": 1000 / 60, "ml/min": 1 / 60, "l/s": 1e3, "m3/s": 1e6}
_SIZE = {"mm": 0.1, "m": 100.0}
_SI = {"Pa", "m3/s", "m", "m2", "Pa s/m3 and m3/Pa", "kg/m3", "Pa s"}
_SI_LOADS, _MMHG_LOADS = "Pa s/m3 and m3/Pa", "mmHg s/ml and ml/mmHg"


class _Group(NamedTuple):
    """Numbers that one unit is chosen for; groups of one kind in the same unit are one mistake."""

    kind: str
    field: str
    unit: str  # of the format
    factors: Mapping[str, float]  # of other units, to that of the format


_GROUPS = {
    "pressure": _Group("pressure", "observations: pressure_mmHg", "mmHg", _PRESSURE),
    "outflow_pressure": _Group("pressure", "network: outflow_pressure_mmHg", "mmHg", _PRESSURE),
    "inlet_pressure": _Group("pressure", "inlet_pressure: pressure_mmHg", "mmHg", _PRESSURE),
    "inflow": _Group("flow", "inflow: flow_ml_s", "ml/s", _FLOW),
    "observed_flow": _Group("flow", "observations: flow_ml_s", "ml/s", _FLOW),
    "length": _Group("size", "network: length_cm", "cm", _SIZE),
    "radius": _Group("size", "network: radius_cm", "cm", _SIZE),
    "observed_area": _Group("area", "observations: area_cm2", "cm2", {"mm2": 0.01, "m2": 1e4}),
    "period": _Group("time", "study: period_s", "s", {"ms": 1e-3}),
    "stiffness": _Group("stiffness", "network: stiffness", "g/(cm s2)", {"kPa": 1e4, "MPa": 1e7}),
    "resistance": _Group("load", "network: R1 and R2", "dyn s/cm5", {_SI_LOADS: 1e-5, _MMHG_LOADS: _MMHG}),
    "compliance": _Group("load", "network: C", "cm5/dyn", {_SI_LOADS: 1e5, _MMHG_LOADS: 1 / _MMHG}),
    "density": _Group("density", "network: density_g_cm3", "g/cm3", {"kg/m3": 1e-3}),
    "viscosity": _Group("viscosity", "network: viscosity_g_cm_s", "g/(cm s)", {"Pa s": 10.0, "mPa s": 0.01}),
}


class UnitWarning(UserWarning):
    """A quantity of a study has the size of another unit."""


@dataclass(frozen=True)
class Suspicion:
    """Fields of a study whose numbers fit another unit.

    Parameters
    ----------
    fields : tuple of str
        Such as "observations: pressure_mmHg".
    unit : str
        That would fit.
    factors : tuple of float
        What the numbers of each field have to be multiplied by.
    text : str
        One line: field, value, what is odd about it, the unit that would fit, the remedy.
    """

    fields: tuple[str, ...]
    unit: str
    factors: tuple[float, ...]
    text: str

    def __str__(self) -> str:
        return self.text


class _Size(NamedTuple):
    """A size with the range that it has in any animal: value times the groups' factors to their powers."""

    words: str
    unit: str
    value: float
    low: float
    high: float
    powers: Mapping[str, float]

    def misfit(self, log_factors: Mapping[str, Array | float]) -> Any:
        """Half the squared distance from the range; inside, a little towards its ends, which breaks ties."""
        x = math.log(self.value) + sum(
            power * log_factors.get(group, 0.0) for group, power in self.powers.items()
        )
        low, high = math.log(self.low), math.log(self.high)
        away = np.maximum(0.0, np.maximum(low - x, x - high))
        middle = (x - 0.5 * (low + high)) / (high - low)
        return 0.5 * np.square(away / SOFTNESS) + 0.5 * np.square(middle)


class _Look:
    """Sizes of a study, and for each group of its numbers one that shows how large they are, in words.

    The ranges reach from the pulmonary tree of a mouse to the aorta of a whale.
    """

    def __init__(self, study: Study) -> None:
        self.study = study
        self.sizes: list[_Size] = []
        self.vessels = [study.vessels[i] for i in sort_vessels(study.vessels)]
        cubes: dict[int | None, float] = {}
        for v in study.vessels:
            cubes[v.parent] = cubes.get(v.parent, 0.0) + v.radius_cm**3
        self.share: dict[int | None, float] = {None: 1.0}  # of the inflow, split as the cubes of the radii
        way: dict[int | None, float] = {None: 0.0}
        for v in self.vessels:
            self.share[v.id] = self.share[v.parent] * v.radius_cm**3 / cubes[v.parent]
            way[v.id] = way[v.parent] + v.length_cm
        self.mean, self.swing = math.nan, math.nan  # not known where the pressure is given
        if study.inflow_ml_s.size:
            times = np.append(study.inflow_time_s, study.inflow_time_s[0] + study.period_s)
            flow = np.append(study.inflow_ml_s, study.inflow_ml_s[0])
            self.mean = float(np.trapezoid(flow, times) / study.period_s)
            self.swing = float(np.ptp(flow))
        blood, root = study.blood, self.vessels[0]
        self.typical = {
            "inflow": ("flow_ml_s has a mean of", self.mean),
            "length": (f"length_cm of vessel {root.id} is", root.length_cm),
            "radius": (f"radius_cm of vessel {root.id} is", root.radius_cm),
            "period": ("period_s is", study.period_s),
            "density": ("density_g_cm3 is", blood.density_g_cm3),
            "viscosity": ("viscosity_g_cm_s is", blood.viscosity_g_cm_s),
        }
        velocity = self.mean / (math.pi * root.radius_cm**2)
        self.add("mean velocity in the root", "cm/s", velocity, 2.5, 80, inflow=1, radius=-2)
        # cm: an aorta's radius goes with mass^(3/8), its period with mass^(1/4)
        part = root.radius_cm / (1.4 * study.period_s**1.5)
        of_aorta = "of an aorta's at this heart rate"
        self.add("radius of the root", of_aorta, part, 1 / 40, 3.5, radius=1, period=-1.5)
        self.way_cm = max(way.values())
        path = self.way_cm / root.radius_cm
        self.add("way to the furthest outlet", "radii of the root", path, 2, 250, length=1, radius=-1)
        if len(self.vessels) > 2:  # a single one may be any tube
            each = float(np.median([v.length_cm / v.radius_cm for v in self.vessels]))
            self.add("median length of the vessels", "of their radii", each, 0.1, 50, length=1, radius=-1)
        self.add("density", "g/cm3", blood.density_g_cm3, 0.9, 1.3, density=1)
        self.add("viscosity", "g/(cm s)", blood.viscosity_g_cm_s, 0.01, 0.25, viscosity=1)
        self._observed()
        self._loads()
        if chi := [v.stiffness[0] for v in study.vessels if v.stiffness]:
            speed = float(np.median([math.sqrt(2 * x / (3 * blood.density_g_cm3)) for x in chi]))
            self.add("wave speed of the walls", "cm/s", speed, 60, 4000, stiffness=0.5, density=-0.5)
            self.travel(speed, stiffness=-0.5, density=0.5)
            self.typical["stiffness"] = "stiffness has a median of", float(np.median(chi))

    def add(self, words: str, unit: str, value: float, low: float, high: float, **powers: float) -> None:
        """A size and its range; none that is zero or infinite."""
        if 0 < value < math.inf:
            self.sizes.append(_Size(words, unit, value, low, high, powers))

    def travel(self, speed_cm_s: float, **powers: float) -> None:
        """The time that a wave of this speed takes to the furthest outlet, over the beat."""
        part = self.way_cm / (speed_cm_s or math.inf) / self.study.period_s
        words = "time of a wave to the furthest outlet"
        self.add(words, "of the beat", part, TRAVEL[0], TRAVEL[1], length=1, period=-1, **powers)

    def _series(self, quantity: str, group: str) -> tuple[Series, Vessel, float] | None:
        """The series of a quantity in the vessel with the largest share of the flow, that, and its mean."""
        found = [s for s in self.study.series if s.quantity == quantity]
        if not found:
            return None
        series = max(found, key=lambda s: self.share[s.vessel])
        mean = float(np.nanmean(series.value))
        self.typical[group] = f"{quantity} in vessel {series.vessel} has a mean of", mean
        return series, next(v for v in self.vessels if v.id == series.vessel), mean

    def _observed(self) -> None:
        study = self.study
        if (given := study.inlet_pressure_mmHg).size:
            self.typical["inlet_pressure"] = "pressure_mmHg has a mean of", float(given.mean())
            self.add("mean pressure", "mmHg", abs(float(given.mean())), 2.5, 250, inlet_pressure=1)
            self.add("pulse of the pressure", "mmHg", float(np.ptp(given)), 1.5, 200, inlet_pressure=1)
        if seen := self._series("pressure_mmHg", "pressure"):
            series, v, mean = seen
            pulse = float(np.nanmax(series.value) - np.nanmin(series.value))
            swing = self.swing * self.share[v.id]
            speed = pulse * _MMHG * math.pi * v.radius_cm**2 / (study.blood.density_g_cm3 * swing or math.inf)
            words = "wave speed that the pulses of pressure and flow need"
            self.add("mean pressure", "mmHg", abs(mean), 2.5, 250, pressure=1)
            self.add("pulse of the pressure", "mmHg", pulse, 1.5, 200, pressure=1)
            self.add(words, "cm/s", speed, 80, 3000, pressure=1, radius=2, inflow=-1, density=-1)
            self.travel(speed, pressure=-1, radius=-2, inflow=1, density=1)
            fed = {one.parent for one in study.vessels}
            behind = max(study.pressure_mmHg("outflow", one) for one in study.vessels if one.id not in fed)
            self.typical["outflow_pressure"] = "outflow_pressure_mmHg is", behind
            if behind > 0.95 * abs(mean) > 0:  # a small one is as good as none
                ratio = behind / abs(mean)
                of_mean = "of the mean pressure"
                self.add("outflow pressure", of_mean, ratio, 0.002, 0.95, outflow_pressure=1, pressure=-1)
        if seen := self._series("flow_ml_s", "observed_flow"):
            _, v, mean = seen
            ratio, far = abs(mean) / (self.mean * self.share[v.id]), 2.0 if v.parent is None else 6.0
            self.add("mean flow", "of what flows in", ratio, 1 / far, far, observed_flow=1, inflow=-1)
        if seen := self._series("area_cm2", "observed_area"):
            _, v, mean = seen
            ratio = mean / (math.pi * v.radius_cm**2)
            self.add("mean area", "of pi radius^2", ratio, 0.4, 4, observed_area=1, radius=-2)

    def _loads(self) -> None:
        """The mean pressure that the mean flow makes over the loads, and their time constant."""
        flow, conductance, times = 0.0, 0.0, []
        for v in self.study.vessels:
            load, total = v.windkessel, v.resistance
            if load is not None:
                total = load.R1 + load.R2
                times.append(load.R2 * load.C / self.study.period_s)
                self.typical.setdefault("compliance", (f"C of vessel {v.id} is", load.C))
            if total:
                words = "resistance" if load is None else "R1 + R2"
                self.typical.setdefault("resistance", (f"{words} of vessel {v.id} is", total))
                conductance += 1 / total
                flow += self.mean * self.share[v.id]
        if not conductance:
            return
        words, fall = "mean flow times the loads", flow / conductance / _MMHG
        pressure, outflow = self.typical.get("pressure", ("", 0.0))[1], self.study.outflow_pressure_mmHg
        if pressure > 1.2 * abs(outflow):
            ratio, of_mean = fall / (pressure - outflow), "of the mean pressure"
            self.add(words, of_mean, ratio, 0.3, 3.5, inflow=1, resistance=1, pressure=-1)
        else:
            self.add(words, "mmHg", fall, 2.0, 250, inflow=1, resistance=1)
        if times:
            tau = float(np.median(times))
            words = "time constant of the loads"
            self.add(words, "beats", tau, 1e-4, 100, resistance=1, compliance=1, period=-1)

    def misfit(self, log_factors: Mapping[str, Array | float]) -> Any:
        """Of all sizes, where the groups' numbers are multiplied by factors."""
        return sum(size.misfit(log_factors) for size in self.sizes)


def suspect_units(study: Study) -> tuple[Suspicion, ...]:
    """Quantities of a study whose size says that they are in another unit than the format's.

    The units are chosen that minimise sum_k d_k^2/(2 s^2) + (price) (number of units changed), where d_k is
    the distance of the logarithm of the k-th size from its range: mean velocity, wave speed, pressure, flow
    times load over pressure, radius over that of an aorta at this heart rate, length over radius, and others.

    Parameters
    ----------
    study : Study

    Returns
    -------
    tuple of Suspicion
        One for each unit that seems to be another; empty for nearly every study.
    """
    look = _Look(study)
    if look.misfit({}) < PRICE:
        return tuple(_single_vessels(study))
    used = {group for size in look.sizes for group in size.powers}
    units = {name: ("", *group.factors) for name, group in _GROUPS.items() if name in used}
    choices = dict(zip(units, np.ix_(*(np.arange(len(known)) for known in units.values())), strict=True))
    log_factors = {name: np.log([1.0, *_GROUPS[name].factors.values()])[at] for name, at in choices.items()}
    cost, in_si = np.asarray(look.misfit(log_factors)), np.zeros(())
    for kind, unit in dict.fromkeys((_GROUPS[name].kind, u) for name in units for u in units[name][1:]):
        alike = [name for name in units if _GROUPS[name].kind == kind and unit in units[name]]
        changed = sum(choices[name] == units[name].index(unit) for name in alike) > 0
        if unit in _SI:
            in_si = in_si + changed
        else:
            cost = cost + PRICE * changed
    cost = cost + np.where(in_si > 0, PRICE - PRICE_OF_NEXT + PRICE_OF_NEXT * in_si, 0.0)
    best = np.unravel_index(int(np.argmin(cost)), cost.shape)
    chosen = {name: units[name][i] for name, i in zip(units, best, strict=True) if i}
    factors = {name: _GROUPS[name].factors[unit] for name, unit in chosen.items()}
    if look.misfit({name: math.log(x) for name, x in factors.items()}) > 3 * PRICE:
        return ()  # sizes of nothing that lives, in any units
    if not chosen:
        return tuple(_single_vessels(study))
    together: dict[tuple[str, str], list[str]] = {}
    for name, unit in chosen.items():
        together.setdefault((_GROUPS[name].kind, unit), []).append(name)
    return tuple(_suspicion(look, names, unit, factors) for (_, unit), names in together.items())


def _suspicion(look: _Look, names: Sequence[str], unit: str, factors: Mapping[str, float]) -> Suspicion:
    """What is told of groups that seem to be in a unit, when all groups in `factors` are in another."""
    right = {name: math.log(factor) for name, factor in factors.items()}
    concerned = [size for size in look.sizes if any(size.powers.get(name) for name in names)]
    oddest = max(concerned, key=lambda size: float(size.misfit({}) - size.misfit(right)))
    better = oddest.value * math.prod(
        factors.get(name, 1.0) ** power for name, power in oddest.powers.items()
    )
    told = [f"{look.typical[name][0]} {look.typical[name][1]:.4g}" for name in names]
    then = [f"{look.typical[name][1] * factors[name]:.4g} {_GROUPS[name].unit}" for name in names]
    where = "; ".join(dict.fromkeys(_GROUPS[name].field.partition(":")[0] for name in names))
    by = [f"{_GROUPS[name].field.partition(': ')[2]} by {factors[name]:.6g}" for name in names]
    alike = len({factors[name] for name in names}) == 1
    remedy = f"multiply by {factors[names[0]]:.6g}" if alike else f"multiply {' and '.join(by)}"
    text = (
        f"{where}: {' and '.join(told)}: the {oddest.words} would be {oddest.value:.3g} {oddest.unit} "
        f"(usual: {oddest.low:.3g} to {oddest.high:.4g}); {unit} would fit ({' and '.join(then)}, and "
        f"{better:.3g} {oddest.unit}); {remedy}"
    )
    return Suspicion(tuple(_GROUPS[n].field for n in names), unit, tuple(factors[n] for n in names), text)


def _single_vessels(study: Study) -> Iterator[Suspicion]:
    """Vessels that alone are ten times as wide or as long as they can be, beside others that are not."""
    by_id = {v.id: v for v in study.vessels}
    long = [v for v in study.vessels if v.length_cm > LONGER * v.radius_cm]
    for v in study.vessels:
        before = None if v.parent is None else by_id[v.parent]
        if before is not None and v.radius_cm > WIDER * before.radius_cm:
            ratio = v.radius_cm / before.radius_cm
            odd = f"{ratio:.2g} times the {before.radius_cm:g} of vessel {before.id} before it"
            yield _in_mm("radius_cm", v, v.radius_cm, odd)
        elif [v] == long and len(by_id) > 1:
            yield _in_mm("length_cm", v, v.length_cm, f"{v.length_cm / v.radius_cm:.3g} times its radius")


def _in_mm(field: str, v: Vessel, value: float, odd: str) -> Suspicion:
    text = f"{field} of vessel {v.id} is {value:g}, {odd}: if it is in mm, write {0.1 * value:g}"
    return Suspicion((f"network: {field}",), "mm", (0.1,), f"network: {text}")


def warn_of_units(study: Study) -> None:
    """Warn of each of `suspect_units`; ``warnings.simplefilter("ignore", UnitWarning)`` silences that.

    Parameters
    ----------
    study : Study
    """
    for suspicion in suspect_units(study):
        warnings.warn(f"{study.source}: {suspicion}", UnitWarning, stacklevel=4)
