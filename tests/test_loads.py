"""The impedance of outlets against the solver's waves at the terminals' ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from test_physics import ADDED, PERIOD, STIFFNESS, bifurcation, solver
from zoo.blood.case import Case
from zoo.blood.conventions import PRINTED
from zoo.blood.functions import WallFunction
from zoo.blood.loads import outlet_impedance
from zoo.blood.physics import Physics
from zoo.blood.solver import SolverOptions
from zoo.blood.units import MMHG

OMEGA = 2 * np.pi / PERIOD * np.arange(13)
LONG = {"inertance": np.array([0.0, 1000.0, 800.0])}
PHYSICS: list[dict[str, Any]] = [
    {},
    ADDED["sections"],
    {**ADDED["sections"], **LONG},
    {
        **LONG,
        "stiffness_ratio": np.array([1.0, 1.4, 0.7]),
        "stiffness_exponent": np.ones(3),
        "wall_function": WallFunction(0.9, 1.5, 0.1 * np.linspace(-0.1, 0.5, 8)),
    },
]


@pytest.mark.parametrize("physics", PHYSICS)
def test_waves_at_the_outlets_have_the_impedance(physics: dict[str, Any]) -> None:
    options = SolverOptions(steps_per_beat=8192, tolerance_mmHg=1e-6, max_beats=300)
    psi1, psi2, c = 1.2, 0.9, 1.1
    solution = solver(options=options, n_times=2048, **physics).solve(STIFFNESS, 2.0, psi1, psi2, c)
    network, one = bifurcation(), np.ones(3)
    time = np.arange(8) * PERIOD / 8
    given = (STIFFNESS, 2 * one, psi1 * one, psi2 * one, c * one)
    case = Case(network, time, 1 + 0 * time, PRINTED, "linear", options, Physics(**physics), *given)
    Z = outlet_impedance(case, OMEGA)
    assert Z.shape == (2, 13)
    for row, expected in zip((3, 5), Z, strict=True):
        p = np.fft.rfft(solution.pressure_mmHg[row] * MMHG)[:13]
        q = np.fft.rfft(solution.flow_ml_s[row])[:13]
        np.testing.assert_allclose(p, expected * q, atol=3e-4 * np.abs(p[1:]).max())
