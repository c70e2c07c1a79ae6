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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from zoo.blood.study.parts import Series, Vessel
from zoo.blood.study.study import Study
from zoo.blood.study.tree import sort_vessels

PRICE = 4.0
"""Log-odds against a unit that is not the format's: what the fit to the ranges must gain."""
PRICE_OF_NEXT = 1.0
"""The same for a second and further unit of the SI, as files that are in it are so throughout."""
SOFTNESS = 0.25
"""Standard deviation, of a logarithm, of the ends of the ranges."""

Array = NDArray[np.float64]

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
    "outflow pressure": _Group("pressure", "network: outflow_pressure_mmHg", "mmHg", _PRESSURE),
    "inflow": _Group("flow", "inflow: flow_ml_s", "ml/s", _FLOW),
    "observed flow": _Group("flow", "observations: flow_ml_s", "ml/s", _FLOW),
    "length": _Group("size", "network: length_cm", "cm", _SIZE),
    "radius": _Group("size", "network: radius_cm", "cm", _SIZE),
    "observed area": _Group("area", "observations: area_cm2", "cm2", {"mm2": 0.01, "m2": 1e4}),
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


class _Tree(NamedTuple):
    """The root, each vessel by id, its share of the inflow and its way from the root's inlet, cm."""

    root: Vessel
    vessels: Mapping[int, Vessel]
    share: Mapping[int, float]
    way_cm: Mapping[int, float]


def _tree(study: Study) -> _Tree:
    """The inflow is split as the cubes of the radii."""
    beside: dict[int | None, float] = {}
    for v in study.vessels:
        beside[v.parent] = beside.get(v.parent, 0.0) + v.radius_cm**3
    ordered = [study.vessels[i] for i in sort_vessels(study.vessels)]
    share: dict[int | None, float] = {None: 1.0}
    way: dict[int | None, float] = {None: 0.0}
    for v in ordered:
        share[v.id] = share[v.parent] * v.radius_cm**3 / beside[v.parent]
        way[v.id] = way[v.parent] + v.length_cm
    return _Tree(
        ordered[0],
        {v.id: v for v in ordered},
        {v.id: share[v.id] for v in ordered},
        {v.id: way[v.id] for v in ordered},
    )


def _nearest(study: Study, quantity: str, tree: _Tree) -> Series | None:
    """The series of a quantity in the vessel with the largest share of the flow."""
    found = [s for s in study.series if s.quantity == quantity]
    return max(found, key=lambda s: tree.share[s.vessel], default=None)


def _mean_inflow(study: Study) -> float:
    """Mean of the inflow, linear between its samples and from the last one on to the first, ml/s."""
    times = np.append(study.inflow_time_s, study.inflow_time_s[0] + study.period_s)
    flow = np.append(study.inflow_ml_s, study.inflow_ml_s[0])
    return float(np.trapezoid(flow, times) / study.period_s)


def _sizes(study: Study) -> list[_Size]:
    """Sizes of a study; the ranges reach from the pulmonary tree of a mouse to the aorta of a whale."""
    tree = _tree(study)
    root, mean = tree.root, _mean_inflow(study)
    blood = study.blood
    path = max(tree.way_cm.values())
    heart = (
        1.4 * study.period_s**1.5
    )  # cm: an aorta's radius goes with mass^(3/8), its period with mass^(1/4)
    sizes = [
        _Size(
            "mean velocity in the root",
            "cm/s",
            mean / (math.pi * root.radius_cm**2),
            2.5,
            80,
            {"inflow": 1, "radius": -2},
        ),
        _Size(
            "radius of the root",
            "of an aorta's at this heart rate",
            root.radius_cm / heart,
            1 / 40,
            3.5,
            {"radius": 1, "period": -1.5},
        ),
        _Size(
            "way to the furthest outlet",
            "radii of the root",
            path / root.radius_cm,
            2,
            250,
            {"length": 1, "radius": -1},
        ),
        _Size("density", "g/cm3", blood.density_g_cm3, 0.9, 1.3, {"density": 1}),
        _Size("viscosity", "g/(cm s)", blood.viscosity_g_cm_s, 0.01, 0.25, {"viscosity": 1}),
        *_observed_sizes(study, tree, mean),
        *_load_sizes(study, tree, mean),
    ]
    speeds = [math.sqrt(2 * chi / (3 * blood.density_g_cm3)) for chi in _stiffnesses(study)]
    if speeds:
        typical = float(np.median(speeds))
        powers = {"stiffness": 0.5, "density": -0.5}
        sizes.append(_Size("wave speed of the walls", "cm/s", typical, 60, 4000, powers))
    return [size for size in sizes if 0 < size.value < math.inf]


def _observed_sizes(study: Study, tree: _Tree, mean: float) -> list[_Size]:
    sizes = []
    pressure = _nearest(study, "pressure_mmHg", tree)
    if pressure is not None:
        v = tree.vessels[pressure.vessel]
        pulse, swing = float(np.ptp(pressure.value)), float(np.ptp(study.inflow_ml_s)) * tree.share[v.id]
        area = math.pi * v.radius_cm**2
        speed = pulse * _MMHG * area / (study.blood.density_g_cm3 * swing) if swing else 0.0
        powers = {"pressure": 1, "radius": 2, "inflow": -1, "density": -1}
        sizes += [
            _Size("mean pressure", "mmHg", abs(float(pressure.value.mean())), 2.5, 250, {"pressure": 1}),
            _Size("pulse of the pressure", "mmHg", pulse, 1.5, 200, {"pressure": 1}),
            _Size("wave speed that the pulses of pressure and flow need", "cm/s", speed, 80, 3000, powers),
        ]
        behind, mean_there = _outflow_pressure(study), abs(float(pressure.value.mean()))
        if behind > 0.95 * mean_there > 0:  # a small one is as good as none
            ratio, powers = behind / mean_there, {"outflow pressure": 1, "pressure": -1}
            sizes.append(_Size("outflow pressure", "of the mean pressure", ratio, 0.002, 0.95, powers))
    flow = _nearest(study, "flow_ml_s", tree)
    if flow is not None:
        ratio = abs(float(flow.value.mean())) / (mean * tree.share[flow.vessel])
        far = 2.0 if flow.vessel == tree.root.id else 6.0
        powers = {"observed flow": 1, "inflow": -1}
        sizes.append(_Size("mean flow", "of what flows in", ratio, 1 / far, far, powers))
    area_seen = _nearest(study, "area_cm2", tree)
    if area_seen is not None:
        ratio = float(area_seen.value.mean()) / (math.pi * tree.vessels[area_seen.vessel].radius_cm ** 2)
        sizes.append(_Size("mean area", "of pi radius^2", ratio, 0.4, 4, {"observed area": 1, "radius": -2}))
    return sizes


def _outflow_pressure(study: Study) -> float:
    """The largest pressure behind an outlet, mmHg."""
    fed = {v.parent for v in study.vessels}
    own = [v.outflow_pressure_mmHg for v in study.vessels if v.id not in fed]
    return max(study.outflow_pressure_mmHg if p is None else p for p in own)


def _load_sizes(study: Study, tree: _Tree, mean: float) -> list[_Size]:
    """The mean pressure that the mean flow makes over the loads, and their time constant."""
    flow_over, conductance, times = 0.0, 0.0, []
    for v in study.vessels:
        load, single = v.windkessel, v.resistance or 0.0
        if load is None and not single:
            continue
        total = load.R1 + load.R2 if load is not None else float(single)
        conductance += 1 / total
        flow_over += mean * tree.share[v.id]
        if load is not None:
            times.append(load.R2 * load.C / study.period_s)
    if not conductance:
        return []
    powers = {"inflow": 1.0, "resistance": 1.0}
    fall = flow_over / conductance / _MMHG
    pressure = _nearest(study, "pressure_mmHg", tree)
    outflow = study.outflow_pressure_mmHg
    if pressure is not None and float(pressure.value.mean()) > 1.2 * abs(outflow):
        ratio = fall / (float(pressure.value.mean()) - outflow)
        sizes = [
            _Size(
                "mean flow times the loads",
                "of the mean pressure",
                ratio,
                0.3,
                3.5,
                powers | {"pressure": -1},
            )
        ]
    else:
        sizes = [_Size("mean flow times the loads", "mmHg", fall, 2.0, 250, powers)]
    if times:
        tau = float(np.median(times))
        powers = {"resistance": 1, "compliance": 1, "period": -1}
        sizes.append(_Size("time constant of the loads", "beats", tau, 1e-4, 100, powers))
    return sizes


def _stiffnesses(study: Study) -> list[float]:
    """chi at the inlet of each vessel that has a stiffness, g/(cm s2)."""
    return [v.stiffness[0] for v in study.vessels if v.stiffness]


def _misfit(size: _Size, log_factors: Mapping[str, Array]) -> Array:
    """Half the squared distance from a size's range; inside, a little towards its ends, which breaks ties."""
    x = np.asarray(math.log(size.value))
    for group, power in size.powers.items():
        x = x + power * log_factors[group]
    low, high = math.log(size.low), math.log(size.high)
    away = np.maximum(0.0, np.maximum(low - x, x - high))
    middle = (x - 0.5 * (low + high)) / (high - low)
    return np.asarray(0.5 * np.square(away / SOFTNESS) + 0.5 * np.square(middle))


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
    sizes = _sizes(study)
    used = {group for size in sizes for group in size.powers}
    groups = [name for name in _GROUPS if name in used]
    as_is = {name: np.zeros(()) for name in groups}
    before = sum(float(_misfit(size, as_is)) for size in sizes)
    if before < PRICE:
        return ()
    units = [["", *_GROUPS[name].factors] for name in groups]
    log_factors: dict[str, Array] = {}
    changed: dict[tuple[str, str], Any] = {}
    for axis, (name, choices) in enumerate(zip(groups, units, strict=True)):
        kind, factors = _GROUPS[name].kind, _GROUPS[name].factors
        shape = [-1 if i == axis else 1 for i in range(len(groups))]
        log_factors[name] = np.array([math.log(factors.get(unit, 1.0)) for unit in choices]).reshape(shape)
        for i, unit in enumerate(choices[1:], 1):
            here = (np.arange(len(choices)) == i).reshape(shape)
            changed[kind, unit] = changed.get((kind, unit), np.False_) | here
    cost = np.asarray(sum(_misfit(size, log_factors) for size in sizes))
    paid: Any = 0.0
    in_si: Any = 0.0
    for (_, unit), flag in changed.items():
        if unit in _SI:
            in_si = in_si + np.asarray(flag, dtype=np.float64)
        else:
            paid = paid + PRICE * np.asarray(flag)
    cost = cost + paid + np.where(in_si > 0, PRICE - PRICE_OF_NEXT + PRICE_OF_NEXT * in_si, 0.0)
    best = np.unravel_index(int(np.argmin(cost)), cost.shape)
    chosen = {name: choices[i] for name, choices, i in zip(groups, units, best, strict=True) if i}
    by_name = {name: _GROUPS[name].factors[unit] for name, unit in chosen.items()}
    together: dict[tuple[str, str], list[str]] = {}
    for name, unit in chosen.items():
        together.setdefault((_GROUPS[name].kind, unit), []).append(name)
    right = as_is | {name: np.asarray(math.log(factor)) for name, factor in by_name.items()}
    if sum(float(_misfit(size, right)) for size in sizes) > 3 * PRICE:
        return ()  # sizes of nothing that lives, in any units
    return tuple(_suspicion(study, sizes, names, unit, by_name) for (_, unit), names in together.items())


def _typical(study: Study, group: str) -> tuple[str, float]:
    """How a number that shows the size of a group is told, up to the number itself, and the number."""
    tree = _tree(study)
    root = tree.root
    quantity = {"pressure": "pressure_mmHg", "observed flow": "flow_ml_s", "observed area": "area_cm2"}
    if group in quantity:
        series = _nearest(study, quantity[group], tree)
        assert series is not None  # else no size asks for the group
        return f"{quantity[group]} in vessel {series.vessel} has a mean of", float(series.value.mean())
    if group in ("resistance", "compliance"):
        for v in study.vessels:
            if v.resistance is not None and group == "resistance":
                return f"resistance of vessel {v.id} is", v.resistance
            if v.windkessel is not None:
                load = v.windkessel
                total = load.R1 + load.R2
                both = {"resistance": ("R1 + R2", total), "compliance": ("C", load.C)}
                words, value = both[group]
                return f"{words} of vessel {v.id} is", value
    return {
        "outflow pressure": ("outflow_pressure_mmHg is", _outflow_pressure(study)),
        "inflow": ("flow_ml_s has a mean of", _mean_inflow(study)),
        "length": (f"length_cm of vessel {root.id} is", root.length_cm),
        "radius": (f"radius_cm of vessel {root.id} is", root.radius_cm),
        "period": ("period_s is", study.period_s),
        "stiffness": ("stiffness has a median of", float(np.median(_stiffnesses(study) or [0.0]))),
        "density": ("density_g_cm3 is", study.blood.density_g_cm3),
        "viscosity": ("viscosity_g_cm_s is", study.blood.viscosity_g_cm_s),
    }[group]


def _suspicion(
    study: Study, sizes: Sequence[_Size], names: Sequence[str], unit: str, factors: Mapping[str, float]
) -> Suspicion:
    """What is told of groups that seem to be in a unit, when all groups in `factors` are in another."""
    none = {group: np.zeros(()) for group in _GROUPS}
    right = none | {group: np.asarray(math.log(factor)) for group, factor in factors.items()}
    concerned = [size for size in sizes if any(size.powers.get(name) for name in names)]
    oddest = max(concerned, key=lambda size: float(_misfit(size, none) - _misfit(size, right)))
    better = oddest.value * math.prod(
        factors.get(group, 1.0) ** power for group, power in oddest.powers.items()
    )
    told, then = [], []
    for name in names:
        words, value = _typical(study, name)
        told.append(f"{words} {value:.4g}")
        then.append(f"{value * factors[name]:.4g} {_GROUPS[name].unit}")
    where = "; ".join(dict.fromkeys(_GROUPS[name].field.partition(":")[0] for name in names))
    if len({factors[name] for name in names}) == 1:
        remedy = f"multiply by {factors[names[0]]:.6g}"
    else:
        by = (f"{_GROUPS[name].field.partition(': ')[2]} by {factors[name]:.6g}" for name in names)
        remedy = f"multiply {' and '.join(by)}"
    text = (
        f"{where}: {' and '.join(told)}: the {oddest.words} would be {oddest.value:.3g} {oddest.unit} "
        f"(usual: {oddest.low:.3g} to {oddest.high:.4g}); {unit} would fit ({' and '.join(then)}, and "
        f"{better:.3g} {oddest.unit}); {remedy}"
    )
    return Suspicion(tuple(_GROUPS[n].field for n in names), unit, tuple(factors[n] for n in names), text)


def warn_of_units(study: Study, stacklevel: int = 2) -> None:
    """Warn of each of `suspect_units`; ``warnings.simplefilter("ignore", UnitWarning)`` silences that.

    Parameters
    ----------
    study : Study
    stacklevel : int
        As of `warnings.warn`, counted from the caller.
    """
    for suspicion in suspect_units(study):
        warnings.warn(f"{study.source}: {suspicion}", UnitWarning, stacklevel=stacklevel + 1)
