"""What the loads at the outlets may lack."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case, with_physics
from zoo.blood.components.curves import curve, factors, minimum_phase
from zoo.blood.components.declared import free_function
from zoo.blood.components.setting import MOST_HARMONICS, Setting, range_knots, span_of
from zoo.blood.functions import OutletFunction
from zoo.blood.loads import with_impedance_change
from zoo.core.arrays import Array
from zoo.core.components import FreeFunction

IMPEDANCE_KNOTS = 10
LOWEST_HARMONIC = 0.1
"""Below this part of the beat's frequency an outlet's impedance is steady."""
POLES = 8
"""Parallel pairs that are added to an outlet's circuit, their time constants evenly spaced in the log."""
FITTED = 60
"""Frequencies at which a circuit is fitted to an impedance."""
STATE_KNOTS, STATE_TABLE = 8, 33


def _spread(case: Case, values: Array) -> Array:
    """Factor of every vessel, 1 where it is no terminal, (n_vessels,)."""
    scale = np.ones(len(case.network.ids))
    scale[case.network.terminals] = factors(values)
    return scale


def scaled_loads(case: Case, values: Array, of: tuple[str, ...]) -> Case:
    """psi1, psi2 or c -> itself times exp(v) at each terminal."""
    scale = _spread(case, values)
    return replace(case, **{name: getattr(case, name) * scale for name in of})


def own_loads(case: Case, values: Array) -> Case:
    """Resistances and compliance of each terminal -> themselves times exp(v), v of all resistances first."""
    resistance, compliance = np.split(values, 2)
    return scaled_loads(scaled_loads(case, resistance, ("psi1", "psi2")), compliance, ("c",))


def log_impedance_change(at: Array, values: Array, omega: Array) -> NDArray[np.complex128]:
    """Change of log Z at angular frequencies (rad/s): v through the knots, and the phase that goes with it.

    A passive circuit's impedance has no zeros or poles of positive real part, so that its modulus gives its
    phase (`zoo.blood.components.curves.minimum_phase`).
    """
    x = np.log(omega / (2 * math.pi))
    return np.asarray((curve(at, x) + 1j * minimum_phase(at, x)) @ values)


def changed_impedance(case: Case, values: Array, at: Array) -> Case:
    """Z(f) -> Z(f) exp(v(f)) at every terminal, by a circuit of `POLES` more pairs."""
    if not np.any(values):
        return case
    omega = 2 * math.pi * np.exp(np.linspace(at[0] - 1.0, at[-1] + 1.0, FITTED))
    log_change = log_impedance_change(at, values, omega)
    change = np.log(factors(np.append(values[0], log_change.real))) + 1j * np.append(0.0, log_change.imag)
    tau = np.exp(-np.linspace(at[0], at[-1], POLES)) / (2 * math.pi)
    return with_impedance_change(case, np.append(0.0, omega), change, times_s=tau)


def changed_state(case: Case, values: Array, at: Array) -> Case:
    """R2 -> R2 exp(v(p)) of all outlets, v a spline through values at pressures (mmHg) behind R1."""
    unit = case.conventions.mmhg
    made = OutletFunction(float(at[0]) * unit, float(at[-1]) * unit, tuple(values))
    made = made.beside(case.physics.outlet_resistance_function, STATE_TABLE)
    return with_physics(case, outlet_resistance_function=made)


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """Impedance, state, and scatter over terminals; of single resistances, that of these alone."""
    network = setting.case.network
    terminals = network.terminals
    labels = tuple(setting.vessels[i] for i in terminals)
    index = np.arange(float(len(terminals)))

    def scatter(name: str, of: tuple[str, ...]) -> FreeFunction:
        return free_function(name, index, functools.partial(scaled_loads, of=of), labels=labels)

    resistance = scatter("outlet-resistance", ("psi1", "psi2"))
    if not np.all(network.R2[terminals] > 0):
        return (resistance,)
    frequencies = np.linspace(math.log(LOWEST_HARMONIC), math.log(MOST_HARMONICS), IMPEDANCE_KNOTS)
    frequencies -= math.log(setting.period_s)
    pressure, flow = (setting.beat[name][terminals, 1] for name in ("pressure", "flow"))
    first = (setting.case.psi1 * network.R1)[terminals, None] / setting.case.conventions.mmhg
    behind = range_knots(pressure - first * flow, STATE_KNOTS)
    return (
        free_function("outlet-impedance", frequencies, functools.partial(changed_impedance, at=frequencies)),
        free_function(
            "outlet-state",
            behind,
            functools.partial(changed_state, at=behind),
            size_of=0.5 * float(np.ptp(behind)),
            lengths_of=span_of(behind),
        ),
        resistance,
        scatter("outlet-first-resistance", ("psi1",)),
        scatter("outlet-compliance", ("c",)),
        free_function(
            "outlet-loads",
            np.arange(2.0 * len(terminals)),
            own_loads,
            labels=tuple(f"{of} of {label}" for of in ("R", "C") for label in labels),
        ),
    )
