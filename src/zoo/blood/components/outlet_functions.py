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
from zoo.blood.loads import outlet_impedance, with_more_impedance
from zoo.blood.outlet_tables import HARMONICS
from zoo.core.arrays import Array
from zoo.core.components import FreeFunction

IMPEDANCE_KNOTS = 22
"""Nearer to one another than the shortest length of the function."""
LOWEST_HARMONIC = 0.3
"""Below this part of the beat's frequency an outlet's impedance changes no more."""
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


def changed_impedance(case: Case, values: Array, change: NDArray[np.complex128]) -> Case:
    """Z -> Z exp(M v) at the harmonics 0 to n of the beat, M = `change` (n_terminals, n + 1, n_knots)."""
    if not np.any(values):
        return case
    log_change = change @ values
    Z = outlet_impedance(case, 2 * math.pi / case.network.period_s * np.arange(change.shape[1]))
    return with_more_impedance(case, Z * (factors(log_change.real) * np.exp(1j * log_change.imag) - 1))


def impedance_changes(at: Array, radius_cm: Array, period_s: float) -> NDArray[np.complex128]:
    """Change of log Z at harmonics of the beat by values at knots: v through them, and the phase with it.

    A passive outlet's impedance has no zeros or poles of positive real part, so that its modulus gives its
    phase (`zoo.blood.components.curves.minimum_phase`). What lies behind a wider outlet is longer in
    proportion, so that it does at frequency f what another of radius r does at f times their ratio.

    Parameters
    ----------
    at : array (n_knots,)
        Logarithms of frequencies (Hz) behind an outlet of the radii's geometric mean.
    radius_cm : array (n_terminals,)
    period_s : float

    Returns
    -------
    complex array (n_terminals, n + 1, n_knots)
        At the harmonics 0 to n; in steady flow v at the first knot.
    """
    wider = np.log(radius_cm)[:, None] - np.mean(np.log(radius_cm))
    x = (wider + np.log(np.arange(1, HARMONICS + 1) / period_s)).ravel()
    moving = (curve(at, x) + 1j * minimum_phase(at, x)).reshape(len(radius_cm), HARMONICS, len(at))
    steady = np.broadcast_to(np.eye(1, len(at)), (len(radius_cm), 1, len(at)))
    return np.concatenate([steady, moving], axis=1)


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
    change = impedance_changes(frequencies, network.radius_out_cm[terminals], setting.period_s)
    pressure, flow = (setting.beat[name][terminals, 1] for name in ("pressure", "flow"))
    first = (setting.case.psi1 * network.R1)[terminals, None] / setting.case.conventions.mmhg
    behind = range_knots(pressure - first * flow, STATE_KNOTS)
    return (
        free_function("outlet-impedance", frequencies, functools.partial(changed_impedance, change=change)),
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
