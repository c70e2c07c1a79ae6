"""The true functions of a case by component: what a changed configuration has and the baseline lacks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoo.blood.case import Case, Wave
from zoo.blood.effects.outflow import sections_of

Array = NDArray[np.float64]
HARMONICS = 20
POINTS = 65
"""Of a table over a range."""
PLACES = (0.0, 0.5, 1.0)
"""Of each vessel, at which the range that a function's argument visits is read."""
DIGITS = 6


def numbers(values: Any) -> list[Any]:
    """Numbers with as many digits as a key holds, nested as the array is."""
    array = np.asarray(values, dtype=np.float64)
    return list(np.array([float(f"{x:.{DIGITS}g}") for x in array.ravel()]).reshape(array.shape).tolist())


def table(
    component: str, name: str, argument: str, argument_unit: str, unit: str, at: Any, values: Any, **more: Any
) -> dict[str, Any]:
    """A true function as the key tells it."""
    return {
        "component": component,
        "name": name,
        "argument": argument,
        "argument_unit": argument_unit,
        "unit": unit,
        "at": numbers(at),
        "values": numbers(values),
        **more,
    }


def impedance(case: Case, omega: Array) -> NDArray[np.complex128]:
    """Of each outlet, dyn s/cm5, (n_terminals, n)."""
    net, at = case.network, case.network.terminals
    rho, kappa = (x[at] if len(x) > 1 else np.repeat(x, len(at), axis=0) for x in sections_of(case))
    R = (case.psi2 * net.R2)[at, None] * rho
    C = (case.c * net.C)[at, None] * kappa
    each = R[:, :, None] / (1 + 1j * omega * (R * C)[:, :, None])
    return np.asarray((case.psi1 * net.R1)[at, None] + each.sum(axis=1))


class Visited:
    """Ranges that the true solution visits, over all vessels and the beat.

    Parameters
    ----------
    case : Case
    solved : array (n_vessels, 3, 2, n_times)
        Area (cm2) and flow (ml/s) at the `PLACES` of each vessel.
    """

    def __init__(self, case: Case, solved: Array) -> None:
        net = case.network
        radius = np.stack(
            [net.radius_in_cm + x * (net.radius_out_cm - net.radius_in_cm) for x in PLACES], axis=1
        )
        area, flow = solved[:, :, 0], solved[:, :, 1]
        stretch = np.sqrt(area / (math.pi * radius**2)[:, :, None])
        velocity = flow / area
        parents = np.unique(net.parent[net.parent >= 0])
        self.stretch = float(stretch.min()), float(stretch.max())
        self.velocity = 0.0, float(np.abs(velocity).max())
        self.junction = float(velocity[parents, 2].min()), float(velocity[parents, 2].max())

    def record(self) -> dict[str, list[float]]:
        """For the key."""
        return {
            "stretch": numbers(self.stretch),
            "velocity_cm_s": numbers(self.velocity),
            "junction_velocity_cm_s": numbers(self.junction),
        }


def _grid(limits: tuple[float, float]) -> Array:
    return np.asarray(np.linspace(*limits, POINTS))


def true_functions(
    before: Case,
    after: Case,
    visited: Visited,
    plain: Array,
    quantities: Sequence[str],
    labels: Sequence[str],
) -> list[dict[str, Any]]:
    """Tables of all in which two configurations differ.

    Parameters
    ----------
    before, after : Case
        The baseline, and with the cause.
    visited : Visited
    plain : array (n_series, n)
        Series of a beat, before any sensor.
    quantities, labels : sequence of str
        Of the series.

    Returns
    -------
    list of dict
    """
    found: list[dict[str, Any]] = []
    net, old = after.network, before.network
    ids = [str(int(i)) for i in net.ids]

    def of_vessels(component: str, name: str, values: Array, which: NDArray[Any] | None = None) -> None:
        some = np.arange(len(ids)) if which is None else which
        if np.any(np.abs(values[some]) > 1e-12):
            radius = numbers(0.5 * (old.radius_in_cm + old.radius_out_cm)[some])
            names = [ids[i] for i in some]
            found.append(
                table(
                    component, name, "vessel", "1", "1", net.ids[some], values[some], labels=names,
                    radius_cm=radius,
                )
            )  # fmt: skip

    if np.any(after.inflow_ml_s != before.inflow_ml_s):
        change = after.inflow_ml_s - before.inflow_ml_s
        found.append(table("inflow", "flow", "time", "s", "ml/s", after.inflow_time_s, change))
    of_vessels("geometry", "log-radius", np.log(net.radius_in_cm / old.radius_in_cm))
    of_vessels("geometry", "log-length", np.log(net.length_cm / old.length_cm))
    of_vessels("wall", "log-stiffness", np.log(after.stiffness / before.stiffness))
    new, base = after.physics, before.physics
    if new.stiffness_wave is not None and new.stiffness_wave is not base.stiffness_wave:
        m = len(new.stiffness_wave)
        times = np.arange(m) * (net.period_s / m)
        found.append(table("wall", "tone", "time", "s", "1", times, new.stiffness_wave - 1))
    if new.viscosity_factor is not None:
        of_vessels("fluid", "log-viscosity", np.log(new.viscosity_factor))
    for component, name, law, limits, words in (
        ("wall", "law", "wall_function", visited.stretch, ("stretch", "1", "K")),
        ("fluid", "friction", "friction_function", visited.velocity, ("velocity", "cm/s", "1")),
        ("junctions", "loss", "junction_function", visited.junction, ("velocity", "cm/s", "dyn/cm2")),
    ):
        function = getattr(new, law, None)
        if function is not None and function is not getattr(base, law, None):
            x = _grid(limits)
            values = function(x) - (1.0 if component == "fluid" else 0.0)
            found.append(table(component, name, *words, x, values))
    at = net.terminals
    of_vessels("outlets", "log-first-resistance", np.log(after.psi1 / before.psi1), at)
    of_vessels("outlets", "log-resistance", np.log(after.psi2 / before.psi2), at)
    of_vessels("outlets", "log-compliance", np.log(after.c / before.c), at)
    omega: Array = np.asarray(2 * math.pi / net.period_s * np.arange(HARMONICS + 1), dtype=np.float64)
    true, nominal = impedance(after, omega), impedance(before, omega)
    if not np.allclose(true, nominal, rtol=1e-12):
        found.append(
            table(
                "outlets", "log-impedance", "angular frequency", "rad/s", "1", omega,
                np.log(np.abs(true / nominal)),
                phase=numbers(np.angle(true / nominal)),
                labels=[ids[i] for i in net.terminals],
                log_modulus=numbers(np.log(np.abs(true))),
                loads={name: numbers(getattr(net, name)[net.terminals]) for name in ("R1", "R2", "C")},
            )
        )  # fmt: skip
    acts = after.waves[len(before.waves) :]
    if acts:
        wave = Wave(plain, tuple(quantities), net.period_s)
        for act in acts:
            wave = act(wave)
        times = np.arange(plain.shape[1]) * (net.period_s / plain.shape[1])
        found.append(
            table(
                "sensor", "reading", "time", "s", "mmHg", times, wave.value - plain,
                pressure=numbers(plain), labels=list(labels),
            )
        )  # fmt: skip
    return found
