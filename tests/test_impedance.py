"""Input impedance at the root, against closed forms and against the impedance that made the data."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.impedance import errors

from zoo.blood.baseline import get_baseline
from zoo.blood.blood_flow import study_data
from zoo.blood.case import Case, simulate, wall_slope
from zoo.blood.components import components
from zoo.blood.conventions import PRINTED
from zoo.blood.impedance import ImpedanceError, measured_impedance, modelled_impedance
from zoo.blood.network import Network
from zoo.blood.physics import NO_PHYSICS
from zoo.blood.solver import SolverOptions
from zoo.blood.study import load_study
from zoo.blood.units import MMHG
from zoo.core.data import Data
from zoo.core.parameters import pack

THETA = {"f3": 4.6e4, "psi1": 0.35, "psi2": 0.9, "c": 1.2}
PERIOD, RADIUS, LENGTH, CHI = 0.11, 0.05, 0.4, 8e4
R1, R2, C = 6e3, 3e4, 2e-6


def line(harmonics: int = 8, swing: float = 0.001) -> Case:
    """One vessel before a Windkessel, with small harmonics around a mean flow."""
    n = 1024
    times = np.arange(n) * (PERIOD / n)
    flow = np.full(n, 0.02)
    for k in range(1, harmonics + 1):
        flow += swing * np.cos(2 * np.pi * k * times / PERIOD + 0.3 * k)
    one = np.ones(1)
    network = Network(
        ids=[1], parent=[-1], length_cm=one * LENGTH, radius_in_cm=one * RADIUS, radius_out_cm=one * RADIUS,
        R1=one * R1, R2=one * R2, C=one * C, density=1.055, viscosity=0.049, period_s=PERIOD,
    )  # fmt: skip
    return Case(
        network, times, flow, PRINTED, "linear", SolverOptions(dx_cm=0.01, tolerance_mmHg=1e-6), NO_PHYSICS,
        one * CHI, 2 * one, one, one, one,
    )  # fmt: skip


def line_impedance(case: Case, omega: np.ndarray) -> np.ndarray:
    """Of the linearised equations around the mean pressure, mmHg s/ml: a lossy line before R1 + R2 || C."""
    net = case.network
    area = float(np.mean(simulate(case, [(1, 0.5, "area_cm2")], case.inflow_time_s)))
    rest = math.pi * RADIUS**2
    per_area = float(wall_slope(case)[0]) / math.sqrt(area * rest)  # dp/dA of (4/3) chi (sqrt(A/A0) - 1)
    compliance = 1 / per_area
    layer = math.sqrt(net.viscosity / net.density * PERIOD / (2 * math.pi))
    friction = 2 * math.pi * net.viscosity / net.density * math.sqrt(area / math.pi) / layer / area
    series = net.density / area * (1j * omega + friction)
    shunt = 1j * omega * compliance
    own, along = np.sqrt(series / shunt), np.sqrt(series * shunt) * LENGTH
    load = R1 + R2 / (1 + 1j * omega * R2 * C)
    found = own * (load + own * np.tanh(along)) / (own + load * np.tanh(along))
    return np.asarray(found / MMHG)


def test_the_modelled_impedance_of_one_vessel_is_that_of_a_lossy_line_before_its_windkessel():
    case = line()
    found = modelled_impedance(case, harmonics=8)
    omega = 2 * np.pi * found.frequency_Hz[1:]
    expected = line_impedance(case, omega)
    np.testing.assert_allclose(found.value[1:], expected, rtol=0.015)
    assert found.frequency_Hz[1] == pytest.approx(1 / PERIOD)
    steady = line_impedance(case, np.array([1e-6]))[0].real
    assert found.modulus[0] == pytest.approx(steady, rel=2e-3)
    assert steady > 1.05 * (R1 + R2) / MMHG, "the vessel's friction is a part of it"
    np.testing.assert_array_equal(found.modulus_low, found.modulus)
    assert not found.weak.any()


def data_of(case: Case, noise: float = 0.0, lag: float = 0.0, n: int = 256, seed: int = 0) -> Data:
    times = np.arange(n) * (PERIOD / n)
    pressure = simulate(case, [(1, 0.0, "pressure_mmHg")], times + lag * PERIOD)
    pressure = pressure + noise * np.random.default_rng(seed).standard_normal(pressure.shape)
    return Data(
        times, pressure, labels=["p"], units=["mmHg"], groups=["pressure_mmHg"], period=PERIOD,
        outputs=[(1, 0.0, "pressure_mmHg")],
    )  # fmt: skip


@pytest.mark.parametrize("lag", [0.0, 1 / 512])
def test_the_measured_impedance_of_exact_series_is_the_modelled_one(lag):
    case = line()
    case = replace(case, conventions=case.conventions.replace(sample_lag_beats=lag))
    found = measured_impedance(data_of(case, lag=lag), case, noise_mmHg=0.0, flow_noise_ml_s=0.0, harmonics=8)
    np.testing.assert_allclose(found.value, modelled_impedance(case, harmonics=8).value, rtol=2e-3)


def test_the_intervals_hold_the_truth_as_often_as_they_say():
    """Noise in the pressure and in the flow; 40 data sets of 8 harmonics."""
    case, inside = line(), []
    truth = modelled_impedance(case, harmonics=8)
    sd, sd_q = 0.005, 0.0003
    for seed in range(40):
        random = np.random.default_rng(1000 + seed)
        seen = replace(case, inflow_ml_s=case.inflow_ml_s + sd_q * random.standard_normal(1024) * 2)
        found = measured_impedance(
            data_of(case, noise=sd, seed=seed), seen, noise_mmHg=sd, flow_noise_ml_s=sd_q, harmonics=8
        )
        assert np.all(found.modulus_low <= found.modulus)
        assert np.all(found.modulus <= found.modulus_high)
        inside.append((found.modulus_low <= truth.modulus) & (truth.modulus <= found.modulus_high))
        inside.append((found.phase_low <= truth.phase) & (truth.phase <= found.phase_high))
    assert 0.91 < np.mean(inside) < 0.98


def test_a_spike_where_the_flows_harmonic_is_nearly_zero_points_to_the_record():
    case = line()
    harmonics = np.fft.rfft(case.inflow_ml_s)
    harmonics[3] *= 0.2
    recorded = np.fft.irfft(harmonics, 1024)
    found = modelled_impedance(case, recorded_ml_s=recorded, harmonics=8)
    assert found.weak.tolist() == [k == 3 for k in range(9)]
    assert found.spike.tolist() == found.weak.tolist()
    assert found.flow_part[3] == pytest.approx(0.2, rel=1e-3)
    assert "harmonic 3" in found.sentences()[0]
    # with the flow that enters there is none, and a weak harmonic alone is no spike
    assert not modelled_impedance(case, harmonics=8).spike.any()
    entering = replace(case, inflow_ml_s=recorded)
    alone = modelled_impedance(entering, harmonics=8)
    assert alone.weak[3]
    assert not alone.spike.any()
    assert alone.sentences() == []


def test_noise_that_hides_a_harmonic_makes_it_weak():
    case = line(harmonics=4)
    found = measured_impedance(data_of(case), case, noise_mmHg=0.005, harmonics=8)
    assert found.weak[5:].all()
    assert not found.weak[:5].any()


def test_what_has_no_impedance_is_refused():
    case = line()
    data = data_of(case)
    with pytest.raises(ImpedanceError, match="position 0 of vessel 1"):
        measured_impedance(replace(data, outputs=((1, 1.0, "pressure_mmHg"),)), case, noise_mmHg=0.1)


@pytest.mark.needs_data
def test_the_measured_mouse_has_a_spike_at_its_third_harmonic_that_an_inflow_explains():
    study = load_study("mouse-c6")
    model = get_baseline("linear-constant").forward(study, options=SolverOptions())
    theta = pack(model.parameters, THETA)
    case, data = model.configure(theta), study_data(study)
    found = measured_impedance(data, case, noise_mmHg=0.1)
    assert np.flatnonzero(found.spike).tolist() == [3], "others are lost in the flow's noise"
    assert found.flow_part[3] == pytest.approx(1 / 12, rel=0.05)
    assert found.modulus[3] > 1.5 * math.sqrt(found.modulus[2] * found.modulus[4])
    plain = modelled_impedance(case)
    assert not plain.spike[3]
    # a flow that enters with more of its third harmonic than the record shows looks like the measured one
    record = next(f for f in components(model, theta, data) if f.name == "flow-record")
    third = np.fft.rfft(case.inflow_ml_s)[3] * 2 / len(case.inflow_ml_s)
    values = np.real(third * np.exp(2j * np.pi * 3 * record.at / record.period))
    changed = modelled_impedance(record.apply(case, values), recorded_ml_s=case.inflow_ml_s)
    assert changed.modulus[3] == pytest.approx(2 * plain.modulus[3], rel=0.1)
    assert changed.spike[3]


def test_vessels_and_forks_have_the_impedance_of_transmission_lines() -> None:
    """At the default accuracy, which is that of a series; benchmarks/impedance.py has more."""
    for fork, off in errors(6, seed=5):
        assert np.all(off < [5e-4, 2.5e-3, 1.5e-2]), (fork, off)
