"""What the loads at the outlets may lack."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case, with_physics
from zoo.blood.components.curves import curve, factors, minimum_phase
from zoo.blood.components.setting import (
    FREQUENCY,
    FREQUENCY_UNIT,
    MOST_HARMONICS,
    Setting,
    range_knots,
    range_lengths,
)
from zoo.blood.functions import OutletFunction
from zoo.blood.loads import with_impedance_change
from zoo.core.components import FreeFunction

Array = NDArray[np.float64]
IMPEDANCE_KNOTS = 10
IMPEDANCE_SIZE = 0.2
IMPEDANCE_LENGTHS = (1.0, 1.6, 2.8)
LOWEST_HARMONIC = 0.1
"""Below this part of the beat's frequency an outlet's impedance is steady."""
POLES = 8
"""Parallel pairs that are added to an outlet's circuit, their time constants evenly spaced in the log."""
FITTED = 60
"""Frequencies at which a circuit is fitted to an impedance."""
STATE_KNOTS, STATE_TABLE = 8, 33
STATE_PER_MMHG = 0.08
"""Change of a resistance's logarithm: four times the distensibility of a radius."""
SCATTER_SIZE = 0.4
FIRST_SIZE = 0.3


def _spread(case: Case, values: Array) -> Array:
    """Factor of every vessel, 1 where it is no terminal, (n_vessels,)."""
    scale = np.ones(len(case.network.ids))
    scale[case.network.terminals] = factors(values)
    return scale


def scaled_loads(case: Case, values: Array, of: tuple[str, ...]) -> Case:
    """psi1, psi2 or c -> itself times exp(v) at each terminal."""
    scale = _spread(case, values)
    return replace(case, **{name: getattr(case, name) * scale for name in of})


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
    old = case.physics.outlet_resistance_function
    if old is not None and old.changes:
        knots = np.linspace(min(old.low, made.low), max(old.high, made.high), STATE_TABLE)
        made = OutletFunction(float(knots[0]), float(knots[-1]), tuple(old(knots) + made(knots)))
    return with_physics(case, outlet_resistance_function=made)


def functions(setting: Setting) -> tuple[FreeFunction, ...]:
    """Impedance, state, and the scatter over terminals; of single resistances, that of these alone."""
    network = setting.case.network
    terminals = network.terminals
    labels = tuple(setting.vessels[i] for i in terminals)
    index = np.arange(float(len(terminals)))

    def scatter(name: str, size: float, of: tuple[str, ...], unit: str, why: str) -> FreeFunction:
        letters = {"psi1": "R1", "psi2": "R2", "c": "C"}
        changed = ", ".join(f"{letters[one]} -> {letters[one]} exp(v)" for one in of)
        return FreeFunction(
            name,
            "outlets",
            index,
            size,
            functools.partial(scaled_loads, of=of),
            "terminal",
            "1",
            unit,
            why=why,
            labels=labels,
            equation=f"{changed} at each terminal, independent",
        )

    found = [
        scatter(
            "outlet-resistance",
            SCATTER_SIZE,
            ("psi1", "psi2"),
            "log resistance",
            "0.4: nominal shares follow Poiseuille's law, r^4 (Qureshi et al. 2018, "
            "doi 10.1007/s10237-018-1078-8), and 10 % of a radius is 0.4 in its fourth power",
        )
    ]
    if np.all(network.R2[terminals] > 0):
        found += [
            scatter(
                "outlet-first-resistance",
                FIRST_SIZE,
                ("psi1",),
                "log resistance",
                "assumed: 0.3; nominal R1 is a fifth of the total by rule, and the characteristic impedance "
                "for which it stands goes with r^-2.5: 10 % of a radius is 0.25",
            ),
            scatter(
                "outlet-compliance",
                SCATTER_SIZE,
                ("c",),
                "log compliance",
                "assumed: 0.4, as for resistances: nominal compliances are one time constant over them",
            ),
        ]
    if not np.all(network.R2[terminals] > 0):
        return tuple(found)
    frequencies = np.linspace(math.log(LOWEST_HARMONIC), math.log(MOST_HARMONICS), IMPEDANCE_KNOTS)
    frequencies -= math.log(setting.period_s)
    pressure, flow = (setting.beat[name][terminals, 1] for name in ("pressure", "flow"))
    first = (setting.case.psi1 * network.R1)[terminals, None] / setting.case.conventions.mmhg
    behind = range_knots(pressure - first * flow, STATE_KNOTS)
    whole = (
        FreeFunction(
            "outlet-impedance",
            "outlets",
            frequencies,
            IMPEDANCE_SIZE,
            functools.partial(changed_impedance, at=frequencies),
            FREQUENCY,
            FREQUENCY_UNIT,
            "log impedance",
            why="0.2; a tree of small arteries (Olufsen et al. 2000, doi 10.1114/1.1326031, as the effect "
            "structured-tree has it) differs from the nearest three-element circuit by up to 0.27",
            lengths=IMPEDANCE_LENGTHS,
            equation="Z(f) -> Z(f) exp(v(f)), v real, with the phase that goes with it; at all terminals",
        ),
        FreeFunction(
            "outlet-state",
            "outlets",
            behind,
            STATE_PER_MMHG * 0.5 * float(np.ptp(behind)),
            functools.partial(changed_state, at=behind),
            "pressure behind R1",
            "mmHg",
            "log resistance",
            why="8 % for each mmHg, over half of the range: resistance goes with r^-4, at a "
            "distensibility of 2 % for each mmHg (Krenz & Dawson 2003, doi 10.1152/ajpheart.00762.2002)",
            lengths=range_lengths(behind),
            equation="R2 -> R2 exp(v(p)), p the pressure behind R1; one v for all terminals",
        ),
    )
    return (*whole, *found)
